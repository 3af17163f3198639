"""The arm, and how it is cabled."""

import math
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from scuhand_bt.bench_spec import Point
from scuhand_bt.device_specs.servo import Direction
from scuhand_bt.drivers import driver_name
from scuhand_bt.quantity import Degrees, Ratio, Seconds, plain_name
from scuhand_bt.specs import Positive, Spec

Seven = Field(min_length=7, max_length=7)


class ArmOptions(Spec):
    """What differs from one CRANE-X7 and its cabling to the next."""

    baud: Annotated[int, Positive] = 3_000_000
    latency_s: Annotated[Seconds, Field(gt=0, le=0.1)] = 0.008
    """How long adapter and system may hold bytes back; an answer is waited for twice as long."""
    servo_ids: Annotated[tuple[Annotated[int, Field(ge=0, le=252)], ...], Seven] = (2, 3, 4, 5, 6, 7, 8)
    """Of the joints, from the base."""
    home_counts: Annotated[tuple[int, ...], Seven] = (2048,) * 7
    """Position of each servo with the arm straight up."""
    directions: Annotated[tuple[Direction, ...], Seven] = (1,) * 7
    following_limit_deg: Annotated[Degrees, Positive] = 10.0
    """A joint further than this from its goal is held up by something."""


class ArmSpec(Spec):
    """The arm as this cell uses it: the CRANE-X7, or another of six or seven joints."""

    driver: Annotated[str, driver_name("arm")] = "dynamixel"
    port: str = ""
    options: ArmOptions = ArmOptions()
    urdf: str = "crane_x7_scuhand_sv.urdf"
    kinematics: Literal["crane_x7", "decomposed"] = "crane_x7"
    """How poses become joints: by the CRANE-X7's closed form, or another arm's as EAIK finds it from its axes."""
    tool_axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    """Of another arm: along which axis of its last joint's frame the handle goes on."""
    flange_mm: Point = (0.0, 0.0, 0.0)
    """Of another arm: where in that frame the hand is screwed on."""
    relaxed_deg: tuple[Degrees, ...] = ()
    """Of another arm: its joints as it stands before a place straight ahead; unset, the middles of its windows."""
    windows_deg: dict[str, tuple[Degrees, Degrees]] = Field(default_factory=dict)
    """By the URDF's names of joints: a narrower window than it tells, from and to."""
    may_touch: tuple[tuple[str, str], ...] = ()
    """Pairs that are not looked at, as bounding shapes that meet where what they bound does not: each a link of the
    URDF, one shape of it (`upper_0`), the cone or the clamp, and another of these or an obstacle."""
    speed_ratio: Annotated[Ratio, Field(ge=0.01, le=1)] = 1.0
    torque_ratio: Annotated[Ratio, Field(ge=0.1, le=1)] = 0.8
    """Of its servos' stall torque (the URDF's `effort`), what a motion may take; one that would take more is slower."""
    gentle_deg: Annotated[Degrees, Field(gt=0, le=90)] = 90.0
    """The largest spill angle a loaded cone is carried at; its powder's own limit where that is smaller."""

    @model_validator(mode="after")
    def _describes_another_arm_only(self) -> Self:
        if self.kinematics == "crane_x7":
            given = {"tool_axis", "flange_mm", "relaxed_deg"} & self.model_fields_set
            if given:
                what = plain_name(min(given))
                raise ValueError(f"'{what}' is only for an arm with 'kinematics: decomposed', other than the CRANE-X7")
        elif math.hypot(*self.tool_axis) < 1e-6:
            raise ValueError("'tool_axis' has no direction")
        return self
