"""The journal: one SQLite file per run, written before an action starts and after it ends.

It is one table of entries, which are only ever added, and chained by their hashes (`journal/hash_chain.py`). What a
reader would rather see (jobs, actions, pulses, doses, events) are views of it.
"""

import json
import math
import sqlite3
import time
import zlib
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict, is_dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

from scuhand_bt.devices.interfaces import Reading
from scuhand_bt.journal.hash_chain import COLUMNS, GENESIS, Entry, digest
from scuhand_bt.record import RecordLost
from scuhand_bt.specs import Container, Dose, Powder, Source

SCHEMA_VERSION = 2
FLUSH_S = 0.5
"""Readings of the balance wait this long in memory, by the wall's time, before they are written down."""
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
_INSERT = f"INSERT INTO entry ({COLUMNS}, hash) VALUES (?{', ?' * len(Entry._fields)})"


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


_to_json = json.JSONEncoder(sort_keys=True, default=plain_value, allow_nan=False).encode


def to_json(values: Any) -> str:
    """Compact JSON with sorted keys; what is no number in JSON (NaN, infinity) by its name."""
    whole = dict(values) if isinstance(values, Mapping) else plain_value(values)
    try:
        return _to_json(whole)
    except ValueError:
        return json.dumps(_named_infinities(json.loads(json.dumps(whole, default=plain_value))), sort_keys=True)


def _named_infinities(value: Any) -> Any:
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    if isinstance(value, dict):
        return {key: _named_infinities(item) for key, item in value.items()}
    return [_named_infinities(item) for item in value] if isinstance(value, list) else value


class Journal:
    """Writes one run, new or continued. Every call is on disk (committed) when it returns.

    `durable` is full fsync, for real runs; a dry run goes without. Every call may raise RecordLost, once: what
    is told to a lost journal after that is dropped, so that the cell can still be made safe.
    """

    def __init__(self, path: Path, *, durable: bool) -> None:
        self.path = path
        self.before_commit: Callable[[], None] = lambda: None
        """Called before every write: a simulated world keeps itself, so that it is never older than the journal."""
        self.now_s: Callable[[], float] = lambda: 0.0
        """The run's clock; set once the cell exists."""
        self.state: Callable[[], Any] = lambda: None
        """What the cell is believed to hold now; set once the cell exists."""
        self.heard: Callable[[str, Mapping[str, Any]], None] = lambda kind, values: None
        """Told of every event once it is on disk."""
        self.job: int | None = None
        self.action: int | None = None
        """The action that is acting now; what devices record is its doing."""
        self.last_dose: Dose | None = None
        """The last dose of the current job."""
        self._lost = False
        self._state: Any = None
        self._readings: deque[Reading] = deque()
        self._weighing: set[int] = set()
        self._flushed_at_s = time.monotonic()
        path.parent.mkdir(parents=True, exist_ok=True)
        self._db = sqlite3.connect(path, isolation_level=None)
        self._db.execute("PRAGMA journal_mode=WAL")
        self._db.execute(f"PRAGMA synchronous={'FULL' if durable else 'OFF'}")
        if self._db.execute("PRAGMA user_version").fetchone()[0] == 0:
            self._db.executescript(f"BEGIN; {SCHEMA} PRAGMA user_version={SCHEMA_VERSION}; COMMIT;")
        last = self._db.execute("SELECT seq, hash FROM entry ORDER BY seq DESC LIMIT 1").fetchone()
        self._seq: int = last[0] if last else 0
        self._head: bytes = last[1] if last else GENESIS

    @property
    def head(self) -> str:
        """The hash of the last entry: who knows it can tell whether any entry is missing."""
        return self._head.hex()

    def describe_run(self, values: Mapping[str, Any]) -> None:
        """What the whole run is: recipe, seed, versions, simulated or not; the first entry."""
        self._append("run", to_json(values))

    def job_started(self, name: str, sample: str | None, attempt: int, workflow: str) -> None:
        self.job = self.action = self.last_dose = None
        values = {"name": name, "sample": sample, "attempt": attempt, "workflow": workflow}
        self.job = self._append("job_started", to_json(values))

    def job_resumed(self, job: int, dose: Dose | None) -> None:
        """Go on with a job of this journal."""
        self.job, self.action, self.last_dose = job, None, dose
        self._append("job_resumed", "{}")

    def job_ended(self, outcome: str, code: str | None = None, detail: str | None = None) -> None:
        self.action = None
        self._append("job_ended", to_json({"outcome": outcome, "code": code, "detail": detail}))

    def action_started(
        self, path: str, visit: int, skill: str, inputs: Mapping[str, Any], *, weighs: bool = False
    ) -> int:
        """Before the action acts; all readings of one that `weighs` what it lets flow are kept as they came."""
        self.action = None
        values = {"path": path, "visit": visit, "skill": skill, "inputs": inputs}
        action = self._append("action_started", to_json(values), with_state=True)
        if weighs:
            self._weighing.add(action)
        return action

    def action_ended(self, action: int, outcome: str, code: str | None, result: Any) -> None:
        self.flush()
        self._weighing.discard(action)
        self.action = action
        self._append("action_ended", to_json({"outcome": outcome, "code": code, "result": result}), with_state=True)
        self.action = None

    def weighed(self, reading: Reading) -> None:
        """Hear a reading of the balance; called on whichever thread it arrives."""
        if self._weighing:
            self._readings.append(reading)

    def flush(self, older_than_s: float = 0.0) -> None:
        """Write the balance's readings down, if some may have waited for so long.

        A power cut comes in the wall's time: a dry run, whose own time flies, writes larger parts, and not more often.
        """
        waiting = self._readings
        if not waiting or time.monotonic() - self._flushed_at_s < older_than_s:
            return
        self._flushed_at_s = time.monotonic()
        readings = [waiting.popleft() for _ in range(len(waiting))]  # others may come meanwhile
        lines = [[round(r.time_s, 4), r.raw.decode("latin-1"), r.value_mg, r.unit, r.stable] for r in readings]
        frames = zlib.compress(json.dumps(lines).encode(), 1)
        self.action = max(self._weighing, default=None)
        self._append("frames", json.dumps({"readings": len(lines)}), frames=frames)

    # --- the Record that devices and skills write to

    def pulse(self, values: Mapping[str, Any]) -> None:
        self._append("pulse", to_json(values))

    def dose(self, dose: Dose) -> None:
        self.last_dose = dose
        self._append("dose", dose.model_dump_json(by_alias=False))

    def event(self, kind: str, values: Mapping[str, Any]) -> None:
        self._append(kind, to_json(values))
        self.heard(kind, values)

    def _append(self, kind: str, payload: str, *, with_state: bool = False, frames: bytes | None = None) -> int:
        if self._lost:
            return self._seq
        self.before_commit()  # first, for it may have something to say itself
        state = self._changed_state() if with_state else None
        at = datetime.now().astimezone().isoformat(timespec="milliseconds")
        seq = self._seq + 1
        entry = Entry(seq, kind, self.job, self.action, self.now_s(), at, payload, state, frames)
        head = digest(self._head, entry)
        try:
            self._db.execute(_INSERT, (*entry, head))
        except sqlite3.Error as error:
            self._lost = True
            raise RecordLost(f"the journal {self.path} cannot be written any more: {error}") from error
        self._seq, self._head = seq, head
        return seq

    def _changed_state(self) -> str | None:
        state = self.state()
        if state == self._state:
            return None
        self._state = state
        return to_json(state)

    def close(self) -> None:
        """The journal is one file again, which may be copied as it is."""
        with suppress(sqlite3.Error):
            self._db.execute("PRAGMA journal_mode=DELETE")
        self._db.close()

    def discard(self) -> None:
        """The run did not come about: no journal of it."""
        self.close()
        for suffix in ("", "-wal", "-shm"):
            self.path.with_name(self.path.name + suffix).unlink(missing_ok=True)
