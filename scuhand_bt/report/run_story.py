"""A run told in lines: what it was, what each job did, and how it ended."""

from collections.abc import Iterator, Mapping
from typing import Any

from scuhand_bt.events.doses import Dose, Pulsed, ValueRecorded
from scuhand_bt.journal.events import Answered, Asked, PersonSoon
from scuhand_bt.journal.kinds import parsed
from scuhand_bt.journal.run_events import Continued, Ended, Paused, Resumed, RunBegun
from scuhand_bt.quantity import format_mass

_LONG = ("readings", "bare", "loaded", "before", "traceback", "rules")


def header_lines(story: Mapping[str, Any]) -> Iterator[str]:
    """What the run was: on what, by whom, with what."""
    run = RunBegun.model_validate(story["header"])
    yield f"{story['id']}: {story['mode']}" + (", no powder was moved" if story["simulated"] else "")
    why = f" ({story['reason']})" if story["reason"] else ""
    total = "" if story["total"] is None else f" of {story['total']}"
    yield f"State: {story['state']}{why}; {story['good']}{total} samples good."
    yield f"Recipe: {run.recipe} ({run.recipe_path}, {run.recipe_hash[:16]}…), controller {run.controller}."
    operator = f" by {run.operator}" if run.operator is not None else ""
    yield f"Started: {run.started}{operator}, with scuhand_bt {run.version} on the cell '{run.cell}'."
    if story["simulated"]:
        yield f"Simulation: seed {run.seed}, physics {run.plant}."
    if (balance := run.devices.get("balance")) is not None:
        yield f"Balance: {balance['driver']}, readability {balance['readability_mg']:g} mg."
    for name, source in run.sources.items():
        lot = f", lot {source.lot}" if source.lot else ""
        yield f"Source '{name}': {source.powder}{lot}, at {source.station}."


def chain_line(chain: Mapping[str, Any]) -> str:
    """Whether the journal is as it was written, as far as it can tell by itself."""
    if not chain["chained"]:
        return "Chain: none; an older scuhand-bt wrote this journal, and whether it was altered cannot be told."
    if chain["problem"] is not None:
        return f"Chain: NOT AS IT WAS WRITTEN: {chain['problem']}. Only what comes before is shown."
    return f"Chain: {chain['entries']} entries, whole; head {chain['head']}"


def told(happened: Mapping[str, Any], indent: int = 0) -> Iterator[str]:
    """One thing that happened, with all that happened in it."""
    kind, mark = happened["kind"], f"{'  ' * indent}{happened['time_s']:9.1f} s  "
    if kind == "job":
        again = f", attempt {happened['attempt']}" if happened["attempt"] > 1 else ""
        yield f"{mark}{happened['name']} ({happened['workflow']}{again}), {happened['at']}: {_ending(happened)}"
    elif kind == "action":
        units = happened["units"]
        inputs = ", ".join(_given(key, value, units.get(key, "")) for key, value in happened["inputs"].items())
        yield f"{mark}{happened['skill']}({inputs}): {_ending(happened)}"
    else:
        yield f"{mark}{_event(kind, happened['values'])}"
    for inner in happened.get("happened", []):
        yield from told(inner, indent + 1)


def _ending(happened: Mapping[str, Any]) -> str:
    if happened["outcome"] in (None, "started"):
        return "has not ended"
    result = happened.get("result")
    detail = happened.get("detail") or (result.get("detail") if isinstance(result, dict) else None)
    words = [happened["outcome"], happened["code"], detail]
    return f"{happened['ended_s'] - happened['time_s']:.1f} s, " + ", ".join(word for word in words if word)


def _event(kind: str, values: Mapping[str, Any]) -> str:
    match event := parsed(kind, values):
        case Pulsed():
            opened = ""
            if event.kind == "pulse":
                opened = (
                    f"opened {event.opening_mm:.2f} mm for {event.dwell_s:.2f} s, vibration {event.vibration:.2f}; "
                )
            return f"{opened}net {format_mass(event.net_mg)} ± {event.uncertainty_mg:.2f} mg"
        case Dose():
            reached = f"{format_mass(event.dispensed_mg)} of {format_mass(event.target_mg)}"
            return f"dose: {reached} ± {event.uncertainty_mg:.2f} mg, {event.verdict} ({event.controller})"
        case ValueRecorded():
            return f"recorded: {_given(event.name, event.value, event.unit)}"
        case PersonSoon():
            return str(event)
        case Asked():
            return f"asked: {event.question} [{'/'.join(event.choices)}]"
        case Answered():
            return f"answered: {event.answer}{_by(event)}"
        case Paused() | Continued():
            return f"{event.KIND}{_by(event)}"
        case Resumed():
            changes = "".join(f"; accepted: {change}" for change in event.changes)
            return f"resumed by {event.operator}; the last entry before was of {event.last_at}{changes}"
        case Ended():
            stopped = f" {_by(event).removeprefix(', ')}" if event.by is not None else ""
            return f"the run ended with exit code {event.exit_code}" + f": {event.reason}{stopped}".removesuffix(": ")
    rest = ", ".join(f"{key} {_plain(value)}" for key, value in values.items() if key not in _LONG)
    return f"{kind}: {rest}" if rest else kind


def _by(event: Answered | Paused | Continued | Ended) -> str:
    return "" if event.by is None else f", by {event.by}" + (", with PIN" if event.signed else "")


def _given(name: str, value: object, unit: str) -> str:
    """An input of an action; of `record` each is a value with its unit."""
    match value:
        case {"value": value, "unit": str(unit)}:
            pass
    return f"{name} {_plain(value)} {unit}".rstrip()


def _plain(value: object) -> str:
    if isinstance(value, list):
        return f"[{', '.join(map(_plain, value))}]"
    return f"{value:g}" if isinstance(value, float) else str(value)
