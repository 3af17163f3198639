"""Shared by the tests of drivers and twins: run a device's generator in real time, wait for something."""

import threading
import time
from collections.abc import Callable
from typing import TypeVar

from scuhand_bt.clock import Steps
from scuhand_bt.run.clock import WallClock

T = TypeVar("T")


def carry_out(steps: Steps[T], clock: WallClock) -> T:
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
