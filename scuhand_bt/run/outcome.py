"""The results of a job, a sample and a whole run."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

from scuhand_bt.cell.pan_bracket import ClosedBracket
from scuhand_bt.dosing.bracket import unseen_mg
from scuhand_bt.dosing.verdict import judge
from scuhand_bt.events.doses import Dose
from scuhand_bt.failures import Code
from scuhand_bt.journal.results import DoseResult, SampleResult, SampleVerdict, SoFar
from scuhand_bt.recipe.sample import Ask, Sample
from scuhand_bt.recipe.stoichiometry import reached
from scuhand_bt.skill import SkillFailed
from scuhand_bt.specs import Container, Verdict

CLOSING_SHARE = 0.5
"""A bare pan that differs from what was dosed by more than this share of the tolerance confirms nothing, however
likely that is by chance."""

Interruption = Literal["stopped", "paused", "tripped"]


@dataclass(frozen=True)
class Outcome:
    """How a job's tree ended: `failure` is None if it succeeded.

    `interrupted` says what halted the job before its end: a person's stop or pause, or a guard. `failure` is then the
    guard's reason.
    """

    failure: SkillFailed | None = None
    interrupted: Interruption | None = None


@dataclass(frozen=True)
class BatchResult:
    """How a run ended."""

    samples: tuple[SampleResult, ...]
    exit_code: int
    reason: str
    duration_s: float
    is_complete: bool
    """Nothing is left that could be resumed."""


def inputs_for(sample: Sample, attempt: int) -> dict[str, Any]:
    """The sample's inputs. A second attempt has new containers, with ids that no sample can have."""

    def fresh(value: Any) -> Any:
        if isinstance(value, tuple):
            return tuple(map(fresh, value))
        return value.model_copy(update={"id": f"{value.id}#{attempt}"}) if isinstance(value, Container) else value

    return {name: fresh(value) if attempt > 1 else value for name, value in sample.inputs.items()}


def sample_result(
    sample: Sample,
    so_far: SoFar,
    verdict: SampleVerdict | None,
    failure: SkillFailed | None,
    *,
    scoops: int,
    duration_s: float,
    true_mg: Mapping[str, float],
    attempt: int,
) -> SampleResult:
    """A sample's result from what its job has reported; `verdict` overrides that of its doses.

    `true_mg` is what the simulation has in its containers, by their ids. The last dose of a lot into a container
    counts for both, as a dose includes the earlier ones. What the recipe asks for (a mass within a tolerance) is
    compared with the dose of that target into the sample's container.
    """
    sample = replace(sample, inputs=inputs_for(sample, attempt))
    last = list({(dose.container, dose.lot): dose for dose in so_far.doses}.values())
    cost = {dose.container: dose for dose in so_far.doses}.values()  # pulses of a dose include earlier ones there
    found = tuple(_dose_result(dose, sample, true_mg.get(dose.container)) for dose in last)
    asked = {number: ask for number, dose in enumerate(found) if (ask := _asked(dose, sample)) is not None}
    number = max(asked, default=len(found) - 1)
    main, of_main = (found[number], last[number]) if found else (None, None)
    missing = [ask for ask in sample.asks if ask not in asked.values()]
    target_mg = main.target_mg if main and (asked or not missing) else sample.asks[-1].mass_mg if sample.asks else None
    result = SampleResult(
        id=sample.id,
        container=sample.container.name if sample.container else None,
        target_mg=target_mg,
        dispensed_mg=main.dispensed_mg if main else None,
        error_mg=main.dispensed_mg - target_mg if main and target_mg is not None else None,
        uncertainty_mg=main.uncertainty_mg if main else None,
        tolerance_mg=main.tolerance_mg if main else sample.tolerance_mg,
        pulses=sum(dose.pulses for dose in cost),
        scoops=scoops,
        vibration_s=sum(dose.vibration_s for dose in cost),
        duration_s=duration_s,
        controller=of_main.controller if of_main else None,
        verdict=verdict
        or _verdict(found, [found[one] for one in asked], is_asked=not missing, has_recorded=bool(so_far.recorded)),
        code=failure.code if failure else None,
        detail=failure.detail if failure else None,
        true_mg=main.true_mg if main else next(iter(true_mg.values()), None),
        attempt=attempt,
        doses=found,
        recorded=tuple(so_far.recorded.values()),
    )
    if sample.composition is None or sample.container is None:
        return result
    composition = sample.composition.model_copy(update={"container": sample.container.id})
    return _reckoned(result.model_copy(update={"composition": composition}))


def confirmed(result: SampleResult, closed: ClosedBracket) -> SampleResult:
    """The result after one of its containers has left: adjusted to the bare pan, or flagged if that disagrees."""
    doses = tuple(confirmed_dose(dose, closed) if dose.container == closed.container else dose for dose in result.doses)
    changes: dict[str, Any] = {"doses": doses}
    told = {dose.lot for dose in doses if dose.container == closed.container}
    others = [f"{net.mass_mg:.1f} mg of {lot}" for lot, net in closed.doses.items() if lot not in told]
    main = _main(result, doses)
    if main is not None and result.target_mg is not None:
        changes |= {
            "dispensed_mg": main.dispensed_mg,
            "error_mg": main.dispensed_mg - result.target_mg,
            "uncertainty_mg": main.uncertainty_mg,
        }
    if result.verdict in get_args(Verdict):
        changes["verdict"] = _verdict(doses, doses, is_asked=True)
    is_open = any(dose.bracket == "does not close" for dose in doses)
    if is_open and result.code in (None, Code.BALANCE_BRACKET_OPEN):
        changes |= {"code": Code.BALANCE_BRACKET_OPEN, "detail": closed.detail}
    elif result.code == Code.BALANCE_BRACKET_OPEN and all(dose.bracket == "closed" for dose in doses):
        changes |= {"code": None, "detail": None}
    if others:
        what = f"'{closed.container}' holds {' and '.join(others)} from a dose that broke off"
        code, detail = (changes.get(name, getattr(result, name)) for name in ("code", "detail"))
        if code is None:
            changes |= {"code": Code.DOSE_NOT_REACHED, "detail": what}
        elif what not in str(detail):
            changes |= {"detail": f"{detail}; {what}"}
    return _reckoned(result.model_copy(update=changes))


def doubted(result: SampleResult, stepped_mg: float, drift_mg_per_s: float) -> SampleResult:
    """The result after the balance's zero was seen to step or drift in any dose of the run."""
    doses = tuple(_doubted(dose, unseen_mg(stepped_mg, drift_mg_per_s, dose.lasted_s)) for dose in result.doses)
    if doses == result.doses:
        return result
    changes: dict[str, Any] = {"doses": doses}
    if (main := _main(result, doses)) is not None:
        changes["uncertainty_mg"] = main.uncertainty_mg
    if result.verdict in get_args(Verdict):
        changes["verdict"] = _verdict(doses, doses, is_asked=True)
        if result.code is None and changes["verdict"] != result.verdict:
            seen = f"drift by {drift_mg_per_s:.3f} mg/s"
            if stepped_mg > 0.0:
                seen = f"step by {stepped_mg:.2f} mg (or its display held back that much)"
            detail = f"the balance's zero was seen to {seen} in this run, and may have done so in this dose, too"
            changes |= {"code": Code.BALANCE_BRACKET_OPEN, "detail": detail}
    return _reckoned(result.model_copy(update=changes))


def _reckoned(result: SampleResult) -> SampleResult:
    """The result with the composition that its doses make."""
    composition = result.composition
    if composition is None:
        return result
    doses = [dose for dose in result.doses if dose.container == composition.container]
    if any(dose.bracket == "does not close" for dose in doses):
        doses = []
    masses = {dose.lot: (dose.dispensed_mg, dose.uncertainty_mg) for dose in doses}
    came = reached(composition, masses, is_closed=all(dose.bracket == "closed" for dose in doses))
    return result.model_copy(update={"composition": came})


def _doubted(dose: DoseResult, zero_mg: float) -> DoseResult:
    if dose.bracket == "open" or zero_mg <= dose.zero_uncertainty_mg:
        return dose
    u_mg = math.sqrt(dose.uncertainty_mg**2 - dose.zero_uncertainty_mg**2 + zero_mg**2)
    verdict = judge(dose.target_mg, dose.tolerance_mg, dose.dispensed_mg, u_mg)
    return dose.model_copy(update={"uncertainty_mg": u_mg, "zero_uncertainty_mg": zero_mg, "verdict": verdict})


def _main(result: SampleResult, doses: Sequence[DoseResult]) -> DoseResult | None:
    """The dose that the result reports, as it is among `doses`."""
    return next((dose for dose, had in zip(doses, result.doses, strict=True) if _is_main(had, result)), None)


def _asked(dose: Dose | DoseResult, sample: Sample) -> Ask | None:
    """What the sample asks for that this dose was meant to fulfil, if anything."""
    return sample.ask_for(dose.target_mg, dose.lot) if sample.is_dosed_into(dose.container) else None


def _is_main(dose: DoseResult, result: SampleResult) -> bool:
    return (dose.dispensed_mg, dose.uncertainty_mg) == (result.dispensed_mg, result.uncertainty_mg)


def _dose_result(dose: Dose, sample: Sample, true_mg: float | None) -> DoseResult:
    tolerance_mg = dose.tolerance_mg
    if (ask := _asked(dose, sample)) is not None and ask.tolerance_mg is not None:
        tolerance_mg = min(tolerance_mg, ask.tolerance_mg)  # a workflow cannot widen the recipe's tolerance
    return DoseResult(
        container=dose.container,
        lot=dose.lot,
        target_mg=dose.target_mg,
        tolerance_mg=tolerance_mg,
        dispensed_mg=dose.dispensed_mg,
        uncertainty_mg=dose.uncertainty_mg,
        lasted_s=dose.lasted_s,
        verdict=judge(dose.target_mg, tolerance_mg, dose.dispensed_mg, dose.uncertainty_mg),
        bracket="open",
        true_mg=true_mg,
    )


def confirmed_dose(dose: DoseResult, closed: ClosedBracket) -> DoseResult:
    """A dose after its container has left the pan: adjusted to the bare pan, where the two agree.

    A container that has left more than once must agree each time. A departure before one of its lots came says
    nothing about that lot.
    """
    if dose.bracket == "does not close" or (closed.doses and dose.lot not in closed.doses):
        return dose
    if not closed.closes or abs(closed.difference_mg) > CLOSING_SHARE * dose.tolerance_mg:
        return dose.model_copy(update={"bracket": "does not close"})
    net = closed.doses[dose.lot]
    return dose.model_copy(
        update={
            "dispensed_mg": net.mass_mg,
            "uncertainty_mg": net.uncertainty_mg,
            "verdict": judge(dose.target_mg, dose.tolerance_mg, net.mass_mg, net.uncertainty_mg),
            "bracket": "closed",
        }
    )


def _verdict(
    doses: Sequence[DoseResult], asked: Sequence[DoseResult], *, is_asked: bool, has_recorded: bool = False
) -> SampleVerdict:
    """The worst of its doses; "not as asked" if something was dosed, but not what the sample asks for.

    "over" is worse than "under", to which powder can be added.
    """
    if not doses and has_recorded and is_asked:
        return "recorded"
    if not doses:
        return "no dose"
    verdicts = {dose.verdict for dose in (doses if is_asked else asked)}
    bad: tuple[Verdict, ...] = ("over", "under")
    return next((one for one in bad if one in verdicts), "in tolerance" if is_asked else "not as asked")
