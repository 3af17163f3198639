"""Our scoop's chance: of what the bed's geometry lifts, a little more or less stays in the cone each time.

collected = lifted * y * (1 + 0.05 n),   at most all there is;   n is normal, y is 1 unless another one is drawn
"""

from numpy.random import Generator

from scuhand_bt.specs import Powder

SPREAD = 0.05


class OurScoopYield:
    """What the bed says, with its spread."""

    def __init__(self, powder: Powder, yields: float = 1.0) -> None:
        self.powder, self.yields = powder, yields

    def collect(self, lifted_mg: float, there_mg: float, rng: Generator) -> float:
        """The mass [mg] that stays in the cone."""
        return min(max(0.0, lifted_mg * self.yields * (1.0 + SPREAD * rng.standard_normal())), there_mg)
