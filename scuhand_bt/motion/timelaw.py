"""The time law: the shortest jerk-limited motion between states, by Ruckig.

    |q'| <= v,  |q''| <= a,  |q'''| <= j      for each joint;  all joints start and end together

From rest to rest over a distance D the optimum has a closed form (if a^2/j <= v):

    T = D/v + v/a + a/j                     D >= v (v/a + a/j)       full speed is reached
    T = a/j + sqrt((a/j)^2 + 4 D/a)         D >= 2 a^3/j^2           full acceleration is reached
    T = 4 (D / 2j)^(1/3)                    otherwise

The slowest joint's T is Ruckig's result, too. It ranks hundreds of goals at once, and is the lower bound (*bound*) of
every motion between the same ends, whatever its path. q [rad], v [rad/s], a [rad/s^2], j [rad/s^3], T [s]. Berscheid
and Kröger, "Jerk-limited real-time trajectory generation with arbitrary target states", RSS 2021.
"""

import math
from dataclasses import dataclass

import numpy as np
from ruckig import InputParameter, Result, Ruckig, RuckigError, Synchronization, Trajectory

from scuhand_bt.motion.kinematics import Floats
from scuhand_bt.motion.trajectory import JointTrajectory, joined, of_jerk_steps

_SHORTEST_S = 1e-9


@dataclass(frozen=True, slots=True)
class RateLimits:
    """Largest speed, acceleration and jerk of each coordinate, (n,) each."""

    speed: Floats
    acceleration: Floats
    jerk: Floats

    def stretch_for(self, trajectory: JointTrajectory) -> float:
        """How many times slower a motion must be to keep these limits; below 1 it could be quicker."""
        speed, acceleration, jerk = trajectory.extremes()
        return max(
            float((speed / self.speed).max()),
            math.sqrt((acceleration / self.acceleration).max()),
            math.cbrt((jerk / self.jerk).max()),
        )


def rest_to_rest_s(distances: Floats, limits: RateLimits) -> Floats:
    """Duration of the optimum from rest to rest over distances (..., n): (...)."""
    longest: Floats = joint_rest_to_rest_s(distances, limits).max(axis=-1)
    return longest


def joint_rest_to_rest_s(distances: Floats, limits: RateLimits) -> Floats:
    """Each joint's own optimum from rest to rest over distances (..., n): (..., n)."""
    t1, t2, t3 = _phases_s(distances, limits)
    return 4 * t1 + 2 * t2 + t3


def _phases_s(distances: Floats, limits: RateLimits) -> tuple[Floats, Floats, Floats]:
    """Phases of each joint's optimum from rest to rest: at full jerk, acceleration and speed, (..., n) each."""
    d = np.abs(distances)
    # If the speed limit is reached before the acceleration limit, the acceleration only reaches sqrt(v j).
    v, j = limits.speed, limits.jerk
    a = np.minimum(limits.acceleration, np.sqrt(v * j))
    whole_s = a / j + np.sqrt((a / j) ** 2 + 4 * d / a)
    full_speed, full_acceleration = d >= v * (v / a + a / j), d >= 2 * a**3 / j**2
    t1 = np.where(full_acceleration | full_speed, a / j, np.cbrt(d / (2 * j)))
    t2 = np.where(full_speed, v / a - a / j, np.where(full_acceleration, whole_s / 2 - 2 * a / j, 0.0))
    t3 = np.where(full_speed, d / v - (v / a + a / j), 0.0)
    return t1, t2, t3


_SIGNS = np.array([1.0, -1.0, -1.0, 1.0, -1.0, 1.0, 1.0, -1.0])


def legs(distances: Floats, limits: RateLimits) -> tuple[Floats, Floats, Floats]:
    """Each joint's own optimum from rest to rest over distances (..., n), as eight jerk steps.

    Returns times and steps (..., n, 8) and durations (..., n): jerk for t1, none for t2, opposite for t1, none for t3
    at the highest speed, and all of it again with the other sign.
    """
    t1, t2, t3 = _phases_s(distances, limits)
    times_s = np.zeros((*t1.shape, 8))
    times_s[..., 1] = t1
    times_s[..., 2] = t1 + t2
    times_s[..., 3] = 2 * t1 + t2
    times_s[..., 4:] = times_s[..., :4] + (2 * t1 + t2 + t3)[..., None]
    return times_s, (np.sign(distances) * limits.jerk)[..., None] * _SIGNS, times_s[..., 7]


class TimeLaw:
    """Ruckig for n coordinates, with the checks that it lacks, and its input kept for reuse.

    Ruckig reads past its vectors, or ends the process, if their length is wrong, so every length is checked here. It
    does not limit positions (its community version ignores those fields), so callers must.
    """

    def __init__(self, limits: RateLimits) -> None:
        self.limits = limits
        self.size = len(limits.speed)
        if not (len(limits.acceleration) == len(limits.jerk) == self.size):
            raise ValueError("speed, acceleration and jerk limits differ in length")
        self._ruckig = Ruckig(self.size)
        self._input = InputParameter(self.size)
        self._input.max_velocity = limits.speed.tolist()
        self._input.max_acceleration = limits.acceleration.tolist()
        self._input.max_jerk = limits.jerk.tolist()
        # From rest to rest this gives a straight line; else Ruckig falls back to a common duration.
        self._input.synchronization = Synchronization.Phase

    def solve(self, q0: Floats, v0: Floats, q1: Floats, v1: Floats) -> Trajectory | None:
        """Ruckig's trajectory between two states without acceleration; None if it finds none."""
        for vector in (q0, v0, q1, v1):
            if vector.shape != (self.size,):
                raise ValueError(f"a state of {self.size} coordinates is needed, not of shape {vector.shape}")
        given = self._input
        given.current_position, given.current_velocity = q0.tolist(), v0.tolist()
        given.target_position, given.target_velocity = q1.tolist(), v1.tolist()
        trajectory = Trajectory(self.size)
        try:
            result = self._ruckig.calculate(given, trajectory)
        except RuckigError:
            return None
        return trajectory if result in (Result.Working, Result.Finished) else None

    def pieces(self, points: Floats, speeds: Floats) -> list[Trajectory] | None:
        """The optima from point to point (m, n), with speeds (m, n) there; None if one fails."""
        solved = []
        for k in range(len(points) - 1):
            piece = self.solve(points[k], speeds[k], points[k + 1], speeds[k + 1])
            if piece is None:
                return None
            solved.append(piece)
        return solved

    def straight(self, points: Floats) -> JointTrajectory:
        """Exactly along a polyline (m, n), at rest in every vertex."""
        return joined([self._straight_leg(points[k], points[k + 1]) for k in range(len(points) - 1)])

    def _straight_leg(self, q0: Floats, q1: Floats) -> JointTrajectory:
        distances = q1 - q0
        share = np.maximum(np.abs(distances), 1e-12)
        limits = (self.limits.speed, self.limits.acceleration, self.limits.jerk)
        one = RateLimits(*(np.array([(limit / share).min()]) for limit in limits))
        times_s, steps, duration_s = legs(np.ones(1), one)
        course = of_jerk_steps(np.zeros(1), times_s, steps, float(duration_s[0]))
        coefficients = course.coefficients * distances
        coefficients[0] += q0
        return JointTrajectory(course.knots_s, coefficients)


def cubics(pieces: list[Trajectory]) -> JointTrajectory:
    """Ruckig's profiles as one piecewise-cubic motion.

    Ruckig ends a profile up to 1e-8 rad from its target. That does not matter at the end of a motion. But a piece that
    began at the target would be a jump, which over a millisecond is a jerk of 20 rad/s^3. So each piece begins where
    the one before it ends.
    """
    parts: list[JointTrajectory] = []
    for piece in pieces:
        if piece.duration > _SHORTEST_S:
            part = _cubics_of(piece)
            parts.append(part.begun_at(parts[-1].end) if parts else part)
    return joined(parts)


def _cubics_of(solved: Trajectory) -> JointTrajectory:
    profiles = solved.profiles[0]
    begins = np.zeros((len(profiles), 8))
    begins[:, 1:] = np.cumsum([profile.t for profile in profiles], axis=1)
    p, v, a = (np.array([getattr(profile, name) for profile in profiles])[:, :7] for name in "pva")
    j = np.array([profile.j for profile in profiles])
    knots_s = np.unique(np.append(begins.ravel(), solved.duration))
    knots_s = knots_s[knots_s <= solved.duration + _SHORTEST_S]
    knots_s = np.append(knots_s[:-1][np.diff(knots_s) > _SHORTEST_S], solved.duration)
    knots_s[0] = 0.0
    middles_s = (knots_s[:-1] + knots_s[1:]) / 2
    piece = np.minimum((middles_s[None, :, None] >= begins[:, None, 1:]).sum(axis=2), 6)
    joint = np.arange(len(profiles))[:, None]
    u = knots_s[None, :-1] - begins[joint, piece]
    p, v, a, j = p[joint, piece], v[joint, piece], a[joint, piece], j[joint, piece]
    coefficients = np.stack([p + u * (v + u * (a / 2 + u * j / 6)), v + u * (a + u * j / 2), (a + u * j) / 2, j / 6])
    return JointTrajectory(knots_s, np.ascontiguousarray(coefficients.transpose(0, 2, 1)))
