"""SBI, the Sartorius Balance Interface: `+   123.56 g  `, 16 characters, or 22 with an id before it.

Source: Sartorius technical note "Entris II, Description of the Interface" and the manuals of Cubis MSE
and Secura/Quintix/Practum. The only sign of stability is the unit: it is blank while unstable.
"""

import re

from scuhand_bt.devices.balances.frames import Answer, Busy, Dialect, Frame, OutOfRange, Refused, Weight, number
from scuhand_bt.devices.serial_link import Framing

_ID = rb"(?P<id>N     |Stat  |G#    |T     |Qnt   )?"
# Sign, nine characters of value (eight and a space on newer models), space, three of unit. Brackets
# mark a digit beyond verified resolution.
_WEIGHT = re.compile(_ID + rb"(?P<value>(?=.{10} )[+\- ] *[0-9.,]+(?:\[[0-9.,]+\])?) (?P<unit>[A-Za-z% ]{3})\r\n")
_SPECIAL = re.compile(_ID + rb" {0,9}(?P<word>High|Low|H|L|Cal\.Ext\.|Cal\.Int\.|Calib\.|--) *\r\n")
_ERROR = re.compile(_ID + rb" {0,9}(?P<code>(?:Err|ERR) *\d{1,3}|(?:APP|DIS|PRT)\.ERR) *\r\n")
_TEXT = re.compile(rb"[A-Za-z0-9][ -~]{2,31}\r\n")

ESC = b"\x1b"


def parse(line: bytes) -> Frame | None:
    """Read one line; None if it is no SBI line. Gross, tare and count lines of a block are answers."""
    if match := _SPECIAL.fullmatch(line):
        return _special(match["word"].decode())
    if match := _ERROR.fullmatch(line):
        return Refused(match["code"].decode())
    if match := _WEIGHT.fullmatch(line):
        value = number(match["value"].translate(bytes.maketrans(b",", b"."), b"[]"))
        if value is None:
            return None
        if match["id"] in (None, b"N     "):
            unit = match["unit"].decode().strip()
            return Weight(value, unit, stable=bool(unit))
        return Answer(line.decode().strip())
    return Answer(line.decode().strip()) if _TEXT.fullmatch(line) and b"," not in line else None


def _special(word: str) -> Frame:
    if word in ("High", "H"):
        return OutOfRange(above=True)
    if word in ("Low", "L"):
        return OutOfRange(above=False)
    return Busy(word, adjusting=word.startswith("Cal"))


DIALECT = Dialect(
    name="SBI",
    framing=Framing(9600, "8O1"),
    parse=parse,
    identify=ESC + b"x2_\r\n",
    poll=ESC + b"P\r\n",
    twin="scuhand_bt.sim.wire.balances:SbiTwin",
)
