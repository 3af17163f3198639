"""The plan: a recipe's samples as jobs in order, with sheet swaps and refills, and the powder and persons needed."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate
from typing import Any

from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.dosing.jars import COUNTED_ON_DEG, JarBed, after_dose, has_way
from scuhand_bt.dosing.ladle import Ladle
from scuhand_bt.lab import CELL_FILE, Lab
from scuhand_bt.problems import Mark, Problems
from scuhand_bt.recipe.demand import Demand, demand_of, discarded_mg, needed_mg
from scuhand_bt.recipe.forecast import Expected, Forecaster
from scuhand_bt.recipe.order import fewest_changes, in_order
from scuhand_bt.recipe.recipe import Recipe
from scuhand_bt.recipe.sample import Sample
from scuhand_bt.recipe.sources import REFILL
from scuhand_bt.specs import Source
from scuhand_bt.tree.check import check_workflows
from scuhand_bt.tree.library import Library

CHANGE_POWDER = "change_powder"
"""The lab's workflow that empties the cone into its source and swaps the sheet; its input is `source`."""
CLEAR_AND_CHANGE_POWDER = "clear_and_change_powder"
"""As `change_powder`, but it also clears the pan meanwhile. It is used between samples if the lab has it.

Not if a person changes containers: an exchange is one visit, and this would be a second one."""
FINISH_BATCH = "finish_batch"
"""The lab's workflow after the last sample; its input is `source`."""
AFTER_FAILURE = "after_failure"
"""The lab's workflow that makes the cell ready again after a failed sample; its input is `source`."""
RESERVE = 0.2
"""A mortar that is refilled is to hold at least this share of its `amount`. From less powder a scoop brings less than
expected, so there would be more scoops than planned."""
ROUNDED_MG = 1e-6
SERVICE = (CHANGE_POWDER, CLEAR_AND_CHANGE_POWDER, FINISH_BATCH, AFTER_FAILURE, REFILL)
"""The workflows that the engine itself calls, with a source as their input."""


@dataclass(frozen=True)
class Job:
    """One workflow with its inputs bound, for a sample or between samples (then `sample` is None)."""

    name: str
    workflow: str
    inputs: Mapping[str, Any]
    sample: Sample | None = None


@dataclass(frozen=True)
class PersonNeeded:
    """A moment of the plan that needs a person, and the place in a file that causes it.

    Without a `job` it comes only if a sample fails.
    """

    job: str | None
    what: str
    mark: Mark

    def __str__(self) -> str:
        """Completes a sentence that begins with "a person is"."""
        return f"needed at '{self.job}': {self.what}" if self.job is not None else f"perhaps needed: {self.what}"


@dataclass(frozen=True)
class Plan:
    """A recipe, ready to run."""

    recipe: Recipe
    jobs: tuple[Job, ...]
    demands: tuple[Demand, ...]
    persons: tuple[PersonNeeded, ...]
    done_s: Mapping[str, float]
    """When each job is expected to end, by its name [s from the start of the run]."""
    descents: frozenset[tuple[str, float]] = frozenset()
    """Places that the cone reaches straight from above, and the height of the descent [mm]."""

    @property
    def duration_s(self) -> float:
        return max(self.done_s.values(), default=0.0)

    def soon(self, job: Job) -> PersonNeeded | None:
        """What the job after this one needs a person for, if this one needs nobody; None otherwise.

        Whoever is notified when this job begins can be there in time. None for a job that is not in the plan.
        """
        number = next((number for number, one in enumerate(self.jobs) if one.name == job.name), len(self.jobs))
        needed = [[one for one in self.persons if one.job == at.name] for at in self.jobs[number:][:2]]
        here, after = needed if len(needed) == 2 else ([], [])
        return replace(after[0], what="; ".join(one.what for one in after)) if after and not here else None

    @property
    def swaps(self) -> int:
        return sum(1 for job in self.jobs if job.workflow in (CHANGE_POWDER, CLEAR_AND_CHANGE_POWDER))

    @property
    def fewest_swaps(self) -> int:
        return fewest_changes(self.recipe.samples)

    @property
    def refills(self) -> Counter[str]:
        """How often each source's mortar is refilled, by the source's name."""
        return Counter(job.inputs["source"].name for job in self.jobs if job.workflow == REFILL and job.sample is None)


def make_plan(recipe: Recipe, lab: Lab) -> Plan:
    """Order the samples, insert sheet swaps and refills, and forecast the run.

    The forecast assumes that nothing fails: the child of a `retry` runs once, and of a `fallback` only the first.
    Raises SourceError if a workflow that the plan needs is missing or wrong.
    """
    problems = Problems()
    check_service_workflows(recipe, lab, problems)
    problems.raise_any()
    forecaster = Forecaster(lab)

    def forecast_of(job: Job) -> list[Expected]:
        if job.sample is None:
            return forecaster.of_service(job.workflow, job.inputs["source"])
        return forecaster.of(job.workflow, job.inputs)

    def duration_s(sample: Sample) -> float:
        return sum(expected.duration_s for expected in forecaster.of(sample.workflow, sample.inputs))

    jobs = tuple(_jobs(lab, in_order(recipe.order, recipe.samples, duration_s)))
    forecasts = [forecast_of(job) for job in jobs]
    refills, refilled_mg = _refills(recipe.sources.values(), jobs, _persons(jobs, forecasts, lab), lab)
    if refills:
        forecast = {job.name: found for job, found in zip(jobs, forecasts, strict=True)}
        jobs = tuple(one for job in jobs for one in (*refills.get(job.name, ()), job))
        forecasts = [forecast[job.name] if job.name in forecast else forecast_of(job) for job in jobs]
    persons = (*_persons(jobs, forecasts, lab), *_persons_after_failures(recipe, forecaster))
    demands = tuple(demand_of(recipe.samples, one, refilled_mg.get(name)) for name, one in recipe.sources.items())
    done_s = accumulate(sum(one.duration_s for one in found) for found in forecasts)
    descents = frozenset(one.descent for found in forecasts for one in found if one.descent is not None)
    return Plan(recipe, jobs, demands, persons, dict(zip((job.name for job in jobs), done_s, strict=True)), descents)


def recoveries(sample: Sample) -> list[Job]:
    """The jobs that may follow if this sample fails: one for each source into which the cone may be emptied.

    By its name a resumed run knows which one was chosen.
    """
    name = f"after {sample.id}"
    return [
        Job(name if len(sample.sources) == 1 else f"{name} with {source.name}", AFTER_FAILURE, {"source": source})
        for source in sample.sources
    ]


def sheet_changes(sample: Sample, recipe: Recipe, library: Library, cell: CellSpec) -> list[Job]:
    """The jobs that may have to change the sheet before this sample: one for each source of another lot.

    The plan has such changes where every sample succeeds. Where one failed within a mixture, only the run knows the
    sheet's lot. By the job's name a resumed run knows which one was chosen.
    """
    first, workflow = next(iter(sample.sources), None), changing_workflow(library, cell)
    if first is None or workflow not in library.workflows:
        return []
    return [
        Job(f"{_change_name(sample)} after {source.name}", workflow, {"source": source})
        for source in recipe.sources.values()
        if source.sheet_key != first.sheet_key
    ]


def changing_workflow(library: Library, cell: CellSpec) -> str:
    """The name of the workflow that changes the sheet between samples in this lab."""
    name = CLEAR_AND_CHANGE_POWDER
    has_it = name in library.workflows or library.broken.of("workflow", name)  # so that a broken one is reported
    return name if has_it and cell.changer.driver != "operator" else CHANGE_POWDER


def _change_name(sample: Sample) -> str:
    return f"change powder to {sample.sources[0].sheet_key} for {sample.id}"


def check_unattended(plan: Plan) -> None:
    """Raises SourceError if the plan needs a person: one problem for each place that asks for one."""
    by_mark: dict[Mark, list[PersonNeeded]] = {}
    for person in plan.persons:
        by_mark.setdefault(person.mark, []).append(person)
    problems = Problems()
    for mark, persons in by_mark.items():
        times = f" (and {len(persons) - 1} more like it)" if len(persons) > 1 else ""
        problems.add(
            mark, f"an unattended run cannot wait for a person, but one is {persons[0]}{times}", code="needs-person"
        )
    problems.raise_any()


def _refills(
    sources: Iterable[Source], jobs: Sequence[Job], persons: Iterable[PersonNeeded], lab: Lab
) -> tuple[dict[str, list[Job]], dict[str, float]]:
    """Refills to insert, by the name of the job after them; and the most that each refilled source ever holds.

    The rule is in docs/recipes.md, "Refilling a mortar". A mortar that does not hold all that is still needed is
    refilled before the first sample that would leave less than `RESERVE` in it. A jar is refilled before the first
    sample for which it may not hold enough. If a person comes earlier anyway, the refill is moved to the last such
    visit.
    """
    visits = {person.job for person in persons}
    samples = [job.sample for job in jobs if job.sample is not None]
    found: dict[str, list[Job]] = {}
    most_mg: dict[str, float] = {}
    for source in sources:
        if source.refill_mg is None:
            continue
        left_mg, since = source.amount_mg, list[tuple[Job, float]]()  # the content before each job since the refill
        to_come_mg = sum(needed_mg(sample, source) + discarded_mg(sample, source) for sample in samples)
        jar = _jar(source, lab)
        for job in jobs:
            since.append((job, left_mg))
            needs_mg = needed_mg(job.sample, source) if job.sample is not None else 0.0
            goes_mg = discarded_mg(job.sample, source) if job.sample is not None else 0.0
            to_come_mg -= needs_mg + goes_mg
            # What the last sample discards, no other sample needs.
            lacks = left_mg < needs_mg + (goes_mg + to_come_mg if to_come_mg > ROUNDED_MG else 0.0)
            is_short = lacks and left_mg - needs_mg < RESERVE * source.amount_mg
            left = _after_dose(jar, needs_mg, source)
            if needs_mg > 0.0 and (is_short if jar is None else left is None):
                with_person = [(one, mg) for one, mg in since if one.name in visits and source.refill_into_mg(mg) > 0.0]
                at, held_mg = with_person[-1] if with_person else (job, left_mg)
                first = next(job.sample.id for job in jobs[jobs.index(at) :] if job.sample is not None)
                named = f"refill {source.name} for {first}"
                found.setdefault(at.name, []).append(Job(named, REFILL, {"source": source}))
                visits.add(at.name)
                left_mg += source.refill_into_mg(held_mg)
                most_mg[source.name] = max(most_mg.get(source.name, 0.0), held_mg + source.refill_into_mg(held_mg))
                since = []
                jar = jar.with_more(source.refill_into_mg(held_mg)) if jar is not None else None
                left = _after_dose(jar, needs_mg, source)
            jar = left or jar
            left_mg -= needs_mg
            left_mg -= min(goes_mg, max(0.0, left_mg))  # a scoop cannot take more than there is
    return found, most_mg


def _jar(source: Source, lab: Lab) -> JarBed | None:
    """The bed of a source that is a beaker or jar; None for a bowl, and if no stroke is possible in it."""
    ladle = Ladle.of(lab.cell.hand)
    if source.mortar.corner_mm is None or not has_way(source.mortar, ladle):
        return None
    return JarBed(source.mortar, source.amount_mg, source.powder, ladle)


def _after_dose(jar: JarBed | None, dose_mg: float, source: Source) -> JarBed | None:
    if jar is None or dose_mg == 0.0:
        return jar
    return after_dose(jar, dose_mg, COUNTED_ON_DEG, is_discarded=source.is_discarded)


def _persons(jobs: tuple[Job, ...], forecasts: list[list[Expected]], lab: Lab) -> Iterator[PersonNeeded]:
    """Every moment that needs a person: those that skills forecast, and refilling the changer."""
    used, changer = Counter[str](), lab.cell.changer
    cell_file = Mark(str(lab.folder / CELL_FILE))
    for job, found in zip(jobs, forecasts, strict=True):
        kinds = [one.name for one in job.sample.all_containers] if job.sample is not None else []
        for number, kind in enumerate(kinds if changer.driver != "operator" else ()):
            if (short := changer.short_of(used, kinds if number == 0 else [kind])) is not None:
                holds = f"{changer.slots_for(short)} {short}".rstrip()
                yield PersonNeeded(job.name, f"fill the changer again (it holds {holds})", cell_file)
                used.clear()
            used[kind if changer.kinds else ""] += 1
        for expected in found:
            if expected.person is not None:
                yield PersonNeeded(job.name, expected.person, expected.mark)


def _persons_after_failures(recipe: Recipe, forecaster: Forecaster) -> Iterator[PersonNeeded]:
    """What a person may be needed for if a sample fails: the recipe's `ask`, and what the lab's recovery needs."""
    for code, action in sorted(recipe.on_failure.items(), key=lambda item: item[0] == "otherwise"):
        if action == "ask":
            how = "in any other way" if code == "otherwise" else f"with {code}"
            what = f"to say what to do if a sample fails {how}"
            yield PersonNeeded(None, what, recipe.marks[f"on_failure.{code}"])
    for source in list(recipe.sources.values())[:1]:
        for expected in forecaster.of_service(AFTER_FAILURE, source):
            if expected.person is not None:
                yield PersonNeeded(None, f"{expected.person}, after a failed sample", expected.mark)


def _jobs(lab: Lab, samples: Iterable[Sample]) -> Iterator[Job]:
    """The jobs without refills. A resumed run knows each by its unique name; ids of samples contain no blank."""
    last: Source | None = None
    changing = changing_workflow(lab.library, lab.cell)
    for sample in samples:
        for first in sample.sources[:1]:
            if last is not None and first.sheet_key != last.sheet_key:
                yield Job(_change_name(sample), changing, {"source": last})
            last = sample.last_source
        yield _job(sample)
    if last is not None and FINISH_BATCH in lab.library.workflows:
        yield Job("finish the batch", FINISH_BATCH, {"source": last})


def _job(sample: Sample) -> Job:
    return Job(sample.id, sample.workflow, sample.inputs, sample)


def check_service_workflows(recipe: Recipe, lab: Lab, problems: Problems) -> None:
    """Report what is wrong with the workflows that the engine calls between this recipe's samples."""
    workflows = lab.library.workflows
    needed = {job.workflow for job in _jobs(lab, recipe.samples) if job.sample is None}
    needed |= {REFILL} if any(source.refill_mg is not None for source in recipe.sources.values()) else set()
    for name in sorted(needed | ({AFTER_FAILURE} & set(workflows))):
        workflow = workflows.get(name)
        if workflow is None and lab.library.broken.tell("workflow", name, problems):
            continue
        if workflow is None:
            folder = str(lab.folder / "trees")
            problems.add(
                Mark(folder),
                f"the workflow '{name}' is missing",
                "this plan needs it to refill mortars" if name == REFILL else "this plan needs it to change powders",
                code="missing-key",
            )
        elif list(workflow.inputs) != ["source"] or workflow.inputs["source"].type.python is not Source:
            problems.add(
                workflow.mark, f"'{name}' must have exactly one input, 'source' (Source)", code="service-workflow"
            )
        else:
            check_workflows(lab.library, [name], problems)
