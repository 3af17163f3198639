"""The chain of a journal: every entry carries a hash of itself and of the entry before it.

Whoever alters, removes or inserts an entry breaks the chain from there on. Entries cut off at the end leave a
chain that is whole, so the last hash (the head) is printed when a run ends: compared with it, nothing is missing.
"""

import hashlib
import json
import sqlite3
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

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


COLUMNS = ", ".join(Entry._fields)


def digest(before: bytes, entry: Entry) -> bytes:
    """SHA-256 over the hash of the entry before and everything in this one."""
    text = json.dumps(entry[:-1], ensure_ascii=True, separators=(",", ":"))
    return hashlib.sha256(before + text.encode() + b"\0" + (entry.frames or b"")).digest()


@dataclass(frozen=True)
class Verified:
    """What was found: the head of the chain as far as it is whole, and what is wrong, if anything is."""

    entries: int
    head: str
    problem: str | None


def verify(database: sqlite3.Connection, head: str | None = None) -> Verified:
    """Follow the chain from its beginning; `head` is what it should end in."""
    last, count = GENESIS, 0
    for entry, stored in _entries(database):
        if entry.seq != count + 1:
            missing = f"entry {count + 1} is missing" if entry.seq > count + 1 else f"entry {entry.seq} is out of place"
            return Verified(count, last.hex(), missing)
        if digest(last, entry) != stored:
            return Verified(count, last.hex(), f"entry {entry.seq} ({entry.kind}, {entry.at}) was altered")
        last, count = stored, entry.seq
    problem = None
    if not count:
        problem = "there is no entry"
    elif head is not None and head != last.hex():
        problem = (
            f"the chain ends in {last.hex()}, not in {head}: entries after {count} are missing, or it is another run"
        )
    return Verified(count, last.hex(), problem)


def _entries(database: sqlite3.Connection) -> Iterator[tuple[Entry, bytes]]:
    for row in database.execute(f"SELECT {COLUMNS}, hash FROM entry ORDER BY seq"):
        yield Entry(*row[:-1]), bytes(row[-1]) if isinstance(row[-1], bytes) else b""


def decoded(text: str | None) -> Any:
    """A JSON column's value."""
    return None if text is None else json.loads(text)
