"""What a cell's devices can do, whoever makes them: the Protocols that drivers and simulation meet.

Commands start and return at once; generators (`Steps`) wait. `stop()` and `close()` may be called at
any time, from a halt, and never wait. A device `is_stopped` when nothing of it moves any more: only
then is its lease freed.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from scuhand_bt.cell_spec import BalanceSpec, HandSpec
from scuhand_bt.clock import Signal, Steps
from scuhand_bt.failures import SkillFailed
from scuhand_bt.specs import Container

Joints = NDArray[np.float64]


class Trajectory(Protocol):
    """A motion of the arm over time, all seven joints."""

    @property
    def duration_s(self) -> float: ...

    def sample(self, time_s: float) -> Joints:
        """Joint positions [rad], shape (7,), at a time since its start (clamped to its ends)."""
        ...


class Device(Protocol):
    """What all devices have in common."""

    @property
    def is_stopped(self) -> bool:
        """True when nothing of the device moves and nothing it was told is still to be done."""
        ...

    @property
    def news(self) -> Signal:
        """Fires whenever the device reports something."""
        ...

    @property
    def fault(self) -> SkillFailed | None:
        """What is wrong with the device now, so that no run may go on with it; None if it is sound."""
        ...

    def stop(self) -> None:
        """Bring the device to its safe state; does not wait."""
        ...


class Arm(Device, Protocol):
    """The seven joints."""

    @property
    def positions(self) -> Joints:
        """Where the joints are now [rad], shape (7,)."""
        ...

    def start(self, trajectory: Trajectory) -> None:
        """Begin a trajectory that starts where the arm is."""
        ...

    def follow(self, trajectory: Trajectory) -> Steps[None]:
        """Start the trajectory and wait for its end; SkillFailed arm.not_following if it was not kept."""
        ...


class Hand(Device, Protocol):
    """The conical sheet, its roller, the valve at the apex and the vibration motor."""

    @property
    def spec(self) -> HandSpec: ...

    @property
    def cone_diameter_mm(self) -> float: ...

    @property
    def opening_mm(self) -> float:
        """The valve's opening as its servo reports it."""
        ...

    def start_morph(self, cone_diameter_mm: float, duration_s: float | None = None) -> None:
        """Begin to change the cone's rim diameter, at the hand's speed or over `duration_s`."""
        ...

    def morph(self, cone_diameter_mm: float, duration_s: float | None = None) -> Steps[None]:
        """Change the cone's rim diameter and wait for it."""
        ...

    def pulse(self, opening_mm: float, dwell_s: float, vibration: float = 0.0) -> Steps[None]:
        """The paper's step command: open, hold for `dwell_s`, close; waits until the valve is shut."""
        ...

    def set_opening(self, opening_mm: float) -> None:
        """Streaming: go to this opening now; 0 closes. Only where `spec.streaming`."""
        ...

    def set_vibration(self, level: float) -> None:
        """Vibration motor, 0 (off) to 1."""
        ...


@dataclass(frozen=True, slots=True)
class Reading:
    """One line of the balance: gross value, its unit as sent, stability, run time, raw bytes.

    A simulated balance forms its `raw` bytes only where `Balance.on_reading` listens.
    """

    value_mg: float
    stable: bool
    time_s: float
    unit: str = "mg"
    raw: bytes = b""

    def values(self) -> dict[str, Any]:
        """As it is written down: the line as it came, and what was understood of it."""
        line = self.raw.decode("latin-1")
        return {
            "raw": line,
            "value_mg": self.value_mg,
            "unit": self.unit,
            "stable": self.stable,
            "time_s": round(self.time_s, 4),
        }


@dataclass(frozen=True, slots=True)
class StableMean:
    """The mean of stable readings, with the standard uncertainty of that mean."""

    value_mg: float
    uncertainty_mg: float
    time_s: float
    readings: Sequence[Reading] = ()

    def values(self) -> dict[str, Any]:
        """As it is written down: the mean, and every reading that it is the mean of."""
        readings = [reading.values() for reading in self.readings]
        return {"gross_mg": self.value_mg, "uncertainty_mg": self.uncertainty_mg, "readings": readings}


class Balance(Device, Protocol):
    """The balance. It is never tared by command: gross values only (a tare would die with the power)."""

    on_reading: Callable[[Reading], None] | None
    """Told every line that is a weight, also one that is not believed (and then not stable), on the thread where it
    arrives; must be quick."""

    @property
    def spec(self) -> BalanceSpec: ...

    @property
    def identity(self) -> str:
        """What the balance answered when asked who it is; "" where it did not."""
        ...

    @property
    def latest(self) -> Reading | None: ...

    def next_reading(self, timeout_s: float = 5.0) -> Steps[Reading]:
        """Wait for the next reading; SkillFailed device.lost if none comes."""
        ...

    def stable_mean(self, timeout_s: float = 30.0) -> Steps[StableMean]:
        """Wait until the balance calls its readings stable, then average a few of them.

        SkillFailed balance.unstable if they are not stable in time, balance.overload, device.lost.
        """
        ...


class Changer(Device, Protocol):
    """Puts containers on the pan and takes them away: a carousel; or the operator does."""

    @property
    def needs_person(self) -> bool: ...

    def bring(self, container: Container) -> Steps[None]:
        """Put this container on the (empty) pan; SkillFailed container.missing, operator.refused."""
        ...

    def take_away(self) -> Steps[None]:
        """Clear the pan; nothing happens if it is empty."""
        ...


class Operator(Protocol):
    """The person at the cell, if there is one."""

    def ask(self, question: str, choices: Sequence[str] = ("done", "stop")) -> Steps[str]:
        """Ask and wait for one of `choices`; SkillFailed operator.absent when nobody is there."""
        ...
