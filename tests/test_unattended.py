"""Who is needed, and when: the policy `ask`, and unattended runs, which need nobody or are refused."""

from pathlib import Path
from typing import Any

import pytest
from conftest import Desk, LabFolder, problems_of
from quiet_skill import QUIET
from running import Watching, make_lab, shared_planner

from scuhand_bt.failures import SkillFailed
from scuhand_bt.lab import load_lab
from scuhand_bt.recipe.plan import Plan, check_unattended, make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.run.operator import Nobody
from scuhand_bt.run.options import Options
from scuhand_bt.run.outcome import BatchResult
from scuhand_bt.run.resume import Resumable, checked_history, find_run, resumable
from scuhand_bt.run.session import Session
from scuhand_bt.run.simulation import DryRun

RECIPE = """\
recipe: one
workflow: scoop_and_dispense
sources:
  beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 5 g}
defaults: {source: beads, container: xrd_holder, mass: 50 mg}
samples:
  - {id: a}
  - {id: b}
"""


def plan_of(desk: Desk, more: str = "") -> Plan:
    return make_plan(desk.load(RECIPE + more), desk.lab)


def refusals(plan: Plan) -> list[str]:
    return problems_of(lambda: check_unattended(plan))


def test_a_plan_that_needs_nobody_may_run_unattended(desk: Desk) -> None:
    assert refusals(plan_of(desk)) == []


def test_ask_is_an_action_and_the_plan_says_when_a_person_may_be_asked(desk: Desk) -> None:
    plan = plan_of(desk, "on_failure: {hand.no_flow: ask, otherwise: ask}\n")
    assert plan.recipe.action_for("hand.no_flow") == plan.recipe.action_for("arm.no_path") == "ask"
    assert plan.recipe.action_for("dose.overshoot") == "flag"
    assert [f"A person is {person}." for person in plan.persons] == [
        "A person is perhaps needed: to say what to do if a sample fails with hand.no_flow.",
        "A person is perhaps needed: to say what to do if a sample fails in any other way.",
    ]


def test_an_action_that_is_none_lists_those_that_are(desk: Desk) -> None:
    (problem,) = desk.problems(RECIPE + "on_failure: {otherwise: asks}\n")
    assert problem == ("9:25: 'asks' is not an action; known: ask, flag, redo, skip_sample, stop; did you mean 'ask'?")


def test_an_unattended_plan_with_ask_is_refused_where_the_policy_stands(desk: Desk) -> None:
    assert refusals(plan_of(desk, "on_failure: {hand.no_flow: ask}\n")) == [
        "9:28: an unattended run cannot wait for a person, but one is perhaps needed: "
        "to say what to do if a sample fails with hand.no_flow"
    ]


def test_each_place_that_needs_a_person_is_told_once(desk: Desk, lab_folder: LabFolder) -> None:
    lab_folder.replace("robot/cell.yaml", "driver: carousel", "driver: operator")
    lab_folder.replace("trees/after_failure.yaml", "    - park:", "    - ask_operator: {question: Look}\n    - park:")
    desk.lab = lab_folder.load()
    told = refusals(plan_of(desk))
    assert [
        line.split(": ", 1)[1].removeprefix("an unattended run cannot wait for a person, but one is ") for line in told
    ] == [
        "perhaps needed: Look, after a failed sample",
        "needed at 'finish the batch': take the container off the pan",
        "needed at 'a': put xrd_holder 'a' on the pan (and 1 more like it)",
    ]


def test_a_changer_that_must_be_filled_again_needs_a_person(desk: Desk, lab_folder: LabFolder) -> None:
    lab_folder.replace("robot/cell.yaml", "slots: 24", "slots: 1")
    desk.lab = lab_folder.load()
    (told,) = refusals(plan_of(desk))
    assert "needed at 'b': fill the changer again (it holds 1)" in told


@pytest.mark.parametrize("asks", [True, False])
def test_what_no_plan_foresees_fails_instead_of_waiting(tmp_path: Path, asks: bool) -> None:
    lab = load_lab(make_lab(tmp_path / "lab", skills__quiet=QUIET, trees__ask="workflow: ask\ntree: {quiet: }\n"))
    path = tmp_path / "recipe.yaml"
    path.write_text("recipe: ask\nworkflow: ask\nsamples: [{id: a}]\n")
    plan = make_plan(load_recipe(path, lab), lab)
    options = Options(DryRun(), folder=tmp_path / "runs", unattended=not asks)
    session = Session(plan, lab, options, shared_planner(plan, lab))
    try:
        result = session.run(Watching())
    finally:
        session.close()
    assert result.exit_code == (0 if asks else 3)
    assert result.samples[0].code == (None if asks else "operator.absent")


REDO = """\
recipe: redo
workflow: scoop_and_dispense
sources: {beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 20 g}}
defaults: {source: beads, container: pellet_die_13mm, mass: 100 mg}
samples: [{id: a}, {id: b}]
on_failure: {dose.overshoot: redo, otherwise: stop}
overshoot_limit: 0
"""


@pytest.mark.parametrize(
    ("slots", "unattended", "again"),
    [
        ("2", True, []),
        ("3", True, ["a"]),
        ("{xrd_holder: 9, pellet_die_13mm: 2}", True, []),
        ("{xrd_holder: 1, pellet_die_13mm: 4}", True, ["a", "b"]),
        ("2", False, ["a", "b"]),
    ],
)
def test_unattended_no_sample_is_done_once_more_in_what_another_one_needs(
    lab_folder: LabFolder, tmp_path: Path, slots: str, unattended: bool, again: list[str]
) -> None:
    """The last sample had no container, and nobody was there to fill the changer."""
    lab_folder.replace("robot/cell.yaml", "slots: 24", f"slots: {slots}")
    lab = lab_folder.load()
    plan = make_plan(load_recipe(lab_folder.write("recipes/redo.yaml", REDO), lab), lab)
    options = Options(DryRun(plant="batch_bench:Gusher"), "paper", tmp_path / "runs", unattended=unattended)
    session = Session(plan, lab, options, shared_planner(plan, lab))
    try:
        result = session.run(Watching())
    finally:
        session.close()
    assert [(one.verdict, one.code) for one in result.samples] == [("over", "dose.overshoot")] * 2
    assert [one.id for one in result.samples if one.attempt == 2] == again
    said = "not done again: the changer has no container to spare, and nobody is there to fill it"
    assert [said in one.detail for one in result.samples] == [one.id not in again for one in result.samples]


class StopsAgain(Watching):
    """Stops the run when a sample is being done once more, its container on the pan."""

    def ticked(self, root: Any) -> None:
        super().ticked(root)
        assert self.session is not None
        pan = self.session.cell.believed.pan
        if pan is not None and pan.id == "a#2":
            self.session.control.wish("stop_now")


def test_what_was_begun_once_more_is_gone_on_with(lab_folder: LabFolder, tmp_path: Path) -> None:
    lab_folder.replace("robot/cell.yaml", "slots: 24", "slots: 3")
    lab, runs = lab_folder.load(), tmp_path / "runs"
    plan = make_plan(load_recipe(lab_folder.write("recipes/redo.yaml", REDO), lab), lab)
    options = Options(DryRun(plant="batch_bench:Gusher"), "paper", runs, unattended=True)

    def run(watching: Watching, found: Resumable | None = None) -> BatchResult:
        watching.session = Session(plan, lab, options, shared_planner(plan, lab), resumes=found)
        try:
            return watching.session.run(watching)
        finally:
            watching.session.close()

    stopped = run(StopsAgain()).samples[0]
    assert (stopped.attempt, stopped.verdict) == (2, "interrupted")
    path = find_run(runs, "last")
    a, b = run(Watching(), resumable(path, checked_history(path), plan, lab, accept_changes=False)).samples
    assert (a.attempt, a.verdict, b.attempt) == (2, "over", 1)


def test_nobody_answers_with_a_failure_at_once() -> None:
    with pytest.raises(SkillFailed, match="Press the button") as caught:
        Nobody().ask("Press the button")
    assert caught.value.code == "operator.absent"
