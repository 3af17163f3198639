"""The simulated arm: it is where its trajectory says, at every moment."""

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from scuhand_bt.clock import Clock, Signal, Steps, Wake
from scuhand_bt.devices.interfaces import Joints, Trajectory
from scuhand_bt.failures import SkillFailed
from scuhand_bt.motion.kinematics import Floats, apex

START_TOLERANCE_RAD = 0.01


class Pose(Protocol):
    """Where the apex is [m], shape (3,), and the cone's up axis, shape (3,)."""

    @property
    def position_m(self) -> Floats: ...

    @property
    def axis(self) -> Floats: ...


class SimulatedArm:
    """The seven joints; see `scuhand_bt.devices.interfaces.Arm`."""

    def __init__(
        self, clock: Clock, apex_offset_m: float, joints: Joints, apex_of: Callable[[Joints], Pose] | None = None
    ) -> None:
        self.news = Signal()
        self._clock = clock
        self._apex_of = apex_of or (lambda q: apex(q, apex_offset_m))
        self._rest: Joints = np.array(joints, dtype=float)
        self._pose: Pose | None = None
        self._trajectory: Trajectory | None = None
        self._begin_s = self._end_s = 0.0

    @property
    def positions(self) -> Joints:
        return self._at(self._clock.now_s).copy()

    @property
    def is_stopped(self) -> bool:
        return self._trajectory is None

    def stop(self) -> None:
        self._hold(self._at(self._clock.now_s))

    def start(self, trajectory: Trajectory) -> None:
        """Begin; SkillFailed arm.not_following if it does not start where the arm is."""
        now_s = self._clock.now_s
        apart_rad = float(np.abs(trajectory.sample(0.0) - self._at(now_s)).max())
        if apart_rad > START_TOLERANCE_RAD:
            raise SkillFailed("arm.not_following", f"the motion starts {apart_rad:.3f} rad from where the arm is")
        self._trajectory = trajectory
        self._begin_s, self._end_s = now_s, now_s + trajectory.duration_s

    def follow(self, trajectory: Trajectory) -> Steps[None]:
        self.start(trajectory)
        while self._trajectory is trajectory:
            yield Wake.on(self.news, self._end_s)

    @property
    def is_active(self) -> bool:
        return self._trajectory is not None

    def advance(self, end_s: float) -> None:
        """Go on to this time; the end of the motion is told."""
        if self._trajectory is not None and end_s >= self._end_s - 1e-9:
            self._hold(self._trajectory.sample(self._trajectory.duration_s))
            self.news.fire()

    def held_at(self, time_s: float) -> list[float]:
        """Where the joints [rad] would be held if its servos heard nothing more from this time on."""
        joints: list[float] = self._at(time_s).tolist()
        return joints

    def hold(self, joints: Sequence[float]) -> None:
        """Stand still there."""
        self._hold(np.array(joints))

    def pose(self, time_s: float) -> Pose:
        """The apex's pose at a time not before now."""
        if self._trajectory is not None:
            return self._apex_of(self._at(time_s))
        if self._pose is None:
            self._pose = self._apex_of(self._rest)
        return self._pose

    def _at(self, time_s: float) -> Joints:
        if self._trajectory is None:
            return self._rest
        return self._trajectory.sample(time_s - self._begin_s)

    def _hold(self, joints: Joints) -> None:
        self._rest = np.array(joints, dtype=float)
        self._trajectory = self._pose = None
