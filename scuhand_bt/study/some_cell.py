"""A simulated cell whose powders, scoops and balance differ from the lab's files, as a real cell's may.

Nobody knows how before a run, so each trial has another such cell, and a plan's intervals include that uncertainty.
The spreads are assumptions, tested against plants of another family by `benchmarks.forecasts`:

* fresh powder of a lot never dosed before flows at half to twice what was believed;
* its lumps depend on how it was stored. No published figure settles of which kind they are (docs/calibration.md), and
  a dose's last milligrams depend on it, so each trial has one of three kinds;
* balances on the market answer within 0.2 to 2 s;
* in 17 strokes, discrete elements lift 11 % more or less (root mean square) than the height field does
  (docs/scoop-yield.md). Nobody has weighed what a real one lifts.
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
"""Standard deviations of logarithms: of a powder's flow and its lumps' mean mass (of any kind), of the balance's lag
and noise, and of what scoops bring."""
KINDS = ("as written", "equal", "other growth")
"""Kinds of lumps, equally likely: exponentially distributed masses that grow with the gap as the lab's file says;
equal masses; and exponential ones that grow if the file says that they do not, or the other way round."""
GROWS = 3.0
"""The exponent of lumps that grow: a lump is as wide as the gap."""
PRIMES = (5, 2, 3, 7, 11, 13)
"""Their square roots are the irrational numbers of the sequence: for lumps (that of 5 is even within a kind as well),
lag, flow, dead diameter, noise and yield."""
SURE = 1e-6
"""Cut-off of the distributions: no cell is farther out than this share on either side."""
SLOWER = 1.5
"""The median balance has so many times the lag that the lab's files give."""
DEAD_MM = 0.03
"""Standard deviation of the opening at which a powder begins to flow [mm]."""


class SomeCell:
    """A plant (`--plant`) with random figures; `seed` says which.

    Cells of successive seeds are spread evenly, the first one in the middle (Richtmyer's sequence: multiples of
    irrational numbers, modulo 1). So even the few trials of a plan have every kind of lumps, small and large; with
    independent draws all might be of one kind.
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
