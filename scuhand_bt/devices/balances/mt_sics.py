"""MT-SICS, Mettler-Toledo's interface command set, levels 0 and 1: `S S     100.00 g`.

Source: Mettler-Toledo MT-SICS reference manuals 11780711 and 11781363. A reply to `SI` or `SIR` carries
the id `S`. One command at a time: the manual warns that a balance may mix up or ignore pipelined ones.
"""

import re

from scuhand_bt.devices.balances.frames import Answer, Busy, Dialect, Frame, OutOfRange, Refused, Weight, number
from scuhand_bt.devices.serial_link import Framing

# The value stands right-aligned in ten characters (more on comparators), its sign beside the digits.
_WEIGHT = re.compile(rb"S ([SD]) (?=.{10,12} [A-Za-z%])( *-?[0-9.]+) ([A-Za-z%]{1,5})\r\n")
# Only A and B say more: a weight whose status was damaged is no overload.
_STATUS = re.compile(rb"([A-Z]{1,3}\d{0,2}) ([ABIL+\-])(?:(?<=[AB]) ([ -~]*))?\r\n")
_SAID_TARE = re.compile(rb"(?:T|TI|TA) [SDA] [ 0-9.\-]{10,12} [A-Za-z%]{1,5}\r\n")
_SAID_ZERO = re.compile(rb"ZI [SD]\r\n")
_FAULTY = re.compile(rb"S S Error +([0-9A-Za-z]{1,4})\r\n")
_ERRORS = (b"ES\r\n", b"ET\r\n", b"EL\r\n")


def parse(line: bytes) -> Frame | None:
    """Read one line; None if it is no MT-SICS line. A tare's value is an answer, never a weight."""
    if match := _WEIGHT.fullmatch(line):
        value = number(match[2])
        return None if value is None else Weight(value, match[3].decode(), match[1] == b"S")
    if match := _FAULTY.fullmatch(line):
        return Refused(f"Error {match[1].decode()}")  # boot, EEPROM, adjustment needed, …
    if _SAID_TARE.fullmatch(line) or _SAID_ZERO.fullmatch(line):
        return Answer(line.decode().strip())
    if match := _STATUS.fullmatch(line):
        return _status(match[1].decode(), match[2].decode(), (match[3] or b"").decode())
    return Refused(line.decode().strip()) if line in _ERRORS else None


def _status(command: str, status: str, rest: str) -> Frame:
    if status in "+-":
        return OutOfRange(above=status == "+")
    if status == "I":
        return Busy(f"{command} I")
    if status == "B" and command.startswith("C"):
        return Busy(f"{command} B", adjusting=True)
    if status == "L":
        return Refused(f"{command} L")
    return Answer(rest.strip('"'))


DIALECT = Dialect(
    name="MT-SICS",
    framing=Framing(9600, "8N1"),
    parse=parse,
    identify=b"@\r\n",  # also ends whatever an earlier program left running
    stream=b"SIR\r\n",
    poll=b"SI\r\n",
    twin="scuhand_bt.sim.wire.balances:MtSicsTwin",
)
