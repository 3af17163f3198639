"""The process in which twins run. Its interface for other programs is in `run/twins.py`."""

import json
import socket
import threading
import time
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from dataclasses import asdict, replace
from pathlib import Path
from types import TracebackType

from scuhand_bt.clock import Signal, Wake
from scuhand_bt.journal.presence import Held, Presence
from scuhand_bt.lab import Lab
from scuhand_bt.problems import Mark, Problem, SourceError
from scuhand_bt.run.bench import bench_of
from scuhand_bt.run.clock import WallClock
from scuhand_bt.run.control import address_of
from scuhand_bt.run.hands import Answer, Hands
from scuhand_bt.run.twins import LOCK, WORLD, Made
from scuhand_bt.sim.fault_rules import FaultFile
from scuhand_bt.specs import Source

ALONE_S = 600.0
"""Twins of a run end if no program was connected for this long [s]: the run was killed, and nobody has resumed it."""
LOOK_S = 1.0


class TwinsProcess:
    """The twins of a lab's cell in a folder, with the world in it or a new one; a context manager.

    `of_run`: a run has started them and tells them of its samples. They then end if alone for `ALONE_S`, and their
    fault file may say what the run's operator does. Raises SourceError if twins already run there, for a world that
    cannot be restored and for faults that could have no effect; NoCompiler, PlantError.
    """

    def __init__(
        self,
        folder: Path,
        lab: Lab,
        sources: Mapping[str, Source],
        *,
        seed: int = 0,
        plant: str | None = None,
        faults: FaultFile | None = None,
        is_new: bool = False,
        of_run: bool = False,
    ) -> None:
        self._of_run = of_run
        self._stop = Signal()
        self._stopped = Wake.on(self._stop)
        self._not_kept: str | None = None
        with ExitStack() as opened:
            opened.callback(_held(folder).end)
            self._clock = WallClock()
            made = Made.of(lab, sources, seed, plant)
            if not is_new:
                made.require_same(folder)
            self.bench = bench_of(
                lab, seed, faults, sources, plant=plant, ports=folder, clock=self._clock, of_run=of_run
            )
            self.goes_on = (folder / WORLD).exists() and not is_new
            """Whether it continues a world that was there."""
            if self.goes_on:
                self._clock.go_on_from(self.bench.take_up(folder / WORLD, self._lose))
            else:
                made.write(folder)
                self.bench.world.keep_in(folder / WORLD, self._lose)
            opened.callback(self.bench.world.close)
            self._hands = Hands(self.bench, lab)
            self._ear = _Ear(folder, self)
            self._opened = opened.pop_all()

    def __enter__(self) -> "TwinsProcess":
        self._opened.enter_context(self.bench)
        self._opened.enter_context(self._ear)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._opened.close()

    def obey(self, words: list[str]) -> Answer:
        """Do what the words say; safe to call from any thread. After the last answer, call `end`."""
        answer = self._hands.obey(words)
        return replace(answer, found={**answer.found, "not_kept": self._not_kept}) if self._not_kept else answer

    def end(self) -> None:
        """Make `go_on` return."""
        self._stop.fire()

    def go_on(self) -> None:
        """Run until the end. Raises whatever has ended the world."""
        try:
            while not (self._stopped.has_fired or (self._of_run and self._ear.alone_s > ALONE_S)):
                self._clock.wait([self._stopped._replace(until_s=self._clock.now_s + LOOK_S)])
                self.bench.check()
        except Exception as error:
            self._ear.say_to_all({"failed": f"{error}" or type(error).__name__})
            raise

    def _lose(self, why: str) -> None:
        self._not_kept = why


class _Ear:
    """Serves other programs, each on its own thread."""

    def __init__(self, folder: Path, process: TwinsProcess) -> None:
        self._process = process
        self._callers: set[socket.socket] = set()
        self._heard_s = time.monotonic()
        self._door = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._door.bind(address_of(folder))
        self._door.listen()

    def __enter__(self) -> "_Ear":
        threading.Thread(target=self._listen, daemon=True, name="ear").start()
        return self

    def __exit__(self, *error: object) -> None:
        for line in (self._door, *self._callers):
            with suppress(OSError):
                line.shutdown(socket.SHUT_RDWR)

    @property
    def alone_s(self) -> float:
        """For how long no program has been connected [s]."""
        return 0.0 if self._callers else time.monotonic() - self._heard_s

    def say_to_all(self, what: Mapping[str, str]) -> None:
        for line in tuple(self._callers):
            with suppress(OSError):
                line.sendall(json.dumps(what).encode() + b"\n")

    def _listen(self) -> None:
        with suppress(OSError):
            while True:
                line, _ = self._door.accept()
                self._callers.add(line)
                threading.Thread(target=self._serve, args=(line,), daemon=True, name="caller").start()
        self._door.close()

    def _serve(self, line: socket.socket) -> None:
        with suppress(OSError, ValueError), line, line.makefile("rb") as lines:
            for said in lines:
                answer = self._process.obey([str(word) for word in json.loads(said)])
                line.sendall(json.dumps(asdict(answer)).encode() + b"\n")
                if answer.is_last:
                    self._process.end()
        self._heard_s = time.monotonic()
        self._callers.discard(line)


def _held(folder: Path) -> Presence:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        return Presence(folder / LOCK)
    except Held:
        what = f"twins are running here already; `scuhand-bt twins end --at {folder}` ends them"
    except OSError as error:
        what = f"twins cannot be kept here: {error.strerror or error}"
    raise SourceError([Problem(Mark(str(folder), 0), what)])
