"""Any value as JSON can keep it, and as a resumed run compares it."""

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, is_dataclass

import numpy as np
from pydantic import BaseModel, JsonValue

from scuhand_bt.events import readable
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
