"""What touched points tell: where an object stands, and where in the hand the apex is. Least squares; numpy only.

An object (`standing`): the apex met its landmarks p_k (3,) at t_k. The least-squares rigid motion (Kabsch, Acta Cryst.
A32, 922, 1976) is, with P, T the points less their means and U S V' = svd(P' T),

    R = V diag(1, 1, det(V U')) U',      t = mean(T) - R mean(P)

The apex (`_apex_in_flange`): it met one fixed point g in n postures, whose flanges are at o_k with rotations R_k:

    o_k + R_k a = g        3 n equations, linear in a and g

The apex and the joints' zeros (`calibrated`): with an error d of each zero, o and R belong to q_k + d, so

    minimise  sum |o(q_k + d) + R(q_k + d) a - g|^2 / sigma_t^2  +  sum d_i^2 / sigma_d^2,     i = 2 ... 6

by Gauss-Newton steps from the linear solution. An error of joint 1 moves everything that is touched, so it shows in
where objects stand; an error of joint 7 only turns a. (Hollerbach & Wampler, "The calibration index and taxonomy for
robot kinematic calibration methods", Int. J. Robotics Research 15, 1996: a point contact, closed-loop method.)

Lengths in mm, angles in degrees.
"""

import math
from dataclasses import dataclass

import numpy as np

from scuhand_bt.motion.kinematics import Floats, Mount, apex_frames

LEAST_SIDE_MM = 40.0
"""Least spread of the points from each other, and from one line, to determine a rotation."""
TOUCHED_MM, ZERO_RAD = 0.3, math.radians(0.5)
"""Standard deviations: of touching a point, and of putting a joint on its mark by hand."""
ROUNDS = 8
LEAST_POSTURES = 6
LEAST_TURN_DEG = 20.0
"""Least difference of postures that separates the apex from the point that it touches."""


@dataclass(frozen=True, slots=True)
class Standing:
    """How an object stands relative to its assumed place: a point p of it is at turn (p - pivot) + pivot + shift."""

    shift_mm: Floats
    """Shift of the pivot (3,), as if the object did not lean."""
    yaw_deg: float
    tilt_deg: float
    """Tilt of its upright axis, without yaw."""
    off_mm: float
    """Largest distance of a touched point from where it should then be; for a rigid object, the error of touching."""


def standing(landmarks_mm: Floats, touched_mm: Floats, pivot_mm: Floats) -> Standing:
    """From landmarks (n, 3) and where they were touched (n, 3), n >= 3. ValueError if too few, or on one line."""
    if landmarks_mm.shape != touched_mm.shape or landmarks_mm.ndim != 2 or len(landmarks_mm) < 3:
        raise ValueError("three points or more are needed, each touched once")
    middle, met = landmarks_mm.mean(axis=0), touched_mm.mean(axis=0)
    if np.linalg.svd(landmarks_mm - middle, compute_uv=False)[1] < LEAST_SIDE_MM / 2:
        raise ValueError(
            f"the points lie within {LEAST_SIDE_MM:g} mm of one line, so they do not show how it is turned"
        )
    u, _, vt = np.linalg.svd((landmarks_mm - middle).T @ (touched_mm - met))
    turn = vt.T @ np.diag([1.0, 1.0, np.sign(np.linalg.det(vt.T @ u.T))]) @ u.T
    off_mm = np.linalg.norm((landmarks_mm - middle) @ turn.T + met - touched_mm, axis=1)
    yaw = math.atan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1])
    # An object that seems to lean a little is taken as level at the middle of the touched points.
    level = np.array([[math.cos(yaw), -math.sin(yaw), 0.0], [math.sin(yaw), math.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
    return Standing(
        level @ (pivot_mm - middle) + met - pivot_mm,
        math.degrees(yaw),
        math.degrees(math.acos(min(1.0, max(-1.0, float(turn[2, 2]))))),
        float(off_mm.max()),
    )


@dataclass(frozen=True, slots=True)
class Calibrated:
    """Where the apex is in the flange, the errors of the joints' zeros, and how well the touched point fits."""

    apex_mm: Floats
    """(3,): along the flange's x, y and the j7 axis."""
    off_rad: Floats
    """(7,): a joint's true angle is its reported one plus this; 0 for the first and the last."""
    off_mm: float
    """Distance of the apex from the point in the worst posture."""


def calibrated(q: Floats) -> Calibrated:
    """From the configurations (n, 7) [rad], as the servos report them, in which the apex met one point.

    Raises ValueError if they are too few or too similar.
    """
    apex_mm, point_mm = _apex_in_flange(q)

    def apart_mm(x: Floats) -> Floats:
        off_rad = np.concatenate([[0.0], x[:5], [0.0]])
        mount = Mount(x[7] / 1e3, math.pi / 2, aside_m=(x[5] / 1e3, x[6] / 1e3))
        apart: Floats = 1e3 * apex_frames(q + off_rad, mount)[0] - x[8:]
        return apart

    def weighed(x: Floats) -> Floats:
        return np.concatenate([apart_mm(x).ravel() / TOUCHED_MM, x[:5] / ZERO_RAD])

    x = np.concatenate([np.zeros(5), apex_mm, point_mm])
    steps = np.concatenate([np.full(5, 1e-5), np.full(6, 1e-2)])
    for _ in range(ROUNDS):
        here = weighed(x)
        slopes = np.array([(weighed(x + step) - here) / step.sum() for step in np.diag(steps)]).T
        x = x - np.linalg.lstsq(slopes, here, rcond=None)[0]
    off_mm = np.linalg.norm(apart_mm(x), axis=1)
    return Calibrated(x[5:8], np.concatenate([[0.0], x[:5], [0.0]]), float(off_mm.max()))


def _apex_in_flange(q: Floats) -> tuple[Floats, Floats]:
    """The apex in the flange and the point that it met, (3,) each [mm], if the joints' zeros are right."""
    if len(q) < LEAST_POSTURES:
        raise ValueError(f"{LEAST_POSTURES} postures or more are needed")
    origins_m, _, seams = apex_frames(q, Mount(0.0, 0.0))
    # The flange's x is the axis of a cone that leans by a right angle.
    x = apex_frames(q, Mount(0.0, math.pi / 2))[1]
    z = -seams
    turns = np.stack([x, np.cross(z, x), z], axis=2)
    spread_deg = max(_turn_deg(one, other) for one in turns for other in turns)
    if spread_deg < LEAST_TURN_DEG:
        raise ValueError(f"the hand was turned by {spread_deg:.0f}° only; turn it by {LEAST_TURN_DEG:g}° or more")
    equations = np.concatenate([np.concatenate([turn, -np.eye(3)], axis=1) for turn in turns])
    found, _, rank, values = np.linalg.lstsq(equations, -1e3 * origins_m.ravel(), rcond=None)
    if rank < 6 or values[-1] < 0.1:
        raise ValueError("the hand was turned about one line only; tilt it another way, too")
    return found[:3], found[3:]


def _turn_deg(one: Floats, other: Floats) -> float:
    return math.degrees(math.acos(min(1.0, max(-1.0, (float(np.trace(one.T @ other)) - 1.0) / 2.0))))
