"""Draws a workflow as SVG: one row for each node with its arguments, joined to its parent by a line."""

from collections.abc import Iterator
from html import escape

from scuhand_bt.tree.grammar import CHOICE_KEYS
from scuhand_bt.tree.workflow import Argument, Branch, Call, Choice, TreeNode, Workflow, children_of
from scuhand_bt.yaml_source import Node, Scalar, plain

ROW, INDENT, LEFT, CHARACTER = 26, 26, 20, 7.9
SIGNS = {"sequence": "→", "fallback": "?", "parallel": "⇉", "while": "↻", "retry": "↺", "repeat": "↻", "timeout": "⏱"}
SIGNS |= {"for_each": "↻", "if": "⋔", "switch": "⋔"}
STYLE = """
text { font: 13px ui-monospace, 'DejaVu Sans Mono', Menlo, Consolas, monospace; fill: #1f2328 }
.given { fill: #59636e } .kind { fill: #2f6fb2 } .line { fill: none; stroke: #818b98 } .paper { fill: #ffffff }
@media (prefers-color-scheme: dark) {
text { fill: #e6edf3 } .given { fill: #9aa4af } .kind { fill: #6cb0f5 }
.line { stroke: #6e7681 } .paper { fill: #0d1117 }
}
"""


def drawn(workflow: Workflow) -> str:
    """The picture of a workflow's own tree. A workflow that it calls is one node."""
    rows = list(_rows(workflow.tree, 0))
    width = max(LEFT * 2 + depth * INDENT + CHARACTER * len(f"{name} {given}") for depth, _, name, given in rows)
    height = ROW * (len(rows) + 2)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height}" role="img">',
        f"<title>{escape(workflow.name)}: {escape(workflow.summary)}</title><style>{STYLE}</style>",
        f'<rect class="paper" width="{width:.0f}" height="{height}"/>',
        f'<text x="{LEFT}" y="{ROW}">{escape(workflow.name)}</text>',
    ]
    above: dict[int, int] = {0: 1}
    for number, (depth, is_call, name, given) in enumerate(rows, 2):
        x, y = LEFT + INDENT * (depth + 1), ROW * number
        above[depth + 1] = number
        from_y = ROW * above[depth] + 6
        parts.append(f'<path class="line" d="M{x - INDENT + 6} {from_y} V{y - 4} H{x - 5}"/>')
        kind = "" if is_call else ' class="kind"'
        shown = f'<tspan{kind}>{escape(name)}</tspan> <tspan class="given">{escape(given)}</tspan>'
        parts.append(f'<text x="{x}" y="{y}">{shown}</text>')
    return "\n".join([*parts, "</svg>", ""])


def _rows(node: TreeNode, depth: int) -> Iterator[tuple[int, bool, str, str]]:
    """Depth, whether it is a call, name and arguments of each row."""
    if isinstance(node, Call):
        kept = f" → {node.result}" if node.result is not None else ""
        yield depth, True, node.name, _given(node.arguments) + kept
        return
    by = {CHOICE_KEYS[node.kind][0]: node.argument} if isinstance(node, Choice) else {}
    given = _given(by if isinstance(node, Branch | Choice) else node.arguments)
    if not isinstance(node, Choice) and node.codes:
        given = f"{given} on {', '.join(node.codes)}".strip()
    yield depth, False, f"{SIGNS.get(node.kind, '')} {node.kind}".strip(), given
    ways = [case.label for case in node.cases] if isinstance(node, Choice) else []
    for number, child in enumerate(children_of(node)):
        if ways:
            yield depth + 1, False, f"{ways[number]}:", ""
        yield from _rows(child, depth + 1 + bool(ways))


def _given(arguments: dict[str, Argument]) -> str:
    return ", ".join(f"{key}: {_shown(argument)}" for key, argument in arguments.items())


def _shown(argument: Argument) -> str:
    if not isinstance(argument, Node):
        return str(argument)
    return argument.text or "~" if isinstance(argument, Scalar) else str(plain(argument))
