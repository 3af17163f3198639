"""Our scoop: the expected share of `scuhand_bt.dosing.scooping`, with its spread, and at most what fits.

    collected = m * share * (1 + 0.05 n),   at most V rho

m [mg] is in the mortar, n is normal, V [mm^3] the closed cone's volume and rho [mg/mm^3] the bulk density.
"""

from dataclasses import dataclass

from numpy.random import Generator

from scuhand_bt.dosing.cone import Cone
from scuhand_bt.dosing.scooping import bed_diameter_mm, collected_share
from scuhand_bt.specs import Mortar, Powder

SPREAD = 0.05


@dataclass
class BowlStroke:
    """One closing of the cone in contact with a mortar's bowl."""

    diameter_mm: float
    """Of the rim, on contact with the wall."""
    closed_diameter_mm: float
    """Of the rim, at the end of the stroke."""
    overtravel_mm: float
    """How far the sheet was pressed onto the wall."""


class OurScoopYield:
    """A share of what is there, limited by the cone."""

    def __init__(self, powder: Powder) -> None:
        self._density = powder.bulk_density_mg_per_mm3

    def collect(self, stroke: BowlStroke, mortar: Mortar, in_mortar_mg: float, rng: Generator) -> float:
        """The mass [mg] that ends in the cone."""
        bed_mm = bed_diameter_mm(mortar, in_mortar_mg, self._density)
        share = collected_share(stroke.diameter_mm, stroke.closed_diameter_mm, stroke.overtravel_mm, bed_mm)
        share *= 1.0 + SPREAD * rng.standard_normal()
        holds_mg = Cone(stroke.closed_diameter_mm).volume_mm3 * self._density
        return min(max(0.0, share) * in_mortar_mg, in_mortar_mg, holds_mg)
