"""Dry runs for tests: a small lab, sessions that share one planner per set of places, and a cell beside any run."""

import functools
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, cast

from scuhand_bt.cell.cell import Cell
from scuhand_bt.devices.interfaces import Operator
from scuhand_bt.journal.results import SampleResult
from scuhand_bt.lab import Lab, load_lab, starter_lab
from scuhand_bt.motion import MotionPlanner
from scuhand_bt.recipe.plan import Plan, make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.record import Record
from scuhand_bt.run.clock import VirtualClock
from scuhand_bt.run.observers import BatchObserver
from scuhand_bt.run.options import Options
from scuhand_bt.run.outcome import BatchResult
from scuhand_bt.run.prepared_motion import places_of, prepared_motion
from scuhand_bt.run.session import Session
from scuhand_bt.run.simulation import DryRun
from scuhand_bt.sim.cell import simulated_cell
from scuhand_bt.sim.fault_rules import parse_faults
from scuhand_bt.sim.world import World
from scuhand_bt.specs import Source

HEAD = """
sources:
  beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 20 g}
  msg: {station: mortar_bay_2, container: small_agate_mortar, powder: monosodium_glutamate, amount: 8 g}
"""


_PLANNERS: dict[str, MotionPlanner] = {}


def shared_planner(plan: Plan, lab: Lab) -> MotionPlanner:
    """Planning is the same for the same places: it is done once for all runs of a test session."""
    key = f"{lab.cell} {sorted(places_of(plan, lab).items())}"
    if key not in _PLANNERS:
        _PLANNERS[key] = prepared_motion(plan, lab)
    return _PLANNERS[key]


def make_lab(folder: Path, **files: str) -> Path:
    """A copy of the starter lab with more files: `trees__mine="…"` writes trees/mine.yaml.

    With its skills as they were compiled: else each test that has a lab does it anew.
    """
    for part in ("robot", "skills", "trees"):
        shutil.copytree(starter_lab() / part, folder / part)
    for name, text in files.items():
        part, stem = name.split("__", 1)
        (folder / part / f"{stem}.{'py' if part == 'skills' else 'yaml'}").write_text(text, encoding="utf-8")
    return folder


@dataclass
class Watching(BatchObserver):
    """An observer that counts ticks, and may stop the run at one of them."""

    session: Session | None = None
    stop_at: int | None = None
    ticks: int = 0
    at_tick: Callable[[Any], None] = lambda root: None
    results: list[SampleResult] = field(default_factory=list)

    def ticked(self, root: Any) -> None:
        self.ticks += 1
        self.at_tick(root)
        if self.ticks == self.stop_at and self.session is not None:
            self.session.control.wish("stop_now")

    def sample_ended(self, result: SampleResult) -> None:
        self.results.append(result)


@dataclass
class Ran:
    """A finished dry run."""

    result: BatchResult
    session: Session
    watching: Watching

    @property
    def journal(self) -> Path:
        return self.session.journal.path

    def sample(self, sample_id: str) -> SampleResult:
        return next(sample for sample in self.result.samples if sample.id == sample_id)


def dry_run(
    tmp_path: Path,
    recipe: str,
    *,
    lab: Path | None = None,
    seed: int = 0,
    plant: str | None = None,
    controller: str | None = "paper",
    stop_at: int | None = None,
    at_tick: Callable[[Any], None] | None = None,
    faults: str | None = None,
) -> Ran:
    """Run a recipe's text (without its sources, those of `HEAD` are used) to its end; `faults` is a fault file's."""
    path = tmp_path / "recipe.yaml"
    path.write_text(recipe if "sources:" in recipe else recipe + HEAD, encoding="utf-8")
    loaded = _load(lab or starter_lab())
    plan = make_plan(load_recipe(path, loaded), loaded)
    wrong = parse_faults(faults, "faults.yaml") if faults is not None else None
    simulation = DryRun(seed, plant, faults=wrong)
    session = Session(plan, loaded, Options(simulation, controller, tmp_path / "runs"), shared_planner(plan, loaded))
    watching = Watching(session, stop_at)
    if at_tick is not None:
        watching.at_tick = at_tick
    try:
        result = session.run(watching)
    finally:
        session.close()
    return Ran(result, session, watching)


def _load(folder: Path) -> Lab:
    return _starter() if folder == starter_lab() else load_lab(folder)


@functools.cache
def _starter() -> Lab:
    return load_lab(starter_lab())


def simulated_bench(
    lab: Lab,
    motion: MotionPlanner,
    clock: VirtualClock,
    sources: Mapping[str, Source] = MappingProxyType({}),
    record: Record | None = None,
) -> tuple[Cell, World]:
    """A lab's simulated cell on a clock, its arm at home, without a run and without a person."""
    cell, world = simulated_cell(
        lab.cell,
        sources,
        clock=clock,
        record=record or Record(),
        motion=motion,
        operator=cast(Operator, None),
        seed=1,
        joints=motion.home(),
    )
    clock.process = world
    return cell, world
