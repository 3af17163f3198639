"""Reading a journal: any version of it, whole or not, and never changing the file.

Nothing of a journal is believed beyond the first entry that is not as it was written: what stands after it is
counted as lost, and `Contents.verified` says so.
"""

import json
import os
import shutil
import sqlite3
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from scuhand_bt.journal.hash_chain import COLUMNS, Entry, Verified, verify
from scuhand_bt.journal.kinds import NewerShape
from scuhand_bt.journal.migrations import MIGRATIONS, in_memory, is_as_made
from scuhand_bt.journal.results import SampleResult
from scuhand_bt.journal.store import BESIDE, SCHEMA_VERSION, read_only
from scuhand_bt.problems import Mark, Problem, SourceError

NONE = "this is not a run's journal"
_JSON_COLUMNS = ("inputs", "result", "payload", "state")


@dataclass(frozen=True)
class Contents:
    """What a journal holds as far as it is whole, in today's form."""

    path: Path
    version: int
    """Of the schema that it was written in."""
    database: sqlite3.Connection
    verified: Verified

    @property
    def is_chained(self) -> bool:
        """Whether its entries carry hashes: those of version 1 do not."""
        return self.version > 1

    def rows(self, table: str) -> list[dict[str, Any]]:
        """All rows of a table or view, in order; JSON columns are decoded."""
        return list(self.each(table))

    def each(self, table: str) -> Iterator[dict[str, Any]]:
        """The same, one after the other: a long run need not be in memory at once."""
        yield from self._rows(f"SELECT * FROM {table}")

    def entry(self, seq: int) -> dict[str, Any]:
        """One entry by its number. Raises LookupError for one that is not there."""
        for row in self._rows(f"SELECT * FROM entry WHERE seq = {seq:d}"):
            return row
        raise LookupError(f"there is no entry {seq}")

    def samples(self) -> Iterator[dict[str, Any]]:
        """What was last said of each sample, in the order in which they were first told of."""
        query = "SELECT MAX(seq) FROM entry WHERE kind = ? GROUP BY json_extract(payload, '$.id') ORDER BY MIN(seq)"
        for (seq,) in self.database.execute(query, (SampleResult.KIND,)).fetchall():
            yield self.entry(seq)["payload"]

    def _rows(self, query: str) -> Iterator[dict[str, Any]]:
        cursor = self.database.execute(query)
        names = [column[0] for column in cursor.description]
        for values in cursor:
            row = dict(zip(names, values, strict=True))
            for key in _JSON_COLUMNS:
                if row.get(key) is not None:
                    row[key] = json.loads(row[key])
            yield row


@contextmanager
def open_journal(path: Path) -> Iterator[tuple[sqlite3.Connection, int]]:
    """A journal's database in today's form, and the version it was written in; nothing is verified.

    Raises SourceError for a file that is no journal, of a newer version, or damaged: also for what goes wrong
    while it is open here.
    """
    try:
        if not path.is_file():
            raise _problem(path, "there is no such journal")
        if not os.access(path, os.R_OK):
            raise _problem(path, "cannot be read: Permission denied")
        # Not only errors of SQLite: a damaged journal may hold anything.
        with _readable(path) as readable, closing(read_only(readable)) as file:
            file.text_factory = lambda text: text.decode(errors="backslashreplace")
            version: int = file.execute("PRAGMA user_version").fetchone()[0]
            if version > SCHEMA_VERSION:
                what = f"a newer scuhand-bt wrote it (version {version}; this one reads up to {SCHEMA_VERSION})"
                raise _problem(path, f"{what}: use that one")
            if version < 1:
                raise _problem(path, NONE)
            database, found = file, version
            while found < SCHEMA_VERSION:
                database, found = MIGRATIONS[found](database), found + 1
            try:
                yield database, version
            finally:
                database.close()
    except (sqlite3.Error, OSError) as error:
        raise _problem(path, f"this is not a run's journal, or it is damaged: {error}") from None
    except NewerShape as error:
        raise _problem(path, f"a newer scuhand-bt wrote it ({error}): use that one") from None
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        what = f"its content is not that of a journal ({type(error).__name__}: {error})"
        raise _problem(path, f"this is not a run's journal, or it is damaged: {what}") from None


@contextmanager
def open_verified(path: Path, head: str | None = None) -> Iterator[tuple[sqlite3.Connection, int, Verified]]:
    """A journal's database, its version, and how far its chain is whole, all of one moment. Raises as `open_journal`.

    Its views are the file's own: only the table of entries is verified.
    """
    with open_journal(path) as (database, version):
        if version < SCHEMA_VERSION:
            count = database.execute("SELECT COUNT(*) FROM entry").fetchone()[0]
            yield database, version, Verified(count, "", None)
            return
        database.execute("BEGIN")  # a run that goes on writes meanwhile
        yield database, version, verify(database, head)


@contextmanager
def open_contents(path: Path, head: str | None = None) -> Iterator[Contents]:
    """What a journal holds, verified; `head` is what its chain should end in. Raises SourceError as `open_journal`.

    A journal that is whole is read where it is; of another one there is a copy, as far as it is whole, in memory.
    """
    with open_verified(path, head) as (database, version, verified):
        if version < SCHEMA_VERSION or (verified.problem is None and is_as_made(database)):
            yield Contents(path, version, database, verified)
            return
        rows = database.execute(f"SELECT {COLUMNS}, hash FROM entry WHERE seq <= {verified.entries} ORDER BY seq")
        with closing(in_memory((Entry(*row[:-1]), row[-1]) for row in rows)) as whole:
            yield Contents(path, version, whole, verified)


@contextmanager
def _readable(path: Path) -> Iterator[Path]:
    """Where the journal can be read without changing anything.

    To read the log that a killed run has left, SQLite wants a third file beside it: where that is not there and cannot
    be made, the two are copied.
    """
    log, index = (path.with_name(path.name + suffix) for suffix in BESIDE)
    with ExitStack() as opened:
        if log.is_file() and not index.exists() and not os.access(path.parent, os.W_OK):
            folder = Path(opened.enter_context(TemporaryDirectory()))
            for part in (path, log):
                shutil.copy(part, folder)
            path = folder / path.name
        yield path


def read(path: Path, table: str) -> list[dict[str, Any]]:
    """All rows of one table or view of a journal, in order. Raises SourceError as `open_journal`."""
    with open_contents(path) as contents:
        return contents.rows(table)


def _problem(path: Path, what: str) -> SourceError:
    return SourceError([Problem(Mark(str(path), 0), what)])
