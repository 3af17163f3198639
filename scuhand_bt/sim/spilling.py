"""How much powder a leaning cone holds, and how fast the rest goes over its rim.

The powder's surface may lean by the angle of repose. So a cone that leans by theta from apparent gravity holds as much
as a cone of liquid that leans by tau = max(0, theta - repose). The liquid's plane goes through the lowest point of the
rim (slant L), and cuts the opposite generator at l = L cos(alpha + tau) / cos(alpha - tau). The elliptic cone below it
has the volume

    V(tau) = V_level (l / L)^(3/2),   V_level = pi L^3 sin^2(alpha) cos(alpha) / 3,   0 from alpha + tau = 90 deg on

Beyond theta = 90 deg - alpha + delta (delta: friction on the sheet) the lower side is so steep that everything slides.
The excess decays with the time constant `POUR_TIME_S`. Angles in radians, lengths in mm.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from scuhand_bt.sim.cone_over import ConePose, Floats, cross
from scuhand_bt.specs import Powder

POUR_TIME_S = 0.15
GRAVITY_MM_PER_S2 = 9810.0
SHORTEST_S = 0.05
"""The least time for which an acceleration is computed: servos move in steps, and powder reacts more slowly."""

_UP = np.array([0.0, 0.0, GRAVITY_MM_PER_S2])


def held_mm3(half_angle: float, slant_mm: float, lean: float, repose: float, wall_friction: float) -> float:
    """The volume that a cone holds at this lean."""
    if lean >= math.pi / 2 - half_angle + wall_friction:
        return 0.0
    tau = max(0.0, lean - repose)
    if half_angle + tau >= math.pi / 2:
        return 0.0
    level_mm3 = math.pi * slant_mm**3 * math.sin(half_angle) ** 2 * math.cos(half_angle) / 3
    held: float = level_mm3 * (math.cos(half_angle + tau) / math.cos(half_angle - tau)) ** 1.5
    return held


@dataclass
class Carried:
    """The acceleration of the apex, as far as a load feels it."""

    _seen: tuple[float, Floats] | None = None
    _speed: tuple[float, Floats] | None = None
    _up: Floats = field(default_factory=_UP.copy)

    def lean(self, now_s: float, pose: ConePose) -> float:
        """The angle between the cone's axis and apparent up, with the acceleration of the last three poses taken."""
        if self._seen is None:
            self._seen = (now_s, pose.apex_mm)
        elif now_s - self._seen[0] >= SHORTEST_S:
            then_s, was_mm = self._seen
            middle_s, speed = (then_s + now_s) / 2, (pose.apex_mm - was_mm) / (now_s - then_s)
            if self._speed is not None:
                self._up = _UP + (speed - self._speed[1]) / (middle_s - self._speed[0])
            self._seen, self._speed = (now_s, pose.apex_mm), (middle_s, speed)
        return _between(pose.axis, self._up)

    def rest(self) -> None:
        """The cone stands still."""
        self._seen, self._speed, self._up = None, None, _UP


def poured_mg(held_mg: float, lean: float, pose: ConePose, powder: Powder, dt_s: float) -> float:
    """The mass that leaves a cone with this load in this time."""
    keeps_mg = powder.bulk_density_mg_per_mm3 * held_mm3(
        math.asin(pose.rim_mm / 2 / pose.slant_mm),
        pose.slant_mm,
        lean,
        math.radians(powder.repose_deg),
        math.radians(powder.wall_friction_deg),
    )
    too_much_mg = held_mg - keeps_mg
    if too_much_mg <= 0.0:
        return 0.0
    return too_much_mg if too_much_mg < 0.1 else too_much_mg * min(1.0, dt_s / POUR_TIME_S)


def _between(axis: Floats, up: Floats) -> float:
    return math.atan2(math.hypot(*cross(axis.tolist(), up.tolist())), float(axis @ up))
