"""From a course in planning coordinates to a proven motion of the joints.

A course is proven if its joints keep their rate and position limits, and the load's spill angle keeps its limit
(`spill`). Its samples must be free, and so dense that nothing can touch in between (`collision`). A course that is too
quick for joints or load is slowed. The result is None if it cannot be proven.

Planning coordinates (7,), times [s].
"""

import numpy as np

from scuhand_bt.motion.coordinates import JointCoordinates
from scuhand_bt.motion.free_space import Space
from scuhand_bt.motion.kinematics import Floats, Mount
from scuhand_bt.motion.spill import spill_stretch
from scuhand_bt.motion.timelaw import RateLimits, TimeLaw
from scuhand_bt.motion.trajectory import JointTrajectory, through

_GRID_S = 0.01
_SLOWER = 8.0
"""A course that the joints would have to follow so many times slower passes the wrist's singularity, and is dropped."""
_FIRST_LOOK = (np.arange(20) + 0.5) / 20
"""Sample times, as shares of the duration, that are tested before a course is converted to cubics of the joints."""
_ROUNDING = 1e-6
"""Tolerance for rounding: of positions, speeds and accelerations where two cubics meet, and of limits."""


def is_whole(motion: JointTrajectory, rates: RateLimits, mount: Mount, spill_limit_deg: float | None) -> bool:
    """Whether cubics of unknown origin are one motion of the joints, from rest to rest, within all its limits.

    Contacts are checked elsewhere.
    """
    if motion.coefficients.shape[2] != len(rates.speed) or rates.stretch_for(motion) > 1 + _ROUNDING:
        return False
    h = np.diff(motion.knots_s)[:, None]
    c0, c1, c2, c3 = motion.coefficients
    ends = c0 + h * (c1 + h * (c2 + h * c3)), c1 + h * (2 * c2 + 3 * h * c3), 2 * c2 + 6 * h * c3
    jumps = [np.abs(end[:-1] - begin[1:]).max(initial=0.0) for end, begin in zip(ends, (c0, c1, 2 * c2), strict=True)]
    if max(*jumps, np.abs(c1[0]).max(), np.abs(ends[1][-1]).max()) > _ROUNDING:
        return False
    if spill_limit_deg is None:
        return True
    slower = spill_stretch(motion, mount, spill_limit_deg + _ROUNDING)
    return slower == 1.0


class Prover:
    """Proves motions in one space.

    `rates` are the joints' limits; `spill_limit_deg` is the load's, None for an empty cone.
    """

    def __init__(self, space: Space, rates: RateLimits, mount: Mount, spill_limit_deg: float | None) -> None:
        self.space = space
        self.law = TimeLaw(space.coordinates.rates)
        self._rates = rates
        self.mount = mount
        self._spill_deg = spill_limit_deg

    def proven(self, course: JointTrajectory, quicker_than_s: float = np.inf) -> JointTrajectory | None:
        """The course as a motion of the joints, slowed as necessary; None if it is not free, or not quicker."""
        motion = course
        if not isinstance(self.space.coordinates, JointCoordinates):
            if self._looks_hit(course):
                return None
            times_s = np.linspace(0.0, course.duration_s, int(course.duration_s / _GRID_S) + 2)
            motion = through(times_s, self.space.coordinates.joints(course.at(times_s)))
            slower = max(1.0, self._rates.stretch_for(motion))
            if slower > _SLOWER:
                return None
            motion = motion.stretched(slower)
        if motion.duration_s >= quicker_than_s:
            return None
        if self._spill_deg is not None:
            factor = spill_stretch(motion, self.mount, self._spill_deg, quicker_than_s)
            if factor is None:
                return None
            motion = motion.stretched(factor).keeping(self._spill_deg)
        if motion.duration_s >= quicker_than_s:
            return None
        return motion if self.space.scene.proves(motion) else None

    def _looks_hit(self, course: JointTrajectory) -> bool:
        """Whether a few samples of a course are hit, as most courses are; the full proof costs fifty times as much."""
        some = self.space.coordinates.joints(course.at(_FIRST_LOOK * course.duration_s))
        return bool(self.space.first_look(some).any()) or self.space.scene.any_hit(some)

    def direct(self, start: Floats, end: Floats) -> JointTrajectory | None:
        """The time-optimal motion from rest to rest along the line, if it is proven."""
        if self._follows_lines and not self.space.free(start, end):
            return None
        return self.along(np.array([start, end]))

    def along(self, free_lines: Floats) -> JointTrajectory | None:
        """A motion along a polyline (m, 7) whose lines are known to be free, at rest in every vertex."""
        course = self.law.straight(free_lines)
        if self._follows_lines:
            return course
        # `proven` looks itself in other coordinates.
        is_looked_at = isinstance(self.space.coordinates, JointCoordinates) and self._looks_hit(course)
        return None if is_looked_at else self.proven(course)

    @property
    def _follows_lines(self) -> bool:
        """Whether a motion along straight lines is proven if the lines are."""
        return isinstance(self.space.coordinates, JointCoordinates) and self._spill_deg is None
