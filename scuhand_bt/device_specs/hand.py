"""The hand: its sheet, its roller and its valve."""

from itertools import pairwise
from typing import Annotated, Self

from pydantic import Field, model_validator

from scuhand_bt.device_specs.servo import Direction
from scuhand_bt.drivers import driver_name
from scuhand_bt.quantity import Degrees, Milligrams, Millimetres, MillimetresPerSecond, Ratio, Seconds
from scuhand_bt.specs import NotNegative, Positive, Spec


class ValveErrorSpec(Spec):
    """How far the simulated valve is from what it is told; no controller reads it."""

    opening_mm: Annotated[Millimetres, NotNegative] = 0.03
    """Standard deviation of the real opening, drawn at each opening."""
    sample_mm: Annotated[Millimetres, NotNegative] = 0.02
    """Standard deviation that stays for a whole sample: how the sheet was last bent."""
    stick_probability: Annotated[Ratio, Field(ge=0, le=1)] = 0.012
    """How often the sheet sticks and slips as it opens."""
    stick_mm: Annotated[Millimetres, NotNegative] = 0.3
    """How much wider it then opens."""


MOUNTED_DIAMETER_MM = 90.0
"""Rim of the cone that a mounted sheet begins as, and that loads are carried in (paper, section V: 36° of overlap)."""


NARROWEST_SHARE, WIDEST_SHARE = 0.3, 0.95
"""Of the flat sheet's diameter: between these rims the roller turns."""


class ValvePoint(Spec):
    """Where the valve's servo stands for an opening."""

    count: Annotated[int, Field(ge=0, le=4095)]
    opening_mm: Annotated[Millimetres, Field(ge=0, le=20)]


class HandOptions(Spec):
    """The roller's servo on the arm's bus, the valve's servo, and the sheet as it is mounted."""

    roller_id: Annotated[int, Field(ge=0, le=252)] = 9
    roller_port: str = ""
    """Where the roller's servo is not on the arm's bus, as beside an arm with a driver of its own."""
    roller_direction: Direction = 1
    start_diameter_mm: Annotated[Millimetres, Positive] = MOUNTED_DIAMETER_MM
    """Of the cone of a sheet that has just been mounted (paper, section V)."""
    valve_map: Annotated[tuple[ValvePoint, ...], Field(min_length=2, max_length=8)] = (
        ValvePoint(count=2048, opening_mm=0.0),
        ValvePoint(count=2308, opening_mm=2.4),
    )
    """The outlet's opening by the position of the valve's servo, from shut to widest, straight in between; calibrated
    (default: the rack's own travel, 0.105 mm a degree, as if the outlet opened by what the rack moves)."""

    @model_validator(mode="after")
    def _valve_map_is_one(self) -> Self:
        openings = [point.opening_mm for point in self.valve_map]
        counts = [point.count for point in self.valve_map]
        if openings[0] != 0.0 or any(b <= a for a, b in pairwise(openings)):
            raise ValueError("its 'valve_map' must begin at an opening of 0 mm, and rise")
        if any((b - a) * (counts[1] - counts[0]) <= 0 for a, b in pairwise(counts)):
            raise ValueError("the counts of its 'valve_map' must all rise or all fall")
        return self


class MountSpec(Spec):
    """How the handle holds the sheet: on the seam's side, as a ladle's.

    Read off the published pictures of the hand, not off drawings: measure yours.
    """

    azimuth_deg: Annotated[Degrees, Field(ge=-180, le=180)] = 180.0
    """Which way the cone lies from the j7 axis, about it, from the flange's x. So it lies above a handle that reaches
    forward with joint 7 at zero."""
    clamp_radius_mm: Annotated[Millimetres, Positive] = 18.0
    """Of what the handle carries where it holds the sheet: clamp, rollers, the valve's rack."""


class HandSpec(Spec):
    """The SCU-Hand-SV: its sheet, roller, valve and vibration motor."""

    driver: Annotated[str, driver_name("hand")] = "hand_controller"
    port: str = ""
    options: HandOptions = HandOptions()
    sheet_radius_mm: Annotated[Millimetres, Field(gt=45, le=500)] = 50.0
    """More than half of the cone that a mounted sheet begins as, 90 mm (paper, section V)."""
    sheet_thickness_mm: Annotated[Millimetres, Positive] = 0.2
    roller_deg_per_mm: Annotated[float, Field(gt=0)] = 11.46
    """Roller angle per millimetre of sheet along the rim; calibrated (default: a 10 mm roller)."""
    morph_speed_mm_per_s: Annotated[MillimetresPerSecond, Positive] = 20.0
    """Speed of the sheet's edge along the rim while the cone changes its size; what the roller's servo can turn."""
    apex_offset_mm: Annotated[Millimetres, Positive] = 120.0
    """Flange to cone apex along the j7 axis, which the sheet's slit continues: read off a picture, measure yours."""
    apex_aside_mm: tuple[Millimetres, Millimetres] = (0.0, 0.0)
    """The apex beside that axis, along x and y of the flange: how crookedly the hand is screwed on."""
    mass_mg: Annotated[Milligrams, Positive] | None = None
    """Of all beyond joint 7, with what was added to the hand; unset, the URDF's."""
    mount: MountSpec = MountSpec()
    max_opening_mm: Annotated[Millimetres, Field(gt=0, le=20)] = 2.4
    valve_speed_mm_per_s: Annotated[MillimetresPerSecond, Field(ge=0.1)] = 4.0
    valve_dead_time_s: Annotated[Seconds, NotNegative] = 0.06
    streaming: bool = True
    """False for a controller board that offers the step command only."""
    simulation: ValveErrorSpec = ValveErrorSpec()

    @property
    def rim_limits_mm(self) -> tuple[float, float]:
        """The narrowest and the widest rim that the roller makes, whoever asks."""
        mounted_mm, flat_mm = self.options.start_diameter_mm, 2 * self.sheet_radius_mm
        return min(mounted_mm, NARROWEST_SHARE * flat_mm), max(mounted_mm, WIDEST_SHARE * flat_mm)

    @model_validator(mode="after")
    def _sheet_makes_the_cone(self) -> Self:
        if self.options.start_diameter_mm >= 2 * self.sheet_radius_mm:
            raise ValueError(f"this sheet only makes cones of less than {2 * self.sheet_radius_mm:g} mm")
        return self

    @model_validator(mode="after")
    def _valve_map_reaches(self) -> Self:
        widest_mm = self.options.valve_map[-1].opening_mm
        if widest_mm < self.max_opening_mm:
            raise ValueError(f"its 'valve_map' ends at {widest_mm:g} mm, below 'max_opening'")
        return self
