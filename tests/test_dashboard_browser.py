"""The dashboard in a real browser: a run watched from its start to its end, answered, paused and played again."""

import math
import queue
import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from browser import browser_page, needs_browser, serious_faults
from dashboard_client import Client, serving
from running import HEAD, make_lab, shared_planner

from scuhand_bt.dashboard.page_state import Page
from scuhand_bt.journal.follow import Follower
from scuhand_bt.journal.reader import read
from scuhand_bt.lab import load_lab
from scuhand_bt.motion.arm_model import SHEET_M
from scuhand_bt.recipe.plan import make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.run.observers import BatchObserver
from scuhand_bt.run.options import Options
from scuhand_bt.run.session import Session
from scuhand_bt.run.simulation import DryRun

pytestmark = needs_browser
RECIPE = """
recipe: two
workflow: fill
defaults: {source: beads, container: xrd_holder, tolerance: 2 mg}
samples: [{id: a, mass: 20 mg}, {id: "b", mass: 50 mg}]
"""
FILL = """
workflow: asking
inputs: {source: Source, container: Container, mass: Mass, tolerance: Mass}
tree:
  sequence:
    - ask_operator: {question: "Is the <img src=x onerror=alert(1)> shield shut?"}
    - fill_xrd_holder: {source: $source, container: $container, mass: $mass, tolerance: $tolerance}
"""


GoesOn = tuple[Client, Session, threading.Thread]
"""A dashboard, the run that it shows, and the thread in which that goes on."""


@contextmanager
def going_on(folder: Path, speed: float) -> Iterator[GoesOn]:
    """A dry run that goes on, and its dashboard."""
    lab_folder = make_lab(folder / "lab", trees__asking=FILL)
    recipe = lab_folder / "recipe.yaml"
    recipe.write_text(RECIPE.replace("workflow: fill", "workflow: asking") + HEAD, encoding="utf-8")
    lab = load_lab(lab_folder)
    plan = make_plan(load_recipe(recipe, lab), lab)
    made: queue.SimpleQueue[Session] = queue.SimpleQueue()

    def run() -> None:  # all in one thread, to which its journal belongs
        options = Options(DryRun(speed=speed, asks=True), None, lab_folder / ".scuhand" / "runs")
        session = Session(plan, lab, options, shared_planner(plan, lab))
        made.put(session)
        try:
            session.run(BatchObserver())
        finally:
            session.close()

    thread = threading.Thread(target=run)
    with serving(lab_folder / ".scuhand") as client:
        thread.start()
        session = made.get(timeout=60)
        try:
            yield client, session, thread
        finally:
            session.control.wish("stop_now")
            thread.join()


def answer(page: Any) -> None:
    """Answer the question that waits, by keyboard."""
    button = page.locator("#answers button", has_text="done")
    button.wait_for(timeout=30_000)
    button.focus()
    page.keyboard.press("Enter")


SEEING = """window.seen = new Set();
new MutationObserver(() => { for (const line of document.querySelectorAll("#tree li"))
  window.seen.add(line.getAttribute("aria-label"));
}).observe(document, {childList: true, subtree: true, attributes: true});"""


def has_seen(page: Any, label: str) -> None:
    """Wait until a node of the tree was shown so: at many times real time some are for an instant."""
    page.wait_for_function("(label) => window.seen.has(label)", arg=label, timeout=60_000)


def states(page: Any) -> dict[str, str]:
    """The tree that is shown: each node's name and state."""
    said = page.locator("#tree li").evaluate_all("lines => lines.map((line) => line.getAttribute('aria-label'))")
    return dict(re.match(r"([^,]+), ([a-z ]+)", line).groups() for line in said)  # type: ignore[union-attr]


@pytest.mark.real_time
def test_a_run_is_watched_answered_paused_and_played_again(tmp_path: Path, browser: Any) -> None:
    with going_on(tmp_path, 15.0) as (client, session, thread), browser_page(browser, client.origin) as page:
        journal = session.journal.path
        page.add_init_script(SEEING)
        page.goto(f"{client.origin}/runs/{journal.stem}")
        page.locator("#answers button").first.wait_for()
        assert page.locator("#asked").inner_text().startswith("Is the <img src=x onerror=alert(1)> shield shut?")
        assert page.locator("main img").count() == 0, "what a recipe says is no markup"
        assert page.locator("#banner").inner_text().startswith("SIMULATED")
        page.locator("#scene canvas").wait_for(timeout=30_000)
        assert serious_faults(page) == []
        page.get_by_role("button", name="Pause", exact=True).click()
        answer(page)
        page.locator("#state", has_text="paused").wait_for()
        paused_s = session.cell.clock.now_s
        page.wait_for_timeout(400)
        assert session.cell.clock.now_s == paused_s
        page.get_by_role("button", name="Continue").click()
        has_seen(page, "scoop, running")
        has_seen(page, "dispense, running")
        has_seen(page, "cone_holds, failed: hand.cone_empty: the cone is believed to hold 0 mg")
        page.locator("#chart .reading").wait_for(state="attached")
        answer(page)
        page.locator("#samples tr", has_text=re.compile("^a.*in tolerance")).wait_for(timeout=60_000)
        page.locator("#state", has_text=re.compile("^complete")).wait_for(timeout=90_000)
        thread.join()
        assert page.locator("#samples .good").count() == 2
        assert page.locator("#control button:enabled").count() == 0
        replay_is_the_journal(page, journal)
        cone_follows_the_roller(page, journal)
        assert serious_faults(page) == []
    asked = [row["payload"] for row in read(journal, "event") if row["kind"] in ("answered", "paused", "continued")]
    assert len(asked) == 4
    assert all(one["by"] for one in asked)


def cone_follows_the_roller(page: Any, journal: Path) -> None:
    """Within a stroke the cone that is drawn is as wide as the journal has it, whatever width the scene has."""
    strokes = [
        row for row in read(journal, "event") if row["kind"] == "arm_moves" and len(row["payload"]["rims_mm"]) > 9
    ]
    row = max(strokes, key=lambda row: len(row["payload"]["joints_rad"]))
    rims_mm = row["payload"]["rims_mm"]
    for k in (0, len(rims_mm) // 3, 2 * len(rims_mm) // 3, len(rims_mm) - 1):
        drawn_mm = page.evaluate(
            "([move, s]) => { window.viewer.at(move, s); return window.viewer.rim(); }",
            [{"at_s": 0.0, **row["payload"]}, k * row["payload"]["step_s"]],
        )
        assert drawn_mm == pytest.approx(rims_mm[k] + 2e3 * SHEET_M, abs=0.2)


def replay_is_the_journal(page: Any, journal: Path) -> None:
    """At moments of the run the page shows what its journal has of them."""
    doses = [row for row in read(journal, "action") if row["skill"] in ("dispense", "scoop")]
    for time_s in sorted((row["started_s"] + row["ended_s"]) / 2 for row in doses):
        page.evaluate(
            """(time_s) => { const slider = document.getElementById("slider");
               slider.value = String(time_s); slider.dispatchEvent(new Event("input")); }""",
            time_s,
        )
        shown_s = float(page.locator("#slider").input_value())
        told = Page(Follower(journal, until_s=shown_s)).news(is_held=True)
        page.locator("#job", has_text=told["job"]["about"]).wait_for()
        page.wait_for_function("(time_s) => window.shownAt === time_s", arg=shown_s)
        assert states(page) == {node["name"]: node["state"] for node in told["tree"]}
        rows = {row["id"]: row["verdict"] for row in told["rows"]}
        shown = page.locator("#samples tr").evaluate_all(
            "rows => rows.map((row) => [row.cells[0].textContent, row.cells[2].textContent])"
        )
        assert dict(shown) == rows
        if told["course"]:
            assert page.locator("#net").inner_text() == f"{told['course'][-1][1]:.1f} mg"


@pytest.fixture(scope="module")
def waiting(tmp_path_factory: pytest.TempPathFactory) -> Iterator[GoesOn]:
    """A run that waits with its question."""
    with going_on(tmp_path_factory.mktemp("waiting"), 20.0) as run:
        yield run


@pytest.mark.parametrize(("width", "height", "scheme"), [(390, 844, "dark"), (1400, 900, "light")])
def test_it_fits_a_phone_and_a_desk_light_and_dark(
    waiting: GoesOn, browser: Any, width: int, height: int, scheme: str
) -> None:
    client, session, _ = waiting
    size: Any = {"viewport": {"width": width, "height": height}, "color_scheme": scheme}
    with browser_page(browser, client.origin, **size) as page:
        for there, loaded in ((f"/runs/{session.journal.path.stem}", "#answers button"), ("/", "#runs tr")):
            page.goto(client.origin + there)
            page.locator(loaded).first.wait_for()
            assert page.evaluate("document.documentElement.scrollWidth") <= width, "nothing scrolls sideways"
            assert serious_faults(page) == []


def test_the_arm_is_drawn_where_pinocchio_has_it(waiting: GoesOn, browser: Any) -> None:
    client, session, _ = waiting
    with browser_page(browser, client.origin) as page:
        page.goto(f"{client.origin}/runs/{session.journal.path.stem}")
        page.locator("#scene canvas").wait_for(timeout=30_000)
        model = session.cell.motion.scene().model
        data, tip_m = model.createData(), np.array([0.0, 0.0, session.cell.spec.hand.apex_offset_mm / 1000])
        for seed in range(5):
            q = np.random.default_rng(seed).uniform(-1.2, 1.2, 7)
            drawn = page.evaluate("(q) => { const v = window.viewer; v.pose(q); return v.apex(); }", q.tolist())
            pin.forwardKinematics(model, data, q)
            assert math.dist(drawn, data.oMi[7].act(tip_m)) < 1e-4


@pytest.mark.slow
def test_a_run_is_stopped_from_the_page(waiting: GoesOn, browser: Any) -> None:
    client, session, thread = waiting
    with browser_page(browser, client.origin) as page:
        page.on("dialog", lambda dialog: dialog.accept())
        page.add_init_script(SEEING)
        page.goto(f"{client.origin}/runs/{session.journal.path.stem}")
        answer(page)
        has_seen(page, "place_container, running")
        page.get_by_role("button", name="Stop now").click()
        page.locator("#state", has_text="stopped").wait_for(timeout=30_000)
        assert page.locator("#progress").inner_text() == "Samples: 1 of 2", "the other was not run"
        thread.join(10)
        assert not thread.is_alive()
