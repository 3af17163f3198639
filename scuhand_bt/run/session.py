"""One run from plan to result: the cell, its journal, and the batch between them."""

import secrets
import sqlite3
from collections import Counter
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from datetime import datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import scuhand_bt
from scuhand_bt.cell.cell import Cell
from scuhand_bt.devices.interfaces import Reading
from scuhand_bt.dosing import CONTROLLERS
from scuhand_bt.events import Event, Note
from scuhand_bt.journal.events import (
    Asked,
    FaultRules,
    Matter,
    OptionsGiven,
    Paused,
    Resumed,
    RuleAccount,
    RunBegun,
    SamplePlanned,
    SourceUsed,
    Trouble,
)
from scuhand_bt.journal.history import History
from scuhand_bt.journal.plain import plain_values
from scuhand_bt.journal.presence import Held, Presence
from scuhand_bt.journal.writer import Journal
from scuhand_bt.lab import Lab, state_folder
from scuhand_bt.lab_state.beliefs import LabState
from scuhand_bt.lab_state.inventory import Inventory
from scuhand_bt.lab_state.lab_db import user_name
from scuhand_bt.motion import MotionPlanner
from scuhand_bt.problems import Mark, Problem, SourceError
from scuhand_bt.recipe.plan import Plan, check_unattended
from scuhand_bt.run.balance_limits import below_usp, beyond_limits
from scuhand_bt.run.batch import Batch, BatchObserver
from scuhand_bt.run.cell_state import state_of, take_up
from scuhand_bt.run.clock import VirtualClock
from scuhand_bt.run.control import Control, WishListener
from scuhand_bt.run.inventory_conflicts import conflicts, corrections, recall, require_resolvable, resolve
from scuhand_bt.run.make_cell import DryRun, Rehearsal, Simulation, set_up
from scuhand_bt.run.notify import Notice, NoticeState, Notifier
from scuhand_bt.run.outcome import BatchResult
from scuhand_bt.run.resume import Resumable, lab_files, world_path
from scuhand_bt.sim.fault_rules import parse_faults
from scuhand_bt.skill import SkillFailed

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
    """A cell made ready for a plan, new or to be resumed. `run` once, then `close`.

    `motion` is a planner that `prepared_motion` made for the same places, when dry runs share one; `resumes` is the
    interrupted run (`run/resume.py` finds and checks it).

    Raises, before anything moves: SourceError for an unknown controller, an unwritable folder, an unattended plan that
    needs a person, a real balance beyond its limits or a run that another process has, PlantError for a plant that
    cannot be used, NoCompiler for a rehearsal without one, SkillFailed for places without a way between them, or a
    device that does not answer.
    """

    def __init__(
        self,
        plan: Plan,
        lab: Lab,
        options: Options,
        motion: MotionPlanner | None = None,
        control: Control | None = None,
        resumes: Resumable | None = None,
    ) -> None:
        _check_controller(options.controller)
        if options.unattended:
            check_unattended(plan)
        self.plan = plan
        self.notices: list[str] = []
        """What went wrong beside the batch: a notification that failed, an inventory that could not be kept."""
        self.warnings: list[str] = []
        """What a real run asks more of its balance than that is known to give, where it goes on all the same."""
        self.control = control or Control()
        """By it the run is paused, continued and stopped, safely (Ctrl-C does)."""
        self._lab, self._options = lab, options
        self._history = resumes.history if resumes is not None else None
        if resumes is None:
            name = f"{datetime.now():%Y%m%d-%H%M%S}-{plan.recipe.name}-{secrets.token_hex(2)}"
            path = (options.folder or state_folder(lab) / "runs") / f"{name}.sqlite"
        else:
            path = resumes.path
        self.run_id = path.stem
        self._state = LabState(path.parent.parent)
        self._inventory = Inventory(path.parent.parent, lab.cell.cell)
        self._notifier = Notifier(lab.cell.notify)
        self._stock = self._inventory.stock(simulated=False) if options.simulation is None else {}
        has_begun = self._history is not None and self._history.state
        self._conflicts = [] if has_begun else conflicts(plan, lab.cell, self._stock)
        require_resolvable(self._conflicts, unattended=options.unattended)
        self.journal = _open_journal(path, durable=not isinstance(options.simulation, DryRun))
        with ExitStack() as opened:
            opened.callback(self.journal.discard if resumes is None else self.journal.close)
            self._make_cell(motion, opened)
            if not self.cell.simulated:
                self._meet_balance()
                self._state.recall(self.cell)
                recall(self.cell, self._stock)
            self._begin(resumes)
            for warning in self.warnings:
                self.journal.event(Trouble(what=warning))
            opened.pop_all()

    def _make_cell(self, motion: MotionPlanner | None, opened: ExitStack) -> None:
        journal, options, history = self.journal, self._options, self._history
        try:
            self._presence = Presence(journal.path)
        except Held:
            problem = f"the run is going on in another process; `scuhand-bt stop {self.run_id}` ends it"
            raise SourceError([Problem(Mark(str(journal.path)), problem)]) from None
        opened.callback(self._presence.end)
        self._listener = WishListener(journal.path, self.control)
        opened.callback(self._listener.end)
        setup = set_up(
            self.plan,
            self._lab,
            options.simulation,
            journal,
            motion,
            unattended=options.unattended,
            world_path=world_path(journal.path),
            resumed_at_s=None if history is None else history.time_s,
        )
        self.cell, self.world, self._close_cell = setup.cell, setup.world, setup.close
        opened.callback(self._close_cell)
        if options.controller is not None:
            self.cell.controller = options.controller
        self.cell.balance.on_reading = self._weighed
        journal.now_s = lambda: self.cell.clock.now_s
        journal.state = lambda: state_of(self.cell)
        journal.heard = self._heard
        if isinstance(self.cell.clock, VirtualClock):
            self.cell.clock.hurries = lambda: self.control.halts
        if self.world is not None:
            journal.before_commit = self.world.save

    def _meet_balance(self) -> None:
        """Which one it is, it has said by its first reading. SourceError where a new run asks more than it gives."""
        with suppress(SkillFailed):  # one that says nothing fails the run by itself
            for wake in self.cell.balance.next_reading():
                self.cell.clock.wait([wake])
        figures = self._state.figures(simulated=False).get(self.cell.balance_name, {})
        beyond = beyond_limits(self.plan, self._lab, figures, datetime.now().astimezone())
        if beyond and self._history is None and self._lab.cell.balance.limits.when_beyond == "refuse":
            raise SourceError(beyond)
        self.warnings = [str(problem) for problem in [*beyond, *below_usp(self.plan, self._lab, figures)]]

    def _weighed(self, reading: Reading) -> None:
        self.cell.readings.append(reading)
        self.journal.weighed(reading)

    def _begin(self, resumes: Resumable | None) -> None:
        """The first words of the journal, or the first ones of a resumed run."""
        if resumes is None:
            self.journal.event(_describe(self.plan, self._lab, self._options, self.cell, self.run_id))
            return
        take_up(self.cell, resumes.history.state)
        recall(self.cell, corrections(self._stock, since=resumes.history.at))
        self.journal.event(
            Resumed(
                last_at=resumes.history.at,
                changes=list(resumes.changes),
                version=scuhand_bt.__version__,
                operator=user_name(),
            )
        )

    @property
    def can_be_resumed(self) -> bool:
        """A rehearsal's twins end with its program."""
        return not isinstance(self._options.simulation, Rehearsal)

    @property
    def title(self) -> str:
        """What is run, on what, in a line."""
        simulation = self._options.simulation
        mode = f"{simulation.mode} (seed {simulation.seed})" if simulation is not None else "real devices"
        if simulation is not None and simulation.faults is not None:
            count = len(simulation.faults.rules)
            mode += f", {count} fault {'rule' if count == 1 else 'rules'}"
        again = "resumed, " if self._history is not None else ""
        count = len(self.plan.recipe.samples)
        return f"{self.plan.recipe.name}: {again}{count} samples on the cell '{self._lab.cell.cell}', {mode}"

    def run(self, observer: BatchObserver) -> BatchResult:
        """Run the batch to its end; whatever happens, the cell ends safe."""
        world = self.world
        batch = Batch(
            self.plan,
            self.cell,
            self._lab.library,
            self.journal,
            observer,
            self.control,
            world.true_mass if world is not None else None,
            self._history,
            first=resolve(self.cell, self._conflicts) if self._conflicts else None,
            after_job=self._after_job,
        )
        try:
            result = batch.run()
        finally:
            if world is not None:
                self.journal.event(Matter(**world.masses_mg))
                if world.faults.rules:
                    self.journal.event(FaultRules(rules=[RuleAccount(**rule) for rule in world.faults.account()]))
            if (problem := self._state.keep(self.cell, self.run_id)) is not None:
                self._trouble(problem)
            self._keep_inventory()
        self._notifier.tell(self._notice("ended" if result.is_complete else "stopped", result.reason, result))
        if result.is_complete:
            world_path(self.journal.path).unlink(missing_ok=True)
        return result

    @property
    def unused_rules(self) -> list[str]:
        """The rules of the fault file whose fault has never come, with their places."""
        simulation, world = self._options.simulation, self.world
        if simulation is None or simulation.faults is None or world is None:
            return []
        file = simulation.faults
        return [f"{file.marks[i]}: '{file.rules[i].fault}'" for i in world.faults.never_came]

    def _after_job(self) -> None:
        if not self.cell.simulated:
            self._keep_inventory()

    def _keep_inventory(self) -> None:
        if (problem := self._inventory.keep(self.cell, self.run_id)) is not None:
            self._trouble(problem)

    def _heard(self, event: Event | Note) -> None:
        """What goes into the journal, and a person who is not here should know."""
        if isinstance(event, Paused):
            self._notifier.tell(self._notice("paused"))
        elif isinstance(event, Asked) and not isinstance(self._options.simulation, DryRun):
            self._notifier.tell(self._notice("needs person", event.question))

    def _notice(self, state: NoticeState, reason: str = "", result: BatchResult | None = None) -> Notice:
        return Notice(
            self.run_id,
            self.plan.recipe.name,
            self.cell.simulated,
            state,
            reason,
            result.exit_code if result is not None else None,
            Counter(sample.verdict for sample in result.samples) if result is not None else {},
            self.journal.head,
        )

    def _trouble(self, what: str) -> None:
        self.notices.append(what)
        self.journal.event(Trouble(what=what))

    def close(self) -> None:
        """Close the devices, wait for what is being told of the run, and close the journal."""
        with ExitStack() as closing:
            closing.callback(self._presence.end)
            closing.callback(self._listener.end)
            closing.callback(self.journal.close)
            closing.callback(self._finish_telling)
            closing.callback(self._close_cell)

    def _finish_telling(self) -> None:
        for what in self._notifier.finish():
            self._trouble(what)


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


def _describe(plan: Plan, lab: Lab, options: Options, cell: Cell, run_id: str) -> RunBegun:
    simulation = options.simulation
    faults = simulation.faults if simulation is not None else None
    return RunBegun(
        run=run_id,
        recipe=plan.recipe.name,
        recipe_hash=plan.recipe.hash,
        recipe_text=plan.recipe.text,
        recipe_path=str(plan.recipe.path.absolute()),
        lab=str(lab.folder.absolute()),
        lab_files=lab_files(lab),
        cell=lab.cell.cell,
        simulated=simulation is not None,
        unattended=options.unattended,
        mode=simulation.mode if simulation is not None else "real devices",
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
        ),
        sources={
            name: SourceUsed(station=source.station, powder=source.powder.name, lot=source.lot)
            for name, source in plan.recipe.sources.items()
        },
        samples=[
            SamplePlanned(id=sample.id, workflow=sample.workflow, inputs=plain_values(sample.inputs))
            for sample in plan.recipe.samples
        ],
        operator=user_name(),
        devices={
            name: getattr(lab.cell, name).model_dump(mode="json", by_alias=False, exclude_none=True)
            for name in ("arm", "hand", "balance", "changer")
        },
        version=scuhand_bt.__version__,
        libraries={name: _version(name) for name in LIBRARIES},
        started=datetime.now().astimezone().isoformat(timespec="seconds"),
    )


def options_of(history: History, folder: Path, path: Path) -> Options:
    """The options that an interrupted run was begun with; SourceError for a rehearsal, whose twins ended with it."""
    run, given = history.run, history.run.options
    if run.mode == Rehearsal.mode:
        problem = "a rehearsal cannot be resumed: the twins ended with its program; start it anew"
        raise SourceError([Problem(Mark(str(path)), problem)])
    faults = parse_faults(run.faults_text, given.faults or "") if run.faults_text is not None else None
    simulation = DryRun(run.seed or 0, given.plant, given.speed, faults) if run.simulated else None
    return Options(simulation, given.controller, folder, run.unattended)


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"
