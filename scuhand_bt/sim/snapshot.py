"""How a world's objects are kept in its file: the attributes that each one's class names in `STATE`.

They are pickled, whatever they are, so that a plant of somebody else's needs no method for it; what cannot be
pickled cannot be saved. A world's file is therefore to be trusted as much as the program that wrote it.
"""

import pickle
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from io import BytesIO
from operator import attrgetter
from pathlib import Path
from typing import Any, ClassVar, Protocol

import numpy.random
from numpy.random import BitGenerator, Generator

from scuhand_bt.devices.interfaces import Reading
from scuhand_bt.sim.world_file import WorldFile, broken


class Stateful(Protocol):
    """Something with a state."""

    STATE: ClassVar[tuple[str, ...]]
    """The names of its attributes that change."""


class Memory:
    """Saves the state of the same objects again and again."""

    def __init__(self, objects: Sequence[Stateful], plant: str) -> None:
        self._getters: list[tuple[Callable[[Any], tuple[Any, ...]], Stateful]] = [
            (attrgetter(*thing.STATE), thing) for thing in objects
        ]
        self._plant = plant
        self._file: WorldFile | None = None
        self._tell: Callable[[str], None] = lambda why: None
        self._bytes = BytesIO()
        self._pickler = pickle.Pickler(self._bytes, pickle.HIGHEST_PROTOCOL)
        self._pickler.dispatch_table = REDUCED

    @property
    def is_kept(self) -> bool:
        """There is a file."""
        return self._file is not None

    def begin(self, path: Path, tell: Callable[[str], None]) -> None:
        """Keep it in a new file. `tell` is told, at most once, why it cannot be saved after all."""
        self._file, self._tell = WorldFile.create(path, pickle.dumps("it ended at once")), tell

    def take_up(self, path: Path, tell: Callable[[str], None]) -> tuple[Any, list[Any]]:
        """Give the objects the state they had; returns what was saved beside it, and what was logged.

        Raises SourceError for a file that cannot be used. The file is kept from then on.
        """
        file, state, log = WorldFile.open(path)
        try:
            kept = pickle.loads(state)
            if not isinstance(kept, str):
                beside, values = kept
                for (_, thing), attributes in zip(self._getters, values, strict=True):
                    for name, value in zip(thing.STATE, attributes, strict=True):
                        setattr(thing, name, value)
                stream, logged = BytesIO(log), []
                while stream.tell() < len(log):
                    logged.append(pickle.load(stream))
                self._file, self._tell = file, tell
                return beside, logged
            why = f"its world could not be saved: {kept}"
        except Exception as error:  # a pickle may fail in any way
            why = f"it was written by another version of the program or the plant ({type(error).__name__}: {error})"
        file.close()
        raise broken(path, why)

    def save(self, beside: object) -> None:
        """Save the state of all, and this beside it."""
        assert self._file is not None
        buffer = self._bytes
        buffer.seek(0)
        buffer.truncate()
        self._pickler.clear_memo()
        try:
            self._pickler.dump((beside, [getter(thing) for getter, thing in self._getters]))
            state = buffer.getvalue()
        except Exception as error:  # of somebody's plant
            self._give_up(f"{self._plant} cannot be pickled ({type(error).__name__}: {error})")
            return
        try:
            self._file.write(state)
        except OSError as error:
            self._give_up(f"its file cannot be written: {error.strerror}")

    def log(self, record: object) -> None:
        """Keep what will not change any more, with the next state that is saved."""
        if self._file is not None:
            try:
                self._file.append(pickle.dumps(record))
            except OSError as error:
                self._give_up(f"its file cannot be written: {error.strerror}")

    def _give_up(self, why: str) -> None:
        """What is in the file is older than what the run knows: nobody may go on from it."""
        assert self._file is not None
        self._file.remove()
        self._file = None
        self._tell(why)

    def close(self) -> None:
        if self._file is not None:
            self._file.close()
            self._file = None


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
