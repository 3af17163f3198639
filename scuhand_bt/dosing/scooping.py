"""What one stroke of the closing cone is expected to collect from a mortar.

    share = best * reach * stroke * contact
    reach = min(1, (d / d_bed)^2),   stroke = min(1, (d - d_closed) / s_full),   contact = min(1, o / o_full)

d rim diameter as the sheet meets the bowl [mm], d_bed diameter of the powder bed in the spherical bowl [mm],
d_closed rim diameter at the stroke's end [mm], o how far the sheet is pressed onto the wall [mm]. The soft
sheet follows the wall, so that repeated scoops leave only the last few per cent. The form and figures are ours;
the published hand reports scooping from containers of several sizes by position control alone (Takahashi et al.,
SCU-Hand, 2025), but no law.
"""

import math

from scuhand_bt.specs import Mortar

BEST_SHARE = 0.85
FULL_STROKE_MM = 20.0
FULL_CONTACT_MM = 2.0


def bed_depth_mm(mortar: Mortar, mass_mg: float, bulk_density_mg_per_mm3: float) -> float:
    """Depth of a levelled bed: h of V = pi h^2 (3 R - h) / 3, at most the bowl's depth."""
    volume_mm3 = mass_mg / bulk_density_mg_per_mm3
    radius_mm = mortar.bowl_radius_mm
    low_mm, high_mm = 0.0, mortar.depth_mm
    while high_mm - low_mm > 1e-3:
        middle_mm = (low_mm + high_mm) / 2.0
        if math.pi * middle_mm**2 * (3.0 * radius_mm - middle_mm) / 3.0 < volume_mm3:
            low_mm = middle_mm
        else:
            high_mm = middle_mm
    return high_mm


def bed_diameter_mm(mortar: Mortar, mass_mg: float, bulk_density_mg_per_mm3: float) -> float:
    """Diameter of a levelled bed's surface."""
    depth_mm = bed_depth_mm(mortar, mass_mg, bulk_density_mg_per_mm3)
    return 2.0 * math.sqrt(max(0.0, depth_mm * (2.0 * mortar.bowl_radius_mm - depth_mm)))


def collected_share(diameter_mm: float, closed_diameter_mm: float, overtravel_mm: float, bed_mm: float) -> float:
    """The share 0..1 of what is in the mortar that one stroke takes; `bed_mm` is the bed's diameter."""
    reach = min(1.0, (diameter_mm / max(bed_mm, 1e-9)) ** 2)
    stroke = min(1.0, max(0.0, diameter_mm - closed_diameter_mm) / FULL_STROKE_MM)
    contact = min(1.0, max(0.0, overtravel_mm) / FULL_CONTACT_MM)
    return BEST_SHARE * reach * stroke * contact
