"""Faults by a file: how it is read, when they come, and what they do to a run."""

import json
from contextlib import suppress
from pathlib import Path

import pytest
from conftest import problems_of
from daily import first_daily
from hypothesis import given, settings
from hypothesis import strategies as st
from running import Ran, Watching, dry_run, shared_planner
from wire_helpers import carry_out, wait_for

from harness.fault_matrix import FAULTS, MOMENTS, Matrix
from scuhand_bt.clock import Steps
from scuhand_bt.devices.connect import Devices, connect_cell_devices
from scuhand_bt.journal.export import canonical
from scuhand_bt.journal.reader import open_contents
from scuhand_bt.lab import load_lab, starter_lab
from scuhand_bt.problems import SourceError
from scuhand_bt.recipe.plan import make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.run.bench import bench_of
from scuhand_bt.run.clock import WallClock
from scuhand_bt.run.options import options_of
from scuhand_bt.run.resume import checked_history, resumable
from scuhand_bt.run.session import Session
from scuhand_bt.sim.fault_rules import KINDS, parse_faults
from scuhand_bt.sim.faults import Faults
from scuhand_bt.sim.plain_state import read, written
from scuhand_bt.skill import SkillFailed

BATCH = """
recipe: two
workflow: scoop_and_dispense
defaults: {container: pellet_die_13mm, tolerance: 10 mg}
samples: [{id: a, source: beads, mass: 300 mg}, {id: b, source: msg, mass: 100 mg}]
on_failure: {container.wrong_mass: skip_sample, otherwise: stop}
"""


def faults_of(*rules: str, seed: int = 0) -> Faults:
    return Faults(parse_faults("faults:\n" + "\n".join(f"  - {{{rule}}}" for rule in rules), "f").rules, seed)


def run_with(tmp_path: Path, *rules: str, controller: str = "adaptive", recipe: str = BATCH) -> Ran:
    text = "faults:\n" + "\n".join(f"  - {{{rule}}}" for rule in rules)
    return dry_run(tmp_path, recipe, faults=text, controller=controller)


def came(ran: Ran) -> list[list[float]]:
    """When each rule's fault came, as the journal has it."""
    with open_contents(ran.journal) as contents:
        events = [event["payload"] for event in contents.rows("event") if event["kind"] == "fault_rules"]
    return [rule["came_s"] for rule in events[-1]["rules"]]


# --- the file


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("faults:\n  - {fault: balance.silnt, at: 2 s}", "2:13: there is no fault 'balance.silnt'; known: "),
        ("faults:\n  - {fault: balance.silent, at: 2}", "2:33: 'at': '2' has no unit; write a duration"),
        ("faults:\n  - {fault: balance.silent, at: 2 mg}", "2:33: 'at': 'mg' is a unit of mass, not of duration"),
        ("faults:\n  - {fault: valve.slow, at_puls: 2}", "2:25: unknown key 'at_puls'; known: "),
        ("faults:\n  - {fault: valve.slow, at_pulse: 0}", "2:35: 'at_pulse': '0' is not accepted"),
        ("faults:\n  - {fault: valve.slow, probability: 2}", "2:38: 'probability': '2' is not accepted"),
        ("faults:\n  - {fault: valve.slow, at: 1 s, at_pulse: 2}", "2:25: 'at' and 'at_pulse' both say when"),
        ("faults:\n  - {fault: scoop.nothing, for: 3 s}", "2:28: 'scoop.nothing' is over in a moment"),
        ("faults:\n  - {fault: valve.slow, at: 1 s, times: 2}", "2:34: 'at' comes once in a run"),
        ("faults:\n  - {at: 1 s}", "2:5: 'fault' is missing"),
        (
            "faults:\n  - valve.slow",
            "2:5: expected a rule, such as {fault: balance.silent, at: 2 min}, found 'valve.slow'",
        ),
        ("faults: []", "1:9: 'faults': an empty list names no fault"),
        ("fault: []", "1:1: unknown key 'fault'; known: faults; did you mean 'faults'?"),
        ("[]", "1:1: expected a fault file, found an empty list"),
    ],
)
def test_a_mistake_is_said_with_its_place(text: str, problem: str) -> None:
    found = problems_of(lambda: parse_faults(text, "faults.yaml"))
    assert any(message.startswith(problem) for message in found), found


def test_all_mistakes_are_said_at_once_and_the_nearest_name_is_offered() -> None:
    text = "faults:\n  - {fault: valve.stuck-open}\n  - {fault: cone.leak, at: soon}\n"
    problems = problems_of(lambda: parse_faults(text, "f"))
    assert len(problems) == 2
    assert problems[0].endswith("did you mean 'valve.stuck_open'?")


def test_a_rule_about_an_unknown_sample_is_refused_before_anything_moves(tmp_path: Path) -> None:
    problems = problems_of(lambda: run_with(tmp_path, "fault: scoop.nothing, sample: c"))
    assert problems == ["2:5: no sample of this recipe is called 'c'; known: a, b"]


@given(st.text(max_size=60))
@settings(max_examples=60, deadline=None)
def test_any_text_is_read_or_refused_cleanly(text: str) -> None:
    with suppress(SourceError):
        assert parse_faults(f"faults:\n  - {{fault: cone.leak, {text}}}", "f").rules


# --- when faults come


def test_the_nth_opening_is_counted_over_the_run_or_within_the_rules_sample() -> None:
    faults = faults_of("fault: valve.slow, at_pulse: 3, for: 1 s", "fault: cone.leak, at_pulse: 2, sample: b, for: 1 s")
    seen = []
    for opening, sample in enumerate(["a", "a", "b", "b"]):
        if sample not in [name for _, name in seen]:
            faults.begin_sample(sample, 1, 10.0 * opening)
        faults.advance(10.0 * opening)
        faults.opening(10.0 * opening)
        seen.append((sorted(faults.active), sample))
    assert [active for active, _ in seen] == [[], [], ["valve.slow"], ["cone.leak"]]


def test_a_fault_lasts_as_long_as_its_rule_says_else_to_the_end() -> None:
    faults = faults_of("fault: balance.silent, at: 2 s, for: 3 s", "fault: vibration.dead, at: 4 s")
    there = {}
    for second in range(8):
        faults.advance(float(second))
        there[second] = sorted(faults.active)
    assert there[1] == []
    assert there[2] == there[3] == ["balance.silent"]
    assert there[4] == ["balance.silent", "vibration.dead"]
    assert there[5] == there[7] == ["vibration.dead"]


def test_of_two_that_exclude_one_another_the_earlier_rule_wins() -> None:
    faults = faults_of(
        "fault: valve.stuck_closed, at: 5 s, for: 2 s", "fault: valve.slow, at: 1 s", "fault: valve.stuck_open, at: 2 s"
    )
    there = {}
    for second in range(9):
        faults.advance(float(second))
        there[second] = list(faults.active)
    assert there[2] == ["valve.slow"]
    assert there[5] == ["valve.stuck_closed"]
    assert there[8] == ["valve.slow"]
    assert [bool(rule["came_s"]) for rule in faults.account()] == [True, True, False]


def test_a_drawn_fault_comes_about_as_often_as_it_is_likely_and_the_same_for_one_seed() -> None:
    drawn = []
    for seed in (4, 4, 5):
        faults = faults_of("fault: scoop.nothing, probability: 0.2", seed=seed)
        drawn.append([faults.comes("scoop.nothing", float(scoop)) for scoop in range(1000)])
    assert drawn[0] == drawn[1] != drawn[2]
    assert sum(drawn[0]) == pytest.approx(200, abs=40)


def test_times_is_how_often_a_fault_may_come() -> None:
    faults = faults_of("fault: scoop.nothing, times: 2", "fault: operator.refuses, at: 5 s")
    assert [faults.comes("scoop.nothing", 0.0) for _ in range(3)] == [True, True, False]
    assert not faults.comes("operator.refuses", 1.0)
    faults.advance(6.0)
    assert faults.comes("operator.refuses", 7.0)  # at the first question after that time
    assert not faults.comes("operator.refuses", 8.0)


def test_the_state_of_faults_can_be_kept_and_taken_up() -> None:
    rules = ("fault: balance.draught, at: 1 s", "fault: scoop.nothing, probability: 0.5")
    first, second = faults_of(*rules), faults_of(*rules)
    first.advance(2.0)
    first.push_mg()
    first.comes("scoop.nothing", 2.0)
    for name in Faults.STATE:
        setattr(second, name, read(json.loads(json.dumps(written(getattr(first, name)))), getattr(second, name)))
    assert second.active == first.active == {"balance.draught": 2.0}
    assert [second.push_mg() for _ in range(9)] == [first.push_mg() for _ in range(9)]
    later = [[f.comes("scoop.nothing", 3.0) for _ in range(20)] for f in (first, second)]
    assert later[0] == later[1]


# --- what they do


@pytest.mark.slow
def test_a_fault_run_is_the_same_for_one_seed_and_says_what_came_and_what_did_not(tmp_path: Path) -> None:
    rules = ("fault: balance.draught, probability: 0.5", "fault: arm.lost, at: 10 h")
    exports = []
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        ran = run_with(tmp_path / name, *rules)
        exports.append(canonical(ran.journal))
    assert exports[0] == exports[1]
    assert came(ran)[0]
    assert came(ran)[1] == []
    assert ran.session.unused_rules == ["faults.yaml:3:5: 'arm.lost'"]
    assert ran.session.title.endswith("SIMULATED (seed 0), 2 fault rules")
    with open_contents(ran.journal) as contents:
        run = {row["key"]: row["value"] for row in contents.rows("run")}
    assert "balance.draught" in run["faults_text"]
    assert len(run["faults_hash"]) == 64


def test_a_wrong_container_is_refused_by_its_weight_and_the_rest_goes_on(tmp_path: Path) -> None:
    ran = run_with(tmp_path, "fault: container.wrong, sample: a")
    assert (ran.sample("a").verdict, ran.sample("a").code) == ("skipped", "container.wrong_mass")
    assert ran.sample("b").verdict == "in tolerance"


def test_a_clog_is_broken_by_vibration(tmp_path: Path) -> None:
    ran = run_with(tmp_path, "fault: powder.clog, sample: a")
    assert ran.sample("a").verdict == "in tolerance"
    assert ran.sample("a").vibration_s >= 3.0


def test_powder_runs_on_out_of_a_stuck_valve_and_the_arm_stays_where_it_is(tmp_path: Path) -> None:
    ran = run_with(tmp_path, "fault: valve.stuck_open")
    world = ran.session.world
    assert world is not None
    assert ran.result.exit_code == 3
    assert ran.sample("a").code == "hand.valve_stuck"
    assert world.is_open
    assert world.masses_mg["container:a"] > 310.0
    assert world.masses_mg["spilled"] == 0.0
    assert ran.session.cell.arm.is_stopped


@pytest.mark.parametrize("fault", first_daily("hand.lost", "valve.no_power", "arm.no_power"))
def test_a_device_that_cannot_be_told_does_not_keep_a_run_that_ends_waiting(tmp_path: Path, fault: str) -> None:
    ran = run_with(tmp_path, f"fault: {fault}, sample: b")
    assert ran.result.exit_code == 3
    assert ran.session.world is not None
    (account,) = ran.session.world.faults.account()
    assert ran.result.duration_s - account["came_s"][0] < 4.0


def test_a_cone_that_leaks_loses_powder_through_its_shut_valve(tmp_path: Path) -> None:
    ran = run_with(tmp_path, "fault: cone.leak, at: 0 s, for: 22 s")
    sound = dry_run(tmp_path, BATCH, controller="adaptive")
    assert ran.session.world is not None
    assert sound.session.world is not None
    assert sound.session.world.masses_mg["spilled"] == 0.0
    assert ran.session.world.masses_mg["spilled"] < 20.0, (
        "what leaks while the cone is tilted, its apex beside the mortar"
    )
    assert ran.session.world.ledger.total_mg == pytest.approx(sound.session.world.ledger.total_mg)
    assert all(sample.verdict == "in tolerance" for sample in ran.result.samples)


def test_a_valve_that_was_open_when_its_controller_was_lost_for_a_moment_is_shut_at_the_end(tmp_path: Path) -> None:
    ran = run_with(tmp_path, "fault: hand.lost, for: 0.1 s")
    assert ran.sample("a").code == "device.lost"
    assert ran.session.world is not None
    assert not ran.session.world.is_open


def test_an_operator_who_refuses_ends_the_change_of_powder(tmp_path: Path) -> None:
    ran = run_with(tmp_path, "fault: operator.refuses")
    assert ran.sample("a").verdict == "in tolerance"
    assert ran.result.exit_code == 3
    assert "operator.refused" in ran.result.reason


def test_a_short_silence_of_the_balance_is_waited_for(tmp_path: Path) -> None:
    ran = run_with(tmp_path, "fault: balance.silent, at: 1 s, for: 2 s")
    assert ran.result.exit_code == 0


def test_what_is_over_before_it_matters_does_no_harm_and_overload_is_told_while_it_lasts(tmp_path: Path) -> None:
    rules = ("fault: balance.overload, at: 75 s, for: 5 s", "fault: balance.unstable, at: 1 s, for: 5 s")
    assert run_with(tmp_path, *rules).result.exit_code == 0  # the sheet is swapped from 70 to 90 s
    assert run_with(tmp_path, "fault: balance.overload, at: 1 s").sample("a").code == "balance.overload"


@pytest.mark.slow
def test_a_fault_that_has_come_does_not_come_again_when_the_run_is_resumed(tmp_path: Path) -> None:
    """The rules' state is the world's, and lives in its file; the rules themselves are in the journal."""
    text = "faults: [{fault: balance.draught, at_pulse: 1, for: 1 s}, {fault: scoop.nothing, sample: b, times: 9}]"
    ran = dry_run(tmp_path, BATCH, controller="adaptive", faults=text, stop_at=500)
    assert ran.result.exit_code == 130
    first = came(ran)
    assert len(first[0]) == 1
    history = checked_history(ran.journal)
    options = options_of(history, ran.journal.parent)
    lab = load_lab(starter_lab())
    plan = make_plan(load_recipe(tmp_path / "recipe.yaml", lab), lab)
    found = resumable(ran.journal, history, plan, lab, accept_changes=False)
    session = Session(plan, lab, options, shared_planner(plan, lab), resumes=found)
    try:
        session.run(Watching())
    finally:
        session.close()
    assert came(ran)[0] == first[0]
    assert came(ran)[1]


# --- the twins


CODES = {
    "balance.silent": "device.lost",
    "balance.garbage, for: 9 s": "device.lost",
    "balance.overload": "balance.overload",
    "hand.emergency_stop": "device.emergency_stop",
    "hand.lost": "device.lost",
    "valve.stuck_closed": "hand.valve_stuck",
    "servo.overload": "servo.overload",
    "servo.overheat": "servo.overload",
    "arm.lost": "device.lost",
    "arm.no_power": "arm.limp",
    "valve.no_power": "hand.valve_lost",
}
TELLING = ("balance.silent", "hand.emergency_stop", "servo.overload", "arm.no_power", "valve.no_power")
"""One of each device; the others are met in CI."""


def pulses(devices: Devices, clock: WallClock) -> Steps[None]:
    """Pulse and read for a while, or until a device has a fault."""
    while clock.now_s < 15.0:
        yield from devices.hand.pulse(0.3, 0.05)
        yield from devices.balance.next_reading(4.0)
        if (fault := devices.arm.fault) is not None:
            raise fault


@pytest.mark.real_time
@pytest.mark.parametrize(
    "fault", [*TELLING, *(pytest.param(f, marks=pytest.mark.slow) for f in CODES if f not in TELLING)]
)
def test_the_real_drivers_meet_the_same_fault_on_twins(fault: str) -> None:
    # A busy machine takes a while to connect: a fault that is over by then is met by nobody.
    bench = bench_of(load_lab(starter_lab()), faults=parse_faults(f"faults: [{{fault: {fault}, at: 3 s}}]", "f"))
    clock = WallClock()
    with bench:
        devices = connect_cell_devices(bench.spec, clock)
        try:
            wait_for(lambda: devices.balance.latest is not None)
            assert devices.arm.fault is None
            with pytest.raises(SkillFailed) as failed:
                carry_out(pulses(devices, clock), clock)
            assert failed.value.code == CODES[fault]
        finally:
            devices.close()


def test_twins_alone_refuse_faults_that_nobody_would_see() -> None:
    faults = parse_faults("faults:\n  - {fault: cone.leak}\n  - {fault: valve.slow, sample: a}\n", "f")
    assert problems_of(lambda: bench_of(load_lab(starter_lab()), faults=faults)) == [
        "2:5: 'cone.leak' has no effect here: no powder is behind twins alone",
        "3:5: 'sample': twins alone know of no sample",
    ]


# --- the matrix


@pytest.fixture(scope="module")
def matrix(tmp_path_factory: pytest.TempPathFactory) -> tuple[Matrix, dict[str, float]]:
    made = Matrix(tmp_path_factory.mktemp("matrix"))
    return made, made.moments(0)


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize(
    "moment", [moment if moment == "dosing" else pytest.param(moment, marks=pytest.mark.slow) for moment in MOMENTS]
)
def test_every_fault_ends_in_recovery_or_safe_with_the_right_code(
    matrix: tuple[Matrix, dict[str, float]], fault: str, moment: str
) -> None:
    runs, moments = matrix
    assert runs.run(fault, moment, moments[moment], 0).wrong == ()


# --- the page


def test_every_fault_is_listed_in_its_page() -> None:
    page = (Path(__file__).parent.parent / "docs" / "faults.md").read_text(encoding="utf-8")
    for name in KINDS:
        assert f"`{name}`" in page
