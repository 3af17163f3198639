"""JSON Schemas of the files that a lab's people write, for their editors: what may stand where, and what it means.

They are made of the models that read the files, and of the lab's own skills, workflows, powders and containers. An
editor checks the form with them; what `check` finds beyond that follows from what the values are (draft 2020-12).
"""

import ast
import inspect
import json
import textwrap
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from scuhand_bt.bench_spec import Station
from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.dosing import CONTROLLERS
from scuhand_bt.kit.case_files import SUCCESS, Expectation, Substituted
from scuhand_bt.lab import TEST_SUFFIX, Lab
from scuhand_bt.recipe.compose import COMPOSE, ComposeText
from scuhand_bt.recipe.leftover import POLICIES, TO
from scuhand_bt.recipe.order import ORDERS
from scuhand_bt.recipe.recipe import ACTIONS
from scuhand_bt.recipe.sources import SourceText
from scuhand_bt.sim.fault_rules import KINDS, Rule
from scuhand_bt.skill import Condition
from scuhand_bt.specs import Container, ContainerKind, Mortar, Powder, Source
from scuhand_bt.tree.grammar import COMPOSITES, DECORATOR_KEYS, PARAMETERS, RECORD
from scuhand_bt.tree.library import Library
from scuhand_bt.tree.wires import INPUT_TYPES, WireType

Json = dict[str, Any]
FOLDER = "schemas"
"""Where a lab keeps them; the headers of its files name it."""
REFERENCE: Json = {
    "type": "string",
    "pattern": r"^\$[A-Za-z_]\w*(\.[A-Za-z_]\w*)*$",
    "description": "$name or $name.attribute",
}
EXPRESSION: Json = {
    "type": "string",
    "pattern": r"\$[A-Za-z_]",
    "description": "$name, $name.attribute, or a calculation with them: 0.25 * $dose.dispensed",
}
TEXT: Json = {"type": ["string", "number", "boolean"]}
FLAG: Json = {"enum": [True, False, "yes", "no"]}


def schema(kind: str, lab: Lab) -> Json:
    """The schema of one kind of file (a key of `KINDS_OF_FILES`)."""
    made = _tidied(KINDS_OF_FILES[kind](lab))
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": f"scuhand_bt: {kind}", **made}


def written(kind: str, lab: Lab) -> str:
    """The schema as it stands in a file."""
    return json.dumps(schema(kind, lab), indent=1, ensure_ascii=False) + "\n"


def write_schemas(lab: Lab) -> list[Path]:
    """All schemas into the lab's folder `schemas`."""
    folder = lab.folder / FOLDER
    folder.mkdir(exist_ok=True)
    paths = [folder / f"{kind}.schema.json" for kind in KINDS_OF_FILES]
    for kind, path in zip(KINDS_OF_FILES, paths, strict=True):
        path.write_text(written(kind, lab), encoding="utf-8")
    return paths


# --- files that are models


def _cell(lab: Lab) -> Json:
    made = _model(CellSpec)
    properties = made["properties"]
    properties["stations"] = _named(_model(Station))
    properties["stations"]["additionalProperties"]["properties"].pop("of_frame")  # which no file gives
    properties.pop("own_options")
    for key in ("geometry", "zones"):
        properties[key]["items"]["properties"].pop("mesh_digest", None)  # which no file gives
    device = properties["devices"]["additionalProperties"]
    device["properties"]["options"] = {"type": "object", "description": "as its driver's `Options` have them"}
    named = {name: {**device, "properties": dict(device["properties"])} for name in lab.cell.devices}
    properties["devices"]["properties"] = named
    for name, options in lab.cell.own_options.items():
        section = named[name] if name in named else properties[name]
        section["properties"]["options"] = _model(type(options))
    return made


def _powders(lab: Lab) -> Json:
    return _named(_model(Powder))


def _containers(lab: Lab) -> Json:
    kinds = {"containers": _named(_model(ContainerKind)), "mortars": _named(_model(Mortar))}
    return {"type": "object", "properties": kinds, "required": list(kinds), "additionalProperties": False}


def _faults(lab: Lab) -> Json:
    rule = _model(Rule)
    rule["properties"]["fault"] = {"oneOf": [{"const": k, "description": one.summary} for k, one in KINDS.items()]}
    rules = {"type": "array", "items": rule, "minItems": 1}
    return {"type": "object", "properties": {"faults": rules}, "required": ["faults"], "additionalProperties": False}


def _named(entry: Json) -> Json:
    """A mapping whose keys are the names of its entries."""
    entry["properties"].pop("name", None)
    entry["required"] = [key for key in entry.get("required", ()) if key != "name"]
    return {"type": "object", "additionalProperties": entry}


def _model(model: type[BaseModel]) -> Json:
    """A model's schema with nothing outside of it, and what its source says of each field."""
    made = model.model_json_schema(by_alias=True)
    definitions = made.pop("$defs", {})
    models = {cls.__name__: cls for cls in _models_in(model)}
    for name, part in {model.__name__: made, **definitions}.items():
        if name in models:
            _describe(part, models[name])
    return dict(_inlined(made, definitions))


def _models_in(model: type[BaseModel]) -> list[type[BaseModel]]:
    found, todo = [model], [model]
    while todo:
        for info in todo.pop().model_fields.values():
            for cls in (info.annotation, *getattr(info.annotation, "__args__", ())):
                if inspect.isclass(cls) and issubclass(cls, BaseModel) and cls not in found:
                    found.append(cls)
                    todo.append(cls)
    return found


def _describe(part: Json, model: type[BaseModel]) -> None:
    """Add the docstrings of a model's fields, and their defaults in words: they are kept in other units."""
    for base in reversed(model.__mro__):
        if not (issubclass(base, BaseModel) and base is not BaseModel):
            continue
        body = ast.parse(textwrap.dedent(inspect.getsource(base))).body[0]
        assert isinstance(body, ast.ClassDef)
        for field, doc in zip(body.body, body.body[1:], strict=False):
            is_doc = isinstance(doc, ast.Expr) and isinstance(doc.value, ast.Constant)
            if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name) and is_doc:
                info = model.model_fields.get(field.target.id)
                if info is not None:
                    said = part["properties"][info.alias or field.target.id]
                    unit = f" ({said['description']})" if "description" in said else ""
                    said["description"] = inspect.cleandoc(doc.value.value) + unit  # type: ignore[attr-defined]


def _inlined(part: Any, definitions: Mapping[str, Json]) -> Any:
    if isinstance(part, list):
        return [_inlined(one, definitions) for one in part]
    if not isinstance(part, dict):
        return part
    if "$ref" in part:
        rest = {key: value for key, value in part.items() if key != "$ref"}
        return {**_inlined(definitions[part["$ref"].rsplit("/", 1)[1]], definitions), **rest}
    return {key: _inlined(value, definitions) for key, value in part.items()}


_NUMBER_KEYS = ("minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum")


def _tidied(part: Any) -> Any:
    """As YAML has it: `yes` is a flag, `007` a text; a quantity is a text, and has no bounds and defaults as one."""
    if isinstance(part, list):
        return [_tidied(one) for one in part]
    if not isinstance(part, dict):
        return part
    is_schema = not any(isinstance(value, dict) and key == "type" for key, value in part.items())
    made = {key: _tidied(value) for key, value in part.items() if key != "title" or isinstance(value, dict)}
    if is_schema and made.get("type") == "boolean":
        return {**{key: value for key, value in made.items() if key not in ("type", "default")}, **FLAG}
    if is_schema and made.get("type") == "string" and "pattern" in made:
        return {key: value for key, value in made.items() if key not in (*_NUMBER_KEYS, "default")}
    if is_schema and made.get("type") == "string" and not {"enum", "const"} & made.keys():
        return {**made, **TEXT}
    if is_schema and isinstance(made.get("default"), dict | list | float):
        made.pop("default")
    return made


# --- workflows and recipes


def _of_wire(wire: WireType, library: Library) -> Json:
    """What may be written for a value of this type; a thing of the lab by its name."""
    if wire.item is not None:
        return {"type": "array", "items": _of_wire(wire.item, library)}
    if wire.python is Powder:
        return {"enum": sorted(library.powders)}
    if wire.python is Container:
        return {"enum": sorted(library.containers), "description": "a kind of container of robot/containers.yaml"}
    if wire.is_class:
        return {"type": "string", "description": f"a {wire.name}"}
    if wire.name == "Text" and wire.python is str:
        return dict(TEXT)
    from pydantic import TypeAdapter

    try:
        made = TypeAdapter(wire.python).json_schema()
    except Exception:  # a lab's own type, which JSON Schema cannot say
        return {}
    return dict(_inlined(made, made.pop("$defs", {})))


def _workflow(lab: Lab) -> Json:
    library = lab.library
    node: Json = {"$ref": "#/$defs/node"}
    nodes: Json = {"type": "array", "items": node, "minItems": 1}
    own = {name: _or_reference(_of_wire(wire, library)) for name, wire in PARAMETERS.items()}
    codes: Json = {"enum": sorted(library.failures())}
    parts: Json = {
        **own,
        "on": {"anyOf": [codes, {"type": "array", "items": codes, "minItems": 1}]},
        "guards": {"type": "array", "items": {"$ref": "#/$defs/condition"}, "minItems": 1},
        "items": {
            "type": "object",
            "additionalProperties": EXPRESSION,
            "minProperties": 1,
            "description": "lists side by side, by what their items are called: {holder: $holders}",
        },
        "child": node,
    }
    keys: Json = dict.fromkeys(COMPOSITES, nodes)
    after = _object({"on": parts["on"], "children": nodes}, ["children"])
    keys["fallback"] = {"anyOf": [nodes, after]}
    keys["if"] = _object({"when": own["when"], "then": node, "else": node}, ["when", "then"])
    cases: Json = {"type": "object", "additionalProperties": node, "minProperties": 1}
    keys["switch"] = _object({"value": EXPRESSION, "cases": cases, "otherwise": node}, ["value", "cases"])
    for kind, known in DECORATOR_KEYS.items():
        needed = [key for key in known if key != "on"]
        made = _object({key: parts[key] for key in known}, needed)
        keys[kind] = {"anyOf": [made, node]} if known == ("child",) else made
    calls = {name: _call(name, library) for name in (*library.skills, *library.workflows)}
    conditions = {name: calls[name] for name, skill in library.skills.items() if issubclass(skill, Condition)}
    calls[RECORD] = {
        "type": "object",
        "additionalProperties": {"anyOf": [EXPRESSION, TEXT]},
        "minProperties": 1,
        "description": library.skills[RECORD].summary(),
    }
    one: Json = {"enum": sorted(INPUT_TYPES)}
    declared: Json = {"anyOf": [one, {"type": "array", "items": one, "minItems": 1, "maxItems": 1}]}
    an_input = {"anyOf": [declared, _object({"type": declared, "default": {}}, ["type"])]}
    workflow = {
        "workflow": {"type": "string", "description": "the name of this file"},
        "summary": {"type": "string"},
        "inputs": {"type": ["object", "null"], "additionalProperties": an_input},
        "result": EXPRESSION,
        "tree": node,
    }
    return {
        **_object(workflow, ["workflow", "tree"]),
        "$defs": {"node": _one_of_keys({**keys, **calls}), "condition": _one_of_keys(conditions)},
    }


def _call(name: str, library: Library) -> Json:
    parameters = library.parameters(name)
    values = {key: _or_reference(_of_wire(p.wire, library), p.wire) for key, p in parameters.items()}
    required = [key for key, p in parameters.items() if p.required]
    summary = library.skills[name].summary() if name in library.skills else library.workflows[name].summary
    made = _object({**values, "as": {"type": "string", "description": "keeps the result under this name"}}, required)
    return {**made, "type": "object" if required else ["object", "null"], "description": summary}


def _or_reference(value: Json, wire: WireType | None = None) -> Json:
    """A thing of the lab but a powder is always wired, from an input."""
    return REFERENCE if wire is not None and wire.python in (Source, Container) else {"anyOf": [value, EXPRESSION]}


def _recipe(lab: Lab) -> Json:
    library = lab.library
    vessels = [one.name for one in lab.cell.stations.values() if one.kind == "waste"]
    mortar_stations = [one.name for one in lab.cell.stations.values() if one.kind == "mortar"]
    source = _model(SourceText)
    known = {"station": mortar_stations, "container": library.mortars, "powder": library.powders}
    source["properties"].update({key: {"enum": sorted(names)} for key, names in known.items()})
    inputs: Json = {}
    for workflow in library.workflows.values():
        for declared in workflow.inputs.values():
            value = _of_wire(declared.type, library)
            if value not in (said := inputs.setdefault(declared.name, [])):
                said.append(value)
    values = {key: said[0] if len(said) == 1 else {"anyOf": said} for key, said in inputs.items()}
    each = {key: {"anyOf": [value, {"type": "array", "items": value}]} for key, value in values.items()}
    workflows: Json = {"enum": sorted(library.workflows)}
    ids = {"anyOf": [TEXT, {"type": "array", "items": TEXT}]}
    compose = _model(ComposeText)
    formula: Json = {"type": "string", "description": "the product's formula, all else as the defaults have it"}
    composed: Json = {"anyOf": [formula, {**compose, "required": []}]}
    each |= {COMPOSE: {"anyOf": [composed, {"type": "array", "items": composed}]}}
    own = {"id": ids, "workflow": workflows, "repeat": {"type": "integer", "minimum": 1}, "table": {"type": "string"}}
    actions: Json = {"oneOf": [{"const": key, "description": said} for key, said in ACTIONS.items()]}
    codes = dict.fromkeys(sorted(library.failures()), actions)
    return _object(
        {
            "recipe": {**TEXT, "description": "its name"},
            "summary": {"type": "string"},
            "workflow": {**workflows, "description": "of every sample that names none of its own"},
            "controller": {"enum": sorted(CONTROLLERS)},
            "order": {"enum": list(ORDERS)},
            "sources": {"type": "object", "additionalProperties": source, "minProperties": 1},
            "defaults": _object({**values, COMPOSE: composed}, []),
            "samples": {"type": "array", "items": _object({**own, **each}, []), "minItems": 1},
            "leftover": {
                "anyOf": [
                    {"oneOf": [{"const": key, "description": said} for key, said in POLICIES.items()]},
                    _object({TO: {"enum": sorted(vessels)}}, [TO]),
                ]
            },
            "on_failure": _object({**codes, "otherwise": actions}, []),
            "overshoot_limit": {"type": "integer", "minimum": 0},
        },
        ["samples"],
    )


def _test(lab: Lab) -> Json:
    library, recipe = lab.library, _recipe(lab)["properties"]
    codes, skills = sorted(library.failures()), sorted(library.skills)
    inputs = _object({key: value for key, value in recipe["defaults"]["properties"].items() if key != COMPOSE}, [])
    rule = _model(Substituted)
    rule["properties"] |= {"fails": {"enum": codes}, "gives": {"description": "the result that it ends with"}}
    expect = _model(Expectation)
    expect["properties"]["outcome"] |= {"enum": [SUCCESS, *codes]}
    expect["properties"]["calls"] = {"type": "array", "items": {"enum": skills}}
    times: Json = {"type": "integer", "minimum": 0}
    expect["properties"]["times"] = _object(dict.fromkeys(skills, times), [])
    case = {
        "name": {**TEXT, "description": "the sentence that it proves"},
        "inputs": inputs,
        "seed": {"type": "integer", "minimum": 0},
        "substitute": {"type": "array", "items": rule},
        "faults": _faults(lab)["properties"]["faults"],
        "expect": expect,
        "trace": {"type": "string", "description": "a file beside the test with all calls of the case"},
    }
    whole = {
        "test": {"enum": sorted(library.workflows)},
        "summary": {"type": "string"},
        "sources": recipe["sources"],
        "inputs": inputs,
        "cases": {"type": "array", "items": _object(case, ["name"]), "minItems": 1},
    }
    return _object(whole, ["test", "cases"])


def _object(properties: Mapping[str, Any], required: list[str]) -> Json:
    made: Json = {"type": "object", "properties": dict(properties), "additionalProperties": False}
    return {**made, "required": required} if required else made


def _one_of_keys(values: Mapping[str, Json]) -> Json:
    """A mapping of exactly one of these keys."""
    return {**_object(values, []), "minProperties": 1, "maxProperties": 1}


KINDS_OF_FILES: Mapping[str, Callable[[Lab], Json]] = {
    "recipe": _recipe,
    "workflow": _workflow,
    "cell": _cell,
    "powders": _powders,
    "containers": _containers,
    "faults": _faults,
    "test": _test,
}
FILES_OF: Mapping[str, str] = {
    "recipe": "recipes/*.yaml",
    "workflow": "trees/*.yaml",
    "cell": "robot/cell.yaml",
    "powders": "robot/powders.yaml",
    "containers": "robot/containers.yaml",
    "test": f"trees/*{TEST_SUFFIX}",
}
"""Where the files of a kind stand in a lab."""


def vscode_settings() -> Json:
    """Settings of VS Code for a lab's folder: the schemas for its files (of the extension redhat.vscode-yaml)."""
    schemas = {
        f"{FOLDER}/{kind}.schema.json": [pattern] if kind == "test" else [pattern, f"!*{TEST_SUFFIX}"]
        for kind, pattern in FILES_OF.items()
    }
    return {"yaml.schemas": schemas, "yaml.validate": True, "files.associations": {"*.yaml": "yaml"}}
