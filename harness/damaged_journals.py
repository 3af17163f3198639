"""Damaged journals: what reads them ends in a clean error or a correct result, and no change goes unnoticed."""

import random
import shutil
import sqlite3
from collections import Counter
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

from scuhand_bt.journal.archive import story, summary
from scuhand_bt.journal.export import canonical_of
from scuhand_bt.journal.hash_chain import COLUMNS
from scuhand_bt.journal.reader import Contents, open_contents
from scuhand_bt.journal.store import SCHEMA, SCHEMA_VERSION
from scuhand_bt.problems import SourceError
from scuhand_bt.report.run_story import chain_line, header_lines, told
from scuhand_bt.report.weighing_record import weighing_csv
from scuhand_bt.run.resume import checked_history


def mutated(whole: bytes, rng: random.Random) -> tuple[str, bytes]:
    """A journal's bytes, damaged: what was done to them, and what they are now."""
    kind = rng.choice(("cut", "bit", "bits", "zeroed", "swapped", "appended"))
    if kind == "cut":
        return kind, whole[: rng.randrange(len(whole))]
    if kind == "appended":
        return kind, whole + rng.randbytes(rng.randrange(1, 5000))
    data = bytearray(whole)
    if kind == "zeroed":
        at, length = rng.randrange(len(data)), rng.randrange(1, 5000)
        data[at : at + length] = bytes(len(data[at : at + length]))
    elif kind == "swapped":  # two of SQLite's pages
        pages = len(data) // 4096
        a, b = (4096 * rng.randrange(pages) for _ in range(2))
        data[a : a + 4096], data[b : b + 4096] = data[b : b + 4096], data[a : a + 4096]
    else:
        for _ in range(1 if kind == "bit" else rng.randrange(2, 9)):
            data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return kind, bytes(data)


def entries(contents: Contents) -> list[tuple[object, ...]]:
    return contents.database.execute("SELECT * FROM entry ORDER BY seq").fetchall()


def as_after_a_crash(journal: Path, folder: Path) -> Path:
    """The same journal with its second half still in SQLite's write-ahead log, as a killed program leaves it."""
    with closing(sqlite3.connect(journal)) as database:
        rows = database.execute(f"SELECT {COLUMNS}, hash FROM entry ORDER BY seq").fetchall()
    open_one, left = folder / "open.sqlite", folder / journal.name
    with closing(sqlite3.connect(open_one, isolation_level=None)) as database:
        database.execute("PRAGMA journal_mode=WAL")
        database.executescript(f"{SCHEMA} PRAGMA user_version={SCHEMA_VERSION};")
        insert = f"INSERT INTO entry ({COLUMNS}, hash) VALUES ({', '.join('?' * len(rows[0]))})"
        database.executemany(insert, rows[: len(rows) // 2])
        database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        database.execute("PRAGMA wal_autocheckpoint=0")
        for row in rows[len(rows) // 2 :]:
            database.execute(insert, row)
        shutil.copy(open_one, left)
        shutil.copy(f"{open_one}-wal", f"{left}-wal")
    return left


class Judge:
    """Knows a journal, and judges what its readers make of a damaged copy."""

    def __init__(self, journal: Path) -> None:
        with open_contents(journal) as contents:
            self._entries = entries(contents)
            self._head = contents.verified.head
            self._exports = self._exported(contents)

    def outcome(self, copy: Path) -> str:
        """What came of a damaged copy. Raises AssertionError for a change that goes unnoticed."""
        summary(copy)
        try:
            with open_contents(copy, self._head) as contents:
                problem = contents.verified.problem
                is_cut_off = problem is not None and "entries after" in problem
                assert entries(contents) == self._entries[: contents.verified.entries], "an altered entry was shown"
                if contents.verified.entries:
                    list(self._told(contents))
                if problem is None or is_cut_off:
                    exports = self._exported(contents)
                if problem is None:
                    assert len(self._entries) == contents.verified.entries, "an entry is gone, unnoticed"
                    assert exports == self._exports, "the exports are others"
        except SourceError:
            outcome = "refused"
        else:
            outcome = "unharmed" if problem is None else "found by the head" if is_cut_off else "found"
        try:
            checked_history(copy)
        except SourceError:
            return outcome
        assert outcome in ("unharmed", "found by the head"), "an altered run was to be resumed"
        return outcome

    @staticmethod
    def _exported(contents: Contents) -> tuple[str, str]:
        return canonical_of(contents), weighing_csv(contents)

    @staticmethod
    def _told(contents: Contents) -> Iterator[str]:
        found = story(contents)
        yield from header_lines(found)
        for happened in found["run"]:
            yield from told(happened)
        yield chain_line(found["chain"])


def mutations(journal: Path, folder: Path, count: int) -> dict[str, float]:
    """Judge many damaged copies of a journal, by their number's randomness; every third of its write-ahead log."""
    folder.mkdir()
    judge, outcomes = Judge(journal), Counter[str]()
    crashed = as_after_a_crash(journal, folder)
    wal = Path(f"{crashed}-wal")
    whole, half, logged = journal.read_bytes(), crashed.read_bytes(), wal.read_bytes()
    for seed in range(count):
        for rest in folder.iterdir():
            rest.unlink()
        is_logged = seed % 3 == 0
        kind, data = mutated(logged if is_logged else whole, random.Random(seed))
        crashed.write_bytes(half if is_logged else data)
        if is_logged:
            wal.write_bytes(data)
        try:
            outcomes[judge.outcome(crashed)] += 1
        except AssertionError as error:
            print(f"mutation {seed} ({kind}): {error}")
            outcomes["unnoticed"] += 1
        except Exception as error:
            print(f"mutation {seed} ({kind}): {type(error).__name__}: {error}")
            outcomes["broken"] += 1
    keys = ("refused", "found", "found by the head", "unharmed", "unnoticed", "broken")
    return {f"mutations_{key.replace(' ', '_')}": outcomes[key] for key in keys}
