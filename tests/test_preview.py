"""The plan as a page: order and needs are the plan's, what to expect its odds', the motions a dry run's."""

from pathlib import Path
from typing import Any

import pytest
from browser import browser_page, needs_browser, serious_faults
from conftest import REPOSITORY, Call, LabFolder
from page_text import Tables
from running import HEAD, make_lab
from test_show_move import packed

from scuhand_bt.lab import load_lab
from scuhand_bt.quantity import format_duration, format_mass
from scuhand_bt.recipe.plan import make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.report.preview import preview_page
from scuhand_bt.study.odds import odds_of
from scuhand_bt.study.trial import Setup, trial

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
    recipe = tmp_path_factory.mktemp("preview") / "recipe.yaml"
    recipe.write_text(RECIPE + HEAD, encoding="utf-8")
    lab = load_lab(REPOSITORY)
    plan = make_plan(load_recipe(recipe, lab), lab)
    odds = odds_of(plan, [trial(Setup(recipe, REPOSITORY), seed) for seed in range(2)])
    return plan, odds, preview_page(plan, lab, odds)


def test_the_page_has_the_plans_order_and_when_each_job_is_to_begin(made: Any) -> None:
    plan, odds, page = made
    tables = Tables(page)
    order = tables.found["The order"][1:]
    assert [row[1] for row in order] == [job.name for job in plan.jobs]
    assert [row[3] for row in order if row[3]] == ["beads", "msg"]
    for row, job in zip(order, plan.jobs, strict=True):
        began = odds.began_s[job.name]
        for bound_s in (began.low, began.middle, began.high):
            assert format_duration(bound_s) in row[7]
    assert [row[8] for row in order if row[8]] == [
        f"{chance.probability:.0%} ({chance.low:.0%} to {chance.high:.0%})" for chance in odds.samples.values()
    ]
    assert f"{format_duration(odds.duration_s.low)} to {format_duration(odds.duration_s.high)}" in tables.text
    assert tables.fetched == []


def test_the_page_says_how_much_powder_is_used_and_when_a_person_is_needed(made: Any) -> None:
    plan, odds, page = made
    tables = Tables(page)
    columns = "source, powder, station, samples, scoops, needed with losses, used, "
    columns += "left, kept, left, returned, amount"  # none is discarded: that needs no column
    for row, demand in zip(tables.found[columns][1:], plan.demands, strict=True):
        name = demand.source.name
        assert (row[0], row[4]) == (name, f"{odds.scoops[name].middle:.0f}")
        assert format_mass(odds.used_mg[name].middle) in row[6]
        assert row[5] == format_mass(demand.needed_mg)
    persons = tables.found["run time, job, what"][1:]
    assert persons[0][0] == "before the start"
    swap = next(row for row in persons if "change powder" in row[1])
    asked = odds.asked_s[swap[1]]
    assert odds.began_s[swap[1]].middle < asked.middle, "what is left in the cone is returned first"
    assert format_duration(asked.middle) in swap[0]
    assert any(row[0] == "if a sample fails" and "dose.overshoot" in row[2] for row in persons)
    assert (plan.swaps, sum(person.job is not None for person in plan.persons)) == (1, 1)
    assert "sheet swap between samples" in tables.text
    assert "moment that needs a person" in tables.text, "who comes once may stay for several"


@pytest.fixture
def stops(lab_folder: LabFolder) -> Path:
    """A recipe whose every run stops in its first sample, with a mortar to be refilled after it."""
    lab_folder.write(
        "trees/hopeless.yaml",
        "workflow: hopeless\ninputs: {source: Source, container: Container, mass: Mass}\ntree:\n  timeout:\n"
        "    duration: 1 s\n    child: {fill_xrd_holder: {source: $source, container: $container, mass: $mass}}\n",
    )
    powder = "powder: glass_beads, amount: 600 mg, refill: 500 mg"
    return lab_folder.write(
        "recipes/stops.yaml",
        "recipe: stops\nworkflow: hopeless\n"
        f"sources: {{beads: {{station: mortar_bay, container: agate_mortar, {powder}}}}}\n"
        "samples: [{id: a, source: beads, container: xrd_holder, mass: 250 mg, repeat: 3}]\n",
    )


@pytest.mark.slow
def test_the_page_of_a_plan_whose_runs_stop_says_what_none_has_come_to(
    stops: Path, command: Call, tmp_path: Path
) -> None:
    ended = command("plan", stops, "--html", tmp_path / "plan.html", "--trials", "3", "--night", "20:00-08:00")
    assert ended.returncode == 0, ended.stderr
    tables = Tables((tmp_path / "plan.html").read_text(encoding="utf-8"))
    order = {row[1]: row[7] for row in tables.found["The order"][1:]}
    assert (order["a-1"], order["a-2"]) == ("0 s", "in no dry run")
    refill = next(row for row in tables.found["run time, job, what"] if row[1].startswith("refill beads"))
    assert refill[0] == "in no dry run"
    assert "600.0 mg + 1 × 500.0 mg" in tables.text
    assert "every dry run has stopped before its end" in tables.text


def test_the_motions_of_a_dry_run_are_in_the_page_job_by_job(made: Any) -> None:
    plan, _, page = made
    shown = packed(page, "shown")
    assert list(dict.fromkeys(one["job"] for one in shown["motions"])) == [job.name for job in plan.jobs]
    assert {one["pan"] for one in shown["motions"]} == {None, "xrd_holder"}
    assert len(shown["scene"]["cones"]) > 1


def test_the_command_writes_the_page_and_refuses_another_kind_of_file(command: Call, tmp_path: Path) -> None:
    lab = make_lab(tmp_path / "lab", trees__stay="workflow: stay\ntree: {sequence: [{park: }]}\n")
    recipe = lab / "stay.yaml"
    recipe.write_text("recipe: stay\nworkflow: stay\nsamples: [{id: a}]\n", encoding="utf-8")
    assert command("plan", recipe, "--html", tmp_path / "plan.txt").returncode == 2
    assert command("plan", recipe, "--html", tmp_path / "plan.html", "--trials", "0").returncode == 2
    ended = command("plan", recipe, "--html", tmp_path / "plan.html", "--trials", "1")
    assert ended.returncode == 0, ended.stderr
    page = (tmp_path / "plan.html").read_text(encoding="utf-8")
    assert "stay: the plan" in page
    assert "By 1 dry run on the simulated cell, too few for an interval" in page
    assert "Each dry run has a cell of its own" in page
    assert not list(lab.glob(".scuhand/runs/*"))


@needs_browser
def test_in_a_browser_the_page_plays_the_moves_of_each_job_and_keeps_nobody_out(
    made: Any, tmp_path: Path, browser: Any
) -> None:
    (tmp_path / "plan.html").write_text(made[2], encoding="utf-8")
    with browser_page(browser, viewport={"width": 390, "height": 844}) as page:
        page.goto((tmp_path / "plan.html").as_uri())
        page.locator("#viewer canvas").wait_for()
        assert page.evaluate("document.documentElement.scrollWidth") <= 390, "nothing but the tables scrolls sideways"
        rest = page.evaluate("document.getElementById('viewer').viewer.apex()")
        page.locator("[data-part=job]").select_option("b")
        page.evaluate(
            """() => { const slider = document.querySelector("[data-part=slider]");
               slider.value = slider.max / 3; slider.dispatchEvent(new Event("input")); }"""
        )
        assert page.evaluate("document.getElementById('viewer').viewer.apex()") != rest
        assert serious_faults(page) == []


@needs_browser
def test_in_a_browser_of_long_names_all_of_every_table_is_seen_without_scrolling(
    made: Any, tmp_path: Path, browser: Any
) -> None:
    name = "a-sample-with-a-long-name-of-the-seventh-of-november-01"
    html = made[2].replace("<td>a</td>", f"<td>{name}</td>").replace(" s <span>(", " s <span>(19 min 02 s to ")
    assert html.count("<span>(19 min") > 3
    (tmp_path / "plan.html").write_text(html, encoding="utf-8")
    with browser_page(browser, viewport={"width": 1200, "height": 844}) as page:
        page.goto((tmp_path / "plan.html").as_uri())
        tables = page.locator(".wide")
        assert name in tables.first.inner_text()
        assert tables.count() == 3
        for table in tables.all():
            assert table.evaluate("it => it.scrollWidth - it.clientWidth") == 0
