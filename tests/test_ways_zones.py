"""What `check` finds of zones before a run would: where the arm parks, and what is about the pan."""

import re
from types import SimpleNamespace

import pytest
from conftest import LabFolder
from ways_bench import found, line_with, strokes_where

from harness.own_workflow import write_own
from scuhand_bt.run import checking, ways


@pytest.fixture
def lab(lab_folder: LabFolder) -> LabFolder:
    write_own(lab_folder.folder)
    return lab_folder


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
