"""Take the container off the balance."""

from collections.abc import Mapping
from typing import Any

from scuhand_bt.cell.pan_cleared import take_container_away
from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.skill import Cell, Forecast, Skill, Steps


class RemoveContainer(Skill[None]):
    """Take the container off the pan and weigh the bare pan, which closes the bracket about what was dosed into it."""

    devices = ("changer", "balance")
    zones = ("pan",)
    typical_s = 9.0
    interrupted = "repeat"

    @classmethod
    def forecast(cls, inputs: Mapping[str, Any], cell: CellSpec) -> Forecast:
        return Forecast.of_change(cell, cls.typical_s, "take the container off the pan")

    def run(self, cell: Cell) -> Steps[None]:
        yield from take_container_away(cell)
