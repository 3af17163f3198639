"""What stands in for skills while a workflow is tested: a failure at the nth call, a result, a delay, by place.

Places are paths of the tree, as they stand in a journal (`fill/retry/sequence.0/fallback.1/scoop`), with wildcards: `*`
is anything within one part, `**` any parts. The first substitution that fits a call is taken.
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
    """One rule; without `code` and `is_result` the skill itself goes on after the delay."""

    mark: Mark
    at: str
    call: int | None = None
    """Only the nth call that it fits, from 1; every one, if None."""
    takes_s: float = 0.0
    code: str | None = None
    """The failure that it ends with."""
    is_result: bool = False
    """Whether it ends with `result`."""
    result: Any = None
    seen: int = 0
    """Calls that it fitted by their place."""
    used: int = 0

    @cached_property
    def _pattern(self) -> re.Pattern[str]:
        parts = re.split(r"(\*\*/|\*\*|\*)", self.at)
        wild = {"**/": r"(?:.*/)?", "**": r".*", "*": r"[^/]*"}
        return re.compile("".join(wild.get(part, re.escape(part)) for part in parts))

    def fits(self, path: str) -> bool:
        """Whether it is for a place of the tree."""
        return self._pattern.fullmatch(path) is not None

    def steps(self, clock: Clock) -> Steps[Any]:
        """What is done in the skill's stead, or before it. SkillFailed as asked."""
        yield from pause(clock, self.takes_s)
        if self.code is not None:
            raise SkillFailed(self.code, "as the test has it")
        return self.result


@dataclass
class Substitutes:
    """The substitutions of one run, in their order."""

    rules: Sequence[Substitution] = field(default_factory=tuple)

    def steps(self, path: str, clock: Clock, skill: Steps[Any]) -> Steps[Any]:
        """The steps of an action: the skill's, or what stands in for them."""
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
        """Those that no call came to."""
        return [rule for rule in self.rules if not rule.used]
