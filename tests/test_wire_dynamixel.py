"""The bus twin: byte by byte against the e-manual's examples, and with the raw SDK as its client."""

import random
from collections.abc import Iterator

import dynamixel_sdk as sdk
import pytest

from scuhand_bt.sim.wire.dynamixel import DynamixelTwin, crane_x7, packet
from scuhand_bt.sim.wire.port import PtyPort
from scuhand_bt.sim.wire.server import TwinServer
from scuhand_bt.sim.wire.servo import ACCESS_ERROR, LIMIT_ERROR, RANGE_ERROR, XM430, Servo


def test_random_and_mutated_bytes_do_not_hang_the_twin_or_move_a_servo_wrongly() -> None:
    rng = random.Random(7)
    twin = DynamixelTwin(crane_x7())
    good = [packet(2, 3, bytes([116, 0, 0, 8, 0, 0])), packet(254, 0x83, bytes([116, 0, 4, 0, 3, 0, 8, 0, 0]))]
    good += [packet(i, code, rng.randbytes(8)) for i in (2, 3, 99) for code in (1, 2, 5, 8, 16, 0x55, 0x92)]
    fed = 0
    while fed < 300_000:
        chunk = bytearray(rng.choice(good) if rng.random() < 0.8 else rng.randbytes(300))
        for _ in range(rng.randrange(3)):
            chunk[rng.randrange(len(chunk))] = rng.randrange(256)
        fed += len(chunk)
        twin.hear(bytes(chunk), 0.0)
    assert all(servo.get(116, 4) in (2048,) for servo in twin.servos.values())


def test_eeprom_is_locked_while_torque_is_on_and_the_present_values_always() -> None:
    servo = Servo(2, XM430)
    assert servo.write(11, b"\x04", 0.0) == 0
    assert servo.write(64, b"\x01", 0.0) == 0
    assert servo.write(11, b"\x03", 0.0) == ACCESS_ERROR
    assert servo.write(132, b"\0\0\0\0", 0.0) == ACCESS_ERROR
    assert servo.write(64, b"\x02", 0.0) == RANGE_ERROR
    assert servo.write(116, (1_048_576).to_bytes(4, "little"), 0.0) == LIMIT_ERROR


def test_a_change_of_mode_resets_gains_and_profile() -> None:
    servo = Servo(2, XM430)
    servo.write(112, b"\x64\0\0\0", 0.0)
    servo.write(84, b"\xe8\x03", 0.0)
    servo.write(11, b"\x04", 0.0)
    assert (servo.get(112, 4), servo.get(84, 2)) == (0, 800)


def test_a_profile_takes_its_time_and_no_profile_goes_at_the_servos_speed() -> None:
    for profile, expected_s in ((20, 3.3), (0, 0.35)):
        servo = Servo(2, XM430, position=1024.0)
        servo.step(0.0)
        servo.write(112, profile.to_bytes(4, "little"), 0.0)
        servo.write(64, b"\x01", 0.0)
        servo.write(116, (2048).to_bytes(4, "little"), 0.0)
        now_s = 0.0
        while abs(servo.position - 2048) > 5:
            now_s += 0.005
            servo.step(now_s)
        assert now_s == pytest.approx(expected_s, rel=0.15)


def test_a_blocked_servo_overloads_shuts_down_and_only_a_reboot_brings_it_back() -> None:
    servo = Servo(2, XM430)
    servo.step(0.0)
    servo.write(64, b"\x01", 0.0)
    servo.blocked = True
    servo.write(116, (3000).to_bytes(4, "little"), 0.0)
    for step in range(1, 400):
        servo.step(step * 0.005)
    assert servo.table[70] == 1 << 5
    assert not servo.has_torque
    assert servo.write(64, b"\x01", 2.0) == ACCESS_ERROR
    servo.blocked = False
    servo.reboot(2.0)
    assert servo.write(64, b"\x01", 2.1) == 0


def test_a_servo_whose_twin_ends_while_it_has_no_power_begins_again_without_its_turns_and_its_torque() -> None:
    servo, again = Servo(9, position=2048 + 3 * 4096), Servo(9)
    servo.put(64, 1, 1)
    servo.cut_power(1.0)
    again.kept = servo.kept
    assert (again.shaft, again.position, again.has_torque) == (servo.shaft, 2048, False)


def test_the_watchdog_stops_the_servo_and_refuses_goals_until_it_is_cleared() -> None:
    servo = Servo(2, XM430)
    servo.step(0.0)
    servo.write(64, b"\x01", 0.0)
    servo.write(98, b"\x04", 0.0)
    servo.write(112, b"\x05\0\0\0", 0.0)
    servo.write(116, (3000).to_bytes(4, "little"), 0.0)
    for step in range(1, 50):
        servo.step(step * 0.01)
    assert servo.get(98, 1, signed=True) == -1
    assert servo.position < 2200
    assert servo.write(116, (2500).to_bytes(4, "little"), 0.5) == RANGE_ERROR
    assert servo.write(98, b"\0", 0.5) == 0
    assert servo.write(116, (2500).to_bytes(4, "little"), 0.5) == 0


@pytest.fixture
def twin() -> Iterator[TwinServer[DynamixelTwin]]:
    with TwinServer(DynamixelTwin(crane_x7()), PtyPort()) as server:
        yield server


@pytest.fixture
def port(twin: TwinServer[DynamixelTwin], monkeypatch: pytest.MonkeyPatch) -> Iterator[sdk.PortHandler]:
    monkeypatch.setattr("dynamixel_sdk.port_handler.LATENCY_TIMER", 100)  # for a busy computer
    port = sdk.PortHandler(twin.url)
    assert port.setBaudRate(3_000_000)
    yield port
    port.closePort()


Twin = TwinServer[DynamixelTwin]
ph = sdk.PacketHandler(2.0)


@pytest.mark.real_time
def test_the_raw_sdk_finds_reads_and_writes_the_servos(twin: Twin, port: sdk.PortHandler) -> None:
    assert ph.ping(port, 2)[:2] == (1020, sdk.COMM_SUCCESS)
    assert ph.ping(port, 3)[:2] == (1120, sdk.COMM_SUCCESS)
    assert ph.ping(port, 42)[1] == sdk.COMM_RX_TIMEOUT
    found, result = ph.broadcastPing(port)
    assert result == sdk.COMM_SUCCESS
    assert sorted(found) == list(range(2, 10))
    assert ph.write1ByteTxRx(port, 2, 64, 1) == (sdk.COMM_SUCCESS, 0)
    assert ph.write1ByteTxRx(port, 2, 11, 4) == (sdk.COMM_SUCCESS, ACCESS_ERROR)
    assert ph.read4ByteTxRx(port, 2, 132) == (2048, sdk.COMM_SUCCESS, 0)


@pytest.mark.real_time
def test_the_raw_sdk_reads_and_writes_many_at_once(twin: Twin, port: sdk.PortHandler) -> None:
    write = sdk.GroupSyncWrite(port, ph, 116, 4)
    read = sdk.GroupSyncRead(port, ph, 116, 4)
    for servo in (2, 3, 4):
        assert write.addParam(servo, list((2000 + servo).to_bytes(4, "little")))
        assert read.addParam(servo)
    assert write.txPacket() == sdk.COMM_SUCCESS
    for answer in (read.txRxPacket, read.fastSyncRead):
        assert answer() == sdk.COMM_SUCCESS
        assert [read.getData(servo, 116, 4) for servo in (2, 3, 4)] == [2002, 2003, 2004]
    bulk = sdk.GroupBulkRead(port, ph)
    bulk.addParam(2, 0, 2)
    bulk.addParam(3, 116, 4)
    assert bulk.txRxPacket() == sdk.COMM_SUCCESS
    assert (bulk.getData(2, 0, 2), bulk.getData(3, 116, 4)) == (1020, 2003)
    many = sdk.GroupBulkWrite(port, ph)
    many.addParam(2, 116, 4, list((2100).to_bytes(4, "little")))
    many.addParam(4, 65, 1, [1])
    assert many.txPacket() == sdk.COMM_SUCCESS
    assert ph.read4ByteTxRx(port, 2, 116)[0] == 2100
    assert ph.read1ByteTxRx(port, 4, 65)[0] == 1


@pytest.mark.real_time
def test_the_raw_sdk_registers_acts_and_reboots(twin: Twin, port: sdk.PortHandler) -> None:
    assert ph.regWriteTxRx(port, 2, 116, 4, list((1900).to_bytes(4, "little"))) == (sdk.COMM_SUCCESS, 0)
    assert ph.read1ByteTxRx(port, 2, 69)[0] == 1
    assert ph.read4ByteTxRx(port, 2, 116)[0] == 2048
    assert ph.action(port, 254) == sdk.COMM_SUCCESS
    assert ph.read4ByteTxRx(port, 2, 116)[0] == 1900
    twin.twin.servos[2].fail(5)
    assert ph.ping(port, 2)[2] == 0x80
    assert ph.reboot(port, 2)[0] == sdk.COMM_SUCCESS
    assert ph.ping(port, 2)[2] == 0
    assert ph.clearMultiTurn(port, 2) == (sdk.COMM_SUCCESS, 0)


@pytest.mark.real_time
def test_the_raw_sdk_reads_and_writes_scattered_registers_by_their_indirect_addresses(
    twin: Twin, port: sdk.PortHandler
) -> None:
    for k, register in enumerate((116, 117, 118, 119, 65)):
        assert ph.write2ByteTxRx(port, 2, 578 + 2 * k, register) == (sdk.COMM_SUCCESS, 0)
    written = [*(1500).to_bytes(4, "little"), 1]
    assert ph.writeTxRx(port, 2, 634, 5, written) == (sdk.COMM_SUCCESS, 0)
    assert (ph.read4ByteTxRx(port, 2, 116)[0], ph.read1ByteTxRx(port, 2, 65)[0]) == (1500, 1)
    assert ph.readTxRx(port, 2, 634, 5)[0] == written
    ph.write2ByteTxRx(port, 2, 168, 132)
    assert ph.write1ByteTxRx(port, 2, 224, 1) == (sdk.COMM_SUCCESS, ACCESS_ERROR), "where it is, is read only"
    ph.reboot(port, 2)
    assert any(ph.ping(port, 2)[1] == sdk.COMM_SUCCESS for _ in range(50)), "it begins anew"
    assert [ph.read2ByteTxRx(port, 2, address)[0] for address in (168, 222, 578, 632)] == [224, 251, 634, 661]


@pytest.mark.real_time
def test_a_servo_whose_id_is_written_answers_to_that_and_two_of_one_id_are_not_understood(
    twin: Twin, port: sdk.PortHandler
) -> None:
    assert ph.write1ByteTxRx(port, 9, 7, 253) == (sdk.COMM_SUCCESS, RANGE_ERROR)
    assert ph.write1ByteTxRx(port, 9, 7, 40)[0] == sdk.COMM_SUCCESS
    assert ph.ping(port, 40)[1] == sdk.COMM_SUCCESS
    assert ph.ping(port, 9)[1] == sdk.COMM_RX_TIMEOUT
    ph.write1ByteTxRx(port, 40, 7, 2)
    assert ph.ping(port, 2)[1] != sdk.COMM_SUCCESS
    ph.write1ByteTxOnly(port, 2, 65, 1)
    assert ph.ping(port, 3)[1] == sdk.COMM_SUCCESS
    assert [servo.table[65] for servo in (twin.twin.servos[2], *twin.twin.doubles)] == [1, 1]


def test_answers_take_their_time_on_the_line_one_after_another() -> None:
    twin = DynamixelTwin(crane_x7((2, 3, 4, 5, 6, 7, 8)))
    for servo in twin.servos.values():
        servo.table[8], servo.table[9] = 1, 0  # 57 600 baud, no return delay
    of_three = packet(0xFE, 0x82, bytes([132, 0, 4, 0, 2, 3, 4]))
    assert twin.hear(of_three, 0.0) == []
    for number in (1, 2, 3):
        came_s = number * 15 * 10 / 57_600
        assert len(twin.hear(b"", came_s - 1e-4)) == 0
        assert len(twin.hear(b"", came_s + 1e-6)) == 1
