"""Plans: the order of the jobs, the sheet swaps, what is needed and who."""

import json
from pathlib import Path

import pytest
from conftest import Call, Desk, LabFolder
from running import dry_run

from scuhand_bt.problems import Problems
from scuhand_bt.recipe.plan import Plan, make_plan
from scuhand_bt.recipe.recipe import load_recipe, read_recipe
from scuhand_bt.run.operator import ANSWER_S

TWO = """\
recipe: two
workflow: scoop_and_dispense
{order}
sources:
  beads: {{station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 5 g}}
  msg: {{station: mortar_bay_2, container: agate_mortar, powder: {second}}}
defaults: {{container: xrd_holder, mass: 50 mg}}
samples:
  - {{id: a, source: beads}}
  - {{id: b, source: msg}}
  - {{id: c, source: beads}}
"""


def plan_of(desk: Desk, order: str = "order: by_powder", second: str = "monosodium_glutamate, amount: 5 g") -> Plan:
    return make_plan(desk.load(TWO.format(order=order, second=second)), desk.lab)


def test_samples_are_grouped_by_powder_with_a_swap_between(desk: Desk) -> None:
    plan = plan_of(desk)
    names = [job.name for job in plan.jobs]
    assert names == ["a", "c", "change powder to monosodium_glutamate for b", "b", "finish the batch"]
    assert plan.swaps == 1
    assert plan.jobs[2].inputs["source"].name == "beads"


def test_as_written_keeps_the_order_and_swaps_as_often_as_it_must(desk: Desk) -> None:
    plan = plan_of(desk, order="order: as_written")
    assert [job.sample.id for job in plan.jobs if job.sample] == ["a", "b", "c"]
    assert plan.swaps == 2


@pytest.mark.parametrize("leftover", ["keep", "return"])
def test_a_sample_of_a_loaded_cone_is_forecast_without_a_scoop_and_without_a_return_of_what_is_kept(
    desk: Desk, leftover: str
) -> None:
    """XRD holders, 33 s each, were forecast to take 53: the time left of a run was told half as much too long."""
    order = f"order: by_powder\nleftover: {leftover}"
    recipe = TWO.format(order=order, second="monosodium_glutamate, amount: 5 g").replace(
        "workflow: scoop_and_dispense", "workflow: fill_xrd_holder"
    )
    took = ["place_container", "tare", "move_over", "park"]
    took += ["return_leftover"] if leftover == "return" else []
    plan = make_plan(desk.load(recipe), desk.lab)
    asked = {"source": plan.recipe.sources["beads"], "mass": 50.0, "tolerance": 2.0}
    dose_s = desk.lab.library.skills["dispense"].forecast(asked, desk.lab.cell).duration_s
    expected_s = sum(desk.lab.library.skills[name].typical_s for name in took) + dose_s
    assert plan.done_s["a"] == pytest.approx(expected_s)


@pytest.mark.parametrize("skill", ["swap_sheet", "refill_mortar", "ask_operator"])
def test_a_person_is_forecast_to_take_as_long_as_one_takes_in_a_dry_run(desk: Desk, skill: str) -> None:
    """With twice as much for a sheet the time left of mixtures was told 1.4 times too long by their plan's own runs."""
    assert desk.lab.library.skills[skill].forecast({}, desk.lab.cell).duration_s == ANSWER_S


def dose_s(desk: Desk, powder: str, mass: str, tolerance: str = "10 mg") -> float:
    """What a sample is told to take beyond one of the least mass of beads."""

    def of_sample_s(powder: str, mass: str, tolerance: str) -> float:
        source = f"{{station: mortar_bay, container: agate_mortar, powder: {powder}, amount: 20 g}}"
        sample = f"{{id: a, source: one, container: alumina_crucible, mass: {mass}, tolerance: {tolerance}}}"
        recipe = f"recipe: r\nworkflow: fill_crucible\nsources: {{one: {source}}}\nsamples: [{sample}]\n"
        return make_plan(desk.load(recipe), desk.lab).done_s["a"]

    return of_sample_s(powder, mass, tolerance) - of_sample_s("glass_beads", "20 mg", "10 mg")


def test_a_dose_is_forecast_by_its_mass_its_powders_flow_and_its_tolerance(desk: Desk) -> None:
    """Crucibles with titanium dioxide were told to take 35 s; dry runs take 75 to 128 s for 1 g, 226 to 245 for 3 g."""
    assert 50.0 < dose_s(desk, "titanium_dioxide", "1 g") < 100.0
    assert 145.0 < dose_s(desk, "titanium_dioxide", "3 g") < 220.0
    assert 0.0 < dose_s(desk, "glass_beads", "1 g") < 25.0
    assert dose_s(desk, "titanium_dioxide", "1 g", "2 mg") > 1.1 * dose_s(desk, "titanium_dioxide", "1 g")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("powder", "masses"), [("titanium_dioxide", "[100 mg, 1 g, 2.5 g]"), ("glass_beads", "[100 mg, 1 g, 6 g]")]
)
def test_a_dry_run_takes_what_its_plan_has_told(tmp_path: Path, powder: str, masses: str) -> None:
    source = f"{{station: mortar_bay, container: agate_mortar, powder: {powder}, amount: 20 g}}"
    sample = f"{{id: [a, b, c], source: one, container: alumina_crucible, mass: {masses}, tolerance: 10 mg}}"
    recipe = f"recipe: r\nworkflow: fill_crucible\nsources: {{one: {source}}}\nsamples: [{sample}]\n"
    ran = dry_run(tmp_path, recipe, controller=None, seed=1)
    assert 1 / 1.5 < ran.result.duration_s / ran.session.plan.duration_s < 1.5


def test_of_a_mixture_each_dose_is_forecast_by_its_own_powder(desk: Desk, lab_folder: LabFolder) -> None:
    def told_s(first: str, second: str) -> float:
        recipe = f"""recipe: mixed
workflow: both
sources:
  {first}: {{station: mortar_bay, container: agate_mortar, powder: titanium_dioxide, amount: 12 g}}
  {second}: {{station: mortar_bay_2, container: agate_mortar, powder: glass_beads, amount: 12 g}}
samples: [{{id: m, first: a, second: b, container: alumina_crucible, mass: 2 g, small: 50 mg, tolerance: 5 mg}}]
"""
        return make_plan(load_recipe(lab_folder.write("recipes/mixed.yaml", recipe), lab), lab).done_s["m"]

    lab_folder.write("trees/both.yaml", BOTH)
    lab = lab_folder.load()
    assert told_s("a", "b") > told_s("b", "a") + 30.0, "the first of both is the large one"


BOTH = """workflow: both
inputs: {first: Source, second: Source, container: Container, mass: Mass, small: Mass, tolerance: Mass}
result: $dose
tree:
  sequence:
    - place_container: {container: $container}
    - tare:
    - fill: {source: $first, container: $container, mass: $mass, tolerance: $tolerance, as: dose}
    - change_powder: {source: $first}
    - fill: {source: $second, container: $container, mass: $small, tolerance: $tolerance}
    - return_leftover: {source: $second}
    - park:
"""


def test_every_job_has_a_name_of_its_own(desk: Desk) -> None:
    again = TWO.replace("id: c", "id: finish").format(
        order="order: as_written", second="monosodium_glutamate, amount: 5 g"
    )
    plan = make_plan(desk.load(again + "  - {id: d, source: msg}\n"), desk.lab)
    assert plan.swaps == 3
    assert len({job.name for job in plan.jobs}) == len(plan.jobs)


def test_two_lots_of_one_powder_need_two_sheets_and_one_lot_in_two_mortars_one(desk: Desk) -> None:
    two_lots = plan_of(desk, second="glass_beads, amount: 5 g, lot: B")
    assert two_lots.swaps == 1
    assert "change powder to glass_beads/B for b" in [job.name for job in two_lots.jobs]
    assert plan_of(desk, second="glass_beads, amount: 5 g").swaps == 0


def test_the_plan_says_what_each_source_must_hold(desk: Desk) -> None:
    demands = {demand.source.name: (demand.samples, demand.needed_mg) for demand in plan_of(desk).demands}
    assert demands == {"beads": (2, 140.0), "msg": (1, 70.0)}


def test_the_plan_lists_every_moment_that_needs_a_person(desk: Desk, lab_folder: LabFolder) -> None:
    assert [person.what for person in plan_of(desk).persons] == ["swap the sheet (two screws), wipe rollers and clamp"]
    lab_folder.replace("robot/cell.yaml", "driver: carousel", "driver: operator")
    desk.lab = lab_folder.load()
    by_hand = [person.what for person in plan_of(desk).persons]
    assert by_hand[:2] == ["put xrd_holder 'a' on the pan", "put xrd_holder 'c' on the pan"]
    assert by_hand[-1] == "take the container off the pan"


def test_a_plan_is_warned_of_what_check_warns_of_its_samples(lab_folder: LabFolder, command: Call) -> None:
    recipe = """recipe: lumps
workflow: scoop_and_dispense
sources: {{m: {{station: mortar_bay, container: agate_mortar, powder: titanium_dioxide, amount: 5 g}}}}
samples: [{{id: a, source: m, container: xrd_holder, mass: 60 mg, tolerance: 4.13 mg}}]{meant}
"""
    path = lab_folder.write("recipes/lumps.yaml", recipe.format(meant=""))
    (checked,) = json.loads(command("check", path, "--fast", "--json").stdout)["problems"]
    assert checked["code"] == "unlikely"
    assert "about 89.6% of such samples can be in tolerance" in checked["message"], "it is warned of below 90 %"
    assert json.loads(command("plan", path, "--trials", 0, "--json").stdout)["problems"] == [checked]
    line = command("check", path, "--fast").stdout.splitlines()[0]
    assert line in command("plan", path, "--trials", 0).stdout.splitlines()
    lab_folder.write("recipes/lumps.yaml", recipe.format(meant="  # ok: unlikely"))
    assert json.loads(command("plan", path, "--trials", 0, "--json").stdout)["problems"] == []


def test_the_plan_as_json_has_the_masses_of_all_powders_of_a_sample(lab_folder: LabFolder, command: Call) -> None:
    recipe = """recipe: mix
workflow: weigh_in
sources:
  a: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 5 g}
  b: {station: mortar_bay_2, container: agate_mortar, powder: monosodium_glutamate, amount: 5 g}
samples:
  - {id: x, sources: [a, b], first: a, masses: [1 g, 50 mg], tolerances: [9 mg, 2.5 mg], container: alumina_crucible}
  - {id: y, workflow: fill_crucible, source: b, mass: 60 mg, tolerance: 5 %, container: alumina_crucible}
"""
    path = lab_folder.write("recipes/mix.yaml", recipe)
    jobs = {job["name"]: job for job in json.loads(command("plan", path, "--trials", 0, "--json").stdout)["jobs"]}
    asked = {name: (job["masses_mg"], job["tolerances_mg"]) for name, job in jobs.items() if job["sample"]}
    assert asked == {"x": ([1000.0, 50.0], [9.0, 2.5]), "y": ([60.0], [3.0])}


def test_a_repeated_request_is_one_line_and_its_time_counts_each_time(desk: Desk, lab_folder: LabFolder) -> None:
    before_s = plan_of(desk).duration_s
    lab_folder.replace(
        "trees/finish_batch.yaml",
        "    - park:",
        "    - repeat: {times: 1000000000, child: {ask_operator: {question: Press}}}",
    )
    desk.lab = lab_folder.load()
    plan = plan_of(desk)
    assert plan.persons[-1].what == "Press (1000000000 times)"
    assert plan.duration_s > before_s + 1e9


def test_a_lab_without_the_workflow_between_powders_is_told_so(desk: Desk, lab_folder: LabFolder) -> None:
    for name in ("change_powder", "clear_and_change_powder"):
        (lab_folder.folder / "trees" / f"{name}.yaml").unlink()
    desk.lab = lab_folder.load()
    assert desk.problems(TWO.format(order="", second="monosodium_glutamate, amount: 5 g")) == []
    try:
        plan_of(desk)
    except Exception as error:
        said = str(error)
    assert "the workflow 'change_powder' is missing; this plan needs it to change powders" in said


@pytest.mark.parametrize(("driver", "called"), [("carousel", "clear_and_change_powder"), ("operator", "change_powder")])
def test_between_two_powders_the_pan_is_cleared_unless_a_person_would_have_to(
    desk: Desk, lab_folder: LabFolder, driver: str, called: str
) -> None:
    cell = lab_folder.folder / "robot" / "cell.yaml"
    cell.write_text(cell.read_text("utf-8").replace("driver: carousel", f"driver: {driver}"), "utf-8")
    desk.lab = lab_folder.load()
    assert desk.problems(TWO.format(order="", second="monosodium_glutamate, amount: 5 g")) == []
    plan = plan_of(desk)
    assert [job.workflow for job in plan.jobs if job.name.startswith("change")] == [called]
    assert plan.swaps == 1


def test_a_forecast_that_breaks_is_said_where_the_skill_is_called(desk: Desk, lab_folder: LabFolder) -> None:
    lab_folder.replace(
        "skills/park.py",
        "    def run",
        "    @classmethod\n    def forecast(cls, inputs, cell):\n        return 1 / 0\n\n    def run",
    )
    desk.lab = lab_folder.load()
    try:
        plan_of(desk)
    except Exception as error:
        said = str(error)
    assert "scoop_and_dispense.yaml:11:7: the forecast of 'park' failed: ZeroDivisionError" in said


DISCARDING = """
recipe: discarding
workflow: fill_crucible
leftover: discard
sources: {beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 3 g}}
defaults: {source: beads, container: alumina_crucible, tolerance: 5 mg}
samples: [{id: a, mass: 300 mg, repeat: 4}]
"""


LENDING = """
recipe: lending
workflow: fill_pellet_die
leftover: keep
sources:
  one: {station: mortar_bay, container: agate_mortar, powder: glass_beads, lot: A, amount: 2.2 g}
  other: {station: mortar_bay_2, container: agate_mortar, powder: glass_beads, lot: A, amount: 3 g}
defaults: {source: one, container: pellet_die_13mm, tolerance: 10 mg, mass: 500 mg}
samples: [{id: a}, {id: b, source: other}, {id: c, repeat: 3}]
"""


@pytest.mark.parametrize(
    ("old", "new", "lent"),
    [
        ("", "", "520.0 mg"),
        ("amount: 2.2 g", "amount: 2.7 g", None),
        ("amount: 2.2 g", "amount: 2.2 g, refill: 2 g", None),
        ("leftover: keep", "leftover: return", None),
        ("leftover: keep\n", "", "520.0 mg"),
        ("workflow: fill_pellet_die", "workflow: scoop_and_dispense", "520.0 mg"),
        ("workflow: fill_pellet_die\nleftover: keep\n", "workflow: scoop_and_dispense\n", None),
        ("workflow: fill_pellet_die", "workflow: fill_vial", None),  # returns it, whatever is wished; `fill` never does
        ("workflow: fill_pellet_die\nleftover: keep", "workflow: fill\nleftover: return", "520.0 mg"),
        ("glass_beads, lot: A, amount: 3", "glass_beads, lot: B, amount: 3", None),
        ("{id: a}, {id: b, source: other}", "{id: b, source: other}, {id: a}", None),
        ("{id: b, source: other}, {id: c, repeat: 3}", "{id: c, repeat: 3}, {id: b, source: other}", None),
    ],
)
def test_a_mortar_whose_kept_powder_may_go_to_samples_of_another_of_its_lot_is_warned_of(
    desk: Desk, old: str, new: str, lent: str | None
) -> None:
    problems = Problems()
    read_recipe(desk.write("recipe.yaml", LENDING.replace(old, new) if old else LENDING), desk.lab, problems)
    assert not problems.errors
    told = [problem.message for problem in problems.found if problem.code == "source-lent"]
    assert len(told) == (lent is not None)
    assert lent is None or f"another source of this lot, up to {lent}: it may run out" in told[0]


@pytest.mark.parametrize(
    ("old", "new", "gone"),
    [
        ("", "", "2.4 g"),  # 2 x 300 mg and 0.5 g, less what is dosed, after three of them
        ("amount: 3 g", "amount: 6 g", None),
        ("powder: glass_beads, amount: 3 g", "powder: titanium_dioxide, amount: 4.5 g", "3.9 g"),  # and 1 g
        ("repeat: 4", "repeat: 1", None),
        ("leftover: discard\n", "", None),
        ("leftover: discard", "leftover: return", None),
        ("amount: 3 g", "amount: 3 g, refill: 3 g", None),
        ("mass: 300 mg, repeat: 4", "mass: 700 mg, repeat: 3", "2.4 g"),
    ],
)
def test_a_mortar_that_may_run_out_as_powder_is_discarded_is_warned_of(
    desk: Desk, old: str, new: str, gone: str | None
) -> None:
    problems = Problems()
    read_recipe(desk.write("recipe.yaml", DISCARDING.replace(old, new) if old else DISCARDING), desk.lab, problems)
    assert not problems.errors
    told = [problem.message for problem in problems.found if problem.code == "source-discarded"]
    assert len(told) == (gone is not None)
    assert gone is None or f"about {gone} are discarded before the last one" in told[0]
