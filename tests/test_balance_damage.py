"""What is believed of a balance's damaged lines: flipped bits, false bytes, failed parity."""

import random
import termios
from collections.abc import Iterator

import pytest
from balance_stream import ALL, PERIOD_S, Stream
from wire_helpers import wait_for

from scuhand_bt.devices.balances.plausibility import FLOW_MG_PER_S, LUMP_MG
from scuhand_bt.devices.interfaces import Reading
from scuhand_bt.devices.serial_link import ErrorMarks, Framing, LineBuffer, SerialLink, mark_errors
from scuhand_bt.sim.wire.port import PtyPort

# --- damaged lines

MASSES_MG = (0.0, 12.3, -4.5, 987.6, 12_345.6, 99_999.9)


def flipped(line: bytes) -> Iterator[bytes]:
    for place, byte in enumerate(line):
        for bit in range(8):
            yield line[:place] + bytes([byte ^ 1 << bit]) + line[place + 1 :]


def damaged(line: bytes) -> Iterator[bytes]:
    """Every single byte replaced by every other, dropped, and doubled; and two lines merged at every place."""
    for place, byte in enumerate(line):
        for other in range(256):
            if other != byte:
                yield line[:place] + bytes([other]) + line[place + 1 :]
        yield line[:place] + line[place + 1 :]
        yield line[: place + 1] + line[place:]
        yield line[:place] + line
        yield line + line[place:]


def believed_falsely(name: str, mass_mg: float, damage: object) -> tuple[int, list[tuple[bytes, Reading]]]:
    """How many damaged lines were fed, and those of which a stable reading with another mass came."""
    stream = Stream(name)
    stream.settle(mass_mg + 0.1)  # its last digit has been seen to change
    stream.settle(mass_mg)
    good, cases, false = stream.line(mass_mg), 0, []
    truth_mg = stream.balance.latest.value_mg  # type: ignore[union-attr]
    for bad in damage(good):  # type: ignore[operator]
        cases += 1
        stream.written.clear()
        given = stream.feed(bad)
        next(stream.balance.next_reading())  # it is no failure either
        given += stream.feed(good)
        if stream.written and any(reading.value_mg != truth_mg for reading in stream.written):
            given += stream.feed(*[good] * 12)  # nothing of this one is left for the next
        false += [
            (bad, reading) for reading in given + stream.written if reading.stable and reading.value_mg != truth_mg
        ]
        far_mg = LUMP_MG + FLOW_MG_PER_S * 2 * PERIOD_S
        false += [(bad, reading) for reading in given if abs(reading.value_mg - truth_mg) > far_mg]
        assert stream.feed(good)[-1].value_mg == truth_mg
    return cases, false


@pytest.mark.parametrize("mass_mg", MASSES_MG)
@pytest.mark.parametrize("name", ALL)
def test_no_flipped_bit_becomes_a_stable_reading(name: str, mass_mg: float) -> None:
    cases, false = believed_falsely(name, mass_mg, flipped)
    assert cases == 8 * len(Stream(name).line(mass_mg))
    assert false == []


@pytest.mark.parametrize("mass_mg", [12.3, 12_345.6])
@pytest.mark.parametrize("name", ALL)
def test_no_byte_that_is_false_missing_or_double_and_no_merged_lines_become_a_stable_reading(
    name: str, mass_mg: float
) -> None:
    cases, false = believed_falsely(name, mass_mg, damaged)
    assert cases == 259 * len(Stream(name).line(mass_mg))
    assert false == []


@pytest.mark.parametrize("name", ALL)
def test_the_first_line_of_a_conversation_may_be_false_too(name: str) -> None:
    for bad in flipped(Stream(name).line(12_345.6)):
        stream = Stream(name)
        good = stream.line(12_345.6)
        given = stream.feed(bad, good, good, good, good, good)
        assert {reading.value_mg for reading in given if reading.stable} <= {12_345.6}, bad
        assert {reading.value_mg for reading in given} == {12_345.6}, bad


@pytest.mark.parametrize("name", ALL)
def test_a_false_line_while_the_balance_flickers_is_no_farther_off_than_it_flickers(name: str) -> None:
    rng = random.Random(3)
    stream = Stream(name)
    loads_mg = [1000.0 + 0.1 * rng.choice((-1, 0, 0, 1)) for _ in range(12)]
    stream.weigh(*loads_mg)
    for bad in flipped(stream.line(1000.0)):
        given = stream.feed(bad)
        assert all(abs(reading.value_mg - 1000.0) < 0.35 for reading in given if reading.stable), bad
        stream.weigh(*loads_mg)


# --- parity


def test_marks_of_spoilt_bytes_are_read_wherever_the_stream_is_cut() -> None:
    marked = b"ST,+0\xff\x0012.3456  g\r\n\xff\xff\x00A\xff\x00\xffB\xff\x00\x00C\xffD"
    meant = b"ST,+0\x0002.3456  g\r\n\xff\x00A\x00B\x00C\xffD".replace(b"\x0002.", b"\x002.")
    for first in range(len(marked)):
        for second in range(first, len(marked)):
            marks = ErrorMarks()
            parts = marked[:first], marked[first:second], marked[second:]
            assert b"".join(marks.feed(part) for part in parts) == meant


@pytest.mark.parametrize("name", ALL)
def test_a_spoilt_byte_anywhere_spoils_its_line(name: str) -> None:
    stream = Stream(name)
    stream.settle(12_345.6)
    good = stream.line(12_345.6)
    stream.written.clear()
    for place in range(len(good)):
        marked = good[:place] + b"\xff\x00" + good[place:]
        lines = LineBuffer().feed(ErrorMarks().feed(marked))
        stream.feed(*lines)
        assert stream.written == []
    assert stream.balance.discarded == len(good) - 1, "without its end it is no line at all"


def test_the_port_is_told_to_check_parity_and_to_mark_what_fails() -> None:
    port = PtyPort()
    for bits in ("8N1", "7E1"):
        opened = Framing(9600, bits).open(port.url)
        try:
            assert mark_errors(opened)
            flags = termios.tcgetattr(opened.fd)[0]
            assert flags & termios.INPCK
            assert flags & termios.PARMRK
            assert not flags & (termios.IGNPAR | termios.ISTRIP)
        finally:
            opened.close()
    port.close()


class Listener:
    """Hears the lines of a link."""

    def __init__(self) -> None:
        self.lines: list[bytes] = []
        self.idles = 0

    def opened(self) -> None: ...

    def lost(self, why: str) -> None: ...

    def idle(self) -> None:
        self.idles += 1

    def line(self, raw: bytes) -> None:
        self.lines.append(raw)


def test_a_link_undoes_the_doubling_that_marking_brings() -> None:
    port, user = PtyPort(), Listener()
    link = SerialLink(port.url, Framing(9600, "8N1"), user)
    link.start()
    try:
        wait_for(lambda: port.write(b"a\xffb\n") or b"a\xffb\n" in user.lines)
        assert set(user.lines) == {b"a\xffb\n"}
    finally:
        link.close()
        port.close()


def test_half_a_line_is_thrown_away_with_the_rest_of_what_has_come_in() -> None:
    user = Listener()
    port = PtyPort()
    link = SerialLink(port.url, Framing(9600, "8N1"), user)
    link.start()
    try:
        wait_for(lambda: port.write(b"first\n") or user.lines)
        port.write(b"half")
        seen = user.idles
        wait_for(lambda: user.idles > seen + 3)
        link.discard_input()
        port.write(b"whole\n")
        wait_for(lambda: b"whole\n" in user.lines)
    finally:
        link.close()
        port.close()


def test_bytes_that_all_fail_their_parity_are_said_with_the_silence() -> None:
    stream = Stream("and")
    stream.feed(*[b"ST,+0\x0012.3456  g\r\n"] * 3)
    assert "fail the parity check" in stream.balance._why_silent()
