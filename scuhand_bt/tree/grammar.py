"""The grammar of a workflow file: from YAML nodes to a small tree of dataclasses, with positions.

Every node of a tree is one key: a composite (`sequence`, `fallback`, `parallel`, `while`), a decorator
(`retry`, `timeout`, `repeat`, `invert`, `optional`), or a call of a skill or of another workflow.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TypeAlias

from scuhand_bt.problems import Mark, Problems, nearest, shorten
from scuhand_bt.tree.wires import INPUT_TYPES, WireType
from scuhand_bt.yaml_source import Entries, Items, Node, Scalar, describe

COMPOSITES = ("sequence", "fallback", "parallel")
DECORATOR_KEYS: dict[str, tuple[str, ...]] = {
    "while": ("guards", "child"),
    "retry": ("attempts", "on", "child"),
    "timeout": ("duration", "child"),
    "repeat": ("times", "child"),
    "invert": ("child",),
    "optional": ("child",),
}
PARAMETERS = {"attempts": INPUT_TYPES["Integer"], "duration": INPUT_TYPES["Duration"], "times": INPUT_TYPES["Integer"]}
"""The decorators' own parameters and their types; like a call's, each is a literal or a `$name`."""
KEYWORDS = (*COMPOSITES, *DECORATOR_KEYS)

QUANTITY_INPUTS = {"mass": "Mass", "tolerance": "Mass"}
"""Inputs whose name says what they are: recipes and plans reckon with them."""
RECIPE_WORDS = ("id", "workflow", "repeat", "table")
"""Keys of a sample that are not its workflow's inputs."""

_REFERENCE = re.compile(r"\$([A-Za-z_]\w*)((?:\.[A-Za-z_]\w*)*)")
_NAME = re.compile(r"[A-Za-z_]\w*")


@dataclass(frozen=True, slots=True)
class Reference:
    """`$name.attribute.attribute`."""

    mark: Mark
    name: str
    attributes: tuple[str, ...]

    def __str__(self) -> str:
        return "$" + ".".join((self.name, *self.attributes))


Argument: TypeAlias = Reference | Node
"""What stands behind a parameter: a reference, or a literal."""


@dataclass(slots=True)
class Branch:
    """A composite: sequence, fallback or parallel."""

    mark: Mark
    kind: str
    children: list["TreeNode"]


@dataclass(slots=True)
class Decorator:
    """A node with one child: while, retry, timeout, repeat, invert, optional."""

    mark: Mark
    kind: str
    child: "TreeNode"
    arguments: dict[str, Argument] = field(default_factory=dict)
    codes: dict[str, Mark] = field(default_factory=dict)
    """`on` of a retry: the failure codes it retries."""
    guards: list["Call"] = field(default_factory=list)


@dataclass(slots=True)
class Call:
    """A skill or a workflow, called by name."""

    mark: Mark
    name: str
    arguments: dict[str, Argument]
    argument_marks: dict[str, Mark]
    result: str | None
    result_mark: Mark


TreeNode: TypeAlias = Branch | Decorator | Call


@dataclass(slots=True)
class Input:
    """A declared input of a workflow; `default` is a literal, or None where it must be given."""

    mark: Mark
    name: str
    type: WireType
    default: Node | None


@dataclass(slots=True)
class Workflow:
    """One file of `trees/`."""

    mark: Mark
    name: str
    summary: str
    inputs: dict[str, Input]
    result: Reference | None
    tree: TreeNode
    is_whole: bool = True
    """False if its file is wrong, so that names may be missing that it is meant to have."""


def walk(node: TreeNode) -> Iterator[TreeNode]:
    """The node and all below it, in the order of the file."""
    yield node
    children: list[TreeNode] = []
    if isinstance(node, Branch):
        children = node.children
    elif isinstance(node, Decorator):
        children = [*node.guards, node.child]
    for child in children:
        yield from walk(child)


def read_workflow(root: Node, stem: str, problems: Problems) -> Workflow | None:
    """Read a workflow file; problems are collected, and None returned if it has no usable tree."""
    before = len(problems.found)
    if not isinstance(root, Entries):
        problems.add(
            root.mark,
            f"{describe(root)} stands where a workflow should be",
            "it has the key 'workflow'",
            code="wrong-shape",
        )
        return None
    known = ("workflow", "summary", "inputs", "result", "tree")
    _only_keys(root, known, problems)
    name = _text(root, "workflow", problems, required=True)
    if name and name != stem:
        problems.add(
            root.values["workflow"].mark,
            f"the workflow '{name}' stands in {stem}.yaml",
            f"call it '{stem}'",
            code="name-mismatch",
        )
    inputs = _read_inputs(root.get("inputs"), problems)
    result = None
    if (node := root.get("result")) is not None:
        argument = _argument(node, problems)
        if isinstance(argument, Reference):
            result = argument
        else:
            problems.add(
                node.mark,
                f"'result': {describe(node)} is no value of this workflow",
                "write $name",
                code="bad-reference",
            )
    tree_node = root.get("tree")
    if tree_node is None:
        problems.add(root.mark, "'tree' is missing", f"a workflow has the keys {', '.join(known)}", code="missing-key")
        return None
    tree = _read_node(tree_node, problems)
    if tree is None:
        return None
    summary = _text(root, "summary", problems) or ""
    return Workflow(root.mark, stem, summary, inputs, result, tree, len(problems.found) == before)


def _read_inputs(node: Node | None, problems: Problems) -> dict[str, Input]:
    inputs: dict[str, Input] = {}
    if node is None or (isinstance(node, Scalar) and node.text is None):
        return inputs
    if not isinstance(node, Entries):
        problems.add(
            node.mark, f"'inputs': {describe(node)} is no mapping", "write {name: Type, …}", code="wrong-shape"
        )
        return inputs
    for name, declared in node.values.items():
        mark = node.keys[name]
        if not _NAME.fullmatch(name):
            problems.add(
                mark,
                f"'{shorten(name)}' is no name",
                "letters, digits and _, not beginning with a digit",
                code="bad-name",
            )
            continue
        if name == "as" or name in RECIPE_WORDS:
            problems.add(
                mark,
                f"'{name}' cannot be an input",
                "it has a meaning of its own where a workflow is used",
                code="bad-name",
            )
            continue
        type_node, default = declared, None
        if isinstance(declared, Entries):
            _only_keys(declared, ("type", "default"), problems)
            default = declared.get("default")
            type_node = declared.get("type") or Scalar(declared.mark, None)
        type_name = type_node.text if isinstance(type_node, Scalar) else None
        wire = INPUT_TYPES.get(type_name or "")
        if wire is None:
            problems.add(
                type_node.mark,
                f"{describe(type_node)} is no type",
                unknown=type_name or "",
                known=INPUT_TYPES,
                code="unknown-type",
            )
            continue
        if name in QUANTITY_INPUTS and wire.name != QUANTITY_INPUTS[name]:
            problems.add(
                type_node.mark, f"'{name}' must be a {QUANTITY_INPUTS[name]}, not a {wire.name}", code="input-type"
            )
            continue
        inputs[name] = Input(mark, name, wire, default)
    return inputs


def _read_node(node: Node, problems: Problems) -> TreeNode | None:
    if isinstance(node, Scalar) and node.text is not None:
        problems.add(
            node.mark,
            f"{describe(node)} is no node",
            f"write '{shorten(node.text)}:' (with the colon)",
            code="bad-node",
        )
        return None
    if not isinstance(node, Entries) or len(node.values) != 1:
        extra = f"; here are {len(node.values)} keys" if isinstance(node, Entries) else ""
        problems.add(
            node.mark,
            f"{describe(node)} stands where a tree's node should be",
            f"a node is one key{extra}",
            code="wrong-shape",
        )
        return None
    ((key, body),) = node.values.items()
    mark = node.keys[key]
    if key in COMPOSITES:
        return Branch(mark, key, _read_children(body, key, problems))
    if key in DECORATOR_KEYS:
        return _read_decorator(mark, key, body, problems)
    return _read_call(mark, key, body, problems)


def _read_children(node: Node, kind: str, problems: Problems) -> list[TreeNode]:
    if not isinstance(node, Items) or not node.items:
        problems.add(
            node.mark, f"'{kind}' has {describe(node)}", "it takes a list of at least one node ('- …')", code="bad-node"
        )
        return []
    return [child for item in node.items if (child := _read_node(item, problems)) is not None]


def _read_decorator(mark: Mark, kind: str, body: Node, problems: Problems) -> Decorator | None:
    known = DECORATOR_KEYS[kind]
    if known == ("child",) and not (isinstance(body, Entries) and "child" in body.values):
        child = _read_node(body, problems)
        return Decorator(mark, kind, child) if child is not None else None
    if not isinstance(body, Entries):
        problems.add(
            body.mark, f"'{kind}' has {describe(body)}", f"it takes the keys {', '.join(known)}", code="bad-node"
        )
        return None
    _only_keys(body, known, problems)
    arguments: dict[str, Argument] = {}
    for key in known:
        if key in PARAMETERS:
            if (value := body.get(key)) is None:
                problems.add(mark, f"'{kind}' needs '{key}'", code="missing-key")
            else:
                arguments[key] = _argument(value, problems)
    codes = _read_codes(body.get("on"), problems)
    guards: list[Call] = []
    if kind == "while":
        if (listed := body.get("guards")) is None:
            problems.add(mark, "'while' needs 'guards'", "a list of conditions", code="missing-key")
        else:
            for guard in _read_children(listed, "guards", problems):
                if isinstance(guard, Call):
                    guards.append(guard)
                else:
                    problems.add(
                        guard.mark, f"'{guard.kind}' cannot be a guard", "a guard is a condition", code="no-condition"
                    )
    if (child_node := body.get("child")) is None:
        problems.add(mark, f"'{kind}' needs 'child'", "one node", code="missing-key")
        return None
    child = _read_node(child_node, problems)
    return Decorator(mark, kind, child, arguments, codes, guards) if child is not None else None


def _read_codes(node: Node | None, problems: Problems) -> dict[str, Mark]:
    if node is None:
        return {}
    items = node.items if isinstance(node, Items) and node.items else [node]
    codes: dict[str, Mark] = {}
    for item in items:
        if isinstance(item, Scalar) and item.text:
            codes[item.text] = item.mark
        else:
            allowed = "such as [hand.cone_empty]; without 'on', every failure is retried"
            problems.add(item.mark, f"{describe(item)} is no failure code", allowed, code="unknown-code")
    return codes


def _read_call(mark: Mark, name: str, body: Node, problems: Problems) -> Call | None:
    if isinstance(body, Scalar) and body.text is None:
        return Call(mark, name, {}, {}, None, mark)
    if not isinstance(body, Entries) and nearest(name, KEYWORDS) is not None:
        what = f"unknown node '{shorten(name)}'"
        problems.add(mark, what, unknown=name, known=KEYWORDS, code="unknown-name")
        return None
    if not isinstance(body, Entries):
        problems.add(
            body.mark,
            f"'{shorten(name)}' has {describe(body)}",
            "write its parameters: {name: value, …}",
            code="bad-node",
        )
        return None
    result, result_mark = None, mark
    if (as_node := body.get("as")) is not None:
        result_mark = as_node.mark
        if isinstance(as_node, Scalar) and as_node.text and _NAME.fullmatch(as_node.text):
            result = as_node.text
        else:
            problems.add(
                as_node.mark,
                f"'as': {describe(as_node)} is no name",
                "a name for the result, without $",
                code="bad-name",
            )
    rest = body.without("as")
    arguments = {key: _argument(value, problems) for key, value in rest.values.items()}
    return Call(mark, name, arguments, rest.keys, result, result_mark)


def _argument(node: Node, problems: Problems) -> Argument:
    if not isinstance(node, Scalar) or node.text is None or not node.text.startswith("$"):
        return node
    match = _REFERENCE.fullmatch(node.text)
    if match is None:
        problems.add(
            node.mark, f"{describe(node)} is no reference", "write $name or $name.attribute", code="bad-reference"
        )
        return Reference(node.mark, "", ())
    return Reference(node.mark, match[1], tuple(match[2].split(".")[1:]))


def _only_keys(node: Entries, known: tuple[str, ...], problems: Problems) -> None:
    for key, mark in node.keys.items():
        if key not in known:
            problems.add(mark, f"unknown key '{shorten(key)}'", unknown=key, known=known, code="unknown-key")


def _text(node: Entries, key: str, problems: Problems, required: bool = False) -> str | None:
    value = node.get(key)
    if isinstance(value, Scalar) and value.text is not None:
        return value.text
    if value is not None:
        problems.add(value.mark, f"'{key}': {describe(value)} is no text", code="wrong-shape")
    elif required:
        problems.add(node.mark, f"'{key}' is missing", code="missing-key")
    return None
