"""How the world's file keeps objects: the attributes that each class names in `STATE`.

They are written as JSON (`plain_state.py`), so that a file from elsewhere is only data. A user's plant with attributes
that are not data cannot be saved. The log has one line per record.
"""

import json
from collections.abc import Callable, Sequence
from operator import attrgetter
from pathlib import Path
from typing import Any, ClassVar, Protocol

from pydantic_core import to_json

from scuhand_bt.problems import SourceError
from scuhand_bt.sim.plain_state import Misplaced, Plain, read, written, written_all
from scuhand_bt.sim.world_file import WorldFile, broken


class Stateful(Protocol):
    """Something with a state."""

    STATE: ClassVar[tuple[str, ...]]
    """The names of its attributes that change."""


class Memory:
    """Saves the state of the same objects again and again."""

    def __init__(self, objects: Sequence[Stateful], plant: str) -> None:
        self._getters: list[tuple[Callable[[Any], Any], Stateful]] = []
        self.add(objects)
        self._plant = plant
        self._file: WorldFile | None = None
        self._tell: Callable[[str], None] = lambda why: None

    def add(self, objects: Sequence[Stateful]) -> None:
        """Add these objects; before there is a file."""
        self._getters += [(_values_of(thing.STATE), thing) for thing in objects]

    @property
    def is_kept(self) -> bool:
        """Whether there is a file."""
        return self._file is not None

    def begin(self, path: Path, tell: Callable[[str], None]) -> None:
        """Keep the state in a new file. If saving fails later, `tell` is called once with the reason."""
        self._file, self._tell = WorldFile.create(path, _json("it ended at once")), tell

    def take_up(self, path: Path, tell: Callable[[str], None]) -> tuple[Any, list[Any]]:
        """Restore the objects' state from a file; returns what was saved beside it, and the log.

        Raises SourceError for a file that cannot be used. The file is kept from then on.
        """
        file, state, log = WorldFile.open(path)
        try:
            beside, logged = _read(path, state, log, self._give)
        except SourceError:
            file.close()
            raise
        self._file, self._tell = file, tell
        return beside, logged

    def _give(self, values: list[Plain]) -> None:
        for (_, thing), attributes in zip(self._getters, values, strict=True):
            for name, plain in zip(thing.STATE, attributes, strict=True):
                setattr(thing, name, read(plain, getattr(thing, name)))

    def save(self, beside: object) -> None:
        """Save the state of all objects, and `beside`."""
        assert self._file is not None
        try:
            values = [written_all(getter(thing)) for getter, thing in self._getters]
            state = _json([written(beside), values])
        except Exception as error:  # of a user's plant
            self._give_up(f"the state of {self._plant} cannot be written down ({type(error).__name__}: {error})")
            return
        try:
            self._file.write(state)
        except OSError as error:
            self._give_up(f"its file cannot be written: {error.strerror}")

    def log(self, record: object) -> None:
        """Append a record that will not change; it counts from the next `save` on."""
        if self._file is not None:
            try:
                self._file.append(_json(written(record)) + b"\n")
            except OSError as error:
                self._give_up(f"its file cannot be written: {error.strerror}")

    def _give_up(self, why: str) -> None:
        """Delete the file: it is older than what the run knows, so nobody may continue from it."""
        assert self._file is not None
        self._file.remove()
        self._file = None
        self._tell(why)

    def close(self) -> None:
        if self._file is not None:
            self._file.close()
            self._file = None


def look_into(path: Path) -> tuple[Any, list[Any]]:
    """What was saved beside the objects' state, and the log; leaves the file unchanged. Raises SourceError."""
    file, state, log = WorldFile.open(path)
    file.close()
    return _read(path, state, log, lambda values: None)


def _read(path: Path, state: bytes, log: bytes, give: Callable[[list[Plain]], None]) -> tuple[Any, list[Any]]:
    try:
        kept = json.loads(state)
        if not isinstance(kept, str):
            beside, values = kept
            give(values)
            return read(beside), [read(json.loads(line)) for line in log.splitlines()]
        why = f"its world could not be saved: {kept}"
    except Misplaced as misplaced:
        why = str(misplaced)
    except Exception as error:  # the file may hold anything, and a plant may do anything
        why = f"it was written by another version of the program or the plant ({type(error).__name__}: {error})"
    raise broken(path, why)


def _values_of(names: Sequence[str]) -> Callable[[Any], Any]:
    first, *others = names
    return attrgetter(first, *others) if others else lambda thing: (getattr(thing, first),)


def _json(plain: object) -> bytes:
    """On one line."""
    return to_json(plain, inf_nan_mode="constants")
