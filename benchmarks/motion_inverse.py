"""The closed form's share of the motion benchmark: all solutions, never a wrong 'none', and whole servo counts."""

import time
from typing import Any

import numpy as np

from benchmarks.figures import spread
from scuhand_bt.device_specs.hand import HandSpec
from scuhand_bt.motion.inverse import YAWS, finest, seams_of, solutions, unreachable_reason
from scuhand_bt.motion.kinematics import COUNT_RAD, LIMITS_RAD, ApexPose, Floats, Mount, apex, apex_positions_m

SEED = 20260
MOUNT = Mount.of(HandSpec())
"""The starter lab's hand."""


def inverse_kinematics() -> dict[str, Any]:
    """500 reachable poses, 10 000 poses against a dense search, and what whole servo counts cost."""
    rng = np.random.default_rng(SEED)
    error_m, times_ms, missed, none_ms = 0.0, [], 0, []
    rounded_mm: list[float] = []
    finest_mm: list[float] = []
    found = 0
    while found < 500:
        pose = ApexPose(rng.uniform([0.15, -0.28, 0.03], [0.42, 0.28, 0.35]))
        if not any(_dense_search_reaches(ApexPose(pose.position_m, pose.axis, s)) for s in seams_of(pose, MOUNT, 12)):
            continue
        found += 1
        begin_s = time.process_time()
        q = solutions(pose, MOUNT)
        times_ms.append((time.process_time() - begin_s) * 1e3)
        missed += len(q) == 0
        if not len(q):
            continue
        positions_m, axes = apex_positions_m(q, MOUNT)
        error_m = max(
            error_m, float(np.abs(positions_m - pose.position_m).max()), float(np.abs(axes - pose.axis).max())
        )
        for store, chosen in ((rounded_mm, q[len(q) // 2]), (finest_mm, finest(pose, q[len(q) // 2], MOUNT))):
            counted = apex(np.round(chosen / COUNT_RAD) * COUNT_RAD, MOUNT).position_m
            store.append(float(np.linalg.norm(counted - pose.position_m)) * 1e3)
    wrong = 0
    for _ in range(10_000):
        axis = rng.normal(size=3)
        pose = ApexPose(rng.uniform([-0.3, -0.5, 0.0], [0.6, 0.5, 0.6]), axis / np.linalg.norm(axis))
        pose = ApexPose(pose.position_m, pose.axis, seams_of(pose, MOUNT)[rng.integers(YAWS)])
        begin_s = time.process_time()
        reason = unreachable_reason(pose, MOUNT)
        if reason is not None:
            none_ms.append((time.process_time() - begin_s) * 1e3)
            wrong += _dense_search_reaches(pose)
        else:
            wrong += len(solutions(pose, MOUNT)) == 0
    return {
        "poses": found,
        "missed": missed,
        "error": error_m,
        "ik_ms, CPU": spread(times_ms, "ms"),
        "none_ms, CPU": spread(none_ms, "ms"),
        "none, of 10000": len(none_ms),
        "wrongly none": wrong,
        "apex error rounded to counts_mm": spread(rounded_mm, "mm"),
        "apex error, finest_mm": spread(finest_mm, "mm"),
    }


def _dense_search_reaches(pose: ApexPose) -> bool:
    """Whether any of 3600 elbow positions gives joints within limits: vectors and angles only, no intervals."""
    wrist = pose.position_m + MOUNT.length_m * pose.seam - (0.0, 0.0, 0.105)
    distance_m = float(np.linalg.norm(wrist))
    if distance_m > 0.5 or distance_m < 1e-6:
        return False
    q4 = -2 * np.arccos(distance_m / 0.5)
    if q4 < LIMITS_RAD[0, 3]:
        return False
    towards = wrist / distance_m
    side = np.cross(towards, [1.0, 0.0, 0.0] if abs(towards[0]) < 0.9 else [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side)
    phi = np.linspace(0.0, 2 * np.pi, 3600, endpoint=False)[:, None]
    sine = np.sqrt(1 - (distance_m / 0.5) ** 2)
    e = towards * distance_m / 0.5 + sine * (np.cos(phi) * side + np.sin(phi) * np.cross(towards, side))
    f = wrist / 0.25 - e
    h = np.broadcast_to(-pose.seam, e.shape)
    for shoulder in (1.0, -1.0):
        q2 = shoulder * np.arccos(np.clip(e[:, 2], -1, 1))
        q1 = np.arctan2(-shoulder * e[:, 1], -shoulder * e[:, 0])
        f2 = _into_frame(f, q1, q2)
        q3 = np.arctan2(f2[:, 1], f2[:, 0])
        h4 = _into_frame(_into_frame(h, q1, q2), q3, np.full(len(q1), q4))
        for wrist_side in (1.0, -1.0):
            q6 = wrist_side * np.arccos(np.clip(h4[:, 2], -1, 1))
            q5 = np.arctan2(-wrist_side * h4[:, 1], -wrist_side * h4[:, 0])
            q = np.stack([q1, q2, q3, np.full(len(q1), q4), q5, q6, np.zeros(len(q1))], axis=1)
            u = _into_frame(_into_frame(np.broadcast_to(pose.axis, e.shape), q1, q2), q3, np.full(len(q1), q4))
            u = _into_frame(u, q5, q6)
            q[:, 6] = np.angle(np.exp(1j * (np.arctan2(u[:, 1], u[:, 0]) - MOUNT.azimuth_rad)))
            if ((q >= LIMITS_RAD[0]) & (q <= LIMITS_RAD[1])).all(axis=1).any():
                return True
    return False


def _into_frame(v: Floats, about_z: Floats, about_minus_y: Floats) -> Floats:
    c, s = np.cos(about_z), np.sin(about_z)
    x, y, z = c * v[:, 0] + s * v[:, 1], -s * v[:, 0] + c * v[:, 1], v[:, 2]
    c, s = np.cos(about_minus_y), np.sin(about_minus_y)
    return np.stack([c * x + s * z, y, c * z - s * x], axis=1)
