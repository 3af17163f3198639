"""The lab's ledger: the heads of all its runs' journals, in a chain of its own, outside of them.

A journal's chain shows that its entries fit together; whoever writes the file can write a whole other chain. So every
run writes its head into the ledger when it begins, after each job on a real cell, and when it ends, and its journal's
first entry has the ledger's head. Who would rewrite one run must rewrite the ledger from there on, and every later
journal with it; a head of the ledger that was noted elsewhere (`scuhand-bt ledger`) shows even that.

A line may be signed (`SCUHAND_BT_KEY` names an Ed25519 key; extra `sign`): who has no key cannot write such a line.
"""

import hashlib
import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Literal, NamedTuple

from scuhand_bt.lab_state.lab_db import lab_db
from scuhand_bt.lab_state.signing import Signer, is_signed_by, signer_of_file

KEY_VARIABLE = "SCUHAND_BT_KEY"
GENESIS = hashlib.sha256(b"scuhand_bt ledger").hexdigest()
"""What the first line is chained to."""

Occasion = Literal["begun", "resumed", "job", "ended"]


class Line(NamedTuple):
    """What a run's journal was at a time."""

    number: int
    at: str
    """Wall time, ISO 8601 with its offset from UTC."""
    run: str
    occasion: Occasion
    entries: int
    head: str
    """The hash of its last entry then."""
    key: str | None
    """The public key that signed the line, in hexadecimal digits."""


_COLUMNS = (*Line._fields, "hash", "signature")


@dataclass(frozen=True)
class Kept:
    """A line as the ledger has it."""

    line: Line
    hash: str
    """SHA-256 over the hash of the line before and everything in this one."""
    signature: str | None

    @property
    def is_signed(self) -> bool:
        """Whether the key that it names has signed it. Raises SourceError without `cryptography`."""
        return self.line.key is not None and is_signed_by(self.line.key, self.hash, self.signature or "")


@dataclass(frozen=True)
class LedgerFound:
    """The ledger as far as it is whole, and what is wrong with it, if anything is."""

    kept: tuple[Kept, ...]
    problem: str | None

    @property
    def head(self) -> str:
        return self.kept[-1].hash if self.kept else GENESIS

    def of(self, run: str) -> list[Kept]:
        return [one for one in self.kept if one.line.run == run]

    def holds(self, head: str) -> bool:
        """Whether this was the ledger's head once."""
        return head == GENESIS or any(one.hash == head for one in self.kept)


class Ledger:
    """The ledger of a lab; `folder` holds its database. See `lab_db` for the errors of reading and writing.

    Raises SourceError for a key that cannot be used.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        named = os.environ.get(KEY_VARIABLE)
        self._signer: Signer | None = signer_of_file(Path(named)) if named else None

    def last(self) -> tuple[str, str | None]:
        """The head, and the wall time of the last line; nothing is verified."""
        with lab_db(self._folder, write=False) as database:
            row = database and database.execute("SELECT hash, at FROM ledger ORDER BY number DESC LIMIT 1").fetchone()
            return (row[0], row[1]) if row else (GENESIS, None)

    def add(self, run: str, occasion: Occasion, entries: int, head: str, *, durable: bool) -> None:
        """Write down what a run's journal is now."""
        at = datetime.now().astimezone().isoformat(timespec="milliseconds")
        with lab_db(self._folder, write=True, durable=durable) as database:
            assert database is not None
            last = database.execute("SELECT number, hash FROM ledger ORDER BY number DESC LIMIT 1").fetchone()
            number, before = (last[0] + 1, last[1]) if last else (1, GENESIS)
            key = self._signer.key if self._signer is not None else None
            line = Line(number, at, run, occasion, entries, head, key)
            digest = _digest(before, line)
            signature = self._signer.sign(digest) if self._signer is not None else None
            marks = ", ".join("?" * len(_COLUMNS))
            database.execute(f"INSERT INTO ledger ({', '.join(_COLUMNS)}) VALUES ({marks})", (*line, digest, signature))

    def verified(self) -> LedgerFound:
        """All lines, each held against the one before it; signatures are looked at one by one (`Kept.is_signed`)."""
        kept: list[Kept] = []
        before = GENESIS
        for one in self._lines():
            if one.line.number != len(kept) + 1:
                return LedgerFound(tuple(kept), f"line {len(kept) + 1} is missing")
            if one.hash != _digest(before, one.line):
                return LedgerFound(tuple(kept), f"line {one.line.number} ({one.line.run}) was altered")
            kept.append(one)
            before = one.hash
        return LedgerFound(tuple(kept), None)

    def _lines(self) -> Iterator[Kept]:
        with lab_db(self._folder, write=False) as database:
            if database is None:
                return
            rows = database.execute(f"SELECT {', '.join(_COLUMNS)} FROM ledger ORDER BY number").fetchall()
        for row in rows:
            yield Kept(Line(*row[:-2]), row[-2], row[-1])


def _digest(before: str, line: Line) -> str:
    return hashlib.sha256(before.encode() + json.dumps(line, separators=(",", ":")).encode()).hexdigest()
