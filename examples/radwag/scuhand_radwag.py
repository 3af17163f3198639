"""Balances by RADWAG (PS, AS, R series): what their lines mean, and a twin that speaks them. See protocol.md."""

import re

from scuhand_bt.devices.balances.frames import Answer, Busy, Dialect, Frame, OutOfRange, Refused, Weight, number
from scuhand_bt.devices.serial_link import Framing
from scuhand_bt.sim.wire.balances import BalanceTwin

_HEAD = rb"(?:S   |SI  |SU  |SUI )"
_WEIGHT = re.compile(_HEAD + rb"([ ?]) ([ -])((?=[ 0-9.]{9} ) *\d+\.?\d*) ((?=.{3}\r)[A-Za-z]{1,3}) *\r\n")
_RANGE = re.compile(rb"(?:S|SI|SU|SUI) +([\^v])(?: [ -].{9} .{3})?\r\n")
_ANSWER = re.compile(rb"(?:NB|C1|C0) A(?: \"?([ -~]{1,20}?)\"?)?\r\n")


def parse(line: bytes) -> Frame | None:
    """One line; None if it is no RADWAG line."""
    if match := _WEIGHT.fullmatch(line):
        value = number(match[2] + match[3])
        return None if value is None else Weight(value, match[4].decode(), match[1] == b" ")
    if match := _RANGE.fullmatch(line):
        return OutOfRange(above=match[1] == b"^")
    if match := _ANSWER.fullmatch(line):
        return Answer((match[1] or b"").decode())
    if line.rstrip().endswith(b" I") and len(line) <= 7:
        return Busy(line.decode("latin-1").strip())  # understood, but not accessible now
    return Refused("ES") if line == b"ES\r\n" else None


class RadwagTwin(BalanceTwin):
    """Immediate readings and a serial number."""

    def obey(self, command: bytes, now_s: float) -> bytes:
        answers = {b"SI": self.reading(now_s), b"NB": b'NB A "TWIN"\r\n', b"": b""}
        return answers.get(command.strip(), b"ES\r\n")

    def waited(self, command: bytes, now_s: float) -> bytes:
        return self.reading(now_s)

    def reading(self, now_s: float) -> bytes:
        text, out = self.displayed(self.net_mg(now_s)), self.range_sign(now_s)
        marker = {"+": "^", "-": "v", "": " " if self.is_stable(now_s) else "?"}[out]
        sign = "-" if text.startswith("-") else " "
        return f"SI  {marker} {sign}{text.lstrip('-'):>9} {self.unit:<3}\r\n".encode()


DRIVER = Dialect(
    "RADWAG", Framing(9600, "8N1"), parse, identify=b"NB\r\n", poll=b"SI\r\n", twin=f"{__name__}:RadwagTwin"
)
