"""Something that is seen in the cell: planned around from then on, and told to who is on the way into it."""

import numpy as np
import pytest

from scuhand_bt.lab import load_lab, starter_lab
from scuhand_bt.motion import ApexPose, MotionPlanner
from scuhand_bt.motion.kinematics import LIMITS_RAD

LAB = load_lab(starter_lab())
AT_M, HALF_M = np.array([0.18, 0.16, 0.2]), np.array([0.03, 0.06, 0.08])


def box_of_points(step_m: float = 0.01) -> np.ndarray:
    """A person's hand, as a depth camera would see it: points on the surface of a box."""
    rng = np.random.default_rng(1)
    points = rng.uniform(-1, 1, (6000, 3))
    side = rng.integers(3, size=len(points))
    points[np.arange(len(points)), side] = np.sign(points[np.arange(len(points)), side])
    return AT_M + points * HALF_M


@pytest.fixture
def planner() -> MotionPlanner:
    made = MotionPlanner(LAB.urdf, LAB.cell, {})
    made.add_place("waste", ApexPose(np.array([0.06, 0.32, 0.2])))
    return made


def least_m(motion, points: np.ndarray) -> float:
    """The least distance of the cone's apex and the wrist from the points, by plain kinematics."""
    import pinocchio as pin

    model = pin.buildModelFromXML(LAB.urdf)
    data, least = model.createData(), np.inf
    for t in np.linspace(0, motion.duration_s, 200):
        pin.forwardKinematics(model, data, motion.sample(t))
        for joint, x_m in ((6, 0.0), (7, 0.06), (7, 0.12)):
            least = min(least, np.linalg.norm(points - data.oMi[joint].act(np.array([0.0, 0.0, x_m])), axis=1).min())
    return float(least)


def test_what_is_seen_is_planned_around_and_forgotten_when_it_has_gone(planner: MotionPlanner) -> None:
    start, points = planner.home(), box_of_points()
    before = planner.move(start, "waste")
    assert planner.keeps_clear(before)
    planner.set_occupied(points)
    assert not planner.keeps_clear(before)
    around = planner.move(start, "waste")
    assert planner.keeps_clear(around)
    assert around.duration_s > before.duration_s
    assert least_m(around, points) > least_m(before, points)
    planner.set_occupied(None)
    assert planner.move(start, "waste").coefficients.tobytes() == before.coefficients.tobytes()


def test_what_is_seen_elsewhere_changes_no_way(planner: MotionPlanner) -> None:
    before = planner.move(planner.home(), "waste")
    planner.set_occupied(box_of_points() - (0.0, 0.45, 0.0))
    assert planner.move(planner.home(), "waste").coefficients.tobytes() == before.coefficients.tobytes()


def test_of_a_motion_under_way_only_what_is_left_of_it_counts(planner: MotionPlanner) -> None:
    motion = planner.move(planner.home(), "waste")
    planner.set_occupied(box_of_points())
    free = [planner.keeps_clear(motion, at_s) for at_s in np.linspace(0.0, motion.duration_s, 12)]
    assert free == sorted(free)
    assert free[0] is False
    assert free[-1] is True


def test_the_cubes_are_kept_away_from_as_boxes_of_their_size_are(planner: MotionPlanner) -> None:
    import coal
    import pinocchio as pin

    planner.set_occupied(box_of_points(), voxel_m=0.04)
    cubes = np.unique(np.floor(box_of_points() / 0.04), axis=0) * 0.04 + 0.02
    scene = planner.scene()
    planner.set_occupied(None)
    q = np.random.default_rng(2).uniform(LIMITS_RAD[0], LIMITS_RAD[1], (1500, 7))
    q = q[~planner.scene().hits(q)]
    hits, data, shape = scene.hits(q), scene.model.createData(), coal.Box(0.04, 0.04, 0.04)
    assert 5 < hits.sum() < len(q) / 2
    arm = [thing for thing in scene.shapes.geometryObjects if thing.parentJoint > 1]
    for hit, one in zip(hits[:250], q[:250], strict=True):
        pin.forwardKinematics(scene.model, data, one)
        apart_m = np.inf
        for thing in arm:
            where = data.oMi[thing.parentJoint] * thing.placement
            placed = coal.Transform3s(where.rotation, where.translation)
            for cube in cubes[np.linalg.norm(cubes - where.translation, axis=1) < 0.3]:
                there = coal.Transform3s(np.eye(3), cube)
                result = coal.DistanceResult()
                apart_m = min(
                    apart_m, coal.distance(shape, there, thing.geometry, placed, coal.DistanceRequest(), result)
                )
        assert hit == (apart_m <= 0.005)


@pytest.mark.parametrize(
    ("points", "voxel_m", "said"),
    [
        (np.zeros((0, 3)), 0.02, "shape"),
        (np.zeros(3), 0.02, "shape"),
        (np.array([[np.nan, 0, 0]]), 0.02, "finite"),
        (np.zeros((1, 3)), 0.0, "1 mm to 1 m"),
        (np.random.default_rng(0).uniform(-5, 5, (250_000, 3)), 0.002, "use wider ones"),
    ],
)
def test_what_is_no_points_is_refused(planner: MotionPlanner, points: np.ndarray, voxel_m: float, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        planner.set_occupied(points, voxel_m)
