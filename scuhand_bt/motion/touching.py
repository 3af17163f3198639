"""What touched points say: where a thing stands, and where in the hand the apex is. Least squares; numpy only.

A thing (`standing`): its landmarks p_k, (3,), were met at t_k by the apex. Rigid motion of the least squares
(Kabsch, Acta Cryst. A32, 922, 1976): with P, T the points less their means, U S V' = svd(P' T),

    R = V diag(1, 1, det(V U')) U',      t = mean(T) - R mean(P)

The apex (`apex_in_flange`): one fixed point g was met by it in n postures, whose flanges are at o_k with the turns R_k:

    o_k + R_k a = g        3 n equations, linear in a and g

The apex and the joints' zeros (`calibrated`): with an error d of each zero, o and R are of q_k + d, and so

    minimise  sum |o(q_k + d) + R(q_k + d) a - g|^2 / sigma_t^2  +  sum d_i^2 / sigma_d^2,     i = 2 ... 6

by Gauss and Newton's steps, from the linear solution. A turn of joint 1 moves all that is touched, and is in where
things stand then; a turn of joint 7 only turns a. (Hollerbach & Wampler, "The calibration index and taxonomy for robot
kinematic calibration methods", Int. J. Robotics Research 15, 1996: a point contact, closed-loop method.)

Lengths in mm, angles in degrees.
"""

import math
from dataclasses import dataclass

import numpy as np

from scuhand_bt.motion.kinematics import Floats, Mount, apex_frames

LEAST_SIDE_MM = 40.0
"""Points nearer to each other, or to one line, say too little about a turn."""
TOUCHED_MM, ZERO_RAD = 0.3, math.radians(0.5)
"""How well a point is touched, and a joint put on its mark, by hand (standard deviations)."""
ROUNDS = 8
LEAST_POSTURES = 6
LEAST_TURN_DEG = 20.0
"""Postures that differ less from each other do not tell an apex from the point that it touches."""


@dataclass(frozen=True, slots=True)
class Standing:
    """How a thing stands against where it was taken to: a point p of it is at turn (p - pivot) + pivot + shift."""

    shift_mm: Floats
    """Of the pivot, (3,), as if it did not lean."""
    yaw_deg: float
    tilt_deg: float
    """Of its upright; no yaw."""
    off_mm: float
    """How far the worst touched point is from where it then should be: of a rigid thing, the touching's error."""


def standing(landmarks_mm: Floats, touched_mm: Floats, pivot_mm: Floats) -> Standing:
    """From landmarks (n, 3) and where they were touched (n, 3), n >= 3; ValueError for too few, or on one line."""
    if landmarks_mm.shape != touched_mm.shape or landmarks_mm.ndim != 2 or len(landmarks_mm) < 3:
        raise ValueError("it takes three points or more, each touched once")
    middle, met = landmarks_mm.mean(axis=0), touched_mm.mean(axis=0)
    if np.linalg.svd(landmarks_mm - middle, compute_uv=False)[1] < LEAST_SIDE_MM / 2:
        raise ValueError(f"the points lie within {LEAST_SIDE_MM:g} mm of one line: they do not tell how it is turned")
    u, _, vt = np.linalg.svd((landmarks_mm - middle).T @ (touched_mm - met))
    turn = vt.T @ np.diag([1.0, 1.0, np.sign(np.linalg.det(vt.T @ u.T))]) @ u.T
    off_mm = np.linalg.norm((landmarks_mm - middle) @ turn.T + met - touched_mm, axis=1)
    yaw = math.atan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1])
    # What leans a little, or seems to, is best taken for level where it was touched: in the points' middle.
    level = np.array([[math.cos(yaw), -math.sin(yaw), 0.0], [math.sin(yaw), math.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
    return Standing(
        level @ (pivot_mm - middle) + met - pivot_mm,
        math.degrees(yaw),
        math.degrees(math.acos(min(1.0, max(-1.0, float(turn[2, 2]))))),
        float(off_mm.max()),
    )


@dataclass(frozen=True, slots=True)
class Calibrated:
    """Where the apex is in the flange, how far the joints are from what they say, and how well that is known."""

    apex_mm: Floats
    """(3,): along the flange's x, y and the j7 axis."""
    off_rad: Floats
    """(7,): a joint really is at what it says, and this; 0 for the first and the last."""
    off_mm: float
    """How far from the point the apex then was, in the worst of the postures."""


def calibrated(q: Floats) -> Calibrated:
    """From the configurations (n, 7) [rad], as said by the servos, in which the apex met one point.

    ValueError where they tell too little.
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
        raise ValueError(f"it takes {LEAST_POSTURES} postures or more")
    origins_m, _, seams = apex_frames(q, Mount(0.0, 0.0))
    # The flange's own x and y, as an axis that leans by a right angle along them has it.
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
