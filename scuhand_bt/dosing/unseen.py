"""What an opening lets out before it is seen: how wide it may begin for that, and how long it may last.

A sheet sticks as it bends, and a flow is stronger than believed; either is seen when the balance has shown it. Where
readings are rare an opening ends before the next one tells.
"""

import math
from dataclasses import replace

import numpy as np

from scuhand_bt.dosing.constraint import RISK
from scuhand_bt.dosing.estimation import EXPONENT_ERROR, UNKNOWN_ERROR_MM
from scuhand_bt.dosing.knowledge import HARDLY_EVER, LEAST_HOLD_S, Knowledge

STUCK_MM = 0.3
"""Once in a hundred openings the sheet sticks as it bends, and lets go wider by this."""
STRONG = 0.5
"""How much more of the flow it is allowed for then, at most."""
SEEN_S, SEEN_READINGS = 0.4, 2
"""So long after the balance's delay, and so many readings, it is seen whether the sheet has stuck."""
NARROWER = 0.95
"""Openings that are compared to begin with are each so much narrower than the one before."""
HOLDS = 12
"""So many durations are compared."""


def sees_s(known: Knowledge) -> float:
    """So long beside the balance's delay something must last to be seen."""
    return max(SEEN_S, SEEN_READINGS * known.request.balance_period_s)


def seen_s(known: Knowledge) -> float:
    """So long after an opening began it is seen whether the sheet has stuck."""
    return known.bank.delay_s + sees_s(known)


def stuck_mg(known: Knowledge, opening_mm: float, open_s: float) -> float:
    """What an opening lets out that is shut after so long, where the sheet has stuck."""
    return _strong(known) * known.valve.passes(opening_mm + STUCK_MM, open_s)


def _strong(known: Knowledge) -> float:
    """The flow's coefficient that a sheet which sticks is allowed for with."""
    return max(known.reference * (1.0 + min(known.spread, STRONG)), known.seen)


def begins_mm(known: Knowledge, most_mg: float) -> float:
    """How wide an opening may be until it is seen: so that `most_mg` are not exceeded if it sticks, or the narrowest.

    Nor if the sheet has not stuck, and the flow is as strong as it hardly ever is.
    """
    opening_mm = known.request.max_opening_mm
    while opening_mm > known.least_mm and _unseen_mg(known, opening_mm) > most_mg:
        opening_mm = max(known.least_mm, NARROWER * opening_mm)
    return opening_mm


def _unseen_mg(known: Knowledge, opening_mm: float) -> float:
    """What an opening may let out before it is seen, where exponent and threshold may be off by as much as they may."""
    until_s, gap_mm = seen_s(known), max(opening_mm - known.shape.threshold_mm, known.gap_mm)
    by_threshold = known.shape.exponent * UNKNOWN_ERROR_MM * (1.0 / known.gap_mm - 1.0 / gap_mm)
    off = math.hypot(EXPONENT_ERROR * math.log(gap_mm / known.gap_mm), by_threshold)
    strong = math.exp(math.hypot(math.log1p(HARDLY_EVER * known.spread), HARDLY_EVER * off))
    strong_mg = known.reference * strong * known.valve.passes(opening_mm, until_s)
    return max(math.exp(off) * stuck_mg(known, opening_mm, until_s), strong_mg)


def hold_s(known: Knowledge, opening_mm: float, most_mg: float) -> float:
    """How long the constraint lets an opening last that no reading ends before; until the next at the most.

    On a balance that tells readings rarely the narrowest may let out too much until then, and one that begins may
    be of a sheet that sticks.
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
