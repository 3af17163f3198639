"""Twins in a process of their own: their world outlives every program, and a rehearsal goes on with it."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from conftest import Call
from daily import first_daily
from running import make_lab, shared_planner
from test_rehearse import HEAD, OPEN

import scuhand_bt.run.twins_process as process_module
from harness.kill import Batch, Kill, Tally, journals, kill_until_done, run_child
from scuhand_bt.failures import SkillFailed
from scuhand_bt.journal.history import read_history
from scuhand_bt.journal.reader import read
from scuhand_bt.lab import Lab, load_lab, starter_lab
from scuhand_bt.problems import SourceError
from scuhand_bt.recipe.plan import make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.run.twins import LOG, WORLD, Made, folder_of_run, have_their_process, open_twins, say
from scuhand_bt.run.twins_process import TwinsProcess
from scuhand_bt.sim.fault_rules import parse_faults
from scuhand_bt.sim.world import masses_in
from scuhand_bt.specs import Source

TWICE_OPENED = "workflow: twice\ntree: {sequence: [{check_valve: }, {check_valve: }]}\n"
DOSED = (
    HEAD
    + "  - {id: a, workflow: scoop_and_dispense, source: beads, container: xrd_holder, mass: 50 mg, tolerance: 5 mg}\n"
)
WHOLE_MG = 6000.0


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Lab:
    return load_lab(make_lab(tmp_path_factory.mktemp("lab") / "lab", trees__twice=TWICE_OPENED, trees__open=OPEN))


@pytest.fixture(scope="module")
def sources() -> dict[str, Source]:
    library = load_lab(starter_lab()).library
    mortar, powder = library.mortars["agate_mortar"], library.powders["glass_beads"]
    return {
        "beads": Source(name="beads", station="mortar_bay", mortar=mortar, powder=powder, amount_mg=WHOLE_MG),
    }


@contextmanager
def running(folder: Path, lab: Lab) -> Iterator[subprocess.Popen[bytes]]:
    """Twins of another program, which hear."""
    recipe = folder.parent / "recipe.yaml"
    recipe.write_text(HEAD + "  - {id: a, workflow: open}\n", encoding="utf-8")
    command = [sys.executable, "-m", "scuhand_bt", "twins", str(recipe), "--lab", str(lab.folder), "--at", str(folder)]
    with subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline().startswith(b"Twins of the cell")
            while not is_heard(folder):
                time.sleep(0.02)
            yield process
        finally:
            process.kill()


def is_heard(folder: Path) -> bool:
    try:
        return say(folder, ["look"]).is_done
    except SourceError:
        return False


# --- a world on disk


def test_what_the_twins_are_is_there_again_where_it_was(tmp_path: Path, lab: Lab, sources: dict[str, Source]) -> None:
    with TwinsProcess(tmp_path, lab, sources, seed=3) as twins:
        bench = twins.bench
        assert not twins.goes_on
        assert twins.obey(["place", "xrd_holder", "a"]).is_done
        assert twins.obey(["fill", "7", "xrd_holder", "b"]).is_done
        assert twins.obey(["load", "beads", "2 g"]).is_done
        bench.bus.twin.servos[4].shaft += 300.0
        bench.bus.twin.servos[9].shaft += 3000.0
        bench.bus.twin.servos[2].put(64, 1, 1)
        bench.balance.twin.tare_mg = 12.0
        bench.others["changer"].twin.shaft.shaft += 40.0
        time.sleep(0.3)
        bench.hand.twin.valve.servo.position = 2300.0
    before, again = bench, TwinsProcess(tmp_path, lab, sources, seed=3)
    bench = again.bench
    assert again.goes_on
    assert bench.world.now_s == before.world.now_s > 0.1
    assert bench.world.masses_mg == before.world.masses_mg
    assert 1900.0 < bench.world.masses_mg["cone"] <= 2000.0
    assert bench.world.pan.container_id == "a"
    assert [servo.position for servo in bench.bus.twin.servos.values()] == [
        servo.position for servo in before.bus.twin.servos.values()
    ]
    assert bench.bus.twin.servos[9].shaft == before.bus.twin.servos[9].shaft > 4000.0
    assert bench.bus.twin.servos[2].has_torque
    assert bench.rim_mm == pytest.approx(before.rim_mm, abs=0.1)
    assert bench.rim_mm != pytest.approx(90.0, abs=1.0)
    assert bench.balance.twin.tare_mg == 12.0
    assert bench.others["changer"].twin.shaft.position == before.others["changer"].twin.shaft.position
    assert bench.scene.kept == before.scene.kept
    assert bench.scene.kept[6]["id"] == "b"
    assert before.hand.twin.opening_mm > 0.5
    assert bench.hand.twin.opening_mm == 0.0, "nobody spoke to it any more"
    with again:
        time.sleep(0.3)
    assert bench.world.masses_mg["cone"] == pytest.approx(before.world.masses_mg["cone"], abs=20.0)
    with TwinsProcess(tmp_path, lab, sources, seed=3, is_new=True) as twins:
        assert not twins.goes_on
        assert twins.bench.world.masses_mg["cone"] == 0.0


def test_a_world_of_another_cell_powder_or_seed_is_not_gone_on_with(
    tmp_path: Path, lab: Lab, sources: dict[str, Source]
) -> None:
    with TwinsProcess(tmp_path, lab, sources):
        pass
    other = "this world is of the cell 'starter' with 'beads' (glass_beads in agate_mortar at mortar_bay), seed 0"
    for now, seed in (({}, 0), (sources, 1)):
        with pytest.raises(SourceError) as refused:
            TwinsProcess(tmp_path, lab, now, seed=seed)
        assert other in str(refused.value)
    (tmp_path / "made.json").write_text("{}", encoding="utf-8")
    with pytest.raises(SourceError, match="does not say what the world"):
        TwinsProcess(tmp_path, lab, sources)
    with TwinsProcess(tmp_path, lab, {}, is_new=True) as twins:
        assert not twins.goes_on


def test_the_balance_shows_nothing_that_is_not_on_disk(tmp_path: Path, lab: Lab, sources: dict[str, Source]) -> None:
    with TwinsProcess(tmp_path, lab, sources) as twins:
        bench = twins.bench
        pan = bench.balance.twin.pan
        twins.obey(["place", "xrd_holder", "a"])
        time.sleep(0.5)
        bench.world.save_changes = lambda: time.sleep(1.0)  # type: ignore[method-assign]  # a slow disk
        time.sleep(0.1)
        twins.obey(["remove"])
        shown_mg = pan.gross_mg(0.0)
        time.sleep(0.5)
        assert pan.gross_mg(0.0) == shown_mg > 1000.0, "it is off the pan, and the world is not saved yet"


@pytest.mark.parametrize("moment_s", first_daily(0.013, 0.0, 0.1))
def test_of_twins_that_are_killed_while_they_save_all_that_they_have_said_is_on_disk(
    tmp_path: Path, lab: Lab, sources: dict[str, Source], moment_s: float
) -> None:
    folder, answered = tmp_path / "twins", 0
    with running(folder, lab) as process:
        until_s = time.monotonic() + moment_s
        while time.monotonic() < until_s or answered == 0:
            assert say(folder, ["refill", "beads", "1 mg"]).is_done
            answered += 1
        process.kill()
        process.wait()
    assert masses_in(folder / WORLD)["source:beads"] == WHOLE_MG + answered
    with TwinsProcess(folder, lab, sources) as twins:
        assert twins.goes_on
        assert twins.bench.world.masses_mg["source:beads"] == WHOLE_MG + answered


# --- what a person says to them


@pytest.mark.slow
def test_from_another_terminal_twins_do_what_a_person_would(tmp_path: Path, lab: Lab, command: Call) -> None:
    folder = tmp_path / "twins"
    with running(folder, lab) as process:
        for words, code, said in (
            ("place xrd_holder a", 0, "'a' stands on the pan"),
            ("place xrd_holder a", 0, "'a' stands on the pan"),
            ("place xrd_holder b", 2, "not done: 'a' stands on the pan"),
            ("refill beads 1.5 g", 0, "the mortar of 'beads' holds 7.5000 g"),
            ("refill beads nan g", 2, "not done: "),
            ("unplug hand", 0, "the cable of 'hand' is out"),
            ("plug hand", 0, "the cable of 'hand' is in"),
            ("look", 0, "'a' stands on the pan; the valve is shut, the rim 90 mm wide; powder: source:beads 7.5000 g"),
            ("dance", 2, "not done: write one of: place KIND ID"),
        ):
            ended = command("twins", *words.split(), "--at", folder)
            assert ended.returncode == code, ended.stderr
            assert (ended.stdout or ended.stderr).startswith(said)
        again = command("twins", "--at", folder)
        assert again.returncode == 2
        assert (
            f"{folder}: twins are running here already; `scuhand-bt twins end --at {folder}` ends them" in again.stderr
        )
        assert command("twins", "end", "--at", folder).returncode == 0
        assert process.wait(30) == 0
    nobody = command("twins", "remove", "--at", folder)
    assert nobody.returncode == 2
    assert "no twins are running here; `scuhand-bt twins` starts them" in nobody.stderr


def test_twins_of_a_run_that_is_gone_end_by_themselves(
    tmp_path: Path, lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(process_module, "LOOK_S", 0.05)
    monkeypatch.setattr(process_module, "ALONE_S", 0.2)
    with TwinsProcess(tmp_path, lab, {}, of_run=True) as twins:
        twins.go_on()
    assert not have_their_process(tmp_path)


def test_only_twins_of_a_run_can_have_faults_of_its_samples_and_its_person(tmp_path: Path, lab: Lab) -> None:
    faults = parse_faults("faults: [{fault: operator.refuses, sample: a}]", "faults.yaml")
    with pytest.raises(SourceError, match=r"'operator\.refuses' has no effect here: nobody is asked by twins alone"):
        TwinsProcess(tmp_path, lab, {}, faults=faults)
    with TwinsProcess(tmp_path, lab, {}, faults=faults, of_run=True) as twins:
        for sample, comes in (("b", False), ("a", True), ("a", False)):
            assert twins.obey(["sample", sample, "1"]).is_done
            assert twins.obey(["comes", "operator.refuses"]).found["comes"] == comes
        (account,) = twins.obey(["look"]).found["faults"]  # type: ignore[misc]
        assert len(account["came_s"]) == 1  # type: ignore[arg-type, call-overload, index]


def test_twins_that_do_not_begin_say_why(tmp_path: Path, lab: Lab) -> None:
    made = Made.of(lab, {}, 0, None)
    with pytest.raises(SourceError, match=r"twins: the twins did not begin: .*nowhere\.yaml"):
        open_twins(tmp_path / "twins", made, ["nowhere.yaml"], print)
    assert (tmp_path / "twins" / LOG).exists()


# --- rehearsals on them


def batch_of(folder: Path, lab: Lab, recipe: str) -> Batch:
    path = folder / "recipe.yaml"
    path.write_text(recipe, encoding="utf-8")
    plan = make_plan(load_recipe(path, lab), lab)
    return Batch(plan, lab, shared_planner(plan, lab), folder / "state" / "runs", 2, rehearses=True)


@pytest.mark.real_time
@pytest.mark.parametrize("twins_too", first_daily(False, True))
def test_a_rehearsal_that_was_killed_goes_on_with_its_twins_or_with_their_world(
    tmp_path: Path, lab: Lab, twins_too: bool
) -> None:
    batch = batch_of(tmp_path, lab, HEAD + "  - {id: a, workflow: twice}\n")
    assert run_child(batch, None, Kill(at_tick=3)) is None
    (journal,) = journals(batch.folder)
    folder = folder_of_run(journal)
    before = say(folder, ["look"]).found
    assert say(folder, ["refill", "beads", "1 g"]).is_done, "they outlive the program"
    if twins_too:
        os.kill(int(str(before["pid"])), signal.SIGKILL)
        while have_their_process(folder):
            time.sleep(0.01)
    assert run_child(batch, journal, Kill()) == 0
    history = read_history(journal)
    assert history.is_complete
    assert history.run.mode.startswith("REHEARSAL")
    (matter,) = [event["payload"] for event in read(journal, "event") if event["kind"] == "matter"]
    assert matter["source:beads"] == WHOLE_MG + 1000.0
    assert masses_in(folder / WORLD)["source:beads"] == WHOLE_MG + 1000.0
    assert not have_their_process(folder), "they end with a run that has ended"


@pytest.mark.slow
@pytest.mark.real_time
def test_twins_that_die_within_a_rehearsal_end_it_and_it_is_resumed(tmp_path: Path, lab: Lab) -> None:
    folder = tmp_path / "twins"
    with running(folder, lab) as process:
        made = Made.of(
            lab, batch_of(tmp_path, lab, HEAD + "  - {id: a, workflow: open}\n").plan.recipe.sources, 0, None
        )
        twins = open_twins(folder, made, [], print)
        twins.check()
        assert twins.masses_mg["source:beads"] == WHOLE_MG
        process.kill()
        process.wait()
        with pytest.raises(SkillFailed, match=r"device\.lost: the twins have ended; their state is on disk"):
            twins.check()
        with pytest.raises(SkillFailed, match="the twins have ended"):
            twins.remove()
        assert twins.masses_mg["source:beads"] == WHOLE_MG, "as their file has it"
        twins.end()


@pytest.mark.real_time
@pytest.mark.slow
def test_of_a_rehearsal_that_is_killed_within_its_dose_with_and_without_its_twins_the_dose_is_once(
    tmp_path: Path, lab: Lab
) -> None:
    batch, tally = batch_of(tmp_path, lab, DOSED), Tally()
    kills = [Kill(at_tick=40, within="scoop"), Kill(at_tick=20, within="dispense")]
    kills += [Kill(at_tick=5, within="dispense", takes_twins=True)]
    kill_until_done(batch, kills, tally)
    assert tally.problems == []
    assert (tally.kills, tally.of_twins, tally.doses) == (3, 1, 1)
