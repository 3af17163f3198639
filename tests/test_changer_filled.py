"""A changer that is filled in the plan's order: what a sample that is done once more does to all behind it."""

from pathlib import Path

import pytest
from conftest import LabFolder
from running import dry_run

from scuhand_bt.journal.reader import open_contents
from scuhand_bt.recipe.plan import make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.report.changer import changer_lines, slots_taken
from scuhand_bt.report.weighing_record import weighing_rows
from scuhand_bt.run.checking import check

RECIPE = """\
recipe: filled
workflow: scoop_and_dispense
sources: {beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 20 g}}
defaults: {source: beads, container: pellet_die_13mm, mass: 100 mg}
samples: [{id: a}, {id: b}, {id: c, container: alumina_crucible}, {id: d}]
"""
REDO = "on_failure: {dose.overshoot: redo, otherwise: stop}\n"
ASK = "on_failure: {dose.overshoot: flag, otherwise: ask}\n"
ALIKE = RECIPE.replace("alumina_crucible", "pellet_die_13mm")
BY_KIND = "{pellet_die_13mm: 4, alumina_crucible: 4}"
BY_HAND = "changer: {driver: operator}"


def with_changer(lab: LabFolder, slots: str) -> None:
    if slots == BY_HAND:
        lab.replace("robot/cell.yaml", "changer: {driver: carousel, slots: 24}", slots)
    else:
        lab.replace("robot/cell.yaml", "slots: 24", f"slots: {slots}")


@pytest.mark.parametrize(
    ("recipe", "slots", "said"),
    [
        (RECIPE, "24", ["in the order of the jobs: 2 pellet_die_13mm, 1 alumina_crucible, 1 pellet_die_13mm."]),
        (ALIKE + REDO, "24", ["in the order of the jobs: 4 pellet_die_13mm.", "put spare ones behind the last."]),
        (ALIKE + ASK, "24", ["in the order of the jobs: 4 pellet_die_13mm.", "put spare ones behind the last."]),
        (RECIPE, "3", ["the jobs, at first 3 of 4: 2 pellet_die_13mm, 1 alumina_crucible."]),
        (
            RECIPE,
            "{pellet_die_13mm: 2, alumina_crucible: 4}",
            ["each kind in its slots: 2 of 3 pellet_die_13mm, 1 alumina_crucible."],
        ),
        (RECIPE, "{pellet_die_13mm: 3, alumina_crucible: 1}", ["in its slots: 3 pellet_die_13mm, 1 alumina_crucible."]),
        (RECIPE, "4", ["in the order of the jobs: 2 pellet_die_13mm, 1 alumina_crucible, 1 pellet_die_13mm."]),
        (RECIPE, BY_KIND, ["each kind in its slots: 3 pellet_die_13mm, 1 alumina_crucible."]),
        (
            RECIPE + REDO,
            BY_KIND,
            ["each kind in its slots: 3 pellet_die_13mm, 1 alumina_crucible.", "put spare ones behind each kind."],
        ),
        (RECIPE + REDO, BY_HAND, []),
    ],
)
def test_a_plan_says_how_the_changer_is_to_be_filled(
    lab_folder: LabFolder, recipe: str, slots: str, said: list[str]
) -> None:
    with_changer(lab_folder, slots)
    lab = lab_folder.load()
    plan = make_plan(load_recipe(lab_folder.write("recipes/r.yaml", recipe), lab), lab)
    lines = list(changer_lines(plan, lab.cell))
    assert len(lines) == len(said)
    assert all(line.endswith(end) for line, end in zip(lines, said, strict=True)), lines


def test_the_changer_is_filled_in_the_order_of_the_plan_and_not_of_the_recipe(lab_folder: LabFolder) -> None:
    lab = lab_folder.load()
    sources = "{msg: {station: mortar_bay_2, container: agate_mortar, powder: monosodium_glutamate, amount: 9 g}, "
    recipe = RECIPE.replace("sources: {", f"sources: {sources}").replace("{id: b}", "{id: b, source: msg}")
    plan = make_plan(load_recipe(lab_folder.write("recipes/r.yaml", recipe), lab), lab)
    (line,) = changer_lines(plan, lab.cell)
    assert line.endswith(": 1 pellet_die_13mm, 1 alumina_crucible, 2 pellet_die_13mm.")


@pytest.mark.parametrize(
    ("recipe", "slots", "line"),
    [
        (RECIPE + REDO, "24", 6),
        (RECIPE + ASK, "24", 6),
        (RECIPE, "24", None),
        (ALIKE + REDO, "24", None),
        (RECIPE + REDO, BY_KIND, None),
        (RECIPE + REDO, BY_HAND, None),
    ],
)
def test_check_warns_where_a_sample_done_once_more_shifts_containers_of_other_kinds(
    lab_folder: LabFolder, recipe: str, slots: str, line: int | None
) -> None:
    """The next sample's container was refused by its weight, and so on to the last."""
    with_changer(lab_folder, slots)
    problems = check(lab_folder.load(), lab_folder.write("recipes/r.yaml", recipe), fast=True).problems
    found = [problem for problem in problems if problem.code == "redo-shifts"]
    assert [problem.mark.line for problem in found] == ([] if line is None else [line])
    assert all("`slots: {pellet_die_13mm: …, alumina_crucible: …}`" in problem.message for problem in found)


def test_a_run_says_which_slot_each_container_came_from(tmp_path: Path) -> None:
    recipe = ALIKE.replace(", {id: c, container: pellet_die_13mm}, {id: d}", "") + REDO + "overshoot_limit: 0\n"
    ran = dry_run(tmp_path, recipe, plant="batch_bench:Gusher")
    with open_contents(ran.journal) as contents:
        assert [(slot, name) for slot, name, _ in slots_taken(contents)] == [
            ("1", "a"),
            ("2", "a#2"),
            ("3", "b"),
            ("4", "b#2"),
        ]
        rows = list(weighing_rows(contents))
    told = {(row["container"], row["container_slot"]) for row in rows if row["weighing"] in ("dose", "result")}
    assert told == {("a", 1), ("a#2", 2), ("b", 3), ("b#2", 4)}
