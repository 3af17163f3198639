"""Functions of numbers and arrays that are called so often that they are compiled (numba).

A compiled function keeps the constants of its module as they were when it was compiled: those that anybody varies are
handed in.
"""

from collections.abc import Callable
from typing import TypeVar, cast

from numba import njit

F = TypeVar("F", bound=Callable[..., object])


def compiled(signature: str) -> Callable[[F], F]:
    """Compile a function for these types as its module is imported; what was compiled before is kept where it can be.

    Not a moment later, when something may be waiting for it. Beside the module, or else where the user's caches are.
    """

    def compile_it(function: F) -> F:
        try:
            return cast(F, njit(signature, cache=True, error_model="numpy")(function))
        except Exception:  # no place to keep it, no room there, or what was kept is spoilt: what else is wrong is told
            return cast(F, njit(signature, error_model="numpy")(function))

    return compile_it
