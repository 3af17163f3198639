"""Resuming in a lab that was moved, or that an editor has left files in."""

import shutil
from pathlib import Path
from zipfile import ZipFile

import pytest
from conftest import Call
from daily import first_daily
from running import dry_run, make_lab

DOSES = """
recipe: two
workflow: fill_xrd_holder
defaults: {container: xrd_holder, source: beads, mass: 30 mg}
samples: [{id: a}, {id: b}]
"""

LONG = """
from pauses_of_mine import LONG_S
from scuhand_bt.skill import Cell, Skill, Steps, pause


class Long(Skill[None]):
    \"\"\"A pause.\"\"\"

    typical_s = LONG_S

    def run(self, cell: Cell) -> Steps[None]:
        yield from pause(cell, LONG_S)
"""


@pytest.fixture
def lab(tmp_path: Path) -> Path:
    """A lab with a run that was stopped."""
    folder = make_lab(tmp_path / "lab")
    (folder / ".scuhand").mkdir()
    dry_run(folder / ".scuhand", DOSES, lab=folder, stop_at=30)
    return folder


@pytest.mark.slow
def test_a_lab_that_was_moved_goes_on_with_its_runs(lab: Path, tmp_path: Path, command: Call) -> None:
    moved = tmp_path / "bench 2" / "lab"
    moved.parent.mkdir()
    lab.rename(moved)
    code, out, err = command("resume", "last", "--lab", moved)
    assert (code, err) == (0, "")
    assert "2 of 2 samples good" in out
    assert not lab.exists()


def test_a_copied_lab_goes_on_with_its_own_files_and_not_with_the_originals(
    lab: Path, tmp_path: Path, command: Call
) -> None:
    copy = Path(shutil.copytree(lab, tmp_path / "copy"))
    (copy / "skills" / "park.py").write_text((copy / "skills" / "park.py").read_text() + "# changed\n")
    code, _, err = command("resume", "last", "--lab", copy)
    assert code == 2
    assert "the lab's skills/park.py has changed" in err


@pytest.mark.parametrize(
    "name", first_daily("trees/park.yaml~", "skills/#park.py#", "robot/.cell.yaml.swp", "trees/.#park.yaml")
)
def test_what_an_editor_leaves_is_no_change_of_the_lab(lab: Path, command: Call, name: str) -> None:
    if ".#" in name:
        (lab / name).symlink_to("someone@computer.1234:1")
    else:
        (lab / name).write_text("tree: [\n")
    code, _, err = command("resume", "last", "--lab", lab)
    assert (code, err) == (0, "")


def test_a_module_beside_the_lab_that_a_skill_is_made_of_is_a_part_of_the_run(
    tmp_path: Path, command: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    mine = tmp_path / "pauses_of_mine.py"
    mine.write_text("LONG_S = 1.0\n", encoding="utf-8")
    lab = make_lab(tmp_path / "lab", skills__long=LONG)
    (lab / ".scuhand").mkdir()
    dry_run(lab / ".scuhand", DOSES, lab=lab, stop_at=30)
    mine.write_text("LONG_S = 2.0\n", encoding="utf-8")
    code, _, err = command("resume", "last", "--lab", lab)
    assert code == 2
    assert "your own module pauses_of_mine has changed" in err
    mine.write_text("LONG_S = 1.0\n", encoding="utf-8")
    assert command("resume", "last", "--lab", lab).returncode == 0


def test_a_module_that_is_no_file_of_its_own_keeps_no_run_from_beginning_or_going_on(
    tmp_path: Path, command: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(tmp_path / "mine.zip")
    with ZipFile(tmp_path / "mine.zip", "w") as mine:
        mine.writestr("pauses_in_a_zip.py", "LONG_S = 1.0\n")
    lab = make_lab(tmp_path / "lab", skills__long=LONG.replace("pauses_of_mine", "pauses_in_a_zip"))
    (lab / ".scuhand").mkdir()
    dry_run(lab / ".scuhand", DOSES, lab=lab, stop_at=30)
    assert command("resume", "last", "--lab", lab).returncode == 0


def test_a_lab_that_was_named_from_where_the_run_began_is_the_same_from_anywhere(
    tmp_path: Path, command: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    lab = make_lab(tmp_path / "lab")
    (lab / ".scuhand").mkdir()
    monkeypatch.chdir(tmp_path)
    dry_run(lab / ".scuhand", DOSES, lab=Path("lab"), stop_at=30)
    code, _, err = command("resume", "last", "--lab", lab)
    assert (code, err) == (0, "")


def test_a_new_workflow_is_still_a_change(lab: Path, command: Call) -> None:
    (lab / "trees" / "new.yaml").write_text("workflow: new\ntree: {park: }\n")
    code, _, err = command("resume", "last", "--lab", lab)
    assert code == 2
    assert "trees/new.yaml was added" in err
