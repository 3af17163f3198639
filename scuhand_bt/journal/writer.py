"""The journal: one SQLite file per run, written before an action starts and after it ends.

It is one table of entries, which are only ever added, and chained by their hashes (`journal/hash_chain.py`). What a
reader would rather see (jobs, actions, pulses, doses, events) are views of it.
"""

import json
import sqlite3
import time
import zlib
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from datetime import datetime
from pathlib import Path

from pydantic import JsonValue

from scuhand_bt.devices.interfaces import Reading
from scuhand_bt.events import BracketClosed, ContainerLifted, Dose, DoseBegun, DoseWeighed, Event, Note
from scuhand_bt.journal.events import ActionEnded, ActionStarted, Frames, JobEnded, JobResumed, JobStarted
from scuhand_bt.journal.hash_chain import COLUMNS, GENESIS, Entry, digest
from scuhand_bt.journal.plain import to_json
from scuhand_bt.record import RecordLost

SCHEMA_VERSION = 2
POINTS_OF_NO_RETURN = (DoseBegun, DoseWeighed, ContainerLifted, BracketClosed)
"""What is weighed before powder falls or a container goes: what is believed then is written with it, in mid-action."""
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
        self.state: Callable[[], Mapping[str, JsonValue] | None] = lambda: None
        """What the cell is believed to hold now; set once the cell exists."""
        self.heard: Callable[[Event | Note], None] = lambda event: None
        """Told of every event once it is on disk."""
        self.job: int | None = None
        self.action: int | None = None
        """The action that is acting now; what devices record is its doing."""
        self.doses: list[Dose] = []
        """The doses of the current job."""
        self._lost = False
        self._state: Mapping[str, JsonValue] | None = None
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
    def last(self) -> tuple[int, str]:
        """The number and the hash of the last entry."""
        return self._seq, self._head.hex()

    @property
    def head(self) -> str:
        """The hash of the last entry: who knows it can tell whether any entry is missing."""
        return self._head.hex()

    def event(self, event: Event | Note) -> None:
        """Anything that happens within the job and the action that are at work, or beside them."""
        if isinstance(event, Dose):
            self.doses.append(event)
        self._append(event, with_state=isinstance(event, POINTS_OF_NO_RETURN))
        self.heard(event)

    def job_started(self, event: JobStarted) -> None:
        self.job = self.action = None
        self.doses = []
        self.job = self._append(event)

    def job_resumed(self, job: int, doses: Sequence[Dose]) -> None:
        """Go on with a job of this journal."""
        self.job, self.action, self.doses = job, None, list(doses)
        self._append(JobResumed())

    def job_ended(self, event: JobEnded) -> None:
        self.action = None
        self._append(event)

    def action_started(self, event: ActionStarted, *, weighs: bool = False) -> int:
        """Before the action acts; all readings of one that `weighs` what it lets flow are kept as they came."""
        self.action = None
        action = self._append(event, with_state=True)
        if weighs:
            self._weighing.add(action)
        return action

    def action_ended(self, action: int, event: ActionEnded) -> None:
        self.flush()
        self._weighing.discard(action)
        self.action = action
        self._append(event, with_state=True)
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
        self._append(Frames(readings=len(lines)), frames=frames)

    def _append(self, event: Event | Note, *, with_state: bool = False, frames: bytes | None = None) -> int:
        if self._lost:
            return self._seq
        self.before_commit()  # first, for it may have something to say itself
        kind, payload = event.entry()
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
