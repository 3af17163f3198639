"""How a plan is to be run: as requested, as the journal's first entry has it, and as a resumed run gets it."""

from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import scuhand_bt
from scuhand_bt.cell.cell import Cell
from scuhand_bt.clock import wall_time
from scuhand_bt.dosing import CONTROLLERS
from scuhand_bt.journal.history import History
from scuhand_bt.journal.plain import plain_values
from scuhand_bt.journal.run_events import OptionsGiven, RunBegun, SamplePlanned, SourceUsed
from scuhand_bt.lab import Lab
from scuhand_bt.problems import Mark, Problem, SourceError
from scuhand_bt.recipe.plan import Plan
from scuhand_bt.run.operator import Person
from scuhand_bt.run.own_modules import digests, lab_modules
from scuhand_bt.run.simulation import DryRun, Rehearsal, Simulation
from scuhand_bt.sim.fault_rules import parse_faults

LIBRARIES = ("py-trees", "pin", "ruckig", "numpy", "scipy", "pydantic", "molmass")


ON_TWINS = "TWINS (simulated matter, real drivers)"
"""The mode of a run on the cell whose devices report that they are another program's twins."""


@dataclass(frozen=True)
class Options:
    """How a plan is run: `simulation` is None on the real cell; `controller` overrides the recipe's."""

    simulation: Simulation | None
    controller: str | None = None
    folder: Path | None = None
    """Where the journal goes; the lab's own `.scuhand/runs` if None. What is learnt goes beside it."""
    unattended: bool = False
    """Nobody is at the cell: a plan that needs a person is refused, and no question waits."""
    may_torque: bool = True
    """Whoever began or resumed the run has seen the arm. If it has no torque, it may be held where it is."""
    person: Person | None = None
    """Who runs it and answers; the user of the computer if None."""
    single_step: bool = False
    """A person is asked before each action."""
    slow_ratio: float = 1.0
    """The share of their own speeds at which arm, roller and changer may go (`CellSpec.slowed`)."""
    is_kept: bool = True
    """Keep a journal and everything else that outlives a run. Without it, as for a dry run that nobody will look at,
    nothing is learnt and nobody is notified."""


def options_of(history: History, folder: Path) -> Options:
    """The options with which an interrupted run was begun."""
    run, given = history.run, history.run.options
    faults = parse_faults(run.faults_text, given.faults or "") if run.faults_text is not None else None
    simulation: Simulation | None = None
    if run.mode == Rehearsal.mode:
        simulation = Rehearsal(run.seed or 0, given.plant, faults, given.asks)
    elif run.seed is not None:  # None also on another program's twins
        simulation = DryRun(run.seed, given.plant, given.speed, faults, given.asks)
    return Options(
        simulation, given.controller, folder, run.unattended, single_step=given.step, slow_ratio=given.slow_ratio
    )


def check_controller(name: str | None) -> None:
    """Raises SourceError for a dosing controller that does not exist."""
    if name is not None and name not in CONTROLLERS:
        problem = f"unknown controller '{name}'; known: {', '.join(CONTROLLERS)}"
        raise SourceError([Problem(Mark("--controller", 0), problem)])


def described(plan: Plan, lab: Lab, options: Options, cell: Cell, run_id: str, person: Person) -> RunBegun:
    """The first entry of a run's journal: everything that another program needs to resume it."""
    simulation = options.simulation
    faults = simulation.faults if simulation is not None else None
    return RunBegun(
        run=run_id,
        recipe=plan.recipe.name,
        recipe_hash=plan.recipe.hash,
        recipe_text=plan.recipe.text,
        recipe_path=str(plan.recipe.path.absolute()),
        lab=str(lab.folder.absolute()),
        lab_files=lab.files,
        modules=digests(lab_modules(lab.folder)),
        cell=lab.cell.cell,
        simulated=cell.simulated,
        unattended=options.unattended,
        mode=simulation.mode if simulation is not None else ON_TWINS if cell.simulated else "real devices",
        seed=simulation.seed if simulation is not None else None,
        plant=(simulation.plant or lab.cell.plant or "scuhand_bt") if simulation is not None else None,
        controller=cell.controller,
        faults_hash=faults.hash if faults is not None else None,
        faults_text=faults.text if faults is not None else None,
        options=OptionsGiven(
            controller=options.controller,
            plant=simulation.plant if simulation is not None else None,
            speed=simulation.speed if isinstance(simulation, DryRun) else None,
            faults=faults.marks[0].file if faults is not None else None,
            asks=simulation is not None and simulation.asks,
            step=options.single_step,
            slow_ratio=options.slow_ratio,
        ),
        sources={
            name: SourceUsed(
                station=source.station, powder=source.powder.name, lot=source.lot, mortar=source.mortar.name
            )
            for name, source in plan.recipe.sources.items()
        },
        samples=[
            SamplePlanned(
                id=sample.id,
                workflow=sample.workflow,
                inputs=plain_values(sample.inputs),
                done_s=round(plan.done_s[sample.id], 1),
            )
            for sample in plan.recipe.samples
        ],
        planned_s=round(plan.duration_s, 1),
        operator=person.name,
        signed=person.is_pin is not None,
        devices={
            name: {
                **lab.cell.section(name).model_dump(mode="json", by_alias=False, exclude_none=True),
                "options": lab.cell.options_of(name).model_dump(mode="json", by_alias=False, exclude_none=True),
            }
            for name in lab.cell.device_names
        },
        version=scuhand_bt.__version__,
        libraries={name: _version(name) for name in LIBRARIES},
        started=wall_time(),
    )


@cache
def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"
