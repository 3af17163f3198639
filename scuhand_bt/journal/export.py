"""The canonical export of a run: what happened, so written that two runs of one seed compare equal.

Virtual times, no wall times, no ids of the run, no paths; keys sorted, numbers rounded to a fixed
number of decimals. It is made from the journal.
"""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from scuhand_bt.events.doses import DoseCurve
from scuhand_bt.events.entry import Event
from scuhand_bt.journal.events import ArmMoves, WorkflowTree
from scuhand_bt.journal.kinds import KINDS
from scuhand_bt.journal.plain import json_parts
from scuhand_bt.journal.reader import Contents, open_contents
from scuhand_bt.journal.results import SampleResult
from scuhand_bt.journal.run_events import Ended, Matter

DECIMALS = 6
_ELSEWHERE = tuple(one.KIND for one in (SampleResult, Ended, Matter, DoseCurve, ArmMoves, WorkflowTree))
RUN_KEYS = ("recipe", "recipe_hash", "seed", "simulated", "mode", "plant", "controller", "version")


def canonical(journal: Path) -> str:
    """The export of a journal as JSON text. Raises SourceError for a file that is none."""
    with open_contents(journal) as contents:
        return canonical_of(contents)


def canonical_of(contents: Contents) -> str:
    """The export of what a journal holds as JSON text."""
    return "".join(canonical_parts(contents))


def canonical_parts(contents: Contents) -> Iterator[str]:
    """The same text in pieces, made as they are asked for: a long run is never in memory at once."""
    each = contents.each
    run = {row["key"]: row["value"] for row in each("run")}
    export = {
        "run": {key: run[key] for key in RUN_KEYS if key in run},
        "samples": contents.samples(),
        "end": _last(contents, Ended),
        "matter_mg": _last(contents, Matter),
        "jobs": (_without(row, "id") for row in each("job")),
        "actions": (_without(row, "id", "job") for row in each("action")),
        "pulses": ({"time_s": row["time_s"], **row["payload"]} for row in each("pulse")),
        "events": (
            {"time_s": event["time_s"], "kind": event["kind"], **_values(event)}
            for event in each("event")
            if event["kind"] not in _ELSEWHERE
        ),
    }
    yield from json_parts(
        {
            key: map(_rounded, value) if isinstance(value, Iterator) else _rounded(value)
            for key, value in export.items()
        },
        indent=1,
        sort_keys=True,
    )
    yield "\n"


def _last(contents: Contents, event: type[Event]) -> Any:
    """What the last entry of a kind says; None where there is none."""
    query = "SELECT payload FROM entry WHERE kind = ? ORDER BY seq DESC LIMIT 1"
    row = contents.database.execute(query, (event.KIND,)).fetchone()
    return None if row is None else json.loads(row[0])


def _without(row: Mapping[str, Any], *keys: str) -> dict[str, Any]:
    return {key: value for key, value in row.items() if key not in keys}


def _values(event: Mapping[str, Any]) -> dict[str, Any]:
    """A payload beside its time and kind; a lab's own keys are kept from them."""
    return event["payload"] if event["kind"] in KINDS else {"values": event["payload"]}


def _rounded(value: Any) -> Any:
    if isinstance(value, float):
        return round(value, DECIMALS) + 0.0  # no minus zero
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    return [_rounded(item) for item in value] if isinstance(value, list) else value
