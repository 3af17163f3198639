"""The plan as a page: the order and what is needed are the plan's, times and powder those of dry runs of it."""

from pathlib import Path
from typing import Any

import pytest
from conftest import REPOSITORY, Call
from page_text import Tables
from running import HEAD, make_lab
from test_show_move import packed

from scuhand_bt.journal.archive import summaries
from scuhand_bt.lab import load_lab
from scuhand_bt.quantity import format_duration
from scuhand_bt.recipe.plan import make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.report.preview import dry_runs, preview

RECIPE = """
recipe: "two"
workflow: fill_xrd_holder
defaults: {container: xrd_holder, tolerance: 2 mg}
samples:
  - {id: a, mass: 20 mg, source: beads}
  - {id: b, mass: 50 mg, source: msg}
on_failure: {dose.overshoot: ask, otherwise: stop}
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Any:
    folder = tmp_path_factory.mktemp("preview")
    recipe = folder / "recipe.yaml"
    recipe.write_text(RECIPE + HEAD, encoding="utf-8")
    lab = load_lab(REPOSITORY)
    plan, told = make_plan(load_recipe(recipe, lab), lab), []
    tried = dry_runs(plan, lab, folder, 2, told.append)
    assert told == [1, 2]
    return folder, lab, plan, tried


def test_the_page_has_the_plans_order_and_the_dry_runs_times(made: Any) -> None:
    _, lab, plan, tried = made
    page = preview(plan, lab, tried)
    tables = Tables(page)
    order = tables.found["The order"][1:]
    assert [row[1] for row in order] == [job.name for job in plan.jobs]
    assert [row[3] for row in order if row[3]] == ["beads", "msg"]
    low, high = sorted(one.duration_s for one in tried)
    assert f"{format_duration(low)} to {format_duration(high)}" in tables.text
    for row, job in zip(order, plan.jobs, strict=True):
        began = sorted(one.jobs[job.name][0] for one in tried)
        words = [format_duration(began_s) for began_s in began]
        assert row[8] == (words[0] if words[0] == words[1] else " to ".join(words))
    assert [row[7] for row in order if row[3]] == ["1", "1"]
    assert tables.fetched == []


def test_the_dry_runs_are_whole_runs_and_leave_nothing_in_the_lab(made: Any) -> None:
    folder, _, _, tried = made
    for seed, one in enumerate(tried):
        (summary,) = summaries(folder / str(seed) / "runs")
        assert (summary.state, summary.good, summary.total) == ("complete", 2, 2)
        assert one.exit_code == 0
    assert tried[0].duration_s != tried[1].duration_s


def test_the_page_says_how_much_powder_is_taken_and_when_a_person_is_needed(made: Any) -> None:
    _, lab, plan, tried = made
    tables = Tables(preview(plan, lab, tried))
    columns = "source, powder, station, samples, needed with losses, taken, amount"
    powder = {row[0]: row for row in tables.found[columns][1:]}
    assert set(powder) == {"beads", "msg"}
    for name, dosed_mg in (("beads", 20.0), ("msg", 50.0)):
        assert all(abs(one.used_mg[name] - dosed_mg) < 5.0 for one in tried)
    persons = tables.found["run time, job, what"][1:]
    assert persons[0][0] == "before the start"
    swap = next(row for row in persons if "change powder" in row[1])
    assert swap[0].startswith("after ")
    assert any(row[0] == "if a sample fails" and "dose.overshoot" in row[2] for row in persons)


def test_the_motions_of_the_first_dry_run_are_in_the_page_job_by_job(made: Any) -> None:
    _, lab, plan, tried = made
    shown = packed(preview(plan, lab, tried), "shown")
    assert list(dict.fromkeys(one["job"] for one in shown["motions"])) == [job.name for job in plan.jobs]
    assert {one["pan"] for one in shown["motions"]} == {"xrd_holder"}
    assert len(shown["scene"]["cones"]) > 1


def test_a_dry_run_that_ended_early_is_told_and_not_counted(made: Any) -> None:
    from dataclasses import replace

    _, lab, plan, tried = made
    page = preview(plan, lab, [tried[0], replace(tried[1], exit_code=3, reason="the <b>valve</b> stuck")])
    tables = Tables(page)
    assert "seed 1: the <b>valve</b> stuck" in tables.text
    assert format_duration(tried[1].duration_s) not in tables.text


def test_the_command_writes_the_page_and_refuses_another_kind_of_file(command: Call, tmp_path: Path) -> None:
    lab = make_lab(tmp_path / "lab", trees__stay="workflow: stay\ntree: {sequence: [{park: }]}\n")
    recipe = lab / "stay.yaml"
    recipe.write_text("recipe: stay\nworkflow: stay\nsamples: [{id: a}]\n", encoding="utf-8")
    assert command("plan", recipe, "--html", tmp_path / "plan.txt").returncode == 2
    ended = command("plan", recipe, "--html", tmp_path / "plan.html", "--runs", "1")
    assert ended.returncode == 0, ended.stderr
    assert "stay: the plan" in (tmp_path / "plan.html").read_text(encoding="utf-8")
    assert not (lab / ".scuhand").exists()
