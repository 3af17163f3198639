"""The front of a room: the names that others are to use, each imported when it is asked for."""

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def front(room: str, names: Mapping[str, str]) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """The `__getattr__` and `__dir__` of a room, by the names that each module of `scuhand_bt` gives to its front.

    What is not asked for is not waited for: the arm's kinematics, a web server, an extra that is not there.
    """
    module_of = {name: module for module, given in names.items() for name in given.split()}

    def get(name: str) -> Any:
        if name not in module_of:
            raise AttributeError(f"module {room!r} has no attribute {name!r}")
        return getattr(import_module(f"scuhand_bt.{module_of[name]}"), name)

    return get, lambda: sorted(module_of)
