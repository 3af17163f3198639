"""The firmware's protocol and state machine on this computer, without a wire."""

import random
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from scuhand_bt.devices.hand_protocol import Hello, Report, crc16, decode, encode
from scuhand_bt.sim.wire.hand import HandTwin

FIRMWARE = Path(__file__).parent.parent / "robot" / "firmware"
ARDUINO = Path(__file__).parent / "arduino"
SOURCES = sorted((FIRMWARE / "hand_controller").glob("*.cpp"))


class Host:
    """Talks to the firmware in a time of its own."""

    def __init__(self, greet: bool = True) -> None:
        self.twin = HandTwin(FIRMWARE)
        self.now_s = 1000.0
        self.number = 0
        self.twin.hear(b"", self.now_s)
        if greet:
            assert isinstance(self.say("hello 1"), Hello)

    def say(self, command: str, number: int | None = None) -> Report | Hello | None:
        if number is None:
            self.number += 1
            number = self.number
        replies = self.twin.hear(encode(number, command), self.now_s)
        return decode(replies[0]) if replies else None

    def report(self, command: str = "ping", number: int | None = None) -> Report:
        answer = self.say(command, number)
        assert isinstance(answer, Report)
        return answer

    def wait(self, seconds: float, talking: bool = True) -> "Host":
        for _ in range(round(seconds / 0.01)):
            self.now_s += 0.01
            self.twin.hear(b"", self.now_s)
            if talking:
                self.say("ping")
        return self


def test_the_checksum_is_the_published_one() -> None:
    assert crc16(b"123456789") == 0x29B1


def test_hello_tells_version_limits_and_gear() -> None:
    assert Host(greet=False).say("hello 1", 7) == Hello(7, "1.0", 2.4, 0.105)


@pytest.mark.parametrize(("greeting", "why"), [("hello 2", "version"), ("hello", "version"), ("open 1.0", "hello")])
def test_nothing_is_done_before_a_right_hello(greeting: str, why: str) -> None:
    host = Host(greet=False)
    assert host.report(greeting).refusal == why
    assert host.report("open 1.0").refusal == "hello"
    assert host.wait(1.0).twin.opening_mm == 0.0


def test_an_opening_is_gone_to_and_reported() -> None:
    host = Host()
    assert host.report("open 1.25").state == "moving"
    report = host.wait(0.6).report()
    assert (report.state, report.opening_mm) == ("open", pytest.approx(1.25, abs=0.01))
    assert host.report("open 0").state == "closing"
    assert host.wait(0.6).report().state == "closed"


def test_a_step_opens_dwells_from_arrival_and_closes() -> None:
    host = Host()
    states = [host.report(f"step {1.2 / 0.105:.3f} 0.500 0.250").state]
    vibration = []
    for _ in range(150):
        report = host.wait(0.01).report()
        vibration.append(report.vibration)
        if report.state != states[-1]:
            states.append(report.state)
    assert states == ["opening", "dwelling", "closing", "closed"]
    assert 0.79 <= vibration.count(0.25) * 0.01 <= 0.95, "0.06 s dead time, 0.3 s of way, 0.5 s of dwell"


@pytest.mark.parametrize(
    "command",
    ["open 2.401", "open 999", "vibrate 1.001", "step 30 1 0", "step 5 60.001 0", "step 5 1 1.5"],
)
def test_what_is_beyond_a_limit_is_refused_and_not_cut(command: str) -> None:
    host = Host()
    assert host.report(command).refusal == "range"
    assert host.wait(0.5).report().is_safe


@pytest.mark.parametrize(
    "command",
    ["open", "open ", "open -1", "open 1e0", "open 1.", "open .5", "open 1.2345", "open 1 1", "open  1", "open 1 ",
     "open 1.2.3", "open 1000", "open 99999999999", "step 1 1", "vibrate x", "close now", "ping 1"],
)  # fmt: skip
def test_arguments_are_as_the_protocol_says_or_refused(command: str) -> None:
    assert Host().report(command).refusal == "arguments"


def test_an_unknown_verb_is_said_to_be_unknown() -> None:
    assert Host().report("explode").refusal == "verb"
    assert Host().report("opening 1").refusal == "verb"


def test_a_line_without_a_right_checksum_is_not_answered_and_not_obeyed() -> None:
    host = Host()
    good = encode(9, "open 1.000")
    for at in range(len(good) - 1):
        for bit in range(8):
            broken = bytearray(good)
            broken[at] ^= 1 << bit
            assert host.twin.hear(bytes(broken) + b"\n", host.now_s) == []
    assert host.twin.hear(b"open 1.0\n*0000\n\n****\n1 *FFFF\n", host.now_s) == []
    assert host.wait(0.2).report().is_safe


def test_a_command_that_comes_again_is_answered_again_and_done_once() -> None:
    host = Host()
    host.report("step 10 0.1 0", 500)
    host.wait(0.0)
    host.report("step 10 0.1 0", 500)
    for _ in range(100):
        host.now_s += 0.01
        report = host.report("step 10 0.1 0", 500)
    assert report.is_safe
    assert report.refusal == ""


def test_within_300_ms_of_silence_vibration_has_stopped_and_the_valve_has_begun_to_move() -> None:
    host = Host()
    host.report("open 1.0")
    host.report("vibrate 1.0")
    host.wait(0.5)
    host.wait(0.2, talking=False)
    assert host.twin.vibration == 1.0, "a busy host is forgiven"
    host.wait(0.1, talking=False)
    assert host.twin.vibration == 0.0
    assert host.twin.opening_mm < 1.0, "it has its dead time of 60 ms behind it"
    host.wait(0.5, talking=False)
    assert host.twin.opening_mm == 0.0
    assert host.report().faults == "d"
    assert host.report("open 1.0").refusal == "fault"
    assert host.report("reset").faults == ""
    assert host.report("open 1.0").refusal == ""


def test_noise_does_not_feed_the_dead_man() -> None:
    host = Host()
    host.report("open 1.0")
    for _ in range(50):
        host.now_s += 0.01
        host.twin.hear(b"1 ping*0000\n\xff\n", host.now_s)
    assert host.report().faults == "d"


def test_a_hand_at_rest_is_not_in_fault_for_being_left_alone() -> None:
    assert Host().wait(10.0, talking=False).report().faults == ""


def test_the_emergency_stop_latches_until_it_is_released_and_reset() -> None:
    host = Host()
    host.report("open 1.0")
    host.wait(0.5)
    host.twin.emergency_stop = True
    assert host.wait(0.02).report().state == "closing"
    assert host.wait(0.5).report("open 0.5").refusal == "fault"
    assert host.report("reset").refusal == "fault"
    host.twin.emergency_stop = False
    assert host.wait(0.02).report().faults == "e"
    assert host.report("close").refusal == ""
    assert host.report("reset").faults == ""


def test_a_valve_that_does_not_arrive_is_stuck_and_one_whose_servo_fails_is_said_to() -> None:
    host = Host()
    host.twin.can_open = False
    host.report("open 1.0")
    assert host.wait(2.4).report().faults == ""
    assert host.wait(0.2).report().faults == "t"
    host.twin.healthy = False
    assert host.wait(0.02).report().faults == "st"


def test_a_valve_that_is_stuck_is_found_while_commands_stream() -> None:
    host = Host()
    host.report("open 0.5")
    host.wait(1.0)
    host.twin.can_open = False
    for step in range(30):
        host.report(f"open {1.0 + 0.01 * step:g}")
        host.wait(0.1)
    assert host.report().faults == "t"


def test_a_valve_that_follows_a_stream_of_commands_is_not_stuck() -> None:
    host = Host()
    for step in range(60):
        host.report(f"open {0.03 * step:g}")
        host.wait(0.1)
    assert host.report().faults == ""


def test_a_board_that_is_reset_with_the_valve_open_closes_it() -> None:
    host = Host()
    host.report("open 2.0")
    host.wait(0.7)
    host.twin.reboot()
    host.wait(0.7, talking=False)
    assert host.twin.opening_mm == 0.0
    assert host.report().refusal == "hello"


def test_the_millisecond_counter_may_wrap_around() -> None:
    host = Host()
    host.now_s = 2**32 / 1000 - 0.2
    host.say("hello 1")
    host.report("step 10 0.3 0")
    assert host.wait(1.5).report().is_safe
    assert host.report().faults == ""


def test_plain_cpp_without_arduino_compiles_without_a_warning() -> None:
    strict = "-std=c++11 -Wall -Wextra -Wpedantic -Wconversion -Werror -fsyntax-only"
    for source in [*SOURCES, *(FIRMWARE / "host").glob("*.cpp")]:
        subprocess.run(["g++", *strict.split(), str(source)], check=True)
    for part in SOURCES + sorted((FIRMWARE / "hand_controller").glob("*.h")):
        assert not re.search(r"#include\s*[<\"]Arduino", part.read_text())


def sketch(tmp_path: Path, *steps: str) -> list[str]:
    """What the sketch answers and does, step by step, on a board and a servo in memory (`tests/arduino`)."""
    built = tmp_path / "sketch"
    parts = [*map(str, SOURCES), str(ARDUINO / "sketch.cpp")]
    command = ["g++", "-std=c++11", "-Wall", "-Wextra", "-Werror", "-fsanitize=undefined", f"-I{ARDUINO}"]
    subprocess.run([*command, "-o", str(built), *parts], check=True)
    run = subprocess.run([str(built)], input="\n".join(steps), capture_output=True, text=True, check=True)
    return run.stdout.splitlines()


def test_the_sketch_moves_its_servo_and_motor_and_reports_what_they_tell(tmp_path: Path) -> None:
    said = sketch(tmp_path, "wait 20", "say 1 hello 1", "say 2 vibrate 0.5", "say 3 open 1.05", "wait 20", "say 4 ping")
    assert said[0] == "goal 0 motor 0"
    assert said[1].startswith("1 hello 1 1.0 2.400 0.105*")
    counts = round(1.05 / 0.105 * 4096 / 360)
    assert said[-3] == f"goal {counts - 1} motor 127", "10 degrees of the servo, rounded down"
    report = decode(said[-2].encode() + b"\n")
    assert isinstance(report, Report)
    assert (report.state, report.opening_mm, report.temperature_c) == ("open", pytest.approx(1.05, abs=0.01), 31)


def test_a_sketch_whose_servo_does_not_answer_says_so_and_closes_when_it_is_back(tmp_path: Path) -> None:
    """The library gives zeros for an answer that did not come: a healthy servo at 0, if they were believed."""
    opened = ("say 1 hello 1", "say 2 open 1.05", "say 3 vibrate 1", "wait 20")
    said = sketch(tmp_path, *opened, "servo 0", "wait 20", "say 4 ping", "servo 1", "wait 20", "say 5 ping")
    lost, back = (report for line in said if (report := decode(line.encode() + b"\n")) and report.sequence in (4, 5))
    assert isinstance(lost, Report)
    assert (lost.faults, lost.opening_mm > 1.0) == ("s", True)
    assert isinstance(back, Report)
    assert (back.state, said[-1]) == ("closed", "goal 0 motor 0"), "the goal it did not hear was told again"


@pytest.mark.parametrize(("blow", "fault"), [("stop 1", "e"), ("error 32", "s"), ("wait 230", "d")])
def test_the_sketch_closes_on_each_of_its_faults(tmp_path: Path, blow: str, fault: str) -> None:
    said = sketch(tmp_path, "say 1 hello 1", "say 2 open 1.05", "say 3 vibrate 1", blow, "wait 20", "say 4 ping")
    assert said[-1] == "goal 0 motor 0"
    report = decode(said[-2].encode() + b"\n")
    assert isinstance(report, Report)
    assert report.faults == fault


@pytest.mark.skipif(shutil.which("avr-g++") is None, reason="Debian's gcc-avr and avr-libc are not installed")
def test_all_of_it_compiles_for_an_avr_and_its_own_part_fits_a_small_one(tmp_path: Path) -> None:
    """The sketch against stubs of Arduino and of the servo's library: what these take is not in the sum."""
    avr = ["avr-g++", "-mmcu=atmega328p", "-std=gnu++11", "-Os", "-Wall", "-Wextra", "-Werror", f"-I{ARDUINO}"]
    sizes = 0
    for source in [*SOURCES, FIRMWARE / "hand_controller" / "hand_controller.ino"]:
        built = tmp_path / f"{source.stem}.o"
        subprocess.run([*avr, "-x", "c++", "-c", str(source), "-o", str(built)], check=True)
        listing = subprocess.run(["avr-size", str(built)], check=True, capture_output=True, text=True).stdout
        sizes += int(listing.splitlines()[1].split()[3])
    assert sizes < 8192, f"{sizes} bytes of 32768"


def test_a_million_random_and_mutated_bytes_do_no_harm(tmp_path: Path) -> None:
    fuzz = tmp_path / "fuzz"
    sanitizers = "-fsanitize=address,undefined -fno-sanitize-recover=all"
    sources = [*map(str, SOURCES), str(FIRMWARE / "host" / "fuzz.cpp")]
    subprocess.run(["g++", "-std=c++11", "-O1", *sanitizers.split(), "-o", str(fuzz), *sources], check=True)
    rng = random.Random(6)
    commands = ["open 1.25", "step 10.5 0.2 1", "vibrate 0.7", "reset", "close", "ping", "step 99999 9 9", "open 2400"]
    data = bytearray(encode(1, "hello 1"))
    while len(data) < 1_000_000:
        line = bytearray(encode(rng.randrange(70_000), rng.choice(commands)))
        if rng.random() < 0.3:
            line[rng.randrange(len(line))] = rng.randrange(256)
        if rng.random() < 0.1:
            line += rng.randbytes(rng.randrange(200))
        data += line
    ended = subprocess.run([str(fuzz)], input=bytes(data), check=True, capture_output=True, timeout=60)
    assert int(ended.stdout) > 10_000, "most lines were good, and answered"
