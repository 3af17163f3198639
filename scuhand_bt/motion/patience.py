"""How long a search goes on once it has an answer.

With budgets that are counts, the same request has the same answer on every machine. Where an arm waits, time counts
too: the best answer certified by then is used. Such an answer depends on the machine, so it is marked and not kept. If
nothing is certified yet, the search goes on to the end of its counts, and fails only by these.
"""

import math
import time

now_s = time.monotonic
FOR_EVER_S = math.inf
LIVE_S = 0.4
"""How long a real run waits for a quicker motion [s]. In random cells 19 of 20 loads take at most half of it."""


class Patience:
    """Begins now, and is over after `lasts_s` [s, wall time]."""

    def __init__(self, lasts_s: float = FOR_EVER_S) -> None:
        self._end_s = now_s() + lasts_s
        self.cut_short = False
        """Whether it has ended a search."""

    def ends(self, has_answer: bool) -> bool:
        """Whether a search is to end here, given whether it has an answer."""
        is_over = has_answer and now_s() >= self._end_s
        self.cut_short |= is_over
        return is_over
