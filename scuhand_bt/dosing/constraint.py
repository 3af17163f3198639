"""How wide the valve may open: one chance constraint for every opening (docs/dosing.md, The constraint).

    P(M when the valve is shut > most) <= RISK        most = target + tolerance - 2 u

M is the mass that has left, by the mixture of all filters of the bank. The mean flow goes on until the valve has
answered the next reading and is shut. What the flow q exceeds its mean by stays unseen for the balance's delay T, which
adds (`filters.widest`), times `erratic`,

    [sigma_q^2 + off^2 + (UNSEEN_ERROR q)^2] T^2 + walk^2 T^3 + 2 m q T        [mg^2]

with the exponent's error off, the walk of k per root second, and the lumps' mean mass m [mg]. If it is less harmful, T
is replaced by the time until the expected mass is the aim, as the valve then shuts by dead reckoning.
"""

from functools import lru_cache

import numpy as np

from scuhand_bt.dosing import filters
from scuhand_bt.dosing.estimation import EXPONENT_ERROR, K_WALK_PER_S, Bank
from scuhand_bt.dosing.identification import Array
from scuhand_bt.dosing.valve import FlowShape

RISK = 0.005
"""Probability of too much that is allowed at every reading of every opening."""
UNSEEN_ERROR = 0.2
"""Error of the balance's model, as a share of a flow's unseen part: no balance is exactly its model."""
CHOICES = 40
"""Openings that are compared, from the narrowest that lets powder through to the widest."""
NARROWEST_MM = 0.05
"""Narrowest opening above the threshold."""


@lru_cache(maxsize=64)
def _choices(
    shape: FlowShape, narrowest_mm: float, widest_mm: float, answered_s: float, speed_mm_per_s: float
) -> Array:
    """The (`CHOICES`, 6) array that `filters.widest` takes."""
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

    `answered_s` passes from a reading until the valve first moves for the next. `reference` is k_ref [mg s^-1 mm^-n].
    `known_gap_mm` is the opening above the threshold at which the flow was seen: the farther from it, the more the
    exponent's error counts. `narrowest_mm` is above the threshold, too.
    """
    widest = max(max_opening_mm - shape.threshold_mm, narrowest_mm)
    choices = _choices(shape, narrowest_mm, widest, answered_s, speed_mm_per_s)
    errors = EXPONENT_ERROR, UNSEEN_ERROR, K_WALK_PER_S * reference
    number = filters.widest(bank.held, choices, aim_mg, most_mg, known_gap_mm, RISK, *errors)
    opening_mm = shape.threshold_mm + float(choices[number, 0])
    return min(opening_mm, max_opening_mm)  # the narrowest may be beyond that
