"""What a lab asks of its balance: what does not hold is told by `check`, refused or warned of by a real run."""

import json
from collections.abc import Callable
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from balance_bench import DAY, RECIPE, plans_with, taken_for_real
from conftest import Call, LabFolder, problems_of
from running import dry_run, shared_planner

from scuhand_bt.cell.cell import Cell
from scuhand_bt.device_specs.balance import BalanceLimits
from scuhand_bt.journal.reader import read
from scuhand_bt.lab import Lab
from scuhand_bt.lab_state.beliefs import LabState, Measured
from scuhand_bt.problems import Problem
from scuhand_bt.recipe.plan import Plan
from scuhand_bt.run.balance_limits import below_usp, beyond_limits
from scuhand_bt.run.options import Options
from scuhand_bt.run.resume import checked_history, resumable
from scuhand_bt.run.session import Session
from scuhand_bt.run.simulation import DryRun


@pytest.fixture
def plan_of(tmp_path: Path, starter: Lab) -> Callable[..., tuple[Plan, Lab]]:
    return plans_with(tmp_path, starter)


NOW = datetime.fromisoformat("2026-03-02T08:00:00+00:00")


def at(problem: Problem) -> tuple[str, int, int]:
    return Path(problem.mark.file).name, problem.mark.line, problem.mark.column


def measured(value: float, ago: timedelta = timedelta()) -> Measured:
    return Measured(value, "run r", (NOW - ago).isoformat())


@pytest.mark.parametrize(
    ("ago", "said"),
    [
        (None, "none was right yet"),
        (timedelta(hours=23, minutes=59), None),
        (timedelta(hours=24, minutes=1), "the last one was right at 2026-03-01T07:59:00+00:00 (run r)"),
    ],
)
def test_a_check_weight_expires(
    plan_of: Callable[..., tuple[Plan, Lab]], ago: timedelta | None, said: str | None
) -> None:
    figures = {"check_weight_error_mg": measured(0.1, ago)} if ago is not None else {}
    found = beyond_limits(*plan_of(check_weight_every_s=86400.0), figures, NOW)
    assert [said in problem.message for problem in found if said] == ([True] if said else [])
    assert len(found) == (said is not None)
    assert beyond_limits(*plan_of(), figures, NOW) == []


def test_what_doses_nothing_needs_no_check_weight(plan_of: Callable[..., tuple[Plan, Lab]]) -> None:
    assert beyond_limits(*plan_of(DAY, check_weight_every_s=60.0), {}, NOW) == []


@pytest.mark.parametrize(
    ("limits", "repeatability_mg", "said"),
    [
        ({}, 0.1, None),
        ({"minimum_weight_mg": 30.0}, None, None),
        (
            {"minimum_weight_mg": 31.0},
            None,
            "30.0 mg is less than the balance's minimum weight, 31.0 mg (robot/cell.yaml)",
        ),
        (
            {"usp_41": True},
            None,
            "30.0 mg is less than the balance's minimum weight, 82.0 mg (2000 x 0.041 mg, USP 41)",
        ),
        (
            {"usp_41": True, "minimum_weight_mg": 90.0},
            None,
            "30.0 mg is less than the balance's minimum weight, 90.0 mg (robot/cell.yaml)",
        ),
        (
            {"usp_41": True, "minimum_weight_mg": 31.0},
            0.2,
            "30.0 mg is less than the balance's minimum weight, 400.0 mg (2000 x 0.2 mg, USP 41)",
        ),
    ],
)
def test_a_mass_below_the_minimum_weight_is_told_where_it_stands(
    plan_of: Callable[..., tuple[Plan, Lab]], limits: Any, repeatability_mg: float | None, said: str | None
) -> None:
    figures = {"repeatability_mg": measured(repeatability_mg)} if repeatability_mg is not None else {}
    found = beyond_limits(*plan_of(**limits), figures, NOW)
    assert [problem.message for problem in found] == ([said] if said else [])
    assert [at(problem) for problem in found] == ([("recipe.yaml", 9, 19)] if said else [])


@pytest.mark.parametrize(
    ("limits", "repeatability_mg", "minimum"),
    [
        ({}, None, None),
        ({}, 0.014, "82.0 mg (2000 x 0.041 mg, USP 41)"),
        ({}, 0.2, "400.0 mg (2000 x 0.2 mg, USP 41)"),
        ({"usp_41": False}, 0.2, None),
        ({"usp_41": True}, 0.2, None),
        ({"minimum_weight_mg": 10.0}, 0.2, None),
    ],
)
def test_a_measured_repeatability_warns_of_small_masses_where_the_lab_has_no_rule_of_its_own(
    plan_of: Callable[..., tuple[Plan, Lab]], limits: Any, repeatability_mg: float | None, minimum: str | None
) -> None:
    figures = {"repeatability_mg": measured(repeatability_mg)} if repeatability_mg is not None else {}
    found = below_usp(*plan_of(**limits), figures)
    assert [problem.message.partition("minimum weight, ")[2].partition(" (and")[0] for problem in found] == (
        [minimum] if minimum else []
    )
    assert [at(problem) for problem in found] == ([("recipe.yaml", 9, 19)] if minimum else [])


def test_a_rule_that_several_samples_break_is_told_once(plan_of: Callable[..., tuple[Plan, Lab]]) -> None:
    (found,) = beyond_limits(*plan_of(minimum_weight_mg=501.0), {}, NOW)
    assert found.message.endswith("(and 3 more like it)")


@pytest.mark.parametrize(("repeatability_mg", "place"), [(0.24, None), (0.26, (8, 38)), (0.8, (5, 66))])
def test_a_tolerance_that_the_repeatability_cannot_tell_is_told_where_it_stands(
    plan_of: Callable[..., tuple[Plan, Lab]], repeatability_mg: float, place: tuple[int, int] | None
) -> None:
    found = beyond_limits(*plan_of(), {"repeatability_mg": measured(repeatability_mg)}, NOW)
    assert [at(problem)[1:] for problem in found] == ([place] if place else [])
    assert all(f"is too fine for a repeatability of {repeatability_mg} mg" in problem.message for problem in found)


def test_check_notes_what_a_real_run_is_refused_for(command: Call, lab_folder: LabFolder) -> None:
    recipe = lab_folder.write("recipes/r.yaml", RECIPE)
    ended = command("check", recipe, "--fast")
    assert ended.returncode == 0
    assert "robot/cell.yaml:6:" in ended.stderr
    assert "a check weight is required every 24 h 00 min, and none was right yet" in ended.stderr
    assert len(json.loads(command("check", recipe, "--fast", "--json").stdout)["notes"]) == 2, (
        "the changer, and the weight"
    )


def test_a_real_run_without_a_check_weight_is_refused_or_warned_and_a_dry_run_is_not(
    tmp_path: Path, plan_of: Callable[..., tuple[Plan, Lab]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("scuhand_bt.run.session.set_up", taken_for_real)

    def begin(simulation: DryRun | None, **limits: Any) -> Session:
        plan, lab = plan_of(check_weight_every_s=86400.0, **limits)
        return Session(plan, lab, Options(simulation, "paper", tmp_path / "runs"), shared_planner(plan, lab))

    (refused,) = problems_of(lambda: begin(None))
    assert "a check weight is required every" in refused
    assert list((tmp_path / "runs").glob("*.sqlite")) == []
    for simulation, limits, warned in ((None, {"when_beyond": "warn"}, 1), (DryRun(), {}, 0)):
        session = begin(simulation, **limits)
        session.close()
        assert len(session.warnings) == warned
        assert [entry["kind"] for entry in read(session.journal.path, "event")].count("trouble") == warned
    keep_checked(session.cell, tmp_path)
    begin(None).close()


def test_a_run_that_was_begun_goes_on_whatever_its_balance(
    tmp_path: Path, plan_of: Callable[..., tuple[Plan, Lab]], monkeypatch: pytest.MonkeyPatch
) -> None:
    ran = dry_run(tmp_path, RECIPE, stop_at=40)
    monkeypatch.setattr("scuhand_bt.run.session.set_up", taken_for_real)
    plan, lab = plan_of(check_weight_every_s=86400.0)
    found = resumable(ran.journal, checked_history(ran.journal), plan, lab, accept_changes=True)
    session = Session(plan, lab, Options(None, "paper", tmp_path / "runs"), shared_planner(plan, lab), resumes=found)
    session.close()
    assert "a check weight is required every" in session.warnings[0]


def keep_checked(cell: Cell, folder: Path) -> None:
    """A check weight was weighed right just now, on the real balance."""
    passed = replace(cell, simulated=False, balance_figures={"check_weight_error_mg": 0.1}, powder_beliefs={})
    LabState(folder).keep(passed, "day")


@pytest.mark.parametrize(
    ("limits", "said"),
    [
        ("minimum_weight: 0.1", "6:"),
        ("minimum_weight: -1 mg", "6:"),
        ("usp_41: perhaps", "6:"),
        ("check_weight_every: 0 h", "6:"),
        ("when_beyond: ask", "6:"),
    ],
)
def test_a_wrong_limit_is_told_where_it_stands(lab_folder: LabFolder, limits: str, said: str) -> None:
    lab_folder.replace("robot/cell.yaml", "limits: {check_weight_every: 24 h}", f"limits: {{{limits}}}")
    problems = problems_of(lab_folder.load)
    assert len(problems) == 1
    assert problems[0].startswith(said)


def test_limits_are_written_as_the_docs_say(lab_folder: LabFolder) -> None:
    limits = "limits: {check_weight_every: 12 h, minimum_weight: 50 mg, usp_41: true, when_beyond: warn}"
    lab_folder.replace("robot/cell.yaml", "limits: {check_weight_every: 24 h}", limits)
    expected = BalanceLimits(check_weight_every_s=43200.0, minimum_weight_mg=50.0, usp_41=True, when_beyond="warn")
    assert lab_folder.load().cell.balance.limits == expected
