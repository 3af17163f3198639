"""What `check`, and `plan`, find before a run would: ways that no pair of places tells of."""

import json
import math
import re
import sys
from itertools import islice
from typing import Any

import pytest
from conftest import Call, LabFolder
from ways_bench import blocked, found, line_with, stands

from harness.own_workflow import RECIPE, TREE, write_own
from scuhand_bt.dosing.ladle import LIP_GAP_MM, Stroke
from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.lab import read_lab, starter_lab
from scuhand_bt.motion import MotionPlanner
from scuhand_bt.report import directions
from scuhand_bt.run import ways

ROOF = "  - {name: roof, box: [20 mm, 20 mm, 6 mm], at: [340 mm, 0 mm, 180 mm]}\n"
"""So low that the cone comes under it from the side alone."""
LID = "  - {name: lid, box: [30 mm, 30 mm, 6 mm], at: [200 mm, 240 mm, 125 mm]}\n"
"""Over the middle of the mortar, above the cone as it hovers there: the handle of a cone that swings comes up to it."""


@pytest.fixture
def lab(lab_folder: LabFolder) -> LabFolder:
    write_own(lab_folder.folder)
    return lab_folder


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


@pytest.mark.slow
def test_a_mortar_over_which_the_arm_can_stand_but_in_which_it_can_make_no_stroke_is_found(lab: LabFolder) -> None:
    stands(lab, LID)
    (problem,) = found(lab, "no-path")
    assert problem.message.startswith("at 'mortar_bay' no stroke is possible in any direction")
    assert "lid" in problem.message
    assert problem.mark.file.endswith("cell.yaml")
    assert problem.mark.line == line_with(lab, "mortar_bay: ")


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
