"""Loads in a cell that nobody drew, judged by an audit that shares nothing with the planner."""

import itertools
from types import SimpleNamespace

import numpy as np
import pytest
from daily import first_daily

from harness import mesh_bodies
from harness.motion_audit import Audit
from harness.motion_layouts import CONTAINER, LAB, LIMITS_DEG, Bench, carries, drawn
from scuhand_bt.bench_spec import Obstacle
from scuhand_bt.cell.places import all_places, over_balance
from scuhand_bt.failures import SkillFailed
from scuhand_bt.motion import ApexPose, Mount, apex
from scuhand_bt.motion.kinematics import LIMITS_RAD
from scuhand_bt.motion.trajectory import JointTrajectory

LAYOUT = drawn(2)


def carried(planner, limit_deg, first="mortar_bay", second="mortar_bay_2"):
    return planner.move(planner.standing_at(first), second, spill_limit_deg=limit_deg)


@pytest.fixture(scope="module")
def planner():
    return LAYOUT.planner()


@pytest.mark.slow
def test_a_load_that_may_lean_more_is_never_carried_more_slowly(planner):
    # The loosest first: what is known for stricter limits must not be needed.
    for first, second in (("mortar_bay", "mortar_bay_2"), ("mortar_bay_2", "balance")):
        taken_s = [carried(planner, limit, first, second).duration_s for limit in reversed(LIMITS_DEG)]
        assert taken_s == sorted(taken_s)


@pytest.mark.slow
def test_a_load_between_places_is_never_quicker_than_the_empty_cone_and_a_looser_one_never_slower():
    planner = drawn(216).planner()
    empty_s = planner.move(planner.standing_at("mortar_bay"), "balance").duration_s
    taken_s = [
        carried(planner, limit_deg, "mortar_bay", "balance").duration_s for limit_deg in (45.0, 30.0, 20.0, 10.0)
    ]
    assert taken_s[0] == pytest.approx(empty_s, rel=1e-3), "the empty cone's way spills nothing at 45 degrees"
    assert taken_s == sorted(taken_s)


def test_a_load_between_places_is_not_bound_to_the_way_of_one_that_may_not_lean():
    planner = drawn(9711).planner()
    leaning_s, level_s = (carried(planner, a, "mortar_bay_2", "balance").duration_s for a in (31.8, 10.0))
    assert leaning_s < 0.7 * level_s


def test_a_load_that_was_left_leaning_on_its_way_is_carried_on():
    # A program that is killed leaves the arm where it is: 33 degrees are within this limit, and above the rung of 30.
    limit_deg, mortars = 33.7, {"mortar_bay": LAB.library.mortars["agate_mortar"]}
    holder, source = (
        LAB.library.containers["xrd_holder"],
        SimpleNamespace(station="mortar_bay", mortar=mortars["mortar_bay"]),
    )
    planner = LAB.motion_planner(mortars)
    for name, position_mm in all_places(LAB.cell, {"beads": source}, [holder]).items():
        planner.add_place(name, ApexPose(np.array(position_mm) / 1000))
    planner.set_geometry(container=holder)
    over, _ = over_balance(LAB.cell, holder)
    way = carried(planner, limit_deg, "mortar_bay", over)
    left = [way.sample(at_s) for at_s in np.linspace(0.0, way.duration_s, 60)]
    # Where it speeds up it may lean more than it could at rest: from there nothing carries it on.
    leaning = max(
        (q for q in left if apex(q, planner.mount()).tilt_deg <= limit_deg),
        key=lambda q: apex(q, planner.mount()).tilt_deg,
    )
    assert apex(leaning, planner.mount()).tilt_deg > 33.0
    verdict = Audit(LAB.urdf, LAB.cell, mortars, holder).of(planner.move(leaning, over, spill_limit_deg=limit_deg))
    assert verdict.clearance_m > 0.003
    assert verdict.spill_deg <= limit_deg
    assert verdict.over_limit < 2e-6


def test_a_load_on_the_way_is_as_quick_as_the_empty_cone_where_it_may_lean_and_never_quicker():
    # Here the search for 31.8 degrees finds a quicker way than the empty cone's, which spills nothing at 60.
    layout = drawn(508)
    planner = layout.planner()
    first, _, near = next(itertools.islice(carries(layout, 16), 2, None))
    assert near is not None
    start = planner.standing_at(first)
    taken_s = [planner.move(start, near, spill_limit_deg=limit).duration_s for limit in (60.0, 31.8, 10.0)]
    assert taken_s[1] >= taken_s[0] / 1.01
    assert taken_s[2] >= taken_s[1] / 1.01


def ways_near(layout, count):
    """Loads' ways to poses near a place, which are planned while the arm waits."""
    return [(first, near) for first, _, near in carries(layout, count) if near is not None]


def test_on_the_way_too_a_load_that_may_lean_more_is_never_slower():
    layout = drawn(1404)
    planner = layout.planner()
    for first, near in ways_near(layout, 7):
        start, taken_s = planner.standing_at(first), []
        for limit_deg in (60.0, 45.0, 31.8, 30.0, 29.0, 20.0, 19.0, 10.0, 9.0):
            taken_s.append(planner.move(start, near, spill_limit_deg=limit_deg).duration_s)
        assert all(looser <= 1.01 * min(taken_s[k:]) for k, looser in enumerate(taken_s))


def test_a_load_that_may_lean_is_not_bound_to_the_way_of_one_that_may_not():
    # Improving on the level way, which is twice as long, the search stood still: it begins anew.
    layout = drawn(1402)
    planner = layout.planner()
    first, near = ways_near(layout, 7)[0]
    start = planner.standing_at(first)
    empty_s, leaning_s, level_s = (planner.move(start, near, spill_limit_deg=a).duration_s for a in (None, 31.8, 10.0))
    assert leaning_s < 0.7 * level_s
    assert leaning_s < 1.1 * empty_s


@pytest.mark.slow
def test_a_load_for_which_the_search_is_ever_so_strict_is_never_quicker(planner):
    taken_s = [carried(planner, limit_deg).duration_s for limit_deg in (11.0, 9.9, 7.0, 4.0, 2.0)]
    assert taken_s == sorted(taken_s)


@pytest.mark.slow
def test_a_load_is_carried_alike_whatever_was_asked_before(planner):
    other = LAYOUT.planner()
    one, two = carried(other, 15.0), carried(planner, 15.0)
    assert one.coefficients.tobytes() == two.coefficients.tobytes()


def test_a_motion_is_the_same_whatever_stood_on_the_pan_and_whatever_the_cone_was_before():
    first, second = LAYOUT.planner(), LAYOUT.planner()
    stood = first.standing_at("balance")  # with the usual cone; with the next one it is no place's posture
    ways = []
    for planner in (first, second):
        planner.set_geometry(0.08, CONTAINER)
        ways.append(planner.move(stood, "mortar_bay").coefficients.tobytes())
    assert ways[0] == ways[1]


@pytest.mark.parametrize("limit_deg", first_daily(*LIMITS_DEG))
def test_what_carries_a_load_touches_nothing_spills_nothing_and_keeps_every_limit(planner, limit_deg):
    verdict = Audit(LAB.urdf, LAYOUT.cell, LAYOUT.mortars, CONTAINER).of(carried(planner, limit_deg))
    assert verdict.clearance_m > 0.003
    assert verdict.spill_deg <= limit_deg
    assert verdict.over_limit < 2e-6


def test_the_audit_sees_what_touches_what_is_too_quick_and_what_spills(planner):
    audit = Audit(LAB.urdf, LAYOUT.cell, LAYOUT.mortars, CONTAINER)
    motion = carried(planner, 10.0)
    hurried = audit.of(motion.stretched(0.6))
    assert hurried.over_limit > 0.3
    assert hurried.spill_deg > 10.0
    walled = LAYOUT.cell.model_copy(update={"geometry": (*LAYOUT.cell.geometry, wall_through(motion))})
    verdict = Audit(LAB.urdf, walled, LAYOUT.mortars, CONTAINER).of(motion)
    assert verdict.clearance_m < -0.001
    assert "wall" in verdict.pair


def turning_joint_2(q, jerks, jump=0.0):
    """From rest at q, each of the jerks [rad/s^3] for 20 ms; the acceleration jumps once, before the last."""
    coefficients = np.zeros((4, len(jerks), 7))
    position, speed, acceleration = q.copy(), 0.0, 0.0
    for k, jerk in enumerate(jerks):
        acceleration += jump if k == len(jerks) - 1 else 0.0
        coefficients[0, k], coefficients[1:, k, 1] = position, (speed, acceleration / 2, jerk / 6)
        position[1] += 0.02 * (speed + 0.02 * (acceleration / 2 + 0.02 * jerk / 6))
        speed, acceleration = speed + 0.02 * (acceleration + 0.02 * jerk / 2), acceleration + 0.02 * jerk
    return JointTrajectory(0.02 * np.arange(len(jerks) + 1), coefficients)


def test_the_audit_tells_five_percent_over_a_limit_and_nothing_of_seams_within_it(planner):
    audit = Audit(LAB.urdf, LAYOUT.cell, LAYOUT.mortars, CONTAINER)
    q = planner.standing_at("balance")
    most = float(planner.rates.jerk[1])
    assert audit.of(turning_joint_2(q, [most, -most, most])).over_limit < 1e-6
    assert audit.of(turning_joint_2(q, [most, -1.05 * most, most])).over_limit == pytest.approx(0.05, abs=1e-3)
    jumping = audit.of(turning_joint_2(q, [most / 2, 0.0, 0.0], jump=0.1))
    assert jumping.over_limit > 0.1
    full = planner.move(q, "mortar_bay")  # some joint is at its acceleration or jerk limit
    assert audit.of(full).over_limit < 1e-6
    assert audit.of(full.stretched(1.05 ** (-1 / 3))).over_limit > 0.03


@pytest.mark.parametrize("name", ["body.stl", "body.obj"])
def test_the_audit_measures_a_mesh_as_the_box_that_it_is_the_surface_of(tmp_path, name):
    size_mm, at_mm, yaw_deg = (60.0, 120.0, 160.0), (230.0, 150.0, 90.0), 25.0
    file = mesh_bodies.write(tmp_path / name, mesh_bodies.box(size_mm, (0.0, 0.0, 0.0)) / 25.4)
    mesh = Obstacle(name="body", mesh=str(file), mesh_unit_mm=25.4, at_mm=at_mm, yaw_deg=yaw_deg)
    box = Obstacle(name="body", box_mm=size_mm, at_mm=at_mm, yaw_deg=yaw_deg)
    audits = [
        Audit(LAB.urdf, LAB.cell.model_copy(update={"geometry": [one]}), {}, None, diameter_mm=90.0)
        for one in (mesh, box)
    ]
    for q in np.random.default_rng(4).uniform(LIMITS_RAD[0], LIMITS_RAD[1], (60, 1, 7)):
        (away_m, pair), (same_m, same_pair) = (audit.nearest(audit.frames(q)) for audit in audits)
        assert away_m == pytest.approx(same_m, abs=1e-6)
        assert pair == same_pair


@pytest.mark.slow
def test_what_passes_a_portal_of_triangles_touches_nothing_in_the_audit(tmp_path):
    layout = drawn(503, Bench(LAB, meshes=tmp_path))  # it stands between the pan and a mortar
    planner, audit = layout.planner(), Audit(LAB.urdf, layout.cell, layout.mortars, CONTAINER)
    near = []
    for limit_deg in (None, 15.0):
        verdict = audit.of(planner.move(planner.standing_at("mortar_bay_2"), "balance", spill_limit_deg=limit_deg))
        assert verdict.clearance_m > 0.003
        near.append(verdict.pair)
    assert any("portal" in pair for pair in near)


def wall_through(motion):
    x_mm, y_mm, z_mm = 1e3 * apex(motion.sample(motion.duration_s / 2), Mount.of(LAB.cell.hand)).position_m
    return Obstacle(name="wall", box_mm=(6, 200, 200), at_mm=(x_mm, y_mm, z_mm))


def test_a_way_that_is_not_found_tells_what_is_in_it():
    planner = LAYOUT.planner()
    start = planner.standing_at("mortar_bay")
    with pytest.raises(SkillFailed) as failed:
        planner.move(start, planner.standing_at("mortar_bay_2"), spill_limit_deg=0.01)
    assert failed.value.code == "arm.no_path"
    assert "in the way: " in failed.value.detail
    assert "shield" in failed.value.detail
