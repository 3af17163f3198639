"""A serial line read by a thread of its own, which comes back by itself after it was unplugged.

The balances and the hand controller speak in lines; this is the part they share. A port is anything
`serial.serial_for_url` opens: `/dev/ttyUSB0`, `socket://127.0.0.1:4001`, …
"""

import contextlib
import re
import termios
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import serial

from scuhand_bt.failures import Code, SkillFailed

READ_SLICE_S = 0.01
"""How long a read may block; `LineUser.idle` is called about this often."""
REOPEN_S = 0.25
"""Between two attempts to open a port that has gone."""
LINE_LIMIT = 256
"""No device here sends a line longer than this: what does not end is noise."""

SPOILT = b"\0"
"""Stands where a byte failed the check of its parity or its stop bit. No device here sends it, and no line has it."""

PORT_ERRORS = (OSError, termios.error)
"""What pyserial raises when a port has gone: SerialException is an OSError, termios.error is not."""


@dataclass(frozen=True, slots=True)
class Framing:
    """Speed and bits of a serial line; ignored by `socket://`."""

    baud: int
    bits: str
    """Data bits, parity, stop bits: "8N1", "7E2"."""

    def open(self, url: str) -> "serial.SerialBase":
        """Open a port; raises OSError, termios.error or ValueError."""
        # The timeout is never changed after this: on a pseudo-terminal a second tcsetattr with
        # parity or seven bits fails with EINVAL (seen with glibc 2.36).
        return serial.serial_for_url(
            url,
            baudrate=self.baud,
            bytesize=int(self.bits[0]),
            parity=self.bits[1],
            stopbits=int(self.bits[2]),
            timeout=READ_SLICE_S,
            write_timeout=1.0,
            exclusive=True,
        )


def mark_errors(port: "serial.SerialBase") -> bool:
    """Have the system check parity, and mark the bytes that fail; False where it has no say (`socket://`).

    pyserial sets a parity and switches its check off. Raises OSError if the port does not take it.
    """
    fd = getattr(port, "fd", None)
    if fd is None:
        return False
    flags = termios.INPCK | termios.PARMRK
    settings = termios.tcgetattr(fd)
    settings[0] = settings[0] & ~(termios.IGNPAR | termios.ISTRIP) | flags
    with contextlib.suppress(termios.error):  # of a pseudo-terminal without these bits: the flags are set all the same
        termios.tcsetattr(fd, termios.TCSANOW, settings)
    if termios.tcgetattr(fd)[0] & flags != flags:
        raise OSError("the port does not check parity")
    return True


class ErrorMarks:
    """Takes the marks of PARMRK out of a stream of bytes (termios(3)): FF 00 X becomes `SPOILT`, FF FF becomes FF."""

    _MARK = re.compile(rb"\xff(?:(\xff)|(\x00.)|\x00?\Z)", re.DOTALL)

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> bytes:
        """The bytes as they were sent, as far as that is known yet."""
        data, self._rest = self._rest + data, b""
        return self._MARK.sub(self._meant, data)

    def _meant(self, mark: re.Match[bytes]) -> bytes:
        if mark[1] is None and mark[2] is None:
            self._rest = mark[0]  # what it is, is still to come
            return b""
        return mark[1] or SPOILT


class LineBuffer:
    """Cuts a stream of bytes into lines that keep their terminator; drops what is no line."""

    def __init__(self, limit: int = LINE_LIMIT) -> None:
        self._limit = limit
        self._rest = b""

    def feed(self, data: bytes) -> list[bytes]:
        """The lines that `data` completes."""
        *lines, rest = (self._rest + data).split(b"\n")
        # An unending line is cut so that its tail cannot pass for a line: it keeps more than the limit.
        self._rest = rest if len(rest) <= self._limit else rest[-self._limit - 1 :]
        return [line + b"\n" for line in lines if len(line) < self._limit]


class LineUser(Protocol):
    """Who a link serves; all of it is called from the link's thread."""

    def opened(self) -> None:
        """The port is open (again), and nothing was read yet."""
        ...

    def line(self, raw: bytes) -> None:
        """One whole line, with its terminator."""
        ...

    def idle(self) -> None:
        """Called every few milliseconds: the place to speak, and to notice silence."""
        ...

    def lost(self, why: str) -> None:
        """The port has gone; the link goes on trying to open it."""
        ...


class SerialLink:
    """Opens a port, reads it on a thread, and opens it again whenever it comes back."""

    def __init__(self, url: str, framing: Framing, user: LineUser, reopen_s: float = REOPEN_S) -> None:
        self.url = url
        self._framing = framing
        self._user = user
        self._reopen_s = reopen_s
        self._port: serial.SerialBase | None = None
        self._lines = LineBuffer()
        self._marks: ErrorMarks | None = None
        self._writing = threading.Lock()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"link {url}", daemon=True)

    def start(self) -> None:
        """Open the port and begin; SkillFailed device.lost if it cannot be opened now."""
        try:
            self._adopt(self._framing.open(self.url))
        except (*PORT_ERRORS, ValueError) as error:
            raise SkillFailed(Code.DEVICE_LOST, why_not_open(self.url, error)) from error
        self._thread.start()

    def close(self) -> None:
        """End the thread and close the port; returns when both have happened."""
        self._closing.set()
        if self._thread.is_alive():
            self._thread.join()
        self._drop()

    def write(self, data: bytes) -> bool:
        """Send bytes, from any thread; False if there is no port to send them to."""
        with self._writing:
            if self._port is None:
                return False
            try:
                self._port.write(data)
            except PORT_ERRORS:
                return False  # the reading thread meets the same error and deals with it
        return True

    def discard_input(self) -> None:
        """Throw away what has come in and was not read yet, or not to its line's end. On the link's thread."""
        self._lines = LineBuffer()
        with contextlib.suppress(*PORT_ERRORS):
            if self._port is not None:
                self._port.reset_input_buffer()

    def _adopt(self, port: "serial.SerialBase") -> None:
        try:
            self._marks = ErrorMarks() if mark_errors(port) else None
        except PORT_ERRORS:
            port.close()
            raise
        self._port = port
        self.discard_input()  # bytes from before: readings of another time

    def _drop(self) -> None:
        with self._writing:
            port, self._port = self._port, None
        network_socket = getattr(port, "_socket", None)
        if port is not None:
            with contextlib.suppress(*PORT_ERRORS):
                port.close()
            # pyserial's socket:// forgets to close its socket when the other side has gone.
            if network_socket is not None:
                network_socket.close()

    def _run(self) -> None:
        try:
            self._serve()
        except Exception as error:
            self._user.lost(f"the thread of {self.url} has failed: {error!r}")
            raise

    def _serve(self) -> None:
        while not self._closing.is_set():
            if self._port is None:
                try:
                    self._adopt(self._framing.open(self.url))
                except (*PORT_ERRORS, ValueError):
                    self._user.idle()
                    self._closing.wait(self._reopen_s)
                    continue
            self._user.opened()
            try:
                self._read_lines(self._port)
            except PORT_ERRORS as error:
                self._drop()
                self._user.lost(f"{self.url} has gone ({error}); check its cable and supply")

    def _read_lines(self, port: "serial.SerialBase | None") -> None:
        assert port is not None
        while not self._closing.is_set():
            data = port.read(1)  # wakes with the first byte, so that arrival times are true
            if data:
                data += port.read(port.in_waiting)
            if self._marks is not None:
                data = self._marks.feed(data)
            for line in self._lines.feed(data):
                self._user.line(line)
            self._user.idle()


def why_not_open(url: str, error: Exception) -> str:
    """A port that cannot be opened, in the user's words."""
    where = url or "no port"
    return f"cannot open {where}: {error}; check the cable, the `port` in robot/cell.yaml and who may use it"


class Silence:
    """Measures how long nothing has been heard, on the machine's own clock."""

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._now = now
        self._last = now()

    def broken(self) -> None:
        self._last = self._now()

    @property
    def seconds(self) -> float:
        return self._now() - self._last
