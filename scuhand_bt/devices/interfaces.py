"""What a cell's devices can do, whoever makes them: the Protocols that drivers and simulation meet.

Those of the devices beside the dose are in `instruments.py`.

Commands start and return at once; generators (`Steps`) wait. A generator that is closed before its end
leaves the device as `stop()` would. `stop()` and `close()` may be called at any time, from a halt, and
never wait. A device `is_stopped` when nothing of it moves any more: only then is its lease freed.

What a call refuses, it refuses before anything moves, and every device of the kind in the same words
(`devices/arguments.py`): ValueError for what no skill should ask for, SkillFailed for what may come
about. tests/test_contract_*.py hold every implementation to what stands here.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from scuhand_bt.clock import Clock, Signal, Steps
from scuhand_bt.device_specs.balance import BalanceSpec
from scuhand_bt.device_specs.hand import HandSpec
from scuhand_bt.devices.liveness import Liveness
from scuhand_bt.events.weighings import Line, Weighing
from scuhand_bt.failures import SkillFailed
from scuhand_bt.motion.axes import SomeAxes
from scuhand_bt.specs import Container

Joints = NDArray[np.float64]


class Trajectory(Protocol):
    """A motion of the arm over time, all seven joints."""

    @property
    def duration_s(self) -> float: ...

    def sample(self, time_s: float) -> Joints:
        """Joint positions [rad], shape (7,), at a time since its start (clamped to its ends)."""
        ...

    def stopped_from(self, at_s: float) -> "Trajectory":
        """The same motion up to `at_s`, and from there its soonest stop along its path, within its limits.

        What stops already is not changed by another stop.
        """
        ...


TWIN = "TWIN"
"""How what a twin says of who it is begins; no real device's does."""


def is_twin(identity: str) -> bool:
    """Whether a device that says this of who it is, is none."""
    return identity.startswith(TWIN)


class Device(Protocol):
    """What all devices have in common."""

    @property
    def is_stopped(self) -> bool:
        """True when nothing of the device moves and nothing it was told is still to be done."""
        ...

    @property
    def news(self) -> Signal:
        """Fires whenever the device reports something; at the latest when it has stopped, or a fault comes or goes."""
        ...

    @property
    def fault(self) -> SkillFailed | None:
        """What is wrong with the device now, so that no run may go on with it; None if it is sound."""
        ...

    def stop(self) -> None:
        """Bring the device to its safe state; does not wait. Again, while it stops, changes nothing."""
        ...


class Arm(Device, Protocol):
    """The seven joints.

    `stop()` brings it to rest along its path as soon as the load's spill angle and the joints' limits allow
    (`motion/stopping.py`): in well under a second, and never later than the motion itself would end. It
    then holds. Only a fault ends a motion at once, where the arm is.
    """

    on_start: Callable[[Trajectory], None]
    """Told of every motion just before it begins; must be quick."""

    @property
    def positions(self) -> Joints:
        """Where the joints are now [rad], shape (7,)."""
        ...

    @property
    def was_limp(self) -> bool:
        """Whether it had no torque before this program gave it some: what was in the cone may have fallen out."""
        ...

    def start(self, trajectory: Trajectory) -> None:
        """Begin a trajectory that starts where the arm is.

        SkillFailed device.busy while it still moves or stops, arm.not_following for a trajectory that begins
        elsewhere, arm.joint_limit for one that leaves the joints' limits; and the fault, if there is one.
        """
        ...

    def follow(self, trajectory: Trajectory) -> Steps[None]:
        """Start the trajectory and wait until the arm is at rest again: at its end, or where a stop has ended it.

        SkillFailed as `start`, or with the fault that ended it early. Closed early, it stops the arm.
        """
        ...


@dataclass(frozen=True, slots=True)
class Forming:
    """How the cone's size is about to change: its rim's diameter [mm] at every time [s] from now on."""

    duration_s: float
    rim_mm: Callable[[float], float]
    with_arm: bool
    """Whether the arm is about to begin its part of the same motion."""


class Hand(Device, Protocol):
    """The conical sheet, its roller, the valve at the apex and the vibration motor.

    `stop()` shuts the valve and ends vibration, whatever was still to be done, and holds the sheet as it is.
    An opening beyond what the valve can have is the nearest that it can; what is no number is a ValueError.
    Opening and vibrating fail with the device's fault, shutting and stopping never do.
    """

    on_start: Callable[[Forming], None]
    """Told of every change of the cone's size just before it begins; must be quick."""

    @property
    def spec(self) -> HandSpec: ...

    @property
    def identity(self) -> str:
        """What its controller says of who it is."""
        ...

    @property
    def longest_dwell_s(self) -> float:
        """The longest that one pulse may hold the valve open."""
        ...

    @property
    def cone_diameter_mm(self) -> float: ...

    @property
    def knows_its_roller(self) -> bool:
        """Whether `cone_diameter_mm` is true. A roller that has lost its turns is not turned before `rim_is`."""
        ...

    @property
    def possible_rims_mm(self) -> Sequence[float]:
        """The rims that the cone may have, by the roller's angle within its turn; none where not even that tells."""
        ...

    def rim_is(self, diameter_mm: float) -> None:
        """A person has seen how wide the rim is, or has mounted a sheet so: `cone_diameter_mm` counts from there.

        ValueError for a rim beyond the roller's limits.
        """
        ...

    @property
    def opening_mm(self) -> float:
        """The valve's opening as its servo reports it."""
        ...

    def start_morph(self, cone_diameter_mm: float, duration_s: float | None = None) -> None:
        """Begin to change the cone's rim diameter, over `duration_s`, but no faster than the hand's speed.

        ValueError for a cone beyond the roller's limits (`HandSpec.rim_limits_mm`) or a duration that is none;
        SkillFailed device.lost, hand.roller_lost.
        """
        ...

    def start_rolling(self, course: SomeAxes) -> None:
        """Begin to turn the roller along a course, one angle [rad] counted from the flat sheet, beside the arm's.

        ValueError and SkillFailed as `start_morph`, and arm.not_following for a course that does not begin with the rim
        that there is. `stop` ends it as it ends the arm's part of the same motion.
        """
        ...

    def morph(self, cone_diameter_mm: float, duration_s: float | None = None) -> Steps[None]:
        """Change the cone's rim diameter and wait for it; closed early, the sheet stays as it is then."""
        ...

    def pulse(self, opening_mm: float, dwell_s: float, vibration: float = 0.0) -> Steps[None]:
        """The paper's step command: open, hold for `dwell_s`, close; waits until the valve is shut.

        It takes the valve's way there and back, its dead times, and the dwell. Closed early, it shuts the valve.
        ValueError for a dwell that is not 0 to `longest_dwell_s`; SkillFailed with what went wrong.
        """
        ...

    def set_opening(self, opening_mm: float) -> None:
        """Streaming: go to this opening now; 0 closes. RuntimeError where the hand has no `spec.streaming`."""
        ...

    def set_vibration(self, level: float) -> None:
        """Vibration motor, 0 (off) to 1; ValueError for anything else."""
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

    def written(self) -> Line:
        """As it is written down: the line as it came, and what was understood of it."""
        return Line(
            raw=self.raw.decode("latin-1"),
            value_mg=self.value_mg,
            unit=self.unit,
            stable=self.stable,
            time_s=round(self.time_s, 4),
        )


@dataclass(frozen=True, slots=True)
class StableMean:
    """The mean of stable readings, with the standard uncertainty of that mean."""

    value_mg: float
    uncertainty_mg: float
    time_s: float
    readings: Sequence[Reading] = ()

    def written(self) -> Weighing:
        """As it is written down: the mean, and every reading that it is the mean of."""
        readings = tuple(reading.written() for reading in self.readings)
        return Weighing(gross_mg=self.value_mg, uncertainty_mg=self.uncertainty_mg, readings=readings)


class Balance(Device, Protocol):
    """The balance. It is never tared by command: gross values only (a tare would die with the power).

    Nothing of it moves: it `is_stopped` always. `latest` is None while it is lost.
    """

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

    def next_reading(self, timeout_s: float | None = None) -> Steps[Reading]:
        """Wait for a reading that comes after now, for the spec's `awaited_s` if for no other time.

        SkillFailed device.lost if none does, balance.overload.
        """
        ...

    def stable_mean(self, timeout_s: float = 30.0) -> Steps[StableMean]:
        """Wait until the balance calls its readings stable, then average a few of them.

        SkillFailed balance.unstable if they are not stable in time, balance.overload, device.lost.
        """
        ...


class Changer(Device, Protocol):
    """Puts containers on the pan and takes them away: a carousel; or the operator does.

    What swings is not stopped: a container is never left hanging. `is_stopped` when the swing is over.
    """

    @property
    def needs_person(self) -> bool: ...

    def bring(self, container: Container) -> Steps[None]:
        """Put this container on the empty pan; nothing happens if it stands there already.

        SkillFailed container.missing where another one is known to stand there, operator.refused.
        """
        ...

    def take_away(self) -> Steps[None]:
        """Clear the pan; nothing happens if it is empty."""
        ...


@runtime_checkable
class Hands(Protocol):
    """A changer that is a person's hands, which are asked once for an exchange: one off the pan, the next one on it."""

    def hand_over(self, to: Container, is_bare: Callable[[], bool]) -> Steps[None]:
        """Clear the pan for this container, that `bring` puts there next: nobody has to say so once the pan is bare.

        SkillFailed operator.refused.
        """
        ...

    def clear(self) -> Steps[None]:
        """Clear the pan, whatever is believed to stand there; SkillFailed operator.refused."""
        ...


@dataclass(frozen=True)
class Site:
    """Where a driver connects its device: what robot/cell.yaml says of it, and what the run has for it."""

    spec: Any
    """Its section: `ArmSpec`, `HandSpec`, `BalanceSpec`, `ChangerSpec` or `DeviceSpec`."""
    options: Any
    """What its `options` say, as the driver's `Options` has read them."""
    clock: Clock
    liveness: Liveness = field(default_factory=Liveness)
    """The pulse of the run's tick: what moves stops without it."""
    may_torque: bool = True
    """A person has seen to what has no torque: it may be given some."""
    slot_of: Callable[[Container], int] = lambda container: 0
    """The slot of a changer, from 0, that a container is in."""
    servos: Any = None
    """What the engine's own arm and hand share."""


SEEN = "seen"
"""What was asked for has shown by itself, before anybody answered."""


class Operator(Protocol):
    """The person at the cell, if there is one."""

    def expect(self) -> None:
        """Something is going to be asked soon, which the run has told: a simulated person sets out."""
        ...

    def dismiss(self) -> None:
        """What was to be asked was not, and who has come for it goes."""
        ...

    def ask(self, question: str, choices: Sequence[str] = ("done", "stop")) -> Steps[str]:
        """Ask and wait for one of `choices`; SkillFailed operator.absent when nobody is there."""
        ...

    def ask_until(
        self, question: str, choices: Sequence[str], is_seen: Callable[[], bool], does: Callable[[], None]
    ) -> Steps[str]:
        """Ask for what shows by itself: one of `choices`, or SEEN once it `is_seen`, and nobody needs to answer.

        `does` lets a simulation follow, where the first of `choices` is given or a simulated person does it.
        """
        ...
