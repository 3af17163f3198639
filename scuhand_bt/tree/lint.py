"""Warnings about workflows that would run but are probably not meant; each has a code (`findings.py`).

They follow from types, from static analysis of the skills' files (`skill_files/facts.py`) and from skills' forecasts.
Workflows with errors are skipped. Where something cannot be known, there is no warning.
"""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from inspect import getattr_static
from typing import Any

from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.failures import Code
from scuhand_bt.problems import Problems
from scuhand_bt.skill import Condition, Skill
from scuhand_bt.skill_files.facts import codes_of
from scuhand_bt.tree.expressions import Reference
from scuhand_bt.tree.grammar import PARAMETERS, RECORD
from scuhand_bt.tree.library import Library, devices_of, literal
from scuhand_bt.tree.workflow import (
    Branch,
    Call,
    Choice,
    Decorator,
    TreeNode,
    Workflow,
    arguments_of,
    children_of,
    references_of,
    walk,
)
from scuhand_bt.yaml_source import Node

DOSING = {"hand", "balance"}
HASTE = 4.0
"""No action is more than this many times quicker than its forecast."""
LASTING = "duration"
"""A skill takes at least as long as its parameter of this name."""


@dataclass(frozen=True)
class Need:
    """A precondition of a part of a dose: `before` must have come before `of`."""

    of: str
    before: str
    code: str
    what: str
    remedy: str


NEEDS = (
    Need(
        "use",
        "place",
        "no-container",
        "'{}' needs a container on the pan, but none was put there",
        "write `place_container:` before it",
    ),
    Need(
        "dose",
        "tare",
        "no-tare",
        "'{}' doses into a container that was not weighed empty",
        "write `tare:` after `place_container`, and before it",
    ),
    Need(
        "dose",
        "hover",
        "not-over-pan",
        "'{}' opens the valve, but the arm was not sent over the pan, or has left it",
        "`move_over:`",
    ),
)


class Lint:
    """The warnings for a lab's workflows; `service` are those that the engine calls between samples."""

    def __init__(self, library: Library, cell: CellSpec, service: Collection[str], problems: Problems) -> None:
        self.library = library
        self._cell = cell
        self._service = service
        self._problems = problems
        self._codes: dict[str, frozenset[str]] = {}
        self._sure: dict[str, bool] = {}
        self._least: dict[str, float] = {}

    def check(self, sound: Collection[str], roots: Collection[str]) -> None:
        """Warn about these workflows; they and everything that they call are free of errors.

        `roots` are those that run as a whole job: named by a recipe, or called by no other workflow.
        """
        for name in sound:
            workflow = self.library.workflows[name]
            self._check_names(workflow)
            for node in walk(workflow.tree):
                if isinstance(node, Decorator) and node.kind == "retry":
                    self._check_codes(node)
                elif isinstance(node, Decorator) and node.kind == "timeout":
                    self._check_timeout(node)
                elif isinstance(node, Branch) and node.kind == "fallback":
                    self._check_fallback(node)
                    self._check_codes(node)
            if name in roots:
                self._check_root(workflow)

    # --- names

    def _check_names(self, workflow: Workflow) -> None:
        read = {ref.name for ref in _references(workflow)}
        for declared in workflow.inputs.values():
            if declared.name not in read and workflow.name not in self._service:
                what = f"the input '{declared.name}' is not used"
                self._problems.warn(declared.mark, what, f"use ${declared.name}, or leave it out", code="unused-input")
        given: set[str] = set()
        for node in walk(workflow.tree):
            if isinstance(node, Call) and node.result is not None:
                if node.result not in read and node.result not in given:
                    remedy = f"use ${node.result}, or leave 'as' out"
                    what = f"the result '{node.result}' is not used"
                    self._problems.warn(node.result_mark, what, remedy, code="unused-result")
                given.add(node.result)
        self._check_shadowed(workflow.tree, frozenset())

    def _check_shadowed(self, node: TreeNode, defined: frozenset[str]) -> frozenset[str]:
        """Warn of a result that overwrites an earlier one. Alternatives may each set the same name."""
        if isinstance(node, Call):
            given = {} if node.result is None else {node.result: node.result_mark}
            if node.name == RECORD:
                given = {f"{RECORD} {name}": mark for name, mark in node.argument_marks.items()}
            for name, mark in given.items():
                if name in defined:
                    what = f"'{name.removeprefix(RECORD).strip()}' already has a value, which is lost here"
                    self._problems.warn(mark, what, "use another name", code="shadowed-name")
            return defined.union(given)
        if isinstance(node, Decorator):
            return self._check_shadowed(node.child, defined)
        if isinstance(node, Choice) or node.kind == "fallback":
            return defined.union(*(self._check_shadowed(child, defined) for child in children_of(node)))
        for child in node.children:
            defined = self._check_shadowed(child, defined)
        return defined

    # --- failures

    def codes(self, node: TreeNode) -> frozenset[str]:
        """All failure codes that a node may fail with."""
        if isinstance(node, Branch):
            return frozenset[str]().union(*map(self.codes, node.children))
        if isinstance(node, Choice):
            return frozenset[str]().union({Code.WORKFLOW_BAD_VALUE}, *map(self.codes, children_of(node)))
        if isinstance(node, Decorator):
            own = {"timeout": {"workflow.timeout"}, "invert": {"workflow.inverted"}}.get(node.kind, set())
            guards = frozenset[str]().union(*map(self.codes, node.guards))
            return self.codes(node.child) | guards | own
        if node.name not in self._codes:
            self._codes[node.name] = frozenset()
            if node.name in self.library.skills:
                skill = self.library.skills[node.name]
                self._codes[node.name] = codes_of(skill, self.library.facts.get(node.name))
            else:
                self._codes[node.name] = self.codes(self.library.workflows[node.name].tree)
        return self._codes[node.name]

    def _check_codes(self, node: Decorator | Branch) -> None:
        """Check `on` of a retry or fallback."""
        raised = frozenset[str]().union(*map(self.codes, children_of(node)))
        for code, mark in node.codes.items():
            if code not in raised:
                then = "is never tried again" if node.kind == "retry" else "never goes on"
                what = f"nothing here fails with {code}, so it {then} for this code"
                self._problems.warn(mark, what, "leave it out, or look at what the child calls", code="retry-never")

    def _is_sure(self, node: TreeNode) -> bool:
        """Whether a node certainly never fails. A value that only the run knows may not exist, or not be accepted."""
        if not all(isinstance(argument, Node) for argument in arguments_of(node)):
            return False
        if isinstance(node, Branch):
            found = [self._is_sure(child) for child in node.children]
            return any(found) if node.kind == "fallback" else all(found)
        if isinstance(node, Choice):
            return node.kind == "if" and all(map(self._is_sure, children_of(node)))
        if isinstance(node, Decorator):
            loops = ("retry", "repeat", "for_each")
            return node.kind == "optional" or (node.kind in loops and self._is_sure(node.child))
        if node.name not in self._sure:
            self._sure[node.name] = False
            skill, facts = self.library.skills.get(node.name), self.library.facts.get(node.name)
            if skill is not None:
                can_fail = bool(skill.devices) or issubclass(skill, Condition) or facts is None or bool(facts.raised)
                self._sure[node.name] = not can_fail and not (facts is not None and facts.asks)
            else:
                self._sure[node.name] = self._is_sure(self.library.workflows[node.name].tree)
        return self._sure[node.name]

    def _check_fallback(self, node: Branch) -> None:
        for number, child in enumerate(node.children[:-1], 1):
            if self._is_sure(child):
                what = f"this is never reached: child {number} of the fallback, before it, never fails"
                remedy = "put what can fail first, or leave this out"
                self._problems.warn(node.children[number].mark, what, remedy, code="unreachable-branch")
                return

    # --- times

    def _check_timeout(self, node: Decorator) -> None:
        argument = node.arguments["duration"]
        if not isinstance(argument, Node):
            return
        duration_s = float(literal("duration", PARAMETERS["duration"], argument, self.library))
        least_s = self.least_s(node.child)
        if duration_s < least_s:
            what = f"{duration_s:g} s are too short: this takes at least {least_s:g} s"
            self._problems.warn(argument.mark, what, "allow a longer time", code="short-timeout")

    def least_s(self, node: TreeNode) -> float:
        """The least time that a node takes if it succeeds [s]."""
        if isinstance(node, Branch):
            found = [self.least_s(child) for child in node.children]
            return sum(found) if node.kind == "sequence" else max(found) if node.kind == "parallel" else min(found)
        if isinstance(node, Choice):
            found = [self.least_s(child) for child in children_of(node)]
            return min(found) if node.is_exhaustive or node.kind == "switch" else 0.0
        if isinstance(node, Decorator):
            if node.kind in ("optional", "invert", "for_each"):
                return 0.0
            times = node.arguments.get("times")
            count = int(literal("times", PARAMETERS["times"], times, self.library)) if isinstance(times, Node) else 1
            return count * self.least_s(node.child)
        if node.name in self.library.skills:
            return self._least_of_skill(node, self.library.skills[node.name])
        if node.name not in self._least:
            self._least[node.name] = 0.0
            self._least[node.name] = self.least_s(self.library.workflows[node.name].tree)
        return self._least[node.name]

    def _least_of_skill(self, node: Call, skill: type[Skill[Any]]) -> float:
        if issubclass(skill, Condition):
            return 0.0
        given = self._literals(node)
        wire = self.library.parameters(node.name).get(LASTING)
        if wire is not None and wire.wire.name == "Duration":
            if LASTING in node.arguments:
                return float(given.get(LASTING, 0.0))
            default = next(i.default for n, i in skill.model_fields.items() if (i.alias or n) == LASTING)
            return float(default) if isinstance(default, int | float) else 0.0
        if all(getattr_static(skill, name) is getattr_static(Skill, name) for name in ("typical_s", "forecast")):
            return 0.0  # the skill does not say how long it takes
        try:
            return skill.forecast(given, self._cell).duration_s / HASTE
        except (Exception, SystemExit):  # a lab's code may raise anything; planning reports it
            return 0.0

    def _literals(self, node: Call) -> Mapping[str, Any]:
        wires = self.library.wires(node)
        return {
            key: literal(key, wires[key], argument, self.library)
            for key, argument in node.arguments.items()
            if isinstance(argument, Node)
        }

    # --- a whole job

    def _check_root(self, workflow: Workflow) -> None:
        if workflow.name in self._service:
            return
        if "arm" in devices_of(workflow.tree, self.library) and self._ends_parked(workflow.tree) is False:
            what = f"'{workflow.name}' does not end with the arm parked: it may stay over the pan or a mortar"
            self._problems.warn(_last(workflow.tree).mark, what, "write `park:` at the end", code="no-park")
        self._check_ready(workflow.tree, frozenset())

    def _ends_parked(self, node: TreeNode) -> bool | None:
        """Whether the last skill that moves the arm parks it; None if nothing moves it."""
        if isinstance(node, Call):
            if node.name in self.library.skills:
                facts = self.library.facts.get(node.name)
                is_mover = "arm" in self.library.skills[node.name].devices and facts is not None
                return facts.parks if is_mover and facts is not None else None
            return self._ends_parked(self.library.workflows[node.name].tree)
        if isinstance(node, Decorator):
            return self._ends_parked(node.child)
        ends = [end for end in map(self._ends_parked, children_of(node)) if end is not None]
        if not ends:
            return None
        return ends[-1] if node.kind == "sequence" else all(ends)

    def _check_ready(self, node: TreeNode, ready: frozenset[str]) -> frozenset[str]:
        """Warn of calls that come before their preconditions; returns what holds after the node."""
        if isinstance(node, Branch):
            if node.kind == "sequence":
                for child in node.children:
                    ready = self._check_ready(child, ready)
                return ready
            ends = [self._check_ready(child, ready) for child in node.children]
            return frozenset.union(*ends) if node.kind == "parallel" else frozenset.intersection(*ends)
        if isinstance(node, Choice):
            ends = [self._check_ready(child, ready) for child in children_of(node)]
            return frozenset.intersection(*ends) if node.is_exhaustive or node.kind == "switch" else ready
        if isinstance(node, Decorator):
            after = self._check_ready(node.child, ready)
            return ready if node.kind in ("optional", "invert") else after
        for name in self._skills_of(node):
            does = self._does(name)
            for need in NEEDS:
                if need.of in does and need.before not in ready:
                    self._problems.warn(node.mark, need.what.format(node.name), need.remedy, code=need.code)
                    ready |= {need.before}  # so that it is reported once
            if "arm" in self.library.skills[name].devices:
                ready -= {"hover"}
            ready |= does
        return ready

    def _does(self, name: str) -> frozenset[str]:
        """Which parts of a dose a skill does, according to its file."""
        facts = self.library.facts.get(name)
        if facts is None:
            return frozenset()
        does = {"place": facts.places, "use": facts.uses, "tare": facts.tares, "hover": facts.hovers}
        doses = DOSING.issubset(self.library.skills[name].devices)
        return frozenset(word for word, is_done in {**does, "dose": doses}.items() if is_done)

    def _skills_of(self, node: TreeNode) -> Iterator[str]:
        """The skills of a tree in order, including everything that it calls."""
        for part in walk(node):
            if isinstance(part, Call) and part.name in self.library.skills:
                yield part.name
            elif isinstance(part, Call):
                yield from self._skills_of(self.library.workflows[part.name].tree)


def _references(workflow: Workflow) -> Iterator[Reference]:
    yield from references_of(workflow.result)
    for node in walk(workflow.tree):
        for argument in arguments_of(node):
            yield from references_of(argument)


def _last(node: TreeNode) -> TreeNode:
    if isinstance(node, Branch) and node.children:
        return _last(node.children[-1])
    return node
