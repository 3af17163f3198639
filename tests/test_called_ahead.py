"""Whoever the next job needs is called as the one before it begins, and can be there when it is asked."""

import io
import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from conftest import Desk
from resuming import Run, Watch
from rich.console import Console
from running import make_lab
from test_answers import WhenAsked
from test_plan import plan_of

from scuhand_bt.cell.believed_powder import MOST_BARREN_LOADS
from scuhand_bt.dashboard.page_state import Page
from scuhand_bt.device_specs.changer import ChangerSpec
from scuhand_bt.journal.follow import Follower
from scuhand_bt.journal.reader import read
from scuhand_bt.recipe.plan import Job
from scuhand_bt.report.live import LiveView, PlainLines
from scuhand_bt.report.picture import Picture
from scuhand_bt.report.watching import shown_of
from scuhand_bt.run.clock import VirtualClock
from scuhand_bt.run.control import Control, say_wish
from scuhand_bt.run.observers import Observers
from scuhand_bt.run.operator import ANSWER_S, AT_HAND, SimulatedOperator
from scuhand_bt.run.simulation import DryRun

COMES_S, DOES_S = ANSWER_S * (1.0 - AT_HAND), ANSWER_S * AT_HAND
ONCE = "workflow: ask\ntree: {ask_operator: {question: Is the shield shut?}}\n"
SOON = "a person is needed soon, at 'b': Is the shield shut?"
RECIPE = "recipe: soon\nsamples: [{id: a, workflow: rest}, {id: b, workflow: ask}, {id: c, workflow: ask}]\n"


PERHAPS = """
workflow: perhaps
tree: {fallback: [{sequence: [{fail: }, {ask_operator: {question: Is the shield shut?}}]}, {wait: {duration: 1 s}}]}
"""
FAILS = "workflow: rest\ntree: {sequence: [{wait: {duration: 5 s}}, {fail: }]}\n"
FAIL = """
from scuhand_bt.skill import Cell, Failure, Skill, SkillFailed, Steps, pause


class Fail(Skill[None]):
    \"\"\"It fails.\"\"\"

    failures = {"fail.always": Failure("It fails.", "Nothing.")}

    def run(self, cell: Cell) -> Steps[None]:
        yield from pause(cell, 0.1)
        raise SkillFailed("fail.always", "as ever")
"""


def make_run(folder: Path, rests_s: float = 5.0, recipe: str = RECIPE, **files: str) -> Run:
    rest = f"workflow: rest\ntree: {{wait: {{duration: {rests_s:g} s}}}}\n"
    run = Run(folder, make_lab(folder / "lab", **{"trees__ask": ONCE, "trees__rest": rest, **files}), recipe)
    run.folder = run.lab_folder / ".scuhand" / "runs"
    return run


def told(run: Run, kind: str) -> list[float]:
    return [row["time_s"] for row in read(run.journal, "event") if row["kind"] == kind]


@pytest.mark.parametrize("rests_s", [0.5 * COMES_S, 2.0 * COMES_S])
def test_who_is_called_comes_while_the_job_before_goes_on(tmp_path: Path, rests_s: float) -> None:
    run = make_run(tmp_path, rests_s)
    assert run.go(Watch()).exit_code == 0
    soon_s, (first_s, second_s), answered_s = (told(run, kind) for kind in ("person_soon", "asked", "answered"))
    assert soon_s == [0.0], "nobody is called while somebody is asked"
    assert answered_s[0] == pytest.approx(max(first_s, COMES_S) + DOES_S, abs=0.1)
    assert answered_s[1] == pytest.approx(second_s + ANSWER_S, abs=0.1)


def test_every_face_tells_of_whom_is_going_to_be_asked_until_that_job_begins(tmp_path: Path) -> None:
    run, lines = make_run(tmp_path), list[str]()
    run.go(Observers(Watch(), PlainLines(lines.append, 3)))
    assert (lines[0], lines.count(SOON)) == (SOON, 1)
    for time_s, soon in ((1.0, SOON), (told(run, "asked")[0], ""), (1000.0, "")):
        now = Follower(run.journal, until_s=time_s)
        assert Page(now).news(is_held=True)["soon"] == soon
        assert now.begun is not None
        assert shown_of(now, now.begun).soon == soon
    plan, _ = run.plan()
    off = SimpleNamespace(latest=None, pan_empty_mg=None, opening_mm=0.0)
    cell: Any = SimpleNamespace(clock=VirtualClock(), balance=off, believed=off, hand=off)
    view = LiveView(Console(file=io.StringIO()), cell, plan, Control(), "SIMULATED")
    shown = []
    for job in plan.jobs:
        view.attempt_started(job, 1)
        shown.append(view.shown())
    assert [one.soon for one in shown] == [SOON, "", ""]
    console = Console(file=io.StringIO(), width=120, height=20)
    console.print(Picture(shown[0]))
    assert SOON in console.file.getvalue()


def test_a_person_elsewhere_is_told_of_the_question_that_is_to_come(tmp_path: Path) -> None:
    run, told_of, program = make_run(tmp_path), tmp_path / "told", tmp_path / "tell"
    program.write_text(f'#!/bin/sh\necho "$(cat)" >> {told_of}\n', encoding="utf-8")
    program.chmod(0o755)
    cell = run.lab_folder / "robot" / "cell.yaml"
    cell.write_text(cell.read_text(encoding="utf-8") + f"\nnotify: {{command: [{program}]}}\n", encoding="utf-8")
    run.go(WhenAsked(lambda: say_wish(run.journal, "stop_now")), simulation=DryRun(asks=True))
    notices = [json.loads(line) for line in told_of.read_text(encoding="utf-8").splitlines()]
    told_by = {one["state"]: one["reason"] for one in notices}
    assert (told_by["person soon"], told_by["needs person"]) == (SOON, "Is the shield shut?")


def test_a_resumed_run_calls_again_for_what_is_still_to_come(tmp_path: Path) -> None:
    run = make_run(tmp_path)
    assert run.go(Watch("stop_now", 1)).exit_code == 130
    stopped = Follower(run.journal)
    stopped.look()
    assert stopped.soon is None, "nobody is asked by a run that stands still"
    assert run.go(Watch(), resumes=True).exit_code == 0
    assert len(told(run, "person_soon")) == 2
    assert run.go(Watch("stop", 1)).exit_code == 130
    assert run.go(Watch(), resumes=True).exit_code == 0
    assert len(told(run, "person_soon")) == 1, "what was over before it was resumed calls nobody"


def test_who_was_called_and_not_asked_has_gone_when_that_job_is_over(tmp_path: Path) -> None:
    recipe = RECIPE.replace("id: b, workflow: ask", "id: b, workflow: perhaps")
    run = make_run(tmp_path, 2.0 * COMES_S, recipe, trees__perhaps=PERHAPS, skills__fail=FAIL)
    assert run.go(Watch()).exit_code == 0
    assert told(run, "person_soon") == [0.0]
    (asked_s,), (answered_s,) = told(run, "asked"), told(run, "answered")
    assert answered_s == pytest.approx(asked_s + ANSWER_S, abs=0.1)


def test_a_run_that_is_resumed_within_what_is_done_once_more_calls_again(tmp_path: Path) -> None:
    class Redone(Watch):
        def attempt_started(self, job: Job, attempt: int) -> None:
            if attempt == 2:
                self.session.control.wish("stop_now")

    again = f"{RECIPE}on_failure: {{fail.always: redo}}\n"
    run = make_run(tmp_path, recipe=again, trees__rest=FAILS, skills__fail=FAIL)
    assert run.go(Redone()).exit_code == 130
    assert len(told(run, "person_soon")) == 1, "both attempts are one job"
    run.go(Watch(), resumes=True)
    assert len(told(run, "person_soon")) == 2


def test_a_sample_that_is_left_out_waits_for_nobody(tmp_path: Path) -> None:
    class NothingComes(Watch):
        def attempt_started(self, job: Job, attempt: int) -> None:
            believed, beads = self.session.cell.believed, self.session.plan.recipe.sources["beads"]
            for _ in range(MOST_BARREN_LOADS if job.name == "a" else 0):
                believed.scooped(beads, 4000.0)
                believed.dosing_ended(0.0, 0.0)
                believed.gave_out(is_short=False)
                believed.emptied()

    recipe = "order: as_written\n" + RECIPE.replace(
        "workflow: ask}, {id: c, workflow: ask", "workflow: ask_of, source: beads}, {id: c, workflow: rest"
    )
    ask_of = ONCE.replace("workflow: ask\n", "workflow: ask_of\ninputs: {source: Source}\n")
    run = make_run(tmp_path, recipe=recipe, trees__ask_of=ask_of)
    run.go(NothingComes())
    assert (told(run, "person_soon"), told(run, "asked")) == ([0.0], [])
    for time_s, soon in ((1.0, SOON), (6.0, "")):
        assert Page(Follower(run.journal, until_s=time_s)).news(is_held=True)["soon"] == soon
    assert Page(Follower(run.journal, until_s=1.0)).news(is_held=False)["soon"] == "", "it was killed"


def test_who_was_called_takes_as_long_to_do_what_shows_by_itself() -> None:
    clock, done_s = VirtualClock(), list[float]()
    person = SimulatedOperator(clock, lambda event: None)
    person.expect()
    clock.now_s = 2.0 * COMES_S
    asking = person.ask_until("Off with it", ("off", "stop"), lambda: bool(done_s), lambda: done_s.append(clock.now_s))
    for wake in asking:
        clock.wait([wake])
    assert done_s == [pytest.approx(2.0 * COMES_S + DOES_S)]


def test_where_every_job_needs_a_person_nobody_is_called(desk: Desk) -> None:
    by_hand = replace(desk.lab, cell=desk.lab.cell.model_copy(update={"changer": ChangerSpec(driver="operator")}))
    plan, of_hands = plan_of(desk), plan_of(Desk(desk.folder, by_hand))
    called = [plan.soon(job) for job in plan.jobs]
    assert [one and one.job for one in called] == [None, plan.jobs[2].name, None, None, None]
    assert called[1] is not None
    assert "swap the sheet" in called[1].what
    needed = {person.job for person in of_hands.persons}
    assert {job.name for job in of_hands.jobs if job.sample} <= needed
    assert not any(of_hands.soon(job) for job in of_hands.jobs[:-1])
