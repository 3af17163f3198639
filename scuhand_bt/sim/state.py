"""The state of simulated objects as bytes: the attributes that each one's class names in `STATE`.

They are pickled, whatever they are, so that a plant of somebody else's needs no method for it; what cannot be
pickled cannot be saved. A world's file is therefore to be trusted as much as the program that wrote it.
"""

import pickle
from collections.abc import Callable, Sequence
from io import BytesIO
from operator import attrgetter
from typing import Any, ClassVar, Protocol

from numpy.random import PCG64, Generator


class Stateful(Protocol):
    """Something with a state."""

    STATE: ClassVar[tuple[str, ...]]
    """The names of its attributes that change."""


class Packer:
    """Packs the state of the same objects again and again."""

    def __init__(self, objects: Sequence[Stateful]) -> None:
        self._getters: list[tuple[Callable[[Any], tuple[Any, ...]], Stateful]] = [
            (attrgetter(*thing.STATE), thing) for thing in objects
        ]
        self._bytes = BytesIO()
        self._pickler = pickle.Pickler(self._bytes, pickle.HIGHEST_PROTOCOL)
        # numpy would write the seed sequence as well, which takes ten times as long.
        self._pickler.dispatch_table = {Generator: _reduced}

    def pack(self, beside: object) -> bytes:
        """The state of all, and what is to be kept beside it. Any exception of what cannot be pickled."""
        buffer = self._bytes
        buffer.seek(0)
        buffer.truncate()
        self._pickler.clear_memo()
        self._pickler.dump((beside, [getter(thing) for getter, thing in self._getters]))
        return buffer.getvalue()

    def give_back(self, unpickled: Any) -> Any:
        """Give the objects the state they had; returns what was kept beside it. ValueError if they do not match."""
        beside, values = unpickled
        for (_, thing), kept in zip(self._getters, values, strict=True):
            for name, value in zip(thing.STATE, kept, strict=True):
                setattr(thing, name, value)
        return beside


def _reduced(generator: Generator) -> tuple[Callable[..., Generator], tuple[object, ...]]:
    state: Any = generator.bit_generator.state
    if state["bit_generator"] != "PCG64":
        return generator.__reduce__()  # type: ignore[return-value]
    numbers = state["state"]
    return _generator, (numbers["state"], numbers["inc"], state["has_uint32"], state["uinteger"])


def _generator(number: int, increment: int, has_uint32: int, uinteger: int) -> Generator:
    bits = PCG64(0)
    bits.state = {
        "bit_generator": "PCG64",
        "state": {"state": number, "inc": increment},
        "has_uint32": has_uint32,
        "uinteger": uinteger,
    }
    return Generator(bits)
