"""What somebody else's package offers, by `package.module:NAME`."""

import importlib
from typing import TypeVar

T = TypeVar("T")


class NotPluggable(ValueError):  # noqa: N818 - it reads as the sentence it is raised in
    """A name that stands for nothing that can be used here; says why, and what would be right."""


def plugged(name: str, kind: type[T]) -> T:
    """The object of `package.module:NAME`, which must be of this kind. NotPluggable."""
    module_name, _, object_name = name.partition(":")
    try:
        module = importlib.import_module(module_name)
    except Exception as error:
        why = f"{type(error).__name__}: {error}"
        raise NotPluggable(
            f"'{name}': module '{module_name}' cannot be imported ({why}); install its package"
        ) from None
    made = getattr(module, object_name, None)
    if not isinstance(made, kind):
        known = ", ".join(key for key, value in vars(module).items() if isinstance(value, kind)) or "none"
        raise NotPluggable(f"'{name}': '{object_name}' is no {kind.__name__}; {module_name} has: {known}")
    return made
