"""The chain of a journal: every entry carries a hash of itself and of the entry before it.

Whoever alters, removes or inserts an entry breaks the chain from there on. Entries cut off at the end leave a
chain that is whole, so the last hash (the head) is printed when a run ends: compared with it, nothing is missing.
"""

import hashlib
import json
import sqlite3
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

GENESIS = hashlib.sha256(b"scuhand_bt journal").digest()
"""What the first entry is chained to."""


class Entry(NamedTuple):
    """One row of the journal, without its hash."""

    seq: int
    kind: str
    job: int | None
    """The entry that started the job it belongs to."""
    action: int | None
    """The entry that started the action it belongs to."""
    time_s: float
    """The run's time."""
    at: str
    """Wall time, ISO 8601 with its offset from UTC."""
    payload: str
    """JSON."""
    state: str | None
    """JSON: what the cell was believed to hold from here on, where that changed."""
    frames: bytes | None
    """Raw lines of the balance, compressed."""


NO_ENTRY = "there is no entry"
"""The problem of a journal whose program ended before its first one."""
COLUMNS = ", ".join(Entry._fields)
_as_text = json.JSONEncoder(ensure_ascii=True, separators=(",", ":")).encode


def digest(before: bytes, entry: Entry) -> bytes:
    """SHA-256 over the hash of the entry before and everything in this one."""
    frames = b"" if entry.frames is None else b"\0" + entry.frames
    return hashlib.sha256(before + _as_text(entry[:-1]).encode() + frames).digest()


@dataclass(frozen=True)
class Verified:
    """What was found: the head of the chain as far as it is whole, and what is wrong, if anything is."""

    entries: int
    head: str
    problem: str | None


def verify(database: sqlite3.Connection, head: str | None = None) -> Verified:
    """Follow the chain from its beginning; `head` is what it should end in.

    Raises sqlite3.Error for a database without entries' table; what cannot be read in it is a problem found.
    """
    last, count, problem = GENESIS, 0, None
    for entry, stored in _entries(database):
        if entry is None:
            problem = f"entry {count + 1} cannot be read"
        elif entry.seq != count + 1:
            is_gap = entry.seq > count + 1
            problem = f"entry {count + 1} is missing" if is_gap else f"entry {entry.seq} is out of place"
        elif not _is_digest(stored, last, entry):
            problem = f"entry {entry.seq} ({entry.kind}, {entry.at}) was altered"
        else:
            last, count = stored, entry.seq
            continue
        return Verified(count, last.hex(), problem)
    if not count:
        problem = NO_ENTRY
    elif head is not None and head != last.hex():
        problem = (
            f"the chain ends in {last.hex()}, not in {head}: entries after {count} are missing, or it is another run"
        )
    return Verified(count, last.hex(), problem)


def _entries(database: sqlite3.Connection) -> Iterator[tuple[Entry | None, bytes]]:
    """Every entry with the hash it carries; None, at last, for one that cannot be read."""
    cursor = database.execute(f"SELECT {COLUMNS}, hash FROM entry ORDER BY seq")
    while True:
        try:
            row = cursor.fetchone()
        except sqlite3.Error:
            yield None, b""
            return
        if row is None:
            return
        yield Entry(*row[:-1]), row[-1]


def _is_digest(stored: object, before: bytes, entry: Entry) -> bool:
    try:
        return digest(before, entry) == stored
    except TypeError:  # a value of a type that no journal has
        return False
