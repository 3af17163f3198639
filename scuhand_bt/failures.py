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
        "The arm touches something (in the model) where it stands, and cannot go out of it by itself.",
        "Hold the arm, switch its supply off, lead it clear, supply on, resume; or correct robot/cell.yaml's geometry.",
        ("cell", "motion"),
    ),
    Code.ARM_JOINT_LIMIT: Failure(
        "A joint is, or would go, beyond its limit.",
        "Move the joint back inside its range by hand and start again.",
        ("motion", "devices"),
    ),
    Code.ARM_IN_THE_WAY: Failure(
        "The arm stands where something else is to move, as over the pan while a container is to be changed.",
        "Put `park:` before `place_container` in the workflow.",
        ("cell", "tree"),
    ),
    Code.ARM_ZONE_TAKEN: Failure(
        "The arm was to go into a zone of the cell, or to leave it, and something else did not end there.",
        "Look at the cell; in the workflow, put what goes into the zone behind the `parallel`, not into it.",
        ("cell",),
    ),
    Code.ARM_NOT_OVER_PAN: Failure(
        "Powder was to be let out, and the cone is not over the mouth of the container on the pan.",
        "Put `move_over:` before `dispense` in the workflow, and behind each `scoop` or `park`.",
    ),
    Code.ARM_NOT_FOLLOWING: Failure(
        "The arm is not where its trajectory says it should be.",
        "Look for what blocks it; check the servos' temperatures and supply.",
        ("devices",),
    ),
    Code.ARM_LIMP: Failure(
        "The arm, or the hand's roller, has no torque, or no servo answers any more: its supply is or was off.",
        "Support the arm, look where the cone's load went, clear the way; switch the supply on, then resume.",
        ("devices", "run"),
    ),
    Code.COMPUTER_BUSY: Failure(
        "This computer did not give the run its time, and what moved was stopped. Nothing was in the arm's way.",
        "Close what else runs here, give the run more cores or `nice -n -5`; `scuhand-bt doctor` measures it.",
        ("devices",),
    ),
    Code.SERVO_OVERLOAD: Failure(
        "A servo has shut down on overload or heat.",
        "Support the arm, free it, let it cool; switch its supply off and on.",
        ("devices",),
    ),
    Code.DEVICE_LOST: Failure(
        "A device no longer answers.",
        "Check its cable and supply, then start again.",
        ("devices", "run"),
    ),
    Code.DEVICE_BUSY: Failure(
        "A device did not stop in the time it should, or is still at work.",
        "Look at the cell; if it stands still, start again.",
        ("devices", "tree", "run"),
    ),
    Code.DEVICE_EMERGENCY_STOP: Failure(
        "The emergency stop is, or was, pressed: the valve closed and vibration stopped.",
        "Make the cell safe, release the emergency stop, and start again.",
        ("devices",),
    ),
    Code.BALANCE_UNSTABLE: Failure(
        "The balance did not settle in time.",
        "Close the draft shield, look for vibration, draughts, a touching container; if it creeps, for its filter.",
        ("devices", "cell"),
    ),
    Code.BALANCE_COARSE: Failure(
        "The balance shows finer digits than it weighs, holds back small changes, or stands still.",
        "Set its readability in robot/cell.yaml to what it resolves; switch off its hold, its stable-display filter.",
    ),
    Code.BALANCE_DRIFTING: Failure(
        "Two weighings of one thing, one after the other, went on differing: a mass cannot be told.",
        "Let the container come to the room's temperature, ground it, close the draft shield, let the balance warm up; "
        "where it only grows, see whether the shut valve leaks: `hand.leak` tells leaks from 1 mg/s.",
        ("cell",),
    ),
    Code.BALANCE_SLOW: Failure(
        "The balance shows a load so late that no dose can be stopped in time.",
        "Set its filter (response, environment) to a quicker one; `scuhand-bt balance` shows what is known of it.",
        ("cell",),
    ),
    Code.BALANCE_BRACKET_OPEN: Failure(
        "What the container has gained by the bare pan before and after it is not what was dosed into it.",
        "Weigh the container again by hand; look for powder beside it, a leaking valve, and a zero that steps: a "
        "display that is renewed less often than the balance's `period` in robot/cell.yaml says looks like one, and so "
        "does a powder that comes charged or warm.",
        ("run",),
    ),
    Code.BALANCE_OVERLOAD: Failure(
        "The load is beyond the balance's range.",
        "Take the load off; use a lighter container or insert. In underload: put the pan in place; or, if it was "
        "switched on with something on it, clear the pan and switch it off and on.",
        ("devices",),
    ),
    Code.CONTAINER_MISSING: Failure(
        "No container stands on the pan, or another one than should.",
        "Put the container on the pan, or fill the changer's slot.",
        ("devices", "run"),
    ),
    Code.CONTAINER_MOVED: Failure(
        "The pan lost mass while a dose was going on.",
        "See whether the container was touched, tipped or taken away; begin its dose again with a new one.",
        ("cell",),
    ),
    Code.CONTAINER_CHANGED: Failure(
        "After an interruption the container on the pan weighs what it cannot, or is another one.",
        "See whether it was touched, tipped, exchanged or taken away; give the sample a new one (`on_failure: redo`).",
        ("cell",),
    ),
    Code.CONTAINER_WRONG_MASS: Failure(
        "What was put on the pan does not weigh what this container should.",
        "Check that it is the right container, empty and clean; correct robot/containers.yaml if it changed.",
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
        "The cone holds, or the sheet has touched, another powder.",
        "Discard or return what is in the cone and swap the sheet.",
    ),
    Code.HAND_NO_FLOW: Failure(
        "The cone should hold more powder, but none comes out, even with vibration: a bridge, or a poor scoop.",
        "Let it out and scoop again (the shipped workflows do); look for a lump at the apex, and whether the sheet "
        "opens and the motor shakes. Dry or sieve the powder.",
    ),
    Code.HAND_VALVE_STUCK: Failure(
        "The valve does not move; powder may be running out of it.",
        "Hold a vessel under the cone, empty it by hand, and look for powder or a fold of the sheet in the valve.",
        ("devices",),
    ),
    Code.HAND_VALVE_LOST: Failure(
        "The valve's servo does not answer, was without power, or has shut down; powder may be running out of it.",
        "Hold a vessel under the cone; check the hand's supply. The valve shuts as soon as its servo has power.",
        ("devices", "run"),
    ),
    Code.HAND_LEAK: Failure(
        "Powder runs onto the pan though the valve is shut, or late, on a balance that was set slower in the dose.",
        "Hold a vessel under the cone and empty it; look for powder in the valve, or a fold or hole in the sheet. "
        "Where nothing runs, look at the balance's filter; then resume.",
        ("run",),
    ),
    Code.HAND_ROLLER_LOST: Failure(
        "The roller's servo was without power, or is new here: nobody knows how far the sheet is rolled.",
        "Begin or resume a run with a person at the cell: it asks how wide the cone's rim is.",
        ("devices",),
    ),
    Code.SCOOP_NOTHING: Failure(
        "Scoops in a row brought nothing that comes out: the source is not scooped from any more in this run.",
        "See that the mortar holds what is written, at its station, that none bridges in the cone, that the sheet "
        "opens when the valve's servo turns, and that the motor shakes; then resume, or, where the recipe went on "
        "without the source, begin a new run of the samples that were not run.",
        ("run",),
    ),
    Code.SOURCE_EMPTY: Failure(
        "The source holds less than a scoop can reach.",
        "Refill the mortar and correct the recipe's amount.",
    ),
    Code.DOSE_OVERSHOOT: Failure(
        "More than the target plus its tolerance has been dispensed; it cannot be taken back.",
        "Discard and dose a new container, or accept the mass that was measured.",
    ),
    Code.DOSE_OVERSHOOTS: Failure(
        "Samples in a row overshot, as many as the recipe's `overshoot_limit` allows: something is not what it was.",
        "Look at the balance's filter (and say `scuhand-bt balance forget`), the valve and the powder; then resume.",
        ("run",),
    ),
    Code.DOSE_RUNAWAY: Failure(
        "Far more than the target is in the container, and the valve is still open.",
        "Discard the container's content; look whether the valve shuts, and whether the balance reads true.",
        ("run",),
    ),
    Code.DOSE_NOT_REACHED: Failure(
        "The dose stopped outside its tolerance, as no dose takes more openings, longer, or more loads in vain; or it "
        "broke off.",
        "See that the mortar holds powder, and none bridges; controller `adaptive` gives up in time for another scoop.",
        ("run",),
    ),
    Code.DOSE_TOO_SMALL: Failure(
        "The target or its tolerance is below what the balance can tell.",
        "Ask for a larger tolerance, or use a balance with a finer readability.",
    ),
    Code.OPERATOR_REFUSED: Failure(
        "The operator answered no.",
        "Do what was asked, or change the recipe.",
        ("cell", "run"),
    ),
    Code.OPERATOR_ABSENT: Failure(
        "A person was needed and none was there.",
        "Run with a person at the cell, or use the container changer.",
        ("run",),
    ),
    Code.WORKFLOW_TIMEOUT: Failure(
        "A part of the workflow took longer than its `timeout` allows.",
        "Look at what it was waiting for; allow it more time if that was normal.",
        ("tree",),
    ),
    Code.WORKFLOW_BAD_VALUE: Failure(
        "A value on a wire is outside what the skill accepts.",
        "Correct the recipe or the workflow that gave the value.",
        ("tree",),
    ),
    Code.WORKFLOW_INVERTED: Failure(
        "What stands under `invert` succeeded, and so `invert` failed.",
        "This is the workflow's own decision; see the workflow.",
        ("tree",),
    ),
}
