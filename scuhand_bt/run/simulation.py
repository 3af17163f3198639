"""How a run is simulated, if it is: as a dry run or as a rehearsal."""

from dataclasses import dataclass
from typing import ClassVar

from scuhand_bt.sim.fault_rules import FaultFile


@dataclass(frozen=True)
class DryRun:
    """Simulated devices on a virtual clock. `speed` limits virtual over wall time (None: no limit).

    `plant` is the physics, `faults` is what goes wrong.
    """

    mode: ClassVar = "SIMULATED"
    seed: int = 0
    plant: str | None = None
    speed: float | None = None
    faults: FaultFile | None = None
    asks: bool = False
    """A real person is asked, and time passes as on the wall while they answer; else a person is simulated."""


@dataclass(frozen=True)
class Rehearsal:
    """The real drivers in real time, against twins of the devices.

    `plant` is the physics behind them, `faults` is what goes wrong.
    """

    mode: ClassVar = "REHEARSAL (simulated matter, real drivers)"
    seed: int = 0
    plant: str | None = None
    faults: FaultFile | None = None
    asks: bool = False
    """A person is asked even without a terminal."""


Simulation = DryRun | Rehearsal
