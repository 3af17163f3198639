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
from typing import NamedTuple

import numpy as np

from scuhand_bt.dosing.estimation import EXPONENT_ERROR, K_WALK_PER_S, Bank, powers
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


def chance(bank: Bank, mean_mg: Array, variance: Array, most_mg: float) -> Array:
    """(...) probability of a mass above `most_mg` [mg], from its mean [mg] and variance [mg^2] by model, (..., H)."""
    return _chance_below(bank, (mean_mg - most_mg) / np.sqrt(variance))


def _chance_below(bank: Bank, deviations: Array) -> Array:
    """(...) probability of what is less than each model's mean and so many standard deviations, (..., H)."""
    from scipy.special import ndtr  # half a second, which not every command has to spend

    return np.asarray(ndtr(deviations) @ bank.weights)


class Choices(NamedTuple):
    """Openings that are compared."""

    gaps_mm: Array
    """Above the threshold."""
    phi: Array
    flow: Array
    """`powers` of phi and its slope."""
    way: Array
    """`powers` of the integrals of both until it is shut."""
    open_s: Array
    """The integral of phi over phi."""


@lru_cache(maxsize=64)
def _choices(
    shape: FlowShape, narrowest_mm: float, widest_mm: float, answered_s: float, speed_mm_per_s: float
) -> Choices:
    gaps_mm = np.geomspace(narrowest_mm, widest_mm, CHOICES)
    phi = gaps_mm**shape.exponent
    slope = shape.exponent * phi / gaps_mm
    open_s = answered_s + gaps_mm / (shape.exponent + 1.0) / speed_mm_per_s
    way = powers(phi * open_s, slope * answered_s + phi / speed_mm_per_s)
    return Choices(gaps_mm, phi, powers(phi, slope), way, open_s)


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
    mean_mg, variance = bank.coming(choices.way)
    flow, flow_variance = bank.flow(choices.flow)
    off = (EXPONENT_ERROR * np.log(choices.gaps_mm / known_gap_mm))[:, None] * flow
    variance += np.square(off * choices.open_s[:, None])
    lasting = np.square(off) + flow_variance + np.square(UNSEEN_ERROR * flow)
    walk = np.square(K_WALK_PER_S * reference * choices.phi)[:, None]
    lumps_mg = 2.0 * bank.surge_mg * flow

    def deviations(mean_mg: Array, unseen_s: Array) -> Array:
        unseen = ((walk * unseen_s + lasting) * unseen_s + lumps_mg) * unseen_s
        return (mean_mg - most_mg) / np.sqrt(variance + bank.erratic * unseen)

    # It is seen after the delay; or it has reached the aim by then, as far as that can be reckoned.
    left_s = np.maximum(aim_mg - mean_mg, 0.0) / np.maximum(flow, 1e-9)
    beyond = np.minimum(deviations(mean_mg, bank.delays_s), deviations(np.maximum(mean_mg, aim_mg), left_s))
    allowed = np.flatnonzero(_chance_below(bank, beyond) <= RISK)
    opening_mm = shape.threshold_mm + float(choices.gaps_mm[allowed[-1] if len(allowed) else 0])
    return min(opening_mm, max_opening_mm)  # which the narrowest may be beyond
