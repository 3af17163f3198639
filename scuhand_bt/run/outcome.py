"""How a job, a sample, and a whole run came out."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

from scuhand_bt.cell.believed import ClosedBracket
from scuhand_bt.dosing.verdict import judge
from scuhand_bt.events import Dose
from scuhand_bt.failures import Code
from scuhand_bt.journal.events import DoseResult, SampleResult, SampleVerdict
from scuhand_bt.recipe.sample import Sample
from scuhand_bt.skill import SkillFailed
from scuhand_bt.specs import Container

Interruption = Literal["stopped", "paused", "tripped"]


@dataclass(frozen=True)
class Outcome:
    """How a job's tree ended: `failure` is None if it succeeded.

    `interrupted` says what halted the job before its end: a person's stop or pause, or a guard, whose reason
    `failure` then is.
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
    """The sample's inputs; a second attempt is for new containers, with ids that no sample can have."""
    inputs = dict(sample.inputs)
    if attempt > 1:
        for name, value in inputs.items():
            if isinstance(value, Container):
                inputs[name] = value.model_copy(update={"id": f"{value.id}#{attempt}"})
    return inputs


def sample_result(
    sample: Sample,
    doses: Sequence[Dose],
    verdict: SampleVerdict | None,
    failure: SkillFailed | None,
    *,
    scoops: int,
    duration_s: float,
    true_mg: float | None,
    attempt: int,
) -> SampleResult:
    """A sample's result from the doses of its job, in their order; `verdict` where there is another than theirs.

    The last dose of a lot into a container counts for both, as doses add up. What the recipe asks for, its mass
    within its tolerance, is held against the dose with that target.
    """
    last = {(dose.container, dose.lot): dose for dose in doses}
    found = [_dose_result(dose, sample) for dose in last.values()]
    asked = sample.mass_mg is None or any(_is_asked(dose, sample) for dose in last.values())
    told = [(dose, one) for dose, one in zip(found, last.values(), strict=True)]
    main, of_main = next((pair for pair in reversed(told) if _is_asked(pair[1], sample)), told[-1] if told else (None, None))
    return SampleResult(
        id=sample.id,
        container=sample.container.name if sample.container else None,
        target_mg=main.target_mg if main and asked else sample.mass_mg,
        dispensed_mg=main.dispensed_mg if main else None,
        error_mg=main.dispensed_mg - main.target_mg if main else None,
        uncertainty_mg=main.uncertainty_mg if main else None,
        tolerance_mg=main.tolerance_mg if main else sample.tolerance_mg,
        pulses=of_main.pulses if of_main else 0,
        scoops=scoops,
        vibration_s=of_main.vibration_s if of_main else 0.0,
        duration_s=duration_s,
        controller=of_main.controller if of_main else None,
        verdict=verdict or _verdict(found, asked=asked),
        code=failure.code if failure else None,
        detail=failure.detail if failure else None,
        true_mg=true_mg,
        attempt=attempt,
        doses=tuple(found),
    )
