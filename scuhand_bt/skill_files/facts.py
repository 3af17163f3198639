"""What a skill's file says of it, read without running it: what it can fail with, and what it is for.

A check of workflows needs more of a skill than its class declares: whether it can fail at all, whether it weighs a
container before its first powder, whether it leaves the arm parked. That stands in its text.
"""

import ast
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

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
OF_INSTRUMENT = ("container.",)
"""And one of those that a cell has beside these, whose kind a skill does not say: a scanner misses a container."""
OF_RUNS = (Code.HAND_LEAK, Code.DOSE_RUNAWAY, Code.DOSE_OVERSHOOTS, Code.BALANCE_BRACKET_OPEN)
"""What ends a run, or is told of a sample when its job is over: no workflow and no policy meets it."""


class Syntax(NamedTuple):
    """What a Python file is to `ast`."""

    tree: ast.Module
    nodes: list[ast.AST]
    """All of them, as `ast.walk` has them: it takes longer than what looks at them."""


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
    places: bool
    """It puts a container on the pan (`cell.believed.placed`)."""
    uses: bool
    """It fails without a container on the pan, which it does not put there itself."""
    hovers: bool
    """It goes to the place over a container (`over_balance`)."""


def facts_of(skill: type[Skill[Any]], syntax: Syntax, shared: Iterable[str]) -> SkillFacts:
    """The facts of a skill by its file; `shared` are the codes of the files that skills of this lab share."""
    nodes = syntax.nodes
    calls = [node for node in nodes if isinstance(node, ast.Call)]
    methods = {node.func.attr for node in calls if isinstance(node.func, ast.Attribute)}
    uses_shared = any(isinstance(node, ast.ImportFrom) and node.level for node in nodes)
    # `station_of_kind("park")`, or kinds of stations in turn, and it is the last of them.
    asked = [node.args for node in calls if isinstance(node.func, ast.Attribute)]
    in_turn = [node.elts[-1:] for node in nodes if isinstance(node, ast.Tuple)]
    places = "placed" in methods
    hovers = "arm" in skill.devices and any(isinstance(node, ast.Name) and node.id == OVER for node in nodes)
    is_at_pan = hovers or "balance" in skill.devices  # a scanner misses a container that is elsewhere, too
    return SkillFacts(
        raised=frozenset({*raised_codes(syntax, ""), *skill.raises, *skill.failures, *(shared if uses_shared else ())}),
        tares="tared" in methods,
        parks=any(isinstance(one, ast.Constant) and one.value == PARK for each in (*asked, *in_turn) for one in each),
        asks="ask" in methods,
        places=places,
        uses=Code.CONTAINER_MISSING in skill.raises and is_at_pan and not places,
        hovers=hovers,
    )


def codes_of(skill: type[Skill[Any]], facts: SkillFacts | None) -> frozenset[str]:
    """Every code that an action of this skill may fail with: its own, its devices', and the engine's within it."""
    own = facts.raised if facts is not None else frozenset({*skill.raises, *skill.failures})
    devices = {*skill.devices, *(skill.watches if issubclass(skill, Condition) else ())}
    prefixes = [prefix for device in devices for prefix in OF_DEVICE.get(device, OF_INSTRUMENT)] + (
        ["device."] if devices else []
    )
    engine = {
        code
        for code, failure in CATALOGUE.items()
        if failure.raised_in and code not in OF_RUNS
        if "run" in failure.raised_in or code.startswith(tuple(prefixes))
    }
    within = {code for code, failure in CATALOGUE.items() if "cell" in failure.raised_in} if devices else set()
    return own | engine | within | {Code.WORKFLOW_BAD_VALUE}


def raised_codes(syntax: Syntax, file: str) -> Mapping[str, Mark]:
    """The failure codes that a lab's file raises, and where; those put together at run time are not seen.

    `Code.X` that there is not stands as it is written.
    """
    codes: dict[str, Mark] = {}
    for node in syntax.nodes:
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == SkillFailed.__name__:
            code = node.args[0] if node.args else None
            if isinstance(code, ast.Constant) and isinstance(code.value, str):
                codes.setdefault(code.value, Mark(file, code.lineno, code.col_offset + 1))
            elif isinstance(code, ast.Attribute) and ast.unparse(code.value) == Code.__name__:
                name = Code.__members__.get(code.attr, ast.unparse(code))
                codes.setdefault(name, Mark(file, code.lineno, code.col_offset + 1))
    return codes


def parsed(path: Path) -> Syntax:
    """A Python file's syntax; SyntaxError or ValueError where it has none."""
    tree = ast.parse(path.read_text(encoding="utf-8-sig"))
    return Syntax(tree, list(ast.walk(tree)))
