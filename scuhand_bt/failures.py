"""The failure catalogue: every way an action on the cell can fail, as data.

Recipes (`on_failure`) and workflows (`retry: {on: [...]}`) branch on the codes. A lab's skill may add
codes of its own (`Skill.failures`).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum


class Code(StrEnum):
    """The codes of the shared catalogue, as they stand in recipes, workflows and journals."""

    ARM_NO_PATH = "arm.no_path"
    ARM_UNREACHABLE = "arm.unreachable"
    ARM_START_IN_COLLISION = "arm.start_in_collision"
    ARM_JOINT_LIMIT = "arm.joint_limit"
    ARM_IN_THE_WAY = "arm.in_the_way"
    ARM_ZONE_TAKEN = "arm.zone_taken"
    ARM_NOT_OVER_PAN = "arm.not_over_pan"
    ARM_NOT_FOLLOWING = "arm.not_following"
    ARM_LIMP = "arm.limp"
    COMPUTER_BUSY = "computer.busy"
    SERVO_OVERLOAD = "servo.overload"
    DEVICE_LOST = "device.lost"
    DEVICE_BUSY = "device.busy"
    DEVICE_EMERGENCY_STOP = "device.emergency_stop"
    BALANCE_UNSTABLE = "balance.unstable"
    BALANCE_OVERLOAD = "balance.overload"
    BALANCE_COARSE = "balance.coarse"
    BALANCE_DRIFTING = "balance.drifting"
    BALANCE_SLOW = "balance.slow"
    BALANCE_BRACKET_OPEN = "balance.bracket_open"
    CONTAINER_MISSING = "container.missing"
    CONTAINER_MOVED = "container.moved"
    CONTAINER_CHANGED = "container.changed"
    CONTAINER_WRONG_MASS = "container.wrong_mass"
    CONTAINER_TOO_SMALL = "container.too_small"
    HAND_CONE_EMPTY = "hand.cone_empty"
    HAND_WRONG_POWDER = "hand.wrong_powder"
    HAND_NO_FLOW = "hand.no_flow"
    HAND_VALVE_STUCK = "hand.valve_stuck"
    HAND_VALVE_LOST = "hand.valve_lost"
    HAND_LEAK = "hand.leak"
    HAND_ROLLER_LOST = "hand.roller_lost"
    SCOOP_NOTHING = "scoop.nothing"
    SOURCE_EMPTY = "source.empty"
    DOSE_OVERSHOOT = "dose.overshoot"
    DOSE_OVERSHOOTS = "dose.overshoots"
    DOSE_RUNAWAY = "dose.runaway"
    DOSE_NOT_REACHED = "dose.not_reached"
    DOSE_TOO_SMALL = "dose.too_small"
    OPERATOR_REFUSED = "operator.refused"
    OPERATOR_ABSENT = "operator.absent"
    WORKFLOW_TIMEOUT = "workflow.timeout"
    WORKFLOW_BAD_VALUE = "workflow.bad_value"
    WORKFLOW_INVERTED = "workflow.inverted"


@dataclass(frozen=True, slots=True)
class Failure:
    """One entry of the catalogue."""

    meaning: str
    remedy: str
    raised_in: tuple[str, ...] = ()
    """The rooms of the engine that raise it, within any skill; what a skill itself raises is in its `raises`."""


class SkillFailed(Exception):  # noqa: N818 - it reads as the sentence it is raised in
    """An action failed in a way the catalogue knows; the tree turns it into FAILURE.

    `code` is a key of the catalogue, `detail` says what happened this time, with its numbers.
    """

    def __init__(self, code: str, detail: str) -> None:
        super().__init__(code, detail)
        self.code = str(code)
        self._detail: str | Callable[[], str] = detail

    @staticmethod
    def that_says(code: str, say: Callable[[], str]) -> "SkillFailed":
        """One whose detail takes long to find out: who tries something else next never asks for it."""
        failure = SkillFailed(code, "")
        failure._detail = say
        return failure

    @property
    def detail(self) -> str:
        """What happened this time."""
        if not isinstance(self._detail, str):
            self._detail = self._detail()
        return self._detail

    def __str__(self) -> str:
        return f"{self.code}: {self.detail}"

    def __reduce__(self) -> tuple[type["SkillFailed"], tuple[str, str]]:
        """From one process to another: by what happened, not by its text."""
        return SkillFailed, (self.code, self.detail)


CATALOGUE: Mapping[str, Failure] = {
    Code.ARM_NO_PATH: Failure(
        "No collision-free way to the station was found.",
        "Move the station or the obstacle in robot/cell.yaml, or free the way.",
        ("cell", "motion", "run"),
    ),
    Code.ARM_UNREACHABLE: Failure(
        "No joint angles put the cone's apex at this pose.",
        "Move the station nearer to the arm; `scuhand-bt reach` draws what can be reached.",
        ("motion",),
    ),
    Code.ARM_START_IN_COLLISION: Failure(
        "Where it stands, the arm touches something (in the model), and it cannot move away by itself.",
        "Hold the arm, switch its supply off and on, lead it clear by hand, and resume. Or correct the geometry in "
        "robot/cell.yaml.",
        ("cell", "motion"),
    ),
    Code.ARM_JOINT_LIMIT: Failure(
        "A joint is beyond its limit, or would go beyond it.",
        "Move the joint back inside its range by hand and start again.",
        ("motion", "devices"),
    ),
    Code.ARM_IN_THE_WAY: Failure(
        "The arm stands where something else is about to move, for example over the pan when a container is to be "
        "changed.",
        "Put `park:` before `place_container` in the workflow.",
        ("cell", "tree"),
    ),
    Code.ARM_ZONE_TAKEN: Failure(
        "The arm had to enter or leave a zone of the cell, but something else there did not end in time.",
        "Look at the cell. In the workflow, put the actions that need this zone after the `parallel`, not inside it.",
        ("cell",),
    ),
    Code.ARM_NOT_OVER_PAN: Failure(
        "Powder was to be let out, but the cone is not over the mouth of the container on the pan.",
        "Put `move_over:` before `dispense` in the workflow, and after each `scoop` or `park`.",
    ),
    Code.ARM_NOT_FOLLOWING: Failure(
        "The arm is not where its trajectory says it should be.",
        "Look for what blocks it; check the servos' temperatures and supply.",
        ("devices",),
    ),
    Code.ARM_LIMP: Failure(
        "The arm or the hand's roller has no torque, or no servo answers: the supply is off, or was off.",
        "Support the arm. Look where the cone's load went, and clear the way. Switch the supply on, then resume.",
        ("devices", "run"),
    ),
    Code.COMPUTER_BUSY: Failure(
        "This computer was too busy for the run, so everything that moved was stopped. Nothing was in the arm's way.",
        "Close other programs, give the run more cores, or start it with `nice -n -5`. `scuhand-bt doctor` "
        "measures how late this computer is.",
        ("devices",),
    ),
    Code.SERVO_OVERLOAD: Failure(
        "A servo has shut down because of overload or heat, or is too hot to go on moving.",
        "Support the arm, free it and let it cool. Then switch its supply off and on.",
        ("devices",),
    ),
    Code.DEVICE_LOST: Failure(
        "A device no longer answers.",
        "Check its cable and supply, then start again.",
        ("devices", "run"),
    ),
    Code.DEVICE_BUSY: Failure(
        "A device did not stop in time, or is still working.",
        "Look at the cell. If everything stands still, start again.",
        ("devices", "tree", "run"),
    ),
    Code.DEVICE_EMERGENCY_STOP: Failure(
        "The emergency stop is, or was, pressed: the valve closed and vibration stopped.",
        "Make the cell safe, release the emergency stop, and start again.",
        ("devices",),
    ),
    Code.BALANCE_UNSTABLE: Failure(
        "The balance did not settle in time.",
        "Close the draft shield. Look for vibration, draughts, and anything that touches the container. If the "
        "reading creeps, check the balance's filter.",
        ("devices", "cell"),
    ),
    Code.BALANCE_COARSE: Failure(
        "The balance shows more digits than it resolves, holds back small changes, or its display is frozen.",
        "Set its readability in robot/cell.yaml to what it really resolves. Switch off its hold and its "
        "stable-display filter.",
    ),
    Code.BALANCE_DRIFTING: Failure(
        "Two weighings in a row of the same load went on differing, so its mass cannot be determined.",
        "Let the container reach room temperature, and ground it. Close the draft shield, and let the balance warm "
        "up. If the reading only grows, check whether the shut valve leaks: `hand.leak` detects only leaks of 1 "
        "mg/s or more.",
        ("cell",),
    ),
    Code.BALANCE_SLOW: Failure(
        "The balance shows a load too late to stop a dose in time.",
        "Set its filter (response, environment) to a faster one. `scuhand-bt balance` shows what is known of it.",
        ("cell",),
    ),
    Code.BALANCE_BRACKET_OPEN: Failure(
        "The container's gain, weighed against the bare pan before and after it, does not confirm the dose.",
        "Weigh the container again by hand. Look for powder beside it, a leaking valve, and a zero that steps. Two "
        "other causes look like a step of the zero: a display that is renewed less often than the balance's "
        "`period` in robot/cell.yaml says, and a powder that comes charged or warm.",
        ("run",),
    ),
    Code.BALANCE_OVERLOAD: Failure(
        "The load is beyond the balance's range.",
        "Take the load off; use a lighter container or insert. On underload, put the pan in place. If the balance "
        "was switched on with something on it, clear the pan and switch it off and on.",
        ("devices",),
    ),
    Code.CONTAINER_MISSING: Failure(
        "No container stands on the pan, or not the expected one.",
        "Put the container on the pan, or fill the changer's slot.",
        ("devices", "run"),
    ),
    Code.CONTAINER_MOVED: Failure(
        "The pan lost mass during a dose.",
        "Check whether the container was touched, tipped or taken away. Begin its dose again with a new container.",
        ("cell",),
    ),
    Code.CONTAINER_CHANGED: Failure(
        "It is not known what the container holds: after an interruption its mass is not possible, or it may be "
        "another one.",
        "Check whether it was touched, tipped, exchanged or taken away. Give the sample a new container "
        "(`on_failure: redo`).",
        ("cell",),
    ),
    Code.CONTAINER_WRONG_MASS: Failure(
        "The mass that was put on the pan is not that of this container.",
        "Check that it is the right container, empty and clean. If its mass has changed, correct "
        "robot/containers.yaml.",
    ),
    Code.CONTAINER_TOO_SMALL: Failure(
        "The mass does not fit into the container.",
        "Ask for less, or choose a larger container.",
    ),
    Code.HAND_CONE_EMPTY: Failure(
        "The cone gives no more powder.",
        "Scoop again (the shipped workflows do).",
    ),
    Code.HAND_WRONG_POWDER: Failure(
        "The cone holds another powder, or the sheet has touched one.",
        "Discard or return what is in the cone and swap the sheet.",
    ),
    Code.HAND_NO_FLOW: Failure(
        "The cone should hold more powder, but none comes out, even with vibration: a bridge, or a poor scoop.",
        "Empty the cone and scoop again (the shipped workflows do). Look for a lump at the apex. Check that the "
        "sheet opens and the motor shakes. Dry or sieve the powder.",
    ),
    Code.HAND_VALVE_STUCK: Failure(
        "The valve does not move; powder may be running out of it.",
        "Hold a vessel under the cone, and empty it by hand. Look for powder, or a fold of the sheet, in the valve.",
        ("devices",),
    ),
    Code.HAND_VALVE_LOST: Failure(
        "The valve's servo does not answer, was without power, or has shut down; powder may be running out of it.",
        "Hold a vessel under the cone; check the hand's supply. The valve shuts as soon as its servo has power.",
        ("devices", "run"),
    ),
    Code.HAND_LEAK: Failure(
        "The pan gains mass though the valve is shut: powder leaks, or the balance was set slower during the dose "
        "and shows earlier powder late.",
        "Hold a vessel under the cone, and empty it. Look for powder in the valve, or a fold or hole in the sheet. "
        "If no powder leaks, check the balance's filter; then resume.",
        ("run",),
    ),
    Code.HAND_ROLLER_LOST: Failure(
        "The roller's servo was without power, or is new here: it is not known how far the sheet is rolled.",
        "Begin or resume a run with a person at the cell. It asks how wide the cone's rim is.",
        ("devices",),
    ),
    Code.SCOOP_NOTHING: Failure(
        "Several scoops in a row from a source brought no powder that comes out. This run scoops from it no more.",
        "Check that the mortar at its station holds the powder and mass that are entered, that no powder bridges "
        "in the cone, that the sheet opens when the valve's servo turns, and that the motor shakes. Then resume. "
        "If the recipe went on without the source, begin a new run with the samples that were not run.",
        ("run",),
    ),
    Code.SOURCE_EMPTY: Failure(
        "The source holds too little powder for a scoop to reach.",
        "Refill the mortar and correct the recipe's amount.",
    ),
    Code.DOSE_OVERSHOOT: Failure(
        "More than the target plus its tolerance has been dispensed; it cannot be taken back.",
        "Discard the container and dose a new one, or accept the mass that was measured.",
    ),
    Code.DOSE_OVERSHOOTS: Failure(
        "As many samples in a row overshot as the recipe's `overshoot_limit` allows: something has changed.",
        "Check the balance's filter (then `scuhand-bt balance forget`), the valve and the powder. Then resume.",
        ("run",),
    ),
    Code.DOSE_RUNAWAY: Failure(
        "The container holds far more than the target, and the valve is still open.",
        "Discard the container's contents. Check whether the valve shuts, and whether the balance reads correctly.",
        ("run",),
    ),
    Code.DOSE_NOT_REACHED: Failure(
        "The dose ended outside its tolerance: it took too many openings, too long, or too many loads that gave "
        "nothing. Or it broke off.",
        "Check that the mortar holds powder, and that none bridges in the cone. The controller `adaptive` gives up "
        "in time for another scoop.",
        ("run",),
    ),
    Code.DOSE_TOO_SMALL: Failure(
        "The target or its tolerance is too small for the balance.",
        "Use a larger tolerance, or a balance with a finer readability.",
    ),
    Code.OPERATOR_REFUSED: Failure(
        "The operator answered no.",
        "Do what was asked, or change the recipe.",
        ("cell", "run"),
    ),
    Code.OPERATOR_ABSENT: Failure(
        "A person was needed, but nobody was there.",
        "Go there, and resume the run from a terminal: it then asks you. Or use the container changer.",
        ("run",),
    ),
    Code.WORKFLOW_TIMEOUT: Failure(
        "A part of the workflow took longer than its `timeout` allows.",
        "Look at what it was waiting for. If that was normal, allow more time.",
        ("tree",),
    ),
    Code.WORKFLOW_BAD_VALUE: Failure(
        "A value on a wire is outside what the skill accepts.",
        "Correct the recipe or the workflow that gave the value.",
        ("tree",),
    ),
    Code.WORKFLOW_INVERTED: Failure(
        "The part of the workflow under `invert` succeeded, so `invert` failed.",
        "This is the workflow's own decision; see the workflow.",
        ("tree",),
    ),
}
