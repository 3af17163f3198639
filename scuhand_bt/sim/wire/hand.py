"""The hand's twin: the real firmware, compiled for this computer, with a simulated valve servo and motor.

The library is `robot/firmware/host/brain.cpp`, built with the C++ compiler that is installed (g++, clang++).
"""

import ctypes
import shutil
import subprocess
import tempfile
import threading
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import TypeAlias

import numpy as np

from scuhand_bt.device_specs.hand import HandOptions, ValvePoint
from scuhand_bt.devices.interfaces import TWIN
from scuhand_bt.sim.wire.dynamixel import BITS_PER_BYTE, DynamixelTwin
from scuhand_bt.sim.wire.servo import XC330, Servo

REPLY_SIZE = 96
BAUD_RATES = {0: 9_600, 1: 57_600, 2: 115_200, 3: 1_000_000, 4: 2_000_000, 5: 3_000_000, 6: 4_000_000}
"""By the value of a servo's register 8 (ROBOTIS e-manual)."""
BAUD_OF_VALVE = 3
BOOT_S = 1.0
"""A Mega's bootloader waits this long for a new program before it starts the present one."""
ANSWER_WITHIN_S = 0.002
"""A little more than the longest return delay: the firmware does not wait in simulated time."""
NOMINAL_MAP = HandOptions().valve_map

Bytes: TypeAlias = "ctypes._Pointer[ctypes.c_uint8]"
Exchange = ctypes.CFUNCTYPE(
    ctypes.c_size_t, ctypes.c_uint32, ctypes.POINTER(ctypes.c_uint8), ctypes.c_size_t, ctypes.POINTER(ctypes.c_uint8)
)
"""Sends a packet to the valve's servo at a baud rate; writes the answer, and returns its length."""


class NoCompiler(Exception):  # noqa: N818 - it reads as the sentence it is raised in
    """The firmware cannot be built here."""


def compiler() -> str:
    """The path of the installed compiler. Raises NoCompiler."""
    if (found := shutil.which("g++") or shutil.which("clang++")) is None:
        raise NoCompiler("the hand's twin runs the real firmware and needs a C++ compiler: install g++")
    return found


@cache
def build_brain(firmware: Path) -> ctypes.CDLL:
    """Compile the firmware as a library and load it. Raises NoCompiler with the reason."""
    sources = [*sorted((firmware / "hand_controller").glob("*.cpp")), firmware / "host" / "brain.cpp"]
    with tempfile.TemporaryDirectory(prefix="hand-") as folder:
        library = Path(folder) / "brain.so"
        says = f'-DHAND_FIRMWARE="{TWIN}-2.0"'
        command = [compiler(), "-std=c++11", "-O1", "-shared", "-fPIC", says, "-o", str(library), *map(str, sources)]
        built = subprocess.run(command, capture_output=True, text=True, check=False)
        if built.returncode != 0:
            raise NoCompiler(built.stderr)
        brain = ctypes.CDLL(str(library))
    handle, byte = ctypes.c_void_p, ctypes.c_char
    brain.hand_new.argtypes = [Exchange]
    brain.hand_new.restype = handle
    for name in ("hand_delete", "hand_reset"):
        getattr(brain, name).argtypes = [handle]
        getattr(brain, name).restype = None
    brain.hand_press.argtypes = [handle, ctypes.c_bool]
    brain.hand_press.restype = None
    brain.hand_vibration.argtypes = [handle]
    brain.hand_vibration.restype = ctypes.c_int32
    brain.hand_tick.argtypes = [handle, ctypes.c_uint32]
    brain.hand_tick.restype = None
    brain.hand_feed.argtypes = [handle, byte, ctypes.c_uint32, ctypes.c_char_p]
    brain.hand_feed.restype = ctypes.c_size_t
    return brain


class Valve:
    """The valve's servo on its line, and the real opening of the outlet at each of its positions."""

    def __init__(self, dead_time_s: float = 0.06, true_map: Sequence[ValvePoint] = NOMINAL_MAP) -> None:
        points = sorted((point.count, point.opening_mm) for point in true_map)
        self._counts, self._openings_mm = zip(*points, strict=True)
        self._rises = true_map[1].count > true_map[0].count
        self._shut_count = float(true_map[0].count)
        self.servo = Servo(1, XC330, self._shut_count, dead_time_s=dead_time_s)
        self.servo.put(8, 1, BAUD_OF_VALVE)
        self.line = DynamixelTwin([self.servo])

    @property
    def opening_mm(self) -> float:
        return float(np.interp(self.servo.position, self._counts, self._openings_mm))

    def shut(self) -> None:
        """Shut at once, as an unobserved controller has left it."""
        self.servo.position = self._shut_count
        self.servo.stand()

    def lets(self, *, open: bool | None = None, close: bool | None = None) -> None:
        """Set whether the valve can open and can close; None leaves that unchanged."""
        up, down = (open, close) if self._rises else (close, open)
        self.servo.can_rise = self.servo.can_rise if up is None else up
        self.servo.can_fall = self.servo.can_fall if down is None else down

    def say(self, baud: int, data: bytes, now_s: float) -> bytes:
        """Send data to the servo; returns its answer by now, nothing if it listens at another baud rate."""
        is_understood = BAUD_RATES[self.servo.table[8]] == baud
        return b"".join(self.line.hear(data if is_understood else b"", now_s))


class HandTwin:
    """The controller's board: its firmware, the valve's servo and the vibration motor."""

    def __init__(
        self, firmware: Path, valve_dead_time_s: float = 0.06, true_map: Sequence[ValvePoint] = NOMINAL_MAP
    ) -> None:
        self.valve = Valve(valve_dead_time_s, true_map)
        self.emergency_stop = False
        self.is_powered = True
        """Whether the board has power. Without it the firmware stands still; the valve follows its last command."""
        self._begins_s = float("-inf")
        self._brain = build_brain(firmware)
        self._awake = threading.Lock()
        """Held while the firmware runs, so that it is not reset meanwhile."""
        self._exchange = Exchange(self._ask_servo)  # keeps the callback alive as long as the library may call it
        self._self = self._brain.hand_new(self._exchange)
        self._now_s = 0.0

    def __del__(self) -> None:
        if hasattr(self, "_self"):
            self._brain.hand_delete(self._self)

    def reboot(self) -> None:
        """The board's reset button: the firmware restarts, the valve stays where it is."""
        with self._awake:
            self._brain.hand_reset(self._self)

    def switch_on(self, now_s: float) -> None:
        """The board has power again, and boots."""
        self.reboot()
        self._begins_s, self.is_powered = now_s + BOOT_S, True

    @property
    def opening_mm(self) -> float:
        """The real opening of the outlet."""
        return self.valve.opening_mm

    @property
    def vibration(self) -> float:
        return int(self._brain.hand_vibration(self._self)) / 1000 if self.is_powered else 0.0

    @property
    def healthy(self) -> bool:
        """Whether the valve's servo is connected."""
        return self.valve.servo.id not in self.valve.line.missing

    @healthy.setter
    def healthy(self, is_connected: bool) -> None:
        self.valve.line.missing = set() if is_connected else {self.valve.servo.id}

    def hear(self, data: bytes, now_s: float) -> list[bytes]:
        """Let the valve move, and the firmware receive and act."""
        with self._awake:
            self._now_s = now_s
            self.valve.servo.step(now_s)
            if not self.is_powered or now_s < self._begins_s:
                return []
            self._brain.hand_press(self._self, self.emergency_stop)
            now_ms = int(now_s * 1000) & 0xFFFFFFFF
            self._brain.hand_tick(self._self, now_ms)
            buffer = ctypes.create_string_buffer(REPLY_SIZE)
            replies = []
            for byte in data:
                if self._brain.hand_feed(self._self, bytes([byte]), now_ms, buffer):
                    replies.append(buffer.value)
            return replies

    def _ask_servo(self, baud: int, packet: Bytes, length: int, answer: Bytes) -> int:
        answered = self.valve.say(baud, bytes(packet[:length]), self._now_s)
        line_s = REPLY_SIZE * BITS_PER_BYTE / baud
        answered += self.valve.say(baud, b"", self._now_s + ANSWER_WITHIN_S + line_s)
        ctypes.memmove(answer, answered, len(answered))
        return len(answered)
