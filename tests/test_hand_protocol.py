"""The hand controller's lines: what is said, what is understood, and what is refused."""

from pathlib import Path

import pytest

from scuhand_bt.devices.hand_protocol import FAULTS, SEQUENCES, VERSION, Hello, Report, crc16, decode, encode
from scuhand_bt.sim.wire.hand import HandTwin

FIRMWARE = Path(__file__).parent.parent / "robot" / "firmware"
REPORT = "17 ok open 1.248 0.500 - 31"


def line(body: str, end: bytes = b"\n") -> bytes:
    """A line of the controller with its right checksum."""
    return body.encode() + b"*%04X" % crc16(body.encode()) + end


@pytest.mark.parametrize(
    ("data", "crc"), [(b"", 0xFFFF), (b"123456789", 0x29B1), (b"A", 0xB915), (b"\x00", 0xE1F0), (b"\xff", 0xFF00)]
)
def test_the_checksum_is_the_published_one(data: bytes, crc: int) -> None:
    """CRC-16/CCITT-FALSE, with the check values of its catalogue."""
    assert crc16(data) == crc


def test_a_command_is_its_number_its_words_and_four_digits_of_checksum() -> None:
    assert encode(17, "open 1.250") == b"17 open 1.250*3ECE\n"
    assert encode(0, "ping") == line("0 ping")
    small = next(number for number in range(100_000) if crc16(b"%d ping" % number) < 0x100)
    assert encode(small, "ping").endswith(b"*00%02X\n" % crc16(b"%d ping" % small))


def test_a_report_is_read_with_its_units() -> None:
    assert decode(line(REPORT)) == Report(17, "", "open", 1.248, 0.5, "", 31)
    refused = decode(line("65535 no fault closed -0.012 0.000 ed -5"))
    assert refused == Report(65535, "fault", "closed", -0.012, 0.0, "ed", -5)


def test_a_greeting_is_read_with_version_and_limit() -> None:
    assert decode(line("7 hello 2 2.0-beta 2.400")) == Hello(7, "2.0-beta", 2.4)
    assert decode(line("7 hello 1 1.0 2.400")) is None, "another version's greeting may mean anything"


@pytest.mark.parametrize("state", ["closed", "closing", "moving", "open", "opening", "dwelling"])
def test_every_state_is_known_and_no_other(state: str) -> None:
    report = decode(line(f"1 ok {state} 0.000 0.000 - 20"))
    assert isinstance(report, Report)
    assert report.state == state
    assert decode(line(f"1 ok {state}s 0.000 0.000 - 20")) is None


def test_a_line_may_end_as_a_terminal_ends_it() -> None:
    assert decode(line(REPORT, b"\r\n")) == decode(line(REPORT)) is not None
    for end in (b"", b"\r", b"\n\n", b" \n"):
        assert decode(line(REPORT, end)) is None


def test_any_changed_bit_is_a_line_that_is_none() -> None:
    whole = line(REPORT)
    for at in range(len(whole)):
        for bit in range(8):
            broken = bytearray(whole)
            broken[at] ^= 1 << bit
            assert decode(bytes(broken)) is None


@pytest.mark.parametrize(
    "body",
    [
        "17 ok open 1.248 0.500 - 31 more",
        "17 ok open 1.2 0.500 - 31",
        "17 ok open 1.248 0.500 x 31",
        "17 ok open 1.248 0.500 ededs 31",
        "170000 ok open 1.248 0.500 - 31",
        "17 no open 1.248 0.500 - 31",
        "17 perhaps open 1.248 0.500 - 31",
        "-1 ok open 1.248 0.500 - 31",
        "17 ok open 12345678.248 0.500 - 31",
        "17 ok",
        "",
    ],
)
def test_what_is_no_answer_of_this_protocol_is_none_in_spite_of_its_checksum(body: str) -> None:
    assert decode(line(body)) is None


def test_a_hand_is_safe_when_it_is_closed_and_still() -> None:
    safe = {
        (state, vibration): Report(1, "", state, 0.0, vibration, "", 20).is_safe
        for state in ("closed", "closing", "open")
        for vibration in (0.0, 0.001, 1.0)
    }
    assert [case for case, is_safe in safe.items() if is_safe] == [("closed", 0.0)]


def test_latched_faults_are_said_in_words() -> None:
    assert Report(1, "", "closed", 0.0, 0.0, "", 20).why == ""
    assert Report(1, "", "closed", 0.0, 0.0, "et", 20).why == (
        "the emergency stop is (or was) pressed; the valve is stuck"
    )
    assert set(FAULTS) == set("edst")


def test_the_firmware_takes_our_version_and_every_number_that_we_count_to() -> None:
    twin = HandTwin(FIRMWARE)
    twin.hear(b"", 0.0)
    (greeting,) = twin.hear(encode(SEQUENCES - 1, f"hello {VERSION}"), 0.0)
    hello = decode(greeting)
    assert isinstance(hello, Hello)
    assert hello.sequence == SEQUENCES - 1
    assert twin.hear(encode(SEQUENCES, "ping"), 0.0) == [], "no number of the protocol"
