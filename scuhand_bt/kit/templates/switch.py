"""An ioniser or a capper: told one of two states, and asked for the one that it is in."""

from typing import Any

from scuhand_bt.devices.line_device import LineSwitch
from scuhand_bt.devices.serial_link import Framing
from scuhand_bt.sim.wire.line_twin import LineTwin
from scuhand_bt.sim.wire.scene import Scene


class Template(LineSwitch):
    """Asks for its state every half second."""

    twin = f"{__name__}:TemplateTwin"
    framing = Framing(9600, "8N1")
    question = b"STATE\r\n"
    period_s = 0.5
    done_within_s = 5.0

    def command(self, value: bool) -> bytes:
        return b"ON\r\n" if value else b"OFF\r\n"

    def parse(self, line: bytes) -> bool | None:
        return {b"IS ON.\r\n": True, b"IS OFF.\r\n": False}.get(line)


class TemplateTwin(LineTwin):
    """Takes a moment to obey; never make it by the driver's own expressions."""

    def __init__(self, options: Any, scene: Scene) -> None:
        super().__init__(options, scene)
        self.state = self._told = False
        self._since_s = 0.0

    def answer(self, command: bytes, now_s: float) -> bytes:
        if now_s >= self._since_s + 0.2:
            self.state = self._told
        if command in (b"ON", b"OFF"):
            self._told, self._since_s = command == b"ON", now_s
        return (b"IS ON.\r\n" if self.state else b"IS OFF.\r\n") if command == b"STATE" else b""


DRIVER = Template
