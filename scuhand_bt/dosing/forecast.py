"""How long a dose takes, known from its powder's belief alone.

It adds up the mass at full flow, the openings that become ever smaller, and the loads that are used up. It is the
arithmetic of `adaptive`, but follows none of its decisions; it gives the mean of doses in dry runs.
"""

import math

from scuhand_bt.specs import Powder, PowderBelief

WEIGHED_S = 7.0
"""Time that each dose takes beside its openings: the weighings before and after it, and a watch of the pan."""
OPENING_S = 2.0
"""Time from one opening to the next, in which the balance shows what came."""
SHAKEN_S = 8.0
"""Additional time of an opening if powder comes only shaken: little at a time, and the motor's ringing."""
LOAD_S = 30.0
"""Time of a load used up within a dose: it gives out, open and shaken, and another one is scooped and brought."""
LEAST_GAP_MM = 0.1
"""Least gap above the threshold that the widest opening is taken to have."""


def full_flow_s(mass_mg: float, powder: PowderBelief, max_opening_mm: float) -> float:
    """How long a mass takes at full flow [s]."""
    gap_mm = max(max_opening_mm - powder.threshold_mm, LEAST_GAP_MM)
    flow_mg_per_s: float = powder.coefficient * gap_mm**powder.exponent
    return mass_mg / flow_mg_per_s


def dose_s(mass_mg: float, tolerance_mg: float, powder: Powder, max_opening_mm: float) -> float:
    """How long a dose takes [s], with all loads that it uses up but the first.

    An opening with a relative spread s of the flow leaves s / (1 + s) of what is missing, until the tolerance is left.
    """
    belief = powder.belief
    openings = math.log1p(mass_mg / tolerance_mg) / math.log1p(1.0 / belief.spread)
    each_s = OPENING_S + SHAKEN_S * belief.vibration
    loads = mass_mg / powder.load_limit_mg
    return WEIGHED_S + openings * each_s + full_flow_s(mass_mg, belief, max_opening_mm) + loads * LOAD_S
