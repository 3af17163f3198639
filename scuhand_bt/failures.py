"""The failure catalogue: every way an action on the cell can fail, as data.

Recipes (`on_failure`) and workflows (`retry: {on: [...]}`) branch on the codes. A lab's skill may add
codes of its own (`Skill.failures`).
"""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Failure:
    """One entry of the catalogue."""

    meaning: str
    remedy: str


class SkillFailed(Exception):  # noqa: N818 - it reads as the sentence it is raised in
    """An action failed in a way the catalogue knows; the tree turns it into FAILURE.

    `code` is a key of the catalogue, `detail` says what happened this time, with its numbers.
    """

    def __init__(self, code: str, detail: str) -> None:
        super().__init__(f"{code}: {detail}")
        self.code = code
        self.detail = detail


CATALOGUE: Mapping[str, Failure] = {
    "arm.no_path": Failure(
        "No collision-free way to the station was found.",
        "Move the station or the obstacle in robot/cell.yaml, or free the way.",
    ),
    "arm.unreachable": Failure(
        "No joint angles put the cone's apex at this pose.",
        "Move the station nearer to the arm; `scuhand-bt reach` draws what can be reached.",
    ),
    "arm.start_in_collision": Failure(
        "The arm touches something (in the model) where it stands.",
        "Move the arm clear by hand, or correct the geometry in robot/cell.yaml.",
    ),
    "arm.joint_limit": Failure(
        "A joint is, or would go, beyond its limit.",
        "Move the joint back inside its range by hand and start again.",
    ),
    "arm.in_the_way": Failure(
        "The arm stands over the pan while a container is to be changed.",
        "Put `park:` before `place_container` in the workflow.",
    ),
    "arm.not_following": Failure(
        "The arm is not where its trajectory says it should be.",
        "Look for what blocks it; check the servos' temperatures and supply.",
    ),
    "servo.overload": Failure(
        "A servo has shut down on overload or heat.",
        "Free the arm, let it cool, reboot the servo.",
    ),
    "device.lost": Failure(
        "A device no longer answers.",
        "Check its cable and supply, then start again.",
    ),
    "device.busy": Failure(
        "A device did not stop in the time it should.",
        "Look at the cell; if it stands still, start again.",
    ),
    "device.emergency_stop": Failure(
        "The emergency stop is, or was, pressed: the valve closed and vibration stopped.",
        "Make the cell safe, release the emergency stop, and start again.",
    ),
    "balance.unstable": Failure(
        "The balance did not settle in time.",
        "Close the draft shield, look for vibration, fume-hood draughts or a touching container.",
    ),
    "balance.overload": Failure(
        "The load is beyond the balance's maximum.",
        "Take the load off; use a lighter container or insert.",
    ),
    "container.missing": Failure(
        "No container stands on the pan.",
        "Put the container on the pan, or fill the changer's slot.",
    ),
    "container.moved": Failure(
        "The pan lost mass while a dose was going on.",
        "See whether the container was touched, tipped or taken away; begin its dose again with a new one.",
    ),
    "container.wrong_mass": Failure(
        "What was put on the pan does not weigh what this container should.",
        "Check that it is the right container, empty and clean; correct robot/containers.yaml if it changed.",
    ),
    "container.too_small": Failure(
        "The mass does not fit into the container.",
        "Ask for less, or choose a larger container.",
    ),
    "hand.cone_empty": Failure(
        "The cone gives no more powder.",
        "Scoop again (the shipped workflows do).",
    ),
    "hand.wrong_powder": Failure(
        "The cone holds, or the sheet has touched, another powder.",
        "Discard or return what is in the cone and swap the sheet.",
    ),
    "hand.no_flow": Failure(
        "The cone should hold powder, but none comes out, even with vibration.",
        "Look whether the scoop brought any; else for a bridge or a lump at the apex. Dry or sieve the powder.",
    ),
    "hand.valve_stuck": Failure(
        "The valve does not move; powder may be running out of it.",
        "Hold a vessel under the cone, empty it by hand, and look for powder or a fold of the sheet in the valve.",
    ),
    "hand.leak": Failure(
        "Powder runs onto the pan although the valve is shut.",
        "Hold a vessel under the cone and empty it; look for powder in the valve, or a fold or hole in the sheet.",
    ),
    "scoop.nothing": Failure(
        "The scoop brought (almost) nothing.",
        "Check that the mortar holds powder and stands at its station.",
    ),
    "source.empty": Failure(
        "The source holds less than a scoop can reach.",
        "Refill the mortar and correct the recipe's amount.",
    ),
    "dose.overshoot": Failure(
        "More than the target plus its tolerance has been dispensed; it cannot be taken back.",
        "Discard and dose a new container, or accept the mass that was measured.",
    ),
    "dose.runaway": Failure(
        "Far more than the target is in the container, and the valve is still open.",
        "Discard the container's content; look whether the valve shuts, and whether the balance reads true.",
    ),
    "dose.not_reached": Failure(
        "The dose stopped below its tolerance: the step limit was reached.",
        "Look at the powder's flow; raise the step limit or choose another controller.",
    ),
    "dose.too_small": Failure(
        "The target or its tolerance is below what the balance can tell.",
        "Ask for a larger tolerance, or use a balance with a finer readability.",
    ),
    "operator.refused": Failure(
        "The operator answered no.",
        "Do what was asked, or change the recipe.",
    ),
    "operator.absent": Failure(
        "A person was needed and none was there.",
        "Run with a person at the cell, or use the container changer.",
    ),
    "workflow.timeout": Failure(
        "A part of the workflow took longer than its `timeout` allows.",
        "Look at what it was waiting for; allow it more time if that was normal.",
    ),
    "workflow.bad_value": Failure(
        "A value on a wire is outside what the skill accepts.",
        "Correct the recipe or the workflow that gave the value.",
    ),
    "workflow.inverted": Failure(
        "What stands under `invert` succeeded, and so `invert` failed.",
        "This is the workflow's own decision; see the workflow.",
    ),
}
