"""The coordinates a path is planned in: the joints themselves, or the arm with its cone held level.

Empty cone: c = q. Loaded cone: the wrist serves the cone's axis u and the planner moves the rest,

    c = (q1, q2, q3, q4, ux, uy, q7),       Rz(q5) Ry(-q6) z = R(q1..q4)^T (-u)

so that a straight line between two level configurations is level all along, and the two angles of the
wrist follow in closed form: q6 = +-acos(z), q5 = atan2(-+y, -+x) of the vector on the right. The sign
of q6 is the coordinates' own; a motion never changes it, as the cone would have to tip over.

q [rad] and c shape (n, 7); u the unit axis, ux and uy its horizontal components.
"""

import math
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from scuhand_bt.motion.kinematics import LIMITS_RAD, Floats, apex_positions_m
from scuhand_bt.motion.timelaw import RateLimits

_AXIS_RATES = (1.0, 4.0, 40.0)
"""Speed, acceleration and jerk of the axis' components [1/s, 1/s^2, 1/s^3]."""


class Coordinates(Protocol):
    """Planning coordinates and their map to the joints."""

    rates: RateLimits
    scatter: Floats
    """The standard deviation of random points, by coordinate: shape (7,)."""

    def joints(self, c: Floats) -> Floats:
        """Coordinates (n, 7) to joints (n, 7)."""
        ...

    def of(self, q: Floats) -> Floats:
        """Joints (n, 7) to coordinates (n, 7)."""
        ...

    def covers(self, q: Floats) -> NDArray[np.bool_]:
        """Which of the configurations (n, 7) these coordinates hold: (n,)."""
        ...

    def draw(self, rng: np.random.Generator) -> Floats:
        """One random point (7,), to grow a tree towards."""
        ...


class JointCoordinates:
    """The joints themselves; random points are level where `level` coordinates are given to draw them."""

    def __init__(self, rates: RateLimits, q_start: Floats, level: "LevelCoordinates | None" = None) -> None:
        self.rates = rates
        self.scatter = np.array([1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0])
        self._q7_rad = q_start[6]
        self._level = level

    def joints(self, c: Floats) -> Floats:
        return c

    def of(self, q: Floats) -> Floats:
        return q

    def covers(self, q: Floats) -> NDArray[np.bool_]:
        return np.ones(len(q), dtype=bool)

    def draw(self, rng: np.random.Generator) -> Floats:
        if self._level is not None:
            level: Floats = self._level.joints(self._level.draw(rng)[None, :])[0]
            return level
        c: Floats = rng.uniform(LIMITS_RAD[0], LIMITS_RAD[1])
        c[6] = self._q7_rad
        return c


class LevelCoordinates:
    """The first four joints and the cone's axis, on one side of the wrist."""

    def __init__(self, rates: RateLimits, q_start: Floats) -> None:
        limits = np.stack([rates.speed, rates.acceleration, rates.jerk])
        limits[:, 4:6] = np.array(_AXIS_RATES)[:, None]
        self.rates = RateLimits(*limits)
        self.scatter = np.array([1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
        self._side = math.copysign(1.0, q_start[5])
        self._q7_rad = q_start[6]

    def joints(self, c: Floats) -> Floats:
        cosine, sine = np.cos(c[:, :4]), np.sin(c[:, :4])
        x, y = -c[:, 4], -c[:, 5]
        z = -np.sqrt(np.maximum(0.0, 1 - x * x - y * y))
        for joint in range(4):
            cj, sj = cosine[:, joint], sine[:, joint]
            if joint % 2 == 0:
                x, y = cj * x + sj * y, cj * y - sj * x
            else:
                x, z = cj * x + sj * z, cj * z - sj * x
        q = c.copy()
        q[:, 4] = np.arctan2(-self._side * y, -self._side * x)
        q[:, 5] = self._side * np.arctan2(np.hypot(x, y), z)
        return q

    def of(self, q: Floats) -> Floats:
        _, axes = apex_positions_m(q, 0.0)
        c = q.copy()
        c[:, 4:6] = axes[:, :2]
        return c

    def covers(self, q: Floats) -> NDArray[np.bool_]:
        covered: NDArray[np.bool_] = self._side * q[:, 5] > 0
        return covered

    def draw(self, rng: np.random.Generator) -> Floats:
        # Of sixteen arms the first whose wrist can hold the cone level; most can not.
        c = rng.uniform(LIMITS_RAD[0], LIMITS_RAD[1], (16, len(LIMITS_RAD[0])))
        c[:, 4:6] = 0.0
        c[:, 6] = self._q7_rad
        q = self.joints(c)
        within = ((q >= LIMITS_RAD[0]) & (q <= LIMITS_RAD[1])).all(axis=1)
        drawn: Floats = c[int(np.argmax(within))]
        return drawn
