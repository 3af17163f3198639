"""The grammar of a workflow file: from YAML nodes to a tree of dataclasses with positions (docs/workflows.md).

Every node has one key: a composite (`sequence`, `fallback`, `parallel`), a decorator (`while`, `retry`, `timeout`,
`repeat`, `for_each`, `invert`, `optional`), a choice (`if`, `switch`), or a call of a skill or workflow.
"""

import re

from scuhand_bt.problems import Mark, Problems, nearest, shorten
from scuhand_bt.tree.expressions import Reference, parse_expression
from scuhand_bt.tree.wires import INPUT_TYPES, list_of
from scuhand_bt.tree.workflow import Argument, Branch, Call, Case, Choice, Decorator, Input, TreeNode, Workflow
from scuhand_bt.yaml_source import Entries, Items, Node, Scalar, describe

COMPOSITES = ("sequence", "fallback", "parallel")
DECORATOR_KEYS: dict[str, tuple[str, ...]] = {
    "while": ("guards", "child"),
    "retry": ("attempts", "on", "child"),
    "timeout": ("duration", "child"),
    "repeat": ("times", "child"),
    "for_each": ("items", "child"),
    "invert": ("child",),
    "optional": ("child",),
}
CHOICE_KEYS: dict[str, tuple[str, ...]] = {"if": ("when", "then", "else"), "switch": ("value", "cases", "otherwise")}
PARAMETERS = {
    "attempts": INPUT_TYPES["Integer"],
    "duration": INPUT_TYPES["Duration"],
    "times": INPUT_TYPES["Integer"],
    "when": INPUT_TYPES["Flag"],
}
"""The parameters of built-in nodes and their types. Like a call's, each is a literal, a `$name` or an expression."""
RECORD = "record"
"""The skill that takes any parameters, and writes them into the sample's row."""
KEYWORDS = (*COMPOSITES, *DECORATOR_KEYS, *CHOICE_KEYS)

QUANTITY_INPUTS = {"mass": "Mass", "tolerance": "Mass"}
"""Inputs whose names have a fixed meaning and type, as recipes and plans use them."""
RECIPE_WORDS = ("id", "workflow", "repeat", "table", "compose")
"""Keys of a sample that are not inputs of its workflow."""

_READS_A_VALUE = re.compile(r"\$[A-Za-z_]")
_NAME = re.compile(r"[A-Za-z_]\w*")


def read_workflow(root: Node, stem: str, problems: Problems) -> Workflow | None:
    """Read a workflow file. Problems are reported; returns None if it has no usable tree."""
    before = len(problems.found)
    if not isinstance(root, Entries):
        problems.add(
            root.mark,
            f"expected a workflow, found {describe(root)}",
            "a workflow is a mapping with the key 'workflow'",
            code="wrong-shape",
        )
        return None
    known = ("workflow", "summary", "inputs", "result", "tree")
    _only_keys(root, known, problems)
    name = _text(root, "workflow", problems, required=True)
    if name and name != stem:
        problems.add(
            root.values["workflow"].mark,
            f"the workflow '{name}' is in {stem}.yaml",
            f"call it '{stem}'",
            code="name-mismatch",
        )
    inputs = _read_inputs(root.get("inputs"), problems)
    result = None
    if (node := root.get("result")) is not None:
        argument = _argument(node, problems)
        if not isinstance(argument, Node):
            result = argument
        else:
            problems.add(
                node.mark,
                f"'result' must be a value of this workflow, not {describe(node)}",
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
            node.mark, f"'inputs' must be a mapping, not {describe(node)}", "write {name: Type, …}", code="wrong-shape"
        )
        return inputs
    for name, declared in node.values.items():
        mark = node.keys[name]
        if not _NAME.fullmatch(name):
            problems.add(
                mark,
                f"'{shorten(name)}' is not a valid name",
                "letters, digits and _, not beginning with a digit",
                code="bad-name",
            )
            continue
        if name == "as" or name in RECIPE_WORDS:
            problems.add(
                mark,
                f"'{name}' cannot be an input",
                "this name has a special meaning where a workflow is called",
                code="bad-name",
            )
            continue
        type_node, default = declared, None
        if isinstance(declared, Entries):
            _only_keys(declared, ("type", "default"), problems)
            default = declared.get("default")
            type_node = declared.get("type") or Scalar(declared.mark, None)
        is_list = isinstance(type_node, Items) and len(type_node.items) == 1
        named = type_node.items[0] if isinstance(type_node, Items) and is_list else type_node
        type_name = named.text if isinstance(named, Scalar) else None
        wire = INPUT_TYPES.get(type_name or "")
        if wire is None:
            problems.add(
                type_node.mark,
                f"{describe(named)} is not a type",
                unknown=type_name or "",
                known=INPUT_TYPES,
                code="unknown-type",
            )
            continue
        if is_list:
            wire = list_of(wire)
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
            f"{describe(node)} is not a node",
            f"write '{shorten(node.text)}:' (with the colon)",
            code="bad-node",
        )
        return None
    if not isinstance(node, Entries) or len(node.values) != 1:
        extra = f"; here are {len(node.values)} keys" if isinstance(node, Entries) else ""
        problems.add(
            node.mark,
            f"expected a node of the tree, found {describe(node)}",
            f"a node has one key{extra}",
            code="wrong-shape",
        )
        return None
    ((key, body),) = node.values.items()
    mark = node.keys[key]
    if key == "fallback" and isinstance(body, Entries):
        return _read_fallback(mark, body, problems)
    if key in COMPOSITES:
        return Branch(mark, key, _read_children(body, key, problems))
    if key in CHOICE_KEYS:
        return _read_choice(mark, key, body, problems)
    if key in DECORATOR_KEYS:
        return _read_decorator(mark, key, body, problems)
    return _read_call(mark, key, body, problems)


def _read_fallback(mark: Mark, body: Entries, problems: Problems) -> TreeNode | None:
    """Read a fallback that goes on only after some failures."""
    _only_keys(body, ("on", "children"), problems)
    if (children := body.get("children")) is None:
        problems.add(mark, "'fallback' needs 'children'", "a list of nodes", code="missing-key")
        return None
    return Branch(
        mark, "fallback", _read_children(children, "fallback", problems), _read_codes(body.get("on"), problems)
    )


def _read_choice(mark: Mark, kind: str, body: Node, problems: Problems) -> TreeNode | None:
    known = CHOICE_KEYS[kind]
    if not isinstance(body, Entries):
        what = f"'{kind}' has {describe(body)}"
        problems.add(body.mark, what, f"it takes the keys {', '.join(known)}", code="bad-node")
        return None
    _only_keys(body, known, problems)
    for key in known[:2]:
        if key not in body.values:
            problems.add(mark, f"'{kind}' needs '{key}'", code="missing-key")
    cases: list[Case] = []
    ways: list[tuple[str, Scalar | None, Node]] = []
    listed, rest = body.get(known[1]), body.get(known[2])
    if kind == "if" and listed is not None:
        ways.append(("then", Scalar(listed.mark, "yes"), listed))
    elif isinstance(listed, Entries) and listed.values:
        ways += [(key, Scalar(listed.keys[key], key), way) for key, way in listed.values.items()]
    elif listed is not None:
        what = f"'cases' has {describe(listed)}"
        problems.add(listed.mark, what, "write what is done for which value: {value: node, …}", code="bad-node")
    if rest is not None:
        ways.append((known[2], None, rest))
    for label, value, way in ways:
        if (child := _read_node(way, problems)) is not None:
            cases.append(Case(label, value, child))
    by = body.get(known[0])
    return Choice(mark, kind, _argument(by, problems), cases) if by is not None and cases else None


def _read_items(mark: Mark, node: Node | None, problems: Problems) -> dict[str, Argument]:
    """The lists of a `for_each`, by the names of their items."""
    if not isinstance(node, Entries) or not node.values:
        what = "'for_each' needs 'items'" if node is None else f"'items' has {describe(node)}"
        allowed = "write each list, with a name for its items: {holder: $holders}"
        problems.add(node.mark if node else mark, what, allowed, code="bad-node" if node else "missing-key")
        return {}
    found: dict[str, Argument] = {}
    for name, listed in node.values.items():
        if _NAME.fullmatch(name):
            found[name] = _argument(listed, problems)
        else:
            what = f"'{shorten(name)}' is not a valid name"
            problems.add(node.keys[name], what, "write a name for the item, without $", code="bad-name")
    return found


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
    arguments = _read_items(mark, body.get("items"), problems) if kind == "for_each" else {}
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
            problems.add(item.mark, f"{describe(item)} is not a failure code", allowed, code="unknown-code")
    return codes


def _read_call(mark: Mark, name: str, body: Node, problems: Problems) -> Call | None:
    if isinstance(body, Scalar) and body.text is None:
        return Call(mark, name, {}, {}, None, mark)
    if isinstance(body, Items) and nearest(name, KEYWORDS) is not None:
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
                f"'as' must be a name, not {describe(as_node)}",
                "write a name for the result, without $",
                code="bad-name",
            )
    rest = body.without("as")
    arguments = {key: _argument(value, problems) for key, value in rest.values.items()}
    return Call(mark, name, arguments, rest.keys, result, result_mark)


def _argument(node: Node, problems: Problems) -> Argument:
    """A literal, or the reference or expression in its place.

    A text that reads a value (`$…`) but is no expression is an error if it begins with `$`, else a literal.
    """
    text = node.text if isinstance(node, Scalar) else None
    if text is None or (not _READS_A_VALUE.search(text) and not text.startswith("$")):
        return node
    try:
        return parse_expression(text, node.mark)
    except ValueError as error:
        if not text.startswith("$"):
            return node
        problems.add(node.mark, no_expression(node, error), EXPRESSIONS, code="bad-expression")
        return Reference(node.mark, "", ())


EXPRESSIONS = "write $name, $name.attribute, or a calculation with them: 0.25 * $dose.dispensed"


def no_expression(node: Node, error: ValueError) -> str:
    """Why a text is no valid expression."""
    return f"{describe(node)} cannot be calculated: {error}"


def why_no_expression(node: Node) -> str | None:
    """Why a literal that contains `$name` is no valid expression; None if it is one, or contains none."""
    if not isinstance(node, Scalar) or not _READS_A_VALUE.search(node.text or ""):
        return None
    try:
        parse_expression(node.text or "", node.mark)
    except ValueError as error:
        return no_expression(node, error)
    return None


def _only_keys(node: Entries, known: tuple[str, ...], problems: Problems) -> None:
    for key, mark in node.keys.items():
        if key not in known:
            problems.add(mark, f"unknown key '{shorten(key)}'", unknown=key, known=known, code="unknown-key")


def _text(node: Entries, key: str, problems: Problems, required: bool = False) -> str | None:
    value = node.get(key)
    if isinstance(value, Scalar) and value.text is not None:
        return value.text
    if value is not None:
        problems.add(value.mark, f"'{key}' must be a text, not {describe(value)}", code="wrong-shape")
    elif required:
        problems.add(node.mark, f"'{key}' is missing", code="missing-key")
    return None
