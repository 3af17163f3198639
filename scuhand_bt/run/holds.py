"""Locks for what only one process may have at a time: a run, and the lab's real cell.

This lock is only a courtesy that tells a second process so before it begins, as a person may delete it. What really
keeps two from going on with one run: an entry is only added after the last one that its writer knows
(`journal/writer.py`).
"""

from pathlib import Path

from scuhand_bt.journal.presence import Held, Presence
from scuhand_bt.problems import Mark, Problem, SourceError

CELL = "cell"
BEING_RUN = "the run is going on in another process; `scuhand-bt stop {}` ends it"


def take_run(journal: Path) -> Presence:
    """Lock a run from before its history is read until it ends. Raises SourceError if another process has it."""
    return _take(journal, BEING_RUN.format(journal.stem))


def take_cell(state_folder: Path) -> Presence:
    """Lock the real cell of the lab with this state folder. Raises SourceError if a run has it."""
    what = "the cell is in use by a run, which keeps its inventory; stop that run first (`scuhand-bt runs` lists it)"
    return _take(state_folder / CELL, what)


def _take(path: Path, held: str) -> Presence:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        return Presence(path)
    except Held:
        what = held
    except OSError as error:
        what = f"it cannot be locked: {error.strerror or error}; nothing was moved"
    raise SourceError([Problem(Mark(str(path)), what)])
