"""What a job did before it was interrupted, and how it is resumed (docs/run-behaviour.md, "Resuming").

An action is identified by its place in the tree and by how often the tree has come there: (path, visit). While a tree
is *replayed*, actions that had ended return their recorded results, and nothing moves. The first action without a
recorded end goes *live*. Arm and pan are compared with the record, an action that had begun is settled as its skill
declares (`Skill.interrupted`), and from there the job runs as usual.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from pydantic import TypeAdapter, ValidationError

from scuhand_bt.skill import Skill, SkillFailed

Key = tuple[str, int]
"""A place in the tree, and the number of the visit, from 1."""
ENDED = ("done", "failed")


@dataclass(frozen=True)
class Recorded:
    """An action as the journal has it. Its outcome is "halted" if the tree halted it, "interrupted" if the run did."""

    skill: str
    inputs: str
    """JSON."""
    outcome: str
    code: str | None = None
    result: Any = None


@dataclass(frozen=True)
class Decision:
    """A node other than a leaf that failed for a reason of its own: a timeout, or a guard of a `while`."""

    failure: SkillFailed
    had_begun: bool = True
    """Whether the child had been ticked before."""


@dataclass
class Replay:
    """One job's record, consumed while its tree is replayed. Without records the job just begins."""

    actions: Mapping[Key, Recorded] = field(default_factory=dict)
    decisions: Mapping[Key, Decision] = field(default_factory=dict)
    joints_rad: Sequence[float] | None = None
    """Where the arm was when the last action began or ended."""
    is_replaying: bool = False
    """True until nothing more can be replayed."""
    is_to_rejoin: bool = False
    """True until the first action has gone live."""
    at_work: frozenset[str] = frozenset()
    """The devices of all actions that had begun and not ended (several, within a `parallel`)."""
    _idle_ticks: int = 0
    _ended: int = 0

    @property
    def open_skills(self) -> set[str]:
        """The skills of the actions that had begun and not ended."""
        return {one.skill for one in self.actions.values() if one.outcome not in (*ENDED, "halted")}

    def recorded(self, path: str, visit: int) -> Recorded | None:
        return self.actions.get((path, visit))

    def decision(self, path: str, visit: int) -> Decision | None:
        return self.decisions.get((path, visit))

    def replay(self, recorded: Recorded, skill: type[Skill[Any]]) -> Any:
        """The result of an action that had ended; raises its SkillFailed if it had failed."""
        self._ended += 1
        if recorded.outcome == "failed":
            raise SkillFailed(recorded.code or "", recorded.result["detail"])
        return _restored(skill, recorded.result)

    def can_replay(self, recorded: Recorded, name: str, skill: type[Skill[Any]], inputs: str) -> bool:
        """False if workflow or recipe have changed since, so that the record is of another action."""
        if recorded.skill != name or recorded.inputs != inputs:
            return False
        try:
            if recorded.outcome == "done":
                _restored(skill, recorded.result)
        except ValidationError:
            return False
        return True

    def tick_ended(self) -> None:
        """After two ticks in which nothing more could be replayed, the job goes on live."""
        ended, self._ended = self._ended, 0
        self._idle_ticks = 0 if ended else self._idle_ticks + 1
        self.is_replaying = self._idle_ticks < 2


def _restored(skill: type[Skill[Any]], result: Any) -> Any:
    """A result as the skill returned it, from JSON."""
    return TypeAdapter(skill.result_type()).validate_python(result, by_name=True, by_alias=False)
