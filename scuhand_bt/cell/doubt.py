"""Whether a stable mean contradicts what a controller took to be on the pan, by what it believes of the balance.

    |mean - estimate|  >  5 s + 0.3 |estimate - estimate four lags before|

A stable mean knows nothing of lags, so it tells that a learnt one holds no more. s [mg] is the noise of a reading; the
second term allows for what a sound model may miss of the powder that came last. Of 379 weighings of known balances in
35 sound dry runs none came beyond 0.44 of the right-hand side; a filter that goes from 0.3 to 1.0 s a pole while powder
flows takes them to three times it.
"""

from collections.abc import Sequence
from itertools import pairwise

from scuhand_bt.cell.cell import Cell
from scuhand_bt.cell.dose_loop import CurvePoint
from scuhand_bt.events import BalanceDoubted
from scuhand_bt.specs import BalanceBelief

NOISES = 5.0
RECENT_LAGS = 4.0
RECENT_SHARE = 0.3


def doubt_balance(cell: Cell, believed: BalanceBelief, curve: Sequence[CurvePoint]) -> None:
    """Give up what was believed of the balance in a dose, where a weighing of it says otherwise; the next one probes.

    A dose that has learnt it anew is believed.
    """
    if believed.fits == 0 or cell.balance_belief.fits != believed.fits:
        return
    for before, now in pairwise(curve):
        if not now.stable or before.stable:
            continue
        difference_mg = now.net_mg - before.estimate_mg
        allowed_mg = _allowed_mg(believed, cell.spec.balance.readability_mg, curve, before)
        if abs(difference_mg) > allowed_mg:
            doubted = BalanceDoubted(difference_mg=difference_mg, allowed_mg=allowed_mg, lag_s=believed.lag_s)
            cell.balance_belief = BalanceBelief()
            cell.record.event(doubted)
            return


def _allowed_mg(believed: BalanceBelief, digit_mg: float, curve: Sequence[CurvePoint], now: CurvePoint) -> float:
    since_s = now.time_s - RECENT_LAGS * believed.lag_s
    then = next(point for point in curve if point.time_s >= since_s)
    return NOISES * max(believed.noise_mg, digit_mg) + RECENT_SHARE * abs(now.estimate_mg - then.estimate_mg)
