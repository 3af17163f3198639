"""The base class of twins that speak in lines; a subclass provides the answers."""

from abc import ABC, abstractmethod
from typing import Any

from scuhand_bt.sim.wire.scene import Scene


class LineTwin(ABC):
    """A device that takes commands in lines, and may send lines by itself."""

    def __init__(self, options: Any, scene: Scene) -> None:
        self.options = options
        self.scene = scene
        self._typed = b""

    def hear(self, data: bytes, now_s: float) -> list[bytes]:
        """Answer commands, and send what is due: whole lines."""
        *commands, rest = (self._typed + data).replace(b"\r\n", b"\n").replace(b"\r", b"\n").split(b"\n")
        self._typed = rest[-64:]
        said = [self.answer(command, now_s) for command in commands]
        return [line for line in (*said, self.unasked(now_s)) if line]

    @abstractmethod
    def answer(self, command: bytes, now_s: float) -> bytes:
        """The answer to a command (given without its terminator); b"" for none."""

    def unasked(self, now_s: float) -> bytes:
        """What it sends now by itself."""
        return b""
