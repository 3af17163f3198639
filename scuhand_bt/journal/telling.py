"""What happens in a run, told while it happens: its journal's entries in order, to a callback or as lines of JSON.

A thread of its own reads the journal, where an entry comes first: nobody is told what is not on disk. Who listens
slowly, or hangs, holds up nothing, and what waits to be told is in no memory. `docs/events.schema.json` describes a
line.
"""

import json
import threading
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import JsonValue

from scuhand_bt.journal.reader import open_journal
from scuhand_bt.journal.run_events import Resumed, RunBegun
from scuhand_bt.problems import SourceError

VERSION = 1
"""Of a line: one more when a reader of before would misread it. Kinds and fields are added without."""
LOOK_S = 0.1
AT_ONCE = 500
"""So many entries are read at a time."""
PATIENCE_S = 5.0
"""Once the run is over, who listens hears an entry within this time, or is waited for no longer."""
_BEGAN = f"SELECT MAX(seq) - 1 FROM entry WHERE kind IN ('{RunBegun.KIND}', '{Resumed.KIND}')"
_COLUMNS = "seq, kind, time_s, at, job, action, payload, frames"
_NEW = f"SELECT {_COLUMNS} FROM entry WHERE seq > ? ORDER BY seq LIMIT {AT_ONCE}"
EVENTS = f"SELECT {_COLUMNS} FROM entry ORDER BY seq"
"""Every entry of a journal, each for `event_of`."""


@dataclass(frozen=True)
class RunEvent:
    """Something that happened in a run: an entry of its journal, as `docs/journal.md` describes them."""

    seq: int
    """The entry's number, from 1 in a journal."""
    kind: str
    time_s: float
    """The run's time."""
    at: str
    """Wall time, ISO 8601 with its offset from UTC."""
    job: int | None
    """The number of the entry with which the job began that it belongs to."""
    action: int | None
    """And the action."""
    values: Mapping[str, JsonValue]
    """By the kind's model; of `frames` also the balance's `lines`: [time_s, raw, value_mg, unit, stable]."""

    def line(self) -> str:
        """As one line of JSON, all of it ASCII, without the line's end."""
        return json.dumps({"version": VERSION, **self.__dict__})


class Telling:
    """Tells of the session that has just been made; `journal` says where its journal is by now.

    `tell` is called on one thread, once for each entry from the one that the session began with. What it raises ends
    the telling, not the run, and is the `problem`.
    """

    def __init__(self, journal: Callable[[], Path], tell: Callable[[RunEvent], object]) -> None:
        self.problem: str | None = None
        """Why not all was told."""
        self._journal, self._tell = journal, tell
        self._seq: int | None = None
        self._told = 0
        self._reading = threading.Lock()
        self._is_over, self._has_given_up = threading.Event(), False
        self._thread = threading.Thread(target=self._run, daemon=True, name="telling")
        self._thread.start()

    @contextmanager
    def paused(self) -> Iterator[None]:
        """In here the journal is not open for reading: it is being closed."""
        with self._reading:
            yield

    def end(self) -> None:
        """The run is over: wait until all is told, as long as it is being heard."""
        self._is_over.set()
        told = None
        while self._thread.is_alive() and told != self._told:
            told = self._told
            self._thread.join(PATIENCE_S)
        if self._thread.is_alive():
            self._has_given_up = True
            self.problem = f"what happened was told up to entry {self._seq}: nobody hears any more"

    def _run(self) -> None:
        try:
            while not self._has_given_up:
                is_over = self._is_over.is_set()  # before the look: what was written until then is seen
                try:
                    found = self._new()
                except SourceError:  # it is lost, and where it goes on is not known yet
                    if is_over:
                        raise
                    found = []
                for event in found:
                    self._tell(event)
                    self._seq = event.seq
                    self._told += 1
                if not found and is_over:
                    return
                if not found:
                    self._is_over.wait(LOOK_S)
        except BaseException as error:  # whatever a listener does, the run is not to know
            self.problem = f"what happened was told up to entry {self._seq}: {type(error).__name__}: {error}"

    def _new(self) -> list[RunEvent]:
        with self._reading, open_journal(self._journal()) as (database, _):
            if self._seq is None:
                self._seq = database.execute(_BEGAN).fetchone()[0]
            rows = database.execute(_NEW, (self._seq,)).fetchall()
        return list(map(event_of, rows))


def event_of(row: tuple[Any, ...]) -> RunEvent:
    """What an entry's row tells."""
    seq, kind, time_s, at, job, action, payload, frames = row
    values: dict[str, JsonValue] = json.loads(payload)
    if frames is not None:
        values["lines"] = json.loads(zlib.decompress(frames))
    return RunEvent(seq, kind, time_s, at, job, action, values)
