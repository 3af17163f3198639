"""The weighing record of a run, for an audit: a table with one row for every weighing that something rests on.

It is comma-separated, with a decimal point and CRLF (RFC 4180). A text that a spreadsheet would take for a
formula gets an apostrophe in front.
"""

import csv
import io
from collections.abc import Iterator, Mapping
from typing import Any

from scuhand_bt.journal.reader import Contents

CONVENTION = (
    "absolute; in tolerance means |net - target| <= tolerance - 2 standard uncertainties of the net mass (guard band), "
    "by a mean of stable readings"
)
COLUMNS = (
    "run", "simulated", "mode", "recipe", "recipe_hash", "operator", "at", "run_time_s", "sample", "attempt",
    "container", "container_kind", "weighing", "balance_driver", "balance_identity", "readability_mg", "tare_mg",
    "gross_mg", "net_mg", "standard_uncertainty_mg", "stable", "tare_lines", "gross_lines", "lines_unit", "target_mg",
    "tolerance_mg", "tolerance_convention", "verdict", "failure_code", "source", "powder", "lot", "sheet",
    "sheet_powder", "controller", "software", "entry", "entry_hash",
)  # fmt: skip
_FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n")


def weighing_record(contents: Contents) -> str:
    """The record as CSV. Masses are in mg; the lines are the balance's own, as they came, in `lines_unit`."""
    text = io.StringIO()
    table = csv.DictWriter(text, COLUMNS, restval="")
    table.writeheader()
    for row in _rows(contents):
        table.writerow({name: _cell(value) for name, value in row.items()})
    return text.getvalue()


def _cell(value: object) -> str:
    """A value as a cell; None is empty."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.4f}"
    text = str(value)
    return f"'{text}" if text.lstrip(" ").startswith(_FORMULA) and not isinstance(value, int) else text


def _rows(contents: Contents) -> Iterator[dict[str, object]]:
    jobs = {row["id"]: row for row in contents.rows("job")}
    codes = {row["id"]: row["code"] for row in contents.rows("action")}
    of_run: dict[str, object] = {}
    sources: Mapping[str, Mapping[str, Any]] = {}
    believed: Mapping[str, Any] = {}
    identity = ""
    tare: Mapping[str, Any] = {}
    loaded: Mapping[str, Any] = {}
    for row in contents.rows("entry"):
        kind, values = row["kind"], row["payload"]
        believed = row["state"]["believed"] if row["state"] is not None else believed
        if kind == "run":
            sources, of_run = values.get("sources", {}), _of_run(values)
        elif kind == "resumed":
            of_run |= {"operator": values.get("operator"), "software": f"scuhand_bt {values['version']}"}
        elif kind == "job_started":
            tare = loaded = {}
        elif kind == "tare":
            tare = values
        elif kind == "pulse":
            loaded = values
        identity = values.get("balance", identity)
        if (weighed := _weighed(kind, values, tare, loaded, believed)) is None:
            continue
        pan = believed.get("pan") or {}
        job = jobs.get(row["job"]) or {}
        yield of_run | {
            "at": row["at"],
            "run_time_s": row["time_s"],
            "sample": job.get("sample"),
            "attempt": job.get("attempt"),
            "container": pan.get("id"),
            "container_kind": pan.get("name"),
            "balance_identity": identity,
            "failure_code": codes.get(row["action"]) if row["action"] is not None else job.get("code"),
            "sheet": believed.get("sheets_used"),
            "sheet_powder": believed.get("sheet"),
            **(_powder(believed, sources) if kind == "dose" else {}),
            **weighed,
            "entry": row["seq"] if contents.is_chained else None,
            "entry_hash": row["hash"].hex(),
        }


def _of_run(header: Mapping[str, Any]) -> dict[str, object]:
    balance = header.get("devices", {}).get("balance", {})
    names = ("run", "simulated", "mode", "recipe", "recipe_hash", "operator")
    return {name: header.get(name) for name in names} | {
        "balance_driver": balance.get("driver"),
        "readability_mg": balance.get("readability_mg"),
        "software": f"scuhand_bt {header['version']}",
    }


def _powder(believed: Mapping[str, Any], sources: Mapping[str, Mapping[str, Any]]) -> dict[str, object]:
    """What was in the cone when it was dispensed."""
    name = believed.get("cone_source")
    source = sources.get(name or "", {})
    return {"source": name, "powder": source.get("powder"), "lot": source.get("lot")}


def _weighed(
    kind: str,
    values: Mapping[str, Any],
    tare: Mapping[str, Any],
    loaded: Mapping[str, Any],
    believed: Mapping[str, Any],
) -> dict[str, object] | None:
    """What an entry says about a mass; None for one that says nothing."""
    match kind:
        case "container":
            row = _between(values.get("bare", {}), values.get("loaded", {}), values["mass_mg"])
            return row | {"weighing": "container", "container": values["container"], "container_kind": values["kind"]}
        case "tare":
            return _gross(values) | {"weighing": "tare", "standard_uncertainty_mg": values.get("uncertainty_mg")}
        case "dose":
            tare_mg = believed.get("pan_empty_mg", tare.get("gross_mg"))
            return _between({**tare, "gross_mg": tare_mg}, loaded, values["dispensed_mg"]) | {
                "weighing": "dose",
                "standard_uncertainty_mg": values["uncertainty_mg"],
                "target_mg": values["target_mg"],
                "tolerance_mg": values["tolerance_mg"],
                "tolerance_convention": CONVENTION,
                "verdict": values["verdict"],
                "controller": values["controller"],
            }
        case "reweighed":
            return _gross(values) | {"weighing": "after an interruption", "net_mg": values["arrived_mg"]}
        case "pan_compared":
            return _gross(values) | {"weighing": "zero after an interruption"}
        case "check_weight":
            row = _between(values.get("bare", {}), values.get("loaded", {}), values["weight_mg"] + values["error_mg"])
            return row | {
                "weighing": "check weight",
                "target_mg": values["weight_mg"],
                "tolerance_mg": values.get("tolerance_mg"),
            }
    return None


def _gross(weighed: Mapping[str, Any]) -> dict[str, object]:
    readings = weighed.get("readings", [])
    return {
        "gross_mg": weighed.get("gross_mg"),
        "stable": _all_stable(readings),
        "gross_lines": _lines(readings),
        "lines_unit": readings[0]["unit"] if readings else None,
    }


def _between(before: Mapping[str, Any], after: Mapping[str, Any], net_mg: float) -> dict[str, object]:
    """The difference of two weighings."""
    bare, loaded = before.get("readings", []), after.get("readings", [])
    return _gross(after) | {
        "tare_mg": before.get("gross_mg"),
        "net_mg": net_mg,
        "stable": _all_stable([*bare, *loaded]),
        "tare_lines": _lines(bare),
    }


def _all_stable(readings: list[Mapping[str, Any]]) -> bool | None:
    """Whether the balance called all of them stable; None for an old journal, which has none."""
    return all(reading["stable"] for reading in readings) if readings else None


def _lines(readings: list[Mapping[str, Any]]) -> str:
    """The balance's own lines, one after the other."""
    return " | ".join(reading["raw"].strip() for reading in readings)
