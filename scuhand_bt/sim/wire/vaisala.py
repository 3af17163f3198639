"""The twin of a Vaisala transmitter, by its manual: one reading at SEND, a stream from R to S."""

from typing import Any

from scuhand_bt.sim.wire.line_twin import LineTwin
from scuhand_bt.sim.wire.scene import Scene


class VaisalaTwin(LineTwin):
    """In STOP mode, with the echo off, in metric units."""

    period_s = 1.0

    def __init__(self, options: Any, scene: Scene) -> None:
        super().__init__(options, scene)
        self.streams = False
        self._next_s = 0.0

    def answer(self, command: bytes, now_s: float) -> bytes:
        match command.strip().upper().split():
            case [b"SEND", *_] if not self.streams:
                return self.reading()
            case [b"R"]:
                self.streams, self._next_s = True, now_s
            case [b"S"]:
                self.streams = False
            case [_, *_] if not self.streams:
                return b"Unknown command.\r\n"
        return b""

    def unasked(self, now_s: float) -> bytes:
        if not self.streams or now_s < self._next_s:
            return b""
        self._next_s = now_s + self.period_s
        return self.reading()

    def reading(self) -> bytes:
        """A line in the factory's format."""
        air = self.scene.air
        humidity, temperature = air["humidity_percent"], air["temperature_c"]
        return f"RH={humidity:5.1f} %RH T={temperature:6.1f} 'C \r\n".encode()
