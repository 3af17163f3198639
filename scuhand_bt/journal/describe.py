"""The description of all kinds of entries, made from their models: `python -m scuhand_bt.journal.describe docs`.

It brings the tables of `journal.md`, `journal.schema.json` and `events.schema.json` in that folder up to date.
"""

import ast
import inspect
import json
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from pydantic.json_schema import models_json_schema

from scuhand_bt.events import cell, doses, weighings
from scuhand_bt.events.catalogue import SKILL_EVENTS
from scuhand_bt.events.entry import NOTE_KIND, Event
from scuhand_bt.journal import events, run_events
from scuhand_bt.journal.events import ENGINE_EVENTS, Frames
from scuhand_bt.journal.kinds import KINDS
from scuhand_bt.journal.telling import VERSION

_BEGIN, _END = "<!-- {} entries, made by scuhand_bt.journal.describe -->", "<!-- end -->"


def with_tables(text: str) -> str:
    """The text of `journal.md` with its tables of kinds as the models have them. Raises ValueError without places."""
    for name, kinds in (("engine", ENGINE_EVENTS), ("skill", SKILL_EVENTS)):
        begin, end = _BEGIN.format(name), _END
        before, found, rest = text.partition(begin)
        _, ended, after = rest.partition(end)
        if not found or not ended:
            raise ValueError(f"there is no '{begin}' … '{end}' in the text")
        text = f"{before}{begin}\n{_table(kinds)}\n{end}{after}"
    return text


def schema() -> str:
    """JSON Schema (2020-12) of every kind's payload, by kind."""
    return _written(
        {
            "title": "The payloads of a journal's entries, by kind",
            "type": "object",
            "properties": {kind: {"$ref": f"#/$defs/{model.__name__}"} for kind, model in KINDS.items()},
            "patternProperties": {f"^{NOTE_KIND}$": _NOTE},
            "additionalProperties": False,
        }
    )


def schema_of_lines() -> str:
    """JSON Schema (2020-12) of a line of `scuhand-bt run --events`, whatever its kind."""
    number = {"type": ["integer", "null"], "minimum": 1}
    properties = {
        "version": {"const": VERSION, "description": "Of a line; kinds and fields are added without another one."},
        "seq": {"type": "integer", "minimum": 1, "description": "The number of the journal's entry."},
        "kind": {"type": "string"},
        "time_s": {"type": "number", "description": "The run's time."},
        "at": {"type": "string", "format": "date-time", "description": "Wall time with its offset from UTC."},
        "job": {**number, "description": "The entry with which the job began that this belongs to."},
        "action": {**number, "description": "And the action."},
        "values": {"type": "object"},
    }
    kinds = [_line(kind, {"$ref": f"#/$defs/{model.__name__}"}) for kind, model in KINDS.items() if model != Frames]
    line = {
        "type": "array",
        "prefixItems": [{"type": one} for one in ("number", "string", "number", "string", "boolean")],
    }
    lines = {"type": "array", "items": line, "description": "[time_s, raw, value_mg, unit, stable]"}
    readings = {"$ref": f"#/$defs/{Frames.__name__}", "properties": {"lines": lines}, "required": ["lines"]}
    own = {"properties": {"kind": {"pattern": f"^{NOTE_KIND}$"}, "values": _NOTE}}
    return _written(
        {
            "title": "A line of `scuhand-bt run --events`: an entry of the run's journal",
            "type": "object",
            "properties": properties,
            "required": list(properties),
            "additionalProperties": False,
            "anyOf": [*kinds, _line(Frames.KIND, readings), own],
        }
    )


_NOTE = {"type": "object", "description": "A lab's own."}


def _line(kind: str, values: Mapping[str, Any]) -> dict[str, Any]:
    return {"properties": {"kind": {"const": kind}, "values": values}}


def _written(whole: Mapping[str, Any]) -> str:
    """A schema with the definitions of all kinds' models, and what stands below their fields."""
    _, made = models_json_schema([(model, "validation") for model in KINDS.values()])
    defs = made["$defs"]
    for name, docs in _docs().items():
        for field, description in docs.items():
            if name in defs:
                defs[name]["properties"][field]["description"] = description
    draft = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
    return json.dumps({**draft, **whole, "$defs": defs}, indent=1, ensure_ascii=False) + "\n"


def _table(kinds: Sequence[type[Event]]) -> str:
    rows = ["| kind | model | what | fields |", "| --- | --- | --- | --- |"]
    for model in kinds:
        what = " ".join((inspect.getdoc(model) or "").split())
        fields = ", ".join(f"`{name}`" for name in model.model_fields)
        rows.append(f"| `{model.KIND}` | `{model.__name__}` | {what} | {fields} |")
    return "\n".join(rows)


def _docs() -> Mapping[str, Mapping[str, str]]:
    """What stands below the fields of each model: pydantic would read it too, but whenever a program starts."""
    found = {}
    for module in (weighings, doses, cell, run_events, events):
        for node in ast.parse(inspect.getsource(module)).body:
            if isinstance(node, ast.ClassDef):
                found[node.name] = dict(_docs_of(node.body))
    return found


def _docs_of(body: Sequence[ast.stmt]) -> Iterator[tuple[str, str]]:
    for field, below in pairwise(body):
        match field, below:
            case (
                ast.AnnAssign(target=ast.Name(id=name)),
                ast.Expr(value=ast.Constant(value=str(text))),
            ) if re.fullmatch("[a-z][a-z_]*", name):
                yield name, " ".join(text.split())


def main(arguments: Sequence[str]) -> None:
    """Write all of it into the folder that is named."""
    folder = Path(*arguments)
    page = folder / "journal.md"
    page.write_text(with_tables(page.read_text(encoding="utf-8")), encoding="utf-8")
    (folder / "journal.schema.json").write_text(schema(), encoding="utf-8")
    (folder / "events.schema.json").write_text(schema_of_lines(), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
