"""Chemical formulas: `Li6.5La3Zr1.5Ta0.5O12`, `FeC2O4·2H2O`, `(NH4)2HPO4`, as exact counts of atoms.

The grammar is here, as solid solutions have counts with decimals: those of molmass end at whole numbers, and what it
makes of others it does not always refuse (`YBa2Cu3O6.9` is read as O6). What an element weighs is molmass's: the NIST's
table of the IUPAC's standard atomic weights. It is imported when the first formula is read.
"""

import re
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from typing import Annotated

from pydantic import AfterValidator
from pydantic_core import PydanticCustomError

LONGEST = 100
_DOTS = "·⋅•∙・"
"""What stands before water of crystallisation, beside `*`."""
_TOKEN = re.compile(r"(?P<symbol>[A-Z][a-z]?)|(?P<count>\d+(?:\.\d+)?)|(?P<open>[(\[])|(?P<close>[)\]])|(?P<dot>\*)")
_COUNT = re.compile(r"(?:[1-9]\d{0,3}|0(?=\.\d*[1-9]))(?:\.\d{1,9})?")
_MOLECULE = re.compile(r"(H2O|NH3)(?![a-z0-9.])")
"""What is most often meant to be beside another formula."""
_PAIRS = {"(": ")", "[": "]"}


@dataclass(frozen=True)
class Formula:
    """How many atoms of each element, in the order in which they are written first."""

    text: str
    counts: Mapping[str, Fraction]

    @property
    def molar_mass_g_per_mol(self) -> float:
        """The sum of the standard atomic weights; in mg per mmol, too."""
        return sum(float(count) * _weights()[element] for element, count in self.counts.items())


@cache
def parse_formula(text: str) -> Formula:
    """Read a formula. ValueError, worded for the user, for what is none."""
    plain = unicodedata.normalize("NFKC", text).strip()
    plain = re.sub(rf"\s*[{_DOTS}*]\s*", "*", plain)
    if not plain:
        raise ValueError("it is empty; write a formula, such as Li7La3Zr2O12")
    if len(plain) > LONGEST:
        raise ValueError(f"it is longer than {LONGEST} characters")
    counts: dict[str, Fraction] = {}
    for part in plain.split("*"):
        _add(counts, _part(part))
    return Formula(text.strip(), counts)


def is_element(symbol: str) -> bool:
    """Whether there is an element of this symbol."""
    return symbol in _weights()


@cache
def _weights() -> Mapping[str, float]:
    from molmass import ELEMENTS

    return {element.symbol: element.mass for element in ELEMENTS}


def _part(text: str) -> dict[str, Fraction]:
    """What stands between two dots: a number of it, perhaps, and groups."""
    number = re.match(r"\d[\d.]*", text)
    times = _count(number[0]) if number else Fraction(1)
    stack: list[tuple[str, dict[str, Fraction]]] = [("", {})]
    at = number.end() if number else 0
    while at < len(text):
        token = _TOKEN.match(text, at)
        if token is None:
            raise ValueError(_not_understood(text, at))
        at = token.end()
        group: dict[str, Fraction]
        if token["symbol"]:
            if not is_element(token["symbol"]):
                raise ValueError(f"there is no element '{token['symbol']}'")
            group = {token["symbol"]: Fraction(1)}
        elif token["open"]:
            stack.append((_PAIRS[token["open"]], {}))
            continue
        elif token["close"]:
            expected, group = stack.pop()
            if token["close"] != expected:
                raise ValueError(f"there is a '{token['close']}' too many, or it closes another kind of bracket")
            if not group:
                raise ValueError("a pair of brackets is empty")
        else:
            raise ValueError(f"'{token[0]}' counts nothing: it has no element before it")
        repeated, at = _count_at(text, at)
        _add(stack[-1][1], group, repeated)
    if len(stack) > 1:
        raise ValueError(f"a '{stack[-1][0]}' is missing")
    if not stack[0][1]:
        raise ValueError("there is nothing on one side of a dot")
    return {element: count * times for element, count in stack[0][1].items()}


def _add(counts: dict[str, Fraction], more: Mapping[str, Fraction], times: Fraction = Fraction(1)) -> None:
    for element, count in more.items():
        counts[element] = counts.get(element, Fraction(0)) + count * times


def _count_at(text: str, at: int) -> tuple[Fraction, int]:
    """The count that stands here, or 1, and where it ends."""
    written = re.compile(r"[\d.]+").match(text, at)
    if written is None:
        return Fraction(1), at
    count, end = written[0], written.end()
    whole, _, behind = count.partition(".")
    if behind and whole.strip("0") and (molecule := _MOLECULE.match(text, end)):
        either = f"'{count}{molecule[0]}' may be {count} of what is before it, or a dot"
        raise ValueError(f"{either}: write {whole}·{behind}{molecule[0]}, or {count}({molecule[0]})")
    return _count(count), end


def _count(text: str) -> Fraction:
    if not _COUNT.fullmatch(text):
        raise ValueError(f"'{text}' is not a count, such as 2, 0.5 or 6.75; write '·' before a second formula")
    return Fraction(text)


def _not_understood(text: str, at: int) -> str:
    sign = text[at]
    if sign.islower():
        return f"'{text[at:]}' does not begin with an element's symbol; a symbol begins with a capital letter"
    if sign in "+-^":
        return f"'{text[at:]}' cannot be read: formulas have no charges, and x must be a number"
    return f"'{text[at:]}' cannot be read; a formula has elements, counts, brackets, and '·' before water"


def _checked(text: str) -> str:
    try:
        parse_formula(text)
    except ValueError as error:
        why = f"'{text if len(text) <= 40 else text[:39] + '…'}' is not a formula: {error}"
        raise PydanticCustomError("formula", "{why}", {"why": why}) from None
    return text


FormulaText = Annotated[str, AfterValidator(_checked)]
"""A field that holds a formula as it is written."""
