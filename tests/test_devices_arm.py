import math
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator

import numpy as np
import pytest
from device_benches import READY, Sway
from wire_helpers import carry_out, wait_for

from scuhand_bt.device_specs.arm import ArmSpec
from scuhand_bt.devices.dynamixel import registers as r
from scuhand_bt.devices.dynamixel.arm import DynamixelArm, arm_axes
from scuhand_bt.devices.dynamixel.axes import Axis
from scuhand_bt.devices.dynamixel.axis_group import AxisGroup
from scuhand_bt.devices.dynamixel.bus import DynamixelBus
from scuhand_bt.devices.dynamixel.servo_loop import ServoChain
from scuhand_bt.devices.interfaces import Joints
from scuhand_bt.devices.liveness import Liveness
from scuhand_bt.failures import SkillFailed
from scuhand_bt.run.clock import WallClock
from scuhand_bt.sim.wire.dynamixel import DynamixelTwin, crane_x7
from scuhand_bt.sim.wire.port import PtyPort
from scuhand_bt.sim.wire.server import TwinServer

pytestmark = pytest.mark.real_time


class Bench:
    """The arm's driver and its twin."""

    def __init__(self) -> None:
        servos = crane_x7(range(2, 9))
        for servo, angle in zip(servos, READY, strict=True):
            servo.position = 2048 + angle * r.COUNTS_PER_RAD
        self.twin = DynamixelTwin(servos)
        self.server = TwinServer(self.twin, PtyPort())
        self.clock = WallClock()
        self.liveness = Liveness()
        self.group = AxisGroup(arm_axes(ArmSpec()))
        bus = DynamixelBus(self.server.url, latency_ms=40.0)  # for a busy computer
        self.chain = ServoChain(bus, [self.group], liveness=self.liveness, reopen_s=0.005)
        self.arm = DynamixelArm(self.chain, self.group)

    def goal_counts(self) -> list[int]:
        return [servo.get(116, 4) for servo in self.twin.servos.values()]


@pytest.fixture
def bench() -> Iterator[Bench]:
    bench = Bench()
    with bench.server:
        bench.chain.open()
        yield bench
        bench.chain.close()


def test_opening_holds_the_arm_where_it_is_and_arms_the_watchdogs(bench: Bench) -> None:
    assert np.allclose(bench.arm.positions, READY, atol=0.002)
    for servo, pid in zip(bench.twin.servos.values(), [axis.pid for axis in bench.group.axes], strict=True):
        assert servo.has_torque
        assert servo.table[9] == 0
        assert servo.table[11] == r.POSITION_MODE
        assert tuple(servo.get(address, 2) for address in (84, 82, 80)) == pid
        assert servo.get(98, 1) == 4


def test_torque_is_never_dropped_by_opening_closing_and_opening_again() -> None:
    bench = Bench()
    with bench.server:
        for _ in range(2):
            bench.chain = ServoChain(DynamixelBus(bench.server.url), [bench.group])
            bench.chain.open()
            assert all(servo.has_torque for servo in bench.twin.servos.values())
            bench.chain.close()
        time.sleep(0.1)
        assert all(servo.has_torque for servo in bench.twin.servos.values())
        assert all(servo.get(98, 1) == 0 for servo in bench.twin.servos.values()), "and nobody is left to trip"


def test_a_trajectory_is_kept_within_half_a_degree_as_a_curve(bench: Bench) -> None:
    trajectory = Sway(bench.arm.positions, 0.3, 1.0)
    seen: list[Joints] = []
    steps = bench.arm.follow(trajectory)
    for wake in steps:
        bench.clock.wait([wake])
        seen.append(bench.arm.positions)
    assert bench.arm.is_stopped
    path = np.array([trajectory.sample(t) for t in np.linspace(0.0, 1.0, 2001)])
    apart = [np.abs(path - positions).max(axis=1).min() for positions in seen]
    assert len(seen) > 40, "the joints are read 50 times a second"
    assert math.degrees(max(apart)) < 0.5
    assert np.allclose(bench.arm.positions, trajectory.sample(1.0), atol=0.005)


def test_goals_are_written_a_hundred_times_a_second(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    times: list[float] = []
    write = bench.chain.bus.sync_write
    monkeypatch.setattr(bench.chain.bus, "sync_write", lambda *a: (times.append(time.monotonic()), write(*a)))
    carry_out(bench.arm.follow(Sway(bench.arm.positions, 0.2, 1.0)), bench.clock)
    assert 80 <= len(times) <= 105


def test_stop_ends_the_motion_on_its_path_and_holds(bench: Bench) -> None:
    start = bench.arm.positions
    trajectory = Sway(start, 0.4, 1.5)
    bench.arm.start(trajectory)
    wait_for(lambda: bench.arm.positions[0] > start[0] + 0.1)
    bench.arm.stop()
    wait_for(lambda: bench.arm.is_stopped)
    offset = bench.arm.positions - start
    assert 0.1 < offset[0] < 0.39
    assert np.ptp(offset) < 0.01, "all joints are at the same point of the path"
    assert all(servo.has_torque for servo in bench.twin.servos.values())


def test_a_trajectory_that_begins_elsewhere_is_refused(bench: Bench) -> None:
    with pytest.raises(SkillFailed, match=r"arm\.not_following: the trajectory begins 5\.7° from where joint \d"):
        bench.arm.start(Sway(bench.arm.positions + 0.1, 0.2, 1.0))


def test_no_goal_beyond_a_servos_window_is_ever_sent(bench: Bench) -> None:
    windows = [(servo.get(52, 4), servo.get(48, 4)) for servo in bench.twin.servos.values()]
    with pytest.raises(SkillFailed, match=r"arm\.joint_limit: joint 6 would go to 90\.\d°"):
        carry_out(bench.arm.follow(Sway(bench.arm.positions, 1.5, 1.0)), bench.clock)
    assert all(low <= goal <= high for goal, (low, high) in zip(bench.goal_counts(), windows, strict=True))


def test_a_goal_at_the_very_end_of_a_window_is_sent(bench: Bench) -> None:
    straight = bench.arm.positions
    swing_rad = np.where(np.arange(7) == 3, -straight[3] + 1e-9, 0.0)  # joint 4 may go up to 0°
    carry_out(bench.arm.follow(Sway(straight, swing_rad, 1.5)), bench.clock)
    assert bench.goal_counts()[3] == 2048


def test_a_blocked_joint_stops_the_arm_and_then_overload_is_named(bench: Bench) -> None:
    bench.twin.servos[5].blocked = True
    with pytest.raises(SkillFailed, match=r"arm\.not_following: joint 4 is 1\d\.\d° from where it should be"):
        carry_out(bench.arm.follow(Sway(bench.arm.positions, 0.5, 1.0)), bench.clock)
    bench.twin.servos[5].fail(5)
    with pytest.raises(SkillFailed, match=r"servo\.overload: servo 5 \(joint 4\) has shut down on overload"):
        carry_out(bench.arm.follow(Sway(bench.arm.positions, 0.01, 1.0)), bench.clock)


def test_a_servo_that_is_too_hot_ends_the_motion_before_it_shuts_down(bench: Bench) -> None:
    bench.twin.servos[3].temperature_c = 77.0
    with pytest.raises(SkillFailed, match=r"servo\.overload: servo 3 \(joint 2\) is at 7\d °C and shuts down at 80"):
        carry_out(bench.arm.follow(Sway(bench.arm.positions, 0.1, 1.0)), bench.clock)


def test_a_hung_tick_stops_the_arm_within_a_tenth_of_a_second(bench: Bench) -> None:
    start = bench.arm.positions
    bench.liveness.beat()
    bench.arm.start(Sway(start, 0.4, 2.0))
    end_s = time.monotonic() + 0.8
    while time.monotonic() < end_s:
        bench.liveness.beat()
        time.sleep(0.01)
    time.sleep(0.1)  # the tick hangs
    stopped_at = bench.goal_counts()
    time.sleep(0.1)
    assert bench.goal_counts() == stopped_at
    assert bench.group.fault is not None
    assert "the run hung for" in bench.group.fault.detail
    assert bench.group.fault.code == "computer.busy", "no obstacle"
    wait_for(lambda: bench.arm.is_stopped)
    bench.liveness.end()
    carry_out(bench.arm.follow(Sway(bench.arm.positions, 0.005, 0.05)), bench.clock)


def test_a_servo_that_is_pushed_away_at_rest_is_a_fault_until_the_next_motion(bench: Bench) -> None:
    assert bench.arm.fault is None
    elbow = bench.twin.servos[5]
    elbow.blocked = True
    elbow.position += 20.0 / 360.0 * 4096
    wait_for(lambda: bench.arm.fault is not None)
    assert str(bench.arm.fault).startswith("arm.not_following: joint 4 is 20.0° from where it should be")
    elbow.blocked = False
    wait_for(lambda: np.allclose(bench.arm.positions, READY, atol=0.01))
    assert bench.arm.fault is not None, "somebody has been there"
    carry_out(bench.arm.follow(Sway(bench.arm.positions, 0.02, 0.2)), bench.clock)
    assert bench.arm.fault is None


HOST = """
import sys, time
import numpy as np
from scuhand_bt.devices.dynamixel.arm import arm_axes
from scuhand_bt.devices.dynamixel.axis_group import AxisGroup
from scuhand_bt.devices.dynamixel.bus import DynamixelBus
from scuhand_bt.devices.dynamixel.servo_loop import ServoChain
from scuhand_bt.device_specs.arm import ArmSpec

class Swaying:
    duration_s = 60.0

    def sample(self, t):
        return start + 0.3 * (1 - np.cos(t))

group = AxisGroup(arm_axes(ArmSpec()))
ServoChain(DynamixelBus(sys.argv[1]), [group]).open()
start = group.positions_rad
group.move(Swaying())
time.sleep(60)
"""


@pytest.mark.parametrize("blow", [signal.SIGKILL, signal.SIGSTOP])
def test_a_host_that_is_killed_or_stopped_leaves_the_arm_stopped_within_a_tenth_of_a_second(
    blow: signal.Signals,
) -> None:
    bench = Bench()
    shoulder = bench.twin.servos[2]
    with bench.server:
        host = subprocess.Popen([sys.executable, "-c", HOST, bench.server.url])
        try:
            wait_for(lambda: shoulder.position > 2048 + 20, timeout_s=20.0)
            host.send_signal(blow)
            time.sleep(0.12)  # 0.1 s, and the twin's own way from its reference to its shaft
            stopped_at = shoulder.position
            time.sleep(0.2)
            assert shoulder.position == pytest.approx(stopped_at, abs=1.0)
            assert all(servo.get(98, 1, signed=True) == -1 for servo in bench.twin.servos.values())
            assert all(servo.has_torque for servo in bench.twin.servos.values())
        finally:
            host.kill()
            host.wait()


def pause_once(bench: Bench, seconds: float) -> None:
    """Let the thread of the bus stand still for once, as a busy computer does."""
    cycle = bench.chain._cycle

    def pause(dt_s: float, now_s: float, read_now: bool) -> None:
        bench.chain._cycle = cycle  # type: ignore[method-assign]
        time.sleep(seconds)

    bench.chain._cycle = pause  # type: ignore[method-assign]


def carry_out_with_a_pause(bench: Bench, trajectory: Sway, seconds: float) -> None:
    for count, wake in enumerate(bench.arm.follow(trajectory)):
        bench.clock.wait([wake])
        if count == 20:
            pause_once(bench, seconds)
            wait_for(lambda: bench.twin.servos[2].get(98, 1, signed=True) == -1, timeout_s=1.0)


def test_after_a_short_pause_of_the_computer_the_motion_goes_on_from_rest(bench: Bench) -> None:
    trajectory = Sway(bench.arm.positions, 0.3, 1.0)
    carry_out_with_a_pause(bench, trajectory, 0.15)
    assert np.allclose(bench.arm.positions, trajectory.sample(1.0), atol=0.005)
    assert all(servo.get(98, 1) == 4 for servo in bench.twin.servos.values()), "watched again"


def test_a_watchdog_that_trips_on_a_silent_line_costs_a_moment_and_not_the_motion(bench: Bench) -> None:
    trajectory = Sway(bench.arm.positions, 0.3, 1.0)
    for count, wake in enumerate(bench.arm.follow(trajectory)):
        bench.clock.wait([wake])
        if count == 20:
            bench.twin.servos[4].put(98, 1, -1)
    assert np.allclose(bench.arm.positions, trajectory.sample(1.0), atol=0.005)


def test_after_a_long_pause_of_the_computer_the_motion_has_failed(bench: Bench) -> None:
    with pytest.raises(SkillFailed, match=r"computer\.busy: this computer paused for [56]\d\d ms"):
        carry_out_with_a_pause(bench, Sway(bench.arm.positions, 0.3, 1.0), 0.55)
    wait_for(lambda: bench.arm.is_stopped)
    carry_out(bench.arm.follow(Sway(bench.arm.positions, 0.1, 0.3)), bench.clock)


def test_a_servo_that_falls_off_the_line_is_named_and_taken_back(bench: Bench) -> None:
    bench.twin.missing.add(6)
    wait_for(lambda: bench.chain.lost is not None)
    with pytest.raises(SkillFailed, match=r"device\.lost: .*servo 6 \(joint 5\) does not answer"):
        carry_out(bench.arm.follow(Sway(bench.arm.positions, 0.1, 0.3)), bench.clock)
    bench.twin.missing.clear()
    wait_for(lambda: bench.chain.lost is None)
    carry_out(bench.arm.follow(Sway(bench.arm.positions, 0.1, 0.3)), bench.clock)


def test_a_bus_that_is_unplugged_at_any_moment_is_reported_and_comes_back_holding(bench: Bench) -> None:
    """Twenty times; five hundred in `benchmarks.devices`."""
    rng = random.Random(5)
    for cycle in range(20):
        swing = Sway(bench.arm.positions, 0.1 if cycle % 2 else -0.1, 0.5)
        wait_for(lambda: bench.arm.is_stopped)
        bench.arm.start(swing)
        time.sleep(rng.uniform(0.0, 0.05))
        bench.server.unplug()
        wait_for(lambda: bench.arm.fault is not None and bench.arm.fault.code == "device.lost")
        assert bench.arm.is_stopped, "its watchdogs see to that"
        assert all(servo.has_torque for servo in bench.twin.servos.values())
        if cycle % 3 == 0:  # and again while it is set up
            bench.server.plug()
            time.sleep(rng.uniform(0.0, 0.03))
            bench.server.unplug()
        bench.server.plug()
        wait_for(lambda: bench.arm.fault is None and bench.arm.is_stopped)
    carry_out(bench.arm.follow(Sway(bench.arm.positions, 0.1, 0.3)), bench.clock)


def test_a_line_that_now_and_then_garbles_or_drops_does_not_stop_a_motion(bench: Bench) -> None:
    trajectory = Sway(bench.arm.positions, 0.2, 1.0)
    for count, wake in enumerate(bench.arm.follow(trajectory)):
        bench.clock.wait([wake])
        if count % 10 == 0:
            setattr(bench.server.misbehaviour, ("drop", "garble", "duplicate")[count // 10 % 3], 1)
    assert np.allclose(bench.arm.positions, trajectory.sample(1.0), atol=0.01)


def test_the_wrong_servo_at_an_id_is_named() -> None:
    bench = Bench()
    bench.twin.servos[3].put(0, 2, 1020)
    with (
        bench.server,
        pytest.raises(SkillFailed, match=r"servo 3 \(joint 2\) .* is a XM430-W350, not a XM540-W270"),
    ):
        bench.chain.open()


def test_a_servo_that_is_shut_down_is_named_at_the_start() -> None:
    bench = Bench()
    bench.twin.servos[3].fail(2)
    with bench.server, pytest.raises(SkillFailed, match=r"servo\.overload: .*overheating and holds nothing"):
        bench.chain.open()


def test_directions_and_home_counts_come_from_the_cells_description() -> None:
    axis = Axis(2, "joint 1", r.XM430, home_count=1000, direction=-1)
    assert axis.count(math.pi / 2) == 1000 - 1024
    assert axis.angle_rad(1000 - 1024) == pytest.approx(math.pi / 2)
    spec = ArmSpec(options={"home_counts": [1, 2, 3, 4, 5, 6, 7], "directions": [1, -1, 1, 1, 1, 1, 1]})
    assert [(axis.home_count, axis.direction) for axis in arm_axes(spec)][:2] == [(1, 1), (2, -1)]


def power(bench: Bench, on: bool) -> None:
    """The servos' supply; the line and its adapter have their own."""
    for servo in bench.twin.servos.values():
        (servo.restore_power if on else servo.cut_power)(time.monotonic())


@pytest.mark.parametrize("dip_s", [0.0, 0.3, 1.5])
def test_an_arm_that_lost_its_power_is_limp_however_short_that_was_and_gets_no_torque_of_itself(
    bench: Bench, dip_s: float
) -> None:
    start = bench.arm.positions
    bench.arm.start(Sway(start, 0.3, 3.0))
    wait_for(lambda: bench.arm.positions[0] > start[0] + 0.02)
    power(bench, on=False)
    time.sleep(dip_s)
    power(bench, on=True)
    wait_for(lambda: bench.arm.fault is not None and bench.arm.fault.code == "arm.limp")
    time.sleep(0.5)
    assert not any(servo.has_torque for servo in bench.twin.servos.values())
    with pytest.raises(SkillFailed, match=r"arm\.limp"):
        bench.arm.start(Sway(bench.arm.positions, 0.1, 0.3))
    elbow = bench.twin.servos[5]
    elbow.position += 100
    wait_for(lambda: abs(bench.arm.positions[3] - bench.group.axes[3].angle_rad(round(elbow.position))) < 0.01)
    assert bench.arm.is_stopped


def test_silence_of_all_servos_is_known_within_a_tenth_of_a_second(bench: Bench) -> None:
    found_s = []
    for _ in range(5):
        bench.chain.bus._port._latency_ms = 8.0  # type: ignore[union-attr]  # a real cell's; twins need more, to answer
        time.sleep(0.05)  # a question under way still waits as long as a twin may take
        power(bench, on=False)
        began_s = time.monotonic()
        wait_for(lambda: bench.arm.fault is not None)
        found_s.append(time.monotonic() - began_s)
        assert str(bench.arm.fault).startswith("arm.limp: no servo on ")
        power(bench, on=True)
        wait_for(lambda: not bench.twin.servos[2].is_silent(time.monotonic()))
        bench.chain.close()
        bench.group = AxisGroup(arm_axes(ArmSpec()))
        bench.chain = ServoChain(DynamixelBus(bench.server.url, latency_ms=40.0), [bench.group])
        bench.chain.open()  # a person has started anew
        bench.arm = DynamixelArm(bench.chain, bench.group)
        assert all(servo.has_torque for servo in bench.twin.servos.values())
    assert sorted(found_s)[len(found_s) // 2] < 0.1


def test_a_line_that_was_unplugged_while_the_power_was_off_comes_back_limp(bench: Bench) -> None:
    bench.server.unplug()
    wait_for(lambda: bench.arm.fault is not None and bench.arm.fault.code == "device.lost")
    power(bench, on=False)
    power(bench, on=True)
    bench.server.plug()
    wait_for(lambda: bench.arm.fault is not None and bench.arm.fault.code == "arm.limp")
    assert not any(servo.has_torque for servo in bench.twin.servos.values())


def test_an_arm_without_torque_is_given_none_unless_a_person_has_seen_to_it() -> None:
    bench = Bench()
    with bench.server:
        with pytest.raises(
            SkillFailed,
            match=r"arm\.limp: joint 1, joint 2, .* have no torque: support the arm, and allow them to hold it",
        ):
            bench.chain.open(may_torque=False)
        assert not any(servo.has_torque for servo in bench.twin.servos.values())
        bench.chain.open()
        assert bench.arm.was_limp
        bench.chain.close()
        again = Bench()
        again.server.port.close()
        again.server = bench.server
        again.chain = ServoChain(DynamixelBus(bench.server.url, latency_ms=40.0), [again.group])
        again.chain.open(may_torque=False)
        assert not DynamixelArm(again.chain, again.group).was_limp, "it has held all the time"
        again.chain.close()
