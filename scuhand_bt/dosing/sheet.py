"""The force of a lip pressed into a wall, by the sheet's bending stiffness.

    F = 3 E I y / l^3,      I = b t^3 / 12 (1 - nu^2)

A strip of the sheet that ends in the lip bends like a cantilever: y over-travel, l free length, b width, t the sheet's
thickness; E and nu of polyacetal. The curved sheet is stiffer than a flat strip by `CURVED`, which can be measured with
a kitchen scale under the mortar. N, mm, MPa.
"""

from scuhand_bt.device_specs.hand import HandSpec

MODULUS_MPA = 2700.0
"""Polyacetal (data sheets: 2.6 to 2.9 GPa)."""
POISSON = 0.35
FREE_SHARE = 0.3
"""Length that bends, as a share of the slant."""
WIDTH_SHARE = 0.6
"""Width that touches, as a share of the slant."""
CURVED = 4.0
"""How much stiffer the curved strip is than a flat one: a guess."""
LIP_FORCE_LIMIT_N = 2.0
"""The most that the lip may press: the mortar stands by its own weight, and powder is not to be ground."""


def lip_force_n(over_travel_mm: float, hand: HandSpec) -> float:
    """The force [N] of a lip that would be `over_travel_mm` beyond the wall."""
    free_mm = FREE_SHARE * hand.sheet_radius_mm
    inertia_mm4 = WIDTH_SHARE * hand.sheet_radius_mm * hand.sheet_thickness_mm**3 / (12 * (1 - POISSON**2))
    return CURVED * 3 * MODULUS_MPA * inertia_mm4 * over_travel_mm / free_mm**3
