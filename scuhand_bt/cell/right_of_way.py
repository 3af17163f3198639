"""What moves in a cell beside something else: who has which zone of it, and who needs all of it to stand still.

A *zone* (`robot/cell.yaml`) is a space that two must not move in at once, as what the container changer sweeps. A skill
leases it as it leases a device. While another skill has it than the one that has the arm, it is *closed*: the arm's
motions are planned around it. A motion that was planned while a zone was open may cross it, and until that motion is
over, and the arm out of the zone, nobody else gets the zone.

A weighing needs stillness: an arm or a changer that swings beside a balance, and a motor that shakes the bench, are in
what it shows. So does a person who reaches into the cell. Motions that are under way come to their end then, and no
other begins. While the pan only comes to rest from what came or went they go on: none of that is weighed.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

from scuhand_bt.clock import Signal, Steps, Wake
from scuhand_bt.devices.interfaces import StableMean
from scuhand_bt.failures import Code, SkillFailed

if TYPE_CHECKING:
    from scuhand_bt.cell.cell import Cell

ZONE_TIMEOUT_S = 120.0
"""How long a zone that is taken is waited for: containers are changed and weighed in a fifth of that."""
STILL_TIMEOUT_S = 120.0
"""How long a weighing waits for arm, hand and changer to stand still: no motion of theirs takes a tenth of that."""
SETTLES_S = 8.0
"""So long a pan may come to rest while the arm goes on: a balance that the arm keeps from it is not waited for."""
REACHES_IN = "An exchange by hand was broken off, and the arm is about to move. Is nobody reaching into the cell?"
MOVING = ("arm", "hand", "changer")
"""What a weighing needs to stand still."""
LOOK_S = 0.1
"""So often it is looked whether what moves has come to rest."""

T = TypeVar("T")


@dataclass(frozen=True)
class _Leaving:
    """Has a zone until these devices, which have been given back, stand still."""

    devices: Sequence[str]


class RightOfWay:
    """Who has what of one cell."""

    def __init__(self, cell: "Cell") -> None:
        self.news = Signal()
        """Fires when a zone, or all motion, is free again."""
        self.commands: dict[str, object] = {}
        """Who has leased which device."""
        self._has_zone: dict[str, object] = {}
        self._cell = cell
        self._crossed: frozenset[str] = frozenset()
        self._hushes = self._watches = self._ahead = 0
        self._is_as_if_open = False
        self._may_reach_in = False
        """Nobody has said that the person has left who was asked to do something in the cell."""

    # --- zones

    @property
    def closed(self) -> frozenset[str]:
        """The zones that the arm must keep out of: another has them than who has the arm."""
        if self._is_as_if_open:
            return frozenset()
        arm = self.commands.get("arm")
        return frozenset(zone for zone in self._cell.spec.zone_names if self.holder(zone) not in (None, arm))

    def holder(self, zone: str) -> object | None:
        """Who has a zone; what has left it still has it until its devices stand still."""
        holder = self._has_zone.get(zone)
        if isinstance(holder, _Leaving) and all(self._cell.device(name).is_stopped for name in holder.devices):
            del self._has_zone[zone]
            return None
        return holder

    def enter(self, zones: Iterable[str], owner: object) -> None:
        """The owner has leased these zones."""
        self._has_zone.update(dict.fromkeys(zones, owner))

    def leave(self, owner: object, devices: Sequence[str]) -> None:
        """The owner has ended, which had leased these devices."""
        for zone in [zone for zone, holder in self._has_zone.items() if holder is owner]:
            self._has_zone[zone] = _Leaving(devices)
        self.news.fire()

    def is_crossed(self, name: str, owner: object) -> bool:
        """Whether the arm is in this zone, or on a way through it, for another than the owner."""
        arm = self.commands.get("arm")
        is_busy = arm not in (None, owner) or not self._cell.arm.is_stopped
        return name in self._crossed and is_busy

    def is_stood_in(self, name: str) -> bool:
        """Whether the arm stands in this zone, and nobody is there to move it."""
        return "arm" not in self.commands and self._cell.arm.is_stopped and name in self._cell.zones_entered()

    def crossing(self) -> frozenset[str]:
        """A motion of the arm is planned from now on: it may go through all zones that are open; gives the others."""
        closed = self.closed
        self._crossed = frozenset(self._cell.spec.zone_names) - closed
        return closed

    def crossed(self) -> None:
        """The arm has come to rest: it is only where it stands, but for what is planned ahead."""
        if not self._ahead:
            self._crossed = self._cell.zones_entered()
            self.news.fire()

    @contextmanager
    def ahead(self) -> Iterator[None]:
        """Meanwhile a motion that was planned before others may go through the zones that were open then."""
        self._ahead += 1
        try:
            yield
        finally:
            self._ahead -= 1
        self.crossed()  # an arm that is halted on its way still moves

    @contextmanager
    def as_if_open(self) -> Iterator[None]:
        """Meanwhile all is planned as if nobody had a zone; nothing may move by it."""
        crossed, self._is_as_if_open = self._crossed, True
        try:
            yield
        finally:
            self._crossed, self._is_as_if_open = crossed, False

    # --- stillness

    @contextmanager
    def _hushed(self) -> Iterator[None]:
        """Meanwhile no motion begins."""
        self._hushes += 1
        try:
            yield
        finally:
            self._hushes -= 1
            self.news.fire()

    def unshaken(self, steps: Steps[T]) -> Steps[T]:
        """Carry out steps while the motor does not begin to shake: how the pan comes to rest tells steps of its zero.

        The arm may move.
        """
        self._watches += 1
        try:
            result = yield from steps
        finally:
            self._watches -= 1
            self.news.fire()
        return result

    def go(self, *, shaking: bool = False) -> Steps[None]:
        """Wait until a motion may begin, or one with which the motor shakes.

        SkillFailed operator.refused, operator.absent where a person may still be reaching into the cell.
        """
        while self._hushes or (shaking and self._watches):
            yield Wake.on(self.news)
        if not self._may_reach_in:
            return
        with self._hushed():
            answer = yield from self._cell.operator.ask(REACHES_IN)
        if answer != "done":
            raise SkillFailed(Code.OPERATOR_REFUSED, REACHES_IN)
        self._may_reach_in = False

    def undisturbed(self, steps: Steps[T]) -> Steps[T]:
        """Carry out what a person does in the cell while arm and hand stand still.

        Where it is halted the person may be at it still: nothing moves then before somebody has said otherwise.
        """
        with self._hushed():
            yield from self._stillness(MOVING)
            try:
                result = yield from steps
            except GeneratorExit:
                self._may_reach_in = True
                raise
        self._may_reach_in = False
        return result

    def stable_mean(self, timeout_s: float = 0.0) -> Steps[StableMean]:
        """The balance's stable mean while all else stands still; what is disturbed all the same begins again.

        They need not until the balance calls a reading stable. SkillFailed balance.unstable where they do not come to
        rest; and as the balance's own, after `timeout_s` at least.
        """
        timeout_s = max(timeout_s, self._cell.spec.balance.settles_s)
        yield from self._settled()
        with self._hushed():
            mean = yield from self._anew(lambda: self._cell.balance.stable_mean(timeout_s), MOVING)
        self._cell.weighed = mean
        return mean

    def beside_arm(self, begun: Callable[[], Steps[T]]) -> Steps[T]:
        """Carry out what reads the balance while hand and changer stand still; what is disturbed by them begins again.

        The arm may move. SkillFailed balance.unstable where they do not come to rest.
        """
        return (yield from self.unshaken(self._anew(begun, [name for name in MOVING if name != "arm"])))

    def _anew(self, begun: Callable[[], Steps[T]], still: Sequence[str]) -> Steps[T]:
        """Carry out steps while these devices stand still; begin them again where one moves all the same."""
        while True:
            yield from self._stillness(still)
            steps = begun()
            try:
                while not self._moving(still):
                    try:
                        wake = next(steps)
                    except StopIteration as over:
                        result: T = over.value
                        return result
                    yield wake
            finally:
                steps.close()

    def _settled(self) -> Steps[None]:
        """Wait until the pan has come to rest, where somebody has the arm: it goes on meanwhile."""
        clock, balance = self._cell.clock, self._cell.balance
        deadline_s = clock.now_s + SETTLES_S
        while "arm" in self.commands and clock.now_s < deadline_s:
            if (latest := balance.latest) is not None and latest.stable:
                return
            yield from balance.next_reading()

    def _moving(self, devices: Sequence[str]) -> list[str]:
        return [name for name in devices if not self._cell.device(name).is_stopped]

    def _stillness(self, devices: Sequence[str]) -> Steps[None]:
        """Wait until none of them moves any more."""
        clock = self._cell.clock
        deadline_s = clock.now_s + STILL_TIMEOUT_S
        while moving := self._moving(devices):
            if clock.now_s >= deadline_s:
                what = f"the {' and the '.join(moving)} moved on for {STILL_TIMEOUT_S:g} s beside the weighing"
                raise SkillFailed(Code.BALANCE_UNSTABLE, what)
            yield Wake.on(self._cell.device(moving[0]).news, clock.now_s + LOOK_S)


def taken(zones: Iterable[str], timeout_s: float) -> SkillFailed:
    """The failure of what has waited for a zone in vain."""
    return SkillFailed(Code.ARM_ZONE_TAKEN, f"{', '.join(sorted(zones))} not free after {timeout_s:g} s")
