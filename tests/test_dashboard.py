"""The dashboard: what its page is told is what the journal has, then and now, and a person answers by it."""

import json
import socket
import time
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from conftest import Call
from dashboard_client import Client, serving
from journal_bench import HEADER, RESULT
from resuming import Watch
from running import dry_run, make_lab
from test_answers import ASK, RECIPE, Run, told

from scuhand_bt.dashboard.page_state import Page, banner
from scuhand_bt.devices.interfaces import Reading
from scuhand_bt.events.entry import Event
from scuhand_bt.journal.events import Answered, Asked, JobStarted
from scuhand_bt.journal.export import canonical
from scuhand_bt.journal.follow import Follower
from scuhand_bt.journal.presence import Presence
from scuhand_bt.journal.reader import read
from scuhand_bt.journal.results import SampleResult, SoFar
from scuhand_bt.journal.run_events import Continued, Ended, Paused, Resumed, RunBegun
from scuhand_bt.journal.writer import Journal
from scuhand_bt.report.watching import shown_of
from scuhand_bt.run.control import Control, WishListener
from scuhand_bt.run.questions import MEANINGS
from scuhand_bt.run.simulation import DryRun

TWO = """
recipe: two
workflow: fill_xrd_holder
defaults: {source: beads, container: xrd_holder, tolerance: 2 mg}
samples: [{id: a, mass: 20 mg}, {id: b, mass: 50 mg}]
"""


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Any:
    return dry_run(tmp_path_factory.mktemp("lab"), TWO, controller=None)


@pytest.fixture
def journal(tmp_path: Path) -> Any:
    """A journal that is being written, and whose run listens."""
    path = tmp_path / "lab" / "runs" / "one.sqlite"
    path.parent.mkdir(parents=True)
    written, control = Journal(path, durable=False), Control()
    written.event(RunBegun.model_validate({**HEADER, "mode": "real devices", "simulated": False}))
    listener = WishListener(path, control)
    try:
        with Presence(path):
            yield written, control
    finally:
        listener.end()
        written.close()


def test_the_page_of_a_run_that_has_ended_says_what_its_samples_came_to(finished: Any) -> None:
    run, folder = finished.journal.stem, finished.journal.parent.parent
    with serving(folder) as page:
        listed = page.get("/api/runs").values
        shown = page.get(f"/api/runs/{run}").values
        assert page.get("/").status == page.get(f"/runs/{run}").status == 200
    assert [(one["id"], one["state"], one["good"], one["total"]) for one in listed] == [(run, "complete", 2, 2)]
    rows = {row["id"]: row for row in shown["rows"]}
    for sample in finished.result.samples:
        assert (rows[sample.id]["verdict"], rows[sample.id]["tone"]) == (sample.verdict, "good")
        assert f"({sample.error_mg:+.1f} mg)" in rows[sample.id]["told"]
    assert (shown["run"]["banner"], shown["state"]) == ("SIMULATED", "complete")
    assert [node["state"] for node in shown["tree"]] == ["done"] * len(shown["tree"])
    assert shown["ends_s"] == finished.result.duration_s
    assert ["cone", "0.0 mg"] in shown["holds"]
    holds = dict(shown["holds"])
    assert all(told.startswith("about ") for place, told in holds.items() if place.startswith("source "))


def test_a_replay_shows_what_a_page_was_shown_then(finished: Any) -> None:
    last_s = finished.result.duration_s
    live, samples = Page(Follower(finished.journal, until_s=0.0)), {}
    for step in range(21):
        time_s = last_s * step / 20
        live.now.until_s = time_s
        for row in (then := live.news(is_held=True))["rows"]:
            samples[row["id"]] = {**samples.get(row["id"], {}), **row}
        again = Page(Follower(finished.journal, until_s=time_s)).news(is_held=True)
        replayed: dict[str, Any] = {}
        for row in again["rows"]:
            replayed[row["id"]] = {**replayed.get(row["id"], {}), **row}
        assert replayed == samples
        for name in ("state", "time_s", "job", "tree", "dose", "holds", "joints_rad", "pan", "question"):
            assert again[name] == then[name], name


def test_within_a_dose_a_replay_shows_its_course_until_then_and_no_further(finished: Any) -> None:
    dose = next(row for row in read(finished.journal, "action") if row["skill"] == "dispense")
    time_s = (dose["started_s"] + dose["ended_s"]) / 2
    whole = Follower(finished.journal, until_s=time_s)
    whole.look()
    begun = next(one for one in whole.actions.values() if one.skill == "dispense")
    assert begun.outcome is None
    assert len(whole.course) > 20
    assert time_s - 1.0 < whole.course[-1][0] <= time_s
    assert whole.reading is not None
    assert time_s - 1.0 < whole.reading[0] <= time_s
    told = Page(Follower(finished.journal, until_s=time_s)).news(is_held=True)
    states = {node["name"]: node["state"] for node in told["tree"]}
    assert (states["dispense"], states["park"]) == ("running", "to come")
    scoops = [node["state"] for node in told["tree"] if node["name"] == "scoop"]
    assert scoops == ["done", "skipped"], "beside the container's change, and before the dose"
    failed = next(node for node in told["tree"] if node["name"] == "cone_holds")
    assert (failed["state"], failed["why"][:15]) == ("failed", "hand.cone_empty")
    assert told["dose"] == {"target_mg": 20.0, "tolerance_mg": 2.0, "words": "20.0 mg ± 2 mg"}


def test_what_the_balance_shows_is_on_the_page_at_any_time(journal: Any) -> None:
    written, control = journal
    shown = Reading(1234.5, False, 7.0)
    control.balance = lambda: shown
    with serving(written.path.parent.parent) as client:
        balance = client.news("one", "balance")
        assert next(balance) == [7.0, 1234.5, False]
        shown = Reading(1240.0, True, 7.1)
        assert next(balance) == [7.1, 1240.0, True]
        shown = None
        assert next(balance) is None
        balance.close()


def test_a_replay_has_what_the_balance_showed_when_it_was_weighed_by(finished: Any) -> None:
    tared = next(row for row in read(finished.journal, "event") if row["kind"] == "tare")
    last = tared["payload"]["readings"][-1]
    told = Page(Follower(finished.journal, until_s=tared["time_s"])).news(is_held=True)
    assert told["reading"] == (last["time_s"], last["value_mg"], True)


def test_what_is_left_of_a_run_is_its_plan_stretched_as_the_run_was_until_then(finished: Any) -> None:
    begun = Page(Follower(finished.journal, until_s=0.0)).news(is_held=True)
    planned = {row["id"]: row["done_s"] for row in begun["rows"] if "done_s" in row}
    (all_s,) = (json.loads(row["value"]) for row in read(finished.journal, "run") if row["key"] == "planned_s")
    assert 0.0 < planned["a"] < planned["b"] < all_s, "the batch is finished after the last sample"
    assert begun["left_s"] == all_s, "nothing is known yet but the plan"
    judged = next(row for row in read(finished.journal, "event") if row["kind"] == "sample")
    at_s = judged["time_s"] + 5.0
    then = Page(Follower(finished.journal, until_s=at_s)).news(is_held=True)
    stretch = (judged["time_s"] + 0.2 * all_s) / (planned["a"] + 0.2 * all_s)  # a fifth of the plan counts beside it
    assert then["pace"] == {"planned_s": planned["a"], "at_s": judged["time_s"], "stretch": pytest.approx(stretch)}
    assert then["left_s"] == pytest.approx(judged["time_s"] + stretch * (all_s - planned["a"]) - then["time_s"])
    assert Page(Follower(finished.journal)).news(is_held=False)["left_s"] is None


NAMES = ("a", "b", "c", "d")
AFTER_150_S = 230.0 / 180.0
"""What stretches the rest where the first of four samples took 150 s, not 100: 80 s of the plan count beside it."""
PLANNED = [
    {"id": name, "workflow": "w", "inputs": {}, "done_s": 100.0 * number} for number, name in enumerate(NAMES, start=1)
]


def told_at(written: Journal, at_s: float, event: Event) -> None:
    written.now_s = lambda: at_s
    written.event(event)
    written.flush()


def judged(name: str, verdict: str = "in tolerance", attempt: int = 1) -> SampleResult:
    return SampleResult.model_validate({**RESULT, "id": name, "verdict": verdict, "attempt": attempt})


@pytest.fixture
def planned(tmp_path: Path) -> Any:
    """A journal that is being written, of a run of four samples of 100 s each."""
    written = Journal(tmp_path / "planned.sqlite", durable=False)
    told_at(written, 0.0, RunBegun.model_validate({**HEADER, "samples": PLANNED}))
    yield written
    written.close()


def test_how_long_a_person_lets_a_run_stand_still_does_not_make_the_rest_of_it_longer(planned: Journal) -> None:
    page = Page(Follower(planned.path))
    told_at(planned, 10.0, Paused())
    told_at(planned, 5010.0, Continued())
    assert page.news(is_held=True)["left_s"] == 390.0, "nothing is known yet but the plan"
    told_at(planned, 5150.0, judged("a"))
    stretched_s = 300.0 * AFTER_150_S
    assert page.news(is_held=True)["left_s"] == pytest.approx(stretched_s), "the first took 150 s without the pause"
    told_at(planned, 5160.0, Paused())
    assert page.news(is_held=True)["left_s"] == pytest.approx(stretched_s - 10.0)
    told_at(planned, 9160.0, Continued())
    told_at(planned, 9160.0, JobStarted(name="b", sample="b", attempt=1, workflow="w"))
    assert page.news(is_held=True)["left_s"] == pytest.approx(stretched_s - 10.0), "and nothing went by meanwhile"


def test_of_a_question_that_waits_overnight_two_minutes_count(planned: Journal) -> None:
    page = Page(Follower(planned.path))
    told_at(planned, 10.0, Asked(question="Is it?", choices=["done", "stop"]))
    told_at(planned, 60.0, JobStarted(name="change", sample=None, attempt=1, workflow="w"))
    assert page.news(is_held=True)["left_s"] == 340.0, "whoever is there answers, and time goes by"
    told_at(planned, 28_000.0, JobStarted(name="change", sample=None, attempt=1, workflow="w"))
    assert page.news(is_held=True)["left_s"] == 270.0, "and none after that"
    told_at(planned, 28_000.0, Paused())
    told_at(planned, 28_500.0, Answered(question="Is it?", answer="done"))
    told_at(planned, 28_810.0, Continued())
    assert page.news(is_held=True)["left_s"] == 270.0, "what a question and a pause share counts once"
    told_at(planned, 28_830.0, judged("a"))
    assert page.news(is_held=True)["left_s"] == pytest.approx(300.0 * AFTER_150_S), "the first took 150 s"


def test_a_sample_that_takes_long_takes_nothing_from_what_comes_after_it(planned: Journal) -> None:
    page = Page(Follower(planned.path))
    told_at(planned, 0.0, JobStarted(name="a", sample="a", attempt=1, workflow="w"))
    told_at(planned, 80.0, Continued())
    assert page.news(is_held=True)["left_s"] == 320.0
    told_at(planned, 390.0, Continued())
    told = page.news(is_held=True)
    assert told["left_s"] == 300.0, "three of 100 s are to come"
    assert told["pace"] == {"planned_s": 100.0, "at_s": 390.0, "stretch": 1.0}, "and as much is told of each"
    told_at(planned, 400.0, judged("a", "over"))
    told_at(planned, 400.0, JobStarted(name="a", sample="a", attempt=2, workflow="w"))
    told_at(planned, 600.0, Continued())
    assert page.news(is_held=True)["left_s"] == pytest.approx(300.0 * 480.0 / 180.0), "nor when it is done again"


def test_a_first_sample_that_takes_long_stretches_less_than_a_whole_plan_that_does(planned: Journal) -> None:
    """It learns what scoops bring: where all the rest was taken to be as slow, twice the time was told."""
    page = Page(Follower(planned.path))
    told_at(planned, 300.0, judged("a"))
    assert page.news(is_held=True)["left_s"] == pytest.approx(300.0 * 380.0 / 180.0), "not three times as long"
    told_at(planned, 600.0, judged("b"))
    told_at(planned, 900.0, judged("c"))
    assert page.news(is_held=True)["left_s"] == pytest.approx(100.0 * 980.0 / 380.0), "but more and more so"


def test_what_a_run_did_not_come_to_is_to_come_again_once_it_is_resumed(planned: Journal) -> None:
    page = Page(Follower(planned.path))
    told_at(planned, 120.0, judged("a"))
    for name, verdict in (("b", "interrupted"), ("c", "not run"), ("d", "not run")):
        told_at(planned, 150.0, judged(name, verdict))
    told_at(planned, 150.0, judged("a"))  # as its container was not seen to go
    told_at(planned, 150.0, Ended(exit_code=130, reason="interrupted"))
    assert {row["id"]: row["verdict"] for row in page.news(is_held=False)["rows"]}["d"] == "not run"
    told_at(planned, 160.0, Resumed(last_at="", changes=[], version="0"))
    resumed = page.news(is_held=True)
    assert resumed["left_s"] == pytest.approx(300.0 * 200.0 / 180.0 - 40.0)
    assert {row["id"]: row["verdict"] for row in resumed["rows"]} == {
        "a": "in tolerance", "b": "to come", "c": "to come", "d": "to come",
    }  # fmt: skip
    assert len(shown_of(page.now, page.now.begun).results) == 1, "so many are done"


def test_a_sample_that_stopped_the_run_and_goes_on_is_under_way(planned: Journal) -> None:
    page = Page(Follower(planned.path))
    planned.now_s = lambda: 0.0
    job = planned.job_started(JobStarted(name="a", sample="a", attempt=1, workflow="w"))
    told_at(planned, 300.0, judged("a", "under"))
    told_at(planned, 300.0, Ended(exit_code=3, reason="a: dose.not_reached"))
    told_at(planned, 300.0, Resumed(last_at="", changes=[], version="0"))
    planned.now_s = lambda: 310.0
    planned.job_resumed(job, SoFar())
    planned.flush()
    assert page.news(is_held=True)["left_s"] == 300.0, "of it nothing is known but that it is late"
    told_at(planned, 320.0, judged("a"))
    assert page.news(is_held=True)["left_s"] == pytest.approx(300.0 * 400.0 / 180.0)


def test_a_motion_is_told_as_it_begins_with_where_it_leads(finished: Any) -> None:
    now = Follower(finished.journal)
    now.look()
    assert now.move is not None
    began_s, move = now.move
    assert began_s + move.step_s * (len(move.joints_rad) - 1) <= now.time_s
    assert move.joints_rad[-1] == pytest.approx(now.state["joints_rad"], abs=1e-4)
    before = Page(Follower(finished.journal, until_s=began_s - 1.0)).news(is_held=True)
    assert before["move"]["at_s"] < began_s


def test_the_cone_is_told_as_wide_as_the_roller_makes_it_all_through_a_motion(finished: Any) -> None:
    events = read(finished.journal, "event")
    moves = [row["payload"] for row in events if row["kind"] == "arm_moves"]
    for move, after in pairwise(moves):
        rims_mm = move["rims_mm"] or [move["cone_mm"]]
        assert (rims_mm[0], rims_mm[-1]) == pytest.approx((move["cone_mm"], after["cone_mm"]), abs=0.05)
    scooped = next(row for row in events if row["kind"] == "scoop")
    open_mm = scooped["payload"]["open_mm"]
    stroke = next(
        row["payload"]
        for row in events
        if row["kind"] == "arm_moves"
        and row["action"] == scooped["action"]
        and open_mm in row["payload"]["rims_mm"][:1]
    )
    assert len(stroke["rims_mm"]) == len(stroke["joints_rad"]) > 10
    assert any(stroke["rims_mm"][-1] + 1.0 < rim_mm < open_mm - 1.0 for rim_mm in stroke["rims_mm"])


def test_what_is_written_is_on_the_page_at_once_and_a_page_that_stays_is_told_only_what_changed(journal: Any) -> None:
    written, _ = journal
    with serving(written.path.parent.parent) as client:
        news = client.news("one")
        first = next(news)
        assert (first["run"]["banner"], first["state"], first["job"]) == ("REAL", "running", None)
        written.job_started(JobStarted(name="a", sample="a", attempt=1, workflow="w"))
        began_s = time.monotonic()
        told = next(news)
        assert time.monotonic() - began_s < 1.0
        assert told["job"]["name"] == "a"
        assert "run" not in told
        news.close()


def test_a_question_is_answered_on_the_page_and_once(journal: Any) -> None:
    written, control = journal
    with serving(written.path.parent.parent) as client:
        news = client.news("one")
        next(news)
        asked = control.questions.ask("Is the <b>shield</b> shut?", ("done", "stop"))
        written.event(Asked(question=asked.text, choices=list(asked.choices)))
        question = next(news)["question"]
        assert (question["number"], question["text"]) == (asked.number, asked.text)
        assert question["choices"][0] == {"answer": "done", "meaning": MEANINGS["done"]}
        there = "/api/runs/one/answer"
        assert client.post(there, {"number": asked.number, "answer": "maybe"}).status == 409
        given = client.post(there, {"number": asked.number, "answer": "done", "name": "Eve"})
        late = client.post(there, {"number": asked.number, "answer": "stop", "name": "Bob"})
        news.close()
    assert given.status == 200
    assert (late.status, late.values["detail"]) == (409, "it was answered already")
    answer = control.questions.given()
    assert (answer.answer, answer.who.name) == ("done", "Eve")


@pytest.mark.parametrize("wish", ["pause", "pause_now", "continue", "stop", "stop_now"])
def test_what_is_wished_on_the_page_the_run_hears(journal: Any, wish: str) -> None:
    written, control = journal
    control.is_pausing = wish == "continue"
    with serving(written.path.parent.parent) as client:
        assert client.post("/api/runs/one/wish", {"wish": wish, "name": "Eve"}).status == 200
    assert (control.is_pausing, control.is_stopping, control.halts) == (
        wish.startswith("pause"),
        wish.startswith("stop"),
        wish.endswith("_now"),
    )
    assert "Eve" in {control.paused_by.name, control.continued_by.name, control.stopped_by.name}


def test_a_dashboard_that_is_flooded_stalled_and_gone_changes_nothing_in_the_run(finished: Any, tmp_path: Path) -> None:
    ticks = 0
    with ExitStack() as opened:

        def disturb(root: Any) -> None:
            nonlocal ticks
            ticks += 1
            if ticks == 5:
                client = opened.enter_context(serving(tmp_path))
                (run,) = (tmp_path / "runs").glob("*.sqlite")
                for _ in range(60):  # each asks for the news, and reads none of it
                    line = opened.enter_context(socket.create_connection(("127.0.0.1", client.port)))
                    line.sendall(
                        f"GET /api/runs/{run.stem}/news HTTP/1.1\r\nHost: 127.0.0.1:{client.port}\r\n\r\n".encode()
                    )
                assert client.post(f"/api/runs/{run.stem}/wish", {"wish": "dance"}).status == 422
            elif ticks == 60:
                opened.close()

        ran = dry_run(tmp_path, TWO, controller=None, at_tick=disturb)
    assert ticks > 60
    assert canonical(ran.journal) == canonical(finished.journal)


def test_of_a_run_that_nobody_has_nothing_can_be_wished(finished: Any) -> None:
    with serving(finished.journal.parent.parent) as client:
        answer = client.post(f"/api/runs/{finished.journal.stem}/wish", {"wish": "stop"})
    assert (answer.status, answer.values["detail"]) == (409, "the run is not running")


def test_a_run_waits_for_the_page_and_goes_on_by_its_answer(tmp_path: Path) -> None:
    run = Run(tmp_path, make_lab(tmp_path / "lab", trees__ask=ASK), RECIPE)
    run.folder = run.lab_folder / ".scuhand" / "runs"

    class Answering(Watch):
        is_done = False

        def ticked(self, root: Any) -> None:
            if not self.is_done and self.session.control.questions.waiting is not None:
                self.is_done = True
                with serving(run.folder.parent) as client:
                    question = next(client.news(run.journal.stem))["question"]
                    body = {"number": question["number"], "answer": "done", "name": "Eve"}
                    assert client.post(f"/api/runs/{run.journal.stem}/answer", body).status == 200

    assert run.go(Answering(), simulation=DryRun(asks=True)).exit_code == 0
    (answered,) = told(run, "answered")
    assert (answered["answer"], answered["by"]) == ("done", "Eve")


@pytest.mark.parametrize(
    ("changed", "word"),
    [
        ({"mode": "SIMULATED", "simulated": True}, "SIMULATED"),
        ({"mode": "REHEARSAL (simulated matter, real drivers)", "simulated": True}, "REHEARSAL"),
        ({"mode": "real devices", "simulated": False, "devices": {"balance": {"port": "/dev/pts/4"}}}, "TWIN"),
        ({"mode": "real devices", "simulated": False, "devices": {"balance": {"port": "/dev/ttyUSB0"}}}, "REAL"),
    ],
)
def test_the_banner_says_what_a_run_moves(changed: dict[str, Any], word: str) -> None:
    assert banner(RunBegun.model_validate({**HEADER, **changed}))[0] == word


def test_a_page_is_told_of_a_journal_that_cannot_be_read(tmp_path: Path) -> None:
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / "bad.sqlite").write_bytes(b"no journal at all" * 100)
    with serving(tmp_path) as client:
        answer = client.get("/api/runs/bad")
        assert client.get("/api/runs").values[0]["state"] == "unreadable"
    assert answer.status == 409
    assert "damaged" in answer.values["detail"]


def test_the_cell_is_drawn_as_motions_are_planned_in_it(finished: Any) -> None:
    with serving(finished.journal.parent.parent) as client:
        scene = client.get(f"/api/runs/{finished.journal.stem}/scene").values
    assert len(scene["joints"]) == 7
    assert scene["joints"][0]["axis"] == [0.0, 0.0, 1.0]
    names = {one["name"] for one in scene["solids"]}
    assert {"balance_body", "mortar_bay", "shield_left"} <= names
    assert len({one["mm"] for one in scene["cones"]}) > 1
    assert all(one["solids"] for one in (*scene["cones"], *scene["containers"]))
    assert {one["name"] for one in scene["containers"]} >= {"xrd_holder", "pellet_die_13mm"}


def test_a_run_brings_its_dashboard_along_and_takes_it_with_it(
    command: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from scuhand_bt.cli import serve

    seen = []

    class Looking(Client):
        def look(self, address: str) -> None:
            deadline_s = time.monotonic() + 20.0
            while time.monotonic() < deadline_s:
                try:
                    seen.append(self.get(f"/api{address[address.index('/runs') :]}").status)
                    return
                except OSError:
                    time.sleep(0.05)

    beside = serve.dashboard_beside

    def looked_at(journal: Path) -> Any:
        class Both:
            def __enter__(self) -> str:
                self.inner = beside(journal)
                address = self.inner.__enter__()
                port = int(address.split(":")[2].split("/")[0])
                Looking(port, None).look(address)
                self.port = port
                return address

            def __exit__(self, *error: Any) -> None:
                self.inner.__exit__(*error)
                with pytest.raises(OSError, match="refused"):
                    Client(self.port, None).get("/")

        return Both()

    monkeypatch.setattr(serve, "dashboard_beside", looked_at)
    lab = make_lab(tmp_path / "lab")
    (tmp_path / "lab" / "recipes").mkdir()
    recipe = lab / "recipes" / "park.yaml"
    (lab / "trees" / "stay.yaml").write_text("workflow: stay\ntree: {sequence: [{park: }]}\n")
    recipe.write_text("recipe: stay\nworkflow: stay\nsamples: [{id: a}]\n")
    ended = command("run", recipe, "--dry-run", "--dashboard", "--lab", lab)
    assert ended.returncode == 0, ended.stderr
    assert "Dashboard: http://127.0.0.1:" in ended.stdout
    assert seen == [200]
