"""What comes into a cell while the arm is at work, and what the arm stands in as it begins: seen, heeded, told."""

from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from running import dry_run, make_lab, simulated_bench

from scuhand_bt.bench_spec import Obstacle
from scuhand_bt.cell.in_the_way import TIMEOUT_S
from scuhand_bt.cell.places import all_places
from scuhand_bt.clock import Steps, Wake
from scuhand_bt.devices.connect import connect_cell_devices
from scuhand_bt.devices.instruments import Watcher
from scuhand_bt.events.cell import ArmFreed, WayObstructed
from scuhand_bt.events.entry import SkillEvent
from scuhand_bt.failures import SkillFailed
from scuhand_bt.journal.reader import read
from scuhand_bt.lab import Lab, load_lab
from scuhand_bt.motion import ApexPose, MotionPlanner
from scuhand_bt.record import Record
from scuhand_bt.run.bench import bench_of
from scuhand_bt.run.clock import VirtualClock, WallClock

AT_MOST_S = 300.0
OVER_THE_MORTAR = "{at: [190 mm, 240 mm, 180 mm], box: [100 mm, 100 mm, 300 mm]"
"""A person's arm, held in from above."""
RECIPE = """
recipe: reached_into
workflow: scoop_and_dispense
samples: [{id: a, source: beads, container: pellet_die_13mm, mass: 500 mg, tolerance: 10 mg}]
"""


def lab_that_sees(folder: Path, *boxes: str) -> Lab:
    made = make_lab(folder)
    cell = made / "robot" / "cell.yaml"
    watcher = f"devices:\n  camera: {{kind: watcher, driver: boxes, options: {{boxes: [{', '.join(boxes)}]}}}}\n"
    cell.write_text(cell.read_text() + watcher)
    return load_lab(made)


class Bench:
    """A simulated cell, and where its arm was at every step."""

    def __init__(self, lab: Lab) -> None:
        self.clock, self.events = VirtualClock(), list[Any]()
        places = all_places(lab.cell, {}, [])
        self.motion = lab.motion_planner({"mortar_bay": lab.library.mortars["agate_mortar"]})
        for name, position_mm in places.items():
            self.motion.add_place(name, ApexPose(np.array(position_mm) / 1000))
        over = (*lab.cell.stations["mortar_bay"].position_mm[:2], 120.0)
        self.motion.add_place("mortar_bay", ApexPose(np.array(over) / 1000))
        self.cell, _ = simulated_bench(lab, self.motion, self.clock, record=Record(self.events.append))
        self.went: list[tuple[float, bool, Any]] = []

    def do(self, steps: Steps[Any]) -> None:
        for wake in steps:
            assert self.clock.now_s < AT_MOST_S
            self.clock.wait([wake, Wake(self.clock.now_s + 0.02)])
            self.went.append((self.clock.now_s, not self.cell.arm.is_stopped, self.cell.arm.positions))

    def told(self, kind: type[SkillEvent]) -> list[Any]:
        return [event for event in self.events if isinstance(event, kind)]


def over_the_pan(bench: Bench) -> Any:
    x_mm, y_mm, z_mm = bench.cell.spec.station_of_kind("balance").position_mm
    bench.motion.add_place("over the pan", ApexPose(np.array([x_mm, y_mm, z_mm + 80.0]) / 1000))
    return bench.motion.standing_at("over the pan")


def is_clear(bench: Bench, lab: Lab, after_s: float, until_s: float) -> bool:
    """Whether the arm kept out of what was seen meanwhile: the box as a part of the cell, each moment looked at."""
    seen = lab.cell.own_options["camera"].boxes[0]  # type: ignore[attr-defined]
    box = Obstacle(name="person", at_mm=seen.at_mm, box_mm=seen.box_mm)
    scene = MotionPlanner(lab.urdf, lab.cell.model_copy(update={"geometry": [box]}), {}).scene(0.0002)
    there = [q for now_s, _, q in bench.went if after_s <= now_s <= until_s]
    return not scene.hits(np.array(there)).any()


@pytest.mark.parametrize("comes_s", [0.0, 0.3])
def test_the_arm_waits_or_stops_for_what_comes_and_goes_on_when_it_is_gone(tmp_path: Path, comes_s: float) -> None:
    lab = lab_that_sees(tmp_path, OVER_THE_MORTAR + f", from: {comes_s} s, for: 15 s}}")
    bench = Bench(lab)
    bench.do(bench.cell.move_to("mortar_bay"))
    told = bench.told(WayObstructed)
    assert [one.stopped for one in told] == ([True, False] if comes_s else [False])
    assert told[-1].waited_s == pytest.approx(15.0, abs=1.0)
    assert not any(moves for now_s, moves, _ in bench.went if comes_s + 1.0 < now_s < comes_s + 15.0)
    assert is_clear(bench, lab, comes_s, comes_s + 15.0)
    assert np.abs(bench.cell.arm.positions - bench.motion.standing_at("mortar_bay")).max() < 1e-9


def test_a_watcher_that_is_blind_for_a_moment_while_another_has_a_zone_ends_nothing(tmp_path: Path) -> None:
    bench, way = Bench(lab_that_sees(tmp_path, OVER_THE_MORTAR + ", from: 200 s}")), object()
    camera, lost = bench.cell.device("camera"), SkillFailed("device.lost", "camera: it does not answer")
    bench.cell.right_of_way.commands.update(arm=object(), changer=way)
    bench.cell.right_of_way.enter(["pan"], way)

    def goes() -> Steps[None]:
        camera.fault = lost  # type: ignore[misc]
        for wake in bench.cell.move_to("mortar_bay"):
            camera.fault = lost if bench.clock.now_s < 5.0 else None  # type: ignore[misc]
            yield wake

    bench.do(goes())
    assert min(now_s for now_s, moves, _ in bench.went if moves) == pytest.approx(5.0, abs=0.5)


def test_what_stays_in_the_way_is_not_waited_for_without_end(tmp_path: Path) -> None:
    bench = Bench(lab_that_sees(tmp_path, OVER_THE_MORTAR + "}"))
    with pytest.raises(SkillFailed, match=rf"arm.no_path: something has been in the way for {TIMEOUT_S:g} s"):
        bench.do(bench.cell.move_to("mortar_bay"))
    assert not any(moves for _, moves, _ in bench.went)


def test_an_arm_whose_camera_is_lost_does_not_move(tmp_path: Path) -> None:
    bench = Bench(lab_that_sees(tmp_path))
    bench.cell.device("camera").fault = SkillFailed("device.lost", "camera: it does not answer")  # type: ignore[misc]
    with pytest.raises(SkillFailed, match=r"device\.lost: camera"):
        bench.do(bench.cell.move_to("mortar_bay"))
    assert not any(moves for _, moves, _ in bench.went)


def test_a_dry_run_in_which_a_person_reaches_in_waits_and_is_good(tmp_path: Path) -> None:
    over_all = "{at: [250 mm, 0 mm, 400 mm], box: [700 mm, 800 mm, 700 mm], from: 1 s, for: 30 s}"
    (tmp_path / "seen").mkdir()
    lab_that_sees(tmp_path / "seen", over_all)
    ran = dry_run(tmp_path, RECIPE, lab=tmp_path / "seen")
    assert [one.verdict for one in ran.result.samples] == ["in tolerance"]
    told = [row for row in read(ran.journal, "event") if row["kind"] == "way_obstructed"]
    assert told


def test_an_arm_that_was_pushed_into_something_goes_out_slowly_and_says_so(tmp_path: Path) -> None:
    bench = Bench(load_lab(make_lab(tmp_path)))
    arm = cast(Any, bench.cell.arm)
    pushed = over_the_pan(bench)
    pushed[0] += 0.19
    scene = bench.motion.scene(0.001)
    depth_m = scene.clearance_m(pushed)[0]
    assert -0.02 < depth_m < 0.0
    arm.hold(pushed)
    bench.do(bench.cell.move_to("park"))
    (freed,) = bench.told(ArmFreed)
    assert "shield" in freed.what
    assert freed.duration_s > 1.0
    depths_m = [scene.clearance_m(q)[0] for _, _, q in bench.went]
    out = next(k for k, depth in enumerate(depths_m) if depth > 0.001)
    assert (np.diff(depths_m[:out]) > -2e-5).all(), "it never goes deeper"
    assert min(depths_m[out:]) > 0.0009
    assert np.abs(bench.cell.arm.positions - bench.motion.standing_at("park")).max() < 1e-9


def test_an_arm_too_deep_in_something_stays_where_it_is(tmp_path: Path) -> None:
    bench = Bench(load_lab(make_lab(tmp_path)))
    pushed = over_the_pan(bench)
    pushed[1] -= 0.35
    cast(Any, bench.cell.arm).hold(pushed)
    with pytest.raises(SkillFailed, match=r"arm.start_in_collision.* overlap by .*supply off and on, lead it clear"):
        bench.do(bench.cell.move_to("park"))
    assert not bench.told(ArmFreed)
    assert np.abs(bench.cell.arm.positions - pushed).max() == 0.0


@pytest.mark.slow
@pytest.mark.real_time
def test_what_a_watcher_was_told_to_see_it_sees_beside_twins_too(tmp_path: Path) -> None:
    lab, clock = lab_that_sees(tmp_path / "lab", f"{OVER_THE_MORTAR}}}"), WallClock()
    with bench_of(lab, clock=clock) as bench:
        devices = connect_cell_devices(bench.spec, clock)
        seen = cast(Watcher, devices.others["camera"]).points_m
        devices.close()
    assert seen is not None
    assert np.abs(seen.mean(axis=0) - (0.19, 0.24, 0.18)).max() < 0.001


def test_an_arm_that_was_pushed_into_something_goes_out_whatever_is_seen_elsewhere(tmp_path: Path) -> None:
    bench = Bench(lab_that_sees(tmp_path, OVER_THE_MORTAR + "}"))
    pushed = over_the_pan(bench)
    pushed[0] += 0.19
    cast(Any, bench.cell.arm).hold(pushed)
    bench.do(bench.cell.move_to("park"))
    assert len(bench.told(ArmFreed)) == 1
    assert bench.clock.now_s < 30.0


def test_an_arm_does_not_make_its_way_out_of_what_is_seen(tmp_path: Path) -> None:
    bench = Bench(lab_that_sees(tmp_path, "{at: [10 mm, 10 mm, 200 mm], box: [10 mm, 10 mm, 10 mm], for: 40 s}"))
    bench.motion.set_occupied(bench.cell.in_the_way.points_m)
    start = bench.cell.arm.positions
    depth_m = bench.motion.scene(0.001).clearance_m(start)[0]
    assert -0.03 < depth_m < 0.0
    bench.do(bench.cell.move_to("park"))
    assert not bench.told(ArmFreed)
    assert not any(moves for now_s, moves, _ in bench.went if now_s < 39.9)
