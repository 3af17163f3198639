"""What a step of a commissioning is, and what it is given: the lab, a person who answers, and the time."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.clock import Clock
from scuhand_bt.lab import Lab
from scuhand_bt.run.clock import WallClock
from scuhand_bt.run.operator import Person
from scuhand_bt.yaml_edit import Path as Keys
from scuhand_bt.yaml_edit import Value


class Left(Exception):  # noqa: N818 - the person has left off; nothing is wrong
    """The person goes no further now."""


class NotFound(Exception):  # noqa: N818 - it reads as the sentence it is raised in
    """A step has not come to what can be believed; its words say why, and what to do."""


class Dialogue(Protocol):
    """The person at the cell."""

    def tell(self, text: str) -> None:
        """Say something."""
        ...

    def ask(self, question: str, choices: Sequence[str] = ("done", "stop")) -> str:
        """Ask, and wait for one of the choices; `Left` for "stop"."""
        ...

    def measure(self, question: str) -> float:
        """Ask for a number that the person reads off, 0 or more; `Left` for "stop"."""
        ...


@dataclass(frozen=True)
class Site:
    """Where a step is done."""

    lab: Lab
    person: Dialogue
    state: Path
    """The folder of the lab's state."""
    who: Person
    simulated: bool = False
    """Its devices are twins: what is found says nothing of a real cell."""
    clock: Clock = field(default_factory=WallClock)

    @property
    def cell(self) -> CellSpec:
        return self.lab.cell


@dataclass(frozen=True)
class Found:
    """What a step came to: in words, and as values of the cell's file."""

    words: Mapping[str, str]
    values: Mapping[Keys, Value] = field(default_factory=dict)


@dataclass(frozen=True)
class Step:
    """One step of the commissioning."""

    name: str
    summary: str
    rests_on: tuple[str, ...]
    """Paths in the cell's file: where one of them is changed, it is to be done again."""
    run: Callable[[Site], Found]
    """Raises Left, NotFound; SkillFailed of a device."""
    takes_cell: bool = True
    """False for a step that is a run, which takes it itself."""
