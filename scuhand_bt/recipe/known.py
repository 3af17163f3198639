"""Which values of a workflow are known before the run, and the bounds of those that are not."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from scuhand_bt.problems import Mark
from scuhand_bt.tree.build import Scope
from scuhand_bt.tree.expressions import ANY_NUMBER, Range, Reference
from scuhand_bt.tree.grammar import PARAMETERS
from scuhand_bt.tree.library import Library, literal, resolve_percent
from scuhand_bt.tree.wires import WireType
from scuhand_bt.tree.workflow import Argument, Call, Decorator, Value, references_of
from scuhand_bt.yaml_source import Node

Ranges = dict[tuple[str, ...], Range]
"""Bounds of a value that only the run knows: its own under (), those of its attributes under their names' path."""


@dataclass(frozen=True)
class Names:
    """The names of a workflow: their values if known, their bounds if not, and where their values were written."""

    scope: Scope
    marks: Mapping[str, Mark]
    inputs: Mapping[str, str]
    """By name: the sample's input that it stands for."""
    ranges: dict[str, Ranges] = field(default_factory=dict)
    """By name: bounds of those that have no known value."""

    def range_of(self, reference: Reference) -> Range:
        """The bounds of one value."""
        if self.scope.has(reference.name):
            value = self.scope.read(reference)
            return (value, value) if isinstance(value, int | float) else ANY_NUMBER
        return self.ranges.get(reference.name, {}).get(reference.attributes, ANY_NUMBER)

    def ranges_of(self, value: Value) -> Ranges:
        """The bounds of a value and of all its attributes, as far as they are known."""
        if not isinstance(value, Reference):
            return {(): value.range(self.range_of)}
        if self.scope.has(value.name):
            return {(): self.range_of(value)}
        before = len(value.attributes)
        known_of = self.ranges.get(value.name, {}).items()
        return {keys[before:]: found for keys, found in known_of if keys[:before] == value.attributes}

    def keep(self, name: str, ranges: Ranges) -> None:
        """Store the bounds of a result. If another branch may also have set it, the bounds are joined."""
        had = self.ranges.get(name)
        self.ranges[name] = (
            ranges
            if had is None
            else {
                keys: (min(low, had[keys][0]), max(high, had[keys][1]))
                for keys, (low, high) in ranges.items()
                if keys in had
            }
        )

    def mark_in(self, node: Call, key: str) -> Mark:
        """Where the value of a call's argument was written; the call's own place if it has no such argument."""
        argument = node.arguments.get(key)
        if argument is None:
            return node.mark
        if isinstance(argument, Reference) and not argument.attributes:
            return self.marks.get(argument.name, argument.mark)
        return argument.mark

    def input_in(self, node: Call | Decorator, key: str) -> str | None:
        """The sample's input that is passed unchanged as this argument, if any."""
        argument = node.arguments.get(key)
        is_whole = isinstance(argument, Reference) and not argument.attributes
        return self.inputs.get(argument.name) if isinstance(argument, Reference) and is_whole else None

    def of_round(self, node: Decorator, within: Scope) -> "Names":
        """The names within a round of a `for_each`: an item stands for the same input as its list."""
        outer = {name: of for name, of in self.inputs.items() if name not in node.arguments}
        items = {name: of for name in node.arguments if (of := self.input_in(node, name)) is not None}
        return replace(self, scope=within, inputs=outer | items)


def known(
    arguments: Mapping[str, Argument], scope: Scope, library: Library, call: Call | None = None
) -> dict[str, Any]:
    """The arguments known before the run: literals, and values that depend only on the workflow's inputs.

    `call` is the call that they belong to; without one they are those of a decorator. Raises SkillFailed if a value
    cannot be computed.
    """
    wires = PARAMETERS if call is None else library.wires(call)
    values: dict[str, Any] = {}
    for key, argument in arguments.items():
        if isinstance(argument, Node):
            values[key] = literal(key, wires[key], argument, library)
        elif is_known(argument, scope):
            values[key] = scope.read(argument)
    return resolve_percent(values)


def is_known(argument: Argument, scope: Scope) -> bool:
    """Whether a value is known before the run."""
    return all(scope.has(reference.name) for reference in references_of(argument))


def refused(given: Mapping[str, Any], wires: Mapping[str, WireType]) -> dict[str, str]:
    """By name: why a skill does not accept a value that it is given."""
    refused: dict[str, str] = {}
    for key, value in given.items():
        try:
            if isinstance(value, int | float | str):
                wires[key].read(value)
        except ValueError as error:
            refused[key] = str(error)
    return refused
