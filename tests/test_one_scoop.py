"""Samples whose doses come of one scoop: what `check` says where one cannot bring them all."""

from pathlib import Path

import pytest
from conftest import LabFolder, read
from running import dry_run

from scuhand_bt.lab import read_lab
from scuhand_bt.problems import Problem
from scuhand_bt.run.checking import check

RECIPE = """recipe: one
workflow: WORKFLOW
order: as_written
sources:
  beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: AMOUNT g, lot: L-1}
defaults: {source: beads, tolerance: 5 %}
samples:
"""
MINE = """workflow: mine
inputs: {source: Source, container: Container, mass: Mass, tolerance: {type: Mass, default: 5 mg}}
tree:
  sequence:
    - scoop: {source: $source, wanted: $mass}
    - place_container: {container: $container}
    - tare:
    - move_over: {container: $container}
TREE
    - return_leftover: {source: $source}
    - park:
"""
DISPENSE = "dispense: {mass: $mass, tolerance: $tolerance}"
HALF = "dispense: {mass: 0.5 * $mass, tolerance: $tolerance}"
AGAIN = f"sequence: [{{scoop: {{source: $source}}}}, {{{DISPENSE}}}]"
TWO = "containers: [alumina_crucible, alumina_crucible]"


def warned(lab: LabFolder, samples: str, workflow: str = "aliquots", amount_g: float = 20.0) -> list[Problem]:
    text = RECIPE.replace("WORKFLOW", workflow).replace("AMOUNT", f"{amount_g:g}") + samples
    recipe = lab.write("recipes/one.yaml", text)
    problems = check(read_lab(lab.folder), recipe, fast=True).problems
    assert all(problem.is_warning for problem in problems), problems
    return [problem for problem in problems if problem.code == "one-scoop"]


def test_doses_of_one_scoop_that_are_more_than_it_brings_are_warned_of_at_their_sample(lab_folder: LabFolder) -> None:
    samples = f"  - {{id: few, {TWO}, mass: 1 g}}\n  - {{id: many, {TWO}, mass: 2.5 g}}\n"
    (told,) = warned(lab_folder, samples)
    assert told.mark.line == 9
    assert told.mark.file.endswith("one.yaml")
    assert "'many' takes 2 doses (5.0000 g) from one scoop of 'beads', but of 17.9600 g" in told.message
    assert "several samples, of 1 dose each" in told.message
    assert "load limit (5.0000 g) is too small for so much at once" in told.message


def test_a_scoop_that_is_the_only_one_is_a_whole_load_though_nobody_knows_yet_what_scoops_bring(tmp_path: Path) -> None:
    """Where another may follow it is half of one, which would not be enough here."""
    text = RECIPE.replace("WORKFLOW", "aliquots").replace("AMOUNT", "20")
    ran = dry_run(tmp_path, f"{text}  - {{id: a, {TWO}, mass: 1.5 g}}\n", controller="adaptive")
    assert ran.sample("a").verdict == "in tolerance"
    (scoop,) = (row["payload"] for row in read(ran.journal, "event") if row["kind"] == "scoop")
    assert 4000.0 < scoop["expected_mg"] < 5000.0


def test_what_is_left_for_a_sample_counts_and_not_what_the_mortar_begins_with(lab_folder: LabFolder) -> None:
    """More in it would do, and does; less would bring as much at first, and not then."""
    first, then = (f"  - {{id: {name}, {TWO}, mass: 1.35 g}}\n" for name in ("first", "then"))
    assert warned(lab_folder, first, amount_g=5.6) == []
    (told,) = warned(lab_folder, first + then, amount_g=5.6)
    assert told.mark.line == 9
    assert "8.4000 g in it, or another mortar" in told.message
    assert warned(lab_folder, first + then, amount_g=8.4) == []


def test_what_is_said_to_do_does(lab_folder: LabFolder) -> None:
    (told,) = warned(lab_folder, f"  - {{id: many, {TWO}, mass: 2.5 g}}\n")
    most_mg = float(told.message.partition("doses of ")[2].split()[0]) * 1000.0
    assert warned(lab_folder, f"  - {{id: many, {TWO}, mass: {most_mg:g} mg}}\n") == []
    assert most_mg == pytest.approx(4.75e3 / 2 * 2 / 3, rel=0.01), "less the last third of a load at its limit"


@pytest.mark.parametrize(
    ("mass", "tree", "is_warned"),
    [
        ("5 g", f"    - {DISPENSE}", True),
        ("5 g", f"    - retry: {{attempts: 3, child: {{{DISPENSE}}}}}", True),
        ("5 g", f"    - retry: {{attempts: 3, child: {{{AGAIN}}}}}", False),
        ("5 g", f"    - fallback: [{{{DISPENSE}}}, {{{AGAIN}}}]", False),
        ("5 g", "    - fill: {source: $source, container: $container, mass: $mass, tolerance: $tolerance}", False),
        ("4 g", f"    - {HALF}\n    - {DISPENSE}", False),
        ("5 g", f"    - {HALF}\n    - {DISPENSE}", True),
        ("5 g", f"    - {HALF}\n    - scoop: {{source: $source}}\n    - {DISPENSE}", False),
    ],
)
def test_only_doses_that_have_no_other_scoop_must_come_of_one(
    lab_folder: LabFolder, mass: str, tree: str, is_warned: bool
) -> None:
    """A dose into a container counts what that holds."""
    lab_folder.write("trees/mine.yaml", MINE.replace("TREE", tree))
    told = warned(
        lab_folder, "  - {id: a, container: alumina_crucible, mass: MASS}\n".replace("MASS", mass), workflow="mine"
    )
    assert bool(told) == is_warned


def test_doses_of_either_way_do_not_add_up(lab_folder: LabFolder) -> None:
    """Which way is taken is known only when it runs."""
    first = "dispense: {mass: 100 mg, tolerance: $tolerance, as: dose}"
    other = f"sequence: [{{place_container: {{container: $other}}}}, {{{DISPENSE}}}]"
    tree = f"    - {first}\n    - if: {{when: $dose.dispensed > 100 mg, then: {{{DISPENSE}}}, else: {{{other}}}}}"
    mine = MINE.replace("TREE", tree).replace("container: Container,", "container: Container, other: Container,")
    lab_folder.write("trees/mine.yaml", mine)
    sample = "  - {id: a, container: alumina_crucible, other: alumina_crucible, mass: 4 g}\n"
    assert warned(lab_folder, sample, workflow="mine") == []
