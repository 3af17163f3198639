"""Shared by the contract tests: each device as simulated, and as the real driver over its twin.

A simulated one goes on in virtual time, in steps as the world's; a wired one in real time, on a pseudo-terminal.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from wire_helpers import carry_out

from scuhand_bt.clock import Steps, Wake
from scuhand_bt.device_specs.arm import ArmSpec
from scuhand_bt.device_specs.balance import BalanceSpec
from scuhand_bt.device_specs.hand import HandSpec
from scuhand_bt.devices.balances import DIALECTS, SerialBalance
from scuhand_bt.devices.dynamixel import registers as r
from scuhand_bt.devices.dynamixel.arm import DynamixelArm, arm_axes
from scuhand_bt.devices.dynamixel.axis_group import AxisGroup
from scuhand_bt.devices.dynamixel.bus import DynamixelBus
from scuhand_bt.devices.dynamixel.servo_loop import ServoChain
from scuhand_bt.devices.hand_controller import HandController
from scuhand_bt.devices.interfaces import Joints
from scuhand_bt.devices.roller import RollerRecord
from scuhand_bt.devices.scuhand import ScuHand, roller_axis
from scuhand_bt.motion.kinematics import Mount
from scuhand_bt.motion.stopping import StoppableTrajectory
from scuhand_bt.motion.timelaw import RateLimits
from scuhand_bt.motion.trajectory import through
from scuhand_bt.run.clock import VirtualClock, WallClock
from scuhand_bt.sim.arm import SimulatedArm
from scuhand_bt.sim.balance import SimulatedBalance
from scuhand_bt.sim.hand import SimulatedHand
from scuhand_bt.sim.plant import Plant
from scuhand_bt.sim.wire.balances import StillPan, balance_twin
from scuhand_bt.sim.wire.dynamixel import DynamixelTwin, crane_x7
from scuhand_bt.sim.wire.hand import HandTwin
from scuhand_bt.sim.wire.port import PtyPort
from scuhand_bt.sim.wire.server import TwinServer

FIRMWARE = Path(__file__).parent.parent / "robot" / "firmware"
READY = np.array([0.0, 0.4, 0.0, -1.6, 0.0, 0.5, 0.0])
RATES = RateLimits(np.full(7, 3.0), np.full(7, 4.4), np.full(7, 44.0))
MOUNT = Mount.of(HandSpec())


class Sway(StoppableTrajectory):
    """A smooth motion from where the arm is by `swing_rad`, of every joint or one for each."""

    def __init__(self, start: Joints, swing_rad: float | Joints, duration_s: float) -> None:
        s = np.linspace(0.0, 1.0, 60)[:, None]
        positions = start + swing_rad * (10 * s**3 - 15 * s**4 + 6 * s**5)
        super().__init__(through(s[:, 0] * duration_s, positions), RATES, MOUNT)


class Stepping:
    """Lets one simulated device go on with virtual time."""

    def __init__(self, advance: Callable[[float, float], object], step_s: float = 0.02) -> None:
        self._advance, self._step_s = advance, step_s

    def step(self, now_s: float, limit_s: float) -> float:
        end_s = min(now_s + self._step_s, limit_s)
        self._advance(end_s, end_s - now_s)
        return end_s

    def save(self) -> None:
        """It outlives no program."""


class DeviceBench:
    """A device and its clock; `device` is what the contract is about."""

    clock: Any
    device: Any
    late_s = 0.0
    """How late things may be on a busy computer."""

    def run(self, steps: Steps[Any]) -> Any:
        return carry_out(steps, self.clock)

    def pass_time(self, duration_s: float) -> None:
        end_s = self.clock.now_s + duration_s
        while self.clock.now_s < end_s:
            self.clock.wait([Wake(end_s)])

    def until(self, condition: Callable[[], object], timeout_s: float = 10.0) -> float:
        """How long it took [s] until this came true."""
        begin_s = self.clock.now_s
        while not condition():
            assert self.clock.now_s < begin_s + timeout_s, "this never came true"
            self.clock.wait([Wake(self.clock.now_s + 0.005)])
        return self.clock.now_s - begin_s

    def timed(self, steps: Steps[Any]) -> float:
        begin_s = self.clock.now_s
        self.run(steps)
        return self.clock.now_s - begin_s


class SimulatedArmBench(DeviceBench):
    def __init__(self, joints: Joints = READY, step_s: float = 0.02) -> None:
        self.clock = VirtualClock()
        self.device = SimulatedArm(self.clock, lambda: MOUNT, joints)
        self.clock.process = Stepping(lambda end_s, dt_s: self.device.advance(end_s), step_s)

    @contextmanager
    def blocked(self) -> Iterator[None]:
        self.device.faults.active = {"servo.not_following": self.clock.now_s}
        yield
        self.device.faults.active = {}


class WiredArmBench(DeviceBench):
    late_s = 0.3

    def __init__(self, joints: Joints = READY) -> None:
        servos = crane_x7(range(2, 9))
        for servo, angle in zip(servos, joints, strict=True):
            servo.position = 2048 + angle * r.COUNTS_PER_RAD
        self.twin = DynamixelTwin(servos)
        self.server = TwinServer(self.twin, PtyPort())
        self.clock = WallClock()
        self.group = AxisGroup(arm_axes(ArmSpec()))
        self.chain = ServoChain(DynamixelBus(self.server.url, latency_ms=40.0), [self.group])
        self.device = DynamixelArm(self.chain, self.group)

    @contextmanager
    def open(self) -> "Iterator[WiredArmBench]":
        with self.server:
            self.chain.open()
            yield self
            self.chain.close()

    @contextmanager
    def blocked(self) -> Iterator[None]:
        elbow = self.twin.servos[5]
        elbow.blocked = True
        yield
        elbow.blocked = False
        self.pass_time(0.3)  # it catches up with where it is held


class SimulatedHandBench(DeviceBench):
    def __init__(self, spec: HandSpec | None = None) -> None:
        self.clock = VirtualClock()
        self.device = SimulatedHand(spec or HandSpec(), self.clock)
        self.clock.process = Stepping(self.device.advance)

    @contextmanager
    def emergency_stop(self) -> Iterator[None]:
        self.device.faults.active = {"hand.emergency_stop": self.clock.now_s}
        self.pass_time(0.1)
        yield
        self.device.faults.active = {}
        self.pass_time(0.1)


class WiredHandBench(DeviceBench):
    late_s = 0.35

    def __init__(self) -> None:
        self.bus = TwinServer(DynamixelTwin(crane_x7()[-1:]), PtyPort())
        self.board = TwinServer(HandTwin(FIRMWARE), PtyPort())
        self.clock = WallClock()
        self.spec = HandSpec(port=self.board.url)

    @contextmanager
    def open(self) -> "Iterator[WiredHandBench]":
        with self.bus, self.board, self.connected():
            self.device.rim_is(90.0)
            yield self

    @contextmanager
    def connected(self, roller_file: Path | None = None) -> Iterator[ScuHand]:
        """A program's hand, from when it connects to its proper end."""
        record = RollerRecord(self.spec, roller_file)
        roller = AxisGroup([roller_axis(self.spec)], False, record.turns_were_lost)
        chain = ServoChain(DynamixelBus(self.bus.url, latency_ms=40.0), [roller])
        chain.open()
        try:
            controller = HandController(self.spec, chain.news)
            controller.open()
            self.device = ScuHand(self.spec, controller, chain, roller, self.clock, record)
            yield self.device
            self.device.close()
        finally:
            chain.close()

    @contextmanager
    def emergency_stop(self) -> Iterator[None]:
        self.board.twin.emergency_stop = True
        self.pass_time(0.2)
        yield
        self.board.twin.emergency_stop = False
        self.pass_time(0.2)
        self.device._controller.reset()
        self.until(lambda: self.device.fault is None)


LOAD_MG = 9_200.0
MAXIMUM_MG = 120_000.0


class SimulatedBalanceBench(DeviceBench):
    def __init__(self) -> None:
        self.clock = VirtualClock()
        self.load_mg = LOAD_MG
        self.device = SimulatedBalance(BalanceSpec(maximum_mg=MAXIMUM_MG), self.clock, Plant())
        self.clock.process = Stepping(lambda end_s, dt_s: self.device.advance(end_s, dt_s, self.load_mg, 0.0, 0.0))

    def load(self, load_mg: float) -> None:
        self.load_mg = load_mg

    @contextmanager
    def lost(self) -> Iterator[None]:
        self.device.faults.active = {"balance.silent": self.clock.now_s}
        yield
        self.device.faults.active = {}

    @contextmanager
    def unstable(self) -> Iterator[None]:
        self.device.faults.active = {"balance.unstable": self.clock.now_s}
        yield
        self.device.faults.active = {}


class WiredBalanceBench(DeviceBench):
    late_s = 0.5

    def __init__(self, driver: str) -> None:
        self.pan = StillPan(LOAD_MG)
        self.server = TwinServer(balance_twin(driver)(self.pan, 0.1, MAXIMUM_MG), PtyPort())
        self.clock = WallClock()
        options = {"bits": "8N1"}
        spec = BalanceSpec(driver=driver, port=self.server.url, options=options, maximum_mg=MAXIMUM_MG)
        self.device = SerialBalance(spec, DIALECTS[driver], self.clock, DIALECTS.values(), reopen_s=0.02)

    @contextmanager
    def open(self) -> "Iterator[WiredBalanceBench]":
        with self.server:
            self.device.open()
            yield self
            self.device.close()

    def load(self, load_mg: float) -> None:
        self.pan.load_mg = load_mg

    @contextmanager
    def lost(self) -> Iterator[None]:
        self.server.unplug()
        yield
        self.server.plug()

    @contextmanager
    def unstable(self) -> Iterator[None]:
        self.pan.stable = False
        yield
        self.pan.stable = True
