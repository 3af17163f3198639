"""What touched points say of where things stand, and of the apex in the hand."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scuhand_bt.device_specs.hand import HandSpec
from scuhand_bt.motion.inverse import along, finest, nearest_configuration, solutions, swivel_of
from scuhand_bt.motion.kinematics import LIMITS_RAD, ApexPose, Mount, apex, apex_frames
from scuhand_bt.motion.touching import calibrated, standing

POINTS_MM = np.array([[260.0, 45.0, 58.0], [260.0, -45.0, 58.0], [390.0, 0.0, 60.0]])
PIVOT_MM = np.array([330.0, 0.0, 60.0])
lengths = st.floats(-30.0, 30.0)


def turned(points: np.ndarray, yaw_deg: float) -> np.ndarray:
    yaw = math.radians(yaw_deg)
    turn = np.array([[math.cos(yaw), -math.sin(yaw), 0.0], [math.sin(yaw), math.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
    return (points - PIVOT_MM) @ turn.T + PIVOT_MM


@given(st.tuples(lengths, lengths, lengths), st.floats(-170.0, 170.0))
def test_a_thing_that_was_moved_and_turned_is_found_where_it_stands(shift: tuple[float, ...], yaw_deg: float) -> None:
    found = standing(POINTS_MM, turned(POINTS_MM, yaw_deg) + shift, PIVOT_MM)
    assert found.shift_mm == pytest.approx(np.array(shift), abs=1e-6)
    assert found.yaw_deg == pytest.approx(yaw_deg, abs=1e-6)
    assert found.tilt_deg == pytest.approx(0.0, abs=1e-4)
    assert found.off_mm < 1e-6


def test_a_thing_that_leans_is_said_to_lean_and_is_not_said_to_be_turned() -> None:
    lean = math.radians(2.0)
    tilted = np.array([[math.cos(lean), 0.0, math.sin(lean)], [0.0, 1.0, 0.0], [-math.sin(lean), 0.0, math.cos(lean)]])
    found = standing(POINTS_MM, (POINTS_MM - PIVOT_MM) @ tilted.T + PIVOT_MM, PIVOT_MM)
    assert (found.tilt_deg, found.yaw_deg) == (pytest.approx(2.0), pytest.approx(0.0, abs=1e-9))
    middle = POINTS_MM.mean(axis=0) - PIVOT_MM
    assert found.shift_mm == pytest.approx(middle @ tilted.T - middle, abs=1e-9), "as high as in the points' middle"


def test_a_point_that_was_touched_beside_its_mark_shows() -> None:
    touched = POINTS_MM.copy()
    touched[1] += (0.0, -6.0, 0.0)
    assert standing(POINTS_MM, touched, PIVOT_MM).off_mm > 1.0


def test_points_on_one_line_are_refused() -> None:
    line = np.array([[0.0, 0.0, 0.0], [100.0, 0.0, 0.0], [200.0, 5.0, 0.0]])
    with pytest.raises(ValueError, match="one line"):
        standing(line, line, PIVOT_MM)


sides = st.floats(-0.006, 0.006)


@settings(max_examples=20, deadline=None)
@given(st.floats(0.10, 0.14), sides, sides, st.integers(0, 1000))
def test_an_apex_is_found_from_postures_that_meet_one_point(offset: float, x: float, y: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    mount = Mount(offset, math.radians(64.0), math.pi, (x, y))
    found = calibrated(np.array([_somehow(rng, mount) for _ in range(8)]))
    assert found.apex_mm == pytest.approx(1e3 * np.array([x, y, offset]), abs=1e-4)
    assert np.abs(found.off_rad).max() < 1e-6
    assert found.off_mm < 1e-4


@pytest.mark.parametrize("seed", range(4))
def test_joints_that_missed_their_marks_are_found_by_what_the_apex_then_meets(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mount = Mount(0.117, math.radians(64.0), math.pi, (0.0025, -0.0015))
    missed = np.radians([0.0, *rng.normal(0.0, 0.4, 5), 0.0])
    met = np.array([_somehow(rng, mount) for _ in range(12)])
    found = calibrated(met + missed)
    assert found.off_rad == pytest.approx(-missed, abs=math.radians(0.05))
    assert found.apex_mm == pytest.approx(np.array([2.5, -1.5, 117.0]), abs=0.3)
    assert found.off_mm < 0.3


def _somehow(rng: np.random.Generator, mount: Mount) -> np.ndarray:
    """A configuration whose apex is at one point, the cone leaning some way."""
    while True:
        axis = np.array([*rng.uniform(-0.35, 0.35, 2), 1.0])
        q = solutions(ApexPose(np.array([0.3, 0.05, 0.15]), axis / np.linalg.norm(axis)), mount)
        if len(q):
            return q[rng.integers(len(q))]


def test_postures_that_are_all_alike_are_refused() -> None:
    mount = Mount.of(HandSpec())
    q = solutions(ApexPose(np.array([0.3, 0.05, 0.15])), mount)[0]
    with pytest.raises(ValueError, match="turned by 0°"):
        calibrated(np.tile(q, (8, 1)))
    with pytest.raises(ValueError, match="6 postures"):
        calibrated(q[None])


def test_an_apex_beside_the_axis_is_put_where_it_is_wanted_by_every_way_in() -> None:
    mount = Mount.of(HandSpec(apex_aside_mm=(3.0, -2.0)))
    pose = ApexPose(np.array([0.32, -0.04, 0.16]))
    found = solutions(pose, mount)
    positions_m, axes, seams = apex_frames(found, mount)
    assert len(found) > 100
    assert np.abs(positions_m - pose.position_m).max() < 1e-9
    assert np.abs(axes - pose.axis).max() < 1e-9
    q = found[len(found) // 2]
    assert apex(q, mount).position_m == pytest.approx(positions_m[len(found) // 2], abs=1e-12)
    beside = apex(q, mount).position_m - apex(q, Mount.of(HandSpec())).position_m
    assert np.linalg.norm(beside) == pytest.approx(math.hypot(0.003, 0.002))
    again = along(
        positions_m[[len(found) // 2]], axes[:1], seams[[len(found) // 2]], np.array([swivel_of(q, mount)]), q, mount
    )
    assert again is not None
    assert np.abs(again[0] - q).max() < 1e-6
    near = finest(pose, nearest_configuration(q, apex(q, mount), mount)[0], mount)
    assert np.abs(apex(near, mount).position_m - pose.position_m).max() < 1e-9
    assert (np.abs(found) <= np.abs(LIMITS_RAD).max()).all()
