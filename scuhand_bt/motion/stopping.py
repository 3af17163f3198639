"""Coming to rest along the path, from any moment of a motion, without leaving what was proven free.

    q(t) = Q(s(t)),     s' = 1 at first, 0 at the end
    q''  = Q'' s'^2 + Q' s''
    q''' = Q''' s'^3 + 3 Q'' s' s'' + Q' s'''

Q is the motion under way, s [s] its own time. After a delay, s' is brought to zero over a time T as s'(x) = 1 - 10 x^3
+ 15 x^4 - 6 x^5, x in 0..1, which covers T/2 of the motion. Of all delays and times on a grid, the earliest end is
taken that keeps the load's spill angle and the limits of a stop. These are wider than a plan's, as a motion at its
limits could not be slowed otherwise. If nothing ends sooner than the motion itself, the motion is followed to its end.

Joints [rad], times [s]. Many stops of the grid are tested at once by a few samples each, and only then proven, so a
stop is found in a few milliseconds.
"""

import math
from collections.abc import Iterator
from functools import cached_property

import numpy as np

from scuhand_bt.motion.kinematics import Floats, Mount
from scuhand_bt.motion.spill import apex_motion, spill_angles_deg, worst_spills_deg
from scuhand_bt.motion.timelaw import RateLimits
from scuhand_bt.motion.torque import Torques
from scuhand_bt.motion.trajectory import JointTrajectory

HARDER = 2.0
"""Acceleration that a stop may use, relative to a plan's; but no more torque than the servos' stall torque."""
JERKIER = 4.0
"""Jerk that a stop may use, relative to a plan's."""
_DELAYS_S = np.arange(0.0, 0.61, 0.04)
_BRAKING_S = np.geomspace(0.08, 3.0, 28)
_SHARES = np.linspace(0.0, 1.0, 120)
"""When a stop is evaluated for a proof, as shares of its duration."""
_FIRST_LOOK = _SHARES[::7]
"""When it is evaluated first; what fails here would fail the proof."""
_AT_ONCE, _FEW_AT_ONCE = 48, 8
"""How many stops are tested together, and proven together; the soonest possible one is mostly among the first."""
_TOLERANCE = 1e-9
_TORQUE_GRID_S = 0.01


class StoppableTrajectory(JointTrajectory):
    """A planned motion with what its stops must keep: joint limits, the load's spill limit, the servos' stall
    torque.
    """

    def __init__(
        self, motion: JointTrajectory, rates: RateLimits, mount: Mount, torques: Torques | None = None
    ) -> None:
        super().__init__(motion.knots_s, motion.coefficients, motion.spill_limit_deg)
        self._rates = rates
        self._mount = mount
        self._torques = torques

    def stopped_from(self, at_s: float) -> "Stop":
        """The same motion up to `at_s`, and from there its soonest stop along the path, within its limits.

        `at_s` is clamped to the motion. Raises ValueError if it is not finite.
        """
        if not math.isfinite(at_s):
            raise ValueError(f"a stop begins at a moment of the motion, not at {at_s!r} s")
        at_s = min(max(at_s, 0.0), self.duration_s)
        return self._soonest(at_s) or Stop(self, at_s, math.inf, 1.0)

    def _soonest(self, at_s: float) -> "Stop | None":
        left_s = self.duration_s - at_s
        delays_s, brakings_s = (grid.ravel() for grid in np.meshgrid(_DELAYS_S, _BRAKING_S))
        # Braking for T covers T/2 of the motion, which must not end before that.
        possible = np.flatnonzero((delays_s + brakings_s / 2 < left_s) & (delays_s + brakings_s < left_s))
        possible = possible[np.argsort((delays_s + brakings_s)[possible], kind="stable")]
        for some in _parts(possible, _AT_ONCE):
            left = some[self._keeps(at_s, delays_s[some, None], brakings_s[some, None], is_proof=False)]
            for few in _parts(left, _FEW_AT_ONCE):
                proven = few[self._keeps(at_s, delays_s[few, None], brakings_s[few, None], is_proof=True)]
                stops = (Stop(self, at_s, float(delays_s[one]), float(brakings_s[one])) for one in proven)
                found = next((stop for stop in stops if self._bears(stop)), None)
                if found is not None:
                    return found
        return None

    def _bears(self, stop: "Stop") -> bool:
        """Whether the servos have the torque for a stop."""
        torques = self._torques
        if torques is None:
            return True
        times_s = np.linspace(stop.at_s, stop.duration_s, int((stop.duration_s - stop.at_s) / _TORQUE_GRID_S) + 2)
        q, speed, acceleration, _ = (values[:, : torques.joints] for values in stop.at(times_s))
        return bool((np.abs(torques.moving(q, speed, acceleration)) <= torques.stall_nm).all())

    def _keeps(self, at_s: float, delays_s: Floats, brakings_s: Floats, *, is_proof: bool) -> np.ndarray:
        """Which of n stops, delays and times (n, 1), keep all limits: (n,). Speeds are never above the motion's own.

        Only a proof evaluates all samples, and what the load may undergo between two of them.
        """
        course = _course((_SHARES if is_proof else _FIRST_LOOK) * (delays_s + brakings_s), delays_s, brakings_s)
        n = len(delays_s)
        q, speed, acceleration, jerk = _along(self, at_s, course.reshape(4, -1))
        kept = np.all(np.abs(acceleration) <= HARDER * self._rates.acceleration + _TOLERANCE, axis=1)
        kept &= np.all(np.abs(jerk) <= JERKIER * self._rates.jerk + _TOLERANCE, axis=1)
        keeps: np.ndarray = np.all(kept.reshape(n, -1), axis=1)
        if self.spill_limit_deg is not None:
            axes, accelerations = apex_motion(q, speed, acceleration, self._mount)
            if is_proof:
                worst_deg = worst_spills_deg(axes.reshape(n, -1, 3), accelerations.reshape(n, -1, 3))
            else:
                worst_deg = spill_angles_deg(axes, accelerations).reshape(n, -1).max(axis=1)
            keeps &= worst_deg <= self.spill_limit_deg
        return keeps


class Stop:
    """A motion that comes to rest on its own path from `at_s` on; the arm follows it after a stop.

    With an infinite delay the motion simply goes on to its end.
    """

    def __init__(self, motion: JointTrajectory, at_s: float, delay_s: float, braking_s: float) -> None:
        self._motion = motion
        self.at_s = at_s
        self._delay_s = delay_s
        self._braking_s = braking_s
        self.spill_limit_deg = motion.spill_limit_deg

    @property
    def duration_s(self) -> float:
        """Of the whole motion, including the part before the stop."""
        return min(self.at_s + self._delay_s + self._braking_s, self._motion.duration_s)

    def sample(self, time_s: float) -> Floats:
        """Joint positions [rad] at a time since the motion's start, (7,); clamped to its ends."""
        since_s = min(time_s, self.duration_s) - self.at_s
        return self._motion.sample(self.at_s + float(_course(np.array(since_s), self._delay_s, self._braking_s)[0]))

    def stopped_from(self, at_s: float) -> "Stop":
        """Itself: a stop is not stopped again."""
        return self

    @cached_property
    def end(self) -> Floats:
        """Where it comes to rest, (7,)."""
        return self.sample(self.duration_s)

    def at(self, times_s: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Position, speed, acceleration and jerk at times (n,) since the motion's start: (n, 7) each."""
        return _along(self._motion, self.at_s, _course(times_s - self.at_s, self._delay_s, self._braking_s))


def _parts(indices: np.ndarray, count: int) -> Iterator[np.ndarray]:
    return (indices[begin : begin + count] for begin in range(0, len(indices), count))


def _course(since_s: Floats, delay_s: Floats | float, braking_s: Floats | float) -> Floats:
    """How much of the motion has passed at times since the stop was asked for, and its first three derivatives.

    The shape is as broadcast, with a leading axis of four. Before that moment the motion's time is real time.
    """
    x = np.clip((since_s - delay_s) / braking_s, 0.0, 1.0)
    run_s = braking_s * (x - 2.5 * x**4 + 3 * x**5 - x**6)
    return np.stack(
        [
            np.minimum(since_s, delay_s) + run_s,
            1 - x**3 * (10 - 15 * x + 6 * x * x),
            -(x**2) * (30 - 60 * x + 30 * x * x) / braking_s,
            -x * (60 - 180 * x + 120 * x * x) / braking_s**2,
        ]
    )


def _along(motion: JointTrajectory, at_s: float, course: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Position, speed, acceleration and jerk (n, 7) at the points of a course (4, n) since `at_s`."""
    s, s1, s2, s3 = course[:, :, None]
    q, q1, q2, q3 = (motion.at(at_s + s[:, 0], k) for k in range(4))
    return q, q1 * s1, q2 * s1**2 + q1 * s2, q3 * s1**3 + 3 * q2 * s1 * s2 + q1 * s3
