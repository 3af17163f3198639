"""The hand's twin: the real firmware, compiled for this computer, with a valve and a motor that are computed.

The brain is `robot/firmware/host/brain.cpp`, built with the C++ compiler that is found (g++, clang++).
"""

import ctypes
import shutil
import subprocess
import tempfile
import threading
from functools import cache
from pathlib import Path

REPLY_SIZE = 96


class NoCompiler(Exception):  # noqa: N818 - it reads as the sentence it is raised in
    """The firmware cannot be built here."""


@cache
def build_brain(firmware: Path) -> ctypes.CDLL:
    """Compile the firmware as a library and load it; NoCompiler says why not."""
    compiler = shutil.which("g++") or shutil.which("clang++")
    if compiler is None:
        raise NoCompiler("the hand's twin runs the real firmware and needs a C++ compiler: install g++")
    sources = [*sorted((firmware / "hand_controller").glob("*.cpp")), firmware / "host" / "brain.cpp"]
    with tempfile.TemporaryDirectory(prefix="hand-") as folder:
        library = Path(folder) / "brain.so"
        command = [compiler, "-std=c++11", "-O1", "-shared", "-fPIC", "-o", str(library), *map(str, sources)]
        built = subprocess.run(command, capture_output=True, text=True, check=False)
        if built.returncode != 0:
            raise NoCompiler(built.stderr)
        brain = ctypes.CDLL(str(library))
    handle, byte, number = ctypes.c_void_p, ctypes.c_char, ctypes.c_int32
    brain.hand_new.restype = handle
    brain.hand_delete.argtypes = [handle]
    brain.hand_delete.restype = None
    brain.hand_sense.argtypes = [handle, number, number, ctypes.c_bool, ctypes.c_bool]
    brain.hand_sense.restype = None
    for name in ("hand_goal_um", "hand_vibration"):
        getattr(brain, name).argtypes = [handle]
        getattr(brain, name).restype = number
    brain.hand_tick.argtypes = [handle, ctypes.c_uint32]
    brain.hand_tick.restype = None
    brain.hand_feed.argtypes = [handle, byte, ctypes.c_uint32, ctypes.c_char_p]
    brain.hand_feed.restype = ctypes.c_size_t
    return brain


class HandTwin:
    """The controller's board: its firmware, the valve's servo and the vibration motor."""

    def __init__(
        self,
        firmware: Path,
        valve_speed_mm_per_s: float = 4.0,
        valve_dead_time_s: float = 0.06,
    ) -> None:
        self.opening_mm = 0.0
        self.can_open = self.can_close = True
        """Whether nothing is in the valve's way."""
        self.speed_ratio = 1.0
        """What its speed is of what it should be."""
        self.healthy = True
        self.emergency_stop = False
        self.temperature_c = 30
        self._brain = build_brain(firmware)
        self._awake = threading.Lock()
        """Held while the firmware runs: it is not taken away under itself."""
        self._self = self._brain.hand_new()
        self._speed_mm_per_s = valve_speed_mm_per_s
        self._dead_time_s = valve_dead_time_s
        self._goals: list[tuple[float, float]] = []
        """Goals that the valve has not begun to follow yet, and from when it will."""
        self._goal_mm = 0.0
        self._now_s: float | None = None

    def __del__(self) -> None:
        if hasattr(self, "_self"):
            self._brain.hand_delete(self._self)

    def reboot(self) -> None:
        """The board's reset button: the firmware begins anew, the valve stays where it is."""
        with self._awake:
            self._brain.hand_delete(self._self)
            self._self = self._brain.hand_new()

    @property
    def vibration(self) -> float:
        return int(self._brain.hand_vibration(self._self)) / 1000

    def hear(self, data: bytes, now_s: float) -> list[bytes]:
        """Let the valve move, and the firmware hear and act."""
        with self._awake:
            return self._hear(data, now_s)

    def _hear(self, data: bytes, now_s: float) -> list[bytes]:
        self._move_valve(now_s)
        self._brain.hand_sense(
            self._self, round(self.opening_mm * 1000), self.temperature_c, self.healthy, self.emergency_stop
        )
        now_ms = int(now_s * 1000) & 0xFFFFFFFF
        replies = []
        buffer = ctypes.create_string_buffer(REPLY_SIZE)
        for byte in data:
            if self._brain.hand_feed(self._self, bytes([byte]), now_ms, buffer):
                replies.append(buffer.value)
        self._brain.hand_tick(self._self, now_ms)
        self._take_goal(now_s)
        return replies

    def _take_goal(self, now_s: float) -> None:
        goal_mm = int(self._brain.hand_goal_um(self._self)) / 1000
        if goal_mm != (self._goals[-1][1] if self._goals else self._goal_mm):
            self._goals.append((now_s + self._dead_time_s, goal_mm))

    def _move_valve(self, now_s: float) -> None:
        dt_s = 0.0 if self._now_s is None else now_s - self._now_s
        self._now_s = now_s
        while self._goals and self._goals[0][0] <= now_s:
            self._goal_mm = self._goals.pop(0)[1]
        if self.healthy:
            most_mm = self._speed_mm_per_s * self.speed_ratio * dt_s
            way_mm = max(-most_mm, min(most_mm, self._goal_mm - self.opening_mm))
            if self.can_open if way_mm > 0.0 else self.can_close:
                self.opening_mm += way_mm
