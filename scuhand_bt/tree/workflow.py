"""A workflow as it was read from its file: a small tree of dataclasses, with positions.

What a composite, a decorator or a choice is called is the grammar's (`tree.grammar`).
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TypeAlias

from scuhand_bt.problems import Mark
from scuhand_bt.tree.expressions import Expression, Reference
from scuhand_bt.tree.wires import WireType
from scuhand_bt.yaml_source import Node, Scalar

Value: TypeAlias = Reference | Expression
"""What has its value when the workflow runs."""
Argument: TypeAlias = Value | Node
"""What stands behind a parameter: such a value, or a literal."""


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
    """Of `for_each` by the names that the items are given."""
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


@dataclass(slots=True)
class Case:
    """One way of a choice, and the value for which it is gone; None for all others."""

    label: str
    value: Scalar | None
    child: "TreeNode"


@dataclass(slots=True)
class Choice:
    """`if` or `switch`: what one of its ways is chosen by, when it begins, and they."""

    mark: Mark
    kind: str
    argument: Argument
    cases: list[Case]

    @property
    def is_exhaustive(self) -> bool:
        """Whether there is a way for every value."""
        return any(case.value is None for case in self.cases)


TreeNode: TypeAlias = Branch | Decorator | Choice | Call


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
    result: Value | None
    tree: TreeNode
    is_whole: bool = True
    """False if its file is wrong, so that names may be missing that it is meant to have."""


def walk(node: TreeNode) -> Iterator[TreeNode]:
    """The node and all below it, in the order of the file."""
    yield node
    for child in children_of(node):
        yield from walk(child)


def children_of(node: TreeNode) -> list[TreeNode]:
    """The nodes right below one, a `while`'s guards before its child."""
    if isinstance(node, Branch):
        return node.children
    if isinstance(node, Decorator):
        return [*node.guards, node.child]
    return [case.child for case in node.cases] if isinstance(node, Choice) else []


def arguments_of(node: TreeNode) -> Iterator[Argument]:
    """What a node is given."""
    if isinstance(node, Choice):
        yield node.argument
    elif not isinstance(node, Branch):
        yield from node.arguments.values()


def references_of(argument: Argument | None) -> Iterator[Reference]:
    """The values that an argument reads."""
    if isinstance(argument, Reference):
        yield argument
    elif isinstance(argument, Expression):
        yield from argument.references
