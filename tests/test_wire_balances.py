"""The balances' twins: byte by byte, and with clients and simulators that other people wrote."""

import asyncio
from collections.abc import Iterator

import pytest
from wire_helpers import carry_out, wait_for

from scuhand_bt.device_specs.balance import BalanceSpec
from scuhand_bt.devices.balances import DIALECTS, SerialBalance
from scuhand_bt.run.clock import WallClock
from scuhand_bt.sim.wire.balances import AndTwin, BalanceTwin, MtSicsTwin, SbiTwin, ShimadzuTwin, StillPan, balance_twin
from scuhand_bt.sim.wire.port import PtyPort, SocketPort
from scuhand_bt.sim.wire.server import TwinServer

pytestmark = pytest.mark.real_time


def say(twin: BalanceTwin, command: bytes, now_s: float = 0.0) -> bytes:
    return b"".join(twin.hear(command, now_s))


@pytest.mark.parametrize("dialect", sorted(DIALECTS))
def test_whatever_a_twin_says_its_dialect_can_read(dialect: str) -> None:
    commands = [
        b"Q",
        b"S",
        b"SI",
        b"SIR",
        b"T",
        b"Z",
        b"TI",
        b"ZI",
        b"TA",
        b"@",
        b"?SN",
        b"I0",
        b"I2",
        b"C3",
        b"M21 0 0",
    ]
    commands += [b"\x1bP", b"\x1bx1_", b"\x1bx2_", b"\x1bZ", b"D01", b"D03", b"D05", b"D07", b"D08", b"nonsense"]
    for load_mg in (0.0, 12.3, -4.5, 199_999.9, 300_000.0, -90_000.0):
        for stable in (True, False):
            twin = balance_twin(dialect)(StillPan(load_mg, stable))
            for step, command in enumerate(commands):
                for line in twin.hear(command + b"\r\n", step * 0.2):
                    assert DIALECTS[dialect].parse(line) is not None, line


def test_and_lines_are_those_of_the_manual() -> None:
    twin = AndTwin(StillPan(12_780.0), readability_mg=10.0)
    assert say(twin, b"Q\r\n") == b"ST,+00012.78  g\r\n"
    twin.pan = StillPan(-183_690.0, stable=False)
    twin.maximum_mg = 1e7
    assert say(twin, b"SI\r\n") == b"US,-00183.69  g\r\n"
    twin.pan = StillPan(2e7)
    assert say(twin, b"Q\r\n") == b"OL,+9999999E+19\r\n"


def test_and_is_silent_or_acknowledges_as_its_menu_says() -> None:
    twin = AndTwin(StillPan(1000.0))
    assert say(twin, b"R\r\n") == b""
    twin.error_codes = True
    assert say(twin, b"R\r\n") == b"\x06\r\n\x06\r\n"
    assert say(twin, b"T\r\n") == b"\x06\r\n"
    twin.pan = StillPan(1000.0, stable=False)
    assert say(twin, b"T\r\n") == b"EC,E11\r\n"
    assert say(twin, b"XYZ\r\n") == b"EC,E01\r\n"


def test_and_answers_a_stable_query_when_it_is_stable_and_not_before() -> None:
    pan = StillPan(1000.0, stable=False)
    twin = AndTwin(pan)
    assert say(twin, b"S\r\n") == b""
    assert say(twin, b"", 100.0) == b""
    pan.stable = True
    assert say(twin, b"", 101.0) == b"ST,+001.0000  g\r\n"


def test_mt_sics_lines_are_those_of_the_manual() -> None:
    pan = StillPan(100_000.0)
    twin = MtSicsTwin(pan, readability_mg=10.0)
    assert say(twin, b"S\r\n") == b"S S     100.00 g\r\n"
    pan.stable = False
    assert say(twin, b"SI\r\n") == b"S D     100.00 g\r\n"
    assert say(twin, b"T\r\n") == b""
    assert say(twin, b"", 31.0) == b"T I\r\n", "it gives up after half a minute"
    assert say(twin, b"TI\r\n") == b"TI D     100.00 g\r\n"
    assert say(twin, b"@\r\n") == b'I4 A "TWIN696838"\r\n'
    assert say(twin, b"C3\r\n", 50.0) == b"C3 B\r\n"
    assert say(twin, b"SI\r\n", 51.0) == b"S I\r\n"
    pan.stable = True
    assert say(twin, b"", 53.0) == b"C3 A\r\n"
    assert say(twin, b"FOO\r\n") == b"ES\r\n"


def test_sbi_lines_are_those_of_the_manual() -> None:
    pan = StillPan(123_560.0)
    twin = SbiTwin(pan, readability_mg=10.0)
    assert say(twin, b"\x1bP") == b"+   123.56 g  \r\n"
    pan.stable = False
    assert say(twin, b"\x1bP\r\n") == b"+   123.56    \r\n"
    assert say(twin, b"\x1bT\r\n") == b"", "silent, and nothing happens"
    assert say(twin, b"\x1bP\r\n") == b"+   123.56    \r\n"
    pan.stable = True
    twin.with_id = True
    assert say(twin, b"\x1bP\r\n") == b"N     +   123.56 g  \r\n"
    say(twin, b"\x1bT\r\n")
    assert say(twin, b"\x1bP\r\n") == b"N     +     0.00 g  \r\n"
    twin.autoprint = True
    assert say(twin, b"\x1bP\r\n", 1.0) == b"N     +     0.00 g  \r\n"
    assert say(twin, b"", 1.1) == b"N     +     0.00 g  \r\n"
    assert say(twin, b"\x1bP\r\n", 1.2) == b"", "and now it is off"


def test_shimadzu_tells_stability_only_where_it_was_asked_to() -> None:
    twin = ShimadzuTwin(StillPan(12_345.6))
    assert say(twin, b"D05\r\n") == b"  12.3456g \r\n"
    assert say(twin, b"D07\r\n") == b"S  12.3456g \r\n"
    assert say(twin, b"D03\r\n", 1.0) == b"S  12.3456g \r\n"
    assert say(twin, b"", 1.05) == b""
    assert say(twin, b"", 1.12) == b"S  12.3456g \r\n"
    assert say(twin, b"D09\r\n", 1.3) == b""
    twin.pan = StillPan(500_000.0, stable=False)
    assert say(twin, b"D07\r\n", 2.0) == b"U    oL     \r\n"


class Served:
    """A twin on a port for somebody else's client."""

    def __init__(self, dialect: str, load_mg: float = 12_345.6) -> None:
        self.pan = StillPan(load_mg)
        self.twin = balance_twin(dialect)(self.pan)

    def on(self, port: PtyPort | SocketPort) -> "TwinServer[BalanceTwin]":
        return TwinServer(self.twin, port)


def labmcp_transport(url: str):  # type: ignore[no-untyped-def]
    transports = pytest.importorskip("labmcp.transports")
    return transports.open_transport(
        url.replace("socket://", "tcp://"), read_termination="\r\n", write_termination="\r\n", timeout=5.0
    )


def test_labmcp_weighs_tares_and_zeroes_on_our_mettler_twin() -> None:
    driver = pytest.importorskip("labmcp_mettler_toledo.driver")
    served = Served("mt_sics")
    with served.on(SocketPort()) as server:
        balance = driver.MTSICSBalance(labmcp_transport(server.url))
        assert balance.identify()["serial"] == "TWIN696838"
        assert balance.weight() == driver.Weight(12.3456, "g", True)
        served.pan.stable = False
        assert balance.weight(stable=False) == driver.Weight(12.3456, "g", False)
        served.pan.stable = True
        assert balance.tare().value == 12.3456
        assert balance.weight().value == 0.0
        balance.clear_tare()
        assert balance.zero()
        served.pan.load_mg += 1000.0
        assert balance.weight().value == 1.0
        served.pan.load_mg = 1e6
        with pytest.raises(Exception, match="overload"):
            balance.weight()
        balance.close()


def test_pylabrobot_weighs_and_tares_on_our_mettler_twin() -> None:
    backend = pytest.importorskip("pylabrobot.scales.mettler_toledo_backend")
    served = Served("mt_sics")

    async def weigh(url: str) -> tuple[float, float]:
        scale = backend.MettlerToledoWXS205SDUBackend(port=url)
        await scale.setup()
        assert scale.serial_number == "TWIN696838"
        first = await scale.read_stable_weight()
        await scale.tare()
        second = await scale.read_stable_weight()
        await scale.stop()
        return first, second

    with served.on(PtyPort()) as server:
        assert asyncio.run(weigh(server.url)) == (12.3456, 0.0)


def test_labmcp_weighs_and_tares_on_our_sartorius_twin() -> None:
    driver = pytest.importorskip("labmcp_sartorius.driver")
    served = Served("sbi")
    for served.twin.with_id in (False, True):  # type: ignore[attr-defined]
        with served.on(SocketPort()) as server:
            balance = driver.SBIBalance(labmcp_transport(server.url))
            reading = balance.weight()
            assert (reading.value, reading.unit, reading.stable) == (12.3456, "g", True)
            served.pan.stable = False
            assert not balance.weight(stable=False).stable
            served.pan.stable = True
            assert balance.identify()["serial"] == "TWIN402012"
            balance.close()


def test_sartoriusb_weighs_on_our_sartorius_twin() -> None:
    sartoriusb = pytest.importorskip("sartoriusb")
    served = Served("sbi")
    with served.on(PtyPort()) as server, sartoriusb.SartoriusUsb(server.url, timeout=0.1) as balance:
        seen = balance.measure()
        assert (float(seen.value), seen.unit, seen.stable) == (12.3456, "g", True)
        served.pan.stable = False
        assert balance.measure().stable is False
        served.pan.load_mg = 1e6
        assert balance.measure().message == "High"


class Simulated:
    """A labmcp simulator at a port: it takes lines and gives lines."""

    def __init__(self, simulator: object) -> None:
        self.simulator = simulator
        self._typed = b""

    def hear(self, data: bytes, now_s: float) -> list[bytes]:
        *lines, self._typed = (self._typed + data).split(b"\r\n")
        return [line for command in lines for line in self._answer(command)]

    def _answer(self, command: bytes) -> Iterator[bytes]:
        reply = self.simulator.handle(command.decode())  # type: ignore[attr-defined]
        for line in [reply] if isinstance(reply, str) else reply or []:
            yield line.encode() + b"\r\n"


@pytest.mark.parametrize(
    ("name", "module", "simulator"),
    [
        ("mt_sics", "labmcp_mettler_toledo.simulator", "MTSICSSimulator"),
        ("sbi", "labmcp_sartorius.simulator", "SBISimulator"),
    ],
)
def test_our_driver_reads_the_labmcp_simulators(name: str, module: str, simulator: str) -> None:
    simulated = Simulated(getattr(pytest.importorskip(module), simulator)())
    clock = WallClock()
    with TwinServer(simulated, PtyPort()) as server:
        spec = BalanceSpec(driver=name, port=server.url, period_s=0.02, options={"bits": "8N1"})
        balance = SerialBalance(spec, DIALECTS[name], clock, DIALECTS.values())
        balance.open()
        try:
            reading = carry_out(balance.next_reading(), clock)
            assert reading.value_mg == pytest.approx(52_187.34, abs=0.5)
            wait_for(lambda: balance.identity)
            simulated.simulator.load_g = 10.0  # type: ignore[attr-defined]
            wait_for(lambda: balance.latest is not None and abs(balance.latest.value_mg - 10_000.0) < 0.5)
            if name == "sbi":  # the other one always says that SI was not stable
                assert carry_out(balance.stable_mean(), clock).value_mg == pytest.approx(10_000.0, abs=0.1)
        finally:
            balance.close()


@pytest.mark.parametrize("preset", ["nan g", "inf g", "-1 g", "1e9 g", "1", "1 lb", "g"])
def test_a_tare_that_is_no_mass_is_refused_and_poisons_nothing(preset: str) -> None:
    twin = MtSicsTwin(StillPan(1_000.0))
    assert twin.hear(f"TA {preset}\r\n".encode(), 0.0) == [b"TA L\r\n"]
    assert twin.hear(b"SI\r\n", 0.1) == [b"S S     1.0000 g\r\n"]
    assert twin.hear(b"TA 0.25 g\r\n", 0.2) == [b"TA A     0.2500 g\r\n"]
    assert twin.hear(b"SI\r\n", 0.3) == [b"S S     0.7500 g\r\n"]
