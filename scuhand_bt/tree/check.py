"""The static check of workflows: every name, every wire's type and every device, before anything runs."""

from collections.abc import Iterable, Mapping
from functools import partial
from typing import Any

from scuhand_bt.problems import Mark, Problems, shorten
from scuhand_bt.skill import Condition
from scuhand_bt.skill_files.versions import of_another_version
from scuhand_bt.specs import Powder
from scuhand_bt.tree.expressions import Reference, fits
from scuhand_bt.tree.grammar import EXPRESSIONS, KEYWORDS, PARAMETERS, RECORD, why_no_expression
from scuhand_bt.tree.library import Library, Percent, literal
from scuhand_bt.tree.side_by_side import check_side_by_side
from scuhand_bt.tree.wires import INPUT_TYPES, NOTHING, QUANTITIES, WireType, of_field
from scuhand_bt.tree.workflow import Argument, Call, Choice, Decorator, Input, TreeNode, Value, Workflow, walk
from scuhand_bt.yaml_source import Node, Scalar, describe

RECORDED = (*QUANTITIES, "Number", "Integer", "Text", "Flag")
"""Types of values that a sample's row can hold."""
MAX_TREE_NODES = 5000
CALLED = ("skill", "workflow")
"""The kinds of things that a node can call by name."""


def check_workflows(library: Library, names: Iterable[str], problems: Problems) -> None:
    """Check the named workflows and everything that they call."""
    checker = _Checker(library, problems)
    for name in names:
        checker.result_of(name)


class _Checker:
    def __init__(self, library: Library, problems: Problems) -> None:
        self._library = library
        self._problems = problems
        self._codes = library.failures()
        self._results: dict[str, WireType | None] = {}
        self._sizes: dict[str, int] = {}
        self._calling: list[str] = []
        self._is_whole = True
        self._inputs: Mapping[str, Input] = {}
        """Inputs of the workflow that is being checked."""
        self._items: frozenset[str] = frozenset()
        """Names of the loop items that are in scope."""
        self._types: dict[str, WireType | None] = {}
        """By name; None if the node that sets the value is itself wrong, and reported."""

    def result_of(self, name: str, caller: Mark | None = None) -> WireType | None:
        """Check a workflow (once) and return its result's type; None if a reported mistake makes that unknown."""
        if name in self._results:
            return self._results[name]
        workflow = self._library.workflows[name]
        self._library.broken.tell("workflow", name, self._problems)
        if name in self._calling:
            circle = " → ".join([*self._calling[self._calling.index(name) :], name])
            self._problems.add(
                caller or workflow.mark, f"workflows call each other in a circle: {circle}", code="circle"
            )
            return NOTHING
        self._calling.append(name)
        outer_types, self._types = self._types, {key: declared.type for key, declared in workflow.inputs.items()}
        outer_is_whole, self._is_whole = self._is_whole, workflow.is_whole
        outer_inputs, self._inputs = self._inputs, workflow.inputs
        outer_items, self._items = self._items, frozenset()
        for declared in workflow.inputs.values():
            if declared.default is not None:
                value = self._check_literal(declared.name, declared.type, declared.default)
                if isinstance(value, Percent) and "mass" not in workflow.inputs:
                    what = "a tolerance in % needs a mass, but this workflow has no input 'mass'"
                    self._problems.add(declared.default.mark, what, code="percent-of-nothing")
        defined = self._check(workflow.tree, frozenset(workflow.inputs))
        result = self._type_of_value(workflow.result, defined) if workflow.result is not None else NOTHING
        self._types, self._is_whole, self._inputs = outer_types, outer_is_whole, outer_inputs
        self._items = outer_items
        self._calling.pop()
        self._results[name] = result
        self._check_size(workflow)
        return result

    def _check_size(self, workflow: Workflow) -> None:
        calls = (part.name if isinstance(part, Call) else "" for part in walk(workflow.tree))
        size = sum(1 + self._sizes.get(name, 0) for name in calls)
        if size > MAX_TREE_NODES:
            what = f"the tree of '{workflow.name}' has more than {MAX_TREE_NODES} nodes"
            self._problems.add(
                workflow.mark, what, "each call counts all nodes of the called workflow; use 'repeat'", code="too-large"
            )
            size = 0  # so that callers are not reported too
        self._sizes[workflow.name] = size

    def _check(self, node: TreeNode, defined: frozenset[str]) -> frozenset[str]:
        """Check a node; returns the names that are certain to have a value once it has succeeded."""
        if isinstance(node, Call):
            return self._check_call(node, defined)
        if isinstance(node, Decorator):
            return (
                self._check_for_each(node, defined) if node.kind == "for_each" else self._check_decorator(node, defined)
            )
        if isinstance(node, Choice):
            return self._check_choice(node, defined)
        if node.kind == "sequence":
            for child in node.children:
                defined = self._check(child, defined)
            return defined
        self._check_codes(node.codes)
        outcomes = [self._check(child, defined) for child in node.children]
        if node.kind == "parallel":
            check_side_by_side(node, defined, self._library, self._problems)
            return defined.union(*outcomes)
        return frozenset.intersection(*outcomes) if outcomes else defined

    def _check_decorator(self, node: Decorator, defined: frozenset[str]) -> frozenset[str]:
        for key, argument in node.arguments.items():
            value = self._check_argument(key, PARAMETERS[key], argument, defined)
            if isinstance(value, int | float) and value <= 0:
                self._problems.add(argument.mark, f"'{key}' is {value:g}", "more than 0", code="bad-count")
        self._check_codes(node.codes)
        for guard in node.guards:
            self._check_call(guard, defined)
            skill = self._library.skills.get(guard.name)
            if guard.name in self._library.workflows or (skill is not None and not issubclass(skill, Condition)):
                conditions = [name for name, cls in self._library.skills.items() if issubclass(cls, Condition)]
                self._problems.add(
                    guard.mark,
                    f"'{guard.name}' is not a condition, and cannot be a guard",
                    known=conditions,
                    code="no-condition",
                )
        after = self._check(node.child, defined)
        return defined if node.kind in ("invert", "optional") else after

    def _check_codes(self, codes: Mapping[str, Mark]) -> None:
        for code, mark in codes.items():
            if code not in self._codes:
                what = f"unknown failure code '{shorten(code)}'"
                self._problems.add(mark, what, unknown=code, known=self._codes, code="unknown-code")

    def _check_for_each(self, node: Decorator, defined: frozenset[str]) -> frozenset[str]:
        """The items have names only below the loop. A list may be empty, so the loop sets nothing for certain."""
        own: set[str] = set()
        for name, argument in node.arguments.items():
            given = None
            if isinstance(argument, Node):
                what = (
                    f"'{name}' takes the items of a list that is an input of the workflow, not of {describe(argument)}"
                )
                self._problems.add(
                    argument.mark, what, "write $name of an input of a type such as [Mass]", code="wrong-type"
                )
            elif (given := self._type_of_value(argument, defined)) is not None and given.item is None:
                what = f"'{name}' takes the items of a list, but {argument} is a {given.name}"
                self._problems.add(argument.mark, what, code="wrong-type")
            if name in self._types:
                what = f"'{name}' is already a value of this workflow"
                self._problems.add(argument.mark, what, "give the item another name", code="name-taken")
                continue
            own.add(name)
            self._types[name] = given.item if given is not None else None
            self._items |= {name}
        self._check(node.child, defined.union(node.arguments))
        self._items = self._items.difference(own)
        for name in own:
            del self._types[name]
        return defined

    def _check_choice(self, node: Choice, defined: frozenset[str]) -> frozenset[str]:
        """Returns the names that are certain after every branch; an `if` without `else` may also take none."""
        if node.kind == "if":
            self._check_argument("when", PARAMETERS["when"], node.argument, defined)
        else:
            self._check_cases(node, defined)
        outcomes = [self._check(case.child, defined) for case in node.cases]
        if node.kind == "if" and not node.is_exhaustive:
            outcomes.append(defined)
        return frozenset.intersection(*outcomes)

    def _check_cases(self, node: Choice, defined: frozenset[str]) -> None:
        argument = node.argument
        if isinstance(argument, Node):
            what = f"'switch' chooses by a value, not by {describe(argument)}"
            self._problems.add(argument.mark, what, EXPRESSIONS, code="bad-value")
            return
        wire = self._type_of_value(argument, defined)
        if wire is not None and (wire.name not in ("Text", "Integer") or wire.optional):
            what = f"'switch' chooses by a Text or an Integer, but {argument} is a {wire.name}"
            self._problems.add(argument.mark, what, "use 'if'", code="wrong-type")
        elif wire is not None:
            self._library.chosen_by[node.mark] = wire
            for case in node.cases:
                if case.value is not None:
                    self._check_literal("cases", wire, case.value)

    def _check_record(self, node: Call, defined: frozenset[str]) -> frozenset[str]:
        """Everything that `record` is given must have a type that a row can hold. Keeps these types for the run."""
        wires: dict[str, WireType] = {}
        for name, argument in node.arguments.items():
            if isinstance(argument, Node):
                wires[name] = INPUT_TYPES["Text"]
                self._check_literal(name, wires[name], argument)
                continue
            wire = self._type_of_value(argument, defined)
            if wire is not None and (wire.name not in RECORDED or wire.optional):
                what = (
                    f"{argument} {'may be nothing' if wire.optional else f'is a {wire.name}'}, which cannot be recorded"
                )
                remedy = "record one of its values: " + ", ".join(
                    f"{argument}.{key}" for key in [*wire.attributes()][:3]
                )
                self._problems.add(argument.mark, what, remedy if wire.is_class else "", code="wrong-type")
            elif wire is not None:
                wires[name] = wire
        if not node.arguments:
            self._problems.add(node.mark, f"'{RECORD}' has no values", "{name: $value}", code="missing-parameter")
        self._library.recorded[node.mark] = wires
        return self._keep(node, NOTHING, defined)

    def _check_call(self, node: Call, defined: frozenset[str]) -> frozenset[str]:
        library = self._library
        if node.name == RECORD and RECORD in library.skills:
            return self._check_record(node, defined)
        callee = library.workflows.get(node.name)
        is_known = node.name in library.skills or callee is not None
        if not is_known and not any(library.broken.tell(kind, node.name, self._problems) for kind in CALLED):
            known = [*library.skills, *library.workflows, *KEYWORDS]
            self._problems.add(
                node.mark,
                f"unknown skill or workflow '{shorten(node.name)}'",
                unknown=node.name,
                known=known,
                code="unknown-name",
            )
        if not is_known or (callee is not None and not callee.is_whole):  # its parameters and result are not known
            for argument in node.arguments.values():
                if not isinstance(argument, Node):
                    self._type_of_value(argument, defined)
            if callee is not None:
                self.result_of(node.name, node.mark)
            return self._keep(node, None, defined)
        parameters = library.parameters(node.name)
        for name, argument in node.arguments.items():
            if name in parameters:
                value = self._check_argument(name, parameters[name].wire, argument, defined)
                if isinstance(value, Percent) and "mass" not in node.arguments:
                    what = f"a tolerance in % needs a mass, but '{node.name}' is given no 'mass' here"
                    self._problems.add(argument.mark, what, code="percent-of-nothing")
            else:
                what = f"'{node.name}' has no parameter '{shorten(name)}'"
                takes = f"it takes {', '.join(parameters) or 'none'}"
                if name in library.taken_there.get(node.name, ()):
                    takes = f"{takes}; {of_another_version([f'{node.name}.py'])}"
                self._problems.add(
                    node.argument_marks[name], what, takes, unknown=name, known=parameters, code="unknown-parameter"
                )
        for name, parameter in parameters.items():
            if parameter.required and name not in node.arguments:
                self._problems.add(
                    node.mark, f"'{node.name}' needs '{name}' ({parameter.wire.name})", code="missing-parameter"
                )
        if node.name in library.workflows:
            result = self.result_of(node.name, node.mark)
        else:
            skill = library.skills[node.name]
            result = of_field(skill.result_type())
        return self._keep(node, result, defined)

    def _keep(self, node: Call, result: WireType | None, defined: frozenset[str]) -> frozenset[str]:
        """The names defined after this call; its result has the type `result` (None if unknown)."""
        if node.result is None:
            return defined
        before = self._types.get(node.result)
        if node.result in self._inputs or node.result in self._items:
            which = "an input of this workflow" if node.result in self._inputs else "an item of a list"
            what = f"'{node.result}' is {which}, which cannot be set again"
            self._problems.add(node.result_mark, what, "give the result another name", code="name-taken")
            return defined
        if result == NOTHING:
            self._problems.add(
                node.result_mark, f"'{node.name}' has no result to keep as '{node.result}'", code="no-result"
            )
            result = None
        elif before is not None and result is not None and not before.accepts(result):
            self._problems.add(
                node.result_mark,
                f"'{node.result}' is already a {before.name}, and cannot become a {result.name}",
                code="wrong-type",
            )
        self._types[node.result] = result
        return defined | {node.result}

    def _check_argument(self, name: str, wire: WireType, argument: Argument, defined: frozenset[str]) -> Any:
        if isinstance(argument, Node):
            return self._check_literal(name, wire, argument)
        given = self._type_of_value(argument, defined)
        accepts = wire.accepts if isinstance(argument, Reference) else partial(fits, wire)
        if given is not None and not accepts(given):
            maybe = "may be nothing" if given.optional and not wire.optional else f"is a {given.name}"
            self._problems.add(
                argument.mark, f"'{name}' takes a {wire.name}, but {argument} {maybe}", code="wrong-type"
            )
        return None

    def _check_literal(self, name: str, wire: WireType, node: Node) -> Any:
        try:
            return literal(name, wire, node, self._library)
        except ValueError as error:
            text = node.text if isinstance(node, Scalar) else None
            if (why := why_no_expression(node)) is not None:
                self._problems.add(node.mark, why, EXPRESSIONS, code="bad-expression")
                return None
            if wire.python is Powder and self._library.broken.tell("powder", text or "", self._problems):
                return None
            known: Iterable[str] = self._library.powders if wire.python is Powder else ()
            self._problems.add(
                node.mark, f"'{name}' takes a {wire.name}: {error}", unknown=text or "", known=known, code="bad-value"
            )
            return None

    def _type_of_value(self, value: Value, defined: frozenset[str]) -> WireType | None:
        """The type of a reference or expression; None if part of it is wrong, which is then reported."""
        if isinstance(value, Reference):
            return self._type_of(value, defined)
        try:
            return value.type(lambda reference: self._type_of(reference, defined))
        except ValueError as error:
            self._problems.add(value.mark, f"'{value}' cannot be calculated: {error}", code="bad-arithmetic")
            return None

    def _type_of(self, reference: Reference, defined: frozenset[str]) -> WireType | None:
        if not self._is_whole and reference.name not in defined:
            return None  # it may be set by the part that could not be read
        if reference.name not in self._types:
            known = [f"${name}" for name in self._types]
            what = f"unknown value '{reference}'"
            self._problems.add(reference.mark, what, unknown=f"${reference.name}", known=known, code="unknown-value")
            return None
        wire = self._types[reference.name]
        if wire is None:
            return None
        if reference.name not in defined:
            self._problems.add(
                reference.mark,
                f"'${reference.name}' may have no value here",
                "it is set on another branch only",
                code="unset-value",
            )
        for attribute in reference.attributes:
            if wire.optional:
                self._problems.add(
                    reference.mark, f"{reference} reads '{attribute}' of a value that may be nothing", code="wrong-type"
                )
                return None
            attributes = wire.attributes()
            if attribute not in attributes:
                what = f"a {wire.name} has no attribute '{attribute}'"
                self._problems.add(reference.mark, what, unknown=attribute, known=attributes, code="unknown-attribute")
                return None
            wire = attributes[attribute][1]
        return wire
