"""A stroke of the arm and the hand's roller: one motion of eight axes under one time law.

The poses have times. They are averaged twice over `AVERAGED_S`, as in `contact`, which makes the speed continuous. At
corners the path rests for as long as the averages reach, so that every leg between two corners stays as requested. The
roller is the eighth coordinate of the same cubics: if a joint or the roller is too quick, all are slowed for that
while, and a stop applies to all.

Positions [m], angles [rad], times [s].
"""

import hashlib
import math
from dataclasses import dataclass

import numpy as np

from scuhand_bt.device_specs.hand import HandSpec
from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.motion.collision import Scene
from scuhand_bt.motion.contact import AVERAGED_S, KEPT, STEP_S
from scuhand_bt.motion.kinematics import Floats, Mount
from scuhand_bt.motion.slowing import slowed
from scuhand_bt.motion.swivels import courses
from scuhand_bt.motion.timelaw import RateLimits
from scuhand_bt.motion.trajectory import JointTrajectory

ROLLER_SPEED_RAD_PER_S = 0.9 * 46 * 2 * math.pi / 60
"""Nine tenths of the no-load speed of an XM430-W350 at 12 V (data sheet)."""
ROLLER_RAD_PER_S2, ROLLER_RAD_PER_S3 = 20.0, 400.0
"""Acceleration and jerk of the roller: our choice, as it moves little mass."""


@dataclass(frozen=True, slots=True)
class StrokePoses:
    """A stroke in the base frame, n poses: times (n,), apexes, axes and seams (n, 3), the roller's angle (n,).

    `rests` (n,) is true where it may come to rest: at its ends, and where the lip meets and leaves the wall.
    """

    times_s: Floats
    positions_m: Floats
    axes: Floats
    seams: Floats
    roller_rad: Floats
    rests: np.ndarray

    @property
    def digest(self) -> bytes:
        """A hash that identifies it."""
        parts = (self.times_s, self.positions_m, self.axes, self.seams, self.roller_rad, self.rests)
        return hashlib.blake2b(b"".join(part.tobytes() for part in parts), digest_size=16).digest()


def with_roller(rates: RateLimits, hand: HandSpec) -> RateLimits:
    """The limits of eight axes: the joints', and the roller's, whose servo is of the joints' kind."""
    speed_rad_per_s = math.radians(hand.morph_speed_mm_per_s * hand.roller_deg_per_mm)
    limits = zip(
        (rates.speed, rates.acceleration, rates.jerk),
        (min(speed_rad_per_s, ROLLER_SPEED_RAD_PER_S), ROLLER_RAD_PER_S2, ROLLER_RAD_PER_S3),
        strict=True,
    )
    return RateLimits(*(np.append(joints, roller) for joints, roller in limits))


def stroke_motion(near: Floats, poses: StrokePoses, scene: Scene, rates: RateLimits, mount: Mount) -> JointTrajectory:
    """The stroke as a proven motion (8 columns), begun and ended as near to `near` (7,) as is quickest.

    `rates` are those of eight axes, `mount` the hand's at the stroke's start. Raises SkillFailed arm.unreachable,
    arm.no_path.
    """
    times_s, positions_m, axes, seams, roller_rad = sampled(poses)
    for course in courses((positions_m, axes, seams), near, scene, rates.speed[:-1], mount):
        motion = slowed(times_s, np.column_stack([course, roller_rad]), rates)
        if scene.proves(arm_part(motion)):
            return motion
    raise SkillFailed(Code.ARM_NO_PATH, "no course of the arm along the stroke is proven free of collisions")


def arm_part(motion: JointTrajectory) -> JointTrajectory:
    """The joints' part of a motion of arm and roller."""
    return JointTrajectory(motion.knots_s, motion.coefficients[:, :, :-1], motion.spill_limit_deg)


def sampled(poses: StrokePoses) -> tuple[Floats, ...]:
    """Times (m,), positions, axes and seams (m, 3) and the roller's angles (m,), averaged."""
    from scipy.ndimage import uniform_filter1d  # slow to load

    width = round(AVERAGED_S / STEP_S) | 1
    pause_s = 2 * width * STEP_S
    waits_s = np.where(poses.rests, pause_s, 0.0)
    waits_s[[0, -1]] /= 2  # at the ends the averages reach into the motion from one side only
    begins_s = poses.times_s + np.cumsum(waits_s) - waits_s
    knots_s = np.stack([begins_s, begins_s + waits_s], axis=1).ravel()
    count = KEPT * int(np.ceil(knots_s[-1] / (KEPT * STEP_S))) + 1
    times_s: Floats = np.arange(count, dtype=float) * STEP_S
    values = np.column_stack([poses.positions_m, poses.axes, poses.seams, poses.roller_rad])
    raw: Floats = np.column_stack([np.interp(times_s, knots_s, np.repeat(column, 2)) for column in values.T])
    for _ in range(2):
        raw = uniform_filter1d(raw, width, axis=0, mode="nearest")
    times_s, raw = times_s[::KEPT], raw[::KEPT]
    axes, seams = (part / np.linalg.norm(part, axis=1)[:, None] for part in (raw[:, 3:6], raw[:, 6:9]))
    return times_s, raw[:, :3], axes, seams, raw[:, 9]
