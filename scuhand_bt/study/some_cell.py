"""A cell that is not quite the simulated one: its powders flow otherwise, its balance answers otherwise.

Nobody knows how, before a run. Each trial has one such cell, so that a plan's intervals hold what is not known. How far
apart cells are is assumed, and held against plants of another family by `benchmarks.forecasts`: fresh powder of a lot
that was never dosed flows at half to twice what was believed, its lumps depend on how it was stored, and balances on
the market answer within 0.2 to 2 s.
"""

import math
from typing import ClassVar

import numpy as np

from scuhand_bt.cell_spec import BalanceSpec
from scuhand_bt.sim.powder import OurPowderFlow
from scuhand_bt.sim.response import OurBalanceResponse
from scuhand_bt.specs import Powder

FLOW, LUMPS, LAG, NOISE = 0.35, 0.5, 0.5, 0.3
"""Standard deviations of the logarithms: of a powder's flow and of its lumps' mass, of the balance's lag and noise."""
SLOWER = 1.5
"""The median balance lags so many times as long as the one in the lab's files."""
DEAD_MM = 0.03
"""Of the opening at which a powder begins to flow."""


class SomeCell:
    """A plant (`--plant`) whose figures are drawn; `seed` says which."""

    seed: ClassVar[int] = 0

    def __init__(self) -> None:
        rng = np.random.default_rng([self.seed, 0x5CE11])
        self._flow, self._dead, self._lag, self._noise, self._lumps = rng.standard_normal(5)

    def flow(self, powder: Powder) -> OurPowderFlow:
        ours = powder.simulation
        figures = {
            "flow_coefficient": ours.flow_coefficient * math.exp(FLOW * self._flow),
            "dead_diameter_mm": max(0.0, ours.dead_diameter_mm + DEAD_MM * self._dead),
            "surge_mg": ours.surge_mg * math.exp(LUMPS * self._lumps),
        }
        return OurPowderFlow(powder.model_copy(update={"simulation": ours.model_copy(update=figures)}))

    def balance(self, spec: BalanceSpec) -> OurBalanceResponse:
        ours = spec.simulation
        figures = {
            "lag_s": ours.lag_s * SLOWER * math.exp(LAG * self._lag),
            "noise_mg": ours.noise_mg * math.exp(NOISE * self._noise),
        }
        return OurBalanceResponse(spec.model_copy(update={"simulation": ours.model_copy(update=figures)}))
