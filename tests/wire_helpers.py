"""Shared by the tests of drivers and twins: run a device's generator in real time, wait for something."""

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
