"""The cell: the devices at one bench, what they are believed to hold, and the motions between stations.

Skills act only through this object.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from scuhand_bt.clock import Clock
from scuhand_bt.devices.interfaces import Arm, Balance, Changer, Device, Hand, Operator
from scuhand_bt.dosing import DEFAULT_CONTROLLER
from scuhand_bt.record import Record
from scuhand_bt.specs import BalanceBelief, CellSpec, PowderBelief, Source

if TYPE_CHECKING:
    from scuhand_bt.motion import MotionPlanner


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
    controller: str = DEFAULT_CONTROLLER
    """The dosing controller of this run."""
    powder_beliefs: dict[str, PowderBelief] = field(default_factory=dict)
    """What is learnt of powders, by `Source.sheet_key`; the powder's own `belief` until then."""
    balance_belief: BalanceBelief = field(default_factory=BalanceBelief)
    """What is learnt of the balance."""

    def device(self, name: str) -> Device:
        """A device by the name that skills lease it under: arm, hand, balance, changer."""
        devices: dict[str, Device] = {
            "arm": self.arm,
            "hand": self.hand,
            "balance": self.balance,
            "changer": self.changer,
        }
        return devices[name]
