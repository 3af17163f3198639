"""What comes in on the wires: a million bytes into every parser, and cables that are pulled at random moments."""

import contextlib
import random
import subprocess
import tempfile
import time
from collections.abc import Callable, Generator, Hashable, Iterator
from pathlib import Path
from statistics import median
from typing import Any, TypeAlias

import numpy as np
from dynamixel_sdk import COMM_SUCCESS

from scuhand_bt.device_specs.arm import ArmSpec
from scuhand_bt.device_specs.balance import BalanceSpec
from scuhand_bt.device_specs.hand import HandSpec
from scuhand_bt.devices.balances import DIALECTS, SerialBalance
from scuhand_bt.devices.balances.frames import Weight
from scuhand_bt.devices.dynamixel.arm import arm_axes
from scuhand_bt.devices.dynamixel.axis_group import AxisGroup
from scuhand_bt.devices.dynamixel.bus import DynamixelBus, _Packets
from scuhand_bt.devices.dynamixel.servo_loop import ServoChain
from scuhand_bt.devices.hand_controller import HandController
from scuhand_bt.devices.hand_protocol import decode, encode
from scuhand_bt.devices.serial_link import LineBuffer
from scuhand_bt.failures import SkillFailed
from scuhand_bt.lab import starter_lab
from scuhand_bt.run.clock import WallClock
from scuhand_bt.sim.wire.balances import StillPan, balance_twin
from scuhand_bt.sim.wire.dynamixel import DynamixelTwin, PacketReader, crane_x7, packet
from scuhand_bt.sim.wire.hand import HandTwin
from scuhand_bt.sim.wire.port import PtyPort, SocketPort
from scuhand_bt.sim.wire.server import TwinServer

Figures: TypeAlias = dict[str, Any]

FIRMWARE = starter_lab() / "robot" / "firmware"
FED = 1_000_000
PIECE = 1024
WAIT_S = 20.0


# --- parsers


def noise(good: list[bytes], wrong: Callable[[random.Random], int], seed: int = 6) -> bytes:
    """Good frames, frames with one to three bytes changed by `wrong`, and random bytes: a million."""
    rng, made = random.Random(seed), bytearray()
    while len(made) < FED:
        chunk = bytearray(rng.choice(good) if rng.random() < 0.7 else rng.randbytes(rng.randrange(120)))
        if chunk and rng.random() < 0.5:
            for _ in range(rng.randrange(1, 4)):
                chunk[rng.randrange(len(chunk))] = wrong(rng)
        made += chunk
    return bytes(made)


def fed(data: bytes, parse: Callable[[bytes], list[Hashable]], is_true: Callable[[Any], bool]) -> Figures:
    """Feed in pieces; what is accepted and not true was accepted wrongly."""
    accepted: list[Hashable] = []
    crashes = 0
    began_s = time.process_time()
    for at in range(0, len(data), PIECE):
        try:
            accepted += parse(data[at : at + PIECE])
        except Exception:
            crashes += 1
    cpu_s = time.process_time() - began_s
    return {
        "bytes": len(data),
        "MB_per_s": len(data) / cpu_s / 1e6,
        "accepted": len(accepted),
        "accepted_wrong": sum(not is_true(frame) for frame in accepted),
        "crashes": crashes,
    }


def one_of(good: list[bytes], parse: Callable[[bytes], list[Hashable]]) -> Callable[[Any], bool]:
    """Whether a frame is what one of the good lines says."""
    return {frame for line in good for frame in parse(line)}.__contains__


def any_byte(rng: random.Random) -> int:
    return rng.randrange(256)


def no_figure(rng: random.Random) -> int:
    """Of a protocol without a checksum nobody can tell another figure, sign or unit from the truth."""
    return rng.choice(b"\x00\x80\xff\r\n;#~")


def parsers() -> Iterator[tuple[str, Figures]]:
    for name in sorted(DIALECTS):
        yield f"parser: balance, {DIALECTS[name].name}", _balance_parser(name)
    yield "parser: hand controller's answers", _hand_parser()
    yield "parser: servos' answers", _status_parser()
    yield "parser: the bus twin", _instruction_parser()
    yield "parser: firmware", _firmware()


def _balance_parser(name: str) -> Figures:
    twin = balance_twin(name)(StillPan())
    ask = {"and": b"Q\r\n", "mt_sics": b"SI\r\n", "sbi": b"\x1bP\r\n", "shimadzu": b"D07\r\n"}[name]
    good = []
    for load_mg in (0.0, 12_345.6, 87_654.3):
        twin.pan = StillPan(load_mg)
        good += twin.hear(ask, 0.0)
    buffer = LineBuffer()

    def parse(data: bytes) -> list[Hashable]:
        frames = [DIALECTS[name].parse(line) for line in buffer.feed(data)]
        return [(frame.value, frame.unit) for frame in frames if isinstance(frame, Weight) and frame.unit]

    return fed(noise(good, no_figure), parse, one_of(good, parse))


def _hand_parser() -> Figures:
    good = [encode(n, f"ok open {n / 1000:.3f} 0.000 - 31") for n in range(50)]
    buffer = LineBuffer()

    def parse(data: bytes) -> list[Hashable]:
        return [report for line in buffer.feed(data) if (report := decode(line)) is not None]

    return fed(noise(good, any_byte), parse, one_of(good, parse))


class _Line:
    """A port of the SDK's whose bytes are at hand; a wait for more ends at once."""

    is_using = False

    def __init__(self) -> None:
        self.waiting = b""
        self._asked = 0

    def add(self, data: bytes) -> None:
        self.waiting += data
        self._asked = 0

    def readPort(self, length: int) -> bytes:  # noqa: N802 - the SDK's name
        self._asked += 1
        got, self.waiting = self.waiting[:length], self.waiting[length:]
        return got

    def isPacketTimeout(self) -> bool:  # noqa: N802
        return not self.waiting or self._asked > 1000


def _status_parser() -> Figures:
    rng = random.Random(8)
    good = [packet(servo, 0x55, b"\0" + rng.randbytes(size)) for servo in (2, 3, 9) for size in (0, 1, 4, 49)]
    line, packets = _Line(), _Packets()

    def parse(data: bytes) -> list[Hashable]:
        line.add(data)
        found: list[Hashable] = []
        while line.waiting:
            received, result = packets.rxPacket(line, False)
            if result == COMM_SUCCESS:
                found.append(tuple(received))
        return found

    data = noise(good, any_byte)
    # A packet is right if sending what it says makes the bytes that came.
    return fed(data, parse, lambda f: packet(f[4], f[7], bytes(f[8:-2])) in data)


def _instruction_parser() -> Figures:
    rng = random.Random(7)
    good = [packet(servo, code, rng.randbytes(8)) for servo in (2, 3, 99) for code in (1, 2, 3, 5, 8, 0x83, 0x92)]
    reader = PacketReader()

    def parse(data: bytes) -> list[Hashable]:
        return [(servo, code, parameters) for servo, code, parameters, intact in reader.feed(data) if intact]

    return fed(noise(good, any_byte), parse, one_of(good, parse))


def _firmware() -> Figures:
    """The controller under the address and undefined-behaviour sanitizers; it aborts on a broken invariant."""
    good = [
        encode(n, command)
        for n, command in enumerate(
            ("hello 2", "open 1.25", "step 1.05 0.2 1", "vibrate 0.7", "reset", "close", "ping")
        )
    ]
    data = encode(1, "hello 2") + noise(good, any_byte)
    with tempfile.TemporaryDirectory() as name:
        fuzz = str(Path(name) / "fuzz")
        sources = [*map(str, sorted((FIRMWARE / "hand_controller").glob("*.cpp"))), str(FIRMWARE / "host/fuzz.cpp")]
        sanitizers = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all")
        subprocess.run(["g++", "-std=c++11", "-O1", *sanitizers, "-o", fuzz, *sources], check=True)
        began_s = time.perf_counter()
        ended = subprocess.run([fuzz], input=data, capture_output=True, check=False)
        wall_s = time.perf_counter() - began_s
    crashes = int(ended.returncode != 0)
    return {"bytes": len(data), "MB_per_s": len(data) / wall_s / 1e6, "accepted": int(ended.stdout or 0)} | {
        "crashes": crashes
    }


# --- cables


class Cycles:
    """Counts what every cycle has to show, and how long it took to come back."""

    def __init__(self, seed: int) -> None:
        self.rng = random.Random(seed)
        self.lost = self.safe = self.back = 0
        self.back_s: list[float] = []

    def plugged_back(self, server: TwinServer[Any], is_back: Callable[[], object]) -> None:
        """Plug in, now and then pulling again in the middle of what the driver does first, until it is back."""
        for _ in range(self.rng.choice((0, 0, 1, 2))):
            server.plug()
            time.sleep(self.rng.uniform(0.0, 0.06))
            server.unplug()
        began_s = time.monotonic()
        server.plug()
        self.back += comes(is_back)
        self.back_s.append(time.monotonic() - began_s)

    def figures(self, cycles: int) -> Figures:
        return {
            "cycles": cycles,
            "lost_reported": self.lost,
            "ended_safe": self.safe,
            "came_back": self.back,
            "back_s_median": median(self.back_s),
            "back_s_max": max(self.back_s),
        }


def comes(condition: Callable[[], object], timeout_s: float = WAIT_S) -> bool:
    """Whether this comes true in time."""
    end_s = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > end_s:
            return False
        time.sleep(0.002)
    return True


def unplugs(cycles: int) -> Iterator[tuple[str, Figures]]:
    """Every device's cable, pulled in the middle of what the device does."""
    yield "unplugs: servo bus, arm swaying", _bus(cycles)
    yield "unplugs: hand, valve open", _hand(cycles)
    for name in sorted(DIALECTS):
        yield f"unplugs: balance, {DIALECTS[name].name}", _balance(name, PtyPort(), cycles)
    yield "unplugs: balance on a socket", _balance("and", SocketPort(), cycles)


def _bus(count: int) -> Figures:
    twin = DynamixelTwin(crane_x7(range(2, 9)))
    cycles, group = Cycles(1), AxisGroup(arm_axes(ArmSpec()))
    with TwinServer(twin, PtyPort()) as server:
        chain = ServoChain(DynamixelBus(server.url), [group], reopen_s=0.01)
        chain.open()
        for _ in range(count):
            start = group.positions_rad
            group.move(Swaying(start, np.clip(-start, -0.3, 0.3), 60.0))
            time.sleep(cycles.rng.uniform(0.0, 0.3))
            server.unplug()
            cycles.lost += comes(lambda: chain.lost is not None) and chain.lost.code == "device.lost"
            # The watchdogs have stopped the servos, which hold: torque is never dropped.
            cycles.safe += group.fault is chain.lost and comes(lambda: _holds(twin))
            cycles.plugged_back(server, lambda: chain.lost is None and not group.is_moving)
        chain.close()
    return cycles.figures(count)


class Swaying:
    """From where the arm is by `sway_rad` and back, again and again; something else than a stop ends it."""

    def __init__(self, start: np.ndarray[Any, Any], sway_rad: Any, duration_s: float) -> None:
        self.duration_s = duration_s
        self._start, self._sway_rad = start, sway_rad

    def sample(self, time_s: float) -> np.ndarray[Any, Any]:
        return self._start + self._sway_rad * np.sin(min(time_s, self.duration_s)) ** 2

    def stopped_from(self, at_s: float) -> "Swaying":
        return Swaying(self._start, self._sway_rad, at_s)


def _holds(twin: DynamixelTwin) -> bool:
    servos = twin.servos.values()
    return all(servo.has_torque and servo.get(98, 1, signed=True) == -1 and servo.velocity == 0.0 for servo in servos)


def _hand(count: int) -> Figures:
    valve, cycles = HandTwin(FIRMWARE), Cycles(2)
    with TwinServer(valve, PtyPort()) as server:
        controller = HandController(HandSpec(port=server.url), reopen_s=0.01)
        controller.open()
        for _ in range(count):
            if cycles.rng.random() < 0.5:
                controller.step(1.2, 5.0, 1.0)
            else:
                controller.set_opening(1.2)
                controller.set_vibration(1.0)
            comes(lambda: valve.vibration > 0.0)
            time.sleep(cycles.rng.uniform(0.0, 0.3))
            server.unplug()
            cycles.lost += comes(lambda: controller.trouble is not None) and controller.trouble.code == "device.lost"
            cycles.safe += comes(lambda: valve.opening_mm < 0.04 and valve.vibration == 0.0)
            cycles.plugged_back(server, lambda: _obeys(controller))
        controller.close()
    return cycles.figures(count)


def _obeys(controller: HandController) -> bool:
    """The dead-man's fault is cleared by a reset, which is asked for as often as a cable loses it."""
    report = controller.report
    if report is not None and report.faults and controller.is_done:
        controller.reset()
    return controller.trouble is None and controller.is_done and report is not None and not report.faults


@contextlib.contextmanager
def _weighing(name: str, server: TwinServer[Any], clock: WallClock) -> Generator[SerialBalance, None, None]:
    spec = BalanceSpec(driver=name, port=server.url, period_s=0.02, options={"bits": "8N1"})  # type: ignore[arg-type]
    balance = SerialBalance(spec, DIALECTS[name], clock, DIALECTS.values(), reopen_s=0.01)
    balance.open()
    try:
        yield balance
    finally:
        balance.close()


def _balance(name: str, port: PtyPort | SocketPort, count: int) -> Figures:
    pan, clock, cycles = StillPan(), WallClock(), Cycles(3)
    twin = balance_twin(name)(pan)
    twin.period_s = 0.02
    with TwinServer(twin, port) as server, _weighing(name, server, clock) as balance:
        for cycle in range(count):
            pan.load_mg = float(cycle)
            time.sleep(cycles.rng.uniform(0.0, 0.05))
            server.unplug()
            cycles.lost += _fails_as_lost(balance, clock)
            cycles.safe += comes(lambda: balance.latest is None)  # what it weighed before is no news of now
            pan.load_mg = wanted_mg = cycle + 0.5
            cycles.plugged_back(
                server, lambda mg=wanted_mg: (latest := balance.latest) is not None and latest.value_mg == mg
            )
    return cycles.figures(count)


def _fails_as_lost(balance: SerialBalance, clock: WallClock) -> bool:
    """Read until that fails: a line that came before the cable was pulled is still a reading."""
    while True:
        steps = balance.next_reading(WAIT_S)
        try:
            while True:
                clock.wait([next(steps)])
        except StopIteration:
            continue
        except SkillFailed as failed:
            return failed.code == "device.lost"
