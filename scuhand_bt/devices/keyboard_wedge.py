"""A barcode scanner that types: Linux' input events of a keyboard of its own. docs/protocols/keyboard_wedge.md.

The keyboard is grabbed, so that a code never lands in a terminal, where a question may wait for an answer.
"""

import contextlib
import fcntl
import os
import select
import stat
import struct
import threading
from collections.abc import Iterator
from typing import ClassVar, Self

from scuhand_bt.devices.interfaces import Site
from scuhand_bt.devices.readers import Reader
from scuhand_bt.devices.serial_link import REOPEN_S
from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.specs import Spec

EVENT = struct.Struct("llHHi")
"""struct input_event of linux/input.h: seconds, microseconds, type, code, value."""
EVIOCGRAB = 0x40044590
INPUT_MAJOR = 13
EV_SYN, EV_KEY, SYN_DROPPED = 0, 1, 3
PRESSED, REPEATED = 1, 2
SHIFTS = (42, 54)
ENDS = (28, 96, 15)
"""Enter, Enter of the number pad, Tab."""
LONGEST = 512
"""Characters of the longest code: what does not end is none."""
_ROWS = (
    (2, "1234567890-=", "!@#$%^&*()_+"),
    (16, "qwertyuiop[]", "QWERTYUIOP{}"),
    (30, "asdfghjkl;'`", 'ASDFGHJKL:"~'),
    (43, "\\zxcvbnm,./", "|ZXCVBNM<>?"),
    (57, " ", " "),
)
KEYS = {first + i: (plain[i], shifted[i]) for first, plain, shifted in _ROWS for i in range(len(plain))}
"""Of the US layout, in which scanners leave the factory: a key's character, and with shift."""


class Typed:
    """Codes out of a stream of input events, cut anywhere."""

    def __init__(self) -> None:
        self._rest = b""
        self._text = ""
        self._is_sound = True
        self._shifts: set[int] = set()

    def feed(self, data: bytes) -> Iterator[str]:
        """The codes that `data` ends; one of which keys were lost, or that has none of ours, is dropped."""
        data = self._rest + data
        whole = len(data) - len(data) % EVENT.size
        self._rest = data[whole:]
        for _, _, kind, code, value in EVENT.iter_unpack(data[:whole]):
            if kind == EV_SYN and code == SYN_DROPPED:
                self._is_sound = False
                self._shifts.clear()
            elif kind == EV_KEY:
                yield from self._key(code, value)

    def _key(self, code: int, value: int) -> Iterator[str]:
        if code in SHIFTS:
            (self._shifts.add if value else self._shifts.discard)(code)
        elif value not in (PRESSED, REPEATED):
            return
        elif code in ENDS:
            text, is_sound = self._text, self._is_sound
            self._text, self._is_sound = "", True
            if text and is_sound:
                yield text
        elif code in KEYS and len(self._text) < LONGEST:
            self._text += KEYS[code][bool(self._shifts)]
        else:
            self._is_sound = False


class NoOptions(Spec):
    """Nothing can be set."""


class KeyboardWedge(Reader[str]):
    """`driver: keyboard_wedge`: the scanner whose `port` is `/dev/input/by-id/…-event-kbd`."""

    Options: ClassVar = NoOptions
    twin: ClassVar = "scuhand_bt.sim.wire.keyboard_wedge:KeyboardWedgeTwin"
    nothing = Code.CONTAINER_MISSING

    @classmethod
    def connect(cls, site: Site) -> Self:
        """The scanner, grabbed; SkillFailed device.lost."""
        scanner = cls(site)
        try:
            scanner._fd = scanner._opened()
        except OSError as error:
            what = f"cannot open {site.spec.port}: {error}; check its cable, and who may use it (group `input`)"
            raise SkillFailed(Code.DEVICE_LOST, what) from error
        scanner._thread.start()
        return scanner

    def __init__(self, site: Site) -> None:
        super().__init__(site.clock, f"the scanner on {site.spec.port}")
        self._port = site.spec.port
        self._fd: int | None = None
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"scanner {self._port}", daemon=True)

    def close(self) -> None:
        """End the thread, and let go of the keyboard."""
        self._closing.set()
        self._thread.join()

    def _opened(self) -> int:
        fd = os.open(self._port, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY)
        try:
            if os.major(os.fstat(fd).st_rdev) == INPUT_MAJOR:
                fcntl.ioctl(fd, EVIOCGRAB, 1)
            elif not stat.S_ISCHR(os.fstat(fd).st_mode):
                raise OSError("it is no device")
        except OSError:
            os.close(fd)
            raise
        return fd

    def _run(self) -> None:
        typed = Typed()
        while not self._closing.is_set():
            if self._fd is None:
                with contextlib.suppress(OSError):
                    self._fd, typed = self._opened(), Typed()
                    self.found()
                    continue
                self._closing.wait(REOPEN_S)
                continue
            try:
                if select.select([self._fd], [], [], 0.1)[0]:
                    if not (data := os.read(self._fd, 64 * EVENT.size)):
                        raise OSError("it has gone")
                    for code in typed.feed(data):
                        self.took(code, data)
            except OSError as error:
                os.close(self._fd)
                self._fd = None
                self.lost(f"{error}; check its cable")
        if self._fd is not None:
            os.close(self._fd)
