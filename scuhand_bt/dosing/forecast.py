"""How long a dose takes, before anything of it is known but what its powder is believed to be.

The mass at full flow; what is left of it by openings that become ever smaller; and the loads that it uses up. It is the
arithmetic of `adaptive`, and follows none of its decisions: of doses in dry runs it says what their mean takes.
"""

import math

from scuhand_bt.specs import Powder, PowderBelief

WEIGHED_S = 7.0
"""What each dose takes beside its openings: a weighing before it, a watch of the pan and a weighing after it."""
OPENING_S = 2.0
"""From one opening until the next: the balance has shown what came."""
SHAKEN_S = 8.0
"""By so much longer where powder comes only shaken: little at a time, and the motor's ringing besides."""
LOAD_S = 30.0
"""A load that is used up within a dose: it gives out, open and shaken, and another one is scooped and brought."""
LEAST_GAP_MM = 0.1
"""The widest opening is taken to be so far above the threshold, at least."""


def full_flow_s(mass_mg: float, powder: PowderBelief, max_opening_mm: float) -> float:
    """How long a mass takes at full flow."""
    gap_mm = max(max_opening_mm - powder.threshold_mm, LEAST_GAP_MM)
    flow_mg_per_s: float = powder.coefficient * gap_mm**powder.exponent
    return mass_mg / flow_mg_per_s


def dose_s(mass_mg: float, tolerance_mg: float, powder: Powder, max_opening_mm: float) -> float:
    """How long a dose takes with the loads that it uses up, but for its first.

    Each opening may let out as much as the flow's spread lets it exceed what was meant, and no more than is to come:
    with a relative spread s it leaves s / (1 + s) of that, until the tolerance is left.
    """
    belief = powder.belief
    openings = math.log1p(mass_mg / tolerance_mg) / math.log1p(1.0 / belief.spread)
    each_s = OPENING_S + SHAKEN_S * belief.vibration
    loads = mass_mg / powder.load_limit_mg
    return WEIGHED_S + openings * each_s + full_flow_s(mass_mg, belief, max_opening_mm) + loads * LOAD_S
