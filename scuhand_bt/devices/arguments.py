"""What arms and hands accept: one rule and one sentence for each, whoever makes the device.

A ValueError is a mistake of whoever calls; a SkillFailed may happen to a sound skill. Nothing has moved then.
"""

import math

import numpy as np

from scuhand_bt.device_specs.hand import HandSpec
from scuhand_bt.devices.interfaces import Joints, Trajectory
from scuhand_bt.dosing.cone import Cone
from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.motion.axes import SomeAxes, at_times

START_LIMIT_RAD = math.radians(3.0)
"""How far from the arm a trajectory may begin: a servo under load stands a little off its goal."""
ROLLER_START_LIMIT_RAD = math.radians(10.0)
"""How far from the roller a course may begin: 0.3 mm of rim; it comes to rest a few degrees after the arm."""
LOOK_S = 0.02
"""Between two looks at where a trajectory would lead the joints."""
ROUNDED_MM = 0.01
HALF_COUNT_RAD = math.pi / 4096
"""Half a servo's count: what is so little beyond a limit is sent as the limit itself."""


def check_trajectory(trajectory: Trajectory, positions: Joints, limits_rad: Joints, *, is_moving: bool) -> None:
    """SkillFailed device.busy, arm.not_following (it begins elsewhere), arm.joint_limit.

    `positions` (7,) is where the arm stands, `limits_rad` (2, 7) what its joints allow.
    """
    if is_moving:
        raise SkillFailed(
            Code.DEVICE_BUSY, "the arm is still moving; a motion can begin only when the one before has ended"
        )
    off_rad = np.abs(trajectory.sample(0.0) - positions)
    if not (off_rad <= START_LIMIT_RAD).all():
        joint = int(off_rad.argmax())
        raise SkillFailed(
            Code.ARM_NOT_FOLLOWING,
            f"the trajectory begins {math.degrees(off_rad[joint]):.1f}° from where joint {joint + 1} stands",
        )
    low, high = limits_rad + np.array([[-HALF_COUNT_RAD], [HALF_COUNT_RAD]])
    looks = max(2, math.ceil(trajectory.duration_s / LOOK_S) + 1)
    joints = at_times(trajectory, np.linspace(0.0, trajectory.duration_s, looks))
    beyond = ~((joints >= low) & (joints <= high))
    if beyond.any():
        look, joint = (int(index) for index in np.argwhere(beyond)[0])
        goes_to = f"joint {joint + 1} would go to {math.degrees(joints[look, joint]):.1f}°"
        low_deg, high_deg = np.degrees(limits_rad[:, joint])
        raise SkillFailed(Code.ARM_JOINT_LIMIT, f"{goes_to}; only {low_deg:.1f}° to {high_deg:.1f}° are allowed")


def checked_dwell(dwell_s: float, longest_s: float) -> float:
    """The dwell of a pulse; ValueError unless it is from 0 to the hand's longest."""
    if not 0.0 <= dwell_s <= longest_s:
        raise ValueError(f"a dwell is 0 to {longest_s:g} s, not {dwell_s!r}; a longer one takes several pulses")
    return dwell_s


def possible_opening(opening_mm: float, spec: HandSpec) -> float:
    """The opening that the valve can have, 0 to `max_opening_mm`; ValueError for what is no number."""
    if not math.isfinite(opening_mm):
        raise ValueError(f"an opening is a number of millimetres, not {opening_mm!r}")
    return min(max(opening_mm, 0.0), spec.max_opening_mm)


def checked_vibration(level: float) -> float:
    """The level of the motor; ValueError unless it is 0 to 1."""
    if not 0.0 <= level <= 1.0:
        raise ValueError(f"vibration is 0 to 1, not {level!r}")
    return level


def checked_duration(duration_s: float | None) -> float:
    """How long a morph is to take at least, 0 for None; ValueError for what is no time."""
    if duration_s is not None and not 0.0 <= duration_s < math.inf:
        raise ValueError(f"a duration is a time of 0 s or more, not {duration_s!r}")
    return duration_s or 0.0


def check_rim(diameter_mm: float, spec: HandSpec) -> None:
    """ValueError for a cone beyond the roller's limits."""
    narrowest_mm, widest_mm = spec.rim_limits_mm
    if not narrowest_mm - ROUNDED_MM <= diameter_mm <= widest_mm + ROUNDED_MM:
        raise ValueError(f"the roller makes rims of {narrowest_mm:g} to {widest_mm:g} mm, not of {diameter_mm:g} mm")


def checked_course(course: SomeAxes, spec: HandSpec, rim_mm: float) -> tuple[float, float]:
    """The least and the greatest angle [rad] of the roller on a course, which has made a rim of `rim_mm` now.

    ValueError where the course leaves its limits; SkillFailed arm.not_following where it begins elsewhere.
    """
    looks = max(2, math.ceil(course.duration_s / LOOK_S) + 1)
    angles_rad = at_times(course, np.linspace(0.0, course.duration_s, looks))[:, 0].tolist()
    ends_rad = min(angles_rad), max(angles_rad)
    for angle_rad in ends_rad:
        check_rim(Cone.from_roller(math.degrees(angle_rad), spec).diameter_mm, spec)
    stands_rad = math.radians(Cone(rim_mm, spec.sheet_radius_mm).roller_deg(spec))
    if (off_rad := abs(angles_rad[0] - stands_rad)) > ROLLER_START_LIMIT_RAD:
        begins_mm = Cone.from_roller(math.degrees(angles_rad[0]), spec).diameter_mm
        raise SkillFailed(
            Code.ARM_NOT_FOLLOWING,
            f"the course begins {math.degrees(off_rad):.1f}° from where the roller stands: "
            f"with a rim of {begins_mm:.1f} mm, but the cone's rim is {rim_mm:.1f} mm",
        )
    return ends_rad


def require_streaming(spec: HandSpec) -> None:
    """RuntimeError for a hand that takes the step command only."""
    if not spec.streaming:
        raise RuntimeError("this hand takes the step command only: use pulse()")
