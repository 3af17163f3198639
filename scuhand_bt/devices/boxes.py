"""`driver: boxes`: a watcher that sees what it was told to see, for dry runs and rehearsals of what comes into a cell.

A depth camera's driver meets the same Protocol (`instruments.Watcher`); these boxes come and go at times of the run.
"""

import math
from typing import Annotated, ClassVar, Self

import numpy as np
from pydantic import Field

from scuhand_bt.bench_spec import Point, Size
from scuhand_bt.clock import Clock, Signal
from scuhand_bt.devices.interfaces import Site
from scuhand_bt.motion.kinematics import Floats
from scuhand_bt.quantity import Degrees, Seconds
from scuhand_bt.specs import Spec

APART_M = 0.015
"""Between two points of a box: less than the cubes that they are put into."""


class Seen(Spec):
    """A box, by its centre, and when it is there."""

    at_mm: Point
    box_mm: tuple[Size, Size, Size]
    yaw_deg: Degrees = 0.0
    from_s: Annotated[Seconds, Field(ge=0)] = 0.0
    """Of the run."""
    for_s: Annotated[Seconds, Field(gt=0)] = math.inf

    @property
    def points_m(self) -> Floats:
        """All of it, as points (n, 3)."""
        grids = [np.linspace(-size / 2e3, size / 2e3, 2 + int(size / 1e3 / APART_M)) for size in self.box_mm]
        inside = np.stack(np.meshgrid(*grids, indexing="ij"), axis=-1).reshape(-1, 3)
        c, s = math.cos(math.radians(self.yaw_deg)), math.sin(math.radians(self.yaw_deg))
        placed: Floats = inside @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) + np.array(self.at_mm) / 1e3
        return placed


class Boxes:
    """Sees its boxes while they are there; see `scuhand_bt.devices.instruments.Watcher`."""

    class Options(Spec):
        """What it sees."""

        boxes: tuple[Seen, ...] = ()

    twin: ClassVar[str] = ""
    fault = None
    is_stopped = True

    def __init__(self, clock: Clock, boxes: tuple[Seen, ...]) -> None:
        self.news = Signal()
        self._clock, self._boxes = clock, boxes
        self._there: tuple[Seen, ...] = ()
        self._points_m: Floats | None = None

    @classmethod
    def connect(cls, site: Site) -> Self:
        """It is there at once."""
        return cls(site.clock, site.options.boxes)

    @property
    def points_m(self) -> Floats | None:
        """The same array for as long as it sees the same."""
        there = tuple(box for box in self._boxes if 0.0 <= self._clock.now_s - box.from_s < box.for_s)
        if there != self._there:
            self._there = there
            self._points_m = np.vstack([box.points_m for box in there]) if there else None
        return self._points_m

    def stop(self) -> None:
        """Nothing of it moves."""

    def close(self) -> None:
        """Nor is it open."""

    def health(self) -> dict[str, str]:
        """How much it sees now."""
        return {"sees": "nothing" if self.points_m is None else f"{len(self.points_m)} points"}
