"""Shimadzu's standard format (ITX, AUW, UW series): `S   12.3456g `.

Source: Shimadzu instruction manuals AUW/AUX and UW/UX, "command codes" and "data format": a letter S or U
where asked for, the sign (a blank for plus), the value right-aligned, the unit. A line without the
letter says nothing of stability, and so is never taken for a stable one.
"""

import re

from scuhand_bt.devices.balances.frames import Dialect, Frame, OutOfRange, Weight, number
from scuhand_bt.devices.serial_link import Framing

_WEIGHT = re.compile(rb"(?P<letter>[SU]?)(?P<sign>[ +\-])(?P<digits>[ 0-9.]{8})(?P<unit>[A-Za-z%][A-Za-z% ])\r\n?")
_OVERLOAD = re.compile(rb"[SU]?(?P<sign>[ +\-]) {0,8}(?:oL|OL) {0,8}\r\n?")


def parse(line: bytes) -> Frame | None:
    """Read one line; None if it is no line of Shimadzu's."""
    if match := _OVERLOAD.fullmatch(line):
        return OutOfRange(above=match["sign"] != b"-")
    if match := _WEIGHT.fullmatch(line):
        value = number(match["sign"] + match["digits"])
        return None if value is None else Weight(value, match["unit"].decode().strip(), match["letter"] == b"S")
    return None


DIALECT = Dialect(
    name="Shimadzu",
    framing=Framing(2400, "7E2"),
    parse=parse,
    # D07, once with the letter, is in every model's manual; continuous output with the letter is not.
    poll=b"D07\r\n",
    twin="scuhand_bt.sim.wire.balances:ShimadzuTwin",
)
