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

from scuhand_bt.cell.believed_powder import BelievedPowder, Counts, count, mass
from scuhand_bt.cell.load import BARREN_MG
from scuhand_bt.cell.pan_bracket import Bracket, ClosedBracket
from scuhand_bt.device_specs.changer import ChangerSpec
from scuhand_bt.dosing.bed import Layer
from scuhand_bt.dosing.bracket import Drift, Gross, Net
from scuhand_bt.specs import Container, Source

COMES_MG = 1.0
"""Less of a load that has come is nothing: a zero may have walked as far."""
LAST_LOADS = 4
"""So many loads in a row that gave a dose's last milligrams in vain: others would not give them either."""


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
    in_vain: int = 0
    """Loads in a row that gave out with its last milligrams missing, since powder came."""


@dataclass(frozen=True)
class Believed(BelievedPowder):
    """What the cell is believed to hold. Frozen to all but its own verbs."""

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
    dosing: DoseSoFar = field(default_factory=DoseSoFar)
    bracket: Bracket | None = None
    """The weighings about the container that stands on the pan, or stood there until the bare pan is weighed again."""
    closed: tuple[ClosedBracket, ...] = ()
    """What containers that have gone came to; until the batch has noted it."""
    gone: tuple[ClosedBracket, ...] = ()
    """What containers came to that have gone in this job, each once: they may be put on the pan again."""
    told_lots: tuple[str, ...] = ()
    """Powder lots that were in containers of this run which have gone, their brackets closed, whatever came out."""
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

    # --- containers

    def changing_container(self) -> None:
        """The container on the pan is about to be taken away."""
        self._set(pan_empty_mg=None, pan_gross_mg=None)

    def removed(self) -> None:
        """Nothing stands on the pan."""
        so_far = replace(self.dosing, target_mg=None, is_unweighed=False)
        self._set(pan=None, pan_empty_mg=None, pan_gross_mg=None, dosing=so_far)

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
        """The container on the pan weighs what its kind does, and what it held before. ValueError without one."""
        if self.pan is None:
            raise ValueError("no container stands on the pan")
        bracket = Bracket(self.pan.id, bare, loaded, loaded)
        if (before := self.had_gone(self.pan.id)) is not None:
            lot = next(reversed([*before.doses]), "")  # what an outage finds in it before another dose is of that
            bracket = replace(bracket, lot=lot, carried=before.doses, lasted_s=before.lasted_s)
        self._set(pan_gross_mg=loaded.gross_mg, bracket=bracket, given_up="")

    def had_gone(self, container: str) -> ClosedBracket | None:
        """What a container came to that was on the pan before in this job, and got powder there."""
        return next((one for one in self.gone if one.container == container), None)

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
            gone=self._gone_with(*lost),
            dosing=replace(self.dosing, target_mg=None, is_unweighed=False),
        )

    def discarded(self) -> None:
        """What stands on the pan is thrown away as it goes: with powder in it, it does not come again."""
        if self.pan is None:
            return
        container, has_powder = self.pan.id, self.dosing.is_unweighed or bool(self.bracket and self.bracket.holds)
        if not has_powder and self.had_gone(container) is None:
            return
        lost = ClosedBracket(container, MappingProxyType({}), False, 0.0, "it was thrown away", is_discarded=True)
        closed = (replace(one, is_discarded=one.is_discarded or one.container == container) for one in self.closed)
        self._set(closed=tuple(closed), gone=self._gone_with(lost))

    def lifted(self, weighing: Gross) -> None:
        """What is about to be taken off the pan weighs so much, the hand away. ValueError without a bracket."""
        self._set(bracket=replace(self._open_bracket, lifted=weighing))

    def bracket_closed(self, closed: ClosedBracket | None) -> None:
        """The bare pan was weighed after a container; None where nothing was dosed into it.

        A zero that has just stepped may step back within the next bracket, which then closes by chance. Of a container
        that has come again the later bracket tells all, and earlier ones only where they did not close.
        """
        if closed is None:
            self._set(bracket=None)
            return
        told = closed
        if closed.closes and self.is_zero_doubted:
            why = "the balance's zero has stepped of late, or the bracket before did not close"
            told = replace(closed, closes=False, detail=f"{why}; {closed.detail}")
        before = self.had_gone(closed.container)
        if is_discarded := before is not None and before.is_discarded:
            told = replace(told, is_discarded=True)
        elif before is not None and abs(before.difference_mg) > abs(told.difference_mg):
            told = replace(told, difference_mg=before.difference_mg, detail=f"{before.detail}; then {told.detail}")
        self._set(
            bracket=None,
            closed=(*(one for one in self.closed if one.container != told.container or not one.closes), told),
            gone=self.gone if is_discarded else self._gone_with(told),
            told_lots=tuple(sorted({*self.told_lots, *closed.doses})),
            is_zero_doubted=not closed.closes,
        )

    def noted(self, closed: ClosedBracket) -> None:
        """The batch has noted what a container came to."""
        self._set(closed=tuple(one for one in self.closed if one is not closed))

    def slots_refilled(self) -> None:
        """Every slot of the changer holds a container again."""
        self._set(slots_used=0, slots_of_kinds={}, slots={})

    def containers_taken(self, slots: int, by_kind: Mapping[str, int]) -> None:
        """So many slots of the changer, and containers by their kind, were used before."""
        self._set(slots_used=count(slots), containers_used={kind: count(used) for kind, used in by_kind.items()})

    def slots_taken(self, by_kind: Mapping[str, int]) -> None:
        """So many slots of a changer in which kinds have their own were used before."""
        used = {kind: count(taken) for kind, taken in by_kind.items()}
        self._set(slots_used=sum(used.values()), slots_of_kinds=used)

    # --- weighing and dosing

    def scooped(self, source: Source, mass_mg: float, layer: Layer | None = None, or_mg: float = 0.0) -> None:
        """As of any powder, and counted for the dose."""
        super().scooped(source, mass_mg, layer, or_mg)
        self._set(dosing=replace(self.dosing, scoops=self.dosing.scoops + 1))

    def gave_out(self, *, is_short: bool, lacked_mg: float = math.inf) -> None:
        """As of any powder, and counted for the dose where that lacked next to nothing."""
        super().gave_out(is_short=is_short, lacked_mg=lacked_mg)
        self._set(dosing=replace(self.dosing, in_vain=self.dosing.in_vain + 1 if lacked_mg < BARREN_MG else 0))

    def dose_began(self, now_s: float) -> None:
        """A job begins: what is counted for a dose begins anew, and no container comes again."""
        self._set(dosing=DoseSoFar(began_s=now_s, is_unweighed=self.dosing.is_unweighed), gone=())

    def tared(self, weighing: Gross) -> None:
        """The container on the pan weighs so much before its first powder. ValueError without one that was weighed."""
        bracket = self._open_bracket.tared(weighing)
        so_far = DoseSoFar(began_s=weighing.time_s, scoops=self.dosing.scoops)  # a scoop may have been made meanwhile
        self._set(pan_empty_mg=weighing.gross_mg, pan_gross_mg=weighing.gross_mg, bracket=bracket, dosing=so_far)

    def zero_stepped(self, by_mg: float) -> None:
        """Weighings of one thing differ by so much, which neither chance nor powder explains; 0: by nothing."""
        if mass(by_mg) > 0.0:
            self._set(is_zero_doubted=True, zero_stepped_mg=max(self.zero_stepped_mg, by_mg))

    def drifted(self, rate_mg_per_s: float) -> None:
        """With the valve shut a full container was seen to weigh ever more, or less, at this rate; 0: it was not."""
        self._set(drift_mg_per_s=max(self.drift_mg_per_s, mass(rate_mg_per_s)))

    def dosing_towards(self, target_mg: float, lot: str, before: Gross) -> None:
        """The valve may open from now on, over what weighs so much; what leaves the cone is not weighed yet.

        ValueError without a container that was weighed.
        """
        bracket = self._open_bracket
        self._set(
            dosing=replace(self.dosing, target_mg=mass(target_mg), is_unweighed=True),
            pan_empty_mg=before.gross_mg - bracket.dosed_mg(lot).mass_mg,
            bracket=replace(bracket, last=before, lot=lot),
        )

    def dosing_ended(self, arrived_mg: float, gross_mg: float) -> None:
        """The valve is shut; by the last reading so much has arrived. A stable mean is still to come."""
        self._left_cone(arrived_mg)
        self._weighed(gross_mg)
        in_vain = self.dosing.in_vain if arrived_mg < COMES_MG else 0
        self._set(dosing=replace(self.dosing, target_mg=None, in_vain=in_vain))

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

    def dripped(self, mass_mg: float) -> None:
        """The container has gained so much since its last dose, which puts its doses in doubt."""
        self._set(bracket=self._open_bracket.dripped(mass(mass_mg)))

    def reweighed(self, gained: Net, now: Gross) -> None:
        """The container was weighed after a dose broke off: what it has gained since is of its lot, and has left the
        cone, if that still has this lot in it.

        ValueError without an earlier gross.
        """
        if self.pan_gross_mg is None:
            raise ValueError("no container on the pan was weighed before")
        bracket = self._open_bracket
        if self.sheet == bracket.lot:
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

    def _gone_with(self, *closed: ClosedBracket) -> tuple[ClosedBracket, ...]:
        names = {one.container for one in closed}
        return (*(one for one in self.gone if one.container not in names), *closed)

    @property
    def _open_bracket(self) -> Bracket:
        if self.bracket is None or self.weighed_container is None:
            raise ValueError("no container on the pan was weighed")
        return self.bracket

    def _weighed(self, gross_mg: float) -> None:
        """A gross belongs to a container that is known: while containers are changed it says nothing."""
        if self.weighed_container is not None:
            self._set(pan_gross_mg=gross_mg)


def slot_of(believed: Believed, container: Container, first_slot: int | None = None) -> int:
    """The slot of the changer, from 0, that a container is in: the next one, for one that was not brought yet.

    Where kinds have slots of their own, the next one of these; `first_slot` is the first.
    """
    if (slot := believed.slots.get(container.id)) is not None:
        return slot
    return believed.slots_used if first_slot is None else first_slot + believed.slots_of_kinds.get(container.name, 0)


def slots_used(believed: Believed, changer: ChangerSpec) -> Mapping[str, int]:
    """How many containers the changer has given since it was filled, by kind; as "" where none has slots of its own."""
    return believed.slots_of_kinds if changer.kinds else {"": believed.slots_used}
