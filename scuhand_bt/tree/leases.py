"""Leases: one skill at a time commands a device, and the next one waits until it stands still."""

from collections.abc import Iterable

from scuhand_bt.cell.cell import Cell
from scuhand_bt.clock import Wake


class Leases:
    """Who commands which device of a cell.

    A lease ends in two steps: the skill ends or is halted (`give_back`), and the device reports that it
    has stopped. Only then may another skill have it.
    """

    def __init__(self, cell: Cell) -> None:
        self._cell = cell
        self._held: dict[str, object] = {}
        self._stopping: set[str] = set()

    def take(self, names: Iterable[str], owner: object) -> bool:
        """Lease all of `names`, or none of them: False if one is held or has not stopped yet."""
        names = tuple(names)
        self._stopping = {name for name in self._stopping if not self._cell.device(name).is_stopped}
        if any(name in self._held or name in self._stopping for name in names):
            return False
        self._held.update(dict.fromkeys(names, owner))
        return True

    def give_back(self, owner: object, keep: Iterable[str] = ()) -> None:
        """The owner has ended, or needs only `keep`: its devices are free once they have stopped."""
        for name in [name for name, holder in self._held.items() if holder is owner and name not in keep]:
            del self._held[name]
            self._stopping.add(name)

    def wakes(self, names: Iterable[str], until_s: float) -> list[Wake]:
        """Wakes for the news of these devices."""
        return [Wake.on(self._cell.device(name).news, until_s) for name in names]
