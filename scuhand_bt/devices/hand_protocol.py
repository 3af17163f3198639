"""The hand controller's line protocol, version 2, as the host speaks it: `docs/protocols/hand_controller.md`.

17 open 1.250*3ECE                17 ok open 1.248 0.000 - 31*CD5E
18 step 1.200 0.350 0.000*5E64   18 no fault closed 0.000 0.000 e 30*5FFC
"""

import re
from dataclasses import dataclass

VERSION = 2
SEQUENCES = 0x10000
LONGEST_DWELL_S = 60.0
"""Of one step: `kLongestDwellMs` in the firmware, which refuses a longer one."""
FAULTS = {
    "e": "the emergency stop is (or was) pressed",
    "d": "the host was silent for too long and the controller closed the valve",
    "s": "the valve's servo does not answer, was without power, or has shut down",
    "t": "the valve is stuck",
}


def crc16(data: bytes) -> int:
    """CRC-16/CCITT-FALSE: polynomial 0x1021, start 0xFFFF."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc


def encode(sequence: int, command: str) -> bytes:
    """A command as a line with its checksum."""
    body = f"{sequence} {command}".encode("ascii")
    return body + b"*%04X\n" % crc16(body)


@dataclass(frozen=True, slots=True)
class Hello:
    """The controller's answer to hello."""

    sequence: int
    firmware: str
    max_opening_mm: float
    """By the valve's map that it has kept; 0 where it has none."""


@dataclass(frozen=True, slots=True)
class Report:
    """The controller's answer to any other command: done or not, and how things stand."""

    sequence: int
    refusal: str
    """Why the command was not carried out; empty if it was."""
    state: str
    """closed, closing, moving, open; opening and dwelling during a step."""
    opening_mm: float
    vibration: float
    faults: str
    """Letters of `FAULTS` that are latched; empty for none."""
    temperature_c: int

    @property
    def is_safe(self) -> bool:
        return self.state == "closed" and self.vibration == 0.0

    @property
    def why(self) -> str:
        """The latched faults in words."""
        return "; ".join(FAULTS[letter] for letter in self.faults)


_NUMBER = rb"(-?\d{1,7}\.\d{3})"
_HELLO = re.compile(rb"(\d{1,5}) hello %d ([!-~]{1,12}) " % VERSION + _NUMBER)
_REPORT = re.compile(
    rb"(\d{1,5}) (?:ok|no ([a-z]{1,12})) (closed|closing|moving|open|opening|dwelling) "
    + _NUMBER
    + rb" "
    + _NUMBER
    + rb" (-|[edst]{1,4}) (-?\d{1,5})"
)
_LINE = re.compile(rb"([ -~]{1,80})\*([0-9A-F]{4})\r?\n")


def decode(line: bytes) -> Hello | Report | None:
    """Read one line of the controller; None for anything that is not one, or whose checksum is wrong."""
    outer = _LINE.fullmatch(line)
    if outer is None or int(outer[2], 16) != crc16(outer[1]):
        return None
    if hello := _HELLO.fullmatch(outer[1]):
        return Hello(int(hello[1]), hello[2].decode(), float(hello[3]))
    if report := _REPORT.fullmatch(outer[1]):
        return Report(
            sequence=int(report[1]),
            refusal=(report[2] or b"").decode(),
            state=report[3].decode(),
            opening_mm=float(report[4]),
            vibration=float(report[5]),
            faults=report[6].decode().strip("-"),
            temperature_c=int(report[7]),
        )
    return None
