"""The runs of a lab, as their journals tell: in what state each is, and what happened in it."""

import json
import sqlite3
import zlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any, Literal

from scuhand_bt.exit_codes import ExitCode
from scuhand_bt.journal.presence import is_held
from scuhand_bt.journal.reader import Contents, open_journal
from scuhand_bt.problems import Mark, Problem, SourceError

RunState = Literal["running", "paused", "complete", "stopped", "fault", "interrupted", "altered", "unreadable"]

_KINDS_OF_STATE = ("run", "sample", "ended", "resumed", "paused", "continued")
_TOLD_ELSEWHERE = ("job_ended", "action_ended", "frames", "dose_curve")
_FRAME = ("time_s", "raw", "value_mg", "unit", "stable")


@dataclass(frozen=True)
class Summary:
    """One run in a line. `interrupted`: it ended without a word, by a crash or a power cut."""

    id: str
    state: RunState
    reason: str = ""
    """Why it ended early, or cannot be read."""
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
    found = [(_began(path, one), one) for path in folder.glob("*.sqlite") for one in [summary(path)]]
    return [one for _, one in sorted(found, key=lambda pair: pair[0], reverse=True)]


def summary(path: Path) -> Summary:
    """One run, not verified."""
    try:
        with open_journal(path) as (database, _):
            return summary_of(path, database)
    except SourceError as error:
        return Summary(path.stem, "unreadable", error.problems[0].message)


def summary_of(path: Path, database: sqlite3.Connection) -> Summary:
    """One run by its database; a process that has the run now is asked for at its journal's place."""
    run: dict[str, Any] = {}
    samples: dict[str, Mapping[str, Any]] = {}
    ended: dict[str, Any] | None = None
    is_paused = False
    marks = ", ".join("?" * len(_KINDS_OF_STATE))
    query = f"SELECT kind, payload FROM entry WHERE kind IN ({marks}) ORDER BY seq"
    for kind, payload in database.execute(query, _KINDS_OF_STATE):
        values = json.loads(payload)
        if kind == "run":
            run = values
        elif kind == "sample":
            samples[values["id"]] = values
        elif kind in ("paused", "continued"):
            is_paused = kind == "paused"
        else:
            ended = values if kind == "ended" else None
            is_paused = False
    state: RunState = "interrupted"
    if is_held(path):
        state = "paused" if is_paused else "running"
    elif ended is not None:
        code = ended["exit_code"]
        is_complete = ended.get("complete", code <= 1)
        state = "complete" if is_complete else "stopped" if code == ExitCode.INTERRUPTED else "fault"
    if not run:
        return Summary(path.stem, state, "it had not begun")
    planned = run.get("samples")
    return Summary(
        id=path.stem,
        state=state,
        reason=ended["reason"] if ended is not None else "",
        recipe=run["recipe"],
        mode=run["mode"],
        simulated=run["simulated"],
        started=datetime.fromisoformat(run["started"]).isoformat(),
        good=sum(_is_good(values) for values in samples.values()),
        total=len(planned) if planned is not None else len(samples) if ended is not None else None,
    )


def story(contents: Contents) -> dict[str, Any]:
    """What happened in a run, as plain values: its header, samples, jobs with all their actions, and its chain."""
    whole = summary_of(contents.path, contents.database)
    if contents.verified.problem is not None:
        whole = replace(whole, state="altered", reason=contents.verified.problem)
    header: dict[str, Any] = {}
    samples: dict[str, dict[str, Any]] = {}
    jobs: dict[int, dict[str, Any]] = {row["id"]: row for row in contents.rows("job")}
    actions: dict[int, dict[str, Any]] = {row["id"]: row for row in contents.rows("action")}
    run: list[dict[str, Any]] = []
    within: dict[int | None, list[dict[str, Any]]] = {seq: [] for seq in (*jobs, *actions)}
    for row in contents.rows("entry"):
        seq, kind = row["seq"], row["kind"]
        happened = {"seq": seq, "kind": kind, "time_s": row["time_s"], "at": row["at"]}
        if kind == "run":
            header = row["payload"]
        elif kind == "sample":
            samples[row["payload"]["id"]] = row["payload"]
        elif kind == "job_started":
            run.append({**happened, "kind": "job", **jobs[seq], "happened": within[seq]})
        elif kind == "action_started":
            within[row["job"]].append({**happened, "kind": "action", **actions[seq], "happened": within[seq]})
        elif kind not in _TOLD_ELSEWHERE:
            within.get(row["action"], within.get(row["job"], run)).append({**happened, "values": row["payload"]})
    chain = asdict(contents.verified) | {"chained": contents.is_chained}
    return {**asdict(whole), "header": header, "samples": list(samples.values()), "run": run, "chain": chain}


def frames(contents: Contents, sample: str) -> list[dict[str, Any]]:
    """Every line that the balance sent while it weighed for a sample, as it came. Raises SourceError for none."""
    jobs = {row["id"]: row for row in contents.rows("job") if row["sample"] == sample}
    found = [
        {"attempt": jobs[job]["attempt"], "entry": seq, **dict(zip(_FRAME, line, strict=True))}
        for seq, job, packed in contents.database.execute(
            "SELECT seq, job, frames FROM entry WHERE kind = 'frames' ORDER BY seq"
        )
        if job in jobs
        for line in json.loads(zlib.decompress(packed))
    ]
    if not found:
        known = sorted({row["sample"] for row in contents.rows("job") if row["sample"]})
        what = f"no line of the balance was kept for a sample '{sample}'; the samples are {', '.join(known) or 'none'}"
        raise SourceError([Problem(Mark(str(contents.path), 0), what)])
    return found


def _is_good(values: Mapping[str, Any]) -> bool:
    wanted = "no dose" if values["target_mg"] is None else "in tolerance"
    return values["code"] is None and bool(values["verdict"] == wanted)


def _began(path: Path, one: Summary) -> float:
    if one.started:
        return datetime.fromisoformat(one.started).timestamp()
    return path.stat().st_mtime if path.exists() else 0.0
