"""The journal: one SQLite file per run, written before an action starts and after it ends."""

import json
import sqlite3
from collections.abc import Callable, Mapping
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

from scuhand_bt.specs import Container, Dose, Powder, Source

SCHEMA_VERSION = 1
_SCHEMA = """
CREATE TABLE run (key TEXT PRIMARY KEY, value TEXT NOT NULL) STRICT;
CREATE TABLE job (
    id INTEGER PRIMARY KEY, name TEXT NOT NULL, sample TEXT, attempt INTEGER NOT NULL, workflow TEXT NOT NULL,
    started_s REAL NOT NULL, ended_s REAL, outcome TEXT, code TEXT, detail TEXT) STRICT;
CREATE TABLE action (
    id INTEGER PRIMARY KEY, job INTEGER NOT NULL REFERENCES job(id), path TEXT NOT NULL, visit INTEGER NOT NULL,
    skill TEXT NOT NULL, inputs TEXT NOT NULL, started_s REAL NOT NULL, ended_s REAL, outcome TEXT NOT NULL,
    code TEXT, result TEXT) STRICT;
CREATE TABLE pulse (
    id INTEGER PRIMARY KEY, action INTEGER REFERENCES action(id), time_s REAL NOT NULL, payload TEXT NOT NULL) STRICT;
CREATE TABLE dose (
    id INTEGER PRIMARY KEY, job INTEGER NOT NULL REFERENCES job(id), time_s REAL NOT NULL,
    payload TEXT NOT NULL) STRICT;
CREATE TABLE event (
    id INTEGER PRIMARY KEY, action INTEGER REFERENCES action(id), time_s REAL NOT NULL, kind TEXT NOT NULL,
    payload TEXT NOT NULL) STRICT;
"""


def plain_value(value: Any) -> Any:
    """A value as JSON can keep it; things of the lab by their name."""
    if isinstance(value, Container):
        return f"{value.id} ({value.name})"
    if isinstance(value, Source | Powder):
        return value.name
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json", by_alias=False)
    if is_dataclass(value) and not isinstance(value, type):
        return asdict(value)
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    return value if isinstance(value, str | int | float | bool | None) else str(value)


def to_json(values: Any) -> str:
    """Compact JSON with sorted keys."""
    whole = dict(values) if isinstance(values, Mapping) else plain_value(values)
    return json.dumps(whole, sort_keys=True, default=plain_value)


class Journal:
    """Writes one run. Every call is on disk (committed) when it returns.

    `durable` is full fsync, for real runs; a dry run goes without.
    """

    def __init__(self, path: Path, *, durable: bool) -> None:
        self.path = path
        path.parent.mkdir(parents=True, exist_ok=True)
        self._db = sqlite3.connect(path, isolation_level=None)
        self._db.execute("PRAGMA journal_mode=WAL")
        self._db.execute(f"PRAGMA synchronous={'FULL' if durable else 'OFF'}")
        self._db.executescript(_SCHEMA)
        self._db.execute(f"PRAGMA user_version={SCHEMA_VERSION}")
        self._job: int | None = None
        self.action: int | None = None
        """The action that is acting now; what devices record is its doing."""
        self.last_dose: Dose | None = None
        """The last dose of the current job."""
        self.now_s: Callable[[], float] = lambda: 0.0
        """The run's clock; set once the cell exists."""

    def describe_run(self, values: Mapping[str, Any]) -> None:
        """What the whole run is: recipe, seed, versions, simulated or not."""
        rows = [(key, value if isinstance(value, str) else json.dumps(value)) for key, value in values.items()]
        self._db.executemany("INSERT OR REPLACE INTO run VALUES (?, ?)", rows)

    def job_started(self, name: str, sample: str | None, attempt: int, workflow: str) -> None:
        cursor = self._db.execute(
            "INSERT INTO job (name, sample, attempt, workflow, started_s) VALUES (?, ?, ?, ?, ?)",
            (name, sample, attempt, workflow, self.now_s()),
        )
        self._job = cursor.lastrowid
        self.action = self.last_dose = None

    def job_ended(self, outcome: str, code: str | None = None, detail: str | None = None) -> None:
        self._db.execute(
            "UPDATE job SET ended_s = ?, outcome = ?, code = ?, detail = ? WHERE id = ?",
            (self.now_s(), outcome, code, detail, self._job),
        )

    def action_started(self, path: str, visit: int, skill: str, inputs: Mapping[str, Any]) -> int:
        cursor = self._db.execute(
            "INSERT INTO action (job, path, visit, skill, inputs, started_s, outcome) "
            "VALUES (?, ?, ?, ?, ?, ?, 'started')",
            (self._job, path, visit, skill, to_json(inputs), self.now_s()),
        )
        assert cursor.lastrowid is not None
        return cursor.lastrowid

    def action_ended(self, action: int, outcome: str, code: str | None, result: Any) -> None:
        self._db.execute(
            "UPDATE action SET ended_s = ?, outcome = ?, code = ?, result = ? WHERE id = ?",
            (self.now_s(), outcome, code, None if result is None else to_json(result), action),
        )

    # --- the Record that devices and skills write to

    def pulse(self, values: Mapping[str, Any]) -> None:
        self._db.execute(
            "INSERT INTO pulse (action, time_s, payload) VALUES (?, ?, ?)", (self.action, self.now_s(), to_json(values))
        )

    def dose(self, dose: Dose) -> None:
        self.last_dose = dose
        self._db.execute(
            "INSERT INTO dose (job, time_s, payload) VALUES (?, ?, ?)",
            (self._job, self.now_s(), dose.model_dump_json(by_alias=False)),
        )

    def event(self, kind: str, values: Mapping[str, Any]) -> None:
        self._db.execute(
            "INSERT INTO event (action, time_s, kind, payload) VALUES (?, ?, ?, ?)",
            (self.action, self.now_s(), kind, to_json(values)),
        )

    def close(self) -> None:
        self._db.close()

    def discard(self) -> None:
        """The run did not come about: no journal of it."""
        self.close()
        for suffix in ("", "-wal", "-shm"):
            self.path.with_name(self.path.name + suffix).unlink(missing_ok=True)


def read(path: Path, table: str) -> list[dict[str, Any]]:
    """All rows of one table of a journal, in order; JSON columns are decoded."""
    database = sqlite3.connect(f"file:{path}?mode=ro", uri=True)
    try:
        database.row_factory = sqlite3.Row
        rows = [dict(row) for row in database.execute(f"SELECT * FROM {table} ORDER BY rowid")]
    finally:
        database.close()
    for row in rows:
        for key in ("inputs", "result", "payload"):
            if row.get(key) is not None:
                row[key] = json.loads(row[key])
    return rows
