"""Notices when the computer's clock, which dates all entries, was set, so that the journal can say so.

Within a run it is compared with the time since boot, which nobody can set and which includes suspended time; between
runs with the last line of the lab's ledger.
"""

import time
from datetime import datetime, timedelta

from scuhand_bt.quantity import format_duration

JUMP_S = 60.0
"""Smaller corrections are ignored; NTP makes them all the time [s]."""
LONGEST_REST = timedelta(days=366)
"""A lab that was idle for longer is less likely than a wrong clock."""


class ClockWatch:
    """Compares the clocks from time to time."""

    def __init__(self) -> None:
        self._wall_s, self._steady_s = _now()

    def jump(self) -> str | None:
        """How the clock was set since the last call, as text; None if it was not."""
        wall_s, steady_s = _now()
        should_be_s = self._wall_s + steady_s - self._steady_s
        self._wall_s, self._steady_s = wall_s, steady_s
        if abs(wall_s - should_be_s) < JUMP_S:
            return None
        way = "forward" if wall_s > should_be_s else "back"
        return (
            f"the computer's clock was set {way} by {format_duration(abs(wall_s - should_be_s))}, from "
            f"{_at(should_be_s)} to {_at(wall_s)}; the order of the entries shows by which of the two each is dated"
        )


def disagreement(last_at: str | None) -> str | None:
    """What is odd about the clock, given the date of the last entry (ISO 8601); None if nothing is."""
    if last_at is None:
        return None
    now, last = datetime.now().astimezone(), datetime.fromisoformat(last_at)
    odd = "earlier than" if now < last - timedelta(seconds=JUMP_S) else "more than a year after"
    if odd == "more than a year after" and now - last < LONGEST_REST:
        return None
    return (
        f"the computer's clock shows {now.isoformat(timespec='seconds')}, {odd} the last time that this lab has "
        f"recorded ({last_at}): check the clock"
    )


def _now() -> tuple[float, float]:
    return time.time(), time.clock_gettime(time.CLOCK_BOOTTIME)


def _at(wall_s: float) -> str:
    return datetime.fromtimestamp(wall_s).astimezone().isoformat(timespec="seconds")
