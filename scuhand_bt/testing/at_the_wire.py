"""What all checks of a driver need: the device connected to its twin, its steps carried out, and patience."""

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel

from scuhand_bt.cell_spec import DeviceSpec
from scuhand_bt.clock import Clock
from scuhand_bt.device_specs.changer import ChangerSpec
from scuhand_bt.devices.interfaces import Site
from scuhand_bt.drivers import driver_of
from scuhand_bt.failures import SkillFailed
from scuhand_bt.run.clock import WallClock
from scuhand_bt.sim.wire.port import PtyPort
from scuhand_bt.sim.wire.scene import StillScene, at_a_twin, twin_of
from scuhand_bt.sim.wire.server import TwinServer
from scuhand_bt.specs import Container

PATIENCE_S = 20.0


@dataclass(frozen=True)
class AtTheWire:
    """A device of a driver, open, its twin at the other end of the cable, and the scene that the twin stands in."""

    device: Any
    server: TwinServer[Any]
    scene: StillScene
    clock: Clock


def options_of(kind: str, driver: str, given: Mapping[str, Any]) -> BaseModel:
    """Options of a driver as they are at its twin."""
    return at_a_twin(driver_of(kind, driver).Options.model_validate(given))


@contextmanager
def at_the_wire(
    kind: str, driver: str, given: Mapping[str, Any], slot_of: Callable[[Container], int] = lambda container: 0
) -> Iterator[AtTheWire]:
    """A driver's device and its twin; at the end nothing of the device is left behind."""
    options, scene, clock = options_of(kind, driver, given), StillScene(), WallClock()
    with TwinServer(twin_of(kind, driver)(options, scene), PtyPort()) as server:
        before = set(threading.enumerate())
        port = server.url
        spec = (
            ChangerSpec(driver=driver, port=port)
            if kind == "changer"
            else DeviceSpec.model_validate({"kind": kind, "driver": driver, "port": port})
        )
        device = driver_of(kind, driver).connect(Site(spec, options, clock, slot_of=slot_of))
        try:
            yield AtTheWire(device, server, scene, clock)
        finally:
            device.close()
        # Not how many there are: others may be tried at the same time.
        since = set(threading.enumerate()) - before
        until(lambda: not any(thread.is_alive() for thread in since), "its threads end with it")


def it_comes_and_goes(wire: AtTheWire, kind: str) -> None:
    """A cable pulled is told as device.lost, soon and by its news; put back, the device is sound again."""
    device, heard = wire.device, wire.device.news.count
    wire.server.unplug()
    until(lambda: device.fault is not None and device.fault.code == "device.lost", f"a lost {kind} is told")
    assert device.news.count > heard, "its news fires as it is lost"
    until(lambda: bool(device.is_stopped), f"a lost {kind} gives its lease back")
    wire.server.plug()
    until(lambda: device.fault is None, "it comes back")


def until(condition: Callable[[], bool], what: str) -> None:
    """Wait for something; AssertionError if it never comes true."""
    end_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end_s, f"this never came true: {what}"
        time.sleep(0.01)


def fails(act: Callable[[], object], code: str) -> None:
    """AssertionError unless it fails with this code."""
    came = "nothing"
    try:
        act()
    except SkillFailed as failed:
        came = failed.code
    assert came == code, f"it should fail with {code}, and what came is {came}"
