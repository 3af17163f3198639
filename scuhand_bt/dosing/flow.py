"""The paper's model of what one pulse drops, and the fit of its one coefficient.

    W = C' D^2.5 (T(D) + t)

W mass [mg], C' lumped coefficient [mg s^-1 mm^-2.5], D opening [mm], T = D / speed the time the valve
takes to reach it [s], t the dwell there [s]. It is Beverloo's law Q = C rho sqrt(g) (D - k d)^2.5
(Beverloo, Leniger & van de Velde, Chem. Eng. Sci. 15, 1961) with the grain term k d dropped
(Takahashi et al., ICRA 2026, eq. 2). Two errors of the model are known and kept, as they are the
paper's: the two ramps together pass 2T/3.5, not T, and C' is not the same for all D when k d is not
small.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

EXPONENT = 2.5
BEVERLOO_C = 0.58
"""Nedderman, Statics and Kinematics of Granular Materials, 1992, 10.2."""
GRAVITY_MM_PER_S2 = 9810.0


@dataclass(frozen=True, slots=True)
class PulseModel:
    """W(D, t) for one powder and one valve."""

    coefficient: float
    """C' in mg s^-1 mm^-2.5."""
    valve_speed_mm_per_s: float

    def mass_mg(self, opening_mm: float, dwell_s: float) -> float:
        """The mass that a pulse is expected to drop."""
        return self.coefficient * basis(opening_mm, dwell_s, self.valve_speed_mm_per_s)


def basis(opening_mm: float, dwell_s: float, valve_speed_mm_per_s: float) -> float:
    """The factor of C' in the model: D^2.5 (T(D) + t), in mm^2.5 s."""
    return float(opening_mm**EXPONENT * (opening_mm / valve_speed_mm_per_s + dwell_s))


def fit_coefficient(bases: Sequence[float], masses_mg: Sequence[float]) -> float:
    """C' by least squares over pulses: sum(b W) / sum(b^2). Raises ValueError if nothing was ever opened."""
    square = sum(b * b for b in bases)
    if square <= 0.0:
        raise ValueError("no pulse opened the valve: nothing to fit")
    return sum(b * w for b, w in zip(bases, masses_mg, strict=True)) / square


def free_flow(bulk_density_mg_per_mm3: float) -> float:
    """C' of fine-grained powder of this density that nothing holds back [mg s^-1 mm^-2.5]."""
    return BEVERLOO_C * bulk_density_mg_per_mm3 * math.sqrt(GRAVITY_MM_PER_S2)
