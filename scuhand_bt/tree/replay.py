"""What a job did before it was interrupted, and how it is taken up again.

The identity of an action is its place in the tree and how often the tree has come there: (path, visit). While a
job's tree is *replayed*, an action that had ended ends again as it did, and nothing moves. The first action
without a recorded end goes live: the arm and the pan are compared with what they were, an action that had begun
is settled as its skill declares (`Skill.interrupted`), and from there on the job runs as any other.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from scuhand_bt.cell.cell import Cell
from scuhand_bt.clock import Steps
from scuhand_bt.motion import apex
from scuhand_bt.skill import Skill, SkillFailed

Key = tuple[str, int]
"""A place in the tree, and the how-manieth visit."""
ENDED = ("done", "failed")
REJOINING = ("arm", "balance")
"""What `rejoin` uses."""
MOVED_RAD = 0.02
"""A joint that is farther than this from where it was has been moved."""
DRIFT_DIGITS = 10.0
"""The balance's zero may have wandered this far while nobody looked; more is asked about."""


@dataclass(frozen=True)
class Recorded:
    """An action as it stands in the journal; `outcome` "halted" is by the tree itself, "interrupted" by the run."""

    skill: str
    inputs: str
    """JSON."""
    outcome: str
    code: str | None = None
    result: Any = None


@dataclass(frozen=True)
class Decision:
    """A node that was no action but failed on its own account: a timeout, a guard of a `while`."""

    failure: SkillFailed
    had_begun: bool = True
    """Whether the child had been ticked before."""


@dataclass
class Past:
    """One job's record, consumed while its tree is replayed. Without records, a job that only begins."""

    actions: Mapping[Key, Recorded] = field(default_factory=dict)
    decisions: Mapping[Key, Decision] = field(default_factory=dict)
    joints_rad: Sequence[float] | None = None
    """Where the arm was when the last action began or ended."""
    is_replaying: bool = False
    """True until nothing more can be replayed."""
    is_to_rejoin: bool = False
    """True until the first action has gone live."""
    _idle_ticks: int = 0
    _ended: int = 0

    def recorded(self, path: str, visit: int) -> Recorded | None:
        return self.actions.get((path, visit))

    def decision(self, path: str, visit: int) -> Decision | None:
        return self.decisions.get((path, visit))

    def replay(self, recorded: Recorded, skill: type[Skill[Any]]) -> Any:
        """The result of an action that had ended; raises its SkillFailed."""
        self._ended += 1
        if recorded.outcome == "failed":
            raise SkillFailed(recorded.code or "", recorded.result["detail"])
        return _restored(skill, recorded.result)

    def can_replay(self, recorded: Recorded, name: str, skill: type[Skill[Any]], inputs: str) -> bool:
        """False where the workflow or the recipe has changed since, so that the record is not of this action."""
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
    """A result as the skill gave it, from JSON."""
    return TypeAdapter(skill.result_type()).validate_python(result, by_name=True, by_alias=False)


def rejoin(cell: Cell, past: Past, skill: Skill[Any], *, was_interrupted: bool) -> Steps[None]:
    """Before the first action: the arm back where it was, if this skill would not move it; the pan compared."""
    there = past.joints_rad
    if there is not None and "arm" not in skill.devices:
        moved_rad = float(np.abs(np.array(there) - cell.arm.positions).max())
        if moved_rad > MOVED_RAD:
            cell.record.event("arm_moved", {"moved_rad": moved_rad})
            yield from cell.move_to(apex(np.array(there), cell.spec.hand.apex_offset_mm / 1000))
    gross_mg = cell.believed.pan_gross_mg
    weighs_itself = (was_interrupted and skill.interrupted == "reweigh") or cell.believed.dosing.is_unweighed
    if gross_mg is not None and not weighs_itself and "changer" not in skill.devices:
        yield from _compare_pan(cell, gross_mg)


def settle(cell: Cell, skill: Skill[Any], name: str, changed_from: Recorded | None) -> Steps[str]:
    """Settle an action that had begun and not ended: "again", or "done" where the operator says so.

    `changed_from` is what stood in its place, if the workflow or the recipe has changed since.
    """
    if changed_from is None and skill.interrupted != "ask":
        cell.record.event("settled", {"skill": name, "by": skill.interrupted})
        yield from skill.settle(cell)
        return "again"
    if changed_from is not None:
        before = f"'{changed_from.skill}' ({changed_from.outcome}, {changed_from.inputs})"
        question = f"The workflow or the recipe has changed: where {before} was, '{name}' is now. Do it?"
    else:
        question = f"'{name}' was interrupted ({skill.model_dump_json()}). Begin it again, or is it done?"
    choices = ["again", "stop"] if skill.result_type() is not type(None) else ["again", "done", "stop"]
    answer = yield from cell.operator.ask(question, choices)
    if answer == "stop":
        raise SkillFailed("operator.refused", f"'{name}' was interrupted, and is not to be begun again")
    return answer


def _compare_pan(cell: Cell, gross_mg: float) -> Steps[None]:
    """Nothing can have been dosed since the pan was weighed: what it shows otherwise is the balance's zero."""
    believed = cell.believed
    mean = yield from cell.balance.settled()
    drift_mg = mean.value_mg - gross_mg
    cell.record.event("pan_compared", {**mean.values(), "before_mg": gross_mg})
    if abs(drift_mg) > max(1.0, DRIFT_DIGITS * cell.spec.balance.readability_mg):
        answer = yield from cell.operator.ask(
            f"The pan shows {drift_mg:+.1f} mg against before the interruption, and nothing was being dosed. Has only "
            "the balance's zero moved ('zero'), or has powder come or gone ('powder')?",
            ("zero", "powder", "stop"),
        )
        if answer == "stop":
            raise SkillFailed("operator.refused", f"the pan shows {drift_mg:+.1f} mg against before")
        if answer == "powder":
            drift_mg = 0.0
    if believed.pan_empty_mg is not None:
        believed.pan_empty_mg += drift_mg
    believed.pan_gross_mg = mean.value_mg
