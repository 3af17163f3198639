"""All the powder of a world: the compartments it can be in, and the one operation that moves it."""

import math
from collections.abc import Iterable, Mapping
from typing import Literal, NamedTuple, TypeAlias, get_args

from scuhand_bt.specs import Source

Kind: TypeAlias = Literal[
    "source", "container", "cone", "sheet", "flight", "balance", "pan", "returned", "waste", "vessel", "spilled"
]


class Compartment(NamedTuple):
    """A place that powder can be in; of sources, containers and vessels there are many, each with a name."""

    kind: Kind
    name: str = ""

    def __str__(self) -> str:
        """As the journal's `matter` entry and the world's file write it: `cone`, `source:NAME`."""
        return f"{self.kind}:{self.name}" if self.name else self.kind

    @classmethod
    def of_text(cls, text: str) -> "Compartment":
        """What `str` has written. ValueError for what it never wrote."""
        kind, _, name = text.partition(":")
        for known in get_args(Kind):
            if kind == known:
                return cls(known, name)
        raise ValueError(f"powder is never in '{text}'")


CONE = Compartment("cone")
SHEET = Compartment("sheet")
"""Stuck to the sheet."""
FLIGHT = Compartment("flight")
"""Fallen, and not landed yet."""
PAN = Compartment("pan")
"""On the balance, beside the container's mouth."""
RETURNED = Compartment("returned")
"""Put back into the mortar of another lot."""
WASTE = Compartment("waste")
"""The bin, and what leaves the cell with a sheet."""
SPILLED = Compartment("spilled")
BALANCE = Compartment("balance")
"""Where powder falls to that will meet a mouth: it lands in the container that stands there then, or on the pan."""


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
    """Masses in compartments that never go negative; only `transfer` changes them, and whoever refills a mortar."""

    def __init__(self, sources: Mapping[str, Source], vessels: Iterable[str] = ()) -> None:
        self.masses_mg: dict[Compartment, float] = dict.fromkeys(
            (CONE, SHEET, FLIGHT, PAN, RETURNED, WASTE, *map(in_vessel, vessels), SPILLED), 0.0
        )
        """By compartment; those of containers come as the containers do."""
        for name, source in sources.items():
            self.masses_mg[in_source(name)] = source.amount_mg

    @property
    def total_mg(self) -> float:
        """All there is; the same at all times, but for what a mortar is refilled with."""
        return math.fsum(self.masses_mg.values())

    def refill(self, source: str, mass_mg: float) -> None:
        """More powder comes into the mortar of a source. ValueError for a source that there is none of, or no mass."""
        place = in_source(source)
        if place not in self.masses_mg:
            raise ValueError(f"there is no source '{source}'")
        if not 0.0 < mass_mg < math.inf:
            raise ValueError(f"a mortar cannot be refilled with {mass_mg:g} mg")
        self.masses_mg[place] += mass_mg

    def transfer(self, source: Compartment, target: Compartment, mass_mg: float) -> None:
        """Move powder. ValueError for NaN, a negative mass, or more than there is."""
        there_mg = self.masses_mg[source]
        if not 0.0 <= mass_mg <= there_mg:
            raise ValueError(f"cannot move {mass_mg!r} mg from {source}, which holds {there_mg!r} mg")
        self.masses_mg[source] = there_mg - mass_mg
        self.masses_mg[target] += mass_mg
