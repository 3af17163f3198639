"""The course of each dose, as its run's journal has it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from scuhand_bt.events import Dose, DoseCurve
from scuhand_bt.journal.reader import Contents

Point = Sequence[float]
"""(time_s, net_mg, opening_mm, vibration, stable, estimate_mg): one row of a `dose_curve` event."""


@dataclass(frozen=True)
class CurveOfDose:
    """A dose and its course."""

    sample: str
    attempt: int
    dose: Dose
    points: Sequence[Point]
    """Empty where the run ended before it was written."""


def dose_curves(contents: Contents) -> Iterator[CurveOfDose]:
    """Every dose of a run's samples, in order. A dose and its course are of the same action."""
    jobs = {row["id"]: row for row in contents.rows("job")}
    doses = [row for row in contents.rows("entry") if row["kind"] in (Dose.KIND, DoseCurve.KIND)]
    points = {
        row["action"]: DoseCurve.model_validate(row["payload"]).points for row in doses if row["kind"] == DoseCurve.KIND
    }
    for row in doses:
        job = jobs.get(row["job"])
        if row["kind"] == Dose.KIND and job is not None and job["sample"] is not None:
            dose = Dose.model_validate(row["payload"])
            yield CurveOfDose(job["sample"], job["attempt"], dose, points.get(row["action"], ()))
