"""A slow motion of the apex along straight lines through waypoints: down to a wall, along it, up again.

    x(t) = (raw * box_T * box_T)(t),      box_T: average over T seconds

`raw` follows the polyline of waypoints (position and axis) at constant speed. Averaging it twice over T makes the
speed continuous and the acceleration bounded. It starts and ends at rest, never exceeds the speed, and cuts a corner
by at most speed * T / 3. The elbow's swivel phi turns evenly from its value at the start, by as little as joint limits
and cell demand. It stays on one branch of the closed form, so it cannot jump.

Positions [m], speeds [m/s], angles [rad], times [s].
"""

import math
from collections.abc import Sequence

import numpy as np

from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.motion.collision import Scene
from scuhand_bt.motion.explain import closest_pair, require_reachable, start_in_collision
from scuhand_bt.motion.inverse import along, swivel_of
from scuhand_bt.motion.kinematics import ApexPose, Floats, Mount, apex
from scuhand_bt.motion.slowing import slowed
from scuhand_bt.motion.spill import spill_stretch
from scuhand_bt.motion.timelaw import RateLimits
from scuhand_bt.motion.trajectory import JointTrajectory, standing

STEP_S = 0.005
"""Step of the averaging [s]."""
KEPT = 4
"""One of so many averaged samples becomes a knot of the cubics."""
AVERAGED_S = 0.08
"""The averaging time T [s]."""
GLANCED_AT = 4
"""One of so many configurations of a course is checked before the proof; most courses that touch something fail
there."""
LEAST_M_PER_S = 1e-4
"""Least speed. The number of cubics grows with the duration, so slower motions would take minutes to plan."""
TURN_RAD_PER_M = 10.0
"""Largest tilt of the cone's axis per metre of the apex' way: points within 0.1 m then gain no more than its speed."""
TURNS_OF_SWIVEL_RAD = (0.0, 0.15, -0.15, 0.3, -0.3, 0.5, -0.5, 0.8, -0.8, 1.2, -1.2)
"""How much the elbow may swing over the whole path, in the order tried."""


def contact_motion(
    start: Floats,
    waypoints: Sequence[ApexPose],
    speed_m_per_s: float,
    scene: Scene,
    rates: RateLimits,
    mount: Mount,
    spill_limit_deg: float | None,
) -> JointTrajectory:
    """The apex in straight lines from `start` (7,) through the waypoints, rest to rest, proven in the scene.

    Raises SkillFailed arm.start_in_collision, arm.unreachable or arm.no_path.
    """
    times_s, positions_m, axes, seams = apex_path(with_seams(apex(start, mount), waypoints), speed_m_per_s)
    if len(times_s) < 2:
        return standing(start)
    if scene.hits(start[None, :])[0]:
        raise start_in_collision(scene, start)
    phi = swivel_of(start, mount)
    why, touching = "the elbow would have to jump", None
    for turn in TURNS_OF_SWIVEL_RAD:
        course = along(positions_m, axes, seams, swivel_course(phi, turn, len(times_s)), start, mount)
        if course is None:
            continue
        course[0] = start
        if scene.any_hit(course[::GLANCED_AT]):
            touching = course if touching is None else touching
            continue
        motion = slowed(times_s, course, rates)
        if spill_limit_deg is not None:
            factor = spill_stretch(motion, mount, spill_limit_deg)
            if factor is None:
                why = f"the cone would have to lean more than {spill_limit_deg:.1f} deg"
                continue
            motion = motion.stretched(factor).keeping(spill_limit_deg)
        if scene.proves(motion):
            return motion
        touching = scene.proving_samples(motion.at, motion.duration_s, motion.extremes()[1])[1]
    if touching is not None and (q := scene.first_hit(touching)) is not None:
        why = closest_pair(scene, q)
    for pose in waypoints:
        require_reachable(pose, "a waypoint", mount, scene)
    raise SkillFailed(Code.ARM_NO_PATH, f"no way through the waypoints: {why}")


def with_seams(start: ApexPose, waypoints: Sequence[ApexPose]) -> list[ApexPose]:
    """The start and the waypoints, each with a seam: its own, or the previous one rotated with the axis."""
    poses = [start]
    for pose in waypoints:
        before = poses[-1]
        assert before.seam is not None  # the start has one, and so all that follow
        seam = pose.seam if pose.seam is not None else _turned_along(before.seam, before.axis, pose.axis)
        poses.append(ApexPose(pose.position_m, pose.axis, seam))
    return poses


def _turned_along(v: Floats, first: Floats, second: Floats) -> Floats:
    """A vector, rotated by the shortest rotation of one unit vector to another, which must not be opposite."""
    about = np.cross(first, second)
    turned: Floats = v + np.cross(about, v) + np.cross(about, np.cross(about, v)) / (1 + float(first @ second))
    return turned


def apex_path(waypoints: Sequence[ApexPose], speed_m_per_s: float) -> tuple[Floats, Floats, Floats, Floats]:
    """Times (n,), and positions, axes and seams (n, 3) of the apex through the waypoints, rest to rest.

    Raises ValueError for a speed below `LEAST_M_PER_S`.
    """
    if not (math.isfinite(speed_m_per_s) and speed_m_per_s >= LEAST_M_PER_S):
        raise ValueError(
            f"a speed of at least {1e3 * LEAST_M_PER_S:g} mm/s is needed, not {1e3 * speed_m_per_s:g} mm/s"
        )
    positions_m = np.array([pose.position_m for pose in waypoints])
    axes = np.array([pose.axis for pose in waypoints])
    seams = np.array([pose.seam for pose in waypoints])
    turns_rad = np.maximum(_turns_rad(axes), _turns_rad(seams))
    legs_m = np.maximum(np.linalg.norm(np.diff(positions_m, axis=0), axis=1), turns_rad / TURN_RAD_PER_M)
    legs_s = legs_m / speed_m_per_s
    width = round(AVERAGED_S / STEP_S) | 1
    # Both ends are at rest because the path stands still there for as long as the averages reach.
    corners_s = width * STEP_S + np.concatenate([[0.0], np.cumsum(legs_s)])
    count = KEPT * math.ceil((corners_s[-1] + width * STEP_S) / (KEPT * STEP_S)) + 1
    times_s = np.arange(count) * STEP_S
    leg = np.clip(np.searchsorted(corners_s, times_s, side="right") - 1, 0, len(legs_s) - 1)
    share = np.clip((times_s - corners_s[leg]) / np.maximum(legs_s[leg], 1e-12), 0.0, 1.0)[:, None]
    raw = np.hstack(
        [
            positions_m[leg] * (1 - share) + positions_m[leg + 1] * share,
            _turned(axes, leg, share),
            _turned(seams, leg, share),
        ]
    )
    from scipy.ndimage import uniform_filter1d  # slow to load

    for _ in range(2):
        raw = uniform_filter1d(raw, width, axis=0, mode="nearest")
    # Cubics through every fourth value follow the averages to micrometres.
    times_s, raw = times_s[::KEPT], raw[::KEPT]
    axes, seams = (part / np.linalg.norm(part, axis=1)[:, None] for part in (raw[:, 3:6], raw[:, 6:]))
    return times_s, raw[:, :3], axes, seams


def _turns_rad(directions: Floats) -> Floats:
    """Angles between consecutive unit vectors (n, 3): (n - 1,)."""
    turns: Floats = 2 * np.arcsin(np.minimum(1.0, np.linalg.norm(np.diff(directions, axis=0), axis=1) / 2))
    return turns


def _turned(axes: Floats, leg: np.ndarray, share: Floats) -> Floats:
    """Axes along the legs, turning at constant speed (slerp)."""
    first, second = axes[leg], axes[leg + 1]
    angle = 2 * np.arcsin(np.minimum(1.0, np.linalg.norm(first - second, axis=1) / 2))[:, None]
    small = angle < 1e-9
    safe = np.where(small, 1.0, angle)
    turned: Floats = np.where(
        small, first, (np.sin((1 - share) * safe) * first + np.sin(share * safe) * second) / np.sin(safe)
    )
    return turned


def swivel_course(phi: float, turn: float, count: int) -> Floats:
    """The swivel angle along a path: from phi by `turn`, starting and ending at rest."""
    share = np.linspace(0.0, 1.0, count)
    course: Floats = phi + turn * share**3 * (10 - 15 * share + 6 * share**2)
    return course
