"""Coming to rest along the path: from any moment of a motion, without leaving what was proven free.

    q(t) = Q(s(t)),     s' = 1 at first, 0 at the end
    q''  = Q'' s'^2 + Q' s''
    q''' = Q''' s'^3 + 3 Q'' s' s'' + Q' s'''

Q is the motion under way, s [s] its own time. After a delay, s' is brought to zero over a time T as
s'(x) = 1 - 10 x^3 + 15 x^4 - 6 x^5, x in 0..1, which runs over T/2 of the motion. Of all delays and
times on a grid the earliest end is taken that keeps the load's spill angle and the joints' limits, of
which a stop may use more than a plan does: a motion that is at its limits already could not be slowed
at all otherwise. Where nothing ends sooner than the motion itself, the motion is followed to its end.

Joints [rad], times [s].
"""

import math
from functools import cached_property

import numpy as np

from scuhand_bt.motion.kinematics import Floats
from scuhand_bt.motion.spill import apex_motion, worst_spill_deg
from scuhand_bt.motion.timelaw import RateLimits
from scuhand_bt.motion.trajectory import JointTrajectory

HARDER = 2.0
"""Acceleration a stop may use, over the plan's; 8.8 rad/s^2 takes about 1.5 of the servos' 4 to 10 N m."""
JERKIER = 4.0
"""Jerk a stop may use, over the plan's."""
_DELAYS_S = np.arange(0.0, 0.61, 0.04)
_BRAKING_S = np.geomspace(0.08, 3.0, 28)
_SAMPLES = 120
_TOLERANCE = 1e-9


class Stop:
    """A motion from `at_s` on that comes to rest on its own path."""

    def __init__(self, motion: JointTrajectory, at_s: float, delay_s: float, braking_s: float) -> None:
        self._motion = motion
        self._at_s = at_s
        self._delay_s = delay_s
        self._braking_s = braking_s
        self.spill_limit_deg = motion.spill_limit_deg

    @property
    def duration_s(self) -> float:
        return self._delay_s + self._braking_s

    def sample(self, time_s: float) -> Floats:
        """Joint positions [rad] at a time since the stop was asked for, shape (7,); clamped to the ends."""
        time_s = min(max(time_s, 0.0), self.duration_s)
        return self._motion.sample(float(self.course(np.array([time_s]))[0][0]))

    @cached_property
    def end(self) -> Floats:
        """Where it comes to rest, shape (7,)."""
        return self.sample(self.duration_s)

    def course(self, times_s: Floats) -> Floats:
        """s and its first three derivatives at times (n,): shape (4, n)."""
        x = np.clip((times_s - self._delay_s) / self._braking_s, 0.0, 1.0)
        before_s = np.minimum(times_s, self._delay_s)
        run_s = self._braking_s * (x - 2.5 * x**4 + 3 * x**5 - x**6)
        return np.stack(
            [
                self._at_s + before_s + run_s,
                1 - x**3 * (10 - 15 * x + 6 * x * x),
                -(x**2) * (30 - 60 * x + 30 * x * x) / self._braking_s,
                -x * (60 - 180 * x + 120 * x * x) / self._braking_s**2,
            ]
        )

    def at(self, times_s: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Position, speed, acceleration and jerk at times (n,): (n, 7) each."""
        s, s1, s2, s3 = self.course(times_s)[:, :, None]
        q, q1, q2, q3 = (self._motion.at(s[:, 0], k) for k in range(4))
        return q, q1 * s1, q2 * s1**2 + q1 * s2, q3 * s1**3 + 3 * q2 * s1 * s2 + q1 * s3


class Rest:
    """What is left of a motion: the stop where none comes sooner than the motion's own end."""

    def __init__(self, motion: JointTrajectory, at_s: float) -> None:
        self._motion = motion
        self._at_s = at_s

    @property
    def duration_s(self) -> float:
        return self._motion.duration_s - self._at_s

    @property
    def end(self) -> Floats:
        """Where it comes to rest, shape (7,)."""
        return self._motion.end

    def sample(self, time_s: float) -> Floats:
        """Joint positions [rad] at a time since the stop was asked for, shape (7,); clamped to the ends."""
        return self._motion.sample(self._at_s + max(time_s, 0.0))


def stop(motion: JointTrajectory, at_s: float, rates: RateLimits, apex_offset_m: float) -> Stop | Rest:
    """The soonest stop from `at_s` of a motion, along its path and within its limits."""
    if not math.isfinite(at_s):
        raise ValueError(f"a stop begins at a moment of the motion, not at {at_s!r} s")
    at_s = min(max(at_s, 0.0), motion.duration_s)
    left_s = motion.duration_s - at_s
    delays_s, brakings_s = (grid.ravel() for grid in np.meshgrid(_DELAYS_S, _BRAKING_S))
    ends_s = delays_s + brakings_s
    # Braking runs over half its time of the motion, which must not end before.
    possible = (delays_s + brakings_s / 2 < left_s) & (ends_s < left_s)
    for k in np.argsort(ends_s, kind="stable"):
        if possible[k]:
            candidate = Stop(motion, at_s, float(delays_s[k]), float(brakings_s[k]))
            if _keeps(candidate, rates, apex_offset_m):
                return candidate
    return Rest(motion, at_s)


def _keeps(candidate: Stop, rates: RateLimits, apex_offset_m: float) -> bool:
    q, speed, acceleration, jerk = candidate.at(np.linspace(0.0, candidate.duration_s, _SAMPLES))
    allowed = (rates.speed, HARDER * rates.acceleration, JERKIER * rates.jerk)
    for values, limits in zip((speed, acceleration, jerk), allowed, strict=True):
        if (np.abs(values) > limits + _TOLERANCE).any():
            return False
    if candidate.spill_limit_deg is None:
        return True
    return worst_spill_deg(*apex_motion(q, speed, acceleration, apex_offset_m)) <= candidate.spill_limit_deg
