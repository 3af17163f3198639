"""Single step: a person is asked before each action of a run."""

from collections.abc import Mapping
from typing import Any

from scuhand_bt.cell.cell import Cell
from scuhand_bt.clock import Steps, Wake
from scuhand_bt.run.control import Control
from scuhand_bt.tree.leaf import SkillLeaf, Ticking
from scuhand_bt.tree.library import units_of

CHOICES = ("go", "stop")


class SingleStep:
    """Lets each action of a run begin when the person at the cell says so; see `tree.leaf.Consent`.

    One question at a time: of actions that begin in parallel, the second is asked for after the first.
    """

    def __init__(self, cell: Cell, control: Control) -> None:
        self._cell, self._control = cell, control
        self._asked: SkillLeaf | None = None
        self._question: Steps[str] | None = None

    def waits(self, leaf: SkillLeaf, inputs: Mapping[str, Any], shared: Ticking) -> Wake | None:
        if self._asked not in (None, leaf):
            return Wake.on(shared.going_on)
        if self._question is None:
            self._asked = leaf
            self._question = self._cell.operator.ask(_asked(leaf, inputs), CHOICES)
            shared.holds_up(self, True)
        try:
            return next(self._question)
        except StopIteration as said:
            self._end(shared)
            if said.value == CHOICES[0]:
                return None
        self._control.wish("stop_now")
        return Wake.on(self._control.news)

    def withdraw(self, leaf: SkillLeaf, shared: Ticking) -> None:
        if self._asked is leaf:
            self._end(shared)

    def _end(self, shared: Ticking) -> None:
        question, self._question, self._asked = self._question, None, None
        if question is not None:
            question.close()
        shared.holds_up(self, False)
        shared.going_on.fire()  # for other leaves that wait for their question


def _asked(leaf: SkillLeaf, inputs: Mapping[str, Any]) -> str:
    units = units_of(leaf.skill)
    said = ", ".join(f"{key}: {_briefly(value)} {units.get(key, '')}".rstrip() for key, value in inputs.items())
    return f"Next: {leaf.name}{f' ({said})' if said else ''}. May it begin? With 'stop' the run stops here."


def _briefly(value: object) -> str:
    """A number or a word as it is; a container, source or powder by its name."""
    named = getattr(value, "id", None) or getattr(value, "name", None)
    return f"{value:g}" if isinstance(value, float) else str(named or value)
