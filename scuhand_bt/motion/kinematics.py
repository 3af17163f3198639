"""Where the cone's apex is: the arm's forward kinematics.

The CRANE-X7 is a spherical-revolute-spherical arm and the cone stands on the axis of its last joint:

    R = Rz(q1) Ry(-q2) Rz(q3) Ry(-q4) Rz(q5) Ry(-q6) Rz(q7)
    apex = S + l e + l f + L h,      e, f, h = the third columns of R up to q2, q4, q6

S   shoulder centre (0, 0, 0.105) m          l   upper arm = forearm = 0.250 m
L   wrist centre to apex: 0.019 m + `apex_offset_m` (flange to apex)
e, f, h   unit vectors along the upper arm, the forearm and the hand; the cone's up axis is u = -h

Figures: `crane-x7_links.csv` of rt-net/rt_manipulators_cpp (Apache-2.0). Lengths in metres, angles in
radians, numpy only.
"""

import math
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scuhand_bt.failures import Code, SkillFailed

Floats: TypeAlias = NDArray[np.float64]

JOINTS = 7
SHOULDER_Z_M = 0.105
LINK_M = 0.250
WRIST_TO_FLANGE_M = 0.019
LIMITS_RAD: Floats = np.radians([[-157, -90, -157, -159, -157, -90, -167], [157, 90, 157, 0, 157, 90, 167]])
"""Lower and upper joint limits, shape (2, 7): the servos' own windows."""
COUNT_RAD = 2 * math.pi / 4096
"""One count of the servos' encoders; zero is at the middle of a count."""


@dataclass(frozen=True, slots=True)
class ApexPose:
    """Where the cone's apex is and which way the cone is up; yaw about the axis is free.

    `position_m` shape (3,) in the base frame; `axis` shape (3,), a unit vector, (0, 0, 1) for a cone
    that stands level. ValueError for anything that is not finite or not a unit axis.
    """

    position_m: Floats
    axis: Floats = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))

    def __post_init__(self) -> None:
        position_m = np.array(self.position_m, dtype=float)
        axis = np.array(self.axis, dtype=float)
        if position_m.shape != (3,) or not np.isfinite(position_m).all():
            raise ValueError(f"an apex position is three finite numbers in metres, not {self.position_m!r}")
        if axis.shape != (3,) or not np.isfinite(axis).all() or abs(float(axis @ axis) - 1) > 1e-6:
            raise ValueError(f"a cone's axis is a unit vector of three numbers, not {self.axis!r}")
        axis /= math.sqrt(float(axis @ axis))
        position_m.flags.writeable = axis.flags.writeable = False
        object.__setattr__(self, "position_m", position_m)
        object.__setattr__(self, "axis", axis)

    @property
    def tilt_deg(self) -> float:
        """Angle between the cone's axis and the vertical."""
        return math.degrees(math.acos(max(-1.0, min(1.0, float(self.axis[2])))))


def apex(q: ArrayLike, apex_offset_m: float) -> ApexPose:
    """The apex pose of a configuration q [rad], shape (7,): a few microseconds of plain floats."""
    q1, q2, q3, q4, q5, q6, _ = map(float, np.asarray(q, dtype=float).tolist())
    c1, s1, c3, s3, c5, s5 = math.cos(q1), math.sin(q1), math.cos(q3), math.sin(q3), math.cos(q5), math.sin(q5)
    c2, s2, c4, s4, c6, s6 = math.cos(q2), math.sin(q2), math.cos(q4), math.sin(q4), math.cos(q6), math.sin(q6)
    # From the hand back to the base: h in the elbow's frame, then the shoulder's, then the base's.
    length_m = WRIST_TO_FLANGE_M + apex_offset_m
    fore = [(-s6 * c5, -s6 * s5, c6), (-s6 * c5 * length_m, -s6 * s5 * length_m, c6 * length_m + LINK_M)]
    base = []
    for (x, y, z), upper_m in zip(fore, (0.0, LINK_M), strict=True):
        x, z = c4 * x - s4 * z, s4 * x + c4 * z + upper_m
        x, y = c3 * x - s3 * y, s3 * x + c3 * y
        x, z = c2 * x - s2 * z, s2 * x + c2 * z
        base.append((c1 * x - s1 * y, s1 * x + c1 * y, z))
    (hx, hy, hz), (px, py, pz) = base
    pose = object.__new__(ApexPose)
    object.__setattr__(pose, "position_m", np.array((px, py, pz + SHOULDER_Z_M)))
    object.__setattr__(pose, "axis", np.array((-hx, -hy, -hz)))
    return pose


def apex_positions_m(q: Floats, apex_offset_m: float) -> tuple[Floats, Floats]:
    """Apex positions [m] and cone axes of many configurations: (n, 7) to (n, 3) and (n, 3)."""
    c, s = np.cos(q), np.sin(q)
    h = np.stack([-s[:, 5] * c[:, 4], -s[:, 5] * s[:, 4], c[:, 5]], axis=1)
    p = h * (WRIST_TO_FLANGE_M + apex_offset_m) + (0.0, 0.0, LINK_M)
    both = np.stack([h, p])
    both = _turned(both, c, s, 3)
    both[1, :, 2] += LINK_M
    for joint in (2, 1, 0):
        both = _turned(both, c, s, joint)
    return both[1] + (0.0, 0.0, SHOULDER_Z_M), -both[0]


def _turned(v: Floats, c: Floats, s: Floats, joint: int) -> Floats:
    """Vectors (..., n, 3) turned by one joint: about z for the even ones, about -y for the odd."""
    cj, sj = c[:, joint], s[:, joint]
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    if joint % 2:
        return np.stack([cj * x - sj * z, y, sj * x + cj * z], axis=-1)
    return np.stack([cj * x - sj * y, sj * x + cj * y, z], axis=-1)


def checked_joints(q: ArrayLike, limits: Floats = LIMITS_RAD) -> Floats:
    """A configuration as a fresh (7,) float array; ValueError or SkillFailed arm.joint_limit if it is none."""
    joints = np.array(q, dtype=float)
    if joints.shape != (JOINTS,) or not np.isfinite(joints).all():
        raise ValueError(f"a configuration is seven finite angles in radians, not {q!r}")
    excess = np.maximum(limits[0] - joints, joints - limits[1])
    joint = int(np.argmax(excess))
    if excess[joint] > COUNT_RAD:
        raise SkillFailed(
            Code.ARM_JOINT_LIMIT,
            f"joint {joint + 1} is at {math.degrees(joints[joint]):.1f} deg, outside "
            f"{math.degrees(limits[0, joint]):.0f}..{math.degrees(limits[1, joint]):.0f} deg",
        )
    # Within one encoder count of a limit the servo itself calls it inside.
    clipped: Floats = np.clip(joints, limits[0], limits[1])
    return clipped
