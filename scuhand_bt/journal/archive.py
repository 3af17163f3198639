"""The runs of a lab, as their journals tell: in what state each is, and what happened in it."""

import json
import sqlite3
import zlib
from collections import deque
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any, Literal

from scuhand_bt.events.doses import DoseCurve
from scuhand_bt.exit_codes import ExitCode
from scuhand_bt.journal.events import (
    ActionEnded,
    ActionStarted,
    Answered,
    ArmMoves,
    Asked,
    Frames,
    JobEnded,
    JobStarted,
    WorkflowTree,
)
from scuhand_bt.journal.kinds import parsed
from scuhand_bt.journal.presence import is_held
from scuhand_bt.journal.reader import NONE, Contents, open_journal
from scuhand_bt.journal.results import SampleResult
from scuhand_bt.journal.run_events import Continued, Ended, Paused, Resumed, RunBegun
from scuhand_bt.journal.runs_index import Indexed, read_index, stamps, write_index
from scuhand_bt.journal.waiting import Waiting
from scuhand_bt.problems import Mark, Problem, SourceError

RunState = Literal[
    "running", "waiting for a person", "paused", "complete", "stopped", "fault", "interrupted", "altered", "unreadable"
]

ABOUT_TO_BEGIN = "it is about to begin"
_KINDS_OF_STATE = tuple(
    event.KIND for event in (RunBegun, SampleResult, Ended, Resumed, Paused, Continued, Asked, Answered)
)
_MARKS = ", ".join("?" * len(_KINDS_OF_STATE))
_OF_STATE = f"""SELECT action, at, kind, payload FROM entry WHERE kind IN ({_MARKS}) OR
    (kind = '{ActionEnded.KIND}' AND action IN (SELECT action FROM entry WHERE kind = '{Asked.KIND}')) ORDER BY seq"""
_GOING_ON: tuple[RunState, ...] = ("running", "waiting for a person", "paused")
_TOLD_ELSEWHERE = (JobEnded.KIND, ActionEnded.KIND, Frames.KIND, DoseCurve.KIND, ArmMoves.KIND, WorkflowTree.KIND)
_LAST_OF_JOBS = """SELECT job, MAX(seq) FROM (SELECT job, seq FROM entry UNION ALL
    SELECT began.job, one.seq FROM entry AS one JOIN entry AS began ON began.seq = one.action) GROUP BY job"""
_FRAME = ("time_s", "raw", "value_mg", "unit", "stable")


@dataclass(frozen=True)
class Summary:
    """One run in a line. `interrupted`: it ended without a word, by a crash or a power cut."""

    id: str
    state: RunState
    reason: str = ""
    """Why it ended early, or cannot be read; what the person is asked that it waits for."""
    since: str = ""
    """When it began to wait for a person; ISO 8601 with its offset from UTC."""
    recipe: str = ""
    mode: str = ""
    simulated: bool | None = None
    started: str = ""
    """ISO 8601 with its offset from UTC."""
    good: int = 0
    """Samples in tolerance, without a failure."""
    total: int | None = None
    """Samples of the recipe; None where an old journal does not say."""


def summaries(folder: Path) -> list[Summary]:
    """All runs of a folder, the newest first; nothing is verified, and one that cannot be read says why."""
    kept, now = read_index(folder), stamps(folder)
    found: list[Summary] = []
    news: dict[str, Indexed] = {}
    for name, stamp in now.items():
        if stamp and name in kept and kept[name][0] == stamp:
            found.append(Summary(**json.loads(kept[name][1])))
            continue
        one = summary(folder / name)
        found.append(one)
        if stamp and one.state not in (*_GOING_ON, "unreadable"):
            news[name] = stamp, json.dumps(asdict(one))
    gone = kept.keys() - now.keys()
    if news or gone:
        write_index(folder, news, gone)
    return sorted(found, key=lambda one: _began(folder, one), reverse=True)


def summary(path: Path) -> Summary:
    """One run, not verified."""
    try:
        with open_journal(path) as (database, _):
            return summary_of(path, database)
    except SourceError as error:
        if is_about_to_begin(path):
            return Summary(path.stem, "running", ABOUT_TO_BEGIN)
        return Summary(path.stem, "unreadable", error.problems[0].message)


def is_about_to_begin(path: Path) -> bool:
    """Whether a process has this run and has written nothing yet: on a busy computer it is so for seconds."""
    if not is_held(path):
        return False
    try:
        with open_journal(path) as (database, _):
            return database.execute("SELECT 1 FROM entry LIMIT 1").fetchone() is None
    except SourceError as error:
        return error.problems[0].message == NONE


def summary_of(path: Path, database: sqlite3.Connection) -> Summary:
    """One run by its database; a process that has the run now is asked for at its journal's place."""
    run: RunBegun | None = None
    samples: dict[str, SampleResult] = {}
    ended: Ended | None = None
    is_paused = False
    waiting = Waiting()
    for action, at, kind, payload in database.execute(_OF_STATE, _KINDS_OF_STATE):
        event = parsed(kind, json.loads(payload))
        waiting.take(action, at, event)
        match event:
            case RunBegun():
                run = event
            case SampleResult():
                samples[event.id] = event
            case Paused() | Continued():
                is_paused = isinstance(event, Paused)
            case Ended() | Resumed():
                ended = event if isinstance(event, Ended) else None
                is_paused = False
    state, reason, since = state_of(run, waiting, ended, is_paused=is_paused, is_held=is_held(path))
    if run is None:
        return Summary(path.stem, state, ABOUT_TO_BEGIN if state == "running" else "it had not begun")
    planned = len(run.samples) if run.samples is not None else None
    return Summary(
        id=path.stem,
        state=state,
        reason=reason,
        since=since,
        recipe=run.recipe,
        mode=run.mode,
        simulated=run.simulated,
        started=datetime.fromisoformat(run.started).isoformat(),
        good=sum(sample.is_good for sample in samples.values()),
        total=planned if planned is not None else len(samples) if ended is not None else None,
    )


def state_of(
    run: RunBegun | None, waiting: Waiting, ended: Ended | None, *, is_paused: bool, is_held: bool
) -> tuple[RunState, str, str]:
    """In what state a run is, why, and since when it waits for a person; `is_held`: a process runs it."""
    if is_held:
        is_answered = run is not None and run.mode == "SIMULATED" and not run.options.asks
        if waiting.asked is not None and not is_paused and not is_answered:
            return "waiting for a person", waiting.asked.question, waiting.at
        return ("paused" if is_paused else "running"), ended.reason if ended is not None else "", ""
    if ended is None:
        return "interrupted", "", ""
    if ended.is_complete:
        return "complete", ended.reason, ""
    return ("stopped" if ended.exit_code == ExitCode.INTERRUPTED else "fault"), ended.reason, ""


def story(contents: Contents) -> dict[str, Any]:
    """What happened in a run, as plain values: its header, samples, jobs with all their actions, and its chain."""
    return {key: list(value) if isinstance(value, Iterator) else value for key, value in told_story(contents).items()}


def told_story(contents: Contents) -> dict[str, Any]:
    """The same, but the samples and what happened (`run`) are told one after the other, as they are asked for."""
    whole = summary_of(contents.path, contents.database)
    if contents.verified.problem is not None:
        whole = replace(whole, state="altered", reason=contents.verified.problem)
    begun = contents.database.execute("SELECT payload FROM entry WHERE kind = ?", (RunBegun.KIND,)).fetchone()
    return {
        **asdict(whole),
        "header": json.loads(*begun) if begun is not None else {},
        "samples": contents.samples(),
        "run": _happenings(contents),
        "chain": asdict(contents.verified) | {"chained": contents.is_chained},
    }


def _happenings(contents: Contents) -> Iterator[dict[str, Any]]:
    """What happened, each job with all that is of it: told once its last entry was read, in the order of the first."""
    last_of = dict(contents.database.execute(_LAST_OF_JOBS))
    jobs, actions = (_Ahead(contents.each(table)) for table in ("job", "action"))
    waiting: deque[tuple[int, dict[str, Any]]] = deque()
    within: dict[int, list[dict[str, Any]]] = {}
    for row in contents.each("entry"):
        seq, kind, job = row["seq"], row["kind"], row["job"]
        happened = {"seq": seq, "kind": kind, "time_s": row["time_s"], "at": row["at"]}
        if kind == JobStarted.KIND:
            within[seq] = []
            waiting.append(
                (last_of.get(seq, seq), {**happened, "kind": "job", **jobs.of(seq), "happened": within[seq]})
            )
        elif kind == ActionStarted.KIND:
            within[seq] = []
            action = {**happened, "kind": "action", **actions.of(seq), "units": row["payload"].get("units", {})}
            within[job].append({**action, "happened": within[seq]})
        elif kind not in (*_TOLD_ELSEWHERE, RunBegun.KIND, SampleResult.KIND):
            happened["values"] = row["payload"]
            around = within.get(row["action"], within.get(job))
            if around is not None:
                around.append(happened)
            else:
                waiting.append((seq, happened))
        while waiting and waiting[0][0] <= seq:
            yield waiting.popleft()[1]
        if not waiting:
            within.clear()
    for _, happened in waiting:
        yield happened


class _Ahead:
    """Rows in the order of their ids, each of which is asked for once, in that order."""

    def __init__(self, rows: Iterator[dict[str, Any]]) -> None:
        self._rows = rows

    def of(self, number: int) -> dict[str, Any]:
        return next(row for row in self._rows if row["id"] == number)


def frames(contents: Contents, sample: str) -> list[dict[str, Any]]:
    """Every line that the balance sent while it weighed for a sample, as it came. Raises SourceError for none."""
    jobs = {row["id"]: row for row in contents.rows("job") if row["sample"] == sample}
    found = [
        {"attempt": jobs[job]["attempt"], "entry": seq, **dict(zip(_FRAME, line, strict=True))}
        for seq, job, packed in contents.database.execute(
            "SELECT seq, job, frames FROM entry WHERE frames IS NOT NULL ORDER BY seq"
        )
        if job in jobs
        for line in json.loads(zlib.decompress(packed))
    ]
    if not found:
        known = sorted({row["sample"] for row in contents.rows("job") if row["sample"]})
        what = f"no line of the balance was kept for a sample '{sample}'; the samples are {', '.join(known) or 'none'}"
        raise SourceError([Problem(Mark(str(contents.path), 0), what)])
    return found


def _began(folder: Path, one: Summary) -> float:
    if one.started:
        return datetime.fromisoformat(one.started).timestamp()
    path = folder / f"{one.id}.sqlite"
    return path.stat().st_mtime if path.exists() else 0.0
