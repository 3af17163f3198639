"""How long a request that has an answer already is searched on for.

By counts alone the same request has the same answer on every machine. Where an arm waits, time counts too: what is not
found in it is answered by the best that is certified by then. Such an answer depends on the machine, so it is told
apart, and not kept. Where nothing is certified yet, the search goes on to the end of its counts: it fails by these
alone.
"""

import math
import time

now_s = time.monotonic
FOR_EVER_S = math.inf
LIVE_S = 0.4
"""What a real run waits for a quicker motion; nineteen of twenty loads in drawn cells take half of it at most."""


class Patience:
    """It begins now, and is over after so many seconds on the wall."""

    def __init__(self, lasts_s: float = FOR_EVER_S) -> None:
        self._end_s = now_s() + lasts_s
        self.cut_short = False
        """Whether a search was ended by it."""

    def ends(self, has_answer: bool) -> bool:
        """Whether a search that has an answer, or not, is to end here."""
        is_over = has_answer and now_s() >= self._end_s
        self.cut_short |= is_over
        return is_over
