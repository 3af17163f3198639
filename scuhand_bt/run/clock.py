"""The two clocks: virtual time, which jumps to the next event, and wall time."""

import math
import threading
import time
from collections.abc import Callable, Sequence
from typing import Protocol

from scuhand_bt.clock import Signal, Wake


class Process(Protocol):
    """What moves on with virtual time: the simulated world."""

    def step(self, now_s: float, limit_s: float) -> float:
        """Go on by one step of its own choosing, not past `limit_s`; return the new time."""
        ...

    def save(self) -> None:
        """Keep what it is now where it outlives this program."""
        ...


SAVED_EVERY_S = 1.0
"""So much of a killed dry run has not happened in its world; its journal knows of none of it, for that saves first."""


class VirtualClock:
    """Time of a dry run. It passes as fast as the simulated world can be computed.

    With `speed`, it also sleeps, so that virtual time goes at most `speed` times as fast as wall time; where
    `is_waited_in`, as fast as that at the most. `beat` is called all through each wait. The process is saved once it
    has not been for `SAVED_EVERY_S`.
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
        """Whether time need not be kept any more: the cell is to be made safe."""
        self.is_waited_in: Callable[[], bool] = lambda: False
        """Whether a person is being waited for, whose time is wall time."""
        self.before_wait: Callable[[], None] = lambda: None
        """Called before each wait: nothing more happens at this time."""
        self._speed = speed
        self._beat = beat
        self._save_at_s = 0.0
        self._pace = speed
        """At which time passes now."""
        self._paced_from_s, self._paced_from_wall_s = 0.0, time.monotonic()

    def go_on_from(self, now_s: float) -> None:
        """Take up the time of a run that was interrupted."""
        self.now_s = self._save_at_s = now_s
        self._pace_from_here()

    def save(self) -> None:
        """Let the process keep what it is now."""
        if self.process is not None:
            self.process.save()
        self._save_at_s = self.now_s + SAVED_EVERY_S

    def wait(self, wakes: Sequence[Wake]) -> None:
        """Go on to the earliest of `wakes`, letting the process take its steps on the way.

        Raises RuntimeError if nothing can ever wake: no time is given and no process could fire.
        """
        limit_s, signals = math.inf, list[tuple[Signal, int]]()
        for until_s, signal, seen in wakes:  # loops, here and in `_has_fired`: generators take twice as long
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
        """Let time stand still until a signal of `wakes` fires."""
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
    """Looked at after every step of the world."""
    for signal, seen in signals:  # noqa: SIM110
        if signal.count != seen:
            return True
    return False


BEAT_S = 0.02
"""Between two beats of a wait: a third of what drivers allow (`devices.liveness`)."""


class WallClock:
    """Time of a run on real devices, whose threads fire the signals. `beat` is called all through each wait."""

    def __init__(self, beat: Callable[[], None] = lambda: None, began_s: float = 0.0) -> None:
        self._began = time.monotonic() - began_s
        self._news = threading.Condition()
        self._beat = beat

    @property
    def now_s(self) -> float:
        return time.monotonic() - self._began

    def go_on_from(self, now_s: float) -> None:
        """Take up the time of what was interrupted."""
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
                # In slices: a signal handler of Python runs between waits only, and the drivers want to hear a beat.
                self._news.wait(min(limit_s - self.now_s, BEAT_S))
                self._beat()

    def hold(self, wakes: Sequence[Wake]) -> None:
        """Real time does not stand still."""
        self.wait(wakes)

    def _notify(self) -> None:
        with self._news:
            self._news.notify_all()
