"""The hand's cone: one disc of sheet, slit to its centre, whose edges overlap.

    a = R (1 - phi / 2 pi)      alpha = asin(a / R)      h = sqrt(R^2 - a^2)      V = pi a^2 h / 3

R slant = radius of the disc [mm], phi overlap [rad], a rim radius [mm], alpha half-angle of the cone,
h depth [mm], V volume to the rim [mm^3]. R = 50 mm and phi = 36 deg give the 90 mm rim of the paper
(Takahashi et al., SCU-Hand-SV, ICRA 2026, section V-A), a half-angle of 64 deg and a wall only 26 deg
above the horizontal. The roller drags the sheet's edge along the rim, by phi R of arc.
"""

import math
from dataclasses import dataclass

from scuhand_bt.device_specs.hand import HandSpec
from scuhand_bt.specs import Mortar


@dataclass(frozen=True, slots=True)
class Cone:
    """The cone at one rim diameter. Raises ValueError unless 0 < diameter < twice the sheet's radius."""

    diameter_mm: float
    sheet_radius_mm: float = 50.0

    def __post_init__(self) -> None:
        if not 0.0 < self.diameter_mm < 2.0 * self.sheet_radius_mm:
            raise ValueError(
                f"a sheet of radius {self.sheet_radius_mm:g} mm cannot make a cone of {self.diameter_mm:g} mm; "
                f"choose more than 0 and less than {2 * self.sheet_radius_mm:g} mm"
            )

    @classmethod
    def from_overlap(cls, overlap_deg: float, sheet_radius_mm: float = 50.0) -> "Cone":
        """The cone for an overlap angle of the sheet."""
        return cls(2.0 * sheet_radius_mm * (1.0 - overlap_deg / 360.0), sheet_radius_mm)

    @classmethod
    def from_roller(cls, roller_deg: float, hand: HandSpec) -> "Cone":
        """The cone for a roller angle, counted from the flat sheet."""
        edge_mm = roller_deg / hand.roller_deg_per_mm
        return cls.from_overlap(math.degrees(edge_mm / hand.sheet_radius_mm), hand.sheet_radius_mm)

    @property
    def overlap_deg(self) -> float:
        return 360.0 * (1.0 - self.diameter_mm / (2.0 * self.sheet_radius_mm))

    @property
    def half_angle_deg(self) -> float:
        """Between the axis and the wall."""
        return math.degrees(math.asin(self.diameter_mm / (2.0 * self.sheet_radius_mm)))

    @property
    def depth_mm(self) -> float:
        """Rim to apex."""
        return math.sqrt(self.sheet_radius_mm**2 - (self.diameter_mm / 2.0) ** 2)

    @property
    def volume_mm3(self) -> float:
        """Filled level with the rim."""
        return math.pi * (self.diameter_mm / 2.0) ** 2 * self.depth_mm / 3.0

    def roller_deg(self, hand: HandSpec) -> float:
        """The roller's angle [deg] at this size, counted from the flat sheet."""
        return math.radians(self.overlap_deg) * hand.sheet_radius_mm * hand.roller_deg_per_mm

    def fill_height_mm(self, mass_mg: float, bulk_density_mg_per_mm3: float) -> float:
        """Height of a levelled load above the apex: h of V = pi tan^2(alpha) h^3 / 3."""
        volume_mm3 = mass_mg / bulk_density_mg_per_mm3
        tangent = math.tan(math.radians(self.half_angle_deg))
        return math.cbrt(3.0 * volume_mm3 / (math.pi * tangent**2))

    def resting_apex_mm(self, mortar: Mortar) -> float:
        """Height of the apex above the bowl's lowest point when this cone, upright, just touches the bowl.

        A wide cone rests on its rim, a narrow one on its apex (0). A rim wider than the bore lies on the mortar's edge.
        """
        radius_mm = min(self.diameter_mm, mortar.bore_mm) / 2.0
        bowl_mm = mortar.bowl_radius_mm
        wall_mm = bowl_mm - math.sqrt(bowl_mm**2 - radius_mm**2)
        return max(0.0, wall_mm - self.depth_mm * radius_mm / (self.diameter_mm / 2.0))


def edge_travel_mm(from_diameter_mm: float, to_diameter_mm: float) -> float:
    """Travel of the sheet's edge along the rim between two sizes: the change of the circumference."""
    return math.pi * abs(from_diameter_mm - to_diameter_mm)
