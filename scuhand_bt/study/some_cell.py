"""A cell that is not quite the simulated one: its powders flow, its scoops bring and its balance answers otherwise.

Nobody knows how, before a run. Each trial has one such cell, so that a plan's intervals hold what is not known. How far
apart cells are is assumed, and held against plants of another family by `benchmarks.forecasts`: fresh powder of a lot
that was never dosed flows at half to twice what was believed, its lumps depend on how it was stored, and balances on
the market answer within 0.2 to 2 s. Of 17 strokes discrete elements lift 11 % more or less (root mean square) than the
height field does (docs/scoop-yield.md); what a real one lifts nobody has weighed yet. What kind of lumps a powder comes
in, no published figure tells well enough (docs/calibration.md), and a dose's last milligrams depend on it: each trial's
are of one of three kinds.
"""

import math
from typing import ClassVar

import numpy as np
from scipy.special import ndtri  # not `stats`, which takes each process half a second

from scuhand_bt.device_specs.balance import BalanceSpec
from scuhand_bt.sim.powder import OurPowderFlow
from scuhand_bt.sim.response import OurBalanceResponse
from scuhand_bt.sim.scoop import OurScoopYield
from scuhand_bt.specs import Powder

FLOW, LUMPS, LAG, NOISE, YIELD = 0.35, 0.5, 0.5, 0.3, 0.15
"""Standard deviations of the logarithms: of a powder's flow and of its lumps' mean mass, whatever their kind, of the
balance's lag and noise, and of what scoops bring."""
KINDS = ("as written", "equal", "other growth")
"""Of lumps, each as likely: of exponential masses that grow with the gap as the lab's file says; of one mass each; and
exponential ones that grow with the gap where the file says that they do not, or the other way round."""
GROWS = 3.0
"""The exponent of those that grow: a lump is as wide as the gap."""
PRIMES = (5, 2, 3, 7, 11, 13)
"""Their roots are the numbers: for lumps (that of 5 is even within a kind as well), lag, flow, dead diameter, noise,
yield."""
SURE = 1e-6
"""No cell is farther out than this share of all."""
SLOWER = 1.5
"""The median balance lags so many times as long as the one in the lab's files."""
DEAD_MM = 0.03
"""Of the opening at which a powder begins to flow."""


class SomeCell:
    """A plant (`--plant`) whose figures are drawn; `seed` says which.

    Cells of successive seeds lie evenly, the first in the middle (Richtmyer's sequence: multiples of irrational
    numbers, modulo 1): the few trials of a plan have every kind of lumps among them, and small and large ones, whereas
    a few that are drawn by chance may all be of one kind.
    """

    seed: ClassVar[int] = 0

    def __init__(self) -> None:
        self._kind = KINDS[self.seed % len(KINDS)]
        shares = (0.5 + self.seed * np.sqrt(PRIMES)) % 1.0
        drawn = ndtri(np.clip(shares, SURE, 1.0 - SURE))
        self._lumps, self._lag, self._flow, self._dead, self._noise, self._yield = drawn

    def flow(self, powder: Powder) -> OurPowderFlow:
        ours, lumps = powder.simulation, math.exp(LUMPS * self._lumps)
        exponent = ours.surge_exponent
        if self._kind == "other growth":
            exponent = 0.0 if exponent > 0.0 else GROWS
        figures = {
            "flow_coefficient": ours.flow_coefficient * math.exp(FLOW * self._flow),
            "dead_diameter_mm": max(0.0, ours.dead_diameter_mm + DEAD_MM * self._dead),
            "surge_mg": ours.surge_mg * lumps,
            "surge_exponent": exponent,
            "avalanche_mg": ours.avalanche_mg * lumps,
        }
        drawn = powder.model_copy(update={"simulation": ours.model_copy(update=figures)})
        return OurPowderFlow(drawn, equal_lumps=self._kind == "equal")

    def scoop(self, powder: Powder) -> OurScoopYield:
        return OurScoopYield(powder, math.exp(YIELD * self._yield))

    def balance(self, spec: BalanceSpec) -> OurBalanceResponse:
        ours = spec.simulation
        figures = {
            "lag_s": ours.lag_s * SLOWER * math.exp(LAG * self._lag),
            "noise_mg": spec.simulated_noise_mg * math.exp(NOISE * self._noise),
        }
        return OurBalanceResponse(spec.model_copy(update={"simulation": ours.model_copy(update=figures)}))
