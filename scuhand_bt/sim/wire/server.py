"""Runs a twin in real time at a port, with the communication faults that a test sets."""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from types import TracebackType
from typing import Generic, Protocol, TypeVar

from scuhand_bt.sim.wire.port import Port

TICK_S = 0.002
FLIP_STRIDE = 37
"""From one flipped bit to the next: a prime, so that in the end every bit of a line is hit."""


class Twin(Protocol):
    """A device as seen from its cable."""

    def hear(self, data: bytes, now_s: float) -> list[bytes]:
        """Take the data that came in (perhaps none); returns the messages to be sent now."""
        ...


TwinT = TypeVar("TwinT", bound=Twin)


@dataclass
class Misbehaviour:
    """Faults of the next messages of a twin. Each count falls to zero as it is used up."""

    drop: int = 0
    garble: int = 0
    """Messages in which one bit is flipped."""
    flip_every: int = 0
    """One of so many messages has a bit flipped, another bit each time; none if 0."""
    duplicate: int = 0
    delay: int = 0
    """Messages that are sent `delay_s` late."""
    delay_s: float = 0.1
    split: int = 0
    """Messages whose second half comes `delay_s` after the first."""
    noise: bytes = b""
    """Sent once, before the next message."""
    _sent: int = field(default=0, init=False)

    def disturb(self, message: bytes, now_s: float) -> list[tuple[float, bytes]]:
        """What is sent in place of a message, and when."""
        if self._takes("drop"):
            return []
        if self._takes("garble"):
            message = message[:-3] + bytes([message[-3] ^ 0x10]) + message[-2:]
        self._sent += 1
        if self.flip_every and self._sent % self.flip_every == 0:
            place, bit = divmod(self._sent // self.flip_every * FLIP_STRIDE % (8 * len(message)), 8)
            message = message[:place] + bytes([message[place] ^ 1 << bit]) + message[place + 1 :]
        noise, self.noise = self.noise, b""
        message = noise + message
        if self._takes("duplicate"):
            message = message + message
        if self._takes("delay"):
            return [(now_s + self.delay_s, message)]
        if self._takes("split"):
            middle = len(message) // 2
            return [(now_s, message[:middle]), (now_s + self.delay_s, message[middle:])]
        return [(now_s, message)]

    def _takes(self, what: str) -> bool:
        left: int = getattr(self, what)
        setattr(self, what, max(0, left - 1))
        return left > 0


class TwinServer(Generic[TwinT]):
    """A twin at a port, on a thread of its own; a context manager."""

    def __init__(self, twin: TwinT, port: Port, now: Callable[[], float] = time.monotonic) -> None:
        self.twin = twin
        self.port = port
        self.misbehaviour = Misbehaviour()
        self.paused = False
        """True while the twin neither receives nor sends (hung, or without power)."""
        self._now = now
        self._due: list[tuple[float, bytes]] = []
        self._plugging = threading.Lock()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"twin {port.url}", daemon=True)

    def __enter__(self) -> "TwinServer[TwinT]":
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._closing.set()
        self._thread.join()
        self.port.close()

    @property
    def url(self) -> str:
        return self.port.url

    def unplug(self) -> None:
        """Pull the cable; the twin itself goes on."""
        with self._plugging:
            self.port.unplug()

    def plug(self) -> None:
        """Put the cable back."""
        with self._plugging:
            self.port.plug()

    def say(self, message: bytes) -> None:
        """Send a message that the twin would not send by itself."""
        with self._plugging:
            self.port.write(message)

    def _run(self) -> None:
        while not self._closing.is_set():
            with self._plugging:
                self._go_on()
            time.sleep(0.0002)  # releases the lock long enough for other threads to take it

    def _go_on(self) -> None:
        data = self.port.read(TICK_S)
        if self.paused:
            return
        now_s = self._now()
        for message in self.twin.hear(data, now_s):
            self._due += self.misbehaviour.disturb(message, now_s)
        self._send_due(now_s)

    def _send_due(self, now_s: float) -> None:
        for message in [message for due_s, message in self._due if due_s <= now_s]:
            self.port.write(message)
        self._due = [(due_s, message) for due_s, message in self._due if due_s > now_s]
