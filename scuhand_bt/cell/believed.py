"""What a cell is believed to hold, from what was measured and commanded; never the true mass.

Everybody reads it; only its verbs change it, each named for something that happened at the cell. They keep these
invariants, whatever happens in whatever order:

- no mass is negative, and no count;
- powder in the cone has a source, and the sheet has touched that source's powder lot (`Source.sheet_key`);
- an empty pan has no gross and no tare, and only a container of a known gross has a tare;
- a fresh sheet holds nothing.

A verb raises ValueError, and changes nothing, where what it tells contradicts what is believed.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Annotated, Any, TypeAlias

from scuhand_bt.cell.load import BARREN_MG, HIDDEN, SURPLUS, Load
from scuhand_bt.cell.pan_bracket import AS_WRITTEN, READ_ONLY, Bracket, ClosedBracket
from scuhand_bt.cell_spec import ChangerSpec
from scuhand_bt.dosing.bracket import Drift, Gross, Net
from scuhand_bt.dosing.strokes import Layer
from scuhand_bt.specs import Container, Source

Counts: TypeAlias = Annotated[Mapping[str, int], READ_ONLY, AS_WRITTEN]
Masses: TypeAlias = Annotated[Mapping[str, float], READ_ONLY, AS_WRITTEN]
"""Masses [mg], or shares of such, by name; read-only, as the rest of what is believed."""
Layers: TypeAlias = Annotated[Mapping[str, Layer], READ_ONLY, AS_WRITTEN]

BARREN_LOADS = 2
"""So many barren loads in a row, and a source is not scooped from any more: it is empty, or nothing gets out of the
cone."""


@dataclass(frozen=True)
class DoseSoFar:
    """What the container on the pan has cost until now, over all scoops and attempts."""

    began_s: float = 0.0
    pulses: int = 0
    scoops: int = 0
    vibration_s: float = 0.0
    target_mg: float | None = None
    """What is being dispensed towards now; None while nothing may flow into the container."""
    is_unweighed: bool = False
    """A dose broke off: what had left the cone then was not weighed by a stable mean yet."""


@dataclass(frozen=True)
class Believed:
    """What the cell is believed to hold. Frozen to all but its own verbs."""

    cone_mg: float = 0.0
    cone_source: str | None = None
    """The source that the powder in the cone came from; it stays known until the cone is emptied, whatever is left."""
    has_rest: bool = False
    """Nothing comes of the cone any more, and it was not emptied since: what is left in it falls out where it tips."""
    load: Load = field(default_factory=Load)
    is_load_doubted: bool = False
    """The load gave far less than it was believed to hold: it is let out before the next scoop."""
    yields: Masses = field(default_factory=lambda: MappingProxyType({}))
    """By source, the share of what its scoops should bring that the last load was seen to; 1 until one was seen."""
    rests: Masses = field(default_factory=lambda: MappingProxyType({}))
    """By source, the last share of a load that comes only shaken, as far as it was seen."""
    barren_loads: Counts = field(default_factory=lambda: MappingProxyType({}))
    """By source, how many loads in a row, the last ones, have brought nothing."""
    sheet: str | None = None
    """The powder lot (`Source.sheet_key`) that this sheet has touched; None for a fresh one."""
    sheets_used: int = 1
    slots_used: int = 0
    """Containers taken from the changer since it was filled."""
    slots_of_kinds: Counts = field(default_factory=lambda: MappingProxyType({}))
    """The same, by their kind."""
    slots: Counts = field(default_factory=lambda: MappingProxyType({}))
    """By container, the slot of the changer that it came from, from 0, since it was filled."""
    containers_used: Counts = field(default_factory=lambda: MappingProxyType({}))
    """Containers that were put on the pan, by kind."""
    pan: Container | None = None
    """The container that stands on the pan, whether it was weighed yet or not: the arm keeps clear of it."""
    pan_empty_mg: float | None = None
    """Stable gross with that container, before its first powder: the software tare."""
    pan_gross_mg: float | None = None
    """The last stable gross with that container; None while containers are changed."""
    sources_mg: Masses = field(default_factory=lambda: MappingProxyType({}))
    layers: Layers = field(default_factory=lambda: MappingProxyType({}))
    """By source, what the last stroke has left on the mortar's wall; none for a bed that nothing was scooped from."""
    dosing: DoseSoFar = field(default_factory=DoseSoFar)
    bracket: Bracket | None = None
    """The weighings about the container that stands on the pan, or stood there until the bare pan is weighed again."""
    closed: tuple[ClosedBracket, ...] = ()
    """What containers that have gone came to; until the batch has noted it."""
    has_closed: bool = False
    """A container of this run has gone, and its bracket was closed, whatever came out."""
    is_zero_doubted: bool = False
    """The balance's zero was seen to step, or the last bracket did not close: one has to, before it is believed."""
    given_up: str = ""
    """Why the container that was last on the pan counts no more; empty where it does."""
    zero_stepped_mg: float = 0.0
    """By how much the balance's zero was seen to step at most: so much may have hidden in any dose of the run."""
    drift_mg_per_s: float = 0.0
    """How fast a full container's weight was seen to change at most, with the valve shut: any dose's may have."""

    @property
    def seen_mg(self) -> float:
        """What has come since the container was last weighed, by the last reading of a dose that broke off."""
        if not self.dosing.is_unweighed or self.bracket is None or self.pan_gross_mg is None:
            return 0.0
        return max(0.0, self.pan_gross_mg - self.bracket.last.gross_mg)

    @property
    def weighed_container(self) -> Container | None:
        """The container on the pan, if its weight has shown that it is the right one."""
        return self.pan if self.pan_gross_mg is not None else None

    @property
    def seen_yields(self) -> Masses:
        """Of `yields`, those of sources of which a load's end was seen, or was in an earlier run."""
        unseen = self.cone_source if self.load.is_larger else None
        return {name: share for name, share in self.yields.items() if name != unseen}

    @property
    def barren_sources(self) -> frozenset[str]:
        """Those whose scoops have brought nothing so often that no more are made."""
        return frozenset(name for name, loads in self.barren_loads.items() if loads >= BARREN_LOADS)

    # --- the cone and the sources

    def source_holds(self, name: str, mass_mg: float) -> None:
        """So much is in a source: what a recipe, the inventory or an operator says."""
        self._set(sources_mg={**self.sources_mg, name: _mass(mass_mg)})

    def scoops_bring(self, name: str, share: float) -> None:
        """What scoops of a source were seen to bring of what was expected, in earlier runs; what this one has seen
        counts more.
        """
        self._set(yields={name: _mass(share), **self.yields})

    def cone_holds(self, source: Source, mass_mg: float) -> None:
        """So much of a source is in the cone, known otherwise than by a scoop; what the source holds is not changed."""
        self._set(cone_mg=_mass(mass_mg), cone_source=source.name, sheet=source.sheet_key, load=Load())

    def touched(self, source: Source) -> None:
        """The sheet has gone into the powder of a source. ValueError while the cone holds another lot."""
        if self.sheet == source.sheet_key:
            return
        if self.cone_mg > 0.0:
            raise ValueError(f"the cone holds powder of '{self.cone_source}', and is in '{source.name}'")
        self.emptied()
        self._set(sheet=source.sheet_key)

    def scooped(self, source: Source, mass_mg: float, layer: Layer | None = None) -> None:
        """A scoop should have brought so much of a source into the cone; it has brought what this source yields of it.

        It should have left this layer; None: nobody knows how it lies.
        ValueError while the cone holds another source's powder.
        """
        if self.cone_mg > 0.0 and self.cone_source != source.name:
            raise ValueError(f"the cone holds powder of '{self.cone_source}', and has scooped from '{source.name}'")
        brought_mg = self.yields.get(source.name, 1.0) * _mass(mass_mg)
        left_mg = max(0.0, self.sources_mg.get(source.name, 0.0) - brought_mg)
        self._set(
            cone_mg=self.cone_mg + brought_mg,
            cone_source=source.name,
            sheet=source.sheet_key,
            load=replace(
                self.load,
                scooped_mg=self.load.scooped_mg + mass_mg,
                is_first=self.load.is_first or source.name not in self.layers,
            ),
            sources_mg={**self.sources_mg, source.name: left_mg},
            layers={name: one for name, one in {**self.layers, source.name: layer}.items() if one is not None},
            dosing=replace(self.dosing, scoops=self.dosing.scoops + 1),
        )

    def emptied(self) -> None:
        """Everything has been let out of the cone."""
        self._set(cone_mg=0.0, cone_source=None, has_rest=False, load=Load(), is_load_doubted=False)

    def cone_spilled(self) -> None:
        """The arm was limp: nobody knows what is left in the cone. Nothing is counted on, and it is let out first."""
        if self.cone_source is not None:
            self._set(cone_mg=0.0, is_load_doubted=True)

    def returned(self, source: str, mass_mg: float) -> None:
        """So much has come back into a source."""
        self.source_holds(source, self.sources_mg.get(source, 0.0) + _mass(mass_mg))

    def gave_out(self, *, is_short: bool, lacked_mg: float = math.inf) -> None:
        """Nothing comes any more, open and shaken: what that tells of the load, and of what the source's scoops bring.

        A load that `is_short` gave far less than it was believed to hold: a bridge holds it, or it was a poor scoop.
        Any other was all of it: what it was thought to hold still never left its source. Where the dose lacked next to
        nothing (`lacked_mg`) lumps were waited for through a narrow gap: that tells neither a poor scoop nor none.
        """
        if (name := self.cone_source) is None:
            return
        load, is_wide = self.load, lacked_mg >= BARREN_MG
        if not is_short and (shaken := load.shaken_share) is not None:
            self._set(rests={**self.rests, name: shaken})
        if load.scooped_mg > 0.0 and not load.is_barren:
            if is_wide or not is_short:
                self._set(yields={**self.yields, name: load.scoops_share})
        elif load.scooped_mg > 0.0 and is_wide:
            self._set(barren_loads={**self.barren_loads, name: self.barren_loads.get(name, 0) + 1})
            self._lies_beside(name, load.scooped_mg)
        if is_short:
            self._set(is_load_doubted=True)
        else:
            self.returned(name, self.cone_mg)
            self.emptied()
            self._set(has_rest=True)

    def rest_left(self) -> None:
        """What is left in the cone comes only shaken: that is for a dose's most, and not for the last of it.

        Where that began long before it should have, the load was a poor one, as its source's next ones will be; and of
        one that was larger than thought nothing else has told how large.
        """
        if (name := self.cone_source) is not None:
            if (rest := self.load.least_rest(self.rests.get(name))) is not None:
                self._set(rests={**self.rests, name: rest})
            if (there_mg := self.load.at_rest_mg(self.cone_mg, rest)) is not None:
                self._set(yields={**self.yields, name: there_mg / self.load.scooped_mg})
                self._moved_to_cone(name, there_mg - self.load.came_mg - self.cone_mg)
        self._set(load=replace(self.load, is_rest=True))

    def flowed(self, shaken_mg: float) -> None:
        """Of the dose that has just ended the last so much came only shaken, and what came before by itself."""
        if self.cone_source is not None:
            self._set(load=replace(self.load, flowed_mg=max(0.0, self.load.came_mg - _mass(shaken_mg))))

    def source_refilled(self, name: str, mass_mg: float) -> None:
        """A person has put so much more into a source, which may be scooped from again if it gave nothing."""
        self.source_holds(name, self.sources_mg.get(name, 0.0) + _mass(mass_mg))
        self._set(barren_loads={other: loads for other, loads in self.barren_loads.items() if other != name})

    def sources_mended(self) -> None:
        """A person has looked after the sources that gave nothing: they may be scooped from again."""
        barren = self.barren_sources
        self._set(barren_loads={name: loads for name, loads in self.barren_loads.items() if name not in barren})

    # --- the sheet

    def sheet_swapped(self) -> None:
        """A fresh sheet is in the hand; what was in the cone went with the old one."""
        self.sheet_is(None, self.sheets_used + 1)

    def sheet_is(self, lot: str | None, number: int) -> None:
        """This sheet, by its number, is in the hand, has touched this powder lot (None: it is fresh), and is empty."""
        self._set(sheet=lot, sheets_used=_count(number))
        self.emptied()

    # --- containers

    def changing_container(self) -> None:
        """The container on the pan is about to be taken away."""
        self._set(pan_empty_mg=None, pan_gross_mg=None)

    def removed(self) -> None:
        """Nothing stands on the pan."""
        self._set(pan=None, pan_empty_mg=None, pan_gross_mg=None)

    def brought(self, container: Container, *, from_changer: bool, first_slot: int | None = None) -> None:
        """A container was put on the pan, and is not weighed yet.

        `first_slot` is the first one of the changer that is for its kind, where kinds have slots of their own.
        """
        kind = container.name
        slots = {**self.slots, container.id: slot_of(self, container, first_slot)} if from_changer else self.slots
        taken = len(slots) - len(self.slots)
        of_kind = {kind: self.slots_of_kinds.get(kind, 0) + taken} if taken else {}
        self._set(
            slots_of_kinds={**self.slots_of_kinds, **of_kind},
            pan=container,
            pan_empty_mg=None,
            pan_gross_mg=None,
            slots_used=self.slots_used + taken,
            slots=slots,
            containers_used={**self.containers_used, kind: self.containers_used.get(kind, 0) + 1},
        )

    def placed(self, bare: Gross, loaded: Gross) -> None:
        """The container on the pan has the weight that its kind has. ValueError without one."""
        if self.pan is None:
            raise ValueError("no container stands on the pan")
        self._set(pan_gross_mg=loaded.gross_mg, bracket=Bracket(self.pan.id, bare, loaded, loaded), given_up="")

    def rebracketed(self, bare: Gross, loaded: Gross, empty: Net, held: Net, left_cone_mg: float) -> None:
        """After an outage the same container was weighed by the bare pan, and holds so much; all weighings begin anew.

        What has come meanwhile has left the cone, and is of the lot that was dosed last. ValueError without a bracket.
        """
        bracket = self.bracket
        if bracket is None or self.pan is None:
            raise ValueError("no container on the pan was weighed before")
        carried: dict[str, Net] = {}
        if bracket.holds or self.dosing.is_unweighed:
            carried = bracket.carried_of(held)
            self._left_cone(max(0.0, left_cone_mg))
        self._set(
            pan_empty_mg=loaded.gross_mg - sum(net.mass_mg for net in carried.values()),
            pan_gross_mg=loaded.gross_mg,
            dosing=replace(self.dosing, target_mg=None, is_unweighed=False),
            bracket=bracket.begun_anew(bare, loaded, empty, carried),
        )

    def container_given_up(self, why: str) -> None:
        """What stands on the pan, if anything does, is not what was weighed there, or nobody knows."""
        bracket = self.bracket
        if bracket is None:
            return
        had = bool(bracket.holds) or self.dosing.is_unweighed
        lost = (ClosedBracket(bracket.container, MappingProxyType({}), False, 0.0, why),) if had else ()
        self._set(
            bracket=None,
            pan_empty_mg=None,
            pan_gross_mg=None,
            given_up=why,
            closed=(*self.closed, *lost),
            dosing=replace(self.dosing, target_mg=None, is_unweighed=False),
        )

    def lifted(self, weighing: Gross) -> None:
        """What is about to be taken off the pan weighs so much, the hand away. ValueError without a bracket."""
        self._set(bracket=replace(self._open_bracket, lifted=weighing))

    def bracket_closed(self, closed: ClosedBracket | None) -> None:
        """The bare pan was weighed after a container; None where nothing was dosed into it.

        A zero that has just stepped may step back within the next bracket, which then closes by chance.
        """
        if closed is None:
            self._set(bracket=None)
            return
        told = closed
        if closed.closes and self.is_zero_doubted:
            told = replace(closed, closes=False, detail=f"the balance's zero has stepped of late; {closed.detail}")
        self._set(bracket=None, closed=(*self.closed, told), has_closed=True, is_zero_doubted=not closed.closes)

    def noted(self, closed: ClosedBracket) -> None:
        """The batch has noted what a container came to."""
        self._set(closed=tuple(one for one in self.closed if one is not closed))

    def slots_refilled(self) -> None:
        """Every slot of the changer holds a container again."""
        self._set(slots_used=0, slots_of_kinds={}, slots={})

    def containers_taken(self, slots: int, by_kind: Mapping[str, int]) -> None:
        """So many slots of the changer, and containers by their kind, were used before."""
        self._set(slots_used=_count(slots), containers_used={kind: _count(used) for kind, used in by_kind.items()})

    def slots_taken(self, by_kind: Mapping[str, int]) -> None:
        """So many slots of a changer in which kinds have their own were used before."""
        used = {kind: _count(count) for kind, count in by_kind.items()}
        self._set(slots_used=sum(used.values()), slots_of_kinds=used)

    # --- weighing and dosing

    def dose_began(self, now_s: float) -> None:
        """What is counted for a dose begins anew."""
        self._set(dosing=DoseSoFar(began_s=now_s))

    def tared(self, weighing: Gross) -> None:
        """The container on the pan weighs so much before its first powder. ValueError without one that was weighed."""
        bracket = self._open_bracket.tared(weighing)
        so_far = DoseSoFar(began_s=weighing.time_s, scoops=self.dosing.scoops)  # a scoop may have been made meanwhile
        self._set(pan_empty_mg=weighing.gross_mg, pan_gross_mg=weighing.gross_mg, bracket=bracket, dosing=so_far)

    def zero_stepped(self, by_mg: float) -> None:
        """Weighings of one thing differ by so much, which neither chance nor powder explains; 0: by nothing."""
        if _mass(by_mg) > 0.0:
            self._set(is_zero_doubted=True, zero_stepped_mg=max(self.zero_stepped_mg, by_mg))

    def drifted(self, rate_mg_per_s: float) -> None:
        """With the valve shut a full container was seen to weigh ever more, or less, at this rate; 0: it was not."""
        self._set(drift_mg_per_s=max(self.drift_mg_per_s, _mass(rate_mg_per_s)))

    def dosing_towards(self, target_mg: float, lot: str, before: Gross) -> None:
        """The valve may open from now on, over what weighs so much; what leaves the cone is not weighed yet.

        ValueError without a container that was weighed.
        """
        bracket = self._open_bracket
        self._set(
            dosing=replace(self.dosing, target_mg=_mass(target_mg), is_unweighed=True),
            pan_empty_mg=before.gross_mg - bracket.dosed_mg(lot).mass_mg,
            bracket=replace(bracket, last=before, lot=lot),
        )

    def dosing_ended(self, arrived_mg: float, gross_mg: float) -> None:
        """The valve is shut; by the last reading so much has arrived. A stable mean is still to come."""
        self._left_cone(arrived_mg)
        self._weighed(gross_mg)
        self._set(dosing=replace(self.dosing, target_mg=None))

    def dosed(self, gained: Net, drift: Drift, now: Gross, pulses: int, vibration_s: float) -> None:
        """The container has gained so much by a dose that took this many pulses, and vibration; it weighs so much."""
        so_far, bracket = self.dosing, self._open_bracket
        self._weighed(now.gross_mg)
        self._set(
            bracket=bracket.gained(gained, drift, now),
            dosing=replace(
                so_far,
                pulses=so_far.pulses + pulses,
                vibration_s=so_far.vibration_s + vibration_s,
                is_unweighed=False,
            ),
        )

    def reweighed(self, gained: Net, now: Gross, lot: str) -> None:
        """The container was weighed after a dose of a lot broke off: what it has gained since has left the cone.

        ValueError without an earlier gross.
        """
        if self.pan_gross_mg is None:
            raise ValueError("no container on the pan was weighed before")
        bracket = replace(self._open_bracket, lot=lot)
        self._left_cone(now.gross_mg - self.pan_gross_mg)
        self._weighed(now.gross_mg)
        self._set(bracket=bracket.found(gained, now))
        self._set(dosing=replace(self.dosing, is_unweighed=False))

    def zero_moved(self, drift_mg: float, now: Gross) -> None:
        """The container's gross is this now, and so much of the difference comes from the balance's zero."""
        self._weighed(now.gross_mg)
        if self.pan_empty_mg is not None:
            self._set(pan_empty_mg=self.pan_empty_mg + drift_mg)
        if (bracket := self.bracket) is not None:
            self._set(bracket=bracket.with_zero_moved(drift_mg, now))

    # --- within

    @property
    def _open_bracket(self) -> Bracket:
        if self.bracket is None or self.weighed_container is None:
            raise ValueError("no container on the pan was weighed")
        return self.bracket

    def _left_cone(self, mass_mg: float) -> None:
        """What arrived (less than nothing, where the balance drifts) is not in a cone that held something."""
        if (name := self.cone_source) is None:
            return
        load = replace(self.load, came_mg=self.load.came_mg + mass_mg)
        if not load.is_barren and name in self.barren_loads:
            self._set(barren_loads={one: count for one, count in self.barren_loads.items() if one != name})
        self._set(cone_mg=self.cone_mg - mass_mg, load=load)
        if self.cone_mg < 0.0:  # it was in the cone, and is not in its source
            self._moved_to_cone(name, -self.cone_mg)
        more_mg = load.came_mg - self.yields.get(name, 1.0) * load.scooped_mg
        if load.scooped_mg > 0.0 and more_mg > SURPLUS * (load.came_mg - more_mg):
            self._set(
                load=replace(load, is_larger=True),
                yields={**self.yields, name: (1.0 + HIDDEN) * load.scoops_share},
            )
            self._moved_to_cone(name, max(0.0, HIDDEN * load.came_mg - self.cone_mg))

    def _lies_beside(self, name: str, mass_mg: float) -> None:
        """A stroke found nothing of so much: it lies where strokes do not come, and the next one goes deeper."""
        if (layer := self.layers.get(name)) is not None:
            self._set(layers={**self.layers, name: replace(layer, beside_mg=layer.beside_mg + mass_mg)})

    def _moved_to_cone(self, name: str, mass_mg: float) -> None:
        """So much more of a source was in the cone than was believed."""
        left_mg = max(0.0, self.sources_mg.get(name, 0.0) - mass_mg)
        self._set(cone_mg=max(0.0, self.cone_mg + mass_mg), sources_mg={**self.sources_mg, name: left_mg})

    def _weighed(self, gross_mg: float) -> None:
        """A gross belongs to a container that is known: while containers are changed it says nothing."""
        if self.weighed_container is not None:
            self._set(pan_gross_mg=gross_mg)

    def _set(self, **changes: Any) -> None:
        for name, value in changes.items():
            object.__setattr__(self, name, MappingProxyType(value) if isinstance(value, dict) else value)


def _mass(mass_mg: float) -> float:
    if not mass_mg >= 0.0:
        raise ValueError(f"a mass is not negative, as {mass_mg!r} mg is")
    return mass_mg


def _count(number: int) -> int:
    if number < 0:
        raise ValueError(f"a count is not negative, as {number} is")
    return number


def slot_of(believed: Believed, container: Container, first_slot: int | None = None) -> int:
    """The slot of the changer, from 0, that a container is in: the next one, for one that was not brought yet.

    Where kinds have slots of their own, the next one of these; `first_slot` is the first.
    """
    if (slot := believed.slots.get(container.id)) is not None:
        return slot
    return believed.slots_used if first_slot is None else first_slot + believed.slots_of_kinds.get(container.name, 0)


def is_used_up(believed: Believed, kind: str, changer: ChangerSpec) -> bool:
    """Whether the changer has given all that it held of what a container of this kind could come from."""
    used = believed.slots_of_kinds.get(kind, 0) if changer.kinds else believed.slots_used
    return used >= changer.slots_for(kind)
