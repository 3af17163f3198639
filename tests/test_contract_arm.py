"""What `devices.interfaces.Arm` says, of the simulated arm and of the driver over its twin alike."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from device_benches import READY, SimulatedArmBench, Sway, WiredArmBench

from harness.arm_stops import TwinArm, off_path_rad, simulated_stop, worst_of
from scuhand_bt.clock import Wake
from scuhand_bt.devices.dynamixel.servo_loop import PERIOD_S
from scuhand_bt.failures import SkillFailed
from scuhand_bt.lab import load_lab, starter_lab
from scuhand_bt.motion import ApexPose, MotionPlanner, Mount
from scuhand_bt.motion.kinematics import LIMITS_RAD, Floats
from scuhand_bt.motion.stopping import HARDER, StoppableTrajectory

BEHIND_RAD = math.radians(1.0)
"""How far a shaft may be behind its goal."""


@pytest.fixture(scope="module")
def wired() -> Iterator[WiredArmBench]:
    with WiredArmBench().open() as bench:
        yield bench


@pytest.fixture(params=["simulated", pytest.param("wired", marks=pytest.mark.real_time)])
def bench(request: pytest.FixtureRequest) -> Iterator[Any]:
    if request.param == "simulated":
        yield SimulatedArmBench()
        return
    wired = request.getfixturevalue("wired")
    wired.until(lambda: wired.device.is_stopped)
    yield wired
    wired.device.stop()


def away(bench: Any, duration_s: float = 1.0) -> Sway:
    """A motion from where the arm stands, towards where it stood at first."""
    here = bench.device.positions
    return Sway(here, np.where(here > READY + 0.05, -0.15, 0.15), duration_s)


def test_a_trajectory_is_followed_to_its_end_in_its_time(bench: Any) -> None:
    arm, motion = bench.device, away(bench)
    assert arm.is_stopped
    news = arm.news.count
    took_s = bench.timed(arm.follow(motion))
    assert motion.duration_s - 2 * PERIOD_S <= took_s <= motion.duration_s + 0.05 + bench.late_s
    assert arm.is_stopped
    assert arm.news.count > news
    assert arm.fault is None
    assert arm.positions == pytest.approx(motion.end, abs=BEHIND_RAD)


def test_a_started_arm_moves_until_it_has_stopped_and_then_says_so(bench: Any) -> None:
    arm, motion = bench.device, away(bench)
    arm.start(motion)
    assert not arm.is_stopped
    bench.pass_time(0.5)
    assert not arm.is_stopped
    wake = Wake.on(arm.news)
    bench.until(lambda: arm.is_stopped)
    assert wake.has_fired
    assert arm.positions == pytest.approx(motion.end, abs=BEHIND_RAD)


def test_a_stop_comes_to_rest_on_the_path_before_the_motions_end_and_another_one_changes_nothing(bench: Any) -> None:
    arm, motion = bench.device, away(bench, 2.5)
    arm.start(motion)
    bench.pass_time(1.0)
    arm.stop()
    assert not arm.is_stopped, "it does not stop in no time"
    bench.pass_time(0.06)
    arm.stop()
    took_s = bench.until(lambda: arm.is_stopped)
    assert took_s <= motion.stopped_from(1.0).duration_s - 1.0 + bench.late_s
    rest = arm.positions
    assert off_path_rad(motion, rest) < BEHIND_RAD
    assert np.abs(rest - motion.end).max() > 0.05, "it did not go on to the end"
    bench.pass_time(0.2)
    arm.stop()
    assert arm.is_stopped
    assert arm.positions == pytest.approx(rest, abs=0.003)


def test_after_a_stop_the_arm_goes_on_from_where_it_came_to_rest(bench: Any) -> None:
    arm, motion = bench.device, away(bench, 2.0)
    arm.start(motion)
    bench.pass_time(0.8)
    arm.stop()
    bench.until(lambda: arm.is_stopped)
    onward = away(bench)
    bench.run(arm.follow(onward))
    assert arm.positions == pytest.approx(onward.end, abs=BEHIND_RAD)


def test_whoever_follows_is_told_of_the_end_that_a_stop_makes(bench: Any) -> None:
    arm, motion = bench.device, away(bench, 3.0)
    steps = arm.follow(motion)
    bench.clock.wait([next(steps), Wake(bench.clock.now_s + 1.0)])
    bench.pass_time(0.5)
    arm.stop()
    assert bench.timed(steps) < 1.5
    assert arm.is_stopped


def test_following_that_is_closed_in_the_middle_stops_the_arm(bench: Any) -> None:
    arm, motion = bench.device, away(bench, 3.0)
    steps = arm.follow(motion)
    next(steps)
    bench.pass_time(1.2)
    steps.close()
    assert not arm.is_stopped
    assert bench.until(lambda: arm.is_stopped) < 1.0
    assert off_path_rad(motion, arm.positions) < BEHIND_RAD
    assert np.abs(arm.positions - motion.end).max() > 0.05


def refusal(bench: Any, motion: Any) -> str:
    before = bench.device.positions
    with pytest.raises(SkillFailed) as refused:
        bench.device.start(motion)
    assert bench.device.is_stopped
    bench.pass_time(0.05)
    assert bench.device.positions == pytest.approx(before, abs=0.003)
    return str(refused.value)


def test_what_does_not_begin_where_the_arm_stands_is_refused(bench: Any) -> None:
    here = bench.device.positions
    off = Sway(here + np.where(np.arange(7) == 4, math.radians(8.0), 0.0), 0.1, 1.0)
    assert refusal(bench, off) == "arm.not_following: the trajectory begins 8.0° from where joint 5 stands"
    near = Sway(here + math.radians(2.0), 0.0, 0.1)
    bench.run(bench.device.follow(near))


def test_what_is_no_number_is_refused(bench: Any) -> None:
    class Nowhere:
        duration_s = 1.0

        def sample(self, time_s: float) -> Floats:
            return np.full(7, math.nan)

    assert refusal(bench, Nowhere()).startswith("arm.not_following")


def test_what_would_leave_a_joints_limits_is_refused_before_anything_moves(bench: Any) -> None:
    here = bench.device.positions
    beyond = Sway(here, np.where(np.arange(7) == 5, math.pi / 2 - here[5] + 0.02, 0.0), 1.0)
    said = refusal(bench, beyond)
    assert said.startswith("arm.joint_limit: joint 6 would go to 9")
    assert said.endswith("°; only -90.0° to 90.0° are allowed")


def test_an_arm_that_moves_takes_no_other_motion(bench: Any) -> None:
    arm = bench.device
    arm.start(away(bench, 2.0))
    bench.pass_time(0.8)
    with pytest.raises(SkillFailed, match=r"device\.busy: the arm is still moving"):
        arm.start(away(bench))
    arm.stop()
    with pytest.raises(SkillFailed, match=r"device\.busy: the arm is still moving"):
        arm.start(away(bench))
    bench.until(lambda: arm.is_stopped)


def test_a_fault_ends_the_motion_where_the_arm_is_and_is_told_to_whoever_follows(bench: Any) -> None:
    arm, motion = bench.device, Sway(bench.device.positions, 0.5, 1.5)
    steps = arm.follow(motion)
    next(steps)
    bench.pass_time(0.2)
    with bench.blocked():
        with pytest.raises(SkillFailed, match=r"arm\.not_following: joint \d is \d+\.\d° from where it should be"):
            bench.run(steps)
        assert arm.fault is not None
        assert arm.fault.code == "arm.not_following"
        assert np.abs(arm.positions - motion.end).max() > 0.1
    bench.until(lambda: arm.is_stopped)
    bench.run(arm.follow(Sway(arm.positions, 0.01, 0.2)))
    assert arm.fault is None


# --- stops of carried loads


LAB = load_lab(starter_lab())
MOUNT = Mount.of(LAB.cell.hand)
ABOVE_MM = {"mortar_bay": 90, "balance": 80, "waste": 40, "park": 0}
STOPS = 60


@pytest.fixture(scope="module")
def carries() -> list[StoppableTrajectory]:
    """Motions of loads between the lab's places, within several spill angles."""
    planner = MotionPlanner(LAB.urdf, LAB.cell, {"mortar_bay": LAB.library.mortars["agate_mortar"]})
    for station, height_mm in ABOVE_MM.items():
        x_mm, y_mm, z_mm = LAB.cell.stations[station].position_mm
        planner.add_place(station, ApexPose(np.array([x_mm, y_mm, z_mm + height_mm]) / 1e3))
    at = {name: planner.move(planner.home(), name).end for name in ABOVE_MM}
    pairs = [("mortar_bay", "balance"), ("balance", "waste"), ("balance", "mortar_bay"), ("waste", "mortar_bay")]
    return [
        planner.move(at[begin], goal, spill_limit_deg=limit_deg) for begin, goal in pairs for limit_deg in (12, 20, 35)
    ]


def random_stops(carries: list[StoppableTrajectory]) -> Iterator[tuple[StoppableTrajectory, float]]:
    rng = np.random.default_rng(3)
    for k in range(STOPS):
        motion = carries[k % len(carries)]
        yield motion, float(rng.uniform(0.05, 0.95)) * motion.duration_s


def check(motion: StoppableTrajectory, at_s: float, course: Floats) -> None:
    limit_deg = motion.spill_limit_deg
    assert limit_deg is not None
    worst = worst_of(course, MOUNT)
    assert worst.spill_deg <= limit_deg + 0.3, f"stopped at {at_s:.3f} s of {motion.duration_s:.3f} s"
    assert worst.acceleration <= HARDER * 4.4 * 1.05
    assert (course >= LIMITS_RAD[0] - 1e-6).all()
    assert (course <= LIMITS_RAD[1] + 1e-6).all()
    assert off_path_rad(motion, course[-1]) < 1e-3
    assert len(course) * PERIOD_S <= motion.duration_s + 2 * PERIOD_S


@pytest.mark.slow
def test_random_stops_of_loads_keep_them_in_the_cone_in_simulation(carries: list[StoppableTrajectory]) -> None:
    for motion, at_s in random_stops(carries):
        check(motion, at_s, simulated_stop(motion, at_s, MOUNT))


@pytest.mark.slow
def test_random_stops_of_loads_keep_them_in_the_cone_on_the_wire(carries: list[StoppableTrajectory]) -> None:
    for motion in carries:
        with TwinArm(motion.start).stepped() as arm:
            for other, at_s in random_stops(carries):
                if other is motion:
                    check(motion, at_s, arm.stopped(motion, at_s))
