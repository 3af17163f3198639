"""What is asked of one stroke, and of what hand."""

import math
from dataclasses import dataclass

from scuhand_bt.device_specs.hand import HandSpec

LIP_GAP_MM = 0.1
"""Between the lip and the wall of a stroke that takes all there is."""
WRIST_TO_FLANGE_MM = 19.0


class NoStrokeError(ValueError):
    """No such stroke is possible in this vessel; its words say why."""


@dataclass(frozen=True, slots=True)
class Stroke:
    """What is asked of one swing. The rim goes from `open_mm` to `closed_mm` evenly with the lip's way along the wall.

    The lip meets the wall at the arc length `begin_mm` from the lowest point, negative behind it, or later where the
    axis would have to be tilted more than `max_tilt_deg`. `heading_deg` is the direction of the swing about the
    vertical. The lip follows the wall at `gap_mm`; less than 0 presses it into the wall. It leaves the wall at the arc
    length `end_mm`, or at the edge, if that is nearer.
    """

    open_mm: float
    closed_mm: float
    begin_mm: float
    attack_deg: float = 22.0
    heading_deg: float = 0.0
    gap_mm: float = LIP_GAP_MM
    max_tilt_deg: float = 110.0
    lip_speed_mm_per_s: float = 60.0
    end_mm: float = math.inf


@dataclass(frozen=True, slots=True)
class Ladle:
    """The hand as far as a stroke depends on it."""

    slant_mm: float = 50.0
    """The sheet's radius."""
    handle_radius_mm: float = 18.0
    """Of the clamp at the rim, and of what continues the seam from there."""
    handle_mm: float = 139.0
    """From the apex along the seam to the wrist's middle."""
    edge_speed_mm_per_s: float = 20.0
    """Of the sheet's edge along the rim: how fast the cone closes."""
    rim_limits_mm: tuple[float, float] = (30.0, 95.0)
    """What the roller makes."""

    @classmethod
    def of(cls, hand: HandSpec) -> "Ladle":
        """A cell's hand."""
        return cls(
            hand.sheet_radius_mm,
            hand.mount.clamp_radius_mm,
            hand.apex_offset_mm + WRIST_TO_FLANGE_MM,
            hand.morph_speed_mm_per_s,
            hand.rim_limits_mm,
        )
