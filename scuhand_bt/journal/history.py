"""A run read back from its journal: what it was, what its jobs have done, and what they left."""

import json
import sqlite3
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from scuhand_bt.journal.reader import open_contents
from scuhand_bt.journal.writer import to_json
from scuhand_bt.skill import SkillFailed
from scuhand_bt.specs import Dose
from scuhand_bt.tree.replay import Decision, Key, Recorded, Replay

STOPPED = "stopped"
"""The outcome of a job whose failure ended the run: it is taken up again where it failed."""


@dataclass
class JobHistory:
    """One attempt at one job, over all the times it was taken up."""

    seq: int
    began_s: float
    outcome: str | None = None
    """None: interrupted without a word."""
    failure: SkillFailed | None = None
    dose: Dose | None = None
    actions: dict[Key, Recorded] = field(default_factory=dict)
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

    run: dict[str, Any] = field(default_factory=dict)
    jobs: dict[tuple[str, int], JobHistory] = field(default_factory=dict)
    """By name and attempt."""
    samples: dict[tuple[str, int], dict[str, Any]] = field(default_factory=dict)
    """The results of finished attempts, by sample and attempt."""
    answers: dict[tuple[str, int], str] = field(default_factory=dict)
    """What a person chose for a failed attempt (`on_failure: ask`), by sample and attempt."""
    state: dict[str, Any] = field(default_factory=dict)
    """What the cell was believed to hold at the end."""
    time_s: float = 0.0
    """Run time of the last entry."""
    at: str = ""
    """Wall time of the last entry."""
    lost_world: str = ""
    """Why the simulated world could not be kept; empty where it was."""
    ended: dict[str, Any] | None = None
    """How the run ended; None if it did not say."""

    @property
    def is_complete(self) -> bool:
        """Nothing is left to do."""
        return self.ended is not None and bool(self.ended.get("complete"))

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
    started: dict[int, tuple[JobHistory, Key]] = {}
    jobs: dict[int, JobHistory] = {}
    rows = database.execute("SELECT seq, kind, job, action, time_s, at, payload, state FROM entry ORDER BY seq")
    for seq, kind, job_seq, action, time_s, at, payload, state in rows:
        values = json.loads(payload)
        history.time_s, history.at = time_s, at
        if state is not None:
            history.state = json.loads(state)
        if kind == "run":
            history.run = values
        elif kind == "job_started":
            jobs[seq] = JobHistory(seq, time_s)
            history.jobs[values["name"], values["attempt"]] = jobs[seq]
        elif kind == "sample" and values["verdict"] not in ("interrupted", "not run"):
            history.samples[values["id"], values["attempt"]] = values
        elif kind == "chosen":
            history.answers[values["sample"], values["attempt"]] = values["action"]
        elif kind == "not_resumable":
            history.lost_world = values["why"]
        elif kind == "ended":
            history.ended = values
        elif kind == "resumed":
            history.ended = None
        if job_seq in jobs and kind != "job_started":
            _note(jobs[job_seq], kind, seq, action, values, started)
    return history


def _note(
    job: JobHistory,
    kind: str,
    seq: int,
    action: int | None,
    values: Mapping[str, Any],
    started: dict[int, tuple[JobHistory, Key]],
) -> None:
    """One entry within a job."""
    if kind == "job_ended":
        job.outcome = values["outcome"]
        job.failure = SkillFailed(values["code"], values["detail"]) if values["code"] else None
    elif kind == "job_resumed":
        job.outcome = job.failure = None
    elif kind == "dose":
        job.dose = Dose.model_validate(values, by_name=True, by_alias=False)
    elif kind == "action_started":
        key = values["path"], values["visit"]
        started[seq] = job, key
        job.actions[key] = Recorded(values["skill"], to_json(values["inputs"]), "started")
    elif kind == "action_ended" and action in started:
        _, key = started[action]
        before = job.actions[key]
        job.actions[key] = Recorded(before.skill, before.inputs, values["outcome"], values["code"], values["result"])
        if values["outcome"] == "failed":
            job._last_failed = job.actions, key, SkillFailed(values["code"], values["result"]["detail"])
    elif kind == "decided":
        key = values["path"], values["visit"]
        failure = SkillFailed(values["code"], values["detail"])
        job.decisions[key] = Decision(failure, values["had_begun"])
        job._last_failed = job.decisions, key, failure
