import random

import pytest
from wire_helpers import carry_out, wait_for

from scuhand_bt.device_specs.balance import BalanceSpec
from scuhand_bt.devices.balances import DIALECTS, SerialBalance
from scuhand_bt.devices.balances.frames import Weight
from scuhand_bt.devices.interfaces import Reading
from scuhand_bt.failures import SkillFailed
from scuhand_bt.run.clock import WallClock
from scuhand_bt.sim.wire.balances import BalanceTwin, StillPan, balance_twin
from scuhand_bt.sim.wire.port import PtyPort, SocketPort
from scuhand_bt.sim.wire.server import TwinServer

pytestmark = pytest.mark.real_time

ALL = sorted(DIALECTS)


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
        self.twin: BalanceTwin = balance_twin(name)(self.pan, readability_mg, maximum_mg)
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
        assert bench.balance.identity in ("TWIN8432", "TWIN696838", "TWIN402012")


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
        with pytest.raises(SkillFailed, match="'PC' \\(not a unit of mass\\)"):
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
            SkillFailed, match=r"not in the format A&D, such as 'S +12\.3456 g'; set the balance to that format"
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
def test_many_unplugs_are_each_reported_and_survived(port: type[PtyPort | SocketPort]) -> None:
    rng = random.Random(5)
    with Bench("shimadzu", port()) as bench:
        for cycle in range(100 if port is PtyPort else 5):
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
