"""What one servo does in the cell, how it is set up, and what it last said."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

from scuhand_bt.devices.dynamixel import registers as r
from scuhand_bt.devices.dynamixel.bus import DynamixelBus
from scuhand_bt.failures import Code, SkillFailed

SHORTEST_RETURN_DELAY = 0
WATCHDOG_UNITS = 4
"""BUS_WATCHDOG, 80 ms: a dead host stops the arm in less than 100 ms."""

BLOCK_START = r.TORQUE_ENABLE.address
BLOCK_LENGTH = r.PRESENT_TEMPERATURE.address + r.PRESENT_TEMPERATURE.size - BLOCK_START
"""One block of the table holds all that is read in every cycle."""


@dataclass(frozen=True, slots=True)
class Axis:
    """One servo: which, where its zero is, and how it is driven."""

    servo: int
    name: str
    model: r.ServoModel
    mode: int = r.POSITION_MODE
    home_count: int = 2048
    direction: int = 1
    pid: tuple[int, int, int] = (800, 0, 0)
    """POSITION_P/I/D_GAIN."""
    following_limit_rad: float = math.radians(10.0)
    """A servo further than this from its goal, for longer than a moment, is held up by something."""

    def count(self, angle_rad: float) -> int:
        return round(self.home_count + self.direction * angle_rad * r.COUNTS_PER_RAD)

    def angle_rad(self, count: int) -> float:
        return self.direction * (count - self.home_count) / r.COUNTS_PER_RAD


@dataclass(slots=True)
class AxisState:
    """What a servo last said of itself."""

    axis: Axis
    position_rad: float = 0.0
    velocity_rad_per_s: float = 0.0
    current_ma: float = 0.0
    voltage_v: float = 0.0
    temperature_c: int = 0
    moving: bool = False
    has_torque: bool = True
    was_limp: bool = False
    """It had no torque before it was set up."""
    hardware_error: int = 0
    """Bits of HARDWARE_ERROR; with any of the shutdown mask it has switched its torque off."""
    tripped: bool = False
    """Its watchdog has stopped it, and it takes no goals."""
    window_rad: tuple[float, float] = (-math.inf, math.inf)
    """The limits in the servo's own memory."""
    temperature_limit_c: int = 80
    far_since_s: float | None = field(default=None)
    """Since when it has been too far from its goal."""

    def take(self, block: bytes) -> None:
        """Take the block that begins at BLOCK_START."""

        def value(register: r.Register) -> int:
            return register.of(block, BLOCK_START)

        axis = self.axis
        self.position_rad = axis.angle_rad(value(r.PRESENT_POSITION))
        self.velocity_rad_per_s = axis.direction * value(r.PRESENT_VELOCITY) * r.RPM_PER_COUNT * 2 * math.pi / 60
        self.current_ma = axis.direction * value(r.PRESENT_CURRENT) * axis.model.current_unit_ma
        self.voltage_v = value(r.PRESENT_VOLTAGE) / 10
        self.temperature_c = value(r.PRESENT_TEMPERATURE)
        self.moving = bool(value(r.MOVING))
        self.has_torque = value(r.TORQUE_ENABLE) == 1
        self.hardware_error = value(r.HARDWARE_ERROR)
        self.tripped = value(r.BUS_WATCHDOG) == r.WATCHDOG_TRIPPED

    @property
    def is_still(self) -> bool:
        return not self.moving and abs(self.velocity_rad_per_s) < 0.03


def set_up(bus: DynamixelBus, axis: Axis, was_without_torque: Callable[[], None] = lambda: None) -> AxisState:
    """Make a servo ready: torque on, holding where it is, watchdog armed. Never drops its torque.

    One that has none is told of before it is given some. Raises SkillFailed with what to do; BusError.
    """
    number = bus.ping(axis.servo)
    if number != axis.model.number:
        found = r.MODELS[number].name if number in r.MODELS else f"model {number}"
        raise SkillFailed(
            Code.DEVICE_LOST, f"servo {axis.servo} ({axis.name}) on {bus.url} is a {found}, not a {axis.model.name}"
        )
    if bits := bus.read(axis.servo, r.HARDWARE_ERROR):
        raise shut_down(axis, bits)
    bus.write(axis.servo, r.BUS_WATCHDOG, 0)  # a tripped one refuses goals
    held = bus.read(axis.servo, r.TORQUE_ENABLE) == 1
    mode = bus.read(axis.servo, r.OPERATING_MODE)
    if held and mode != axis.mode:
        # The mode can only be changed without torque, and the arm has no brakes.
        raise SkillFailed(
            Code.DEVICE_LOST,
            f"servo {axis.servo} ({axis.name}) is powered in mode {mode}, not {axis.mode}; "
            "support the arm, switch its supply off and on, and start again",
        )
    if not held and bus.read(axis.servo, r.RETURN_DELAY) != SHORTEST_RETURN_DELAY:
        bus.write(axis.servo, r.RETURN_DELAY, SHORTEST_RETURN_DELAY)  # read first: EEPROM wears out
    if mode != axis.mode:
        bus.write(axis.servo, r.OPERATING_MODE, axis.mode)  # resets gains and profile: so it comes before them
    for gain, value in zip((r.POSITION_P_GAIN, r.POSITION_I_GAIN, r.POSITION_D_GAIN), axis.pid, strict=True):
        bus.write(axis.servo, gain, value)
    # No profile in the servo: the goals that are streamed to it are the profile.
    bus.write(axis.servo, r.PROFILE_ACCELERATION, 0)
    bus.write(axis.servo, r.PROFILE_VELOCITY, 0)
    if not held:
        was_without_torque()
    present = bus.read(axis.servo, r.PRESENT_POSITION)
    bus.write(axis.servo, r.GOAL_POSITION, present)
    bus.write(axis.servo, r.TORQUE_ENABLE, 1)
    bus.write(axis.servo, r.BUS_WATCHDOG, WATCHDOG_UNITS)
    state = AxisState(axis, position_rad=axis.angle_rad(present), was_limp=not held)
    state.temperature_limit_c = bus.read(axis.servo, r.TEMPERATURE_LIMIT)
    if axis.mode == r.POSITION_MODE:
        ends = (bus.read(axis.servo, r.MIN_POSITION_LIMIT), bus.read(axis.servo, r.MAX_POSITION_LIMIT))
        low, high = sorted(axis.angle_rad(end) for end in ends)
        state.window_rad = (low, high)
    return state


def shut_down(axis: Axis, bits: int) -> SkillFailed:
    """The failure of a servo that has switched itself off."""
    return SkillFailed(
        Code.SERVO_OVERLOAD,
        f"servo {axis.servo} ({axis.name}) has shut down on {r.hardware_errors(bits)} and holds nothing; "
        "support the arm, find the cause, and switch its supply off and on",
    )


def hold_again(bus: DynamixelBus, axes: list[Axis], goals_rad: Callable[[Axis], float]) -> None:
    """Give tripped servos their goals back: clear the watchdog, hold, arm it again. Raises BusError."""
    bus.sync_write(r.BUS_WATCHDOG, {axis.servo: 0 for axis in axes})
    bus.sync_write(r.GOAL_POSITION, {axis.servo: axis.count(goals_rad(axis)) for axis in axes})
    bus.sync_write(r.BUS_WATCHDOG, {axis.servo: WATCHDOG_UNITS for axis in axes})
