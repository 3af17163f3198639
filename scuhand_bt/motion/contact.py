"""A slow, straight-lined motion of the apex past waypoints: down to a wall, along it, up again.

    x(t) = (raw * box_T * box_T)(t),      box_T: average over T seconds

`raw` runs along the polyline of waypoints (position and axis) at constant speed; averaging it twice
over T makes speed continuous and acceleration bounded, starts and ends at rest, never exceeds the
speed, and cuts a corner by no more than speed * T / 3. The elbow's swivel phi is carried along from
the start, turned evenly by as little as the joints' limits and the cell demand, on one branch of the
closed form: so it cannot jump.

Positions [m], speeds [m/s], angles [rad], times [s].
"""

import math
from collections.abc import Sequence

import numpy as np
from scipy.ndimage import uniform_filter1d

from scuhand_bt.motion.kinematics import ApexPose, Floats

STEP_S = 0.005
KEPT = 4
AVERAGED_S = 0.08
TURN_RAD_PER_S = 0.6
"""How fast the cone's axis may tilt on the way."""
TURNS_OF_SWIVEL_RAD = (0.0, 0.15, -0.15, 0.3, -0.3, 0.5, -0.5, 0.8, -0.8, 1.2, -1.2)
"""By how much the elbow may swing over the whole path, in the order tried."""


def apex_path(waypoints: Sequence[ApexPose], speed_m_per_s: float) -> tuple[Floats, Floats, Floats]:
    """Times (n,), positions (n, 3) and axes (n, 3) of the apex through the waypoints, rest to rest.

    ValueError for a speed that is not above zero.
    """
    if not (math.isfinite(speed_m_per_s) and speed_m_per_s > 0):
        raise ValueError(f"a speed above zero is needed, not {speed_m_per_s!r} m/s")
    positions_m = np.array([pose.position_m for pose in waypoints])
    axes = np.array([pose.axis for pose in waypoints])
    turns_rad = 2 * np.arcsin(np.minimum(1.0, np.linalg.norm(np.diff(axes, axis=0), axis=1) / 2))
    legs_s = np.maximum(
        np.linalg.norm(np.diff(positions_m, axis=0), axis=1) / speed_m_per_s, turns_rad / TURN_RAD_PER_S
    )
    width = round(AVERAGED_S / STEP_S) | 1
    # Standing still for as long as the averages reach, before and after, makes both ends rest.
    corners_s = width * STEP_S + np.concatenate([[0.0], np.cumsum(legs_s)])
    count = KEPT * math.ceil((corners_s[-1] + width * STEP_S) / (KEPT * STEP_S)) + 1
    times_s = np.arange(count) * STEP_S
    leg = np.clip(np.searchsorted(corners_s, times_s, side="right") - 1, 0, len(legs_s) - 1)
    share = np.clip((times_s - corners_s[leg]) / np.maximum(legs_s[leg], 1e-12), 0.0, 1.0)[:, None]
    raw = np.hstack([positions_m[leg] * (1 - share) + positions_m[leg + 1] * share, _turned(axes, leg, share)])
    for _ in range(2):
        raw = uniform_filter1d(raw, width, axis=0, mode="nearest")
    # The averages are taken finely; cubics through every fourth of their values follow them to micrometres.
    times_s, raw = times_s[::KEPT], raw[::KEPT]
    return times_s, raw[:, :3], raw[:, 3:] / np.linalg.norm(raw[:, 3:], axis=1)[:, None]


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
    """The swivel angle along a path: from phi by `turn`, starting and ending without speed."""
    share = np.linspace(0.0, 1.0, count)
    course: Floats = phi + turn * share**3 * (10 - 15 * share + 6 * share**2)
    return course
