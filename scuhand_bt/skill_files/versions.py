"""What goes by the engine of another version: a lab's copies of the starter lab's skills, held against today's."""

import ast
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from scuhand_bt.problems import Problem
from scuhand_bt.quantity import plain_name
from scuhand_bt.skill_files.facts import parsed

OF_ANOTHER_VERSION = ("skill-import", "skill-arguments", "skill-unknown-member")
"""What is found in a skill that goes by such an engine."""


def of_another_version(files: Sequence[str]) -> str:
    """What to do about files that may be of one."""
    what = "they" if len(files) > 1 else "it"
    return f"if {what} came with another version, take {' and '.join(files)} from a new lab (`scuhand-bt init DIR`)"


def with_remedy(problem: Problem, skill: Path, shared: Sequence[Path], starter: Path) -> Problem:
    """What does not go with this engine, where the skill, or a file it shares, stands in the starter lab, changed."""
    changed = [path.name for path in (skill, *shared) if is_changed(path, starter)]
    if problem.code not in OF_ANOTHER_VERSION or not changed:
        return problem
    return replace(problem, message=f"{problem.message}; {of_another_version(changed)}")


def is_changed(path: Path, starter: Path) -> bool:
    """Whether the starter lab has this file, and not as it is; not of one that cannot be read."""
    theirs = starter / "skills" / path.name
    with suppress(OSError):
        return theirs.is_file() and path.read_bytes() != theirs.read_bytes()
    return False


def taken_there(path: Path, starter: Path) -> frozenset[str]:
    """What the starter lab's skill takes, by the names that workflows give; nothing where the lab has the same file."""
    if not is_changed(path, starter):
        return frozenset()
    nodes = parsed(starter / "skills" / path.name).nodes
    fields = [part.target for node in nodes if isinstance(node, ast.ClassDef) for part in _annotated(node)]
    return frozenset(plain_name(field.id) for field in fields if isinstance(field, ast.Name))


def _annotated(node: ast.ClassDef) -> list[ast.AnnAssign]:
    return [part for part in node.body if isinstance(part, ast.AnnAssign)]
