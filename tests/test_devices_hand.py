import contextlib
import random
import subprocess
import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from wire_helpers import carry_out, wait_for

from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.clock import Steps
from scuhand_bt.device_specs.arm import ArmSpec
from scuhand_bt.device_specs.balance import BalanceSpec
from scuhand_bt.device_specs.changer import ChangerSpec
from scuhand_bt.device_specs.hand import HandSpec
from scuhand_bt.devices.connect import Devices, connect_cell_devices
from scuhand_bt.devices.hand_protocol import Hello, Report, decode, encode
from scuhand_bt.devices.interfaces import Site
from scuhand_bt.devices.keyboard_wedge import NoOptions
from scuhand_bt.devices.liveness import Liveness
from scuhand_bt.devices.serial_link import LineBuffer
from scuhand_bt.failures import SkillFailed
from scuhand_bt.run.clock import WallClock
from scuhand_bt.sim.wire.balances import ShimadzuTwin, StillPan
from scuhand_bt.sim.wire.dynamixel import DynamixelTwin, crane_x7
from scuhand_bt.sim.wire.hand import HandTwin
from scuhand_bt.sim.wire.port import PtyPort
from scuhand_bt.sim.wire.server import TwinServer

pytestmark = pytest.mark.real_time

FIRMWARE = Path(__file__).parent.parent / "robot" / "firmware"


class Cell:
    """All drivers, each with its twin."""

    def __init__(self) -> None:
        self.pan = StillPan(9_200.0)
        self.bus = TwinServer(DynamixelTwin(crane_x7()), PtyPort())
        self.hand_twin = TwinServer(HandTwin(FIRMWARE), PtyPort())
        self.balance_twin = TwinServer(ShimadzuTwin(self.pan), PtyPort())
        self.clock = WallClock()
        self.liveness = Liveness()
        self.spec = CellSpec(
            cell="bench",
            arm=ArmSpec(port=self.bus.url),
            hand=HandSpec(port=self.hand_twin.url),
            balance=BalanceSpec(port=self.balance_twin.url, options={"bits": "8N1"}),
            changer=ChangerSpec(driver="operator"),
            stations={},
        )

    def connect(self) -> Devices:
        devices = connect_cell_devices(self.spec, self.clock, self.liveness)
        devices.hand.rim_is(90.0)
        return devices

    @property
    def servers(self) -> tuple[TwinServer, ...]:  # type: ignore[type-arg]
        return self.bus, self.hand_twin, self.balance_twin

    @property
    def valve(self) -> HandTwin:
        return self.hand_twin.twin


@pytest.fixture
def cell() -> Iterator[Cell]:
    cell = Cell()
    with cell.bus, cell.hand_twin, cell.balance_twin:
        yield cell


@pytest.fixture
def devices(cell: Cell) -> Iterator[Devices]:
    devices = cell.connect()
    yield devices
    devices.close()


def carry_out_while(cell: Cell, steps: Steps[None], meanwhile: Callable[[int], None]) -> None:
    for count, wake in enumerate(steps):
        cell.clock.wait([wake])
        meanwhile(count)


def test_a_whole_cell_is_opened_from_its_description(cell: Cell, devices: Devices) -> None:
    arm, hand, balance, changer = devices.arm, devices.hand, devices.balance, devices.changer
    assert hand.cone_diameter_mm == pytest.approx(90.0)
    assert carry_out(balance.next_reading(), cell.clock).value_mg == 9_200.0
    assert changer is None
    wait_for(lambda: arm.is_stopped and hand.is_stopped and balance.is_stopped)


class OthersArm:
    """An arm with a driver of its own, somewhere else."""

    Options = NoOptions
    twin = ""

    @classmethod
    def connect(cls, site: Site) -> "OthersArm":
        return cls()

    def close(self) -> None:
        """Nothing was opened."""


def test_beside_an_arm_of_others_our_hand_has_its_roller_on_a_port_of_its_own(cell: Cell) -> None:
    hand = cell.spec.hand
    roller = hand.model_copy(update={"options": hand.options.model_copy(update={"roller_port": cell.bus.url})})
    arm = ArmSpec(driver=f"{__name__}:OthersArm")
    own = {"arm": NoOptions()}
    cell.spec = cell.spec.model_copy(update={"arm": arm, "hand": roller, "own_options": own})
    devices = cell.connect()
    try:
        assert type(devices.arm).__name__ == "OthersArm"
        assert devices.hand.fault is None
        turned_by = cell.bus.twin.servos[9].position
        carry_out(devices.hand.morph(85.0), cell.clock)
        assert cell.bus.twin.servos[9].position != turned_by
        assert not cell.bus.twin.servos[2].has_torque, "the arm's servos are none of ours"
    finally:
        devices.close()


@pytest.mark.parametrize("device", ["arm", "hand", "balance"])
def test_a_port_that_cannot_be_opened_is_named_and_the_other_ports_are_closed_again(cell: Cell, device: str) -> None:
    gone = getattr(cell.spec, device).model_copy(update={"port": "/dev/no-such-port"})
    cell.spec = cell.spec.model_copy(update={device: gone})
    with pytest.raises(SkillFailed, match=r"device\.lost: cannot open /dev/no-such-port"):
        cell.connect()


def test_a_pulse_opens_holds_and_shuts(cell: Cell, devices: Devices) -> None:
    began_s = time.monotonic()
    widest = 0.0
    for wake in devices.hand.pulse(1.2, 0.2, vibration=0.5):
        cell.clock.wait([wake])
        widest = max(widest, devices.hand.opening_mm)
    took_s = time.monotonic() - began_s
    assert widest == pytest.approx(1.2, abs=0.04)
    assert 0.85 < took_s < 2.0, "0.06 s dead time and 0.3 s of way, twice, and 0.2 s of dwell"
    assert cell.valve.opening_mm < 0.04
    assert cell.valve.vibration == 0.0
    assert devices.hand.is_stopped


def test_streamed_openings_are_followed_and_closing_closes(cell: Cell, devices: Devices) -> None:
    for step in range(1, 25):
        devices.hand.set_opening(0.05 * step)
        devices.hand.set_vibration(0.3)
        time.sleep(0.02)
    wait_for(lambda: abs(devices.hand.opening_mm - 1.2) < 0.04)
    assert cell.valve.vibration == 0.3
    assert not devices.hand.is_stopped
    devices.hand.stop()
    wait_for(lambda: devices.hand.is_stopped)
    assert cell.valve.vibration == 0.0


def test_the_controller_hears_from_the_host_more_than_twenty_times_a_second(
    cell: Cell, devices: Devices, monkeypatch: pytest.MonkeyPatch
) -> None:
    heard = 0
    hear = cell.valve.hear

    def count(data: bytes, now_s: float) -> list[bytes]:
        nonlocal heard
        heard += data.count(b"\n")
        return hear(data, now_s)

    monkeypatch.setattr(cell.valve, "hear", count)
    time.sleep(1.0)
    assert 20 <= heard <= 60


def test_the_cone_is_morphed_by_the_roller(cell: Cell, devices: Devices) -> None:
    roller = cell.bus.twin.servos[9]
    before = roller.position
    carry_out(devices.hand.morph(85.0), cell.clock)
    assert devices.hand.cone_diameter_mm == pytest.approx(85.0, abs=0.05)
    turned_deg = (roller.position - before) * 360 / 4096
    assert turned_deg == pytest.approx(3.14159 * 5.0 * 11.46, rel=0.01)


def test_a_pulse_that_is_halted_closes_the_valve(cell: Cell, devices: Devices) -> None:
    steps = devices.hand.pulse(1.2, 30.0, vibration=1.0)
    for wake in steps:
        cell.clock.wait([wake])
        if devices.hand.opening_mm > 1.0:
            break
    steps.close()
    wait_for(lambda: devices.hand.is_stopped)
    assert cell.valve.opening_mm < 0.04


def test_a_lost_answer_does_not_repeat_the_pulse(cell: Cell, devices: Devices) -> None:
    cell.hand_twin.misbehaviour.drop = 3
    openings = []
    for wake in devices.hand.pulse(0.4, 0.05):
        cell.clock.wait([wake])
        openings.append(cell.valve.opening_mm > 0.2)
    time.sleep(0.3)
    assert cell.valve.opening_mm < 0.04
    assert sum(now and not before for before, now in pairwise(openings)) == 1


def test_the_emergency_stop_ends_a_pulse_and_is_named_until_it_is_released(cell: Cell, devices: Devices) -> None:
    def press_when_open(count: int) -> None:
        cell.valve.emergency_stop = cell.valve.emergency_stop or devices.hand.opening_mm > 1.0

    with pytest.raises(SkillFailed, match=r"device\.emergency_stop"):
        carry_out_while(cell, devices.hand.pulse(1.2, 30.0), press_when_open)
    wait_for(lambda: cell.valve.opening_mm < 0.04)
    with pytest.raises(SkillFailed, match=r"device\.emergency_stop"):
        carry_out(devices.hand.pulse(0.4, 0.05), cell.clock)
    time.sleep(0.1)  # it is pressed all the time
    cell.valve.emergency_stop = False
    with pytest.raises(SkillFailed, match=r"is \(or was\) pressed"):
        carry_out(devices.hand.pulse(0.4, 0.05), cell.clock)
    time.sleep(0.1)
    carry_out(devices.hand.pulse(0.4, 0.05), cell.clock)


def test_a_stuck_valve_and_a_dead_servo_are_named(cell: Cell, devices: Devices) -> None:
    cell.valve.healthy = False
    wait_for(lambda: (report := devices.hand._controller.report) is not None and report.faults)
    with pytest.raises(SkillFailed, match=r"hand\.valve_lost: .*does not answer, was without power"):
        devices.hand.set_opening(1.0)
    devices.hand.set_opening(0.0)
    devices.hand.set_vibration(0.0)


def test_a_hung_tick_closes_the_valve_and_is_said(cell: Cell, devices: Devices) -> None:
    cell.liveness.beat()
    devices.hand.set_opening(1.0)
    devices.hand.set_vibration(1.0)
    for _ in range(40):
        cell.liveness.beat()
        time.sleep(0.01)
    assert cell.valve.opening_mm > 0.9
    time.sleep(0.25)  # the tick hangs
    assert cell.valve.opening_mm < 0.9
    assert cell.valve.vibration == 0.0
    cell.liveness.beat()
    with pytest.raises(SkillFailed, match="the run hung for"):
        devices.hand.set_opening(1.0)
    cell.liveness.end()
    carry_out(devices.hand.pulse(0.4, 0.05), cell.clock)


def test_a_restarted_controller_is_greeted_again_and_the_pulse_fails(cell: Cell, devices: Devices) -> None:
    def reboot(count: int) -> None:
        if count == 10:
            cell.valve.reboot()

    with pytest.raises(SkillFailed, match="has restarted"):
        carry_out_while(cell, devices.hand.pulse(0.8, 30.0), reboot)
    wait_for(lambda: devices.hand.is_stopped)
    carry_out(devices.hand.pulse(0.4, 0.05), cell.clock)


def test_a_controller_that_hangs_is_lost_and_comes_back(cell: Cell, devices: Devices) -> None:
    cell.hand_twin.paused = True
    wait_for(lambda: devices.hand._controller.trouble is not None)
    with pytest.raises(SkillFailed, match=r"device\.lost: the hand controller .* does not answer"):
        devices.hand.set_opening(1.0)
    assert not devices.hand.is_stopped, "nobody knows"
    cell.hand_twin.paused = False
    wait_for(lambda: devices.hand.is_stopped)
    carry_out(devices.hand.pulse(0.4, 0.05), cell.clock)


def test_faults_that_an_earlier_program_left_are_cleared_unless_their_cause_is_still_there(cell: Cell) -> None:
    first = cell.connect()
    first.hand.set_vibration(1.0)
    wait_for(lambda: cell.valve.vibration == 1.0)
    cell.hand_twin.unplug()
    wait_for(lambda: cell.valve.vibration == 0.0)
    first.close()
    cell.hand_twin.plug()
    second = cell.connect()
    wait_for(lambda: second.hand.is_stopped)
    assert second.hand.fault is None
    carry_out(second.hand.pulse(0.4, 0.05), cell.clock)
    second.close()
    cell.valve.emergency_stop = True
    third = cell.connect()
    wait_for(lambda: third.hand.fault is not None and third.hand.fault.code == "device.emergency_stop")
    third.close()


def test_an_opening_that_was_asked_of_a_lost_controller_is_not_made_up_for_when_it_comes_back(
    cell: Cell, devices: Devices
) -> None:
    wait_for(lambda: devices.hand.is_stopped)
    cell.hand_twin.paused = True
    devices.hand.set_opening(2.0)
    devices.hand.set_vibration(1.0)
    wait_for(lambda: devices.hand._controller.trouble is not None)
    cell.hand_twin.paused = False
    wait_for(lambda: devices.hand.is_stopped)
    time.sleep(0.2)
    assert cell.valve.opening_mm < 0.04
    assert cell.valve.vibration == 0.0


def test_many_unplugs_of_the_hand_at_any_moment_of_a_pulse_are_each_reported_and_survived(
    cell: Cell, devices: Devices
) -> None:
    """Ten; five hundred in `benchmarks.devices`."""
    rng = random.Random(7)
    devices.hand._controller._link._reopen_s = 0.005
    for cycle in range(10):
        if cycle % 5 == 0:  # the others meet a hand at rest: a valve takes its time to close
            wait_for(lambda: devices.hand.is_stopped)
            devices.hand.set_vibration(1.0)
            devices.hand.set_opening(1.0)
        time.sleep(rng.uniform(0.0, 0.03))
        cell.hand_twin.unplug()
        wait_for(lambda: devices.hand.fault is not None and devices.hand.fault.code == "device.lost")
        assert not devices.hand.is_stopped, "nobody knows"
        if cycle % 5 == 0:
            wait_for(lambda: cell.valve.opening_mm < 0.04 and cell.valve.vibration == 0.0)
        if cycle % 3 == 0:  # and again while it is greeted
            cell.hand_twin.plug()
            time.sleep(rng.uniform(0.0, 0.03))
            cell.hand_twin.unplug()
            wait_for(lambda: devices.hand.fault is not None)  # else the greeting before this loss passes for the next
        cell.hand_twin.plug()
        wait_for(lambda: _is_well(devices))
    carry_out(devices.hand.pulse(0.4, 0.05), cell.clock)


def _is_well(devices: Devices) -> bool:
    """What a next action would ask: it clears the dead-man's fault, and fails until that is gone."""
    with contextlib.suppress(SkillFailed):
        devices.hand.set_vibration(0.01)
        devices.hand.set_vibration(0.0)
    return devices.hand.fault is None and devices.hand._controller.report is not None


def test_noise_and_broken_answers_do_not_disturb_a_pulse(cell: Cell, devices: Devices) -> None:
    rng = random.Random(2)
    cell.hand_twin.misbehaviour.delay_s = 0.02
    for count, wake in enumerate(devices.hand.pulse(1.0, 0.5)):
        cell.clock.wait([wake])
        if count % 10 == 0:
            setattr(cell.hand_twin.misbehaviour, rng.choice(["drop", "garble", "duplicate", "split"]), 1)
        if count % 17 == 0:
            cell.hand_twin.misbehaviour.noise = rng.randbytes(20)
    assert cell.valve.opening_mm < 0.04


REPORT = Report(17, "", "open", 1.248, 0.0, "ed", 31)


def test_an_answer_is_read_with_all_it_says() -> None:
    body = "17 ok open 1.248 0.000 ed 31"
    assert decode(encode(17, body.removeprefix("17 "))) == REPORT
    assert REPORT.why.startswith("the emergency stop")
    refused = decode(encode(18, "no fault closed -0.012 0.000 - 31"))
    assert refused == Report(18, "fault", "closed", -0.012, 0.0, "", 31)
    assert decode(encode(0, "hello 2 2.0 2.400")) == Hello(0, "2.0", 2.4)


@given(st.binary(max_size=80))
def test_no_bytes_make_the_decoder_fail(data: bytes) -> None:
    decode(data)
    decode(data + b"\n")


def test_a_million_random_and_mutated_bytes_give_no_false_report() -> None:
    rng = random.Random(9)
    good = [encode(n, f"ok open {n / 1000:.3f} 0.000 - 31") for n in range(50)]
    buffer, fed, accepted = LineBuffer(), 0, set()
    while fed < 1_000_000:
        chunk = bytearray(rng.choice(good) if rng.random() < 0.7 else rng.randbytes(rng.randrange(100)))
        if chunk and rng.random() < 0.5:
            chunk[rng.randrange(len(chunk))] = rng.randrange(256)
        fed += len(chunk)
        accepted |= {report for line in buffer.feed(bytes(chunk)) if (report := decode(line)) is not None}
    assert accepted == {decode(line) for line in good}


def test_no_single_or_double_error_of_an_answer_goes_unnoticed() -> None:
    line = encode(17, "ok open 1.248 0.000 ed 31")
    rng = random.Random(4)
    for at in range(len(line) - 1):
        for bit in range(7):
            broken = bytearray(line)
            broken[at] ^= 1 << bit
            assert decode(bytes(broken)) is None
            broken[rng.randrange(len(line) - 1)] ^= 1 << rng.randrange(7)
            assert decode(bytes(broken)) in (None, REPORT)


def test_a_killed_host_is_noticed_by_the_controller_and_the_valve_closes(cell: Cell) -> None:
    """A process opens the valve through the twin's port and is stopped with SIGSTOP, then killed."""
    script = (
        "import sys, time\n"
        "from scuhand_bt.device_specs.hand import HandSpec\n"
        "from scuhand_bt.devices.hand_controller import HandController\n"
        "hand = HandController(HandSpec(port=sys.argv[1])); hand.open()\n"
        "hand.set_opening(2.0); hand.set_vibration(1.0)\n"
        "time.sleep(60)\n"
    )
    import signal
    import sys

    host = subprocess.Popen([sys.executable, "-c", script, cell.hand_twin.url])
    try:
        wait_for(lambda: cell.valve.opening_mm > 1.9, timeout_s=10.0)
        for blow in (signal.SIGSTOP, signal.SIGKILL):
            host.send_signal(blow)
            if blow == signal.SIGSTOP:
                time.sleep(0.1)
                assert cell.valve.vibration == 1.0, "not before its time"
            wait_for(lambda: cell.valve.vibration == 0.0, timeout_s=0.2)
            wait_for(lambda: cell.valve.opening_mm < 0.04)
    finally:
        host.kill()
        host.wait()
