"""The seams of the simulated physics: what a plant named by `--plant module:Class` may replace.

The class is built without arguments and offers any of `flow(powder)`, `balance(spec)` and
`scoop(powder)`; what it does not offer is ours. Every method gets the generator it must draw from.
"""

from typing import Protocol

from numpy.random import Generator

from scuhand_bt.specs import BalanceSpec, Mortar, Powder


class PowderFlow(Protocol):
    """Powder leaving the apex; one object per cone load."""

    def step(self, dt_s: float, opening_mm: float, vibration: float, in_cone_mg: float, rng: Generator) -> float:
        """The mass [mg] that leaves in `dt_s` at this real opening and vibration 0..1."""
        ...


class BalanceResponse(Protocol):
    """From mass on the pan to the reading, before it is rounded to the readability."""

    def step(self, dt_s: float, on_pan_mg: float, landing_mg: float, vibration: float, rng: Generator) -> float:
        """The reading [mg]. `on_pan_mg` is the settled gross without `landing_mg`, which lands in this step."""
        ...


class ScoopingCone(Protocol):
    """The cone's stroke through the powder."""

    diameter_mm: float
    """Rim diameter on contact with the wall."""
    closed_diameter_mm: float
    """Rim diameter at the end of the stroke."""
    overtravel_mm: float
    """How far the sheet was pressed onto the wall."""


class ScoopYield(Protocol):
    """What one scoop collects."""

    def collect(self, cone: ScoopingCone, mortar: Mortar, in_mortar_mg: float, rng: Generator) -> float:
        """The mass [mg] that ends in the cone."""
        ...


class Plant(Protocol):
    """A whole replaceable physics; each method may be absent."""

    def flow(self, powder: Powder) -> PowderFlow: ...

    def balance(self, spec: BalanceSpec) -> BalanceResponse: ...

    def scoop(self, powder: Powder) -> ScoopYield: ...
