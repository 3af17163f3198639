"""A&D standard format (FX, FZ, GX, GF, BM series): `ST,+00012.78  g`.

Source: A&D instruction manuals FX-i/FZ-i, GX/GF and BM, "A&D standard format" and "commands".
"""

import re

from scuhand_bt.devices.balances.frames import Answer, Busy, Dialect, Frame, OutOfRange, Refused, Weight, number
from scuhand_bt.devices.serial_link import Framing

# Header, sign and 8 characters (9 above eight digits, on BM), unit right-aligned in three.
_WEIGHT = re.compile(rb"(ST|WT|US|QT),([+-][0-9.]{8,9})([ A-Za-z%]{3})\r\n")
_OVERLOAD = re.compile(rb"OL,([+-])9{7}E\+19\r\n")
_ERROR = re.compile(rb"EC,(E\d\d)\r\n")
_ANSWER = re.compile(rb"(?:ID|SN|TN|PT)[,:]([ -~]{1,32})\r\n")
_ACKNOWLEDGED = b"\x06\r\n"

NOT_READY = "E02"
UNSTABLE = "E11"


def parse(line: bytes) -> Frame | None:
    """Read one line; None if it is no A&D standard line."""
    if match := _WEIGHT.fullmatch(line):
        value = number(match[2])
        # WT is what some counting scales send for ST; QT counts pieces, which are no mass: its unit says so.
        return None if value is None else Weight(value, match[3].decode().strip(), match[1] in (b"ST", b"WT"))
    if match := _OVERLOAD.fullmatch(line):
        return OutOfRange(above=match[1] == b"+")
    if match := _ERROR.fullmatch(line):
        code = match[1].decode()
        return Busy(code) if code in (NOT_READY, UNSTABLE) else Refused(code)
    if match := _ANSWER.fullmatch(line):
        return Answer(match[1].decode().strip())
    return Answer("") if line == _ACKNOWLEDGED else None


DIALECT = Dialect(
    name="A&D",
    framing=Framing(2400, "7E1"),
    parse=parse,
    identify=b"?SN\r\n",
    stream=b"SIR\r\n",
    poll=b"Q\r\n",
    twin="scuhand_bt.sim.wire.balances:AndTwin",
)
