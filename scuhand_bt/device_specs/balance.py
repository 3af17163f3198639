"""The balance, how it answers, and what a run asks of it."""

from typing import Annotated, Literal

from pydantic import Field

from scuhand_bt.drivers import driver_name
from scuhand_bt.quantity import Milligrams, Seconds
from scuhand_bt.specs import NotNegative, Positive, Spec


class BalanceResponseSpec(Spec):
    """How the simulated balance answers (`scuhand_bt.sim.response`); no controller reads it."""

    lag_s: Annotated[Seconds, Field(gt=0)] = 0.3
    """Time constant of each of its filter's two poles."""
    noise_mg: Annotated[Milligrams, NotNegative] | None = None
    """Standard deviation of a reading on a quiet pan; unset, 0.08 mg, and of finer balances 0.8 digits."""
    vibration_noise_mg: Annotated[Milligrams, NotNegative] = 0.4
    """Standard deviation that the hand's motor adds at full level."""
    drift_mg: Annotated[Milligrams, NotNegative] | None = None
    """Random walk of the zero: standard deviation after a minute; unset, 0.1 mg, and of finer balances a digit."""


class BalanceOptions(Spec):
    """Where the balance's own menu is not as it left the factory."""

    baud: Annotated[int, Positive] | None = None
    bits: Annotated[str, Field(pattern=r"^[78][NEO][12]$")] | None = None
    """Data bits, parity, stop bits: "7E1"."""
    unit: Literal["g", "mg", "kg", "ct"] | None = None
    """Of a balance that leaves it out while it is not stable."""


class BalanceLimits(Spec):
    """What a run on the real cell asks of its balance (docs/weighing.md); `check` notes what is beyond."""

    check_weight_every_s: Annotated[Seconds, Field(gt=0)] | None = None
    """Within this time before a run it must have weighed a check weight right."""
    minimum_weight_mg: Annotated[Milligrams, NotNegative] = 0.0
    """The least mass to be dosed."""
    usp_41: bool | None = None
    """That, and at least 2000 times the repeatability (USP 41); unset, a mass below it is warned of, not refused."""
    when_beyond: Literal["refuse", "warn"] = "refuse"


class BalanceSpec(Spec):
    """The balance under the hand."""

    driver: Annotated[str, driver_name("balance")] = "shimadzu"
    port: str = ""
    options: BalanceOptions = BalanceOptions()
    readability_mg: Annotated[Milligrams, Positive] = 0.1
    maximum_mg: Annotated[Milligrams, Positive] = 120_000.0
    period_s: Annotated[Seconds, Field(gt=0, le=2)] = 0.1
    limits: BalanceLimits = BalanceLimits()
    weighed_twice: Literal["first", "every"] = "first"
    """Which containers come and go twice, about the bare pan, as the first of each run does; the first with each powder
    lot goes twice (docs/weighing.md)."""
    simulation: BalanceResponseSpec = BalanceResponseSpec()

    @property
    def least_tolerance_mg(self) -> float:
        """Two digits: a stable mean is known to about half of one, and acceptance keeps twice that inside."""
        return 2.0 * self.readability_mg

    @property
    def confirmed_tolerance_mg(self) -> float:
        """Five digits: of doses within less, nine in ten are not always told so (docs/weighing.md has the figures)."""
        return 5.0 * self.readability_mg

    @property
    def told_uncertainty_mg(self) -> float:
        """0.8 digits: the standard uncertainty of a result when its container has gone, in dry runs 0.07 to 0.10 mg of
        20 mg to 3 g by digits of 0.1 mg."""
        return 0.8 * self.readability_mg

    @property
    def simulated_noise_mg(self) -> float:
        """Of a finer balance less, as it tells finer steps: one that never calls itself stable could not be used."""
        written_mg = self.simulation.noise_mg
        return min(0.08, 0.8 * self.readability_mg) if written_mg is None else written_mg

    @property
    def simulated_drift_mg(self) -> float:
        """Likewise."""
        written_mg = self.simulation.drift_mg
        return min(0.1, self.readability_mg) if written_mg is None else written_mg

    @property
    def settles_s(self) -> float:
        """A balance that calls no reading stable for so long does not come to rest."""
        return max(30.0, 40.0 * self.period_s)

    @property
    def lost_after_s(self) -> float:
        """Without a word for this long, the balance is taken for lost."""
        return max(3.0, 10.0 * self.period_s)

    @property
    def awaited_s(self) -> float:
        """Its next reading is waited for so long, if nobody says for how long: until it is lost, at least."""
        return max(5.0, self.lost_after_s)
