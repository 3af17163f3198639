"""Vaisala's transmitters of humidity and temperature, by their serial commands: docs/protocols/vaisala.md."""

import re
from typing import ClassVar

from scuhand_bt.devices.line_device import LineReader
from scuhand_bt.devices.serial_link import Framing

_NUMBER = rb"= *(-?\d{1,4}\.\d{1,3}) *"
_HUMIDITY = re.compile(rb"(?:^|[ \t])RH" + _NUMBER + rb"%RH(?=[ \t\r\n])")
_TEMPERATURE = re.compile(rb"(?:^|[ \t])Ta?" + _NUMBER + rb"'C(?=[ \t\r\n])")


class Vaisala(LineReader[dict[str, float]]):
    """`driver: vaisala`: HMT310, HMT330, HMP155 and their like, in metric units."""

    twin: ClassVar = "scuhand_bt.sim.wire.vaisala:VaisalaTwin"
    framing: ClassVar = Framing(4800, "7E1")
    question: ClassVar = b"SEND\r\n"

    def parse(self, line: bytes) -> dict[str, float] | None:
        humidity, temperature = _HUMIDITY.findall(line), _TEMPERATURE.findall(line)
        if len(humidity) != 1 or len(temperature) != 1 or not line.endswith(b"\n"):
            return None
        value = {"temperature_c": float(temperature[0]), "humidity_percent": float(humidity[0])}
        return value if -80.0 <= value["temperature_c"] <= 180.0 and 0.0 <= value["humidity_percent"] <= 100.0 else None
