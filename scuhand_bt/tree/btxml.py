"""Converts workflows to BehaviorTree.CPP 4 XML, as Groot2 and similar editors use it, and back.

A workflow and every workflow that it calls become a `BehaviorTree` each. Skills become actions and conditions, with
their ports in the `TreeNodesModel`. Quantities are texts with units. What the format cannot express is kept in
attributes that begin with `_scuhand_`, which BehaviorTree.CPP ignores.

    $mass            {mass}
    as: dose         result="{dose}"
    sequence         Sequence
    fallback         Fallback
    parallel         Parallel success_count="-1" failure_count="1"
    while            ReactiveSequence, its last child is the `child`
    retry            RetryUntilSuccessful num_attempts, _scuhand_on
    timeout          Timeout msec, _scuhand_duration
    repeat           Repeat num_cycles
    invert           Inverter
    optional         ForceSuccess
    fallback: {on}   Fallback _scuhand_on
    if               IfThenElse; its first child is a ScriptCondition with _scuhand_when
    switch           Switch2 to Switch6; AlwaysFailure if there is no `otherwise`
    for_each         LoopString over the first of its lists, _scuhand_items

An expression ($mass - $a.dispensed) is written as its text.
"""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import yaml

from scuhand_bt.problems import Mark, Problem, SourceError
from scuhand_bt.quantity import DURATION, parse
from scuhand_bt.skill import Condition
from scuhand_bt.tree.expressions import Expression, Reference
from scuhand_bt.tree.grammar import RECORD
from scuhand_bt.tree.library import Library
from scuhand_bt.tree.wires import NOTHING, WireType, of_field
from scuhand_bt.tree.workflow import Argument, Branch, Call, Choice, TreeNode, Workflow, walk
from scuhand_bt.yaml_source import Items, Node, Scalar, describe

OWN = "_scuhand_"
RESULT = "result"
BRANCHES = {"sequence": "Sequence", "fallback": "Fallback", "parallel": "Parallel"}
DECORATORS = {
    "retry": ("RetryUntilSuccessful", "num_attempts", "attempts"),
    "repeat": ("Repeat", "num_cycles", "times"),
    "timeout": ("Timeout", "msec", "duration"),
    "invert": ("Inverter", "", ""),
    "optional": ("ForceSuccess", "", ""),
}
WHILE, LOOP, IF, ELSE, NO_CASE = "ReactiveSequence", "LoopString", "IfThenElse", "AlwaysSuccess", "AlwaysFailure"
MOST_CASES = 6
TYPES = {"Integer": "int", "Number": "double", "Flag": "bool"}
"""Types of ports; everything else is a string."""


def to_xml(library: Library, name: str) -> str:
    """A checked workflow and all that it calls, as one file. SourceError for what the format cannot express."""
    root = Element("root", BTCPP_format="4", main_tree_to_execute=name)
    workflows = list(dict.fromkeys(_reached(library, name)))
    for each in workflows:
        workflow = library.workflows[each]
        tree = SubElement(root, "BehaviorTree", ID=each)
        if workflow.summary:
            tree.set("_description", workflow.summary)
        _node(tree, workflow.tree, library)
    model = SubElement(root, "TreeNodesModel")
    skills = dict.fromkeys(call for each in workflows for call in _skills(library.workflows[each], library))
    for skill in sorted(skills):
        _model_of_skill(model, skill, library, workflows)
    for each in workflows:
        _model_of_workflow(model, library.workflows[each])
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _reached(library: Library, name: str) -> Iterator[str]:
    yield name
    for part in walk(library.workflows[name].tree):
        if isinstance(part, Call) and part.name in library.workflows:
            yield from _reached(library, part.name)


def _skills(workflow: Workflow, library: Library) -> Iterator[str]:
    return (part.name for part in walk(workflow.tree) if isinstance(part, Call) and part.name in library.skills)


def _node(parent: Element, node: TreeNode, library: Library) -> None:
    if isinstance(node, Branch):
        made = SubElement(parent, BRANCHES[node.kind])
        if node.kind == "parallel":
            made.attrib.update({"success_count": "-1", "failure_count": "1"})
        _set_codes(made, node.codes)
        for child in node.children:
            _node(made, child, library)
    elif isinstance(node, Call):
        _call(parent, node, library)
    elif isinstance(node, Choice):
        _choice(parent, node, library)
    elif node.kind == "for_each":
        (name, first), *_ = node.arguments.items()
        made = SubElement(parent, LOOP, queue=_text(first), value="{" + name + "}", if_empty="SUCCESS")
        made.set(OWN + "items", "; ".join(f"{key}={argument}" for key, argument in node.arguments.items()))
        _node(made, node.child, library)
    elif node.kind == "while":
        made = SubElement(parent, WHILE)
        for child in (*node.guards, node.child):
            _node(made, child, library)
    else:
        tag, port, key = DECORATORS[node.kind]
        made = SubElement(parent, tag)
        if key:
            argument = node.arguments[key]
            made.set(port, _count(key, argument))
            if isinstance(argument, Expression) or (key == "duration" and isinstance(argument, Node)):
                made.set(OWN + key, _text(argument))
        _set_codes(made, node.codes)
        _node(made, node.child, library)


def _set_codes(made: Element, codes: Mapping[str, Mark]) -> None:
    if codes:
        made.set(OWN + "on", ";".join(codes))


def _choice(parent: Element, node: Choice, library: Library) -> None:
    cases, by = [case for case in node.cases if case.value is not None], _text(node.argument)
    if node.kind == "if":
        made = SubElement(parent, IF)
        SubElement(made, "ScriptCondition", {"code": "true", OWN + "when": by})
    elif 2 <= len(cases) <= MOST_CASES:
        variable = {"variable": by} if isinstance(node.argument, Reference) else {"variable": "", OWN + "value": by}
        values = {f"case_{number}": case.label for number, case in enumerate(cases, 1)}
        made = SubElement(parent, f"Switch{len(cases)}", {**variable, **values})
    else:
        what = f"a 'switch' of {len(cases)} cases cannot be written for BehaviorTree.CPP"
        raise SourceError([Problem(node.mark, f"{what}; it can have 2 to {MOST_CASES}")])
    for case in node.cases:
        _node(made, case.child, library)
    if not node.is_exhaustive:
        SubElement(made, ELSE if node.kind == "if" else NO_CASE)


def _count(key: str, argument: Argument) -> str:
    if isinstance(argument, Expression):
        return "1"
    if isinstance(argument, Reference) or key != "duration":
        return _text(argument)
    return str(round(1000 * parse(_text(argument), DURATION)))


def _call(parent: Element, node: Call, library: Library) -> None:
    is_skill = node.name in library.skills
    made = SubElement(parent, node.name) if is_skill else SubElement(parent, "SubTree", ID=node.name)
    wires = library.wires(node)
    for key, argument in node.arguments.items():
        made.set(key, _text(argument, None if is_skill else wires[key]))
    if lists := [key for key, argument in node.arguments.items() if isinstance(argument, Items)]:
        made.set(OWN + "lists", ";".join(lists))
    if node.result is not None:
        made.set(RESULT, "{" + node.result + "}")


def _text(argument: Argument, wire: WireType | None = None) -> str:
    """A value as the text of an attribute.

    A `Number` in a call of a workflow gets ".0": a subtree would take "5" as an integer.
    """
    if isinstance(argument, Reference):
        return "{" + str(argument)[1:] + "}"
    if isinstance(argument, Expression):
        return argument.text
    if isinstance(argument, Items):
        return ";".join(_text(item, wire.item if wire is not None else None) for item in argument.items)
    text = argument.text if isinstance(argument, Scalar) else None
    if text is None:
        what = f"{describe(argument)} cannot be written for BehaviorTree.CPP, which has only texts"
        raise SourceError([Problem(argument.mark, what)])
    if wire is not None and wire.name == "Flag":
        return "true" if text in ("yes", "true", "on") else "false"
    if wire is not None and wire.name == "Number" and text and text.lstrip("+-").isdigit():
        return f"{text}.0"
    return text


def _model_of_skill(model: Element, name: str, library: Library, workflows: Iterable[str]) -> None:
    skill = library.skills[name]
    made = SubElement(model, "Condition" if issubclass(skill, Condition) else "Action", ID=name)
    fields = {info.alias or key: info for key, info in skill.model_fields.items()}
    if name == RECORD:
        nodes = (node for each in workflows for node in walk(library.workflows[each].tree))
        calls = (node for node in nodes if isinstance(node, Call) and node.name == RECORD)
        for key in dict.fromkeys(key for call in calls for key in call.arguments):
            SubElement(made, "input_port", name=key, type="std::string")
    for key, parameter in library.parameters(name).items():
        port = SubElement(made, "input_port", name=key, type=TYPES.get(parameter.wire.name, "std::string"))
        port.text = parameter.wire.name
        default = fields[key].default
        if not parameter.required and isinstance(default, bool | int | str) and default != "":
            port.set("default", str(default).lower() if isinstance(default, bool) else str(default))
    result = of_field(skill.result_type())
    if result != NOTHING:
        port = SubElement(made, "output_port", name=RESULT, type=TYPES.get(result.name, "std::string"))
        port.text = result.name
    about = SubElement(SubElement(made, "MetadataFields"), "Metadata")
    about.set("summary", skill.summary())


def _model_of_workflow(model: Element, workflow: Workflow) -> None:
    made = SubElement(model, "SubTree", ID=workflow.name)
    for declared in workflow.inputs.values():
        kind = TYPES.get(declared.type.name, "std::string")
        port = SubElement(made, "input_port", name=declared.name, type=kind)
        port.text = declared.type.name
        if declared.default is not None:
            port.set("default", _text(declared.default, declared.type))
    if workflow.result is not None:
        SubElement(made, "output_port", name=RESULT, default=_text(workflow.result))


# --- and back


def from_xml(text: str, file: str) -> dict[str, str]:
    """The workflows of such a file by name, each as its YAML file's text. Raises SourceError for a foreign file."""
    if "<!" in text.replace("<!--", ""):
        raise SourceError([Problem(Mark(file), "has a document type or entities, which are not accepted")])
    try:
        root = ElementTree.fromstring(text.encode())
    except ElementTree.ParseError as error:
        line, column = error.position
        raise SourceError([Problem(Mark(file, line, column + 1), f"is not XML: {error}")]) from None
    models = {one.get("ID", ""): one for one in root.iterfind("TreeNodesModel/SubTree")}
    found = {}
    for tree in root.iterfind("BehaviorTree"):
        name, children = tree.get("ID", ""), list(tree)
        if len(children) != 1:
            raise SourceError([Problem(Mark(file), f"the tree '{name}' has {len(children)} children; a tree has one")])
        workflow: dict[str, Any] = {"workflow": name}
        if summary := tree.get("_description"):
            workflow["summary"] = summary
        workflow |= _declared(models.get(name))
        workflow["tree"] = _read(children[0], file)
        found[name] = yaml.safe_dump(workflow, sort_keys=False, allow_unicode=True, width=110)
    return found


def _declared(model: Element | None) -> dict[str, Any]:
    inputs: dict[str, Any] = {}
    made: dict[str, Any] = {}
    for port in model if model is not None else ():
        name, default = port.get("name", ""), port.get("default")
        if port.tag == "input_port":
            kind = (port.text or "Text").strip()
            is_list = kind.startswith("[")
            declared = [kind[1:-1]] if is_list else kind
            of_list = default.split(";") if is_list and default is not None else default
            inputs[name] = declared if default is None else {"type": declared, "default": of_list}
        elif port.tag == "output_port" and default:
            made["result"] = _value(default)
    return {"inputs": inputs, **made} if inputs else made


def _read(node: Element, file: str) -> dict[str, Any]:
    if node.tag in (IF, LOOP) or node.tag.startswith("Switch"):
        return _read_chosen(node, file)
    kinds = {tag: kind for kind, tag in BRANCHES.items()}
    decorators = {tag: (kind, port, key) for kind, (tag, port, key) in DECORATORS.items()}
    children = [_read(child, file) for child in node]
    if node.tag in kinds:
        codes = node.get(OWN + "on")
        return {kinds[node.tag]: {"on": codes.split(";"), "children": children} if codes else children}
    if node.tag == WHILE:
        return {"while": {"guards": children[:-1], "child": children[-1]}}
    if node.tag not in decorators:
        name = node.get("ID", "") if node.tag in ("SubTree", "Action", "Condition") else node.tag
        return {name: _arguments(node.attrib)}
    kind, port, key = decorators[node.tag]
    if len(children) != 1:
        raise SourceError([Problem(Mark(file), f"{node.tag} has {len(children)} children; it takes one")])
    body: dict[str, Any] = {}
    if key:
        given: str = node.get(OWN + key) or node.get(port) or ""
        is_written = OWN + key in node.attrib or given.startswith("{")
        body[key] = _value(given) if is_written or key != "duration" else f"{given} ms"
    if codes := node.get(OWN + "on"):
        body["on"] = codes.split(";")
    return {kind: {**body, "child": children[0]}}


def _read_chosen(node: Element, file: str) -> dict[str, Any]:
    """Read an `if`, a `switch` or a `for_each`."""
    first, last = node[0] if len(node) else None, node[-1] if len(node) else None
    if first is None or last is None or (node.tag == IF and len(node) < 2):
        raise SourceError([Problem(Mark(file), f"{node.tag} has {len(node)} children; it takes more")])
    if node.tag == LOOP:
        items = [item.split("=", 1) for item in node.get(OWN + "items", "").split("; ")]
        return {"for_each": {"items": dict(items), "child": _read(first, file)}}
    is_open = last.tag in (ELSE, NO_CASE)
    ways = [_read(child, file) for child in (node[:-1] if is_open else node) if child.tag != "ScriptCondition"]
    if node.tag == IF:
        when = first.get(OWN + "when", first.get("code", ""))
        return {"if": {"when": _value(when), **dict(zip(("then", "else"), ways, strict=False))}}
    labels = [node.get(f"case_{number}", "") for number in range(1, MOST_CASES + 1) if f"case_{number}" in node.attrib]
    by = _value(node.get(OWN + "value", node.get("variable", "")))
    rest = {} if is_open else {"otherwise": ways[-1]}
    return {"switch": {"value": by, "cases": dict(zip(labels, ways, strict=False)), **rest}}


def _arguments(attributes: Mapping[str, str]) -> dict[str, Any] | None:
    lists = attributes.get(OWN + "lists", "").split(";")
    made = {
        "as" if key == RESULT else key: value.strip("{}")
        if key == RESULT
        else value.split(";")
        if key in lists
        else _value(value)
        for key, value in attributes.items()
        if key not in ("ID", "name") and not key.startswith("_")
    }
    return made or None


def _value(text: str) -> str:
    return f"${text[1:-1]}" if text.startswith("{") and text.endswith("}") else text
