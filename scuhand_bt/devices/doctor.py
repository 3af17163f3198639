"""The doctor: looks at every device of a cell by itself, and says what it found and what to do.

Nothing moves and nothing is written, but for the self-test of the hand, which is asked for. The checks read
through the drivers' own classes; the arm's servos are asked one by one, with their torque left as it is.
"""

import math
import os
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from serial.tools import list_ports

from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.clock import Clock, carried_out, until
from scuhand_bt.device_specs.hand import HandSpec
from scuhand_bt.devices.balances import SerialBalance
from scuhand_bt.devices.connect import connect_alone
from scuhand_bt.devices.crane_x7 import bus_of
from scuhand_bt.devices.dynamixel import registers as r
from scuhand_bt.devices.dynamixel.arm import arm_axes
from scuhand_bt.devices.dynamixel.axes import Axis
from scuhand_bt.devices.dynamixel.bus import BusError, DynamixelBus
from scuhand_bt.devices.dynamixel.servo_loop import HOT_MARGIN_C
from scuhand_bt.devices.hand_controller import HandController
from scuhand_bt.devices.hand_protocol import VERSION
from scuhand_bt.devices.interfaces import Balance
from scuhand_bt.devices.liveness import LIMIT_S
from scuhand_bt.devices.scuhand import roller_axis
from scuhand_bt.drivers import is_ours
from scuhand_bt.failures import CATALOGUE, Code, SkillFailed
from scuhand_bt.motion.kinematics import LIMITS_RAD

OLDEST_FIRMWARE = 38
"""Of the servos: older ones have no BUS_WATCHDOG (ROBOTIS e-manual), and a dead host would not stop the arm."""
NARROWER_RAD, WIDER_RAD = math.radians(0.5), math.radians(3.0)
"""How far a servo's window may be from the planner's limits."""
ZERO_MM = 0.05
"""How far a shut valve may report to be from 0."""
HOT_C = 60
"""Of the valve's servo, which shuts down at 70."""
TEST_OPENING_MM = 1.0
TEST_DWELL_S = 0.3
TEST_VIBRATION = 0.5
ANSWER_S = 5.0
FIRST_READING_S = 10.0

LATE_S = 0.02
"""A thread that is woken later than this once in a hundred times: the goals' own period is 10 ms."""
WAKINGS = 200
WAKING_S = 0.005

Health = Literal["ok", "FAIL", "not done"]


@dataclass(frozen=True)
class Finding:
    """One check: what was found, what should have been, and what to do where they differ."""

    device: str
    check: str
    found: str
    expected: str
    verdict: Health
    what_to_do: str = ""


def judged(device: str, check: str, found: str, expected: str, good: bool, what_to_do: str) -> Finding:
    """A finding; what to do is only said where something is to be done."""
    return Finding(device, check, found, expected, "ok" if good else "FAIL", "" if good else what_to_do)


def examine(spec: CellSpec, clock: Clock, *, self_test: bool) -> Iterator[Finding]:
    """Every check of a cell, in turn; `self_test` lets the valve open and the motor vibrate."""
    ours: dict[str, Callable[[], Iterator[Finding]]] = {
        "arm": lambda: servos(spec),
        "hand": lambda: hand(spec.hand, clock, self_test=self_test),
    }
    yield computer()
    for device in spec.device_names:
        section = spec.section(device)
        if (device, section.driver) == ("changer", "operator"):
            yield Finding("changer", "driver", "operator", "a changer, or the operator", "ok")
            continue
        is_of_others = not is_ours(spec.kind_of(device), section.driver)
        if section.port or not is_of_others:  # a driver of others may need none
            yield (there := port_of(device, section.port))
            if there.verdict != "ok":
                continue
        if device == "balance":
            yield from balance(spec, clock)
        else:
            yield from ours[device]() if device in ours and not is_of_others else driven(spec, device, clock)


def port_of(device: str, port: str) -> Finding:
    """Whether the port that the cell names for a device is there, and may be used."""
    if "://" in port:
        return Finding(device, "port", port, "one to open", "ok")
    if not (port and Path(port).exists()):
        here = [f"{there.device} ({there.description})" for there in sorted(list_ports.comports())]
        known = f"this computer's serial ports: {', '.join(here) or 'none'}"
        found, do = f"{port} is not there", f"plug it in, or correct its `port` in robot/cell.yaml; {known}"
        if not port:
            found, do = "none is named", f"name its `port` in robot/cell.yaml; {known}"
        if not port and device == "changer":
            do += "; or write `changer: {driver: operator}`: a person changes containers"
        return judged(device, "port", found, "one that you may use", False, do)
    may_be_used = os.access(port, os.R_OK | os.W_OK)
    found = port if may_be_used else f"{port}, which you may not use"
    do = "add yourself to the group that owns it (`sudo usermod -aG dialout $USER`), and log in again"
    return judged(device, "port", found, "one that you may use", may_be_used, do)


def computer(sleep: Callable[[float], None] = time.sleep, now: Callable[[], float] = time.monotonic) -> Finding:
    """Whether this computer keeps time for a second: how late a sleeping thread is woken."""
    late_s = []
    for _ in range(WAKINGS):
        due_s = now() + WAKING_S
        sleep(WAKING_S)
        late_s.append(now() - due_s)
    late_s.sort()
    usual_s, worst_s = late_s[int(0.99 * WAKINGS) - 1], late_s[-1]
    found = f"99 of 100 within {1000 * usual_s:.1f} ms, the latest {1000 * worst_s:.1f} ms"
    expected = f"99 of 100 within {1000 * LATE_S:g} ms, all within {1000 * LIMIT_S:g} ms"
    do = f"close what else runs here ({os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}), or run with `nice -n -5`"
    return judged("computer", "wakes in time", found, expected, usual_s <= LATE_S and worst_s <= LIMIT_S, do)


def servos(spec: CellSpec) -> Iterator[Finding]:
    """The arm's servos and the roller's: who is on the bus, what they are, how they are."""
    bus = bus_of(spec.arm)
    try:
        bus.open()
        with closing(bus), bus.patience():
            found = bus.scan()
            axes = [*arm_axes(spec.arm), roller_axis(spec.hand)]
            yield _on_the_bus(found, axes)
            for index, axis in enumerate(axes):
                if axis.servo in found:
                    limits_rad = (LIMITS_RAD[0][index], LIMITS_RAD[1][index]) if index < len(axes) - 1 else None
                    yield from _servo(bus, axis, found[axis.servo], limits_rad)
    except BusError as error:
        do = "check the cable and the supply of the servos, and that no other program has the port open"
        yield judged("arm", "bus", str(error), "a bus that answers", False, do)


def _on_the_bus(found: Iterable[int], axes: list[Axis]) -> Finding:
    wanted = {axis.servo: axis.name for axis in axes}
    missing = [f"{servo} ({name})" for servo, name in wanted.items() if servo not in found]
    others = [servo for servo in found if servo not in wanted]
    do = f"no answer from {', '.join(missing)}: check their cables, ids, baud rate and supply"
    if others:
        do += f"; unknown servos on the bus: {', '.join(map(str, others))}"
    expected = ", ".join(map(str, wanted))
    return judged("arm", "servo ids", ", ".join(map(str, sorted(found))) or "none", expected, not missing, do)


def _servo(bus: DynamixelBus, axis: Axis, number: int, limits_rad: tuple[float, float] | None) -> Iterator[Finding]:
    """One servo that answers. `limits_rad` is what the planner may ask of it; None for the roller."""
    name = f"servo {axis.servo} ({axis.name})"

    def read(register: r.Register) -> int:
        return bus.read(axis.servo, register)

    model = r.MODELS[number].name if number in r.MODELS else f"model {number}"
    right = number == axis.model.number
    yield judged(name, "model", model, axis.model.name, right, "put the right servo here, or correct the ids")
    firmware = read(r.FIRMWARE)
    do = "update it with the DYNAMIXEL Wizard: its bus watchdog is what stops the arm when this computer dies"
    expected = f"{OLDEST_FIRMWARE} or newer"
    yield judged(name, "firmware", str(firmware), expected, firmware >= OLDEST_FIRMWARE, do)
    bits = read(r.HARDWARE_ERROR)
    do = "it has shut down and holds nothing: support the arm, find the cause, and switch its supply off and on"
    yield judged(name, "hardware error", r.hardware_errors(bits), "none", not bits, do)
    odd = [
        f"{what} {value}" for what, value in (("offset", read(r.HOMING_OFFSET)), ("mode", read(r.DRIVE_MODE))) if value
    ]
    do = "set Homing Offset and Drive Mode to 0 with the DYNAMIXEL Wizard; `home_counts` and `directions` replace them"
    yield judged(name, "offset, drive mode", ", ".join(odd) or "none", "none", not odd, do)
    low_v, high_v = read(r.MIN_VOLTAGE_LIMIT) / 10, read(r.MAX_VOLTAGE_LIMIT) / 10
    volts = read(r.PRESENT_VOLTAGE) / 10
    do = "check the supply and its cable"
    yield judged(name, "voltage", f"{volts:.1f} V", f"{low_v:g} to {high_v:g} V", low_v <= volts <= high_v, do)
    limit_c = read(r.TEMPERATURE_LIMIT) - HOT_MARGIN_C
    warm_c = read(r.PRESENT_TEMPERATURE)
    yield judged(name, "temperature", f"{warm_c} °C", f"below {limit_c} °C", warm_c < limit_c, "let it cool")
    if limits_rad is not None:
        yield _window(name, axis, (read(r.MIN_POSITION_LIMIT), read(r.MAX_POSITION_LIMIT)), limits_rad)


def _window(name: str, axis: Axis, ends: tuple[int, int], limits_rad: tuple[float, float]) -> Finding:
    """The window in the servo's own memory must hold the one that motions are planned in, and be little wider."""
    low_rad, high_rad = sorted(axis.angle_rad(end) for end in ends)
    beyond_rad = (limits_rad[0] - low_rad, high_rad - limits_rad[1])
    return judged(
        name,
        "window",
        f"{math.degrees(low_rad):.1f} to {math.degrees(high_rad):.1f}°",
        f"{math.degrees(limits_rad[0]):.1f} to {math.degrees(limits_rad[1]):.1f}°",
        all(-NARROWER_RAD <= beyond <= WIDER_RAD for beyond in beyond_rad),
        "correct its position limits with the DYNAMIXEL Wizard, or `home_counts` and `directions` in robot/cell.yaml",
    )


def hand(spec: HandSpec, clock: Clock, *, self_test: bool) -> Iterator[Finding]:
    """The hand's controller: its greeting and status, and the valve and the motor if they may move."""
    controller = HandController(spec)
    try:
        hello = controller.open()
    except SkillFailed as error:
        yield _lost("hand", error)
        return
    with closing(controller):
        yield Finding("hand", "firmware", hello.firmware, f"protocol {VERSION}", "ok")
        if not carried_out(until(clock, lambda: controller.report is not None, controller.news, ANSWER_S), clock):
            yield judged("hand", "status", "no report", "a report", False, "check its cable and supply")
            return
        yield from _hand_status(controller)
        if self_test:
            yield from _hand_test(controller, clock)
        else:
            yield Finding("hand", "self-test", "", "a valve and a motor that move", "not done", "run it with --yes")


def _hand_status(controller: HandController) -> Iterator[Finding]:
    report = controller.report
    assert report is not None
    pressed = "e" in report.faults
    do = "release the emergency stop" if pressed else "switch the controller off and on; if it stays, look at the valve"
    yield judged("hand", "faults", report.why or "none", "none", not report.faults, do)
    yield judged("hand", "valve", report.state, "closed", report.state == "closed", "free the valve")
    shut = abs(report.opening_mm) <= ZERO_MM
    do = "look for powder in the valve; if there is none, calibrate `valve_map` of the hand in robot/cell.yaml"
    yield judged("hand", "valve zero", f"{report.opening_mm:.3f} mm", f"0 ± {ZERO_MM:g} mm", shut, do)
    warm_c = report.temperature_c
    yield judged("hand", "temperature", f"{warm_c} °C", f"below {HOT_C} °C", warm_c < HOT_C, "let it cool")


def _hand_test(controller: HandController, clock: Clock) -> Iterator[Finding]:
    """Open the valve once and vibrate meanwhile; nothing may be in the cone."""
    widest_mm = strongest = 0.0

    def is_over() -> bool:
        nonlocal widest_mm, strongest
        if controller.trouble or controller.refused:
            return True
        report = controller.report
        if report is None:
            return False
        widest_mm, strongest = max(widest_mm, report.opening_mm), max(strongest, report.vibration)
        return controller.is_safe

    controller.step(TEST_OPENING_MM, TEST_DWELL_S, TEST_VIBRATION)
    over = carried_out(until(clock, is_over, controller.news, ANSWER_S), clock)
    trouble = controller.trouble or controller.refused
    if trouble is not None or not over:
        controller.make_safe()
        said = trouble.detail if trouble else f"the valve was not shut after {ANSWER_S:g} s"
        yield judged("hand", "self-test", said, "a step to its end", False, "look at the valve and its servo")
        return
    opened = abs(widest_mm - TEST_OPENING_MM) <= 0.2 * TEST_OPENING_MM
    do = "look at the valve's servo and its linkage"
    yield judged("hand", "valve opens", f"{widest_mm:.2f} mm", f"{TEST_OPENING_MM:g} mm", opened, do)
    vibrated = strongest >= 0.9 * TEST_VIBRATION
    do = "look at the motor and its cable"
    yield judged("hand", "vibration", f"{strongest:.2f}", f"{TEST_VIBRATION:g}", vibrated, do)


def driven(spec: CellSpec, name: str, clock: Clock) -> Iterator[Finding]:
    """A device of which nothing is known but its Protocol: whether it is sound, and what it says of itself."""
    try:
        device = connect_alone(spec, name, clock)
    except SkillFailed as error:
        yield _lost(name, error)
        return
    with closing(device):
        fault: SkillFailed | None = None
        try:
            if hasattr(device, "read"):
                carried_out(device.read(ANSWER_S), clock)
            else:
                carried_out(until(clock, lambda: device.fault is not None, device.news, ANSWER_S), clock)
        except SkillFailed as error:
            fault = error if error.code == Code.DEVICE_LOST else None  # a scanner has read nothing: nothing is there
        fault = fault or device.fault
        do = "look at its cable and supply, and at `options` in robot/cell.yaml"
        yield judged(name, "fault", fault.detail if fault is not None else "none", "none", fault is None, do)
        for check, found in device.health().items() if hasattr(device, "health") else ():
            yield Finding(name, check, found, "", "ok")


def balance(cell: CellSpec, clock: Clock) -> Iterator[Finding]:
    """The balance: what it reads, in which steps, who it says it is, whether it settles, and how clean its line is."""
    spec = cell.balance
    try:
        device: Balance = connect_alone(cell, "balance", clock)
    except SkillFailed as error:
        yield _lost("balance", error)
        return
    with closing(device):  # type: ignore[type-var]
        try:
            reading = carried_out(device.next_reading(FIRST_READING_S), clock)
            yield Finding("balance", "reading", _grams(reading.value_mg), "a reading", "ok")
            yield Finding("balance", "readability", f"{spec.readability_mg:g} mg", "as in robot/cell.yaml", "ok")
            yield _identity(device)
            mean = carried_out(device.stable_mean(spec.settles_s), clock)
            found = f"{_grams(mean.value_mg)} ± {mean.uncertainty_mg:.2f} mg"
            yield Finding("balance", "stability", found, "stable readings", "ok")
            if isinstance(device, SerialBalance):
                yield _line_of(device)
        except SkillFailed as error:
            if isinstance(device, SerialBalance) and (odd := device.misfit) is not None:
                yield judged("balance", "readability", odd.found, odd.expected, False, odd.what_to_do)
            elif error.code == Code.DEVICE_LOST:
                yield _lost("balance", error)
            else:
                remedy = CATALOGUE[error.code].remedy
                yield judged("balance", "stability", error.detail, "stable readings", False, remedy)


def _line_of(device: SerialBalance) -> Finding:
    found = f"{device.discarded} of {device.lines} lines discarded"
    do = "look at the balance's cable, its shield and ground, and at `baud` and `bits` in robot/cell.yaml"
    clean = device.discarded <= 1  # the first one may have begun before the port was open
    return judged("balance", "line", found, "at most the first", clean, do)


def _grams(mass_mg: float) -> str:
    return f"{round(mass_mg / 1000, 4) + 0.0:.4f} g"  # + 0.0: nobody weighs -0.0000 g


def _identity(device: Balance) -> Finding:
    if isinstance(device, SerialBalance) and not device.says_who_it_is:
        return Finding("balance", "identity", "this dialect has none", "", "not done")
    do = "readings come all the same; if there are several balances, check that this is the right one"
    return Finding("balance", "identity", device.identity or "no answer", "a serial number", "ok", do)


def _lost(device: str, error: SkillFailed) -> Finding:
    return judged(device, "connection", error.detail, "a device that answers", False, CATALOGUE[error.code].remedy)
