"""The batch: runs a plan's jobs one after the other, handles failed samples, and gives every sample a verdict."""

import traceback
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

from scuhand_bt.cell.believed import slots_used
from scuhand_bt.cell.cell import Cell
from scuhand_bt.clock import Steps
from scuhand_bt.devices.liveness import Hung
from scuhand_bt.exit_codes import ExitCode
from scuhand_bt.failures import Code
from scuhand_bt.journal.events import JobEnded, JobStarted, PersonSoon
from scuhand_bt.journal.history import STOPPED, History, read_history
from scuhand_bt.journal.results import Chosen, SampleVerdict, SoFar
from scuhand_bt.journal.run_events import Broken, Ended
from scuhand_bt.journal.writer import Journal
from scuhand_bt.recipe.plan import AFTER_FAILURE, Job, Plan, recoveries, sheet_changes
from scuhand_bt.recipe.pour import each_of
from scuhand_bt.recipe.sample import Sample
from scuhand_bt.record import RecordLost
from scuhand_bt.run.control import Control
from scuhand_bt.run.guards import Guards
from scuhand_bt.run.observers import BatchObserver
from scuhand_bt.run.outcome import BatchResult, Outcome, inputs_for
from scuhand_bt.run.runner import Runner
from scuhand_bt.run.sample_results import SampleResults
from scuhand_bt.sim.plant import PlantError
from scuhand_bt.skill import SkillFailed
from scuhand_bt.specs import Container
from scuhand_bt.tree.leaf import Consent, SkillBug
from scuhand_bt.tree.library import Library
from scuhand_bt.tree.replay import Replay
from scuhand_bt.tree.substitutes import Substitutes

ANSWERS = ("flag", "redo", "skip_sample", "stop")
"""What a person may choose for a failed sample if the recipe says `ask`."""


class Batch:
    """Runs a plan on a cell, or resumes it from `history`. `true_mass_mg` gives the true mass of a simulated dose.

    `first` is settled with the operator before the first job. `after_job` is called when a job has ended and
    everything known of it is in the journal. `unattended`: nobody refills the changer on the way.
    """

    def __init__(
        self,
        plan: Plan,
        cell: Cell,
        library: Library,
        journal: Journal,
        observer: BatchObserver,
        control: Control,
        true_mass_mg: Callable[[str], float] | None = None,
        history: History | None = None,
        first: Steps[None] | None = None,
        after_job: Callable[[], None] = lambda: None,
        substitutes: Substitutes | None = None,
        consent: Consent | None = None,
        *,
        unattended: bool = False,
    ) -> None:
        self._plan = plan
        self._unattended = unattended
        self._cell = cell
        self._library = library
        self._journal = journal
        self._observer = observer
        self._control = control
        self._history = history or History()
        self._first = first
        self._after_job = after_job
        self._runner = Runner(cell, library, journal, control, Guards(cell), observer, substitutes, consent)
        self._results = SampleResults(plan, cell, journal, observer, true_mass_mg)
        self._under_way: tuple[Sample, int, float] | None = None
        """The sample whose job runs, its attempt, and when that began [s]."""
        self._called_at: Job | None = None
        """The last job at whose start a person was called for the next one."""

    def run(self) -> BatchResult:
        """Run every job. Whatever happens, the cell ends safe and every sample has a verdict."""
        ending = _ended(ExitCode.CELL_FAULT, "broken")
        try:
            ending = self._run_jobs()
        except (SkillBug, PlantError, RecordLost, SkillFailed, Hung) as error:
            ending = _ended(ExitCode.CELL_FAULT, str(error))
        except Exception as error:  # the cell must end safe, and the journal must have the reason
            ending = _ended(ExitCode.CELL_FAULT, f"{type(error).__name__}: {error}")
            self._journal.event(Broken(traceback=traceback.format_exc()))
        finally:
            if not self._is_safe():
                reason = f"{ending.reason}; a device did not stop".lstrip("; ")
                ending = _ended(ExitCode.CELL_FAULT, reason, complete=ending.is_complete)
            if self._under_way is not None:
                self._note_interrupted(*self._under_way, failure=None)
            for job in self._plan.jobs:
                if job.sample is not None and job.sample.id not in self._results.by_id:
                    self._note_unreached(job.name, job.sample)
            self._results.note_brackets()
            self._results.note_open_brackets()
            in_order = tuple(self._results.by_id[sample.id] for sample in self._plan.recipe.samples)
            code = ending.exit_code
            if code == ExitCode.OK and any(not result.is_good for result in in_order):
                code = ExitCode.FLAGGED
            ending = _ended(code, ending.reason, complete=ending.is_complete)
            if code == ExitCode.INTERRUPTED:
                by = self._control.stopped_by
                ending = ending.model_copy(update={"by": by.name, "signed": by.signed})
            ending = self._said(ending)
        return BatchResult(in_order, ending.exit_code, ending.reason, self._cell.clock.now_s, ending.is_complete)

    def _said(self, ending: Ended) -> Ended:
        """Write the run's end into its journal. If that fails, the run did not end well."""
        try:
            self._journal.event(ending)
            self._journal.settle()
            if ending.exit_code != ExitCode.CELL_FAULT and self._journal.lost is not None:
                raise self._journal.lost  # its first report was ignored, to make the cell safe
        except (RecordLost, Hung) as lost:
            ending = _ended(ExitCode.CELL_FAULT, f"how the run ended is not written: {lost}")
            with suppress(RecordLost):
                self._journal.event(ending)  # into the journal's rescue copy, if there is one
        return ending

    def _is_safe(self) -> bool:
        try:
            return self._runner.make_safe()
        except RecordLost:
            return self._runner.make_safe()
        except (Exception, Hung):  # such as a simulated world that raises at every step
            self._journal.event(Broken(traceback=traceback.format_exc()))
            return False

    def _run_jobs(self) -> Ended:
        if self._first is not None:
            self._runner.ask(self._first)
        for number, job in enumerate(self._plan.jobs):
            if self._control.is_stopping:
                return _ended(ExitCode.INTERRUPTED, "interrupted" if self._control.halts else "as was asked for")
            if job.sample is not None or not self._was_over(job.name, 1):
                self._observer.job_started(job, number)
            if job.sample is None:
                ending = self._run_service(job, 1)
            else:
                ending = self._run_sample(job, job.sample) or self._too_many_overshoots()
            if ending is not None:
                return ending
            if self._called_at is not job:
                self._cell.operator.dismiss()
        return _ended(ExitCode.OK, "", complete=True)

    def _was_over(self, name: str, attempt: int) -> bool:
        """Whether an attempt at a job had ended before the run was resumed."""
        before = self._history.jobs.get((name, attempt))
        return before is not None and before.is_over

    def _note_unreached(self, job: str, sample: Sample) -> None:
        """Give a sample that this process has not reached the result that an earlier one left."""
        begun = [attempt for name, attempt in self._history.jobs if name == job]
        attempt = begun[-1] if begun else 1
        if (known := self._history.samples.get((sample.id, attempt))) is not None:
            self._results.take(known)
        elif begun:
            before = self._history.jobs[job, attempt]
            self._results.note(
                self._results.result_of(sample, before.so_far, "interrupted", None, before.began_s, attempt)
            )
        else:
            self._results.note(self._results.result_of(sample, SoFar(), "not run", None, 0.0, 1))

    def _note_interrupted(self, sample: Sample, attempt: int, began_s: float, failure: SkillFailed | None) -> None:
        """Record what was done for a sample whose job has not ended."""
        so_far = self._journal.so_far
        self._results.note(self._results.result_of(sample, so_far, "interrupted", failure, began_s, attempt))

    def _run_service(self, job: Job, attempt: int) -> Ended | None:
        outcome = self._run_job(job, job.inputs, None, attempt)
        if outcome.failure is not None:
            return _ended(ExitCode.CELL_FAULT, f"{job.name}: {outcome.failure}")
        return _ended(ExitCode.INTERRUPTED, "interrupted") if outcome.interrupted else None

    def _run_sample(self, job: Job, sample: Sample) -> Ended | None:
        """Run a sample's job, and again if the recipe says so. Returns how the run ends, if it ends here."""
        if (barren := self._barren_source(sample)) is not None and (job.name, 1) not in self._history.jobs:
            what = f"'{barren}' has brought nothing before, so it was not tried again for this sample"
            self._results.note(
                self._results.result_of(sample, SoFar(), "not run", SkillFailed(Code.SCOOP_NOTHING, what), 0.0, 1)
            )
            return None
        attempt = 1
        while True:
            before = self._history.jobs.get((job.name, attempt))
            if (ended := self._change_sheet(sample, attempt, has_begun=before is not None)) is not None:
                return ended
            began_s = self._cell.clock.now_s if before is None else before.began_s
            self._under_way = sample, attempt, began_s
            outcome = self._run_job(job, inputs_for(sample, attempt), sample.id, attempt)
            self._under_way = None
            failure = outcome.failure
            if outcome.interrupted is not None:
                self._note_interrupted(sample, attempt, began_s, failure)
                if failure is not None:
                    return _ended(ExitCode.CELL_FAULT, f"{sample.id}: {failure}")
                return _ended(ExitCode.INTERRUPTED, "interrupted")
            action = "flag" if failure is None else self._action_for(sample, failure, attempt)
            if action == "redo" and attempt > 1:
                action = "flag"
            if failure is not None and action == "redo" and not self._may_redo(job, sample):
                action = "flag"
                no_more = "not done again: the changer has no container to spare, and nobody is there to fill it"
                failure = SkillFailed(failure.code, f"{failure.detail}; {no_more}")
            verdict: SampleVerdict | None = "skipped" if action == "skip_sample" else None
            recorded = self._history.samples.get((sample.id, attempt))
            if recorded is not None and self._was_over(job.name, attempt):
                self._results.take(recorded)
                self._observer.sample_known(recorded)
            else:
                self._results.note(
                    self._results.result_of(sample, self._journal.so_far, verdict, failure, began_s, attempt)
                )
            self._results.note_brackets()
            if failure is None:
                return None
            if action == "stop":
                return _ended(ExitCode.CELL_FAULT, f"{sample.id}: {failure}")
            if (ended := self._recover(sample, attempt)) is not None:
                return ended
            if action != "redo":
                return None
            attempt += 1

    def _may_redo(self, job: Job, sample: Sample) -> bool:
        """Whether the changer has containers for it beyond those of all later samples, or somebody can refill it."""
        if not self._unattended or (job.name, 2) in self._history.jobs:
            return True
        believed, changer = self._cell.believed, self._cell.spec.changer
        to_come = [one.sample for one in self._plan.jobs[self._plan.jobs.index(job) + 1 :] if one.sample is not None]
        containers = [container for one in (sample, *to_come) for container in one.all_containers]
        return changer.short_of(slots_used(believed, changer), [one.name for one in containers]) is None

    def _too_many_overshoots(self) -> Ended | None:
        """How the run ends if as many samples in a row have overshot as the recipe allows; None if it goes on.

        Samples of all powders count, as they share balance and valve. Samples that dosed nothing do not break the
        row. Those already reported to a person, before a resume, do not count again.
        """
        overshot: list[str] = []
        for result in reversed(self._results.by_id.values()):
            if result.id in self._history.looked_after or (result.doses and result.overshot_mg is None):
                break
            if result.overshot_mg is not None:
                overshot.insert(0, f"{result.id} by {result.overshot_mg:.1f} mg")
        if not 0 < self._plan.recipe.overshoot_limit <= len(overshot):
            return None
        by = ", ".join(overshot)
        return _ended(ExitCode.CELL_FAULT, f"{Code.DOSE_OVERSHOOTS}: samples overshot in a row: {by}")

    def _barren_source(self, sample: Sample) -> str | None:
        """The first of its sources that a scoop has found to give nothing."""
        barren = self._cell.believed.barren_sources
        return next((source.name for source in sample.sources if source.name in barren), None)

    def _action_for(self, sample: Sample, failure: SkillFailed, attempt: int) -> str:
        """What the recipe says, or the person whom it lets decide."""
        action = self._plan.recipe.action_for(failure.code)
        if action != "ask":
            return action
        answer = self._history.answers.get((sample.id, attempt))
        if answer is None:
            choices = [choice for choice in ANSWERS if choice != "redo" or attempt == 1]
            try:
                question = f"Sample '{sample.id}' failed: {failure}. What now?"
                answer = self._runner.ask(self._cell.operator.ask(question, choices)) or "stop"
            except SkillFailed as error:
                if error.code != Code.OPERATOR_ABSENT:
                    raise
                return "stop"
            if answer != "stop":  # after "stop", the question is asked again when the run is resumed
                self._journal.event(Chosen(sample=sample.id, attempt=attempt, action=answer))
            if answer == "redo":
                self._cell.believed.sources_mended()
        return answer

    def _recover(self, sample: Sample, attempt: int) -> Ended | None:
        if AFTER_FAILURE not in self._library.workflows or not sample.sources:
            return None
        jobs = recoveries(sample)
        begun = [job for job in jobs if (job.name, attempt) in self._history.jobs]
        of_cone = [job for job in jobs if job.inputs["source"].name == self._cell.believed.cone_source]
        return self._run_service([*begun, *of_cone, *jobs][0], attempt)

    def _change_sheet(self, sample: Sample, attempt: int, *, has_begun: bool) -> Ended | None:
        """Swap the sheet if a failed sample has left another lot on it than this sample begins with."""
        changes = sheet_changes(sample, self._plan.recipe, self._library, self._cell.spec)
        begun = [job for job in changes if (job.name, attempt) in self._history.jobs]
        sheet = None if has_begun else self._cell.believed.sheet
        due = [*begun, *(job for job in changes if job.inputs["source"].sheet_key == sheet)]
        return self._run_service(due[0], attempt) if due else None

    def _run_job(self, job: Job, inputs: Mapping[str, Any], sample_id: str | None, attempt: int) -> Outcome:
        """Run a job to its end, across pauses that halt it. What it did before the run was resumed is replayed."""
        journal, before = self._journal, self._history.jobs.get((job.name, attempt))
        if before is not None and before.is_over:
            journal.so_far = before.so_far
            return Outcome(before.failure)
        self._call_ahead(job)
        self._observer.attempt_started(job, attempt)
        self._cell.of_job = [value for _, value in each_of(inputs) if isinstance(value, Container)]
        if before is None:
            self._cell.begin_sample(sample_id or job.name, attempt)
            self._cell.believed.dose_began(self._cell.clock.now_s)
            journal.job_started(JobStarted(name=job.name, sample=sample_id, attempt=attempt, workflow=job.workflow))
            replay = Replay()
        else:
            journal.job_resumed(before.seq, before.so_far)
            replay = before.replay(self._history.state.get("joints_rad"))
        while True:
            try:
                outcome = self._runner.run(job, inputs, replay)
            except BaseException as error:
                journal.job_ended(JobEnded(outcome="broken", detail=f"{type(error).__name__}: {error}"))
                raise
            self._note_outcome(sample_id, attempt, outcome)
            if outcome.interrupted != "paused":
                return outcome
            self._runner.make_safe()
            if (fault := self._runner.hold()) is not None:
                return Outcome(fault, "tripped")
            if self._control.is_stopping:
                return Outcome(interrupted="stopped")
            self._runner.settle()
            history = read_history(journal.path)
            again = history.jobs[job.name, attempt]
            journal.job_resumed(again.seq, again.so_far)
            replay = again.replay(history.state.get("joints_rad"))

    def _call_ahead(self, job: Job) -> None:
        """Call the person whom the next job needs, once for all attempts at this one."""
        if self._called_at is not job and (person := self._plan.soon(job)) is not None:
            self._called_at = job
            soon = PersonSoon(job=person.job or "", what=person.what)
            self._journal.event(soon)
            self._observer.person_called(soon)
            self._cell.operator.expect()

    def _note_outcome(self, sample_id: str | None, attempt: int, outcome: Outcome) -> None:
        failure = outcome.failure
        if outcome.interrupted is not None:
            word = "interrupted"
        elif failure is None:
            word = "done"
        else:
            stops = sample_id is None or self._plan.recipe.action_for(failure.code) == "stop"
            word = STOPPED if stops else "failed"
        code, detail = (failure.code, failure.detail) if failure is not None else (None, None)
        self._journal.job_ended(JobEnded(outcome=word, code=code, detail=detail))
        self._results.note_brackets(None if sample_id is None else (sample_id, attempt))
        self._after_job()


def _ended(exit_code: int, reason: str, *, complete: bool = False) -> Ended:
    """The entry for a run's end."""
    return Ended(exit_code=exit_code, reason=reason, complete=complete)
