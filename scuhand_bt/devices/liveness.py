"""Whether the run's tick is alive: what feeds the arm's stop and the hand's dead-man.

A driver's thread goes on when the run that commands it hangs, so it must not vouch for the run. The run
beats (`run.clock` and the runner, at every tick and every slice of a wait); drivers ask how long ago.
"""

import time

LIMIT_S = 0.07
"""Longer without a beat, and what moves is stopped: it stands within 100 ms. Waits beat every 20 ms."""


class Hung(BaseException):
    """Raised in whatever the run's thread does, once that has taken far too long: no skill is to catch it."""


class Liveness:
    """The run's pulse. Until the first beat nobody is watched: a console without a run, a test."""

    def __init__(self) -> None:
        self._last_s: float | None = None

    def beat(self) -> None:
        """The tick is alive now."""
        self._last_s = time.monotonic()

    def end(self) -> None:
        """The run is over: nobody is watched any more."""
        self._last_s = None

    @property
    def last_s(self) -> float | None:
        """When the tick was last alive, by the wall's clock; None where nobody is watched."""
        return self._last_s

    @property
    def silent_s(self) -> float:
        """Seconds since the last beat; 0 where nobody is watched."""
        return 0.0 if self._last_s is None else time.monotonic() - self._last_s

    @property
    def is_alive(self) -> bool:
        return self.silent_s <= LIMIT_S
