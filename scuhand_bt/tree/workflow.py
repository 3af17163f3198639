"""A workflow as read from its file: a tree of dataclasses with positions. The names of kinds are in `tree.grammar`."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TypeAlias

from scuhand_bt.problems import Mark
from scuhand_bt.tree.expressions import Expression, Reference
from scuhand_bt.tree.wires import WireType
from scuhand_bt.yaml_source import Node, Scalar

Value: TypeAlias = Reference | Expression
"""A reference or expression, evaluated when the workflow runs."""
Argument: TypeAlias = Value | Node
"""What a parameter is given: a value, or a literal."""


@dataclass(slots=True)
class Branch:
    """A composite: sequence, fallback or parallel."""

    mark: Mark
    kind: str
    children: list["TreeNode"]
    codes: dict[str, Mark] = field(default_factory=dict)
    """`on` of a fallback: the failure codes after which it goes on."""


@dataclass(slots=True)
class Decorator:
    """A node with one child: while, retry, timeout, repeat, for_each, invert, optional."""

    mark: Mark
    kind: str
    child: "TreeNode"
    arguments: dict[str, Argument] = field(default_factory=dict)
    """For `for_each`: the lists, by the names of their items."""
    codes: dict[str, Mark] = field(default_factory=dict)
    """`on` of a retry: the failure codes that it retries."""
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


@dataclass(slots=True)
class Case:
    """One branch of a choice, and the value that selects it; None for all other values."""

    label: str
    value: Scalar | None
    child: "TreeNode"


@dataclass(slots=True)
class Choice:
    """`if` or `switch`: `argument` selects one of the cases when the node begins."""

    mark: Mark
    kind: str
    argument: Argument
    cases: list[Case]

    @property
    def is_exhaustive(self) -> bool:
        """Whether there is a branch for every value."""
        return any(case.value is None for case in self.cases)


TreeNode: TypeAlias = Branch | Decorator | Choice | Call


@dataclass(slots=True)
class Input:
    """A declared input of a workflow; `default` is a literal, or None if the input is required."""

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
    result: Value | None
    tree: TreeNode
    is_whole: bool = True
    """False if its file has mistakes, so that names may be missing."""


def walk(node: TreeNode) -> Iterator[TreeNode]:
    """The node and all nodes below it, depth-first in the order of the file."""
    yield node
    for child in children_of(node):
        yield from walk(child)


def children_of(node: TreeNode) -> list[TreeNode]:
    """The direct children of a node; a `while`'s guards come before its child."""
    if isinstance(node, Branch):
        return node.children
    if isinstance(node, Decorator):
        return [*node.guards, node.child]
    return [case.child for case in node.cases] if isinstance(node, Choice) else []


def arguments_of(node: TreeNode) -> Iterator[Argument]:
    """The arguments of a node."""
    if isinstance(node, Choice):
        yield node.argument
    elif not isinstance(node, Branch):
        yield from node.arguments.values()


def references_of(argument: Argument | None) -> Iterator[Reference]:
    """The references that an argument reads."""
    if isinstance(argument, Reference):
        yield argument
    elif isinstance(argument, Expression):
        yield from argument.references
