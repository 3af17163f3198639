"""A sensor that is asked, and answers in one line."""

import re

from scuhand_bt.devices.line_device import LineReader
from scuhand_bt.devices.serial_link import Framing
from scuhand_bt.sim.wire.line_twin import LineTwin

_LINE = re.compile(rb"T (-?\d+\.\d) H (\d+\.\d);\r\n")


class Template(LineReader[dict[str, float]]):
    """Asks once a second."""

    twin = f"{__name__}:TemplateTwin"
    framing = Framing(9600, "8N1")
    question = b"READ\r\n"

    def parse(self, line: bytes) -> dict[str, float] | None:
        match = _LINE.fullmatch(line)
        return {"temperature_c": float(match[1]), "humidity_percent": float(match[2])} if match else None


class TemplateTwin(LineTwin):
    """Answers as the manual says; never make it by the driver's own expressions."""

    def answer(self, command: bytes, now_s: float) -> bytes:
        air = self.scene.air
        known = command.strip() == b"READ"
        return f"T {air['temperature_c']:.1f} H {air['humidity_percent']:.1f};\r\n".encode() if known else b""


DRIVER = Template
