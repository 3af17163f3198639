"""The cell as a skill sees it: with the devices that it leased, and no others.

Every skill has what is known and believed (`cell.believed`, `cell.spec`, the clock, the record). A device, and what
moves it, is there only for the skill that leased it.
"""

from collections.abc import Collection
from typing import Any, cast

from scuhand_bt.cell.cell import Cell
from scuhand_bt.cell_spec import DEVICES

_MOVES = ("move_to", "lower_to", "touch", "contact")


class NotLeased(RuntimeError):  # noqa: N818 - it reads as the sentence it is raised in
    """A skill used a device that it did not lease: a bug of the skill."""


def of_arm(name: str) -> bool:
    """Whether a method of the cell moves the arm."""
    return name in _MOVES


class _LeasedCell:
    """A cell that refuses what is not leased, and otherwise is the cell."""

    __slots__ = ("_cell", "_leased")

    def __init__(self, cell: Cell, leased: Collection[str]) -> None:
        object.__setattr__(self, "_cell", cell)
        object.__setattr__(self, "_leased", frozenset(leased))

    def __getattr__(self, name: str) -> Any:
        device = name if name in DEVICES else "arm" if name in _MOVES else None
        if name in ("devices", "every_device"):
            raise NotLeased("it takes a device past its lease: `cell.device(name)`")
        if device is not None and device not in self._leased:
            raise NotLeased(f"it uses the {device}, which its 'devices' do not lease")
        return getattr(self._cell, name)

    def device(self, name: str) -> Any:
        """A leased device by its name."""
        if name not in self._leased:
            raise NotLeased(f"it uses the {name}, which its 'devices' do not lease")
        return self._cell.device(name)

    def __setattr__(self, name: str, value: Any) -> None:
        if name in DEVICES:
            raise NotLeased(f"it puts another {name} into the cell")
        setattr(self._cell, name, value)


def leased(cell: Cell, devices: Collection[str]) -> Cell:
    """The cell, restricted to these devices."""
    return cast(Cell, _LeasedCell(cell, devices))
