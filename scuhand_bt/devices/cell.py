"""The cell: the devices at one bench, what they are believed to hold, and the motions between stations.

Skills act only through this object.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from scuhand_bt.clock import Clock
from scuhand_bt.devices.interfaces import Arm, Balance, Changer, Device, Hand, Operator
from scuhand_bt.record import Record
from scuhand_bt.specs import CellSpec, ContainerKind, Source

if TYPE_CHECKING:
    from scuhand_bt.motion import MotionPlanner

DISPENSING_HEIGHT_MM = 80.0
"""Apex above the pan while dispensing (paper, section V-A)."""
MOUTH_CLEARANCE_MM = 15.0
"""Apex above a container's mouth, where that is higher."""


@dataclass
class Believed:
    """What the cell is believed to hold, from what was measured and commanded; never the true mass."""

    cone_mg: float = 0.0
    cone_source: str | None = None
    """The source that the powder in the cone came from."""
    sheet: str | None = None
    """The powder lot (`Source.sheet_key`) that this sheet has touched; None for a fresh one."""
    sheets_used: int = 1
    pan: str | None = None
    """The id of the container on the pan."""
    pan_empty_mg: float | None = None
    """Stable gross with that container, before its first powder: the software tare."""
    sources_mg: dict[str, float] = field(default_factory=dict)


@dataclass
class Cell:
    """One bench: real, or simulated."""

    spec: CellSpec
    clock: Clock
    record: Record
    arm: Arm
    hand: Hand
    balance: Balance
    changer: Changer
    operator: Operator
    motion: "MotionPlanner"
    sources: Mapping[str, Source]
    simulated: bool
    believed: Believed = field(default_factory=Believed)
    begin_sample: Callable[[str, int], None] = lambda sample, attempt: None
    """Told at the start of each job (sample id, attempt); the simulation draws its randomness by it."""

    def device(self, name: str) -> Device:
        """A device by the name that skills lease it under: arm, hand, balance, changer."""
        devices: dict[str, Device] = {
            "arm": self.arm,
            "hand": self.hand,
            "balance": self.balance,
            "changer": self.changer,
        }
        return devices[name]

    def dispensing_height_mm(self, container: ContainerKind) -> float:
        """Apex above the pan for this container: 80 mm, or its mouth plus a clearance if that is higher."""
        return max(DISPENSING_HEIGHT_MM, container.height_mm + MOUTH_CLEARANCE_MM)
