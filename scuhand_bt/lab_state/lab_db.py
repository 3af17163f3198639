"""The lab's own small database, `.scuhand/lab.db`: what was learnt and measured, the inventory, the ledger, and who
signs with a PIN.

Its schema is versioned (`PRAGMA user_version`). Opening it brings an older one up to date, in place and as one
transaction; one that a newer program has written is left alone. Rows are only ever added.
"""

import getpass
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

from scuhand_bt.problems import Mark, Problem, SourceError

MIGRATIONS = (
    """
    CREATE TABLE IF NOT EXISTS learnt (
        version INTEGER PRIMARY KEY, kind TEXT NOT NULL CHECK (kind IN ('powder', 'balance')), name TEXT NOT NULL,
        simulated INTEGER NOT NULL, run TEXT NOT NULL, at TEXT NOT NULL, belief TEXT NOT NULL) STRICT
    """,
    """
    CREATE TABLE inventory (
        id INTEGER PRIMARY KEY, cell TEXT NOT NULL, simulated INTEGER NOT NULL CHECK (simulated IN (0, 1)),
        kind TEXT NOT NULL CHECK (kind IN ('station', 'cone', 'sheet', 'changer', 'container')), name TEXT NOT NULL,
        powder TEXT NOT NULL, lot TEXT NOT NULL, mass_mg REAL, used INTEGER,
        run TEXT, operator TEXT, at TEXT NOT NULL, CHECK (run IS NOT NULL OR operator IS NOT NULL)) STRICT
    """,
    """
    CREATE TABLE measured (
        id INTEGER PRIMARY KEY, balance TEXT NOT NULL, figure TEXT NOT NULL,
        simulated INTEGER NOT NULL CHECK (simulated IN (0, 1)), value REAL, says TEXT NOT NULL, at TEXT NOT NULL) STRICT
    """,
    """
    CREATE TABLE ledger (
        number INTEGER PRIMARY KEY, at TEXT NOT NULL, run TEXT NOT NULL, occasion TEXT NOT NULL,
        entries INTEGER NOT NULL, head TEXT NOT NULL, key TEXT, hash TEXT NOT NULL, signature TEXT) STRICT
    """,
    """
    CREATE TABLE person (
        number INTEGER PRIMARY KEY, name TEXT NOT NULL, at TEXT NOT NULL, salt BLOB NOT NULL, hash BLOB NOT NULL) STRICT
    """,
    "ALTER TABLE inventory ADD COLUMN reason TEXT",
    """
    CREATE TABLE yielded (
        version INTEGER PRIMARY KEY, lot TEXT NOT NULL, mortar TEXT NOT NULL,
        simulated INTEGER NOT NULL CHECK (simulated IN (0, 1)), share REAL, run TEXT NOT NULL, at TEXT NOT NULL) STRICT
    """,
)
"""One statement for each version of the schema, from the one before."""
FILE = "lab.db"
LONGEST_S = 2.0
"""How long another process's transaction is waited for."""


@contextmanager
def reading_lab_db(folder: Path) -> Iterator[sqlite3.Connection | None]:
    """The lab's database as it is at one moment; None if there is none yet.

    Raises SourceError, naming the file and what to do, for one that is damaged, of a newer version, or locked.
    """
    path = folder / FILE
    with _located(path):
        if path.exists():
            with _transaction(path, "BEGIN") as database:
                yield database
        else:
            yield None


@contextmanager
def writing_lab_db(folder: Path, *, durable: bool = True) -> Iterator[sqlite3.Connection]:
    """The lab's database, made if there is none, as one transaction; `durable` is full fsync.

    Raises SourceError as `reading_lab_db`, and where it cannot be written.
    """
    path = folder / FILE
    with _located(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with _transaction(path, "BEGIN IMMEDIATE", durable=durable) as database:
            yield database


@contextmanager
def _transaction(path: Path, begin: str, *, durable: bool = True) -> Iterator[sqlite3.Connection]:
    with closing(sqlite3.connect(path, timeout=LONGEST_S, isolation_level=None)) as database:
        database.execute(f"PRAGMA synchronous={'FULL' if durable else 'OFF'}")
        if _version(database) != len(MIGRATIONS):
            _migrate(database, path)
        database.execute(begin)
        yield database
        database.execute("COMMIT")


@contextmanager
def _located(path: Path) -> Iterator[None]:
    """What goes wrong with the database, in the words of a user."""
    try:
        yield
    except sqlite3.OperationalError as error:
        raise _problem(path, f"the lab's database cannot be used: {error}") from None
    except (sqlite3.DatabaseError, ValueError) as error:  # ValueError: a row that cannot be understood
        what = f"the lab's database is damaged ({type(error).__name__}: {error})"
        raise _problem(path, f"{what}; move it away; then the inventory and all that was learnt begin anew") from None
    except OSError as error:
        raise _problem(path, f"the lab's database cannot be written: {error.strerror or error}") from None


def user_name() -> str:
    """Who uses this program."""
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # a user without a name, as in a container
        return "unknown"


def _version(database: sqlite3.Connection) -> int:
    version = database.execute("PRAGMA user_version").fetchone()[0]
    assert isinstance(version, int)
    return version


def _migrate(database: sqlite3.Connection, path: Path) -> None:
    database.execute("BEGIN IMMEDIATE")  # and look again: another process may have been at it
    if (version := _version(database)) > len(MIGRATIONS):
        what = f"the lab's database has the schema {version}, and this program knows {len(MIGRATIONS)}"
        raise _problem(path, f"{what}; a newer scuhand-bt has written it: use that one")
    for statement in MIGRATIONS[version:]:
        database.execute(statement)
    database.execute(f"PRAGMA user_version={len(MIGRATIONS)}")
    database.execute("COMMIT")


def _problem(path: Path, what: str) -> SourceError:
    return SourceError([Problem(Mark(str(path)), what)])
