"""A simulated object's state as JSON, and back. Reading makes only data, never an object of a class that a file names.

    number, text, true, false, null, list      unchanged
    {KIND: …}                                  all else: `tuple`, `dict`, `set`, `deque`, `bytes`, numpy's `array` and
                                               `generator`, the balance's `reading`, `object`, and `spec`

An object is written as its class and its attributes. Reading sets them on an object of the same class that the program
has made itself at the same place. So a user's plant needs no method for it, as long as its attributes are data. The
lab's description (a `Spec`) never changes, and is not written.
"""

from collections import deque
from collections.abc import Callable, Iterable, Mapping
from copy import copy
from dataclasses import is_dataclass
from functools import cache
from types import ModuleType
from typing import Any, TypeAlias

import numpy as np
from numpy.random import BitGenerator, Generator

from scuhand_bt.devices.interfaces import Reading
from scuhand_bt.specs import Spec

Plain: TypeAlias = Any
"""Whatever `json` writes and reads."""


class Misplaced(Exception):  # noqa: N818 - it says what was found
    """State that does not fit the objects it is read onto."""


def written(value: object) -> Plain:
    """A value as JSON data. Raises TypeError for what is not data: a function, a file, an object of a C extension."""
    kind = type(value)
    if kind in _AS_THEY_ARE:
        return value
    if kind is list:
        return written_all(value)  # type: ignore[arg-type]
    if (write := _WRITERS.get(kind)) is not None:
        return write(value)
    if isinstance(value, np.generic):
        return written(value.item())
    if isinstance(value, Spec):
        return {"spec": _class_of(value)}
    attributes = _attributes(value)
    return {"object": [_class_of(value), dict(zip(attributes, written_all(attributes.values()), strict=True))]}


def written_all(values: Iterable[object]) -> list[Plain]:
    """Each of them as JSON data, with a short cut for numbers, which most of them are."""
    return [value if type(value) in _AS_THEY_ARE else written(value) for value in values]


def read(plain: Plain, onto: Any = None) -> Any:
    """The value that was written; objects are read onto `onto`, the object at their place.

    A dataclass may be shared as a value, so a copy of it is changed. Raises Misplaced if `onto` is not of the object's
    class; LookupError, TypeError or ValueError for data that `written` never makes.
    """
    if isinstance(plain, list):
        there = onto if isinstance(onto, list) and len(onto) == len(plain) else [None] * len(plain)
        return [read(one, place) for one, place in zip(plain, there, strict=True)]
    if not isinstance(plain, dict):
        return plain
    ((kind, content),) = plain.items()
    return _READERS[kind](content, onto)


def _class_of(value: object) -> str:
    kind: Any = type(value)  # mypy takes a type for unhashable
    return _name_of(kind)


@cache
def _name_of(kind: type) -> str:
    return f"{kind.__module__}.{kind.__qualname__}"


@cache
def _slots_of(kind: type) -> tuple[str, ...]:
    return tuple(name for of in kind.__mro__ for name in vars(of).get("__slots__", ()) if not name.startswith("__"))


def _attributes(value: object) -> dict[str, Any]:
    kind: Any = type(value)
    slots = _slots_of(kind)
    if callable(value) or isinstance(value, ModuleType) or not (slots or hasattr(value, "__dict__")):
        raise TypeError(f"{_class_of(value)} is no data")
    return {name: getattr(value, name) for name in slots if hasattr(value, name)} | getattr(value, "__dict__", {})


def _read_object(content: Plain, onto: Any) -> Any:
    name, attributes = content
    _read_spec(name, onto)
    if is_dataclass(onto):
        onto = copy(onto)
    for field, plain in attributes.items():
        object.__setattr__(onto, field, read(plain, getattr(onto, field, None)))
    return onto


def _read_spec(name: str, onto: Any) -> Any:
    if onto is None or _class_of(onto) != name:
        raise Misplaced(f"there is no {name} where one was")
    return onto


def _read_dict(content: Plain, onto: Any) -> dict[Any, Any]:
    there = onto if isinstance(onto, dict) else {}
    pairs = [(read(key), plain) for key, plain in content]
    return {key: read(plain, there.get(key)) for key, plain in pairs}


def _read_generator(content: Plain, onto: Any) -> Generator:
    state = read(content)
    if isinstance(state, list):
        name, *numbers = state
        at, step, has_uint32, uinteger = (int(number, 16) for number in numbers)
        state = {"bit_generator": name, "state": {"state": at, "inc": step}}
        state |= {"has_uint32": has_uint32, "uinteger": uinteger}
    made = getattr(np.random, state["bit_generator"])
    if not (isinstance(made, type) and issubclass(made, BitGenerator)):
        raise ValueError(f"{made!r} draws no numbers")
    bits = made()
    bits.state = state
    return Generator(bits)


def _reading(value_mg: float, stable: bool, time_s: float, unit: str, raw: str) -> Reading:
    return Reading(value_mg, stable, time_s, unit, raw.encode("latin-1"))


def _written_generator(generator: Generator) -> Plain:
    """For our own bit generator, its numbers in hexadecimal: JSON is slow with integers of 128 bits."""
    state = generator.bit_generator.state
    if state["bit_generator"] != "PCG64":
        return {"generator": written(state)}
    numbers = *state["state"].values(), state["has_uint32"], state["uinteger"]
    return {"generator": ["PCG64", *map(hex, numbers)]}


def _plain_array(array: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    if array.dtype.hasobject:
        raise TypeError("an array of objects is no data")
    return array


_AS_THEY_ARE = frozenset({float, int, str, bool, type(None)})
_WRITERS: Mapping[type, Callable[[Any], Plain]] = {
    tuple: lambda values: {"tuple": written_all(values)},
    dict: lambda values: {"dict": [written_all(pair) for pair in values.items()]},
    set: lambda values: {"set": written_all(values)},
    deque: lambda values: {"deque": [written_all(values), values.maxlen]},
    bytes: lambda value: {"bytes": value.decode("latin-1")},
    np.ndarray: lambda array: {"array": [_plain_array(array).dtype.str, array.tolist()]},
    Generator: _written_generator,
    Reading: lambda r: {"reading": [r.value_mg, r.stable, r.time_s, r.unit, r.raw.decode("latin-1")]},
}
_READERS: Mapping[str, Callable[[Plain, Any], Any]] = {
    "tuple": lambda content, onto: tuple(read(content, list(onto) if isinstance(onto, tuple) else None)),
    "dict": _read_dict,
    "set": lambda content, onto: set(read(content)),
    "deque": lambda content, onto: deque(read(content[0]), content[1]),
    "bytes": lambda content, onto: content.encode("latin-1"),
    "array": lambda content, onto: _plain_array(np.array(content[1], dtype=content[0])),
    "generator": _read_generator,
    "reading": lambda content, onto: _reading(*content),
    "object": _read_object,
    "spec": _read_spec,
}
