"""What a plan will come to: `scuhand-bt plan RECIPE --html FILE`, one page that needs nothing from elsewhere.

The order and what each job needs are the plan's. How long it takes, how often is scooped, what each source gives, when
a person is asked and how the arm moves are what dry runs of it came to, from the lowest to the highest of them.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scuhand_bt.exit_codes import ExitCode
from scuhand_bt.journal.events import Asked
from scuhand_bt.journal.reader import open_contents
from scuhand_bt.journal.results import SampleResult
from scuhand_bt.lab import Lab
from scuhand_bt.quantity import format_duration, format_mass
from scuhand_bt.recipe.plan import CHANGE_POWDER, Plan
from scuhand_bt.report import viewer
from scuhand_bt.report.page import rendered
from scuhand_bt.report.powder_balance import powder_balance
from scuhand_bt.report.run_scene import run_motions, scene_of
from scuhand_bt.report.time_spent import time_spent
from scuhand_bt.run.batch import BatchObserver
from scuhand_bt.run.make_cell import DryRun, prepared_motion
from scuhand_bt.run.options import Options
from scuhand_bt.run.session import Session

NONE = "–"


@dataclass(frozen=True)
class Tried:
    """What a dry run of the plan came to."""

    exit_code: int
    reason: str
    duration_s: float
    jobs: Mapping[str, tuple[float, float]]
    """When each began, and how long all its attempts took [s]."""
    scoops: Mapping[str, int]
    """Of each sample."""
    used_mg: Mapping[str, float]
    """What each source gave."""
    asked: int
    """How often a person was asked."""
    motions: Sequence[Mapping[str, Any]]


def dry_runs(plan: Plan, lab: Lab, folder: Path, seeds: int, told: Callable[[int], None]) -> list[Tried]:
    """Run a plan on simulated devices, with the seeds from 0 on; `told` hears of each that has ended."""
    motion, tried = prepared_motion(plan, lab), []
    for seed in range(seeds):
        session = Session(plan, lab, Options(DryRun(seed), None, folder / str(seed) / "runs"), motion)
        try:
            result = session.run(BatchObserver())
        finally:
            session.close()
        tried.append(_tried(session.journal.path, result.exit_code, result.reason, with_motions=seed == 0))
        told(seed + 1)
    return tried


def preview(plan: Plan, lab: Lab, tried: Sequence[Tried]) -> str:
    """The page."""
    first, ended = tried[0], [one for one in tried if one.exit_code <= ExitCode.FLAGGED]
    recipe, sources = plan.recipe, plan.recipe.sources.values()
    scene = scene_of(lab, {one.station: one.mortar for one in sources}, {one["cone_mm"] for one in first.motions})
    return rendered(
        "preview.html",
        recipe=recipe.name,
        runs=len(tried),
        early=[f"seed {seed}: {one.reason}" for seed, one in enumerate(tried) if one not in ended],
        figures=[
            ("time", _span([one.duration_s for one in ended], format_duration)),
            ("samples", str(len(recipe.samples))),
            ("scoops", _span([sum(one.scoops.values()) for one in ended], str)),
            ("sheet swaps", str(plan.swaps)),
            ("times that a person is needed", _span([one.asked for one in ended], str)),
        ],
        jobs=list(_jobs(plan, ended)),
        powders=list(_powders(plan, ended)),
        persons=list(_persons(plan, ended)),
        packed=viewer.packed(scene, first.motions, "The arm's motions in the batch, job by job"),
    )


def _tried(journal: Path, exit_code: int, reason: str, *, with_motions: bool) -> Tried:
    with open_contents(journal) as contents:
        jobs: dict[str, tuple[float, float]] = {}
        for job in time_spent(contents).jobs:
            began_s, lasted_s = jobs.get(job.name, (job.began_s, 0.0))
            jobs[job.name] = began_s, lasted_s + job.duration_s
        scoops: Counter[str] = Counter()
        asked, last_s = 0, 0.0
        for row in contents.rows("entry"):
            last_s = max(last_s, row["time_s"])
            if row["kind"] == SampleResult.KIND:
                scoops[row["payload"]["id"]] = row["payload"]["scoops"]
            elif row["kind"] == Asked.KIND:
                asked += 1
        used_mg = {
            one.name: (one.start_mg or 0.0) - one.left_mg for one in powder_balance(contents) if one.left_mg is not None
        }
        motions = run_motions(contents) if with_motions else []
    return Tried(exit_code, reason, last_s, jobs, scoops, used_mg, asked, motions)


def _span(values: Sequence[Any], words: Callable[[Any], str]) -> str:
    """From the lowest to the highest, in words."""
    if not values:
        return NONE
    low, high = words(min(values)), words(max(values))
    return low if low == high else f"{low} to {high}"


def _jobs(plan: Plan, tried: Sequence[Tried]) -> Iterator[dict[str, Any]]:
    for number, job in enumerate(plan.jobs, start=1):
        sample, ran = job.sample, [one.jobs[job.name] for one in tried if job.name in one.jobs]
        has_mass = sample is not None and sample.mass_mg is not None
        yield {
            "is_swap": job.workflow == CHANGE_POWDER,
            "cells": [
                str(number),
                job.name,
                job.workflow,
                ", ".join(source.name for source in sample.sources) if sample is not None else "",
                sample.container.name if sample is not None and sample.container is not None else "",
                format_mass(sample.mass_mg or 0.0) if sample is not None and has_mass else "",
                f"± {sample.tolerance_mg:g} mg" if sample is not None and sample.tolerance_mg is not None else "",
                _span([one.scoops.get(sample.id, 0) for one in tried], str) if sample is not None else "",
                _span([began_s for began_s, _ in ran], format_duration),
                _span([lasted_s for _, lasted_s in ran], format_duration),
            ],
        }


def _powders(plan: Plan, tried: Sequence[Tried]) -> Iterator[list[str]]:
    for demand in plan.demands:
        source = demand.source
        used = [one.used_mg[source.name] for one in tried if source.name in one.used_mg]
        yield [
            source.name,
            source.powder.name + (f", lot {source.lot}" if source.lot else ""),
            source.station,
            str(demand.samples),
            format_mass(demand.needed_mg),
            _span(used, format_mass),
            format_mass(source.amount_mg),
        ]


def _persons(plan: Plan, tried: Sequence[Tried]) -> Iterator[list[str]]:
    """Every moment of the plan that needs a person, with when its job began."""
    yield ["before the start", "", "the sources filled and in their places, a fresh sheet in the hand"]
    for person in plan.persons:
        if person.job is None:
            yield ["if a sample fails", "", person.what]
        else:
            began_s = [one.jobs[person.job][0] for one in tried if person.job in one.jobs]
            yield [f"after {_span(began_s, format_duration)}", person.job, person.what]
