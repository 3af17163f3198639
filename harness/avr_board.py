"""The firmware's binary for the reference board, an Arduino Mega 2560, run in simavr against the valve's twin.

It has the same seam as `HandTwin`, so that a test may be run on both. A second of its time takes some 0.05 s of the
processor's, as the chip sleeps for most of it. Debian's packages: gcc-avr, avr-libc, arduino-core-avr, libsimavr-dev.
"""

import ctypes
import os
import shutil
import subprocess
from collections.abc import Sequence
from functools import cache
from pathlib import Path

from scuhand_bt.device_specs.hand import ValvePoint
from scuhand_bt.sim.wire.hand import NOMINAL_MAP, Valve

HOST, SERVO = 0, 1
CYCLES_PER_S = 16_000_000
SLICE_S, QUIET_SLICE_S = 500e-6, 10e-3
"""Between two looks at the servo: while it may have an answer, its return delay, and while nobody has asked it."""
HOST_BAUD = 115_200
STOP_PIN = (b"H", 4)
"""Pin 7 of a Mega."""
UCSR1A, UBRR1L, UBRR1H, TCCR2A, OCR2B = 0xC8, 0xCC, 0xCD, 0xB0, 0xB4
"""The servo's baud rate, and the PWM of pin 9 (ATmega2560, register summary)."""
MOTOR_PIN = (b"H", 6)
CORE = Path("/usr/share/arduino/hardware/arduino/avr")


def missing_tools() -> str:
    """What is not here to build the firmware and run it, as a test's reason to be skipped; "" if all is there."""
    missing = []
    if shutil.which("avr-g++") is None or not Path("/usr/lib/avr/include").exists():
        missing.append("gcc-avr and avr-libc")
    if not CORE.exists():
        missing.append("arduino-core-avr")
    if not Path("/usr/include/simavr/sim_avr.h").exists():
        missing.append("libsimavr-dev")
    return f"Debian's {', '.join(missing)} are not installed" if missing else ""


def build_firmware(firmware: Path, out: Path) -> None:
    """Compile the sketch for every board with the real Arduino core: `out`/mega.elf, `out`/leonardo.elf."""
    command = ["make", "--silent", "-C", str(firmware), f"OUT={out}"]
    built = subprocess.run(command, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stdout + built.stderr


def build_simulator(out: Path) -> Path:
    """Compile the board around simavr as a library."""
    library = out / "board.so"
    source = Path(__file__).with_suffix(".c")
    subprocess.run(["gcc", "-O2", "-shared", "-fPIC", "-o", str(library), str(source), "-lsimavr"], check=True)
    return library


@cache
def _load(library: Path) -> ctypes.CDLL:
    board = ctypes.CDLL(str(library))
    handle, data, size = ctypes.c_void_p, ctypes.c_char_p, ctypes.c_size_t
    for name, result, *arguments in (
        ("new", handle, data, data),
        ("free", None, handle),
        ("run", ctypes.c_uint32, handle, ctypes.c_uint32),
        ("feed", None, handle, ctypes.c_int, data, size, ctypes.c_uint32),
        ("sent", size, handle, ctypes.c_int, data),
        ("set_pin", None, handle, ctypes.c_char, ctypes.c_int, ctypes.c_int),
        ("pin", ctypes.c_int, handle, ctypes.c_char, ctypes.c_int),
        ("against_the_switch", ctypes.c_ulong, handle),
        ("memory", ctypes.c_uint8, handle, ctypes.c_uint16),
        ("poke", None, handle, ctypes.c_uint16, ctypes.c_uint8),
        ("jump", None, handle, ctypes.c_uint32),
        ("reset", None, handle),
    ):
        function = getattr(board, f"board_{name}")
        function.restype, function.argtypes = result, arguments
    return board


class AvrHand:
    """A Mega with the firmware, its valve and its motor; see `HandTwin`."""

    def __init__(self, elf: Path, simulator: Path, true_map: Sequence[ValvePoint] = NOMINAL_MAP) -> None:
        self.valve = Valve(true_map=true_map)
        self.valve.line.takes_time = False  # it is fed to the chip as slowly as it comes
        self._board = _load(simulator)
        self._self = self._board.board_new(os.fsencode(elf), b"atmega2560")
        assert self._self, f"simavr cannot run {elf}"
        self._symbols = _symbols(elf)
        self._now_s: float | None = None
        self._buffer = ctypes.create_string_buffer(4096)
        self._line = b""
        self._is_asked = False
        self.emergency_stop = False

    def __del__(self) -> None:
        if getattr(self, "_self", None):
            self._board.board_free(self._self)

    @property
    def emergency_stop(self) -> bool:
        return self._pressed

    @emergency_stop.setter
    def emergency_stop(self, is_pressed: bool) -> None:
        self._pressed = is_pressed
        self._board.board_set_pin(self._self, *STOP_PIN, int(is_pressed))

    @property
    def opening_mm(self) -> float:
        return self.valve.opening_mm

    @property
    def vibration(self) -> float:
        """The motor's duty, by the timer's registers, or by the pin where the timer does not drive it."""
        if self._memory(TCCR2A) & 0x20:
            return self._memory(OCR2B) / 255
        return float(self._board.board_pin(self._self, *MOTOR_PIN))

    @property
    def servo_baud(self) -> int:
        """What the board has set its second port to."""
        divisor = (self._memory(UBRR1H) << 8) + self._memory(UBRR1L) + 1
        rate = CYCLES_PER_S / divisor / (8 if self._memory(UCSR1A) & 2 else 16)
        return min((9_600, 57_600, 115_200, 1_000_000), key=lambda baud: abs(baud - rate))

    @property
    def bytes_against_the_switch(self) -> int:
        """Bytes that the line's direction pin would not have let through."""
        return int(self._board.board_against_the_switch(self._self))

    def reboot(self) -> None:
        """The board's reset button."""
        self._board.board_reset(self._self)

    def hang(self) -> None:
        """The firmware runs into an endless loop, with interrupts off."""
        self._board.board_jump(self._self, self._symbols["__stop_program"])

    def set_millis(self, value: int) -> None:
        """Set the core's counter, which wraps around at 2**32; let the board go round once before it is told more."""
        address = self._symbols["timer0_millis"] & 0xFFFF
        for place, byte in enumerate((value % 2**32).to_bytes(4, "little")):
            self._board.board_poke(self._self, address + place, byte)

    def hear(self, data: bytes, now_s: float) -> list[bytes]:
        """Go on until `now_s`; the lines that the board has sent meanwhile."""
        self._board.board_feed(self._self, HOST, data, len(data), CYCLES_PER_S * 10 // HOST_BAUD)
        self._now_s = now_s if self._now_s is None else self._now_s
        while self._now_s < now_s:
            self._go_on(min(SLICE_S if self._is_asked else QUIET_SLICE_S, now_s - self._now_s))
        *lines, self._line = (self._line + self._sent(HOST)).split(b"\n")
        return [line + b"\n" for line in lines]

    def _go_on(self, most_s: float) -> None:
        took = self._board.board_run(self._self, max(1, round(most_s * CYCLES_PER_S)))
        assert took, "the chip has stopped"
        self._now_s += took / CYCLES_PER_S
        baud = self.servo_baud
        asked = self._sent(SERVO)
        answer = self.valve.say(baud, asked, self._now_s)
        self._is_asked = bool(asked) or (self._is_asked and not answer)
        if answer:
            self._board.board_feed(self._self, SERVO, answer, len(answer), CYCLES_PER_S * 10 // baud)

    def _sent(self, port: int) -> bytes:
        length = self._board.board_sent(self._self, port, self._buffer)
        return self._buffer.raw[:length]

    def _memory(self, address: int) -> int:
        return int(self._board.board_memory(self._self, address))


@cache
def _symbols(elf: Path) -> dict[str, int]:
    listing = subprocess.run(["avr-nm", str(elf)], capture_output=True, text=True, check=True).stdout
    return {line.split()[-1]: int(line.split()[0], 16) for line in listing.splitlines() if line[0] != " "}
