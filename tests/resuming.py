"""A recipe in a lab of its own, run, stopped and resumed in this process."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from running import HEAD, shared_planner

from scuhand_bt.events.entry import Event, Note
from scuhand_bt.journal.reader import read
from scuhand_bt.lab import Lab, load_lab
from scuhand_bt.recipe.plan import Plan, make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.run.observers import BatchObserver
from scuhand_bt.run.options import Options
from scuhand_bt.run.resume import checked_history, find_run, resumable
from scuhand_bt.run.session import Session
from scuhand_bt.run.simulation import DryRun

RECIPE = """
recipe: three
workflow: fill_xrd_holder
defaults: {source: beads, container: xrd_holder, tolerance: 2 mg}
samples:
  - {id: a, mass: 20 mg}
  - {id: b, mass: 80 mg}
  - {id: c, mass: 200 mg, container: alumina_crucible, workflow: scoop_and_dispense}
"""


class Watch(BatchObserver):
    """Wishes something of the run at a tick, and waits for no one."""

    def __init__(self, wish: str | None = None, at_tick: int = 10**9) -> None:
        self.session: Any = None
        self._wish, self._at, self.ticks = wish, at_tick, 0

    def ticked(self, root: Any) -> None:
        self.ticks += 1
        if self.ticks == self._at:
            self.session.control.wish(self._wish)


class Run:
    """A recipe in a folder, run and resumed in this process."""

    def __init__(self, folder: Path, lab: Path, recipe: str = RECIPE) -> None:
        self.folder, self.recipe = folder / "runs", folder / "recipe.yaml"
        self.lab_folder = lab
        self.recipe.write_text(recipe + HEAD, encoding="utf-8")

    def plan(self) -> tuple[Plan, Lab]:
        lab = load_lab(self.lab_folder)
        return make_plan(load_recipe(self.recipe, lab), lab), lab

    @property
    def journal(self) -> Path:
        return find_run(self.folder, "last")

    def go(
        self,
        watch: Watch,
        *,
        resumes: bool = False,
        accept_changes: bool = False,
        heard: Callable[[Event | Note], None] | None = None,
        **options: Any,
    ) -> Any:
        plan, lab = self.plan()
        found = None
        if resumes:
            history = checked_history(self.journal)
            found = resumable(self.journal, history, plan, lab, accept_changes=accept_changes)
        chosen = Options(**{"simulation": DryRun(), "folder": self.folder, **options})
        session = Session(plan, lab, chosen, shared_planner(plan, lab), resumes=found)
        if heard is not None:
            session.journal.heard = heard
        watch.session = session
        try:
            return session.run(watch)
        finally:
            session.close()


def actions(journal: Path) -> list[tuple[str, str]]:
    return [(row["skill"], row["outcome"]) for row in read(journal, "action")]
