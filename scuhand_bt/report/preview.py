"""What a plan will come to, as one page that needs nothing from elsewhere: `scuhand-bt plan RECIPE --html FILE`.

The order and what each job needs are the plan's, what is to be expected of it its odds' (`study/odds.py`), and the arm
moves as in a dry run of it.
"""

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from scuhand_bt.journal.reader import open_contents
from scuhand_bt.lab import Lab
from scuhand_bt.quantity import format_duration, format_mass
from scuhand_bt.recipe.plan import Plan
from scuhand_bt.report import viewer
from scuhand_bt.report.changer import changer_lines
from scuhand_bt.report.doses import amount_cell, asked_cells
from scuhand_bt.report.page import rendered
from scuhand_bt.report.run_scene import run_motions, scene_of
from scuhand_bt.run.observers import BatchObserver
from scuhand_bt.run.options import Options
from scuhand_bt.run.session import Session
from scuhand_bt.run.simulation import DryRun
from scuhand_bt.study.odds import CELLS, COVERED, RECKONED, Odds, Range

NEVER = "in no dry run"


def preview_page(
    plan: Plan, lab: Lab, odds: Odds, *, doubts: Sequence[str] = (), of_persons: Sequence[str] = ()
) -> str:
    """The page; `doubts` are told beside the samples' odds, and `of_persons` beside when a person is needed.

    Raises as `Session` for a plan that no dry run can be made of.
    """
    motions = _motions(plan, lab)
    recipe, sources = plan.recipe, plan.recipe.sources.values()
    moments = sum(person.job is not None for person in plan.persons)
    return rendered(
        "preview.html",
        recipe=recipe.name,
        trials=odds.trials,
        tells_intervals=odds.tells_intervals,
        cells=CELLS,
        covered=f"{COVERED:.0%}",
        figures=[
            ("time", _range(odds.duration_s, format_duration)),
            ("samples in tolerance", f"{odds.good:.1f} of {len(recipe.samples)}"),
            ("sheet swap between samples" if plan.swaps == 1 else "sheet swaps between samples", str(plan.swaps)),
            ("moment that needs a person" if moments == 1 else "moments that need a person", str(moments)),
        ],
        jobs=list(_jobs(plan, odds)),
        powder_columns=_powder_columns(odds),
        reckoned=RECKONED,
        powders=list(_powders(plan, odds)),
        doubts=doubts,
        failures=[(what, f"{count:.2g}") for what, count in odds.not_good.items()],
        persons=list(_persons(plan, odds)),
        of_persons=[*changer_lines(plan, lab.cell), *of_persons],
        packed=viewer.packed(
            scene_of(lab, {one.station: one.mortar for one in sources}),
            motions,
            "The arm's motions in the batch, job by job",
        ),
    )


def _motions(plan: Plan, lab: Lab) -> Sequence[Mapping[str, Any]]:
    """How the arm moves in a dry run."""
    with tempfile.TemporaryDirectory(prefix="scuhand-plan-") as folder:
        session = Session(plan, lab, Options(DryRun(0), None, Path(folder) / "runs"))
        try:
            session.run(BatchObserver())
        finally:
            session.close()
        with open_contents(session.journal.path) as contents:
            return run_motions(contents)


def _range(found: Range, words: Callable[[float], str]) -> str:
    low, middle, high = words(found.low), words(found.middle), words(found.high)
    return f"{middle} ({low} to {high})" if low != high else middle


def _jobs(plan: Plan, odds: Odds) -> Iterator[dict[str, Any]]:
    needed = {person.job for person in plan.persons}
    for number, job in enumerate(plan.jobs, start=1):
        sample = job.sample
        mass, tolerance = asked_cells(sample) if sample is not None else ("", "")
        chance = odds.samples.get(sample.id) if sample is not None else None
        yield {
            "is_visit": sample is None and job.name in needed,
            "cells": [
                str(number),
                job.name,
                job.workflow,
                ", ".join(source.name for source in sample.sources) if sample is not None else "",
                sample.container.name if sample is not None and sample.container is not None else "",
                mass,
                f"± {tolerance}" if tolerance else "",
                _when(odds.began_s.get(job.name)),
                chance.told if chance is not None else "",
            ],
        }


def _when(found: Range | None) -> str:
    return _range(found, format_duration) if found is not None else NEVER


def _powder_columns(odds: Odds) -> list[str]:
    left = [f"left, {kind}" for kind in odds.left]
    return ["source", "powder", "station", "samples", "scoops", "needed with losses", "used", *left, "amount"]


def _powders(plan: Plan, odds: Odds) -> Iterator[list[str]]:
    for demand in plan.demands:
        source = demand.source
        yield [
            source.name,
            source.powder.name + (f", lot {source.lot}" if source.lot else ""),
            source.station,
            str(demand.samples),
            _range(odds.scoops[source.name], lambda count: f"{count:.0f}"),
            format_mass(demand.needed_mg),
            _range(odds.used_mg[source.name], format_mass),
            *(_range(odds.leftovers_mg[source.name][kind], format_mass) for kind in odds.left),
            amount_cell(plan, source),
        ]


def _persons(plan: Plan, odds: Odds) -> Iterator[list[str]]:
    """Every moment of the plan that needs a person, with when that is."""
    yield ["before the start", "", "the sources filled and in their places, a fresh sheet in the hand"]
    for person, at in odds.persons_s(plan):
        if person.job is None:
            yield ["if a sample fails", "", person.what]
        else:
            when = _when(at)
            yield [when if when == NEVER else f"after {when}", person.job, person.what]
