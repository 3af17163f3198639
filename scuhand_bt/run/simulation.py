"""How a run is simulated, if it is: dry, or as a rehearsal."""

from dataclasses import dataclass
from typing import ClassVar

from scuhand_bt.sim.fault_rules import FaultFile


@dataclass(frozen=True)
class DryRun:
    """Simulated devices on a virtual clock: the seed, the physics, how fast time may pass (None: at once).

    `faults` is what goes wrong.
    """

    mode: ClassVar = "SIMULATED"
    seed: int = 0
    plant: str | None = None
    speed: float | None = None
    faults: FaultFile | None = None
    asks: bool = False
    """A person is asked, as at the real cell, and time goes on as it does for that person; else one is simulated."""


@dataclass(frozen=True)
class Rehearsal:
    """The real drivers in real time, against twins of the devices: the seed, and the physics behind them.

    `faults` is what goes wrong.
    """

    mode: ClassVar = "REHEARSAL (simulated matter, real drivers)"
    seed: int = 0
    plant: str | None = None
    faults: FaultFile | None = None
    asks: bool = False
    """A person is asked though no terminal is there."""


Simulation = DryRun | Rehearsal
