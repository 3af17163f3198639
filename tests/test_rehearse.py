"""A rehearsal: the real drivers carry out a recipe in real time, and the world behind the twins judges it."""

import itertools
import time
from dataclasses import replace
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np
import pytest
from daily import first_daily
from running import Watching, make_lab, shared_planner

from harness.roller_kill import JAR
from scuhand_bt import api
from scuhand_bt.devices.scuhand import ScuHand
from scuhand_bt.journal.reader import read
from scuhand_bt.lab import Lab, load_lab
from scuhand_bt.lab_state.inventory import Inventory
from scuhand_bt.problems import SourceError
from scuhand_bt.recipe.plan import make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.run.bench import bench_of
from scuhand_bt.run.options import ON_TWINS, Options, options_of
from scuhand_bt.run.questions import Who
from scuhand_bt.run.resume import checked_history, resumable
from scuhand_bt.run.session import Session
from scuhand_bt.run.simulation import DryRun, Rehearsal
from scuhand_bt.run.twins import Twins
from scuhand_bt.sim.wire.hand import NoCompiler

pytestmark = pytest.mark.real_time

DOSE = """\
workflow: dose
inputs: {container: Container, mass: Mass, tolerance: Mass}
result: $dose
tree:
  sequence:
    - place_container: {container: $container}
    - tare:
    - move_over: {container: $container}
    - dispense: {mass: $mass, tolerance: $tolerance, as: dose}
    - park:
    - remove_container:
"""
OPEN = """\
workflow: open
tree:
  check_valve:
"""
SCOOP = """\
workflow: scoop_once
inputs: {source: Source}
tree:
  scoop: {source: $source}
"""
HEAD = """\
recipe: rehearsed
sources:
  beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 6 g}
samples:
"""
ONE_DOSE = HEAD + "  - {id: a, workflow: dose, container: xrd_holder, mass: 50 mg, tolerance: 5 mg}\n"


class BreaksSoon:
    """A plant that is sound when it is tried, and breaks as soon as powder should flow in the run."""

    class Flow:
        steps = 0

        def step(self, dt_s: float, opening_mm: float, vibration: float, in_cone_mg: float, rng: object) -> float:
            self.steps += 1
            return float("nan") if self.steps > 4 else 0.0

    def flow(self, powder: object) -> "BreaksSoon.Flow":
        return self.Flow()


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Lab:
    trees = {"trees__dose": DOSE, "trees__open": OPEN, "trees__scoop_once": SCOOP}
    folder = make_lab(tmp_path_factory.mktemp("lab") / "lab", **trees)
    with (folder / "robot" / "containers.yaml").open("a", encoding="utf-8") as kinds:
        kinds.write(JAR)
    return load_lab(folder)


def session_of(folder: Path, lab: Lab, simulation: DryRun | Rehearsal | None, recipe: str = ONE_DOSE) -> Session:
    path = folder / "recipe.yaml"
    path.write_text(recipe, encoding="utf-8")
    plan = make_plan(load_recipe(path, lab), lab)
    return Session(plan, lab, Options(simulation, "adaptive", folder / "runs"), shared_planner(plan, lab))


def told(session: Session, *words: str) -> Any:
    """Say something to the twins of a rehearsal; what was found."""
    assert isinstance(session.truth, Twins)
    return session.truth.say(*words)


def load_by_hand(session: Session) -> None:
    """Fill the cone as the paper's experiments did: a scoop takes its time."""
    if session.world is not None:
        session.world.load_cone("beads", 3000.0)
    else:
        told(session, "load", "beads", "3 g")
    session.cell.believed.cone_holds(session.cell.sources["beads"], 3000.0)


@pytest.mark.slow
def test_a_rehearsed_dose_has_the_verdict_of_the_dry_run_and_says_what_it_is(tmp_path: Path, lab: Lab) -> None:
    verdicts = []
    for simulation in (DryRun(seed=2), Rehearsal(seed=2)):
        session = session_of(tmp_path, lab, simulation)
        try:
            load_by_hand(session)
            result = session.run(Watching(session))
        finally:
            session.close()
        (sample,) = result.samples
        verdicts.append((sample.verdict, sample.code))
        assert sample.dispensed_mg == pytest.approx(sample.true_mg, abs=1.5)
    assert verdicts[0] == verdicts[1] == ("in tolerance", None)
    assert isinstance(session.cell.hand, ScuHand)
    assert session.cell.simulated
    run = {row["key"]: row["value"] for row in read(session.journal.path, "run")}
    assert run["simulated"] == "true"
    assert run["mode"] == "REHEARSAL (simulated matter, real drivers)"


@pytest.mark.slow
@pytest.mark.parametrize(("vessel", "least_mg"), [("agate_mortar", 3000.0), ("jar_95", 300.0)])
def test_a_rehearsed_scoop_spills_less_than_a_hundredth(tmp_path: Path, lab: Lab, vessel: str, least_mg: float) -> None:
    recipe = HEAD.replace("agate_mortar", vessel) + "  - {id: a, workflow: scoop_once, source: beads}\n"
    session = session_of(tmp_path, lab, Rehearsal(seed=1), recipe)
    twins, ticks, most_mg = session.truth, itertools.count(), [0.0]
    assert twins is not None

    def look(root: Any) -> None:
        if next(ticks) % 20 == 0:  # asking them takes a moment of its own
            most_mg.append(twins.masses_mg["cone"])

    try:
        result = session.run(Watching(session, at_tick=look))
        assert (result.exit_code, result.reason) == (0, "")
        assert max(most_mg) > least_mg
        assert twins.masses_mg["spilled"] < 0.01 * max(most_mg)
    finally:
        session.close()


def test_a_rehearsal_that_is_stopped_ends_safe_and_leaves_nobody_watched(tmp_path: Path, lab: Lab) -> None:
    session = session_of(tmp_path, lab, Rehearsal())
    watching = Watching(session, stop_at=5)
    result = session.run(watching)
    arm, hand = session.cell.arm, session.cell.hand
    assert result.exit_code == 130
    assert arm.is_stopped
    assert hand.is_stopped
    rests = arm.positions
    session.close()
    assert np.allclose(arm.positions, rests)


@pytest.mark.parametrize("device", first_daily("arm", "hand", "balance"))
def test_a_device_that_is_unplugged_at_work_is_named_and_the_cell_ends_safe(
    tmp_path: Path, lab: Lab, device: str
) -> None:
    recipe = ONE_DOSE if device == "balance" else HEAD + "  - {id: a, workflow: open}\n"
    session = session_of(tmp_path, lab, Rehearsal(), recipe)

    def pull(root: Any) -> None:
        seen = told(session, "look")
        if {"arm": seen["turns"], "hand": seen["opening_mm"] > 0.5, "balance": True}[device]:
            told(session, "unplug", device)

    try:
        result = session.run(Watching(session, at_tick=pull))
        seen = told(session, "look")
    finally:
        session.close()
    assert result.exit_code == 3
    assert "device.lost" in result.reason
    assert seen["opening_mm"] < 0.04
    assert seen["vibration"] == 0.0
    assert seen["has_torque"], "the arm has no brakes"


@pytest.mark.slow
def test_a_plant_that_fails_in_the_middle_ends_the_rehearsal(tmp_path: Path, lab: Lab) -> None:
    opened = HEAD + "  - {id: a, workflow: open}\n"
    session = session_of(tmp_path, lab, Rehearsal(plant="test_rehearse:BreaksSoon"), opened)
    try:
        load_by_hand(session)
        result = session.run(Watching(session))
        assert result.exit_code == 3
        assert "nan" in result.reason
    finally:
        session.close()


def test_without_a_compiler_there_is_no_rehearsal(tmp_path: Path, lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(NoCompiler, match=r"install g\+\+"):
        session_of(tmp_path, lab, Rehearsal())


# --- on twins of another program


def stop(session: Session) -> None:
    """How far the sheet is rolled no run in this lab has kept: it is asked for, and whoever is asked stops the run."""
    while (asked := session.control.questions.waiting) is None:
        time.sleep(0.05)
    session.control.questions.give(asked.number, "stop", Who("Ada"))


@pytest.mark.slow
def test_a_run_on_twins_of_another_program_says_so_and_nothing_of_it_is_taken_for_real(
    tmp_path: Path, lab: Lab
) -> None:
    with bench_of(lab) as bench:
        at_twins = replace(lab, cell=bench.spec)
        session = session_of(tmp_path, at_twins, None, HEAD + "  - {id: a, workflow: open}\n")
        try:
            assert session.cell.simulated
            assert session.mode == ON_TWINS
            assert "real" not in session.title.replace("real drivers", "")
            Thread(target=stop, args=(session,), daemon=True).start()
            session.run(Watching())
        finally:
            session.close()
    history = checked_history(session.journal.path)
    assert (history.run.mode, history.run.simulated, history.run.seed) == (ON_TWINS, True, None)
    inventory = Inventory(tmp_path, lab.cell.cell)
    assert inventory.stock(simulated=False) == {}
    assert inventory.stock(simulated=True) != {}
    assert options_of(history, tmp_path).simulation is None, "it goes on at the same ports"


@pytest.mark.slow
def test_the_api_runs_on_what_is_at_the_ports_of_the_cell(tmp_path: Path, lab: Lab) -> None:
    recipe = tmp_path / "one.yaml"
    recipe.write_text(HEAD + "  - {id: a, workflow: open}\n", encoding="utf-8")
    told: list[api.RunEvent] = []

    def hear(event: api.RunEvent) -> None:
        told.append(event)
        if event.kind == "asked":
            (journal,) = (tmp_path / "runs").glob("*.sqlite")
            run = api.find_run(journal)
            if (asked := run.question()) is not None:
                run.answer(asked, "done")

    with bench_of(lab) as bench:
        at_twins = api.OpenLab(replace(lab, cell=bench.spec))
        result = at_twins.run(recipe, operator="Ada", journals=tmp_path / "runs", on_event=hear)
    assert told[0].values["mode"] == ON_TWINS
    assert told[0].values["operator"] == "Ada"
    assert told[-1].kind in ("ended", "trouble")
    assert [event.seq for event in told] == list(range(1, len(told) + 1))
    assert result.notices == ()


def test_a_run_that_was_begun_on_real_devices_does_not_go_on_upon_twins(
    tmp_path: Path, lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    recipe = HEAD + "  - {id: a, workflow: open}\n"
    with bench_of(lab) as bench:
        at_twins = replace(lab, cell=bench.spec)
        with monkeypatch.context() as real:
            real.setattr("scuhand_bt.run.session.is_twin", lambda identity: False)
            real.setattr("scuhand_bt.run.session.beyond_limits", lambda *_: [])
            session = session_of(tmp_path, at_twins, None, recipe)
            session.close()
        path = session.journal.path
        found = resumable(path, checked_history(path), session.plan, at_twins, accept_changes=True)
        with pytest.raises(SourceError, match="begun on real devices, and twins are at the ports"):
            Session(session.plan, at_twins, Options(None, folder=tmp_path / "runs"), resumes=found)
