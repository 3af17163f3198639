"""A lab backed up while it runs, restored elsewhere, and its journals made single files."""

import json
import shutil
import sqlite3
import zipfile
from contextlib import closing
from pathlib import Path

import pytest
from conftest import Call
from journal_bench import HEADER, tamper
from running import dry_run, make_lab

from scuhand_bt.journal.copies import make_one_file
from scuhand_bt.journal.export import canonical
from scuhand_bt.journal.presence import Presence
from scuhand_bt.journal.reader import read
from scuhand_bt.journal.run_events import Paused, RunBegun
from scuhand_bt.journal.writer import Journal
from scuhand_bt.report.backup import MANIFEST

DOSES = """
recipe: two
workflow: fill_xrd_holder
defaults: {container: xrd_holder, source: beads, mass: 30 mg}
samples: [{id: a}, {id: b}]
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A lab with a run that was stopped."""
    lab = make_lab(tmp_path_factory.mktemp("made") / "lab", trees__own="workflow: own\ntree: {park: }\n")
    for folder in (".scuhand", "recipes"):
        (lab / folder).mkdir()
    dry_run(lab / "recipes", DOSES, lab=lab, stop_at=30)
    for name in ("runs", "lab.db"):
        (lab / "recipes" / name).rename(lab / ".scuhand" / name)
    return lab


@pytest.fixture
def lab(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "lab"))


def journal_of(lab: Path) -> Path:
    (journal,) = (lab / ".scuhand" / "runs").glob("*.sqlite")
    return journal


def test_a_restored_lab_has_all_that_was_there_and_goes_on_with_its_run(
    lab: Path, tmp_path: Path, command: Call
) -> None:
    archive, again = tmp_path / "lab.zip", tmp_path / "again"
    assert command("inventory", "set", "mortar_bay", "7 g", "--powder", "glass_beads", "--lab", lab)[0] == 0
    assert command("backup", archive, "--lab", lab)[0] == 0
    export, shown = canonical(journal_of(lab)), command("inventory", "--lab", lab, "--json")[1]
    shutil.rmtree(lab)

    code, out, err = command("restore", archive, again)
    assert (code, err) == (0, "")
    assert "restored, with 1 run" in out
    assert canonical(journal_of(again)) == export
    assert command("inventory", "--lab", again, "--json")[1] == shown
    assert (again / "trees" / "own.yaml").is_file()
    assert command("verify", "last", "--lab", again)[0] == 0
    code, out, _ = command("resume", "last", "--lab", again)
    assert code == 0
    assert "2 of 2 samples good" in out


def test_a_run_that_is_being_written_is_backed_up_as_of_one_moment(lab: Path, tmp_path: Path, command: Call) -> None:
    journal = Journal(lab / ".scuhand" / "runs" / "now.sqlite", durable=False)
    journal.event(RunBegun.model_validate({**HEADER, "run": "now"}))
    for _ in range(100):
        journal.event(Paused())
    assert command("backup", tmp_path / "lab.zip", "--lab", lab)[0] == 0
    journal.event(Paused())
    journal.close()
    assert command("restore", tmp_path / "lab.zip", tmp_path / "again")[0] == 0
    copied = tmp_path / "again" / ".scuhand" / "runs" / "now.sqlite"
    assert [path.name for path in copied.parent.glob("now*")] == ["now.sqlite"]
    assert len(read(copied, "entry")) == 101


def test_an_altered_journal_is_restored_as_it_was_and_told(lab: Path, tmp_path: Path, command: Call) -> None:
    tamper(journal_of(lab), "DELETE FROM entry WHERE seq = 4")
    assert command("backup", tmp_path / "lab.zip", "--lab", lab)[0] == 0
    code, _, err = command("restore", tmp_path / "lab.zip", tmp_path / "again")
    assert code == 3
    assert "entry 4 is missing" in err


def rewritten(archive: Path, change: dict[str, bytes], *, listed: bool) -> None:
    """The archive with other content; `listed`: its list of files tells of it."""
    import hashlib

    with zipfile.ZipFile(archive) as stored:
        files = {name: stored.read(name) for name in stored.namelist()}
    files |= change
    if listed:
        manifest = json.loads(files[MANIFEST])
        manifest["files"] |= {name: hashlib.sha256(content).hexdigest() for name, content in change.items()}
        files[MANIFEST] = json.dumps(manifest).encode()
    with zipfile.ZipFile(archive, "w") as stored:
        for name, content in files.items():
            stored.writestr(name, content)


@pytest.mark.parametrize(
    ("change", "listed", "what"),
    [
        ({"trees/own.yaml": b"workflow: evil\n"}, False, "'trees/own.yaml' in it is not what was copied"),
        ({"trees/new.yaml": b""}, False, "its list of files does not match the files in it"),
        ({"trees/../../evil": b""}, True, "is not a file of a lab"),
        ({"/etc/evil": b""}, True, "is not a file of a lab"),
        ({"elsewhere/evil": b""}, True, "is not a file of a lab"),
    ],
)
def test_an_archive_that_is_not_what_was_written_makes_nothing(
    lab: Path, tmp_path: Path, command: Call, change: dict[str, bytes], listed: bool, what: str
) -> None:
    archive = tmp_path / "lab.zip"
    assert command("backup", archive, "--lab", lab)[0] == 0
    rewritten(archive, change, listed=listed)
    before = sorted(tmp_path.rglob("*"))
    code, _, err = command("restore", archive, tmp_path / "again")
    assert code == 2
    assert what in err
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("content", [b"", b"no archive", None])
def test_what_is_no_backup_is_told(tmp_path: Path, command: Call, content: bytes | None) -> None:
    archive = tmp_path / "lab.zip"
    if content is not None:
        archive.write_bytes(content)
    code, _, err = command("restore", archive, tmp_path / "again")
    assert code == 2
    assert "cannot be restored" in err
    assert not (tmp_path / "again").exists()


def test_nothing_is_restored_over_a_folder_that_is_there(lab: Path, tmp_path: Path, command: Call) -> None:
    assert command("backup", tmp_path / "lab.zip", "--lab", lab)[0] == 0
    code, _, err = command("restore", tmp_path / "lab.zip", lab)
    assert code == 2
    assert "it exists already" in err


def test_a_backup_that_cannot_be_written_leaves_the_last_one(lab: Path, tmp_path: Path, command: Call) -> None:
    archive = tmp_path / "lab.zip"
    assert command("backup", archive, "--lab", lab)[0] == 0
    before = archive.read_bytes()
    journal_of(lab).write_bytes(b"no database, though it is called one")
    code, _, err = command("backup", archive, "--lab", lab)
    assert code == 2
    assert "cannot be copied" in err
    assert archive.read_bytes() == before
    assert not list(tmp_path.glob("*.new"))


@pytest.mark.parametrize("name", [".", "recipes/own.yaml", "recipes/lab.zip", "trees/../skills/lab.zip"])
def test_no_backup_is_written_over_a_recipe_or_into_what_it_copies(lab: Path, command: Call, name: str) -> None:
    recipe = lab / "recipes" / "own.yaml"
    recipe.write_text(DOSES)
    before = sorted(lab.rglob("*"))
    code, _, err = command("backup", f"{lab}/{name}", "--lab", lab)
    assert code == 2
    assert "must be a file of this kind: .zip" in err or "would be part of what it copies" in err
    assert recipe.read_text() == DOSES
    assert sorted(lab.rglob("*")) == before


# --- one file


def killed(path: Path) -> Path:
    """A journal as a killed run leaves it: its entries are in its log."""
    journal = Journal(path, durable=False)
    journal.event(RunBegun.model_validate(HEADER))
    copy = path.with_name("killed.sqlite")
    for suffix in ("", "-wal"):
        shutil.copy(f"{path}{suffix}", f"{copy}{suffix}")
    journal.close()
    path.unlink()
    return copy


def test_a_killed_run_becomes_one_file_with_all_its_entries(tmp_path: Path, command: Call) -> None:
    lab = make_lab(tmp_path / "lab")
    runs = lab / ".scuhand" / "runs"
    journal = killed(runs / "r.sqlite")
    assert len(read(journal, "entry")) == 1
    assert command("vacuum", "--lab", lab)[1] == "1 journal is one file now; the others were.\n"
    assert [path.name for path in runs.iterdir()] == ["killed.sqlite"]
    assert len(read(journal, "entry")) == 1
    assert not make_one_file(journal)


def test_a_run_that_goes_on_is_left_alone(tmp_path: Path, command: Call) -> None:
    lab = make_lab(tmp_path / "lab")
    journal = killed(lab / ".scuhand" / "runs" / "r.sqlite")
    presence = Presence(journal)
    assert "killed is still running, and was skipped" in command("vacuum", "--lab", lab)[1]
    presence.end()
    assert journal.with_name("killed.sqlite-wal").exists()


def test_a_run_that_ends_leaves_one_file(lab: Path) -> None:
    journal = journal_of(lab)
    assert [path.name for path in journal.parent.glob("*.sqlite*")] == [journal.name]
    with closing(sqlite3.connect(journal)) as database:
        assert database.execute("PRAGMA journal_mode").fetchone() == ("delete",)
