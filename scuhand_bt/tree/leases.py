"""Leases: only one skill at a time commands a device or moves in a zone; the next one waits until it is free."""

from collections.abc import Iterable, Sequence

from scuhand_bt.cell.cell import Cell
from scuhand_bt.cell.right_of_way import ZONE_TIMEOUT_S, taken
from scuhand_bt.clock import Wake
from scuhand_bt.failures import Code, SkillFailed

LEASE_TIMEOUT_S = 10.0
"""How long to wait for a device that is not free [s]."""


class Leases:
    """Which action holds which devices and zones of a cell.

    A lease ends in two steps. First the skill ends or is halted (`give_back`). Then the device reports that it has
    stopped, or the arm has left the zone. Only then can another skill have it.
    """

    def __init__(self, cell: Cell) -> None:
        self._cell = cell
        self._way = cell.right_of_way
        self._stopping: set[str] = set()

    def take(self, devices: Iterable[str], owner: object, zones: Iterable[str] = ()) -> bool:
        """Lease all of these; False, and none leased, if any of them is not free."""
        devices, zones = tuple(devices), tuple(zones)
        if self.missing(devices, owner, zones):
            return False
        self._way.commands.update(dict.fromkeys(devices, owner))
        self._way.enter(zones, owner)
        return True

    def missing(self, devices: Iterable[str], owner: object, zones: Iterable[str] = ()) -> list[str]:
        """Those that are not free."""
        self._stopping = {name for name in self._stopping if not self._cell.device(name).is_stopped}
        way = self._way
        missing = [name for name in devices if name in way.commands or name in self._stopping]
        missing += [zone for zone in zones if way.holder(zone) is not None or way.is_crossed(zone, owner)]
        return missing + self.stood_in(devices, zones)

    def stood_in(self, devices: Iterable[str], zones: Iterable[str]) -> list[str]:
        """The zones that are not free because the arm stands in them.

        None if the caller has the arm, or has the hand but not the changer.
        """
        used = {*devices}
        if "arm" in used or ("hand" in used and "changer" not in used):
            return []
        return [zone for zone in zones if self._way.is_stood_in(zone)]

    def give_back(self, owner: object) -> None:
        """The owner has ended. Its devices become free once they stand still; then its zones, if the arm is out."""
        way = self._way
        gone = [name for name, holder in way.commands.items() if holder is owner]
        for name in gone:
            del way.commands[name]
        self._stopping.update(gone)
        way.leave(owner, gone)

    def waited_for(self, devices: Sequence[str], owner: object, zones: Sequence[str]) -> tuple[float, SkillFailed]:
        """How long to wait for devices and zones that are taken [s], and the failure after that."""
        missing, stood_in = self.missing(devices, owner, zones), self.stood_in(devices, zones)
        if stood_in and set(missing) <= set(stood_in):
            what = f"for {ZONE_TIMEOUT_S:g} s nothing has moved the arm out of the zone {', '.join(stood_in)}"
            return ZONE_TIMEOUT_S, SkillFailed(Code.ARM_IN_THE_WAY, what)
        if set(missing) <= set(zones):
            return ZONE_TIMEOUT_S, taken(missing, ZONE_TIMEOUT_S)
        what = f"{', '.join(devices)} not free after {LEASE_TIMEOUT_S:g} s"
        return LEASE_TIMEOUT_S, SkillFailed(Code.DEVICE_BUSY, what)

    def wakes(self, names: Iterable[str], until_s: float) -> list[Wake]:
        """Wakes for news of these devices, and for leases that others give back."""
        devices = [Wake.on(self._cell.device(name).news, until_s) for name in names]
        return [*devices, Wake.on(self._way.news, until_s)]
