"""A run as it is now, by its journal, for whoever watches from another process: each look reads only what is new.

Or as it was at an earlier time: then only what was written until then is read.
"""

import json
import math
import sqlite3
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from scuhand_bt.events.catalogue import SKILL_EVENTS
from scuhand_bt.events.doses import DoseCurve
from scuhand_bt.events.entry import Event
from scuhand_bt.events.weighings import BracketClosed, ContainerPlaced, Weighing
from scuhand_bt.failures import SkillFailed
from scuhand_bt.journal.events import (
    ActionEnded,
    ActionStarted,
    Answered,
    ArmMoves,
    Asked,
    Decided,
    Frames,
    GaveUp,
    JobEnded,
    JobResumed,
    JobStarted,
    PersonSoon,
    RoundsDone,
    TreeNode,
    WorkflowTree,
)
from scuhand_bt.journal.kinds import parsed
from scuhand_bt.journal.reader import open_journal
from scuhand_bt.journal.results import SampleResult
from scuhand_bt.journal.run_events import Continued, Ended, Paused, Resumed, RunBegun
from scuhand_bt.journal.standing import Standing
from scuhand_bt.journal.waiting import Waiting

_OF_RUN = (
    *(RunBegun, Resumed, WorkflowTree, JobStarted, JobEnded, SampleResult),
    *(PersonSoon, Asked, Answered, Paused, Continued, Ended),
)
_WEIGHINGS: tuple[type[Event], ...] = (
    *(ContainerPlaced, BracketClosed),
    *(kind for kind in SKILL_EVENTS if issubclass(kind, Weighing)),
)
_OF_JOB: tuple[type[Event], ...] = (
    JobResumed,
    ActionStarted,
    ActionEnded,
    Decided,
    GaveUp,
    RoundsDone,
    ArmMoves,
    DoseCurve,
    Frames,
    *_WEIGHINGS,
)
"""Told of the job that is under way alone: of those before it nobody looks any more."""


def _marks(kinds: Sequence[type[Event]]) -> str:
    return ", ".join(f"'{kind.KIND}'" for kind in kinds)


_LAST_JOB = f"SELECT MAX(seq) FROM entry WHERE kind = '{JobStarted.KIND}' AND time_s <= ?"
_NEW = f"""SELECT seq, action, at, time_s, kind, payload, frames FROM entry
    WHERE seq > ? AND time_s <= ? AND (kind IN ({_marks(_OF_RUN)}) OR (kind IN ({_marks(_OF_JOB)}) AND seq > ?))
    ORDER BY seq"""
_COURSE = f"""SELECT payload, frames FROM entry
    WHERE seq > ? AND time_s > ? AND action = ? AND kind IN ('{DoseCurve.KIND}', '{Frames.KIND}') ORDER BY seq"""
_STATE = """SELECT seq, time_s, state FROM entry WHERE seq > ? AND time_s <= ? AND state IS NOT NULL
    ORDER BY seq DESC LIMIT 1"""
_LAST_MOVE = f"""SELECT time_s, payload FROM entry WHERE kind = '{ArmMoves.KIND}' AND time_s <= ?
    ORDER BY seq DESC LIMIT 1"""


@dataclass
class ActionNow:
    """An action of the job that is under way."""

    skill: str
    path: str = ""
    outcome: str | None = None
    """None while it goes on."""
    failure: SkillFailed | None = None


@dataclass
class Follower:
    """Follows the journal at `path`; `look` brings it up to date. Nothing is verified."""

    path: Path
    until_s: float = math.inf
    """Run time that is looked at; what came after it is not seen."""
    begun: RunBegun | None = None
    trees: dict[str, Sequence[TreeNode]] = field(default_factory=dict)
    """What the workflows' trees look like, by the workflows' names."""
    samples: dict[str, SampleResult] = field(default_factory=dict)
    """What was said of each last, the newest last."""
    told_s: dict[str, tuple[float, float]] = field(default_factory=dict)
    """Run time at which the attempt that `samples` has was first judged, and how much of that it had stood still."""
    standing: Standing = field(default_factory=Standing)
    """How much of the run's time it has stood still."""
    resumed: int = 0
    """How often it was."""
    job: JobStarted | None = None
    job_ended: JobEnded | None = None
    """None while the job goes on."""
    actions: dict[int, ActionNow] = field(default_factory=dict)
    """Of that job, by the entries that they began with."""
    decided: dict[str, SkillFailed] = field(default_factory=dict)
    """Why nodes of its tree that are no skill have failed, by their places."""
    over: set[str] = field(default_factory=set)
    """Places of what begins others again, and does so no more, nor was come to again: see `GaveUp`, `RoundsDone`."""
    course: list[Sequence[float]] = field(default_factory=list)
    """Of its doses until now: the points of `dose_curve`."""
    reading: tuple[float, float, bool] | None = None
    """The balance's last line in it that was written down: run time [s], gross [mg], whether it is stable."""
    move: tuple[float, ArmMoves] | None = None
    """The last motion of the arm, and the run time at which it began."""
    state: dict[str, Any] = field(default_factory=dict)
    """What the cell was last said to hold, and where its joints were."""
    state_s: float = 0.0
    """Run time of that."""
    waiting: Waiting = field(default_factory=Waiting)
    """The question that waits."""
    soon: PersonSoon | None = None
    """What a person is going to be asked for."""
    is_paused: bool = False
    ended: Ended | None = None
    time_s: float = 0.0
    """Run time of the last entry."""
    at: str = ""
    """Wall time of it; ISO 8601."""
    _seq: int = 0
    _state_seq: int = 0

    def look(self) -> list[SampleResult]:
        """Read what is new, and return the results among it. Raises SourceError as `open_journal`."""
        with open_journal(self.path) as (database, _):
            database.execute("BEGIN")  # all of one moment
            return self._read(database)

    def _read(self, database: sqlite3.Connection) -> list[SampleResult]:
        results = []
        job = database.execute(_LAST_JOB, (self.until_s,)).fetchone()[0] or 0 if self._seq == 0 else self._seq
        before = self._seq
        for seq, action, at, time_s, kind, payload, frames in database.execute(_NEW, (self._seq, self.until_s, job)):
            self._seq, self.time_s, self.at = seq, time_s, at
            event = parsed(kind, json.loads(payload))
            self.waiting.take(action, at, event)
            (self.standing.answered if self.waiting.asked is None else self.standing.asked)(time_s)
            self._take(seq, action, event)
            if isinstance(event, ArmMoves):
                self.move = time_s, event
            elif frames is not None:
                self._weigh(frames)
            elif isinstance(event, SampleResult):
                results.append(event)
        if (row := database.execute(_STATE, (self._state_seq, self.until_s)).fetchone()) is not None:
            self._state_seq, self.state_s, self.state = row[0], row[1], json.loads(row[2])
        if self._seq > before:
            if self.move is None and (row := database.execute(_LAST_MOVE, (self.until_s,)).fetchone()) is not None:
                self.move = row[0], ArmMoves.model_validate_json(row[1])
            if self.until_s < math.inf:
                self._read_ahead(database)
        return results

    def _read_ahead(self, database: sqlite3.Connection) -> None:
        """What the actions at work had seen by then, though it was written later: a dry run writes in large parts."""
        for action in [seq for seq, one in self.actions.items() if one.outcome is None]:
            for payload, frames in database.execute(_COURSE, (self._seq, self.until_s, action)):
                if frames is not None:
                    self._weigh(frames)
                else:
                    points = DoseCurve.model_validate_json(payload).points
                    self.course += [point for point in points if point[0] <= self.until_s]

    def _weigh(self, frames: bytes) -> None:
        lines = [line for line in json.loads(zlib.decompress(frames)) if line[0] <= self.until_s]
        if lines:
            time_s, _, value_mg, _, stable = lines[-1]
            self.reading = time_s, value_mg, stable

    def _weigh_by(self, event: Event) -> None:
        """What was shown last in a weighing that was written down with its lines."""
        weighings = [event, getattr(event, "bare", None), getattr(event, "loaded", None)]
        lines = [line for one in weighings if isinstance(one, Weighing) for line in one.readings]
        if lines:
            self.reading = lines[-1].time_s, lines[-1].value_mg, lines[-1].stable

    def _take(self, seq: int, action: int | None, event: Event | None) -> None:
        match event:
            case RunBegun():
                self.begun = event
            case WorkflowTree():
                self.trees[event.workflow] = event.nodes
            case JobStarted():
                self.job, self.job_ended, self.reading = event, None, None
                self.actions, self.decided, self.over, self.course = {}, {}, set(), []
                self._has_come_to(event.name)
            case JobResumed():
                self.job_ended = None
                self.samples.pop((self.job and self.job.sample) or "", None)  # one that had stopped the run
            case JobEnded():
                self.job_ended = event
            case ActionStarted():
                self.actions[seq] = ActionNow(event.skill, event.path)
                self.over -= {place for place in self.over if event.path.startswith(f"{place}/")}
            case ActionEnded() if action in self.actions:
                begun = self.actions[action]
                self.actions[action] = ActionNow(begun.skill, begun.path, event.outcome, event.failure)
            case Decided():
                self.decided[event.path] = event.failure
            case GaveUp() | RoundsDone():
                self.over.add(event.path)
            case DoseCurve():
                self.course += event.points
            case SampleResult():
                self._has_come_to(event.id)  # one that is left out begins no job
                before = self.samples.pop(event.id, None)
                self.samples[event.id] = event
                # It is told again as its container has gone, and as the run ends: by then it had long been done.
                if before is None or before.attempt != event.attempt:
                    self.told_s[event.id] = self.time_s, self.standing.until(self.time_s)
            case Weighing() | ContainerPlaced() | BracketClosed():
                self._weigh_by(event)
            case PersonSoon():
                self.soon = event
            case Paused():
                self.is_paused = True
                self.standing.paused(self.time_s)
            case Continued():
                self._goes_on()
            case Ended():
                self.ended, self.soon = event, None
                self._goes_on()
            case Resumed():
                self.ended = None
                self._goes_on()
                self.resumed += 1
                self.samples = {name: one for name, one in self.samples.items() if one.was_tried}

    def _has_come_to(self, job: str) -> None:
        """Who was going to be needed there is by now, or is not any more."""
        self.soon = None if self.soon is not None and self.soon.job == job else self.soon

    def _goes_on(self) -> None:
        self.is_paused = False
        self.standing.continued(self.time_s)
