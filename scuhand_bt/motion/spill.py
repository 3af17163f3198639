"""When a carried load spills: one angle for tilt and acceleration together (docs/motion.md, "The spill angle").

To the powder the cone leans by the *spill angle* between the cone's up axis u and the apparent "up", which
acceleration turns away from the vertical:

    cos(angle) = u . w / |w|,        w = g z + p''        p'' apex acceleration, g = 9.81 m/s^2

A liquid of volume V in a cone (half-angle alpha, t = tan alpha, rim radius R) reaches the rim at the tilt theta:

    V / V_full = ((1 - t tan theta) / (1 + t tan theta))^(3/2),       V_full = pi R^3 / (3 t)
    tan theta = (1 - r) / (t (1 + r)),         r = (V / V_full)^(2/3)

A powder's surface leans up to its angle of repose before it flows, and the load up to the wall's friction angle before
it slides. The limit is theta plus the smaller of these, less a margin. Angles in degrees where the name says so,
lengths in mm.
"""

import math
from typing import TYPE_CHECKING

import numpy as np

from scuhand_bt.motion.kinematics import LINK_M, Floats, Mount

if TYPE_CHECKING:
    from scuhand_bt.motion.trajectory import JointTrajectory

GRAVITY_M_PER_S2 = 9.81
MARGIN_DEG = 5.0
"""Safety margin of a load's limit."""
GRID_S = 0.005
"""Step at which the spill angle is evaluated."""
LEAST_SHARE = 1e-3
"""Least share of the acceleration that is left by slowing; a motion slower than that is useless."""


def liquid_spill_deg(half_angle_deg: float, rim_radius_mm: float, load_mm3: float) -> float:
    """Tilt at which a liquid of this volume reaches the rim. Raises ValueError if the cone cannot hold it."""
    t = math.tan(math.radians(half_angle_deg))
    full_mm3 = math.pi * rim_radius_mm**3 / (3 * t)
    if not 0 <= load_mm3 <= full_mm3:
        raise ValueError(f"a cone of {full_mm3:.0f} mm^3 cannot carry {load_mm3:.0f} mm^3")
    r = (load_mm3 / full_mm3) ** (2 / 3)
    return math.degrees(math.atan((1 - r) / (t * (1 + r))))


def spill_limit_deg(
    half_angle_deg: float,
    rim_radius_mm: float,
    load_mm3: float,
    repose_deg: float,
    wall_friction_deg: float,
    margin_deg: float = MARGIN_DEG,
) -> float:
    """The largest spill angle that this load may have. Raises ValueError if even a level cone would not keep it."""
    liquid_deg = liquid_spill_deg(half_angle_deg, rim_radius_mm, load_mm3)
    limit_deg = liquid_deg + min(repose_deg, wall_friction_deg) - margin_deg
    if not limit_deg > 0:
        raise ValueError(f"this load spills within the margin of {margin_deg:g} deg of a level cone")
    return limit_deg


def apex_motion(q: Floats, speed: Floats, acceleration: Floats, mount: Mount) -> tuple[Floats, Floats]:
    """Cone axes and apex accelerations [m/s^2] for joint positions, speeds and accelerations (n, 7): (n, 3) each."""
    if mount.arm is not None:
        return mount.arm.apex_motion(q, speed, acceleration, mount)
    # Vectors as rows of components (3, n), which is twice as fast as columns.
    n = len(q)
    x, y, z = (np.repeat(one[:, None], n, axis=1) for one in np.eye(3))
    turning, twisting, total = np.zeros((3, n)), np.zeros((3, n)), np.zeros((3, n))
    cosines, sines, speeds, accelerations = np.cos(q.T), np.sin(q.T), speed.T, acceleration.T
    lengths_m = {1: LINK_M, 3: LINK_M, 5: mount.length_m}
    for joint in range(6):
        axis = z if joint % 2 == 0 else -y
        along = speeds[joint] * axis
        twisting = twisting + accelerations[joint] * axis + _cross(turning, along)
        turning = turning + along
        c, s = cosines[joint], sines[joint]
        x, y, z = (c * x + s * y, c * y - s * x, z) if joint % 2 == 0 else (c * x + s * z, y, c * z - s * x)
        if joint in lengths_m:
            total += lengths_m[joint] * (_cross(twisting, z) + _cross(turning, _cross(turning, z)))
    # The last joint turns the cone about its own apex, so it only moves the axis.
    (ax, ay, az), c, s = mount.axis, cosines[6], sines[6]
    axes: Floats = (c * ax - s * ay) * x + (s * ax + c * ay) * y + az * z
    return axes.T, total.T


def _cross(first: Floats, second: Floats) -> Floats:
    """Cross products of vectors (3, n)."""
    (a, b, c), (d, e, f) = first, second
    return np.stack([b * f - c * e, c * d - a * f, a * e - b * d])


def spill_angles_deg(axes: Floats, accelerations: Floats) -> Floats:
    """The spill angle at each sample: axes (n, 3) and accelerations (n, 3) [m/s^2] to (n,)."""
    angles: Floats = np.degrees(_between(axes, _apparent_up(accelerations)))
    return angles


def worst_spill_deg(axes: Floats, accelerations: Floats) -> float:
    """Upper bound of the spill angle of a densely sampled motion (m, 3), including between samples."""
    return float(worst_spills_deg(axes[None], accelerations[None])[0])


def worst_spills_deg(axes: Floats, accelerations: Floats) -> Floats:
    """The same for n motions (n, m, 3) at once: (n,).

    Between neighbouring samples both directions turn by at most their own step, so the angle exceeds the larger of the
    two ends by at most half of both steps together. A tenth is added for curvature.
    """
    up = _apparent_up(accelerations)
    angles = _between(axes, up)
    steps = _between(axes[:, 1:], axes[:, :-1]) + _between(up[:, 1:], up[:, :-1])
    worst: Floats = np.degrees((np.maximum(angles[:, 1:], angles[:, :-1]) + 0.55 * steps).max(axis=1))
    return worst


def _apparent_up(accelerations: Floats) -> Floats:
    w = accelerations + np.array([0.0, 0.0, GRAVITY_M_PER_S2])
    up: Floats = w / np.linalg.norm(w, axis=-1, keepdims=True)
    return up


def _between(first: Floats, second: Floats) -> Floats:
    # By the chord, as the arccos of a dot product loses half its digits for small angles.
    chord = np.minimum(np.linalg.norm(first - second, axis=-1), 2.0)
    angle: Floats = 2 * np.arcsin(chord / 2)
    return angle


def spill_stretch(
    motion: "JointTrajectory", mount: Mount, limit_deg: float, quicker_than_s: float = math.inf
) -> float | None:
    """How many times slower (>= 1) a motion must be to keep the limit; None if its tilt alone exceeds it.

    Also None if it would then not be quicker than `quicker_than_s`. Slowed by k, the tilt is the same and the
    acceleration 1/k^2.
    """
    return Carriage(motion, mount).stretch(limit_deg, quicker_than_s)


class Carriage:
    """What a cone undergoes on a motion, for any load in it."""

    def __init__(self, motion: "JointTrajectory", mount: Mount) -> None:
        self._duration_s = motion.duration_s
        times_s = np.linspace(0.0, motion.duration_s, int(motion.duration_s / GRID_S) + 2)
        self._axes, self._accelerations = apex_motion(*motion.states(times_s), mount)

    def stretch(self, limit_deg: float, quicker_than_s: float = math.inf) -> float | None:
        """As `spill_stretch`."""

        def keeps(share: float) -> bool:
            return worst_spill_deg(self._axes, share * self._accelerations) <= limit_deg

        if keeps(1.0):
            return 1.0
        slow, quick = 0.0, 1.0
        if not keeps(slow) or (quicker_than_s < math.inf and not keeps((self._duration_s / quicker_than_s) ** 2)):
            return None
        for _ in range(10):
            middle = (slow + quick) / 2
            if keeps(middle):
                slow = middle
            else:
                quick = middle
        # With hardly any acceleration left, nobody would wait for the motion.
        return 1 / math.sqrt(slow) if slow > LEAST_SHARE else None
