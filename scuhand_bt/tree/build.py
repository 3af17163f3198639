"""Builds the py_trees tree of a job from a checked workflow and its inputs."""

from collections.abc import Collection, Mapping
from typing import Any

from py_trees.behaviour import Behaviour
from py_trees.common import ParallelPolicy
from py_trees.composites import Parallel, Selector, Sequence
from py_trees.decorators import FailureIsSuccess, Inverter

from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.skill import Condition
from scuhand_bt.tree.expressions import Reference
from scuhand_bt.tree.grammar import PARAMETERS, RECORD
from scuhand_bt.tree.guarded import Guard, While
from scuhand_bt.tree.leaf import Arguments, SkillLeaf, Ticking, Values
from scuhand_bt.tree.library import Library, Percent, literal, resolve_percent
from scuhand_bt.tree.nodes import (
    Chosen,
    Fallback,
    ForEach,
    Repeat,
    Retry,
    Timeout,
    WorkflowCall,
)
from scuhand_bt.tree.record import Round, recorded
from scuhand_bt.tree.wires import WireType, read_attribute
from scuhand_bt.tree.workflow import Argument, Branch, Call, Choice, Decorator, TreeNode, Value, Workflow
from scuhand_bt.yaml_source import Node


class Scope:
    """The named values of one call of a workflow; within a `for_each` also the items of the current round.

    `rounds` are those of all loops around it, including loops around the workflow's call.
    """

    def __init__(self, values: Values, outer: "Scope | None" = None, rounds: tuple[Round, ...] = ()) -> None:
        self.values = values
        self.rounds = rounds
        self._outer = outer

    def read(self, value: Value) -> Any:
        """The current value of a reference or expression. Raises SkillFailed workflow.bad_value if it has none."""
        if not isinstance(value, Reference):
            try:
                return value.value(self.read)
            except ValueError as error:
                raise SkillFailed(Code.WORKFLOW_BAD_VALUE, f"'{value}' cannot be calculated: {error}") from None
        found = self._named(value.name)
        for attribute in value.attributes:
            found = read_attribute(found, attribute)
        return found

    def keep(self, name: str, value: Any) -> None:
        """Store a result. It belongs to the workflow, even if it is set within a loop."""
        if self._outer is not None:
            self._outer.keep(name, value)
        else:
            self.values[name] = value

    def has(self, name: str) -> bool:
        """Whether this name has a value yet."""
        return name in self.values or (self._outer is not None and self._outer.has(name))

    def _named(self, name: str) -> Any:
        return self.values[name] if name in self.values or self._outer is None else self._outer._named(name)


class Tree:
    """A job's tree: its root, and the workflow's result once the root has succeeded."""

    def __init__(self, workflow: Workflow, inputs: Mapping[str, Any], library: Library, shared: Ticking) -> None:
        self.workflow, self.library = workflow, library
        builder = _Builder(library, shared)
        self.scopes = builder.scopes
        """The values of the workflow and of every workflow that it calls, in the order of the tree."""
        self.scopes.append(Scope(bound_inputs(workflow, inputs, library)))
        self.root = builder.build(workflow.tree, self.scopes[0], workflow.name)

    def result(self) -> Any:
        reference = self.workflow.result
        return None if reference is None else self.scopes[0].read(reference)


def bound_inputs(
    workflow: Workflow, given: Mapping[str, Any], library: Library, unknown: Collection[str] = ()
) -> Values:
    """A workflow's inputs: what is given, else the default. Those in `unknown` get no default."""
    values = dict(given)
    for declared in workflow.inputs.values():
        if declared.name not in (*values, *unknown) and declared.default is not None:
            values[declared.name] = literal(declared.name, declared.type, declared.default, library)
    return resolve_percent(values)


def chosen_case(node: Choice, scope: Scope, library: Library) -> int | None:
    """The index of the branch that an `if` or `switch` takes; None if an `if` takes none.

    Raises SkillFailed workflow.bad_value if a `switch` has no case for the value.
    """
    by, wire = node.argument, PARAMETERS["when"] if node.kind == "if" else library.chosen_by[node.mark]
    value = literal("when", wire, by, library) if isinstance(by, Node) else scope.read(by)
    for number, case in enumerate(node.cases):
        if case.value is None or literal("cases", wire, case.value, library) == value:
            return number
    if node.kind == "switch":
        raise SkillFailed(Code.WORKFLOW_BAD_VALUE, f"there is no case for {by}, '{value}'")
    return None


class _Builder:
    def __init__(self, library: Library, shared: Ticking) -> None:
        self.scopes: list[Scope] = []
        self._library = library
        self._shared = shared

    def build(self, node: TreeNode, scope: Scope, path: str) -> Behaviour:
        if isinstance(node, Call):
            return self._build_call(node, scope, path)
        if isinstance(node, Decorator):
            return self._build_decorator(node, scope, f"{path}/{node.kind}")
        if isinstance(node, Choice):
            return self._build_choice(node, scope, f"{path}/{node.kind}")
        return self._build_branch(node, scope, f"{path}/{node.kind}")

    def _build_branch(self, node: Branch, scope: Scope, path: str) -> Behaviour:
        children = [self.build(child, scope, f"{path}.{i}") for i, child in enumerate(node.children)]
        if node.kind == "sequence":
            return Sequence("sequence", memory=True, children=children)
        if node.kind == "fallback":
            return Fallback(children, frozenset(node.codes)) if node.codes else Selector("fallback", True, children)
        return Parallel("parallel", ParallelPolicy.SuccessOnAll(synchronise=True), children)

    def _build_decorator(self, node: Decorator, scope: Scope, path: str) -> Behaviour:
        if node.kind in ("for_each", "repeat"):
            return self._build_loop(node, scope, path)
        child = self.build(node.child, scope, path)
        arguments = self._arguments(node.arguments, PARAMETERS, scope)
        if node.kind == "retry":
            return Retry(path, child, arguments, frozenset(node.codes), self._shared)
        if node.kind == "timeout":
            return Timeout(path, child, arguments, self._shared)
        if node.kind == "while":
            guards = [self._build_guard(guard, scope) for guard in node.guards]
            return While(path, guards, child, self._shared)
        if node.kind == "invert":
            return Inverter("invert", child)
        return FailureIsSuccess("optional", child)

    def _build_loop(self, node: Decorator, scope: Scope, path: str) -> Behaviour:
        around, arguments = Round(), self._arguments(node.arguments, PARAMETERS, scope)
        within = Scope({}, scope, (*scope.rounds, around))
        child = self.build(node.child, within, path)
        if node.kind == "for_each":
            return ForEach(path, child, arguments, around, within.values, self._shared)
        return Repeat(path, child, arguments, around, self._shared)

    def _build_choice(self, node: Choice, scope: Scope, path: str) -> Behaviour:
        children = [self.build(case.child, scope, f"{path}.{case.label}") for case in node.cases]
        return Chosen(node.kind, children, lambda: chosen_case(node, scope, self._library))

    def _build_guard(self, node: Call, scope: Scope) -> Guard:
        condition = self._library.skills[node.name]
        assert issubclass(condition, Condition)
        return Guard(node.name, condition, self._call_arguments(node, scope), self._shared)

    def _build_call(self, node: Call, scope: Scope, path: str) -> Behaviour:
        path = f"{path}/{node.name}"
        arguments = self._call_arguments(node, scope)

        def keep(value: Any) -> None:
            if node.result is not None:
                scope.keep(node.result, value)

        if node.name in self._library.skills:
            return SkillLeaf(node.name, path, self._library.skills[node.name], arguments, keep, self._shared)
        workflow = self._library.workflows[node.name]
        inner = Scope({}, rounds=scope.rounds)
        self.scopes.append(inner)

        def bind() -> None:
            inner.values = bound_inputs(workflow, arguments(), self._library)

        def keep_result() -> None:
            if workflow.result is not None:
                keep(inner.read(workflow.result))

        return WorkflowCall(node.name, self.build(workflow.tree, inner, path), bind, keep_result)

    def _call_arguments(self, node: Call, scope: Scope) -> Arguments:
        wires = self._library.wires(node)
        arguments = self._arguments(node.arguments, wires, scope)
        return (lambda: recorded(arguments(), wires, scope.rounds)) if node.name == RECORD else arguments

    def _arguments(self, arguments: Mapping[str, Argument], wires: Mapping[str, WireType], scope: Scope) -> Arguments:
        fixed = {
            name: literal(name, wires[name], argument, self._library)
            for name, argument in arguments.items()
            if isinstance(argument, Node)
        }
        worked_out = {name: argument for name, argument in arguments.items() if not isinstance(argument, Node)}

        def evaluate() -> Values:
            values = {**fixed, **{name: scope.read(value) for name, value in worked_out.items()}}
            return resolve_percent(values) if any(isinstance(value, Percent) for value in fixed.values()) else values

        return evaluate
