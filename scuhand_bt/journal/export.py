"""The canonical export of a run: what happened, so written that two runs of one seed compare equal.

Virtual times, no wall times, no ids of the run, no paths; keys sorted, numbers rounded to a fixed
number of decimals. It is made from the journal.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from scuhand_bt.events import DoseCurve
from scuhand_bt.journal.events import ArmMoves, Ended, Matter, WorkflowTree
from scuhand_bt.journal.kinds import KINDS
from scuhand_bt.journal.reader import Contents, open_contents
from scuhand_bt.journal.results import SampleResult

DECIMALS = 6
_ELSEWHERE = tuple(one.KIND for one in (SampleResult, Ended, Matter, DoseCurve, ArmMoves, WorkflowTree))
RUN_KEYS = ("recipe", "recipe_hash", "seed", "simulated", "mode", "plant", "controller", "version")


def canonical(journal: Path) -> str:
    """The export of a journal as JSON text. Raises SourceError for a file that is none."""
    with open_contents(journal) as contents:
        return canonical_of(contents)


def canonical_of(contents: Contents) -> str:
    """The export of what a journal holds as JSON text."""
    return json.dumps(_export(contents), sort_keys=True, indent=1) + "\n"


def _export(contents: Contents) -> dict[str, Any]:
    read = contents.rows
    run = {row["key"]: row["value"] for row in read("run")}
    events = read("event")
    actions = read("action")
    samples, ends, matter = (
        [event["payload"] for event in events if event["kind"] == kind.KIND] for kind in (SampleResult, Ended, Matter)
    )
    export: dict[str, Any] = _rounded(
        {
            "run": {key: run[key] for key in RUN_KEYS if key in run},
            "samples": list({sample["id"]: sample for sample in samples}.values()),
            "end": ends[-1] if ends else None,
            "matter_mg": matter[-1] if matter else None,
            "jobs": [{key: value for key, value in row.items() if key != "id"} for row in read("job")],
            "actions": [{key: value for key, value in row.items() if key not in ("id", "job")} for row in actions],
            "pulses": [{"time_s": row["time_s"], **row["payload"]} for row in read("pulse")],
            "events": [
                {"time_s": event["time_s"], "kind": event["kind"], **_values(event)}
                for event in events
                if event["kind"] not in _ELSEWHERE
            ],
        }
    )
    return export


def _values(event: Mapping[str, Any]) -> dict[str, Any]:
    """A payload beside its time and kind; a lab's own keys are kept from them."""
    return event["payload"] if event["kind"] in KINDS else {"values": event["payload"]}


def _rounded(value: Any) -> Any:
    if isinstance(value, float):
        return round(value, DECIMALS) + 0.0  # no minus zero
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    return [_rounded(item) for item in value] if isinstance(value, list) else value
