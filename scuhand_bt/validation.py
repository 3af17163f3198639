"""Models from nodes: every error of a model becomes a located problem in a user's words."""

import typing
from collections.abc import Iterator, Sequence
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from scuhand_bt.problems import Problems, shorten
from scuhand_bt.quantity import NOT_WRITTEN, counted, in_unit_of
from scuhand_bt.yaml_source import Entries, Items, Node, describe, plain

M = TypeVar("M", bound=BaseModel)


def validate(model: type[M], node: Node, problems: Problems, known: str = "", **extra: Any) -> M | None:
    """Make a model of a node; every error of the model becomes a located problem, and the result None.

    `extra` are fields that do not stand in the file (such as a name that is the entry's key).
    """
    if not isinstance(node, Entries):
        problems.add(
            node.mark,
            f"expected {known or 'a mapping (key: value)'}, found {describe(node)}",
            code="wrong-shape",
        )
        return None
    found_before = len(problems.found)
    for key in extra:
        if key in node.keys:
            problems.add(
                node.keys[key],
                f"unknown key '{key}'",
                known=set(_keys_at(model, ())).difference(extra),
                code="unknown-key",
            )
    try:
        made = model.model_validate({**plain(node), **extra}, by_alias=True, by_name=False)
        return made if len(problems.found) == found_before else None
    except ValidationError as error:
        for item in error.errors(include_url=False):
            _explain(model, node, item, problems)
        return None


def _explain(model: type[BaseModel], node: Node, error: Any, problems: Problems) -> None:
    mark, owner = node.mark, node
    named = list[str]()  # of the steps those that are written: one into a union is the name of a kind
    for i, step in enumerate(error["loc"], start=1):
        if isinstance(owner, Entries) and step in owner.values:
            named.append(step)
            is_key_wrong = error["type"] == "extra_forbidden" and i == len(error["loc"])
            mark = owner.keys[step] if is_key_wrong else owner.values[step].mark
            if not is_key_wrong:
                owner = owner.values[step]
        elif isinstance(owner, Items) and isinstance(step, int) and step < len(owner.items):
            owner = owner.items[step]
            mark = owner.mark
    last = next((step for step in reversed(error["loc"]) if isinstance(step, str)), "")
    name = named[-1] if named and error["type"] != "missing" else last
    if error["type"] == "extra_forbidden":
        known = _keys_at(model, error["loc"][:-1])
        problems.add(mark, f"unknown key '{shorten(name)}'", unknown=name, known=known, code="unknown-key")
    elif error["type"] == "missing" and isinstance(owner, Items):
        problems.add(mark, f"'{name}' has {counted(len(owner.items), 'value')}, and needs more", code="missing-key")
    elif error["type"] == "missing":
        problems.add(mark, f"'{name}' is missing", code="missing-key")
    else:
        code = _OWN_CODES.get(error["type"], "bad-value")
        problems.add(mark, (f"'{shorten(name)}': " if name else "") + refusal(error), code=code)


def refusal(error: Any) -> str:
    """What pydantic has against a value (one of `ValidationError.errors()`), in a user's words."""
    if error["type"] in _OWN_CODES:
        return str(error["msg"])
    given, context = error["input"], error.get("ctx", {})
    bounds = {key: in_unit_of(str(given), bound) for key, bound in context.items() if key in _BOUNDS}
    given = f"{given:g}" if isinstance(given, float) else given  # what was worked out has all its digits
    shown = (
        f"'{shorten(str(given))}'" if isinstance(given, str | int | float) else "nothing" if given is None else "this"
    )
    why = _WHY.get(error["type"], "").format(**context | bounds) or error["msg"].removeprefix("Value error, ")
    return f"{shown} is not accepted; {why[:1].lower() + why[1:]}"


_OWN_CODES = {"quantity": "bad-unit", "formula": "bad-formula"}
"""The codes of findings of the types of errors that are our own, and worded already."""

_BOUNDS = ("gt", "ge", "lt", "le")
_WHY = {
    "missing": "it is missing",
    "greater_than": "more than {gt}",
    "greater_than_equal": "at least {ge}",
    "less_than": "less than {lt}",
    "less_than_equal": "at most {le}",
    **dict.fromkeys(("int_parsing", "int_type", "int_from_float", "int_parsing_size"), "a whole number, such as 3"),
    **dict.fromkeys(("float_parsing", "float_type", "finite_number"), "a plain number, such as 0.5"),
    **dict.fromkeys(("bool_parsing", "bool_type"), "yes or no"),
    "string_type": "a text",
    "string_pattern_mismatch": "text of the form {pattern}",
    "literal_error": "write {expected}",
    **dict.fromkeys(("list_type", "tuple_type"), "a list"),
    **dict.fromkeys(("dict_type", "model_type", "model_attributes_type"), "a mapping (key: value)"),
    "too_short": "a list of at least {min_length}",
    "too_long": "a list of at most {max_length}",
}
"""What would be accepted, by pydantic's types of errors."""


def _keys_at(model: type[BaseModel], path: Sequence[Any]) -> list[str]:
    """The keys that a model, or the model nested in it at `path`, accepts."""
    for step in path:
        for name, info in model.model_fields.items():
            if step in (name, info.alias):
                model = next(_models_in(info.annotation), model)
                break
    return [info.alias or name for name, info in model.model_fields.items() if info.json_schema_extra != NOT_WRITTEN]


def _models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in typing.get_args(annotation):
        yield from _models_in(part)
