"""Commissioning on wire twins: a person leads the arm by hand, and the faults of the cell are found and mended."""

import json
import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from conftest import Call
from dose_bench import Bench, Setting
from hypothesis import given
from hypothesis import strategies as st
from running import make_lab

from scuhand_bt.cell.places import over_balance
from scuhand_bt.cell_spec import CellSpec, HandOptions, HandSpec, ValvePoint
from scuhand_bt.commissioning.coupling import ringing
from scuhand_bt.commissioning.guide import carry_out, on_twins
from scuhand_bt.commissioning.record import FILE, Done, Record, values_of
from scuhand_bt.commissioning.roller import deg_per_mm
from scuhand_bt.commissioning.servos import TURNS, turned
from scuhand_bt.commissioning.step import Left, NotFound, Site
from scuhand_bt.commissioning.steps import STEPS, commissioned, next_step
from scuhand_bt.commissioning.valve import moved, opens_later_mm
from scuhand_bt.commissioning.valve_map import ROUNDS, SHARES, equivalent_mm, weighed_round
from scuhand_bt.devices.connect import Devices
from scuhand_bt.devices.dynamixel.arm import arm_axes
from scuhand_bt.dosing.cone import Cone
from scuhand_bt.lab import Lab, load_lab, starter_lab, state_folder
from scuhand_bt.motion.inverse import solutions
from scuhand_bt.motion.kinematics import ApexPose, Floats, Mount, apex
from scuhand_bt.problems import SourceError
from scuhand_bt.run.make_cell import bench_of
from scuhand_bt.run.operator import Person
from scuhand_bt.sim.wire.bench import COUNTS_PER_RAD, WireBench
from scuhand_bt.sim.wire.servo import Servo
from scuhand_bt.specs import Container, Source
from scuhand_bt.yaml_edit import Path as Keys
from scuhand_bt.yaml_edit import Value, edited

TRUTH: dict[Keys, Value] = {
    ("arm", "options"): {
        "servo_ids": [2, 5, 4, 3, 6, 7, 9],
        "home_counts": [2105, 1991, 2105, 1991, 2105, 1991, 2105],
        "directions": [1, 1, 1, -1, 1, 1, 1],
    },
    ("hand", "options", "roller_id"): 1,
    ("hand", "apex_offset"): "117 mm",
    ("hand", "apex_aside"): ["2.5 mm", "-1.5 mm"],
    ("frames", "balance", "shift"): ["9 mm", "-8 mm", "0.5 mm"],
    ("frames", "balance", "yaw"): "3 deg",
    ("hand", "options", "valve_map"): [{"count": 2081, "opening": "0 mm"}, {"count": 2341, "opening": "2.7 mm"}],
    ("hand", "roller_deg_per_mm"): "12.1",
    ("frames", "table", "shift"): ["0 mm", "0 mm", "-2 mm"],
}
"""How the cell was really built: ids, horns and a hand as nobody has written them down."""
UPRIGHT_WITHIN_RAD = math.radians(0.4)
TOUCHED_WITHIN_M = 0.0001


@dataclass
class Hands:
    """A person who knows the cell by its marks only, and moves what is limp."""

    bench: WireBench
    truth: CellSpec
    rng: np.random.Generator
    bench_lab: Lab
    stops_at: int | None = None
    """A question that is answered with "stop"."""
    asked: list[str] = field(default_factory=list)
    told: list[str] = field(default_factory=list)
    led_to: Floats = field(default_factory=lambda: np.zeros(7))
    """The joints as they were led to the last place."""
    jogs: Iterator[str] = field(default_factory=lambda: iter(()))
    _rolled: float = 0.0
    """Counts by which the roller is turned, and not back yet."""
    _before: Floats = field(default_factory=lambda: np.zeros(7))
    """Where the joints stood before they turned by themselves."""

    def tell(self, text: str) -> None:
        self.told.append(text)

    def ask(self, question: str, choices: Sequence[str] = ("done", "stop")) -> str:
        self.asked.append(question)
        if len(self.asked) - 1 == self.stops_at:
            raise Left
        if "straight up" in question:
            self._roller.position -= self._rolled
            self._rolled = 0.0
            self._lead_to(self.rng.uniform(-1, 1, 7) * UPRIGHT_WITHIN_RAD)
        elif question.startswith("By hand, "):
            self._turn(next(k for k, (what, _) in enumerate(TURNS) if what in question))
        elif "that point" in question:
            self._touch(np.array([0.30, 0.05, 0.15]), leaning=True)
        elif "empty crucible" in question:
            crucible = self.bench_lab.library.containers["alumina_crucible"]
            self.bench.world.remove()
            self.bench.world.place(Container.model_validate({**crucible.model_dump(), "id": "crucible"}))
            self._touch(np.array(over_balance(self.truth, crucible)[1]) / 1e3, leaning=False, free=True)
        elif question.startswith("Empty the cone"):
            self.bench.world.swap_sheet()
            self.bench.world.remove()
        elif "glass_beads into the cone" in question and self.bench.world.masses_mg["cone"] < 2000.0:
            self.bench.world.refill("beads", 4000.0)
            self.bench.world.load_cone("beads", 4000.0)
        elif "over the middle of the pan" in question:
            holder = self.bench_lab.library.containers["xrd_holder"]
            self._touch(np.array(over_balance(self.truth, holder)[1]) / 1e3, leaning=False, free=True)
        elif "room all round" in question or "can be measured" in question:
            self.led_to = self.bench_lab.motion_planner({}).home()
            self._lead_to(self.led_to)
        elif question.startswith("By itself, joint"):
            self._before = self.bench.arm.joints
        elif question.startswith("Has it done that"):
            which = next(k for k, (what, _) in enumerate(TURNS) if what.split(": ")[1] in question)
            turned_deg = np.degrees(self.bench.arm.joints - self._before)
            return "yes" if self._is_only(which, turned_deg * TURNS[which][1]) else "no"
        elif question.startswith("Jog a joint") and (jogs := next(self.jogs, None)):
            return jogs
        elif "the mark of the" in question:
            name = question.split("mark of the ")[1].split(" at ")[0]
            frame = self.truth.frames[name]
            at = tuple(float(part) for part in question.split("(")[1].split(")")[0].split(","))
            self._touch(np.array(frame.moved_mm(at)) / 1e3, leaning=False)
        return choices[0]

    def measure(self, question: str) -> float:
        self.asked.append(question)
        if "pin" in question:
            opening_mm = self.bench.hand.twin.opening_mm
            while opening_mm < 2.0:  # it opens yet
                opening_mm = self.bench.hand.twin.opening_mm
            time.sleep(0.5)
            return round(self.bench.hand.twin.opening_mm, 1)
        return round(self.bench.rim_mm + self.rng.uniform(-0.3, 0.3), 1)

    @staticmethod
    def _is_only(which: int, turned_deg: Floats) -> bool:
        others = np.delete(turned_deg, which)
        return bool(turned_deg[which] > 2.0 and np.abs(others).max() < 0.5)

    @property
    def _roller(self) -> Servo:
        return self.bench.bus.twin.servos[self.truth.hand.options.roller_id]

    def _lead_to(self, joints: Floats) -> None:
        servos = self.bench.bus.twin.servos
        assert not any(servos[servo].has_torque for servo in self.truth.arm.options.servo_ids), (
            "an arm that holds is not led"
        )
        self.bench.arm.stand_at(joints)

    def _turn(self, which: int) -> None:
        by_rad = math.radians(20.0) * TURNS[which][1]
        if which < 7:
            joints = self.bench.arm.joints
            joints[which] += by_rad
            self._lead_to(joints)
        else:
            self._rolled = by_rad * COUNTS_PER_RAD
            self._roller.position += self._rolled

    def _touch(self, point_m: Floats, *, leaning: bool, free: bool = False) -> None:
        mount = Mount.of(self.truth.hand)
        met_m = point_m + self.rng.uniform(-1, 1, 3) * TOUCHED_WITHIN_M
        while True:
            lean = self.rng.uniform(-0.4, 0.4, 2) if leaning else np.zeros(2)
            axis = np.array([*lean, 1.0])
            found = solutions(ApexPose(met_m, axis / np.linalg.norm(axis)), mount)
            if free and len(found):
                found = found[~self.bench_lab.motion_planner({}).scene().hits(found)]
            if len(found):
                self.led_to = found[self.rng.integers(len(found))]
                return self._lead_to(self.led_to)


@dataclass
class Factory:
    """A cell from the factory, on twins that are built as `TRUTH` has it, and the lab that knows nothing of that."""

    lab_folder: Path
    truth: Lab
    bench: WireBench
    hands: Hands

    @property
    def lab(self) -> Lab:
        return load_lab(self.lab_folder)

    def site(self) -> Site:
        return Site(self.lab, self.hands, state_folder(self.lab), Person("Ada"), simulated=True)

    def do(self, *names: str) -> None:
        for step in STEPS:
            if step.name in names:
                assert carry_out(step, self.site()) is not None

    def cell_text(self) -> str:
        return (self.lab_folder / "robot" / "cell.yaml").read_text(encoding="utf-8")

    def off_mm(self) -> float:
        """How far the real apex is from the middle of the real pan, where the program takes it to be over it."""
        container = self.lab.library.containers["xrd_holder"]
        (_, wanted_mm), (_, true_mm) = (over_balance(lab.cell, container) for lab in (self.lab, self.truth))
        joints = solutions(ApexPose(np.array(wanted_mm) / 1e3), Mount.of(self.lab.cell.hand))
        worst_mm = 0.0
        for q in joints[:: max(1, len(joints) // 20)]:
            servos = self.bench.bus.twin.servos
            for axis, angle_rad in zip(arm_axes(self.lab.cell.arm), q, strict=True):
                servos[axis.servo].position = axis.count(angle_rad)
            there = apex(self.bench.arm.joints, Mount.of(self.truth.cell.hand)).position_m
            worst_mm = max(worst_mm, float(np.linalg.norm(1e3 * there - true_mm)))
        return worst_mm


@pytest.fixture
def factory(tmp_path: Path) -> Iterator[Factory]:
    truth_folder = make_lab(tmp_path / "truth")
    cell = truth_folder / "robot" / "cell.yaml"
    cell.write_text(edited(cell.read_text(encoding="utf-8"), TRUTH), encoding="utf-8")
    truth = load_lab(truth_folder)
    library = truth.library
    beads = Source(
        name="beads",
        station="mortar_bay",
        mortar=library.mortars["agate_mortar"],
        powder=library.powders["glass_beads"],
        amount_mg=1.0,
    )
    with bench_of(truth, sources={"beads": beads}) as bench:
        folder = make_lab(tmp_path / "lab")
        cell = folder / "robot" / "cell.yaml"
        ports: dict[Keys, Value] = {
            (name, "port"): getattr(bench.spec, name).port for name in ("arm", "hand", "balance")
        }
        ports |= {("arm", "options"): {"latency": "100 ms"}, ("changer",): {"driver": "operator"}}
        cell.write_text(edited(cell.read_text(encoding="utf-8"), ports), encoding="utf-8")
        yield Factory(folder, truth, bench, Hands(bench, truth.cell, np.random.default_rng(1), truth))


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


def test_a_balance_that_leans_and_a_mark_that_was_missed_are_refused(factory: Factory) -> None:
    factory.do("servos", "zero", "apex")
    lead, touched = factory.hands._touch, []

    def beside(point_m: Floats, *, leaning: bool) -> None:
        touched.append(point_m)
        lead(point_m + (np.array([0.0, 0.008, 0.0]) if len(touched) == 2 else 0.0), leaning=leaning)

    factory.hands._touch = beside  # type: ignore[method-assign]
    with pytest.raises(NotFound, match="not touched where they are"):
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


def test_what_was_found_on_twins_counts_for_no_real_cell(tmp_path: Path) -> None:
    lab = load_lab(make_lab(tmp_path / "lab"))
    record = Record(state_folder(lab))
    record.add(done_now("servos", lab, simulated=True))
    assert record.last(simulated=False) == {}
    assert {f.verdict for f in commissioned(lab)} == {"not done"}


def test_a_damaged_record_is_said_to_be_and_not_begun_anew_over(tmp_path: Path) -> None:
    (tmp_path / FILE).write_text('[{"step": "servos"', encoding="utf-8")
    with pytest.raises(SourceError, match="no record of a commissioning"):
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
    with pytest.raises(ValueError, match="beyond its turn"):
        moved(rising, 20.0)


@pytest.mark.real_time
@pytest.mark.slow
def test_a_valve_whose_zero_is_off_by_0_3_mm_is_mended_by_weighing(factory: Factory) -> None:
    factory.do("servos", "zero", "valve")
    wanted, found = (lab.cell.hand.options.valve_map for lab in (factory.truth, factory.lab))
    counts_per_mm = (wanted[1].count - wanted[0].count) / 2.4
    assert abs(found[0].count - wanted[0].count) / counts_per_mm < 0.1
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
    with pytest.raises(NotFound, match=r"joint 7 .* does not turn as it is described"):
        factory.do("jog")


@pytest.mark.real_time
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
    with pytest.raises(ValueError, match="no more flows"):
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
    with pytest.raises(ValueError, match="still goes"):
        ringing(rung(30.0), 2.0, 0.4)
    with pytest.raises(ValueError, match="too few"):
        ringing(rung(0.2)[:20], 2.0, 0.4)
