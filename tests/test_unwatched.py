"""A run does not depend on who watches it, and its exit code is the engine's to say."""

import errno
import io
import os
import pty
import re
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
import typer
from conftest import REPOSITORY, Call, LabFolder
from daily import first_daily
from journal_bench import write_run
from running import make_lab
from test_journal_store import wait_for

from scuhand_bt.api import Control, Hung
from scuhand_bt.cli import streams, supervisor
from scuhand_bt.cli.streams import Beside
from scuhand_bt.devices.liveness import Liveness
from scuhand_bt.journal.archive import summary
from scuhand_bt.journal.reader import read
from scuhand_bt.journal.store import Store

RECIPE = """\
recipe: small
workflow: w
sources:
  beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 5 g}
samples: [{id: a}, {id: b}, {id: c}]
"""
TREE = "workflow: w\ntree: {sequence: [{wait: {duration: 5 s}}, {park: }]}\n"
COMMAND = (sys.executable, "-m", "scuhand_bt", "run")


@pytest.fixture
def recipe(tmp_path: Path) -> Path:
    lab = make_lab(tmp_path / "lab", trees__w=TREE)
    path = lab / "recipes" / "small.yaml"
    path.parent.mkdir()
    path.write_text(RECIPE, encoding="utf-8")
    return path


def the_journal(recipe: Path) -> Path:
    (path,) = recipe.parent.parent.glob(".scuhand/runs/*.sqlite")
    return path


def ended(recipe: Path) -> tuple[str, int | None]:
    """The state that the journal of the only run tells, and the exit code that it has."""
    journal = the_journal(recipe)
    codes = [row["payload"]["exit_code"] for row in read(journal, "event") if row["kind"] == "ended"]
    return summary(journal).state, codes[-1] if codes else None


@pytest.mark.parametrize("where", first_daily("| head -1", ">/dev/full", ">&-", ">/dev/full 2>&1"))
def test_a_run_goes_on_to_its_end_whatever_becomes_of_its_output(recipe: Path, where: str) -> None:
    line = f"{' '.join(COMMAND)} {recipe} --dry-run {where}; exit ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", line], cwd=REPOSITORY, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    assert "Exception ignored" not in done.stderr
    assert ended(recipe) == ("complete", 0)


@pytest.mark.slow
def test_a_run_whose_journal_was_removed_tells_how_to_go_on_with_what_was_rescued(recipe: Path) -> None:
    with subprocess.Popen(
        [*COMMAND, str(recipe), "--dry-run", "--speed", "4"], stdout=subprocess.PIPE, text=True, cwd=REPOSITORY
    ) as process:
        assert process.stdout is not None
        assert any(line.startswith("[1/3] a") for line in process.stdout)
        the_journal(recipe).unlink()
        told = process.communicate(timeout=30)[0]
    assert process.returncode == 3
    move, resume = re.findall(r"`(mv .*?|scuhand-bt resume .*?)`", told)
    subprocess.run(shlex.split(move), check=True)
    again = [sys.executable, "-m", "scuhand_bt", *shlex.split(resume)[1:], "--yes", "--lab", str(recipe.parent.parent)]
    assert subprocess.run(again, cwd=REPOSITORY, capture_output=True, timeout=60).returncode == 0
    assert ended(recipe) == ("complete", 0)


def test_a_disk_that_is_full_before_the_first_entry_moves_nothing_and_says_so(
    recipe: Path, command: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(store: Store, rows: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Store, "add", full)
    done = command("run", recipe, "--dry-run")
    assert done.returncode == 2
    told = " ".join(done.stderr.split())
    assert "No space left on device" in told
    assert told.endswith("nothing was moved")


@pytest.mark.parametrize("where", first_daily("2>/dev/full", "2>&-", ">/dev/full 2>&1"))
def test_what_is_wrong_is_in_the_exit_code_though_nobody_can_be_told(tmp_path: Path, where: str) -> None:
    line = f"{' '.join(COMMAND)} {tmp_path / 'none.yaml'} --dry-run {where}"
    assert subprocess.run(["bash", "-c", line], cwd=REPOSITORY, capture_output=True, timeout=60).returncode == 2


@pytest.mark.parametrize("asks", first_daily(["faults"], ["runs", "--json"]))
def test_what_a_full_disk_does_not_take_was_not_told_and_is_said_to_be(tmp_path: Path, asks: list[str]) -> None:
    told = [sys.executable, "-m", "scuhand_bt", *asks]
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(told, stdout=full, stderr=subprocess.PIPE, text=True, cwd=REPOSITORY, timeout=60)
    assert done.returncode == 2
    assert done.stderr == "It could not be finished: [Errno 28] No space left on device.\n"


@pytest.mark.parametrize(
    "asks", first_daily(["show"], ["export", "--csv"], ["export", "--json"], ["show", "--json"], ["verify"])
)
def test_who_needs_no_more_of_a_journal_ends_the_command_quietly_and_a_full_disk_is_not_the_journals_damage(
    tmp_path: Path, asks: list[str]
) -> None:
    journal = write_run(tmp_path / "r.sqlite")
    journal.close()
    told = [sys.executable, "-m", "scuhand_bt", asks[0], str(journal.path), *asks[1:]]
    theirs, ours = os.pipe()
    os.close(theirs)
    with Path("/dev/full").open("w") as full:
        how: Any = {"stderr": subprocess.PIPE, "text": True, "cwd": REPOSITORY, "timeout": 60}
        unread, untold = (subprocess.run(told, stdout=out, **how) for out in (ours, full))
    os.close(ours)
    assert (unread.returncode, unread.stderr) == (141, "")
    assert (untold.returncode, untold.stderr) == (2, "It could not be finished: [Errno 28] No space left on device.\n")


@pytest.mark.parametrize(("asks", "code"), [(["faults"], 141), (["--help"], 141), (["runs", "--lab", "none"], 2)])
def test_a_command_whose_reader_has_gone_tells_nobody_and_what_was_wrong_keeps_its_code(
    asks: list[str], code: int
) -> None:
    theirs, ours = os.pipe()
    os.close(theirs)
    told = [sys.executable, "-m", "scuhand_bt", *asks]
    done = subprocess.run(told, stdout=ours, stderr=ours, cwd=REPOSITORY, timeout=60)
    os.close(ours)
    assert done.returncode == code


@pytest.mark.parametrize("how", first_daily("stopped reading", "closed"))
def test_a_run_goes_on_to_its_end_when_its_terminal_is_gone(recipe: Path, how: str) -> None:
    ours, theirs = pty.openpty()
    with subprocess.Popen(
        [*COMMAND, str(recipe), "--dry-run", "--speed", "20"],
        stdin=theirs, stdout=theirs, stderr=theirs, cwd=REPOSITORY, start_new_session=True,
        preexec_fn=lambda: os.close(os.open(os.ttyname(theirs), os.O_RDWR)),
    ) as process:  # fmt: skip
        os.close(theirs)
        os.read(ours, 1)
        if how == "closed":
            os.close(ours)
        process.wait(timeout=60)
    if how != "closed":
        os.close(ours)
    assert process.returncode == 0
    assert ended(recipe) == ("complete", 0)


# --- exit codes

ENDING = '''
"""A skill that would end the program."""
import sys
from scuhand_bt.skill import Cell, Skill, Steps, pause

class Ending(Skill[None]):
    """End everything."""
    devices = ("hand",)
    def run(self, cell: Cell) -> Steps[None]:
        cell.hand.set_opening(1.0)
        try:
            yield from pause(cell, 0.1)
        finally:
            %s
'''


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ("sys.exit(0)", "SystemExit: 0"),
        ("raise KeyboardInterrupt", "KeyboardInterrupt"),
        ("raise GeneratorExit", "GeneratorExit"),
    ],
)
def test_a_skill_that_would_end_the_program_has_a_fault_and_the_run_says_which(
    command: Call, lab_folder: LabFolder, how: str, said: str
) -> None:
    lab_folder.write("skills/ending.py", ENDING % how)
    lab_folder.write("trees/w.yaml", "workflow: w\ntree: {sequence: [{ending: }, {park: }]}\n")
    recipe = lab_folder.write("recipes/small.yaml", RECIPE)
    done = command("run", recipe, "--dry-run")
    assert done.returncode == 3
    assert f"the skill ending broke: {said}" in done.stdout
    assert ended(recipe) == ("fault", 3)


# --- what hangs

HANGING = '''
"""A skill that never comes back."""
import threading
from scuhand_bt.skill import Cell, Skill, Steps, pause

class Hanging(Skill[None]):
    """Hang with the valve open."""
    devices = ("hand",)
    def run(self, cell: Cell) -> Steps[None]:
        yield from pause(cell, 0.1)
        cell.hand.set_opening(1.0)
        %s
'''
# `check` refuses a loop that is written without an end; one that only turns out so is the supervisor's.
LOOP = 'print("hangs")\n        while cell: pass'
SLEEP = "threading.Event().wait(3600)"
DEAF = """while cell:
            try:
                threading.Event().wait(3600)
            except BaseException:
                pass"""
HUNG = {
    "loops": (LOOP, "the skill hanging broke: Hung"),
    "sleeps": (SLEEP, "the skill hanging broke: Hung"),
    "deaf": (DEAF, "cannot be ended"),
}


def hanging(lab_folder: LabFolder, body: str) -> Path:
    lab_folder.write("skills/hanging.py", HANGING % body)
    lab_folder.write("trees/w.yaml", "workflow: w\ntree: {sequence: [{hanging: }, {park: }]}\n")
    return lab_folder.write("recipes/small.yaml", RECIPE)


@pytest.mark.parametrize("how", first_daily(*HUNG))
def test_a_skill_that_hangs_is_ended_with_code_3_and_named(lab_folder: LabFolder, how: str) -> None:
    body, said = HUNG[how]
    recipe = hanging(lab_folder, body)
    program = "from scuhand_bt.cli import main, supervisor; supervisor.HANGS_S = 1.0; supervisor.GRACE_S = 1.0; main()"
    done = subprocess.run(
        [sys.executable, "-c", program, "run", str(recipe), "--dry-run"],
        cwd=REPOSITORY, capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert done.returncode == 3, done.stderr
    assert said in done.stdout + done.stderr
    assert "Traceback" not in done.stderr
    state, code = ended(recipe)
    assert (state, code) == ("fault", 3)


@pytest.mark.slow
def test_a_device_that_hangs_when_it_is_told_to_stop_keeps_no_run_from_its_end(recipe: Path) -> None:
    program = "import time; from scuhand_bt.sim.hand import SimulatedHand; SimulatedHand.stop = lambda self: "
    program += "time.sleep(3600); from scuhand_bt.cli import main, supervisor; supervisor.HANGS_S = 1.0; main()"
    done = subprocess.run(
        [sys.executable, "-c", program, "run", str(recipe), "--dry-run"],
        cwd=REPOSITORY, capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert done.returncode == 3, done.stderr
    assert "a device did not stop" in done.stdout
    assert ended(recipe) == ("complete", 3), "its doses were"


def test_a_second_ctrl_c_ends_a_skill_that_hangs_at_once(lab_folder: LabFolder) -> None:
    recipe = hanging(lab_folder, LOOP)
    with subprocess.Popen(
        [*COMMAND, str(recipe), "--dry-run"], cwd=REPOSITORY, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        while process.stdout.readline() != "hangs\n":
            pass
        time.sleep(1.2)
        process.send_signal(signal.SIGINT)
        time.sleep(0.5)
        assert process.poll() is None, "the first one waits for the skill"
        began_s = time.monotonic()
        process.send_signal(signal.SIGINT)
        out, _ = process.communicate(timeout=30)
    assert time.monotonic() - began_s < 3.0
    assert process.returncode == 3
    assert "the skill hanging broke: Hung" in out
    assert ended(recipe) == ("fault", 3)


def test_what_ends_a_run_that_hung_is_not_interrupted_in_its_turn() -> None:
    """It may be at the journal, in the middle of a transaction, and the tick is as silent as before."""
    session = cast(Any, SimpleNamespace(liveness=Liveness()))
    session.liveness.beat()
    watcher = supervisor.Supervisor(Control())
    watcher.stop()

    def stopped_again() -> None:
        watcher.stop()
        time.sleep(supervisor.GRACE_S)

    with watcher.watching(session):
        time.sleep(1.2 * supervisor.IMPATIENT_S)
        with pytest.raises(Hung):
            stopped_again()
        time.sleep(1.2 * supervisor.IMPATIENT_S)


def test_what_computes_on_a_busy_computer_is_given_its_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """A plan of four seconds took 22 beside eight other programs, and the skill that had asked for it was blamed."""
    monkeypatch.setattr(supervisor, "HANGS_S", 1.0)
    monkeypatch.setattr(supervisor.time, "clock_gettime", lambda clock: 0.25 * time.monotonic())
    session = cast(Any, SimpleNamespace(liveness=Liveness()))
    session.liveness.beat()
    with supervisor.Supervisor(Control()).watching(session):
        time.sleep(2.5)
        with pytest.raises(Hung):
            time.sleep(3.0)


# --- a stream that nobody waits for


class Reader:
    """The other end of a stream; `gone` or not reading."""

    def __init__(self) -> None:
        self.got: list[str] = []
        self.is_gone = self.is_stuck = False

    def write(self, text: str) -> int:
        if self.is_gone:
            raise BrokenPipeError
        wait_for(lambda: not self.is_stuck)
        self.got.append(text)
        return len(text)

    def flush(self) -> None:
        if self.is_gone:
            raise BrokenPipeError

    def isatty(self) -> bool:
        return True

    def fileno(self) -> int:
        raise OSError("no file")


def test_what_is_written_comes_in_its_order_and_at_the_end_all_of_it() -> None:
    reader: Any = Reader()
    with Beside(reader) as stream:
        for number in range(100):
            print(number, file=stream)
        assert stream.isatty()
    assert "".join(reader.got).split() == [str(number) for number in range(100)]


def test_nobody_waits_for_a_reader_who_does_not_read(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(streams, "LONGEST_READING_S", 0.1)
    reader: Any = Reader()
    reader.is_stuck = True
    began_s = time.monotonic()
    with Beside(reader) as stream:
        for _ in range(2 * streams.MOST_WAITING):
            stream.write("x")
    assert time.monotonic() - began_s < 2.0
    reader.is_stuck = False
    assert supervisor.HANGS_S > 1.0


def test_a_reader_who_has_gone_is_written_to_no_more() -> None:
    reader: Any = Reader()
    reader.is_gone = True
    with Beside(reader) as stream:
        assert stream.write("x") == 1
        wait_for(lambda: stream.is_gone)
        assert stream.write("y") == 1
    assert reader.got == []


def test_a_question_between_the_lines_of_a_run_is_shown_and_so_is_what_comes_after_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """typer took the stream for one of bytes; nothing more was shown of a run on the cell that was resumed."""
    shown = tmp_path / "shown.txt"
    with shown.open("w", encoding="utf-8") as terminal:
        monkeypatch.setattr(sys, "stdout", terminal)
        monkeypatch.setattr(sys, "stdin", io.StringIO("y\n"))
        with streams.unwatched():
            assert typer.confirm("May the run go on?")
            print("it goes on")
    assert shown.read_text(encoding="utf-8") == "May the run go on? [y/N]: it goes on\n"
