"""What a person sees of a run in a real terminal, and how much is told."""

import os
import re
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from conftest import REPOSITORY, Call
from resuming import Run, Watch
from running import dry_run, make_lab
from terminal_bench import BATCH, SIZES, unwrapped

from scuhand_bt.report.live import PlainLines
from scuhand_bt.run.questions import MEANINGS


@pytest.mark.slow
def test_watching_a_run_to_its_end_says_what_to_do_next(tmp_path: Path, command: Call) -> None:
    lab = make_lab(tmp_path / "lab")
    run = Run(tmp_path, lab, BATCH)
    run.folder = lab / ".scuhand" / "runs"
    run.go(Watch("stop", 1))
    code, out, _ = command("watch", "last", "--lab", lab)
    assert code == 0
    assert f"{run.journal.stem} (SIMULATED): stopped: as was asked for; 0 of 3 samples good." in out
    for what in ("resume", "report", "show"):
        assert f"`scuhand-bt {what} {run.journal.stem}`" in out
    table = out.split("holds (sim.)")[1]
    assert re.findall(r"^(\w)  ", table, re.M) == ["a", "b", "c"], "the plan's order, though `a` was told last"


# --- how much is told


@pytest.mark.slow
def test_each_action_and_why_it_failed_is_told_if_wished(tmp_path: Path) -> None:
    lines: list[str] = []
    plain = PlainLines(lines.append, 3, each_action=True)
    dry_run(tmp_path, BATCH, controller=None, at_tick=plain.ticked)
    assert lines.count("  dispense running") == lines.count("  dispense done") == 3
    assert any(line.startswith("  cone_holds failed: hand.cone_empty") for line in lines)


def test_a_quiet_run_says_only_what_it_came_to(tmp_path: Path, command: Call) -> None:
    lab = make_lab(tmp_path / "lab")
    recipe = tmp_path / "r.yaml"
    recipe.write_text(
        BATCH + "sources:\n  beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 9 g}\n"
    )
    code, out, _ = command("run", recipe, "--dry-run", "--quiet", "--lab", lab)
    lines = out.splitlines()
    assert code == 0
    assert lines[0].startswith("3 of 3 samples good; ")
    assert [line.split(":")[0] for line in lines[1:]] == ["Journal", "Head of its chain"]
    assert command("run", recipe, "--dry-run", "--quiet", "--verbose", "--lab", lab)[0] == 2


# --- in a real terminal

ASKS = """\
workflow: asks
inputs: {source: Source, container: Container, mass: Mass, tolerance: Mass}
tree:
  sequence:
    - fill_xrd_holder: {source: $source, container: $container, mass: $mass, tolerance: $tolerance}
    - ask_operator: {question: Is the shield shut?}
"""
CLOGS = "workflow: clogs\ntree: {sequence: [{clog: }]}\n"
CLOG = '''\
from scuhand_bt.skill import Cell, Code, Skill, SkillFailed, Steps


class Clog(Skill[None]):
    """Fail."""

    raises = (Code.HAND_NO_FLOW,)

    def run(self, cell: Cell) -> Steps[None]:
        yield from ()
        raise SkillFailed(Code.HAND_NO_FLOW, "no powder comes")
'''
IN_TMUX = """\
recipe: shown
workflow: asks
defaults: {source: beads, container: xrd_holder, tolerance: 2 mg}
samples:
  - {id: a, mass: 30 mg}
  - {id: broken, workflow: clogs}
  - {id: b, mass: 40 mg}
on_failure: {hand.no_flow: ask, otherwise: stop}
sources:
  beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 9 g}
"""
ONE_FOR_EACH_SIZE = """\
recipe: shown
workflow: fill_xrd_holder
defaults: {source: beads, container: xrd_holder, tolerance: 2 mg}
samples: [{id: a, mass: 30 mg, repeat: 3}]
sources:
  beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 9 g}
"""


class Tmux:
    """A terminal, whose size can be changed."""

    def __init__(self, command: str) -> None:
        self._name = f"scuhand-{os.getpid()}-{time.monotonic_ns()}"
        width, height = SIZES[0]
        self._tmux(
            "new-session", "-d", "-x", str(width), "-y", str(height), f"unset COLUMNS LINES; {command}; sleep 600"
        )

    def _tmux(self, *arguments: str) -> str:
        done = subprocess.run(["tmux", "-L", self._name, *arguments], capture_output=True, text=True, check=True)
        return done.stdout

    def keys(self, *keys: str) -> None:
        self._tmux("send-keys", *keys)

    def resize(self, size: tuple[int, int]) -> None:
        self._tmux("resize-window", "-x", str(size[0]), "-y", str(size[1]))

    def shows(self, *texts: str) -> str:
        """What is on the screen, its lines as one, once all of this is."""
        until_s = time.monotonic() + 90  # a computer may have much else to do
        while True:
            screen = self._tmux("capture-pane", "-p")
            if all(text in (shown := unwrapped(screen.splitlines())) for text in texts):
                return shown
            assert time.monotonic() < until_s, f"{texts} in:\n{screen}"
            time.sleep(0.1)

    def shows_in_every_size(self, *texts: str) -> None:
        for size in SIZES:
            self.resize(size)
            self.shows(*texts)

    def end(self) -> None:
        self._tmux("kill-server")


@contextmanager
def terminal_of(folder: Path, recipe: str, *options: str) -> Iterator[Tmux]:
    """A dry run in a terminal."""
    lab = make_lab(folder / "lab", trees__asks=ASKS, trees__clogs=CLOGS, skills__clog=CLOG)
    path = folder / "shown.yaml"
    path.write_text(recipe, encoding="utf-8")
    command = [sys.executable, "-m", "scuhand_bt", "run", str(path), "--lab", str(lab), "--dry-run", *options]
    tmux = Tmux(f"cd {REPOSITORY}; {shlex.join(command)}")
    try:
        yield tmux
    finally:
        tmux.end()


needs_tmux = pytest.mark.skipif(shutil.which("tmux") is None, reason="there is no tmux (apt install tmux)")


@needs_tmux
@pytest.mark.slow
def test_a_run_that_goes_on_shows_what_it_does_and_why_in_every_size(tmp_path: Path) -> None:
    with terminal_of(tmp_path, ONE_FOR_EACH_SIZE, "--speed", "6") as terminal:
        for number, size in enumerate(SIZES, start=1):
            terminal.resize(size)
            running = terminal.shows(f"a-{number}: 30.0 mg", "▶ dispense", "Ctrl-C stops now")
            assert "SIMULATED: shown" in running
            assert f"a-{number}: 30.0 mg ± 2 mg of glass_beads into xrd_holder" in running
            assert "✓ move_over ▶ dispense · return_leftover · park" in running
            assert "g, stable" in running or "g, moving" in running
            assert "valve " in running
            assert "Ctrl-Z pauses, Ctrl-\\ stops after this sample, Ctrl-C stops now" in running
        terminal.keys("C-c")
        terminal.shows("samples good;", "goes on with it")


@needs_tmux
def test_a_run_is_watched_answered_paused_and_ended_in_a_terminal_of_every_size(tmp_path: Path) -> None:
    with terminal_of(tmp_path, IN_TMUX, "--ask") as terminal:
        waits = ("? Is the shield shut?", f"done: {MEANINGS['done']}", "> ▏", "SIMULATED: shown", "▶ ask_operator")
        terminal.shows_in_every_size(*waits, "a: 30.0 mg ± 2 mg of glass_beads into xrd_holder")
        terminal.keys("dobe", "BSpace", "BSpace", "ne", "Enter")
        terminal.shows_in_every_size("b: 40.0 mg", "last: a: ", "? Is the shield shut?")
        terminal.keys("C-z")
        terminal.shows_in_every_size("Paused: no further action begins; Ctrl-Z continues", "? Is the shield shut?")
        terminal.keys("C-z")
        terminal.shows("Ctrl-Z pauses")
        terminal.keys("d", "one", "Enter")
        failed = ("? Sample 'broken' failed: hand.no_flow: no powder comes. What now?", "✗ clog: hand.no_flow: no")
        terminal.shows_in_every_size(*failed, "left undone; the batch goes on")
        terminal.resize(SIZES[0])
        terminal.keys("skip_sample", "Enter")
        ended = terminal.shows("samples good;", "writes its report", "Head of its chain:")
        assert "broken: skipped, hand.no_flow: no powder comes" in ended
        assert "2 of 3 samples good" in ended
        assert "? Sample" not in ended, "nothing is left of the picture"
