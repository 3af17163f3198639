"""A run read back from its journal: what it was, what its jobs have done, and what they left."""

import json
import sqlite3
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from scuhand_bt.events.doses import Dose, ValueRecorded
from scuhand_bt.events.entry import Event
from scuhand_bt.events.weighings import ContainerDiscarded
from scuhand_bt.failures import Code
from scuhand_bt.journal.events import ActionEnded, ActionStarted, Decided, JobEnded, JobResumed, JobStarted
from scuhand_bt.journal.kinds import parsed
from scuhand_bt.journal.plain import to_json
from scuhand_bt.journal.reader import open_contents
from scuhand_bt.journal.results import Chosen, SampleResult, SoFar
from scuhand_bt.journal.run_events import Ended, NotResumable, Resumed, RunBegun
from scuhand_bt.skill import SkillFailed
from scuhand_bt.tree.replay import Decision, Key, Recorded, Replay

STOPPED = "stopped"
"""The outcome of a job whose failure ended the run: it is taken up again where it failed."""
_TOLD_BY = (
    *(RunBegun, JobStarted, JobResumed, JobEnded, ActionStarted, ActionEnded, Decided, SampleResult, Chosen),
    *(Dose, ContainerDiscarded, ValueRecorded, NotResumable, Ended, Resumed),
)
_KINDS = tuple(event.KIND for event in _TOLD_BY)
_OF_ACTIONS = (ActionStarted.KIND, ActionEnded.KIND, Decided.KIND)


@dataclass
class JobHistory:
    """One attempt at one job, over all the times it was taken up."""

    seq: int
    began_s: float
    outcome: str | None = None
    """None: interrupted without a word."""
    failure: SkillFailed | None = None
    so_far: SoFar = field(default_factory=SoFar)
    actions: dict[Key, Recorded] = field(default_factory=dict)
    """Of a job that is not over, as the decisions: nothing else is replayed."""
    decisions: dict[Key, Decision] = field(default_factory=dict)
    _last_failed: tuple[dict[Key, Any], Key, SkillFailed] | None = None

    @property
    def is_over(self) -> bool:
        return self.outcome in ("done", "failed")

    def replay(self, joints_rad: list[float] | None) -> Replay:
        """What is to be replayed when the job is taken up again."""
        actions, decisions = dict(self.actions), dict(self.decisions)
        if self.outcome == STOPPED and self._last_failed is not None:
            where, key, failure = self._last_failed
            if str(failure) != str(self.failure):
                pass  # what failed last is not why the job did (an `invert`): it is over, and is not done again
            elif where is self.decisions:
                del decisions[key]
            else:
                actions[key] = Recorded(actions[key].skill, actions[key].inputs, "interrupted")
        return Replay(actions, decisions, joints_rad, is_replaying=True, is_to_rejoin=True)


@dataclass
class History:
    """One run as its journal has it."""

    begun: RunBegun | None = None
    """What the run is; None for one that ended before its first word."""
    jobs: dict[tuple[str, int], JobHistory] = field(default_factory=dict)
    """By name and attempt."""
    samples: dict[tuple[str, int], SampleResult] = field(default_factory=dict)
    """The results of finished attempts, by sample and attempt."""
    told: dict[str, SampleResult] = field(default_factory=dict)
    """What was said last of each sample, also of one that was never begun."""
    answers: dict[tuple[str, int], str] = field(default_factory=dict)
    """What a person chose for a failed attempt (`on_failure: ask`), by sample and attempt."""
    state: dict[str, Any] = field(default_factory=dict)
    """What the cell was believed to hold at the end."""
    time_s: float = 0.0
    """Run time of the last entry."""
    at: str = ""
    """Wall time of the last entry."""
    head: str = ""
    """The hash of the last entry: who goes on with the run goes on behind that one."""
    lost_world: str = ""
    """Why the simulated world could not be kept; empty where it was."""
    looked_after: frozenset[str] = frozenset()
    """The samples that were done when the run was stopped for those that overshot: a person was told of these."""
    ended: Ended | None = None
    """How the run ended; None if it did not say."""

    @property
    def run(self) -> RunBegun:
        """What the run is. Raises LookupError for one that ended before its first word."""
        if self.begun is None:
            raise LookupError("the run had not begun")
        return self.begun

    @property
    def is_complete(self) -> bool:
        """Nothing is left to do."""
        return self.ended is not None and self.ended.is_complete

    def unfinished(self) -> tuple[JobHistory, str] | None:
        """The job that was interrupted, and its name."""
        for (name, _), job in reversed(self.jobs.items()):
            return None if job.is_over else (job, name)
        return None


def read_history(path: Path) -> History:
    """The history of a run's journal, as far as that is whole. Raises SourceError for a file that is none."""
    with open_contents(path) as contents:
        return history_of(contents.database)


def history_of(database: sqlite3.Connection) -> History:
    """The history that a journal's database tells."""
    history = History()
    jobs: dict[int, JobHistory] = {}
    acted: dict[int, list[tuple[int, int | None, str, str]]] = {}
    last_state = "{}"
    marks = ", ".join("?" * len(_KINDS))
    query = f"""SELECT seq, job, action, time_s, at, state, kind, hash, CASE WHEN kind IN ({marks}) THEN payload END
        FROM entry ORDER BY seq"""
    for seq, job_seq, action, time_s, at, state, kind, head, payload in database.execute(query, _KINDS):
        history.time_s, history.at, history.head = time_s, at, head.hex()
        last_state = state or last_state
        if kind in _OF_ACTIONS:
            acted.setdefault(job_seq, []).append((seq, action, kind, payload))
            continue
        event = parsed(kind, json.loads(payload)) if payload is not None else None
        match event:
            case RunBegun():
                history.begun = event
            case JobStarted():
                jobs[seq] = history.jobs[event.name, event.attempt] = JobHistory(seq, time_s)
            case SampleResult():
                history.told[event.id] = event
                if event.was_tried:
                    history.samples[event.id, event.attempt] = event
            case Chosen():
                history.answers[event.sample, event.attempt] = event.action
            case NotResumable():
                history.lost_world = event.why
            case Ended():
                history.ended = event
                if event.reason.startswith(Code.DOSE_OVERSHOOTS):
                    history.looked_after = frozenset(name for name, _ in history.samples)
            case Resumed():
                history.ended = None
        if event is not None and job_seq in jobs:
            _note(jobs[job_seq], event)
    history.state = json.loads(last_state)
    for job_seq, job in jobs.items():
        if not job.is_over:
            _note_actions(job, acted.get(job_seq, ()))
    return history


def _note(job: JobHistory, event: Event) -> None:
    """One entry within a job."""
    match event:
        case JobEnded():
            job.outcome = event.outcome
            job.failure = event.failure
        case JobResumed():
            job.outcome = job.failure = None
        case _:
            job.so_far.note(event)


def _note_actions(job: JobHistory, acted: Iterable[tuple[int, int | None, str, str]]) -> None:
    """What the job's actions did and its nodes decided: entry, the entry of its action, kind, payload."""
    started: dict[int | None, Key] = {}
    for seq, action, kind, payload in acted:
        match event := parsed(kind, json.loads(payload)):
            case ActionStarted():
                key = started[seq] = event.path, event.visit
                job.actions[key] = Recorded(event.skill, to_json(event.inputs), "started")
            case ActionEnded() if action in started:
                key = started[action]
                before = job.actions[key]
                job.actions[key] = Recorded(before.skill, before.inputs, event.outcome, event.code, event.result)
                if event.failure is not None:
                    job._last_failed = job.actions, key, event.failure
            case Decided():
                key = event.path, event.visit
                job.decisions[key] = Decision(event.failure, event.had_begun)
                job._last_failed = job.decisions, key, event.failure
