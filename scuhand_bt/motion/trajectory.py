"""A motion over time as a jerk-limited motion is: piecewise cubic.

    q(t) = c0 + c1 u + c2 u^2 + c3 u^3,    u = t - t_k,    t_k <= t <= t_{k+1}

q [rad] (n,). Position, speed and acceleration are continuous at the knots t_k [s]; the jerk 6 c3 is constant in
between. So extremes of speed and acceleration are known exactly, and a motion can be stretched, reversed and joined
without sampling it.
"""

import bisect
from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np

from scuhand_bt.motion.kinematics import Floats

_SAME_S = 1e-9


class JointTrajectory:
    """A piecewise-cubic motion of n joints, which the arm follows.

    `knots_s` (k + 1,) increase strictly from 0; `coefficients` (4, k, n) have rising powers. `spill_limit_deg` is the
    limit that the motion is proven to keep, None for an empty cone.
    """

    def __init__(self, knots_s: Floats, coefficients: Floats, spill_limit_deg: float | None = None) -> None:
        if len(knots_s) != coefficients.shape[1] + 1 or knots_s[0] != 0 or not (np.diff(knots_s) > 0).all():
            raise ValueError("a trajectory's knots start at 0, increase, and enclose its cubics")
        self.knots_s = knots_s
        self.coefficients = coefficients
        self.spill_limit_deg = spill_limit_deg
        self._knots: list[float] = knots_s.tolist()

    @property
    def duration_s(self) -> float:
        return self._knots[-1]

    @cached_property
    def start(self) -> Floats:
        """Where it begins, (n,)."""
        return self.sample(0.0)

    @cached_property
    def end(self) -> Floats:
        """Where it ends, (n,)."""
        return self.sample(self.duration_s)

    def sample(self, time_s: float) -> Floats:
        """Joint positions [rad] at one time, (n,); clamped to the ends."""
        time_s = min(max(time_s, 0.0), self._knots[-1])
        k = min(bisect.bisect_right(self._knots, time_s), len(self._knots) - 1) - 1
        u, cubics = time_s - self._knots[k], self.coefficients[:, k].T.tolist()
        # For a few joints plain floats are quicker than arrays.
        return np.array([((c3 * u + c2) * u + c1) * u + c0 for c0, c1, c2, c3 in cubics])

    def at(self, times_s: Floats, derivative: int = 0) -> Floats:
        """Positions, or their 1st, 2nd or 3rd derivative, at many times within the motion: (m, n)."""
        u, (c0, c1, c2, c3) = self._cubics_at(times_s)
        value: Floats = (
            ((c3 * u + c2) * u + c1) * u + c0,
            (3 * c3 * u + 2 * c2) * u + c1,
            6 * c3 * u + 2 * c2,
            6 * c3,
        )[derivative]
        return value

    def states(self, times_s: Floats) -> tuple[Floats, Floats, Floats]:
        """Positions, speeds and accelerations at many times within the motion: (m, n) each."""
        u, (c0, c1, c2, c3) = self._cubics_at(times_s)
        return ((c3 * u + c2) * u + c1) * u + c0, (3 * c3 * u + 2 * c2) * u + c1, 6 * c3 * u + 2 * c2

    def _cubics_at(self, times_s: Floats) -> tuple[Floats, Floats]:
        k = np.clip(np.searchsorted(self.knots_s, times_s, side="right") - 1, 0, self.coefficients.shape[1] - 1)
        return (np.clip(times_s, 0.0, self.duration_s) - self.knots_s[k])[:, None], self.coefficients[:, k]

    def extremes(self) -> tuple[Floats, Floats, Floats]:
        """The largest |speed|, |acceleration| and |jerk| of each joint anywhere in the motion: (n,) each."""
        h = np.diff(self.knots_s)[:, None]
        _, c1, c2, c3 = self.coefficients
        jerk = 6 * c3
        acceleration = np.maximum(np.abs(2 * c2), np.abs(2 * c2 + jerk * h))
        speed = np.maximum(np.abs(c1), np.abs(c1 + 2 * c2 * h + 3 * c3 * h * h))
        with np.errstate(divide="ignore", invalid="ignore"):
            turn = np.where(c3 == 0, -1.0, -c2 / (3 * c3))
        inside = (turn > 0) & (turn < h)
        speed = np.where(inside, np.maximum(speed, np.abs(c1 - c2 * c2 / np.where(c3 == 0, 1.0, 3 * c3))), speed)
        return speed.max(axis=0), acceleration.max(axis=0), np.abs(jerk).max(axis=0)

    def span(self) -> tuple[Floats, Floats]:
        """The lowest and highest position of each joint anywhere in the motion: (n,) each."""
        h = np.diff(self.knots_s)[:, None]
        c0, c1, c2, c3 = self.coefficients
        # The two moments of zero speed; if there are none, any other moment within the piece does no harm.
        root = -(c2 + np.copysign(np.sqrt(np.maximum(c2 * c2 - 3 * c1 * c3, 0.0)), c2))
        with np.errstate(divide="ignore", invalid="ignore"):
            u = np.clip(np.nan_to_num(np.stack([root / (3 * c3), c1 / root])), 0.0, h)
        turns = (((c3 * u + c2) * u + c1) * u + c0).reshape(-1, c0.shape[1])
        all_ends = np.vstack([c0, self.end, turns])
        return all_ends.min(axis=0), all_ends.max(axis=0)

    def stretched(self, factor: float) -> "JointTrajectory":
        """The same path in `factor` times the duration."""
        scale = (1 / factor) ** np.arange(4)
        return JointTrajectory(self.knots_s * factor, self.coefficients * scale[:, None, None], self.spill_limit_deg)

    def reversed(self) -> "JointTrajectory":
        """The same motion backwards: speeds change their sign, accelerations do not."""
        h = np.diff(self.knots_s)[:, None]
        c0, c1, c2, c3 = self.coefficients
        ends = np.stack([c0 + h * (c1 + h * (c2 + h * c3)), -(c1 + h * (2 * c2 + 3 * h * c3)), c2 + 3 * h * c3, -c3])
        knots_s = self.duration_s - self.knots_s[::-1]
        knots_s[0] = 0.0
        return JointTrajectory(knots_s, ends[:, ::-1], self.spill_limit_deg)

    def begun_at(self, q: Floats) -> "JointTrajectory":
        """The same motion, shifted to begin at q (n,)."""
        coefficients = self.coefficients.copy()
        coefficients[0] += q - self.start
        return JointTrajectory(self.knots_s, coefficients, self.spill_limit_deg)

    def keeping(self, spill_limit_deg: float | None) -> "JointTrajectory":
        """The same motion, marked with the spill limit that it is proven to keep."""
        return JointTrajectory(self.knots_s, self.coefficients, spill_limit_deg)


def standing(q: Floats) -> JointTrajectory:
    """No motion: a millisecond at q."""
    coefficients = np.zeros((4, 1, len(q)))
    coefficients[0, 0] = q
    return JointTrajectory(np.array([0.0, 1e-3]), coefficients)


def of_jerk_steps(start: Floats, times_s: Floats, steps: Floats, duration_s: float) -> JointTrajectory:
    """From rest at `start` (n,), the motion whose jerk changes by `steps` at `times_s`: (n, k) each."""
    knots_s = np.unique(np.append(times_s[steps != 0], [0.0, duration_s]))
    knots_s = knots_s[(knots_s >= 0) & (knots_s <= duration_s)]
    # Merge knots that differ only by rounding.
    knots_s = np.append(knots_s[:-1][np.diff(knots_s) > _SAME_S], duration_s)
    knots_s[0] = 0.0
    since = np.maximum(knots_s[:-1, None, None] - times_s, 0.0)
    before = (times_s <= knots_s[:-1, None, None] + _SAME_S) * steps
    c3 = before.sum(axis=2) / 6
    c2 = (steps * since).sum(axis=2) / 2
    c1 = (steps * since**2).sum(axis=2) / 2
    c0 = start + (steps * since**3).sum(axis=2) / 6
    return JointTrajectory(knots_s, np.stack([c0, c1, c2, c3]))


def joined(parts: Sequence[JointTrajectory]) -> JointTrajectory:
    """Motions one after another; each must start where and as fast as the one before ends."""
    offsets_s = np.cumsum([0.0, *(part.duration_s for part in parts)])
    knots_s = np.concatenate([[0.0], *(part.knots_s[1:] + o for part, o in zip(parts, offsets_s, strict=False))])
    return JointTrajectory(knots_s, np.concatenate([part.coefficients for part in parts], axis=1))


def begun_later(motion: JointTrajectory, by_s: float) -> JointTrajectory:
    """The same motion after a rest of `by_s` at its start; unchanged if that is not above 0."""
    if by_s <= _SAME_S:
        return motion
    rest = standing(motion.start)
    return joined([rest.stretched(by_s / rest.duration_s), motion])


def beside(first: JointTrajectory, second: JointTrajectory) -> JointTrajectory:
    """Two motions at once, as one of all their axes; the shorter is slowed to the same duration."""
    lasts_s = max(first.duration_s, second.duration_s)
    parts = [motion.stretched(lasts_s / motion.duration_s) for motion in (first, second)]
    knots_s = np.union1d(parts[0].knots_s, parts[1].knots_s)
    knots_s = np.append(knots_s[:-1][knots_s[:-1] < lasts_s - _SAME_S], lasts_s)
    knots_s = np.append(0.0, knots_s[1:][np.diff(knots_s) > _SAME_S])
    starts = [np.hstack([part.at(knots_s[:-1], order) for part in parts]) for order in range(4)]
    return JointTrajectory(knots_s, np.stack(starts) / np.array([1.0, 1.0, 2.0, 6.0])[:, None, None])


def through(times_s: Floats, positions: Floats) -> JointTrajectory:
    """The smoothest cubics through samples (m, n) of a motion that begins and ends at rest."""
    from scipy.interpolate import CubicSpline  # takes half a second to load

    spline = CubicSpline(times_s, positions, axis=0, bc_type="clamped")
    return JointTrajectory(times_s, np.ascontiguousarray(spline.c[::-1]))


def later(motion: JointTrajectory, begin_s: float) -> Callable[[Floats], Floats]:
    """A motion's positions, as a function of times counted from one of its moments."""
    return lambda times_s: motion.at(begin_s + times_s)
