"""A lab's journals as single files: copied while they are being written, and made one file after a kill."""

import sqlite3
from contextlib import closing
from pathlib import Path

from scuhand_bt.journal.presence import Presence
from scuhand_bt.problems import Mark, Problem, SourceError


def copy_database(path: Path, into: Path) -> None:
    """A copy of what a database holds at one moment, its log included, as one file; a program may be writing it.

    Raises SourceError for one that cannot be read.
    """
    try:
        uri = f"{path.absolute().as_uri()}?mode=ro"
        with closing(sqlite3.connect(uri, uri=True)) as source, closing(sqlite3.connect(into)) as target:
            source.backup(target)
            target.execute("PRAGMA journal_mode=DELETE")
    except sqlite3.Error as error:
        raise SourceError([Problem(Mark(str(path)), f"it cannot be copied: {error}")]) from None


def make_one_file(path: Path) -> bool:
    """Take the log that a killed run has left into its journal; whether there was one.

    Raises Held where a program has the run, SourceError where the files cannot be written.
    """
    if not path.with_name(f"{path.name}-wal").exists():
        return False
    presence = Presence(path)
    try:
        with closing(sqlite3.connect(path)) as database:
            database.execute("PRAGMA journal_mode=DELETE")
    except sqlite3.Error as error:
        raise SourceError([Problem(Mark(str(path)), f"its log cannot be taken into it: {error}")]) from None
    finally:
        presence.end()
    return True
