"""The part of a motion that one device follows, if the motion has more axes than the device.

Arm and roller follow parts of one motion. Told to stop at the same moment, both come to rest by the same law.

Angles [rad], times [s].
"""

from typing import Protocol

import numpy as np

from scuhand_bt.motion.kinematics import Floats
from scuhand_bt.motion.trajectory import JointTrajectory


class Sampled(Protocol):
    """Has a position at every time."""

    def sample(self, time_s: float) -> Floats: ...


class Course(Sampled, Protocol):
    """A motion of all axes, or its stop."""

    @property
    def duration_s(self) -> float: ...

    def stopped_from(self, at_s: float) -> "Course": ...


class SomeAxes:
    """Some axes of a larger motion, for one device. If stopped at the same moment, all parts stop alike."""

    def __init__(self, whole: Course, axes: slice, zero_rad: float = 0.0) -> None:
        self._whole, self._axes, self._zero_rad = whole, axes, zero_rad

    @property
    def duration_s(self) -> float:
        return self._whole.duration_s

    def sample(self, time_s: float) -> Floats:
        sampled: Floats = self._whole.sample(time_s)[self._axes] - self._zero_rad
        return sampled

    def at(self, times_s: Floats) -> Floats:
        """Positions at many times (m,): (m, n)."""
        return at_times(self._whole, times_s)[:, self._axes] - self._zero_rad

    def stopped_from(self, at_s: float) -> "SomeAxes":
        return SomeAxes(self._whole.stopped_from(at_s), self._axes, self._zero_rad)

    def counted_from(self, zero_rad: float) -> "SomeAxes":
        """The same, with angles counted from another zero."""
        return SomeAxes(self._whole, self._axes, self._zero_rad + zero_rad)


def at_times(course: Sampled, times_s: Floats) -> Floats:
    """Positions of a course at many times (m,): (m, n). Vectorised for our own motions."""
    if isinstance(course, JointTrajectory | SomeAxes):
        return course.at(times_s)
    return np.array([course.sample(time_s) for time_s in times_s.tolist()])


def of_arm(whole: Course) -> SomeAxes:
    """The arm's part of a stroke."""
    return SomeAxes(whole, slice(0, -1))


def of_roller(whole: Course) -> SomeAxes:
    """The roller's part of a stroke, counted from the flat sheet."""
    return SomeAxes(whole, slice(-1, None))
