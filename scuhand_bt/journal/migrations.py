"""Journals of earlier versions, made into today's as they are read; the file itself is never touched."""

import json
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from datetime import datetime, timedelta
from typing import Any

from scuhand_bt.journal.hash_chain import COLUMNS, Entry
from scuhand_bt.journal.store import SCHEMA

_JSON_OF_RUN = ("simulated", "seed", "libraries")
"""What version 1 kept of a run as JSON; the rest was plain text."""
_NO_JOB = 1 << 62
"""What belongs to no job comes after the jobs of its time."""


def in_memory(links: Iterator[tuple[Entry, bytes]]) -> sqlite3.Connection:
    """A database in memory with these entries and their hashes, and all views of them."""
    values = ", ".join("?" * (len(Entry._fields) + 1))
    with ExitStack() as opened:
        database = opened.enter_context(closing(sqlite3.connect(":memory:", isolation_level=None)))
        database.executescript(SCHEMA)
        database.execute("BEGIN")
        database.executemany(
            f"INSERT INTO entry ({COLUMNS}, hash) VALUES ({values})", ((*e, stored) for e, stored in links)
        )
        database.execute("COMMIT")
        opened.pop_all()  # entries that are damaged leave none open
    return database


def is_as_made(database: sqlite3.Connection) -> bool:
    """Whether the tables, views and triggers of a database are word for word those of today, and no others."""
    with closing(in_memory(iter(()))) as made:
        return _schema(database) == _schema(made)


def _schema(database: sqlite3.Connection) -> list[tuple[str, str]]:
    return database.execute("SELECT name, sql FROM sqlite_schema ORDER BY name").fetchall()


def _from_tables(old: sqlite3.Connection) -> sqlite3.Connection:
    """1 to 2: from tables whose rows were changed as things went on, to entries; they carry no hash."""
    return in_memory((entry, b"") for entry in _entries_of_tables(old))


def _entries_of_tables(old: sqlite3.Connection) -> Iterator[Entry]:
    old.row_factory = sqlite3.Row
    run = {row["key"]: row["value"] for row in old.execute("SELECT key, value FROM run")}
    header = {key: json.loads(value) if key in _JSON_OF_RUN else value for key, value in run.items()}
    header["plant"] = None if run["plant"] == "null" else run["plant"]
    began = datetime.fromisoformat(header["started"])
    found = sorted(_happenings(old), key=lambda one: one[0])
    numbers = {("run", 0): 1}
    for seq, (_, _, owner, *_) in enumerate(found, start=2):
        if owner is not None:
            numbers[owner] = seq
    yield Entry(1, "run", None, None, 0.0, began.isoformat(), json.dumps(header), None, None)
    for seq, ((time_s, *_), kind, _, job, action, payload) in enumerate(found, start=2):
        of_job, of_action = (numbers.get(("job", job)), numbers.get(("action", action)))
        at = (began + timedelta(seconds=time_s)).isoformat(timespec="milliseconds")
        yield Entry(seq, kind, of_job, of_action, time_s, at, payload, None, None)


def _happenings(old: sqlite3.Connection) -> Iterator[tuple[Any, ...]]:
    """What to sort by, kind, (table, id) of what it begins, job, action, payload."""
    jobs = {row["id"]: row["job"] for row in old.execute("SELECT id, job FROM action")}
    for row in old.execute("SELECT * FROM job"):
        values = {key: row[key] for key in ("name", "sample", "attempt", "workflow")}
        yield (row["started_s"], row["id"], 0, 0, 0), "job_started", ("job", row["id"]), None, None, json.dumps(values)
        if row["outcome"] is not None:
            values = {key: row[key] for key in ("outcome", "code", "detail")}
            yield (row["ended_s"], row["id"], 4, 0, 0), "job_ended", None, row["id"], None, json.dumps(values)
    for row in old.execute("SELECT * FROM action"):
        values = {key: row[key] for key in ("path", "visit", "skill")} | {"inputs": json.loads(row["inputs"])}
        order = (row["started_s"], row["job"], 1, row["id"], 0)
        yield order, "action_started", ("action", row["id"]), row["job"], None, json.dumps(values)
        if row["outcome"] != "started":
            result = None if row["result"] is None else json.loads(row["result"])
            values = {"outcome": row["outcome"], "code": row["code"], "result": result}
            order = (row["ended_s"], row["job"], 1, row["id"], 2)
            yield order, "action_ended", None, row["job"], row["id"], json.dumps(values)
    for row in old.execute("SELECT * FROM pulse"):
        job = jobs.get(row["action"], _NO_JOB)
        yield (row["time_s"], job, 1, row["action"] or 0, 1), "pulse", None, job, row["action"], row["payload"]
    for row in old.execute("SELECT * FROM dose"):
        yield (row["time_s"], row["job"], 3, 0, 0), "dose", None, row["job"], None, row["payload"]
    for row in old.execute("SELECT * FROM event"):
        kind, is_of_end = row["kind"], row["kind"] in ("ended", "matter")
        is_result = is_of_end or kind == "sample"
        job = _NO_JOB if is_of_end else jobs.get(row["action"], _NO_JOB)
        action = None if is_result else row["action"]
        yield (row["time_s"], job, 5 if is_result else 1, action or 0, 1), kind, None, job, action, row["payload"]


MIGRATIONS: dict[int, Callable[[sqlite3.Connection], sqlite3.Connection]] = {1: _from_tables}
"""For each earlier version, what makes a database of the next one from it."""
