"""What a resumed run believes: what was measured and learnt before, but for what the lab wrote or forgot since."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from balance_bench import RECIPE, plans_with, taken_for_real
from running import dry_run, shared_planner

from scuhand_bt.lab import Lab
from scuhand_bt.lab_state.beliefs import LabState
from scuhand_bt.recipe.plan import Plan
from scuhand_bt.run.cell_state import state_of, take_up
from scuhand_bt.run.options import Options
from scuhand_bt.run.resume import checked_history, resumable
from scuhand_bt.run.session import Session
from scuhand_bt.specs import BalanceBelief


@pytest.fixture
def plan_of(tmp_path: Path, starter: Lab) -> Callable[..., tuple[Plan, Lab]]:
    return plans_with(tmp_path, starter)


@pytest.mark.slow
def test_a_resumed_run_knows_what_was_measured_before(tmp_path: Path) -> None:
    cell = dry_run(tmp_path, RECIPE, controller="adaptive").session.cell
    fresh = replace(cell, balance_figures={}, known_delay_s=None)
    take_up(fresh, json.loads(json.dumps(state_of(cell))))
    assert fresh.balance_figures == cell.balance_figures != {}
    assert fresh.known_delay_s == cell.known_delay_s


@pytest.mark.parametrize("wrote", ["nothing", "before", "since", "forgotten"])
def test_a_resumed_real_run_believes_what_its_doses_taught_of_powders_but_for_what_the_lab_wrote_since(
    tmp_path: Path, plan_of: Callable[..., tuple[Plan, Lab]], monkeypatch: pytest.MonkeyPatch, wrote: str
) -> None:
    """What a run had learnt before it was killed was learnt anew, as it is kept at a run's end."""
    ran, state = dry_run(tmp_path, RECIPE, stop_at=500, controller="adaptive"), LabState(tmp_path)
    learnt = ran.session.cell.powder_beliefs["glass_beads"]
    assert (ran.result.is_complete, ran.session.cell.balance_belief.fits > 0, learnt.doses) == (False, True, 1)
    other = learnt.model_copy(update={"coefficient": 50.0})
    if wrote != "nothing":
        taught: dict[str, Any] = {"powder_beliefs": {"glass_beads": other}, "balance_belief": BalanceBelief()}
        with monkeypatch.context() as then:
            if wrote == "before":
                then.setattr("scuhand_bt.lab_state.beliefs.wall_time", lambda: "2026-01-01T00:00:00+00:00")
            state.keep(replace(ran.session.cell, simulated=False, **taught), "another")
    if wrote == "forgotten":
        state.forget_powders("glass_beads")
    monkeypatch.setattr("scuhand_bt.run.session.set_up", taken_for_real)
    plan, lab = plan_of()
    found = resumable(ran.journal, checked_history(ran.journal), plan, lab, accept_changes=True)
    session = Session(plan, lab, Options(None, "paper", tmp_path / "runs"), shared_planner(plan, lab), resumes=found)
    session.close()
    assert session.cell.balance_belief == BalanceBelief(), "nothing was learnt of it on real devices, or forgotten"
    assert session.cell.powder_beliefs.get("glass_beads") == {"since": other, "forgotten": None}.get(wrote, learnt)


@pytest.mark.parametrize(("is_forgotten", "believes"), [(True, {}), (False, {"beads": 0.6})])
def test_what_was_forgotten_of_scoops_since_a_run_broke_off_stays_forgotten_when_it_is_resumed(
    tmp_path: Path,
    plan_of: Callable[..., tuple[Plan, Lab]],
    monkeypatch: pytest.MonkeyPatch,
    is_forgotten: bool,
    believes: dict[str, float],
) -> None:
    """It was believed again, and written anew at the run's end."""
    ran, state = dry_run(tmp_path, RECIPE, stop_at=500), LabState(tmp_path)
    taught = replace(ran.session.cell.believed, yields={"beads": 0.6})
    state.keep(replace(ran.session.cell, simulated=False, believed=taught), "day-1")
    monkeypatch.setattr("scuhand_bt.run.session.set_up", taken_for_real)
    plan, lab = plan_of()
    found = resumable(ran.journal, checked_history(ran.journal), plan, lab, accept_changes=True)
    found.history.state["believed"]["yields"] = {"beads": 0.6}
    if is_forgotten:
        state.forget_powders("glass_beads")
    session = Session(plan, lab, Options(None, "paper", tmp_path / "runs"), shared_planner(plan, lab), resumes=found)
    session.close()
    assert session.cell.believed.yields == believes
    state.keep(session.cell, "resumed")
    assert [one.share for one in state.yields(simulated=False).values()] == list(believes.values())
