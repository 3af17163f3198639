"""Workflows as BehaviorTree.CPP 4 writes them (XML, for Groot2 and its kin), and back.

A workflow becomes a `BehaviorTree`, and so does every workflow that it calls; skills are actions, conditions are
conditions, both with their ports in the `TreeNodesModel`. Quantities are texts with their units. What the format has
no word for stands in attributes that begin with `_scuhand_`, which BehaviorTree.CPP ignores: the codes of a retry, the
text of a duration.

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
"""

from collections.abc import Iterator, Mapping
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import yaml

from scuhand_bt.problems import Mark, Problem, SourceError
from scuhand_bt.quantity import DURATION, parse
from scuhand_bt.skill import Condition
from scuhand_bt.tree.check import Library
from scuhand_bt.tree.grammar import Argument, Branch, Call, Reference, TreeNode, Workflow, walk
from scuhand_bt.tree.wires import NOTHING, WireType, of_field
from scuhand_bt.yaml_source import Scalar, describe

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
WHILE = "ReactiveSequence"
TYPES = {"Integer": "int", "Number": "double", "Flag": "bool"}
"""Of ports; everything else is a text."""


def to_xml(library: Library, name: str) -> str:
    """A checked workflow and all that it calls, as one file."""
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
        _model_of_skill(model, skill, library)
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
        for child in node.children:
            _node(made, child, library)
    elif isinstance(node, Call):
        _call(parent, node, library)
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
            if key == "duration" and not isinstance(argument, Reference):
                made.set(OWN + "duration", _text(argument))
        if node.codes:
            made.set(OWN + "on", ";".join(node.codes))
        _node(made, node.child, library)


def _count(key: str, argument: Argument) -> str:
    if isinstance(argument, Reference) or key != "duration":
        return _text(argument)
    return str(round(1000 * parse(_text(argument), DURATION)))


def _call(parent: Element, node: Call, library: Library) -> None:
    is_skill = node.name in library.skills
    made = SubElement(parent, node.name) if is_skill else SubElement(parent, "SubTree", ID=node.name)
    parameters = library.parameters(node.name)
    for key, argument in node.arguments.items():
        made.set(key, _text(argument, None if is_skill else parameters[key].wire))
    if node.result is not None:
        made.set(RESULT, "{" + node.result + "}")


def _text(argument: Argument, wire: WireType | None = None) -> str:
    """A value as an attribute; a subtree takes a number that looks like an integer for one."""
    if isinstance(argument, Reference):
        return "{" + str(argument)[1:] + "}"
    text = argument.text if isinstance(argument, Scalar) else None
    if text is None:
        what = f"{describe(argument)} cannot stand in a file of BehaviorTree.CPP, which knows only texts"
        raise SourceError([Problem(argument.mark, what)])
    if wire is not None and wire.name == "Flag":
        return "true" if text in ("yes", "true", "on") else "false"
    if wire is not None and wire.name == "Number" and text and text.lstrip("+-").isdigit():
        return f"{text}.0"
    return text


def _model_of_skill(model: Element, name: str, library: Library) -> None:
    skill = library.skills[name]
    made = SubElement(model, "Condition" if issubclass(skill, Condition) else "Action", ID=name)
    fields = {info.alias or key: info for key, info in skill.model_fields.items()}
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
    """The workflows of such a file, each as the text of its YAML file; SourceError for what is none of ours."""
    if "<!" in text.replace("<!--", ""):
        raise SourceError([Problem(Mark(file), "has a document type or entities, which are not accepted")])
    try:
        root = ElementTree.fromstring(text.encode())
    except ElementTree.ParseError as error:
        line, column = error.position
        raise SourceError([Problem(Mark(file, line, column + 1), f"is no XML: {error}")]) from None
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
            inputs[name] = kind if default is None else {"type": kind, "default": default}
        elif port.tag == "output_port" and default:
            made["result"] = _value(default)
    return {"inputs": inputs, **made} if inputs else made


def _read(node: Element, file: str) -> dict[str, Any]:
    kinds = {tag: kind for kind, tag in BRANCHES.items()}
    decorators = {tag: (kind, port, key) for kind, (tag, port, key) in DECORATORS.items()}
    children = [_read(child, file) for child in node]
    if node.tag in kinds:
        return {kinds[node.tag]: children}
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


def _arguments(attributes: Mapping[str, str]) -> dict[str, str] | None:
    made = {
        "as" if key == RESULT else key: value.strip("{}") if key == RESULT else _value(value)
        for key, value in attributes.items()
        if key not in ("ID", "name") and not key.startswith("_")
    }
    return made or None


def _value(text: str) -> str:
    return f"${text[1:-1]}" if text.startswith("{") and text.endswith("}") else text
