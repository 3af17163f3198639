"""Servos that move together, and the motion that they are on.

Everything moves by streaming: a motion is a function from time to joint angles, sampled in every cycle.
A stop is a motion too: the one under way tells how it comes to rest along its path (`motion/stopping.py`), and is
replaced by that.
"""

import threading
from collections.abc import Callable, Sequence

import numpy as np

from scuhand_bt.devices.arguments import HALF_COUNT_RAD
from scuhand_bt.devices.dynamixel.axes import Axis, AxisState
from scuhand_bt.devices.interfaces import Joints, Trajectory
from scuhand_bt.failures import Code, SkillFailed

STOP_LEAD_S = 0.05
"""A stop is found for a moment so far ahead, on the caller's thread, while the motion goes on: it takes 3 to 40 ms."""
SPEEDING_UP_S = 0.25
"""From rest to full speed along the path, after a pause of this computer."""


class AxisGroup:
    """Servos that move together: the arm, or the roller alone."""

    def __init__(
        self, axes: Sequence[Axis], watched: bool = True, was_without_torque: Callable[[], None] = lambda: None
    ) -> None:
        self.axes = list(axes)
        self.watched = watched
        """Stopped when the run's tick hangs; the roller may go on while the next motion is planned."""
        self.was_without_torque = was_without_torque
        """Told of a servo that has none, before that is given some: what it counted may be lost."""
        self.states: list[AxisState] = [AxisState(axis) for axis in axes]
        self.goals_rad: Joints = np.zeros(len(axes))
        self.fault: SkillFailed | None = None
        """Why the last motion ended early, or what has happened to the servos since, at rest."""
        self._motion: Trajectory | None = None
        self._at_s = 0.0
        self._rate = 1.0
        self._lock = threading.Lock()

    @property
    def positions_rad(self) -> Joints:
        return np.array([state.position_rad for state in self.states])

    @property
    def is_moving(self) -> bool:
        """A motion is under way, or a servo still turns."""
        return self._motion is not None or not all(state.is_still for state in self.states)

    @property
    def is_streaming(self) -> bool:
        return self._motion is not None

    def move(self, motion: Trajectory) -> None:
        """Begin a motion; takes the place of one that is under way."""
        with self._lock:
            self.fault = None
            self._motion, self._at_s, self._rate = motion, 0.0, 1.0

    def stop(self) -> None:
        """Come to rest along the path, as the motion tells."""
        with self._lock:
            motion, now_s = self._motion, self._at_s
        lead_s = STOP_LEAD_S
        while motion is not None:
            from_s = now_s + lead_s
            stopped = motion.stopped_from(from_s)  # without the lock: the motion goes on meanwhile
            with self._lock:
                if self._motion is not motion:
                    return  # it has ended, or stops already
                now_s = self._at_s
                if now_s <= from_s:
                    self._motion = stopped
                    return
            lead_s *= 2.0  # a busy computer: the moment that the stop was found for has passed

    def rest(self) -> None:
        """Stand still for a moment, and come up to speed again from here."""
        with self._lock:
            self._rate = 0.0

    def freeze(self, fault: SkillFailed) -> None:
        """End the motion at once, where the servos are."""
        with self._lock:
            self.fault, self._motion = fault, None
            self.goals_rad = self.positions_rad

    def advance(self, dt_s: float) -> None:
        """Go on along the path by `dt_s`; ends the motion at its end."""
        with self._lock:
            if self._motion is None:
                return
            self._rate = min(1.0, self._rate + dt_s / SPEEDING_UP_S)
            self._at_s += self._rate * dt_s
            duration_s = self._motion.duration_s
            self.goals_rad = np.asarray(self._motion.sample(min(self._at_s, duration_s)), dtype=float)
            if self._at_s >= duration_s:
                self._motion = None

    def goal_of(self, axis: Axis) -> float:
        """The present goal of one of its servos [rad]."""
        return float(self.goals_rad[self.axes.index(axis)])

    def beyond(self) -> SkillFailed | None:
        """The goal that is beyond its servo's window, if there is one."""
        for state, goal in zip(self.states, self.goals_rad, strict=True):
            low, high = state.window_rad
            if not low - HALF_COUNT_RAD < goal < high + HALF_COUNT_RAD:
                what = f"{state.axis.name} would go to {np.degrees(goal):.1f}°"
                window = f"{np.degrees(low):.1f}..{np.degrees(high):.1f}°"
                return SkillFailed(Code.ARM_JOINT_LIMIT, f"{what}, but servo {state.axis.servo} allows only {window}")
        return None
