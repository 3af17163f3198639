"""Commands of the program as processes that move only when they are told to: an interleaving is then a list, not luck.

Each command runs in a fork of this process, its motions planned already. A run or a resume stops at gates: when it has
read a run's history and could wait for a person's consent, and after every so many ticks of its tree. There it tells
the true masses of its world and waits for a word. Its other threads go on: it hears wishes at a gate, too.
"""

import json
import os
import resource
import select
import signal
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

from scuhand_bt import cli, clock
from scuhand_bt.api import interrupted
from scuhand_bt.motion import MotionPlanner
from scuhand_bt.report import live
from scuhand_bt.run import control, make_cell, session, wall_clock

BROKEN = 70
"""Exit code of a command that ended by an exception that the program did not expect."""
LONGEST_S = 60.0
QUIET_S = 0.4
"""A paused run says nothing."""
FREE = 10**9
Seen = dict[str, Any]


@dataclass
class Command:
    """One command of the program, in a process of its own."""

    args: Sequence[str]
    run: str
    """The run that it is about; empty while it is not known."""
    process: int
    says: int
    hears: int
    output: Path
    gate: str = ""
    """Where it waits: `prompt`, `tick`; empty while it goes."""
    code: int | None = None
    """Its exit code; negative for a signal."""
    seen: Seen = field(default_factory=dict)
    """The last that it told."""
    is_wished_paused: bool = False
    is_elsewhere: bool = False
    """On another computer, which hears no wish of ours."""
    is_mute: bool = False
    """Its disk is full: what it says may be lost."""
    came_to: int | None = None
    """The exit code that the engine decided."""
    _rest: bytes = b""

    @property
    def text(self) -> str:
        return self.output.read_text(encoding="utf-8", errors="replace")

    @property
    def is_overtaken(self) -> bool:
        """It ended because another one went on with its run."""
        return "another process has gone on with this run" in " ".join(self.text.split())

    def go(self, ticks: int = FREE, does: str = "", amount: float = 0.0) -> None:
        """Let it go on from its gate to the next one, or to its end; before, something `does` happen to it."""
        if self.gate:
            self.gate = ""
            os.write(self.hears, json.dumps([ticks, does, amount]).encode() + b"\n")
        self.wait()

    def wait(self) -> None:
        """Until it is at a gate, at its end, or paused. Raises TimeoutError for one that hangs."""
        limit_s = QUIET_S if self.is_wished_paused else LONGEST_S
        while self.code is None and not self.gate:
            if not select.select([self.says], [], [], limit_s)[0]:
                if self.is_wished_paused:
                    return
                self.kill()
                raise TimeoutError(f"{' '.join(self.args)} hangs")
            self._hear()

    def kill(self) -> None:
        """End it as SIGKILL does: at once, if it has not ended unheard."""
        os.kill(self.process, signal.SIGKILL)
        while self.code is None:
            self._hear()

    def _hear(self) -> None:
        """What it says next, or that it has ended."""
        if not (part := os.read(self.says, 65536)):
            self._reap()
            return
        *lines, self._rest = (self._rest + part).split(b"\n")
        for line in lines:
            told: Seen = json.loads(line)
            self.seen = told
            self.run = told["run"] or self.run
            self.gate = told["at"] if told["at"] != "end" else ""
            self.came_to = told.get("code", self.came_to)

    def _reap(self) -> None:
        _, status = os.waitpid(self.process, 0)
        self.code = -os.WTERMSIG(status) if os.WIFSIGNALED(status) else os.waitstatus_to_exitcode(status)
        self.gate = ""
        os.close(self.says)
        os.close(self.hears)


@dataclass(frozen=True)
class Computer:
    """What a command runs on: how far its clock was set [s], and whether it is another computer on the same disk."""

    clock_s: float = 0.0
    is_another: bool = False
    first_ticks: int = 1


def start(
    args: Sequence[str],
    output: Path,
    motion: MotionPlanner,
    plant: Callable[[], None],
    computer: Computer = Computer(),
    run: str = "",
) -> Command:
    """Begin a command, and wait until it is at its first gate or its end; `plant` changes the program in it."""
    ours, says = os.pipe()
    hears, words = os.pipe()
    process = os.fork()
    if process == 0:
        code = BROKEN
        try:
            os.close(ours)
            os.close(words)
            code = _child(args, output, motion, plant, computer, _Gates(says, hears, computer.first_ticks))
        except BaseException:
            os.write(2, traceback.format_exc().encode())
        finally:
            os._exit(code)
    os.close(says)
    os.close(hears)
    command = Command(args, run, process, ours, words, output, is_elsewhere=computer.is_another)
    command.wait()
    return command


def _child(
    args: Sequence[str],
    output: Path,
    motion: MotionPlanner,
    plant: Callable[[], None],
    computer: Computer,
    gates: "_Gates",
) -> int:
    file = os.open(output, os.O_CREAT | os.O_WRONLY | os.O_TRUNC)
    for number in (1, 2):
        os.dup2(file, number)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    sys.stdin, sys.stdout = open(0, closefd=False), open(1, "w", closefd=False)  # noqa: SIM115
    sys.stderr = open(2, "w", buffering=1, closefd=False)  # noqa: SIM115 - by lines, as the interpreter has it
    make_cell.prepared_motion = make_cell.motion_of = lambda *given, **options: motion  # type: ignore[assignment]
    gates.put_up()
    if computer.clock_s:
        set_clock(computer.clock_s)
    if computer.is_another:  # its sockets' names are not ours
        here = control.address_of
        control.address_of = lambda journal: here(journal) + "@another"
    plant()
    sys.argv = ["scuhand-bt", *args]
    code: Any = 0
    try:
        cli.main()
    except SystemExit as ending:
        code = ending.code
    sys.stdout.flush()
    with suppress(OSError):  # as the interpreter does
        sys.stderr.flush()
    return int(code or 0)


class _Gates:
    """Where a command waits for a word, in its own process."""

    def __init__(self, says: int, hears: int, first_ticks: int) -> None:
        self._says, self._hears = says, hears
        self._left = first_ticks
        self._session: session.Session | None = None

    def put_up(self) -> None:
        known, made, ran = interrupted.what_is_known, session.Session.__init__, session.Session.run

        def what_is_known(*given: Any) -> list[str]:
            self._wait("prompt")
            return known(*given)

        def make(one: session.Session, *given: Any, **options: Any) -> None:
            made(one, *given, **options)
            self._session = one

        def run(one: session.Session, *given: Any) -> Any:
            result = ran(one, *given)
            self._tell("end", code=int(result.exit_code))
            return result

        def ticked(observer: live.PlainLines, root: Any) -> None:
            self._left -= 1
            if self._left <= 0:
                self._wait("tick")

        interrupted.what_is_known = what_is_known
        session.Session.__init__ = make  # type: ignore[assignment]
        session.Session.run = run  # type: ignore[method-assign]
        live.PlainLines.ticked = ticked  # type: ignore[method-assign]

    def _tell(self, at: str, **more: Any) -> None:
        told: Seen = {"at": at, "told_s": time.monotonic(), "run": "", "matter": {}, **more}
        if self._session is not None and self._session.world is not None:
            world = self._session.world
            changed = [rule["fault"] for rule in world.faults.account() if rule["came_s"]]
            told |= {"run": self._session.run_id, "matter": world.masses_mg, "changed": changed}
        os.write(self._says, json.dumps(told).encode() + b"\n")

    def _wait(self, at: str) -> None:
        self._tell(at)
        word = b""
        while not word.endswith(b"\n"):
            if not (part := os.read(self._hears, 1)):  # nobody is there to let it go on
                os._exit(BROKEN)
            word += part
        self._left, does, amount = json.loads(word)
        if does == "full":
            fill_disk(int(amount))
        elif does == "clock":
            set_clock(amount)


def fill_disk(most_bytes: int) -> None:
    """No file of this process may grow beyond this: what a full disk does, to all of its files."""
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (most_bytes, resource.RLIM_INFINITY))


def set_clock(by_s: float) -> None:
    """Set this process's clock, as for those who date entries and those who watch the clock."""
    steady = time.time

    class Shifted(datetime):
        @classmethod
        def now(cls, tz: Any = None) -> Any:
            return datetime.now(tz) + timedelta(seconds=by_s)

    for module in (clock, session, wall_clock):
        module.datetime = Shifted  # type: ignore[attr-defined]
    time.time = lambda: steady() + by_s
