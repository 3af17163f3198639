"""One run from plan to result: the cell, its journal, and the batch that joins them."""

import secrets
import shutil
import sqlite3
import threading
from contextlib import ExitStack, suppress
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import scuhand_bt
from scuhand_bt import dosing
from scuhand_bt.clock import Steps
from scuhand_bt.devices.interfaces import Reading, is_twin
from scuhand_bt.exit_codes import ExitCode
from scuhand_bt.journal.follow import Follower
from scuhand_bt.journal.run_events import Broken, Ended, FaultRules, Matter, Resumed, RuleAccount, Trouble
from scuhand_bt.journal.writer import Journal
from scuhand_bt.lab import Lab, state_folder
from scuhand_bt.lab_state.lab_db import user_name
from scuhand_bt.lab_state.ledger import Occasion
from scuhand_bt.motion import MotionPlanner
from scuhand_bt.problems import Mark, Problem, SourceError
from scuhand_bt.quantity import counted, format_mass
from scuhand_bt.recipe.plan import Plan, check_unattended
from scuhand_bt.record import RecordLost
from scuhand_bt.run.balance_limits import below_usp, beyond_limits
from scuhand_bt.run.batch import Batch
from scuhand_bt.run.cell_state import MotionRecord, state_of, take_up
from scuhand_bt.run.clock import VirtualClock
from scuhand_bt.run.control import Control, WishListener
from scuhand_bt.run.holds import BEING_RUN, take_cell, take_run
from scuhand_bt.run.inventory_conflicts import (
    about_rim,
    about_vessels,
    conflicts,
    corrections,
    recall,
    require_resolvable,
    resolve,
)
from scuhand_bt.run.lab_records import LabRecords
from scuhand_bt.run.make_cell import set_up
from scuhand_bt.run.observers import BatchObserver
from scuhand_bt.run.operator import Person
from scuhand_bt.run.options import ON_TWINS, Options, check_controller, described
from scuhand_bt.run.outage import settle_arm, settle_outage, settle_roller
from scuhand_bt.run.outcome import BatchResult
from scuhand_bt.run.questions import Who
from scuhand_bt.run.resume import Resumable, world_path
from scuhand_bt.run.simulation import DryRun, Rehearsal
from scuhand_bt.run.single_step import SingleStep
from scuhand_bt.run.twins import folder_of_run
from scuhand_bt.skill import SkillFailed
from scuhand_bt.tree.substitutes import Substitutes

TOLD_SPILLED_MG = 1.0
"""Least powder beside mortars, pan and waste that is reported, if a simulation knows it [mg]."""


class Session:
    """A cell made ready for a plan, new or resumed. Call `run` once, then `close`, from any thread.

    `motion` is a planner that `prepared_motion` made for the same places, if dry runs share one. `resumes` is the
    interrupted run (found and checked by `run/resume.py`). `substitutes` stand in for skills, in a test.

    Raises, before anything moves: SourceError for an unknown controller, an unwritable folder, an unattended plan that
    needs a person, a real balance beyond its limits or a run that another process has; PlantError for a plant that
    cannot be used; NoCompiler for a rehearsal without one; SkillFailed for places without a way between them, or a
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
        substitutes: Substitutes | None = None,
    ) -> None:
        check_controller(options.controller)
        if options.unattended:
            check_unattended(plan)
        self.plan = plan
        self.warnings: list[str] = []
        """What a real run asks of its balance beyond what that is known to give, if it runs all the same."""
        self.control = control or Control()
        """Pauses, continues and stops the run safely, as Ctrl-C does."""
        lab = replace(lab, cell=lab.cell.slowed(options.slow_ratio))
        self._lab, self._options, self._has_run = lab, options, threading.Lock()
        self._substitutes, self._shares_motion = substitutes, motion is not None
        self._history = resumes.history if resumes is not None else None
        self._account: list[RuleAccount] = []
        if resumes is None:
            name = f"{datetime.now():%Y%m%d-%H%M%S}-{plan.recipe.name}-{secrets.token_hex(2)}"
            path = (options.folder or state_folder(lab) / "runs") / f"{name}.sqlite"
        else:
            path = resumes.path
        self.run_id = path.stem
        is_kept, simulation = options.is_kept, options.simulation
        self._records = LabRecords(path.parent.parent, lab, self.run_id, plan.recipe.name, simulation, is_kept=is_kept)
        self.notices = self._records.notices
        self._person = options.person or Person(user_name())
        self.control.at_terminal = Who(self._person.name)
        stock = self._records.stock
        self._conflicts = [*about_vessels(plan, stock)] if self._is_taken_up else conflicts(plan, lab.cell, stock)
        require_resolvable(self._conflicts, unattended=options.unattended)
        dosing.prepare()
        with ExitStack() as opened:
            self._holds = opened.enter_context(ExitStack())
            presence = resumes.presence if resumes is not None else None
            if is_kept:
                self._holds.callback((presence or take_run(path)).end)
            if simulation is None:
                self._holds.callback(take_cell(path.parent.parent).end)
            durable = not isinstance(simulation, DryRun)
            self.journal = _open_journal(path, is_new=resumes is None, durable=durable, is_kept=is_kept)
            opened.callback(self.journal.discard if resumes is None else self.journal.close)
            if self._history is not None and self.journal.head != self._history.head:
                problem = "another process has gone on with it meanwhile; resume it again to see its present state"
                raise SourceError([Problem(Mark(str(path)), problem)])
            self._make_cell(motion, opened)
            if not self.cell.simulated:
                self.cell.simulated = self._are_twins()
                self._require_same_matter(path)
            if not self.cell.simulated:
                self._meet_balance()
                recall(self.cell, self._records.stock)
            try:
                if (odd := self._records.odd_clock(None if resumes is None else resumes.history.at)) is not None:
                    self.warnings.append(odd)
                self._begin(resumes)
                self.journal.settle()  # before the ledger has it
                occasion: Occasion = "begun" if resumes is None else "resumed"
                if (untold := self._records.anchor(occasion, *self.journal.last)) is not None:
                    if not self.cell.simulated:
                        raise SourceError([Problem(Mark(str(path)), untold)])
                    self.warnings.append(untold)
                for warning in self.warnings:
                    self.journal.event(Trouble(what=warning))
            except RecordLost as lost:
                raise SourceError([Problem(Mark(str(path)), f"{lost}; nothing was moved")]) from None
            opened.pop_all()

    def _make_cell(self, motion: MotionPlanner | None, opened: ExitStack) -> None:
        journal, options, history = self.journal, self._options, self._history
        if options.is_kept:
            listener = _listen(journal.path, self.control)
            self._holds.callback(listener.end)
        if history is None and isinstance(options.simulation, Rehearsal):  # a run that never began leaves nothing
            opened.callback(shutil.rmtree, folder_of_run(journal.path), ignore_errors=True)
        setup = set_up(
            self.plan,
            self._lab,
            options.simulation,
            journal,
            motion,
            unattended=options.unattended,
            person=self._person,
            questions=self.control.questions,
            terminal=self.control.terminal,
            world_path=world_path(journal.path) if options.is_kept else None,
            resumed_at_s=None if history is None else history.time_s,
            may_torque=options.may_torque,
        )
        self.cell, self.world, self.truth = setup.cell, setup.world, setup.truth
        self._close_cell, self.liveness = setup.close, setup.liveness
        opened.callback(self._close_cell)
        if options.controller is not None:
            self.cell.controller = options.controller
        self.cell.balance.on_reading = self._weighed
        self.control.balance = lambda: self.cell.balance.latest
        if options.is_kept:
            MotionRecord(self.cell, self.journal.event)
        journal.now_s = lambda: self.cell.clock.now_s
        journal.state = lambda: state_of(self.cell)
        self._records.begin(journal, self.cell)
        journal.is_beside = not isinstance(self.cell.clock, VirtualClock)
        if isinstance(self.cell.clock, VirtualClock):
            journal.gathers, self.cell.clock.before_wait = True, journal.commit
            self.cell.clock.hurries = lambda: self.control.halts

    def _are_twins(self) -> bool:
        """Whether a device says that it is a twin. A balance identifies itself by its first reading.

        Then no matter is real: nothing is learnt from this run, and the inventory is not used.
        """
        with suppress(SkillFailed):  # a silent balance fails the run later
            for wake in self.cell.balance.next_reading():
                self.cell.clock.wait([wake])
        return any(is_twin(getattr(device, "identity", "")) for device in self.cell.every_device.values())

    def _require_same_matter(self, path: Path) -> None:
        """Raises SourceError if a run begun on real devices is resumed on twins, or the other way round."""
        begun = self._history.run if self._history is not None else None
        if begun is not None and begun.seed is None and begun.simulated != self.cell.simulated:
            there, here = ("twins", "real devices") if begun.simulated else ("real devices", "twins")
            problem = f"it was begun on {there}, and {here} are at the ports of robot/cell.yaml now"
            raise SourceError([Problem(Mark(str(path)), problem)])

    def _meet_balance(self) -> None:
        """Compare the plan with the balance. Raises SourceError if a new run asks too much of it."""
        figures = self._records.learnt.figures(simulated=False).get(self.cell.balance_name, {})
        beyond = beyond_limits(self.plan, self._lab, figures, datetime.now().astimezone())
        if beyond and self._history is None and self._lab.cell.balance.limits.when_beyond == "refuse":
            raise SourceError(beyond)
        self.warnings = [str(problem) for problem in [*beyond, *below_usp(self.plan, self._lab, figures)]]

    def _weighed(self, reading: Reading) -> None:
        self.cell.readings.append(reading)
        self.journal.weighed(reading)

    def _begin(self, resumes: Resumable | None) -> None:
        """Write the first entry of a new or resumed run."""
        if resumes is not None:
            take_up(self.cell, resumes.history.state)
            self.cell.believed.sources_mended()
        if not self.cell.simulated:  # what a person has had forgotten since the interruption stays forgotten
            broke_off = resumes.history.at if resumes is not None else ""
            self._records.learnt.recall(self.cell, datetime.now().astimezone(), broke_off)
            for name in self._records.learnt.unreadable():
                self.warnings.append(
                    f"what another version has learnt of '{name}' cannot be read: it will be learnt again"
                )
        if not self._options.is_kept:
            return
        if resumes is None:
            begun = described(self.plan, self._lab, self._options, self.cell, self.run_id, self._person)
            with suppress(SourceError):  # an unreadable ledger is reported when its first line is written
                begun = begun.model_copy(update={"ledger": self._records.ledger.last()[0]})
            self.journal.event(begun)
            return
        recall(self.cell, corrections(self._records.stock, since=resumes.history.at))
        self.journal.event(
            Resumed(
                last_at=resumes.history.at,
                changes=list(resumes.changes),
                version=scuhand_bt.__version__,
                operator=self._person.name,
                signed=self._person.is_pin is not None,
            )
        )

    @property
    def mode(self) -> str:
        """ "REAL DEVICES", or how it is simulated."""
        simulation = self._options.simulation
        on_cell = ON_TWINS if self.cell.simulated else "REAL DEVICES"
        return simulation.mode if simulation is not None else on_cell

    @property
    def title(self) -> str:
        """What is run, and on what, in one line."""
        simulation = self._options.simulation
        on_cell = ON_TWINS if self.cell.simulated else "real devices"
        mode = f"{simulation.mode} (seed {simulation.seed})" if simulation is not None else on_cell
        if simulation is not None and simulation.faults is not None:
            mode += f", {counted(len(simulation.faults.rules), 'fault rule')}"
        if self._options.slow_ratio < 1.0:
            mode += f", at {self._options.slow_ratio:.0%} of its speed"
        if self._options.single_step:
            mode += ", in single step"
        again = "resumed, " if self._history is not None else ""
        count = counted(len(self.plan.recipe.samples), "sample")
        return f"{self.plan.recipe.name}: {again}{count} on the cell '{self._lab.cell.cell}', {mode}"

    def run(self, observer: BatchObserver) -> BatchResult:
        """Run the batch to its end; whatever happens, the cell ends safe. Raises RuntimeError the second time."""
        if not self._has_run.acquire(blocking=False):
            raise RuntimeError("a session is run once: make another one")
        truth = self.truth
        batch = Batch(
            self.plan,
            self.cell,
            self._lab.library,
            self.journal,
            observer,
            self.control,
            truth.true_mass if truth is not None else None,
            self._history,
            first=self._settle(),
            after_job=self._records.after_job,
            substitutes=self._substitutes,
            consent=SingleStep(self.cell, self.control) if self._options.single_step else None,
            unattended=self._options.unattended,
        )
        try:
            result = batch.run()
        finally:
            try:
                if truth is not None and (masses_mg := truth.masses_mg):
                    self.journal.event(Matter(**masses_mg))
                    if (spilled_mg := masses_mg.get("spilled", 0.0)) >= TOLD_SPILLED_MG:
                        spilled = f"In the simulation {format_mass(spilled_mg)} of powder were spilled"
                        self.notices.append(f"{spilled}: `scuhand-bt show` has what was done meanwhile")
                if truth is not None and (account := truth.fault_account):
                    self._account = [RuleAccount(**rule) for rule in account]
                    self.journal.event(FaultRules(rules=self._account))
                self._records.batch_ended()
                self.journal.settle()  # while the world can still be saved with it
            except RecordLost as lost:  # the run's end is already written
                self.notices.append(str(lost))
        self._records.came_to(result)
        if result.is_complete:
            world_path(self.journal.path).unlink(missing_ok=True)
        return result

    def before(self) -> Follower | None:
        """What a resumed run had done before; None for a new one."""
        if self._history is None:
            return None
        now = Follower(self.journal.path)
        now.look()
        return now

    @property
    def _is_taken_up(self) -> bool:
        return self._history is not None and bool(self._history.state)

    def _settle(self) -> Steps[None]:
        """What must be known of the cell before its first job."""
        if not self.cell.hand.knows_its_roller:
            yield from settle_roller(self.cell)
        yield from resolve(self.cell, self._conflicts)
        if not self.cell.simulated:
            yield from resolve(self.cell, about_rim(self.cell, self._records.stock))
        if self._is_taken_up:
            yield from settle_outage(self.journal, self.cell)
        else:
            yield from settle_arm(self.cell)

    @property
    def unused_rules(self) -> list[str]:
        """The rules of the fault file whose fault has never occurred, with their places."""
        file = self._options.simulation.faults if self._options.simulation is not None else None
        if file is None:
            return []
        account = zip(file.marks, self._account, strict=False)  # empty if the twins have ended
        return [f"{mark}: '{rule.fault}'" for mark, rule in account if not rule.came_s]

    def write_off(self, reason: str, traceback: str) -> None:
        """Close the journal of a run that hangs, from another thread; the program ends right after."""
        self.journal.event(Broken(traceback=traceback))
        self.journal.event(Ended(exit_code=ExitCode.CELL_FAULT, reason=reason, complete=False))
        self.journal.close()

    def close(self) -> None:
        """Close the devices, wait for notifications under way, and close the journal."""
        with ExitStack() as closing:
            closing.callback(self._holds.close)
            closing.callback(self._records.anchor_end)
            closing.callback(self.journal.close)
            closing.callback(self._records.finish_telling)
            if not self._shares_motion:  # frees its memory even if the session is kept, or waits for the collector
                closing.callback(self.cell.motion.let_go)
            closing.callback(self.cell.motion.keep_plans)
            closing.callback(self._close_cell)


def _listen(journal: Path, control: Control) -> WishListener:
    try:
        return WishListener(journal, control)
    except OSError:  # its lock was deleted
        raise SourceError([Problem(Mark(str(journal)), BEING_RUN.format(journal.stem))]) from None


def _open_journal(path: Path, *, is_new: bool, durable: bool, is_kept: bool) -> Journal:
    try:
        if is_new and is_kept:  # if two runs of the same second draw the same id, the second one ends here
            path.parent.mkdir(parents=True, exist_ok=True)
            path.touch(exist_ok=False)
        return Journal(path, durable=durable, is_kept=is_kept)
    except (OSError, sqlite3.Error) as error:
        problem = Problem(Mark(str(path)), f"the journal cannot be written: {error}; nothing was moved")
        raise SourceError([problem]) from None
