"""Take a container off the balance whose contents do not count."""

from collections.abc import Mapping
from typing import Any

from scuhand_bt.cell.pan_cleared import take_container_away
from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.skill import Cell, ContainerDiscarded, Forecast, Skill, Steps


class DiscardContainer(Skill[None]):
    """Take the container off the pan to throw its contents away; its doses do not count for the sample."""

    devices = ("changer", "balance")
    zones = ("pan",)
    typical_s = 19.0
    interrupted = "repeat"

    @classmethod
    def forecast(cls, inputs: Mapping[str, Any], cell: CellSpec) -> Forecast:
        task = "take the container off the pan, and throw away what is in it"
        return Forecast.of_change(cell, cls.typical_s, task)

    def run(self, cell: Cell) -> Steps[None]:
        believed = cell.believed
        of_bracket = believed.bracket.container if believed.bracket is not None else None
        container = believed.pan.id if believed.pan is not None else of_bracket
        if container is not None:  # None where it went before an interruption
            cell.record.event(ContainerDiscarded(container=container))
            believed.discarded()
        yield from take_container_away(cell)
