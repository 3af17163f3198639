"""The arm's closed-form inverse kinematics: all configurations that put the cone's apex somewhere.

In the symbols of `kinematics`, given apex p, axis u and the handle's yaw about u, the seam is

    s(yaw) = u cos(lean) + (x cos(yaw) + y sin(yaw)) sin(lean),       x, y orthogonal to u

and the wrist W = p + L s. Yaw and the elbow's swivel are free (`elbow_circle`). q7 follows, as it turns the cone's
axis to u. Other arms (`decomposed`) are handled by the same functions.

Lengths in metres, angles in radians, numpy only.
"""

import math
from functools import cache

import numpy as np
from numpy.typing import NDArray

from scuhand_bt.motion.elbow_circle import (
    EDGE,
    Circle,
    arcs,
    circle_of,
    circles_of,
    configurations,
    forms_of,
    four_branches,
    has_circle,
    swivel_on,
)
from scuhand_bt.motion.kinematics import (
    COUNT_RAD,
    JOINTS,
    LIMITS_RAD,
    LINK_M,
    SHOULDER_Z_M,
    ApexPose,
    Floats,
    Mount,
    apex,
    apex_positions_m,
    with_wrist_turned,
)

SWIVELS = 72
YAWS = 72


def seams_of(pose: ApexPose, mount: Mount, count: int = YAWS) -> Floats:
    """The seams that a pose allows: its own, or `count` evenly about its axis: (n, 3)."""
    if pose.seam is not None:
        return pose.seam[None, :]
    u = pose.axis
    other = np.array([1.0, 0.0, 0.0]) if abs(u[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    x = other - (other @ u) * u
    x /= math.sqrt(float(x @ x))
    yaws = np.linspace(0.0, 2 * math.pi, count, endpoint=False)[:, None]
    around = np.cos(yaws) * x + np.sin(yaws) * np.cross(u, x)
    seams: Floats = math.cos(mount.lean_rad) * u + math.sin(mount.lean_rad) * around
    return seams


def _within(q: Floats, limits: Floats) -> NDArray[np.bool_]:
    within: NDArray[np.bool_] = ((q >= limits[0] - EDGE) & (q <= limits[1] + EDGE)).all(axis=-1)
    return within


@cache
def _even_swivels() -> Floats:
    return np.linspace(0.0, 2 * math.pi, SWIVELS, endpoint=False)


def solutions(pose: ApexPose, mount: Mount, limits: Floats = LIMITS_RAD) -> Floats:
    """Configurations (n, 7) that put the apex at the pose, on a grid of the two free angles.

    With a seam: every 5 deg of swivel. With a free yaw: every 10 deg of yaw and of swivel. If these find none: every 5
    deg of yaw and the middle of each arc of swivels.
    """
    seams = seams_of(pose, mount, YAWS // 2)
    if mount.arm is not None:
        found = mount.arm.solutions(pose, seams, mount, limits)
        return found if len(found) or pose.seam is not None else _more_closely(pose, mount, limits)
    swivels = _even_swivels()[:: 1 if len(seams) == 1 else 2]
    found = _on_grid(pose, seams, swivels, mount, limits)
    if not len(found):
        circles = (circle_of(pose.position_m, pose.axis, seam, mount) for seam in seams_of(pose, mount))
        found = np.vstack([np.zeros((0, JOINTS)), *(_in_arcs(c, limits) for c in circles if not isinstance(c, str))])
        found = _turned_within(found, pose.axis, mount, limits)
    return found


def some_solutions(pose: ApexPose, mount: Mount, limits: Floats, count: int) -> Floats:
    """Configurations of a pose at `count` yaws and swivels. Others may exist even if these are none."""
    seams = seams_of(pose, mount, count)
    if mount.arm is not None:
        return mount.arm.solutions(pose, seams, mount, limits)
    return _on_grid(pose, seams, np.linspace(0.0, 2 * math.pi, count, endpoint=False), mount, limits)


def _more_closely(pose: ApexPose, mount: Mount, limits: Floats) -> Floats:
    """For an arm of another kind: at all yaws, each with the fine grid of swivels."""
    assert mount.arm is not None
    seams = seams_of(pose, mount)
    return np.vstack([mount.arm.solutions(pose, seam[None, :], mount, limits) for seam in seams])


def _on_grid(pose: ApexPose, seams: Floats, swivels: Floats, mount: Mount, limits: Floats) -> Floats:
    """Solutions at each seam (m, 3) and each swivel (k,): (n, 7)."""
    positions_m, axes = (np.broadcast_to(one, seams.shape) for one in (pose.position_m, pose.axis))
    reached = has_circle(positions_m, axes, seams, mount)
    if not reached.any():
        return np.zeros((0, JOINTS))
    circles = circles_of(positions_m[reached], axes[reached], seams[reached], mount)
    assert circles is not None
    stacked = circles.repeated(len(swivels))
    q = four_branches(stacked, np.tile(swivels, int(reached.sum()))).reshape(-1, JOINTS)
    return _turned_within(q[_within(q, limits)], pose.axis, mount, limits)


def _turned_within(q: Floats, axis: Floats, mount: Mount, limits: Floats) -> Floats:
    """Configurations with the wrist turned for the axis; only those within the limits."""
    if not len(q):
        return q
    q = with_wrist_turned(q, np.broadcast_to(axis, (len(q), 3)), mount)
    return np.clip(q[_within(q, limits)], limits[0], limits[1])


def _at_arcs(circle: Circle, limits: Floats) -> Floats:
    """The middle of each arc of swivels, in all branches: (n, 7), q7 = 0, limits ignored."""
    forms = forms_of(circle)
    begins, lengths = arcs(circle, forms, limits)
    return configurations(circle, forms, begins + lengths / 2)


def _in_arcs(circle: Circle, limits: Floats) -> Floats:
    """The same, where the first six joints keep their limits."""
    q = _at_arcs(circle, limits)
    return q[_within(q, limits)]


def neighbours(pose: ApexPose, q: Floats, mount: Mount, spread_rad: float, count: int) -> Floats:
    """Solutions (n, 7) of the same branch and yaw within `spread_rad` of swivel around the solution q."""
    seam = apex(q, mount).seam
    assert seam is not None  # every configuration has one
    circle = circle_of(pose.position_m, pose.axis, seam, mount)
    if isinstance(circle, str):
        return np.zeros((0, JOINTS))
    swivels = swivel_on(circle, q) + np.linspace(-spread_rad, spread_rad, count)
    around = configurations(circle, forms_of(circle), swivels)
    near = (np.abs(around[:, :6] - q[:6]) < 4 * spread_rad + EDGE).all(axis=1)
    return _turned_within(around[near & _within(around, LIMITS_RAD)], pose.axis, mount, LIMITS_RAD)


def finest(pose: ApexPose, q: Floats, mount: Mount, spread_rad: float = 0.05) -> Floats:
    """The neighbour of the solution q whose angles, rounded to servo counts, come closest to the pose: (7,).

    One count is 0.09 deg. Some configurations of the elbow's family lie much nearer to whole counts than others, which
    makes the commanded apex some ten times more exact at no cost.
    """
    family = neighbours(pose, q, mount, spread_rad, 400)
    if not len(family):
        return q
    rounded_m, _ = apex_positions_m(np.round(family / COUNT_RAD) * COUNT_RAD, mount)
    best: Floats = family[np.argmin(((rounded_m - pose.position_m) ** 2).sum(axis=1))]
    return best


def unreachable_reason(pose: ApexPose, mount: Mount, limits: Floats = LIMITS_RAD) -> str | None:
    """Why no configuration within the joints' limits reaches the pose; None if one does."""
    if len(solutions(pose, mount, limits)):
        return None
    seams = seams_of(pose, mount)
    if mount.arm is not None:
        return mount.arm.unreachable_reason(pose, seams, mount, limits)
    wrists_m = mount.wrists_m(pose.position_m, pose.axis, seams) - (0.0, 0.0, SHOULDER_Z_M)
    distances_m = np.linalg.norm(wrists_m, axis=1)
    off_m = np.maximum(distances_m - 2 * LINK_M, 2 * LINK_M * math.cos(LIMITS_RAD[0, 3] / 2) - distances_m)
    circles = [circle_of(pose.position_m, pose.axis, seams[k], mount) for k in np.argsort(off_m, kind="stable")]
    if isinstance(circles[0], str):
        return circles[0]
    q = np.vstack([_at_arcs(circle, limits) for circle in circles if not isinstance(circle, str)])
    q = with_wrist_turned(q, np.broadcast_to(pose.axis, (len(q), 3)), mount)
    excess = np.maximum(limits[0] - q, q - limits[1])
    nearest = int(np.argmin(excess.max(axis=1)))
    joint = int(np.argmax(excess[nearest]))
    return (
        f"no yaw of the handle and no swivel of the elbow keep all joints within their limits: joint {joint + 1} would "
        f"be at {math.degrees(q[nearest, joint]):.1f} deg, {math.degrees(excess[nearest, joint]):.1f} deg beyond"
    )


def swivel_of(q: Floats, mount: Mount) -> float:
    """The elbow's swivel angle phi of a configuration; for an arm of another kind the held joint's angle."""
    if mount.arm is not None:
        return mount.arm.swivel_of(q)
    pose = apex(q, mount)
    assert pose.seam is not None  # every configuration has one
    circle = circle_of(pose.position_m, pose.axis, pose.seam, mount)
    if isinstance(circle, str):
        raise ValueError(circle)
    return swivel_on(circle, q)


def branches_of(positions_m: Floats, axes: Floats, seams: Floats, swivels: Floats, mount: Mount) -> Floats | None:
    """All configurations of poses (three times (n, 3)) at each of m swivels: (n, m, 4, 7), limits ignored.

    None if a pose is out of reach. For an arm of another kind (n, m, 8, joints), NaN where there is none.
    """
    n, m = len(positions_m), len(swivels)
    if mount.arm is not None:
        each = [np.repeat(one, m, axis=0) for one in (positions_m, axes, seams)]
        found = mount.arm.branches(each[0], each[1], each[2], np.tile(swivels, n), mount)
        return found.reshape(n, m, *found.shape[1:])
    if (circles := circles_of(positions_m, axes, seams, mount)) is None:
        return None
    branches = four_branches(circles.repeated(m), np.tile(swivels, n)).reshape(-1, JOINTS)
    return with_wrist_turned(branches, np.repeat(axes, 4 * m, axis=0), mount).reshape(n, m, 4, JOINTS)


def nearest_configuration(q: Floats, pose: ApexPose, mount: Mount) -> Floats:
    """The configuration of a pose with a seam nearest to q (7,), with q's own swivel: (1, 7), or (0, 7) for none.

    For a pose close to q's own, no configuration on a grid of swivels is so near.
    """
    assert pose.seam is not None
    swivel = np.array([swivel_of(q, mount)])
    found = branches_of(pose.position_m[None], pose.axis[None], pose.seam[None], swivel, mount)
    if found is None:
        return np.empty((0, JOINTS))
    four = found[0, 0] if mount.arm is None else mount.arm.nearest_turns(found[0, 0], q)
    four = four[within_limits(four, mount)]
    nearest: Floats = four[np.argsort(np.abs(four - q).max(axis=1), kind="stable")[:1]]
    return nearest


def within_limits(q: Floats, mount: Mount) -> NDArray[np.bool_]:
    """Which configurations (..., 7) keep the joints' limits."""
    return _within(q, mount.limits_rad)


def swivel_grid(mount: Mount, begin: float) -> Floats:
    """Swivel angles evenly over one turn, beginning at `begin`; a single one if the arm has no free swivel."""
    if mount.arm is not None and mount.arm.held is None:
        return np.zeros(1)
    return begin + 2 * math.pi * np.arange(SWIVELS) / SWIVELS


def along(
    positions_m: Floats, axes: Floats, seams: Floats, swivels: Floats, q_start: Floats, mount: Mount
) -> Floats | None:
    """Configurations (n, 7) along a course of poses (three times (n, 3)) and swivels (n,), on q_start's branch.

    The axes may lean from the seams differently along the course, as the cone's size changes. None if a pose is out of
    reach, or a joint would leave its limits or jump.
    """
    if mount.arm is not None:
        return mount.arm.along(positions_m, axes, seams, swivels, q_start, mount)
    if (circles := circles_of(positions_m, axes, seams, mount)) is None:
        return None
    branches = four_branches(circles, swivels)
    n = len(branches)
    turned = with_wrist_turned(branches.reshape(-1, JOINTS), np.repeat(axes, 4, axis=0), mount)
    branches = turned.reshape(n, 4, JOINTS)
    q = np.empty((n, JOINTS))
    previous = q_start
    for k, four in enumerate(branches):
        jumps = np.abs(four - previous).max(axis=1)
        nearest = int(jumps.argmin())
        if jumps[nearest] > 0.1:
            return None
        q[k] = previous = four[nearest]
    return q if _within(q, LIMITS_RAD).all() else None
