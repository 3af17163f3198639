"""What an opening lets out before it is seen: how wide it may begin, and how long it may last (docs/dosing.md).

A sheet may stick as it bends, and a flow may be stronger than believed; either shows only after the balance's delay.
With rare readings, an opening ends before the next one tells.
"""

import math
from dataclasses import replace

import numpy as np

from scuhand_bt.dosing.constraint import RISK
from scuhand_bt.dosing.estimation import EXPONENT_ERROR, UNKNOWN_ERROR_MM
from scuhand_bt.dosing.knowledge import HARDLY_EVER, LEAST_HOLD_S, Knowledge

STUCK_MM = 0.3
"""About once in a hundred openings the sheet sticks, and then lets go wider by this."""
STRONG = 0.5
"""The most by which a stronger flow is allowed for then, as a share of k_ref."""
SEEN_S, SEEN_READINGS = 0.4, 2
"""Time after the balance's delay, and number of readings, in which a stuck sheet is noticed."""
NARROWER = 0.95
"""Factor between successive beginning widths that are tried."""
HOLDS = 12
"""Durations that are compared."""


def sees_s(known: Knowledge) -> float:
    """How long something must last, besides the balance's delay, to be seen."""
    return max(SEEN_S, SEEN_READINGS * known.request.balance_period_s)


def seen_s(known: Knowledge) -> float:
    """How long after an opening began a stuck sheet is noticed."""
    return known.bank.delay_s + sees_s(known)


def stuck_mg(known: Knowledge, opening_mm: float, open_s: float) -> float:
    """The mass [mg] that an opening lets out in `open_s` and until it is shut, if the sheet has stuck."""
    return _strong(known) * known.valve.passes(opening_mm + STUCK_MM, open_s)


def _strong(known: Knowledge) -> float:
    """The coefficient allowed for if the sheet sticks."""
    return max(known.reference * (1.0 + min(known.spread, STRONG)), known.seen)


def begins_mm(known: Knowledge, most_mg: float) -> float:
    """The widest beginning [mm] with which `most_mg` is not exceeded before it is seen; the narrowest if none.

    That holds if the sheet sticks, and if it does not but the flow is as strong as one in 200.
    """
    opening_mm = known.request.max_opening_mm
    while opening_mm > known.least_mm and _unseen_mg(known, opening_mm) > most_mg:
        opening_mm = max(known.least_mm, NARROWER * opening_mm)
    return opening_mm


def _unseen_mg(known: Knowledge, opening_mm: float) -> float:
    """The mass [mg] that an opening may let out before it is seen, with the errors of exponent and threshold."""
    until_s, gap_mm = seen_s(known), max(opening_mm - known.shape.threshold_mm, known.gap_mm)
    by_threshold = known.shape.exponent * UNKNOWN_ERROR_MM * (1.0 / known.gap_mm - 1.0 / gap_mm)
    off = math.hypot(EXPONENT_ERROR * math.log(gap_mm / known.gap_mm), by_threshold)
    strong = math.exp(math.hypot(math.log1p(HARDLY_EVER * known.spread), HARDLY_EVER * off))
    strong_mg = known.reference * strong * known.valve.passes(opening_mm, until_s)
    return max(math.exp(off) * stuck_mg(known, opening_mm, until_s), strong_mg)


def hold_s(known: Knowledge, opening_mm: float, most_mg: float) -> float:
    """How long [s] an opening may last by the constraint; until the next reading at most.

    With rare readings, even the narrowest may let out too much until then; and in a new opening the sheet may stick.
    """
    period_s, valve, bank = known.request.balance_period_s, known.valve, known.bank
    if period_s <= LEAST_HOLD_S:
        return known.until_next_s
    holds_s = np.geomspace(period_s, LEAST_HOLD_S, HOLDS).tolist()
    stuck = replace(known.shape, threshold_mm=known.shape.threshold_mm - STUCK_MM)

    def is_allowed(open_s: float) -> bool:
        if bank.chance(*valve.passing(known.shape, opening_mm, open_s), most_mg) > RISK:
            return False
        is_open = valve.opening_mm > 0.0
        return is_open or _strong(known) * valve.passing(stuck, opening_mm, open_s)[0] <= most_mg - bank.mass_mg

    longest_s: float = next(filter(is_allowed, holds_s), LEAST_HOLD_S)
    return known.until_next_s if longest_s == holds_s[0] else longest_s
