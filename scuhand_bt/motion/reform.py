"""Changes the cone's size while it stays upright: arm and roller in one motion between any upright poses.

Rim, apex and the handle's yaw about the vertical change evenly, the yaw in either direction. The handle's slope is the
cone's half-angle at every rim.

Positions [m], angles [rad], times [s].
"""

import itertools
import math
from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from scuhand_bt.device_specs.hand import HandSpec
from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.motion.collision import Scene
from scuhand_bt.motion.decomposed import DecomposedArm
from scuhand_bt.motion.kinematics import ApexPose, Floats, Mount, apex
from scuhand_bt.motion.slowing import slowed
from scuhand_bt.motion.stroke import StrokePoses, arm_part, sampled
from scuhand_bt.motion.swivels import courses
from scuhand_bt.motion.timelaw import RateLimits, TimeLaw
from scuhand_bt.motion.trajectory import JointTrajectory, begun_later, beside, later

RollerAngle: TypeAlias = Callable[[float], float]
"""The roller's angle [rad] for a rim's diameter [mm], counted from the flat sheet."""

STEPS = 40
SPEED_M_PER_S, TURN_RAD_PER_S = 0.15, 1.2
"""Speed of the apex, and angular speed of the handle."""


def reform_motion(
    begin: Floats,
    end: Floats,
    rims_mm: tuple[float, float],
    scene: Scene,
    rates: RateLimits,
    hand: HandSpec,
    roller_rad: RollerAngle,
    arm: DecomposedArm | None = None,
) -> JointTrajectory:
    """The proven motion (8 columns) between two configurations (7,) whose cones, with these rims, are upright.

    Raises SkillFailed arm.no_path.
    """
    mounts = [Mount.of(hand, rim_mm, arm) for rim_mm in rims_mm]
    first, last = apex(begin, mounts[0]), apex(end, mounts[1])
    why: SkillFailed | None = None
    for yaw_turn in _ways(_yaw(first), _yaw(last)):
        poses_of_turn = _poses(first, last, yaw_turn, rims_mm, hand, roller_rad)
        times_s, positions_m, axes, seams, rolled_rad = sampled(poses_of_turn)
        try:
            poses, speed = (positions_m, axes, seams), rates.speed[:-1]
            for course in courses(poses, begin, scene, speed, mounts[0], ends=(begin, end)):
                course[0], course[-1] = begin, end
                motion = slowed(times_s, np.column_stack([course, rolled_rad]), rates)
                if scene.proves(arm_part(motion)):
                    return motion
        except SkillFailed as error:
            why = why or error
    raise SkillFailed(Code.ARM_NO_PATH, f"the cone cannot change its size on the way: {why}")


def forming_motion(
    way: JointTrajectory,
    rims_mm: tuple[float, float],
    rates: RateLimits,
    roller_rad: RollerAngle,
    scene_of: Callable[[list[float]], Scene],
) -> JointTrajectory:
    """A way of the arm with the roller's beside it (8 columns), during which the rim changes; proven.

    `scene_of` gives the scene in which the cone has each of some rims. Raises SkillFailed arm.no_path.
    """
    law = TimeLaw(RateLimits(rates.speed[-1:], rates.acceleration[-1:], rates.jerk[-1:]))
    rolling = law.straight(np.array([[roller_rad(rim_mm)] for rim_mm in rims_mm]))
    both = beside(begun_later(way, rolling.duration_s - way.duration_s), rolling)
    leaves_s, comes_s = max(0.0, both.duration_s - way.duration_s), both.duration_s
    turned_rad = rolling.end - rolling.start
    for begin_s, end_s in itertools.pairwise((0.0, leaves_s, (leaves_s + comes_s) / 2, comes_s)):
        rolled_rad = both.at(np.linspace(begin_s, end_s, 3))[:, -1] - rolling.start
        shares = rolled_rad / turned_rad if turned_rad else np.zeros(3)  # the rim is linear in the roller's angle
        three_mm = (rims_mm[0] + shares * (rims_mm[1] - rims_mm[0])).round(1).tolist()
        if not scene_of(three_mm).curve_free(later(arm_part(both), begin_s), end_s - begin_s, both.extremes()[1][:-1]):
            raise SkillFailed(
                Code.ARM_NO_PATH, f"the cone would touch something while its rim changes to {rims_mm[1]:g} mm"
            )
    return both


def _yaw(pose: ApexPose) -> float:
    assert pose.seam is not None  # every configuration has one
    return math.atan2(pose.seam[1], pose.seam[0])


def _ways(begin_rad: float, end_rad: float) -> tuple[float, float]:
    """The two turns from one angle to another, the shorter first."""
    turn = (end_rad - begin_rad + math.pi) % (2 * math.pi) - math.pi
    return turn, turn - math.copysign(2 * math.pi, turn)


def _poses(
    first: ApexPose,
    last: ApexPose,
    yaw_turn: float,
    rims_mm: tuple[float, float],
    hand: HandSpec,
    roller_rad: RollerAngle,
) -> StrokePoses:
    share = np.linspace(0.0, 1.0, STEPS)
    rims = rims_mm[0] + (rims_mm[1] - rims_mm[0]) * share
    leans = np.arcsin(rims / (2 * hand.sheet_radius_mm))
    yaws = _yaw(first) + yaw_turn * share
    seams = np.stack([np.sin(leans) * np.cos(yaws), np.sin(leans) * np.sin(yaws), np.cos(leans)], axis=1)
    way_m = float(np.linalg.norm(last.position_m - first.position_m))
    closing_s = math.pi * abs(rims_mm[1] - rims_mm[0]) / hand.morph_speed_mm_per_s
    lasts_s = max(closing_s, way_m / SPEED_M_PER_S, abs(yaw_turn) / TURN_RAD_PER_S)
    return StrokePoses(
        lasts_s * share,
        first.position_m + share[:, None] * (last.position_m - first.position_m),
        np.tile([0.0, 0.0, 1.0], (STEPS, 1)),
        seams,
        np.array([roller_rad(rim_mm) for rim_mm in rims.tolist()]),
        np.isin(share, (0.0, 1.0)),
    )
