"""What the cone and the sources are believed to hold, by what was measured and commanded (docs/scoop-belief.md)."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Annotated, Any, TypeAlias

from scuhand_bt.cell.load import BARREN_MG, HIDDEN, SURPLUS, Load
from scuhand_bt.cell.pan_bracket import AS_WRITTEN, READ_ONLY
from scuhand_bt.dosing.bed import Layer
from scuhand_bt.specs import Source

Counts: TypeAlias = Annotated[Mapping[str, int], READ_ONLY, AS_WRITTEN]
Masses: TypeAlias = Annotated[Mapping[str, float], READ_ONLY, AS_WRITTEN]
"""Masses [mg], or shares of masses, by name; read-only."""
Layers: TypeAlias = Annotated[Mapping[str, Layer], READ_ONLY, AS_WRITTEN]


@dataclass(frozen=True)
class InVessel:
    """What a vessel for leftovers holds."""

    lot: str | None = None
    """The powder lot (`Source.sheet_key`) in it; None if it is empty."""
    mass_mg: float = 0.0
    """Without rests, whose mass is unknown."""


Vessels: TypeAlias = Annotated[Mapping[str, InVessel], READ_ONLY, AS_WRITTEN]

BARREN_LOADS, BARREN_SHARE, MOST_BARREN_LOADS = 2, 0.6, 6
"""A source is given up after BARREN_LOADS loads in a row that brought nothing, and should have brought BARREN_SHARE of
what is believed to be there; or after MOST_BARREN_LOADS. Until then each stroke goes deeper, as there may be less."""
LEAST_SHARE = 0.2
"""With a smaller share, a load larger than expected has found a deeper place and no heap, as strokes went above most of
the powder before."""
FAR_LESS = 0.75
"""A share below this part of the one before is not chance: powder was not where the stroke should have found it. 0.6 to
0.9 were tried, with titanium dioxide at half its yield."""


@dataclass(frozen=True)
class Barren:
    """A source's last loads in a row that have brought nothing."""

    loads: int = 0
    mass_mg: float = 0.0
    """What they should have brought, in all."""

    def and_one_of(self, mass_mg: float) -> "Barren":
        """With one more that should have brought `mass_mg`."""
        return Barren(self.loads + 1, self.mass_mg + mass_mg)


Barrens: TypeAlias = Annotated[Mapping[str, Barren], READ_ONLY, AS_WRITTEN]


@dataclass(frozen=True)
class BelievedPowder:
    """The part of what a cell is believed to hold (`believed.py`) that is scooped and let out."""

    cone_mg: float = 0.0
    cone_source: str | None = None
    """The source of the powder in the cone; known until the cone is emptied, whatever is left."""
    has_rest: bool = False
    """Whether nothing more comes out of a cone that was not emptied since; what is left falls out as it tilts."""
    load: Load = field(default_factory=Load)
    is_load_doubted: bool = False
    """Whether the load gave far less than was believed; it is let out before the next scoop."""
    yields: Masses = field(default_factory=lambda: MappingProxyType({}))
    """By source, the share that the last load's scoops brought of what was expected; 1 until one was seen."""
    rests: Masses = field(default_factory=lambda: MappingProxyType({}))
    """By source, the share of a load that comes only shaken, as far as it was seen."""
    barren: Barrens = field(default_factory=lambda: MappingProxyType({}))
    """By source, the loads that brought nothing, up to the last one."""
    sheet: str | None = None
    """The powder lot (`Source.sheet_key`) that this sheet has touched; None for a fresh one."""
    sheets_used: int = 1
    sources_mg: Masses = field(default_factory=lambda: MappingProxyType({}))
    layers: Layers = field(default_factory=lambda: MappingProxyType({}))
    """By source, what the last stroke left in the mortar; none for a bed never scooped from."""
    vessels: Vessels = field(default_factory=lambda: MappingProxyType({}))
    """By station, what the vessels for leftovers hold, as far as known; without the waste bin."""

    @property
    def seen_yields(self) -> Masses:
        """The `yields` of sources of which a load's end was seen, now or in an earlier run."""
        unseen = self.cone_source if self.load.is_larger else None
        return {name: share for name, share in self.yields.items() if name != unseen}

    @property
    def barren_sources(self) -> frozenset[str]:
        """Sources given up as their scoops bring nothing."""
        return frozenset(name for name, barren in self.barren.items() if self._is_given_up(name, barren))

    @property
    def is_probing(self) -> bool:
        """Whether the load before this one brought nothing, and the source is not given up if this does not either."""
        barren = self.barren.get(name := self.cone_source or "")
        return barren is not None and not self._is_given_up(name, barren.and_one_of(self.load.scooped_mg))

    @property
    def missed_mg(self) -> Masses:
        """By source, what its last stroke should have brought and did not find: it is believed to lie there still."""
        return {name: layer.missed_mg for name, layer in self.layers.items()}

    # --- the cone and the sources

    def source_holds(self, name: str, mass_mg: float) -> None:
        """A recipe, the inventory or an operator says how much is in a source."""
        self._set(sources_mg={**self.sources_mg, name: mass(mass_mg)})

    def scoops_bring(self, name: str, share: float) -> None:
        """An earlier run has seen the share that a source's scoops bring; what this run has seen takes precedence."""
        self._set(yields={name: mass(share), **self.yields})

    def scoops_forgotten(self, name: str) -> None:
        """Somebody has said that the share of a source's scoops is no longer known."""
        self._set(yields={other: share for other, share in self.yields.items() if other != name})

    def cone_holds(self, source: Source, mass_mg: float) -> None:
        """So much of a source is in the cone, known otherwise than by a scoop; the source is left as it is."""
        self._set(cone_mg=mass(mass_mg), cone_source=source.name, sheet=source.sheet_key, load=Load())

    def touched(self, source: Source) -> None:
        """The sheet has gone into a source's powder. Raises ValueError while the cone holds another lot."""
        if self.sheet == source.sheet_key:
            return
        if self.cone_mg > 0.0:
            raise ValueError(f"the cone holds powder of '{self.cone_source}', and is in '{source.name}'")
        self.emptied()
        self._set(sheet=source.sheet_key)

    def scooped(self, source: Source, mass_mg: float, layer: Layer | None = None, or_mg: float = 0.0) -> None:
        """A scoop should have brought `mass_mg`; the source's share of it is in the cone, if there is so much.

        `or_mg` is what it brought if what the stroke before had missed was on its way. `layer` is what it should have
        left; None if nobody knows how that lies. Raises ValueError while the cone holds another source's powder.
        """
        if self.cone_mg > 0.0 and self.cone_source != source.name:
            raise ValueError(f"the cone holds powder of '{self.cone_source}', and has scooped from '{source.name}'")
        brought_mg = self.yields.get(source.name, 1.0) * mass(mass_mg)
        brought_mg = min(brought_mg, self.sources_mg.get(source.name, math.inf))
        left_mg = max(0.0, self.sources_mg.get(source.name, 0.0) - brought_mg)
        self._set(
            cone_mg=self.cone_mg + brought_mg,
            cone_source=source.name,
            sheet=source.sheet_key,
            load=replace(
                self.load,
                scooped_mg=self.load.scooped_mg + mass_mg,
                or_scooped_mg=self.load.scooped_mg + or_mg,
                is_first=self.load.is_first or source.name not in self.layers,
            ),
            sources_mg={**self.sources_mg, source.name: left_mg},
            layers={name: one for name, one in {**self.layers, source.name: layer}.items() if one is not None},
        )

    def emptied(self) -> None:
        """Everything was let out of the cone."""
        self._set(cone_mg=0.0, cone_source=None, has_rest=False, load=Load(), is_load_doubted=False)

    def vessel_holds(self, station: str, lot: str | None, mass_mg: float) -> None:
        """The inventory or an operator says what a vessel holds; a lot of None means that it is empty."""
        self._set(vessels={**self.vessels, station: InVessel(lot, mass(mass_mg))})

    def let_into(self, station: str, source: Source, mass_mg: float) -> None:
        """Powder of a source was let into a vessel. Raises ValueError if that holds another lot."""
        held = self.vessels.get(station, InVessel())
        if held.lot not in (None, source.sheet_key):
            raise ValueError(f"the vessel at '{station}' holds {held.lot}, and {source.sheet_key} is let into it")
        self.vessel_holds(station, source.sheet_key, held.mass_mg + mass(mass_mg))

    def cone_spilled(self) -> None:
        """The arm was limp: nobody knows what is left in the cone. Nothing is counted on, and it is let out first."""
        if self.cone_source is not None:
            self._set(cone_mg=0.0, is_load_doubted=True)

    def returned(self, source: str, mass_mg: float) -> None:
        """Powder has come back into a source."""
        self.source_holds(source, self.sources_mg.get(source, 0.0) + mass(mass_mg))

    def gave_out(self, *, is_short: bool, lacked_mg: float = math.inf) -> None:
        """Nothing comes any more, open and shaken: learn about the load, and about the source's scoops.

        If it `is_short`, it gave far less than was believed: a bridge, or a poor scoop. Otherwise it was all: what it
        should still hold never left its source. If next to nothing was missing (`lacked_mg`), lumps were waited for
        through a narrow gap, which tells neither a poor scoop nor none.
        """
        if (name := self.cone_source) is None:
            return
        load, is_wide = self.load, lacked_mg >= BARREN_MG
        if not is_short and (shaken := load.shaken_share) is not None:
            self._set(rests={**self.rests, name: shaken})
        if load.scooped_mg > 0.0 and not load.is_barren:
            if is_wide or not is_short:
                self._scoops_brought(name, load)
        elif load.scooped_mg > 0.0:
            if is_wide:
                barren = self.barren.get(name, Barren()).and_one_of(load.scooped_mg)
                self._set(barren={**self.barren, name: barren})
            self._lies_beside(name, load.scooped_mg)
        if is_short:
            self._set(is_load_doubted=True)
        else:
            self.returned(name, self.cone_mg)
            self.emptied()
            self._set(has_rest=True)

    def rest_left(self) -> None:
        """What is left in the cone comes only shaken, and is not used for the last of a dose.

        A rest that begins far too early shows a poor load, and the source's next ones will be poor, too. Of a load
        larger than believed, nothing else has told how large it was.
        """
        if (name := self.cone_source) is not None:
            if (rest := self.load.least_rest(self.rests.get(name))) is not None:
                self._set(rests={**self.rests, name: rest})
            if (there_mg := self.load.at_rest_mg(self.cone_mg, rest)) is not None:
                self._set(yields={**self.yields, name: there_mg / self.load.scooped_mg})
                self._moved_to_cone(name, there_mg - self.load.came_mg - self.cone_mg)
        self._set(load=replace(self.load, is_rest=True))

    def flowed(self, shaken_mg: float) -> None:
        """The last `shaken_mg` of the dose that has just ended came only shaken."""
        if self.cone_source is not None:
            self._set(load=replace(self.load, flowed_mg=max(0.0, self.load.came_mg - mass(shaken_mg))))

    def source_refilled(self, name: str, mass_mg: float) -> None:
        """A person has put more into a source; if it was given up, it may be scooped from again."""
        self.source_holds(name, self.sources_mg.get(name, 0.0) + mass(mass_mg))
        self._set(barren={other: barren for other, barren in self.barren.items() if other != name})

    def sources_mended(self) -> None:
        """A person has looked after the sources that were given up: they may be scooped from again."""
        given_up = self.barren_sources
        self._set(barren={name: barren for name, barren in self.barren.items() if name not in given_up})

    # --- the sheet

    def sheet_swapped(self) -> None:
        """A fresh sheet is in the hand; what was in the cone went with the old one."""
        self.sheet_is(None, self.sheets_used + 1)

    def sheet_is(self, lot: str | None, number: int) -> None:
        """The sheet with this number is in the hand, empty; it has touched this powder lot (None: fresh)."""
        self._set(sheet=lot, sheets_used=count(number))
        self.emptied()

    # --- within

    def _left_cone(self, mass_mg: float) -> None:
        """What has arrived (negative if the balance drifts) has left the cone."""
        if (name := self.cone_source) is None:
            return
        load = replace(self.load, came_mg=self.load.came_mg + mass_mg)
        if not load.is_barren and name in self.barren:
            load = self._was_not_there(name, load, self.barren[name].mass_mg)
            self._set(barren={one: barren for one, barren in self.barren.items() if one != name})
        self._set(cone_mg=self.cone_mg - mass_mg, load=load)
        if self.cone_mg < 0.0:  # it was in the cone, and so is not in its source
            self._moved_to_cone(name, -self.cone_mg)
        share = self.yields.get(name, 1.0)
        more_mg = load.came_mg - share * load.scooped_mg
        may_be_found = share >= LEAST_SHARE and load.or_scooped_mg > load.scooped_mg > 0.0
        if may_be_found and more_mg > SURPLUS * (load.came_mg - more_mg):
            load = self._found_what_was_missed(name, load)
            more_mg = load.came_mg - share * load.scooped_mg
            self._moved_to_cone(name, max(0.0, -more_mg - self.cone_mg))
        if load.scooped_mg > 0.0 and more_mg > SURPLUS * (load.came_mg - more_mg):
            self._set(
                load=replace(load, is_larger=True),
                yields={**self.yields, name: (1.0 + HIDDEN) * load.scoops_share},
            )
            self._moved_to_cone(name, max(0.0, HIDDEN * load.came_mg - self.cone_mg))

    def _scoops_brought(self, name: str, load: Load) -> None:
        """Learn the share that a load's scoops brought, which the source's next ones are expected to bring.

        If it is far less than before, what was missing lies beside, and the next stroke goes deeper. Nobody knows which
        share will repeat, so their geometric mean is expected. What a lens out of a bowl more than half full lacks lies
        beside, too, however little the one before brought.
        """
        share, before, layer = load.scoops_share, self.yields.get(name, 0.0), self.layers.get(name)
        if before > 0.0 and layer is not None and layer.is_lens:
            before = max(1.0, before)
        if share < FAR_LESS * before:
            self._lies_beside(name, (1.0 - share / before) * load.scooped_mg)
            share = math.sqrt(share * before)
        self._set(yields={**self.yields, name: share})

    def _lies_beside(self, name: str, mass_mg: float) -> None:
        """A stroke did not find so much: it lies where strokes do not come, and the next one goes deeper."""
        if (layer := self.layers.get(name)) is not None:
            there = replace(layer, beside_mg=layer.beside_mg + mass_mg, missed_mg=mass_mg)
            self._set(layers={**self.layers, name: there})

    def _is_given_up(self, name: str, barren: Barren) -> bool:
        there_mg = self.sources_mg.get(name, 0.0) + (self.cone_mg if self.cone_source == name else 0.0)
        is_most_of_it = barren.loads >= BARREN_LOADS and barren.mass_mg >= BARREN_SHARE * there_mg
        return is_most_of_it or barren.loads >= MOST_BARREN_LOADS

    def _was_not_there(self, name: str, load: Load, missing_mg: float) -> Load:
        """Powder came after strokes that brought nothing: what those should have brought was never there."""
        if (layer := self.layers.get(name)) is not None:
            layer = replace(layer, beside_mg=max(0.0, layer.beside_mg - missing_mg))
            self._set(layers={**self.layers, name: layer})
        missing_mg = min(missing_mg, self.sources_mg.get(name, 0.0))
        self.source_holds(name, self.sources_mg.get(name, 0.0) - missing_mg)
        return replace(load, not_there_mg=missing_mg)

    def _found_what_was_missed(self, name: str, load: Load) -> Load:
        """More came than expected: what the stroke before had missed lay on the way, and nothing lies beside."""
        if (layer := self.layers.get(name)) is not None:
            beside_mg = max(0.0, layer.beside_mg - (load.or_scooped_mg - load.scooped_mg))
            self._set(layers={**self.layers, name: replace(layer, beside_mg=beside_mg)})
        self.source_holds(name, self.sources_mg.get(name, 0.0) + load.not_there_mg)
        self._set(load=replace(load, scooped_mg=load.or_scooped_mg, or_scooped_mg=0.0, not_there_mg=0.0))
        return self.load

    def _moved_to_cone(self, name: str, mass_mg: float) -> None:
        """More of a source was in the cone than was believed."""
        left_mg = max(0.0, self.sources_mg.get(name, 0.0) - mass_mg)
        self._set(cone_mg=max(0.0, self.cone_mg + mass_mg), sources_mg={**self.sources_mg, name: left_mg})

    def _set(self, **changes: Any) -> None:
        for name, value in changes.items():
            object.__setattr__(self, name, MappingProxyType(value) if isinstance(value, dict) else value)


def mass(mass_mg: float) -> float:
    """A mass [mg]; raises ValueError if it is negative."""
    if not mass_mg >= 0.0:
        raise ValueError(f"a mass is not negative, as {mass_mg!r} mg is")
    return mass_mg


def count(number: int) -> int:
    """A count; raises ValueError if it is negative."""
    if number < 0:
        raise ValueError(f"a count is not negative, as {number} is")
    return number
