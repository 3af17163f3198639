"""Samples in a row that overshoot stop the batch: something is not what it was."""

import re
from pathlib import Path
from typing import Any

import pytest
from conftest import Call, LabFolder, problems_of
from daily import first_daily
from numpy.random import Generator
from running import HEAD, Ran, Watching, dry_run, shared_planner

from scuhand_bt.exit_codes import ExitCode
from scuhand_bt.journal.results import SampleResult
from scuhand_bt.lab import Lab
from scuhand_bt.recipe.plan import Plan, make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.run.options import Options
from scuhand_bt.run.outcome import BatchResult
from scuhand_bt.run.resume import checked_history, resumable
from scuhand_bt.run.session import Session
from scuhand_bt.run.simulation import DryRun
from scuhand_bt.sim.powder import OurPowderFlow
from scuhand_bt.specs import Powder

SIX = """
recipe: six
workflow: scoop_and_dispense
defaults: {container: pellet_die_13mm, mass: 50 mg, tolerance: 5 mg}
samples:
  - {id: a, source: beads}
  - {id: b, source: beads}
  - {id: c, source: msg}
  - {id: d, source: msg}
  - {id: e, source: msg}
  - {id: f, source: msg}
order: as_written
on_failure: {dose.overshoot: POLICY, otherwise: stop}
"""


class Gushing:
    """A plant in which some loads, counted from 1, gush: each sample scoops one."""

    loads: frozenset[int] = frozenset()
    seen = 0

    class Flow(OurPowderFlow):
        def __init__(self, powder: Powder, plant: "Gushing") -> None:
            super().__init__(powder)
            self._plant, self._number = plant, 0

        def step(self, dt_s: float, opening_mm: float, vibration: float, in_cone_mg: float, rng: Generator) -> float:
            if self._number == 0:
                type(self._plant).seen += 1
                self._number = type(self._plant).seen
            if self._number - PROBED in self._plant.loads and opening_mm > 0.0:
                return min(in_cone_mg, 40.0)
            return super().step(dt_s, opening_mm, vibration, in_cone_mg, rng)

    def flow(self, powder: Powder) -> OurPowderFlow:
        return self.Flow(powder, self)


PROBED = 2
"""Flows that are tried before a run: one for each powder."""


def run(tmp_path: Path, loads: set[int], recipe: str = SIX, policy: str = "flag", faults: str | None = None) -> Ran:
    Gushing.loads, Gushing.seen = frozenset(loads), 0
    recipe = recipe.replace("POLICY", policy)
    return dry_run(tmp_path, recipe, plant=f"{__name__}:Gushing", controller="adaptive", faults=faults)


def codes(ran: Any) -> list[str | None]:
    return [sample.code if sample.verdict != "not run" else "not run" for sample in ran.samples]


@pytest.mark.parametrize("policy", first_daily("skip_sample", "flag"))
def test_two_samples_in_a_row_that_overshot_stop_the_batch_whatever_their_powder(tmp_path: Path, policy: str) -> None:
    ran = run(tmp_path, {2, 3}, policy=policy)
    assert codes(ran.result) == [None, "dose.overshoot", "dose.overshoot", "not run", "not run", "not run"]
    assert (ran.result.exit_code, ran.result.is_complete) == (ExitCode.CELL_FAULT, False)
    words = r"dose\.overshoots: samples overshot in a row: b by (\d+\.\d) mg, c by (\d+\.\d) mg"
    told = re.fullmatch(words, ran.result.reason or "")
    assert told is not None
    by_mg = [ran.sample(name).overshot_mg for name in "bc"]  # by now the bare pan has confirmed them
    assert [float(mg) for mg in told.groups()] == pytest.approx(by_mg, abs=0.2)
    assert by_mg[0] > 2.0


@pytest.mark.slow
def test_overshoots_with_a_good_sample_between_them_do_not_stop_it(tmp_path: Path) -> None:
    ran = run(tmp_path, {2, 4, 6})
    assert codes(ran.result) == [None, "dose.overshoot", None, "dose.overshoot", None, "dose.overshoot"]
    assert ran.result.exit_code == ExitCode.FLAGGED


@pytest.mark.slow
def test_a_sample_that_was_not_dosed_is_no_good_one_between_two_overshoots(tmp_path: Path) -> None:
    recipe = SIX.replace("otherwise: stop", "container.wrong_mass: skip_sample, otherwise: stop")
    ran = run(tmp_path, {1, 2}, recipe, faults="faults: [{fault: container.wrong, sample: b}]")
    told = ["dose.overshoot", "container.wrong_mass", "dose.overshoot", "not run", "not run", "not run"]
    assert codes(ran.result) == told


@pytest.mark.slow
@pytest.mark.parametrize(("limit", "dosed"), first_daily((3, 4), (0, 6), (1, 2)))
def test_the_recipe_says_how_many(tmp_path: Path, limit: int, dosed: int) -> None:
    ran = run(tmp_path, {2, 3, 4, 5, 6}, SIX + f"overshoot_limit: {limit}\n")
    assert [code for code in codes(ran.result) if code != "not run"] == [None, *["dose.overshoot"] * (dosed - 1)]


@pytest.mark.slow
def test_a_sample_that_is_done_again_counts_once_and_by_its_last_container(tmp_path: Path) -> None:
    ran = run(tmp_path, {1, 3}, policy="redo")
    assert codes(ran.result) == [None] * 6, "twice over, and good the second time each"
    again = tmp_path / "again"
    again.mkdir()
    ran = run(again, {1, 2}, policy="redo")
    assert codes(ran.result) == ["dose.overshoot", *[None] * 5], "over in both of its containers is one sample"


@pytest.mark.parametrize(("later", "completes"), first_daily(({3, 4}, False), (set[int](), True), ({3}, True)))
def test_a_run_that_was_stopped_for_it_is_resumed_and_counts_anew(
    tmp_path: Path, starter: Lab, later: set[int], completes: bool
) -> None:
    stopped = run(tmp_path, {1, 2})
    assert codes(stopped.result)[2:] == ["not run"] * 4
    result = resumed(tmp_path, starter, stopped.journal, later)
    assert result.is_complete == completes
    told = [None if name not in later else "dose.overshoot" for name in (3, 4, 5, 6)]
    assert codes(result)[2:] == (told if completes else [*told[:2], "not run", "not run"])


def test_a_run_that_broke_off_before_it_was_stopped_for_it_is_so_once_it_is_resumed(
    tmp_path: Path, starter: Lab
) -> None:
    """As its cone was emptied after the second one; nobody was told, and it went on."""

    class Ending(Watching):
        def sample_ended(self, result: SampleResult) -> None:
            if result.id == "b" and self.session is not None:
                self.session.control.wish("stop_now")

    plan = plan_of(tmp_path, starter, SIX.replace("POLICY", "flag") + HEAD)
    Gushing.loads, Gushing.seen = frozenset({1, 2}), 0
    options = Options(DryRun(plant=f"{__name__}:Gushing"), "adaptive", tmp_path / "runs")
    session = Session(plan, starter, options, shared_planner(plan, starter))
    try:
        broke_off = session.run(Ending(session))
    finally:
        session.close()
    assert (codes(broke_off)[:2], broke_off.exit_code) == (["dose.overshoot"] * 2, ExitCode.INTERRUPTED)
    told = resumed(tmp_path, starter, session.journal.path, set())
    assert told.reason.startswith("dose.overshoots: samples overshot in a row: a by")
    assert codes(told)[2:] == ["not run"] * 4
    assert resumed(tmp_path, starter, session.journal.path, set()).is_complete, "somebody has looked"


def plan_of(tmp_path: Path, lab: Lab, recipe: str) -> Plan:
    (tmp_path / "recipe.yaml").write_text(recipe, encoding="utf-8")
    return make_plan(load_recipe(tmp_path / "recipe.yaml", lab), lab)


def resumed(tmp_path: Path, lab: Lab, journal: Path, later: set[int]) -> BatchResult:
    """What comes of a run of six that is gone on with; `later` loads gush."""
    plan = make_plan(load_recipe(tmp_path / "recipe.yaml", lab), lab)
    found = resumable(journal, checked_history(journal), plan, lab, accept_changes=False)
    Gushing.loads, Gushing.seen = frozenset(later), 2
    options = Options(DryRun(plant=f"{__name__}:Gushing"), "adaptive")
    session = Session(plan, lab, options, shared_planner(plan, lab), resumes=found)
    try:
        return session.run(Watching(session))
    finally:
        session.close()


def test_the_reason_is_told_by_runs_and_show_and_explained(command: Call, lab_folder: LabFolder) -> None:
    (lab_folder.folder / ".scuhand").mkdir()
    ran = run(lab_folder.folder / ".scuhand", {1, 2})
    assert "dose.overshoots: samples" in " ".join(command("runs", "--lab", lab_folder.folder).stdout.split())
    assert "dose.overshoots: samples overshot in a row: a by" in command("show", ran.journal).stdout
    assert "overshoot_limit" in command("explain", "dose.overshoots").stdout


@pytest.mark.parametrize("limit", ["two", "-1", "1.5", "2 mg"])
def test_a_limit_that_is_no_number_is_told_where_it_stands(lab_folder: LabFolder, limit: str) -> None:
    path = lab_folder.write("recipes/r.yaml", "\n".join(SIX.split("\n")[1:]) + f"overshoot_limit: {limit}\n")
    problems = problems_of(lambda: load_recipe(path, lab_folder.load()))
    assert any(
        f"13:18: 'overshoot_limit' must be a number of samples, not '{limit}'" in problem for problem in problems
    )
