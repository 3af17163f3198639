"""Randomised plants: families of powders, hands and balances that nobody has tuned to, drawn by Latin hypercube.

A family says from what each figure is drawn; `draw` gives some plants of it. The sets of seeds, one to tune with, one
to judge by, and three to judge forecasts by, share no plant and no random number. None of it is known to a controller,
and the physics (`harness.random_physics`) shares nothing with the simulation that the lab ships.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, TypeAlias

from scipy.stats import qmc

from harness.random_physics import BalanceFigures, DrawnBalance, DrawnFlow, FlowFigures
from scuhand_bt.device_specs.balance import BalanceSpec
from scuhand_bt.device_specs.hand import HandSpec, ValveErrorSpec
from scuhand_bt.specs import Powder

SETS = {
    "tuning": 20_260_301,
    "judging": 77_123_009,
    "foretold": 55_310_207,
    "foretold_again": 91_440_613,
    "foretold_anew": 30_118_842,
}
"""Seeds of numpy: of the draw, and where the seeds of its plants begin."""
LONGEST_DELAY_S = 6.0


@dataclass(frozen=True)
class Uniform:
    """Evenly between two ends."""

    low: float
    high: float

    def at(self, share: float) -> float:
        return self.low + share * (self.high - self.low)


@dataclass(frozen=True)
class Log:
    """Evenly in the logarithm."""

    low: float
    high: float

    def at(self, share: float) -> float:
        return self.low * (self.high / self.low) ** share


@dataclass(frozen=True)
class OneOf:
    """Each equally likely."""

    values: tuple[Any, ...]

    def at(self, share: float) -> Any:
        return self.values[min(int(share * len(self.values)), len(self.values) - 1)]


Prior: TypeAlias = Uniform | Log | OneOf
Priors: TypeAlias = Mapping[str, Prior]

HAND: Priors = {
    "opening_mm": Uniform(0.01, 0.05),
    "sample_mm": Uniform(0.0, 0.05),
    "stick_probability": Uniform(0.0, 0.02),
    "stick_mm": Uniform(0.1, 0.4),
    "valve_dead_time_s": Uniform(0.03, 0.12),
    "valve_speed_mm_per_s": Uniform(3.5, 4.5),
}
"""What the valve does; the controllers are told of the lab's own hand."""
FREE: Priors = {
    "factor": Log(0.4, 2.5),
    "exponent": Uniform(2.0, 3.2),
    "threshold_mm": Uniform(0.0, 0.3),
    "gravity": Uniform(0.8, 1.0),
    "load_spread": Uniform(0.03, 0.15),
    "opening_spread": Uniform(0.01, 0.06),
    "noise": Uniform(0.02, 0.1),
    "noise_s": Log(0.1, 3.0),
    "heel": Uniform(0.0, 0.05),
    "prime_s": Uniform(0.0, 0.5),
    "prime_mg": Uniform(0.0, 3.0),
    "transit_s": Log(0.01, 0.1),
    "trickle_mg": Uniform(0.0, 0.3),
    "trickle_s": Log(0.05, 1.0),
}
BRIDGING: Priors = FREE | {
    "gravity": Uniform(0.5, 1.0),
    "load_spread": Uniform(0.05, 0.25),
    "opening_spread": Uniform(0.05, 0.3),
    "noise": Uniform(0.1, 0.35),
    "heel": Uniform(0.0, 0.35),
    "prime_s": Uniform(0.0, 2.0),
    "arch_mg": Log(0.5, 2.0),
    "arch_mm": Uniform(0.6, 1.4),
    "arch_s": Log(0.03, 0.3),
    "arch_tail": Uniform(1.2, 3.0),
    "arch_creep": Uniform(0.0, 0.1),
    "gush_mg": Uniform(0.0, 0.2),
    "lump_share": Uniform(0.05, 0.4),
    "lump_mg": Log(0.1, 0.5),
}
LUMPS: Priors = BRIDGING | {
    "factor": Log(0.3, 3.0),
    "threshold_mm": Uniform(0.0, 0.5),
    "gravity": OneOf((0.0, 0.0, 0.05, 0.3, 1.0)),
    "opening_spread": Uniform(0.05, 0.2),
    "heel": Uniform(0.0, 0.6),
    "prime_s": Uniform(0.0, 9.9),
    "lump_share": Uniform(0.5, 0.95),
    "lump_mg": Log(1.0, 5.0),
    "lump_kind": OneOf(("one size", "exponential", "gap")),
}
CLOGGING: Priors = BRIDGING | {
    "arch_mg": Log(1.0, 5.0),
    "arch_mm": Uniform(1.4, 3.0),
    "arch_s": Log(0.1, 1.0),
    "arch_tail": Uniform(0.8, 1.5),
    "arch_creep": Uniform(0.0, 0.02),
    "gush_mg": Uniform(0.0, 1.0),
}


@dataclass(frozen=True)
class Family:
    """Plants of one kind, and the powder of `robot/powders.yaml` that they are taken for."""

    powder: str
    priors: Priors


FACTORS = OneOf((0.1, 0.5, 2.0, 5.0))
FAMILIES = {
    "beads": Family("glass_beads", FREE),
    "msg": Family("monosodium_glutamate", BRIDGING),
    "lumps": Family("titanium_dioxide", LUMPS),
    "flow": Family("glass_beads", FREE | {"factor": FACTORS}),
    "flow_msg": Family("monosodium_glutamate", BRIDGING | {"factor": FACTORS}),
    "clogging": Family("monosodium_glutamate", CLOGGING),
    "surges": Family("glass_beads", FREE | {"surge_mg": Uniform(30.0, 30.0), "surge_every_s": Log(30.0, 120.0)}),
}
_NOISES: Priors = {
    "momentum": Uniform(0.0, 1.0),
    "noise_mg": Log(0.03, 0.2),
    "shake_mg": Uniform(0.0, 0.6),
    "drift_mg": Uniform(0.0, 0.2),
}
BALANCES: Mapping[str, Priors] = {
    name: _NOISES | own
    for name, own in {
        "lab": {
            "kind": OneOf(("poles", "poles", "mean", "adaptive", "ringing", "delay")),
            "delay_s": Log(0.3, 1.2),
            "poles": OneOf((1, 2, 3, 4)),
            "damping": Uniform(0.6, 0.8),
            "patience": Uniform(1.5, 3.0),
            "restless_mg": Log(3.0, 30.0),
        },
        "poles": {"kind": OneOf(("poles",)), "delay_s": Log(0.2, 6.0), "poles": OneOf((1, 2, 3, 4, 5, 6))},
        "mean": {"kind": OneOf(("mean",)), "delay_s": Log(0.2, 3.0)},
        "delay": {"kind": OneOf(("delay",)), "delay_s": Log(0.2, 3.0)},
        "adaptive": {
            "kind": OneOf(("adaptive",)),
            "delay_s": Log(0.2, 1.5),
            "patience": Uniform(2.0, 6.0),
            "restless_mg": Log(3.0, 30.0),
        },
        "ringing": {"kind": OneOf(("ringing",)), "delay_s": Log(0.2, 1.5), "damping": Uniform(0.4, 0.8)},
    }.items()
}
"""What is weighed with: `lab` are ordinary balances of every kind, the others go to the end of what is sold."""
STEPS: Priors = {
    "ratio": OneOf((0.25, 0.4, 0.6, 1.7, 2.5, 4.0)),
    "dose": Uniform(0.2, 0.8),
    "change_s": OneOf((0.0, 0.0, 0.0, 0.5, 1.5, 4.0)),
}
"""A filter that is changed: by what its delay is multiplied; after which share of a run's doses; and so long after
the first powder of that dose has landed."""


@dataclass(frozen=True)
class Drawn:
    """One plant of a family; `seed` is where its random numbers begin."""

    family: str
    index: int
    seed: int
    powder: str
    flow: FlowFigures
    hand: HandSpec
    balance: BalanceFigures
    later: BalanceFigures | None = None
    """What the balance becomes, where its filter is changed."""
    change_dose: int = 0
    change_s: float = 0.0

    def balance_of(self, dose: int) -> DrawnBalance:
        """The balance as it is in this dose of a run."""
        if self.later is None or dose < self.change_dose:
            return DrawnBalance(self.balance)
        if dose > self.change_dose:
            return DrawnBalance(self.later)
        return DrawnBalance(self.balance, self.later, self.change_s)


def draw(
    family: str,
    powders: Mapping[str, Powder],
    plants: int,
    *,
    seeds: str = "tuning",
    balances: Sequence[str] = ("lab",),
    doses: int = 10,
    steps: bool = False,
) -> list[Drawn]:
    """So many plants of a family, on balances of these kinds; with `steps` each changes once in its run of doses."""
    first = SETS[seeds] + 10_000 * list(FAMILIES).index(family)
    priors = FAMILIES[family].priors
    columns = [*priors, *HAND, *STEPS, *sorted({name for kind in BALANCES.values() for name in kind}), "balance"]
    cube = qmc.LatinHypercube(d=len(columns), seed=first).random(plants)
    drawn = []
    for index, row in enumerate(cube):
        shares = dict(zip(columns, map(float, row), strict=True))
        balance = BalanceFigures(**_values(BALANCES[OneOf(tuple(balances)).at(shares["balance"])], shares))
        change = _values(STEPS, shares)
        delay_s = min(balance.delay_s * change["ratio"], LONGEST_DELAY_S)
        hand = _values(HAND, shares)
        valve = {name: hand.pop(name) for name in ValveErrorSpec.model_fields}
        drawn.append(
            Drawn(
                family=family,
                index=index,
                seed=first + index,
                powder=FAMILIES[family].powder,
                flow=_flow(powders[FAMILIES[family].powder], _values(priors, shares)),
                hand=HandSpec(simulation=ValveErrorSpec(**valve), **hand),
                balance=balance,
                later=replace(balance, delay_s=delay_s) if steps else None,
                change_dose=int(change["dose"] * doses),
                change_s=change["change_s"],
            )
        )
    return drawn


def _values(priors: Priors, shares: Mapping[str, float]) -> dict[str, Any]:
    return {name: prior.at(shares[name]) for name, prior in priors.items()}


def _flow(powder: Powder, values: dict[str, Any]) -> FlowFigures:
    """`factor` is against what the lab believes of this powder's flow at an opening of 1 mm."""
    belief = powder.belief
    believed = belief.coefficient * (1.0 - belief.threshold_mm) ** belief.exponent
    return FlowFigures(flow_mg_per_s=believed * values.pop("factor"), **values)


class RandomPlant:
    """The physics of the plant that is `at_hand`, as `--plant` names it: a cell for each dose."""

    at_hand: ClassVar[Drawn]
    dose: ClassVar[int] = 0
    """Which of the run's doses it is."""

    def flow(self, powder: Powder) -> DrawnFlow:
        return DrawnFlow(self.at_hand.flow)

    def balance(self, spec: BalanceSpec) -> DrawnBalance:
        return self.at_hand.balance_of(self.dose)
