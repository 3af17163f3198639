"""What every balance's driver has to pass, the engine's own and anybody else's, against its twin.

Each check raises AssertionError with what is wrong. The second half runs in real time, a few seconds.
"""

import random
import time

from scuhand_bt.clock import carried_out
from scuhand_bt.device_specs.balance import BalanceSpec
from scuhand_bt.devices.balances.frames import Answer, Busy, Dialect, OutOfRange, Refused, Weight
from scuhand_bt.devices.interfaces import Site, is_twin
from scuhand_bt.drivers import driver_of
from scuhand_bt.run.clock import WallClock
from scuhand_bt.sim.wire.balances import BalanceTwin, StillPan, balance_twin
from scuhand_bt.sim.wire.port import PtyPort
from scuhand_bt.sim.wire.server import TwinServer
from scuhand_bt.testing.at_the_wire import fails, options_of, until

MAXIMUM_MG = 120_000.0
DIGIT_MG = 0.1
LOADS_MG = (0.0, 0.1, 12.3, 9_200.0, 119_999.9, -0.1, -1_500.0)
LOAD_MG = 9_200.0


def balance_conforms(driver: str) -> None:
    """All of it, for a driver as `robot/cell.yaml` names it."""
    dialect, twin = driver_of("balance", driver), balance_twin(driver)
    if isinstance(dialect, Dialect):
        readings_are_understood(dialect, twin)
        nothing_else_is_a_reading(dialect, twin)
        questions_are_answered(dialect, twin)
    the_driver_reads_it(driver)


def readings_are_understood(dialect: Dialect, twin: type[BalanceTwin]) -> None:
    """Every load is read as it is, stable only where the balance says so; what is out of range is no reading."""
    for load_mg in LOADS_MG:
        for stable in (True, False):
            line = _said(dialect, twin(StillPan(load_mg, stable), DIGIT_MG, MAXIMUM_MG))
            frame = dialect.parse(line)
            assert isinstance(frame, Weight), f"{line!r} of {load_mg} mg is read as {frame}, not as a weight"
            told_mg = frame.milligrams("g")
            assert told_mg is not None, f"{line!r}: the unit '{frame.unit}' is none of mass"
            assert abs(told_mg - load_mg) < 1e-6, f"{line!r} of {load_mg} mg is read as {told_mg} mg"
            assert frame.stable == stable, f"{line!r} is read as {'stable' if frame.stable else 'unstable'}"
    for load_mg, above in ((2 * MAXIMUM_MG, True), (-0.5 * MAXIMUM_MG, False)):
        line = _said(dialect, twin(StillPan(load_mg), DIGIT_MG, MAXIMUM_MG))
        assert dialect.parse(line) == OutOfRange(above), f"{line!r} is out of range"


def _said(dialect: Dialect, balance: BalanceTwin) -> bytes:
    """The line that the driver's question, or its stream, is answered by."""
    lines = balance.hear(dialect.poll or dialect.stream, 0.0) or balance.hear(b"", 1.0)
    assert len(lines) == 1, f"{dialect.poll or dialect.stream!r} is answered by {lines}"
    return lines[0]


def nothing_else_is_a_reading(dialect: Dialect, twin: type[BalanceTwin]) -> None:
    """No bytes make the parser fail, and no shortened line is a stable weight of another value."""
    line = _said(dialect, twin(StillPan(12_345.6), DIGIT_MG, MAXIMUM_MG))
    whole = dialect.parse(line)
    assert isinstance(whole, Weight)
    for end in range(len(line.rstrip())):
        part = dialect.parse(line[:end] + b"\r\n")
        assert not (isinstance(part, Weight) and part.milligrams("g")), f"{line[:end]!r} is read as {part}"
    for begin in range(1, len(line)):
        part = dialect.parse(line[begin:])
        is_same = isinstance(part, Weight) and abs(part.value) == abs(whole.value)
        assert not isinstance(part, Weight) or is_same, f"{line[begin:]!r} is read as {part}"
    rng = random.Random(1)
    for _ in range(20_000):
        dialect.parse(rng.randbytes(rng.randrange(30)) + b"\r\n")
        mutant = bytearray(line)
        mutant[rng.randrange(len(line))] = rng.randrange(256)
        dialect.parse(bytes(mutant))


def questions_are_answered(dialect: Dialect, twin: type[BalanceTwin]) -> None:
    """What the driver says gets what it expects: who the balance is, a stream, or one reading."""
    assert dialect.stream or dialect.poll, "a dialect streams, or is polled"
    balance = twin(StillPan(LOAD_MG, stable=False), DIGIT_MG, MAXIMUM_MG)
    if dialect.identify:
        frames = [dialect.parse(line) for line in balance.hear(dialect.identify, 0.0)]
        told = [frame.text for frame in frames if isinstance(frame, Answer) and frame.text]
        assert told, f"it says who it is by {frames}"
        assert is_twin(told[-1]), f"its twin says that it is '{told[-1]}': begin that with TWIN"
    if dialect.poll:
        frames = [dialect.parse(line) for line in balance.hear(dialect.poll, 1.0)]
        assert any(isinstance(frame, Weight) for frame in frames), f"it answers {dialect.poll!r} by {frames}"
    if dialect.stream:
        times_s = [2.0 + 0.05 * n for n in range(41)]
        lines = [line for at_s in times_s for line in balance.hear(dialect.stream if at_s == 2.0 else b"", at_s)]
        frames = [dialect.parse(line) for line in lines]
        weights = sum(isinstance(frame, Weight) for frame in frames)
        assert weights >= 5, f"in 2 s of its stream there are {weights} weights"
        assert not any(isinstance(frame, Refused | Busy) or frame is None for frame in frames), f"it streams {lines}"


def the_driver_reads_it(driver: str) -> None:
    """The engine's driver over the twin's wire: readings, a mean, unrest, overload, a cable pulled and put back."""
    pan = StillPan(LOAD_MG)
    twin = balance_twin(driver)(pan, DIGIT_MG, MAXIMUM_MG)
    clock = WallClock()
    with TwinServer(twin, PtyPort()) as server:
        # A pseudo-terminal cannot be set to seven bits or parity twice.
        spec = BalanceSpec(driver=driver, port=server.url, options={"bits": "8N1"}, maximum_mg=MAXIMUM_MG)
        options = (
            spec.options if isinstance(driver_of("balance", driver), Dialect) else options_of("balance", driver, {})
        )
        balance = driver_of("balance", driver).connect(Site(spec, options, clock))
        try:
            until(lambda: balance.latest is not None, "a first reading")
            reading = carried_out(balance.next_reading(), clock)
            assert abs(reading.value_mg - LOAD_MG) < DIGIT_MG, f"{reading}"
            mean = carried_out(balance.stable_mean(), clock)
            assert abs(mean.value_mg - LOAD_MG) < DIGIT_MG, f"{mean}"
            pan.stable = False
            time.sleep(0.3)
            fails(lambda: carried_out(balance.stable_mean(0.6), clock), "balance.unstable")
            pan.stable, pan.load_mg = True, 2 * MAXIMUM_MG
            time.sleep(0.5)
            fails(lambda: carried_out(balance.next_reading(), clock), "balance.overload")
            pan.load_mg = LOAD_MG
            server.unplug()
            until(lambda: balance.fault is not None and balance.fault.code == "device.lost", "a lost balance is told")
            server.plug()
            until(lambda: balance.fault is None, "it comes back")
            assert abs(carried_out(balance.next_reading(), clock).value_mg - LOAD_MG) < DIGIT_MG
        finally:
            balance.close()
