"""Commissioning on wire twins: a person leads the arm by hand, and the faults of the cell are found and mended."""

import json
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from conftest import Call
from dose_bench import Bench, Setting
from hypothesis import given
from hypothesis import strategies as st
from running import make_lab

from harness.factory_cell import Factory, Hands, from_factory
from scuhand_bt.commissioning.coupling import ringing
from scuhand_bt.commissioning.guide import carry_out, on_twins
from scuhand_bt.commissioning.record import FILE, Done, Record, values_of
from scuhand_bt.commissioning.roller import deg_per_mm
from scuhand_bt.commissioning.servos import turned
from scuhand_bt.commissioning.step import Left, NotFound, Site
from scuhand_bt.commissioning.steps import STEPS, commissioned, next_step
from scuhand_bt.commissioning.valve import moved, opens_later_mm, pressed
from scuhand_bt.commissioning.valve_map import ROUNDS, SHARES, equivalent_mm, weighed_round
from scuhand_bt.device_specs.hand import HandOptions, HandSpec, ValvePoint
from scuhand_bt.devices.connect import Devices
from scuhand_bt.dosing.cone import Cone
from scuhand_bt.lab import Lab, load_lab, starter_lab, state_folder
from scuhand_bt.motion.kinematics import Floats
from scuhand_bt.problems import SourceError
from scuhand_bt.run.operator import Person
from scuhand_bt.yaml_edit import Path as Keys
from scuhand_bt.yaml_edit import Value, edited


@pytest.fixture
def factory(tmp_path: Path) -> Iterator[Factory]:
    with from_factory(tmp_path) as made:
        yield made


GEOMETRY = ("servos", "zero", "apex", "table", "balance_place")


@pytest.mark.real_time
def test_from_factory_state_the_steps_alone_bring_the_apex_over_the_container(factory: Factory) -> None:
    factory.do(*GEOMETRY)
    cell, truth = factory.lab.cell, factory.truth.cell
    assert cell.arm.options.servo_ids == truth.arm.options.servo_ids
    assert cell.arm.options.directions == truth.arm.options.directions
    assert cell.hand.options.roller_id == truth.hand.options.roller_id
    by_touch = np.abs(np.subtract(cell.arm.options.home_counts, truth.arm.options.home_counts))[1:6]
    assert by_touch.max() <= 3, "0.26°, after marks that were met within 0.4°"
    assert cell.hand.apex_aside_mm == pytest.approx(truth.hand.apex_aside_mm, abs=0.6)
    assert cell.frames["balance"].yaw_deg == pytest.approx(3.0, abs=0.3)
    assert cell.stations["mortar_bay"].position_mm[2] == pytest.approx(-2.0, abs=0.5)
    assert factory.off_mm() < 1.0
    assert "# One bench: its devices" in factory.cell_text()
    assert on_twins(cell)


def test_a_commissioning_is_left_at_any_question_and_taken_up_with_the_step_it_was_in(factory: Factory) -> None:
    factory.do("servos")
    factory.hands.asked.clear()
    factory.hands.stops_at = 1
    with pytest.raises(Left):
        factory.do("zero")
    last = Record(state_folder(factory.lab)).last(simulated=True)
    assert list(last) == ["servos"]
    assert last["servos"].by == "Ada"
    upcoming = next_step(last, factory.lab.cell)
    assert upcoming is not None
    assert upcoming.name == "zero"
    assert factory.lab.cell.arm.options.home_counts == (2048,) * 7


def test_what_is_not_accepted_is_neither_written_nor_taken_for_done(factory: Factory) -> None:
    before = factory.cell_text()
    ask = factory.hands.ask
    factory.hands.ask = lambda question, choices=("done", "stop"): (  # type: ignore[method-assign]
        "no" if question.startswith("Write this") else ask(question, choices)
    )
    assert carry_out(STEPS[0], factory.site()) is None
    assert factory.cell_text() == before
    assert any(line.startswith("+arm: ") for line in factory.hands.told), "the person has seen what was to be written"
    assert not (state_folder(factory.lab) / FILE).exists()


@pytest.mark.slow
def test_a_balance_that_leans_and_a_mark_that_was_missed_are_refused(factory: Factory) -> None:
    factory.do("servos", "zero", "apex")
    lead, touched = factory.hands._touch, []

    def beside(point_m: Floats, *, leaning: bool) -> None:
        touched.append(point_m)
        lead(point_m + (np.array([0.0, 0.008, 0.0]) if len(touched) == 2 else 0.0), leaning=leaning)

    factory.hands._touch = beside  # type: ignore[method-assign]
    with pytest.raises(NotFound, match=r"the points touched are up to \d+\.\d mm from where robot/cell.yaml has them"):
        factory.do("balance_place")

    def leaning_thing(point_m: Floats, *, leaning: bool) -> None:
        lead(point_m + np.array([0.0, 0.0, 0.05 * (point_m[0] - 0.33)]), leaning=leaning)

    factory.hands._touch = leaning_thing  # type: ignore[method-assign]
    with pytest.raises(NotFound, match=r"leans by [23]\."):
        factory.do("balance_place")


def test_which_servo_was_turned_is_only_said_where_it_is_clear() -> None:
    assert turned([2048, 2048, 2048], [2050, 1820, 2047]) == (1, -1)
    with pytest.raises(ValueError, match="by about 20"):
        turned([2048, 2048], [2048 + 99, 2048])
    with pytest.raises(ValueError, match="two servos"):
        turned([2048, 2048], [2048 + 230, 2048 - 80])


def done_now(step: str, lab: Lab, **changes: bool) -> Done:
    rests_on = next(one.rests_on for one in STEPS if one.name == step)
    return Done(step, "2026-11-22T10:00:00+00:00", "Ada", False, {}, values_of(lab.cell, rests_on), **changes)


def test_the_doctor_knows_what_was_commissioned_and_what_was_changed_since(tmp_path: Path) -> None:
    folder = make_lab(tmp_path / "lab")
    lab = load_lab(folder)
    record = Record(state_folder(lab))
    record.add(done_now("servos", lab))
    record.add(done_now("balance_place", lab))
    cell = folder / "robot" / "cell.yaml"
    changes: dict[Keys, Value] = {("frames", "balance", "yaw"): "1 deg", ("balance", "readability"): "1 mg"}
    cell.write_text(edited(cell.read_text(encoding="utf-8"), changes), encoding="utf-8")
    said = {f.check: f for f in commissioned(load_lab(folder))}
    assert (said["servos"].verdict, said["servos"].found) == ("ok", "2026-11-22 10:00 by Ada")
    assert said["balance place"].verdict == "FAIL"
    assert said["balance place"].found.endswith("changed since: frames.balance")
    assert (said["zero"].verdict, said["zero"].found) == ("not done", "never")


def test_what_a_later_step_refines_leaves_the_earlier_done_and_what_an_earlier_finds_anew_does_not(
    tmp_path: Path,
) -> None:
    folder = make_lab(tmp_path / "lab")
    record, cell = Record(state_folder(load_lab(folder))), folder / "robot" / "cell.yaml"

    def done_with(step: str, home_count: int) -> str | None:
        homes: dict[Keys, Value] = {("arm", "options", "home_counts"): [home_count] * 7}
        cell.write_text(edited(cell.read_text(encoding="utf-8"), homes), encoding="utf-8")
        record.add(done_now(step, load_lab(folder)))
        upcoming = next_step(record.last(simulated=False), load_lab(folder).cell)
        return None if upcoming is None else upcoming.name

    assert done_with("servos", 2048) == "zero"
    assert done_with("zero", 2060) == "apex"
    assert done_with("apex", 2062) == "table", "zero is done, though apex has mended its zeros"
    assert done_with("zero", 2070) == "apex", "it stands elsewhere now"
    assert done_with("apex", 2071) == "table"


def test_what_was_found_on_twins_counts_for_no_real_cell(tmp_path: Path) -> None:
    lab = load_lab(make_lab(tmp_path / "lab"))
    record = Record(state_folder(lab))
    record.add(done_now("servos", lab, simulated=True))
    assert record.last(simulated=False) == {}
    assert {f.verdict for f in commissioned(lab)} == {"not done"}


def test_a_damaged_record_is_said_to_be_and_not_begun_anew_over(tmp_path: Path) -> None:
    (tmp_path / FILE).write_text('[{"step": "servos"', encoding="utf-8")
    with pytest.raises(SourceError, match="this is not a commissioning record"):
        Record(tmp_path).last(simulated=False)


def test_the_command_lists_the_steps_and_names_what_is_none(tmp_path: Path, command: Call) -> None:
    folder = make_lab(tmp_path / "lab")
    Record(folder / ".scuhand").add(done_now("servos", load_lab(folder)))
    listed = json.loads(command("commission", "--json", "--lab", str(folder)).stdout)
    assert [row["step"] for row in listed] == [step.name for step in STEPS]
    assert listed[0]["done"]["by"] == "Ada"
    assert listed[1]["done"] is None
    assert "Ada" in command("commission", "--list", "--lab", str(folder)).stdout
    wrong = command("commission", "servo", "--lab", str(folder))
    assert wrong.returncode == 2
    assert "servos" in wrong.stderr


@given(st.floats(-0.6, 0.6), st.floats(20.0, 120.0))
def test_a_valve_that_opens_later_than_its_map_says_is_found_by_how_powder_flows(later_mm: float, c: float) -> None:
    openings_mm = [0.9, 1.3, 1.7, 2.1]
    flows = [c * (opening_mm - later_mm - 0.05) ** 2.5 for opening_mm in openings_mm]
    assert opens_later_mm(openings_mm, flows, 0.05) == pytest.approx(later_mm, abs=1e-9)


@pytest.mark.parametrize("flows", [[10.0, 30.0], [10.0, 0.0, 30.0], [30.0, 20.0, 10.0], [10.0, 200.0, 90.0]])
def test_flows_that_tell_no_zero_are_refused(flows: list[float]) -> None:
    with pytest.raises(ValueError, match=r"flow"):
        opens_later_mm([0.9, 1.5, 2.1][: len(flows)], flows, 0.05)


def test_a_map_is_moved_the_way_its_counts_run() -> None:
    rising = HandOptions().valve_map
    falling = tuple(ValvePoint(count=4096 - point.count, opening_mm=point.opening_mm) for point in rising)
    assert [point.count for point in moved(rising, 0.3)] == [2080, 2340]
    assert [point.count for point in moved(falling, 0.3)] == [2016, 1756]
    with pytest.raises(ValueError, match="beyond its range"):
        moved(rising, 20.0)


def test_a_valve_is_shut_beyond_its_zero_and_opens_as_its_map_had_it() -> None:
    rising = HandOptions().valve_map
    shut = pressed(rising)
    assert [(point.count, point.opening_mm) for point in shut] == [(2037, 0.0), (2053, 0.05), (2308, 2.4)]
    assert pressed(shut) == shut
    assert [point.count for point in moved(shut, 0.3)] == [2070, 2086, 2341]
    with pytest.raises(ValueError, match="beyond its range"):
        pressed((ValvePoint(count=5, opening_mm=0.0), ValvePoint(count=265, opening_mm=2.4)))


@pytest.mark.real_time
@pytest.mark.slow
def test_a_valve_whose_zero_is_off_by_0_3_mm_is_mended_by_weighing(factory: Factory) -> None:
    factory.do("servos", "zero", "valve")
    wanted, found = (lab.cell.hand.options.valve_map for lab in (factory.truth, factory.lab))
    counts_per_mm = (wanted[1].count - wanted[0].count) / wanted[1].opening_mm
    beyond_mm = (wanted[0].count - found[0].count) / counts_per_mm
    assert 0.0 <= beyond_mm < 0.2, "it is shut a tenth of a millimetre beyond what was found"
    assert factory.bench.hand.twin.opening_mm == 0.0


@pytest.mark.parametrize("step", ["balance", "first_dose"])
def test_what_only_a_run_can_show_is_not_taken_for_done_without_one(factory: Factory, step: str) -> None:
    with pytest.raises(NotFound, match=r"scuhand-bt run recipes/\w+.yaml --step --slow 20%"):
        factory.do(step)


@pytest.mark.real_time
def test_a_joint_that_does_not_do_what_is_described_ends_the_jog(factory: Factory) -> None:
    factory.do("servos", "zero")
    cell = factory.lab_folder / "robot" / "cell.yaml"
    ways: dict[Keys, Value] = {("arm", "options", "directions"): [1, 1, 1, -1, 1, 1, -1]}
    cell.write_text(edited(cell.read_text(encoding="utf-8"), ways), encoding="utf-8")
    with pytest.raises(NotFound, match=r"joint 7 .* does not turn as described"):
        factory.do("jog")


@pytest.mark.real_time
@pytest.mark.slow
def test_the_arm_is_jogged_where_the_person_wants_it(factory: Factory) -> None:
    factory.do("servos", "zero")
    factory.hands.jogs = iter(["1+", "1+", "7-"])
    factory.do("jog")
    jogged_deg = np.degrees(factory.bench.arm.joints - factory.hands.led_to)
    assert jogged_deg[[0, 6]] == pytest.approx([4.0, -2.0], abs=0.3)
    assert np.abs(jogged_deg[1:6]).max() < 0.3
    factory.do("zero")
    assert factory.hands._roller.has_torque, "who leads the arm does not let go of the sheet"


@given(st.floats(8.0, 16.0), st.floats(46.0, 60.0))
def test_the_roller_is_known_by_measured_rims_whatever_the_sheets_radius(per_mm: float, radius_mm: float) -> None:
    hand = HandSpec(roller_deg_per_mm=per_mm, sheet_radius_mm=radius_mm)
    rims_mm = [90.0, 78.0, 66.0, 54.0]
    found, off_mm = deg_per_mm([Cone(rim_mm, radius_mm).roller_deg(hand) for rim_mm in rims_mm], rims_mm)
    assert found == pytest.approx(per_mm, rel=1e-6)
    assert off_mm < 1e-6
    with pytest.raises(ValueError, match="narrower"):
        deg_per_mm([0.0, 100.0, 200.0], [60.0, 70.0, 80.0])


@given(st.floats(20.0, 120.0), st.floats(1.8, 3.2))
def test_openings_are_known_to_each_other_by_what_flows(c: float, widest_mm: float) -> None:
    real_mm = [0.3 * widest_mm, 0.7 * widest_mm, widest_mm]
    flows = [c * (opening_mm - 0.05) ** 2.5 for opening_mm in real_mm]
    assert equivalent_mm(flows, 0.05, widest_mm) == pytest.approx(real_mm)
    with pytest.raises(ValueError, match="the flow does not grow"):
        equivalent_mm([20.0, 19.0, 30.0], 0.05, widest_mm)


@pytest.mark.parametrize("speed_mm_per_s", [4.0, 3.2])
def test_weighing_tells_every_opening_whatever_single_pulses_bring(speed_mm_per_s: float) -> None:
    lab = load_lab(starter_lab())
    beads = lab.library.powders["glass_beads"]
    told_mm = [round(share * lab.cell.hand.max_opening_mm, 2) for share in SHARES]
    worst_mm = []
    for seed in range(4):
        built = HandSpec(valve_speed_mm_per_s=speed_mm_per_s)
        bench = Bench(beads, seed=seed, dose=seed, setting=Setting(hand=built))
        devices = Devices(bench.cell.arm, bench.cell.hand, bench.cell.balance, None, {}, lambda: None)
        site = Site(lab, Hands.__new__(Hands), Path(), Person("Ada"), clock=bench.clock)
        rounds = []
        for _ in range(ROUNDS):
            bench.world.load_cone("store", max(0.0, 4000.0 - bench.world.masses_mg["cone"]))
            bench.world.refill("store", 4000.0)
            rounds.append(weighed_round(devices, site, told_mm, beads.belief.threshold_mm))
        flows = np.median(rounds, axis=0).tolist()
        found_mm = equivalent_mm(flows, beads.belief.threshold_mm, told_mm[-1])
        worst_mm.append(float(np.abs(np.subtract(found_mm, told_mm)).max()))
    assert max(worst_mm) < 0.12


def rung(decay_s: float) -> list[tuple[float, float]]:
    """Two seconds of a disturbance of 5 mg that then dies away about 20 mg, and 8 s more."""
    times_s = np.arange(0.0, 10.0, 0.1)
    return [
        (t, 20.0 + 5.0 * math.cos(10.0 * math.pi * t) * math.exp(-max(0.0, t - 2.0) / decay_s))
        for t in times_s.tolist()
    ]


def test_how_long_a_balance_rings_is_counted_from_the_end_of_what_has_disturbed_it() -> None:
    quick, slow = ringing(rung(0.2), 2.0, 0.4), ringing(rung(0.6), 2.0, 0.4)
    assert quick.rings_s == pytest.approx(0.2 * math.log(5.0 / 0.4), abs=0.15)
    assert slow.rings_s == pytest.approx(0.6 * math.log(5.0 / 0.4), abs=0.15)
    assert quick.apart_mg == pytest.approx(5.0, abs=0.1)
    assert ringing([(t, 20.0) for t, _ in rung(1.0)], 2.0, 0.4).rings_s == 0.0
    with pytest.raises(ValueError, match="still vary"):
        ringing(rung(30.0), 2.0, 0.4)
    with pytest.raises(ValueError, match="too few"):
        ringing(rung(0.2)[:20], 2.0, 0.4)
