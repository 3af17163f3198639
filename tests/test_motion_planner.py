import gc
import itertools
import re
import weakref

import numpy as np
import pytest

from scuhand_bt.failures import SkillFailed
from scuhand_bt.lab import load_lab, starter_lab
from scuhand_bt.motion import ApexPose, MotionPlanner, Mount, apex, solutions, transfer
from scuhand_bt.motion.collision import Scene
from scuhand_bt.motion.kinematics import LIMITS_RAD
from scuhand_bt.motion.spill import apex_motion, spill_angles_deg
from scuhand_bt.motion.timelaw import rest_to_rest_s
from scuhand_bt.motion.transfer import BRIEF, LIVE

LAB = load_lab(starter_lab())
MORTAR = LAB.library.mortars["agate_mortar"]
MOUNT = Mount.of(LAB.cell.hand)
ABOVE_MM = {"mortar_bay": 90, "mortar_bay_2": 90, "balance": 80, "waste": 40, "sheet_swap": 0, "park": 0}


def above(station, height_mm):
    x, y, z = LAB.cell.stations[station].position_mm
    return ApexPose(np.array([x, y, z + height_mm]) / 1e3)


def new_planner():
    planner = MotionPlanner(LAB.urdf, LAB.cell, {"mortar_bay": MORTAR, "mortar_bay_2": MORTAR})
    planner.set_geometry(container=LAB.library.containers["alumina_crucible"])
    for station, height_mm in ABOVE_MM.items():
        planner.add_place(station, above(station, height_mm))
    return planner


@pytest.fixture(scope="module")
def planner():
    prepared = new_planner()
    prepared.prepare()
    return prepared


def posture(planner, place):
    return planner.move(planner.home(), place).end


def times(motion, step_s=0.002):
    return np.linspace(0.0, motion.duration_s, int(motion.duration_s / step_s) + 2)


def nearest_m(planner, motion):
    return min(planner.scene().clearance_m(q)[0] for q in motion.at(times(motion, 0.01)))


def test_every_pair_of_stations_of_the_starter_lab_has_a_motion_that_touches_nothing(planner):
    for first in ABOVE_MM:
        for second in ABOVE_MM:
            motion = planner.move(posture(planner, first), second)
            assert np.abs(apex(motion.end, MOUNT).position_m - above(second, ABOVE_MM[second]).position_m).max() < 1e-9
            assert nearest_m(planner, motion) > 0.003


def test_a_motion_keeps_every_joints_limits(planner):
    motion = planner.move(posture(planner, "mortar_bay"), "balance")
    assert planner.rates.stretch_for(motion) <= 1 + 1e-6
    q = motion.at(times(motion))
    assert ((q >= LIMITS_RAD[0] - 1e-9) & (q <= LIMITS_RAD[1] + 1e-9)).all()


@pytest.mark.parametrize("effort", [BRIEF, LIVE])
def test_a_brief_search_for_a_loads_way_plants_no_trees(monkeypatch, effort):
    """Where there is none, they took 7 s of a check for each direction of a stroke."""
    planned = []
    monkeypatch.setattr(transfer._Search, "direct", lambda search, goals, upto_s: search.add(goals) and None)
    monkeypatch.setattr(transfer._Search, "quicker_than", lambda search, *_: None)
    monkeypatch.setattr(transfer._Search, "by_rrt_connect", lambda search, *_: planned.append(search._loaded))
    planner = new_planner()
    pose = above("mortar_bay", 120)
    with pytest.raises(SkillFailed, match=r"arm\.no_path"):
        planner.move(planner.home(), pose, spill_limit_deg=25.0, effort=effort)
    assert any(planned) is (effort is LIVE)


@pytest.mark.slow
def test_two_planners_answer_the_same_request_with_the_same_motion(planner):
    other = new_planner()
    # In another order: what was planned before must not matter.
    other.move(posture(other, "balance"), "mortar_bay_2", spill_limit_deg=25.0)
    for spill_limit_deg in (None, 25.0):
        one, two = (
            p.move(posture(p, "mortar_bay_2"), "balance", spill_limit_deg=spill_limit_deg) for p in (planner, other)
        )
        assert one.coefficients.tobytes() == two.coefficients.tobytes()


def test_what_stands_on_the_pan_changes_no_motion_that_is_free_of_it():
    planner = new_planner()
    planner.set_geometry()
    bare = planner.move(posture(planner, "mortar_bay"), "waste")
    planner.set_geometry(container=LAB.library.containers["alumina_crucible"])
    past = planner.move(posture(planner, "mortar_bay"), "waste")
    assert past.coefficients.tobytes() == bare.coefficients.tobytes()
    past = planner.move(posture(planner, "mortar_bay"), "balance")
    assert nearest_m(planner, past) > 0.003


def test_between_places_motions_are_polished(planner):
    ratios = []
    for first, second in itertools.combinations(ABOVE_MM, 2):
        begin, goal = posture(planner, first), posture(planner, second)
        least_s = rest_to_rest_s(goal - begin, planner.rates)
        ratios.append(planner.move(begin, second).duration_s / least_s)
    assert np.mean(ratios) < 1.1
    assert max(ratios) < 1.7


@pytest.mark.parametrize("limit_deg", [30.0, 10.0])
def test_a_loaded_cone_keeps_its_spill_limit_at_every_sample(planner, limit_deg):
    for goal in ("balance", "park"):
        motion = planner.move(posture(planner, "mortar_bay"), goal, spill_limit_deg=limit_deg)
        at_s = times(motion, 0.001)
        angles = spill_angles_deg(*apex_motion(motion.at(at_s), motion.at(at_s, 1), motion.at(at_s, 2), MOUNT))
        assert angles.max() <= limit_deg
        assert planner.rates.stretch_for(motion) <= 1 + 1e-6
        assert nearest_m(planner, motion) > 0.003


def test_a_goal_may_be_any_pose(planner):
    motion = planner.move(planner.home(), above("balance", 100))
    assert apex(motion.end, MOUNT).position_m == pytest.approx(above("balance", 100).position_m, abs=1e-9)
    assert apex(motion.end, MOUNT).tilt_deg == pytest.approx(0.0, abs=1e-6)


def test_an_arm_that_reports_a_count_off_its_posture_gets_the_prepared_motion(planner):
    home = planner.home()
    assert planner.move(home + 0.001, "balance") is planner.move(home, "balance")


def test_a_place_that_is_named_again_is_where_it_is_now():
    planner = new_planner()
    planner.move(planner.home(), "waste")
    moved = ApexPose(np.array([0.1, 0.3, 0.18]))
    planner.add_place("waste", moved)
    end = planner.move(planner.home(), "waste").end
    assert apex(end, MOUNT).position_m == pytest.approx(moved.position_m, abs=1e-9)


def test_a_load_comes_straight_down_over_a_mouth_within_its_spill_limit(planner):
    begin = planner.move(posture(planner, "mortar_bay"), above("balance", 110)).end
    motion = planner.contact(begin, [above("balance", 80)], 0.06, spill_limit_deg=5.0)
    q = motion.at(times(motion))
    positions_m = np.array([apex(one, MOUNT).position_m for one in q])
    assert positions_m[-1] == pytest.approx(above("balance", 80).position_m, abs=1e-9)
    assert np.abs(positions_m[:, :2] - positions_m[0, :2]).max() < 2e-5
    angles = spill_angles_deg(*apex_motion(q, motion.at(times(motion), 1), motion.at(times(motion), 2), MOUNT))
    assert angles.max() <= 5.0 == motion.spill_limit_deg


def test_a_contact_path_does_not_begin_inside_something(planner):
    x, y, _ = above("mortar_bay", 0).position_m
    inside = solutions(ApexPose(np.array([x, y, 0.0])), MOUNT)[0]
    with pytest.raises(SkillFailed) as failed:
        planner.contact(inside, [above("mortar_bay", 90)], 0.04)
    assert failed.value.code == "arm.start_in_collision"


def test_a_pose_out_of_reach_is_refused_with_the_nearest_one(planner):
    for far_m in (0.7, 3.0):
        with pytest.raises(SkillFailed, match="nearest position that the apex can reach") as failed:
            planner.move(planner.home(), ApexPose(np.array([far_m, 0.0, 0.1])))
    assert failed.value.code == "arm.unreachable"


def test_the_nearest_one_can_be_taken_as_it_is_written(planner):
    # On the edge of what the arm reaches: rounded by less than half a millimetre it is out of reach again.
    for far in ([0.5247025, -0.2738464, 0.47368276], [0.61890997, -0.32636175, 0.52342386], [0.7, 0.0, 0.1]):
        with pytest.raises(SkillFailed, match="nearest position that the apex can reach") as failed:
            planner.move(planner.home(), ApexPose(np.array(far)))
        x, y, z = re.search(r"the apex can reach is \((-?\d+), (-?\d+), (-?\d+)\) mm", failed.value.detail).groups()
        taken = planner.move(planner.home(), ApexPose(np.array([float(x), float(y), float(z)]) / 1e3))
        assert taken.duration_s > 0


@pytest.mark.parametrize("turn_rad", [1e-3, -1e-3])
def test_a_start_inside_something_is_refused_by_name(planner, turn_rad):
    start = posture(planner, "balance").copy()
    start[:2] += turn_rad, -0.35
    with pytest.raises(SkillFailed, match=r"where it stands, the arm touches something.* overlap by") as failed:
        planner.move(start, "park")
    assert failed.value.code == "arm.start_in_collision"


def test_a_goal_inside_something_is_the_goal_in_whatever_direction_the_way_is_looked_for(planner):
    goal = posture(planner, "balance").copy()
    goal[1] -= 0.35
    for place in ABOVE_MM:
        start = planner.standing_at(place)
        with pytest.raises(SkillFailed, match=r"cannot stand at the configuration asked for: .* overlap by"):
            planner.move(start, goal)


def test_a_station_inside_an_obstacle_is_refused_by_name(planner):
    with pytest.raises(SkillFailed, match=r"cannot stand at .* overlap by") as failed:
        planner.move(planner.home(), ApexPose(np.array([0.35, 0.103, 0.15])))
    assert failed.value.code == "arm.no_path"


def test_a_start_beyond_a_joints_limit_and_one_that_is_no_number_are_refused(planner):
    start = planner.home()
    start[3] = 0.2
    with pytest.raises(SkillFailed, match="joint 4"):
        planner.move(start, "park")
    with pytest.raises(ValueError, match="finite"):
        planner.move(np.full(7, np.nan), "park")


@pytest.mark.parametrize("diameter_m", [float("nan"), 0.0, 0.1])
def test_a_cone_that_the_sheet_does_not_make_is_refused(planner, diameter_m):
    with pytest.raises(ValueError, match="less than 100 mm"):
        planner.set_geometry(diameter_m)


@pytest.mark.parametrize("lift_mm", [0.001, 1.0])
def test_the_cone_is_lifted_a_little_as_quickly_as_a_little_takes(planner, lift_mm):
    begin = planner.standing_at("mortar_bay")
    motion = planner.move(begin, above("mortar_bay", 90 + lift_mm))
    least_s = rest_to_rest_s(motion.end - begin, planner.rates)
    assert motion.duration_s <= 1.01 * least_s
    assert motion.duration_s < (0.05 if lift_mm < 0.01 else 0.2)


def test_a_contact_path_that_would_creep_is_refused(planner):
    with pytest.raises(ValueError, match=r"at least 0.1 mm/s"):
        planner.contact(planner.home(), [above("park", 10)], 1e-6)


@pytest.mark.parametrize("limit_deg", [float("nan"), 0.0, -3.0])
def test_a_spill_limit_that_is_no_angle_is_refused(planner, limit_deg):
    with pytest.raises(ValueError, match="spill limit"):
        planner.move(planner.home(), "balance", spill_limit_deg=limit_deg)


def test_a_stop_at_no_moment_is_refused_and_one_outside_the_motion_is_at_its_ends(planner):
    motion = planner.move(planner.home(), "balance")
    with pytest.raises(ValueError, match="moment"):
        motion.stopped_from(float("nan"))
    assert motion.stopped_from(motion.duration_s + 1).duration_s == motion.duration_s
    assert motion.stopped_from(-1.0).sample(0.0) == pytest.approx(motion.start)


def test_a_contact_path_without_waypoints_stays_where_it_is(planner):
    home = planner.home()
    assert planner.contact(home, [], 0.04).end == pytest.approx(home)


def test_unknown_places_and_stations_are_named_with_what_there_is(planner):
    with pytest.raises(KeyError, match="there are: mortar_bay"):
        planner.move(planner.home(), "balnce")
    with pytest.raises(KeyError, match="the cell has no station"):
        MotionPlanner(LAB.urdf, LAB.cell, {"nowhere": MORTAR})


def test_a_contact_path_passes_its_waypoints_at_its_speed_without_a_jump(planner):
    start = posture(planner, "mortar_bay")
    tilt = np.radians(8.0)
    leaning = np.array([np.sin(tilt), 0.0, np.cos(tilt)])
    x, y, _ = above("mortar_bay", 0).position_m
    waypoints = [
        ApexPose(np.array([x, y, 0.06])),
        ApexPose(np.array([x - 0.01, y, 0.055]), leaning),
        ApexPose(np.array([x, y, 0.045])),
        above("mortar_bay", 90),
    ]
    motion = planner.contact(start, waypoints, 0.04, touching="mortar_bay")
    at_s = times(motion)
    poses = [apex(q, MOUNT) for q in motion.at(at_s)]
    positions_m = np.array([pose.position_m for pose in poses])
    assert np.linalg.norm(np.diff(positions_m, axis=0), axis=1).max() / (at_s[1] - at_s[0]) <= 0.0402
    for waypoint in waypoints:
        # Corners are cut by at most speed * averaging time / 3.
        assert np.linalg.norm(positions_m - waypoint.position_m, axis=1).min() < 0.04 * 0.08 / 3 + 2e-4
    assert np.abs(np.diff(motion.at(at_s), axis=0)).max() < 0.01
    assert positions_m[-1] == pytest.approx(waypoints[-1].position_m, abs=1e-6)
    assert planner.rates.stretch_for(motion) <= 1 + 1e-6


def test_only_the_named_mortar_may_be_touched(planner):
    planner.set_geometry(0.070)  # its handle is steep enough to pass the mortar's edge
    start = posture(planner, "mortar_bay")
    x, y, _ = above("mortar_bay", 0).position_m
    down = [ApexPose(np.array([x, y, 0.043]))]
    assert planner.contact(start, down, 0.04, touching="mortar_bay").duration_s > 0.5
    with pytest.raises(SkillFailed, match="mortar_bay") as failed:
        planner.contact(start, down, 0.04)
    assert failed.value.code == "arm.no_path"
    aside = [ApexPose(np.array([x + 0.12, y, z_m])) for z_m in (0.08, 0.0)]
    with pytest.raises(SkillFailed, match="table"):
        planner.contact(start, aside, 0.04, touching="mortar_bay")
    planner.set_geometry()


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
@pytest.mark.parametrize("spill_limit_deg", [None, 25.0])
def test_a_stop_comes_to_rest_on_the_path_and_not_after_the_motions_own_end(planner, share, spill_limit_deg):
    motion = planner.move(posture(planner, "mortar_bay"), "balance", spill_limit_deg=spill_limit_deg)
    at_s = share * motion.duration_s
    stop = motion.stopped_from(at_s)
    for time_s in (0.0, at_s / 2, at_s):
        assert stop.sample(time_s) == pytest.approx(motion.sample(time_s), abs=1e-9)
    assert stop.duration_s <= motion.duration_s
    assert stop.stopped_from(at_s + 0.1) is stop
    path = motion.at(np.linspace(at_s, motion.duration_s, 4000))
    for time_s in np.linspace(at_s, stop.duration_s, 40):
        assert np.abs(path - stop.sample(time_s)).max(axis=1).min() < 2e-3
    h = 1e-4
    last = (stop.sample(stop.duration_s) - stop.sample(stop.duration_s - h)) / h
    assert np.abs(last).max() < 1e-3


def test_what_stands_on_the_pan_is_in_the_way():
    planner = new_planner()
    low = above("balance", 30)
    with pytest.raises(SkillFailed, match="alumina_crucible on the pan"):
        planner.move(planner.home(), low)
    planner.set_geometry()
    assert planner.move(planner.home(), low).duration_s > 0


def test_a_load_is_carried_from_a_cone_that_lies_below_its_handle_too(planner):
    """The level coordinates do not hold such a posture: a motion planned in them would begin in another."""
    start = np.radians([27.0, -42.0, 15.0, -84.0, 23.0, -87.0, -137.0])
    motion = planner.move(start, posture(planner, "mortar_bay"), spill_limit_deg=50.0)
    assert np.abs(motion.start - start).max() < 1e-9


def test_straight_down_to_a_place_every_height_over_the_pan_lets_the_arm(planner):
    """Where joint 2 or joint 6 passes through zero on the way, too."""
    x_mm, y_mm, _ = LAB.cell.stations["balance"].position_mm
    for height_mm in range(120, 200, 10):
        place = ApexPose(np.array([x_mm, y_mm, height_mm]) / 1e3)
        planner.add_place("over the pan", place)
        down = planner.descent("over the pan", 0.06, 0.06, spill_limit_deg=20.0)
        assert planner.descent("over the pan", 0.06, 0.06, spill_limit_deg=20.0) is down
        mount = Mount.of(LAB.cell.hand)
        ways = [apex(down.sample(share * down.duration_s), mount) for share in np.linspace(0.0, 1.0, 30)]
        assert np.linalg.norm(ways[-1].position_m - place.position_m) < 1e-4
        assert max(np.linalg.norm(way.position_m[:2] - place.position_m[:2]) for way in ways) < 5e-4
        assert ways[0].position_m[2] - ways[-1].position_m[2] == pytest.approx(0.06, abs=1e-4)
        assert max(way.tilt_deg for way in ways) < 0.5


@pytest.mark.slow
def test_what_is_kept_for_cones_of_many_sizes_does_not_grow(planner):
    """Every scoop forms another; a planner that kept what it made for each would fill the memory."""
    counts = []
    gc.collect()
    others = {id(one) for one in gc.get_objects() if isinstance(one, Scene)}
    for sizes in (40, 120):
        several = new_planner()
        for k in range(sizes):
            several.set_geometry(0.080 + 1e-4 * k)
            several.move(several.standing_at("park"), several.standing_at("park"))
        gc.collect()
        counts.append(len(gc.get_objects()))
        kept = [one for one in gc.get_objects() if isinstance(one, Scene) and id(one) not in others]
        assert len([one for one in kept if one.arm_shapes]) < 60
        del several, kept
    assert counts[1] < 1.02 * counts[0]


def test_a_planner_that_nobody_has_any_more_is_gone_at_once():
    """Python counts few objects in it, and would collect its scenes late."""
    several, gone = new_planner(), []
    weakref.finalize(several, gone.append, True)
    gc.disable()
    try:
        del several
        assert gone
    finally:
        gc.enable()


def test_what_has_let_go_of_its_scenes_builds_them_again(planner):
    several = new_planner()
    scene = weakref.ref(several.scene())
    several.let_go()
    gc.collect()
    assert scene() is None
    start = several.home()
    assert np.array_equal(several.move(start, "waste").coefficients, planner.move(start, "waste").coefficients)
