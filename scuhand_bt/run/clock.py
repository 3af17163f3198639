"""The two clocks: virtual time, which jumps to the next event, and wall time."""

import math
import threading
import time
from collections.abc import Callable, Sequence
from typing import Protocol

from scuhand_bt.clock import Signal, Wake


class Process(Protocol):
    """What advances with virtual time: the simulated world."""

    def step(self, now_s: float, limit_s: float) -> float:
        """Advance by one step of its own choice, at most to `limit_s`. Returns the new time [s]."""
        ...

    def save(self) -> None:
        """Save its state where it outlives this program."""
        ...


SAVED_EVERY_S = 1.0
"""How far a killed dry run's world may be behind [s]. Its journal is not ahead of it, as it saves the world first."""


class VirtualClock:
    """Time of a dry run, which passes as fast as the simulated world can be computed.

    With `speed` it also sleeps, so that virtual time passes at most `speed` times as fast as wall time. While a person
    is waited for (`is_waited_in`), it passes at most as fast as wall time. `beat` is called throughout each wait. The
    process is saved whenever that is `SAVED_EVERY_S` ago.
    """

    def __init__(
        self,
        process: Process | None = None,
        speed: float | None = None,
        beat: Callable[[], None] = lambda: None,
    ) -> None:
        self.now_s = 0.0
        self.process = process
        self.hurries: Callable[[], bool] = lambda: False
        """Whether `speed` is ignored, as the cell is to be made safe."""
        self.is_waited_in: Callable[[], bool] = lambda: False
        """Whether a person is being waited for, whose time is wall time."""
        self.before_wait: Callable[[], None] = lambda: None
        """Called before each wait, when nothing more happens at the current time."""
        self._speed = speed
        self._beat = beat
        self._save_at_s = 0.0
        self._pace = speed
        """The current limit of virtual over wall time."""
        self._paced_from_s, self._paced_from_wall_s = 0.0, time.monotonic()

    def go_on_from(self, now_s: float) -> None:
        """Continue the time of an interrupted run."""
        self.now_s = self._save_at_s = now_s
        self._pace_from_here()

    def save(self) -> None:
        """Save the process."""
        if self.process is not None:
            self.process.save()
        self._save_at_s = self.now_s + SAVED_EVERY_S

    def wait(self, wakes: Sequence[Wake]) -> None:
        """Advance to the earliest of `wakes`, stepping the process on the way.

        Raises RuntimeError if nothing could ever wake it: no time is given and no process could fire a signal.
        """
        limit_s, signals = math.inf, list[tuple[Signal, int]]()
        for until_s, signal, seen in wakes:  # plain loops, here and in `_has_fired`: generators take twice as long
            if until_s < limit_s:
                limit_s = until_s
            if signal is not None:
                signals.append((signal, seen))
        self.before_wait()
        process, beat = self.process, self._beat
        if math.isinf(limit_s) and (process is None or not signals):
            raise RuntimeError("a wait without end: no time given, and nothing that could fire")
        if self.now_s >= self._save_at_s:
            self.save()
        beat()
        while self.now_s < limit_s and not _has_fired(signals):
            self.now_s = limit_s if process is None else process.step(self.now_s, limit_s)
            beat()
            self._keep_pace()

    def hold(self, wakes: Sequence[Wake]) -> None:
        """Stop time until a signal of `wakes` fires."""
        self.before_wait()
        held_at = time.monotonic()
        while not any(wake.has_fired for wake in wakes):
            time.sleep(0.02)
            self._beat()
        self._paced_from_wall_s += time.monotonic() - held_at

    def _keep_pace(self) -> None:
        pace = min(1.0, self._speed or 1.0) if self.is_waited_in() else self._speed
        if pace != self._pace:
            self._pace = pace
            self._pace_from_here()
        while pace is not None and not self.hurries() and (ahead_s := self._ahead_s(pace)) > 0.002:
            time.sleep(min(ahead_s, 0.05))

    def _pace_from_here(self) -> None:
        self._paced_from_s, self._paced_from_wall_s = self.now_s, time.monotonic()

    def _ahead_s(self, pace: float) -> float:
        return (self.now_s - self._paced_from_s) / pace - (time.monotonic() - self._paced_from_wall_s)


def _has_fired(signals: Sequence[tuple[Signal, int]]) -> bool:
    """Called after every step of the world."""
    for signal, seen in signals:  # noqa: SIM110
        if signal.count != seen:
            return True
    return False


BEAT_S = 0.02
"""Time between two beats of a wait [s]: a third of what drivers allow (`devices.liveness`)."""


class WallClock:
    """Time of a run on real devices, whose threads fire the signals. `beat` is called throughout each wait."""

    def __init__(self, beat: Callable[[], None] = lambda: None, began_s: float = 0.0) -> None:
        self._began = time.monotonic() - began_s
        self._news = threading.Condition()
        self._beat = beat

    @property
    def now_s(self) -> float:
        return time.monotonic() - self._began

    def go_on_from(self, now_s: float) -> None:
        """Continue the time of an interrupted run."""
        self._began = time.monotonic() - now_s

    def wait(self, wakes: Sequence[Wake]) -> None:
        """Sleep until the earliest of `wakes` is due or one of their signals has fired."""
        limit_s = min((wake.until_s for wake in wakes), default=math.inf)
        for wake in wakes:
            if wake.signal is not None:
                wake.signal.on_fire = self._notify
        self._beat()
        with self._news:
            while self.now_s < limit_s and not any(wake.has_fired for wake in wakes):
                # In slices: Python's signal handlers run only between waits, and drivers expect beats.
                self._news.wait(min(limit_s - self.now_s, BEAT_S))
                self._beat()

    def hold(self, wakes: Sequence[Wake]) -> None:
        """As `wait`: real time does not stop."""
        self.wait(wakes)

    def _notify(self) -> None:
        with self._news:
            self._news.notify_all()
