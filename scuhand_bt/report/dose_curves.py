"""The course of each dose, as its run's journal has it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from scuhand_bt.events.doses import Dose, DoseCurve
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


def curves_of_doses(contents: Contents) -> Iterator[CurveOfDose]:
    """Every dose of a run's samples, in order. A dose and its course are of one action; of one job in old journals."""
    jobs = {row["id"]: row for row in contents.rows("job")}
    of_actions: dict[int, list[Point]] = {}
    of_jobs: dict[int, list[Point]] = {}
    job_of = {row["id"]: row["job"] for row in contents.rows("action")}
    entries = [row for row in contents.each("entry") if row["kind"] in (Dose.KIND, DoseCurve.KIND)]
    for row in entries:
        if row["kind"] == DoseCurve.KIND:
            points = DoseCurve.model_validate(row["payload"]).points
            of_actions.setdefault(row["action"], []).extend(points)
            of_jobs.setdefault(job_of.get(row["action"], row["job"]), []).extend(points)
    for row in entries:
        job = jobs.get(row["job"])
        if row["kind"] == Dose.KIND and job is not None and job["sample"] is not None:
            course = of_jobs.get(row["job"], ()) if row["action"] is None else of_actions.get(row["action"], ())
            yield CurveOfDose(job["sample"], job["attempt"], Dose.model_validate(row["payload"]), course)
