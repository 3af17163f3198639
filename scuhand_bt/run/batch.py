"""The batch: a plan's jobs one after the other, what to do when one fails, and a verdict for every sample."""

import traceback
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal, Protocol

from py_trees.behaviour import Behaviour

from scuhand_bt.clock import Signal
from scuhand_bt.devices.cell import Cell, DoseSoFar
from scuhand_bt.plan import AFTER_FAILURE, Job, Plan
from scuhand_bt.run.journal import Journal
from scuhand_bt.run.runner import Outcome, Runner
from scuhand_bt.sample import Sample
from scuhand_bt.sim.plant import PlantError
from scuhand_bt.skill import SkillFailed
from scuhand_bt.specs import Container, Dose
from scuhand_bt.tree.check import Library
from scuhand_bt.tree.nodes import SkillBug

Verdict = Literal["in tolerance", "under", "over", "no dose", "skipped", "interrupted", "not run"]

EXIT_OK, EXIT_FLAGGED, EXIT_BAD_INPUT, EXIT_CELL_FAULT, EXIT_INTERRUPTED = 0, 1, 2, 3, 130


@dataclass(frozen=True)
class SampleResult:
    """One line of the table at the end; `true_mg` is the simulation's, for judging, and None on a real cell."""

    id: str
    container: str | None
    target_mg: float | None
    dispensed_mg: float | None
    error_mg: float | None
    uncertainty_mg: float | None
    tolerance_mg: float | None
    pulses: int
    scoops: int
    vibration_s: float
    duration_s: float
    controller: str | None
    verdict: Verdict
    code: str | None
    detail: str | None
    true_mg: float | None

    @property
    def is_good(self) -> bool:
        """A dose in tolerance, or a workflow that was to dose nothing; and no failure."""
        return self.code is None and self.verdict == ("no dose" if self.target_mg is None else "in tolerance")


@dataclass(frozen=True)
class BatchResult:
    """How a run ended."""

    samples: tuple[SampleResult, ...]
    exit_code: int
    reason: str
    duration_s: float


class BatchObserver(Protocol):
    """Is told how the batch goes on: the live view, or plain lines."""

    def ticked(self, root: Behaviour) -> None: ...

    def job_started(self, job: Job, number: int) -> None: ...

    def sample_ended(self, result: SampleResult) -> None: ...


class Batch:
    """Runs a plan on a cell. `true_mass_mg` judges a simulated dose by its container's id."""

    def __init__(
        self,
        plan: Plan,
        cell: Cell,
        library: Library,
        journal: Journal,
        observer: BatchObserver,
        stop: Signal,
        true_mass_mg: Callable[[str], float] | None = None,
    ) -> None:
        self._plan = plan
        self._cell = cell
        self._library = library
        self._journal = journal
        self._observer = observer
        self._true_mass_mg = true_mass_mg
        self._runner = Runner(cell, library, journal, stop, observer)
        self._results: dict[str, SampleResult] = {}

    def run(self) -> BatchResult:
        """Run every job; whatever happens, the cell ends safe and every sample has a verdict."""
        exit_code, reason = EXIT_CELL_FAULT, "broken"
        try:
            exit_code, reason = self._run_jobs()
        except (SkillBug, PlantError) as error:
            reason = str(error)
        except Exception as error:  # whatever it is, the cell ends safe and the journal says what it was
            reason = f"{type(error).__name__}: {error}"
            self._journal.event("broken", {"traceback": traceback.format_exc()})
        finally:
            if not self._is_safe():
                exit_code, reason = EXIT_CELL_FAULT, f"{reason}; a device did not stop".lstrip("; ")
            for job in self._plan.jobs:
                if job.sample is not None and job.sample.id not in self._results:
                    self._note(self._result(job.sample, None, "not run", None, 0.0, 1))
            self._journal.event("ended", {"exit_code": exit_code, "reason": reason})
        in_order = tuple(self._results[sample.id] for sample in self._plan.recipe.samples)
        if exit_code == EXIT_OK and any(not result.is_good for result in in_order):
            exit_code = EXIT_FLAGGED
        return BatchResult(in_order, exit_code, reason, self._cell.clock.now_s)

    def _is_safe(self) -> bool:
        try:
            return self._runner.make_safe()
        except Exception:  # a simulated world that breaks at every step cannot come to rest
            self._journal.event("broken", {"traceback": traceback.format_exc()})
            return False

    def _run_jobs(self) -> tuple[int, str]:
        for number, job in enumerate(self._plan.jobs):
            self._observer.job_started(job, number)
            if job.sample is None:
                stopped = self._run_service(job.name, job.workflow, job.inputs)
            else:
                stopped = self._run_sample(job, job.sample)
            if stopped is not None:
                return stopped
        return EXIT_OK, ""

    def _run_service(self, name: str, workflow: str, inputs: Mapping[str, Any]) -> tuple[int, str] | None:
        outcome = self._run_job(Job(name, workflow, inputs), inputs, None, 1)
        if outcome.halted:
            return EXIT_INTERRUPTED, "interrupted"
        if outcome.failure is not None:
            return EXIT_CELL_FAULT, f"{name}: {outcome.failure}"
        return None

    def _run_sample(self, job: Job, sample: Sample) -> tuple[int, str] | None:
        """Run a sample's job, again if the recipe says so; returns how the run ends, if it ends here."""
        attempt = 1
        while True:
            began_s = self._cell.clock.now_s
            outcome = self._run_job(job, _inputs_for(sample, attempt), sample.id, attempt)
            failure = outcome.failure
            action = "flag" if failure is None else self._plan.recipe.action_for(failure.code)
            if action == "redo" and attempt > 1:
                action = "flag"
            verdict: Verdict | None = "interrupted" if outcome.halted else None
            if action == "skip_sample":
                verdict = "skipped"
            self._note(self._result(sample, self._journal.last_dose, verdict, failure, began_s, attempt))
            if outcome.halted:
                return EXIT_INTERRUPTED, "interrupted"
            if failure is None:
                return None
            if action == "stop":
                return EXIT_CELL_FAULT, f"{sample.id}: {failure}"
            if (ended := self._recover(sample)) is not None:
                return ended
            if action != "redo":
                return None
            attempt += 1

    def _recover(self, sample: Sample) -> tuple[int, str] | None:
        if AFTER_FAILURE not in self._library.workflows or sample.source is None:
            return None
        return self._run_service(f"after {sample.id}", AFTER_FAILURE, {"source": sample.source})

    def _run_job(self, job: Job, inputs: Mapping[str, Any], sample_id: str | None, attempt: int) -> Outcome:
        journal = self._journal
        self._cell.begin_sample(sample_id or job.name, attempt)
        self._cell.believed.dosing = DoseSoFar(began_s=self._cell.clock.now_s)
        journal.job_started(job.name, sample_id, attempt, job.workflow)
        try:
            outcome = self._runner.run(job, inputs)
        except BaseException as error:
            journal.job_ended("broken", None, f"{type(error).__name__}: {error}")
            raise
        failure = outcome.failure
        if failure is not None:
            journal.job_ended("failed", failure.code, failure.detail)
        else:
            journal.job_ended("halted" if outcome.halted else "done")
        return outcome

    def _result(
        self,
        sample: Sample,
        dose: Dose | None,
        verdict: Verdict | None,
        failure: SkillFailed | None,
        began_s: float,
        attempt: int,
    ) -> SampleResult:
        container = _inputs_for(sample, attempt).get("container") if sample.container else None
        was_run = verdict != "not run"
        true_mg = None
        if self._true_mass_mg is not None and isinstance(container, Container) and was_run:
            true_mg = self._true_mass_mg(container.id)
        believed = self._cell.believed.dosing
        return SampleResult(
            id=sample.id,
            container=sample.container.name if sample.container else None,
            target_mg=dose.target_mg if dose else sample.mass_mg,
            dispensed_mg=dose.dispensed_mg if dose else None,
            error_mg=dose.error_mg if dose else None,
            uncertainty_mg=dose.uncertainty_mg if dose else None,
            tolerance_mg=dose.tolerance_mg if dose else sample.tolerance_mg,
            pulses=dose.pulses if dose else 0,
            scoops=believed.scoops if was_run else 0,
            vibration_s=dose.vibration_s if dose else 0.0,
            duration_s=self._cell.clock.now_s - began_s if was_run else 0.0,
            controller=dose.controller if dose else None,
            verdict=verdict or (dose.verdict if dose else "no dose"),
            code=failure.code if failure else None,
            detail=failure.detail if failure else None,
            true_mg=true_mg,
        )

    def _note(self, result: SampleResult) -> None:
        self._journal.event("sample", asdict(result))
        self._results[result.id] = result
        self._observer.sample_ended(result)


def _inputs_for(sample: Sample, attempt: int) -> dict[str, Any]:
    """The sample's inputs; a second attempt is for a new container."""
    inputs = dict(sample.inputs)
    if attempt > 1:
        for name, value in inputs.items():
            if isinstance(value, Container):
                inputs[name] = value.model_copy(update={"id": f"{value.id}.{attempt}"})
    return inputs
