"""Every way of putting the cone's apex somewhere: the arm's closed-form inverse kinematics.

In the symbols of `kinematics`, given apex p, axis u and the yaw of the handle about u, the seam is

    s(yaw) = u cos(lean) + (x cos(yaw) + y sin(yaw)) sin(lean),       x, y level across u

the wrist W = p + L s and d = W - S. Yaw and swivel are free, and q7 follows: it turns the cone's axis to u. The
elbow angle follows from |d|^2 = 2 l^2 (1 + cos q4); the elbow itself is free on a circle about d, by
the swivel angle phi:

    e(phi) = (d/|d|) cos(q4/2) + (n cos phi + m sin phi) sin(|q4|/2)

The cosine or the tangent of every other joint is a ratio of expressions *linear* in e. So each joint
limit but q7's is a root of A + B cos phi + C sin phi = 0, the swivel circle falls into arcs between those
roots, and one look into each arc tells exactly whether the first six joints have any solution at a yaw. Yaws are
looked at 5 deg apart.

Closed form in the manner of Shimizu et al., "Analytical inverse kinematic computation for 7-DOF
redundant manipulators", IEEE T-RO 24(5), 2008. Lengths in metres, angles in radians, numpy only.
"""

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

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
_SINGULAR = 1e-9
_EDGE = 1e-9


@dataclass(frozen=True, slots=True)
class _Circle:
    """The elbow's circle of a pose: e(phi) = middle + across cos phi + up sin phi, with d, h and q4."""

    middle: Floats
    across: Floats
    up: Floats
    d_m: Floats
    h: Floats
    q4: float

    def directions(self, phi: Floats) -> Floats:
        """Unit vectors of the upper arm, (n, 3)."""
        return self.middle + np.cos(phi)[:, None] * self.across + np.sin(phi)[:, None] * self.up


@dataclass(frozen=True, slots=True)
class _Circles:
    """The circles of many poses, stacked: (n, 3) each, and q4 (n,)."""

    middle: Floats
    across: Floats
    up: Floats
    d_m: Floats
    h: Floats
    q4: Floats

    def repeated(self, count: int) -> "_Circles":
        """Each of them so many times, one after another."""
        every = (self.middle, self.across, self.up, self.d_m, self.h, self.q4)
        return _Circles(*(np.repeat(one, count, axis=0) for one in every))

    def __getitem__(self, k: int) -> _Circle:
        return _Circle(self.middle[k], self.across[k], self.up[k], self.d_m[k], self.h[k], float(self.q4[k]))


def seams_of(pose: ApexPose, mount: Mount, count: int = YAWS) -> Floats:
    """The seams that a pose allows: its own, or as many as asked, evenly about its axis: (n, 3)."""
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


def _circle(position_m: Floats, axis: Floats, seam: Floats, mount: Mount) -> _Circle | str:
    """The elbow's circle of an apex, an axis and a seam, or the sentence that says why it has none."""
    d = mount.wrists_m(position_m, axis, seam) - (0.0, 0.0, SHOULDER_Z_M)
    distance_m = math.sqrt(float(d @ d))
    nearest_m = 2 * LINK_M * math.cos(LIMITS_RAD[0, 3] / 2)
    if distance_m > 2 * LINK_M + _EDGE:
        return (
            f"the wrist would be {distance_m * 1e3:.0f} mm from the shoulder, {(distance_m - 2 * LINK_M) * 1e3:.0f} mm "
            f"farther than the stretched arm's {2 * LINK_M * 1e3:.0f} mm"
        )
    if distance_m < nearest_m - _EDGE:
        return (
            f"the wrist would be {distance_m * 1e3:.0f} mm from the shoulder, {(nearest_m - distance_m) * 1e3:.0f} mm "
            f"nearer than the folded elbow's {nearest_m * 1e3:.0f} mm"
        )
    half = math.acos(min(1.0, distance_m / (2 * LINK_M)))
    towards = d / distance_m
    # Any fixed normal does; the world's z, or x where the wrist is straight above the shoulder.
    other = np.array([1.0, 0.0, 0.0]) if abs(towards[2]) > 0.99 else np.array([0.0, 0.0, 1.0])
    up = other - (other @ towards) * towards
    up /= math.sqrt(float(up @ up))
    (ux, uy, uz), (tx, ty, tz) = up, towards
    across = np.array([uy * tz - uz * ty, uz * tx - ux * tz, ux * ty - uy * tx])
    # sin(q4/2) from |d| loses its last digits as the arm stretches; the elbow's own triangle does not.
    sine = math.sqrt(max(0.0, 1 - (distance_m / (2 * LINK_M)) ** 2))
    return _Circle(towards * math.cos(half), across * sine, up * sine, d, -seam, -2 * half)


def _dot(a: Floats, b: Floats) -> Floats:
    """Dot products of vectors with one vector, or with one each."""
    product: Floats = a @ b if b.ndim == 1 else (a * b).sum(axis=-1)
    return product


def _linear_forms(circle: _Circle | _Circles, e: Floats) -> Floats:
    """The eight expressions, linear in e, that carry q1, q2, q3, q5 and q6: shape (8, n).

    With s2 = sin q2, s4 = sin |q4|: s2 cos q1 and s2 sin q1, cos q2, s2 times the forearm's two
    components that give q3, s4 times the hand's two that give q5 (without the sign of q6), cos q6.
    """
    d, h = circle.d_m / LINK_M, circle.h
    along = _dot(circle.middle, d)
    f = d - e
    (dx, dy, dz), (hx, hy, hz) = d.T, h.T
    across = np.array([dy * hz - dz * hy, dz * hx - dx * hz, dx * hy - dy * hx]).T
    cos_q6 = _dot(f, h)
    return np.stack(
        [
            -e[:, 0],
            -e[:, 1],
            e[:, 2],
            d[..., 2] - e[:, 2] * along,
            e[:, 1] * d[..., 0] - e[:, 0] * d[..., 1],
            _dot(e, h) - cos_q6 * np.cos(circle.q4),
            -_dot(e, across),
            cos_q6,
        ]
    )


_THREE = np.array([0.0, math.pi / 2, math.pi])


def _forms_of(circle: _Circle) -> Floats:
    """The eight expressions as functions of the swivel angle: times (1, cos phi, sin phi), shape (8, 3)."""
    at = _linear_forms(circle, circle.directions(_THREE))
    constant = (at[:, 0] + at[:, 2]) / 2
    return np.stack([constant, (at[:, 0] - at[:, 2]) / 2, at[:, 1] - constant], axis=1)


def _configurations(circle: _Circle, forms: Floats, phi: Floats) -> Floats:
    """All four branches (signs of q2 and q6) at each swivel angle: shape (4 n, 7), limits ignored."""
    x1, y1, c2, x3, y3, x5, y5, c6 = forms @ np.array([np.ones(len(phi)), np.cos(phi), np.sin(phi)])
    q = np.zeros((2, 2, len(phi), JOINTS))
    shoulder_bent = np.hypot(x1, y1) > _SINGULAR
    elbow_bent = abs(circle.q4) > _SINGULAR
    wrist_bent = np.hypot(x5, y5) > _SINGULAR * max(abs(math.sin(circle.q4)), _SINGULAR)
    s2 = np.hypot(x1, y1)
    for i, sign in enumerate((1.0, -1.0)):
        q[i, :, :, 0] = np.where(shoulder_bent, np.arctan2(sign * y1, sign * x1), 0.0)
        q[i, :, :, 1] = sign * np.arctan2(s2, c2)
        q[i, :, :, 2] = np.where(shoulder_bent, np.arctan2(sign * y3, sign * x3), 0.0)
    q[:, :, :, 3] = circle.q4
    if not elbow_bent or not shoulder_bent.all():
        _settle_singular(q, circle, circle.directions(phi), elbow_bent)
        return q.reshape(-1, JOINTS)
    s6 = np.sqrt(np.maximum(0.0, 1 - np.minimum(1.0, c6 * c6)))
    # |sin q6| from the two components is exact where c6 is near one.
    s6 = np.where(np.abs(c6) > 0.9, np.hypot(x5, y5) / math.sin(-circle.q4), s6)
    for k, sign in enumerate((1.0, -1.0)):
        q[:, k, :, 4] = np.where(wrist_bent, np.arctan2(sign * y5, sign * x5), 0.0)
        q[:, k, :, 5] = sign * np.arctan2(s6, c6)
    return q.reshape(-1, JOINTS)


def _settle_singular(q: Floats, circle: _Circle, e: Floats, elbow_bent: bool) -> None:
    """Fill q3, q5 and q6 by turning vectors back, where the arm is straight or the upper arm upright."""
    for i in range(2):
        for n in range(q.shape[2]):
            q1, q2 = q[i, 0, n, 0], q[i, 0, n, 1]
            f = _turned_back(circle.d_m / LINK_M - e[n], q1, q2)
            q3 = math.atan2(f[1], f[0]) if elbow_bent else 0.0
            h = _turned_back(_turned_back(circle.h, q1, q2), q3, circle.q4)
            s6 = math.hypot(h[0], h[1])
            for k, sign in enumerate((1.0, -1.0)):
                q5 = math.atan2(-sign * h[1], -sign * h[0]) if s6 > _SINGULAR else 0.0
                q[i, k, n, 2], q[i, k, n, 4], q[i, k, n, 5] = q3, q5, sign * math.atan2(s6, h[2])


def _turned_back(v: Floats, about_z: float, about_minus_y: float) -> Floats:
    c, s = math.cos(about_z), math.sin(about_z)
    x, y, z = c * v[0] + s * v[1], -s * v[0] + c * v[1], v[2]
    c, s = math.cos(about_minus_y), math.sin(about_minus_y)
    return np.array([c * x + s * z, y, -s * x + c * z])


@cache
def _limit_lines(limits: bytes) -> tuple[Floats, Floats]:
    """The combinations (10, 8) of the linear forms that are a number each (10,) where a joint is at a limit."""
    bounds = np.frombuffer(limits).reshape(2, JOINTS)
    weights, shifts = np.zeros((10, 8)), np.zeros(10)
    # tan q = y/x at its limit: x sin(limit) - y cos(limit) = 0, on either of the two branches.
    for k, (joint, x, y) in enumerate(((0, 0, 1), (2, 3, 4), (4, 5, 6))):
        weights[2 * k : 2 * k + 2, x], weights[2 * k : 2 * k + 2, y] = (
            np.sin(bounds[:, joint]),
            -np.cos(bounds[:, joint]),
        )
    for k, (joint, form) in enumerate(((1, 2), (5, 7)), start=3):
        weights[2 * k : 2 * k + 2, form], shifts[2 * k : 2 * k + 2] = 1.0, np.cos(bounds[:, joint])
    return weights, shifts


def _limit_roots(forms: Floats, limits: Floats) -> Floats:
    """Every swivel angle at which some joint may reach a limit: sorted, in [0, 2 pi)."""
    weights, shifts = _limit_lines(limits.tobytes())
    a, b, c = (weights @ forms).T
    a = a - shifts
    amplitude = np.hypot(b, c)
    crosses = amplitude > np.maximum(np.abs(a), 1e-15)
    a, b, c, amplitude = a[crosses], b[crosses], c[crosses], amplitude[crosses]
    middle, half = np.arctan2(c, b), np.arccos(-a / amplitude)
    return np.sort(np.concatenate([middle - half, middle + half]) % (2 * math.pi))


def _arcs(circle: _Circle, forms: Floats, limits: Floats) -> tuple[Floats, Floats]:
    """Begins and lengths of the arcs that the limits cut the swivel circle into."""
    if abs(circle.q4) <= _SINGULAR:
        return np.zeros(1), np.zeros(1)
    roots = _limit_roots(forms, limits)
    if not len(roots):
        return np.zeros(1), np.full(1, 2 * math.pi)
    return roots, np.diff(roots, append=roots[0] + 2 * math.pi)


def _within(q: Floats, limits: Floats) -> NDArray[np.bool_]:
    within: NDArray[np.bool_] = ((q >= limits[0] - _EDGE) & (q <= limits[1] + _EDGE)).all(axis=-1)
    return within


@cache
def _even_swivels() -> Floats:
    return np.linspace(0.0, 2 * math.pi, SWIVELS, endpoint=False)


def solutions(pose: ApexPose, mount: Mount, limits: Floats = LIMITS_RAD) -> Floats:
    """Every configuration that puts the apex at the pose: shape (n, 7).

    The family has two parameters: every 5 deg of swivel for a pose with its seam, every 10 deg of yaw and of swivel
    for one whose yaw is free; where those find none, every 5 deg of yaw and the middle of each arc of swivels.
    """
    seams = seams_of(pose, mount, YAWS // 2)
    if mount.arm is not None:
        found = mount.arm.solutions(pose, seams, mount, limits)
        return found if len(found) or pose.seam is not None else _more_closely(pose, mount, limits)
    swivels = _even_swivels()[:: 1 if len(seams) == 1 else 2]
    found = _on_grid(pose, seams, swivels, mount, limits)
    if not len(found):
        circles = (_circle(pose.position_m, pose.axis, seam, mount) for seam in seams_of(pose, mount))
        found = np.vstack([np.zeros((0, JOINTS)), *(_in_arcs(c, limits) for c in circles if not isinstance(c, str))])
        found = _turned_within(found, pose.axis, mount, limits)
    return found


def _more_closely(pose: ApexPose, mount: Mount, limits: Floats) -> Floats:
    """For an arm of another kind: at all yaws, and as finely as where the yaw is not free."""
    assert mount.arm is not None
    seams = seams_of(pose, mount)
    return np.vstack([mount.arm.solutions(pose, seam[None, :], mount, limits) for seam in seams])


def _on_grid(pose: ApexPose, seams: Floats, swivels: Floats, mount: Mount, limits: Floats) -> Floats:
    """Solutions at each seam (m, 3) and each swivel (k,): (n, 7)."""
    positions_m, axes = (np.broadcast_to(one, seams.shape) for one in (pose.position_m, pose.axis))
    reached = _has_circle(positions_m, axes, seams, mount)
    if not reached.any():
        return np.zeros((0, JOINTS))
    circles = _circles(positions_m[reached], axes[reached], seams[reached], mount)
    assert circles is not None
    stacked = circles.repeated(len(swivels))
    q = _branches(stacked, np.tile(swivels, int(reached.sum()))).reshape(-1, JOINTS)
    return _turned_within(q[_within(q, limits)], pose.axis, mount, limits)


def _turned_within(q: Floats, axis: Floats, mount: Mount, limits: Floats) -> Floats:
    """Configurations with their wrist turned for the axis, those within the limits."""
    if not len(q):
        return q
    q = with_wrist_turned(q, np.broadcast_to(axis, (len(q), 3)), mount)
    return np.clip(q[_within(q, limits)], limits[0], limits[1])


def _at_arcs(circle: _Circle, limits: Floats) -> Floats:
    """The middle of each arc of swivels, in all branches: (n, 7), q7 = 0, limits ignored."""
    forms = _forms_of(circle)
    begins, lengths = _arcs(circle, forms, limits)
    return _configurations(circle, forms, begins + lengths / 2)


def _in_arcs(circle: _Circle, limits: Floats) -> Floats:
    """Of those, the ones whose first six joints keep their limits."""
    q = _at_arcs(circle, limits)
    return q[_within(q, limits)]


def neighbours(pose: ApexPose, q: Floats, mount: Mount, spread_rad: float, count: int) -> Floats:
    """Solutions of the same branch and yaw within `spread_rad` of swivel around the solution q: shape (n, 7)."""
    seam = apex(q, mount).seam
    assert seam is not None  # every configuration has one
    circle = _circle(pose.position_m, pose.axis, seam, mount)
    if isinstance(circle, str):
        return np.zeros((0, JOINTS))
    swivels = _swivel_on(circle, q) + np.linspace(-spread_rad, spread_rad, count)
    around = _configurations(circle, _forms_of(circle), swivels)
    near = (np.abs(around[:, :6] - q[:6]) < 4 * spread_rad + _EDGE).all(axis=1)
    return _turned_within(around[near & _within(around, LIMITS_RAD)], pose.axis, mount, LIMITS_RAD)


def finest(pose: ApexPose, q: Floats, mount: Mount, spread_rad: float = 0.05) -> Floats:
    """The neighbour of the solution q whose servo counts, once rounded, hit the pose best: shape (7,).

    One count is 0.09 deg; along the elbow's family some configurations lie much nearer to whole
    counts than others, which makes the commanded apex some ten times more exact at no cost.
    """
    family = neighbours(pose, q, mount, spread_rad, 400)
    if not len(family):
        return q
    rounded_m, _ = apex_positions_m(np.round(family / COUNT_RAD) * COUNT_RAD, mount)
    best: Floats = family[np.argmin(((rounded_m - pose.position_m) ** 2).sum(axis=1))]
    return best


def unreachable_reason(pose: ApexPose, mount: Mount, limits: Floats = LIMITS_RAD) -> str | None:
    """Why no configuration within the joints' limits reaches the pose, or None where one does."""
    if len(solutions(pose, mount, limits)):
        return None
    seams = seams_of(pose, mount)
    if mount.arm is not None:
        return mount.arm.unreachable_reason(pose, seams, mount, limits)
    wrists_m = mount.wrists_m(pose.position_m, pose.axis, seams) - (0.0, 0.0, SHOULDER_Z_M)
    distances_m = np.linalg.norm(wrists_m, axis=1)
    off_m = np.maximum(distances_m - 2 * LINK_M, 2 * LINK_M * math.cos(LIMITS_RAD[0, 3] / 2) - distances_m)
    circles = [_circle(pose.position_m, pose.axis, seams[k], mount) for k in np.argsort(off_m, kind="stable")]
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
    """The elbow's swivel angle phi of a configuration; the held joint's of an arm of another kind."""
    if mount.arm is not None:
        return mount.arm.swivel_of(q)
    pose = apex(q, mount)
    assert pose.seam is not None  # every configuration has one
    circle = _circle(pose.position_m, pose.axis, pose.seam, mount)
    if isinstance(circle, str):
        raise ValueError(circle)
    return _swivel_on(circle, q)


def _swivel_on(circle: _Circle, q: Floats) -> float:
    s = math.sin(q[1])
    e = np.array([-s * math.cos(q[0]), -s * math.sin(q[0]), math.cos(q[1])])
    return math.atan2(float(e @ circle.up), float(e @ circle.across))


def branches_of(positions_m: Floats, axes: Floats, seams: Floats, swivels: Floats, mount: Mount) -> Floats | None:
    """All configurations of poses (n, 3) three times, at each of m swivels: (n, m, 4, 7), limits ignored.

    None where a pose is beyond the arm. For an arm of another kind (n, m, 8, joints), not a number where there is none.
    """
    n, m = len(positions_m), len(swivels)
    if mount.arm is not None:
        each = [np.repeat(one, m, axis=0) for one in (positions_m, axes, seams)]
        found = mount.arm.branches(each[0], each[1], each[2], np.tile(swivels, n), mount)
        return found.reshape(n, m, *found.shape[1:])
    if (circles := _circles(positions_m, axes, seams, mount)) is None:
        return None
    branches = _branches(circles.repeated(m), np.tile(swivels, n)).reshape(-1, JOINTS)
    return with_wrist_turned(branches, np.repeat(axes, 4 * m, axis=0), mount).reshape(n, m, 4, JOINTS)


def nearest_configuration(q: Floats, pose: ApexPose, mount: Mount) -> Floats:
    """The configuration of a pose with a seam nearest to q (7,), with q's own swivel: (1, 7), or (0, 7) if it has none.

    For a pose that is hardly another no configuration on a grid of swivels is so near.
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
    """Swivel angles evenly over a turn from this one on; one where the arm has none to spare."""
    if mount.arm is not None and mount.arm.held is None:
        return np.zeros(1)
    return begin + 2 * math.pi * np.arange(SWIVELS) / SWIVELS


def along(
    positions_m: Floats, axes: Floats, seams: Floats, swivels: Floats, q_start: Floats, mount: Mount
) -> Floats | None:
    """Configurations (n, 7) of a course of poses (n, 3) three times and swivels (n,), on q_start's branch.

    The axes may lean from the seams as the cone's size along the course has it. None where a pose is beyond the arm,
    or a joint would leave its limits or jump.
    """
    if mount.arm is not None:
        return mount.arm.along(positions_m, axes, seams, swivels, q_start, mount)
    if (circles := _circles(positions_m, axes, seams, mount)) is None:
        return None
    branches = _branches(circles, swivels)
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


def _has_circle(positions_m: Floats, axes: Floats, seams: Floats, mount: Mount) -> NDArray[np.bool_]:
    """Which apexes and seams (n, 3) the arm is neither too short nor too folded for: (n,)."""
    d = mount.wrists_m(positions_m, axes, seams) - (0.0, 0.0, SHOULDER_Z_M)
    share = np.linalg.norm(d, axis=1) / (2 * LINK_M)
    has: NDArray[np.bool_] = (share <= 1 + _EDGE) & (share >= math.cos(LIMITS_RAD[0, 3] / 2) - _EDGE)
    return has


def _circles(positions_m: Floats, axes: Floats, seams: Floats, mount: Mount) -> _Circles | None:
    """The elbow circles of many apexes and seams (n, 3), (n, 3), stacked; None where one has none."""
    if not _has_circle(positions_m, axes, seams, mount).all():
        return None
    d = mount.wrists_m(positions_m, axes, seams) - (0.0, 0.0, SHOULDER_Z_M)
    share = np.linalg.norm(d, axis=1)[:, None] / (2 * LINK_M)
    towards = d / (2 * LINK_M * share)
    upright = np.abs(towards[:, 2:]) > 0.99
    other = np.where(upright, (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    up = other - _dot(other, towards)[:, None] * towards
    up /= np.linalg.norm(up, axis=1)[:, None]
    share = np.minimum(share, 1.0)
    sine = np.sqrt(1 - share**2)
    return _Circles(towards * share, np.cross(up, towards) * sine, up * sine, d, -seams, -2 * np.arccos(share[:, 0]))


def _branches(stacked: _Circles, swivels: Floats) -> Floats:
    """The four configurations of each circle at its own swivel angle: (n, 4, 7)."""
    phi = swivels[:, None]
    e = stacked.middle + np.cos(phi) * stacked.across + np.sin(phi) * stacked.up
    x1, y1, c2, x3, y3, x5, y5, c6 = _linear_forms(stacked, e)
    s2, s4 = np.hypot(x1, y1), -np.sin(stacked.q4)
    if min(s2.min(), s4.min(), (np.hypot(x5, y5) / np.maximum(s4, _SINGULAR)).min()) < 1e3 * _SINGULAR:
        # Where an angle is not determined, one configuration at a time settles it.
        circles = (stacked[k] for k in range(len(swivels)))
        return np.array([_configurations(c, _forms_of(c), swivels[k : k + 1]) for k, c in enumerate(circles)])
    s6 = np.hypot(x5, y5) / s4
    q = np.zeros((len(swivels), 2, 2, JOINTS))
    q[..., 3] = stacked.q4[:, None, None]
    for k, sign in enumerate((1.0, -1.0)):
        q[:, k, :, 0] = np.arctan2(sign * y1, sign * x1)[:, None]
        q[:, k, :, 1] = sign * np.arctan2(s2, c2)[:, None]
        q[:, k, :, 2] = np.arctan2(sign * y3, sign * x3)[:, None]
        q[:, :, k, 4] = np.arctan2(sign * y5, sign * x5)[:, None]
        q[:, :, k, 5] = sign * np.arctan2(s6, c6)[:, None]
    return q.reshape(-1, 4, JOINTS)
