"""How wide the valve may be, and when it must shut: one chance constraint for every opening.

    P(mass that has left when the valve is shut > most) <= RISK        most = target + tolerance - guard

The mass is the bank's: a mixture of normal distributions, one for each balance that is thinkable, with what each has
not shown yet, the spread of the flow, of the opening and of the lumps.

How wide: for the mean flow until the valve can answer the next reading and is shut; and, as what the flow is more than
that stays unseen for the balance's delay T, for its spread over T:

    (sigma_q^2 + walk^2 + off^2 + (UNSEEN_ERROR q)^2) T^2 + 2 m q T          [mg^2], with the lumps' mean mass m [mg]

or, where that is less harmful, for its spread until it has reached the aim, at which it is shut by reckoning.

When to shut: for the next reading's time.
"""

from functools import lru_cache

import numpy as np

from scuhand_bt.dosing import filters
from scuhand_bt.dosing.estimation import EXPONENT_ERROR, K_WALK_PER_S, Bank
from scuhand_bt.dosing.identification import Array
from scuhand_bt.dosing.valve import FlowShape

RISK = 0.005
"""The greatest probability of too much, of every opening at every reading."""
UNSEEN_ERROR = 0.2
"""No balance is just its model: what a flow's unseen part is off by, relative to it."""
CHOICES = 40
"""Openings that are compared, from the narrowest that lets powder through to the widest."""
NARROWEST_MM = 0.05
"""Above the threshold: nothing is opened by less."""


@lru_cache(maxsize=64)
def _choices(
    shape: FlowShape, narrowest_mm: float, widest_mm: float, answered_s: float, speed_mm_per_s: float
) -> Array:
    """(`CHOICES`, 6) as `filters.widest` has them."""
    gaps_mm = np.geomspace(narrowest_mm, widest_mm, CHOICES)
    phi = gaps_mm**shape.exponent
    slope = shape.exponent * phi / gaps_mm
    open_s = answered_s + gaps_mm / (shape.exponent + 1.0) / speed_mm_per_s
    return np.stack((gaps_mm, phi, slope, phi * open_s, slope * answered_s + phi / speed_mm_per_s, open_s), axis=1)


def widest_mm(
    bank: Bank,
    shape: FlowShape,
    aim_mg: float,
    most_mg: float,
    answered_s: float,
    speed_mm_per_s: float,
    max_opening_mm: float,
    reference: float,
    known_gap_mm: float,
    narrowest_mm: float,
) -> float:
    """The widest opening [mm] that the constraint allows; the narrowest where it allows none.

    `answered_s` passes between a reading and the valve's first move for it. `reference` [mg s^-1 mm^-n] is k where
    nothing is in the powder's way. `known_gap_mm` is the opening above the threshold that the flow was seen at: what
    the powder's exponent may be off by makes others the less sure. `narrowest_mm` is above the threshold, too.
    """
    widest = max(max_opening_mm - shape.threshold_mm, narrowest_mm)
    choices = _choices(shape, narrowest_mm, widest, answered_s, speed_mm_per_s)
    errors = EXPONENT_ERROR, UNSEEN_ERROR, K_WALK_PER_S * reference
    number = filters.widest(bank.held, choices, aim_mg, most_mg, known_gap_mm, RISK, *errors)
    opening_mm = shape.threshold_mm + float(choices[number, 0])
    return min(opening_mm, max_opening_mm)  # which the narrowest may be beyond
