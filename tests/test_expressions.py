"""What is worked out of a workflow's values: what may be written, of which type it is, what it comes to, its bounds."""

import math
from typing import Any

import pytest

from scuhand_bt.problems import Mark
from scuhand_bt.tree.expressions import Expression, Range, Reference, parse_expression
from scuhand_bt.tree.wires import INPUT_TYPES, WireType, list_of

TYPES: dict[str, WireType] = {
    **{name.lower(): wire for name, wire in INPUT_TYPES.items()},
    "masses": list_of(INPUT_TYPES["Mass"]),
    "maybe": WireType("Mass", float, optional=True),
}
VALUES: dict[str, Any] = {"mass": 50.0, "ratio": 0.25, "integer": 3, "flag": False, "text": "a", "masses": (20.0, 30.0)}
VALUES |= {"density": 1.5, "volume": 200.0, "duration": 4.0, "number": 0.0, "none": ()}


def expression(text: str) -> Expression:
    found = parse_expression(text, Mark("x.yaml"))
    assert isinstance(found, Expression)
    return found


def type_of(reference: Reference) -> WireType:
    wire = TYPES[reference.name]
    for attribute in reference.attributes:
        wire = wire.attributes()[attribute][1]
    return wire


def read(reference: Reference) -> Any:
    return VALUES[reference.name]


@pytest.mark.parametrize(
    ("text", "type_name", "value"),
    [
        ("0.25 * $mass", "Mass", 12.5),
        ("$mass / 4", "Mass", 12.5),
        ("$ratio * $mass", "Mass", 12.5),
        ("25 % * $mass", "Mass", 12.5),
        ("$mass - 1 g", "Mass", -950.0),
        ("$mass - 20 mg - 10 mg", "Mass", 20.0),
        ("$mass - (20 mg - 10 mg)", "Mass", 40.0),
        ("-$mass + 2 * $mass", "Mass", 50.0),
        ("2 + 3 * $integer", "Integer", 11),
        ("$integer / 2", "Number", 1.5),
        ("$mass / 100 mg", "Number", 0.5),
        ("$density * $volume", "Mass", 300.0),
        ("$mass / $density", "Volume", 50 / 1.5),
        ("$mass * $mass / $mass", "Mass", 50.0),
        ("1e2 * $mass", "Mass", 5000.0),
        ("min($mass, 0.02 g)", "Mass", 20.0),
        ("max($mass, 20 mg, 3 mg)", "Mass", 50.0),
        ("sum($masses)", "Mass", 50.0),
        ("min($masses)", "Mass", 20.0),
        ("count($masses) * $mass", "Mass", 100.0),
        ("$mass > 20 mg", "Flag", True),
        ("$mass >= 50 mg", "Flag", True),
        ("$mass < 50 mg", "Flag", False),
        ("$integer == 3", "Flag", True),
        ("$integer != 3", "Flag", False),
        ("$text == 'a'", "Flag", True),
        ('$text != "a b"', "Flag", True),
        ("not $flag", "Flag", True),
        ("$flag or $mass > 20 mg and not $flag", "Flag", True),
        ("not ($flag or $mass > 20 mg)", "Flag", False),
        ("$integer == 2 or $integer == 3", "Flag", True),
    ],
)
def test_what_is_worked_out_has_a_type_and_a_value(text: str, type_name: str, value: Any) -> None:
    found = expression(text)
    wire = found.type(type_of)
    assert wire is not None
    assert wire.name == type_name
    assert found.value(read) == pytest.approx(value)
    assert type(found.value(read)) is type(value)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("$mass +", "something is missing at its end"),
        ("min($mass", "a ')' is missing; inside { }, put a text with a comma in quotes"),
        ("$mass $mass", "'$mass' is out of place"),
        ("$mass ** 2", "'*' is out of place"),
        ("$mass; 3", "'; 3' cannot be read"),
        ("$mass.__class__()", "out of place"),
        ("open($text)", "unknown function 'open'; known: min, max, sum, count"),
        ("$mass + 3 furlongs", "'3 furlongs' has no known unit"),
        ("2 * 3 mg", None),
        ("3 mg", "it uses no value of the workflow"),
        ("$mass + " * 60 + "1 g", "longer than 300 characters"),
    ],
)
def test_what_cannot_be_read_is_told_and_nothing_else_is_run(text: str, why: str | None) -> None:
    if why is None:
        assert not list(expression(text).references)
        return
    with pytest.raises(ValueError, match=r".+") as error:
        parse_expression(text, Mark("x.yaml"))
    assert why in str(error.value)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("$mass + $duration", "$mass is a Mass and $duration is a Duration, which do not go together"),
        ("$mass - 3", "$mass is a Mass and 3 is an Integer"),
        ("min($mass, 3 s)", "$mass is a Mass and 3 s is a Duration"),
        ("$mass < 3 s", "which do not go together"),
        ("$mass * $mass", "its result is not a known kind of quantity"),
        ("$mass / $duration", "not a known kind of quantity"),
        ("$mass == 3 mg", "never equal to the last digit; compare them with < or >"),
        ("$number == 3", "compare them with < or >"),
        ("$text < 'b'", "compare it with == or !="),
        ("$text == 3", "which cannot be compared"),
        ("$dose == $dose", "which cannot be compared"),
        ("$text + $text", "$text is a Text, which cannot be calculated with"),
        ("$dose * 2", "$dose is a Dose, which cannot be calculated with"),
        ("$flag + 1", "$flag is a Flag, which cannot be calculated with"),
        ("$mass and $flag", "$mass is a Mass, but 'and' takes only what is true or false"),
        ("not $mass", "'not' takes only what is true or false"),
        ("min($mass)", "has one value; give it several, or a list"),
        ("count($mass)", "count($mass) needs a list"),
        ("$masses * 2", "$masses is a [Mass], which cannot be calculated with"),
        ("2 * $maybe", "$maybe may be nothing"),
        ("$dose.verdict == 'ovr'", "write 'in tolerance', 'under' or 'over'"),
    ],
)
def test_what_does_not_go_together_is_told(text: str, why: str) -> None:
    with pytest.raises(ValueError, match=r".+") as error:
        expression(text).type(type_of)
    assert why in str(error.value)


def test_a_type_that_is_not_known_makes_none_known() -> None:
    assert expression("2 * $mass").type(lambda reference: None) is None
    assert expression("min($mass, 3 mg)").type(lambda reference: None) is None


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("$mass / $number", "$mass / $number divides by 0"),
        ("max($none)", r"the list of max\($none\) is empty"),
        ("$mass * 1e300 * 1e300", "gives inf"),
    ],
)
def test_what_has_no_value_is_told(text: str, why: str) -> None:
    with pytest.raises(ValueError, match=why.replace("$", r"\$")):
        expression(text).value(read)


RANGES: dict[str, Range] = {"a": (2.0, 3.0), "b": (-1.0, 4.0), "none": (0.0, 0.0), "any": (-math.inf, math.inf)}


@pytest.mark.parametrize(
    ("text", "least", "most"),
    [
        ("$a + $b", 1.0, 7.0),
        ("$a - $b", -2.0, 4.0),
        ("-$b", -4.0, 1.0),
        ("$a * $b", -3.0, 12.0),
        ("$b / $a", -0.5, 2.0),
        ("$a / $b", -math.inf, math.inf),
        ("min($any, 50, $a)", -math.inf, 3.0),
        ("max($any, 50, $a)", 50.0, math.inf),
        ("sum($a, $b)", 1.0, 7.0),
        ("2 * $any", -math.inf, math.inf),
        ("$none * $any", 0.0, 0.0),
        ("min(2 * $any, 7) + 1", -math.inf, 8.0),
        ("count($a)", -math.inf, math.inf),
    ],
)
def test_bounds_of_what_is_worked_out_hold_whatever_its_values(text: str, least: float, most: float) -> None:
    assert expression(text).range(lambda reference: RANGES[reference.name]) == pytest.approx((least, most))


def test_a_lone_reference_is_itself() -> None:
    assert str(parse_expression("$a.b.c", Mark("x.yaml"))) == "$a.b.c"
    assert isinstance(parse_expression("$a.b.c", Mark("x.yaml")), Reference)
