"""Bowls that cannot be scooped from, or bring too little at a time, are told before a run."""

import re
from types import SimpleNamespace
from typing import Any

import pytest
from conftest import LabFolder
from ways_bench import blocked, found

from harness.own_workflow import RECIPE, write_own
from scuhand_bt import api
from scuhand_bt.failures import SkillFailed
from scuhand_bt.lab import read_lab
from scuhand_bt.run import ways
from scuhand_bt.run.checking import check

REFILLED = """recipe: refilled
workflow: fill_crucible
order: as_written
sources:
  beads: {station: mortar_bay_2, container: small_agate_mortar, powder: glass_beads, amount: 10 g}
  tio2: {station: mortar_bay, container: agate_mortar, powder: titanium_dioxide, amount: 66 g, refill: 20 g}
defaults: {container: alumina_crucible, tolerance: 5 %}
samples:
  - {id: first, source: beads, mass: 500 mg}
  - {id: many, source: tio2, mass: 14 g, repeat: 5}
"""


@pytest.fixture
def lab(lab_folder: LabFolder) -> LabFolder:
    write_own(lab_folder.folder)
    return lab_folder


def test_a_mortar_that_cannot_be_scooped_from_anywhere_is_told_where_the_recipe_names_it(lab: LabFolder) -> None:
    """No other place for its station helps, so none is looked for."""
    dish = "bore: 120 mm, depth: 10 mm, height: 45 mm, outer_diameter: 130 mm"
    lab.write("robot/containers.yaml", (lab.folder / "robot" / "containers.yaml").read_text() + f"  dish: {{{dish}}}\n")
    recipe = lab.folder / "recipes" / "one.yaml"
    recipe.write_text(re.sub(r"container: \w*agate_mortar", "container: dish", recipe.read_text()))
    (problem,) = found(lab, "no-path")
    assert problem.message.endswith("steep at its edge; a depth of 15 mm would do"), "no wider one would"
    assert problem.mark.file == str(recipe)
    assert "container: dish" in recipe.read_text().splitlines()[problem.mark.line - 1]


def test_a_mortar_that_stands_badly_and_cannot_be_scooped_from_anywhere_is_told_to_be_the_second(
    lab: LabFolder,
) -> None:
    dish = "bore: 120 mm, depth: 10 mm, height: 45 mm, outer_diameter: 130 mm"
    lab.write("robot/containers.yaml", (lab.folder / "robot" / "containers.yaml").read_text() + f"  dish: {{{dish}}}\n")
    recipe = lab.folder / "recipes" / "one.yaml"
    recipe.write_text(re.sub(r"container: \w*agate_mortar", "container: dish", recipe.read_text()))
    lab.replace("robot/cell.yaml", "[200 mm,  240 mm, 0 mm]", "[330 mm, 60 mm, 60 mm]")
    (problem,) = found(lab, "no-path")
    assert problem.message.endswith("would do")
    assert problem.mark.file == str(recipe)


def test_a_bowl_of_which_a_stroke_may_bring_next_to_nothing_is_told_before_a_run_takes_it_for_empty(
    lab: LabFolder,
) -> None:
    cup = "bore: 55 mm, depth: 18.15 mm, height: 33 mm, outer_diameter: 75 mm"
    lab.write("robot/containers.yaml", (lab.folder / "robot" / "containers.yaml").read_text() + f"  cup: {{{cup}}}\n")
    recipe = lab.folder / "recipes" / "one.yaml"
    recipe.write_text(re.sub(r"container: \w*agate_mortar", "container: cup", recipe.read_text()))
    powders = lab.folder / "robot" / "powders.yaml"
    lab.write("robot/powders.yaml", re.sub("wall_friction: .* deg", "wall_friction: 58 deg", powders.read_text()))
    (problem,) = found(lab, "no-path")
    assert re.search(
        r"a stroke brings only [\d.]+ mg of [\d.]+ m?g in this bowl, without a heap over its edge", problem.message
    )
    assert problem.mark.file == str(recipe)


@pytest.mark.parametrize(("mass", "cannot"), [("300 mg", True), ("50 mg", False)])
def test_a_bowl_that_gives_little_at_a_time_is_refused_where_that_is_less_than_what_is_needed(
    lab: LabFolder, mass: str, cannot: bool
) -> None:
    cup = "bore: 57 mm, depth: 20 mm, height: 32 mm, outer_diameter: 77 mm"
    lab.write("robot/containers.yaml", (lab.folder / "robot" / "containers.yaml").read_text() + f"  cup: {{{cup}}}\n")
    recipe = lab.folder / "recipes" / "one.yaml"
    said = re.sub(
        r"container: \w*agate_mortar, powder: glass_beads", "container: cup, powder: titanium_dioxide", RECIPE
    )
    recipe.write_text(said.replace("xrd_holder, mass: 50 mg", f"alumina_crucible, mass: {mass}"))
    told = [
        message
        for message in blocked(lab)
        if re.search(r"a stroke brings only [\d.]+ m?g of [\d.]+ m?g in this bowl", message)
    ]
    assert len(told) == cannot
    if cannot:  # not only of a run on the cell: a dry run scooped for nine minutes in vain
        with pytest.raises(SkillFailed, match=r"'\w+' cannot be scooped from: a stroke brings only .* in this bowl"):
            api.open_lab(lab.folder).dry_run(recipe, seed=1)
        assert not list((lab.folder / ".scuhand").glob("runs/*"))


def test_a_refill_that_would_fill_a_bowl_too_much_to_be_scooped_from_is_refused(lab: LabFolder) -> None:
    """At the visit for the sheet the mortar is nearly full still."""
    recipe = lab.folder / "recipes" / "one.yaml"
    recipe.write_text(REFILLED)
    (problem,) = found(lab, "no-path")
    assert re.search("'tio2' cannot be scooped from: once it is refilled, .* is nearly full with", problem.message)
    assert problem.mark.line == 6


@pytest.mark.parametrize(
    ("cup", "mass", "poor"),
    [
        ("bore: 60 mm, depth: 20 mm", "500 mg", True),
        ("bore: 60 mm, depth: 20 mm", "100 mg", False),
        ("bore: 62 mm, depth: 21 mm", "500 mg", False),
    ],
)
def test_a_bowl_of_which_doses_take_ever_more_scoops_is_warned_of(
    lab: LabFolder, cup: str, mass: str, poor: bool
) -> None:
    kinds = (lab.folder / "robot" / "containers.yaml").read_text()
    lab.write("robot/containers.yaml", kinds + f"  cup: {{{cup}, height: 34 mm, outer_diameter: 80 mm}}\n")
    said = re.sub(
        r"container: \w*agate_mortar, powder: glass_beads", "container: cup, powder: monosodium_glutamate", RECIPE
    )
    recipe = lab.folder / "recipes" / "one.yaml"
    recipe.write_text(said.replace("xrd_holder, mass: 50 mg", f"alumina_crucible, mass: {mass}"))
    problems = check(read_lab(lab.folder), recipe, fast=True).problems
    (told,) = [one for one in problems if one.code == "poor-strokes"] or [None]
    assert (told is not None) == poor
    assert told is None or (told.is_warning and told.mark.file == str(recipe))


def test_what_a_bowl_fails_by_at_one_place_is_asked_first_at_the_next(monkeypatch: pytest.MonkeyPatch) -> None:
    asked_mg, bowl = [(9e3, 3e3), (9e3, 100.0), (2e3, 3e3)], SimpleNamespace(mortar=SimpleNamespace(corner_mm=None))
    demand: Any = SimpleNamespace(source=bowl)
    found = []

    def no_last_bed(*asked: Any, at_length: bool) -> None:
        found.append(asked[3:])
        assert not at_length
        if asked[3] < 9e3:
            raise SkillFailed("arm.no_path", "no stroke")

    monkeypatch.setattr(ways, "_stroke", no_last_bed)
    nowhere: Any = None
    for _ in range(2):
        with pytest.raises(SkillFailed):
            ways._strokes_there(nowhere, nowhere, demand, asked_mg)
    assert found == [(9e3, 3e3), (9e3, 100.0), (2e3, 3e3), (2e3, 3e3)]
