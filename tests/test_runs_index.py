"""The list of runs by its index: always what the journals say."""

import os
import shutil
import time
from pathlib import Path

import pytest
from conftest import Call
from journal_bench import write_run
from running import make_lab

from scuhand_bt.journal import archive, runs_index
from scuhand_bt.journal.archive import Summary, summaries
from scuhand_bt.journal.presence import Presence
from scuhand_bt.journal.run_events import Ended, Resumed
from scuhand_bt.journal.writer import Journal
from scuhand_bt.lab_state.ledger import Ledger
from scuhand_bt.run.resume import find_run


@pytest.fixture
def runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Three runs that were listed before, and so are in the index."""
    monkeypatch.setattr(runs_index, "SETTLED_S", 0.0)
    folder = tmp_path / "runs"
    for name in ("a", "b", "c"):
        write_run(folder / f"{name}.sqlite").close()
    assert len(summaries(folder)) == 3
    return folder


def states(folder: Path) -> dict[str, str]:
    return {one.id: one.state for one in summaries(folder)}


def read_anew(folder: Path, monkeypatch: pytest.MonkeyPatch) -> set[str]:
    """The runs whose journals are opened to list all."""
    opened: set[str] = set()
    real = archive.summary

    def watched(path: Path) -> Summary:
        opened.add(path.stem)
        return real(path)

    with monkeypatch.context() as patch:
        patch.setattr(archive, "summary", watched)
        summaries(folder)
    return opened


def test_what_has_not_changed_is_not_read_again_and_is_listed_the_same(
    runs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    indexed = summaries(runs)
    assert read_anew(runs, monkeypatch) == set()
    runs.with_name("runs.index").unlink()
    assert summaries(runs) == indexed


def test_a_run_that_goes_on_is_read_again(runs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    journal = Journal(runs / "b.sqlite", durable=False)  # its last entries are in its log beside it
    journal.event(Resumed(last_at="", changes=[], version=""))
    journal.event(Ended(exit_code=130, reason="as was asked for", complete=False))
    assert states(runs) == {"a": "complete", "b": "stopped", "c": "complete"}
    journal.event(Resumed(last_at="", changes=[], version=""))
    assert states(runs)["b"] == "interrupted"
    journal.close()
    assert states(runs)["b"] == "interrupted"
    assert read_anew(runs, monkeypatch) == set()


def test_a_run_that_a_program_has_is_always_read(runs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    presence = Presence(runs / "c.sqlite")
    assert states(runs) == {"a": "complete", "b": "complete", "c": "running"}
    assert read_anew(runs, monkeypatch) == {"c"}
    presence.end()
    assert states(runs)["c"] == "complete"


def test_a_journal_put_in_the_place_of_another_is_read(runs: Path) -> None:
    a, b = runs / "a.sqlite", runs / "b.sqlite"
    before = a.stat()
    other = Journal(b, durable=False)
    other.event(Ended(exit_code=3, reason="", complete=False))
    other.close()
    shutil.copyfile(b, a)
    os.truncate(a, before.st_size)
    os.utime(a, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert states(runs) == {"a": "fault", "b": "fault", "c": "complete"}


def test_a_run_that_is_gone_is_not_listed_nor_kept(runs: Path) -> None:
    (runs / "a.sqlite").unlink()
    assert states(runs).keys() == {"b", "c"}
    assert runs_index.read_index(runs).keys() == {"b.sqlite", "c.sqlite"}


def test_a_journal_written_this_moment_is_not_kept(tmp_path: Path) -> None:
    write_run(tmp_path / "runs" / "a.sqlite").close()
    assert states(tmp_path / "runs") == {"a": "complete"}
    assert runs_index.read_index(tmp_path / "runs") == {}


@pytest.mark.parametrize("content", [b"no database", b"", None])
def test_an_index_that_cannot_be_used_is_no_matter(runs: Path, content: bytes | None) -> None:
    index = runs.with_name("runs.index")
    index.unlink()
    if content is None:
        index.mkdir()
    else:
        index.write_bytes(content)
    assert len(states(runs)) == 3


def test_of_an_index_of_another_version_nothing_is_believed(runs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runs_index, "VERSION", 99)
    assert read_anew(runs, monkeypatch) == {"a", "b", "c"}
    assert read_anew(runs, monkeypatch) == set()


def test_only_the_newest_runs_are_listed_unless_all_are_asked_for(
    tmp_path: Path, command: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    from scuhand_bt.cli import archive as commands

    monkeypatch.setattr(commands, "NEWEST", 2)
    lab = make_lab(tmp_path / "lab")
    for name in ("a", "b", "c"):
        write_run(lab / ".scuhand" / "runs" / f"{name}.sqlite").close()
        time.sleep(0.01)
    out = command("runs", "--lab", lab)[1]
    assert "… and 1 older ones (--all)." in out
    assert len([line for line in out.splitlines() if "complete" in line]) == 2
    out = command("runs", "--lab", lab, "--all")[1]
    assert len([line for line in out.splitlines() if "complete" in line]) == 3


@pytest.mark.parametrize("made", ["a file", "a journal"])
def test_a_run_that_is_about_to_begin_is_said_to_be(tmp_path: Path, made: str, command: Call) -> None:
    """As for seconds on a busy computer: what a process has that has written nothing yet is not damaged."""
    lab = make_lab(tmp_path)
    path = lab / ".scuhand" / "runs" / "begins.sqlite"
    path.parent.mkdir(parents=True)
    journal = None
    with Presence(path):
        path.touch()
        if made == "a journal":
            journal = Journal(path, durable=False)
        (listed,) = summaries(path.parent)
        assert (listed.state, listed.reason) == ("running", "it is about to begin")
        for looks in ("show", "verify"):
            looked = command(looks, "begins", "--lab", lab)
            assert looked.returncode == 2
            assert "it is about to begin: nothing can be read yet; try again" in looked.stderr
    if journal is not None:
        journal.close()
    (listed,) = summaries(path.parent)
    assert listed.state == ("unreadable" if journal is None else "interrupted"), "of which nothing came"


def test_a_run_that_ended_before_anything_was_written_down_is_not_said_to_be_altered(
    tmp_path: Path, command: Call
) -> None:
    """Its journal is as empty as one of which all was deleted; of that the ledger knows."""
    lab = make_lab(tmp_path / "lab")
    state = lab / ".scuhand"
    Journal(state / "runs" / "gone.sqlite", durable=False).close()
    for looks in ("show", "verify", "audit", "report"):
        looked = command(looks, "gone", "--lab", lab)
        assert looked.returncode == 2, looks
        assert "the run was ended before anything was written down, and nothing had moved" in looked.stderr
    assert "interrupted: it had not begun" in command("runs", "--lab", lab).stdout
    assert command("backup", tmp_path / "lab.zip", "--lab", lab).returncode == 0
    assert command("restore", tmp_path / "lab.zip", tmp_path / "again").returncode == 0
    Ledger(state).add("gone", "begun", 3, "00" * 32, durable=False)
    for looks in ("show", "verify"):
        looked = command(looks, "gone", "--lab", lab)
        assert (looked.returncode, "there is no entry" in looked.stderr) == (3, True), looks


def test_the_last_run_is_the_one_that_goes_on_though_another_has_ended_meanwhile(runs: Path) -> None:
    journal = Journal(runs / "b.sqlite", durable=False)
    journal.event(Resumed(last_at="", changes=[], version=""))
    now_s = time.time()
    for name, ago_s in (("a.sqlite", 60.0), ("b.sqlite", 90.0), ("b.sqlite-wal", 1.0), ("c.sqlite", 30.0)):
        os.utime(runs / name, (now_s - ago_s, now_s - ago_s))
    assert find_run(runs, "last").stem == "b"
    journal.close()
