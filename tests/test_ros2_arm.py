"""The arm behind rosbridge: goals that ROS 2's own definitions take, and what becomes of them."""

import math
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("roslibpy")
pytest.importorskip("rosbags")

from ros2_system import GOAL, Definitions
from running import make_lab

from scuhand_bt.clock import carried_out
from scuhand_bt.device_specs.arm import ArmSpec
from scuhand_bt.devices.interfaces import Site
from scuhand_bt.devices.liveness import Liveness
from scuhand_bt.devices.ros2_arm import DRIVER, Ros2Arm, Ros2Options, goal_of
from scuhand_bt.drivers import driver_of
from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.lab import load_lab
from scuhand_bt.problems import SourceError
from scuhand_bt.run.clock import WallClock
from scuhand_bt.testing.of_motion import Sway, arm_conforms
from scuhand_bt.yaml_edit import Path as Keys
from scuhand_bt.yaml_edit import Value, edited

pytestmark = pytest.mark.real_time
WAY = np.full(7, math.radians(6.0))


class Ros2:
    """A ROS 2 system of a process of its own, and arms connected to it."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, str(Path(__file__).with_name("ros2_system.py"))],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self._process.stdout is not None
        self.url = f"ws://127.0.0.1:{int(self._process.stdout.readline())}"
        self._arms: list[Ros2Arm] = []

    def say(self, line: str) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(line + "\n")
        self._process.stdin.flush()

    def connect(self, liveness: Liveness | None = None, **options: float) -> Ros2Arm:
        spec = ArmSpec(port=self.url)
        site = Site(spec, Ros2Options.model_validate(options), WallClock(), liveness or Liveness())
        self._arms.append(DRIVER.connect(site))
        return self._arms[-1]

    def end(self) -> None:
        for arm in self._arms:
            arm.close()
        self._process.kill()
        self._process.communicate()


@pytest.fixture
def ros2() -> Iterator[Ros2]:
    system = Ros2()
    try:
        yield system
    finally:
        system.end()


def until(condition: Callable[[], bool]) -> None:
    end_s = time.monotonic() + 10.0
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.005)


def sway(arm: Ros2Arm, duration_s: float = 2.0) -> Sway:
    here = arm.positions
    return Sway(here, np.where(here > 0.0, -WAY, WAY), duration_s)


@pytest.mark.slow
def test_it_conforms(ros2: Ros2) -> None:
    arm_conforms(ros2.connect(silent_after_s=2.0), WallClock())


def test_a_goal_is_one_by_ros_2s_own_definitions() -> None:
    motion, definitions = Sway(np.zeros(7), WAY, 1.23), Definitions()
    goal = definitions.built(GOAL, goal_of(motion, Ros2Options()))
    last = goal.trajectory.points[-1]
    assert last.positions == pytest.approx(WAY)
    assert last.time_from_start.sec + last.time_from_start.nanosec * 1e-9 == pytest.approx(1.23)
    assert not last.velocities.any()
    middle = goal.trajectory.points[len(goal.trajectory.points) // 2]
    at_s = middle.time_from_start.nanosec * 1e-9
    speeds = (motion.sample(at_s + 1e-4) - motion.sample(at_s - 1e-4)) / 2e-4
    assert middle.velocities == pytest.approx(speeds, rel=1e-3)
    with pytest.raises(ValueError, match="has no velocity_tolerance"):
        definitions.built(GOAL, {"velocity_tolerance": []})
    with pytest.raises(ValueError, match="is no int32"):
        definitions.built(GOAL, {"goal_time_tolerance": {"sec": 0.5}})


def test_it_goes_where_it_is_told_and_a_stop_cancels_the_goal_and_holds(ros2: Ros2) -> None:
    arm = ros2.connect()
    assert arm.was_limp, "nobody tells whether it had torque all along"
    goal = sway(arm)
    carried_out(arm.follow(goal), WallClock())
    assert arm.positions == pytest.approx(goal.sample(2.0), abs=math.radians(1.0))
    arm.start(back := sway(arm, 4.0))
    time.sleep(1.5)
    arm.stop()
    until(lambda: arm.is_stopped)
    rest = arm.positions
    assert np.abs(rest - back.begin).max() > math.radians(0.5)
    assert np.abs(rest - back.sample(4.0)).max() > math.radians(0.5)
    time.sleep(0.5)
    assert arm.positions == pytest.approx(rest, abs=math.radians(0.2))
    assert arm.fault is None


def test_a_joint_that_is_held_up_ends_the_motion_as_not_following(ros2: Ros2) -> None:
    arm = ros2.connect(following_limit_deg=2.0)
    ros2.say("block 4")
    with pytest.raises(SkillFailed, match=r"arm\.not_following: .*upper_arm_revolute_part_rotate_joint"):
        carried_out(arm.follow(sway(arm)), WallClock())


def test_hardware_without_torque_is_limp_for_this_program_whatever_ros_2_does_then(ros2: Ros2) -> None:
    arm = ros2.connect()
    arm.start(sway(arm, 4.0))
    time.sleep(0.3)
    ros2.say("deactivate")
    until(lambda: arm.fault is not None and arm.fault.code == Code.ARM_LIMP)
    ros2.say("activate")
    time.sleep(0.6)
    with pytest.raises(SkillFailed, match=r"arm\.limp"):
        arm.start(sway(arm))


def test_an_arm_without_torque_is_refused_and_says_what_to_do(ros2: Ros2) -> None:
    ros2.say("deactivate")
    with pytest.raises(SkillFailed, match=r"arm\.limp: .*'crane_x7' is inactive.*activate the hardware in ROS 2"):
        ros2.connect()


@pytest.mark.parametrize("how", ["silent", "drop"])
def test_a_system_that_is_heard_no_more_is_lost_and_says_that_the_motion_goes_on(ros2: Ros2, how: str) -> None:
    arm = ros2.connect()
    arm.start(sway(arm, 4.0))
    time.sleep(0.5)
    ros2.say(how)
    until(lambda: arm.fault is not None)
    assert arm.fault is not None
    assert arm.fault.code == Code.DEVICE_LOST
    assert "goes on to its end" in arm.fault.detail
    until(lambda: arm.is_stopped)


def test_a_stop_that_is_not_taken_is_told_with_what_rosbridge_needs(ros2: Ros2) -> None:
    arm = ros2.connect()
    ros2.say("deaf")
    arm.start(sway(arm, 5.0))
    time.sleep(0.5)
    arm.stop()
    until(lambda: arm.fault is not None)
    assert arm.fault is not None
    assert "send_action_goals_in_new_thread:=true" in arm.fault.detail


def test_a_run_that_hangs_stops_the_arm(ros2: Ros2) -> None:
    liveness = Liveness()
    arm = ros2.connect(liveness)
    liveness.beat()
    arm.start(sway(arm, 4.0))
    until(lambda: arm.is_stopped)
    assert arm.fault is not None
    assert arm.fault.code == Code.COMPUTER_BUSY


def test_nobody_there_and_no_address_are_named() -> None:
    for port, why in (
        ("ws://127.0.0.1:9", "no rosbridge answers"),
        ("/dev/ttyUSB0", "is not the address of a rosbridge"),
    ):
        with pytest.raises(SkillFailed, match=why):
            DRIVER.connect(Site(ArmSpec(port=port), Ros2Options(), WallClock()))


def test_a_cell_names_it_and_its_options_are_checked(tmp_path: Path) -> None:
    folder = make_lab(tmp_path / "lab")
    cell = folder / "robot" / "cell.yaml"
    arm: dict[Keys, Value] = {
        ("arm", "driver"): "ros2",
        ("arm", "options"): {"following_limit": "3 deg", "silent_after": "400 ms"},
    }
    cell.write_text(edited(cell.read_text(encoding="utf-8"), arm), encoding="utf-8")
    lab = load_lab(folder)
    options = lab.cell.options_of("arm")
    assert isinstance(options, Ros2Options)
    assert (options.following_limit_deg, options.silent_after_s) == (3.0, 0.4)
    assert driver_of("arm", lab.cell.arm.driver) is DRIVER
    arm["arm", "options"] = {"joints": ["a", "b"]}
    cell.write_text(edited(cell.read_text(encoding="utf-8"), arm), encoding="utf-8")
    with pytest.raises(SourceError, match="joints"):
        load_lab(folder)
