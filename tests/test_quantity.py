"""Quantities as people write them, at the border between text and floats."""

import math
import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scuhand_bt import quantity
from scuhand_bt.quantity import ANGLE, DENSITY, DURATION, LENGTH, MASS, RATIO, SPEED, VOLUME, Unit, in_unit_of, parse

UNITS = [MASS, DURATION, LENGTH, ANGLE, VOLUME, DENSITY, SPEED, RATIO]


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("50 mg", MASS, 50.0),
        ("50mg", MASS, 50.0),
        ("  0.05 g ", MASS, 50.0),
        (".5 g", MASS, 500.0),
        ("5. g", MASS, 5000.0),
        ("1e3 µg", MASS, 1.0),
        ("1e3 μg", MASS, 1.0),
        ("+3 grams", MASS, 3000.0),
        ("0.3 g", MASS, 300.0),
        ("2 h", DURATION, 7200.0),
        ("100 ms", DURATION, 0.1),
        ("5 min", DURATION, 300.0),
        ("0.3 m", LENGTH, 300.0),
        ("26°", ANGLE, 26.0),
        ("26 deg", ANGLE, 26.0),
        ("0.5 cm^3", VOLUME, 500.0),
        ("0.5 cm³", VOLUME, 500.0),
        ("0.5 cm3", VOLUME, 500.0),
        ("2 mL", VOLUME, 2000.0),
        ("1.5 g/cm^3", DENSITY, 1.5),
        ("1500 kg/m**3", DENSITY, 1.5),
        ("5 cm/s", SPEED, 50.0),
        ("1 %", RATIO, 0.01),
    ],
)
def test_a_number_with_a_unit_is_read_in_the_fields_unit(text: str, unit: Unit, value: float) -> None:
    assert parse(text, unit) == value


@pytest.mark.parametrize(
    ("text", "unit", "said"),
    [
        ("50", MASS, "'50' has no unit; write a mass with its unit"),
        ("50 mm", MASS, "'mm' is a unit of length, not of mass"),
        ("5 %", ANGLE, "'%' is a unit of ratio, not of angle; write an angle"),
        ("5 deg", RATIO, "'deg' is a unit of angle, not of ratio"),
        ("5 g/s^2", MASS, "'g/s^2' is not a unit of mass"),
        ("5 stones", MASS, "'stones' is not a known unit"),
        ("5 nan", MASS, "'nan' is not a known unit"),
        ("1,5 g", MASS, "'1,5 g' has a comma; write decimals with a point"),
        ("12,34,5 g", MASS, "'12,34,5 g' is not a mass"),
        ("heavy", MASS, "'heavy' is not a mass"),
        ("", MASS, "'' is not a mass"),
        ("nan", MASS, "'nan' is not a mass"),
        ("1e999 g", MASS, "too large"),
        ("2 × 3 g", MASS, "is not a mass"),
        ("1 g + 1 g", MASS, "is not a mass"),
    ],
)
def test_what_is_no_such_quantity_is_refused_in_words(text: str, unit: Unit, said: str) -> None:
    with pytest.raises(ValueError, match=r"write an? ") as caught:
        parse(text, unit)
    assert said in str(caught.value)


@pytest.mark.parametrize("text", ["1.234,5 g", "1,234.5 mg", "1 234 mg", "1\u202f234,5", "1'234.5 mg", "1.234.567 mg"])
def test_a_sign_for_thousands_is_called_one(text: str) -> None:
    with pytest.raises(ValueError, match="has a thousands separator; leave it out"):
        parse(text, MASS)


def is_read_or_refused(text: str, unit: Unit) -> bool:
    try:
        return math.isfinite(parse(text, unit))
    except ValueError as error:
        return unit.examples in str(error)


@given(st.text(max_size=80), st.sampled_from(UNITS))
def test_any_text_is_a_finite_number_or_a_value_error(text: str, unit: Unit) -> None:
    assert is_read_or_refused(text, unit)


@given(
    st.floats(-1e12, 1e12),
    st.text("abcdefghijklmnopqrstuvwxyzµμ°%GLNH/23^*²³", max_size=12),
    st.sampled_from(UNITS),
)
def test_any_unit_is_known_or_refused(number: float, unit_text: str, unit: Unit) -> None:
    assert is_read_or_refused(f"{number:g} {unit_text}", unit)


def test_a_text_of_megabytes_is_refused_at_once_and_shown_short() -> None:
    for text in ("1" + " " * 1_000_000 + "x", "1 g" + " x" * 1_000_000, "9" * 1_000_000):
        with pytest.raises(ValueError, match="is not a mass") as caught:
            parse(text, MASS)
        assert len(str(caught.value)) < 200


@given(st.floats(0.001, 1e6))
def test_what_is_formatted_as_a_mass_reads_back(mass_mg: float) -> None:
    assert parse(quantity.format_mass(mass_mg), MASS) == pytest.approx(mass_mg, abs=0.051)


def test_what_is_below_a_limit_is_shown_below_it() -> None:
    shares = (0.5, 0.894, 0.8949, 0.895, 0.896, 0.89999)
    told = ["50%", "89%", "89%", "89.5%", "89.6%", "89.9%"]
    assert [quantity.format_below(share, 0.9) for share in shares] == told


def test_durations_are_shown_as_people_say_them() -> None:
    assert [quantity.format_duration(s) for s in (42, 59.6, 185, 7800)] == [
        "42 s",
        "1 min 00 s",
        "3 min 05 s",
        "2 h 10 min",
    ]


def test_a_field_loses_the_suffix_of_its_unit_in_yaml() -> None:
    names = ["mass_mg", "speed_mm_per_s", "capacity_mm3", "bulk_density_mg_per_mm3", "repose_deg", "tag"]
    assert [quantity.plain_name(name) for name in names] == [
        "mass",
        "speed",
        "capacity",
        "bulk_density",
        "repose",
        "tag",
    ]


def test_pint_is_loaded_with_the_first_unit_and_not_before() -> None:
    code = """
import sys
import scuhand_bt.cli
from scuhand_bt.quantity import MASS, parse
print("pint" in sys.modules)
parse("50 mg", MASS)
print("pint" in sys.modules)
"""
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert ended.stdout.split() == ["False", "True"]


@pytest.mark.parametrize(
    ("text", "bound", "said"),
    [
        *(
            ("101 %", 1.0, "100 %"),
            ("1600g/cm^3", 23.0, "23 g/cm^3"),
            ("5 m", 200.0, "0.2 m"),
            ("200 deg", 180.0, "180 deg"),
        ),
        *(("0 g", 0.0, "0"), ("7", 5, "5"), ("many", 5, "5"), ("5 stones", 5, "5"), ("9" * 100 + " g", 5, "5")),
    ],
)
def test_a_bound_is_told_in_the_unit_of_what_was_written(text: str, bound: float, said: str) -> None:
    assert in_unit_of(text, bound) == said
