"""From a course in the planning coordinates to a proven motion of the joints.

A course is proven when its joints keep their rates and positions, its samples are free so closely that nothing can
touch in between (`collision`), and the load's spill angle stays within its limit (`spill`). What is too quick for the
joints or the load is slowed until it is not; what cannot be proven is None.

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
"""A course that the joints must be so many times slower for turns the wrist past its singularity: it is not used."""
_FIRST_LOOK = (np.arange(20) + 0.5) / 20
"""The moments, as shares of a course's duration, that are looked at before it is put into the joints' own cubics."""
_ROUNDING = 1e-6
"""Of positions, speeds and accelerations where two cubics meet, and of limits that are just kept."""


def is_whole(motion: JointTrajectory, rates: RateLimits, mount: Mount, spill_limit_deg: float | None) -> bool:
    """Whether cubics of unknown origin are one motion of the joints from rest to rest within all its limits.

    What they touch is looked at elsewhere.
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

    `rates` are the joints' limits; `spill_limit_deg` the load's, None for an empty cone.
    """

    def __init__(self, space: Space, rates: RateLimits, mount: Mount, spill_limit_deg: float | None) -> None:
        self.space = space
        self.law = TimeLaw(space.coordinates.rates)
        self._rates = rates
        self.mount = mount
        self._spill_deg = spill_limit_deg

    def proven(self, course: JointTrajectory, quicker_than_s: float = np.inf) -> JointTrajectory | None:
        """The course as a motion of the joints, as slow as it must be; None if it is not free, or not quicker."""
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
        """Whether a few moments of a course are hit already: most are, and what follows costs fifty times as much."""
        some = self.space.coordinates.joints(course.at(_FIRST_LOOK * course.duration_s))
        return bool(self.space.first_look(some).any()) or self.space.scene.any_hit(some)

    def direct(self, start: Floats, end: Floats) -> JointTrajectory | None:
        """The optimum from rest to rest along the line, if it is proven."""
        if self._follows_lines and not self.space.free(start, end):
            return None
        return self.along(np.array([start, end]))

    def along(self, free_lines: Floats) -> JointTrajectory | None:
        """At rest in every vertex of a polyline (m, 7), exactly along lines that are known to be free."""
        course = self.law.straight(free_lines)
        if self._follows_lines:
            return course
        # In other coordinates it is looked at anyway.
        is_looked_at = isinstance(self.space.coordinates, JointCoordinates) and self._looks_hit(course)
        return None if is_looked_at else self.proven(course)

    @property
    def _follows_lines(self) -> bool:
        """Whether a motion along straight lines of the coordinates is proven as soon as the lines are."""
        return isinstance(self.space.coordinates, JointCoordinates) and self._spill_deg is None
