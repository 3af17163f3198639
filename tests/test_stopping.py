"""Stopping a run, and looking at what it left, depend on nothing else: no sound lab, no space, no right to write."""

import shutil
import socket
import threading
import time
from pathlib import Path
from typing import Any

import pytest
from conftest import Call
from nobody import as_nobody, let_in
from resuming import Run, Watch
from running import make_lab

from scuhand_bt.events.entry import Note
from scuhand_bt.journal.archive import summaries
from scuhand_bt.journal.presence import Presence
from scuhand_bt.journal.reader import read
from scuhand_bt.journal.writer import Journal
from scuhand_bt.run import control as control_module
from scuhand_bt.run.control import HEARD, Control, WishListener, may_wish, say_wish

BROKEN = "workflow: half\ntree:\n  sequence:\n"
LOOKING = (["runs"], ["show", "last"], ["verify", "last"], ["export", "last", "--json"], ["explain", "hand.cone_empty"])


@pytest.fixture
def run(tmp_path: Path) -> Run:
    run = Run(tmp_path, make_lab(tmp_path / "lab"))
    run.folder = run.lab_folder / ".scuhand" / "runs"
    return run


def break_lab(lab: Path, how: str) -> None:
    if how == "half saved":
        (lab / "trees" / "half.yaml").write_text(BROKEN, encoding="utf-8")
    else:
        for part in ("robot", "skills", "trees"):
            shutil.rmtree(lab / part)


@pytest.mark.parametrize("how", ["half saved", "gone"])
def test_a_run_is_paused_and_stopped_and_looked_at_whatever_has_become_of_its_lab(
    run: Run, command: Call, how: str
) -> None:
    said = []

    class Stopping(Watch):
        def ticked(self, root: Any) -> None:
            super().ticked(root)
            if self.ticks == 40:
                break_lab(run.lab_folder, how)
                said.append(command("pause", "last", "--lab", run.lab_folder))
                said.append(command("stop", "last", "--now", "--lab", run.lab_folder))

    result = run.go(Stopping())
    assert [one.returncode for one in said] == [0, 0], said
    assert result.exit_code == 130
    for looks in LOOKING:
        ended = command(*looks, "--lab", run.lab_folder)
        assert ended.returncode == 0, (looks, ended.stderr)
        assert ended.stdout
    assert "stopped" in command("runs", "--lab", run.lab_folder).stdout


def test_explain_says_what_it_leaves_out_of_a_lab_that_cannot_be_read(run: Run, command: Call) -> None:
    break_lab(run.lab_folder, "half saved")
    ended = command("explain", "hand.cone_empty", "--lab", run.lab_folder)
    assert "half.yaml:3" in ended.stderr
    assert "hand.cone_empty: " in ended.stdout


def test_a_run_is_continued_and_stopped_though_its_lock_was_deleted_and_not_begun_twice(
    run: Run, command: Call
) -> None:
    said = []

    class Stopping(Watch):
        def ticked(self, root: Any) -> None:
            super().ticked(root)
            if self.ticks == 40:
                run.journal.with_suffix(".lock").unlink()
                said.append(command("pause", "last", "--lab", run.lab_folder))
                said.append(command("resume", "last", "--yes", "--lab", run.lab_folder))
                assert not self.session.control.is_pausing
                said.append(command("stop", "last", "--now", "--lab", run.lab_folder))

    result = run.go(Stopping())
    assert [one.returncode for one in said] == [0, 0, 0], said
    assert "continues" in said[1].stdout
    assert result.exit_code == 130
    assert [row["kind"] for row in read(run.journal, "event")].count("resumed") == 0


def test_what_does_not_run_cannot_be_stopped_and_what_begins_says_so(run: Run, command: Call) -> None:
    run.go(Watch("stop_now", 40))
    idle = command("stop", "last", "--lab", run.lab_folder)
    assert (idle.returncode, "it is not running" in idle.stderr) == (2, True)
    with Presence(run.journal):
        begins = command("stop", "last", "--lab", run.lab_folder)
    assert (begins.returncode, "about to begin or to resume it" in begins.stderr) == (2, True)


# --- by a folder that can only be read


def test_a_killed_run_in_a_folder_that_can_only_be_read_is_read_to_its_last_entry(tmp_path: Path) -> None:
    folder = tmp_path / "runs"
    journal = Journal(folder / "killed.sqlite", durable=False)
    for number in range(3):
        journal.event(Note("lab.note", {"number": number}))
    copied = tmp_path / "copied"
    copied.mkdir()
    for part in ("killed.sqlite", "killed.sqlite-wal"):  # as a kill leaves them, or a careful copy
        shutil.copy(folder / part, copied / part)
    (copied / "killed.lock").touch()
    let_in(tmp_path)
    copied.chmod(0o555)

    def look() -> None:
        assert len(read(copied / "killed.sqlite", "entry")) == 3
        assert [one.state for one in summaries(copied)] == ["interrupted"]

    before = sorted(copied.iterdir())
    assert as_nobody(look) == "ok"
    assert sorted(copied.iterdir()) == before
    journal.close()
    copied.chmod(0o755)


# --- wishes


def test_every_wish_is_heard_by_the_run_or_answered_to_be_none(tmp_path: Path) -> None:
    journal, heard = tmp_path / "r.sqlite", []

    class Counting(Control):
        def wish(self, wish: Any, who: Any = None) -> None:
            heard.append(wish)

    listener = WishListener(journal, Counting())
    answers: list[Any] = []
    wishes = ["pause", "stop_now", "continue", "dance", "stop"] * 8
    threads = [threading.Thread(target=lambda w=wish: answers.append(say_wish(journal, w))) for wish in wishes]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(heard) == sorted(wish for wish in wishes if wish != "dance")
    assert answers.count(HEARD) == len(heard)
    assert answers.count("this command is not known") == 8
    with pytest.raises(OSError, match="in use"):
        WishListener(journal, Control())
    assert say_wish(tmp_path / "other.sqlite", "stop") is None
    listener.end()
    assert say_wish(journal, "stop") is None


def test_who_calls_and_says_nothing_keeps_nobody_else_from_stopping_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(control_module, "SPOKEN_S", 0.1)
    journal, control = tmp_path / "r.sqlite", Control()
    listener = WishListener(journal, control)
    with socket.socket(socket.AF_UNIX) as silent:
        silent.connect(control_module.address_of(journal))
        assert say_wish(journal, "stop_now") == HEARD
    assert control.stops_now
    listener.end()


def test_anyone_may_stop_a_run_and_its_owner_lets_it_go_on() -> None:
    assert all(may_wish(wish, 1001, 1000) for wish in ("pause", "pause_now", "stop", "stop_now"))
    assert [may_wish("continue", user, 1000) for user in (1000, 0, 1001)] == [True, True, False]


def test_nobody_waits_for_callers_who_say_nothing(tmp_path: Path) -> None:
    journal, control = tmp_path / "lab" / "runs" / "one.sqlite", Control()
    listener, silent = WishListener(journal, control), []
    try:
        for _ in range(3 * control_module.MOST_CALLERS):
            silent.append(socket.socket(socket.AF_UNIX, socket.SOCK_STREAM))
            silent[-1].connect(control_module.address_of(journal))
            silent[-1].sendall(b'{"wish": ')
        began_s = time.monotonic()
        assert say_wish(journal, "stop") == HEARD
        assert time.monotonic() - began_s < control_module.SPOKEN_S / 2
        assert control.is_stopping
    finally:
        listener.end()
        for line in silent:
            line.close()


def test_who_says_it_in_pieces_is_heard_and_who_stalls_is_hung_up_on(tmp_path: Path) -> None:
    journal, control = tmp_path / "lab" / "runs" / "one.sqlite", Control()
    listener = WishListener(journal, control)
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as line:
            line.connect(control_module.address_of(journal))
            for part in (b'{"wish": "pause", ', b'"by": null, "pin": null}'):
                line.sendall(part)
                time.sleep(0.05)
            line.shutdown(socket.SHUT_WR)
            line.settimeout(2.0)
            assert line.recv(100) == HEARD.encode()
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as line:
            line.connect(control_module.address_of(journal))
            line.settimeout(5 * control_module.SPOKEN_S)
            assert line.recv(100) == b""
        assert control.is_pausing
    finally:
        listener.end()
