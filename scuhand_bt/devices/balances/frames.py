"""What any balance can say, whatever its dialect: the common result of all grammars."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from decimal import Decimal
from typing import ClassVar, TypeAlias

from scuhand_bt.device_specs.balance import BalanceOptions
from scuhand_bt.devices.interfaces import Balance, Site
from scuhand_bt.devices.serial_link import Framing

MILLIGRAMS_PER_UNIT = {
    "mg": Decimal(1),
    "g": Decimal(1000),
    "kg": Decimal(1_000_000),
    "ct": Decimal(200),  # the metric carat
}


@dataclass(frozen=True, slots=True)
class Weight:
    """A value with its unit as sent ("" where the dialect left it out) and what was said of stability."""

    value: Decimal
    unit: str
    stable: bool

    def milligrams(self, unit_if_blank: str = "") -> float | None:
        """The value in mg; None when its unit is unknown or none of mass."""
        factor = MILLIGRAMS_PER_UNIT.get(self.unit or unit_if_blank)
        return None if factor is None else float(self.value * factor)


@dataclass(frozen=True, slots=True)
class OutOfRange:
    """Overload (`above`), or underload: the pan was lifted."""

    above: bool


@dataclass(frozen=True, slots=True)
class Busy:
    """Not now: adjusting itself, or it gave up waiting for stability."""

    detail: str
    adjusting: bool = False


@dataclass(frozen=True, slots=True)
class Refused:
    """A command the balance did not take, with its code."""

    code: str


@dataclass(frozen=True, slots=True)
class Answer:
    """An answer that is no weight: an identity, an acknowledgement."""

    text: str


Frame: TypeAlias = Weight | OutOfRange | Busy | Refused | Answer


@dataclass(frozen=True, slots=True)
class Dialect:
    """One vendor's protocol as the driver uses it."""

    name: str
    framing: Framing
    """The vendor's factory setting."""
    parse: Callable[[bytes], Frame | None]
    """One line, terminator included, to a frame; None if this is not the dialect."""
    stream: bytes = b""
    """Starts continuous readings; empty where the driver polls."""
    poll: bytes = b""
    """Asks for one reading, stable or not; used without, or instead of a refused `stream`."""
    identify: bytes = b""
    """Asks for the serial number; sent first."""
    twin: str = ""
    """`package.module:Class` of its twin, a `sim.wire.balances.BalanceTwin`: for rehearsals and conformance."""
    Options: ClassVar = BalanceOptions

    def connect(self, site: Site) -> Balance:
        """The balance that speaks this, read by the engine's driver for all of them; SkillFailed device.lost."""
        from scuhand_bt.devices.balances import DIALECTS, SerialBalance

        balance = SerialBalance(site.spec, self, site.clock, DIALECTS.values())
        balance.open()
        return balance


_NUMBER = re.compile(rb" *([+-]?) *(\d+(?:\.\d*)?|\.\d+)")


def number(text: bytes) -> Decimal | None:
    """A decimal whose sign may stand apart, as in b"-   0.12"; None for anything else."""
    match = _NUMBER.fullmatch(text)
    return None if match is None else Decimal((match[1] + match[2]).decode())
