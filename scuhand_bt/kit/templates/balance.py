"""A balance: what its lines mean, and a twin that speaks them. The engine's driver does the rest."""

import re

from scuhand_bt.devices.balances.frames import Answer, Dialect, Frame, OutOfRange, Refused, Weight, number
from scuhand_bt.devices.serial_link import Framing
from scuhand_bt.sim.wire.balances import BalanceTwin

_WEIGHT = re.compile(rb"W([ ?]) *(-?\d+\.\d+) (mg|g|kg)\r\n")
_RANGE = re.compile(rb"W([+-])\r\n")
_ANSWER = re.compile(rb"ID ([ -~]{1,20})\r\n")


def parse(line: bytes) -> Frame | None:
    """One line; None if it is none of this balance's."""
    if match := _WEIGHT.fullmatch(line):
        value = number(match[2])
        return None if value is None else Weight(value, match[3].decode(), match[1] == b" ")
    if match := _RANGE.fullmatch(line):
        return OutOfRange(above=match[1] == b"+")
    if match := _ANSWER.fullmatch(line):
        return Answer(match[1].decode())
    return Refused("ERR") if line == b"ERR\r\n" else None


class TemplateTwin(BalanceTwin):
    """Answers as the manual says; never make it by the driver's own expressions."""

    def obey(self, command: bytes, now_s: float) -> bytes:
        answers = {b"READ": self.reading(now_s), b"WHO": b"ID TWIN\r\n", b"": b""}
        return answers.get(command.strip(), b"ERR\r\n")

    def waited(self, command: bytes, now_s: float) -> bytes:
        return self.reading(now_s)

    def reading(self, now_s: float) -> bytes:
        if out := self.range_sign(now_s):
            return f"W{out}\r\n".encode()
        marker = " " if self.is_stable(now_s) else "?"
        return f"W{marker}{self.displayed(self.net_mg(now_s)):>10} {self.unit}\r\n".encode()


DRIVER = Dialect(
    "Template", Framing(9600, "8N1"), parse, identify=b"WHO\r\n", poll=b"READ\r\n", twin=f"{__name__}:TemplateTwin"
)
