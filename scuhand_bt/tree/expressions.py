"""Expressions over a workflow's values: `0.25 * $first.dispensed`, `min($mass, 50 mg)`, `$dose.error > 1 mg`.

The grammar below is all there is; no text is ever handed to Python. It is parsed by lark, which reports columns and
can read `50 mg` as one token, as Python's `ast` cannot. A number with a unit becomes a quantity in the engine's unit
(mg, mm, s, degrees). These units are coherent: products and quotients get their dimension from pint, and sums and
comparisons need equal dimensions.
"""

import math
import operator
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import TYPE_CHECKING, Any, TypeAlias

from scuhand_bt import quantity
from scuhand_bt.problems import Mark, shorten
from scuhand_bt.quantity import Dimension
from scuhand_bt.tree.wires import INPUT_TYPES, QUANTITIES, WireType

if TYPE_CHECKING:
    from lark import Lark, Token

GRAMMAR = r"""
?start: either
?either: both ("or" both)*
?both: negation ("and" negation)*
?negation: "not" negation -> negated | comparison
?comparison: sum (COMPARE sum)?
?sum: product (ADD product)*
?product: factor (TIMES factor)*
?factor: MINUS factor | atom
?atom: REFERENCE | QUANTITY | TEXT | "(" either ")" | call
call: NAME "(" sum ("," sum)* ")"
COMPARE: "<=" | ">=" | "==" | "!=" | "<" | ">"
ADD: "+" | "-"
MINUS: "-"
TIMES: "*" | "/"
REFERENCE: /\$[A-Za-z_]\w*(\.[A-Za-z_]\w*)*/
NAME: /(?!(and|or|not)\b)[a-z]+(?=\s*\()/
TEXT: /'[^']*'/ | /"[^"]*"/
QUANTITY: /(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?(\s*(?!(and|or|not)\b)%UNIT%(\/%UNIT%)?)?/
%ignore /\s+/
""".replace("%UNIT%", r"(%|[A-Za-zµμ°]+(\^?[23]|[²³])?)")
ARITHMETIC: dict[str, Callable[[Any, Any], Any]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
}
COMPARISONS: dict[str, Callable[[Any, Any], Any]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "==": operator.eq,
    "!=": operator.ne,
}
FUNCTIONS: dict[str, Callable[[Sequence[Any]], float]] = {"min": min, "max": max, "sum": math.fsum, "count": len}
"""They take several values, or one list; `count` takes only a list."""
LONGEST = 300
"""Most characters of an expression."""

NUMBER: Dimension = ()
Range: TypeAlias = tuple[float, float]
"""The least and the greatest value that a number may have."""
ANY_NUMBER: Range = (-math.inf, math.inf)


@dataclass(frozen=True, slots=True)
class Reference:
    """A value by name: `$name.attribute.attribute`."""

    mark: Mark
    name: str
    attributes: tuple[str, ...]

    def __str__(self) -> str:
        return "$" + ".".join((self.name, *self.attributes))


@dataclass(frozen=True, slots=True)
class Constant:
    """A number, a quantity in the engine's unit, or a text."""

    type: str
    value: float | str
    text: str

    def __str__(self) -> str:
        return self.text


@dataclass(frozen=True, slots=True)
class Operation:
    """An operator with its operands, or a function with its arguments."""

    sign: str
    parts: tuple["Term", ...]

    def __str__(self) -> str:
        if self.sign in FUNCTIONS:
            return f"{self.sign}({', '.join(map(str, self.parts))})"
        if len(self.parts) == 1:
            return f"{self.sign} {self.parts[0]}".replace("- ", "-")
        return f" {self.sign} ".join(f"({part})" if isinstance(part, Operation) else str(part) for part in self.parts)


Term: TypeAlias = Reference | Constant | Operation
TypeOf: TypeAlias = Callable[[Reference], WireType | None]


@dataclass(frozen=True, slots=True)
class _Kind:
    """The type of a term, and its dimension if it is a number."""

    dimension: Dimension | None
    wire: WireType
    is_whole: bool = False

    def __str__(self) -> str:
        return f"{'an' if self.wire.name[0] in 'AEIOU' else 'a'} {self.wire.name}"


@dataclass(frozen=True, slots=True)
class Expression:
    """An expression. It is evaluated each time the node that contains it begins."""

    mark: Mark
    text: str
    root: Operation

    def __str__(self) -> str:
        return self.text

    @property
    def references(self) -> Iterator[Reference]:
        """All values that it reads."""
        todo: list[Term] = [self.root]
        while todo:
            term = todo.pop(0)
            if isinstance(term, Reference):
                yield term
            elif isinstance(term, Operation):
                todo += term.parts

    def type(self, type_of: TypeOf) -> WireType | None:
        """Its type; None if that of a value is unknown. Raises ValueError, worded for the user, if it is ill-typed."""
        kind = _kind(self.root, type_of)
        if kind is not None and kind.dimension is not None and kind.wire.name == UNNAMED:
            raise ValueError("its result is not a known kind of quantity")
        return kind.wire if kind is not None else None

    def value(self, read: Callable[[Reference], Any]) -> Any:
        """Its value. Raises ValueError if it has none: a division by 0, or the minimum of an empty list."""
        found = _value(self.root, read)
        if isinstance(found, float) and not math.isfinite(found):
            raise ValueError(f"{self.text} gives {found}")
        return found

    def range(self, range_of: Callable[[Reference], Range]) -> Range:
        """Bounds of its value by interval arithmetic, from the bounds of the values that it reads."""
        return _range(self.root, range_of)


def fits(wire: WireType, given: WireType) -> bool:
    """Whether an expression's value may flow into a wire. Unlike a reference, a plain number also fits a ratio."""
    return wire.accepts(given) or (wire.name == "Ratio" and given.name in ("Number", "Integer"))


def parse_expression(text: str, mark: Mark) -> Expression | Reference:
    """Parse an expression; a lone reference is returned as such. Raises ValueError, worded for the user."""
    if len(text) > LONGEST:
        raise ValueError(f"it is longer than {LONGEST} characters")
    from lark.exceptions import UnexpectedCharacters, UnexpectedEOF, UnexpectedToken

    try:
        root = _term(_tree(text), mark)
    except UnexpectedCharacters as error:
        raise ValueError(f"'{shorten(text[error.pos_in_stream or 0 :], 20)}' cannot be read") from None
    except UnexpectedEOF:
        raise ValueError(_ends_early(text)) from None
    except UnexpectedToken as error:
        raise ValueError(
            f"'{shorten(str(error.token), 20)}' is out of place" if error.token else _ends_early(text)
        ) from None
    if isinstance(root, Reference):
        return root
    if not isinstance(root, Operation):
        raise ValueError("it uses no value of the workflow")
    return Expression(mark, text, root)


def _ends_early(text: str) -> str:
    if text.count("(") > text.count(")"):
        return "a ')' is missing; inside { }, put a text with a comma in quotes"
    return "something is missing at its end"


@cache
def _parser() -> "Lark":
    from lark import Lark

    return Lark(GRAMMAR, parser="lalr", maybe_placeholders=False)


@lru_cache(maxsize=1024)  # a lab is read again by each command of a server, and by each test
def _tree(text: str) -> Any:
    return _parser().parse(text)


def _term(tree: Any, mark: Mark) -> Term:
    """Convert lark's tree to ours. Raises ValueError for an unknown unit or function."""
    from lark import Token

    if isinstance(tree, Token):
        return _atom(tree, mark)
    if tree.data == "call":
        name = str(tree.children[0])
        if name not in FUNCTIONS:
            raise ValueError(f"unknown function '{shorten(name)}'; known: {', '.join(FUNCTIONS)}")
        return Operation(name, tuple(_term(child, mark) for child in tree.children[1:]))
    if tree.data in ("either", "both"):
        sign = {"either": "or", "both": "and"}[tree.data]
        return Operation(sign, tuple(_term(child, mark) for child in tree.children))
    if tree.data == "negated":
        return Operation("not", (_term(tree.children[0], mark),))
    if tree.data == "factor":
        return Operation("-", (_term(tree.children[1], mark),))
    found, *rest = tree.children
    term = _term(found, mark)
    for sign, operand in zip(rest[::2], rest[1::2], strict=True):
        term = Operation(str(sign), (term, _term(operand, mark)))
    return term


def _atom(token: "Token", mark: Mark) -> Term:
    text = str(token)
    if token.type == "REFERENCE":
        name, *attributes = text[1:].split(".")
        return Reference(mark, name, tuple(attributes))
    if token.type == "TEXT":
        return Constant("Text", text[1:-1], text)
    if text.replace(".", "").isdigit() or ("e" in text.lower() and not text.lower().strip("0123456789.e+-")):
        whole = text.isdigit()
        return Constant("Integer" if whole else "Number", int(text) if whole else float(text), text)
    for name, unit in QUANTITIES.items():
        try:
            return Constant(name, quantity.parse(text, unit), text)
        except ValueError:
            continue
    raise ValueError(f"'{shorten(text)}' has no known unit")


# --- types

UNNAMED = "quantity without a name"


def _kind(term: Term, type_of: TypeOf) -> _Kind | None:
    """The type of a term; None if that of a value is unknown. Raises ValueError if it is ill-typed."""
    if isinstance(term, Constant):
        return _of_wire(INPUT_TYPES[term.type], str(term))
    if isinstance(term, Reference):
        wire = type_of(term)
        return None if wire is None else _of_wire(wire, str(term))
    found = [_kind(part, type_of) for part in term.parts]
    kinds = [kind for kind in found if kind is not None]
    if term.sign == "count" and len(kinds) == len(found):
        if len(kinds) != 1 or kinds[0].wire.item is None:
            raise ValueError(f"{term} needs a list")
        return _of_wire(INPUT_TYPES["Integer"])
    if len(kinds) < len(found):
        return None
    if term.sign in ("and", "or", "not"):
        for kind, part in zip(kinds, term.parts, strict=True):
            if kind.wire.name != "Flag":
                raise ValueError(f"{part} is {kind}, but '{term.sign}' takes only what is true or false")
        return kinds[0]
    if term.sign in COMPARISONS:
        return _compared(term, *kinds)
    if term.sign in FUNCTIONS and len(kinds) == 1 and (item := kinds[0].wire.item) is not None:
        kinds = [_of_wire(item, f"an item of {term.parts[0]}")]
    elif term.sign in FUNCTIONS and len(kinds) == 1:
        raise ValueError(f"{term} has one value; give it several, or a list")
    return _reckoned(term, kinds)


def _reckoned(term: Operation, kinds: Sequence[_Kind]) -> _Kind:
    """The type of an arithmetic operation on these types."""
    dimensions = []
    for kind, part in zip(kinds, term.parts, strict=False):
        if kind.dimension is None:
            raise ValueError(f"{part} is {kind}, which cannot be calculated with")
        dimensions.append(kind.dimension)
    is_whole = all(kind.is_whole for kind in kinds)
    if term.sign in ("*", "/"):
        power = 1 if term.sign == "*" else -1
        return _of_dimension(quantity.times(dimensions[0], dimensions[1], power), is_whole and power > 0)
    for kind, part, dimension in zip(kinds, term.parts, dimensions, strict=False):
        if dimension != dimensions[0]:
            raise ValueError(f"{term.parts[0]} is {kinds[0]} and {part} is {kind}, which do not go together")
    return _of_dimension(dimensions[0], is_whole)


def _compared(term: Operation, first: _Kind, second: _Kind) -> _Kind:
    is_equality = term.sign in ("==", "!=")
    a, b = term.parts
    if first.dimension is not None and second.dimension is not None:
        if first.dimension != second.dimension:
            raise ValueError(f"{a} is {first} and {b} is {second}, which do not go together")
        if is_equality and not (first.is_whole and second.is_whole):
            raise ValueError(f"{a} and {b} are measured, and never equal to the last digit; compare them with < or >")
    elif first.wire.name != second.wire.name or first.wire.name not in ("Text", "Flag"):
        raise ValueError(f"{a} is {first} and {b} is {second}, which cannot be compared")
    elif not is_equality:
        raise ValueError(f"{a} is {first}: compare it with == or !=")
    for kind, other in ((first, b), (second, a)):
        if isinstance(other, Constant) and kind.wire.name == "Text":
            kind.wire.read(other.value)  # raises if the text is not among the words of a Literal
    return _of_wire(INPUT_TYPES["Flag"])


def _of_wire(wire: WireType, what: str = "") -> _Kind:
    if wire.optional:
        raise ValueError(f"{what} may be nothing")
    if wire.name in QUANTITIES:
        return _Kind(quantity.dimension(QUANTITIES[wire.name]), wire)
    return _Kind(NUMBER if wire.name in ("Number", "Integer") else None, wire, wire.name == "Integer")


def _of_dimension(dimension: Dimension, is_whole: bool) -> _Kind:
    if dimension == NUMBER:
        return _Kind(NUMBER, INPUT_TYPES["Integer" if is_whole else "Number"], is_whole)
    for name, unit in QUANTITIES.items():
        if quantity.dimension(unit) == dimension:
            return _Kind(dimension, INPUT_TYPES[name])
    return _Kind(dimension, WireType(UNNAMED, float))


# --- values


def _value(term: Term, read: Callable[[Reference], Any]) -> Any:
    if isinstance(term, Constant):
        return term.value
    if isinstance(term, Reference):
        return read(term)
    if term.sign in ("and", "or"):
        return (all if term.sign == "and" else any)(_value(part, read) for part in term.parts)
    values = [_value(part, read) for part in term.parts]
    if term.sign in FUNCTIONS:
        several = values[0] if isinstance(values[0], list | tuple) else values
        if not several and term.sign in ("min", "max"):
            raise ValueError(f"the list of {term} is empty")
        return FUNCTIONS[term.sign](several)
    if len(values) == 1:
        return not values[0] if term.sign == "not" else -values[0]
    first, second = values
    if term.sign in COMPARISONS:
        return COMPARISONS[term.sign](first, second)
    if term.sign == "/" and second == 0:
        raise ValueError(f"{term} divides by 0")
    return ARITHMETIC[term.sign](first, second)


def _range(term: Term, range_of: Callable[[Reference], Range]) -> Range:
    if isinstance(term, Constant):
        return (term.value, term.value) if isinstance(term.value, int | float) else ANY_NUMBER
    if isinstance(term, Reference):
        return range_of(term)
    ranges = [_range(part, range_of) for part in term.parts]
    if term.sign in ("min", "max") and len(ranges) > 1:
        of = FUNCTIONS[term.sign]
        return of([low for low, _ in ranges]), of([high for _, high in ranges])
    if term.sign == "sum" and len(ranges) > 1:
        return sum(low for low, _ in ranges), sum(high for _, high in ranges)
    if term.sign == "-" and len(ranges) == 1:
        return -ranges[0][1], -ranges[0][0]
    if term.sign not in ARITHMETIC:
        return ANY_NUMBER
    (a_low, a_high), (b_low, b_high) = ranges
    if term.sign == "+":
        return a_low + b_low, a_high + b_high
    if term.sign == "-":
        return a_low - b_high, a_high - b_low
    if term.sign == "/":
        if b_low <= 0.0 <= b_high:
            return ANY_NUMBER
        b_low, b_high = 1.0 / b_high, 1.0 / b_low
    corners = [a * b for a in (a_low, a_high) for b in (b_low, b_high)]
    known = [corner for corner in corners if not math.isnan(corner)]  # nan is 0 times infinity
    return (min(known), max(known)) if known else (0.0, 0.0)
