"""The ledger of a world's powder: the compartments it can be in, and the one operation that moves it."""

import math
from collections.abc import Iterable, Mapping
from typing import Literal, NamedTuple, TypeAlias, get_args

from scuhand_bt.specs import Source

Kind: TypeAlias = Literal[
    "source", "container", "cone", "sheet", "flight", "balance", "pan", "returned", "waste", "vessel", "spilled"
]


class Compartment(NamedTuple):
    """A place that powder can be in. There are many sources, containers and vessels, each with a name."""

    kind: Kind
    name: str = ""

    def __str__(self) -> str:
        """As in the journal's `matter` entry and the world's file: `cone`, `source:NAME`."""
        return f"{self.kind}:{self.name}" if self.name else self.kind

    @classmethod
    def of_text(cls, text: str) -> "Compartment":
        """The inverse of `str`. Raises ValueError for any other text."""
        kind, _, name = text.partition(":")
        for known in get_args(Kind):
            if kind == known:
                return cls(known, name)
        raise ValueError(f"powder is never in '{text}'")


CONE = Compartment("cone")
SHEET = Compartment("sheet")
"""Stuck to the sheet."""
FLIGHT = Compartment("flight")
"""In the air."""
PAN = Compartment("pan")
"""On the balance, beside the container's mouth."""
RETURNED = Compartment("returned")
"""Put back into the mortar of another lot."""
WASTE = Compartment("waste")
"""The bin, and what leaves the cell with a sheet."""
SPILLED = Compartment("spilled")
BALANCE = Compartment("balance")
"""Powder in the air above a mouth. It lands in the container that then stands there, or else on the pan."""


def in_source(name: str) -> Compartment:
    """The mortar of a source."""
    return Compartment("source", name)


def in_container(container_id: str) -> Compartment:
    """The inside of a container: the true mass of its dose."""
    return Compartment("container", container_id)


def in_vessel(station: str) -> Compartment:
    """The vessel for leftovers at a station, beside the waste bin."""
    return Compartment("vessel", station)


class MassLedger:
    """Masses in compartments; none ever goes negative. Only `transfer` and `refill` change them."""

    def __init__(self, sources: Mapping[str, Source], vessels: Iterable[str] = ()) -> None:
        self.masses_mg: dict[Compartment, float] = dict.fromkeys(
            (CONE, SHEET, FLIGHT, PAN, RETURNED, WASTE, *map(in_vessel, vessels), SPILLED), 0.0
        )
        """By compartment; a container's is added with the container."""
        for name, source in sources.items():
            self.masses_mg[in_source(name)] = source.amount_mg

    @property
    def total_mg(self) -> float:
        """The total mass; constant except for `refill`."""
        return math.fsum(self.masses_mg.values())

    def refill(self, source: str, mass_mg: float) -> None:
        """Add powder to a source's mortar. Raises ValueError for an unknown source or a mass that is not positive."""
        place = in_source(source)
        if place not in self.masses_mg:
            raise ValueError(f"there is no source '{source}'")
        if not 0.0 < mass_mg < math.inf:
            raise ValueError(f"a mortar cannot be refilled with {mass_mg:g} mg")
        self.masses_mg[place] += mass_mg

    def transfer(self, source: Compartment, target: Compartment, mass_mg: float) -> None:
        """Move powder. Raises ValueError for NaN, a negative mass, or more than there is."""
        there_mg = self.masses_mg[source]
        if not 0.0 <= mass_mg <= there_mg:
            raise ValueError(f"cannot move {mass_mg!r} mg from {source}, which holds {there_mg!r} mg")
        self.masses_mg[source] = there_mg - mass_mg
        self.masses_mg[target] += mass_mg
