"""Checks that the children of a `parallel` share no device, no zone and no value."""

from collections.abc import Iterator
from typing import Any

from scuhand_bt.problems import Problems
from scuhand_bt.skill import Skill
from scuhand_bt.tree.grammar import RECORD
from scuhand_bt.tree.library import Library, skills_of
from scuhand_bt.tree.workflow import (
    Branch,
    Call,
    Decorator,
    TreeNode,
    arguments_of,
    children_of,
    references_of,
    walk,
)


def check_side_by_side(node: Branch, defined: frozenset[str], library: Library, problems: Problems) -> None:
    """Check a `parallel`; `defined` are the names that have a value before it."""
    _check_places(node, library, problems)
    _check_values(node, defined, problems)
    _check_records(node, library, problems)


def _check_places(node: Branch, library: Library, problems: Problems) -> None:
    """No two children command one device or move in one zone; what moves beside the arm does so in a described zone."""
    used: dict[str, int] = {}
    entered: dict[str, int] = {}
    anywhere: dict[int, str] = {}
    """By child, a skill that has containers swing, and does not say where."""
    rules = (
        (used, "devices", "both command the {}", "one device does one thing at a time", "parallel-devices"),
        (entered, "zones", "both move in the zone '{}'", "one thing moves there at a time", "parallel-zones"),
    )
    for number, child in enumerate(node.children, start=1):
        skills = skills_of(child, library)
        unsaid = (name for name, skill in library.skills.items() if skill in skills and _swings_anywhere(skill))
        if (name := next(unsaid, None)) is not None:
            anywhere[number] = name
        for first, kind, clash, why, code in rules:
            for name in sorted({name for skill in skills for name in getattr(skill, kind)}):
                if name in first:
                    what = f"children {first[name]} and {number} of 'parallel' {clash.format(name)}"
                    problems.add(child.mark, what, f"{why}; use 'sequence'", code=code)
                first.setdefault(name, number)
    for zone, number in entered.items():
        is_known = zone in library.zones or library.broken.of("zone", zone)
        if used.get("arm", number) != number and not is_known:
            problems.add(
                node.children[number - 1].mark,
                f"this moves in the zone '{zone}' while the arm moves, and nothing keeps the arm out of it",
                f"describe '{zone}' and its box under `zones` of robot/cell.yaml, or use 'sequence'",
                code="unknown-zone",
            )
    for number, name in anywhere.items():
        if used.get("arm", number) != number:
            problems.add(
                node.children[number - 1].mark,
                f"'{name}' commands the changer while the arm moves, but leases no zone: nothing keeps the arm away",
                "name the zone that containers come and go through in `zones` of its class, or use 'sequence'",
                code="no-zone",
            )


def _swings_anywhere(skill: type[Skill[Any]]) -> bool:
    return "changer" in skill.devices and not skill.zones


def _check_values(node: Branch, defined: frozenset[str], problems: Problems) -> None:
    """A value that one child sets, no other child sets or reads: their order is not known."""
    sets, reads = [], []
    for child in node.children:
        parts = [*walk(child)]
        values = [value for part in parts for given in arguments_of(part) for value in references_of(given)]
        sets.append({part.result: part.result_mark for part in parts if isinstance(part, Call) and part.result})
        reads.append({value.name: value.mark for value in values if value.name in defined})
    remedy = "which comes first is not known; give each result a name of its own"
    for number, of in enumerate(sets, start=1):
        for name, mark in of.items():
            for other, (also_sets, also_reads) in enumerate(zip(sets, reads, strict=True), start=1):
                if name in also_sets and other < number:
                    what = f"children {other} and {number} of 'parallel' both set '${name}'"
                    problems.add(mark, what, remedy, code="parallel-values")
                elif name in also_reads and name not in also_sets:
                    what = f"child {other} of 'parallel' reads '${name}', which child {number} sets"
                    problems.add(also_reads[name], what, remedy, code="parallel-values")


def _check_records(node: Branch, library: Library, problems: Problems) -> None:
    """No two children record the same name: which one came last is not known."""
    first: dict[tuple[str, int], int] = {}
    for number, child in enumerate(node.children, start=1):
        names = dict.fromkeys(_recorded(child, library, 0, set()))
        for name, depth in names:
            if first.setdefault((name, depth), number) != number:
                what = f"children {first[name, depth]} and {number} of 'parallel' both record '{name}'"
                problems.add(
                    child.mark,
                    what,
                    "which comes last is not known; give each a name of its own",
                    code="parallel-values",
                )


def _recorded(node: TreeNode, library: Library, depth: int, seen: set[tuple[str, int]]) -> Iterator[tuple[str, int]]:
    """The names recorded in a tree and its calls, each with the number of loops around it.

    Each loop appends the number of its round to the name.
    """
    if isinstance(node, Call) and node.name == RECORD:
        yield from ((name, depth) for name in node.arguments)
    elif isinstance(node, Call) and node.name in library.workflows and (node.name, depth) not in seen:
        seen.add((node.name, depth))
        yield from _recorded(library.workflows[node.name].tree, library, depth, seen)
    depth += isinstance(node, Decorator) and node.kind in ("for_each", "repeat")
    for child in children_of(node):
        yield from _recorded(child, library, depth, seen)
