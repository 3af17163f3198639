"""In tolerance or not: the one rule by which a dose is accepted.

    |W - W*| <= T - k u(W),     k = 2

W* target, T tolerance, W net mass, u(W) its standard uncertainty [mg]. The guard band is as wide as the expanded
uncertainty (JCGM 106:2012, 8.3.2).
"""

import math

from scuhand_bt.specs import Verdict

COVERAGE = 2.0
"""k, the coverage factor; about 95 % (JCGM 100:2008, 6.3.3)."""

LIKELY = 0.9
"""`check` warns of samples that are less likely in tolerance than this."""


def judge(target_mg: float, tolerance_mg: float, net_mg: float, uncertainty_mg: float) -> Verdict:
    """The verdict on a net mass with this standard uncertainty."""
    error_mg = net_mg - target_mg
    if abs(error_mg) <= acceptance_mg(tolerance_mg, uncertainty_mg):
        return "in tolerance"
    return "over" if error_mg > 0.0 else "under"


def acceptance_mg(tolerance_mg: float, uncertainty_mg: float) -> float:
    """How far from the target a net mass may be; negative where no verdict is possible."""
    return tolerance_mg - COVERAGE * uncertainty_mg


def chance_with_lumps(tolerance_mg: float, lump_mg: float) -> float:
    """Probability that a dose of unbroken lumps ends within its tolerance, whatever shuts the valve.

    Lumps have exponential masses with this mean. The one that passes W* - T exceeds that by as much again, whatever
    came before it: P = 1 - exp(-2 T / lump).
    """
    return 1.0 - math.exp(-2.0 * tolerance_mg / lump_mg) if lump_mg > 0.0 else 1.0
