"""The file of a journal: one table of entries, added to in one transaction, and whose they are.

Entries are added behind the one that their writer knows, which is looked at in the transaction that adds them, so that
who was overtaken writes nothing more (in the literature: a fencing token). A file that is gone, or is another one now,
takes none either: `moved` then keeps all that there was, and the rest, in a new file elsewhere.
"""

import os
import shutil
import sqlite3
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from tempfile import gettempdir, mkdtemp

from scuhand_bt.journal.hash_chain import COLUMNS, GENESIS, Entry
from scuhand_bt.record import RecordLost

SCHEMA_VERSION = 2
Row = tuple[Entry, bytes]
"""An entry, and its hash."""
OVERTAKEN = "another process has gone on with this run"
_ENDED = """
    LEFT JOIN (SELECT {of} AS of, MAX(seq) AS seq FROM entry WHERE kind = '{of}_ended' GROUP BY {of}) AS last
        ON last.of = began.seq
    LEFT JOIN entry AS ended ON ended.seq = last.seq
    WHERE began.kind = '{of}_started' ORDER BY began.seq"""
SCHEMA = f"""
CREATE TABLE entry (
    seq INTEGER PRIMARY KEY, kind TEXT NOT NULL, job INTEGER, action INTEGER, time_s REAL NOT NULL, at TEXT NOT NULL,
    payload TEXT NOT NULL, state TEXT, frames BLOB, hash BLOB NOT NULL) STRICT;
CREATE TRIGGER entries_stay BEFORE UPDATE ON entry BEGIN SELECT RAISE(ABORT, 'entries are only added'); END;
CREATE TRIGGER entries_last BEFORE DELETE ON entry BEGIN SELECT RAISE(ABORT, 'entries are only added'); END;
CREATE VIEW run AS SELECT each.key AS key,
    CASE WHEN each.type IN ('true', 'false', 'null') THEN each.type ELSE CAST(each.value AS TEXT) END AS value
    FROM entry, json_each(entry.payload) AS each WHERE entry.kind = 'run';
CREATE VIEW job AS SELECT began.seq AS id,
    json_extract(began.payload, '$.name') AS name, json_extract(began.payload, '$.sample') AS sample,
    json_extract(began.payload, '$.attempt') AS attempt, json_extract(began.payload, '$.workflow') AS workflow,
    began.time_s AS started_s, ended.time_s AS ended_s, json_extract(ended.payload, '$.outcome') AS outcome,
    json_extract(ended.payload, '$.code') AS code, json_extract(ended.payload, '$.detail') AS detail
    FROM entry AS began {_ENDED.format(of="job")};
CREATE VIEW action AS SELECT began.seq AS id, began.job AS job,
    json_extract(began.payload, '$.path') AS path, json_extract(began.payload, '$.visit') AS visit,
    json_extract(began.payload, '$.skill') AS skill, json_extract(began.payload, '$.inputs') AS inputs,
    began.time_s AS started_s, ended.time_s AS ended_s,
    COALESCE(json_extract(ended.payload, '$.outcome'), 'started') AS outcome,
    json_extract(ended.payload, '$.code') AS code,
    NULLIF(json_quote(json_extract(ended.payload, '$.result')), 'null') AS result
    FROM entry AS began {_ENDED.format(of="action")};
CREATE VIEW pulse AS SELECT seq AS id, action, time_s, payload FROM entry WHERE kind = 'pulse' ORDER BY seq;
CREATE VIEW dose AS SELECT seq AS id, job, time_s, payload FROM entry WHERE kind = 'dose' ORDER BY seq;
CREATE VIEW event AS SELECT seq AS id, action, time_s, kind, payload FROM entry
    WHERE kind NOT IN ('run', 'job_started', 'job_ended', 'job_resumed', 'action_started', 'action_ended', 'pulse',
        'dose', 'frames') ORDER BY seq;
"""
_LAST = "SELECT seq, hash FROM entry ORDER BY seq DESC LIMIT 1"
_INSERT = f"INSERT INTO entry ({COLUMNS}, hash) VALUES (?{', ?' * len(Entry._fields)})"
BESIDE = ("-wal", "-shm")
"""What SQLite keeps beside a database that is written."""


def read_only(path: Path) -> sqlite3.Connection:
    """A database that is there, to be read; nothing of it is changed. Raises sqlite3.Error."""
    return sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True, isolation_level=None)


class Store:
    """One journal's file, made if there is none; `durable` is full fsync. Raises OSError, sqlite3.Error.

    Not to be used by two threads at once.
    """

    def __init__(self, path: Path, *, durable: bool) -> None:
        self.path = path
        self._durable = durable
        path.parent.mkdir(parents=True, exist_ok=True)
        self.db = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
        with ExitStack() as opened:
            opened.callback(self.db.close)
            self.db.execute("PRAGMA journal_mode=WAL")
            self.db.execute(f"PRAGMA synchronous={'FULL' if durable else 'OFF'}")
            if self.db.execute("PRAGMA user_version").fetchone()[0] == 0:
                self.db.executescript(f"BEGIN; {SCHEMA} PRAGMA user_version={SCHEMA_VERSION}; COMMIT;")
            self._file = path.stat()
            self.last = self._last()
            """The number and the hash of the last entry that this writer knows."""
            opened.pop_all()

    def add(self, rows: Sequence[Row]) -> None:
        """Put entries on disk, all or none. Raises RecordLost, sqlite3.Error, OSError: then it takes none any more."""
        self.db.execute("BEGIN IMMEDIATE")
        self.look()
        self.db.executemany(_INSERT, [(*entry, head) for entry, head in rows])
        self.db.execute("COMMIT")
        self.last = rows[-1][0].seq, rows[-1][1]

    def look(self) -> None:
        """Raises RecordLost for a file that is gone, or another, or that another process has added to."""
        if not self._is_there():
            raise RecordLost("another file stands in its place" if self.path.exists() else "it was taken away")
        if self._last() != self.last:
            raise RecordLost(OVERTAKEN)

    def moved(self, rows: Sequence[Row]) -> "Store | None":
        """A new file elsewhere with all that this writer has added here, and these; None where no place takes it."""
        try:
            found = self.db.execute(f"SELECT {COLUMNS}, hash FROM entry WHERE seq <= ? ORDER BY seq", self.last[:1])
            before = [(Entry(*row[:-1]), row[-1]) for row in found]
        except sqlite3.Error:
            before = []
        for folder in (self.path.parent.parent, Path(gettempdir()), Path("/dev/shm")):
            with suppress(OSError, sqlite3.Error, RecordLost), ExitStack() as opened:
                place = Path(mkdtemp(prefix="rescued-", dir=folder))
                opened.callback(shutil.rmtree, place, ignore_errors=True)
                new = Store(place / self.path.name, durable=self._durable)
                opened.callback(new.close)
                if before or rows:
                    new.add([*before, *rows])
                opened.pop_all()
                return new
        return None

    def close(self) -> None:
        """The journal is one file again, which may be copied as it is."""
        with suppress(sqlite3.Error):
            self.db.execute("PRAGMA journal_mode=DELETE")
        self.db.close()
        with suppress(OSError):
            if not self._is_there():  # what is left beside it would be read into whatever file comes to stand there
                for suffix in BESIDE:
                    self.path.with_name(self.path.name + suffix).unlink(missing_ok=True)

    def _is_there(self) -> bool:
        try:
            return os.path.samestat(self.path.stat(), self._file)
        except FileNotFoundError:
            return False

    def _last(self) -> tuple[int, bytes]:
        last: tuple[int, bytes] | None = self.db.execute(_LAST).fetchone()
        return last or (0, GENESIS)
