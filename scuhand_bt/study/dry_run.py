"""One trial: a dry run that uses nothing learnt from other runs, and leaves nothing behind.

Its result does not depend on the process, nor on what ran there before. What takes time to make is kept within a
process: lab, plan and motions.
"""

import tempfile
from collections import Counter, defaultdict
from collections.abc import Hashable
from dataclasses import replace
from functools import cache, lru_cache
from pathlib import Path

from scuhand_bt.events.cell import Discarded, Kept, Refilled, Returned, Scooped
from scuhand_bt.events.entry import Event, Note
from scuhand_bt.journal.events import Asked
from scuhand_bt.journal.results import DoseResult, SampleResult
from scuhand_bt.lab import Lab, load_lab
from scuhand_bt.motion import MotionPlanner
from scuhand_bt.problems import Mark, Problem, SourceError
from scuhand_bt.recipe.plan import Job, Plan, make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.recipe.sample import Sample
from scuhand_bt.run.observers import BatchObserver
from scuhand_bt.run.options import Options
from scuhand_bt.run.prepared_motion import places_of, prepared_motion
from scuhand_bt.run.session import Session
from scuhand_bt.run.simulation import DryRun
from scuhand_bt.sim.plant import PlantError
from scuhand_bt.study.change import changed, files_hash, modules_hash
from scuhand_bt.study.some_cell import SomeCell
from scuhand_bt.study.trial import SampleTrial, Setup, Trial, into

SOME_CELL = f"{SomeCell.__module__}:{SomeCell.__name__}"


def dry_run(setup: Setup, seed: int) -> Trial:
    """One dry run. Raises SourceError for a wrong recipe, lab, change or plant."""
    try:
        return _dry_run(setup, seed)
    except PlantError as error:
        raise SourceError([Problem(Mark("--plant", 0), str(error))]) from None


def _dry_run(setup: Setup, seed: int) -> Trial:
    plan, lab, motion = _made(setup)
    plant = SOME_CELL if setup.plant is None else setup.plant
    if setup.modules and _read_as(setup.plant, setup.lab) not in ("", setup.modules):
        what = "one of your own modules, which its skills, its drivers or the --plant import, has changed since"
        raise SourceError([Problem(Mark(str(setup.lab), 0), f"{what}; start again, also a cluster's workers")])
    SomeCell.seed = seed
    with tempfile.TemporaryDirectory(prefix="scuhand-trial-") as folder:
        runs = Path(folder) / "runs"
        session = Session(plan, lab, Options(DryRun(seed, plant), setup.controller, runs, is_kept=False), motion)
        assert session.world is not None
        try:
            before_mg = session.world.masses_mg
            told = _Told(session)
            session.journal.heard = told.heard
            result = session.run(told)
            after_mg = session.world.masses_mg
        finally:
            session.close()
    vessels = {station.name for station in lab.cell.vessels}
    became_mg = {name: defaultdict[str, float](float) for name in plan.recipe.sources}
    for event in told.left:
        if event.source in became_mg:
            to = event.to if isinstance(event, Discarded) else None
            became = into(to) if to is not None and to in vessels else event.KIND
            before, now = became_mg[event.source][became], event.expected_mg
            # What is kept is mostly the same powder each time, so only the maximum counts.
            became_mg[event.source][became] = max(before, now) if isinstance(event, Kept) else before + now
    names = list(plan.recipe.sources)
    samples = tuple(
        SampleTrial(
            one.id,
            one.is_good,
            _is_truly_good(one, sample),
            one.verdict,
            one.code,
            one.target_mg,
            one.dispensed_mg,
            one.true_mg,
            one.duration_s,
        )
        for one, sample in zip(result.samples, plan.recipe.samples, strict=True)
    )
    had_mg = {name: before_mg.get(f"source:{name}", 0.0) + told.refilled_mg[name] for name in names}
    used_mg = {name: had_mg[name] - after_mg.get(f"source:{name}", 0.0) for name in names}
    return Trial(
        seed,
        int(result.exit_code),
        result.duration_s,
        told.began_s,
        samples,
        {name: told.scoops[name] for name in names},
        used_mg,
        {name: dict(mg) for name, mg in became_mg.items()},
        dict(told.asked_s),
        "" if result.is_complete else result.reason,
    )


def _is_truly_good(one: SampleResult, sample: Sample) -> bool:
    """Whether its containers truly hold what they should, by the simulation, which does not tell lots apart."""
    if not one.doses:
        return one.is_good
    lots = {take.source.sheet_key for take in sample.takes}
    if one.verdict == "not as asked" or not lots <= {dose.lot for dose in one.doses}:
        return False
    of_containers = defaultdict[str, list[DoseResult]](list)
    for dose in one.doses:
        of_containers[dose.container].append(dose)
    return all(
        abs((doses[0].true_mg or 0.0) - sum(dose.target_mg for dose in doses))
        <= sum(dose.tolerance_mg for dose in doses)
        for doses in of_containers.values()
    )


class _Told(BatchObserver):
    """Records when each job began and when a person was asked in it, and what became of the sources' powder."""

    def __init__(self, session: Session) -> None:
        self._clock = session.cell.clock
        self._job = session.plan.jobs[0].name  # questions before the first job count as the first job's
        self.began_s: dict[str, float] = {}
        self.asked_s = defaultdict[str, list[list[float]]](list)
        self._asked_by: dict[int | None, list[float]] = {}
        self._journal = session.journal
        self.scoops = Counter[str]()
        self.refilled_mg = defaultdict[str, float](float)
        self.left: list[Kept | Returned | Discarded] = []

    def job_started(self, job: Job, number: int) -> None:
        self._job = job.name
        self.began_s.setdefault(job.name, self._clock.now_s)

    def heard(self, event: Event | Note) -> None:
        match event:
            case Asked():
                action, now_s = self._journal.action, self._clock.now_s
                if action is None or action not in self._asked_by:
                    self._asked_by[action] = [now_s, now_s]
                    self.asked_s[self._job].append(self._asked_by[action])
                self._asked_by[action][1] = now_s
            case Scooped():
                self.scoops[event.source] += 1
            case Refilled():
                self.refilled_mg[event.source] += event.mass_mg
            case Kept() | Returned() | Discarded():
                self.left.append(event)


@cache
def _read_as(plant: str | None, lab: Path) -> str:
    """The hash of the user's own modules as this process has them: each is imported once, and then kept."""
    return modules_hash(plant, lab)


@lru_cache(maxsize=1)
def _as_written(lab: Path, files: str) -> tuple[Lab, dict[Hashable, MotionPlanner]]:
    """A lab with exactly these files, and its motions by geometry, shared by all draws that change only the recipe."""
    return load_lab(lab), {}


@lru_cache(maxsize=2)
def _made(setup: Setup) -> tuple[Plan, Lab, MotionPlanner]:
    with changed(setup.recipe, setup.lab, setup.changes) as (recipe, folder):
        is_as_written = all(place.startswith("recipe.") for place, _ in setup.changes)
        lab, motions = _as_written(setup.lab, setup.files) if is_as_written and setup.files else (load_lab(folder), {})
        # The recipe's tables are beside it in the copy; in all else the lab is shared by all draws.
        loaded = load_recipe(recipe, replace(lab, folder=folder))
        plan = make_plan(loaded if setup.order is None else replace(loaded, order=setup.order), lab)
        stands = frozenset((one.station, one.mortar) for one in plan.recipe.sources.values())
        geometry = stands, frozenset(places_of(plan, lab).items())
        if geometry not in motions:
            motions[geometry] = prepared_motion(plan, lab)
        made = plan, lab, motions[geometry]
    if setup.files not in ("", files_hash(setup.recipe, setup.lab)):
        problem = "it, one of its tables or its lab has changed since these dry runs began; start them again"
        raise SourceError([Problem(Mark(str(setup.recipe), 0), problem)])
    return made
