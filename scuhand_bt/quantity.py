"""Units at the border: "50 mg" in a file, `mass_mg = 50.0` inside.

Every number with a unit is a float whose *name* carries the unit. The annotated types below are what
models and skills declare; they read text with pint and let a plain float through, which is then taken
to be in the field's unit (that is how Python code calls a skill). pint takes a third of a second to
import: it is, when the first unit is read.
"""

import math
import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core import PydanticCustomError, core_schema

if TYPE_CHECKING:
    import pint

_DEFINITIONS = """
nano- = 1e-9 = n-
micro- = 1e-6 = µ- = μ- = u-
milli- = 1e-3 = m-
centi- = 1e-2 = c-
kilo- = 1e3 = k-
gram = [mass] = g
meter = [length] = m = metre
second = [time] = s = sec
minute = 60 * second = min
hour = 60 * minute = h = hr
liter = 1e-3 * meter ** 3 = L = l = litre
radian = [angle] = rad
degree = 0.017453292519943295 * radian = deg = °
percent = 0.01 = %
newton = kilogram * meter / second ** 2 = N
hertz = 1 / second = Hz
"""
MAX_LENGTH = 60
MOST_LISTED = 8
_NUMBER = re.compile(r"([+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d{1,3})?)\s*(.*)", re.DOTALL)
_COMMA = re.compile(r"[+-]?\d+,\d+(?!.*[.,])")
_THOUSANDS = re.compile(
    r"[+-]?\d{1,3}((\.\d{3})+,\d+|(,\d{3})+\.\d+|(\.\d{3}){2,}|(,\d{3}){2,}|(['’\s]\d{3})+([.,]\d+)?)\s*[A-Za-zµμ°%]*"
)
_UNIT = re.compile(r"[A-Za-zµμ°%]{1,12}(?:(?:\^|\*\*)?[23]|[²³])?(?:/[A-Za-zµμ°%]{1,12}(?:(?:\^|\*\*)?[23]|[²³])?)?")


_WRITTEN = r"^\s*[+-]?[0-9.]+([eE][+-]?[0-9]+)?\s*[A-Za-zµμ°%][A-Za-zµμ°%0-9/*^²³]*\s*$"
"""A quantity as it is written, for editors; what counts is `parse`."""


@dataclass(frozen=True)
class Unit:
    """The unit a field is kept in, and what its dimension is called in a message."""

    unit: str
    dimension: str
    examples: str

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        return core_schema.no_info_before_validator_function(self._read, handler(source))

    def __get_pydantic_json_schema__(
        self, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        examples = [text.strip('"') for text in self.examples.split(" or ")]
        return {
            "type": "string",
            "pattern": _WRITTEN,
            "description": f"{self.noun}, in {self.unit}",
            "examples": examples,
        }

    def _read(self, value: Any) -> Any:
        if isinstance(value, str):
            return self.parse(value)
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            shown = "nothing" if value is None else f"'{_short(str(value))}'"
            why = self.wanted(f"{shown} is not {self.noun}")
            raise PydanticCustomError("quantity", "{why}", {"why": why})
        return float(value)

    def parse(self, text: str) -> float:
        """Read "0.05 g" as a float in this unit; PydanticCustomError says what is wrong otherwise."""
        try:
            return parse(text, self)
        except ValueError as error:
            raise PydanticCustomError("quantity", "{why}", {"why": str(error)}) from None

    def wanted(self, problem: str) -> str:
        """A problem as a message: what is wrong, and what to write instead."""
        return f"{problem}; write {self.noun} with its unit, such as {self.examples}"

    @property
    def symbol(self) -> str:
        """The unit as it is shown."""
        return {"dimensionless": "", "degree": "°"}.get(self.unit, self.unit.replace("**3", "³"))

    @property
    def noun(self) -> str:
        """The dimension with its article: "a mass", "an angle"."""
        return f"{'an' if self.dimension[0] in 'aeiou' else 'a'} {self.dimension}"


@cache
def _registry() -> "pint.UnitRegistry[float]":
    import pint

    registry: pint.UnitRegistry[float] = pint.UnitRegistry(None)
    registry.load_definitions(_DEFINITIONS.strip().splitlines())
    return registry


Dimension = tuple[tuple[str, float], ...]
"""Powers of mass, length, time and angle, as pint calls them; () for a plain number."""


@cache
def dimension(unit: Unit) -> Dimension:
    """The dimension of what is kept in a unit."""
    powers = _registry().Unit(unit.unit).dimensionality
    return tuple(sorted((name, float(str(power))) for name, power in powers.items()))


def times(first: Dimension, second: Dimension, power: int = 1) -> Dimension:
    """The dimension of a product; with power -1 of a quotient."""
    powers = dict(first)
    for name, exponent in second:
        powers[name] = powers.get(name, 0) + power * exponent
    return tuple(sorted((name, exponent) for name, exponent in powers.items() if exponent))


@cache
def _factor(unit_text: str, unit: Unit) -> float:
    """What one `unit_text` is in `unit`; ValueError in the user's words if it cannot be."""
    import pint

    normal = unit_text.replace("²", "^2").replace("³", "^3").replace("μ", "µ")
    normal = re.sub(r"(?<=[A-Za-zµ°%])([23])", r"^\1", normal).replace("%", "percent").replace("°", "degree")
    try:
        return float(_registry().Quantity(1.0, normal).to(unit.unit).magnitude)
    except pint.DimensionalityError as error:
        found = _DIMENSIONS.get(str(error.dim1))
        what = f"a unit of {found}, not of {unit.dimension}" if found else f"not a unit of {unit.dimension}"
        raise ValueError(unit.wanted(f"'{unit_text}' is {what}")) from None
    except (pint.PintError, AttributeError, ValueError):  # pint has more ways to refuse a unit than one
        raise ValueError(unit.wanted(f"'{unit_text}' is not a known unit")) from None


_DIMENSIONS = {
    "[mass]": "mass",
    "[length]": "length",
    "[length] ** 3": "volume",
    "[time]": "duration",
    "[angle]": "angle",
    "dimensionless": "ratio",
}


@cache
def parse(text: str, unit: Unit) -> float:
    """Read a number with its unit, e.g. "50 mg", as a float in `unit`.

    Raises ValueError, worded for the user, for anything that is not one finite number and one unit of
    the right dimension.
    """
    text = text.strip()
    match = _NUMBER.fullmatch(text) if len(text) <= MAX_LENGTH else None
    if match is None or (match[2] and not _UNIT.fullmatch(match[2])):
        if _COMMA.match(text[:MAX_LENGTH]):
            raise ValueError(unit.wanted(f"'{_short(text)}' has a comma; write decimals with a point"))
        if _THOUSANDS.fullmatch(text[:MAX_LENGTH]):
            raise ValueError(unit.wanted(f"'{_short(text)}' has a thousands separator; leave it out"))
        raise ValueError(unit.wanted(f"'{_short(text)}' is not {unit.noun}"))
    number, unit_text = float(match[1]), match[2]
    if not unit_text:
        raise ValueError(unit.wanted(f"'{_short(text)}' has no unit"))
    value = float(f"{number * _factor(unit_text, unit):.12g}")  # 0.1 + 0.2 is nobody's mass
    if not math.isfinite(value):
        raise ValueError(unit.wanted(f"'{_short(text)}' is too large"))
    return value


def in_unit_of(text: str, value: float) -> str:
    """A value, in its dimension's own unit, as it would be written beside a text: 1 beside "101 %" is "100 %".

    Nought, and what stands beside no quantity, has no unit.
    """
    match = _NUMBER.fullmatch(text.strip()) if len(text) <= MAX_LENGTH else None
    if value and match is not None and _UNIT.fullmatch(match[2]):
        for unit in (MASS, DURATION, LENGTH, ANGLE, VOLUME, DENSITY, SPEED, RATIO):
            with suppress(ValueError):
                return f"{value / _factor(match[2], unit):.12g} {match[2]}"
    return f"{value:.12g}"


def _short(text: str) -> str:
    return text if len(text) <= 40 else text[:39] + "…"


MASS = Unit("mg", "mass", '"50 mg" or "3 g"')
DURATION = Unit("s", "duration", '"30 s" or "5 min"')
LENGTH = Unit("mm", "length", '"80 mm" or "0.3 m"')
ANGLE = Unit("degree", "angle", '"26 deg"')
VOLUME = Unit("mm**3", "volume", '"0.5 cm^3" or "2 mL"')
DENSITY = Unit("mg/mm**3", "density", '"1.5 g/cm^3"')
SPEED = Unit("mm/s", "speed", '"50 mm/s"')
RATIO = Unit("dimensionless", "ratio", '"1 %"')

Milligrams = Annotated[float, MASS]
Seconds = Annotated[float, DURATION]
Millimetres = Annotated[float, LENGTH]
Degrees = Annotated[float, ANGLE]
CubicMillimetres = Annotated[float, VOLUME]
MilligramsPerCubicMillimetre = Annotated[float, DENSITY]
MillimetresPerSecond = Annotated[float, SPEED]
Ratio = Annotated[float, RATIO]

SUFFIXES = ("_mg_per_mm3", "_mm_per_s", "_mm3", "_deg", "_mg", "_mm", "_s", "_ratio")

NOT_WRITTEN: dict[str, Any] = {"written": False}
"""The `json_schema_extra` of a field that the engine fills in: no file gives it."""


def plain_name(field_name: str) -> str:
    """The name a user writes for a field: `mass_mg` is `mass` in YAML; a number per unit keeps it, `deg_per_mm`."""
    for suffix in SUFFIXES:
        plain = field_name.removesuffix(suffix)
        if plain != field_name and not plain.endswith("_per"):
            return plain
    return field_name


def counted(count: int, noun: str) -> str:
    """So many of something whose plural ends in s: "1 sample", "2 samples"."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def listed(names: Sequence[str], noun: str) -> str:
    """Names as people read them: of many the first ones, the last, and how many they are."""
    if len(names) <= MOST_LISTED:
        return ", ".join(names)
    return f"{', '.join(names[:3])}, …, {names[-1]} ({counted(len(names), noun)})"


def format_mass(mass_mg: float) -> str:
    """A mass as people read it: mg below 1 g, else g, both to 0.1 mg."""
    return f"{mass_mg:.1f} mg" if abs(mass_mg) < 1000 else f"{mass_mg / 1000:.4f} g"


def format_tolerance(tolerance_mg: float) -> str:
    """A tolerance as people read it: its three leading digits, in mg, without the unit."""
    return f"{float(f'{tolerance_mg:.3g}'):g}"


def format_below(share: float, limit: float) -> str:
    """A share that is below a limit: in whole percents, or rounded down to a tenth where those would say the limit."""
    told = f"{share:.0%}"
    return told if told != f"{limit:.0%}" else f"{math.floor(1000.0 * share) / 10.0:.1f}%"


def format_duration(duration_s: float) -> str:
    """A duration as people read it: "42 s", "3 min 05 s", "2 h 10 min"."""
    if math.isinf(duration_s):
        return "for ever"
    seconds = round(duration_s)
    if seconds < 60:
        return f"{seconds} s"
    if seconds < 3600:
        return f"{seconds // 60} min {seconds % 60:02d} s"
    return f"{seconds // 3600} h {seconds % 3600 // 60:02d} min"
