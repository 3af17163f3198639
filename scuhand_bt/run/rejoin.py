"""Resumes a job where it was interrupted: moves the arm back, compares the pan, and settles the open action."""

from typing import Any

import numpy as np

from scuhand_bt.cell.cell import Cell
from scuhand_bt.cell.leased import leased
from scuhand_bt.cell.weighing import weighing_of
from scuhand_bt.clock import Steps
from scuhand_bt.failures import Code
from scuhand_bt.journal.events import ArmMoved, PanCompared, Settled
from scuhand_bt.journal.writer import Journal
from scuhand_bt.motion import apex
from scuhand_bt.skill import Skill, SkillFailed
from scuhand_bt.tree.leaf import REJOINING
from scuhand_bt.tree.replay import Recorded, Replay

MOVED_RAD = 0.02
"""A joint farther than this from its recorded position has been moved."""
DRIFT_DIGITS = 10.0
"""How far the balance's zero may have drifted meanwhile, in its digits; a larger difference is asked about."""


def rejoin(
    journal: Journal,
    cell: Cell,
    replay: Replay,
    skill: Skill[Any],
    name: str,
    recorded: Recorded | None,
    *,
    is_same: bool,
) -> Steps[bool]:
    """What `tree.leaf.Rejoin` asks for. Raises SkillFailed operator.refused if the operator stops the run."""
    if replay.is_to_rejoin:
        replay.is_to_rejoin = False
        yield from _return(journal, cell, replay, skill, was_interrupted=recorded is not None)
    if recorded is None:
        return True
    return (yield from _settle(journal, cell, skill, name, None if is_same else recorded)) != "done"


def _return(journal: Journal, cell: Cell, replay: Replay, skill: Skill[Any], *, was_interrupted: bool) -> Steps[None]:
    """Move the arm back to where it was, unless this skill moves it; then compare the pan."""
    there = replay.joints_rad
    if there is not None and "arm" not in {*skill.devices, *replay.at_work}:  # the action that had the arm moves it
        moved_rad = float(np.abs(np.array(there) - cell.arm.positions).max())
        if moved_rad > MOVED_RAD:
            journal.event(ArmMoved(moved_rad=moved_rad))
            yield from cell.move_to(apex(np.array(there), cell.motion.mount(cell.hand.cone_diameter_mm)))
    gross_mg = cell.believed.pan_gross_mg
    weighs_itself = (was_interrupted and skill.interrupted == "reweigh") or cell.believed.dosing.is_unweighed
    if gross_mg is not None and not weighs_itself and "changer" not in {*skill.devices, *replay.at_work}:
        yield from _compare_pan(journal, cell, gross_mg)


def _settle(journal: Journal, cell: Cell, skill: Skill[Any], name: str, changed_from: Recorded | None) -> Steps[str]:
    """Settle an action that had begun and not ended: "again", or "done" if the operator says so.

    `changed_from` is what is recorded in its place, if the workflow or recipe has changed since.
    """
    if changed_from is None and skill.interrupted != "ask":
        journal.event(Settled(skill=name, by=skill.interrupted))
        yield from skill.settle(leased(cell, {*skill.devices, *REJOINING}))
        return "again"
    if changed_from is not None:
        before = f"'{changed_from.skill}' ({changed_from.outcome}, {changed_from.inputs})"
        question = f"The workflow or the recipe has changed: '{name}' now stands in the place of {before}. Do it?"
    else:
        question = f"'{name}' was interrupted ({skill.model_dump_json()}). Is it to begin again, or is it done?"
    choices = ["again", "stop"] if skill.result_type() is not type(None) else ["again", "done", "stop"]
    answer = yield from cell.operator.ask(question, choices)
    if answer == "stop":
        raise SkillFailed(
            Code.OPERATOR_REFUSED, f"'{name}' was interrupted, and the operator did not let it begin again"
        )
    return answer


def _compare_pan(journal: Journal, cell: Cell, gross_mg: float) -> Steps[None]:
    """Compare the pan with its last weighing. Nothing was dosed since, so a difference is the balance's zero."""
    mean = yield from cell.balance.stable_mean(cell.spec.balance.settles_s)
    drift_mg = mean.value_mg - gross_mg
    journal.event(PanCompared(**dict(mean.written()), before_mg=gross_mg))
    if abs(drift_mg) > max(1.0, DRIFT_DIGITS * cell.spec.balance.readability_mg):
        answer = yield from cell.operator.ask(
            f"The reading of the pan has changed by {drift_mg:+.1f} mg since the interruption, and nothing was being "
            "dosed. Has only the balance's zero moved ('zero'), or was powder added or lost ('powder')?",
            ("zero", "powder", "stop"),
        )
        if answer == "stop":
            raise SkillFailed(
                Code.OPERATOR_REFUSED,
                f"the reading of the pan has changed by {drift_mg:+.1f} mg since the interruption",
            )
        if answer == "powder":
            drift_mg = 0.0
    cell.believed.zero_moved(drift_mg, weighing_of(mean))
