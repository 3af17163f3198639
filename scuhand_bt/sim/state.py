"""The state of simulated objects as bytes: the attributes that each one's class names in `STATE`.

They are pickled, whatever they are, so that a plant of somebody else's needs no method for it; what cannot be
pickled cannot be saved. A world's file is therefore to be trusted as much as the program that wrote it.
"""

import pickle
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from io import BytesIO
from operator import attrgetter
from typing import Any, ClassVar, Protocol

import numpy.random
from numpy.random import BitGenerator, Generator

from scuhand_bt.devices.interfaces import Reading


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
        self._pickler.dispatch_table = REDUCED

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


def _generator(state: Mapping[str, Any]) -> Generator:
    bits: BitGenerator = getattr(numpy.random, state["bit_generator"])()
    bits.state = state
    return Generator(bits)


# Each takes less than half the time of what the objects say of themselves; a world is saved at every tick.
REDUCED: Mapping[type, Callable[[Any], tuple[Callable[..., Any], tuple[Any, ...]]]] = {
    Generator: lambda generator: (_generator, (generator.bit_generator.state,)),
    deque: lambda queue: (deque, (list(queue), queue.maxlen)),
    Reading: lambda r: (Reading, (r.value_mg, r.stable, r.time_s, r.unit, r.raw)),
}
