"""A scanner that sends each code as a line, unasked."""

from typing import Any

from scuhand_bt.devices.line_device import LineReader
from scuhand_bt.devices.serial_link import Framing
from scuhand_bt.failures import Code
from scuhand_bt.sim.wire.line_twin import LineTwin
from scuhand_bt.sim.wire.scene import Scene


class Template(LineReader[str]):
    """A code is what stands between two line ends, of letters that a label can hold."""

    twin = f"{__name__}:TemplateTwin"
    framing = Framing(9600, "8N1")
    nothing = Code.CONTAINER_MISSING

    def parse(self, line: bytes) -> str | None:
        code = line.rstrip(b"\r\n")
        return code.decode() if code and all(32 <= letter < 127 for letter in code) else None


class TemplateTwin(LineTwin):
    """Reads the code before it again and again, as it is set to; never make it by the driver's own expressions."""

    def __init__(self, options: Any, scene: Scene) -> None:
        super().__init__(options, scene)
        self._next_s = 0.0

    def answer(self, command: bytes, now_s: float) -> bytes:
        return b""

    def unasked(self, now_s: float) -> bytes:
        if self.scene.on_pan is None or now_s < self._next_s:
            return b""
        self._next_s = now_s + 0.5
        return f"{self.scene.on_pan}\r\n".encode()


DRIVER = Template
