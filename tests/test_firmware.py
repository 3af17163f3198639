"""The firmware's protocol and state machine on this computer, without a wire."""

import random
import re
import subprocess
from pathlib import Path

import pytest

from harness.hand_host import FIRMWARE, Host
from scuhand_bt.devices.hand_protocol import Hello, crc16, encode

SOURCES = sorted((FIRMWARE / "hand_controller").glob("*.cpp"))


def test_the_checksum_is_the_published_one() -> None:
    assert crc16(b"123456789") == 0x29B1


def test_hello_tells_the_version_and_how_wide_the_valve_opens_by_the_map_that_was_kept() -> None:
    host = Host(greet=False)
    assert host.say("hello 2", 7) == Hello(7, "TWIN-2.0", 0.0), "a new board"
    host.greet()
    assert host.say("hello 2", 8) == Hello(8, "TWIN-2.0", 2.4)


@pytest.mark.parametrize(("greeting", "why"), [("hello 1", "version"), ("hello", "version"), ("open 1.0", "hello")])
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
    states = [host.report("step 1.200 0.500 0.250").state]
    vibration = []
    for _ in range(150):
        report = host.wait(0.01).report()
        vibration.append(report.vibration)
        if report.state != states[-1]:
            states.append(report.state)
    assert states == ["opening", "dwelling", "closing", "closed"]
    assert 0.79 <= vibration.count(0.25) * 0.01 <= 0.99, "0.06 s dead time, 0.32 s of way, 0.5 s of dwell"


@pytest.mark.parametrize(
    "command",
    ["open 2.401", "open 999", "vibrate 1.001", "step 2.401 1 0", "step 1 60.001 0", "step 1 1 1.5"],
)
def test_what_is_beyond_a_limit_is_refused_and_not_cut(command: str) -> None:
    host = Host()
    assert host.report(command).refusal == "range"
    assert host.wait(0.5).report().is_safe


@pytest.mark.parametrize(
    "command",
    ["open", "open ", "open -1", "open 1e0", "open 1.", "open .5", "open 1.2345", "open 1 1", "open  1", "open 1 ",
     "open 1.2.3", "open 10000", "open 99999999999", "step 1 1", "vibrate x", "close now", "ping 1"],
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
    host.report("step 1.05 0.1 0", 500)
    host.wait(0.0)
    host.report("step 1.05 0.1 0", 500)
    for _ in range(100):
        host.now_s += 0.01
        report = host.report("step 1.05 0.1 0", 500)
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
    assert host.twin.opening_mm < 0.001
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
    host.twin.valve.lets(open=False)
    host.report("open 1.0")
    assert host.wait(2.4).report().faults == ""
    assert host.wait(0.2).report().faults == "t"
    host.twin.healthy = False
    assert host.wait(0.05).report().faults == "st"


def test_a_valve_that_is_stuck_is_found_while_commands_stream() -> None:
    host = Host()
    host.report("open 0.5")
    host.wait(1.0)
    host.twin.valve.lets(open=False)
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
    assert host.twin.opening_mm < 0.001
    assert host.report().refusal == "hello"


def test_the_millisecond_counter_may_wrap_around() -> None:
    host = Host()
    host.now_s = 2**32 / 1000 - 0.2
    host.say("hello 2")
    host.report("step 1.05 0.3 0")
    assert host.wait(1.5).report().is_safe
    assert host.report().faults == ""


def test_plain_cpp_without_arduino_compiles_without_a_warning() -> None:
    strict = "-std=c++11 -Wall -Wextra -Wpedantic -Wconversion -Werror -fsyntax-only"
    for source in [*SOURCES, *(FIRMWARE / "host").glob("*.cpp")]:
        subprocess.run(["g++", *strict.split(), str(source)], check=True)
    for part in SOURCES + sorted((FIRMWARE / "hand_controller").glob("*.h")):
        assert not re.search(r"#include\s*[<\"]Arduino", part.read_text())


def test_a_million_random_and_mutated_bytes_do_no_harm(tmp_path: Path) -> None:
    fuzz = tmp_path / "fuzz"
    sanitizers = "-fsanitize=address,undefined -fno-sanitize-recover=all"
    sources = [*map(str, SOURCES), str(FIRMWARE / "host" / "fuzz.cpp")]
    subprocess.run(["g++", "-std=c++11", "-O1", *sanitizers.split(), "-o", str(fuzz), *sources], check=True)
    rng = random.Random(6)
    commands = ["open 1.25", "step 1.05 0.2 1", "vibrate 0.7", "reset", "close", "ping", "step 99999 9 9", "open 2400"]
    commands += ["point 0 2048 0", "point 1 2300 2.3", "point 1 100 1.5", "map 2 4.0", "map 9 70", "point 9 5000 40"]
    data = bytearray(encode(1, "hello 2"))
    while len(data) < 1_000_000:
        line = bytearray(encode(rng.randrange(70_000), rng.choice(commands)))
        if rng.random() < 0.3:
            line[rng.randrange(len(line))] = rng.randrange(256)
        if rng.random() < 0.1:
            line += rng.randbytes(rng.randrange(200))
        data += line
    ended = subprocess.run([str(fuzz)], input=bytes(data), check=True, capture_output=True, timeout=60)
    assert int(ended.stdout) > 10_000, "most lines were good, and answered"
