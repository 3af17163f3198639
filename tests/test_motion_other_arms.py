"""Arms other than the CRANE-X7: by their URDF and what the cell says of them, with the same proofs."""

import math
import re

import numpy as np
import pinocchio as pin
import pytest

from harness.example_labs import EXAMPLES, example_lab
from harness.motion_audit import Audit
from harness.motion_layouts import CONTAINER, Bench, drawn
from scuhand_bt.device_specs.arm import ArmSpec
from scuhand_bt.device_specs.hand import HandSpec
from scuhand_bt.failures import SkillFailed
from scuhand_bt.motion import ApexPose, Mount, apex, solutions, unreachable_reason
from scuhand_bt.motion.arm_model import Arm
from scuhand_bt.motion.coordinates import level_coordinates
from scuhand_bt.motion.decomposed import DecomposedArm
from scuhand_bt.motion.inverse import along, nearest_configuration, swivel_of
from scuhand_bt.motion.kinematics import Floats, apex_frames
from scuhand_bt.motion.spill import apex_motion

XARM7 = (EXAMPLES / "xarm7" / "robot" / "xarm7_scuhand_sv.urdf").read_text()
SPEC = ArmSpec(kinematics="decomposed", windows_deg={"joint5": (0.0, 360.0)})

UR5E_JOINTS = (
    ("0 0 0.1625", "0 0 0"),
    ("0 0 0", "1.570796327 0 0"),
    ("-0.425 0 0", "0 0 0"),
    ("-0.3922 0 0.1333", "0 0 0"),
    ("0 -0.0997 0", "1.570796327 0 0"),
    ("0 0.0996 0", "1.570796326589793 3.141592653589793 3.141592653589793"),
)
"""config/ur5e/default_kinematics.yaml of UniversalRobots/Universal_Robots_ROS2_Description (BSD-3-Clause)."""


def six_joints() -> str:
    """A UR5e of balls: its joints stand where a UR5e's do."""
    body = (
        '<inertial><mass value="1"/><inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial>'
        '<collision><geometry><sphere radius="0.04"/></geometry></collision>'
    )
    lines = [f'<link name="l{k}">{body}</link>' for k in range(7)]
    lines += [
        f'<joint name="j{k + 1}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/>'
        f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="0 0 1"/>'
        '<limit lower="-3.1" upper="3.1" velocity="3" effort="100" acceleration="8" jerk="80"/></joint>'
        for k, (xyz, rpy) in enumerate(UR5E_JOINTS)
    ]
    return f'<robot name="six" version="1.1">{"".join(lines)}</robot>'


ARMS = {"seven": Arm(XARM7, SPEC), "six": Arm(six_joints(), ArmSpec(kinematics="decomposed"))}


def kinematics(arm: Arm) -> tuple[DecomposedArm, Mount]:
    assert arm.decomposed is not None
    return arm.decomposed, Mount.of(HandSpec(apex_aside_mm=(2.0, -3.0)), 80.0, arm.decomposed)


def drawn_joints(arm: Arm, count: int) -> Floats:
    return np.random.default_rng(1).uniform(*arm.limits_rad, (count, arm.model.nq))


def pinocchios(arm: Arm, q: Floats, mount: Mount) -> tuple[Floats, Floats]:
    """Where Pinocchio has apex and cone axis."""
    data = arm.model.createData()
    pin.forwardKinematics(arm.model, data, q)
    flange = data.oMi[arm.model.njoints - 1]
    return flange.act(np.array([*mount.aside_m, mount.offset_m])), flange.rotation @ mount.axis


@pytest.mark.parametrize("arm", ARMS.values(), ids=ARMS)
def test_every_solution_is_the_pose_and_the_one_it_came_from_is_among_them(arm):
    _, mount = kinematics(arm)
    for q in drawn_joints(arm, 20):
        pose = apex(q, mount)
        found = np.vstack([nearest_configuration(q, pose, mount), solutions(pose, mount, arm.limits_rad)])
        assert np.abs(found[0] - q).max() < 1e-6
        for one in found[:: max(1, len(found) // 8)]:
            position_m, axis = pinocchios(arm, one, mount)
            assert np.abs(position_m - pose.position_m).max() < 1e-6
            assert np.abs(axis - pose.axis).max() < 1e-6
            assert (one >= arm.limits_rad[0]).all()
            assert (one <= arm.limits_rad[1]).all()


@pytest.mark.parametrize("arm", ARMS.values(), ids=ARMS)
def test_the_apexs_acceleration_is_that_of_its_positions(arm):
    _, mount = kinematics(arm)
    begin, speed, pull = drawn_joints(arm, 3)
    h = 1e-3
    q = begin + speed * np.array([[-h], [0.0], [h]]) + pull * np.array([[h * h], [0.0], [h * h]]) / 2
    positions_m, axes, _ = apex_frames(q, mount)
    seen, accelerations = apex_motion(q[1:2], speed[None], pull[None], mount)
    assert seen[0] == pytest.approx(axes[1])
    assert accelerations[0] == pytest.approx(np.diff(positions_m, 2, axis=0)[0] / h**2, abs=1e-3)


@pytest.mark.parametrize("arm", ARMS.values(), ids=ARMS)
def test_a_straight_line_of_the_level_coordinates_keeps_the_cone_level(arm):
    decomposed, mount = kinematics(arm)
    found = solutions(ApexPose(np.array([0.42, 0.1, 0.25])), mount, arm.limits_rad)
    start = found[np.argmax(decomposed.wrist_lean(found, mount))]
    level = level_coordinates(arm.rates, mount, start)
    c = level.of(start[None, :])
    assert level.joints(c)[0] == pytest.approx(start, abs=1e-7)
    away = c + np.linspace(0, 1, 9)[:, None] * np.append(np.full(arm.model.nq - 2, 0.05), (0.0, 0.0))
    q = level.joints(away)
    reached = q[:, -1] <= arm.limits_rad[1, -1]
    assert reached.sum() >= 5
    assert apex_frames(q[reached], mount)[1][:, 2].min() > 1 - 1e-9
    assert 0 < level.covers(found).mean() < 1, "the other half has the wrist bent the other way"


def test_a_course_keeps_its_branch_and_one_beyond_the_windows_is_none():
    arm = ARMS["seven"]
    _, mount = kinematics(arm)
    start = solutions(ApexPose(np.array([0.45, 0.0, 0.2])), mount, arm.limits_rad)[0]
    pose, steps = apex(start, mount), np.linspace(0, 1, 40)[:, None]
    assert pose.seam is not None
    fixed = [np.repeat(part[None], 40, axis=0) for part in (pose.axis, pose.seam)]
    swivels = np.full(40, swivel_of(start, mount))
    lifted = along(pose.position_m + steps * (0.0, 0.0, 0.05), *fixed, swivels, start, mount)
    assert lifted is not None
    assert np.abs(np.diff(lifted, axis=0)).max() < 0.05
    assert along(pose.position_m + steps * (2.0, 0.0, 0.0), *fixed, swivels, start, mount) is None


def test_a_course_begins_in_whatever_turn_its_joints_are_and_does_not_jump_or_leave_its_windows():
    arm = ARMS["seven"]
    decomposed, mount = kinematics(arm)
    found = solutions(ApexPose(np.array([0.45, 0.0, 0.2])), mount, arm.limits_rad)
    start, held = found[0], decomposed.held
    assert held is not None
    pose = apex(start, mount)
    assert pose.seam is not None
    still = [np.repeat(part[None], 40, axis=0) for part in (pose.position_m, pose.axis, pose.seam)]
    stays = np.full(40, start[held])
    for joint in (0, 6):
        turned = start.copy()
        turned[joint] -= math.copysign(2 * math.pi, start[joint])
        course = along(*still, stays, turned, mount)
        assert course is not None
        assert course == pytest.approx(np.repeat(turned[None], 40, axis=0), abs=1e-6)
    assert along(*still, stays + np.where(np.arange(40) < 20, 0.0, 0.5), start, mount) is None
    beyond = Arm(XARM7, ArmSpec(kinematics="decomposed", windows_deg=window_around(arm, start, held))).decomposed
    tight = Mount.of(HandSpec(apex_aside_mm=(2.0, -3.0)), 80.0, beyond)
    swung = start[held] + np.linspace(0.0, 0.2, 40)
    assert along(*still, swung, start, mount) is not None
    assert along(*still, swung, start, tight) is None


def window_around(arm, q, joint):
    """Joint 5 as it is, and one joint within 0.1 rad of a configuration."""
    name, degrees = arm.model.names[joint + 1], math.degrees(q[joint])
    return {"joint5": (0.0, 360.0), name: (degrees - 6.0, degrees + 6.0)}


def test_an_angle_is_taken_in_the_turn_nearest_to_where_the_joint_is_if_its_window_has_it():
    decomposed, _ = kinematics(ARMS["seven"])
    to, q = np.zeros(7), np.zeros((2, 7))
    to[0], q[0, 0], q[1, 0] = 6.0, -0.5, 0.5
    assert decomposed.nearest_turns(q, to)[:, 0] == pytest.approx([2 * math.pi - 0.5, 0.5])


@pytest.mark.parametrize("arm", ARMS.values(), ids=ARMS)
def test_level_coordinates_are_level_in_both_bends_of_the_wrist_and_nowhere_free_where_they_cannot_be(arm):
    decomposed, mount = kinematics(arm)
    found = solutions(ApexPose(np.array([0.42, 0.1, 0.25])), mount, arm.limits_rad)
    leans = decomposed.wrist_lean(found, mount)
    for start in (found[np.argmax(leans)], found[np.argmin(leans)]):
        level = level_coordinates(arm.rates, mount, start)
        assert level.joints(level.of(start[None, :]))[0] == pytest.approx(start, abs=1e-7)
        rng = np.random.default_rng(2)
        drawn = np.array([level.draw(rng) for _ in range(40)])
        anywhere = rng.uniform(*arm.limits_rad, drawn.shape) * ([1.0] * (arm.model.nq - 2) + [0.0, 0.0])
        for c, least in ((drawn, 0.9), (anywhere, 0.0)):
            q = level.joints(c)
            within = ((q >= arm.limits_rad[0]) & (q <= arm.limits_rad[1])).all(axis=1)
            assert least <= within.mean()
            assert apex_frames(q[within], mount)[1][:, 2] == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("arm", ARMS.values(), ids=ARMS)
def test_no_apex_is_beyond_what_the_stretched_arm_is_told_to_reach(arm):
    decomposed, mount = kinematics(arm)
    away_m = np.linalg.norm(apex_frames(drawn_joints(arm, 3000), mount)[0] - decomposed.shoulder_m, axis=1).max()
    assert away_m <= decomposed.reach_m(mount) < 1.5 * away_m


def test_why_a_pose_cannot_be_reached_is_told():
    arm = ARMS["seven"]
    _, mount = kinematics(arm)
    far = unreachable_reason(ApexPose(np.array([3.0, 0.0, 0.2])), mount, arm.limits_rad)
    assert re.search(r"no joint angles reach it; stretched, the arm reaches \d+ mm", str(far))
    narrow = arm.limits_rad.copy()
    narrow[:, 3] = -0.19, 0.0
    assert "joint 4 would be at" in str(unreachable_reason(ApexPose(np.array([0.8, 0.0, 0.2])), mount, narrow))


def test_an_arm_that_has_no_closed_form_or_another_kinds_is_refused():
    twisted = re.sub('<origin xyz=".*?" rpy=".*?"', '<origin xyz="0.03 0.05 0.1" rpy="1.2 0.3 0.1"', six_joints())
    with pytest.raises(ValueError, match="EAIK knows no closed form"):
        Arm(twisted, ArmSpec(kinematics="decomposed"))
    with pytest.raises(ValueError, match="no joint 'elbow'"):
        Arm(XARM7, ArmSpec(kinematics="decomposed", windows_deg={"elbow": (0.0, 1.0)}))
    with pytest.raises(ValueError, match="are not within its servo's"):
        Arm(XARM7)


def test_the_example_carries_a_load_proven_by_the_audit(tmp_path):
    lab = example_lab("xarm7", tmp_path)
    assert lab.problems == ()
    layout = drawn(1, Bench(lab, 1.4))
    planner = layout.planner()
    audit = Audit(lab.urdf, layout.cell, layout.mortars, CONTAINER)
    for limit_deg in (None, 10.0):
        motion = planner.move(planner.standing_at("mortar_bay"), "balance", spill_limit_deg=limit_deg)
        verdict = audit.of(motion)
        assert verdict.clearance_m > 0
        assert verdict.over_limit < 1e-3
        assert limit_deg is None or verdict.spill_deg <= limit_deg
    stop = motion.stopped_from(motion.duration_s / 4)
    assert stop.duration_s < motion.duration_s


def test_the_example_pours_a_cone_out_over_its_lip(tmp_path):
    lab = example_lab("xarm7", tmp_path)
    planner = lab.motion_planner({"mortar_bay": lab.library.mortars["agate_mortar"]})
    x, y, _ = np.array(lab.cell.stations["mortar_bay"].position_mm) / 1e3
    planner.add_place("above", ApexPose(np.array([x, y, 0.12])))
    start = planner.standing_at("above")
    out, up = np.array([x, y, 0.0]) / np.hypot(x, y), np.array([0.0, 0.0, 1.0])
    poured = [
        ApexPose(np.array([x, y, 0.17]) - 0.05 * (np.sin(tilt) * out + np.cos(tilt) * up), axis)
        for tilt in np.radians([0.0, 20.0, 40.0, 60.0, 80.0])
        for axis in (np.sin(tilt) * out + np.cos(tilt) * up,)
    ]
    motion = planner.contact(start, poured, 0.1, "mortar_bay")
    assert apex(motion.end, planner.mount()).tilt_deg == pytest.approx(80.0, abs=0.1)
    with pytest.raises(SkillFailed, match="no way through the waypoints"):
        planner.contact(start, [ApexPose(np.array([x, y, 0.0]))], 0.1)


@pytest.mark.slow
def test_a_shipped_recipe_runs_dry_on_another_arm(tmp_path, command):
    example_lab("xarm7", tmp_path)
    ended = command("run", tmp_path / "recipes" / "first_dose.yaml", "--dry-run", "--seed", 1, "--lab", tmp_path)
    assert "1 of 1 samples good" in ended.stdout
