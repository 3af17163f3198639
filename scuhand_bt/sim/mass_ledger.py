"""All the powder of a world, and the one operation that moves it.

source:NAME   in that mortar              container:ID   in that container: the true mass of its dose
cone          in the cone                 pan            on the balance, beside the container's mouth
sheet         stuck to the sheet          returned       put back into another powder's mortar
flight        fallen, not yet landed      waste, spilled
"""

import math
from collections.abc import Mapping

from scuhand_bt.specs import Source

PLACES = ("cone", "sheet", "flight", "pan", "returned", "waste", "spilled")


class Matter:
    """Masses in compartments that never go negative; only `transfer` changes them."""

    def __init__(self, sources: Mapping[str, Source]) -> None:
        self.masses_mg: dict[str, float] = dict.fromkeys(PLACES, 0.0)
        """By compartment; those of containers come as the containers do."""
        for name, source in sources.items():
            self.masses_mg[f"source:{name}"] = source.amount_mg

    @property
    def total_mg(self) -> float:
        """All there is; the same at all times."""
        return math.fsum(self.masses_mg.values())

    def transfer(self, source: str, target: str, mass_mg: float) -> None:
        """Move powder. ValueError for NaN, a negative mass, or more than there is."""
        there_mg = self.masses_mg[source]
        if not 0.0 <= mass_mg <= there_mg:
            raise ValueError(f"cannot move {mass_mg!r} mg from {source}, which holds {there_mg!r} mg")
        self.masses_mg[source] = there_mg - mass_mg
        self.masses_mg[target] += mass_mg
