"""`check`: finds everything that `run` would refuse, and what is probably not meant, without moving anything.

One pass covers the lab, its skills and workflows, the recipe with its tables, the plan, and the arm's ways. Mistakes
in files of the lab that the recipe does not use are reported as warnings.
"""

import hashlib
import json
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from scuhand_bt.dosing.verdict import LIKELY, acceptance_mg, chance_with_lumps
from scuhand_bt.lab import CELL_FILE, Lab, cell_mark, files_of, kept_by_changing, state_folder, without_driver
from scuhand_bt.lab_state.beliefs import LabState
from scuhand_bt.lab_state.inventory import Inventory
from scuhand_bt.problems import Mark, Problem, Problems, SourceError
from scuhand_bt.program import source_digest
from scuhand_bt.quantity import format_below, format_mass
from scuhand_bt.recipe.demand import needed_mg
from scuhand_bt.recipe.plan import SERVICE, Plan, check_service_workflows, make_plan
from scuhand_bt.recipe.pour import each_of
from scuhand_bt.recipe.recipe import Recipe, RecipeGiven, read_recipe
from scuhand_bt.recipe.sample import Sample
from scuhand_bt.run.balance_limits import below_usp, beyond_limits
from scuhand_bt.run.inventory_conflicts import conflicts
from scuhand_bt.run.one_scoop import warn_of_one_scoop
from scuhand_bt.run.stroke_ways import MortarCannotBeScooped, poor_first_mg
from scuhand_bt.silencers import without_silenced
from scuhand_bt.skill import SkillFailed
from scuhand_bt.specs import Container
from scuhand_bt.tree.check import check_workflows
from scuhand_bt.tree.lint import Lint
from scuhand_bt.tree.workflow import Call, walk

if TYPE_CHECKING:
    from scuhand_bt.motion import MotionPlanner

OF_ROOTS = ("no-container", "no-tare", "not-over-pan", "no-park", "on-failure-never", "unused-source")
"""Warnings that depend on what a recipe names."""
PLANNED = "planned.json"
"""A file in the lab's state: hashes of cells and plans whose ways were all found."""
MOST_PLANNED = 50
"""How many of them are kept."""
LONG_HELD_SHARE = 0.5
"""The share of its stall torque that a servo may hold for the minutes of a dose. The shipped cell needs at most 37 %.
"""


@dataclass(frozen=True)
class Checked:
    """All problems in the order of the files; and the plan, if one could be made."""

    problems: tuple[Problem, ...]
    lab: Lab
    plan: Plan | None

    @property
    def errors(self) -> tuple[Problem, ...]:
        return tuple(problem for problem in self.problems if not problem.is_warning)


def check(lab: Lab, recipe: RecipeGiven | None, *, fast: bool = False) -> Checked:
    """Check a lab as `read_lab` returns it, and one of its recipes. `fast` skips planning the arm's ways."""
    of_lab = Problems(list(lab.problems))
    check_workflows(lab.library, lab.library.workflows, of_lab)
    of_recipe = Problems()
    read = _read(recipe, lab, of_recipe) if recipe is not None else None
    lint = Lint(lab.library, lab.cell, SERVICE, of_lab)
    used = {sample.workflow for sample in read.samples} if read is not None else set()
    sound = _sound(lab, of_lab.errors)
    lint.check(sorted(sound), _uncalled(lab) if recipe is None else used)
    plan = None
    if read is not None:
        if used and used | (lab.library.workflows.keys() & set(SERVICE)) <= sound:
            _check_on_failure(read, lint, used, of_recipe)
        check_service_workflows(read, lab, of_recipe)
        if lab.has_cell and not of_recipe.errors:
            plan = _plan(read, lab, of_recipe, fast=fast)
    problems = _merged(lab, of_lab.found, of_recipe.found, has_recipe=recipe is not None)
    files = [*files_of(lab.folder / "trees", "*.yaml"), *files_of(lab.folder / "skills", "*.py")]
    files += [*files_of(lab.folder / "robot", "*.yaml"), *([recipe] if isinstance(recipe, Path) else [])]
    unsure = OF_ROOTS if recipe is None else ()
    found = SourceError(without_silenced(problems, files, unsure)).problems
    return Checked(tuple(found), lab, plan)


def on_the_cell(plan: Plan, lab: Lab) -> list[Problem]:
    """What a run of a sound plan on the real cell would be refused for, or would ask. Does not apply to dry runs."""
    problems = without_driver(lab)
    try:
        stock = Inventory(state_folder(lab), lab.cell.cell).stock(simulated=False)
        problems += [conflict.problem for conflict in conflicts(plan, lab.cell, stock)]
        # Only a run knows which balance is connected; the last one measured is assumed.
        last = list(LabState(state_folder(lab)).figures(simulated=False).values())[-1:]
        figures = last[0] if last else {}
        problems += beyond_limits(plan, lab, figures, datetime.now().astimezone())
        problems += below_usp(plan, lab, figures)
    except SourceError as error:
        problems += error.problems
    return problems


def doubts(plan: Plan, lab: Lab) -> list[Problem]:
    """`check`'s warnings that fewer of a sound plan's samples will be in tolerance than the recipe asks for.

    Without those that the recipe silences.
    """
    problems = Problems()
    _check_doubts(plan.recipe, lab, problems)
    told = without_silenced(problems.found, [plan.recipe.path], ())
    return [problem for problem in problems.found if problem in told]


def _merged(lab: Lab, of_lab: list[Problem], of_recipe: list[Problem], *, has_recipe: bool) -> Iterator[Problem]:
    """The problems of both. A mistake in the lab that does not affect the recipe becomes a warning."""
    yield from of_recipe
    cell = str(lab.folder / CELL_FILE)
    told = {(problem.mark, problem.message) for problem in of_recipe}
    for problem in of_lab:
        if (problem.mark, problem.message) not in told:
            is_error = not has_recipe or (not lab.has_cell and problem.mark.file == cell)
            yield problem if is_error else replace(problem, is_warning=True)


def _read(given: RecipeGiven, lab: Lab, problems: Problems) -> Recipe | None:
    try:
        return read_recipe(given, lab, problems)
    except SourceError as error:
        problems.found += error.problems
        return None


def _plan(recipe: Recipe, lab: Lab, problems: Problems, *, fast: bool) -> Plan | None:
    try:
        plan = make_plan(recipe, lab)
    except SourceError as error:
        problems.found += error.problems
        return None
    _check_doubts(recipe, lab, problems)
    _check_first_strokes(plan, lab, problems)
    warn_of_one_scoop(plan, lab.cell, problems)
    _check_redone(recipe, lab, problems)
    _check_slots(recipe, lab, problems)
    if not fast:
        _check_ways(plan, lab, problems)
    return plan


def _check_first_strokes(plan: Plan, lab: Lab, problems: Problems) -> None:
    """Warn of bowls and jars that give so little at a time that doses take several scoops.

    Runs with even less are refused.
    """
    for demand in plan.demands:
        source = demand.source
        largest_mg = max(needed_mg(sample, source) for sample in plan.recipe.samples)
        if (brings_mg := poor_first_mg(lab.cell, source, largest_mg)) is not None:
            amount = format_mass(source.amount_mg)
            is_jar = source.mortar.corner_mm is not None
            first = f"the first stroke in this {'jar' if is_jar else 'bowl'} brings {format_mass(brings_mg)}"
            what = f"of {amount} of {source.powder.name} {first}, and later ones less: "
            what += "doses take several scoops each, the last ones many, and not all may be good"
            remedy = "use more of it, or a mortar" if is_jar else "use a deeper or a larger mortar"
            problems.warn(plan.recipe.marks[f"sources.{source.name}"], what, remedy, code="poor-strokes")


def _check_redone(recipe: Recipe, lab: Lab, problems: Problems) -> None:
    """Warn of `redo` if the changer is filled in the plan's order: later samples then get the next container."""
    changer = lab.cell.changer
    kinds = list(dict.fromkeys(one.name for sample in recipe.samples for one in sample.all_containers))
    if changer.driver == "operator" or changer.kinds or len(kinds) < 2 or not recipe.redone:
        return
    what = "a sample that is done once more takes the next container from the changer, and every later sample takes "
    what += f"the one after its own; they are of {len(kinds)} kinds, and some will be refused by their weight"
    slots = ", ".join(f"{kind}: …" for kind in kinds)
    remedy = f"write slots by kind in {CELL_FILE} (`slots: {{{slots}}}`), or use `flag`"
    problems.warn(recipe.marks[f"on_failure.{recipe.redone[0]}"], what, remedy, code="redo-shifts")


def _check_slots(recipe: Recipe, lab: Lab, problems: Problems) -> None:
    """Warn of samples with more containers than a full changer holds; once for samples that are alike."""
    changer, told = lab.cell.changer, set[tuple[str, ...]]()
    for sample in recipe.samples if changer.driver != "operator" else ():
        kinds = tuple(one.name for one in sample.all_containers)
        if kinds in told:
            continue
        told.add(kinds)
        found = Counter[str]()
        for key, container in each_of(sample.inputs):
            if not isinstance(container, Container):
                continue
            if (short := changer.short_of(found, [container.name])) is not None:
                slots, of_kind = changer.slots_for(short), f" of the kind {short}" if short else ""
                what = (
                    f"'{sample.id}' takes more containers{of_kind} than the changer has slots: {slots}. A person fills "
                )
                what += "it again midway, and a container that is gone by then does not come back"
                remedy = f"use at most {slots} in a sample, or more slots in {CELL_FILE}"
                mark = recipe.marks.get(f"samples.{sample.id}.{key}", sample.mark)
                problems.warn(mark, what, remedy, code="few-slots")
                break
            found[container.name if changer.kinds else ""] += 1


def _check_doubts(recipe: Recipe, lab: Lab, problems: Problems) -> None:
    _check_odds(recipe, lab, problems)
    _check_telling(recipe, lab, problems)


def _check_odds(recipe: Recipe, lab: Lab, problems: Problems) -> None:
    """Warn of samples whose powder has lumps too large for their tolerance; once for samples that are alike."""
    told, u_mg = set[tuple[str, float]](), lab.cell.balance.told_uncertainty_mg
    for sample in recipe.samples:
        for powder, tolerance_mg in sample.powder_tolerances:
            if (powder.name, tolerance_mg) in told:
                continue
            told.add((powder.name, tolerance_mg))
            if (chance := chance_with_lumps(acceptance_mg(tolerance_mg, u_mg), powder.lump_mg)) < LIKELY:
                lumps = f"{powder.name} comes in lumps of about {powder.lump_mg:g} mg"
                share = format_below(chance, LIKELY)
                what = f"only about {share} of such samples can be in tolerance (± {tolerance_mg:g} mg): {lumps}"
                remedy = "ask for a wider tolerance; `plan` shows the odds"
                problems.warn(_tolerance_mark(recipe, sample), what, remedy, code="unlikely")


def _check_telling(recipe: Recipe, lab: Lab, problems: Problems) -> None:
    """Warn of tolerances of which the balance's guard band leaves too little; once for each."""
    balance, told = lab.cell.balance, set[float]()
    for sample in recipe.samples:
        tolerance_mg = sample.least_tolerance_mg
        if tolerance_mg is None or tolerance_mg in told or not sample.flow.pours:
            continue
        told.add(tolerance_mg)
        if tolerance_mg < balance.confirmed_tolerance_mg:
            digits = f"the balance has digits of {balance.readability_mg:g} mg"
            what = f"good doses within ± {tolerance_mg:g} mg may be flagged, some or many of them: {digits}"
            remedy = f"ask for {balance.confirmed_tolerance_mg:g} mg or more, or use a balance with finer digits"
            problems.warn(_tolerance_mark(recipe, sample), what, remedy, code="hardly-told")


def _tolerance_mark(recipe: Recipe, sample: Sample) -> Mark:
    places = (recipe.marks.get(f"samples.{sample.id}.{key}") for key in ("tolerance", "mass", "compose"))
    return next(filter(None, places), Mark(str(recipe.path), 1))


def _sound(lab: Lab, errors: Collection[Problem]) -> set[str]:
    """The workflows that are free of errors, including all that they call."""
    library, trees = lab.library, lab.folder / "trees"
    wrong = {Path(problem.mark.file).stem for problem in errors if Path(problem.mark.file).parent == trees}
    calls = {name: _called(lab, name) for name in library.workflows}
    known = {*library.skills, *library.workflows}
    wrong |= {name for name, called in calls.items() if called - known}
    while more := {name for name, called in calls.items() if name not in wrong and called & wrong}:
        wrong |= more
    return set(library.workflows) - wrong


def _called(lab: Lab, name: str) -> set[str]:
    return {part.name for part in walk(lab.library.workflows[name].tree) if isinstance(part, Call)}


def _uncalled(lab: Lab) -> set[str]:
    """The workflows that no other one calls, which are meant to be run as they are."""
    workflows = lab.library.workflows
    return set(workflows).difference(*(_called(lab, name) - {name} for name in workflows))


def _check_on_failure(recipe: Recipe, lint: Lint, used: Collection[str], problems: Problems) -> None:
    library = lint.library
    trees = [library.workflows[name].tree for name in (*used, *SERVICE) if name in library.workflows]
    raised = frozenset[str]().union(*map(lint.codes, trees))
    for code in recipe.on_failure:
        mark = recipe.marks.get(f"on_failure.{code}")
        if mark is not None and code != "otherwise" and code in library.failures() and code not in raised:
            what = f"nothing in this recipe's workflows fails with {code}"
            problems.warn(mark, what, "leave it out, or look for the code that was meant", code="on-failure-never")


# --- the ways of the arm


def ways_lacking(plan: Plan, lab: Lab) -> list[Problem]:
    """The ways that a sound plan needs and the arm does not have, and where a joint would get hot."""
    problems = Problems()
    _check_ways(plan, lab, problems)
    return problems.found


def _check_ways(plan: Plan, lab: Lab, problems: Problems) -> None:
    """Find all ways between the plan's places, as a run does. Results are cached by hash."""
    key = _key(plan, lab)
    if (strained := _planned(lab).get(key)) is not None:
        _warn_of_strain(strained, lab, problems)
        return
    from scuhand_bt.run.prepared_motion import prepared_motion
    from scuhand_bt.run.ways import MortarStandsBadly, pan_in_no_zone

    try:
        motion = prepared_motion(plan, lab, for_real=True)
        strained, in_the_way = _strained(motion), [*_parked_in_zones(motion, lab), *pan_in_no_zone(motion, lab)]
    except SourceError as error:
        problems.found += error.problems
    except MortarStandsBadly as failure:
        mark = cell_mark(lab, "stations", failure.station, "position")
        problems.found.append(Problem(mark, failure.detail, "no-path"))
    except MortarCannotBeScooped as failure:
        problems.found.append(Problem(plan.recipe.marks[f"sources.{failure.source}"], failure.detail, "no-path"))
    except SkillFailed as failure:
        blocked = list(_blocked(plan, lab)) or [Problem(cell_mark(lab), failure.detail, "no-path")]
        problems.found += blocked
    else:
        problems.found += in_the_way
        if not in_the_way:
            _note_planned(lab, key, strained)
        _warn_of_strain(strained, lab, problems)


def _parked_in_zones(motion: "MotionPlanner", lab: Lab) -> Iterator[Problem]:
    """A problem for each zone in which the parked arm stands: nothing else could ever enter it."""
    for zone in sorted(motion.entered(motion.home())):
        what = f"the arm parks inside the zone '{zone}', and whatever else moves in that zone waits for it for ever"
        remedy = "move the station away from it, or make the zone no larger than what moves there"
        mark = cell_mark(lab, "stations", lab.cell.station_of_kind("park").name, "position")
        yield Problem(mark, f"{what}: {remedy}", "parked-in-zone")


def _strained(motion: "MotionPlanner") -> str:
    """Where the arm's most strained joint holds more than it should for long, as text; "" if nowhere."""
    held = {place: motion.held_at(place) for place in motion.places}
    place = max(held, key=lambda one: held[one].share)
    strain = held[place]
    if strain.share <= LONG_HELD_SHARE:
        return ""
    return (
        f"at '{place}' joint {strain.joint} of the arm holds {strain.torque_nm:.1f} N m, {strain.share:.0%} of its "
        f"servo's stall torque: it gets hot, and sags"
    )


def _warn_of_strain(strained: str, lab: Lab, problems: Problems) -> None:
    if strained:
        remedy = f"use a lighter hand, or a place nearer to the arm; up to {LONG_HELD_SHARE:.0%} can be held for long"
        problems.warn(cell_mark(lab, "hand", "mass"), strained, remedy, code="strained")


def _blocked(plan: Plan, lab: Lab) -> Iterator[Problem]:
    """A problem for each place that cannot be reached from the park station, where that place is written."""
    import numpy as np

    from scuhand_bt.motion import ApexPose
    from scuhand_bt.run.prepared_motion import places_of

    mortars = {source.station: source.mortar for source in plan.recipe.sources.values()}
    park = lab.cell.station_of_kind("park").name
    places = places_of(plan, lab)
    for name in places:
        motion = lab.motion_planner(mortars)
        try:
            for place in dict.fromkeys((park, name)):
                motion.add_place(place, ApexPose(np.array(places[place]) / 1000))
            motion.home()
            motion.prepare()
        except SkillFailed as failure:
            station = name.split("+")[0]
            mark = cell_mark(lab, "stations", station, "position")
            yield Problem(mark, f"{failure.detail}; move the station, or what is in the way", "no-path")


def _key(plan: Plan, lab: Lab) -> str:
    """A hash of everything on which the ways, and what is reported about them, depend."""
    kinds = sorted({repr(kind.kind) for sample in plan.recipe.samples for kind in sample.all_containers})
    demands = sorted(f"{demand.source!r} {demand.doses_mg} {demand.refilled_mg}" for demand in plan.demands)
    kept = sorted(kept_by_changing(lab).items())
    depends = (source_digest(), lab.urdf, lab.cell, demands, kinds, sorted(plan.descents), kept)
    return hashlib.sha256(repr(depends).encode()).hexdigest()


def _planned(lab: Lab) -> dict[str, str]:
    """The plans whose ways were found, with what was reported about each."""
    with suppress(OSError, ValueError):
        found = json.loads((state_folder(lab) / PLANNED).read_text(encoding="utf-8"))
        if isinstance(found, dict):
            return {key: said for key, said in found.items() if isinstance(said, str)}
    return {}


def _note_planned(lab: Lab, key: str, strained: str) -> None:
    """Remember a result for the next check; a read-only lab is planned again each time."""
    with suppress(OSError):
        folder = state_folder(lab)
        folder.mkdir(parents=True, exist_ok=True)
        kept = [*_planned(lab).items(), (key, strained)][-MOST_PLANNED:]
        (folder / PLANNED).write_text(json.dumps(dict(kept)), encoding="utf-8")
