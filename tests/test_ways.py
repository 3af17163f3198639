"""What `check`, and `plan`, find before a run would: ways that no pair of places tells of."""

import json
import math
import re
import sys
from collections.abc import Callable
from itertools import islice
from types import SimpleNamespace
from typing import Any

import pytest
from conftest import Call, LabFolder

from harness.own_workflow import RECIPE, TREE, write_own
from scuhand_bt import api
from scuhand_bt.bench_spec import Point
from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.dosing.ladle import LIP_GAP_MM, Stroke
from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.lab import read_lab, starter_lab
from scuhand_bt.motion import MotionPlanner
from scuhand_bt.problems import Problem
from scuhand_bt.report import directions
from scuhand_bt.run import checking, ways
from scuhand_bt.run.checking import check
from scuhand_bt.specs import Source

ROOF = "  - {name: roof, box: [20 mm, 20 mm, 6 mm], at: [340 mm, 0 mm, 180 mm]}\n"
"""So low that the cone comes under it from the side alone."""
LID = "  - {name: lid, box: [30 mm, 30 mm, 6 mm], at: [200 mm, 240 mm, 125 mm]}\n"
"""Over the middle of the mortar, above the cone as it hovers there: the handle of a cone that swings comes up to it."""

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


def stands(lab: LabFolder, what: str) -> None:
    cell = lab.folder / "robot" / "cell.yaml"
    lab.write("robot/cell.yaml", cell.read_text(encoding="utf-8") + what)


def found(lab: LabFolder, code: str) -> list[Problem]:
    problems = check(read_lab(lab.folder), lab.folder / "recipes" / "one.yaml").problems
    return [problem for problem in problems if problem.code == code]


def blocked(lab: LabFolder) -> list[str]:
    return [problem.message for problem in found(lab, "no-path")]


def line_with(lab: LabFolder, text: str) -> int:
    lines = (lab.folder / "robot" / "cell.yaml").read_text(encoding="utf-8").splitlines()
    return next(number for number, line in enumerate(lines, 1) if text in line)


def strokes_where(monkeypatch: pytest.MonkeyPatch, possible: Callable[[str, dict[str, Point]], bool]) -> None:
    """Strokes are possible where that says so, by the station's name and where all stations are; other ways all are."""

    def swing_and_out(motion: Any, cell: CellSpec, source: Source, *_: Any, is_brief: bool) -> float:
        if not possible(source.station, {name: one.position_mm for name, one in cell.stations.items()}):
            raise SkillFailed(Code.ARM_NO_PATH, "none")
        return 4.0

    monkeypatch.setattr(ways, "swing_and_out", swing_and_out)
    monkeypatch.setattr(MotionPlanner, "prepare", lambda *_: None)


@pytest.mark.slow
def test_a_way_straight_down_that_something_is_in_is_found_where_a_workflow_asks_for_one(lab: LabFolder) -> None:
    stands(lab, ROOF)
    assert blocked(lab) == [], "the place itself can be reached"
    lab.write("trees/mine.yaml", TREE.replace("mass: $mass}", "mass: $mass, from_above: 30 mm}"))
    (message,) = blocked(lab)
    assert message.startswith("the last 30 mm straight down to 'balance+")
    assert "roof" in message


def test_reach_tells_of_the_strokes_that_the_skill_makes_in_its_directions() -> None:
    """Of a tilt of 110 degrees at most: one of 75, which the skill makes nowhere, went in all of the first four."""
    lab = read_lab(starter_lab())
    skill = lab.library.skills["scoop"]
    (x_mm, y_mm, _), turns_deg = lab.cell.stations["mortar_bay"].position_mm, vars(sys.modules[skill.__module__])
    looked_at = list(islice(directions(lab, lab.library.powders["glass_beads"]), 5))
    of_skill = sorted((math.degrees(math.atan2(y_mm, x_mm)) + deg) % 360.0 for deg in turns_deg["HEADINGS_DEG"])
    assert [one.heading_deg for one in looked_at] == pytest.approx(of_skill[:5])
    assert [one.first_s is not None for one in looked_at] == [False, False, False, False, True]
    assert [bool(one.why_not) for one in looked_at] == [True, True, True, True, False]


def test_a_park_in_a_zone_is_told_where_it_is_as_no_container_would_ever_come(
    lab: LabFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    strokes_where(monkeypatch, lambda *_: True)
    cell = (lab.folder / "robot" / "cell.yaml").read_text(encoding="utf-8")
    lab.write("robot/cell.yaml", re.sub(r"(name: pan, .*)}", r"\1, yaw: 30 deg}", cell))
    for _ in range(2):  # a check that passed is remembered
        (problem,) = found(lab, "parked-in-zone")
        assert "zone 'pan'" in problem.message
        assert problem.mark.line == line_with(lab, "park: ")


def test_a_zone_of_the_changer_that_is_not_about_the_pan_is_told(
    lab: LabFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a wrong sign in its place nothing kept the arm from where containers come and go, and nobody said so."""
    strokes_where(monkeypatch, lambda *_: True)
    cell = (lab.folder / "robot" / "cell.yaml").read_text(encoding="utf-8")
    assert not found(lab, "pan-in-no-zone")
    behind = re.sub(r"(name: pan, .* at: \[)345 mm", r"\1-345 mm", cell)
    lab.write("robot/cell.yaml", behind)
    for _ in range(2):  # a check that passed is remembered
        (problem,) = found(lab, "pan-in-no-zone")
        assert "the zones that discard_container, place_container, remove_container leases (pan)" in problem.message
        assert problem.mark.line == line_with(lab, "name: pan")
    lab.write("robot/cell.yaml", re.sub(r"changer: .*", "changer: {driver: operator}", behind))
    assert not found(lab, "pan-in-no-zone"), "while a person changes containers the arm stands still"


def test_a_skill_that_commands_the_changer_and_leases_a_zone_elsewhere_is_told_also_after_a_check_that_passed(
    lab: LabFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    """That others lease the right one kept nobody out of the pan while this one brought a container."""
    strokes_where(monkeypatch, lambda *_: True)
    cell = (lab.folder / "robot" / "cell.yaml").read_text(encoding="utf-8")
    door = "  - {name: door, box: [50 mm, 50 mm, 50 mm], at: [-200 mm, 300 mm, 40 mm]}\n"
    lab.write("robot/cell.yaml", cell.replace("geometry:\n", door + "geometry:\n"))
    assert not found(lab, "pan-in-no-zone")
    skill = (lab.folder / "skills" / "remove_container.py").read_text(encoding="utf-8")
    lab.write("skills/clear_pan.py", skill.replace("RemoveContainer", "ClearPan").replace('("pan",)', '("door",)'))
    (problem,) = found(lab, "pan-in-no-zone")
    assert "the zones that clear_pan leases (door)" in problem.message


@pytest.mark.parametrize(
    ("leased", "zones", "entered", "is_told"),
    [
        ({"changer": "pan"}, ("pan",), {"pan"}, False),
        ({"changer": "pan", "arm": "rack"}, ("pan", "rack"), {"rack"}, True),
        ({"changer": "pan"}, (), set[str](), False),
        ({"arm": "rack"}, ("rack",), set[str](), False),
    ],
)
def test_only_zones_that_the_cell_has_and_the_changer_keeps_have_to_be_about_the_pan(
    leased: dict[str, str], zones: tuple[str, ...], entered: set[str], is_told: bool, lab: LabFolder
) -> None:
    """A lab that does one thing after the other needs no zone, and `check` then tells of none."""
    own = lab.load()
    skills = {name: SimpleNamespace(devices=(name,), zones=(zone,)) for name, zone in leased.items()}
    of_lab = {**vars(own), "library": SimpleNamespace(skills=skills), "cell": own.cell.model_copy(update={"zones": []})}
    of_lab["cell"].zones.extend(SimpleNamespace(name=name) for name in zones)
    motion = SimpleNamespace(
        places=["park", "balance+6mm"],
        standing_at=lambda place: place,
        entered=lambda at: frozenset(entered if at.startswith("balance") else ()),
    )
    told = ways.pan_in_no_zone(motion, SimpleNamespace(**of_lab))  # type: ignore[arg-type]
    assert bool(list(told)) == is_told


def test_a_pass_of_a_program_that_did_not_look_for_it_hides_nothing(
    lab: LabFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    strokes_where(monkeypatch, lambda *_: True)
    cell = (lab.folder / "robot" / "cell.yaml").read_text(encoding="utf-8")
    lab.write("robot/cell.yaml", re.sub(r"(name: pan, .*)}", r"\1, yaw: 30 deg}", cell))
    with monkeypatch.context() as before:
        before.setattr(checking, "source_digest", lambda: "another source of the same version")
        before.setattr(checking, "_parked_in_zones", lambda *_: ())
        assert not found(lab, "parked-in-zone"), "it passes, and that is remembered"
        assert not found(lab, "parked-in-zone")
    (problem,) = found(lab, "parked-in-zone")
    assert "zone 'pan'" in problem.message


@pytest.mark.slow
def test_a_mortar_over_which_the_arm_can_stand_but_in_which_it_can_make_no_stroke_is_found(lab: LabFolder) -> None:
    stands(lab, LID)
    (problem,) = found(lab, "no-path")
    assert problem.message.startswith("at 'mortar_bay' no stroke is possible in any direction")
    assert "lid" in problem.message
    assert problem.mark.file.endswith("cell.yaml")
    assert problem.mark.line == line_with(lab, "mortar_bay: ")


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


def test_the_stroke_for_the_smallest_dose_is_looked_at_beside_the_deepest(
    lab: LabFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One that leaves a thicker layer has the arm higher: a recipe passed, and its first dose of 36 mg was lost."""
    gaps_mm, recipe = list[float](), lab.folder / "recipes" / "one.yaml"
    recipe.write_text(re.sub(r"amount: \d+ g", "amount: 20 g", recipe.read_text()))

    def noted(motion: Any, cell: Any, source: Any, stroke: Stroke, *, is_brief: bool) -> float:
        gaps_mm.append(stroke.gap_mm)
        return 4.0

    monkeypatch.setattr(ways, "swing_and_out", noted)
    assert blocked(lab) == []
    first_mm, smallest_mm, *_ = gaps_mm
    assert smallest_mm > first_mm > LIP_GAP_MM


@pytest.mark.slow
def test_where_no_stroke_is_possible_no_way_between_places_is_polished(
    lab: LabFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither before that is known nor where the mortar might stand: that took longer than all else."""
    patience_s = list[float]()

    def noted(motion: MotionPlanner, *_: Any) -> None:
        patience_s.append(motion.patience_s)

    monkeypatch.setattr(MotionPlanner, "prepare", noted)
    stands(lab, LID)
    (message,) = blocked(lab)
    assert "no stroke is possible in any direction" in message
    assert "it can scoop there" in message
    assert set(patience_s) == {0.0}


@pytest.mark.parametrize("last", [False, True])
def test_a_way_that_is_soon_found_comes_before_long_searches_in_other_directions(
    lab: LabFolder, monkeypatch: pytest.MonkeyPatch, last: bool
) -> None:
    asked = list[tuple[float, bool]]()

    def possible(motion: Any, cell: Any, source: Any, stroke: Stroke, *, is_brief: bool) -> float:
        asked.append((stroke.heading_deg, is_brief))
        if (last and is_brief) or len(asked) < 3:
            raise SkillFailed(Code.ARM_NO_PATH, "none")
        return 4.0

    monkeypatch.setattr(ways, "swing_and_out", possible)
    assert blocked(lab) == []
    first = [is_brief for _, is_brief in asked][: 49 if last else 3]
    assert first == ([True] * 48 + [False] if last else [True] * 3)
    assert asked[48 if last else 0][0] == asked[0][0], "all of them again, in their order"


def with_two_mortars(lab: LabFolder) -> None:
    recipe = lab.folder / "recipes" / "one.yaml"
    more = (
        "  more: {station: mortar_bay_2, container: agate_mortar, powder: glass_beads, amount: 5 g, lot: B}\nsamples:\n"
    )
    sample = "  - {id: b, source: more, container: xrd_holder, mass: 50 mg}\n"
    recipe.write_text(recipe.read_text().replace("samples:\n", more) + sample)


def follow(lab: LabFolder, message: str) -> list[str]:
    """Write the proposed places into the cell's file; which stations they are of."""
    proposed = re.findall(r"'(\w+)' at (\[[^]]*\])", message)
    cell = (lab.folder / "robot" / "cell.yaml").read_text(encoding="utf-8")
    for station, place in proposed:
        cell, changed = re.subn(rf"(\n  {station}: .*position: )\[[^]]*\]", rf"\g<1>{place}", cell)
        assert changed == 1
    lab.write("robot/cell.yaml", cell)
    return [station for station, _ in proposed]


@pytest.mark.slow
def test_two_mortars_that_stand_badly_are_proposed_places_at_once(lab: LabFolder) -> None:
    """Over the second the arm cannot even stand: it is to have no way there as long as the first is looked for."""
    with_two_mortars(lab)
    lab.replace("robot/cell.yaml", "[200 mm,  240 mm, 0 mm]", "[460 mm, 230 mm, 0 mm]")
    lab.replace("robot/cell.yaml", "[200 mm, -240 mm, 0 mm]", "[290 mm, -90 mm, 0 mm]")
    (message,) = blocked(lab)
    why, _ = message.split(" With ")
    assert re.search(r"mortar_bay\b.*; .*mortar_bay_2\b", why), "why, of both"
    assert follow(lab, message) == ["mortar_bay", "mortar_bay_2"]
    assert blocked(lab) == []


def test_a_place_that_two_mortars_would_have_is_proposed_to_one_and_another_to_the_other(
    lab: LabFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second also stands well on a stand, elsewhere than where it is, which is told in words."""
    with_two_mortars(lab)
    lab.replace("robot/cell.yaml", "[200 mm,  240 mm, 0 mm]", "[340 mm, 260 mm, 0 mm]")
    shared, raised = (180.0, 210.0, 0.0), (220.0, -260.0, 20.0)

    def possible(station: str, at_mm: dict[str, Point]) -> bool:
        return at_mm[station] == shared or (station, at_mm[station]) == ("mortar_bay_2", raised)

    strokes_where(monkeypatch, possible)
    (message,) = blocked(lab)
    assert message.count("no stroke is possible") == 2, "why, of both"
    assert message.endswith(
        "With 'mortar_bay' at [180 mm, 210 mm, 0 mm] and 'mortar_bay_2' at [220 mm, -260 mm, 20 mm], on a stand of "
        "20 mm, it can scoop there, and carry what it has scooped to where it goes"
    )
    follow(lab, message)
    assert blocked(lab) == []


def test_of_two_mortars_that_are_in_each_others_way_one_stays(lab: LabFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    with_two_mortars(lab)
    here = {"mortar_bay": (200.0, 240.0, 0.0), "mortar_bay_2": (200.0, -240.0, 0.0)}
    strokes_where(monkeypatch, lambda _, at_mm: any(at_mm.get(name) != place_mm for name, place_mm in here.items()))
    (message,) = blocked(lab)
    assert re.search(r"With 'mortar_bay' where it is and 'mortar_bay_2' at \[.* it can scoop there", message)
    assert follow(lab, message) == ["mortar_bay_2"]
    assert blocked(lab) == []


def test_a_mortar_that_would_do_nowhere_is_named_though_another_would_somewhere(
    lab: LabFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    with_two_mortars(lab)
    strokes_where(monkeypatch, lambda station, at_mm: station == "mortar_bay" and at_mm[station][0] < 200.0)
    (message,) = blocked(lab)
    assert "none of the places that were tried, nor stands, suits 'mortar_bay_2'" in message
    assert "With" not in message


@pytest.mark.parametrize(
    ("station", "was", "now", "leftover"),
    [
        ("waste", "[60 mm, 320 mm, 100 mm]", "[60 mm, 320 mm, 40 mm]", "leftover: discard\n"),
        ("balance", "position: [330 mm, 0 mm, 60 mm]", "position: [330 mm, 80 mm, 60 mm]", ""),
    ],
)
def test_where_powder_goes_is_told_where_it_is_written_and_no_mortar_blamed_for_it(
    lab: LabFolder, station: str, was: str, now: str, leftover: str
) -> None:
    lab.replace("robot/cell.yaml", was, now)
    lab.write("recipes/one.yaml", RECIPE + leftover)
    (problem,) = found(lab, "no-path")
    assert problem.message.startswith(f"the arm cannot stand at {station}")
    assert problem.mark.line == line_with(lab, now)
    assert "mortar" not in problem.message


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


@pytest.mark.parametrize(
    ("said", "told"),
    [
        ("may_touch: [[fore, wastebin]]", "which is not there; known: .* did you mean 'waste_bin'"),
        ("windows: {j8: [-60 deg, 60 deg]}", "the URDF has no joint 'j8'; known: j1, j2"),
        ("windows: {j1: [60 deg, -60 deg]}", "that leaves joint 'j1' no window"),
    ],
)
def test_what_the_cell_says_of_its_arm_and_the_urdf_does_not_have_is_located_in_the_cells_file(
    lab: LabFolder, said: str, told: str
) -> None:
    lab.replace("robot/cell.yaml", "urdf: crane_x7_scuhand_sv.urdf}", f"urdf: crane_x7_scuhand_sv.urdf, {said}}}")
    (problem,) = found(lab, "bad-value")
    assert re.search(told, problem.message)
    assert problem.mark.file.endswith("cell.yaml")
    assert problem.mark.line == line_with(lab, said)


@pytest.mark.slow
def test_where_the_check_says_a_mortar_may_stand_the_arm_can_scoop_and_carry_and_stand_at_every_other_place(
    lab: LabFolder,
) -> None:
    """The nearest place with a stroke is so near the sheet's that the cone there would be in the mortar."""
    here = "mortar_bay:   {kind: mortar,  position: [200 mm,  240 mm, 0 mm]"
    lab.replace("robot/cell.yaml", here, here.replace("200 mm,  240 mm, 0 mm", "340 mm, -400 mm, 120 mm"))
    (message,) = blocked(lab)
    proposed = re.search(r"With 'mortar_bay' at \[(.*)\] it can scoop there, and carry what it has scooped", message)
    assert proposed is not None, message
    lab.replace("robot/cell.yaml", "340 mm, -400 mm, 120 mm", proposed[1])
    assert blocked(lab) == []


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


@pytest.mark.slow
def test_where_a_mortar_may_stand_is_told_in_the_figures_of_its_frame(lab: LabFolder) -> None:
    """What stands turned and shifted is written into the cell's file as it was drawn."""
    moved = "table:   {pivot: [260 mm, 0 mm, 0 mm], shift: [12 mm, -8 mm, 3 mm], yaw: 15 deg, "
    lab.replace("robot/cell.yaml", "table:   {", moved)
    lab.replace("robot/cell.yaml", "[200 mm,  240 mm, 0 mm]", "[410 mm, 160 mm, 0 mm]")
    (message,) = blocked(lab)
    proposed = re.search(r"With 'mortar_bay' at \[(.*)\] it can scoop there", message)
    assert proposed is not None, message
    assert proposed[1].endswith(", 0 mm"), "on the table, which is 3 mm higher"
    lab.replace("robot/cell.yaml", "410 mm, 160 mm, 0 mm", proposed[1])
    assert blocked(lab) == []
    position_mm = read_lab(lab.folder).cell.stations["mortar_bay"].position_mm
    assert position_mm == pytest.approx((280.0, 200.0, 3.0), abs=0.1), "the nearest of the places about the arm"


BAR_OBJ = """
v -100 -10 -4\nv 100 -10 -4\nv 100 10 -4\nv -100 10 -4\nv -100 -10 4\nv 100 -10 4\nv 100 10 4\nv -100 10 4
f 1 3 2\nf 1 4 3\nf 5 6 7\nf 5 7 8\nf 1 2 6\nf 1 6 5\nf 2 3 7\nf 2 7 6\nf 3 4 8\nf 3 8 7\nf 4 1 5\nf 4 5 8
"""


@pytest.mark.slow
@pytest.mark.parametrize("shape", ["box: [200 mm, 20 mm, 8 mm]", "mesh: bar.obj"])
def test_a_mortar_is_proposed_to_stand_in_no_box_that_is_turned(lab: LabFolder, shape: str) -> None:
    """Nor in a mesh: what is so low is in no way of the arm, but in the mortar's."""
    lab.write("robot/bar.obj", BAR_OBJ)
    here = "mortar_bay:   {kind: mortar,  position: [200 mm,  240 mm, 0 mm]"
    lab.replace("robot/cell.yaml", here, here.replace("200 mm,  240 mm, 0 mm", "420 mm, 180 mm, 0 mm"))
    stands(lab, f"  - {{name: bar, {shape}, at: [280 mm, 320 mm, 4 mm], yaw: 0 deg}}\n")
    beside = "With 'mortar_bay' at [280 mm, 200 mm, 0 mm]"
    (message,) = blocked(lab)
    assert beside in message
    lab.replace("robot/cell.yaml", "yaw: 0 deg}", "yaw: 90 deg}")
    (message,) = blocked(lab)
    assert "With 'mortar_bay' at" in message
    assert beside not in message


@pytest.mark.slow
def test_a_mortar_with_so_thin_a_floor_that_handle_and_wrist_come_too_low_is_proposed_on_a_stand(
    lab: LabFolder,
) -> None:
    dish = "bore: 90 mm, depth: 22.5 mm, height: 25.5 mm, outer_diameter: 110 mm"
    lab.write("robot/containers.yaml", (lab.folder / "robot" / "containers.yaml").read_text() + f"  dish: {{{dish}}}\n")
    recipe = lab.folder / "recipes" / "one.yaml"
    recipe.write_text(re.sub(r"container: \w*agate_mortar", "container: dish", recipe.read_text()))
    (message,) = blocked(lab)
    assert "With 'mortar_bay' at [200 mm, 240 mm, 20 mm], on a stand of 20 mm, it can scoop there" in message
    lab.replace("robot/cell.yaml", "[200 mm,  240 mm, 0 mm]", "[200 mm,  240 mm, 20 mm]")
    assert blocked(lab) == []


@pytest.mark.slow
def test_a_fresh_sheets_cone_that_is_wider_than_the_usual_one_must_come_everywhere_too(lab: LabFolder) -> None:
    """Between the mortar and a wall there is room for the usual cone, not for this one."""
    stands(lab, "  - {name: wall, box: [6 mm, 120 mm, 110 mm], at: [259 mm, 240 mm, 55 mm]}\n")
    assert blocked(lab) == []
    wide = "hand: {driver: hand_controller, port: /dev/ttyACM0, sheet_radius: 60 mm, options: {start_diameter: 112 mm}}"
    lab.replace("robot/cell.yaml", "hand: {driver: hand_controller, port: /dev/ttyACM0}", wide)
    assert any("wall" in message for message in blocked(lab))


@pytest.mark.slow
def test_a_hand_so_heavy_that_a_servo_gets_hot_is_warned_of_each_time(lab: LabFolder) -> None:
    lab.replace("robot/cell.yaml", "hand: {driver: hand_controller,", "hand: {driver: hand_controller, mass: 480 g,")
    for _ in range(2):
        (strained,) = found(lab, "strained")
        assert strained.is_warning
        assert "holds" in strained.message
        assert "N m" in strained.message
        assert strained.mark.line == 5


@pytest.mark.slow
def test_a_plan_with_dry_runs_tells_what_planning_the_arms_ways_tells(lab: LabFolder, command: Call) -> None:
    lab.replace("robot/cell.yaml", "hand: {driver: hand_controller,", "hand: {driver: hand_controller, mass: 480 g,")
    asked = ("plan", lab.folder / "recipes" / "one.yaml", "--workers", 1, "--json")
    for trials in (0, 1):
        notes = json.loads(command(*asked, "--trials", trials).stdout)["notes"]
        assert any("it gets hot" in note for note in notes) == bool(trials)
