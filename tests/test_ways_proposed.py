"""Where `check` proposes that a mortar may stand, the arm can scoop and carry."""

import re

import pytest
from conftest import LabFolder
from ways_bench import blocked, stands, strokes_where

from harness.own_workflow import write_own
from scuhand_bt.bench_spec import Point
from scuhand_bt.lab import read_lab


@pytest.fixture
def lab(lab_folder: LabFolder) -> LabFolder:
    write_own(lab_folder.folder)
    return lab_folder


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
