"""A stroke of arm and roller at a mortar of the starter lab: one motion, proven, along the wall."""

import gc
import math
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest

from scuhand_bt.cell.scooping import planned_stroke
from scuhand_bt.dosing.bed import Bed
from scuhand_bt.dosing.cone import Cone
from scuhand_bt.dosing.ladle import Ladle, Stroke
from scuhand_bt.dosing.strokes import chosen
from scuhand_bt.dosing.swing import StrokePath, stroke_path
from scuhand_bt.dosing.vessel import Vessel
from scuhand_bt.failures import SkillFailed
from scuhand_bt.lab import load_lab, starter_lab
from scuhand_bt.motion import ApexPose, MotionPlanner, Mount, apex
from scuhand_bt.motion.axes import of_arm, of_roller
from scuhand_bt.motion.collision import Scene
from scuhand_bt.motion.scenes import STROKES_KEPT
from scuhand_bt.motion.slowing import slowed
from scuhand_bt.motion.stopping import StoppableTrajectory
from scuhand_bt.motion.stroke import with_roller
from scuhand_bt.motion.timelaw import RateLimits
from scuhand_bt.motion.trajectory import through

LAB = load_lab(starter_lab())
HAND = LAB.cell.hand
MORTAR = LAB.library.mortars["agate_mortar"]
BEADS = LAB.library.powders["glass_beads"]
STATION = LAB.cell.stations["mortar_bay_2"]
OUTWARD_DEG = math.degrees(math.atan2(STATION.position_mm[1], STATION.position_mm[0]))
UP = np.array([0.0, 0.0, 1.0])
BOTTOM_MM = np.array(STATION.position_mm) + (MORTAR.height_mm - MORTAR.depth_mm) * UP
CENTRE_MM = BOTTOM_MM + MORTAR.bowl_radius_mm * UP


@pytest.fixture(scope="module")
def planner() -> MotionPlanner:
    return LAB.motion_planner({STATION.name: MORTAR})


@pytest.fixture(scope="module")
def path() -> StrokePath:
    stroke = Stroke(82.0, 70.0, -26.0, heading_deg=OUTWARD_DEG + 120.0)
    return stroke_path(Vessel.of(MORTAR), stroke, Ladle.of(HAND))


@pytest.fixture(scope="module")
def motion(planner: MotionPlanner, path: StrokePath) -> StoppableTrajectory:
    return planned_stroke(planner, planner.home(), path, LAB.cell, STATION.name, MORTAR)


def _roller_rad(rim_mm: float) -> float:
    return math.radians(Cone(rim_mm, HAND.sheet_radius_mm).roller_deg(HAND))


def _poses(motion: StoppableTrajectory) -> tuple[list[ApexPose], np.ndarray]:
    """The cone along the motion, by the arm's and the roller's own kinematics, and its rims [mm]."""
    q = motion.at(np.linspace(0.0, motion.duration_s, 600))
    rims_mm = np.array([Cone.from_roller(math.degrees(turned), HAND).diameter_mm for turned in q[:, 7]])
    poses = [apex(row[:7], Mount.of(HAND, rim_mm)) for row, rim_mm in zip(q, rims_mm, strict=True)]
    return poses, rims_mm


def test_the_lip_is_on_the_wall_where_it_was_planned_and_the_apex_touches_nothing(
    motion: StoppableTrajectory, path: StrokePath
) -> None:
    poses, rims_mm = _poses(motion)
    lips_mm = np.array(
        [
            1e3 * pose.position_m + 50.0 * (2 * math.cos(math.asin(rim_mm / 100.0)) * pose.axis - pose.seam)
            for pose, rim_mm in zip(poses, rims_mm, strict=True)
        ]
    )
    off_mm = MORTAR.bowl_radius_mm - np.linalg.norm(lips_mm - CENTRE_MM, axis=1)
    low = lips_mm[:, 2] < BOTTOM_MM[2] + MORTAR.depth_mm
    assert off_mm[low].min() > 0.0
    for wanted_mm in (path.lip_mm + BOTTOM_MM)[path.on_wall][::8]:
        nearest = int(np.linalg.norm(lips_mm - wanted_mm, axis=1).argmin())
        assert abs(off_mm[nearest]) <= 0.3
    apexes_mm = np.array([1e3 * pose.position_m for pose in poses])
    assert Vessel.of(MORTAR).clearance_mm(apexes_mm - BOTTOM_MM).min() >= 3.0


def test_the_cone_closes_along_the_way_and_ends_upright(motion: StoppableTrajectory) -> None:
    poses, rims_mm = _poses(motion)
    assert rims_mm[0] == pytest.approx(82.0, abs=0.05)
    assert rims_mm[-1] == pytest.approx(70.0, abs=0.5)
    assert np.diff(rims_mm).max() < 0.01
    assert poses[0].tilt_deg > 85.0
    assert poses[-1].tilt_deg == pytest.approx(0.0, abs=0.1)


def test_no_joint_nor_the_roller_is_asked_for_more_than_it_can(
    planner: MotionPlanner, motion: StoppableTrajectory
) -> None:
    rates = with_roller(planner.rates, HAND)
    assert rates.speed[7] == pytest.approx(math.radians(HAND.morph_speed_mm_per_s * HAND.roller_deg_per_mm))
    assert rates.stretch_for(motion) <= 1 + 1e-6


@pytest.mark.parametrize("share", [0.2, 0.5, 0.8])
def test_arm_and_roller_that_are_stopped_at_one_moment_rest_on_one_pose_of_the_stroke(
    motion: StoppableTrajectory, share: float
) -> None:
    arm, roller = of_arm(motion), of_roller(motion)
    assert len(arm.sample(0.0)) == 7
    assert len(roller.sample(0.0)) == 1
    at_s = share * motion.duration_s
    arm, roller = arm.stopped_from(at_s), roller.stopped_from(at_s)
    assert arm.duration_s == roller.duration_s < motion.duration_s
    rests = np.append(arm.sample(arm.duration_s), roller.sample(roller.duration_s))
    stroke = motion.at(np.linspace(0.0, motion.duration_s, 20000))
    assert np.abs(stroke - rests).max(axis=1).min() < 1e-3


def test_a_stroke_that_something_is_in_the_way_of_says_what(path: StrokePath) -> None:
    low = LAB.cell.geometry[0].model_copy(
        update={"name": "shelf", "box_mm": (600.0, 600.0, 10.0), "at_mm": (200.0, -240.0, 120.0)}
    )
    blocked = LAB.cell.model_copy(update={"geometry": (*LAB.cell.geometry, low)})
    planner = MotionPlanner(LAB.urdf, blocked, {STATION.name: MORTAR})
    with pytest.raises(SkillFailed, match="shelf") as failed:
        planned_stroke(planner, np.array([0.0, 0.9, 0.0, -2.5, 0.0, -0.4, 0.0]), path, blocked, STATION.name, MORTAR)
    assert failed.value.code == "arm.no_path"


def test_a_cone_that_opens_where_it_stands_stays_upright_about_its_apex(planner: MotionPlanner) -> None:
    x_mm, y_mm, z_mm = STATION.position_mm
    planner.set_geometry(0.070)
    place = ApexPose(np.array([x_mm, y_mm, z_mm + MORTAR.height_mm + 25.0]) / 1e3)
    planner.add_place("above", place)
    start = planner.move(planner.home(), "above").end
    poses, rims_mm = _poses(planner.reform(start, "above", 90.0, _roller_rad))
    planner.set_geometry()
    assert rims_mm[[0, -1]] == pytest.approx([70.0, 90.0], abs=0.05)
    assert max(pose.tilt_deg for pose in poses) < 0.5
    assert max(np.linalg.norm(pose.position_m - place.position_m) for pose in poses) < 5e-4


def test_on_its_way_to_a_stroke_the_cone_is_formed_and_touches_nothing(planner: MotionPlanner) -> None:
    stroke = replace(chosen(Bed(MORTAR, 20000.0, BEADS), Ladle.of(HAND), 4000.0), heading_deg=OUTWARD_DEG + 90.0)
    path = stroke_path(Vessel.of(MORTAR), stroke, Ladle.of(HAND))
    motion = planned_stroke(planner, planner.home(), path, LAB.cell, STATION.name, MORTAR)
    way = planner.forming(planner.home(), motion.start[:7], (90.0, 82.0), _roller_rad)
    rolled_mm = [Cone.from_roller(math.degrees(turned), HAND).diameter_mm for turned in way.at(way.knots_s)[:, 7]]
    assert rolled_mm[0] == pytest.approx(90.0, abs=0.01)
    assert rolled_mm[-1] == pytest.approx(82.0, abs=0.01)
    assert np.abs(way.end[:7] - motion.start[:7]).max() < 1e-9
    assert with_roller(planner.rates, HAND).stretch_for(way) <= 1 + 1e-6
    alone_s = planner.move(planner.home(), motion.start[:7]).duration_s
    assert way.duration_s < alone_s + 0.5 * math.pi * (90.0 - 82.0) / HAND.morph_speed_mm_per_s


def test_a_cone_that_would_touch_something_at_its_first_size_is_not_formed_on_the_way() -> None:
    x_mm, y_mm, z_mm = STATION.position_mm
    place = ApexPose(np.array([x_mm, y_mm, z_mm + 200.0]) / 1e3)
    ring = LAB.cell.geometry[0].model_copy(
        update={"name": "ring", "box_mm": (4.0, 4.0, 4.0), "at_mm": (x_mm + 33.0, y_mm, z_mm + 200.0 + 30.0)}
    )
    narrow = LAB.cell.model_copy(update={"geometry": (*LAB.cell.geometry, ring)})
    planner = MotionPlanner(LAB.urdf, narrow, {STATION.name: MORTAR})
    planner.set_geometry(0.040)
    begin = planner.move(planner.home(), place).end
    assert planner.forming(begin, planner.home(), (42.0, 40.0), _roller_rad).duration_s > 0.0
    with pytest.raises(SkillFailed, match="would touch") as failed:
        planner.forming(begin, planner.home(), (90.0, 40.0), _roller_rad)
    assert failed.value.code == "arm.no_path"


def test_a_stroke_that_is_asked_for_again_has_the_answer_that_it_had(
    planner: MotionPlanner, motion: StoppableTrajectory, path: StrokePath
) -> None:
    assert planned_stroke(planner, planner.home(), path, LAB.cell, STATION.name, MORTAR) is motion
    forming = planner.forming(planner.home(), motion.start[:7], (90.0, 82.0), _roller_rad)
    assert planner.forming(planner.home(), motion.start[:7], (90.0, 82.0), _roller_rad) is forming
    assert planner.forming(planner.home(), motion.start[:7], (88.0, 82.0), _roller_rad) is not forming
    far = replace(path, apex_mm=path.apex_mm + 900.0 * UP)
    whys = []
    for _ in range(2):
        with pytest.raises(SkillFailed) as failed:
            planned_stroke(planner, planner.home(), far, LAB.cell, STATION.name, MORTAR)
        whys.append((failed.value.code, failed.value.detail))
    assert whys == [("arm.unreachable", "the arm cannot reach every pose of this motion")] * 2


def test_strokes_that_cannot_be_do_not_hold_the_scenes_that_they_were_looked_for_in(path: StrokePath) -> None:
    planner = LAB.motion_planner({STATION.name: MORTAR})
    far, home = replace(path, apex_mm=path.apex_mm + 900.0 * UP), planner.home()

    def scenes() -> int:
        gc.collect()
        return sum(isinstance(one, Scene) for one in gc.get_objects())

    before = scenes()
    for narrower_mm in range(STROKES_KEPT + 2):
        with suppress(SkillFailed):
            other = replace(far, rim_mm=far.rim_mm - narrower_mm)
            planned_stroke(planner, home, other, LAB.cell, STATION.name, MORTAR)
    assert scenes() - before == STROKES_KEPT


@pytest.mark.parametrize(("name", "mortar"), [("mortar_bay", "agate_mortar"), ("mortar_bay_2", "small_agate_mortar")])
def test_the_arm_can_swing_to_and_fro_at_a_station_with_either_mortar(name: str, mortar: str) -> None:
    kind, station = LAB.library.mortars[mortar], LAB.cell.stations[name]
    planner = LAB.motion_planner({name: kind})
    bed = Bed(kind, 6000.0, BEADS)
    outward_deg = math.degrees(math.atan2(station.position_mm[1], station.position_mm[0]))
    for wanted_mg in (2000.0, 6000.0):
        stroke, possible = chosen(bed, Ladle.of(HAND), wanted_mg), []
        for aside_deg in (90.0, 240.0, 270.0, 300.0):
            path = stroke_path(Vessel.of(kind), replace(stroke, heading_deg=outward_deg + aside_deg), Ladle.of(HAND))
            try:
                possible.append(planned_stroke(planner, planner.home(), path, LAB.cell, name, kind).duration_s)
            except SkillFailed:
                continue
        assert len(possible) >= 2
        assert min(possible) < 9.0


def test_a_course_is_slower_only_where_a_joint_is_too_quick() -> None:
    rates = RateLimits(np.array([1.0, 1.0]), np.array([4.0, 4.0]), np.array([40.0, 40.0]))
    times_s = np.linspace(0.0, 4.0, 161)
    share = times_s / 4.0
    even = share**3 * (10 - 15 * share + 6 * share**2)
    quick = 1.2 / (1 + np.exp(-(times_s - 2.0) / 0.1))
    samples = np.column_stack([even, quick])
    motion = slowed(times_s, samples, rates)
    whole = through(times_s, samples)
    assert rates.stretch_for(motion) <= 1 + 1e-6
    assert motion.duration_s < 0.75 * rates.stretch_for(whole) * whole.duration_s
    assert np.abs(motion.at(motion.knots_s) - samples).max() < 1e-9, "it is where it was asked to be"
