"""A sample of several sources: what it takes of each, its place in the plan, and a run of it."""

import csv
import io
from pathlib import Path

import pytest
from conftest import Desk, LabFolder
from running import dry_run

from scuhand_bt.journal.reader import open_contents, read
from scuhand_bt.recipe.plan import make_plan
from scuhand_bt.recipe.sample import Sample
from scuhand_bt.report.weighing_record import weighing_csv

SOURCES = """\
sources:
  beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 5 g}
  other: {station: mortar_bay_2, container: agate_mortar, powder: {powder}, amount: 5 g}
"""
RECIPE = """\
recipe: blends
workflow: blend
order: {order}
{sources}defaults: {{container: alumina_crucible, mass: 100 mg}}
samples:
{samples}
"""
BLEND = """\
workflow: blend
inputs: {first: Source, second: Source, container: Container, mass: Mass, more: {type: Mass, default: 40 mg}}
result: $dose
tree:
  sequence:
    - place_container: {container: $container}
    - tare:
    - fill: {source: $second, container: $container, mass: $more}
    - change_powder: {source: $second}
    - tare:
    - fill: {source: $first, container: $container, mass: $mass, as: dose}
AND_THEN
"""
IN_ORDER = BLEND.replace("AND_THEN", "    - return_leftover: {source: $first}\n    - park:")
TREE_LINE = 5


def recipe(*samples: str, order: str = "as_written", powder: str = "monosodium_glutamate") -> str:
    lines = "\n".join(f"  - {{{sample}}}" for sample in samples)
    return RECIPE.format(order=order, sources=SOURCES.replace("{powder}", powder), samples=lines)


PLAIN = "workflow: scoop_and_dispense, source: beads"
MIXED = "first: beads, second: other"


@pytest.fixture
def lab(desk: Desk, lab_folder: LabFolder) -> LabFolder:
    lab_folder.write("trees/blend.yaml", IN_ORDER)
    desk.lab = lab_folder.load()
    return lab_folder


def problems_of_tree(desk: Desk, lab: LabFolder, child: str) -> list[str]:
    """What is wrong with a blend whose tree is this child, and with its sample `a`, which asks for no mass."""
    head = IN_ORDER.split("tree:")[0].replace("result: $dose\n", "")
    head = head.replace("mass: Mass", "amount: {type: Mass, default: 100 mg}")
    lab.write("trees/blend.yaml", head + f"tree:\n  {child}\n")
    desk.lab = lab.load()
    return desk.problems(a_blend())


def a_blend(powder: str = "monosodium_glutamate") -> str:
    return recipe(f"id: a, {MIXED}", powder=powder).replace(", mass: 100 mg", "")


def names(sample: Sample) -> list[str]:
    return [source.name for source in sample.sources]


@pytest.mark.usefixtures("lab")
def test_a_sample_knows_all_of_its_sources_in_the_order_in_which_its_workflow_takes_from_them(desk: Desk) -> None:
    mixed, plain, same = desk.load(
        recipe(f"id: a, {MIXED}", f"id: b, {PLAIN}", "id: c, first: beads, second: beads")
    ).samples
    assert names(mixed) == ["other", "beads"]
    assert mixed.last_source is not None
    assert mixed.last_source.name == "beads"
    assert [(take.source.name, take.mass_mg) for take in mixed.takes] == [("other", 40.0), ("beads", 100.0)]
    assert (names(plain), names(same)) == (["beads"], ["beads"])


@pytest.mark.usefixtures("lab")
def test_each_source_must_hold_what_is_taken_from_it_and_no_more(desk: Desk) -> None:
    made = make_plan(desk.load(recipe(f"id: a, {MIXED}", f"id: b, {PLAIN}", f"id: c, {MIXED}, more: 4.5 g")), desk.lab)
    demands = {demand.source.name: (demand.samples, demand.needed_mg) for demand in made.demands}
    assert demands == {"beads": (3, 360.0), "other": (2, 40.0 + 20.0 + 4500.0 + 20.0)}
    (said,) = desk.problems(recipe(f"id: a, {MIXED}, more: 5 g"))
    assert said.startswith("6:3: 'other' holds 5.0000 g of monosodium_glutamate, but its 1 sample needs 5.0")


@pytest.mark.usefixtures("lab")
def test_powders_change_from_the_last_source_of_a_sample_to_the_first_of_the_next(desk: Desk) -> None:
    made = make_plan(desk.load(recipe(f"id: a, {PLAIN}", f"id: b, {MIXED}", f"id: c, {PLAIN}")), desk.lab)
    swap = "change powder to monosodium_glutamate for b"
    assert [job.name for job in made.jobs] == ["a", swap, "b", "c", "finish the batch"]
    assert made.jobs[1].inputs["source"].name == made.jobs[-1].inputs["source"].name == "beads"
    grouped = recipe(f"id: a, {PLAIN}", f"id: b, {MIXED}", f"id: c, {PLAIN}", order="by_powder")
    assert [job.name for job in make_plan(desk.load(grouped), desk.lab).jobs][:2] == ["a", "c"]


@pytest.mark.usefixtures("lab")
def test_all_that_comes_together_must_fit_into_the_container_and_on_the_balance(desk: Desk) -> None:
    (said,) = desk.problems(recipe(f"id: a, container: xrd_holder, {MIXED}, more: 130 mg"))
    assert "100.0 mg of glass_beads" in said
    assert "130.0 mg of monosodium_glutamate and" in said
    assert "do not fit into 'xrd_holder' with the 4.0 mg more that the tolerance allows; it holds 0.20 cm³" in said
    said = desk.problems(recipe(f"id: a, {MIXED}, mass: 45 g, more: 45 g"))[-2]
    assert "'alumina_crucible' (31.0000 g) and 90.0040 g are too heavy for the balance" in said
    assert desk.problems(recipe(f"id: a, {MIXED}, more: 0 mg")) == [
        "9:48: the mass taken from 'other' is 0 mg; more than 0"
    ]


AMOUNT = "takes from one of several sources is not known before the run; dispense a written mass, an"


@pytest.mark.parametrize(
    ("child", "said"),
    [
        ("scoop: {source: $first}", f"4:3: how much 'scoop' {AMOUNT}"),
        ("sequence: [{park: }, {scoop: {source: $first}}]", f"4:25: how much 'scoop' {AMOUNT}"),
        (
            "fallback: [{fill: {source: $first, container: $container, mass: 1 g}}, "
            "{fill: {source: $second, container: $container, mass: 1 g}}]",
            "4:3: which of glass_beads, monosodium_glutamate the sheet has touched after this 'fallback' is not known "
            "before the run; use sources of one powder and lot, or a sequence",
        ),
    ],
)
def test_what_cannot_be_told_before_the_run_is_refused_where_it_is_written(
    desk: Desk, lab: LabFolder, child: str, said: str
) -> None:
    (found,) = problems_of_tree(desk, lab, child)
    assert found.startswith(said)


def test_a_mass_that_is_measured_only_in_the_run_is_refused(desk: Desk, lab: LabFolder) -> None:
    fill = "fill: {source: $first, container: $container, mass: $gross}"
    (found,) = problems_of_tree(desk, lab, f"sequence: [{{tare: {{as: gross}}}}, {{{fill}}}]")
    assert f"how much 'fill' {AMOUNT}" in found


PICK = """
from scuhand_bt.skill import Cell, Skill, Source, Steps


class Pick(Skill[Source]):
    \"\"\"Pick a source.\"\"\"

    source: Source

    def run(self, cell: Cell) -> Steps[Source]:
        yield from ()
        return self.source
"""


def test_a_source_that_is_picked_only_in_the_run_is_refused(desk: Desk, lab: LabFolder) -> None:
    lab.write("skills/pick.py", PICK)
    fill = "{fill: {source: $one, container: $container, mass: 1 g}}"
    (found,) = problems_of_tree(desk, lab, f"sequence: [{{pick: {{source: $first, as: one}}}}, {fill}]")
    where, what = found.split(": ", 1)
    assert where == "4:57"
    assert what == ("which source 'fill' gets is not known before the run: $one; use an input of this workflow")


def test_how_often_a_dose_is_repeated_needs_not_be_known_as_it_counts_what_is_there(desk: Desk, lab: LabFolder) -> None:
    lab.write("skills/pick.py", PICK.replace("Skill[Source]", "Skill[int]").replace("Steps[Source]", "Steps[int]"))
    fill = "{fill: {source: $first, container: $container, mass: 1 g}}"
    tree = f"sequence: [{{pick: {{source: $first, as: n}}}}, {{repeat: {{times: $n, child: {fill}}}}}]"
    assert problems_of_tree(desk, lab, tree) == []
    (sample,) = desk.load(a_blend()).samples
    assert [(take.source.name, take.mass_mg) for take in sample.takes] == [("beads", 1000.0)]


def test_one_lot_in_two_mortars_may_be_taken_from_either(desk: Desk, lab: LabFolder) -> None:
    fills = [f"{{fill: {{source: ${name}, container: $container, mass: $amount}}}}" for name in ("first", "second")]
    problems_of_tree(desk, lab, f"fallback: [{', '.join(fills)}]")
    (sample,) = desk.load(a_blend("glass_beads")).samples
    assert [(take.source.name, take.mass_mg) for take in sample.takes] == [("beads", 100.0), ("other", 100.0)]


def test_a_workflow_of_one_source_takes_its_mass_however_it_does_that(desk: Desk, lab: LabFolder) -> None:
    tree = "workflow: bare\ninputs: {source: Source, mass: Mass}\ntree:\n  dispense: {mass: $mass}\n"
    lab.write("trees/bare.yaml", tree)
    desk.lab = lab.load()
    (sample,) = desk.load(recipe("id: a, workflow: bare, source: beads, mass: 5.01 g").replace("5 g", "9 g", 1)).samples
    assert [(take.source.name, take.mass_mg, take.needed_mg) for take in sample.takes] == [("beads", 5010.0, 5050.0)]


def test_a_mass_by_default_is_taken_and_a_fallback_may_take_two_lots_in_one_way(desk: Desk, lab: LabFolder) -> None:
    inputs = "inputs: {source: Source, mass: {type: Mass, default: 7 mg}}"
    pinch = f"workflow: pinch\n{inputs}\ntree:\n  dispense: {{mass: $mass}}\n"
    lab.write("trees/pinch.yaml", pinch)
    both = "{sequence: [{pinch: {source: $first}}, {pinch: {source: $second}}]}"
    assert problems_of_tree(desk, lab, f"fallback: [{both}, {{discard: }}]") == []
    (sample,) = desk.load(a_blend()).samples
    assert [(take.source.name, take.mass_mg) for take in sample.takes] == [("beads", 7.0), ("other", 7.0)]


def test_what_is_repeated_into_one_container_is_taken_once_as_a_dose_counts_what_is_there(
    desk: Desk, lab: LabFolder
) -> None:
    fill = "{fill: {source: $second, container: $container, mass: $amount}}"
    assert problems_of_tree(desk, lab, f"repeat: {{times: 3, child: {fill}}}") == []
    (sample,) = desk.load(a_blend()).samples
    assert [(take.source.name, take.mass_mg) for take in sample.takes] == [("other", 100.0)]
    assert names(sample) == ["other", "beads"]


def test_a_wrong_workflow_of_several_sources_is_said_where_it_stands_and_ends_nothing(
    desk: Desk, lab: LabFolder
) -> None:
    (found,) = problems_of_tree(desk, lab, "sequence: [{park: }, {scop: {source: $first}}]")
    assert "unknown skill or workflow 'scop'" in found


def test_a_blend_is_dosed_from_both_sources(tmp_path: Path, lab: LabFolder) -> None:
    ran = dry_run(tmp_path, recipe(f"id: a, {MIXED}", f"id: b, {PLAIN}"), lab=lab.folder, controller="adaptive")
    assert ran.result.exit_code == 0
    assert ran.session.world is not None
    held_mg = ran.session.world.masses_mg
    assert held_mg["container:a"] == pytest.approx(140.0, abs=8.0)
    assert held_mg["container:b"] == pytest.approx(100.0, abs=5.0)
    assert (held_mg["returned"], held_mg["spilled"]) == (0.0, 0.0)


ONE_TARE = IN_ORDER.replace("    - tare:\n    - fill: {source: $first", "    - fill: {source: $first")


def test_two_powders_into_one_crucible_need_one_tare_and_each_is_measured_by_itself(
    tmp_path: Path, lab: LabFolder
) -> None:
    assert ONE_TARE.count("tare:") == 1
    lab.write("trees/blend.yaml", ONE_TARE)
    ran = dry_run(tmp_path, recipe(f"id: a, {MIXED}"), lab=lab.folder)
    had = ran.sample("a")
    rows = [(dose.container, dose.lot, dose.target_mg, dose.bracket, dose.verdict) for dose in had.doses]
    assert rows == [
        ("a", "monosodium_glutamate", 40.0, "closed", "in tolerance"),
        ("a", "glass_beads", 100.0, "closed", "in tolerance"),
    ]
    assert (had.target_mg, had.dispensed_mg, had.is_good) == (100.0, had.doses[1].dispensed_mg, True)
    assert ran.session.world is not None
    true_mg = ran.session.world.masses_mg["container:a"]
    assert true_mg == pytest.approx(140.0, abs=4.0)
    assert true_mg == pytest.approx(sum(dose.dispensed_mg for dose in had.doses), abs=1.0)
    with open_contents(ran.journal) as contents:
        written = list(csv.DictReader(io.StringIO(weighing_csv(contents))))
    brackets = [row for row in written if row["weighing"] == "result"]
    assert [(row["source"], row["powder"], row["target_mg"]) for row in brackets] == [
        ("other", "monosodium_glutamate", "40.0000"),
        ("beads", "glass_beads", "100.0000"),
    ]
    assert [float(row["net_mg"]) for row in brackets] == pytest.approx(
        [dose.dispensed_mg for dose in had.doses], abs=1e-3
    )
    for row in written:
        if row["weighing"] == "dose":
            net_mg = float(row["gross_mg"]) - float(row["tare_mg"]) - float(row["drift_mg"])
            assert net_mg + float(row["earlier_mg"]) == pytest.approx(float(row["net_mg"]), abs=1e-3)


@pytest.mark.slow
def test_after_a_failure_the_cone_is_emptied_into_the_source_that_it_was_filled_from(
    tmp_path: Path, lab: LabFolder
) -> None:
    lab.write("trees/blend.yaml", BLEND.replace("AND_THEN", "    - cone_holds: {powder: $second.powder}"))
    text = recipe(f"id: a, {MIXED}") + "on_failure: {otherwise: flag}\n"
    ran = dry_run(tmp_path, text, lab=lab.folder)
    assert ran.sample("a").code == "hand.wrong_powder"
    assert [row["name"] for row in read(ran.journal, "job")][:2] == ["a", "after a with beads"]
    assert ran.session.world is not None
    assert ran.session.world.masses_mg["returned"] == 0.0
    assert ran.session.cell.believed.cone_source is None
    assert ran.session.world.masses_mg["waste"] < 10.0


def test_what_the_cone_holds_of_one_lot_is_not_dosed_as_another_lot_of_the_powder(
    tmp_path: Path, lab: LabFolder
) -> None:
    change = "    - change_powder: {source: $second}\n    - tare:\n"
    without = IN_ORDER.replace(change, "").replace("leftover: {source: $first}", "leftover: {source: $second}")
    lab.write("trees/blend.yaml", without)
    text = recipe(f"id: a, {MIXED}", powder="glass_beads, lot: B")
    ran = dry_run(tmp_path, text, lab=lab.folder)
    assert ran.sample("a").code == "hand.wrong_powder"
    assert ran.session.world is not None
    assert ran.session.world.masses_mg["container:a"] == pytest.approx(40.0, abs=4.0), "and no more of lot B"
