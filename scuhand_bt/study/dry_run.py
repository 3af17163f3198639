"""One trial: a dry run that learns from no run, and leaves nothing behind.

It gives the same figures in any process, whatever ran before it there. What costs time is made once in a process and
kept: the lab, the plan, its motions.
"""

import tempfile
from collections import Counter
from functools import lru_cache
from pathlib import Path

from scuhand_bt.journal.reader import open_journal
from scuhand_bt.lab import Lab, load_lab
from scuhand_bt.motion import MotionPlanner
from scuhand_bt.recipe.plan import Job, Plan, make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.run.batch import BatchObserver
from scuhand_bt.run.make_cell import DryRun
from scuhand_bt.run.options import Options
from scuhand_bt.run.prepared_motion import prepared_motion
from scuhand_bt.run.session import Session
from scuhand_bt.study.change import changed
from scuhand_bt.study.some_cell import SomeCell
from scuhand_bt.study.trial import LEFTOVERS, SampleTrial, Setup, Trial, into

SOME_CELL = f"{SomeCell.__module__}:{SomeCell.__name__}"


_REFILLED = """
SELECT json_extract(payload, '$.source'), SUM(json_extract(payload, '$.mass_mg')) FROM entry
WHERE kind = 'refilled' GROUP BY 1
"""


def dry_run(setup: Setup, seed: int) -> Trial:
    """One dry run. SourceError for a recipe, a lab or changes that are wrong."""
    plan, lab, motion = _made(setup)
    began = _Began()
    plant = SOME_CELL if setup.plant is None else setup.plant
    SomeCell.seed = seed
    with tempfile.TemporaryDirectory(prefix="scuhand-trial-") as folder:
        runs = Path(folder) / "runs"
        session = Session(plan, lab, Options(DryRun(seed, plant), setup.controller, runs), motion)
        assert session.world is not None
        session.world.close()  # in no file: no trial is resumed
        try:
            before_mg = session.world.masses_mg
            began.session = session
            result = session.run(began)
            after_mg = session.world.masses_mg
        finally:
            session.close()
        with open_journal(session.journal.path) as (database, _):
            scooped = database.execute("SELECT json_extract(payload, '$.source') FROM entry WHERE kind = 'scoop'")
            scoops = Counter(source for (source,) in scooped)
            refilled_mg = dict(database.execute(_REFILLED).fetchall())
            leftovers = database.execute(
                "SELECT json_extract(payload, '$.source'), kind, json_extract(payload, '$.to'),"
                " SUM(json_extract(payload, '$.expected_mg')) FROM entry WHERE kind IN (?, ?, ?) GROUP BY 1, 2, 3",
                LEFTOVERS,
            ).fetchall()
    vessels = {station.name for station in lab.cell.vessels}
    became_mg: dict[str, Counter[str]] = {name: Counter() for name in plan.recipe.sources}
    for source, kind, station, mass_mg in leftovers:
        if source in became_mg:
            became_mg[source][into(station) if station in vessels else kind] += mass_mg
    names = list(plan.recipe.sources)
    samples = tuple(
        SampleTrial(
            one.id,
            one.is_good,
            one.target_mg is None
            or (one.true_mg is not None and abs(one.true_mg - one.target_mg) <= (one.tolerance_mg or 0.0)),
            one.verdict,
            one.code,
            one.target_mg,
            one.dispensed_mg,
            one.true_mg,
            one.duration_s,
        )
        for one in result.samples
    )
    had_mg = {name: before_mg.get(f"source:{name}", 0.0) + refilled_mg.get(name, 0.0) for name in names}
    used_mg = {name: had_mg[name] - after_mg.get(f"source:{name}", 0.0) for name in names}
    return Trial(
        seed,
        int(result.exit_code),
        result.duration_s,
        began.at_s,
        samples,
        {name: scoops[name] for name in names},
        used_mg,
        {name: dict(mg) for name, mg in became_mg.items()},
    )


class _Began(BatchObserver):
    """When each job began."""

    session: Session

    def __init__(self) -> None:
        self.at_s: dict[str, float] = {}

    def job_started(self, job: Job, number: int) -> None:
        self.at_s.setdefault(job.name, self.session.cell.clock.now_s)


@lru_cache(maxsize=2)
def _made(setup: Setup) -> tuple[Plan, Lab, MotionPlanner]:
    with changed(setup.recipe, setup.lab, setup.changes) as (recipe, folder):
        lab = load_lab(folder)
        plan = make_plan(load_recipe(recipe, lab), lab)
        return plan, lab, prepared_motion(plan, lab)
