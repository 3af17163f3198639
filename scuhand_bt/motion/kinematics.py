"""The arm's forward kinematics: where the cone's apex is.

The CRANE-X7 is a spherical-revolute-spherical arm. The hand holds its cone as a ladle's handle holds the bowl. The
apex lies on the axis of the last joint, the handle's axis, and the slit's edge (the seam) continues the handle. The
cone's own axis leans from there by the cone's half-angle. (A measured offset of the apex, `Mount.aside_m`, is left out
here.)

    R = Rz(q1) Ry(-q2) Rz(q3) Ry(-q4) Rz(q5) Ry(-q6) Rz(q7)
    apex = S + l e + l f + L h,      e, f, h = the third columns of R up to q2, q4, q6
    seam s = -h,     up axis u = R a,     a = (sin(lean) cos(azimuth), sin(lean) sin(azimuth), -cos(lean))

    S         shoulder centre (0, 0, 0.105) m
    l         upper arm = forearm = 0.250 m
    L         wrist centre to apex: 0.019 m + `offset_m` (flange to apex)
    e, f, h   unit vectors along the upper arm, the forearm and the handle

Figures: `crane-x7_links.csv` of rt-net/rt_manipulators_cpp (Apache-2.0). Lengths in metres, angles in radians, numpy
only.
"""

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scuhand_bt.device_specs.hand import MOUNTED_DIAMETER_MM, HandSpec
from scuhand_bt.failures import Code, SkillFailed

if TYPE_CHECKING:
    from scuhand_bt.motion.decomposed import DecomposedArm

Floats: TypeAlias = NDArray[np.float64]

JOINTS = 7
SHOULDER_Z_M = 0.105
LINK_M = 0.250
WRIST_TO_FLANGE_M = 0.019
LIMITS_RAD: Floats = np.radians([[-157, -90, -157, -159, -157, -90, -167], [157, 90, 157, 0, 157, 90, 167]])
"""Lower and upper joint limits, shape (2, 7): the windows of the servos."""
COUNT_RAD = 2 * math.pi / 4096
"""One count of the servos' encoders; zero is at the middle of a count."""


@dataclass(frozen=True, slots=True)
class Mount:
    """How the hand holds a cone of one size: the apex on the j7 axis, the cone's axis leaning from it.

    `lean_rad` is the cone's half-angle. `azimuth_rad` is the direction in which the cone lies from the j7 axis,
    counted from the flange's x.
    """

    offset_m: float
    """Flange to apex."""
    lean_rad: float
    azimuth_rad: float = 0.0
    aside_m: tuple[float, float] = (0.0, 0.0)
    """Offset of the apex from the j7 axis, along x and y of the flange."""
    arm: "DecomposedArm | None" = None
    """The arm that holds the hand, if it is not the CRANE-X7."""

    @classmethod
    def of(
        cls, hand: HandSpec, diameter_mm: float = MOUNTED_DIAMETER_MM, arm: "DecomposedArm | None" = None
    ) -> "Mount":
        """This hand's mount with a rim of this diameter. Raises ValueError if the sheet cannot make it."""
        lean_rad = math.asin(diameter_mm / (2 * hand.sheet_radius_mm))
        azimuth_rad = math.radians(hand.mount.azimuth_deg)
        return cls(hand.apex_offset_mm / 1e3, lean_rad, azimuth_rad, _in_metres(hand), arm)

    @property
    def limits_rad(self) -> Floats:
        """The windows of the arm's joints, shape (2, 7)."""
        return LIMITS_RAD if self.arm is None else self.arm.limits_rad

    @property
    def length_m(self) -> float:
        """Wrist centre to apex."""
        return WRIST_TO_FLANGE_M + self.offset_m

    def wrists_m(self, positions_m: Floats, axes: Floats, seams: Floats) -> Floats:
        """The wrist's centre for an apex, a cone axis and a seam, (3,) or (n, 3) each: the same shape.

        The component b of the axis orthogonal to the seam points in the flange's azimuth, whatever the lean; h x b
        completes the frame.
        """
        wrists_m: Floats = positions_m + self.length_m * seams
        x_m, y_m = self.aside_m
        if x_m == 0.0 == y_m:
            return wrists_m
        cosine, sine = math.cos(self.azimuth_rad), math.sin(self.azimuth_rad)
        towards = axes - (axes * seams).sum(axis=-1, keepdims=True) * seams
        towards = towards / np.linalg.norm(towards, axis=-1, keepdims=True)
        wrists_m -= (x_m * cosine + y_m * sine) * towards
        wrists_m += (y_m * cosine - x_m * sine) * np.cross(seams, towards)
        return wrists_m

    @property
    def axis(self) -> Floats:
        """The cone's up axis in the flange's frame, (3,)."""
        level = math.sin(self.lean_rad)
        return np.array(
            [level * math.cos(self.azimuth_rad), level * math.sin(self.azimuth_rad), -math.cos(self.lean_rad)]
        )


@dataclass(frozen=True, slots=True)
class ApexPose:
    """Where the cone's apex is and which way the cone is up.

    `position_m` (3,) is in the base frame. `axis` (3,) is a unit vector, (0, 0, 1) for a level cone. `seam` (3,) is a
    unit vector along the slit's edge to the handle, or None if the yaw about the axis is free. Raises ValueError for
    anything not finite or not of unit length.
    """

    position_m: Floats
    axis: Floats = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    seam: Floats | None = None

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
        if self.seam is not None:
            seam = np.array(self.seam, dtype=float)
            if seam.shape != (3,) or not np.isfinite(seam).all() or abs(float(seam @ seam) - 1) > 1e-6:
                raise ValueError(f"a seam is a unit vector of three numbers, not {self.seam!r}")
            seam /= math.sqrt(float(seam @ seam))
            seam.flags.writeable = False
            object.__setattr__(self, "seam", seam)

    @property
    def digest(self) -> bytes:
        """Bytes that identify it."""
        return b"".join(part.tobytes() for part in (self.position_m, self.axis, self.seam) if part is not None)

    @property
    def tilt_deg(self) -> float:
        """Angle between the cone's axis and the vertical."""
        return math.degrees(math.acos(max(-1.0, min(1.0, float(self.axis[2])))))


def _in_metres(hand: HandSpec) -> tuple[float, float]:
    x_mm, y_mm = hand.apex_aside_mm
    return x_mm / 1e3, y_mm / 1e3


def apex(q: ArrayLike, mount: Mount) -> ApexPose:
    """The apex pose, with its seam, of a configuration q [rad] (7,). Takes a few microseconds, in plain floats."""
    if mount.arm is not None:
        return mount.arm.apex(np.asarray(q, dtype=float), mount)
    q1, q2, q3, q4, q5, q6, q7 = np.asarray(q, dtype=float).tolist()
    c1, s1, c3, s3, c5, s5 = math.cos(q1), math.sin(q1), math.cos(q3), math.sin(q3), math.cos(q5), math.sin(q5)
    c2, s2, c4, s4, c6, s6 = math.cos(q2), math.sin(q2), math.cos(q4), math.sin(q4), math.cos(q6), math.sin(q6)
    # From hand to base: h and u in the elbow's frame, then in the shoulder's, then in the base's.
    length_m, level = mount.length_m, math.sin(mount.lean_rad)
    ux, uy, uz = (
        level * math.cos(mount.azimuth_rad + q7),
        level * math.sin(mount.azimuth_rad + q7),
        -math.cos(mount.lean_rad),
    )
    ux, uz = c6 * ux - s6 * uz, s6 * ux + c6 * uz
    up = (c5 * ux - s5 * uy, s5 * ux + c5 * uy, uz)
    hx, hy, hz = -s6 * c5, -s6 * s5, c6
    fore = [(hx, hy, hz), (hx * length_m, hy * length_m, hz * length_m + LINK_M), up]
    base = []
    for (x, y, z), upper_m in zip(fore, (0.0, LINK_M, 0.0), strict=True):
        x, z = c4 * x - s4 * z, s4 * x + c4 * z + upper_m
        x, y = c3 * x - s3 * y, s3 * x + c3 * y
        x, z = c2 * x - s2 * z, s2 * x + c2 * z
        base.append((c1 * x - s1 * y, s1 * x + c1 * y, z))
    (hx, hy, hz), (px, py, pz), up = base
    if mount.aside_m != (0.0, 0.0):
        (px, py, pz) = (float(x) for x in apex_positions_m(np.asarray(q, dtype=float)[None], mount)[0][0])
        pz -= SHOULDER_Z_M
    pose = object.__new__(ApexPose)
    object.__setattr__(pose, "position_m", np.array((px, py, pz + SHOULDER_Z_M)))
    object.__setattr__(pose, "axis", np.array(up))
    object.__setattr__(pose, "seam", np.array((-hx, -hy, -hz)))
    return pose


def apex_positions_m(q: Floats, mount: Mount) -> tuple[Floats, Floats]:
    """Apex positions [m] and cone axes of many configurations: (n, 7) to (n, 3) and (n, 3)."""
    positions_m, axes, _ = apex_frames(q, mount)
    return positions_m, axes


def apex_frames(q: Floats, mount: Mount) -> tuple[Floats, Floats, Floats]:
    """Apex positions [m], cone axes and seams of many configurations: (n, 7) to three times (n, 3)."""
    if mount.arm is not None:
        return mount.arm.frames(q, mount)
    c, s = np.cos(q), np.sin(q)
    h = np.stack([-s[:, 5] * c[:, 4], -s[:, 5] * s[:, 4], c[:, 5]], axis=1)
    p = h * mount.length_m + (0.0, 0.0, LINK_M)
    if mount.aside_m != (0.0, 0.0):
        aside = np.broadcast_to(np.array([*mount.aside_m, 0.0]), h.shape)
        for joint in (6, 5, 4):
            aside = _turned(aside, c, s, joint)
        p = p + aside
    u = np.broadcast_to(mount.axis, h.shape)
    for joint in (6, 5, 4):
        u = _turned(u, c, s, joint)
    both = np.stack([h, p, u])
    both = _turned(both, c, s, 3)
    both[1, :, 2] += LINK_M
    for joint in (2, 1, 0):
        both = _turned(both, c, s, joint)
    return both[1] + (0.0, 0.0, SHOULDER_Z_M), both[2], -both[0]


def axis_heights(q: Floats, mount: Mount) -> Floats:
    """Vertical components of the cones' axes, the cosines of their tilts: (n, 7) to (n,)."""
    if mount.arm is not None:
        of_arm: Floats = mount.arm.frames(q, mount)[1][:, 2]
        return of_arm
    c, s = np.cos(q.T), np.sin(q.T)
    # The vertical in the frame of one link after another; the first joint turns about it.
    x, y, z = s[1], np.zeros(len(q)), c[1]
    for joint in range(2, 7):
        if joint % 2:
            x, z = c[joint] * x + s[joint] * z, c[joint] * z - s[joint] * x
        else:
            x, y = c[joint] * x + s[joint] * y, c[joint] * y - s[joint] * x
    ux, uy, uz = mount.axis
    heights: Floats = ux * x + uy * y + uz * z
    return heights


def with_wrist_turned(q: Floats, axes: Floats, mount: Mount) -> Floats:
    """Configurations (n, 7) with the q7 that turns the cone's axis as near to `axes` (n, 3) as possible.

    q7 is in -pi..pi, regardless of its limits.
    """
    c, s = np.cos(q), np.sin(q)
    v = axes
    for joint in range(6):
        v = _turned(v, c, -s, joint)
    turned = q.copy()
    turned[:, 6] = (np.arctan2(v[:, 1], v[:, 0]) - mount.azimuth_rad + math.pi) % (2 * math.pi) - math.pi
    return turned


def _turned(v: Floats, c: Floats, s: Floats, joint: int) -> Floats:
    """Vectors (..., n, 3) rotated by one joint: about z for even ones, about -y for odd ones."""
    cj, sj = c[:, joint], s[:, joint]
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    if joint % 2:
        return np.stack([cj * x - sj * z, y, sj * x + cj * z], axis=-1)
    return np.stack([cj * x - sj * y, sj * x + cj * y, z], axis=-1)


def checked_joints(q: ArrayLike, limits: Floats = LIMITS_RAD) -> Floats:
    """A copy of a configuration as a (7,) float array. Raises ValueError, or SkillFailed arm.joint_limit."""
    joints = np.array(q, dtype=float)
    if joints.shape != limits[0].shape or not np.isfinite(joints).all():
        raise ValueError(f"a configuration is {len(limits[0])} finite angles in radians, not {q!r}")
    excess = np.maximum(limits[0] - joints, joints - limits[1])
    joint = int(np.argmax(excess))
    if excess[joint] > COUNT_RAD:
        raise SkillFailed(
            Code.ARM_JOINT_LIMIT,
            f"joint {joint + 1} is at {math.degrees(joints[joint]):.1f} deg, outside "
            f"{math.degrees(limits[0, joint]):.0f}..{math.degrees(limits[1, joint]):.0f} deg",
        )
    # The servo itself accepts up to one encoder count beyond a limit.
    clipped: Floats = np.clip(joints, limits[0], limits[1])
    return clipped
