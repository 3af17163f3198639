"""The journal: one SQLite file per run, written before an action starts and after it ends.

It is one table of entries, which are only ever added, and chained by their hashes (`journal/hash_chain.py`). What a
reader would rather see (jobs, actions, pulses, doses, events) are views of it.

The file (`journal/store.py`) is written beside the run's tick: what happens is numbered and chained where it happens, a
thread puts it on disk, in that order, and what may only begin once it is there waits for `waits`. A dry run, whose time
stands still meanwhile, gathers what happens at one moment, and writes it in one piece before time goes on. A journal
that is lost (removed, replaced, overtaken by another process, on a full disk) ends the run, and what happens until then
is kept in a file elsewhere.
"""

import json
import sqlite3
import threading
import time
import zlib
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from pydantic import JsonValue

from scuhand_bt.clock import Signal, Wake, wall_time
from scuhand_bt.devices.interfaces import Reading
from scuhand_bt.events.cell import Discarded, Returned
from scuhand_bt.events.doses import CurveRow, DoseCurve
from scuhand_bt.events.entry import Event, Note
from scuhand_bt.events.weighings import BracketClosed, ContainerLifted, DoseBegun, DoseWeighed
from scuhand_bt.journal.events import ActionEnded, ActionStarted, Frames, JobEnded, JobResumed, JobStarted
from scuhand_bt.journal.hash_chain import GENESIS, Entry, digest
from scuhand_bt.journal.plain import to_json
from scuhand_bt.journal.results import SoFar
from scuhand_bt.journal.store import BESIDE, Row, Store
from scuhand_bt.record import RecordLost

POINTS_OF_NO_RETURN = (DoseBegun, DoseWeighed, ContainerLifted, BracketClosed, Returned, Discarded)
"""What is weighed before powder falls or a container goes, and that the cone was emptied, as it may tip from then on:
what is believed is written with it, in mid-action."""
FLUSH_S = 0.5
"""Readings of the balance, and the course of a dose, wait this long in memory, by the wall's time, before they are
written down."""
LOOK_S = 0.25
"""So often it is seen whether the journal's file is still there, and this run's."""


class Journal:
    """Writes one run, new or continued.

    `durable` is full fsync, for real runs; a dry run goes without. Every call is committed when it returns, or, with
    `is_beside` or where it `gathers`, waits for no disk (but for `commit`, `settle` and `close`). Every call may raise
    RecordLost, once: what is told to a lost journal after that goes to where it is `kept_in`, so that the cell can
    still be made safe. Raises OSError, sqlite3.Error for a file that is none.

    One that is not `is_kept` has no file: of what happens it only tells who listens.
    """

    def __init__(self, path: Path, *, durable: bool, is_kept: bool = True) -> None:
        self.path = path
        self.is_kept = is_kept
        self.is_beside = False
        """Whether a thread beside puts entries on disk; set where time is real."""
        self.gathers = False
        """Whether entries wait for `commit`: set where time stands still, and who lets it go on calls that first."""
        self.news = Signal()
        """Fires when entries have come on disk, or never will."""
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
        self.so_far = SoFar()
        """What the current job tells of its sample."""
        self._lost: RecordLost | None = None
        self._is_told = False
        self._state: Mapping[str, JsonValue] | None = None
        self._readings: deque[Reading] = deque()
        self._course: list[CurveRow] = []
        self._weighing: set[int] = set()
        self._flushed_at_s = time.monotonic()
        self._store: Store | None = Store(path, durable=durable) if is_kept else None
        self._seq, self._head = self._store.last if self._store is not None else (0, GENESIS)
        self._on_disk = self._seq
        self._queue: list[tuple[Row, Event | Note | None]] = []
        self._numbering = threading.Lock()
        self._writing = threading.Lock()
        self._wanted, self._closing = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._keep_writing, daemon=True, name="journal") if is_kept else None
        if self._thread is not None:
            self._thread.start()

    @property
    def last(self) -> tuple[int, str]:
        """The number and the hash of the last entry."""
        with self._numbering:
            return self._seq, self._head.hex()

    @property
    def head(self) -> str:
        """The hash of the last entry: who knows it can tell whether any entry is missing."""
        return self._head.hex()

    @property
    def kept_in(self) -> Path | None:
        """Where all that has happened is: elsewhere than in `path` once that was lost, None where it is nowhere."""
        return self._store.path if self._store is not None else None

    def waits(self, seq: int | None = None) -> Wake | None:
        """What is to be waited for until an entry (None: all there are) is on disk; None where it is.

        Or will be before time goes on: until then nothing acts.
        """
        wake = Wake.on(self.news)
        return None if self.gathers or self._on_disk >= (self._seq if seq is None else seq) else wake

    def commit(self) -> None:
        """Write what was gathered, if there is any."""
        if self.gathers and self._queue:
            self.settle()

    @property
    def lost(self) -> RecordLost | None:
        """Why nothing is written to its path any more, whoever was told of it; None while it is."""
        return self._lost

    def settle(self) -> None:
        """Wait until all is on disk: only where nothing moves. Raises RecordLost, once, where it cannot be."""
        if self.gathers:
            self._before_commit()
        self._write()
        self._raise_lost()

    def keep_up(self) -> None:
        """To be called all through a run: readings that have waited are written, and a lost journal is said to be."""
        self.flush(FLUSH_S)
        self._raise_lost()

    def event(self, event: Event | Note) -> None:
        """Anything that happens within the job and the action that are at work, or beside them."""
        self.so_far.note(event)
        self._append(event, with_state=isinstance(event, POINTS_OF_NO_RETURN), is_told=True)

    def course(self, point: CurveRow) -> None:
        """A point of a dose's course; it may wait in memory, and is kept with the readings that it goes by."""
        self._course.append(point)

    def job_started(self, event: JobStarted) -> None:
        self.job = self.action = None
        self.so_far = SoFar()
        self.job = self._append(event)

    def job_resumed(self, job: int, so_far: SoFar) -> None:
        """Go on with a job of this journal."""
        self.job, self.action, self.so_far = job, None, so_far.copy()
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
        if self._weighing and self.is_kept:
            self._readings.append(reading)

    def flush(self, older_than_s: float = 0.0) -> None:
        """Write the balance's readings and the dose's course down, if some may have waited for so long.

        A power cut comes in the wall's time: a dry run, whose own time flies, writes larger parts, and not more often.
        """
        waiting = self._readings
        if not (waiting or self._course) or time.monotonic() - self._flushed_at_s < older_than_s:
            return
        self._flushed_at_s = time.monotonic()
        self.action = max(self._weighing, default=None)
        if self._course:
            course, self._course = self._course, []
            self._append(DoseCurve(points=tuple(course)))
        readings = [waiting.popleft() for _ in range(len(waiting))]  # others may come meanwhile
        if not readings:
            return
        lines = [[round(r.time_s, 4), r.raw.decode("latin-1"), r.value_mg, r.unit, r.stable] for r in readings]
        frames = zlib.compress(json.dumps(lines).encode(), 1)
        self._append(Frames(readings=len(lines)), frames=frames)

    def _append(
        self, event: Event | Note, *, with_state: bool = False, frames: bytes | None = None, is_told: bool = False
    ) -> int:
        if not self.is_kept:
            self._seq += 1
            self._on_disk = self._seq  # nobody is to wait
            if is_told:
                self.heard(event)
            return self._seq
        if not self.gathers:
            self._before_commit()  # first, for it may have something to say itself
        with self._numbering:
            kind, payload = event.entry()
            state = self._changed_state() if with_state else None
            at = wall_time("milliseconds")
            seq = self._seq + 1
            entry = Entry(seq, kind, self.job, self.action, self.now_s(), at, payload, state, frames)
            self._seq, self._head = seq, digest(self._head, entry)
            self._queue.append(((entry, self._head), event if is_told else None))
        if self.is_beside:
            self._wanted.set()
        elif not self.gathers:
            self._write()
        self._raise_lost()
        return seq

    def _before_commit(self) -> None:
        if self._lost is None:
            self.before_commit()

    def _keep_writing(self) -> None:
        while not self._closing.is_set():
            self._wanted.wait(LOOK_S)
            self._wanted.clear()
            self._write(takes=not self.gathers)

    def _write(self, *, takes: bool = True) -> None:
        """Put on disk what waits, where it `takes` that, or see that the file is still there to take more."""
        with self._writing:
            with self._numbering:
                waiting, self._queue = (self._queue, []) if takes else ([], self._queue)
            rows = [row for row, _ in waiting]
            try:
                if self._store is not None and rows:
                    self._store.add(rows)
                elif self._store is not None:
                    self._store.look()
            except (RecordLost, sqlite3.Error, OSError) as why:
                self._lose(why, rows)
            if rows:
                self._on_disk = rows[-1][0].seq
        for _, event in waiting:
            if event is not None:
                self.heard(event)
        if self.is_beside and rows:
            self.news.fire()

    def _lose(self, why: Exception, rows: Sequence[Row]) -> None:
        assert self._store is not None
        before, self._store = self._store, self._store.moved(rows)
        before.close()
        if self._lost is None:
            where = f"what happened is in {self.kept_in}" if self.kept_in else "what happens now is kept nowhere"
            self._lost = RecordLost(f"the journal {self.path} cannot be written any more: {why}; {where}")
        self.news.fire()

    def _raise_lost(self) -> None:
        if self._lost is not None and not self._is_told:
            self._is_told = True
            raise self._lost

    def _changed_state(self) -> str | None:
        state = self.state()
        if state == self._state:
            return None
        self._state = state
        return to_json(state)

    def close(self) -> None:
        """Wait until all is on disk; the journal is one file again, which may be copied as it is. Once is enough."""
        if self._closing.is_set():
            return
        self._closing.set()
        self._wanted.set()
        if self._thread is not None:
            self._thread.join()
        if self.gathers:
            self._before_commit()
        self._write()
        if self._store is not None:
            self._store.close()

    def discard(self) -> None:
        """The run did not come about: no journal of it."""
        self.close()
        for suffix in ("", *BESIDE):
            self.path.with_name(self.path.name + suffix).unlink(missing_ok=True)
