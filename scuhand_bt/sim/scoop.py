"""The random part of our scoop: how much of what the bed lifts stays in the cone.

collected = lifted * y * (1 + 0.05 n), at most all there is; n is standard normal; y is 1 unless the caller sets it
"""

from numpy.random import Generator

from scuhand_bt.specs import Powder

SPREAD = 0.05


class OurScoopYield:
    """The bed's yield with a relative spread `SPREAD`."""

    def __init__(self, powder: Powder, yields: float = 1.0) -> None:
        self.powder, self.yields = powder, yields

    def collect(self, lifted_mg: float, there_mg: float, rng: Generator) -> float:
        """The mass [mg] that stays in the cone."""
        return min(max(0.0, lifted_mg * self.yields * (1.0 + SPREAD * rng.standard_normal())), there_mg)
