import random
import time
from collections.abc import Iterator

import pytest
from dynamixel_sdk import COMM_PORT_BUSY, PacketHandler, PortHandler

from scuhand_bt.devices.dynamixel import registers as r
from scuhand_bt.devices.dynamixel.bus import BusLost, DynamixelBus, NoAnswer, ServoRefused
from scuhand_bt.sim.wire.dynamixel import DynamixelTwin, crane_x7
from scuhand_bt.sim.wire.port import PtyPort
from scuhand_bt.sim.wire.server import TwinServer

pytestmark = pytest.mark.real_time

Line = TwinServer[DynamixelTwin]


@pytest.fixture
def twin() -> Iterator[Line]:
    with TwinServer(DynamixelTwin(crane_x7()), PtyPort()) as server:
        for servo in server.twin.servos.values():
            servo.table[9] = 0
        yield server


@pytest.fixture
def bus(twin: Line) -> Iterator[DynamixelBus]:
    bus = DynamixelBus(twin.url, latency_ms=20.0)  # for a busy computer
    bus.open()
    yield bus
    bus.close()


def test_values_are_read_with_their_sign(bus: DynamixelBus, twin: Line) -> None:
    servo = twin.twin.servos[9]
    for value in (-1, -131073, 2048, 1_048_575):
        servo.position = value
        assert bus.read(9, r.PRESENT_POSITION) == value
    bus.write(9, r.TORQUE_ENABLE, 1)
    servo.blocked = True
    assert bus.read(9, r.PRESENT_CURRENT) < -1000, "the goal is far below"


def test_a_payload_that_looks_like_a_header_is_stuffed_on_its_way_out(bus: DynamixelBus, twin: Line) -> None:
    bus.write(9, r.OPERATING_MODE, r.EXTENDED_POSITION_MODE)
    goal = int.from_bytes(b"\xff\xff\xfd\xff", "little", signed=True)
    assert goal == -131073
    bus.write(9, r.GOAL_POSITION, goal)
    assert twin.twin.servos[9].get(116, 4, signed=True) == goal
    bus.sync_write(r.GOAL_POSITION, {9: 0})
    bus.sync_write(r.GOAL_POSITION, {9: goal})
    assert bus.read(9, r.GOAL_POSITION) == goal


def test_a_late_answer_is_never_taken_for_the_next_questions(bus: DynamixelBus, twin: Line) -> None:
    twin.misbehaviour.delay_s = 0.055
    for _ in range(5):
        twin.misbehaviour.delay = 1
        with pytest.raises(NoAnswer):
            bus.read(2, r.PRESENT_POSITION)
        assert bus.read(2, r.MODEL_NUMBER) == 1020, "and not 2048, the position that was asked before"


def test_an_answer_of_another_length_is_refused(bus: DynamixelBus, twin: Line) -> None:
    twin.paused = True
    with pytest.raises(NoAnswer, match="does not answer"):
        bus.read(2, r.PRESENT_POSITION)
    twin.paused = False
    bus._suspect = None  # as if nothing had happened before: the late answer meets the next question
    twin.misbehaviour.drop = 1
    twin.misbehaviour.noise = b""
    with pytest.raises(NoAnswer):
        bus.read(2, r.MODEL_NUMBER)
    assert bus.read(2, r.MODEL_NUMBER) == 1020


def test_a_broken_answer_and_a_doubled_one_cost_one_question(bus: DynamixelBus, twin: Line) -> None:
    twin.misbehaviour.garble = 1
    with pytest.raises(NoAnswer):
        bus.read(3, r.MODEL_NUMBER)
    assert bus.read(3, r.MODEL_NUMBER) == 1120
    for _ in range(20):
        twin.misbehaviour.duplicate = 1
        assert bus.read(2, r.PRESENT_POSITION) == 2048
        assert bus.read(2, r.MODEL_NUMBER) == 1020
    twin.misbehaviour.noise = b"\xff\xff\xfd\x00\x02\xff"
    assert bus.read(2, r.MODEL_NUMBER) == 1020


def test_answers_in_pieces_are_put_together(bus: DynamixelBus, twin: Line) -> None:
    twin.misbehaviour.delay_s = 0.004
    twin.misbehaviour.split = 3
    assert [bus.read(servo, r.PRESENT_POSITION) for servo in (2, 3, 4)] == [2048, 2048, 2048]


def test_action_leaves_no_answer_on_the_wire(bus: DynamixelBus, twin: Line) -> None:
    twin.twin.servos[2].registered = (116, (3000).to_bytes(4, "little"))
    bus.action()
    assert bus.read(2, r.GOAL_POSITION) == 3000


def test_waiting_for_an_answer_costs_no_processor_time(bus: DynamixelBus, twin: Line) -> None:
    wall_s, cpu_s = time.perf_counter(), time.thread_time()
    for _ in range(5):
        with pytest.raises(NoAnswer):
            bus.ping(77)
    wall_s, cpu_s = time.perf_counter() - wall_s, time.thread_time() - cpu_s
    assert cpu_s < 0.3 * wall_s, f"{cpu_s:.3f} s of {wall_s:.3f} s"


def test_a_port_that_died_in_mid_call_can_be_opened_again(bus: DynamixelBus, twin: Line) -> None:
    for _ in range(3):
        twin.unplug()
        with pytest.raises(BusLost):
            bus.read(2, r.PRESENT_POSITION)
        with pytest.raises(BusLost, match="is not open"):
            bus.read(2, r.PRESENT_POSITION)
        twin.plug()
        bus.open()
        assert bus.ping(2) == 1020


def test_the_sdk_alone_stays_busy_for_ever_after_that(twin: Line) -> None:
    port, packets = PortHandler(twin.url), PacketHandler(2.0)
    port.setBaudRate(3_000_000)
    twin.unplug()
    with pytest.raises(Exception):  # noqa: B017, PT011 - OSError or termios.error, as it happens
        packets.ping(port, 2)
    assert packets.ping(port, 2)[1] == COMM_PORT_BUSY
    port.closePort()


def test_speeds_the_sdk_does_not_know_are_refused_in_words(twin: Line) -> None:
    with pytest.raises(BusLost, match="4500000 baud"):
        DynamixelBus(twin.url, baud=4_500_000).open()


def test_what_a_servo_refuses_is_said_with_its_reason(bus: DynamixelBus, twin: Line) -> None:
    bus.write(2, r.TORQUE_ENABLE, 1)
    with pytest.raises(ServoRefused, match="cannot be written"):
        bus.write(2, r.OPERATING_MODE, 4)
    with pytest.raises(ServoRefused, match="beyond a limit"):
        bus.write(2, r.GOAL_POSITION, 100)
    with pytest.raises(ServoRefused, match="cannot be written"):
        bus.write(2, r.PRESENT_POSITION, 100)


@pytest.mark.parametrize("fast", [False, True])
def test_all_servos_are_read_in_one_question(bus: DynamixelBus, twin: Line, fast: bool) -> None:
    read = bus.fast_sync_read if fast else bus.sync_read
    servos = list(twin.twin.servos)
    for count, servo in enumerate(servos):
        twin.twin.servos[servo].position = -100 * count
    twin.twin.servos[4].fail(5)
    answers = read(servos, 122, 25)
    assert [r.PRESENT_POSITION.of(answers[servo].data, 122) for servo in servos] == [-100 * i for i in range(8)]
    assert [servo for servo in servos if answers[servo].alert] == [4]


def test_a_position_that_looks_like_a_header_comes_back_right_both_ways(bus: DynamixelBus, twin: Line) -> None:
    servo = twin.twin.servos[3]
    servo.position = -131073
    for read in (bus.sync_read, bus.fast_sync_read):
        assert r.PRESENT_POSITION.of(read([2, 3, 4], 122, 25)[3].data, 122) == -131073


def test_a_missing_servo_is_missing_and_the_others_before_it_are_not(bus: DynamixelBus, twin: Line) -> None:
    twin.twin.missing.add(5)
    assert sorted(bus.sync_read([2, 3, 4, 5, 6], 122, 25)) == [2, 3, 4]
    with pytest.raises(NoAnswer):
        bus.fast_sync_read([2, 3, 4, 5, 6], 122, 25)
    twin.twin.missing.clear()
    assert sorted(bus.sync_read([2, 3, 4, 5, 6], 122, 25)) == [2, 3, 4, 5, 6]


def test_no_false_value_comes_out_of_a_line_that_misbehaves_at_random(bus: DynamixelBus, twin: Line) -> None:
    rng = random.Random(3)
    twin.misbehaviour.delay_s = 0.055
    wrong = failed = 0
    for _ in range(40):
        setattr(twin.misbehaviour, rng.choice(["drop", "garble", "duplicate", "delay", "split"]), 1)
        servo = rng.choice([2, 3])
        register, expected = rng.choice(
            [
                (r.MODEL_NUMBER, {2: 1020, 3: 1120}),
                (r.PRESENT_POSITION, {2: 2048, 3: 2048}),
                (r.FIRMWARE, {2: 46, 3: 46}),
            ]
        )
        try:
            wrong += bus.read(servo, register) != expected[servo]
        except NoAnswer:
            failed += 1
    assert wrong == 0
    assert failed > 5
