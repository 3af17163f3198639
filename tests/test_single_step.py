"""`run --step` asks before each action, and `--slow` derates what moves."""

import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from running import make_lab, shared_planner

from scuhand_bt.devices.interfaces import Trajectory
from scuhand_bt.exit_codes import ExitCode
from scuhand_bt.journal.reader import read
from scuhand_bt.lab import Lab, load_lab
from scuhand_bt.motion.kinematics import JOINTS
from scuhand_bt.recipe.plan import Plan, make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.run.observers import BatchObserver
from scuhand_bt.run.options import Options, options_of
from scuhand_bt.run.outcome import BatchResult
from scuhand_bt.run.questions import Question, Who
from scuhand_bt.run.resume import checked_history, resumable
from scuhand_bt.run.session import Session
from scuhand_bt.run.simulation import DryRun

RECIPE = "recipe: walk\nworkflow: mine\nsamples:\n  - {id: a}\n"
WALK = "workflow: mine\ntree:\n  sequence:\n    - tour:\n    - wait: {duration: 1 s}\n    - park:\n"
BESIDE = "workflow: mine\ntree:\n  parallel:\n    - wait: {duration: 1 s}\n    - tour:\n"
BESIDE_IN_TIME = (
    "workflow: mine\ntree:\n  parallel:\n"
    "    - timeout: {duration: 0.3 s, child: {wait: {duration: 0.5 s}}}\n    - tour:\n"
)
THEN_LATE = (
    "workflow: mine\ntree:\n  sequence:\n"
    "    - wait: {duration: 0.1 s}\n    - optional: {timeout: {duration: 0.3 s, child: {wait: {duration: 9 s}}}}\n"
)
IN_TIME = "workflow: mine\ntree:\n  timeout: {duration: 0.3 s, child: {wait: {duration: 0.1 s}}}\n"


class Answering(BatchObserver):
    """The person at the cell, who says `go` to the first `goes` questions and then `stop`."""

    def __init__(self, goes: int = 99, after_s: float = 0.0) -> None:
        self.asked: list[Question] = []
        self._goes, self._after_s = goes, after_s

    def ticked(self, root: Any) -> None:
        question = self.session.control.questions.waiting
        if question is None or question in self.asked:
            return
        self.asked.append(question)
        answer = "go" if len(self.asked) <= self._goes else "stop"
        said = (question.number, answer, Who("Eve"))
        threading.Timer(self._after_s, lambda: self.session.control.questions.give(*said)).start()

    session: Session


class Walk:
    """A workflow without powder, in a lab of its own."""

    def __init__(self, folder: Path, tree: str) -> None:
        self.lab: Lab = load_lab(make_lab(folder / "lab", trees__mine=tree))
        recipe = folder / "recipe.yaml"
        recipe.write_text(RECIPE, encoding="utf-8")
        self.plan: Plan = make_plan(load_recipe(recipe, self.lab), self.lab)
        self.folder = folder / "runs"
        self.motions: list[Trajectory] = []

    def go(self, person: Answering, options: Options, resumes: Any = None) -> BatchResult:
        motion = shared_planner(self.plan, self.lab) if options.slow_ratio == 1.0 else None
        session = Session(self.plan, self.lab, options, motion, resumes=resumes)
        person.session, self.journal = session, session.journal.path
        session.cell.arm.on_start = self.motions.append
        try:
            return session.run(person)
        finally:
            session.close()

    def step(self, person: Answering) -> BatchResult:
        return self.go(person, Options(DryRun(asks=True), folder=self.folder, single_step=True))

    def told(self) -> list[str]:
        """What was asked, answered and begun, in its order."""
        rows = [row for row in read(self.journal, "event") if row["kind"] in ("asked", "answered")]
        shown = {row["id"]: row["payload"].get("answer") or row["payload"]["question"] for row in rows}
        shown |= {row["id"]: row["skill"] for row in read(self.journal, "action")}
        return [shown[number] for number in sorted(shown)]


def test_every_action_begins_after_the_person_has_said_go_to_it(tmp_path: Path) -> None:
    walk = Walk(tmp_path, WALK)
    assert walk.step(Answering()).exit_code == 0
    told = walk.told()
    assert told[1::3] == ["go"] * 3
    assert told[2::3] == ["tour", "wait", "park"]
    assert [question.split(".")[0] for question in told[0::3]] == [
        "Next: tour",
        "Next: wait (duration: 1 s)",
        "Next: park",
    ]


def test_stop_ends_the_run_before_the_action_and_it_is_resumed_in_single_step_from_there(tmp_path: Path) -> None:
    walk = Walk(tmp_path, WALK)
    stopped = walk.step(Answering(goes=1))
    assert stopped.exit_code == ExitCode.INTERRUPTED
    assert [row["skill"] for row in read(walk.journal, "action")] == ["tour"]
    history = checked_history(walk.journal)
    options, person = options_of(history, walk.folder), Answering()
    found = resumable(walk.journal, history, walk.plan, walk.lab, accept_changes=False)
    assert walk.go(person, options, found).exit_code == 0
    assert [question.text.split(" ")[1] for question in person.asked] == ["wait", "park."]
    assert [row["skill"] for row in read(walk.journal, "action")] == ["tour", "wait", "park"]


def test_actions_side_by_side_are_asked_for_one_after_the_other(tmp_path: Path) -> None:
    walk, person = Walk(tmp_path, BESIDE), Answering()
    assert walk.step(person).exit_code == 0
    assert len(person.asked) == 2
    assert walk.told()[1:3] == ["go", "wait"], "the first may begin before the second is asked for"


def test_no_timeout_ends_what_a_person_still_thinks_about(tmp_path: Path) -> None:
    walk = Walk(tmp_path, IN_TIME)
    assert walk.step(Answering(after_s=0.6)).exit_code == 0


def test_a_slow_run_keeps_to_its_share_of_every_joints_speed(tmp_path: Path) -> None:
    walk = Walk(tmp_path, WALK)
    walk.go(Answering(), Options(DryRun(), folder=walk.folder, slow_ratio=0.2))
    fastest = walk.lab.motion_planner({}).rates.speed
    shares = [_fastest(motion) / fastest for motion in walk.motions if motion.duration_s > 0.0]
    assert len(shares) >= 3
    assert 0.19 < max(share.max() for share in shares) <= 0.2 + 1e-6


def test_arm_roller_and_changer_are_slow_and_the_valve_doses_as_ever(tmp_path: Path) -> None:
    cell = Walk(tmp_path, WALK).lab.cell
    slow = cell.slowed(0.25)
    assert slow.arm.speed_ratio == 0.25 * cell.arm.speed_ratio
    assert slow.hand.morph_speed_mm_per_s == 0.25 * cell.hand.morph_speed_mm_per_s
    assert slow.changer.options.slot_s == 4 * cell.changer.options.slot_s
    assert slow.hand.valve_speed_mm_per_s == cell.hand.valve_speed_mm_per_s
    assert slow.slowed(4.0) == cell


@pytest.mark.parametrize("slow", ["20", "4 %", "120 %", "0.2 mm", "nan"])
def test_a_share_that_is_none_is_refused(command: Any, slow: str) -> None:
    ended = command("run", "recipes/start_of_day.yaml", "--dry-run", "--slow", slow)
    assert ended.returncode == ExitCode.BAD_INPUT
    assert "--slow" in ended.stderr


def _fastest(motion: Trajectory) -> Any:
    """The highest speed of each joint [rad/s]."""
    times_s, step_s = np.linspace(0.0, motion.duration_s, 400, retstep=True)
    joints = np.array([motion.sample(time_s)[:JOINTS] for time_s in times_s])
    return np.abs(np.diff(joints, axis=0)).max(axis=0) / step_s


def test_no_timeout_ends_what_goes_on_beside_a_question(tmp_path: Path) -> None:
    walk = Walk(tmp_path, BESIDE_IN_TIME)
    assert walk.step(Answering(after_s=0.6)).exit_code == 0


def test_a_timeout_has_its_own_time_after_a_person_has_thought(tmp_path: Path) -> None:
    walk = Walk(tmp_path, THEN_LATE)
    assert walk.step(Answering(after_s=0.4)).exit_code == 0
    (late,) = (row for row in read(walk.journal, "action") if row["outcome"] == "halted")
    assert 0.3 <= late["ended_s"] - late["started_s"] < 0.35
