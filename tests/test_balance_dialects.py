"""What balances say and are told: the lines of the manuals, whatever is no line, and the talk, without a wire."""

import random
from decimal import Decimal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scuhand_bt.devices.balances import DIALECTS
from scuhand_bt.devices.balances.conversation import ANSWER_TIMEOUT_S, QUIET_S, Conversation, Phase
from scuhand_bt.devices.balances.frames import Answer, Busy, Dialect, OutOfRange, Refused, Weight
from scuhand_bt.devices.serial_link import Framing, LineBuffer

ALL = sorted(DIALECTS)


def weight(value: str, unit: str, stable: bool) -> Weight:
    return Weight(Decimal(value), unit, stable)


FRAMES = [
    ("and", b"ST,+00012.78  g\r\n", weight("12.78", "g", True)),
    ("and", b"US,-00183.69  g\r\n", weight("-183.69", "g", False)),
    ("and", b"WT,+00012.78 kg\r\n", weight("12.78", "kg", True)),
    ("and", b"QT,+00000123 PC\r\n", weight("123", "PC", False)),
    ("and", b"ST,+000012.7890  g\r\n", None),
    ("and", b"ST,+0012.7890  g\r\n", weight("12.7890", "g", True)),
    ("and", b"OL,+9999999E+19\r\n", OutOfRange(above=True)),
    ("and", b"OL,-9999999E+19\r\n", OutOfRange(above=False)),
    ("and", b"EC,E11\r\n", Busy("E11")),
    ("and", b"EC,E02\r\n", Busy("E02", adjusting=False)),
    ("and", b"EC,E01\r\n", Refused("E01")),
    ("and", b"\x06\r\n", Answer("")),
    ("and", b"SN,15608432\r\n", Answer("15608432")),
    ("mt_sics", b"S S     100.00 g\r\n", weight("100.00", "g", True)),
    ("mt_sics", b"S D    -100.00 mg\r\n", weight("-100.00", "mg", False)),
    ("mt_sics", b"S S    100.00 g\r\n", None),
    ("mt_sics", b"S S -   100.00 g\r\n", None),
    ("mt_sics", b"S +     100.00 g\r\n", None),
    ("mt_sics", b"S I\r\n", Busy("S I")),
    ("mt_sics", b"S +\r\n", OutOfRange(above=True)),
    ("mt_sics", b"S -\r\n", OutOfRange(above=False)),
    ("mt_sics", b"S L\r\n", Refused("S L")),
    ("mt_sics", b"T I\r\n", Busy("T I")),
    ("mt_sics", b"T S    12.3456 g\r\n", Answer("T S    12.3456 g")),
    ("mt_sics", b"ZI D\r\n", Answer("ZI D")),
    ("mt_sics", b"C3 B\r\n", Busy("C3 B", adjusting=True)),
    ("mt_sics", b'I4 A "B207696838"\r\n', Answer("B207696838")),
    ("mt_sics", b"C3 A\r\n", Answer("")),
    ("mt_sics", b'I0 B "0 @"\r\n', Answer("0 @")),
    ("mt_sics", b"ES\r\n", Refused("ES")),
    ("mt_sics", b"ET\r\n", Refused("ET")),
    ("mt_sics", b"EL\r\n", Refused("EL")),
    ("mt_sics", b"EX\r\n", None),
    ("mt_sics", b"S S Error 10b\r\n", Refused("Error 10b")),
    ("sbi", b"+   123.56 g  \r\n", weight("123.56", "g", True)),
    ("sbi", b"+  123.56 g  \r\n", None),
    ("sbi", b"+    123.56 g  \r\n", None),
    ("sbi", b"+    12[3.5 g  \r\n", None),
    ("sbi", b"+  12.3[5] g  \r\n", weight("12.35", "g", True)),
    ("sbi", b"+   123.56    \r\n", weight("123.56", "", False)),
    ("sbi", b"-  1234567 mg \r\n", weight("-1234567", "mg", True)),
    ("sbi", b"N     +   123.56 g  \r\n", weight("123.56", "g", True)),
    ("sbi", b"G#    +   123.56 g  \r\n", Answer("G#    +   123.56 g")),
    ("sbi", b"Stat       High     \r\n", OutOfRange(above=True)),
    ("sbi", b"     Low      \r\n", OutOfRange(above=False)),
    ("sbi", b"   Cal.Ext.   \r\n", Busy("Cal.Ext.", adjusting=True)),
    ("sbi", b"   Err 101    \r\n", Refused("Err 101")),
    ("sbi", b"0037402012\r\n", Answer("0037402012")),
    ("sbi", b"ST,+00012.78  g\r\n", None),
    ("sbi", b"+  123.[6] g  \r\n", weight("123.6", "g", True)),
    ("shimadzu", b"S  12.3456g \r\n", weight("12.3456", "g", True)),
    ("shimadzu", b"U- 12.3456g \r\n", weight("-12.3456", "g", False)),
    ("shimadzu", b"  12.3456g \r\n", weight("12.3456", "g", False)),
    ("shimadzu", b"S 1234.56 mg\r\n", None),
    ("shimadzu", b"S  1234.56ct\r\n", weight("1234.56", "ct", True)),
    ("shimadzu", b"U    oL     \r\n", OutOfRange(above=True)),
    ("shimadzu", b"S-   OL     \r\n", OutOfRange(above=False)),
]


@pytest.mark.parametrize(("name", "line", "frame"), FRAMES)
def test_each_line_of_the_manuals_is_read_as_what_it_says(name: str, line: bytes, frame: object) -> None:
    assert DIALECTS[name].parse(line) == frame


@pytest.mark.parametrize(
    ("unit", "milligrams"), [("g", 12_500.0), ("mg", 12.5), ("kg", 12_500_000.0), ("ct", 2500.0), ("PC", None)]
)
def test_units_become_milligrams_or_no_reading(unit: str, milligrams: float | None) -> None:
    assert weight("12.5", unit, True).milligrams() == milligrams


def test_a_weight_without_a_unit_takes_the_one_it_is_given() -> None:
    assert weight("12.5", "", True).milligrams() is None
    assert weight("12.5", "", True).milligrams("g") == 12_500.0
    assert weight("12.5", "mg", True).milligrams("g") == 12.5
    assert weight("12.5", "PC", True).milligrams("g") is None


@pytest.mark.parametrize(
    ("name", "framing", "commands"),
    [
        ("and", Framing(2400, "7E1"), (b"?SN\r\n", b"SIR\r\n", b"Q\r\n")),
        ("mt_sics", Framing(9600, "8N1"), (b"@\r\n", b"SIR\r\n", b"SI\r\n")),
        ("sbi", Framing(9600, "8O1"), (b"\x1bx2_\r\n", b"", b"\x1bP\r\n")),
        ("shimadzu", Framing(2400, "7E2"), (b"", b"", b"D07\r\n")),
    ],
)
def test_each_vendors_factory_setting_and_commands_are_its_manuals(
    name: str, framing: Framing, commands: tuple[bytes, bytes, bytes]
) -> None:
    dialect = DIALECTS[name]
    assert dialect.framing == framing
    assert (dialect.identify, dialect.stream, dialect.poll) == commands


@pytest.mark.parametrize(("name", "line", "frame"), [frame for frame in FRAMES if isinstance(frame[2], Weight)])
def test_no_shortened_line_is_taken_for_a_weight(name: str, line: bytes, frame: Weight) -> None:
    for end in range(len(line)):
        shorter = DIALECTS[name].parse(line[:end] + b"\r\n")
        assert not isinstance(shorter, Weight) or shorter.milligrams() is None or line[end:].strip() == b""
    for begin in range(1, len(line)):
        shorter = DIALECTS[name].parse(line[begin:])
        if isinstance(shorter, Weight):  # the sign, or the letter, may be all that is missing
            assert abs(shorter.value) == abs(frame.value)
            assert not shorter.stable or name == "sbi"


@given(st.binary(max_size=40))
def test_no_parser_fails_on_any_bytes(data: bytes) -> None:
    for dialect in DIALECTS.values():
        dialect.parse(data)
        dialect.parse(data + b"\r\n")


@pytest.mark.parametrize("name", ALL)
def test_a_million_random_and_mutated_bytes_give_no_false_weight(name: str) -> None:
    rng = random.Random(1)
    good = [line for dialect, line, frame in FRAMES if dialect == name and isinstance(frame, Weight)]
    values = {DIALECTS[name].parse(line) for line in good}
    fed = 0
    buffer = LineBuffer()
    while fed < 1_000_000:
        mutated = bytearray(rng.choice(good) if rng.random() < 0.7 else rng.randbytes(200))
        for _ in range(rng.randrange(4)):
            # A bit error that gives another digit cannot be told from the truth by anybody: no checksum.
            mutated[rng.randrange(len(mutated))] = rng.choice(b"\x00\x80\xff\r\n;#~")
        fed += len(mutated)
        for line in buffer.feed(bytes(mutated)):
            frame = DIALECTS[name].parse(line)
            if isinstance(frame, Weight):
                assert any(frame.value in (v.value, -v.value) for v in values if isinstance(v, Weight))


def test_lines_are_cut_anywhere_and_come_out_whole() -> None:
    stream = b"ST,+00012.78  g\r\nUS,-00183.69  g\r\n"
    for cut in range(len(stream)):
        buffer = LineBuffer()
        assert buffer.feed(stream[:cut]) + buffer.feed(stream[cut:]) == [stream[:17], stream[17:]]


def test_what_never_ends_is_no_line() -> None:
    buffer = LineBuffer(limit=32)
    assert buffer.feed(b"x" * 100) == []
    assert buffer.feed(b"x\r\n") == []
    assert buffer.feed(b"ES\r\n") == [b"ES\r\n"]


class Talk:
    """A conversation on a clock that the test moves."""

    def __init__(self, dialect: Dialect) -> None:
        self.now_s = 0.0
        self.said: list[bytes] = []
        self.discarded = 0
        self.it = Conversation(dialect, self.said.append, self._discard, 0.1, lambda: self.now_s)
        self.it.begin()

    def _discard(self) -> None:
        self.discarded += 1

    def after(self, seconds: float) -> "Talk":
        self.now_s += seconds
        self.it.go_on(patience_s=3.0)
        return self


def test_a_balance_that_streams_is_asked_its_name_and_then_told_to_stream() -> None:
    talk = Talk(DIALECTS["mt_sics"])
    assert talk.said == [b"@\r\n"]
    talk.it.heard(Answer("B207696838"))
    assert talk.said == [b"@\r\n", b"SIR\r\n"]


def test_a_balance_that_does_not_say_its_name_is_read_all_the_same() -> None:
    assert Talk(DIALECTS["and"]).after(ANSWER_TIMEOUT_S).said == [b"?SN\r\n", b"SIR\r\n"]


def test_a_stream_that_ended_is_started_again() -> None:
    talk = Talk(DIALECTS["and"]).after(ANSWER_TIMEOUT_S)
    assert talk.after(3.0).said[-1] == b"?SN\r\n"


def test_a_balance_that_cannot_stream_is_asked_instead() -> None:
    talk = Talk(DIALECTS["mt_sics"])
    talk.it.heard(Answer("B207696838"))
    talk.it.heard(Refused("ES"))
    assert talk.said == [b"@\r\n", b"SIR\r\n", b"SI\r\n"]
    talk.it.heard(weight("1", "g", True))
    assert talk.after(0.1).said[-1] == b"SI\r\n"


def test_one_question_at_a_time_and_not_before_the_period_is_over() -> None:
    talk = Talk(DIALECTS["shimadzu"])
    talk.after(1.0)
    assert talk.said == [b"D07\r\n"]
    assert talk.it.heard(weight("1", "g", True))
    assert talk.after(0.0).said == [b"D07\r\n", b"D07\r\n"]
    talk.it.heard(weight("1", "g", True))
    assert len(talk.after(0.05).said) == 2
    assert len(talk.after(0.05).said) == 3


def test_the_late_answer_to_a_question_that_was_given_up_is_not_used() -> None:
    talk = Talk(DIALECTS["shimadzu"]).after(ANSWER_TIMEOUT_S)
    assert talk.it.state is Phase.DRAINING
    assert talk.discarded == 1
    assert not talk.after(0.2).it.heard(weight("1", "g", True))
    assert len(talk.after(0.2).said) == 1, "the line was quiet for 0.2 s only"
    assert len(talk.after(QUIET_S).said) == 2
    assert talk.it.heard(weight("2", "g", True))


def test_after_a_broken_answer_the_next_question_does_not_wait_for_another() -> None:
    talk = Talk(DIALECTS["shimadzu"])
    talk.it.misheard()
    assert len(talk.after(0.05).said) == 1
    assert len(talk.after(0.05).said) == 2
    streaming = Talk(DIALECTS["and"]).after(ANSWER_TIMEOUT_S)
    streaming.it.misheard()
    assert streaming.it.state is Phase.LISTENING


def test_an_sbi_balance_that_prints_by_itself_is_never_asked_as_that_would_switch_it_off() -> None:
    talk = Talk(DIALECTS["sbi"])
    talk.it.heard(weight("1", "g", True))
    assert talk.after(2.5).said == [DIALECTS["sbi"].identify]
    assert talk.it.state is Phase.LISTENING
