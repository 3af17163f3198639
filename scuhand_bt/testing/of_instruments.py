"""What the drivers of sensors, scanners, ionisers, cappers and changers have to pass, against their twins."""

import random
from collections.abc import Mapping
from typing import Any

from scuhand_bt.clock import carried_out
from scuhand_bt.devices.line_device import LineReader, LineSwitch, LineWatcher
from scuhand_bt.sim.wire.line_twin import LineTwin
from scuhand_bt.specs import Container
from scuhand_bt.testing.at_the_wire import AtTheWire, at_the_wire, fails, it_comes_and_goes, until

AIRS = (
    {"temperature_c": 22.4, "humidity_percent": 45.1},
    {"temperature_c": -5.5, "humidity_percent": 3.2},
    {"temperature_c": 40.0, "humidity_percent": 98.7},
)
DIGIT = 0.051
"""Half of the last digit of an instrument that shows one decimal."""
CODES = ("xrd-01", "LOT_7/b 2", "0042")
NOISE = b"\xfe\x00~?%\r\n12.5\r\n"


def sensor_conforms(driver: str, options: Mapping[str, Any]) -> None:
    """It measures what its twin's scene is like, by names with units, now and not before."""
    with at_the_wire("sensor", driver, options) as wire:
        for air in AIRS:
            wire.scene.air.update(air)
            _read(wire)  # what was on its way
            value = _read(wire)
            assert value, "it measures nothing"
            for name, told in value.items():
                assert name in air, f"'{name}' is no quantity with its unit: {', '.join(air)}"
                assert abs(told - air[name]) < DIGIT, f"it reads {name} {told}, and it is {air[name]}"
        only_lines_are_understood(wire)
        is_sound_after_noise(wire)
        it_comes_and_goes(wire, "sensor")
        _read(wire)


def scanner_conforms(driver: str, options: Mapping[str, Any]) -> None:
    """It reads the code that is shown, whole, and none where none is."""
    with at_the_wire("scanner", driver, options) as wire:
        fails(lambda: carried_out(wire.device.read(1.5), wire.clock), "container.missing")
        for code in CODES:
            wire.scene.on_pan = code
            _read(wire)
            assert (told := _read(wire)) == code, f"it reads {told!r}, and the code is {code!r}"
        it_comes_and_goes(wire, "scanner")
        assert _read(wire) == CODES[-1]


def switch_conforms(kind: str, driver: str, options: Mapping[str, Any]) -> None:
    """It is brought into both states, says when it is there, and completes whatever happens."""
    with at_the_wire(kind, driver, options) as wire:
        device, twin = wire.device, wire.server.twin
        until(lambda: device.state is not None, "it tells its state")
        for value in (True, True, False, True):
            status = device.set(value)
            fails(lambda: device.set(False), "device.busy")
            carried_out(status.wait(), wire.clock)
            assert status.is_done, "what has been waited for is done"
            assert device.state == twin.state == value, (
                f"told to be {value}, it is {twin.state} and says {device.state}"
            )
            assert device.is_stopped, "it stands still when it is done"
        only_lines_are_understood(wire)
        is_sound_after_noise(wire)
        wire.server.paused = True
        status = device.set(not twin.state)
        until(lambda: bool(status.is_done), "a set of a device that hangs completes")
        assert status.failure is not None, "a set of a device that hangs has failed"
        wire.server.paused = False
        until(lambda: device.fault is None, "it answers again")
        it_comes_and_goes(wire, kind)
        device.stop()
        device.stop()
        until(lambda: bool(device.is_stopped), "it stops")


def changer_conforms(driver: str, options: Mapping[str, Any]) -> None:
    """It puts on the pan what it is asked for, never two, and ends every swing that it has begun."""
    vials = {name: _vial(name) for name in ("a", "b", "c")}
    slots = {"a": 0, "b": 1, "c": 5}
    with at_the_wire("changer", driver, options, lambda container: slots[container.id]) as wire:
        device, scene = wire.device, wire.scene
        assert device.needs_person is False
        for name, slot in slots.items():
            for _ in range(2):
                carried_out(device.bring(vials[name]), wire.clock)
                assert scene.slot == slot, f"asked for slot {slot}, it has put that of {scene.slot} on the pan"
            other = next(vial for vial in vials.values() if vial.id != name)
            fails(lambda other=other: carried_out(device.bring(other), wire.clock), "container.missing")  # type: ignore[misc]
            for _ in range(2):
                carried_out(device.take_away(), wire.clock)
                assert scene.slot is None, f"the pan is to be bare, and the container of {scene.slot} stands on it"
        swing = device.bring(vials["b"])
        next(swing)
        device.stop()
        swing.close()
        until(lambda: bool(device.is_stopped) and scene.slot == slots["b"], "a swing goes on to its end when halted")
        it_comes_and_goes(wire, "changer")
        carried_out(device.bring(vials["b"]), wire.clock)
        carried_out(device.take_away(), wire.clock)
        assert scene.slot is None


def _vial(name: str) -> Container:
    return Container(name="vial", id=name, mouth_mm=10.0, height_mm=30.0, capacity_mm3=2000.0, empty_mass_mg=4000.0)


def _read(wire: AtTheWire) -> Any:
    return carried_out(wire.device.read(), wire.clock).value


def only_lines_are_understood(wire: AtTheWire) -> None:
    """For what speaks in lines: a broken line says nothing, or the same."""
    device, twin = wire.device, wire.server.twin
    if not (isinstance(device, LineReader | LineSwitch | LineWatcher) and isinstance(twin, LineTwin)):
        return
    lines = [line for at_s in (1e9, 2e9) for line in twin.hear(device.question, at_s) if line]
    assert lines, f"its question {device.question!r} is not answered"
    line = lines[-1]
    whole = device.parse(line)
    assert whole is not None, f"its twin's line {line!r} is not understood"
    for end in range(len(line.rstrip())):
        said = device.parse(line[:end] + b"\r\n")
        assert said in (None, whole), f"{line[:end]!r} is understood as {said}"
    rng = random.Random(1)
    for _ in range(2_000):
        said = device.parse(rng.randbytes(rng.randrange(30)) + b"\r\n")
        assert said is None, f"noise is understood as {said}"


def is_sound_after_noise(wire: AtTheWire) -> None:
    """Noise on its line is no fault, and its health is in words."""
    wire.server.say(NOISE)
    assert wire.device.fault is None
    for name, said in wire.device.health().items():
        assert isinstance(said, str), f"'{name}' of its health is no text"
