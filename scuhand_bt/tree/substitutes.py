"""Stand-ins for skills in tests of workflows: a failure at the nth call, a result, or a delay, chosen by place.

Places are paths of the tree as in the journal (`fill/retry/sequence.0/fallback.1/scoop`), with wildcards: `*` matches
within one part, `**` any number of parts. The first substitution that matches a call applies.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from scuhand_bt.clock import Clock, Steps, pause
from scuhand_bt.failures import SkillFailed
from scuhand_bt.problems import Mark


@dataclass
class Substitution:
    """One rule. Without `code` and `is_result` the skill itself runs after the delay."""

    mark: Mark
    at: str
    call: int | None = None
    """Only the nth call that matches, from 1; None for every one."""
    takes_s: float = 0.0
    code: str | None = None
    """The failure code that the call ends with."""
    is_result: bool = False
    """Whether the call ends with `result`."""
    result: Any = None
    seen: int = 0
    """How many calls have matched by their place."""
    used: int = 0

    @cached_property
    def _pattern(self) -> re.Pattern[str]:
        parts = re.split(r"(\*\*/|\*\*|\*)", self.at)
        wild = {"**/": r"(?:.*/)?", "**": r".*", "*": r"[^/]*"}
        return re.compile("".join(wild.get(part, re.escape(part)) for part in parts))

    def fits(self, path: str) -> bool:
        """Whether it matches a place of the tree."""
        return self._pattern.fullmatch(path) is not None

    def steps(self, clock: Clock) -> Steps[Any]:
        """The steps before the skill, or in its place. Raises SkillFailed as asked."""
        yield from pause(clock, self.takes_s)
        if self.code is not None:
            raise SkillFailed(self.code, "as the test has it")
        return self.result


@dataclass
class Substitutes:
    """The substitutions of one run, in their order."""

    rules: Sequence[Substitution] = field(default_factory=tuple)

    def steps(self, path: str, clock: Clock, skill: Steps[Any]) -> Steps[Any]:
        """The steps of an action: the skill's, or those of the substitution that applies."""
        fitting = [rule for rule in self.rules if rule.fits(path)]
        for rule in fitting:
            rule.seen += 1
        for rule in fitting:
            if rule.call in (None, rule.seen):
                rule.used += 1
                return self._steps(rule, clock, skill)
        return skill

    def _steps(self, rule: Substitution, clock: Clock, skill: Steps[Any]) -> Steps[Any]:
        given = yield from rule.steps(clock)
        return given if rule.is_result else (yield from skill)

    @property
    def unused(self) -> list[Substitution]:
        """Those that never applied."""
        return [rule for rule in self.rules if not rule.used]
