"""One run from plan to result: the cell, its journal, and the batch between them."""

import os
import secrets
import sqlite3
from dataclasses import dataclass
from datetime import datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import scuhand_bt
from scuhand_bt.clock import Signal
from scuhand_bt.devices.cell import Cell
from scuhand_bt.dosing import CONTROLLERS
from scuhand_bt.lab import Lab, starter_lab
from scuhand_bt.motion import MotionPlanner
from scuhand_bt.plan import Plan, check_unattended
from scuhand_bt.run.batch import Batch, BatchObserver, BatchResult
from scuhand_bt.run.journal import Journal
from scuhand_bt.run.learnt import LabState
from scuhand_bt.run.setup import DryRun, Simulation, set_up
from scuhand_bt.yaml_source import Mark, Problem, SourceError

LIBRARIES = ("py-trees", "pin", "ruckig", "numpy", "scipy", "pydantic")


@dataclass(frozen=True)
class Options:
    """How a plan is run: `simulation` is None on the real cell; `controller` overrides the recipe's."""

    simulation: Simulation | None
    controller: str | None = None
    folder: Path | None = None
    """Where the journal goes; the lab's own `.scuhand/runs` if None. What is learnt goes beside it."""
    unattended: bool = False
    """Nobody is at the cell: a plan that needs a person is refused, and no question waits."""


class Session:
    """A cell made ready for a plan. `run` once, then `close`.

    `motion` is a planner that `prepared_motion` made for the same places, when dry runs share one.

    Raises, before anything moves: SourceError for an unknown controller, an unwritable folder or an unattended plan
    that needs a person, PlantError for a plant that cannot be used, NoCompiler for a rehearsal without one,
    SkillFailed for places without a way between them, or a device that does not answer.
    """

    def __init__(
        self,
        plan: Plan,
        lab: Lab,
        options: Options,
        motion: MotionPlanner | None = None,
        stop: Signal | None = None,
    ) -> None:
        _check_controller(options.controller)
        if options.unattended:
            check_unattended(plan)
        self.plan = plan
        self.stop = stop or Signal()
        """Fire it to end the run safely at the next tick (Ctrl-C does)."""
        self.run_id = f"{datetime.now():%Y%m%d-%H%M%S}-{plan.recipe.name}-{secrets.token_hex(2)}"
        folder = options.folder or state_folder(lab) / "runs"
        self.journal = _open_journal(
            folder / f"{self.run_id}.sqlite", durable=not isinstance(options.simulation, DryRun)
        )
        try:
            setup = set_up(plan, lab, options.simulation, self.journal, motion, unattended=options.unattended)
        except BaseException:
            self.journal.discard()
            raise
        self.cell, self.world, self._close_cell = setup.cell, setup.world, setup.close
        if options.controller is not None:
            self.cell.controller = options.controller
        self.journal.now_s = lambda: self.cell.clock.now_s
        self.journal.describe_run(_describe(plan, lab, options, self.cell, self.run_id))
        self._library = lab.library
        self._state = LabState(folder.parent)
        if not self.cell.simulated:
            self._state.recall(self.cell)

    def run(self, observer: BatchObserver) -> BatchResult:
        """Run the batch to its end; whatever happens, the cell ends safe."""
        world = self.world
        judge = world.true_mass if world is not None else None
        batch = Batch(self.plan, self.cell, self._library, self.journal, observer, self.stop, judge)
        try:
            return batch.run()
        finally:
            if world is not None:
                self.journal.event("matter", world.masses_mg)
            self._state.keep(self.cell, self.run_id)

    def close(self) -> None:
        """Close the devices and the journal."""
        try:
            self._close_cell()
        finally:
            self.journal.close()


def state_folder(lab: Lab) -> Path:
    """Where journals and what is learnt go: the lab's `.scuhand`; the working folder's for the packed starter lab."""
    packed = lab.folder == starter_lab() and lab.folder.name == "starter_lab"
    home = Path.cwd() if packed or not os.access(lab.folder, os.W_OK) else lab.folder
    return home / ".scuhand"


def _open_journal(path: Path, *, durable: bool) -> Journal:
    try:
        return Journal(path, durable=durable)
    except (OSError, sqlite3.Error) as error:
        problem = Problem(Mark(str(path)), f"the journal cannot be written: {error}; nothing was moved")
        raise SourceError([problem]) from None


def _check_controller(name: str | None) -> None:
    if name is not None and name not in CONTROLLERS:
        problem = f"unknown controller '{name}'; known: {', '.join(CONTROLLERS)}"
        raise SourceError([Problem(Mark("--controller", 0), problem)])


def _describe(plan: Plan, lab: Lab, options: Options, cell: Cell, run_id: str) -> dict[str, object]:
    simulation = options.simulation
    return {
        "run": run_id,
        "recipe": plan.recipe.name,
        "recipe_hash": plan.recipe.hash,
        "recipe_text": plan.recipe.text,
        "recipe_path": str(plan.recipe.path),
        "lab": str(lab.folder),
        "cell": lab.cell.cell,
        "simulated": simulation is not None,
        "unattended": options.unattended,
        "mode": simulation.mode if simulation is not None else "real devices",
        "seed": simulation.seed if simulation is not None else None,
        "plant": (simulation.plant or lab.cell.plant or "scuhand_bt") if simulation is not None else None,
        "controller": cell.controller,
        "version": scuhand_bt.__version__,
        "libraries": {name: _version(name) for name in LIBRARIES},
        "started": datetime.now().astimezone().isoformat(timespec="seconds"),
    }


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"
