"""`driver: ros2`: a CRANE-X7 that ros2_control moves, for a lab that keeps it; this computer needs no ROS 2.

The seam is rosbridge (JSON over a websocket, protocol 2.1) by `roslibpy`, the extra `ros2`: a motion is one goal of
control_msgs/action/FollowJointTrajectory, `joint_states` tell where the joints are, and the controller manager whether
its hardware has torque. docs/protocols/ros2.md says what is lost by that: above all the dead-man.
"""

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import Annotated, Any, ClassVar
from urllib.parse import urlsplit

import numpy as np
from pydantic import Field

from scuhand_bt.clock import Signal, Steps, Wake
from scuhand_bt.devices.arguments import check_trajectory
from scuhand_bt.devices.interfaces import Joints, Site, Trajectory
from scuhand_bt.devices.liveness import Liveness
from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.motion.kinematics import LIMITS_RAD
from scuhand_bt.quantity import Degrees, Seconds
from scuhand_bt.specs import Positive, Spec

CRANE_X7_JOINTS = (
    "crane_x7_shoulder_fixed_part_pan_joint",
    "crane_x7_shoulder_revolute_part_tilt_joint",
    "crane_x7_upper_arm_revolute_part_twist_joint",
    "crane_x7_upper_arm_revolute_part_rotate_joint",
    "crane_x7_lower_arm_fixed_part_joint",
    "crane_x7_lower_arm_revolute_part_joint",
    "crane_x7_wrist_joint",
)
"""From the base; `rt-net/crane_x7_ros`, `crane_x7_control/config/crane_x7_controllers.yaml` (Apache-2.0)."""
ACTION = "control_msgs/action/FollowJointTrajectory"
HARDWARE = "controller_manager_msgs/srv/ListHardwareComponents"
POINTS_S = 0.02
"""Between two points of a goal; the controller goes along cubics in between."""
LOOK_S = 0.02
ASKED_S = 0.25
"""Between two questions whether the hardware has torque."""
STATES_MS = 10
SUCCEEDED = 4
"""action_msgs/msg/GoalStatus."""
NOT_FOLLOWED = (-4, -5)
"""PATH_TOLERANCE_VIOLATED and GOAL_TOLERANCE_VIOLATED."""
STILL_RAD, STILL_S = math.radians(0.1), 0.3
"""What has not moved further for so long stands still: not every hardware tells velocities, and a count is 0.09°."""
AT_GOAL_RAD = math.radians(1.5)
CONNECT_S, ACCEPTED_S, STOPPED_S, SETTLED_S = 5.0, 2.0, 1.0, 2.0


class Ros2Options(Spec):
    """What differs from one ROS 2 system to the next."""

    action: str = "/crane_x7_arm_controller/follow_joint_trajectory"
    joint_states: str = "/joint_states"
    controller_manager: str = "/controller_manager"
    joints: Annotated[tuple[str, ...], Field(min_length=7, max_length=7)] = CRANE_X7_JOINTS
    """As ROS 2 names them, from the base."""
    following_limit_deg: Annotated[Degrees, Positive] = 10.0
    """A joint further than this from its trajectory is held up by something: the goal's path tolerance."""
    silent_after_s: Annotated[Seconds, Field(gt=0, le=5)] = 0.25
    """Without `joint_states` for this long the arm is taken for lost."""


class Bridge:
    """A connection to rosbridge; whatever comes is told on its thread."""

    def __init__(self, url: str, options: Ros2Options) -> None:
        """SkillFailed device.lost without `roslibpy`, or where nobody answers."""
        try:
            import roslibpy
        except ImportError:
            raise SkillFailed(
                Code.DEVICE_LOST, "the ros2 driver needs roslibpy: pip install 'scuhand-bt[ros2]'"
            ) from None
        there = urlsplit(url if "://" in url else f"ws://{url}")
        if there.scheme not in ("ws", "wss") or not there.hostname:
            raise SkillFailed(
                Code.DEVICE_LOST, f"'{url}' is not the address of a rosbridge, such as ws://127.0.0.1:9090"
            )
        self._ros = roslibpy.Ros(there.hostname, there.port or 9090, there.scheme == "wss", transport="asyncio")
        self._states = roslibpy.Topic(
            self._ros, options.joint_states, "sensor_msgs/msg/JointState", throttle_rate=STATES_MS, queue_length=1
        )
        self._action = roslibpy.ActionClient(self._ros, options.action, ACTION)
        self._hardware = roslibpy.Service(self._ros, f"{options.controller_manager}/list_hardware_components", HARDWARE)
        self._goal_of, self._request_of = roslibpy.Goal, roslibpy.ServiceRequest
        try:
            self._ros.run(CONNECT_S)
        except roslibpy.core.RosTimeoutError:
            self.close()
            raise SkillFailed(
                Code.DEVICE_LOST, f"no rosbridge answers at {url}; is rosbridge_websocket running there?"
            ) from None

    @property
    def is_connected(self) -> bool:
        return bool(self._ros.is_connected)

    def listen(self, heard: Callable[[Mapping[str, Any]], None]) -> None:
        """Tell every joint_states message."""
        self._states.subscribe(heard)

    def send(
        self, goal: Mapping[str, Any], ended: Callable[[Mapping[str, Any]], None], accepted: Callable[[], None]
    ) -> str:
        """Send a goal; its id. `ended` is told the result, whichever, `accepted` that there is feedback."""
        sent: str = self._action.send_goal(self._goal_of(goal), ended, lambda feedback: accepted(), ended)
        return sent

    def cancel(self, goal: str) -> None:
        self._action.cancel_goal(goal)

    def ask_hardware(self, answered: Callable[[Mapping[str, Any]], None]) -> None:
        """Ask for the hardware components; what cannot be asked is not answered."""
        self._hardware.call(self._request_of(), answered, lambda error: None)

    def close(self) -> None:
        self._ros.factory._stop = True  # one that has not connected yet would go on trying
        if self.is_connected:
            self._ros.close()


class Ros2Arm:
    """The seven joints behind a bridge; meets `devices.interfaces.Arm`.

    Its `stop` cancels the goal, and the controller then holds where the joints are: at once, not along the path. An
    arm that was without torque stays limp for this program, also when ROS 2 has given it some.
    """

    def __init__(self, bridge: Bridge, options: Ros2Options, liveness: Liveness) -> None:
        self.news = Signal()
        self.on_start: Callable[[Trajectory], None] = lambda trajectory: None
        self.was_limp = True
        """Nobody tells whether it had torque all along before this program was there."""
        self._bridge, self._options, self._liveness = bridge, options, liveness
        self._lock = threading.RLock()
        self._heard: deque[tuple[float, Joints]] = deque(maxlen=64)
        self._goal: _Goal | None = None
        self._fault: SkillFailed | None = None
        """Why the last motion ended early."""
        self._limp: SkillFailed | None = None
        self._lost: SkillFailed | None = None
        self._is_active = False
        """The hardware was seen to be active."""
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="ros2 arm", daemon=True)

    def open(self) -> None:
        """Wait until joints and hardware are known; SkillFailed device.lost, arm.limp."""
        self._bridge.listen(self._take)
        self._bridge.ask_hardware(self._take_hardware)
        until_s = time.monotonic() + CONNECT_S
        while time.monotonic() < until_s and not (self._heard and (self._is_active or self._limp)):
            time.sleep(0.01)
        if (limp := self._limp) is not None:
            raise limp
        if not self._heard:
            what = f"nobody publishes its joints on {self._options.joint_states}"
            raise SkillFailed(Code.DEVICE_LOST, f"{what}; is the joint_state_broadcaster active?")
        if not self._is_active:
            what = f"{self._options.controller_manager} does not say whether its hardware is active"
            raise SkillFailed(Code.DEVICE_LOST, f"{what}; is controller_manager_msgs installed beside rosbridge?")
        self._thread.start()

    def close(self) -> None:
        """Leave it; what moves is stopped first."""
        self.stop()
        self._closing.set()
        if self._thread.is_alive():
            self._thread.join()
        self._bridge.close()

    @property
    def positions(self) -> Joints:
        return self._heard[-1][1].copy()

    @property
    def is_stopped(self) -> bool:
        with self._lock:
            return self._goal is None and (self._lost is not None or self._stands())

    @property
    def fault(self) -> SkillFailed | None:
        """What is wrong with it now, or ended the last motion early, until the next one begins."""
        return self._limp or self._lost or self._fault

    def stop(self) -> None:
        """Cancel the motion; the controller holds."""
        with self._lock:
            goal = self._goal
            if goal is not None and goal.cancelled_s is None:
                goal.cancelled_s = time.monotonic()
                self._bridge.cancel(goal.id)

    def start(self, trajectory: Trajectory) -> None:
        """Send a trajectory that starts where the arm is."""
        with self._lock:
            if (trouble := self._limp or self._lost) is not None:
                raise trouble
            check_trajectory(trajectory, self.positions, LIMITS_RAD, is_moving=self._goal is not None)
            self.on_start(trajectory)
            self._fault = None
            goal = self._goal = _Goal(trajectory)
            goal.id = self._bridge.send(
                goal_of(trajectory, self._options), lambda result: self._ended(goal, result), goal.was_accepted
            )

    def follow(self, trajectory: Trajectory) -> Steps[None]:
        """Start the trajectory and wait until the arm is at rest; SkillFailed with the fault that ended it early."""
        self.start(trajectory)
        try:
            while True:
                wake = Wake.on(self.news)
                if (fault := self.fault) is not None:
                    raise fault
                if self.is_stopped:
                    return
                yield wake
        finally:
            self.stop()

    # --- on the bridge's thread

    def _take(self, message: Mapping[str, Any]) -> None:
        """One joint_states message: of any joints, in any order."""
        said = dict(zip(message["name"], message["position"], strict=False))
        try:
            joints = np.array([said[name] for name in self._options.joints], dtype=float)
        except (KeyError, TypeError):
            return  # of another robot, or a joint that has no position yet
        if np.isfinite(joints).all():
            self._heard.append((time.monotonic(), joints))
            self.news.fire()

    def _take_hardware(self, message: Mapping[str, Any]) -> None:
        states = {one["name"]: one["state"]["label"] for one in message["component"] if one["type"] == "system"}
        without = [f"'{name}' is {label}" for name, label in states.items() if label != "active"]
        self._is_active = bool(states) and not without
        if without and self._limp is None:
            what = f"its hardware {', '.join(without)}: the servos have no torque"
            self._limp = SkillFailed(
                Code.ARM_LIMP, f"{what}; support the arm, activate the hardware in ROS 2, and resume"
            )
            self._end(self._limp)

    def _ended(self, goal: "_Goal", result: Mapping[str, Any]) -> None:
        with self._lock:
            if self._goal is not goal:
                return
            self._goal = None
            status = getattr(result.get("status"), "value", result.get("status"))
            if goal.cancelled_s is None and status != SUCCEEDED and self._fault is None:
                self._fault = _failure_of(result.get("values"))
        self.news.fire()

    # --- on a thread of its own

    def _watch(self) -> None:
        asked_s = 0.0
        while not self._closing.wait(LOOK_S):
            now_s = time.monotonic()
            if now_s - asked_s >= ASKED_S and self._bridge.is_connected:
                asked_s = now_s
                self._bridge.ask_hardware(self._take_hardware)
            self._look_whether_lost(now_s)
            if (goal := self._goal) is not None:
                self._look_at(goal, now_s)
            self.news.fire()

    def _look_whether_lost(self, now_s: float) -> None:
        silent_s = now_s - self._heard[-1][0]
        if self._bridge.is_connected and silent_s <= self._options.silent_after_s:
            self._lost = None
            return
        if self._lost is None:
            what = "has closed its line" if not self._bridge.is_connected else f"was silent for {silent_s:.2f} s"
            goes_on = "; a motion that was under way goes on to its end" if self._goal is not None else ""
            self._lost = SkillFailed(Code.DEVICE_LOST, f"the ROS 2 system {what}{goes_on}")
            self.stop()
            self._end(self._lost)

    def _look_at(self, goal: "_Goal", now_s: float) -> None:
        if not self._liveness.is_alive and goal.cancelled_s is None:
            pause_ms = 1000 * self._liveness.silent_s
            self._fault = SkillFailed(Code.COMPUTER_BUSY, f"the run hung for {pause_ms:.0f} ms; the arm was stopped")
            self.stop()
        if goal.cancelled_s is not None and now_s - goal.cancelled_s > STOPPED_S and not self._stands():
            what = "the controller did not accept the stop; rosbridge needs `send_action_goals_in_new_thread:=true`"
            self._end(SkillFailed(Code.DEVICE_LOST, what))
        elif goal.cancelled_s is not None and now_s - goal.cancelled_s > STOPPED_S:
            self._end(None)  # it holds, though nobody has said so
        elif not goal.is_accepted and now_s - goal.sent_s > ACCEPTED_S:
            self.stop()
            self._end(SkillFailed(Code.DEVICE_LOST, f"no controller accepts goals on {self._options.action}"))
        elif now_s - goal.sent_s > goal.duration_s + ACCEPTED_S + SETTLED_S:
            self.stop()
            self._end(SkillFailed(Code.ARM_NOT_FOLLOWING, "the controller did not report the end of the motion"))

    def _end(self, fault: SkillFailed | None) -> None:
        """The motion counts no more."""
        with self._lock:
            self._goal, self._fault = None, fault or self._fault
        self.news.fire()

    def _stands(self) -> bool:
        now_s = time.monotonic()
        late = [joints for at_s, joints in tuple(self._heard) if now_s - at_s <= STILL_S]
        return len(late) > 1 and bool((np.ptp(np.array(late), axis=0) < STILL_RAD).all())


class _Goal:
    """One goal that was sent."""

    def __init__(self, trajectory: Trajectory) -> None:
        self.id = ""
        self.duration_s = trajectory.duration_s
        self.sent_s = time.monotonic()
        self.cancelled_s: float | None = None
        self.is_accepted = False

    def was_accepted(self) -> None:
        self.is_accepted = True


def goal_of(trajectory: Trajectory, options: Ros2Options) -> dict[str, Any]:
    """The goal of FollowJointTrajectory: points 20 ms apart, from rest to rest, held to the following limit."""
    count = max(2, math.ceil(trajectory.duration_s / POINTS_S))
    times_s = np.linspace(0.0, trajectory.duration_s, count + 1)[1:]
    points = []
    for time_s in times_s.tolist():
        before_s, after_s = max(0.0, time_s - 1e-3), min(trajectory.duration_s, time_s + 1e-3)
        ends = time_s == times_s[-1]
        velocities = (trajectory.sample(after_s) - trajectory.sample(before_s)) / (after_s - before_s)
        points.append(
            {
                "positions": trajectory.sample(time_s).tolist(),
                "velocities": [0.0] * 7 if ends else velocities.tolist(),
                "time_from_start": _duration(time_s),
            }
        )
    return {
        "trajectory": {"joint_names": list(options.joints), "points": points},
        "path_tolerance": _tolerances(options, math.radians(options.following_limit_deg)),
        "goal_tolerance": _tolerances(options, AT_GOAL_RAD),
        "goal_time_tolerance": _duration(SETTLED_S / 2),
    }


def _tolerances(options: Ros2Options, position_rad: float) -> list[dict[str, Any]]:
    return [{"name": name, "position": position_rad} for name in options.joints]


def _duration(time_s: float) -> dict[str, int]:
    """builtin_interfaces/msg/Duration."""
    nanoseconds = round(time_s * 1e9)
    return {"sec": nanoseconds // 10**9, "nanosec": nanoseconds % 10**9}


def _failure_of(values: Any) -> SkillFailed:
    """What the result of a goal says that did not succeed."""
    if not isinstance(values, Mapping):
        return SkillFailed(Code.DEVICE_LOST, f"the goal was not accepted: {values}")
    code, said = values.get("error_code", 0), values.get("error_string") or "it does not say why"
    if code in NOT_FOLLOWED:
        return SkillFailed(Code.ARM_NOT_FOLLOWING, f"the controller has aborted the motion: {said}")
    return SkillFailed(Code.DEVICE_LOST, f"the controller has ended the motion ({code}): {said}")


class Driver:
    """`driver: ros2` of the arm."""

    Options: ClassVar = Ros2Options
    twin: ClassVar = ""

    @staticmethod
    def connect(site: Site) -> Ros2Arm:
        bridge = Bridge(site.spec.port, site.options)
        arm = Ros2Arm(bridge, site.options, site.liveness)
        try:
            arm.open()
        except SkillFailed:
            bridge.close()
            raise
        return arm


DRIVER = Driver
