"""What the driver of a watcher has to pass, against its twin: what is there is seen, soon, and where it is.

A watcher that sees nothing lets the arm go; so one that cannot see has a fault, until it has told what is there *now*.
"""

import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scuhand_bt.devices.boxes import Seen
from scuhand_bt.testing.at_the_wire import AtTheWire, at_the_wire, it_comes_and_goes, until
from scuhand_bt.testing.of_instruments import is_sound_after_noise, only_lines_are_understood

SEEN = (
    (Seen(at_mm=(190.0, 240.0, 180.0), box_mm=(100.0, 60.0, 300.0)),),
    (Seen(at_mm=(-60.0, -310.0, 90.0), box_mm=(40.0, 120.0, 80.0)),),
    (
        Seen(at_mm=(400.0, 0.0, 250.0), box_mm=(60.0, 60.0, 60.0)),
        Seen(at_mm=(150.0, -280.0, 40.0), box_mm=(80.0, 40.0, 80.0)),
    ),
)
OFF_M = 0.02
"""By how much what is told may be off: one of the cubes that it is put into."""
SOON_S = 2.0
"""Within this it tells what has come: a person's hand is in the arm's way by then."""


def watcher_conforms(driver: str, options: Mapping[str, Any]) -> None:
    """It tells what is there, soon and where it is, the same array for the same; what it cannot see is a fault."""
    with at_the_wire("watcher", driver, options) as wire:
        device = wire.device
        assert device.fault is None, "connected, it has told what it sees"
        _tells_soon(wire, ())
        for boxes in (*SEEN, (), SEEN[0]):
            _tells_soon(wire, boxes)
            told = device.points_m
            time.sleep(0.5)
            assert device.points_m is told, "the same is the same array: another one is looked at again"
        only_lines_are_understood(wire)
        is_sound_after_noise(wire)
        wire.server.paused = True
        until(lambda: device.fault is not None, "one that says nothing any more is lost, and not blind")
        wire.scene.seen = SEEN[1]
        wire.server.paused = False
        until(lambda: device.fault is None, "it answers again")
        _tells(device.points_m, SEEN[1])
        it_comes_and_goes(wire, "watcher")
        _tells(device.points_m, SEEN[1])


def _tells_soon(wire: AtTheWire, boxes: tuple[Seen, ...]) -> None:
    wire.scene.seen = boxes
    end_s = time.monotonic() + SOON_S
    while True:
        try:
            _tells(wire.device.points_m, boxes)
        except AssertionError:
            if time.monotonic() > end_s:
                raise
            time.sleep(0.01)
        else:
            return


def _tells(points_m: NDArray[np.float64] | None, boxes: Sequence[Seen]) -> None:
    """AssertionError unless points are told in all of the boxes, as far as these reach, and nowhere else."""
    if not boxes:
        assert points_m is None or not len(points_m), "it tells something where nothing is"
        return
    assert points_m is not None, f"it tells nothing, and something is at {boxes[0].at_mm} mm"
    assert points_m.shape == (len(points_m), 3), f"points are (n, 3), not {points_m.shape}"
    in_any = np.zeros(len(points_m), dtype=bool)
    for box in boxes:
        middle_m, half_m = np.array(box.at_mm) / 1e3, np.array(box.box_mm) / 2e3
        inside = (np.abs(points_m - middle_m) <= half_m + OFF_M).all(axis=1)
        in_any |= inside
        where = f"the box of {box.box_mm} mm at {box.at_mm} mm"
        assert inside.any(), f"it tells nothing in {where}"
        reach_m = np.array([points_m[inside].min(axis=0), points_m[inside].max(axis=0)]) - middle_m
        assert (np.abs(np.abs(reach_m) - half_m) <= OFF_M).all(), f"what it tells is not as large as {where}"
    assert in_any.all(), f"it tells a point at {1e3 * points_m[~in_any][0]} mm, where nothing is"
