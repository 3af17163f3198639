"""The weighings about one container as they are made, and their result when it has gone (`dosing/bracket.py`)."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Annotated, TypeAlias

from pydantic import AfterValidator, PlainSerializer

from scuhand_bt.dosing.bracket import Drift, Gross, Net, standing, total

AS_WRITTEN = PlainSerializer(dict)
READ_ONLY = AfterValidator(MappingProxyType)
Nets: TypeAlias = Annotated[Mapping[str, Net], READ_ONLY, AS_WRITTEN]
"""Doses by powder lot (`Source.sheet_key`); read-only."""
Durations: TypeAlias = Annotated[Mapping[str, float], READ_ONLY, AS_WRITTEN]
"""How long these took to come [s], by powder lot."""


@dataclass(frozen=True)
class Bracket:
    """The weighings about what is dosed into one container. Every change makes a new object."""

    container: str
    bare: Gross
    """a0: the bare pan before the container came."""
    loaded: Gross
    """l0: the empty container, the hand away."""
    last: Gross
    """The last weighing of what stands there, with the hand in place or away."""
    doses: Nets = field(default_factory=lambda: MappingProxyType({}))
    drifted: Nets = field(default_factory=lambda: MappingProxyType({}))
    """What was subtracted from them for drift, by powder lot."""
    lasted_s: Durations = field(default_factory=lambda: MappingProxyType({}))
    """How long they took to come, by powder lot; what the zero did meanwhile is in them."""
    drift: Drift = field(default_factory=lambda: Drift(0.0, 0.0))
    """The drift seen about the last dose."""
    lot: str = ""
    """The lot that is being dosed."""
    dripped_mg: float = 0.0
    """What it gained between doses, the hand away: dripped powder or a force; the bare pan shows no difference."""
    lifted: Gross | None = None
    """l1: the filled container, the hand away, before it is taken off."""
    carried: Nets = field(default_factory=lambda: MappingProxyType({}))
    """What it held before these weighings: when it came to the pan again, or when all began anew after an outage."""
    empty: Net | None = None
    """Its empty mass before such an outage; None if `bare`, `loaded` and `carried` tell it."""

    def dosed_mg(self, lot: str) -> Net:
        """What was dosed of a powder lot until now."""
        return total(nets[lot] for nets in (self.carried, self.doses) if lot in nets)

    @property
    def holds(self) -> dict[str, Net]:
        """All that was dosed, by powder lot."""
        return {lot: self.dosed_mg(lot) for lot in {**self.carried, **self.doses}}

    def weighed_empty(self, readability_mg: float) -> Net:
        """The mass of the container without any powder."""
        if self.empty is not None:
            return self.empty
        stood, carried = standing(self.bare, self.loaded, readability_mg), total(self.carried.values())
        return Net(stood.mass_mg - carried.mass_mg, math.hypot(stood.uncertainty_mg, carried.uncertainty_mg))

    def tared(self, weighing: Gross) -> "Bracket":
        """Weighed before a dose; before the first one that is the empty container, too."""
        return replace(self, loaded=self.loaded if self.doses else weighing, last=weighing)

    def gained(self, gained: Net, drift: Drift, now: Gross) -> "Bracket":
        """A dose of the present lot was weighed."""
        lasted_s = now.time_s - self.last.time_s
        doubt = drift.uncertainty if drift.rate != 0.0 or drift.is_doubted else 0.0
        drifted = Net(drift.rate * lasted_s, doubt * lasted_s)
        return replace(
            self,
            doses=self._with(self.doses, gained),
            drifted=self._with(self.drifted, drifted),
            lasted_s=MappingProxyType({**self.lasted_s, self.lot: self.lasted_s.get(self.lot, 0.0) + lasted_s}),
            drift=drift,
            last=now,
        )

    def found(self, gained: Net, now: Gross) -> "Bracket":
        """A dose broke off and was weighed; as nobody has watched the zero, N has to tell."""
        return replace(self, doses=self._with(self.doses, gained), last=now)

    def _with(self, nets: Nets, more: Net) -> Nets:
        so_far = nets.get(self.lot, Net(0.0, 0.0))
        return MappingProxyType({**nets, self.lot: total([so_far, more])})

    def dripped(self, mass_mg: float) -> "Bracket":
        """It has gained between two doses."""
        return replace(self, dripped_mg=self.dripped_mg + mass_mg)

    def with_zero_moved(self, drift_mg: float, now: Gross) -> "Bracket":
        """As if the balance had always had its present zero."""
        return replace(self, bare=_shifted(self.bare, drift_mg), loaded=_shifted(self.loaded, drift_mg), last=now)

    def begun_anew(self, bare: Gross, loaded: Gross, empty: Net, carried: Mapping[str, Net]) -> "Bracket":
        """After an outage: what it holds is carried, and no earlier weighing counts."""
        return Bracket(
            self.container, bare, loaded, loaded, lot=self.lot, carried=MappingProxyType(dict(carried)), empty=empty
        )

    def carried_of(self, held: Net) -> dict[str, Net]:
        """What it holds by lot, given the total; what nobody knew of is of the lot dosed last."""
        others = total(net for lot, net in self.holds.items() if lot != self.lot)
        u_mg = math.hypot(held.uncertainty_mg, others.uncertainty_mg)
        return {**self.holds, self.lot: Net(held.mass_mg - others.mass_mg, u_mg)}


@dataclass(frozen=True)
class ClosedBracket:
    """The result after a container has gone: its doses, and whether to believe them."""

    container: str
    doses: Nets
    closes: bool
    difference_mg: float
    """N less what was dosed; of several visits the largest."""
    detail: str
    lasted_s: Durations = field(default_factory=lambda: MappingProxyType({}))
    """How long the doses took to come, over all visits."""
    is_discarded: bool = False
    """Whether it was thrown away: what it holds is then no dose of the sample."""


def _shifted(weighing: Gross, by_mg: float) -> Gross:
    return replace(weighing, gross_mg=weighing.gross_mg + by_mg)
