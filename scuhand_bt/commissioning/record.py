"""What was commissioned, when and by whom: a file of the lab's state, to which entries are only added.

Each keeps what of `robot/cell.yaml` it rests on, so that what was changed since is known.
"""

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from pydantic import JsonValue, TypeAdapter, ValidationError

from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.problems import Mark, Problem, SourceError

FILE = "commissioning.json"


@dataclass(frozen=True)
class Done:
    """One step, done once."""

    step: str
    at: str
    """ISO 8601, with its offset from UTC."""
    by: str
    signed: bool
    """And has proven it by a PIN."""
    found: Mapping[str, str]
    """What was found, in words with units."""
    rests_on: Mapping[str, JsonValue]
    """By their paths, the values of the cell's file that it counts for."""
    simulated: bool = False
    """On twins: of the real cell it says nothing."""


_ENTRIES = TypeAdapter(tuple[Done, ...])


class Record:
    """The commissioning of one lab's cell; `state` is the folder of the lab's state.

    Raises SourceError for a file that cannot be read, or written.
    """

    def __init__(self, state: Path) -> None:
        self._path = state / FILE

    def entries(self) -> tuple[Done, ...]:
        """All that was done, in its order."""
        try:
            return _ENTRIES.validate_json(self._path.read_bytes())
        except FileNotFoundError:
            return ()
        except ValidationError:
            raise self._problem("this is not a commissioning record; move it away, and begin again") from None
        except OSError as error:
            raise self._problem(f"cannot be read: {error.strerror or error}") from None

    def last(self, *, simulated: bool) -> dict[str, Done]:
        """By step, when it was done last; in the order in which that was."""
        found: dict[str, Done] = {}
        for done in self.entries():
            if done.simulated == simulated:
                found.pop(done.step, None)
                found[done.step] = done
        return found

    def add(self, done: Done) -> None:
        """Add an entry; the file is the old one or the new one, whatever happens meanwhile."""
        text = json.dumps([asdict(one) for one in (*self.entries(), done)], indent=1)
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            replace_text(self._path, text + "\n")
        except OSError as error:
            raise self._problem(f"cannot be written: {error.strerror or error}") from None

    def _problem(self, what: str) -> SourceError:
        return SourceError([Problem(Mark(str(self._path), 0), what)])


def replace_text(path: Path, text: str) -> None:
    """Write a file as a whole, or leave the one that is there. Raises OSError."""
    new = path.with_name(path.name + ".new")
    with new.open("w", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    new.replace(path)


def values_of(cell: CellSpec, paths: Sequence[str]) -> dict[str, JsonValue]:
    """Values of the cell by paths as in its file (`arm.options.home_counts`); None for what is not there."""
    whole: Any = cell.model_dump(mode="json", by_alias=True)
    found: dict[str, JsonValue] = {}
    for path in paths:
        value = whole
        for key in path.split("."):
            value = value.get(key) if isinstance(value, dict) else None
        found[path] = value
    return found
