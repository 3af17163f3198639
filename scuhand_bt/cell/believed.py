"""What a cell is believed to hold, by what was measured and commanded; never the true mass.

Everybody may read it. Only its verbs change it, each named for something that happened at the cell. They keep these
invariants, in whatever order things happen:

- no mass is negative, and no count;
- powder in the cone has a source, and the sheet has touched that source's powder lot (`Source.sheet_key`);
- an empty pan has no gross and no tare, and only a container of a known gross has a tare;
- a fresh sheet holds nothing.

A verb raises ValueError, and changes nothing, where what it says contradicts what is believed.
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
"""Less than this of a load counts as nothing: the zero may have wandered as far."""
LAST_LOADS = 4
"""After so many loads in a row that gave a dose's last milligrams in vain, no further ones are tried."""


@dataclass(frozen=True)
class DoseSoFar:
    """What has been done for the container on the pan until now, over all scoops and attempts."""

    began_s: float = 0.0
    pulses: int = 0
    scoops: int = 0
    vibration_s: float = 0.0
    target_mg: float | None = None
    """The present target; None while nothing may flow into the container."""
    is_unweighed: bool = False
    """Whether a dose broke off whose powder has no stable mean yet."""
    in_vain: int = 0
    """Loads in a row that gave out with the dose's last milligrams missing, since powder came."""


@dataclass(frozen=True)
class Believed(BelievedPowder):
    """What the cell is believed to hold; changed by its own verbs only."""

    slots_used: int = 0
    """Containers taken from the changer since it was filled."""
    slots_of_kinds: Counts = field(default_factory=lambda: MappingProxyType({}))
    """The same, by their kind."""
    slots: Counts = field(default_factory=lambda: MappingProxyType({}))
    """By container, the slot of the changer that it came from, counted from 0, since the changer was filled."""
    containers_used: Counts = field(default_factory=lambda: MappingProxyType({}))
    """Containers put on the pan, by kind."""
    pan: Container | None = None
    """The container on the pan, weighed or not: the arm keeps clear of it."""
    pan_empty_mg: float | None = None
    """Stable gross of that container before its first powder: the software tare."""
    pan_gross_mg: float | None = None
    """Its last stable gross; None while containers are changed."""
    dosing: DoseSoFar = field(default_factory=DoseSoFar)
    bracket: Bracket | None = None
    """The weighings about the container on the pan, until the bare pan is weighed after it."""
    closed: tuple[ClosedBracket, ...] = ()
    """Results of containers that have gone, until the batch has noted them."""
    gone: tuple[ClosedBracket, ...] = ()
    """Results of the containers that have gone in this job, each once: they may come to the pan again."""
    told_lots: tuple[str, ...] = ()
    """Powder lots whose containers have gone in this run, whether their brackets closed or not."""
    is_zero_doubted: bool = False
    """Whether the zero was seen to step, or the last bracket did not close; the next one to close is not believed."""
    given_up: str = ""
    """Why the container last on the pan no longer counts; empty if it does."""
    zero_stepped_mg: float = 0.0
    """The largest step of the zero seen in this run: any dose may hide one as large."""
    drift_mg_per_s: float = 0.0
    """The fastest change of a full container's weight seen with the valve shut: any dose may have had it."""

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

        `first_slot` is the changer's first slot for its kind, where kinds have slots of their own.
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
        """The container on the pan has the weight of its kind and of what it held before.

        Raises ValueError without one.
        """
        if self.pan is None:
            raise ValueError("no container stands on the pan")
        bracket = Bracket(self.pan.id, bare, loaded, loaded)
        if (before := self.had_gone(self.pan.id)) is not None:
            lot = next(reversed([*before.doses]), "")  # what an outage finds in it before another dose is of that lot
            bracket = replace(bracket, lot=lot, carried=before.doses, lasted_s=before.lasted_s)
        self._set(pan_gross_mg=loaded.gross_mg, bracket=bracket, given_up="")

    def had_gone(self, container: str) -> ClosedBracket | None:
        """The result of a container that was on the pan before in this job, and got powder there."""
        return next((one for one in self.gone if one.container == container), None)

    def rebracketed(self, bare: Gross, loaded: Gross, empty: Net, held: Net, left_cone_mg: float) -> None:
        """After an outage the same container was weighed against the bare pan; all weighings begin anew.

        What has come meanwhile has left the cone, and is of the lot dosed last. Raises ValueError without a bracket.
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
        """What stands on the pan is not what was weighed there, or nobody knows what it is."""
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
        """What stands on the pan is thrown away as it goes; with powder in it, it does not come again."""
        if self.pan is None:
            return
        container, has_powder = self.pan.id, self.dosing.is_unweighed or bool(self.bracket and self.bracket.holds)
        if not has_powder and self.had_gone(container) is None:
            return
        lost = ClosedBracket(container, MappingProxyType({}), False, 0.0, "it was thrown away", is_discarded=True)
        closed = (replace(one, is_discarded=one.is_discarded or one.container == container) for one in self.closed)
        self._set(closed=tuple(closed), gone=self._gone_with(lost))

    def lifted(self, weighing: Gross) -> None:
        """The container was weighed, the hand away, before it is taken off. Raises ValueError without a bracket."""
        self._set(bracket=replace(self._open_bracket, lifted=weighing))

    def bracket_closed(self, closed: ClosedBracket | None) -> None:
        """The bare pan was weighed after a container; None if nothing was dosed into it.

        After a step of the zero the next bracket may close by chance, as the zero steps back. If a container has come
        again, the later bracket tells all, and earlier ones count only where they did not close.
        """
        if closed is None:
            self._set(bracket=None)
            return
        told = closed
        if closed.closes and self.is_zero_doubted:
            why = "the balance's zero has stepped recently, or the bracket before did not close"
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
        """The batch has noted a container's result."""
        self._set(closed=tuple(one for one in self.closed if one is not closed))

    def slots_refilled(self) -> None:
        """Every slot of the changer holds a container again."""
        self._set(slots_used=0, slots_of_kinds={}, slots={})

    def containers_taken(self, slots: int, by_kind: Mapping[str, int]) -> None:
        """So many of the changer's slots, and of each kind's containers, were used before."""
        self._set(slots_used=count(slots), containers_used={kind: count(used) for kind, used in by_kind.items()})

    def slots_taken(self, by_kind: Mapping[str, int]) -> None:
        """So many slots were used before, by kind, in a changer in which kinds have slots of their own."""
        used = {kind: count(taken) for kind, taken in by_kind.items()}
        self._set(slots_used=sum(used.values()), slots_of_kinds=used)

    # --- weighing and dosing

    def scooped(self, source: Source, mass_mg: float, layer: Layer | None = None, or_mg: float = 0.0) -> None:
        """As for any powder; also counted for the dose."""
        super().scooped(source, mass_mg, layer, or_mg)
        self._set(dosing=replace(self.dosing, scoops=self.dosing.scoops + 1))

    def gave_out(self, *, is_short: bool, lacked_mg: float = math.inf) -> None:
        """As for any powder; also counted for the dose if it lacked next to nothing."""
        super().gave_out(is_short=is_short, lacked_mg=lacked_mg)
        self._set(dosing=replace(self.dosing, in_vain=self.dosing.in_vain + 1 if lacked_mg < BARREN_MG else 0))

    def dose_began(self, now_s: float) -> None:
        """A job begins: counts for a dose start at zero, and no container comes again."""
        self._set(dosing=DoseSoFar(began_s=now_s, is_unweighed=self.dosing.is_unweighed), gone=())

    def tared(self, weighing: Gross) -> None:
        """The container was weighed before its first powder. Raises ValueError unless one was weighed on the pan."""
        bracket = self._open_bracket.tared(weighing)
        so_far = DoseSoFar(began_s=weighing.time_s, scoops=self.dosing.scoops)  # its scoop may have been made before
        self._set(pan_empty_mg=weighing.gross_mg, pan_gross_mg=weighing.gross_mg, bracket=bracket, dosing=so_far)

    def zero_stepped(self, by_mg: float) -> None:
        """Weighings of one thing differ by more than chance and powder explain; 0 if they do not."""
        if mass(by_mg) > 0.0:
            self._set(is_zero_doubted=True, zero_stepped_mg=max(self.zero_stepped_mg, by_mg))

    def drifted(self, rate_mg_per_s: float) -> None:
        """A full container's weight was seen to change at this rate with the valve shut; 0 if it did not."""
        self._set(drift_mg_per_s=max(self.drift_mg_per_s, mass(rate_mg_per_s)))

    def dosing_towards(self, target_mg: float, lot: str, before: Gross) -> None:
        """The valve may open now, over a container of this gross; what leaves the cone has yet to be weighed.

        Raises ValueError without a container that was weighed.
        """
        bracket = self._open_bracket
        self._set(
            dosing=replace(self.dosing, target_mg=mass(target_mg), is_unweighed=True),
            pan_empty_mg=before.gross_mg - bracket.dosed_mg(lot).mass_mg,
            bracket=replace(bracket, last=before, lot=lot),
        )

    def dosing_ended(self, arrived_mg: float, gross_mg: float) -> None:
        """The valve is shut; the arrived mass is by the last reading, and a stable mean is still to come."""
        self._left_cone(arrived_mg)
        self._weighed(gross_mg)
        in_vain = self.dosing.in_vain if arrived_mg < COMES_MG else 0
        self._set(dosing=replace(self.dosing, target_mg=None, in_vain=in_vain))

    def dosed(self, gained: Net, drift: Drift, now: Gross, pulses: int, vibration_s: float) -> None:
        """A dose of so many pulses, and so much vibration, was weighed."""
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
        """The container has gained since its last dose, which puts its doses in doubt."""
        self._set(bracket=self._open_bracket.dripped(mass(mass_mg)))

    def reweighed(self, gained: Net, now: Gross) -> None:
        """The container was weighed after a dose broke off.

        What it has gained is of that dose's lot, and has left the cone if that still has this lot in it. Raises
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
        """The container was weighed, and so much of the difference comes from the balance's zero."""
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
        """Keep a gross, unless containers are being changed: then nobody knows what it is of."""
        if self.weighed_container is not None:
            self._set(pan_gross_mg=gross_mg)


def slot_of(believed: Believed, container: Container, first_slot: int | None = None) -> int:
    """The changer's slot, from 0, of a container; the next free one if it was not brought yet.

    Where kinds have slots of their own, it is the next of these, from `first_slot` on.
    """
    if (slot := believed.slots.get(container.id)) is not None:
        return slot
    return believed.slots_used if first_slot is None else first_slot + believed.slots_of_kinds.get(container.name, 0)


def slots_used(believed: Believed, changer: ChangerSpec) -> Mapping[str, int]:
    """Containers given since the changer was filled, by kind; as "" where kinds have no slots of their own."""
    return believed.slots_of_kinds if changer.kinds else {"": believed.slots_used}
