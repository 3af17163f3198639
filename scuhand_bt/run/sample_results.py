"""The results of a batch's samples: first as each ends, later corrected by the bare pan."""

from collections.abc import Callable
from dataclasses import replace

from scuhand_bt.cell.cell import Cell
from scuhand_bt.cell.pan_bracket import ClosedBracket
from scuhand_bt.failures import Code
from scuhand_bt.journal.results import SampleResult, SampleVerdict, SoFar
from scuhand_bt.journal.writer import Journal
from scuhand_bt.recipe.plan import Plan
from scuhand_bt.recipe.sample import Sample
from scuhand_bt.run.observers import BatchObserver
from scuhand_bt.run.outcome import confirmed, doubted, inputs_for, sample_result
from scuhand_bt.skill import SkillFailed


class SampleResults:
    """The latest result of each sample, by its id. `true_mass_mg` gives the true mass of a simulated dose."""

    def __init__(
        self,
        plan: Plan,
        cell: Cell,
        journal: Journal,
        observer: BatchObserver,
        true_mass_mg: Callable[[str], float] | None,
    ) -> None:
        self.by_id: dict[str, SampleResult] = {}
        self._cell = cell
        self._journal = journal
        self._observer = observer
        self._true_mass_mg = true_mass_mg
        self._undoubted: list[str] = []
        """The samples whose results are new or changed since the last time that all were doubted."""
        self._doubted_of = (0.0, 0.0)
        """The step [mg] and drift [mg/s] of the balance's zero that were used then."""
        self._owners = {
            container.id: sample.id for sample in plan.recipe.samples for container in sample.all_containers
        }
        """The sample of each container, by the id that this has in a first attempt."""

    def result_of(
        self,
        sample: Sample,
        so_far: SoFar,
        verdict: SampleVerdict | None,
        failure: SkillFailed | None,
        began_s: float,
        attempt: int,
    ) -> SampleResult:
        """The result of an attempt at a sample, by what the journal has of it so far."""
        containers = replace(sample, inputs=inputs_for(sample, attempt)).all_containers
        was_run = verdict != "not run"
        true_mg = {}
        if self._true_mass_mg is not None and was_run:
            true_mg = {container.id: self._true_mass_mg(container.id) for container in containers}
        believed = self._cell.believed
        if believed.dosing.is_unweighed and was_run and verdict != "interrupted":
            failure = _broke_off(failure, believed.seen_mg)
        return sample_result(
            sample,
            so_far,
            verdict,
            failure,
            scoops=believed.dosing.scoops if was_run else 0,
            duration_s=self._cell.clock.now_s - began_s if was_run else 0.0,
            true_mg=true_mg,
            attempt=attempt,
        )

    def note_brackets(self, waiting: tuple[str, int] | None = None) -> None:
        """Correct results by bare pans: of samples whose containers have left, and of all by what the zero has shown.

        A container that left within the attempt that is `waiting` for its result has to wait too. What another job
        than its sample's dosed into a container is no sample's dose.
        """
        believed = self._cell.believed
        on_pan = believed.bracket.container if believed.bracket is not None else None
        noted: dict[str, SampleResult] = {}
        for closed in believed.closed:
            name, _, number = closed.container.partition("#")
            owner, attempt = self._owners.get(name), int(number or 1)
            result = self.by_id.get(owner) if owner is not None else None
            if closed.closes and closed.container == on_pan:
                believed.noted(closed)  # it has come again, and is judged when it leaves
                continue
            if owner is not None and ((owner, attempt) == waiting or result is None):
                continue
            if result is not None and result.attempt == attempt and _tells_of(closed, result):
                noted.setdefault(result.id, result)
                self.by_id[result.id] = confirmed(result, closed)
            believed.noted(closed)
        seen = believed.zero_stepped_mg, believed.drift_mg_per_s
        # Not all every time, as this runs after each of many samples.
        fresh = (*noted, *self._undoubted) if seen == self._doubted_of else self.by_id
        for name in dict.fromkeys(fresh):
            before = self.by_id[name]
            now = doubted(before, *seen)
            if now is not noted.get(name, before):
                self.note(now)
        self._undoubted, self._doubted_of = [], seen

    def note_open_brackets(self) -> None:
        """Flag every dose whose container was not seen to leave the pan."""
        for result in list(self.by_id.values()):
            if result.code is None and any(dose.bracket == "open" for dose in result.doses):
                what = (
                    "the container was not taken off after the dose, so the bare pan was not weighed: call "
                    "`remove_container`"
                )
                self.note(result.model_copy(update={"code": Code.BALANCE_BRACKET_OPEN, "detail": what}))

    def note(self, result: SampleResult) -> None:
        """Set a sample's result: write it, and tell the observer."""
        self._journal.event(result)
        self.take(result)
        self._observer.sample_ended(result)

    def take(self, result: SampleResult) -> None:
        """Set a sample's result that is already in the journal."""
        self.by_id[result.id] = result
        self._undoubted.append(result.id)


def _broke_off(failure: SkillFailed | None, seen_mg: float) -> SkillFailed:
    """The failure of a sample with a dose that broke off unweighed: it has no row in the results, and is not good."""
    seen = f"; at the balance's last reading it had brought {seen_mg:.0f} mg" if seen_mg > 0.0 else ""
    what = f"a dose broke off, and was not weighed{seen}"
    if failure is None:
        return SkillFailed(Code.DOSE_NOT_REACHED, what)
    return SkillFailed(failure.code, f"{failure.detail}; {what}")


def _tells_of(closed: ClosedBracket, result: SampleResult) -> bool:
    """Whether something came into the container, even if no dose of its sample says so.

    For a discarded container, only its sample's doses count.
    """
    return bool(closed.doses and not closed.is_discarded) or any(
        dose.container == closed.container for dose in result.doses
    )
