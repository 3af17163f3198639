"""What a skill's file says of it, read without running it: what it can fail with, and what it is for.

A check of workflows needs more of a skill than its class declares: whether it can fail at all, whether it weighs a
container before its first powder, whether it leaves the arm parked. That stands in its text.
"""

import ast
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scuhand_bt.failures import CATALOGUE, Code, SkillFailed
from scuhand_bt.problems import Mark
from scuhand_bt.skill import Condition, Skill

OVER = "over_balance"
PARK = "park"
"""The kind of station that the arm is out of the way at."""
OF_DEVICE = {
    "arm": ("arm.", "servo."),
    "hand": ("hand.", "servo."),
    "balance": ("balance.",),
    "changer": ("container.",),
}
"""The codes that a device, or what the engine does with it, fails with."""
OF_RUNS = (Code.HAND_LEAK, Code.DOSE_RUNAWAY, Code.DOSE_OVERSHOOTS, Code.BALANCE_BRACKET_OPEN)
"""What ends a run, or is told of a sample when its job is over: no workflow and no policy meets it."""


@dataclass(frozen=True)
class SkillFacts:
    """What is known of one skill by its text."""

    raised: frozenset[str]
    """The codes that its file raises, and those that it declares; of the shared files (`_x.py`), if it uses any."""
    tares: bool
    """It weighs a container before its first powder (`cell.believed.tared`)."""
    parks: bool
    """It moves the arm to a station of the kind `park`."""
    asks: bool
    """It asks a person (`cell.operator`)."""
    places: bool = False
    """It puts a container on the pan (`cell.believed.placed`)."""
    hovers: bool = False
    """It goes to the place over a container (`over_balance`)."""


def facts_of(skill: type[Skill[Any]], tree: ast.Module, shared: Iterable[str]) -> SkillFacts:
    """The facts of a skill by its file; `shared` are the codes of the files that skills of this lab share."""
    uses_shared = any(isinstance(node, ast.ImportFrom) and node.level for node in ast.walk(tree))
    raised = {*raised_codes(tree, ""), *skill.raises, *skill.failures, *(shared if uses_shared else ())}
    called = {node.func.attr for node in ast.walk(tree) if _is_method(node)}  # type: ignore[attr-defined]
    hovers = "arm" in skill.devices and any(isinstance(n, ast.Name) and n.id == OVER for n in ast.walk(tree))
    parks = any(
        _is_method(node) and any(isinstance(a, ast.Constant) and a.value == PARK for a in node.args)  # type: ignore[attr-defined]
        for node in ast.walk(tree)
    )
    return SkillFacts(
        frozenset(raised),
        "tared" in called,
        parks or _compares_to_park(tree),
        "ask" in called,
        "placed" in called,
        hovers,
    )


def _is_method(node: ast.AST) -> bool:
    return isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)


def _compares_to_park(tree: ast.Module) -> bool:
    """It goes through kinds of stations, and `park` is the last of them."""
    kinds = (n.elts[-1] for n in ast.walk(tree) if isinstance(n, ast.Tuple) and n.elts)
    return any(isinstance(last, ast.Constant) and last.value == PARK for last in kinds)


def codes_of(skill: type[Skill[Any]], facts: SkillFacts | None) -> frozenset[str]:
    """Every code that an action of this skill may fail with: its own, its devices', and the engine's within it."""
    own = facts.raised if facts is not None else frozenset({*skill.raises, *skill.failures})
    devices = {*skill.devices, *(skill.watches if issubclass(skill, Condition) else ())}
    prefixes = [prefix for device in devices for prefix in OF_DEVICE[device]] + (["device."] if devices else [])
    engine = {
        code
        for code, failure in CATALOGUE.items()
        if failure.raised_in and code not in OF_RUNS
        if "run" in failure.raised_in or code.startswith(tuple(prefixes))
    }
    within = {code for code, failure in CATALOGUE.items() if "cell" in failure.raised_in} if devices else set()
    return own | engine | within | {Code.WORKFLOW_BAD_VALUE}


def raised_codes(tree: ast.Module, file: str) -> Mapping[str, Mark]:
    """The failure codes that a lab's file raises, and where; those put together at run time are not seen.

    `Code.X` that there is not stands as it is written.
    """
    codes: dict[str, Mark] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == SkillFailed.__name__:
            code = node.args[0] if node.args else None
            if isinstance(code, ast.Constant) and isinstance(code.value, str):
                codes.setdefault(code.value, Mark(file, code.lineno, code.col_offset + 1))
            elif isinstance(code, ast.Attribute) and ast.unparse(code.value) == Code.__name__:
                name = Code.__members__.get(code.attr, ast.unparse(code))
                codes.setdefault(name, Mark(file, code.lineno, code.col_offset + 1))
    return codes


def parsed(path: Path) -> ast.Module:
    """A Python file's syntax tree; SyntaxError or ValueError where it is none."""
    return ast.parse(path.read_text(encoding="utf-8-sig"))
