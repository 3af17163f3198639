"""`record: {name: $value, …}` writes values of a workflow into its sample's row, with their units."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pydantic import ConfigDict

from scuhand_bt.cell.cell import Cell
from scuhand_bt.clock import Steps
from scuhand_bt.events.doses import ValueRecorded
from scuhand_bt.skill import Skill
from scuhand_bt.tree.wires import QUANTITIES, WireType


@dataclass
class Round:
    """The number of a loop's current round, from 1."""

    number: int = 0


class Record(Skill[None]):
    """Write values into the sample's row, each under a name: quantities, numbers, texts and flags."""

    model_config = ConfigDict(extra="allow")
    interrupted = "repeat"
    typical_s = 0.0

    def run(self, cell: Cell) -> Steps[None]:
        for value in (self.model_extra or {}).values():
            cell.record.event(value)
        return
        yield


def recorded(
    values: Mapping[str, Any], wires: Mapping[str, WireType], rounds: Sequence[Round]
) -> dict[str, ValueRecorded]:
    """The values with their units. Within loops the numbers of the rounds are appended to the name: `net[2]`."""
    behind = "".join(f"[{one.number}]" for one in rounds)
    return {
        name + behind: ValueRecorded(
            name=name + behind,
            value=values[name],
            unit=QUANTITIES[wire.name].symbol if wire.name in QUANTITIES else "",
        )
        for name, wire in wires.items()
    }
