"""Files and folders of a lab that its user may not read: each is named, and nothing takes its place."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest
from conftest import LabFolder
from nobody import as_nobody, let_in

from scuhand_bt.events.entry import Note
from scuhand_bt.journal.reader import read
from scuhand_bt.journal.writer import Journal
from scuhand_bt.lab import find_lab, load_lab
from scuhand_bt.report.backup import back_up


def closed(path: Path, action: Callable[[], object]) -> str:
    """What an action comes to for somebody to whom this file or folder is closed, and nothing else."""
    action()
    let_in(path.parent)
    path.chmod(0o700 if os.geteuid() == 0 else 0)
    try:
        return as_nobody(action)
    finally:
        path.chmod(0o755)


@pytest.mark.parametrize("part", ["robot", "skills", "trees"])
def test_a_closed_folder_of_a_lab_is_said_and_no_other_lab_is_taken(lab_folder: LabFolder, part: str) -> None:
    recipe = lab_folder.write("recipes/one.yaml", "")
    path = lab_folder.folder / part
    assert closed(path, lambda: load_lab(find_lab(recipe))) == f"{path}:1:1: cannot be read: Permission denied"


def test_a_closed_skill_that_was_compiled_before_is_one_that_cannot_be_loaded(lab_folder: LabFolder) -> None:
    path = lab_folder.folder / "skills" / "park.py"
    said: list[str] = []

    def look() -> None:
        said[:] = lab_folder.problems()
        assert not said, said

    assert "skills/park.py:1:1: the skill cannot be loaded: PermissionError" in closed(path, look)


def test_no_backup_leaves_out_what_cannot_be_listed(lab_folder: LabFolder, tmp_path: Path) -> None:
    state, archive = lab_folder.folder / ".scuhand", tmp_path / "to" / "kept.zip"
    (state / "runs").mkdir(parents=True)
    archive.parent.mkdir()
    archive.parent.chmod(0o777)
    for path in (state, state / "runs", lab_folder.folder / "recipes"):
        said = closed(path, lambda: (back_up(lab_folder.folder, state, archive), archive.unlink()))
        assert said == f"{path}:1:1: it cannot be copied: Permission denied"
    assert not list(archive.parent.iterdir())


def test_a_closed_journal_is_not_called_damaged(tmp_path: Path) -> None:
    path = tmp_path / "one.sqlite"
    journal = Journal(path, durable=False)
    journal.event(Note("lab.note", {}))
    journal.close()
    assert closed(path, lambda: read(path, "entry")) == f"{path}: cannot be read: Permission denied"
