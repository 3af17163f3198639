"""The coordinates in which a path is planned: the joints, or level coordinates, which hold a cone level.

Empty cone: c = q. Loaded cone: the last two joints serve the cone's axis u, and the rest is planned,

    c = (q1, q2, q3, q4, q5, ux, uy),       Ry(-q6) Rz(q7) a = v = R(q1..q5)^T u

So a straight line between two level configurations is level throughout. With a as in `kinematics`,

    sin(lean) sin(azimuth + q7) = vy

Of the two solutions the one with cos(azimuth + q7) < 0 is taken, in which the cone lies above its handle. Then q6
rotates (sin(lean) cos(azimuth + q7), -cos(lean)) to (vx, vz). Nothing is singular nearby: q6 may pass through zero.
There is no solution where |vy| > sin(lean).

q [rad] and c have the shape (n, 7); u is the unit axis, ux and uy its horizontal components.
"""

import math
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from scuhand_bt.motion.decomposed import AxisLevel
from scuhand_bt.motion.kinematics import LIMITS_RAD, Floats, Mount, apex_positions_m
from scuhand_bt.motion.timelaw import RateLimits

_NOWHERE_RAD = 9.0
"""Joint 7 where there is no solution: outside its limits, so that nothing is free there."""
_AXIS_RATES = (1.0, 4.0, 40.0)
"""Limits of the axis' components: speed [1/s], acceleration [1/s^2], jerk [1/s^3]."""


class Coordinates(Protocol):
    """Planning coordinates and their map to the joints."""

    rates: RateLimits
    scatter: Floats
    """Relative standard deviation of random points, by coordinate: (7,)."""

    def joints(self, c: Floats) -> Floats:
        """Coordinates (n, 7) to joints (n, 7)."""
        ...

    def of(self, q: Floats) -> Floats:
        """Joints (n, 7) to coordinates (n, 7)."""
        ...

    def covers(self, q: Floats) -> NDArray[np.bool_]:
        """Which of the configurations (n, 7) these coordinates can represent: (n,)."""
        ...

    def draw(self, rng: np.random.Generator) -> Floats:
        """A random point (7,) to grow a tree towards."""
        ...


class JointCoordinates:
    """The joints themselves. With `level` coordinates, random points are level."""

    def __init__(self, rates: RateLimits, limits_rad: Floats, level: Coordinates | None = None) -> None:
        self.rates = rates
        self.scatter = np.ones(len(rates.speed))
        self.level = level
        self._limits_rad = limits_rad

    def joints(self, c: Floats) -> Floats:
        return c

    def of(self, q: Floats) -> Floats:
        return q

    def covers(self, q: Floats) -> NDArray[np.bool_]:
        return np.ones(len(q), dtype=bool)

    def draw(self, rng: np.random.Generator) -> Floats:
        if self.level is not None:
            level: Floats = self.level.joints(self.level.draw(rng)[None, :])[0]
            return level
        c: Floats = rng.uniform(self._limits_rad[0], self._limits_rad[1])
        return c


def level_coordinates(rates: RateLimits, mount: Mount, start: Floats) -> Coordinates:
    """Coordinates in which a straight line keeps the cone level, for an arm that begins at `start` (7,)."""
    return LevelCoordinates(rates, mount) if mount.arm is None else AxisLevel(rates, mount, start)


class LevelCoordinates:
    """The first five joints and the cone's axis, with the cone above its handle."""

    def __init__(self, rates: RateLimits, mount: Mount) -> None:
        limits = np.stack([rates.speed, rates.acceleration, rates.jerk])
        limits[:, 5:] = np.array(_AXIS_RATES)[:, None]
        self.rates = RateLimits(*limits)
        self.scatter = np.array([1.0, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0])
        self._mount = mount

    def joints(self, c: Floats) -> Floats:
        cosine, sine = np.cos(c[:, :5]), np.sin(c[:, :5])
        x, y = c[:, 5], c[:, 6]
        z = np.sqrt(np.maximum(0.0, 1 - x * x - y * y))
        for joint in range(5):
            cj, sj = cosine[:, joint], sine[:, joint]
            if joint % 2 == 0:
                x, y = cj * x + sj * y, cj * y - sj * x
            else:
                x, z = cj * x + sj * z, cj * z - sj * x
        level, high = math.sin(self._mount.lean_rad), math.cos(self._mount.lean_rad)
        beside = y / level
        forward = -level * np.sqrt(np.maximum(0.0, 1 - beside * beside))
        q = c.copy()
        q[:, 5] = _wrapped(np.arctan2(z, x) - np.arctan2(-high, forward))
        turned = _wrapped(math.pi - np.arcsin(np.clip(beside, -1.0, 1.0)) - self._mount.azimuth_rad)
        q[:, 6] = np.where(np.abs(beside) > 1, _NOWHERE_RAD, turned)
        return q

    def of(self, q: Floats) -> Floats:
        c = q.copy()
        c[:, 5:] = apex_positions_m(q, self._mount)[1][:, :2]
        return c

    def covers(self, q: Floats) -> NDArray[np.bool_]:
        covered: NDArray[np.bool_] = np.cos(q[:, 6] + self._mount.azimuth_rad) < 0
        return covered

    def draw(self, rng: np.random.Generator) -> Floats:
        # Of sixteen random arms, the first that can hold the cone level, which most cannot.
        c = rng.uniform(LIMITS_RAD[0], LIMITS_RAD[1], (16, len(LIMITS_RAD[0])))
        c[:, 5:] = 0.0
        q = self.joints(c)
        within = ((q >= LIMITS_RAD[0]) & (q <= LIMITS_RAD[1])).all(axis=1)
        drawn: Floats = c[int(np.argmax(within))]
        return drawn


def _wrapped(angle: Floats) -> Floats:
    """Angles wrapped to -pi..pi."""
    wrapped: Floats = (angle + math.pi) % (2 * math.pi) - math.pi
    return wrapped
