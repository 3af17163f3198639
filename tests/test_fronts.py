"""The fronts of rooms: the names that others use come from where they are defined, each when it is asked for."""

import ast
from importlib import import_module
from pathlib import Path

import pytest

FRONTS = ("api", "api.books", "study", "fleet", "dashboard", "kit", "report", "commissioning")


def declared(file: str) -> dict[str, str]:
    """What type checkers are told: each name and the module that it is from."""
    body = ast.parse(Path(file).read_text(encoding="utf-8")).body
    (checked,) = (node for node in body if isinstance(node, ast.If))
    imports = [node for node in checked.body if isinstance(node, ast.ImportFrom)]
    return {name.name: str(node.module) for node in imports for name in node.names}


@pytest.mark.parametrize("room", FRONTS)
def test_a_front_gives_what_type_checkers_are_told_and_nothing_else(room: str) -> None:
    front = import_module(f"scuhand_bt.{room}")
    names = declared(str(front.__file__))
    assert dir(front) == sorted(names) == sorted(front.__all__)
    for name, module in names.items():
        assert getattr(front, name) is getattr(import_module(module), name), name
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        front.nonsense  # noqa: B018
