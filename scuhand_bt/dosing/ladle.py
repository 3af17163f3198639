"""What a stroke is asked to do, and the hand that makes it."""

import math
from dataclasses import dataclass

from scuhand_bt.device_specs.hand import HandSpec

LIP_GAP_MM = 0.1
"""Gap between lip and wall in a stroke that takes all there is."""
WRIST_TO_FLANGE_MM = 19.0


class NoStrokeError(ValueError):
    """No such stroke is possible in this vessel; the message says why."""


@dataclass(frozen=True, slots=True)
class Stroke:
    """One swing, as asked for.

    The rim goes from `open_mm` to `closed_mm` evenly along the lip's way on the wall. The lip meets the wall at the arc
    length `begin_mm` from the lowest point (negative behind it), or later where that needs more tilt than
    `max_tilt_deg`. It follows the wall at `gap_mm` (below 0 it presses into the wall), and leaves it at `end_mm` or at
    the edge. `heading_deg` is the swing's direction about the vertical.
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
    """The hand, as far as a stroke depends on it."""

    slant_mm: float = 50.0
    """The sheet's radius."""
    handle_radius_mm: float = 18.0
    """Radius of the clamp at the rim, and of what continues the seam from there."""
    handle_mm: float = 139.0
    """From the apex along the seam to the middle of the wrist."""
    edge_speed_mm_per_s: float = 20.0
    """Speed of the sheet's edge along the rim, as the cone closes."""
    rim_limits_mm: tuple[float, float] = (30.0, 95.0)
    """Diameters that the roller can make."""

    @classmethod
    def of(cls, hand: HandSpec) -> "Ladle":
        """The hand of a cell."""
        return cls(
            hand.sheet_radius_mm,
            hand.mount.clamp_radius_mm,
            hand.apex_offset_mm + WRIST_TO_FLANGE_MM,
            hand.morph_speed_mm_per_s,
            hand.rim_limits_mm,
        )
