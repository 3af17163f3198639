"""The weighing record of a run, for an audit: a table with one row for every weighing that something rests on.

It is comma-separated, with a decimal point and CRLF (RFC 4180), every cell in quotes. What a spreadsheet would take for
a formula, also where it splits at a semicolon, gets an apostrophe in front.

A net mass is gross less tare less drift. A dose's tare is what the container weighed just before the valve opened,
less what earlier doses had brought of the same powder. A `result` is what is said of a dose at the end, adjusted to the
bare pan behind its container where that confirms it (`bracket`). They stand last, one for each dose, and behind
them what workflows have recorded of their samples, one row for each value, and what samples are composed of, one row
for each element: atoms per formula of the product.
"""

import csv
import io
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from scuhand_bt.events.doses import Dose, Pulsed
from scuhand_bt.events.entry import Event
from scuhand_bt.events.weighings import (
    BracketClosed,
    ContainerAgain,
    ContainerLifted,
    ContainerPlaced,
    DoseWeighed,
    Line,
    Reweighed,
    Tared,
    Weighed,
    Weighing,
    WeightChecked,
)
from scuhand_bt.journal.events import ContainerReweighed, JobStarted, PanCompared
from scuhand_bt.journal.kinds import parsed
from scuhand_bt.journal.reader import Contents
from scuhand_bt.journal.results import SampleResult
from scuhand_bt.journal.run_events import Resumed, RunBegun, SourceUsed
from scuhand_bt.problems import harmless

CONVENTION = (
    "absolute; in tolerance means |net - target| <= tolerance - 2 standard uncertainties of the net mass (guard band), "
    "by a mean of stable readings"
)
COLUMNS = (
    "run", "simulated", "mode", "recipe", "recipe_hash", "operator", "at", "run_time_s", "sample", "attempt",
    "container", "container_kind", "container_slot", "weighing", "balance_driver", "balance_identity",
    "readability_mg", "tare_mg", "gross_mg", "drift_mg", "earlier_mg", "net_mg", "standard_uncertainty_mg",
    "stable", "tare_lines", "gross_lines",
    "lines_unit", "target_mg", "tolerance_mg", "tolerance_convention", "verdict", "sample_verdict",
    "bracket", "true_mg", "failure_code", "source", "powder", "lot", "sheet",
    "sheet_powder", "controller", "software", "recorded_name", "recorded_value", "recorded_unit", "product", "element",
    "atoms_asked", "atoms_reached", "atoms_standard_uncertainty", "composition_tolerance", "entry", "entry_hash",
)  # fmt: skip
_WEIGHED = ("tare_mg", "gross_mg", "drift_mg", "earlier_mg", "stable", "tare_lines", "gross_lines", "lines_unit")
"""What is said of a weighing, and not of its dose's result."""
_FORMULA = re.compile(r"(^|;)(?=\s*[=+\-@＝＋－＠])")


def weighing_csv(contents: Contents) -> str:
    """The record as CSV. Masses are in mg; the lines are the balance's own, as they came, in `lines_unit`.

    Of a dose, net = gross - tare - drift + earlier: what the same lot had brought before that tare was weighed.
    """
    return "".join(weighing_lines(contents))


def weighing_lines(contents: Contents) -> Iterator[str]:
    """The same text line by line, made as they are asked for."""
    line = io.StringIO()
    table = csv.DictWriter(line, COLUMNS, restval="", quoting=csv.QUOTE_ALL)
    table.writeheader()
    for row in weighing_rows(contents):
        table.writerow({name: _cell(value) for name, value in row.items()})
        yield line.getvalue()
        line.seek(0)
        line.truncate()
    yield line.getvalue()


def _cell(value: object) -> str:
    """A value as a cell; None is empty."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.4f}"
    return str(value) if isinstance(value, int) else _FORMULA.sub(r"\1'", harmless(str(value)))


def weighing_rows(contents: Contents) -> Iterator[dict[str, object]]:
    """The record's rows before they are text, by column; what a row has nothing to say of is absent or None."""
    jobs = {row["id"]: row for row in contents.each("job")}
    codes = {row["id"]: row["code"] for row in contents.each("action") if row["code"] is not None}
    of_run: dict[str, object] = {}
    sources: Mapping[str, SourceUsed] = {}
    believed: Mapping[str, Any] = {}
    identity = ""
    tare: Tared | None = None
    loaded: Pulsed | DoseWeighed | None = None
    of_doses: dict[tuple[str, str], dict[str, object]] = {}
    first_doses: dict[str, tuple[str, str]] = {}
    results: dict[str, int] = {}
    slots: dict[object, int | None] = {}
    for row in contents.each("entry"):
        believed = row["state"]["believed"] if row["state"] is not None else believed
        match event := parsed(row["kind"], row["payload"]):
            case RunBegun():
                sources, of_run = event.sources, _of_run(event)
            case Resumed():
                of_run |= {"operator": event.operator, "software": f"scuhand_bt {event.version}"}
            case JobStarted():
                tare = loaded = None
            case Tared():
                tare = event
            case Pulsed() | DoseWeighed():
                loaded = event
            case SampleResult():
                results[event.id] = row["seq"]
        if isinstance(event, ContainerPlaced | Tared | WeightChecked):
            identity = event.balance or identity
        if isinstance(event, ContainerPlaced):
            slots[event.container] = event.slot
        if (weighed := _weighed(event, tare, loaded, believed)) is None:
            continue
        pan = believed.get("pan") or {}
        job = jobs.get(row["job"]) or {}
        written = of_run | {
            "sample": job.get("sample"),
            "attempt": job.get("attempt"),
            "container": pan.get("id"),
            "container_kind": pan.get("name"),
            "balance_identity": identity,
            "failure_code": codes.get(row["action"]) if row["action"] is not None else job.get("code"),
            "sheet": believed.get("sheets_used"),
            "sheet_powder": believed.get("sheet"),
            **(_powder(believed, sources) if isinstance(event, Dose) else {}),
            **weighed,
            **_entry(contents, row),
        }
        if isinstance(event, ContainerLifted | BracketClosed):  # which may come in the next sample's job
            of_dose = of_doses.get(first_doses.get(event.container, ("", "")), {})
            written |= {name: of_dose.get(name) for name in ("sample", "attempt", "container_kind")}
        written["container_slot"] = slots.get(written["container"])
        if isinstance(event, Dose):
            first_doses.setdefault(event.container, (event.container, event.lot))
            of_doses[event.container, event.lot] = {k: v for k, v in written.items() if k not in _WEIGHED}
        yield written
    for row in map(contents.entry, results.values()):
        result = SampleResult.model_validate(row["payload"])
        yield from _result_rows(result, of_doses, of_run, _entry(contents, row))


def _entry(contents: Contents, row: Mapping[str, Any]) -> dict[str, object]:
    number = row["seq"] if contents.is_chained else None
    return {"at": row["at"], "run_time_s": row["time_s"], "entry": number, "entry_hash": row["hash"].hex()}


def _result_rows(
    result: SampleResult,
    of_doses: Mapping[tuple[str, str], Mapping[str, object]],
    of_run: Mapping[str, object],
    entry: Mapping[str, object],
) -> Iterator[dict[str, object]]:
    """A row for each dose of a sample, by the last that was said of it, each value recorded, each element composed."""
    for dose in result.doses:
        yield {
            **of_doses.get((dose.container, dose.lot), {}),
            "weighing": "result",
            "sample": result.id,
            "attempt": result.attempt,
            "container": dose.container,
            "net_mg": dose.dispensed_mg,
            "standard_uncertainty_mg": dose.uncertainty_mg,
            "tolerance_mg": dose.tolerance_mg,
            "verdict": dose.verdict,
            "sample_verdict": result.verdict,
            "bracket": dose.bracket,
            "true_mg": dose.true_mg,
            "failure_code": result.code,
            **entry,
        }
    of_sample = {
        **of_run,
        "sample": result.id,
        "attempt": result.attempt,
        "sample_verdict": result.verdict,
        "failure_code": result.code,
        **entry,
    }
    for value in result.recorded:
        yield {
            **of_sample,
            "weighing": "recorded",
            "recorded_name": value.name,
            "recorded_value": value.value,
            "recorded_unit": value.unit,
        }
    if (composition := result.composition) is None:
        return
    for element in composition.elements:
        yield {
            **of_sample,
            "weighing": "composition",
            "container": composition.container,
            "verdict": composition.verdict,
            "product": composition.product,
            "element": element.element,
            "atoms_asked": element.asked,
            "atoms_reached": element.reached,
            "atoms_standard_uncertainty": element.uncertainty,
            "composition_tolerance": composition.tolerance,
        }


def _of_run(run: RunBegun) -> dict[str, object]:
    balance = run.devices.get("balance", {})
    return {
        "run": run.run,
        "simulated": run.simulated,
        "mode": run.mode,
        "recipe": run.recipe,
        "recipe_hash": run.recipe_hash,
        "operator": run.operator,
        "balance_driver": balance.get("driver"),
        "readability_mg": balance.get("readability_mg"),
        "software": f"scuhand_bt {run.version}",
    }


def _powder(believed: Mapping[str, Any], sources: Mapping[str, SourceUsed]) -> dict[str, object]:
    """What was in the cone when it was dispensed."""
    name = believed.get("cone_source")
    source = sources.get(name or "")
    return {"source": name, "powder": source and source.powder, "lot": source and source.lot}


def _weighed(
    event: Event | None, tare: Tared | None, loaded: Pulsed | DoseWeighed | None, believed: Mapping[str, Any]
) -> dict[str, object] | None:
    """What an entry says about a mass; None for one that says nothing."""
    match event:
        case ContainerPlaced():
            row = _between(event.bare, event.loaded, event.mass_mg)
            return row | {"weighing": "container", "container": event.container, "container_kind": event.kind}
        case ContainerAgain():
            row = _between(event.bare, event.loaded, event.loaded.gross_mg - event.bare.gross_mg)
            return row | {"weighing": "container again", "container": event.container}
        case Tared():
            return _gross(event) | {"weighing": "tare", "standard_uncertainty_mg": event.uncertainty_mg}
        case Dose():
            if isinstance(loaded, DoseWeighed):
                row = _between(loaded.before, loaded, event.dispensed_mg) | {
                    "earlier_mg": event.dispensed_mg - loaded.gained_mg,
                    "drift_mg": loaded.gross_mg - loaded.before.gross_mg - loaded.gained_mg,
                }
            else:  # a journal of before doses were bracketed
                row = _between(tare, loaded, event.dispensed_mg) | {
                    "tare_mg": believed.get("pan_empty_mg", tare and tare.gross_mg)
                }
            return row | {
                "weighing": "dose",
                "standard_uncertainty_mg": event.uncertainty_mg,
                "target_mg": event.target_mg,
                "tolerance_mg": event.tolerance_mg,
                "tolerance_convention": CONVENTION,
                "verdict": event.verdict,
                "controller": event.controller,
            }
        case Weighed():
            row = _gross(event) | {"weighing": "weighed", "container": event.container, "net_mg": event.net_mg}
            return row | {"standard_uncertainty_mg": event.net_uncertainty_mg}
        case ContainerLifted():
            row = _gross(event) | {"weighing": "lifted", "container": event.container}
            return row | {"standard_uncertainty_mg": event.uncertainty_mg}
        case BracketClosed(bare=Weighing() as bare):
            row = _gross(bare) | {"weighing": "bare pan", "container": event.container}
            return row | {"standard_uncertainty_mg": bare.uncertainty_mg}
        case Reweighed():
            return _gross(event) | {"weighing": "after an interruption", "net_mg": event.arrived_mg}
        case ContainerReweighed():
            row = _between(event.bare, event.loaded, event.held_mg) | {"weighing": "after an outage"}
            return row | {"container": event.container, "standard_uncertainty_mg": event.uncertainty_mg}
        case PanCompared():
            return _gross(event) | {"weighing": "zero after an interruption"}
        case WeightChecked():
            return _between(event.bare, event.loaded, event.weight_mg + event.error_mg) | {
                "weighing": "check weight",
                "target_mg": event.weight_mg,
                "tolerance_mg": event.tolerance_mg,
            }
    return None


def _gross(weighed: Weighing | Pulsed | None) -> dict[str, object]:
    readings = weighed.readings if weighed is not None else ()
    return {
        "gross_mg": weighed.gross_mg if weighed is not None else None,
        "stable": _all_stable(readings),
        "gross_lines": _lines(readings),
        "lines_unit": readings[0].unit if readings else None,
    }


def _between(before: Weighing | None, after: Weighing | Pulsed | None, net_mg: float) -> dict[str, object]:
    """The difference of two weighings; in an old journal one of them may be missing."""
    bare = before.readings if before is not None else ()
    loaded = after.readings if after is not None else ()
    return _gross(after) | {
        "tare_mg": before.gross_mg if before is not None else None,
        "net_mg": net_mg,
        "stable": _all_stable([*bare, *loaded]),
        "tare_lines": _lines(bare),
    }


def _all_stable(readings: Sequence[Line]) -> bool | None:
    """Whether the balance called all of them stable; None for an old journal, which has none."""
    return all(reading.stable for reading in readings) if readings else None


def _lines(readings: Sequence[Line]) -> str:
    """The balance's own lines, one after the other."""
    return " | ".join(reading.raw.strip() for reading in readings)
