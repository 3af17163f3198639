"""A simulated cell without a batch, for tests of single skills."""

from pathlib import Path
from types import TracebackType
from typing import Any, Self

from scuhand_bt.cell.cell import Cell
from scuhand_bt.cell.leased import leased
from scuhand_bt.kit.rehearsed import Rehearser
from scuhand_bt.recipe.plan import Plan
from scuhand_bt.recipe.recipe import Recipe
from scuhand_bt.tree.leaf import made


class DryCell:
    """The lab's cell, simulated, with nothing on its pan and nothing in its cone; its clock jumps."""

    def __init__(self, rehearser: Rehearser, folder: Path) -> None:
        self._lab = rehearser.lab
        recipe = Recipe(folder / "test", "", "test", "as_written", None, {}, (), {"otherwise": "flag"}, 0, {})
        self._session = rehearser.session(Plan(recipe, (), (), (), {}), folder)

    @property
    def cell(self) -> Cell:
        """The cell, with all its devices."""
        return self._session.cell

    def run(self, skill: str, **inputs: Any) -> Any:
        """Run a skill of the lab to its end with the devices that it leases, and give its result.

        Inputs as a workflow writes them ("5 s"), or as values. KeyError for a skill that is none; SkillFailed.
        """
        cls = self._lab.library.skills[skill]
        steps = made(skill, cls, inputs).run(leased(self.cell, cls.sees()))
        try:
            while True:
                self.cell.clock.wait([next(steps)])
        except StopIteration as ended:
            return ended.value

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._session.close()
