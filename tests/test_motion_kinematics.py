import math
import pickle
import subprocess
import sys

import numpy as np
import pytest

from scuhand_bt.device_specs.hand import HandSpec
from scuhand_bt.failures import SkillFailed
from scuhand_bt.lab import load_lab, starter_lab
from scuhand_bt.motion.collision import Arm, Scene
from scuhand_bt.motion.explain import require_reachable
from scuhand_bt.motion.inverse import finest, solutions, unreachable_reason
from scuhand_bt.motion.kinematics import (
    COUNT_RAD,
    LIMITS_RAD,
    ApexPose,
    Mount,
    apex,
    apex_frames,
    apex_positions_m,
    checked_joints,
    with_wrist_turned,
)
from scuhand_bt.motion.nearest import nearest_reachable

ARM = Arm(load_lab(starter_lab()).urdf)
ALONE = Scene(ARM, ARM.with_sheet(HandSpec(), [90.0]), [], 0.001)
"""The arm with nothing around it."""
MOUNT = Mount(0.12, math.radians(64.2), 0.3)
HEIGHTS_M = (0.041, 0.064, 0.065, 0.185, 0.121, 0.129, 0.019)


def configurations(count, seed=1):
    return np.random.default_rng(seed).uniform(LIMITS_RAD[0], LIMITS_RAD[1], (count, 7))


def turned(joint, angle):
    c, s = math.cos(angle), math.sin(angle)
    about_z = [[c, -s, 0], [s, c, 0], [0, 0, 1]]
    about_minus_y = [[c, 0, -s], [0, 1, 0], [s, 0, c]]
    return np.array(about_minus_y if joint % 2 else about_z)


def test_the_apex_is_where_the_product_of_seven_rotations_puts_it():
    for q in configurations(200):
        rotation, position_m = np.eye(3), np.zeros(3)
        for joint, height_m in enumerate(HEIGHTS_M):
            position_m = position_m + rotation[:, 2] * height_m
            rotation = rotation @ turned(joint, q[joint])
        pose = apex(q, MOUNT)
        assert np.abs(pose.position_m - position_m - MOUNT.offset_m * rotation[:, 2]).max() < 1e-12
        assert np.abs(pose.seam + rotation[:, 2]).max() < 1e-12
        # The cone lies from its seam towards the flange's x, turned by the azimuth.
        towards = rotation @ [math.cos(MOUNT.azimuth_rad), math.sin(MOUNT.azimuth_rad), 0.0]
        leaning = math.cos(MOUNT.lean_rad) * pose.seam + math.sin(MOUNT.lean_rad) * towards
        assert np.abs(pose.axis - leaning).max() < 1e-12


def test_many_apex_positions_are_the_same_as_one_by_one():
    q = configurations(50)
    positions_m, axes = apex_positions_m(q, MOUNT)
    for k, one in enumerate(q):
        assert np.abs(positions_m[k] - apex(one, MOUNT).position_m).max() < 1e-12
        assert np.abs(axes[k] - apex(one, MOUNT).axis).max() < 1e-12


@pytest.mark.parametrize("yaw_is_free", [False, True])
def test_every_pose_the_arm_can_take_is_solved_exactly_and_within_limits(yaw_is_free):
    for q in configurations(60 if yaw_is_free else 300, seed=2):
        pose = apex(q, MOUNT)
        if yaw_is_free:
            pose = ApexPose(pose.position_m, pose.axis)
        found = solutions(pose, MOUNT)
        assert len(found)
        assert unreachable_reason(pose, MOUNT) is None
        assert ((found >= LIMITS_RAD[0]) & (found <= LIMITS_RAD[1])).all()
        positions_m, axes, seams = apex_frames(found, MOUNT)
        assert np.abs(positions_m - pose.position_m).max() < 1e-9
        assert np.abs(axes - pose.axis).max() < 1e-9
        assert yaw_is_free or np.abs(seams - pose.seam).max() < 1e-9


def test_turning_the_wrist_turns_the_axis_to_where_it_is_asked():
    q = configurations(100)
    _, axes, _ = apex_frames(q, MOUNT)
    unturned = q.copy()
    unturned[:, 6] = 0.0
    assert with_wrist_turned(unturned, axes, MOUNT) == pytest.approx(q)


def test_a_cone_that_closes_turns_its_axis_towards_the_handle_and_leaves_apex_and_seam():
    hand = HandSpec()
    q = configurations(1)[0]
    wide, narrow = (apex(q, Mount.of(hand, rim_mm)) for rim_mm in (90.0, 60.0))
    assert wide.position_m == pytest.approx(narrow.position_m)
    assert wide.seam == pytest.approx(narrow.seam)
    for pose, rim_mm in ((wide, 90.0), (narrow, 60.0)):
        assert math.degrees(math.acos(pose.axis @ pose.seam)) == pytest.approx(math.degrees(math.asin(rim_mm / 100)))


def test_the_family_of_solutions_comes_near_the_configuration_it_was_made_from():
    for q in configurations(50, seed=3):
        found = solutions(apex(q, MOUNT), MOUNT)
        # Every 5 deg of swivel; a joint may turn faster than the swivel, so a quarter turn is near.
        assert np.abs(found - q).max(axis=1).min() < 0.8


@pytest.mark.parametrize(
    "q",
    [
        np.zeros(7),
        np.array([0.3, 0.0, 0.4, -1.0, 0.2, 0.5, 0.0]),
        np.array([0.3, 0.5, 0.4, -1.0, 0.2, 0.0, 0.0]),
        np.array([0.3, 0.5, 0.4, 0.0, 0.2, 0.3, 0.0]),
    ],
    ids=["straight up", "upper arm upright", "hand along the forearm", "elbow straight"],
)
def test_singular_configurations_are_solved_too(q):
    pose = apex(q, MOUNT)
    found = solutions(pose, MOUNT)
    positions_m, axes = apex_positions_m(found, MOUNT)
    assert len(found)
    assert np.abs(positions_m - pose.position_m).max() < 1e-9
    assert np.abs(axes - pose.axis).max() < 1e-9


def test_no_solution_comes_with_a_reason_and_a_solution_with_none():
    rng = np.random.default_rng(4)
    refused = 0
    for _ in range(60):
        axis = rng.normal(size=3)
        pose = ApexPose(rng.uniform([-0.3, -0.5, 0.0], [0.6, 0.5, 0.6]), axis / np.linalg.norm(axis))
        reason = unreachable_reason(pose, MOUNT)
        assert (reason is None) == (len(solutions(pose, MOUNT)) > 0)
        refused += reason is not None
    assert 10 < refused < 50


def test_a_pose_too_far_says_by_how_much_and_a_reachable_one_near_is_found():
    pose = ApexPose(np.array([0.7, 0.0, 0.1]))
    assert "farther than the stretched arm's 500 mm" in unreachable_reason(pose, MOUNT)
    near = nearest_reachable(pose, MOUNT, ALONE)
    assert unreachable_reason(near, MOUNT) is None
    assert np.linalg.norm(near.position_m - pose.position_m) < 0.3


def test_who_does_not_ask_why_a_pose_is_out_of_reach_waits_for_no_search(monkeypatch):
    """A skill that tries one way after another stood for a second before each next one."""
    searched = []
    monkeypatch.setattr("scuhand_bt.motion.explain.nearest_reachable", lambda pose, *_: searched.append(pose))
    pose = ApexPose(np.array([0.7, 0.0, 0.1]))
    with pytest.raises(SkillFailed) as failed:
        require_reachable(pose, "the pose", MOUNT, ALONE)
    assert (failed.value.code, searched) == ("arm.unreachable", [])
    assert failed.value.detail.startswith("the pose: ")
    assert str(failed.value) == f"arm.unreachable: {failed.value.detail}"
    assert str(pickle.loads(pickle.dumps(failed.value))) == str(failed.value)
    assert searched == [pose], "once"


@pytest.mark.slow
def test_no_reachable_pose_is_much_nearer_than_the_one_that_is_told():
    rng = np.random.default_rng(3)
    for position_m in ([0.9, 0.0, 0.1], [0.0, 0.0, 0.45], [0.05, 0.0, 0.5]):
        pose = ApexPose(np.array(position_m))
        told_m = np.linalg.norm(nearest_reachable(pose, MOUNT, ALONE).position_m - pose.position_m)
        around = rng.normal(size=(40, 3))
        around *= (told_m - 0.01) * rng.uniform(size=(40, 1)) ** (1 / 3) / np.linalg.norm(around, axis=1)[:, None]
        assert not any(can_stand(ApexPose(pose.position_m + off)) for off in around)


def can_stand(pose):
    """Whether some of a pose's configurations is free of the arm itself."""
    q = solutions(pose, MOUNT)
    return len(q) > 0 and not ALONE.hits(q[:: max(1, len(q) // 16)]).all()


def test_the_pose_that_is_told_for_one_within_the_arms_base_is_none_of_those():
    assert can_stand(nearest_reachable(ApexPose(np.array([0.03, 0.02, 0.1])), MOUNT, ALONE))


def test_a_pose_beyond_a_joints_limit_names_the_joint():
    reason = unreachable_reason(ApexPose(np.array([0.05, 0.0, 0.5])), MOUNT)
    assert "joint" in reason
    assert "beyond" in reason


def test_choosing_by_servo_counts_makes_the_commanded_apex_more_exact():
    errors = {"any": [], "finest": []}
    for x in np.linspace(0.2, 0.35, 8):
        pose = ApexPose(np.array([x, 0.1, 0.1]))
        q = solutions(pose, MOUNT)[10]
        for name, chosen in (("any", q), ("finest", finest(pose, q, MOUNT))):
            counted = apex(np.round(chosen / COUNT_RAD) * COUNT_RAD, MOUNT)
            errors[name].append(np.linalg.norm(counted.position_m - pose.position_m))
    assert np.mean(errors["finest"]) < np.mean(errors["any"]) / 2


@pytest.mark.parametrize("axis", [(0, 0, 2), (0, 0, math.nan), (0, 1)])
def test_an_axis_that_is_not_a_unit_vector_is_refused(axis):
    with pytest.raises(ValueError, match="unit vector"):
        ApexPose(np.zeros(3), np.array(axis, dtype=float))


def test_a_position_that_is_not_a_number_is_refused():
    with pytest.raises(ValueError, match="finite"):
        ApexPose(np.array([0.1, math.nan, 0.2]))


def test_a_joint_beyond_its_limit_is_named():
    q = np.zeros(7)
    q[3] = 0.1
    with pytest.raises(SkillFailed, match="joint 4") as failed:
        checked_joints(q)
    assert failed.value.code == "arm.joint_limit"
    with pytest.raises(ValueError, match="7 finite angles"):
        checked_joints(np.full(7, math.nan))


def test_kinematics_need_no_library_but_numpy():
    heavy = "{'pinocchio', 'coal', 'ruckig', 'scipy'}"
    code = f"import sys, scuhand_bt.motion.kinematics; print({heavy} & set(sys.modules))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "set()"
