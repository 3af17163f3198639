"""Who may move in a cell: who has which zone of it, and who needs all of it to stand still.

A *zone* (`robot/cell.yaml`) is a space that two must not move in at once, such as what the container changer sweeps. A
skill leases it like a device. While another skill than the arm's has it, it is *closed*: motions of the arm are planned
around it. A motion planned while a zone was open may cross it. Until that motion is over, and the arm out of the zone,
nobody else gets the zone.

A weighing needs stillness, as the balance shows a swinging arm or changer, a shaking motor, or a person reaching in.
Motions under way come to their end, and no other begins. While the pan is only coming to rest they go on, as none of
that is weighed.
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
"""How long a taken zone is waited for; a change of containers with its weighings takes a fifth of that."""
STILL_TIMEOUT_S = 120.0
"""How long a weighing waits for stillness; no motion takes a tenth of that."""
SETTLES_S = 8.0
"""How long a pan may come to rest while the arm goes on; a balance that the arm disturbs is not waited for."""
REACHES_IN = "An exchange by hand was interrupted, and the arm is about to move. See that nobody reaches into the cell."
MOVING = ("arm", "hand", "changer")
"""What has to stand still for a weighing."""
LOOK_S = 0.1
"""Interval at which what moves is looked at."""

T = TypeVar("T")


@dataclass(frozen=True)
class _Leaving:
    """Has a zone until these devices, already given back, stand still."""

    devices: Sequence[str]


class RightOfWay:
    """Who has what in one cell."""

    def __init__(self, cell: "Cell") -> None:
        self.news = Signal()
        """Fires when a zone, or all motion, is free again."""
        self.commands: dict[str, object] = {}
        """By device, who has leased it."""
        self._has_zone: dict[str, object] = {}
        self._cell = cell
        self._crossed: frozenset[str] = frozenset()
        self._hushes = self._watches = self._ahead = 0
        self._is_as_if_open = False
        self._may_reach_in = False
        """Whether a person who was asked to do something in the cell may still be reaching in."""

    # --- zones

    @property
    def closed(self) -> frozenset[str]:
        """The zones that the arm must keep out of: someone other than the arm's owner has them."""
        if self._is_as_if_open:
            return frozenset()
        arm = self.commands.get("arm")
        return frozenset(zone for zone in self._cell.spec.zone_names if self.holder(zone) not in (None, arm))

    def holder(self, zone: str) -> object | None:
        """Who has a zone; an owner that has ended has it until its devices stand still."""
        holder = self._has_zone.get(zone)
        if isinstance(holder, _Leaving) and all(self._cell.device(name).is_stopped for name in holder.devices):
            del self._has_zone[zone]
            return None
        return holder

    def enter(self, zones: Iterable[str], owner: object) -> None:
        """An owner has leased these zones."""
        self._has_zone.update(dict.fromkeys(zones, owner))

    def leave(self, owner: object, devices: Sequence[str]) -> None:
        """An owner, which had leased these devices, has ended."""
        for zone in [zone for zone, holder in self._has_zone.items() if holder is owner]:
            self._has_zone[zone] = _Leaving(devices)
        self.news.fire()

    def is_crossed(self, name: str, owner: object) -> bool:
        """Whether the arm is in this zone, or on a way through it, for someone other than the owner."""
        arm = self.commands.get("arm")
        is_busy = arm not in (None, owner) or not self._cell.arm.is_stopped
        return name in self._crossed and is_busy

    def is_stood_in(self, name: str) -> bool:
        """Whether the arm stands in this zone, with nobody to move it."""
        return "arm" not in self.commands and self._cell.arm.is_stopped and name in self._cell.zones_entered()

    def crossing(self) -> frozenset[str]:
        """Note that a motion is planned from now on, which may cross all open zones; returns the closed ones."""
        closed = self.closed
        self._crossed = frozenset(self._cell.spec.zone_names) - closed
        return closed

    def crossed(self) -> None:
        """Note that the arm has come to rest: it is only where it stands, except for what is planned ahead."""
        if not self._ahead:
            self._crossed = self._cell.zones_entered()
            self.news.fire()

    @contextmanager
    def ahead(self) -> Iterator[None]:
        """Within this, motions planned before others may cross the zones that were open then."""
        self._ahead += 1
        try:
            yield
        finally:
            self._ahead -= 1
        self.crossed()  # an arm that is halted on its way still moves

    @contextmanager
    def as_if_open(self) -> Iterator[None]:
        """Within this, plans are made as if nobody had a zone; nothing may move by them."""
        crossed, self._is_as_if_open = self._crossed, True
        try:
            yield
        finally:
            self._crossed, self._is_as_if_open = crossed, False

    # --- stillness

    @contextmanager
    def _hushed(self) -> Iterator[None]:
        """Within this, no motion begins."""
        self._hushes += 1
        try:
            yield
        finally:
            self._hushes -= 1
            self.news.fire()

    def unshaken(self, steps: Steps[T]) -> Steps[T]:
        """Carry out steps while no shaking begins, as the way the pan comes to rest shows steps of its zero.

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
        """Wait until a motion may begin; with `shaking`, one with which the motor shakes.

        Raises SkillFailed operator.refused, operator.absent where a person may still be reaching in.
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
        """Carry out what a person does in the cell, with arm and hand at rest.

        If it is halted, the person may still be at it: nothing moves before somebody has said otherwise.
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
        """The balance's stable mean with all else at rest; begins again if it is disturbed.

        Motions may go on until the balance calls a reading stable. Raises SkillFailed balance.unstable if they do not
        come to rest, and as the balance does, after `timeout_s` at least.
        """
        timeout_s = max(timeout_s, self._cell.spec.balance.settles_s)
        yield from self._settled()
        with self._hushed():
            mean = yield from self._anew(lambda: self._cell.balance.stable_mean(timeout_s), MOVING)
        self._cell.weighed = mean
        return mean

    def beside_arm(self, begun: Callable[[], Steps[T]]) -> Steps[T]:
        """Carry out what reads the balance with hand and changer at rest; begins again if they disturb it.

        The arm may move. Raises SkillFailed balance.unstable if they do not come to rest.
        """
        return (yield from self.unshaken(self._anew(begun, [name for name in MOVING if name != "arm"])))

    def _anew(self, begun: Callable[[], Steps[T]], still: Sequence[str]) -> Steps[T]:
        """Carry out steps while these devices stand still; begin again if one moves all the same."""
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
        """Wait until the pan has come to rest, if somebody has the arm, which goes on meanwhile."""
        clock, balance = self._cell.clock, self._cell.balance
        deadline_s = clock.now_s + SETTLES_S
        while "arm" in self.commands and clock.now_s < deadline_s:
            if (latest := balance.latest) is not None and latest.stable:
                return
            yield from balance.next_reading()

    def _moving(self, devices: Sequence[str]) -> list[str]:
        return [name for name in devices if not self._cell.device(name).is_stopped]

    def _stillness(self, devices: Sequence[str]) -> Steps[None]:
        """Wait until none of these devices moves."""
        clock = self._cell.clock
        deadline_s = clock.now_s + STILL_TIMEOUT_S
        while moving := self._moving(devices):
            if clock.now_s >= deadline_s:
                what = f"the {' and the '.join(moving)} did not come to rest in {STILL_TIMEOUT_S:g} s for a weighing"
                raise SkillFailed(Code.BALANCE_UNSTABLE, what)
            yield Wake.on(self._cell.device(moving[0]).news, clock.now_s + LOOK_S)


def taken(zones: Iterable[str], timeout_s: float) -> SkillFailed:
    """The failure after waiting for zones in vain."""
    return SkillFailed(Code.ARM_ZONE_TAKEN, f"{', '.join(sorted(zones))} not free after {timeout_s:g} s")
