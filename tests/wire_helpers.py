"""Shared by the tests of devices: run a device's generator, wait for something, and a motion of the arm."""

import threading
import time
from collections.abc import Callable
from typing import TypeVar

import numpy as np

from scuhand_bt.clock import Clock, Steps
from scuhand_bt.devices.interfaces import Joints
from scuhand_bt.motion.stopping import StoppableTrajectory
from scuhand_bt.motion.timelaw import RateLimits
from scuhand_bt.motion.trajectory import through

T = TypeVar("T")

READY = np.array([0.0, 0.4, 0.0, -1.6, 0.0, 0.5, 0.0])
RATES = RateLimits(np.full(7, 3.0), np.full(7, 4.4), np.full(7, 44.0))


class Sway(StoppableTrajectory):
    """A smooth motion from where the arm is by `swing_rad`, of every joint or one for each."""

    def __init__(self, start: Joints, swing_rad: float | Joints, duration_s: float) -> None:
        s = np.linspace(0.0, 1.0, 60)[:, None]
        positions = start + swing_rad * (10 * s**3 - 15 * s**4 + 6 * s**5)
        super().__init__(through(s[:, 0] * duration_s, positions), RATES, 0.12)


def carry_out(steps: Steps[T], clock: Clock) -> T:
    while True:
        try:
            wake = next(steps)
        except StopIteration as done:
            return done.value
        clock.wait([wake])


def wait_for(condition: Callable[[], object], timeout_s: float = 20.0) -> None:
    end_s = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end_s, "this never came true"
        time.sleep(0.002)


class Metronome:
    """Sleeps for a moment again and again beside what is tested, and notes the latest that it was woken."""

    def __init__(self) -> None:
        self.latest_s = 0.0
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._tick, daemon=True)

    def __enter__(self) -> "Metronome":
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._over.set()
        self._thread.join()

    def _tick(self) -> None:
        due_s = time.monotonic()
        while not self._over.is_set():
            due_s += 0.005
            time.sleep(max(0.0, due_s - time.monotonic()))
            now_s = time.monotonic()
            self.latest_s = max(self.latest_s, now_s - due_s)
            due_s = max(due_s, now_s - 0.005)
