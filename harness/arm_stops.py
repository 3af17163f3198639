"""Stops of the arm as simulated, and by the driver on its twin: where it is told to be, moment by moment.

Both are seen every period of the driver's loop, from a motion's beginning to rest. The driver's loop is told its time
here instead of waiting for it, so a stop costs some milliseconds.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from scuhand_bt.clock import Wake
from scuhand_bt.device_specs.arm import ArmSpec
from scuhand_bt.devices.dynamixel import registers as r
from scuhand_bt.devices.dynamixel.arm import DynamixelArm, arm_axes
from scuhand_bt.devices.dynamixel.axis_group import AxisGroup
from scuhand_bt.devices.dynamixel.bus import DynamixelBus
from scuhand_bt.devices.dynamixel.servo_loop import PERIOD_S, ServoChain
from scuhand_bt.motion.kinematics import Floats, Mount
from scuhand_bt.motion.spill import apex_motion, spill_angles_deg
from scuhand_bt.motion.stopping import StoppableTrajectory
from scuhand_bt.run.clock import VirtualClock
from scuhand_bt.sim.arm import SimulatedArm
from scuhand_bt.sim.wire.dynamixel import DynamixelTwin, crane_x7
from scuhand_bt.sim.wire.port import PtyPort
from scuhand_bt.sim.wire.server import TwinServer


class _ArmAlone:
    """Lets an arm go on with virtual time."""

    def __init__(self, arm: SimulatedArm) -> None:
        self._arm = arm

    def step(self, now_s: float, limit_s: float) -> float:
        end_s = min(now_s + PERIOD_S, limit_s)
        self._arm.advance(end_s)
        return end_s

    def save(self) -> None:
        """It outlives no program."""


def simulated_stop(motion: StoppableTrajectory, at_s: float, mount: Mount) -> Floats:
    """Where the simulated arm is (n, 7), stopped at a moment of a motion; asked for after that, it is not."""
    clock = VirtualClock()
    arm = SimulatedArm(clock, lambda: mount, motion.start)
    clock.process = _ArmAlone(arm)
    arm.start(motion)
    seen: list[Floats] = []
    while not arm.is_stopped:
        if len(seen) == round(at_s / PERIOD_S):
            arm.stop()
        clock.wait([Wake(clock.now_s + PERIOD_S)])
        seen.append(arm.positions)
    return np.array(seen)


class TwinArm:
    """The driver on its twin, at a port of this computer; `joints` is where the arm stands."""

    def __init__(self, joints: Floats) -> None:
        servos = crane_x7(range(2, 9))
        for servo, angle in zip(servos, joints, strict=True):
            servo.position = 2048 + angle * r.COUNTS_PER_RAD
        self.twin = DynamixelTwin(servos)
        self.server = TwinServer(self.twin, PtyPort())
        self.group = AxisGroup(arm_axes(ArmSpec()))
        self.chain = ServoChain(DynamixelBus(self.server.url, latency_ms=40.0), [self.group])
        self.device = DynamixelArm(self.chain, self.group)

    @contextmanager
    def stepped(self) -> "Iterator[TwinArm]":
        """Connected, its loop to be stepped by `stopped`."""
        with self.server:
            self.chain.bus.open()
            self.chain._set_up()
            self.chain._disarm()  # between two stops a while passes, for which no servo's watchdog was made
            yield self
            self.chain.bus.close()

    def stopped(self, motion: StoppableTrajectory, at_s: float) -> Floats:
        """The goals (n, 7) that the driver's loop sends to the twin, stopped at a moment of a motion."""
        self.group.move(motion)
        seen: list[Floats] = []
        while self.group.is_streaming:
            if len(seen) == round(at_s / PERIOD_S):
                self.device.stop()
            self.chain._cycle(PERIOD_S, 0.0, read_now=False)
            seen.append(self.group.goals_rad.copy())
        return np.array(seen)

    def twin_heard(self) -> bool:
        """Whether the twin's servos, asked, have the driver's last goals."""
        bus, goal_of = self.chain.bus, self.group.goal_of
        with bus.patience():
            return all(bus.read(axis.servo, r.GOAL_POSITION) == axis.count(goal_of(axis)) for axis in self.group.axes)


@dataclass(frozen=True)
class Worst:
    """The most that is seen of a course: spill angle [deg], and joints' accelerations [rad/s²] and jerks [rad/s³]."""

    spill_deg: float
    acceleration: float
    jerk: float


def worst_of(course: Floats, mount: Mount) -> Worst:
    """What differences say of a course (n, 7) that is sampled every period, and of standing where it ends."""
    course = np.vstack([course, course[-1:], course[-1:], course[-1:]])
    speed = (course[2:] - course[:-2]) / (2 * PERIOD_S)
    acceleration = (course[2:] - 2 * course[1:-1] + course[:-2]) / PERIOD_S**2
    jerk = np.diff(acceleration, axis=0) / PERIOD_S
    spill_deg = spill_angles_deg(*apex_motion(course[1:-1], speed, acceleration, mount))
    return Worst(float(spill_deg.max()), float(np.abs(acceleration).max()), float(np.abs(jerk).max()))


def off_path_rad(motion: StoppableTrajectory, positions: Floats) -> float:
    """How far a configuration is from the nearest of a motion's."""
    shares, spacing = np.linspace(0.0, 1.0, 2001), 1 / 2000
    for _ in range(2):
        off_rad = np.abs(motion.at(shares * motion.duration_s) - positions).max(axis=1)
        nearest = int(off_rad.argmin())
        shares = np.clip(shares[nearest] + np.linspace(-spacing, spacing, 201), 0.0, 1.0)
    return float(off_rad.min())
