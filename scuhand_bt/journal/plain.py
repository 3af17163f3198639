"""Any value as JSON can keep it, and as a resumed run compares it."""

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, is_dataclass

import numpy as np
from pydantic import BaseModel, JsonValue

from scuhand_bt.events.entry import readable
from scuhand_bt.specs import Container, Powder, Source


def plain(value: object) -> JsonValue:
    """A value in the types of JSON: things of the lab by their names, what is no number in JSON (NaN, infinity) too."""
    match value:
        case np.generic():  # before float, which some of them are
            return plain(value.item())
        case str():
            return readable(value)
        case None | bool() | int():
            return value
        case float():
            return value if math.isfinite(value) else str(value)
        case Container():
            return f"{value.id} ({value.name})"
        case Source() | Powder():
            return value.name
        case BaseModel():
            return plain(value.model_dump(mode="json", by_alias=False))
        case np.ndarray():
            return plain(value.tolist())
        case Mapping():
            return {str(key): plain(item) for key, item in value.items()}
        case list() | tuple():
            return [plain(item) for item in value]
    if is_dataclass(value) and not isinstance(value, type):
        return plain(asdict(value))
    return str(value)


def plain_values(values: Mapping[str, object]) -> dict[str, JsonValue]:
    """Several, by their names."""
    return {name: plain(value) for name, value in values.items()}


_to_json = json.JSONEncoder(sort_keys=True, allow_nan=False).encode


def to_json(values: object) -> str:
    """JSON with sorted keys."""
    try:
        return _to_json(values)
    except (TypeError, ValueError):  # what is plain already, and most is, need not be walked through
        return _to_json(plain(values))


def json_parts(values: Mapping[str, object], *, indent: int, sort_keys: bool = False) -> Iterator[str]:
    """What `json.dumps` makes of them, piece by piece; a value that is an iterator becomes a list, item by item."""

    def dumped(value: object, level: int) -> str:
        text = json.dumps(value, sort_keys=sort_keys, indent=indent)
        return text.replace("\n", "\n" + " " * (indent * level))

    pad, inner = " " * indent, " " * (2 * indent)
    before = "{"
    for key in sorted(values) if sort_keys else values:
        value = values[key]
        yield f"{before}\n{pad}{json.dumps(key)}: "
        before = ","
        if not isinstance(value, Iterator):
            yield dumped(value, 1)
            continue
        mark = "["
        for item in value:
            yield f"{mark}\n{inner}{dumped(item, 2)}"
            mark = ","
        yield f"\n{pad}]" if mark == "," else "[]"
    yield "\n}" if before == "," else "{}"
