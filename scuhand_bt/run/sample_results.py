"""The results of a batch's samples: as each has ended, and as the bare pan tells later."""

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
    """The last result of each sample, by its id. `true_mass_mg` judges a simulated dose."""

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
        """The samples whose results have come or changed since all were doubted last."""
        self._doubted_of = (0.0, 0.0)
        """How large a step, and how fast a drift, of the balance's zero they were doubted of then."""
        self._owners = {
            container.id: sample.id for sample in plan.recipe.samples for container in sample.all_containers
        }
        """The samples of all containers, by the ids that these have in a first attempt."""

    def result_of(
        self,
        sample: Sample,
        so_far: SoFar,
        verdict: SampleVerdict | None,
        failure: SkillFailed | None,
        began_s: float,
        attempt: int,
    ) -> SampleResult:
        """What an attempt at a sample has come to, by what the journal has of it so far."""
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
        """Say of each sample whose container has gone what it came to by the bare pan, and of all what that tells.

        One that has gone within the attempt at its own sample that is `waiting` for its result still waits too. What
        was dosed into a container by another job than its sample's is no sample's dose.
        """
        believed = self._cell.believed
        on_pan = believed.bracket.container if believed.bracket is not None else None
        noted: dict[str, SampleResult] = {}
        for closed in believed.closed:
            name, _, number = closed.container.partition("#")
            owner, attempt = self._owners.get(name), int(number or 1)
            result = self.by_id.get(owner) if owner is not None else None
            if closed.closes and closed.container == on_pan:
                believed.noted(closed)  # it has come again, and what it holds is told when it goes
                continue
            if owner is not None and ((owner, attempt) == waiting or result is None):
                continue
            if result is not None and result.attempt == attempt and _tells_of(closed, result):
                noted.setdefault(result.id, result)
                self.by_id[result.id] = confirmed(result, closed)
            believed.noted(closed)
        seen = believed.zero_stepped_mg, believed.drift_mg_per_s
        # Not all each time: a run of many samples comes here after each.
        fresh = (*noted, *self._undoubted) if seen == self._doubted_of else self.by_id
        for name in dict.fromkeys(fresh):
            before = self.by_id[name]
            now = doubted(before, *seen)
            if now is not noted.get(name, before):
                self.note(now)
        self._undoubted, self._doubted_of = [], seen

    def note_open_brackets(self) -> None:
        """Flag every dose whose container was not seen to go."""
        for result in list(self.by_id.values()):
            if result.code is None and any(dose.bracket == "open" for dose in result.doses):
                what = (
                    "after the dose its container was not taken off, and the bare pan not weighed (`remove_container`)"
                )
                self.note(result.model_copy(update={"code": Code.BALANCE_BRACKET_OPEN, "detail": what}))

    def note(self, result: SampleResult) -> None:
        """A sample has this result from now on: it is written, and told."""
        self._journal.event(result)
        self.take(result)
        self._observer.sample_ended(result)

    def take(self, result: SampleResult) -> None:
        """A sample has this result from now on, which is in the journal already."""
        self.by_id[result.id] = result
        self._undoubted.append(result.id)


def _broke_off(failure: SkillFailed | None, seen_mg: float) -> SkillFailed:
    """The failure of a sample of which a dose broke off: no row tells what that has brought, and it is not good."""
    seen = f"; by the balance's last reading it had brought {seen_mg:.0f} mg" if seen_mg > 0.0 else ""
    what = f"a dose broke off, and was not weighed{seen}"
    if failure is None:
        return SkillFailed(Code.DOSE_NOT_REACHED, what)
    return SkillFailed(failure.code, f"{failure.detail}; {what}")


def _tells_of(closed: ClosedBracket, result: SampleResult) -> bool:
    """Whether something came into the container, whether a dose of its sample tells of it or not.

    Of one that was thrown away only what its sample still tells of counts.
    """
    return bool(closed.doses and not closed.is_discarded) or any(
        dose.container == closed.container for dose in result.doses
    )
