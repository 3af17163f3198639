"""How a world's objects are kept in its file: the attributes that each one's class names in `STATE`.

They are written as JSON (`plain_state.py`), so that a file from elsewhere is only data; what is none, in somebody's
plant, cannot be saved. The log is a line for each record.
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
        """These, too; before there is a file."""
        self._getters += [(_values_of(thing.STATE), thing) for thing in objects]

    @property
    def is_kept(self) -> bool:
        """There is a file."""
        return self._file is not None

    def begin(self, path: Path, tell: Callable[[str], None]) -> None:
        """Keep it in a new file. `tell` is told, at most once, why it cannot be saved after all."""
        self._file, self._tell = WorldFile.create(path, _json("it ended at once")), tell

    def take_up(self, path: Path, tell: Callable[[str], None]) -> tuple[Any, list[Any]]:
        """Give the objects the state they had; returns what was saved beside it, and what was logged.

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
        """Save the state of all, and this beside it."""
        assert self._file is not None
        try:
            values = [written_all(getter(thing)) for getter, thing in self._getters]
            state = _json([written(beside), values])
        except Exception as error:  # of somebody's plant
            self._give_up(f"the state of {self._plant} cannot be written down ({type(error).__name__}: {error})")
            return
        try:
            self._file.write(state)
        except OSError as error:
            self._give_up(f"its file cannot be written: {error.strerror}")

    def log(self, record: object) -> None:
        """Keep what will not change any more, with the next state that is saved."""
        if self._file is not None:
            try:
                self._file.append(_json(written(record)) + b"\n")
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


def look_into(path: Path) -> tuple[Any, list[Any]]:
    """What was saved beside the objects' state, and what was logged; the file stays whose it is. SourceError."""
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
    except Exception as error:  # the file may hold anything, and a plant do anything
        why = f"it was written by another version of the program or the plant ({type(error).__name__}: {error})"
    raise broken(path, why)


def _values_of(names: Sequence[str]) -> Callable[[Any], Any]:
    first, *others = names
    return attrgetter(first, *others) if others else lambda thing: (getattr(thing, first),)


def _json(plain: object) -> bytes:
    """On one line."""
    return to_json(plain, inf_nan_mode="constants")
