"""What a run came to, as typed records and as rows of a table."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from scuhand_bt.journal.results import DoseResult, SampleResult
from scuhand_bt.recipe.composition import Composition


@dataclass(frozen=True)
class DoseRecord:
    """One dose: a powder lot in a container; of a sample that was not dosed, its verdict alone."""

    sample: str
    container: str | None
    lot: str | None
    target_mg: float | None
    dispensed_mg: float | None
    error_mg: float | None
    uncertainty_mg: float | None
    tolerance_mg: float | None
    verdict: str
    sample_duration_s: float
    code: str | None
    """Of the sample's failure, if there was one."""
    detail: str | None
    true_mg: float | None
    """The simulation's, of all that the container holds, whichever lot; None on a real cell."""
    recorded: Mapping[str, bool | int | float | str]
    """What the workflow has recorded of the sample, by name, in mg, mm, s or degrees."""
    composition: Mapping[str, float | str | None]
    """Of a composed sample: by element the atoms reached per formula of the product, and their `u(ELEMENT)`; `verdict`.
    """


@dataclass(frozen=True)
class Result:
    """What a run came to."""

    run: str
    """Its id."""
    samples: tuple[SampleResult, ...]
    exit_code: int | None
    """As the command's: 0 every dose in tolerance, 1 with flagged doses, 3 a fault of the cell, 130 interrupted.

    None of a run that has not said how it ended: it goes on, or was killed.
    """
    reason: str
    """Why it ended early; empty where it did not."""
    duration_s: float
    """Time of the run."""
    notices: tuple[str, ...]
    """What went wrong beside the batch: a notification that failed, a callback that broke."""

    @property
    def doses(self) -> list[DoseRecord]:
        """All doses, in the order of the recipe."""
        return [record for sample in self.samples for record in _records(sample)]

    def rows(self) -> list[dict[str, Any]]:
        """The doses as dicts: `pandas.DataFrame(result.rows())`; recorded values stand there as `recorded.NAME`, and
        what a sample is composed of as `composition.ELEMENT`.
        """
        rows = [asdict(dose) for dose in self.doses]
        nested = ("recorded", "composition")
        return [row | {f"{of}.{key}": value for of in nested for key, value in row.pop(of).items()} for row in rows]


def _records(sample: SampleResult) -> list[DoseRecord]:
    """A record for each dose; of a sample without one, of the sample itself."""
    if not sample.doses:
        return [_record(sample, sample, None, sample.true_mg)]
    return [_record(sample, dose, dose.lot, dose.true_mg) for dose in sample.doses]


def _record(sample: SampleResult, of: SampleResult | DoseResult, lot: str | None, true_mg: float | None) -> DoseRecord:
    return DoseRecord(
        sample=sample.id,
        container=of.container,
        lot=lot,
        target_mg=of.target_mg,
        dispensed_mg=of.dispensed_mg,
        error_mg=of.error_mg,
        uncertainty_mg=of.uncertainty_mg,
        tolerance_mg=of.tolerance_mg,
        verdict=of.verdict,
        sample_duration_s=sample.duration_s,
        code=sample.code,
        detail=sample.detail,
        true_mg=true_mg,
        recorded={one.name: one.value for one in sample.recorded},
        composition=_composition(sample.composition) if sample.composition is not None else {},
    )


def _composition(composition: Composition) -> dict[str, float | str | None]:
    found: dict[str, float | str | None] = {}
    for one in composition.elements:
        found |= {one.element: one.reached, f"u({one.element})": one.uncertainty}
    return found | {"verdict": composition.verdict}
