"""A ROS 2 system as rosbridge shows it, without ROS 2: joint states, a trajectory controller, a controller manager.

    python tests/ros2_system.py        # says its port, then obeys lines on its standard input

It knows nothing of the driver. Every message, in or out, goes through ROS 2's own definitions: it is built field by
field as `rosbridge_library` does it (an unknown field or another type is an error), serialised to CDR and read back by
`rosbags`. The definitions of Jazzy are rosbags' own; those of control_msgs and controller_manager_msgs stand below,
from `ros-controls/control_msgs` and `ros-controls/ros2_control`. The controller does what the documentation of
`joint_trajectory_controller` says: it refuses, follows by cubics, watches tolerances, and holds where a goal is
cancelled.

Lines: `block N`, `free`, `deactivate`, `activate`, `silent`, `deaf` (cancels are not heard), `drop`.
"""

import asyncio
import json
import math
import sys
import threading
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
from autobahn.asyncio.websocket import WebSocketServerFactory, WebSocketServerProtocol
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

DEFINITIONS = {
    "control_msgs/msg/JointTolerance": "string name\nfloat64 position\nfloat64 velocity\nfloat64 acceleration\n",
    "control_msgs/msg/JointComponentTolerance": (
        "string joint_name\nuint16 component\nfloat64 position\nfloat64 velocity\nfloat64 acceleration\n"
    ),
    "control_msgs/msg/FollowJointTrajectory_Goal": (
        "trajectory_msgs/JointTrajectory trajectory\n"
        "trajectory_msgs/MultiDOFJointTrajectory multi_dof_trajectory\n"
        "JointTolerance[] path_tolerance\nJointComponentTolerance[] component_path_tolerance\n"
        "JointTolerance[] goal_tolerance\nJointComponentTolerance[] component_goal_tolerance\n"
        "builtin_interfaces/Duration goal_time_tolerance\n"
    ),
    "control_msgs/msg/FollowJointTrajectory_Result": "int32 error_code\nstring error_string\n",
    "control_msgs/msg/FollowJointTrajectory_Feedback": (
        "std_msgs/Header header\nstring[] joint_names\ntrajectory_msgs/JointTrajectoryPoint desired\n"
        "trajectory_msgs/JointTrajectoryPoint actual\ntrajectory_msgs/JointTrajectoryPoint error\n"
        "string[] multi_dof_joint_names\ntrajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_desired\n"
        "trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_actual\n"
        "trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_error\n"
    ),
    "controller_manager_msgs/msg/HardwareInterface": (
        "string name\nstring data_type\nbool is_available\nbool is_claimed\n"
    ),
    "controller_manager_msgs/msg/HardwareComponentState": (
        "string name\nstring type\nbool is_async\nuint16 rw_rate\nstring plugin_name\nstring class_type\n"
        "lifecycle_msgs/State state\nHardwareInterface[] command_interfaces\nHardwareInterface[] state_interfaces\n"
    ),
    "controller_manager_msgs/msg/ListHardwareComponents_Response": "HardwareComponentState[] component\n",
}
GOAL, RESULT, FEEDBACK = (f"control_msgs/msg/FollowJointTrajectory_{part}" for part in ("Goal", "Result", "Feedback"))
JOINTS = (
    "crane_x7_shoulder_fixed_part_pan_joint",
    "crane_x7_shoulder_revolute_part_tilt_joint",
    "crane_x7_upper_arm_revolute_part_twist_joint",
    "crane_x7_upper_arm_revolute_part_rotate_joint",
    "crane_x7_lower_arm_fixed_part_joint",
    "crane_x7_lower_arm_revolute_part_joint",
    "crane_x7_wrist_joint",
)
GRIPPER = "crane_x7_gripper_finger_a_joint"
HOME = np.array([0.0, 0.3979, 0.0, -2.1994, 0.0563, 0.4817, 0.0])
ACTION = "/crane_x7_arm_controller/follow_joint_trajectory"
SUCCEEDED, CANCELED, ABORTED = 4, 5, 6
TICK_S, LAG_S = 0.005, 0.015
KINDS = {"string": str, "bool": bool}


class Definitions:
    """ROS 2's message definitions, by which messages are built and taken apart."""

    def __init__(self) -> None:
        self.store = get_typestore(Stores.ROS2_JAZZY)
        types: dict[str, Any] = {}
        for name, text in DEFINITIONS.items():
            types |= get_types_from_msg(text, name)
        self.store.register(types)

    def built(self, name: str, said: Any, at: str = "") -> Any:
        """The message that JSON says, read back from CDR. ValueError for what is not in its definition."""
        message = self._built(name, said, at or name)
        return self.store.deserialize_cdr(self.store.serialize_cdr(message, name), name) if not at else message

    def _built(self, name: str, said: Any, at: str) -> Any:
        _, defined = self.store.fielddefs[name]
        if not isinstance(said, dict):
            raise ValueError(f"{at}: {said!r} is no {name}")
        if unknown := said.keys() - {field for field, _ in defined}:
            raise ValueError(f"{at}: {name} has no {', '.join(sorted(unknown))}")
        values = {field: self._value(kind, said.get(field), f"{at}.{field}") for field, kind in defined}
        return self.store.types[name](**values)

    def _value(self, kind: Any, said: Any, at: str) -> Any:
        node, what = kind
        if node == Nodetype.NAME:
            return self._built(what, {} if said is None else said, at)
        if node in (Nodetype.SEQUENCE, Nodetype.ARRAY):
            inner = what[0]
            items = [self._value(inner, one, f"{at}[{n}]") for n, one in enumerate(said or [])]
            is_number = inner[0] == Nodetype.BASE and inner[1][0] not in KINDS
            return np.array(items, dtype=inner[1][0]) if is_number else items
        return self._plain(what[0], said, at)

    @staticmethod
    def _plain(kind: str, said: Any, at: str) -> Any:
        if kind in KINDS:
            value = KINDS[kind]() if said is None else said
            if not isinstance(value, KINDS[kind]):
                raise ValueError(f"{at}: {said!r} is no {kind}")
            return value
        if isinstance(said, bool) or not isinstance(said, int | float | None):
            raise ValueError(f"{at}: {said!r} is no {kind}")
        if kind.startswith("float"):
            return float(0.0 if said is None else said)
        if not isinstance(said, int | None):
            raise ValueError(f"{at}: {said!r} is no {kind}")
        bounds = np.iinfo(kind)
        if not bounds.min <= (said or 0) <= bounds.max:
            raise ValueError(f"{at}: {said!r} is beyond {kind}")
        return said or 0

    def plain(self, message: Any) -> Any:
        """A message as JSON has it; what is no number is null, as rosbridge sends it."""
        if is_dataclass(message):
            named = [field.name for field in fields(message) if field.name != "__msgtype__"]
            return {name: self.plain(getattr(message, name)) for name in named}
        if isinstance(message, list | np.ndarray):
            return [self.plain(one) for one in message]
        if isinstance(message, float | np.floating):
            return float(message) if math.isfinite(message) else None
        return message.item() if isinstance(message, np.generic) else message


class Goal:
    """A goal under way, of one caller."""

    def __init__(self, caller: "Line", identity: str, wanted: Any, begin: Any, now_s: float) -> None:
        self.caller, self.id, self.wanted, self.began_s = caller, identity, wanted, now_s
        order = [list(wanted.trajectory.joint_names).index(name) for name in JOINTS]
        points = wanted.trajectory.points
        self.times_s = np.array([0.0, *(seconds(point.time_from_start) for point in points)])
        self.positions = np.array([begin, *(point.positions[order] for point in points)])
        self.velocities = np.array([np.zeros(7), *(point.velocities[order] for point in points)])
        self.path_rad = self._tolerances(wanted.path_tolerance)
        self.end_rad = self._tolerances(wanted.goal_tolerance)
        self.feedback_s = now_s

    @staticmethod
    def _tolerances(said: Any) -> Any:
        named = {one.name: one.position for one in said}
        return np.array([named.get(name, 0.0) or math.inf for name in JOINTS])

    def at(self, time_s: float) -> Any:
        """Cubics between the points (Hermite's)."""
        k = int(np.searchsorted(self.times_s, time_s, side="right")) - 1
        if k >= len(self.times_s) - 1:
            return self.positions[-1]
        span_s = self.times_s[k + 1] - self.times_s[k]
        s = (time_s - self.times_s[k]) / span_s
        p0, p1 = self.positions[k], self.positions[k + 1]
        m0, m1 = self.velocities[k] * span_s, self.velocities[k + 1] * span_s
        rises = 3 * s**2 - 2 * s**3
        return (1 - rises) * p0 + rises * p1 + (s**3 - 2 * s**2 + s) * m0 + (s**3 - s**2) * m1


class System:
    """The arm, its controller and its hardware."""

    def __init__(self) -> None:
        self.definitions = Definitions()
        self.lines: set[Line] = set()
        self.actual, self.command = HOME.copy(), HOME.copy()
        self.goal: Goal | None = None
        self.blocked: int | None = None
        self.is_active, self.is_silent, self.is_deaf = True, False, False
        self.now_s = 0.0

    def tick(self) -> None:
        self.now_s += TICK_S
        if (goal := self.goal) is not None and self.is_active:
            self.command = goal.at(self.now_s - goal.began_s)
        if self.is_active:
            moved = self.actual + (self.command - self.actual) * (1.0 - math.exp(-TICK_S / LAG_S))
            if self.blocked is not None:
                moved[self.blocked] = self.actual[self.blocked]
            self.actual = moved
        if goal is not None:
            self._watch(goal)
        for line in tuple(self.lines):
            line.states(self)

    def _watch(self, goal: Goal) -> None:
        since_s, off = self.now_s - goal.began_s, np.abs(self.command - self.actual)
        if self.now_s - goal.feedback_s >= 0.05:
            goal.feedback_s = self.now_s
            self._feed(goal)
        end_s = goal.times_s[-1]
        if since_s < end_s and (off > goal.path_rad).any():
            worst = int((off / goal.path_rad).argmax())
            self.end(goal, ABORTED, -4, f"Aborted due to path tolerance violation of {JOINTS[worst]}")
        elif since_s >= end_s and (off <= goal.end_rad).all():
            self.end(goal, SUCCEEDED, 0, "Goal successfully reached!")
        elif since_s >= end_s + seconds(goal.wanted.goal_time_tolerance):
            self.end(goal, ABORTED, -5, "Aborted due to goal_time_tolerance exceeding")

    def _feed(self, goal: Goal) -> None:
        points = (self.command, self.actual, self.command - self.actual)
        said = {
            name: {"positions": at.tolist()} for name, at in zip(("desired", "actual", "error"), points, strict=True)
        }
        message = self.definitions.built(FEEDBACK, {"joint_names": list(JOINTS), **said})
        goal.caller.say({"op": "action_feedback", "action": ACTION, "id": goal.id, "values": message})

    def take(self, caller: "Line", identity: str, said: Any) -> None:
        """A goal has come."""
        try:
            wanted = self.definitions.built(GOAL, said)
            points = wanted.trajectory.points
            if sorted(wanted.trajectory.joint_names) != sorted(JOINTS):
                raise ValueError("Joints on incoming trajectory don't match the controller joints.")
            times_s = [seconds(point.time_from_start) for point in points]
            if not points or any(b <= a for a, b in zip([0.0, *times_s], times_s, strict=False)):
                raise ValueError("Time between points is not strictly increasing")
            if any(len(point.positions) != 7 or len(point.velocities) not in (0, 7) for point in points):
                raise ValueError("Mismatch between joint_names size and positions")
            if np.abs(points[-1].velocities).max() > 1e-12:
                raise ValueError("Velocity of last trajectory point is not zero")
            if not self.is_active:
                raise ValueError("Controller is not running")
        except ValueError as error:
            failed = {"op": "action_result", "action": ACTION, "id": identity, "status": 0, "result": False}
            caller.say({**failed, "values": f"Action goal was rejected: {error}"})
            return
        if self.goal is not None:
            self.end(self.goal, ABORTED, -1, "Current goal cancelled due to new incoming action.")
        self.goal = Goal(caller, identity, wanted, self.command.copy(), self.now_s)
        self._feed(self.goal)

    def cancel(self, identity: str) -> None:
        if self.goal is not None and self.goal.id == identity and not self.is_deaf:
            self.end(self.goal, CANCELED, 0, "")

    def end(self, goal: Goal, status: int, code: int, why: str) -> None:
        """The goal is over, and the joints are held where they are."""
        self.goal = None
        self.command = self.command if status == SUCCEEDED else self.actual.copy()
        result = self.definitions.built(RESULT, {"error_code": code, "error_string": why})
        said = {"op": "action_result", "action": ACTION, "id": goal.id, "status": status, "result": True}
        goal.caller.say({**said, "values": result})

    def hardware(self) -> Any:
        state = {"id": 3, "label": "active"} if self.is_active else {"id": 2, "label": "inactive"}
        part = {"name": "crane_x7", "type": "system", "plugin_name": "crane_x7_control/CraneX7Hardware"}
        return self.definitions.built(
            "controller_manager_msgs/msg/ListHardwareComponents_Response", {"component": [{**part, "state": state}]}
        )

    def obey(self, word: str, *rest: str) -> None:
        match word:
            case "block":
                self.blocked = int(rest[0]) - 1
            case "free":
                self.blocked = None
            case "deactivate" | "activate":
                self.is_active = word == "activate"
                if self.goal is not None and not self.is_active:
                    self.end(self.goal, ABORTED, -1, "Controller deactivated")
            case "silent":
                self.is_silent = True
            case "deaf":
                self.is_deaf = True
            case "drop":
                for line in tuple(self.lines):
                    line.transport.abort()


class Line(WebSocketServerProtocol):
    """One connection, in rosbridge's protocol."""

    def __init__(self) -> None:
        super().__init__()
        self._every_s: float | None = None
        self._told_s = 0.0

    def onOpen(self) -> None:  # noqa: N802
        self.factory.system.lines.add(self)

    def onClose(self, was_clean: bool, code: Any, reason: Any) -> None:  # noqa: N802
        self.factory.system.lines.discard(self)

    def onMessage(self, payload: bytes, is_binary: bool) -> None:  # noqa: N802
        system, said = self.factory.system, json.loads(payload)
        match said["op"]:
            case "subscribe":
                assert (said["topic"], said["type"]) == ("/joint_states", "sensor_msgs/msg/JointState")
                self._every_s = said.get("throttle_rate", 0) / 1000
            case "send_action_goal":
                assert (said["action"], said["action_type"]) == (ACTION, "control_msgs/action/FollowJointTrajectory")
                system.take(self, said["id"], said["args"])
            case "cancel_action_goal":
                system.cancel(said["id"])
            case "call_service":
                assert said["service"] == "/controller_manager/list_hardware_components"
                answer = {"op": "service_response", "id": said["id"], "service": said["service"], "result": True}
                self.say({**answer, "values": system.hardware()})

    def states(self, system: System) -> None:
        """The joint states, if they are due."""
        if self._every_s is None or system.is_silent or system.now_s - self._told_s < self._every_s - 1e-9:
            return
        self._told_s = system.now_s
        named = sorted([*zip(JOINTS, system.actual.tolist(), strict=True), (GRIPPER, 0.0)])
        said = {"name": [name for name, _ in named], "position": [at for _, at in named], "velocity": [math.nan] * 8}
        message = system.definitions.built("sensor_msgs/msg/JointState", said)
        self.say({"op": "publish", "topic": "/joint_states", "msg": message})

    def say(self, said: dict[str, Any]) -> None:
        plain = {key: self.factory.system.definitions.plain(value) for key, value in said.items()}
        self.sendMessage(json.dumps(plain).encode())


def seconds(duration: Any) -> float:
    return float(duration.sec + duration.nanosec * 1e-9)


async def main() -> None:
    system, loop = System(), asyncio.get_running_loop()
    factory = WebSocketServerFactory()
    factory.protocol, factory.system = Line, system
    server = await loop.create_server(factory, "127.0.0.1", 0)
    print(server.sockets[0].getsockname()[1], flush=True)

    def obey_lines() -> None:
        for line in sys.stdin:
            loop.call_soon_threadsafe(system.obey, *line.split())
        loop.call_soon_threadsafe(loop.stop)

    threading.Thread(target=obey_lines, daemon=True).start()
    due_s = loop.time()
    while True:
        system.tick()
        due_s = max(due_s + TICK_S, loop.time() - 0.2)
        await asyncio.sleep(max(0.0, due_s - loop.time()))


if __name__ == "__main__":
    asyncio.run(main())
