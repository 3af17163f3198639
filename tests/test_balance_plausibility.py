"""What is believed of a balance's lines: the drivers fed with damaged streams, on a clock that the test moves."""

import random
import termios
from collections.abc import Iterator

import pytest
from wire_helpers import carry_out, wait_for

from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.device_specs.balance import BalanceSpec
from scuhand_bt.devices import doctor
from scuhand_bt.devices.balances import DIALECTS, SerialBalance
from scuhand_bt.devices.balances.plausibility import FLOW_MG_PER_S, LUMP_MG
from scuhand_bt.devices.interfaces import Reading
from scuhand_bt.devices.serial_link import ErrorMarks, Framing, LineBuffer, SerialLink, mark_errors
from scuhand_bt.failures import SkillFailed
from scuhand_bt.run.clock import VirtualClock, WallClock
from scuhand_bt.sim.wire.balances import BalanceTwin, StillPan, balance_twin
from scuhand_bt.sim.wire.port import PtyPort
from scuhand_bt.sim.wire.server import TwinServer

ALL = sorted(DIALECTS)
ASKS = {"and": b"Q\r\n", "mt_sics": b"SI\r\n", "sbi": b"\x1bP\r\n", "shimadzu": b"D07\r\n"}
PERIOD_S = 0.1


class Stream:
    """A driver that is fed with bytes, and what it gives out."""

    def __init__(self, name: str, readability_mg: float = 0.1, shown_mg: float = 0.1, **spec: object) -> None:
        self.name = name
        self.pan = StillPan()
        self.twin: BalanceTwin = balance_twin(name)(self.pan, shown_mg)
        self.clock = VirtualClock()
        figures = BalanceSpec(driver=name, readability_mg=readability_mg, **spec)  # type: ignore[arg-type]
        self.balance = SerialBalance(figures, DIALECTS[name], self.clock, DIALECTS.values())
        self.balance.opened()
        self.written: list[Reading] = []
        self.balance.on_reading = self.written.append
        self.buffer = LineBuffer()

    def line(self, load_mg: float, stable: bool = True) -> bytes:
        """What the balance sends with this load on its pan."""
        self.pan.load_mg, self.pan.stable = load_mg, stable
        return b"".join(self.twin.hear(ASKS[self.name], 0.0))

    def feed(self, *messages: bytes) -> list[Reading]:
        """The readings given out while these come, one a period."""
        given: list[Reading] = []
        for message in messages:
            self.clock.now_s += PERIOD_S
            for line in self.buffer.feed(message):
                before = self.balance.latest
                self.balance.line(line)
                if self.balance.latest is not None and self.balance.latest is not before:
                    given.append(self.balance.latest)
        return given

    def weigh(self, *loads_mg: float, stable: bool = True) -> list[Reading]:
        return self.feed(*(self.line(load_mg, stable) for load_mg in loads_mg))

    def settle(self, load_mg: float) -> None:
        assert self.weigh(*[load_mg] * 12)[-1].stable
        assert self.balance.latest is not None
        assert self.balance.latest.value_mg == pytest.approx(load_mg)


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


def test_a_flickering_balance_is_believed_to_be_stable_nearly_always() -> None:
    for digits in (0.3, 0.8, 8.0):  # standard deviation
        rng = random.Random(4)
        stream = Stream("mt_sics")
        given = stream.weigh(*[1000.0 + round(digits * rng.gauss(0.0, 1.0)) * 0.1 for _ in range(1000)])
        assert sum(reading.stable for reading in given) > 930, digits


def test_a_step_of_one_digit_is_believed_to_be_stable_when_it_is_said_twice() -> None:
    stream = Stream("shimadzu")
    stream.settle(500.0)
    assert [reading.stable for reading in stream.weigh(500.1, 500.1, 500.1)] == [False, True, True]


def test_what_was_said_before_the_balance_moved_bears_nothing_out() -> None:
    stream = Stream("and")
    stream.settle(500.0)
    stream.weigh(503.0, stable=False)
    assert [reading.stable for reading in stream.weigh(500.0, 500.0)] == [False, True]


# --- steps


def test_a_container_put_on_the_pan_is_shown_two_readings_later_and_written_down_at_once() -> None:
    stream = Stream("mt_sics")
    stream.settle(0.0)
    stream.written.clear()
    assert stream.weigh(20_000.0, 20_000.0) == []
    assert [reading.value_mg for reading in stream.written] == [20_000.0, 20_000.0]
    assert [reading.stable for reading in stream.written] == [False, False]
    assert [reading.value_mg for reading in stream.weigh(20_000.0, 20_000.0)] == [20_000.0, 20_000.0]
    assert stream.balance.discarded == 0


def test_a_load_that_rises_for_a_second_is_followed_with_no_more_delay_than_that() -> None:
    stream = Stream("and")
    stream.settle(0.0)
    rising_mg = [2000.0 * step for step in range(1, 11)]
    given = stream.weigh(*rising_mg, stable=False)
    assert len(given) == 3
    assert all(stream.clock.now_s - reading.time_s < 12 * PERIOD_S for reading in given)
    assert stream.weigh(20_000.0, 20_000.0, 20_000.0)[-1].value_mg == 20_000.0


def test_one_line_far_off_is_held_back_and_then_counted_as_discarded() -> None:
    stream = Stream("sbi")
    stream.settle(1000.0)
    given = stream.weigh(9000.0, 1000.0, 1000.0)
    assert [reading.value_mg for reading in given] == [1000.0, 1000.0]
    assert stream.balance.discarded == 1


def test_lines_that_contradict_each_other_confirm_nothing() -> None:
    stream = Stream("and")
    stream.settle(5000.0)
    assert stream.weigh(9000.0, 1000.0, 9000.0, 1000.0, 9000.0) == []
    assert stream.weigh(5000.0)[-1].value_mg == 5000.0


def test_of_three_lines_that_confirm_a_step_one_may_be_false() -> None:
    for place in range(3):
        stream = Stream("mt_sics")
        stream.settle(0.0)
        loads_mg = [20_000.0] * 3
        loads_mg[place] = 80_000.0
        assert [reading.value_mg for reading in stream.weigh(*loads_mg)] == [20_000.0]


@pytest.mark.parametrize("period_s", [0.05, 0.1])
def test_no_reading_of_a_dose_is_held_back(period_s: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Beads at full opening; titanium dioxide, in lumps of tens of milligrams that are felt as twice their weight."""
    monkeypatch.setattr("test_balance_plausibility.PERIOD_S", period_s)
    stream = Stream("shimadzu")
    stream.settle(10_000.0)
    rng, load_mg, felt_mg = random.Random(2), 10_000.0, []
    for _ in range(200):
        lump_mg = rng.choice((0.0, 0.0, rng.uniform(1.0, 50.0)))
        load_mg += 800.0 * period_s
        felt_mg.append(round(load_mg + 2.0 * lump_mg, 1))
        load_mg += lump_mg
    assert len(stream.weigh(*felt_mg, stable=False)) == 200


def test_a_conversation_that_begins_anew_believes_nothing_of_the_last_one() -> None:
    stream = Stream("mt_sics", 0.1, 1.0)
    stream.weigh(*[1000.0] * 10)
    stream.balance.opened()
    assert stream.balance.misfit is None
    stream.twin.readability_mg = 0.1
    stream.settle(1000.0)
    stream.balance.opened()
    assert stream.weigh(1000.0, 1000.0) == []
    assert stream.balance.discarded == 0


# --- readability


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize(("configured_mg", "shown_mg"), [(0.1, 1.0), (1.0, 0.1), (0.1, 0.01), (10.0, 1.0)])
def test_another_readability_than_configured_is_refused_with_what_to_write(
    name: str, configured_mg: float, shown_mg: float
) -> None:
    stream = Stream(name, configured_mg, shown_mg)
    assert stream.weigh(*[12_345.0] * 20) == []
    fault = stream.balance.fault
    assert fault is not None
    said = f"it shows steps of {shown_mg:g} mg instead of {configured_mg:g} mg; write `readability: {shown_mg:g} mg`"
    assert said in fault.detail


def test_a_line_or_two_of_another_form_are_noise_and_cost_nothing_else() -> None:
    stream = Stream("mt_sics")
    stream.settle(1000.0)
    assert stream.feed(b"S S       1.00 g\r\n", b"S S     1.0000 f\r\n") == []
    assert stream.balance.fault is None
    assert stream.weigh(1000.0)[-1].stable
    assert stream.balance.discarded == 2


def test_a_balance_set_right_again_is_read_again() -> None:
    stream = Stream("and", 0.1, 1.0)
    stream.weigh(*[1000.0] * 10)
    assert stream.balance.misfit is not None
    stream.twin.readability_mg = 0.1
    assert stream.weigh(*[1000.0] * 4)[-1].value_mg == 1000.0
    assert stream.balance.fault is None
    assert stream.balance.misfit is None


@pytest.mark.parametrize(("step_mg", "shown_mg"), [(1.0, 1.0), (0.2, 0.2), (0.5, 0.5)])
def test_a_last_digit_that_never_changes_is_noticed(step_mg: float, shown_mg: float) -> None:
    stream = Stream("shimadzu")
    stream.settle(0.0)
    given = stream.weigh(*[round(step_mg * step, 1) for step in range(1, 40)], stable=False)
    assert len(given) < 25
    fault = stream.balance.fault
    assert fault is not None
    assert f"it shows steps of {shown_mg:g} mg instead of 0.1 mg" in fault.detail


def test_a_load_that_stands_still_says_nothing_of_the_last_digit() -> None:
    stream = Stream("shimadzu")
    for load_mg in (0.0, 1000.0, 2000.0):
        stream.settle(load_mg)
    assert stream.balance.fault is None


def test_half_milligram_steps_are_read_where_they_are_configured() -> None:
    stream = Stream("mt_sics", 0.5, 0.5)
    assert stream.weigh(*[1000.5] * 4)[-1].value_mg == 1000.5
    given = stream.feed(b"S S     1.0006 g\r\n", b"S S     1.0005 g\r\n")
    assert [reading.value_mg for reading in given] == [1000.5]


def test_a_unit_other_than_the_configured_one_is_refused() -> None:
    stream = Stream("mt_sics", options={"unit": "mg"})
    stream.weigh(*[1000.0] * 6)
    assert stream.balance.misfit is not None
    assert "write `unit: g`" in stream.balance.misfit.what_to_do


# --- range


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize(("load_mg", "what"), [(120_500.0, "beyond its maximum"), (-121_000.0, "in underload")])
def test_more_than_the_maximum_is_overload_whatever_the_line_says(name: str, load_mg: float, what: str) -> None:
    stream = Stream(name)
    stream.twin.maximum_mg = 1e9
    stream.settle(5000.0)
    assert stream.weigh(*[load_mg] * 3) == []
    with pytest.raises(SkillFailed, match=rf"balance\.overload: .*{what}"):
        next(stream.balance.next_reading())
    stream.settle(5000.0)


def test_a_single_false_line_beyond_the_maximum_is_no_overload() -> None:
    stream = Stream("and")
    stream.twin.maximum_mg = 1e9
    stream.settle(5000.0)
    stream.weigh(185_000.0, 5000.0)
    reading = stream.balance.next_reading()
    next(reading)
    stream.weigh(5000.0)
    with pytest.raises(StopIteration):
        next(reading)


def test_a_balance_whose_line_is_held_back_is_not_silent() -> None:
    stream = Stream("and")
    stream.settle(0.0)
    reading = stream.balance.next_reading(timeout_s=0.25)
    next(reading)
    for _ in range(2):
        stream.weigh(3000.0)
        next(reading)
    stream.clock.now_s += 0.06  # 0.26 s after it was asked for
    next(reading)
    stream.weigh(3000.0)
    with pytest.raises(StopIteration):
        next(reading)


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


# --- the twins, the doctor


@pytest.fixture
def served(request: pytest.FixtureRequest) -> Iterator[tuple[TwinServer[BalanceTwin], BalanceSpec]]:
    """A twin on a pseudo-terminal that shows steps of 1 mg, and the spec that says so."""
    name = request.param
    twin = balance_twin(name)(StillPan(12_345.0), 1.0, 120_000.0)
    twin.period_s = 0.005
    with TwinServer(twin, PtyPort()) as server:
        yield (
            server,
            BalanceSpec(driver=name, port=server.url, period_s=0.005, readability_mg=1.0, options={"bits": "8N1"}),
        )


@pytest.mark.real_time
@pytest.mark.parametrize("served", ALL, indirect=True)
def test_the_real_driver_never_believes_the_twins_flipped_bits(
    served: tuple[TwinServer[BalanceTwin], BalanceSpec], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("scuhand_bt.devices.balances.conversation.ANSWER_TIMEOUT_S", 0.1)
    server, spec = served
    server.misbehaviour.flip_every = 5
    written: list[Reading] = []
    balance, clock = SerialBalance(spec, DIALECTS[spec.driver], WallClock(), DIALECTS.values()), WallClock()
    balance.on_reading = written.append
    balance.open()
    try:
        wait_for(lambda: balance.discarded > 20)
        mean = carry_out(balance.stable_mean(), clock)
    finally:
        balance.close()
    assert mean.value_mg == 12_345.0
    assert {reading.value_mg for reading in written if reading.stable} == {12_345.0}
    assert any(reading.value_mg != 12_345.0 for reading in written), "what was not believed is written down too"


@pytest.mark.real_time
@pytest.mark.parametrize("served", ["shimadzu"], indirect=True)
def test_after_a_broken_answer_a_polled_balance_is_asked_again_at_once(
    served: tuple[TwinServer[BalanceTwin], BalanceSpec],
) -> None:
    server, spec = served
    clock = WallClock()
    balance = SerialBalance(spec, DIALECTS[spec.driver], clock, DIALECTS.values())
    balance.open()
    try:
        carry_out(balance.next_reading(), clock)
        server.misbehaviour.garble = 3
        wait_for(lambda: balance.discarded == 3)
        carry_out(balance.next_reading(timeout_s=1.0), clock)
    finally:
        balance.close()


def of_cell(balance: BalanceSpec) -> CellSpec:
    return CellSpec(cell="bench", stations={}, balance=balance)


@pytest.mark.real_time
@pytest.mark.parametrize("served", ALL, indirect=True)
def test_the_doctor_says_which_readability_it_has_seen_and_how_clean_the_line_is(
    served: tuple[TwinServer[BalanceTwin], BalanceSpec],
) -> None:
    found = [(f.check, f.verdict) for f in doctor.balance(of_cell(served[1]), WallClock())]
    assert found[:2] == [("reading", "ok"), ("readability", "ok")]
    assert found[-1] == ("line", "ok")


@pytest.mark.real_time
@pytest.mark.parametrize("served", ALL, indirect=True)
def test_the_doctor_says_that_the_readability_is_another_and_what_to_write(
    served: tuple[TwinServer[BalanceTwin], BalanceSpec],
) -> None:
    (wrong,) = doctor.balance(of_cell(served[1].model_copy(update={"readability_mg": 0.1})), WallClock())
    assert (wrong.check, wrong.verdict, wrong.found, wrong.expected) == (
        "readability",
        "FAIL",
        "steps of 1 mg",
        "0.1 mg",
    )
    assert wrong.what_to_do.startswith("write `readability: 1 mg` for the balance in robot/cell.yaml")


@pytest.mark.real_time
@pytest.mark.parametrize("served", ["shimadzu"], indirect=True)
def test_the_doctor_finds_a_bad_cable(served: tuple[TwinServer[BalanceTwin], BalanceSpec]) -> None:
    server, spec = served
    server.misbehaviour.flip_every = 3
    findings = {f.check: f for f in doctor.balance(of_cell(spec), WallClock())}
    assert findings["line"].verdict == "FAIL"
    assert "cable" in findings["line"].what_to_do
