"""Values set in a YAML file's text; all else of it stays to the byte: comments, order, blanks, quotes."""

from collections.abc import Mapping, Sequence
from typing import Any

import yaml

Path = tuple[str, ...]
Value = str | int | float | Sequence["Value"] | Mapping[str, "Value"]


def edited(text: str, values: Mapping[Path, Value]) -> str:
    """The text with each value at its path of keys, which are made where they are missing.

    ValueError where there is something else than a mapping on the way.
    """
    for path, value in values.items():
        text = _with(text, path, flow(value))
    return text


def flow(value: Value) -> str:
    """A value in one line of YAML."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key}: {flow(one)}" for key, one in value.items()) + "}"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return "[" + ", ".join(map(flow, value)) + "]"
    return str(value)


def _with(text: str, path: Path, value: str) -> str:
    node: Any = yaml.compose(text, Loader=yaml.SafeLoader)
    for depth, key in enumerate(path):
        if not isinstance(node, yaml.MappingNode):
            raise ValueError(f"'{'.'.join(path[:depth])}' is not a mapping (key: value)")
        held = next((held for name, held in node.value if name.value == key), None)
        is_empty = isinstance(held, yaml.ScalarNode) and held.tag == "tag:yaml.org,2002:null"
        if held is None or is_empty:
            missing = value
            for name in reversed(path[depth + 1 :]):
                missing = f"{{{name}: {missing}}}"
            if held is not None:
                return _put(text, held.start_mark.index, held.end_mark.index, f" {missing}")
            return _inserted(text, node, f"{key}: {missing}")
        node = held
    return _put(text, node.start_mark.index, _end(node), value)


def _inserted(text: str, node: yaml.MappingNode, entry: str) -> str:
    """One more entry at the end of a mapping."""
    if node.flow_style:
        end = _end(node) - 1
        return _put(text, end, end, f"{', ' if node.value else ''}{entry}")
    last = _end(node.value[-1][1])
    line_end = text.find("\n", last)
    at = len(text) if line_end < 0 else line_end
    return _put(text, at, at, f"\n{' ' * node.value[0][0].start_mark.column}{entry}")


def _put(text: str, begin: int, end: int, new: str) -> str:
    return text[:begin] + new + text[end:]


def _end(node: Any) -> int:
    """Where a node's own text ends: of a block, where its last value does, and not at what comes after."""
    if isinstance(node, yaml.ScalarNode) or node.flow_style or not node.value:
        end: int = node.end_mark.index
        return end
    last = node.value[-1]
    return _end(last[1] if isinstance(node, yaml.MappingNode) else last)
