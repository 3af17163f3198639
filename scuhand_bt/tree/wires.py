"""The types of a workflow's wires: what may be connected to what, and how a literal is read.

A wire type is a quantity (Mass, Duration, …), a plain value (Number, Integer, Text, Flag), a list, or a class whose
attributes can be read (`$source.powder`): Source, Container, Powder, Dose, or a lab's own.
"""

import inspect
import types
import typing
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from pydantic import AllowInfNan, BaseModel, Field, FiniteFloat, TypeAdapter, ValidationError

from scuhand_bt import quantity
from scuhand_bt.events.doses import Dose
from scuhand_bt.quantity import Unit, plain_name
from scuhand_bt.specs import Container, OnPan, Powder, Source
from scuhand_bt.validation import refusal


@dataclass(frozen=True)
class WireType:
    """One type. Types are equal if name, `is_class` and `optional` are."""

    name: str
    python: Any = field(compare=False, hash=False)
    is_class: bool = False
    optional: bool = False
    item: "WireType | None" = field(default=None, compare=False)
    """For a list, the type of its items."""

    @property
    def is_on_pan(self) -> bool:
        """Whether it is a mass that is put on the pan as it is."""
        return any(isinstance(one, OnPan) for one in getattr(self.python, "__metadata__", ()))

    def accepts(self, given: "WireType") -> bool:
        """Whether a value of type `given` may flow into this one."""
        if given.optional and not self.optional:
            return False
        if self.item is not None and given.item is not None:
            return self.item.accepts(given.item)
        if self.is_class and given.is_class:
            return inspect.isclass(given.python) and issubclass(given.python, self.python)
        return self.name == given.name or (self.name, given.name) == ("Number", "Integer") or self.name == "Any"

    def attributes(self) -> Mapping[str, tuple[str, "WireType"]]:
        """The attributes that can be read: name in YAML -> (name in Python, type)."""
        return _attributes(self.python) if self.is_class else {}

    def read(self, value: Any) -> Any:
        """The value of a literal (str, None, list or dict from YAML). Raises ValueError, worded for the user."""
        try:
            return self._adapter.validate_python(value)
        except ValidationError as error:
            raise ValueError(in_words(error)) from None

    @cached_property
    def _adapter(self) -> TypeAdapter[Any]:
        return TypeAdapter(self.python)


def in_words(error: ValidationError) -> str:
    """Why pydantic refuses a value, on one line."""
    found = []
    for item in error.errors(include_url=False):
        name = ".".join(map(str, item["loc"]))
        found.append((f"'{name}': " if name else "") + refusal(item))
    return "; ".join(found)


QUANTITIES = {
    "Mass": quantity.MASS,
    "Duration": quantity.DURATION,
    "Length": quantity.LENGTH,
    "Angle": quantity.ANGLE,
    "Volume": quantity.VOLUME,
    "Density": quantity.DENSITY,
    "Speed": quantity.SPEED,
    "Ratio": quantity.RATIO,
}

LARGEST = 1_000_000_000
"""Largest integer accepted; more is taken as a typing error."""

INPUT_TYPES: Mapping[str, WireType] = {
    **{name: WireType(name, typing.Annotated[float, unit]) for name, unit in QUANTITIES.items()},
    "Number": WireType("Number", FiniteFloat),
    "Integer": WireType("Integer", typing.Annotated[int, Field(ge=-LARGEST, le=LARGEST)]),
    "Text": WireType("Text", str),
    "Flag": WireType("Flag", bool),
    **{cls.__name__: WireType(cls.__name__, cls, is_class=True) for cls in (Source, Container, Powder, Dose)},
}
"""The types that a workflow may declare for its inputs."""

NOTHING = WireType("nothing", type(None))


def list_of(item: WireType) -> WireType:
    """The type of a list, written [Mass]."""
    return WireType(f"[{item.name}]", list[item.python], item=item)  # type: ignore[name-defined]


def of_field(annotation: Any, metadata: tuple[Any, ...] | list[Any] = ()) -> WireType:
    """The wire type of a Python annotation. Pydantic keeps it as the bare type and its metadata."""
    if typing.get_origin(annotation) is typing.Annotated:
        inner, *more = typing.get_args(annotation)
        return of_field(inner, [*metadata, *more])
    full = typing.Annotated[(annotation, *metadata)] if metadata else annotation
    origin = typing.get_origin(annotation)
    if origin in (typing.Union, types.UnionType):
        members = [member for member in typing.get_args(annotation) if member is not type(None)]
        if len(members) == 1:
            inner = of_field(members[0], metadata)
            return WireType(inner.name, inner.python if inner.is_class else full, inner.is_class, optional=True)
    for mark in metadata:
        if isinstance(mark, Unit):
            return WireType(next(name for name, unit in QUANTITIES.items() if unit == mark), full)
    if annotation in (None, type(None)):
        return NOTHING
    plain = {bool: "Flag", int: "Integer", float: "Number", str: "Text"}.get(annotation)
    if plain == "Number":
        return WireType(plain, typing.Annotated[full, AllowInfNan(False)])
    if plain is not None:
        return WireType(plain, full)
    if origin is typing.Literal:
        return WireType("Text", full)
    if origin in (list, tuple):
        items = [one for one in typing.get_args(annotation) if one is not Ellipsis]
        if len(items) == 1:
            return list_of(of_field(items[0]))
    if inspect.isclass(annotation) and (
        issubclass(annotation, BaseModel) or hasattr(annotation, "__dataclass_fields__")
    ):
        return WireType(annotation.__name__, annotation, is_class=True)
    return WireType("Any" if annotation is Any else str(annotation), full)


def read_attribute(value: Any, name: str) -> Any:
    """The attribute of a value that YAML calls `name`: `mouth` reads `mouth_mm`."""
    return getattr(value, _attributes(type(value))[name][0])


_ATTRIBUTES: dict[type, Mapping[str, tuple[str, WireType]]] = {}


def _attributes(cls: type) -> Mapping[str, tuple[str, WireType]]:
    if cls not in _ATTRIBUTES:
        _ATTRIBUTES[cls] = _find_attributes(cls)
    return _ATTRIBUTES[cls]


def _find_attributes(cls: type) -> Mapping[str, tuple[str, WireType]]:
    found: dict[str, tuple[str, WireType]] = {}
    if issubclass(cls, BaseModel):
        for name, info in cls.model_fields.items():
            found[plain_name(name)] = (name, of_field(info.annotation, info.metadata))
    else:
        for name, hint in typing.get_type_hints(cls, include_extras=True).items():
            found[plain_name(name)] = (name, _by_suffix(name, of_field(hint)))
    for name, member in inspect.getmembers(cls, lambda member: isinstance(member, property)):
        if not name.startswith(("_", "model_")):
            hints = typing.get_type_hints(member.fget, include_extras=True)
            found[plain_name(name)] = (name, of_field(hints.get("return", Any)))
    return {plain: (name, _by_suffix(name, wire)) for plain, (name, wire) in found.items()}


def _by_suffix(name: str, wire: WireType) -> WireType:
    """A plain float whose name ends in a unit is that quantity."""
    if wire.name != "Number":
        return wire
    for suffix, quantity_name in _SUFFIX_TYPES.items():
        if name.endswith(suffix):
            return INPUT_TYPES[quantity_name]
    return wire


_SUFFIX_TYPES = {
    "_mg_per_mm3": "Density",
    "_mm_per_s": "Speed",
    "_mm3": "Volume",
    "_deg": "Angle",
    "_mg": "Mass",
    "_mm": "Length",
    "_s": "Duration",
    "_ratio": "Ratio",
}
