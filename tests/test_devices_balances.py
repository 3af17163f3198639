import random
from decimal import Decimal

import pytest
from hypothesis import given
from hypothesis import strategies as st
from wire_helpers import carry_out, wait_for

from scuhand_bt.cell_spec import BalanceSpec
from scuhand_bt.devices.balances import DIALECTS, SerialBalance
from scuhand_bt.devices.balances.conversation import ANSWER_TIMEOUT_S, QUIET_S, Conversation, Phase
from scuhand_bt.devices.balances.frames import Answer, Busy, Dialect, OutOfRange, Refused, Weight
from scuhand_bt.devices.interfaces import Reading
from scuhand_bt.devices.serial_link import LineBuffer
from scuhand_bt.failures import SkillFailed
from scuhand_bt.run.clock import WallClock
from scuhand_bt.sim.wire.balances import TWINS, BalanceTwin, StillPan
from scuhand_bt.sim.wire.port import PtyPort, SocketPort
from scuhand_bt.sim.wire.server import TwinServer

pytestmark = pytest.mark.real_time

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
    ("mt_sics", b"ES\r\n", Refused("ES")),
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


class Bench:
    """A twin on a port, and the driver at the other end."""

    def __init__(
        self,
        name: str,
        port: PtyPort | SocketPort,
        readability_mg: float = 0.1,
        maximum_mg: float = 220_000.0,
        **options: object,
    ) -> None:
        self.pan = StillPan(12_345.6)
        self.twin: BalanceTwin = TWINS[name](self.pan, readability_mg, maximum_mg)
        self.twin.period_s = 0.02
        self.server = TwinServer(self.twin, port)
        self.clock = WallClock()
        spec = BalanceSpec(
            driver=name,
            port=port.url,
            period_s=0.02,
            readability_mg=readability_mg,
            maximum_mg=maximum_mg,
            options={"bits": "8N1"} | options,
        )
        self.balance = SerialBalance(spec, DIALECTS[name], self.clock, DIALECTS.values(), reopen_s=0.005)

    def __enter__(self) -> "Bench":
        self.server.__enter__()
        self.balance.open()
        return self

    def __exit__(self, *error: object) -> None:
        self.balance.close()
        self.server.__exit__(None, None, None)

    def read_on(self) -> None:
        """Read until that fails."""
        while True:
            carry_out(self.balance.next_reading(), self.clock)

    def reads(self, value_mg: float) -> None:
        """Wait until the balance reads this."""
        wait_for(lambda: (latest := self.balance.latest) is not None and latest.value_mg == value_mg)


@pytest.mark.parametrize("port", [PtyPort, SocketPort])
@pytest.mark.parametrize("name", ALL)
def test_every_balance_is_read_over_a_terminal_and_a_socket(name: str, port: type[PtyPort | SocketPort]) -> None:
    with Bench(name, port()) as bench:
        reading = carry_out(bench.balance.next_reading(), bench.clock)
        assert reading.value_mg == 12_345.6
        assert reading.unit == "g"
        assert reading.raw.endswith(b"\r\n")
        bench.pan.stable = False
        bench.pan.load_mg = -321.5
        bench.reads(-321.5)
        assert not bench.balance.latest.stable  # type: ignore[union-attr]
        bench.pan.stable = True
        mean = carry_out(bench.balance.stable_mean(), bench.clock)
        assert mean.value_mg == -321.5
        assert 0.02 < mean.uncertainty_mg < 0.04, "the rounding to 0.1 mg remains"


@pytest.mark.parametrize("name", ALL)
def test_whoever_listens_hears_every_reading_with_the_line_that_it_came_in(name: str) -> None:
    with Bench(name, PtyPort()) as bench:
        bench.reads(12_345.6)
        heard: list[Reading] = []
        bench.balance.on_reading = heard.append
        for load_mg in (-20.0, 400.1, 12_345.6):
            bench.pan.load_mg = load_mg
            bench.reads(load_mg)
        bench.balance.on_reading = None
        assert {reading.value_mg for reading in heard} >= {-20.0, 400.1, 12_345.6}
        for reading in heard:
            weight = DIALECTS[name].parse(reading.raw)
            assert isinstance(weight, Weight)
            assert weight.milligrams("g") == reading.value_mg
            assert weight.stable >= reading.stable


@pytest.mark.parametrize("name", ["and", "mt_sics", "sbi"])
def test_the_balance_says_who_it_is(name: str) -> None:
    with Bench(name, PtyPort()) as bench:
        wait_for(lambda: bench.balance.identity)
        assert bench.balance.identity in ("15608432", "B207696838", "0037402012")


@pytest.mark.parametrize("name", ALL)
def test_overload_and_underload_fail_with_their_own_code_and_pass_when_they_pass(name: str) -> None:
    with Bench(name, PtyPort()) as bench:
        bench.reads(12_345.6)
        for load_mg in (300_000.0, -50_000.0):
            bench.pan.load_mg = load_mg
            with pytest.raises(SkillFailed, match=r"balance\.overload"):
                bench.read_on()
        bench.pan.load_mg = 5.0
        bench.reads(5.0)


@pytest.mark.parametrize("name", ALL)
def test_half_a_line_noise_and_a_broken_one_cost_no_more_than_themselves(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("scuhand_bt.devices.balances.conversation.ANSWER_TIMEOUT_S", 0.5)
    with Bench(name, PtyPort()) as bench:
        bench.reads(12_345.6)
        bench.server.misbehaviour.split = 1
        bench.server.misbehaviour.delay_s = 0.3
        bench.pan.load_mg = 7.0
        bench.reads(7.0)
        bench.server.misbehaviour.noise = b"\xff\x00\x80\r\n\r\nST,+0001"
        bench.server.misbehaviour.garble = 1
        bench.pan.load_mg = 8.0
        bench.reads(8.0)


@pytest.mark.parametrize("name", ALL)
def test_a_balance_that_never_settles_fails_as_unstable(name: str) -> None:
    with Bench(name, PtyPort(), unit="g") as bench:
        bench.pan.stable = False
        with pytest.raises(SkillFailed, match=r"balance\.unstable"):
            carry_out(bench.balance.stable_mean(timeout_s=1.0), bench.clock)


def test_an_sbi_balance_that_was_never_stable_gives_no_reading_as_its_unit_is_unknown() -> None:
    with Bench("sbi", PtyPort()) as bench:
        bench.pan.stable = False
        with pytest.raises(SkillFailed, match="it shows no unit"):
            carry_out(bench.balance.next_reading(timeout_s=0.5), bench.clock)
        bench.pan.stable = True
        bench.reads(12_345.6)
        bench.pan.stable = False
        bench.pan.load_mg = 9.0
        bench.reads(9.0)


@pytest.mark.parametrize(
    ("unit", "readability_mg", "load_mg"),
    [("mg", 0.1, 12_345.6), ("ct", 0.2, 200.2), ("kg", 1000.0, 9_999_000.0), ("g", 1.0, 99_999_999.0)],
)
def test_milligrams_carats_kilograms_and_large_loads_are_read(unit: str, readability_mg: float, load_mg: float) -> None:
    with Bench("and", PtyPort(), readability_mg, maximum_mg=2e9) as bench:
        bench.twin.unit = unit
        bench.pan.load_mg = load_mg
        bench.reads(load_mg)


def test_pieces_are_no_mass() -> None:
    with Bench("and", PtyPort()) as bench:
        bench.reads(12_345.6)
        bench.twin.streaming = False
        bench.server.say(b"QT,+00000123 PC\r\n")
        with pytest.raises(SkillFailed, match="'PC', which is no mass"):
            carry_out(bench.balance.next_reading(timeout_s=0.5), bench.clock)


def test_a_balance_that_speaks_another_dialect_is_named_and_never_read() -> None:
    with Bench("and", SocketPort()) as bench:
        bench.reads(12_345.6)
        bench.twin.streaming = False
        bench.server.say(b"S S     100.00 g\r\n")
        wait_for(lambda: bench.balance.latest is None)
        with pytest.raises(SkillFailed, match="it speaks MT-SICS; change `driver`"):
            carry_out(bench.balance.next_reading(), bench.clock)


def test_lines_of_no_known_format_are_shown_as_they_came(monkeypatch: pytest.MonkeyPatch) -> None:
    """An A&D balance whose menu says MT, or NU, or a wrong parity: it is not silent."""
    monkeypatch.setattr(BalanceSpec, "lost_after_s", 0.3)
    with Bench("and", SocketPort()) as bench:
        bench.reads(12_345.6)
        bench.twin.format = "MT"  # type: ignore[attr-defined]
        with pytest.raises(
            SkillFailed, match=r"no line of A&D, such as 'S +12\.3456 g'; set the balance to that format"
        ):
            bench.read_on()
        bench.twin.format = "A&D"  # type: ignore[attr-defined]
        bench.reads(12_345.6)
        assert bench.balance.fault is None


def test_a_balance_that_falls_silent_in_overload_is_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(BalanceSpec, "lost_after_s", 0.3)
    with Bench("shimadzu", PtyPort()) as bench:
        bench.pan.load_mg = 1e6
        with pytest.raises(SkillFailed, match=r"balance\.overload"):
            bench.read_on()
        assert bench.balance.fault is None, "the load is to blame"
        bench.server.paused = True
        wait_for(lambda: bench.balance.fault is not None and bench.balance.fault.code == "device.lost")


def test_an_adjustment_in_progress_is_busy_and_then_over() -> None:
    with Bench("mt_sics", SocketPort()) as bench:
        bench.reads(12_345.6)
        bench.twin.streaming = False
        bench.server.say(b"C3 B\r\n")
        with pytest.raises(SkillFailed, match=r"busy \(C3 B\)"):
            carry_out(bench.balance.next_reading(timeout_s=0.5), bench.clock)
        bench.server.say(b"C3 A\r\n")
        bench.twin.streaming = True
        carry_out(bench.balance.next_reading(), bench.clock)


@pytest.mark.parametrize("port", [PtyPort, SocketPort])
def test_hundreds_of_unplugs_are_each_reported_and_survived(port: type[PtyPort | SocketPort]) -> None:
    rng = random.Random(5)
    with Bench("shimadzu", port()) as bench:
        for cycle in range(500 if port is PtyPort else 10):
            bench.pan.load_mg = float(cycle)
            if rng.random() < 0.5:
                bench.reads(float(cycle))
            bench.server.unplug()
            with pytest.raises(SkillFailed, match=r"device\.lost"):
                bench.read_on()  # a line that had come before the cable was pulled is still a reading
            wait_for(lambda: bench.balance.latest is None)
            bench.server.plug()
        bench.pan.load_mg = 1.0
        bench.reads(1.0)


def test_a_port_that_another_program_has_open_is_refused() -> None:
    with Bench("and", PtyPort()) as bench:
        second = SerialBalance(bench.balance.spec, DIALECTS["and"], bench.clock)
        with pytest.raises(SkillFailed, match=r"device\.lost: cannot open .*exclusively lock"):
            second.open()


def test_a_port_that_cannot_be_opened_is_named_with_what_to_do() -> None:
    spec = BalanceSpec(driver="and", port="/dev/no-such-port")
    with pytest.raises(SkillFailed, match=r"device\.lost: cannot open /dev/no-such-port: .*check the cable"):
        SerialBalance(spec, DIALECTS["and"], WallClock()).open()
