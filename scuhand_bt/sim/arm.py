"""The simulated arm: it follows its trajectory, or the stop of that trajectory, exactly."""

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from scuhand_bt.clock import Clock, Signal, Steps, Wake
from scuhand_bt.devices.arguments import check_trajectory
from scuhand_bt.devices.interfaces import Joints, Trajectory
from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.motion.kinematics import Floats, Mount, apex
from scuhand_bt.sim.faults import Faults

SHUT_DOWN = {
    "servo.overheat": (Code.SERVO_OVERLOAD, "servo 4 (joint 3) has shut down: it is too hot"),
    "servo.overload": (Code.SERVO_OVERLOAD, "servo 4 (joint 3) has shut down on overload"),
    "arm.lost": (Code.DEVICE_LOST, "the servo bus does not answer; check its cable and supply"),
    "arm.no_power": (Code.ARM_LIMP, "no servo answers any more: they have no supply, or the line is broken"),
}
"""The faults that stop the arm, and the failure that each of them raises."""
BLOCKED = "servo.not_following"


class Pose(Protocol):
    """The apex's position [m], (3,), and the cone's axis, (3,), a unit vector from the apex out of the mouth."""

    @property
    def position_m(self) -> Floats: ...

    @property
    def axis(self) -> Floats: ...


class SimulatedArm:
    """The joints; see `scuhand_bt.devices.interfaces.Arm`.

    `mount` returns how the hand holds its cone now. It returns the same object until that changes.
    """

    def __init__(
        self, clock: Clock, mount: Callable[[], Mount], joints: Joints, apex_of: Callable[[Joints], Pose] | None = None
    ) -> None:
        self.news = Signal()
        self.on_start: Callable[[Trajectory], None] = lambda trajectory: None
        self.faults = Faults()
        """Its active faults; the world replaces it by its own."""
        self.was_limp = False
        self._is_blocked = self._was_faulty = False
        self._clock = clock
        self._mount = mount
        self._apex_of = apex_of or (lambda q: apex(q, mount()))
        self._rest: Joints = np.array(joints, dtype=float)
        self._pose: tuple[float | None, Mount, Pose] | None = None  # when (None: at rest), how the hand held its cone
        self._trajectory: Trajectory | None = None
        self._begin_s = self._end_s = 0.0

    @property
    def positions(self) -> Joints:
        return self._at(self._clock.now_s).copy()

    @property
    def is_stopped(self) -> bool:
        return self._trajectory is None

    @property
    def fault(self) -> SkillFailed | None:
        """Its present fault; None if it is sound."""
        active = self.faults.active
        if not active:
            return None
        if self._is_blocked and BLOCKED in active:
            return SkillFailed(Code.ARM_NOT_FOLLOWING, "joint 3 is 8.0° from where it should be")
        return next((SkillFailed(*SHUT_DOWN[name]) for name in active if name in SHUT_DOWN), None)

    def stop(self) -> None:
        if self._trajectory is not None:
            self._go_along(self._trajectory.stopped_from(self._clock.now_s - self._begin_s))

    def start(self, trajectory: Trajectory) -> None:
        if (fault := self.fault) is not None:
            raise fault
        now_s = self._clock.now_s
        check_trajectory(trajectory, self._at(now_s), self._mount().limits_rad, is_moving=self._trajectory is not None)
        self.on_start(trajectory)
        self._begin_s = now_s
        self._go_along(trajectory)
        self.faults.chance("motion", now_s)

    def follow(self, trajectory: Trajectory) -> Steps[None]:
        self.start(trajectory)
        try:
            while self._trajectory is not None:
                yield Wake.on(self.news, self._end_s)
        finally:
            self.stop()
        if (fault := self.fault) is not None:
            raise fault

    def _go_along(self, trajectory: Trajectory) -> None:
        self._trajectory, self._pose = trajectory, None
        self._end_s = self._begin_s + trajectory.duration_s

    @property
    def is_active(self) -> bool:
        return self._trajectory is not None

    def advance(self, end_s: float) -> None:
        """Advance to this time; fires `news` at the end of the motion."""
        if self.faults.active or self._was_faulty:
            self._apply_faults(end_s)
        if self._trajectory is not None and end_s >= self._end_s - 1e-9:
            self._hold(self._trajectory.sample(self._trajectory.duration_s))
            self.news.fire()

    def _apply_faults(self, now_s: float) -> None:
        """Stand still where a fault has stopped it; fire `news` when a fault begins or ends."""
        active = self.faults.active
        self._is_blocked = BLOCKED in active and (self._is_blocked or self._trajectory is not None)
        if (fault := self.fault) is not None and self._trajectory is not None:
            self._hold(self._at(now_s))
        if (fault is not None) != self._was_faulty:
            self._was_faulty = fault is not None
            self.news.fire()

    def held_at(self, time_s: float) -> list[float]:
        """The joints [rad] at which it would stop if its servos received nothing more from this time on."""
        joints: list[float] = self._at(time_s).tolist()
        return joints

    def hold(self, joints: Sequence[float]) -> None:
        """Stand still at these joints [rad]."""
        self._hold(np.array(joints))

    def sink(self, by_rad: float) -> None:
        """Go limp: the shoulder sinks by so much, at most to its limit."""
        self.was_limp = True
        joints = self._rest.copy()
        joints[1] = max(joints[1] - by_rad, self._mount().limits_rad[0, 1])
        self._hold(joints)

    def pose(self, time_s: float) -> Pose:
        """The apex's pose at a time that is not before now."""
        mount, at_s = self._mount(), None if self._trajectory is None else time_s
        if self._pose is None or self._pose[0] != at_s or self._pose[1] is not mount:
            self._pose = at_s, mount, self._apex_of(self._at(time_s))
        return self._pose[2]

    def _at(self, time_s: float) -> Joints:
        if self._trajectory is None:
            return self._rest
        return self._trajectory.sample(time_s - self._begin_s)

    def _hold(self, joints: Joints) -> None:
        self._rest = np.array(joints, dtype=float)
        self._trajectory = self._pose = None
