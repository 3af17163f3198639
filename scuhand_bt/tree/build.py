"""From a checked workflow and its inputs to one small tree of py_trees nodes."""

from collections.abc import Collection, Mapping
from typing import Any

from py_trees.behaviour import Behaviour
from py_trees.common import ParallelPolicy
from py_trees.composites import Parallel, Selector, Sequence
from py_trees.decorators import FailureIsSuccess, Inverter

from scuhand_bt.skill import Condition
from scuhand_bt.tree.check import Library, Percent, literal, resolve_percent
from scuhand_bt.tree.grammar import PARAMETERS, Argument, Branch, Call, Decorator, Reference, TreeNode, Workflow
from scuhand_bt.tree.leaf import Arguments, SkillLeaf, Ticking, Values
from scuhand_bt.tree.nodes import Guard, Repeat, Retry, Timeout, While, WorkflowCall
from scuhand_bt.tree.wires import WireType, read_attribute


class Scope:
    """The named values of one call of a workflow."""

    def __init__(self, values: Values) -> None:
        self.values = values

    def read(self, reference: Reference) -> Any:
        value = self.values[reference.name]
        for attribute in reference.attributes:
            value = read_attribute(value, attribute)
        return value


class Tree:
    """A job's tree: its root, and the result of its workflow once the root has succeeded."""

    def __init__(self, workflow: Workflow, inputs: Mapping[str, Any], library: Library, shared: Ticking) -> None:
        self._workflow = workflow
        self._scope = Scope(bound_inputs(workflow, inputs, library))
        self.root = _Builder(library, shared).build(workflow.tree, self._scope, workflow.name)

    def result(self) -> Any:
        reference = self._workflow.result
        return None if reference is None else self._scope.read(reference)


def bound_inputs(
    workflow: Workflow, given: Mapping[str, Any], library: Library, unknown: Collection[str] = ()
) -> Values:
    """A workflow's inputs: what is given, else its defaults; none for those given a value that is `unknown` yet."""
    values = dict(given)
    for declared in workflow.inputs.values():
        if declared.name not in (*values, *unknown) and declared.default is not None:
            values[declared.name] = literal(declared.name, declared.type, declared.default, library)
    return resolve_percent(values)


class _Builder:
    def __init__(self, library: Library, shared: Ticking) -> None:
        self._library = library
        self._shared = shared

    def build(self, node: TreeNode, scope: Scope, path: str) -> Behaviour:
        if isinstance(node, Call):
            return self._build_call(node, scope, path)
        if isinstance(node, Decorator):
            return self._build_decorator(node, scope, f"{path}/{node.kind}")
        return self._build_branch(node, scope, f"{path}/{node.kind}")

    def _build_branch(self, node: Branch, scope: Scope, path: str) -> Behaviour:
        children = [self.build(child, scope, f"{path}.{i}") for i, child in enumerate(node.children)]
        if node.kind == "sequence":
            return Sequence("sequence", memory=True, children=children)
        if node.kind == "fallback":
            return Selector("fallback", memory=True, children=children)
        return Parallel("parallel", ParallelPolicy.SuccessOnAll(synchronise=True), children)

    def _build_decorator(self, node: Decorator, scope: Scope, path: str) -> Behaviour:
        child = self.build(node.child, scope, path)
        arguments = self._arguments(node.arguments, PARAMETERS, scope)
        if node.kind == "retry":
            return Retry(child, arguments, frozenset(node.codes), self._shared)
        if node.kind == "repeat":
            return Repeat(child, arguments, self._shared)
        if node.kind == "timeout":
            return Timeout(path, child, arguments, self._shared)
        if node.kind == "while":
            guards = [self._build_guard(guard, scope) for guard in node.guards]
            return While(path, guards, child, self._shared)
        if node.kind == "invert":
            return Inverter("invert", child)
        return FailureIsSuccess("optional", child)

    def _build_guard(self, node: Call, scope: Scope) -> Guard:
        condition = self._library.skills[node.name]
        assert issubclass(condition, Condition)
        return Guard(node.name, condition, self._call_arguments(node, scope), self._shared)

    def _build_call(self, node: Call, scope: Scope, path: str) -> Behaviour:
        path = f"{path}/{node.name}"
        arguments = self._call_arguments(node, scope)

        def keep(value: Any) -> None:
            if node.result is not None:
                scope.values[node.result] = value

        if node.name in self._library.skills:
            return SkillLeaf(node.name, path, self._library.skills[node.name], arguments, keep, self._shared)
        workflow = self._library.workflows[node.name]
        inner = Scope({})

        def bind() -> None:
            inner.values = bound_inputs(workflow, arguments(), self._library)

        def keep_result() -> None:
            if workflow.result is not None:
                keep(inner.read(workflow.result))

        return WorkflowCall(node.name, self.build(workflow.tree, inner, path), bind, keep_result)

    def _call_arguments(self, node: Call, scope: Scope) -> Arguments:
        parameters = self._library.parameters(node.name)
        return self._arguments(node.arguments, {name: p.wire for name, p in parameters.items()}, scope)

    def _arguments(self, arguments: Mapping[str, Argument], wires: Mapping[str, WireType], scope: Scope) -> Arguments:
        fixed = {
            name: literal(name, wires[name], argument, self._library)
            for name, argument in arguments.items()
            if not isinstance(argument, Reference)
        }
        references = {name: argument for name, argument in arguments.items() if isinstance(argument, Reference)}

        def evaluate() -> Values:
            values = {**fixed, **{name: scope.read(reference) for name, reference in references.items()}}
            return resolve_percent(values) if any(isinstance(value, Percent) for value in fixed.values()) else values

        return evaluate
