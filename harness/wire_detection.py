"""How soon the drivers of a cell of wire twins know that a supply has failed, while nothing else goes on."""

import math
import random
import threading
import time
from typing import Any

import numpy as np

from harness.wire_cell import WireCell
from harness.wire_cuts import SHORTEST_S, Cut, cpu_time_s, idle_share
from scuhand_bt.clock import carried_out
from scuhand_bt.devices.connect import connect_cell_devices
from scuhand_bt.run.clock import WallClock
from scuhand_bt.testing.at_the_wire import until
from scuhand_bt.testing.of_motion import SWAY_RAD, Sway


def detect(cell: WireCell, rng: random.Random, count: int) -> list[Cut]:
    """Let supplies fail while the drivers are connected and nothing else goes on; half the time arm or valve move."""
    return [_detected(cell, rng, ("arm", "valve", "hand", "changer", "balance")[n % 5]) for n in range(count)]


def _detected(cell: WireCell, rng: random.Random, supply: str) -> Cut:
    clock = WallClock()
    devices = connect_cell_devices(cell.lab.cell, clock)
    try:
        carried_out(devices.balance.next_reading(10.0), clock)
        until(lambda: devices.arm.is_stopped, "the arm stands still")
        if rng.random() < 0.5:
            devices.hand.set_opening(1.0)
            here = devices.arm.positions
            devices.arm.start(Sway(here, np.where(here > 0.0, -SWAY_RAD, SWAY_RAD), 4.0))
        time.sleep(rng.uniform(0.2, 0.8))
        device: Any = devices.hand if supply in ("valve", "hand") else vars(devices)[supply]
        assert device.fault is None, f"{device.fault}"
        before, length_s = cpu_time_s(), math.exp(rng.uniform(math.log(SHORTEST_S), math.log(1.0)))
        cut = Cut(supply, length_s if supply != "balance" else 5.0)
        at_s = float(cell.say("power", "off", supply)["at_s"])
        back = threading.Timer(max(0.0, at_s + cut.length_s - time.monotonic()), cell.say, ("power", "on", supply))
        back.start()
        while (fault := device.fault) is None and time.monotonic() < at_s + 6.0:
            time.sleep(0.001)
        if fault is not None:
            cut.known_s, cut.code = round(time.monotonic() - at_s, 4), str(fault.code)
        back.join()
        cut.idle = round(idle_share(before, cpu_time_s()), 2)
        return cut
    finally:
        devices.close()
        time.sleep(1.5 if supply in ("hand", "valve") else 0.3)  # until it has begun again
