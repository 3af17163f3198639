"""Twins of the balances A&D, MT-SICS, SBI and Shimadzu, each with its commands, formats and errors.

Sources: `docs/protocols/`. They share nothing with the drivers. They share the pan, and the serial numbers say TWIN.
"""

import re
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Protocol

from scuhand_bt.drivers import NotPluggable
from scuhand_bt.sim.wire.scene import twin_of

CRLF = b"\r\n"
STABLE_TIMEOUT_S = 30.0
"""A command that waits for stability gives up after this."""
BOOT_S = 2.0
"""From power-on to the first line; our assumption, as manuals name no time."""


class PanLoad(Protocol):
    """The load on the balance: the simulated world's, or a test's own."""

    def gross_mg(self, now_s: float) -> float:
        """The load cell's value [mg], not rounded."""
        ...

    def is_stable(self, now_s: float) -> bool: ...


@dataclass
class StillPan:
    """A pan whose load changes only by assignment."""

    load_mg: float = 0.0
    stable: bool = True

    def gross_mg(self, now_s: float) -> float:
        return self.load_mg

    def is_stable(self, now_s: float) -> bool:
        return self.stable


class BalanceTwin(ABC):
    """What the four have in common: lines of commands, a stream of readings, zero, tare and range."""

    STATE: ClassVar[tuple[str, ...]] = ("unit", "period_s", "streaming", "zero_mg", "tare_mg")
    """The attributes that the world's file keeps."""

    def __init__(self, pan: PanLoad, readability_mg: float = 0.1, maximum_mg: float = 220_000.0) -> None:
        self.pan = pan
        self.readability_mg = readability_mg
        self.maximum_mg = maximum_mg
        self.unit = "g"
        self.period_s = 0.1
        self.streaming = False
        self.adjusting_until_s = float("-inf")
        self.zero_mg = 0.0
        self.tare_mg = 0.0
        self._typed = b""
        self._next_s = 0.0
        self._waiting: list[tuple[bytes, float]] = []
        """Commands that wait for stability, and until when."""
        self._begins_s = float("-inf")
        """The end of the boot after power-on."""

    def switch_on(self, now_s: float) -> None:
        """Start after power-on, without what the menu does not keep. The world takes the load on the pan as zero."""
        self._begins_s, self.adjusting_until_s = now_s + BOOT_S, now_s
        self.streaming, self.zero_mg, self.tare_mg, self._typed = False, 0.0, 0.0, b""
        self.cancel_waiting()

    def hear(self, data: bytes, now_s: float) -> list[bytes]:
        """Answer commands, and send the readings of a stream that are due: whole lines."""
        if now_s < self._begins_s:
            return []
        return self._say_now(data, now_s).splitlines(keepends=True)

    def _say_now(self, data: bytes, now_s: float) -> bytes:
        out = b"".join(self.obey(command, now_s) for command in self._commands(data))
        if self._waiting and (self.is_stable(now_s) or now_s >= self._waiting[0][1]):
            (command, _), *self._waiting = self._waiting
            out += self.waited(command, now_s)
        if self.streaming and now_s >= self._next_s:
            self._next_s = now_s + self.period_s
            out += self.reading(now_s)
        return out

    def _commands(self, data: bytes) -> Iterator[bytes]:
        *lines, rest = (self._typed + data).replace(b"\r\n", b"\n").replace(b"\r", b"\n").split(b"\n")
        self._typed = rest[-64:]
        yield from lines

    def wait_for_stability(self, command: bytes, now_s: float) -> bytes:
        self._waiting.append((command, now_s + STABLE_TIMEOUT_S))
        return b""

    def cancel_waiting(self) -> None:
        self._waiting.clear()

    def net_mg(self, now_s: float) -> float:
        """The displayed mass before rounding [mg]."""
        return self.pan.gross_mg(now_s) - self.zero_mg - self.tare_mg

    def is_stable(self, now_s: float) -> bool:
        return self.pan.is_stable(now_s) and not self.is_adjusting(now_s)

    def is_adjusting(self, now_s: float) -> bool:
        return now_s < self.adjusting_until_s

    def range_sign(self, now_s: float) -> str:
        """ "+" above the maximum, "-" when the pan is lifted, else ""."""
        load_mg = self.pan.gross_mg(now_s) - self.zero_mg
        return "+" if load_mg > self.maximum_mg else "-" if load_mg < -0.02 * self.maximum_mg else ""

    def tare(self, now_s: float) -> None:
        self.tare_mg = self.pan.gross_mg(now_s) - self.zero_mg

    def zero(self, now_s: float) -> None:
        self.zero_mg, self.tare_mg = self.pan.gross_mg(now_s), 0.0

    def displayed(self, mg: float) -> str:
        """A mass in the balance's unit, rounded to its readability, with a sign only if negative."""
        per_unit_mg = {"g": 1000.0, "mg": 1.0, "kg": 1e6, "ct": 200.0}[self.unit]
        step = self.readability_mg / per_unit_mg
        decimals = max(0, len(f"{step:.8f}".rstrip("0").split(".")[1]))
        text = f"{round(mg / self.readability_mg) * step:.{decimals}f}"
        return text.removeprefix("-") if float(text) == 0 else text

    @abstractmethod
    def obey(self, command: bytes, now_s: float) -> bytes:
        """The reply to one command line, b"" if there is none (yet)."""

    @abstractmethod
    def waited(self, command: bytes, now_s: float) -> bytes:
        """The reply to a command that has waited for stability, or has given up waiting."""

    @abstractmethod
    def reading(self, now_s: float) -> bytes:
        """One line with the displayed value."""


class AndTwin(BalanceTwin):
    """A&D standard format, with `erCd 0` (silent) or `erCd 1` (acknowledging)."""

    def __init__(self, pan: PanLoad, readability_mg: float = 0.1, maximum_mg: float = 220_000.0) -> None:
        super().__init__(pan, readability_mg, maximum_mg)
        self.error_codes = False
        self.format = "A&D"
        """"MT" for the menu's Mettler-like output."""

    def obey(self, command: bytes, now_s: float) -> bytes:
        if command in (b"Q", b"SI"):
            return self.reading(now_s)
        if command in (b"S", b"\x1bP"):
            return self.wait_for_stability(command, now_s + 1e9)  # without a timeout
        if command == b"SIR":
            self.streaming = True
            return b""
        if command == b"C":
            self.streaming = False
            self.cancel_waiting()
            return b""
        if command == b"?SN":
            return b"SN,TWIN8432" + CRLF
        if command == b"?ID":
            return b"ID,LAB-0123" + CRLF
        if command in (b"R", b"Z", b"\x1bT", b"T"):
            return self._control(command, now_s)
        return self._error("E01") if command.strip() else b""

    def _control(self, command: bytes, now_s: float) -> bytes:
        if self.is_adjusting(now_s):
            return self._error("E02")
        if not self.is_stable(now_s):
            return self._error("E11")
        if command == b"T":
            self.tare(now_s)
            return b"\x06\r\n" if self.error_codes else b""
        self.zero(now_s)
        return b"\x06\r\n\x06\r\n" if self.error_codes else b""  # received, completed

    def _error(self, code: str) -> bytes:
        return f"EC,{code}".encode() + CRLF if self.error_codes else b""

    def waited(self, command: bytes, now_s: float) -> bytes:
        return self.reading(now_s)

    def reading(self, now_s: float) -> bytes:
        if sign := self.range_sign(now_s):
            return f"OL,{sign}9999999E+19".encode() + CRLF
        stable = self.is_stable(now_s)
        text = self.displayed(self.net_mg(now_s))
        if self.format == "MT":
            return f"S{' ' if stable else 'D'} {text:>9} {self.unit}".encode() + CRLF
        sign = "-" if text.startswith("-") else "+"
        return f"{'ST' if stable else 'US'},{sign}{text.lstrip('-'):0>8}{self.unit:>3}".encode() + CRLF


_PRESET = re.compile(r"(\d{1,6}(?:\.\d{1,6})?) g")
"""The tare values that `TA` accepts."""


class MtSicsTwin(BalanceTwin):
    """MT-SICS levels 0 and 1."""

    serial_number = "TWIN696838"

    def obey(self, command: bytes, now_s: float) -> bytes:
        word, _, rest = command.decode("ascii", "replace").strip().partition(" ")
        if not word:
            return b""
        if word == "@":
            self.streaming = False
            self.cancel_waiting()
            self.adjusting_until_s = now_s
            self.tare_mg = 0.0
            return self._say(f'I4 A "{self.serial_number}"')
        if word in ("S", "T", "Z"):
            self.streaming = False
            return self._range(word, now_s) or self.wait_for_stability(command, now_s)
        if word == "SI":
            self.streaming = False
            return self.reading(now_s)
        if word == "SIR":
            self.streaming = True
            return b""
        if word in ("ZI", "TI"):
            return self._range(word, now_s) or self._at_once(word, now_s)
        if word == "TA" and rest:
            if (preset := _PRESET.fullmatch(rest)) is None:
                return self._say("TA L")  # parameter wrong
            self.tare_mg = float(preset[1]) * 1000
        answers = {
            "TA": f"TA A {self.displayed(self.tare_mg):>10} {self.unit}",
            "TAC": "TAC A",
            "I0": 'I0 B 0 "I0"\r\nI0 B 0 "@"\r\nI0 A 0 "S"',
            "I1": 'I1 A "01" "2.30" "2.20" "" ""',
            "I2": f'I2 A "WXS205SDU WXA-Bridge {self.maximum_mg / 1000:.5f} g"',
            "I3": 'I3 A "2.10 10.28.0.493.142"',
            "I4": f'I4 A "{self.serial_number}"',
            "M21": "M21 A",
            "C3": "C3 B",
        }
        if word == "TAC":
            self.tare_mg = 0.0
        if word == "C3":
            self.adjusting_until_s = now_s + 2.0
            self.wait_for_stability(command, now_s)
        return self._say(answers.get(word, "ES"))

    def _at_once(self, word: str, now_s: float) -> bytes:
        status = "S" if self.is_stable(now_s) else "D"
        if word == "ZI":
            self.zero(now_s)
            return self._say(f"ZI {status}")
        self.tare(now_s)
        return self._say(f"TI {status} {self.displayed(self.tare_mg):>10} {self.unit}")

    def waited(self, command: bytes, now_s: float) -> bytes:
        word = command.decode().strip()
        if not self.is_stable(now_s):
            return self._say(f"{word} I")
        if word == "S":
            return self.reading(now_s)
        if word == "T":
            self.tare(now_s)
            return self._say(f"T S {self.displayed(self.tare_mg):>10} {self.unit}")
        if word == "Z":
            self.zero(now_s)
        return self._say(f"{word} A")

    def reading(self, now_s: float) -> bytes:
        if self.is_adjusting(now_s):
            return self._say("S I")
        status = "S" if self.is_stable(now_s) else "D"
        return self._range("S", now_s) or self._say(f"S {status} {self.displayed(self.net_mg(now_s)):>10} {self.unit}")

    def _range(self, word: str, now_s: float) -> bytes:
        sign = self.range_sign(now_s)
        return self._say(f"{word} {sign}") if sign else b""

    @staticmethod
    def _say(text: str) -> bytes:
        return text.encode() + CRLF


class SbiTwin(BalanceTwin):
    """SBI with lines of 16 or 22 characters. Control commands are silent; tare and zero work only when stable."""

    def __init__(self, pan: PanLoad, readability_mg: float = 0.1, maximum_mg: float = 220_000.0) -> None:
        super().__init__(pan, readability_mg, maximum_mg)
        self.with_id = False
        self.autoprint = False
        self.print_when_stable = False

    def _say_now(self, data: bytes, now_s: float) -> bytes:
        out = super()._say_now(data, now_s)
        # `ESC char` may come without a line end, unless the char begins a longer command.
        if self._typed[:1] == b"\x1b" and len(self._typed) == 2 and self._typed[1:] not in (b"x", b"k", b"s"):
            command, self._typed = self._typed, b""
            out += self.obey(command, now_s)
        return out

    def obey(self, command: bytes, now_s: float) -> bytes:
        if command == b"\x1bP" or command == b"\x1bkP_":
            if self.autoprint:
                self.streaming = not self.streaming
                return b""
            return self.wait_for_stability(command, now_s) if self.print_when_stable else self.reading(now_s)
        if command in (b"\x1bT", b"\x1bU") and self.is_stable(now_s):
            self.tare(now_s)
        elif command == b"\x1bV" and self.is_stable(now_s):
            self.zero(now_s)
        elif command == b"\x1bZ":
            self.adjusting_until_s = now_s + 2.0
        names = {b"\x1bx1_": "ENTRIS224I-1S", b"\x1bx2_": "TWIN402012", b"\x1bx3_": "00-20-12.01"}
        return names[command].encode() + CRLF if command in names else b""

    def waited(self, command: bytes, now_s: float) -> bytes:
        return self.reading(now_s)

    def reading(self, now_s: float) -> bytes:
        if self.is_adjusting(now_s):
            return self._line("Stat", "   Cal.Int.   ")
        if sign := self.range_sign(now_s):
            return self._line("Stat", "     High     " if sign == "+" else "     Low      ")
        text = self.displayed(self.net_mg(now_s))
        sign = "-" if text.startswith("-") else "+"
        unit = self.unit if self.is_stable(now_s) else ""
        return self._line("N", f"{sign} {text.lstrip('-'):>8} {unit:<3}")

    def _line(self, name: str, block: str) -> bytes:
        return f"{name if self.with_id else '':<{6 * self.with_id}}{block}".encode() + CRLF


class ShimadzuTwin(BalanceTwin):
    """Shimadzu's standard format: D01/D03 continuous, D05/D07/D08 once, D09 stops."""

    def __init__(self, pan: PanLoad, readability_mg: float = 0.1, maximum_mg: float = 120_000.0) -> None:
        super().__init__(pan, readability_mg, maximum_mg)
        self.period_s = 0.11
        self._with_letter = False

    def obey(self, command: bytes, now_s: float) -> bytes:
        if command in (b"D01", b"D03"):
            self.streaming, self._with_letter = True, command == b"D03"
        elif command == b"D09":
            self.streaming = False
            self.cancel_waiting()
        elif command in (b"D05", b"D07"):
            return self._line(now_s, with_letter=command == b"D07")
        elif command in (b"D08", b"TS"):
            return self.wait_for_stability(command, now_s + 1e9)
        elif command in (b"T", b"TARE"):
            self.tare(now_s)
        return b""

    def waited(self, command: bytes, now_s: float) -> bytes:
        if command == b"TS":
            self.tare(now_s)
            return b""
        return self._line(now_s, with_letter=False)

    def reading(self, now_s: float) -> bytes:
        return self._line(now_s, self._with_letter)

    def _line(self, now_s: float, with_letter: bool) -> bytes:
        letter = ("S" if self.is_stable(now_s) else "U") if with_letter else ""
        if sign := self.range_sign(now_s):
            return f"{letter}{' ' if sign == '+' else '-'}   oL     ".encode() + CRLF
        text = self.displayed(self.net_mg(now_s))
        sign = "-" if text.startswith("-") else " "
        return f"{letter}{sign}{text.lstrip('-'):>8}{self.unit:<2}".encode() + CRLF


def balance_twin(driver: str) -> type[BalanceTwin]:
    """The twin for a balance driver, ours or another package's. Raises NotPluggable if there is none."""
    twin = twin_of("balance", driver)
    if not issubclass(twin, BalanceTwin):
        raise NotPluggable(f"'{twin.__name__}' is no BalanceTwin")
    return twin
