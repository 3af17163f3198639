"""The lab that an interleaving happens in, and what has happened there."""

import shutil
import sqlite3
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

from harness.gated import Command
from scuhand_bt.journal.history import read_history
from scuhand_bt.lab import load_lab, starter_lab
from scuhand_bt.motion import MotionPlanner
from scuhand_bt.problems import SourceError
from scuhand_bt.recipe.plan import make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.run.observers import BatchObserver
from scuhand_bt.run.options import Options
from scuhand_bt.run.prepared_motion import prepared_motion
from scuhand_bt.run.session import Session
from scuhand_bt.run.simulation import DryRun
from scuhand_bt.sim.fault_rules import OUTAGES

RECIPE = """
recipe: shared
workflow: {workflow}
sources: {{beads: {{station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 20 g}}}}
defaults: {{source: beads, container: xrd_holder, tolerance: 2 mg}}
samples:
  - {{id: a, mass: 30 mg}}
  - {{id: a.2, mass: 50 mg}}
on_failure: {{container.changed: redo, container.missing: redo, dose.overshoot: redo, otherwise: flag}}
"""
TARGETS_MG = {"a": 30.0, "a.2": 50.0}
TOLERANCE_MG = 2.0
SOURCE_MG = 20_000.0
FILL = """workflow: careless_fill
inputs: {source: Source, container: Container, mass: Mass, tolerance: {type: Mass, default: 2 mg}}
result: $dose
tree:
  sequence:
    - place_container: {container: $container}
    - tare:
    - fill: {source: $source, container: $container, mass: $mass, tolerance: $tolerance, as: dose}
    - park:
    - careless:
"""
SKILL = '''
"""A skill that does what none may."""
import sys
from scuhand_bt.journal.run_events import Ended
from scuhand_bt.skill import Cell, Skill, Steps, pause

class Careless(Skill[None]):
    """Be careless."""
    devices = ("hand",)
    interrupted = "repeat"
    def run(self, cell: Cell) -> Steps[None]:
        yield from pause(cell, 0.5)
        {does}
'''
CARELESS = {
    "leaves the valve open": "cell.hand.set_opening(2.0)",
    "says that the run has ended": 'cell.record.event(Ended(exit_code=0, reason="", complete=True))',
    "ends the program": "sys.exit(0)",
}
LIKELY = 0.2
"""How likely each of the things that a power cut may do comes with one."""


@dataclass(frozen=True)
class Made:
    """What one interleaving is, beside what happens in it."""

    seed: int
    folder: Path
    motion: MotionPlanner
    plant: Callable[[], None] = lambda: None
    """Changes the program in every process."""
    has_outages: bool = False
    only: str = ""
    """The one thing that every power cut does."""
    careless: str = ""
    """What the lab's careless skill does; empty where it has none."""
    steps: int = 12
    script: Sequence[str] = ()
    """What happens, instead of what is drawn."""

    @property
    def lab(self) -> Path:
        return self.folder / "lab"


@dataclass
class Done:
    """What has happened."""

    made: Made
    ended: list[Command] = field(default_factory=list)
    """Every command, in the order in which they ended."""
    happened: list[str] = field(default_factory=list)
    count: Counter[str] = field(default_factory=Counter)
    deleted_s: dict[str, float] = field(default_factory=dict)
    """When the journal of a run was deleted, and with it what the run had come to until then."""
    given_up: dict[str, str] = field(default_factory=dict)
    """Runs that cannot be resumed, and why."""
    problems: list[str] = field(default_factory=list)

    @property
    def runs(self) -> Path:
        return self.made.lab / ".scuhand" / "runs"

    @property
    def journals(self) -> list[Path]:
        return sorted(path for path in self.runs.glob("*.sqlite"))

    def wrong(self, what: str) -> None:
        self.problems.append(f"seed {self.made.seed}: {what}")


def shared_motion(folder: Path) -> MotionPlanner:
    """The planner of all interleavings: they have the same places.

    It has served a run, which has imported what is imported only when it is needed: no process begins with that.
    """
    lab = load_lab(starter_lab())
    recipe = folder / "motion.yaml"
    recipe.write_text(RECIPE.format(workflow="fill_xrd_holder"), encoding="utf-8")
    plan = make_plan(load_recipe(recipe, lab), lab)
    motion = prepared_motion(plan, lab)
    with closing(Session(plan, lab, Options(DryRun(0), folder=folder / "runs"), motion)) as session:
        session.run(BatchObserver())
    return motion


def make_lab(made: Made) -> tuple[Path, Path]:
    """The starter lab's copy, with what is careless in it; its recipe, and the file of what power cuts do."""
    for part in ("robot", "skills", "trees"):
        shutil.copytree(starter_lab() / part, made.lab / part, ignore=shutil.ignore_patterns("__pycache__", "firmware"))
    (made.lab / "recipes").mkdir()
    if made.careless:
        (made.lab / "skills" / "careless.py").write_text(SKILL.format(does=CARELESS[made.careless]))
        (made.lab / "trees" / "careless_fill.yaml").write_text(FILL)
    recipe = made.lab / "recipes" / "shared.yaml"
    workflow = "careless_fill" if made.careless else "fill_xrd_holder"
    recipe.write_text(RECIPE.format(workflow=workflow), encoding="utf-8")
    faults = made.folder / "faults.yaml"
    rules = [f"{{fault: {made.only}, probability: 1}}"] if made.only else []
    rules = rules or [f"{{fault: {name}, probability: {LIKELY}}}" for name in OUTAGES]
    faults.write_text("faults:\n" + "".join(f"  - {rule}\n" for rule in rules))
    return recipe, faults


def read_is_complete(journal: Path) -> bool:
    """Whether its journal says that nothing is left to do."""
    try:
        return read_history(journal).is_complete
    except SourceError:
        return False


def heads_of(journal: Path) -> list[bytes]:
    """The hashes of a journal's entries; none where it is no journal."""
    if not journal.exists():
        return []
    with closing(sqlite3.connect(journal)) as database:
        try:
            return [head for (head,) in database.execute("SELECT hash FROM entry ORDER BY seq")]
        except sqlite3.Error:
            return []
