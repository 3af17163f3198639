"""The firmware and its servo through what happens to their power: on this computer, and as binaries for real boards.

The sketch is built with Arduino's own core, and the reference board's binary is run in simavr.
"""

import importlib
import re
import subprocess
from itertools import pairwise
from pathlib import Path

import pytest
import yaml

from harness.avr_board import AvrHand, build_firmware, build_simulator, missing_tools
from harness.hand_host import FIRMWARE, MAP, Board, Host
from scuhand_bt.device_specs.hand import ValvePoint
from scuhand_bt.devices.hand_protocol import Hello
from scuhand_bt.sim.wire.hand import HandTwin
from scuhand_bt.sim.wire.servo import BOOT_S, OVERLOAD_BIT

"""One worker builds the boards' binaries."""

SHUT_MM = 0.04
AFTER_POWER_S = 0.5
"""With the servo's power there again, and the servo begun, the valve is shut within this time from its widest."""
WIDEST_MM = 2.4


@pytest.fixture(scope="session")
def binaries(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the firmware stands built for both boards, and simavr around the reference board."""
    if missing := missing_tools():
        pytest.skip(missing)
    out = tmp_path_factory.mktemp("avr")
    build_firmware(FIRMWARE, out)
    build_simulator(out)
    return out


@pytest.fixture(params=["this computer", "Mega 2560 in simavr"])
def board(request: pytest.FixtureRequest) -> Board:
    """The firmware's board, on a valve's servo that is computed."""
    if request.param == "this computer":
        return HandTwin(FIRMWARE)
    out: Path = request.getfixturevalue("binaries")
    return AvrHand(out / "mega.elf", out / "board.so")


@pytest.fixture
def mega(binaries: Path) -> AvrHand:
    return AvrHand(binaries / "mega.elf", binaries / "board.so")


def opened(host: Host, opening_mm: float = 1.0) -> Host:
    host.report(f"open {opening_mm:.3f}")
    host.until(lambda: host.twin.opening_mm > opening_mm - 0.03, 1.0)
    return host


def is_shut(host: Host) -> bool:
    return host.twin.opening_mm < SHUT_MM


@pytest.mark.parametrize("name", ["mega", "leonardo"])
def test_the_sketch_builds_with_the_real_core_and_fits_its_board(binaries: Path, name: str) -> None:
    listing = subprocess.run(["avr-size", str(binaries / f"{name}.elf")], capture_output=True, text=True, check=True)
    text, data, bss, *_ = (int(field) for field in listing.stdout.splitlines()[1].split()[:3])
    flash, ram = {"mega": (253_952, 8192), "leonardo": (28_672, 2560)}[name]
    assert text + data < flash
    assert data + bss < 0.6 * ram, "the rest is the stack's"


def test_a_board_with_one_serial_port_is_refused_in_words() -> None:
    if missing := missing_tools():
        pytest.skip(missing)
    sketch, core = FIRMWARE / "hand_controller" / "hand_controller.ino", Path("/usr/share/arduino/hardware/arduino/avr")
    command = ["avr-g++", "-mmcu=atmega328p", "-DF_CPU=16000000L", "-DDECIMAL_DIG=17", "-std=gnu++11", "-fsyntax-only"]
    command += [f"-I{core}/cores/arduino", f"-I{core}/variants/standard", "-include", "Arduino.h", "-x", "c++"]
    built = subprocess.run([*command, str(sketch)], capture_output=True, text=True, check=False)
    assert "a Mega 2560, a Leonardo or a Micro. An Uno or Nano has only one." in built.stderr


def test_a_dose_a_silence_and_a_reset_as_the_protocol_says(board: Board) -> None:
    host = Host(board)
    states, opening_mm = [host.report("step 1.000 0.200 0.500").state], 0.0
    while states[-1] != "closed":
        report = host.wait(0.02).report()
        opening_mm = max(opening_mm, board.opening_mm)
        if report.state != states[-1]:
            states.append(report.state)
    assert states == ["opening", "dwelling", "closing", "closed"]
    assert opening_mm == pytest.approx(1.0, abs=0.02)
    opened(host).report("vibrate 1")
    began_s = host.now_s
    host.until(lambda: board.vibration == 0.0, 0.3, talking=False)
    assert host.now_s - began_s > 0.2, "a busy host is forgiven"
    host.until(lambda: is_shut(host), 0.6, talking=False)
    assert host.report().faults == "d"
    assert host.report("reset").faults == ""


def test_the_valve_goes_as_fast_as_it_is_told_and_arrives_in_spite_of_its_gears(board: Board) -> None:
    host = Host(board)
    host.report("open 2.000")
    host.until(lambda: board.opening_mm > 0.2, 1.0)
    took_s = host.until(lambda: board.opening_mm > 1.8, 2.0)
    assert 1.6 / took_s == pytest.approx(4.0, rel=0.15), "not the 41 mm/s that the servo can"
    assert host.wait(0.3).report().state == "open"
    assert board.opening_mm == pytest.approx(2.0, abs=0.02)


@pytest.mark.parametrize("dip_s", [0.005, 0.2, 2.0])
def test_a_servo_that_loses_its_power_with_the_valve_open_shuts_it_when_the_power_is_back(
    board: Board, dip_s: float
) -> None:
    host = opened(Host(board), WIDEST_MM)
    servo = board.valve.servo
    servo.cut_power(host.now_s)
    host.wait(dip_s)
    assert not is_shut(host)
    servo.restore_power(host.now_s)
    accepted = 0
    while servo.is_silent(host.now_s):
        host.wait(0.01, talking=False)
        accepted += host.report("open 0.500").refusal == ""
    host.until(lambda: is_shut(host), AFTER_POWER_S)
    assert servo.has_torque
    assert host.report("open 0.500").refusal == "fault", "not before a person, or the program, has seen it"
    assert accepted <= 3, "what is said in the first 30 ms"
    assert host.report("reset").faults == ""
    assert opened(host, 0.5).report().faults == ""


def test_a_supply_that_is_switched_on_after_the_board_is_taken_up(board: Board) -> None:
    board.valve.servo.cut_power(999.0)
    board.valve.servo.position += 260
    host = Host(board, greet=False)
    assert isinstance(host.say("hello 2"), Hello)
    assert [host.report(command).refusal for command in (*MAP, "open 0.5")] == ["", "", "", "fault"]
    assert host.wait(0.3).report().faults == "s"
    board.valve.servo.restore_power(host.now_s)
    assert host.until(lambda: is_shut(host), BOOT_S + AFTER_POWER_S) > BOOT_S
    assert host.report("reset").faults == ""
    assert opened(host).report().faults == ""


def test_a_valve_that_was_shut_in_a_hurry_doses_at_its_own_speed_again(board: Board) -> None:
    host = opened(Host(board), WIDEST_MM)
    board.valve.servo.put(64, 1, 0)  # somebody's tool
    took_s = host.until(lambda: is_shut(host), AFTER_POWER_S)
    assert took_s < 0.6 * WIDEST_MM / 4.0
    host.wait(0.1).report("reset")
    host.report("open 2.000")
    host.until(lambda: board.opening_mm > 0.2, 1.0)
    assert 1.6 / host.until(lambda: board.opening_mm > 1.8, 2.0) == pytest.approx(4.0, rel=0.15)
    board.valve.servo.put(64, 1, 0)
    host.until(lambda: board.opening_mm < 1.0, AFTER_POWER_S)
    assert host.report("reset").refusal == ""
    host.report("open 2.000")
    began_mm = board.opening_mm
    took_s = host.until(lambda: board.opening_mm > 1.8, 2.0)
    assert took_s > 0.85 * (1.8 - began_mm) / 4.0, "before it was shut, too"


def test_a_valve_whose_servo_did_not_hear_its_speed_does_not_open_in_a_hurry() -> None:
    host = opened(Host(), WIDEST_MM)
    servo, say, lost = host.twin.valve.servo, host.twin.valve.say, [0]
    servo.put(64, 1, 0)
    host.until(lambda: host.twin.opening_mm < 1.2, AFTER_POWER_S)
    assert host.report("reset").faults == ""

    def deaf(baud: int, data: bytes, now_s: float) -> bytes:
        hears = not (data[7:10] == b"\x03\x70\x00" and lost[0] == 0)  # a write to its profile velocity
        lost[0] += not hears
        return say(baud, data if hears else b"", now_s)

    host.twin.valve.say = deaf  # type: ignore[method-assign]
    host.report("open 2.400")
    openings_mm = [host.wait(0.01).twin.opening_mm for _ in range(100)]
    assert lost == [1]
    assert openings_mm[-1] == pytest.approx(2.4, abs=0.03)
    assert max(now - last for last, now in pairwise(openings_mm)) < 1.3 * 4.0 * 0.01


def test_a_servo_that_has_shut_itself_down_is_switched_on_again_by_a_reset_alone(board: Board) -> None:
    host = opened(Host(board))
    board.valve.servo.fail(OVERLOAD_BIT)
    host.wait(0.5)
    assert host.report().faults == "s"
    assert not is_shut(host), "known to be open, and said to be"
    host.report("reset")
    host.until(lambda: is_shut(host), BOOT_S + AFTER_POWER_S)
    assert host.report("reset").faults == ""


def test_a_valve_that_is_blocked_is_said_to_be_stuck_before_its_servo_shuts_down(board: Board) -> None:
    host = Host(board)
    board.valve.lets(open=False)
    host.report("open 1.000")
    assert host.until(lambda: host.report().faults != "", 4.0) == pytest.approx(2.5, abs=0.2)
    assert host.report().faults == "t"


def test_a_servo_from_its_box_is_found_and_moved_to_our_baud_rate(board: Board) -> None:
    servo = board.valve.servo
    servo.put(8, 1, 1)  # 57 600
    host = Host(board, greet=False)
    host.say("hello 2")
    for command in MAP:
        host.report(command)
    host.until(lambda: host.report("reset").faults == "", 1.0)
    assert servo.table[8] == 3
    assert opened(host).report().faults == ""


@pytest.mark.parametrize(
    ("register", "size", "value"), [(84, 2, 100), (82, 2, 0), (112, 4, 0), (100, 2, 885), (10, 1, 1), (11, 1, 4)]
)
def test_what_the_servo_was_set_to_before_does_not_matter(register: int, size: int, value: int) -> None:
    twin = HandTwin(FIRMWARE)
    twin.valve.servo.put(register, size, value)
    Host(twin)
    assert twin.valve.servo.get(register, size) != value


def test_a_servo_whose_torque_somebody_has_switched_off_shuts_the_valve() -> None:
    host = opened(Host())
    host.twin.valve.servo.put(64, 1, 0)
    host.until(lambda: is_shut(host), AFTER_POWER_S)
    assert host.report().faults == "s"


def test_garbled_answers_of_the_servo_are_not_believed_and_one_now_and_then_is_forgiven() -> None:
    host = opened(Host())
    say, asked = host.twin.valve.say, 0

    def garbled(baud: int, data: bytes, now_s: float) -> bytes:
        nonlocal asked
        answer = bytearray(say(baud, data, now_s))
        asked += bool(answer)
        if answer and asked % 7 == 0:
            answer[asked % len(answer)] ^= 1 << asked % 8
        return bytes(answer)

    host.twin.valve.say = garbled  # type: ignore[method-assign]
    for _ in range(300):
        report = host.wait(0.01).report()
        assert (report.opening_mm, report.faults) == (pytest.approx(1.0, abs=0.03), "")


def test_a_goal_that_the_servo_did_not_hear_is_told_again() -> None:
    host = Host()
    host.twin.healthy = False
    host.report("open 1.000")
    host.wait(0.01)
    host.twin.healthy = True
    host.until(lambda: host.twin.opening_mm > 0.97, 0.6)
    assert host.report().faults == ""


def test_an_answer_that_looks_like_a_header_is_read_without_its_stuffing() -> None:
    host = opened(Host())
    for address, byte in ((123, 0xFF), (124, 0xFF), (125, 0xFD)):
        host.twin.valve.servo.put(address, 1, byte)
    report = host.wait(0.1).report()
    assert (report.opening_mm, report.faults) == (pytest.approx(1.0, abs=0.03), "")


def test_the_servos_own_limits_are_the_ends_of_the_map() -> None:
    servo = Host().twin.valve.servo
    assert (servo.get(52, 4), servo.get(48, 4)) == (2048, 2308)


def test_the_servos_lasting_memory_is_written_where_it_differs_only() -> None:
    twin = HandTwin(FIRMWARE)
    host = Host(twin)
    written: list[int] = []
    write = twin.valve.servo.write

    def count(address: int, data: bytes, now_s: float) -> int:
        written.append(address)
        return write(address, data, now_s)

    twin.valve.servo.write = count  # type: ignore[method-assign]
    for _ in range(3):
        twin.valve.servo.cut_power(host.now_s)
        twin.valve.servo.restore_power(host.now_s)
        host.wait(1.0)
    assert written
    assert [address for address in written if address < 64] == []


CURVED = (
    ValvePoint(count=3000, opening_mm=0.0),
    ValvePoint(count=2950, opening_mm=0.3),
    ValvePoint(count=2700, opening_mm=2.0),
)
"""A valve that opens as its servo falls, and not evenly."""
CURVED_COMMANDS = ("point 0 3000 0", "point 1 2950 0.3", "point 2 2700 2", "map 3 4.0")


def test_an_opening_is_gone_to_by_the_calibrated_map() -> None:
    host = Host(HandTwin(FIRMWARE, true_map=CURVED), greet=False)
    host.greet(CURVED_COMMANDS)
    for opening_mm, count in ((0.15, 2975), (0.3, 2950), (1.15, 2825), (2.0, 2700)):
        opened(host, opening_mm)
        report = host.wait(0.3).report()
        assert host.twin.valve.servo.position == pytest.approx(count, abs=1)
        assert (report.state, report.opening_mm) == ("open", pytest.approx(opening_mm, abs=0.01))
    assert host.report("open 2.001").refusal == "range", "nothing beyond the map was calibrated"


def test_without_a_map_nothing_moves() -> None:
    host = Host(greet=False)
    host.twin.valve.servo.position = 2200.0
    host.say("hello 2")
    assert host.report("open 0.1").refusal == "map"
    assert host.report("step 0.1 1 0").refusal == "map"
    host.wait(0.5)
    assert host.twin.valve.servo.position == 2200.0, "nobody has told where it is shut"


@pytest.mark.parametrize(
    "commands",
    [
        ("map 0 4",),
        ("point 0 2048 0", "map 1 4"),
        ("point 0 2048 0.1", "point 1 2300 1", "map 2 4"),
        ("point 0 2048 0", "point 1 2048 1", "map 2 4"),
        ("point 0 2048 0", "point 1 2300 1", "point 2 2200 2", "map 3 4"),
        ("point 0 2048 0", "point 1 2300 1", "point 2 2400 1", "map 3 4"),
        ("point 0 2048 0", "point 1 2300 1", "map 2 0"),
        ("point 0 2048 0", "point 1 2300 1", "map 2 66"),
        ("point 8 2048 0",),
        ("point 0 4096 0",),
        ("point 0 2048.5 0",),
        ("point 0 2048 33",),
    ],
)
def test_a_map_that_is_none_is_refused_and_the_one_before_is_kept(commands: tuple[str, ...]) -> None:
    host = Host()
    assert [host.report(command).refusal for command in commands][-1] == "range"
    assert host.say("hello 2") == Hello(host.number, "TWIN-2.0", 2.4)


def test_a_map_is_not_changed_under_an_open_valve() -> None:
    host = opened(Host())
    assert [host.report(command).refusal for command in CURVED_COMMANDS][-1] == "busy"
    assert [host.report(command).refusal for command in MAP] == ["", "", ""], "the same one changes nothing"
    assert not is_shut(host.wait(0.3))


def test_a_board_that_starts_with_the_valve_open_shuts_it_by_the_map_that_it_has_kept(board: Board) -> None:
    host = opened(Host(board), WIDEST_MM)
    board.reboot()
    host.until(lambda: is_shut(host), AFTER_POWER_S, talking=False)
    assert host.report().refusal == "hello"


def test_firmware_that_hangs_with_the_valve_open_is_reset_by_the_watchdog_and_shuts_it(mega: AvrHand) -> None:
    host = opened(Host(mega), WIDEST_MM)
    mega.hang()
    took_s = host.until(lambda: is_shut(host), 1.0, talking=False)
    assert 0.12 < took_s < AFTER_POWER_S, "the watchdog's time, and the valve's way"
    assert host.report().refusal == "hello"
    host.greet()
    opened(host)
    mega.hang()
    host.until(lambda: is_shut(host), AFTER_POWER_S, talking=False)


def test_the_boards_counter_wraps_around_in_a_dose_and_in_a_silence(mega: AvrHand) -> None:
    """After 49.7 days; it is set to shortly before."""
    host = Host(mega)
    mega.set_millis(2**32 - 320)
    host.wait(0.02).report("step 1.000 0.300 0.500")
    assert host.until(lambda: host.report().state == "closed", 2.0) > 0.8
    mega.set_millis(2**32 - 520)
    opened(host.wait(0.02))
    host.until(lambda: is_shut(host), 1.0, talking=False)
    assert host.report().faults == "d"


def test_the_servos_line_is_switched_for_every_byte_and_its_answers_fit_the_cores_buffer(mega: AvrHand) -> None:
    """The core's ring takes 63 bytes; a status of 88 bytes once overran it, and no answer was whole."""
    host = Host(mega)
    longest = 0
    say = mega.valve.say

    def measured(baud: int, data: bytes, now_s: float) -> bytes:
        nonlocal longest
        answer = say(baud, data, now_s)
        longest = max(longest, len(answer))
        return answer

    mega.valve.say = measured  # type: ignore[method-assign]
    opened(host)
    assert host.report().faults == ""
    assert 40 < longest < 64
    assert mega.bytes_against_the_switch == 0


def test_the_emergency_stop_shuts_the_valve_and_a_broken_wire_is_one(mega: AvrHand) -> None:
    host = opened(Host(mega))
    mega.emergency_stop = True
    host.until(lambda: is_shut(host), 0.5)
    assert host.report("reset").refusal == "fault"
    mega.emergency_stop = False
    assert host.wait(0.05).report("reset").faults == ""


def test_the_wiring_diagram_is_of_todays_wiring_and_the_wiring_of_the_firmwares_pins(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    hardware = FIRMWARE.parent / "hardware"
    monkeypatch.syspath_prepend(str(hardware))
    drawing = importlib.import_module("draw_wiring").drawing()
    assert (hardware / "wiring.svg").read_text(encoding="utf-8") == drawing, "python robot/hardware/draw_wiring.py"
    nets = yaml.safe_load((hardware / "wiring.yaml").read_text(encoding="utf-8"))["nets"]
    pins = (FIRMWARE / "hand_controller" / "pins.h").read_text(encoding="utf-8")
    for what, net in (("DIRECTION", "direction"), ("VIBRATION", "vibration"), ("EMERGENCY_STOP", "stop")):
        (number,) = re.findall(rf"#define SCUHAND_{what}_PIN (\d+)", pins)
        assert f"board.{number}" in nets[net]
