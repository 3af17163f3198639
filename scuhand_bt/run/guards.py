"""Guards."""

from scuhand_bt.clock import Wake
from scuhand_bt.devices.cell import Cell
from scuhand_bt.failures import SkillFailed


class Guards:
    def __init__(self, cell: Cell) -> None:
        pass

    def wakes(self) -> list[Wake]:
        return []

    def look(self) -> SkillFailed | None:
        return None
