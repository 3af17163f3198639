"""Time, as skills, devices and the simulated world know it.

One `Clock` per run tells the run's time in seconds since the run began. Nothing that takes part in a
run reads another clock and nothing sleeps: what has to wait yields a `Wake`, and the runner asks the
clock to go on to the earliest of them. The clocks themselves are in `scuhand_bt.run.clock`.
"""

import math
from collections.abc import Callable, Generator, Sequence
from datetime import datetime
from typing import Literal, NamedTuple, Protocol, TypeAlias, TypeVar

T = TypeVar("T")


class Signal:
    """Counts a device's news (a reading, the end of a motion), so that no waiter can miss one.

    `on_fire` is called after every count, from the device's thread; a clock in real time sets it to
    wake whoever waits.
    """

    __slots__ = ("count", "on_fire")

    def __init__(self) -> None:
        self.count = 0
        self.on_fire: Callable[[], None] | None = None

    def fire(self) -> None:
        self.count += 1
        if self.on_fire is not None:
            self.on_fire()


class Wake(NamedTuple):
    """When a waiting skill wants its next tick: at `until_s` of run time, or when `signal` fires.

    A tuple, as thousands are made for a sample.
    """

    until_s: float = math.inf
    signal: Signal | None = None
    seen: int = 0

    @classmethod
    def on(cls, signal: Signal, until_s: float = math.inf) -> "Wake":
        """Wake at the signal's next firing after now, at the latest at `until_s`."""
        return cls(until_s, signal, signal.count)

    @property
    def has_fired(self) -> bool:
        return self.signal is not None and self.signal.count != self.seen


Steps: TypeAlias = Generator[Wake, None, T]
"""What a skill or a device's action is: every `yield` waits, `return` gives the result."""


class Clock(Protocol):
    """The time of one run."""

    @property
    def now_s(self) -> float:
        """Seconds since the run began."""
        ...

    def wait(self, wakes: Sequence[Wake]) -> None:
        """Go on until the earliest of `wakes`; returns at once if one is due or has fired."""
        ...

    def hold(self, wakes: Sequence[Wake]) -> None:
        """Stand still until a signal of `wakes` fires; where time is real it goes on, and their times count too."""
        ...


def wall_time(precision: Literal["seconds", "milliseconds"] = "seconds") -> str:
    """The computer's time, by which records are dated and nothing else is done: ISO 8601 with its offset from UTC."""
    return datetime.now().astimezone().isoformat(timespec=precision)


def pause(clock: Clock, duration_s: float) -> Steps[None]:
    """Let time pass."""
    end_s = clock.now_s + duration_s
    while clock.now_s < end_s:
        yield Wake(end_s)


def until(clock: Clock, condition: Callable[[], bool], signal: Signal, timeout_s: float) -> Steps[bool]:
    """Wait until `condition` holds, looking whenever `signal` fires; False if it never did in time."""
    deadline_s = clock.now_s + timeout_s
    while not condition():
        if clock.now_s >= deadline_s:
            return False
        yield Wake.on(signal, deadline_s)
    return True


def carried_out(steps: Steps[T], clock: Clock) -> T:
    """Carry out steps here, to their end, and give their result: where nothing else is to go on meanwhile."""
    while True:
        try:
            wake = next(steps)
        except StopIteration as done:
            result: T = done.value
            return result
        clock.wait([wake])
