"""The picture of a run: nothing is cut that matters, whatever its size; and the time that is left."""

import io
import threading
from datetime import datetime, timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from journal_bench import HEADER
from py_trees.behaviour import Behaviour
from rich.console import Console
from running import HEAD, Ran, dry_run
from terminal_bench import BATCH, SIZES, unwrapped

from scuhand_bt.journal.events import ActionStarted, Asked, JobStarted
from scuhand_bt.journal.follow import Follower
from scuhand_bt.journal.run_events import Paused, RunBegun
from scuhand_bt.journal.standing import Standing
from scuhand_bt.journal.writer import Journal
from scuhand_bt.lab import load_lab, starter_lab
from scuhand_bt.recipe.plan import Plan, make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.report import picture
from scuhand_bt.report.doses import doses_table
from scuhand_bt.report.live import LiveView
from scuhand_bt.report.picture import Node, Picture, Shown
from scuhand_bt.report.watching import shown_of
from scuhand_bt.run.clock import VirtualClock
from scuhand_bt.run.control import Control
from scuhand_bt.run.observers import BatchObserver, Observers
from scuhand_bt.run.options import Options
from scuhand_bt.run.questions import MEANINGS, Who
from scuhand_bt.run.session import Session
from scuhand_bt.run.simulation import DryRun

TWO_SOURCES = """\
sources:
  beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 20 g}
  msg: {station: mortar_bay_2, container: agate_mortar, powder: monosodium_glutamate, amount: 8 g}
"""
LONG = "Put a fresh sheet into the hand; this one has touched monosodium_glutamate/MSG-17, which no other may touch."
TREE = [Node(min(place, 9), f"step-{place}", "running") for place in range(40)]


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Ran:
    return dry_run(tmp_path_factory.mktemp("ran"), BATCH, controller=None)


def drawn(shown: Shown, size: tuple[int, int]) -> list[str]:
    """The lines of a terminal of this size."""
    text = io.StringIO()
    console = Console(file=text, width=size[0], height=size[1], force_terminal=True, color_system=None)
    console.print(Picture(shown), end="")
    lines = text.getvalue().split("\n")
    assert len(lines) == size[1]
    assert max(map(len, lines)) <= size[0]
    return lines


def seen(ran: Ran, **more: Any) -> Shown:
    failed = ran.result.samples[1].model_copy(update={"code": "hand.no_flow", "detail": "no powder comes"})
    results = [ran.result.samples[0], failed] * 20
    values = {
        "recipe": "five", "mode": "SIMULATED", "total": 60, "results": results, "run_time_s": 754.0, "left_s": 130.0,
        "job": "c, attempt 2: 30.0 mg ± 2 mg of glass_beads into xrd_holder", "tree": TREE,
        "readings": "balance 9.2451 g, stable", "keys": "Ctrl-Z pauses",
    }  # fmt: skip
    return Shown(**{**values, **more})


@pytest.mark.parametrize("size", SIZES)
def test_the_question_its_answers_and_the_last_verdict_stay_in_every_size(ran: Ran, size: tuple[int, int]) -> None:
    since = (datetime.now().astimezone() - timedelta(seconds=125)).isoformat()
    question = picture.Asked(LONG, ("done", "stop"), since)
    lines = drawn(seen(ran, question=question, typed="do", note="'dune' is no answer"), size)
    text = unwrapped(lines)
    assert "SIMULATED: five" in lines[0]
    assert "40/60 samples, 20 good; 12 min 34 s of run time, about 2 min 10 s left" in lines[1]
    assert "c, attempt 2: 30.0 mg ± 2 mg of glass_beads into xrd_holder" in lines[2]
    assert f"? {LONG} (waits for 2 min 0" in text
    for answer in ("done", "stop"):
        assert f"{answer}: {MEANINGS[answer]}" in text
    assert "> do" in text
    assert "'dune' is no answer" in text
    assert "in tolerance (hand.no_flow: no powder comes)" in text, "the last verdict, and why"
    assert "Ctrl-Z pauses" in lines[-1]
    assert "step-39" in text, "what is at work"


@pytest.mark.parametrize("size", SIZES)
def test_a_run_that_is_paused_says_so_and_the_newest_dose_comes_first(ran: Ran, size: tuple[int, int]) -> None:
    results = [one.model_copy(update={"id": f"s{number}"}) for number in range(30) for one in ran.result.samples[:1]]
    lines = drawn(seen(ran, results=results, state="Paused: Ctrl-Z continues"), size)
    assert "Paused: Ctrl-Z continues" in lines[-1]
    rows = [word for line in lines for word in line.split() if word.startswith("s") and word[1:].isdigit()]
    assert rows[:3] == ["s29", "s28", "s27"]


def test_what_each_powder_of_a_sample_came_to_stands_where_there_is_room(ran: Ran) -> None:
    sample = ran.result.samples[0]
    doses = tuple(sample.doses[0].model_copy(update={"lot": lot}) for lot in ("sand", "salt"))
    lines = drawn(seen(ran, results=[sample.model_copy(update={"doses": doses})], tree=TREE[:5]), (80, 24))
    rows = [line.split()[0] for line in lines if "in tolerance" in line and "last:" not in line]
    assert {"sand", "salt"} <= set(rows)


def test_a_mass_is_not_told_of_all_the_powders_of_a_sample(tmp_path: Path) -> None:
    samples = """\
  - {id: mix, workflow: mix_at_ratio, container: alumina_crucible, mass: 80 mg, ratio: 50 %, first: beads, second: msg}
"""
    session = dry_run(tmp_path, f"recipe: two\nsamples:\n{samples}{TWO_SOURCES}", controller=None).session
    view = LiveView(Console(file=io.StringIO()), session.cell, session.plan, Control(), "SIMULATED")
    view.attempt_started(session.plan.jobs[0], 1)
    assert view.shown().job == "mix: 80.0 mg ± 2 mg into alumina_crucible"


def test_masses_side_by_side_are_told_each_with_its_powder(tmp_path: Path) -> None:
    asked = "masses: [80 mg, 40 mg], tolerances: [3 mg, 0.65 mg], first: beads, sources: [beads, msg]"
    path = tmp_path / "two.yaml"
    samples = f"samples: [{{id: mix, container: alumina_crucible, {asked}}}]\n"
    path.write_text(f"recipe: two\nworkflow: weigh_in\n{samples}{TWO_SOURCES}", encoding="utf-8")
    lab = load_lab(starter_lab())
    plan, off = make_plan(load_recipe(path, lab), lab), SimpleNamespace(latest=None, pan_empty_mg=None, opening_mm=0.0)
    cell = SimpleNamespace(clock=VirtualClock(), balance=off, believed=off, hand=off)
    view = LiveView(Console(file=io.StringIO()), cell, plan, Control(), "SIMULATED")  # type: ignore[arg-type]
    view.attempt_started(plan.jobs[0], 1)
    both = "80.0 mg ± 3 mg of glass_beads + 40.0 mg ± 0.65 mg of monosodium_glutamate"
    assert view.shown().job == f"mix: {both} into alumina_crucible"


def of_the_rest(first_s: float, plan: Plan) -> float:
    """What it is stretched by when the first took so long: a fifth of the plan counts beside it."""
    return (first_s + 0.2 * plan.duration_s) / (plan.done_s["a"] + 0.2 * plan.duration_s)


def test_time_left_is_the_plan_stretched_by_what_is_done_and_a_pause_does_not_count(ran: Ran) -> None:
    session, clock = ran.session, VirtualClock()
    cell = SimpleNamespace(
        **{name: getattr(session.cell, name) for name in ("balance", "believed", "hand")}, clock=clock
    )
    control = Control()
    view = LiveView(Console(file=io.StringIO()), cell, session.plan, control, "SIMULATED")  # type: ignore[arg-type]
    plan_s, first_s = session.plan.duration_s, session.plan.done_s["a"]
    twice_s = of_the_rest(2.0 * first_s, session.plan) * (plan_s - first_s)
    clock.now_s = 5.0
    assert view.shown().left_s == pytest.approx(plan_s - 5.0), "nothing is known yet but the plan"
    view.paused()
    clock.now_s = 3605.0
    assert view.shown().left_s == pytest.approx(plan_s - 5.0), "none of it goes by meanwhile"
    view.continued()
    clock.now_s = 3600.0 + 2.0 * first_s
    view.sample_ended(ran.sample("a"))
    assert view.shown().left_s == pytest.approx(twice_s), "it took twice as long as planned"
    view.attempt_started(session.plan.jobs[0], 2)
    clock.now_s += 20.0
    assert view.shown().left_s == pytest.approx(twice_s), "done again it takes nothing from the rest"
    view.attempt_started(session.plan.jobs[1], 1)
    view.sample_ended(ran.sample("a"))  # as its container has gone
    view.sample_ended(ran.sample("b").model_copy(update={"verdict": "not run"}))
    assert view.shown().left_s == pytest.approx(twice_s - 20.0)
    view = LiveView(Console(file=io.StringIO()), cell, session.plan, control, "SIMULATED")  # type: ignore[arg-type]
    clock.now_s = 0.0
    asked = control.questions.ask("Is it?", ("done", "stop"))
    assert asked is not None
    view.shown()
    clock.now_s = 28_000.0
    assert view.shown().left_s == pytest.approx(max(0.0, plan_s - 120.0)), (
        "as of what waits overnight two minutes count"
    )
    control.questions.give(asked.number, "done", Who("Ada"))
    view.shown()
    clock.now_s += first_s
    view.sample_ended(ran.sample("a"))
    stretched = of_the_rest(first_s + 120.0, session.plan)
    assert view.shown().left_s == pytest.approx(stretched * (plan_s - first_s)), "and no more"


def test_a_resumed_run_tells_the_time_left_by_what_was_done_before_and_when(ran: Ran) -> None:
    """As who watches it does: not as if all of it had been done as it was resumed."""
    session, clock, a = ran.session, VirtualClock(), ran.sample("a")
    cell = SimpleNamespace(
        **{name: getattr(session.cell, name) for name in ("balance", "believed", "hand")}, clock=clock
    )
    plan_s, first_s = session.plan.duration_s, session.plan.done_s["a"]
    twice_s = of_the_rest(2.0 * first_s, session.plan) * (plan_s - first_s)
    stood = Standing()
    stood.paused(10.0)
    stood.continued(110.0)
    told_s = {"a": (2.0 * first_s + 100.0, 100.0)}
    before = Follower(session.journal.path, samples={"a": a}, told_s=told_s, standing=stood)
    clock.now_s = 2.0 * first_s + 120.0
    view = LiveView(Console(file=io.StringIO()), cell, session.plan, Control(), "SIMULATED", before)  # type: ignore[arg-type]
    view.sample_known(a)
    assert view.shown().left_s == pytest.approx(twice_s - 20.0)


def test_a_run_tells_who_watches_that_it_stands_still(tmp_path: Path) -> None:
    said: list[str] = []
    has_wished: list[bool] = []

    class Pausing(BatchObserver):
        def ticked(self, root: Behaviour) -> None:
            if session.cell.clock.now_s > 20.0 and not has_wished:
                has_wished.append(True)
                session.control.wish("pause_now")
                threading.Timer(0.5, session.control.wish, ["continue"]).start()

        def paused(self) -> None:
            said.append("paused")

        def continued(self) -> None:
            said.append("continued")

    lab = load_lab(starter_lab())
    (tmp_path / "r.yaml").write_text(BATCH + HEAD, encoding="utf-8")
    plan = make_plan(load_recipe(tmp_path / "r.yaml", lab), lab)
    session = Session(plan, lab, Options(DryRun(1), None, tmp_path / "runs"))
    session.run(Observers(Pausing()))
    session.close()
    assert said == ["paused", "continued"]


def test_without_colours_a_states_sign_tells_it(ran: Ran) -> None:
    tree = [Node(0, "tare", "done"), Node(0, "scoop", "failed", "scoop.nothing: it brought nothing")]
    tree += [Node(0, "park", "running"), Node(0, "wait", "to come")]
    text = unwrapped(drawn(seen(ran, tree=tree), (120, 40)))
    assert all(one in text for one in ("✓ tare", "✗ scoop: scoop.nothing", "▶ park", "· wait"))


@pytest.mark.slow
def test_no_color_means_none(ran: Ran, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NO_COLOR", "1")
    text = io.StringIO()
    console = Console(file=text, width=80, height=24, force_terminal=True)
    console.print(Picture(seen(ran)))
    assert "\x1b[3" not in text.getvalue()
    assert "\x1b[9" not in text.getvalue()


@pytest.mark.parametrize("width", [80, 100, 120, 160, 200])
def test_no_width_takes_a_name_a_mass_or_a_verdict_from_the_table(ran: Ran, width: int) -> None:
    code = {"code": "balance.bracket_open", "detail": "the container was not taken off"}
    results = [ran.result.samples[0], ran.result.samples[1].model_copy(update=code)]
    text = io.StringIO()
    Console(file=text, width=width).print(doses_table(results, width))
    lines = text.getvalue().splitlines()
    assert max(map(len, lines)) <= width
    for result, line in zip(results, [line for line in lines if "30.0 mg" in line], strict=True):
        assert line.split()[0] == result.id
        assert f"{result.error_mg:+.1f} ± {result.uncertainty_mg:.1f}" in line
        assert "in tolerance" in line
    assert any("balance.bracket_open" in line for line in lines)
    assert ("controller" in lines[0]) == (width >= 160)


def test_who_watches_sees_what_is_under_way_and_what_waits(tmp_path: Path, ran: Ran) -> None:
    journal = Journal(tmp_path / "r.sqlite", durable=False)
    inputs = {"mass": 30.0, "tolerance": 2.0, "source": "beads", "container": "a (xrd_holder)"}
    sources = {"beads": {"station": "mortar_bay", "powder": "glass_beads", "lot": ""}}
    planned = [{"id": name, "workflow": "fill", "inputs": inputs} for name in ("a", "b")]
    journal.event(RunBegun.model_validate({**HEADER, "samples": planned, "sources": sources}))
    journal.job_started(JobStarted(name="a", sample="a", attempt=2, workflow="fill"))
    action = journal.action_started(ActionStarted(path="ask", visit=1, skill="ask", inputs={}), weighs=False)
    journal.action = action
    journal.event(Asked(question="Is it?", choices=["done", "stop"]))
    now = Follower(journal.path)
    now.look()
    assert now.begun is not None
    shown = shown_of(now, now.begun)
    assert shown.job == "a, attempt 2: 30.0 mg ± 2 mg of glass_beads into a (xrd_holder)"
    assert [(node.name, node.state) for node in shown.tree] == [("ask", "running")]
    assert (shown.question and shown.question.text, shown.keys) == ("Is it?", "scuhand-bt answer r")
    journal.event(Paused())
    journal.event(ran.result.samples[0])
    assert [one.id for one in now.look()] == ["a"]
    assert "Paused" in shown_of(now, now.begun).state
    assert now.look() == []
    journal.close()
