"""The circle on which the elbow is free, and the configurations on it: closed form of the arm, numpy only.

In the symbols of `kinematics` and `inverse`, d = W - S is the vector from shoulder to wrist. The elbow angle follows
from |d|^2 = 2 l^2 (1 + cos q4). The elbow is free on a circle about d, by the swivel angle phi:

    e(phi) = (d/|d|) cos(q4/2) + (n cos phi + m sin phi) sin(|q4|/2)

The cosine or tangent of every other joint is a ratio of expressions *linear* in e. So each joint limit except q7's is
a root of A + B cos phi + C sin phi = 0. These roots divide the swivel circle into arcs, and one test in each arc
decides exactly whether the first six joints have any solution.

Closed form in the manner of Shimizu et al., "Analytical inverse kinematic computation for 7-DOF redundant
manipulators", IEEE T-RO 24(5), 2008. Lengths in metres, angles in radians.
"""

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from scuhand_bt.motion.kinematics import (
    JOINTS,
    LIMITS_RAD,
    LINK_M,
    SHOULDER_Z_M,
    Floats,
    Mount,
)

SINGULAR = 1e-9
EDGE = 1e-9
_THREE = np.array([0.0, math.pi / 2, math.pi])


@dataclass(frozen=True, slots=True)
class Circle:
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
class Circles:
    """The circles of many poses, stacked: (n, 3) each, and q4 (n,)."""

    middle: Floats
    across: Floats
    up: Floats
    d_m: Floats
    h: Floats
    q4: Floats

    def repeated(self, count: int) -> "Circles":
        """Each of them `count` times in a row."""
        every = (self.middle, self.across, self.up, self.d_m, self.h, self.q4)
        return Circles(*(np.repeat(one, count, axis=0) for one in every))

    def __getitem__(self, k: int) -> Circle:
        return Circle(self.middle[k], self.across[k], self.up[k], self.d_m[k], self.h[k], float(self.q4[k]))


def circle_of(position_m: Floats, axis: Floats, seam: Floats, mount: Mount) -> Circle | str:
    """The elbow's circle for an apex, axis and seam; or a sentence that says why there is none."""
    d = mount.wrists_m(position_m, axis, seam) - (0.0, 0.0, SHOULDER_Z_M)
    distance_m = math.sqrt(float(d @ d))
    nearest_m = 2 * LINK_M * math.cos(LIMITS_RAD[0, 3] / 2)
    if distance_m > 2 * LINK_M + EDGE:
        return (
            f"the wrist would be {distance_m * 1e3:.0f} mm from the shoulder, {(distance_m - 2 * LINK_M) * 1e3:.0f} mm "
            f"farther than the stretched arm's {2 * LINK_M * 1e3:.0f} mm"
        )
    if distance_m < nearest_m - EDGE:
        return (
            f"the wrist would be {distance_m * 1e3:.0f} mm from the shoulder, {(nearest_m - distance_m) * 1e3:.0f} mm "
            f"nearer than the folded elbow's {nearest_m * 1e3:.0f} mm"
        )
    half = math.acos(min(1.0, distance_m / (2 * LINK_M)))
    towards = d / distance_m
    # Any fixed normal will do: the world's z, or x if the wrist is straight above the shoulder.
    other = np.array([1.0, 0.0, 0.0]) if abs(towards[2]) > 0.99 else np.array([0.0, 0.0, 1.0])
    up = other - (other @ towards) * towards
    up /= math.sqrt(float(up @ up))
    (ux, uy, uz), (tx, ty, tz) = up, towards
    across = np.array([uy * tz - uz * ty, uz * tx - ux * tz, ux * ty - uy * tx])
    # By the elbow's triangle, as sin(q4/2) from the angle loses digits for a stretched arm.
    sine = math.sqrt(max(0.0, 1 - (distance_m / (2 * LINK_M)) ** 2))
    return Circle(towards * math.cos(half), across * sine, up * sine, d, -seam, -2 * half)


def has_circle(positions_m: Floats, axes: Floats, seams: Floats, mount: Mount) -> NDArray[np.bool_]:
    """Which apexes and seams (n, 3) are neither too far from nor too near to the shoulder: (n,)."""
    d = mount.wrists_m(positions_m, axes, seams) - (0.0, 0.0, SHOULDER_Z_M)
    share = np.linalg.norm(d, axis=1) / (2 * LINK_M)
    has: NDArray[np.bool_] = (share <= 1 + EDGE) & (share >= math.cos(LIMITS_RAD[0, 3] / 2) - EDGE)
    return has


def circles_of(positions_m: Floats, axes: Floats, seams: Floats, mount: Mount) -> Circles | None:
    """The elbow circles of many apexes and seams, (n, 3) each, stacked; None if one has none."""
    if not has_circle(positions_m, axes, seams, mount).all():
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
    return Circles(towards * share, np.cross(up, towards) * sine, up * sine, d, -seams, -2 * np.arccos(share[:, 0]))


def _dot(a: Floats, b: Floats) -> Floats:
    """Dot products of vectors with one vector, or pairwise."""
    product: Floats = a @ b if b.ndim == 1 else (a * b).sum(axis=-1)
    return product


def _linear_forms(circle: Circle | Circles, e: Floats) -> Floats:
    """The eight expressions, linear in e, that determine q1, q2, q3, q5 and q6: (8, n).

    With s2 = sin q2, s4 = sin |q4|: s2 cos q1 and s2 sin q1; cos q2; s2 times the forearm's two components that give
    q3; s4 times the hand's two that give q5 (without the sign of q6); cos q6.
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


def forms_of(circle: Circle) -> Floats:
    """The eight expressions as functions of the swivel angle: coefficients of (1, cos phi, sin phi), (8, 3)."""
    at = _linear_forms(circle, circle.directions(_THREE))
    constant = (at[:, 0] + at[:, 2]) / 2
    return np.stack([constant, (at[:, 0] - at[:, 2]) / 2, at[:, 1] - constant], axis=1)


def configurations(circle: Circle, forms: Floats, phi: Floats) -> Floats:
    """All four branches (signs of q2 and q6) at each swivel angle: (4 n, 7), limits ignored."""
    x1, y1, c2, x3, y3, x5, y5, c6 = forms @ np.array([np.ones(len(phi)), np.cos(phi), np.sin(phi)])
    q = np.zeros((2, 2, len(phi), JOINTS))
    shoulder_bent = np.hypot(x1, y1) > SINGULAR
    elbow_bent = abs(circle.q4) > SINGULAR
    wrist_bent = np.hypot(x5, y5) > SINGULAR * max(abs(math.sin(circle.q4)), SINGULAR)
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
    # Near c6 = 1, |sin q6| is exact only from the two components.
    s6 = np.where(np.abs(c6) > 0.9, np.hypot(x5, y5) / math.sin(-circle.q4), s6)
    for k, sign in enumerate((1.0, -1.0)):
        q[:, k, :, 4] = np.where(wrist_bent, np.arctan2(sign * y5, sign * x5), 0.0)
        q[:, k, :, 5] = sign * np.arctan2(s6, c6)
    return q.reshape(-1, JOINTS)


def _settle_singular(q: Floats, circle: Circle, e: Floats, elbow_bent: bool) -> None:
    """Fill in q3, q5 and q6 by rotating vectors back, for a straight arm or an upright upper arm."""
    for i in range(2):
        for n in range(q.shape[2]):
            q1, q2 = q[i, 0, n, 0], q[i, 0, n, 1]
            f = _turned_back(circle.d_m / LINK_M - e[n], q1, q2)
            q3 = math.atan2(f[1], f[0]) if elbow_bent else 0.0
            h = _turned_back(_turned_back(circle.h, q1, q2), q3, circle.q4)
            s6 = math.hypot(h[0], h[1])
            for k, sign in enumerate((1.0, -1.0)):
                q5 = math.atan2(-sign * h[1], -sign * h[0]) if s6 > SINGULAR else 0.0
                q[i, k, n, 2], q[i, k, n, 4], q[i, k, n, 5] = q3, q5, sign * math.atan2(s6, h[2])


def _turned_back(v: Floats, about_z: float, about_minus_y: float) -> Floats:
    c, s = math.cos(about_z), math.sin(about_z)
    x, y, z = c * v[0] + s * v[1], -s * v[0] + c * v[1], v[2]
    c, s = math.cos(about_minus_y), math.sin(about_minus_y)
    return np.array([c * x + s * z, y, -s * x + c * z])


def four_branches(stacked: Circles, swivels: Floats) -> Floats:
    """The four configurations of each circle at its own swivel angle: (n, 4, 7)."""
    phi = swivels[:, None]
    e = stacked.middle + np.cos(phi) * stacked.across + np.sin(phi) * stacked.up
    x1, y1, c2, x3, y3, x5, y5, c6 = _linear_forms(stacked, e)
    s2, s4 = np.hypot(x1, y1), -np.sin(stacked.q4)
    if min(s2.min(), s4.min(), (np.hypot(x5, y5) / np.maximum(s4, SINGULAR)).min()) < 1e3 * SINGULAR:
        # An undetermined angle needs the slower way, one configuration at a time.
        circles = (stacked[k] for k in range(len(swivels)))
        return np.array([configurations(c, forms_of(c), swivels[k : k + 1]) for k, c in enumerate(circles)])
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


def swivel_on(circle: Circle, q: Floats) -> float:
    """The swivel angle phi of a configuration whose elbow is on the circle."""
    s = math.sin(q[1])
    e = np.array([-s * math.cos(q[0]), -s * math.sin(q[0]), math.cos(q[1])])
    return math.atan2(float(e @ circle.up), float(e @ circle.across))


@cache
def _limit_lines(limits: bytes) -> tuple[Floats, Floats]:
    """Combinations (10, 8) of the linear forms, and the values (10,) that they have where a joint is at a limit."""
    bounds = np.frombuffer(limits).reshape(2, JOINTS)
    weights, shifts = np.zeros((10, 8)), np.zeros(10)
    # tan q = y/x, so at a limit x sin(limit) - y cos(limit) = 0, on both branches.
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


def arcs(circle: Circle, forms: Floats, limits: Floats) -> tuple[Floats, Floats]:
    """Begins and lengths of the arcs into which the limits divide the swivel circle."""
    if abs(circle.q4) <= SINGULAR:
        return np.zeros(1), np.zeros(1)
    roots = _limit_roots(forms, limits)
    if not len(roots):
        return np.zeros(1), np.full(1, 2 * math.pi)
    return roots, np.diff(roots, append=roots[0] + 2 * math.pi)
