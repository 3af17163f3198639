"""Which stroke is made: by what lies in the mortar and what is wanted in the cone.

    expected = CAUGHT m A / A_bed

A is the part of the levelled bed's disc, of diameter d_bed, in the way of the rim: no farther aside than half of the
rim, and ahead of where the lip comes to the wall. The soft sheet catches most of that. The form and CAUGHT are ours;
what a source really yields is learnt from weighing (`cell/believed.py`).

Where all of the bed would be too much for the cone or for the dose, the rim is narrower, and the lip comes to the wall
further on. Masses in mg, lengths in mm.
"""

import math
from collections.abc import Iterator

from scuhand_bt.dosing.scooping import bed_diameter_mm
from scuhand_bt.dosing.swing import Stroke
from scuhand_bt.specs import Mortar

CAUGHT = 0.85
BED_GAP_MM = 4.0
"""The lip meets the wall this far behind the bed."""
WIDEST_SHARE = 0.92
"""Of the bore, or of the flat sheet: the widest rim that a stroke begins with."""
CLOSING_MM = 12.0
"""How much the rim closes around the powder, which lifts the handle's clamp over the mortar's edge."""
NARROWEST_SHARE = 0.75
"""Of the widest rim, the narrowest that a stroke begins with."""
WIDTHS, BEGINS = 3, 24
"""How many rims, and how many places to begin, are looked at."""


def strokes(mortar: Mortar, sheet_radius_mm: float, bed_mm: float) -> Iterator[Stroke]:
    """The strokes that there are in a mortar whose bed has this diameter, without a heading."""
    widest_mm = WIDEST_SHARE * min(mortar.bore_mm, 2 * sheet_radius_mm)
    behind_mm = _along_wall_mm(mortar, bed_mm / 2) + BED_GAP_MM
    for k in range(WIDTHS):
        open_mm = widest_mm * (1 - (1 - NARROWEST_SHARE) * k / (WIDTHS - 1))
        for n in range(BEGINS):
            begin_mm = -behind_mm + 1.6 * behind_mm * n / (BEGINS - 1)
            yield Stroke(open_mm, open_mm - CLOSING_MM, begin_mm)


def expected_mg(stroke: Stroke, mortar: Mortar, in_mortar_mg: float, bulk_density_mg_per_mm3: float) -> float:
    """What a stroke is expected to bring into the cone."""
    bed_mm = bed_diameter_mm(mortar, in_mortar_mg, bulk_density_mg_per_mm3)
    begin_mm = mortar.bowl_radius_mm * math.sin(stroke.begin_mm / mortar.bowl_radius_mm)
    return CAUGHT * in_mortar_mg * _share_of_disc(bed_mm / 2, stroke.open_mm / 2, begin_mm)


def chosen(
    mortar: Mortar,
    sheet_radius_mm: float,
    in_mortar_mg: float,
    bulk_density_mg_per_mm3: float,
    wanted_mg: float,
    most_mg: float,
) -> Stroke:
    """The stroke that brings the least that is enough, and at most `most_mg`; else as much as it may."""
    bed_mm = bed_diameter_mm(mortar, in_mortar_mg, bulk_density_mg_per_mm3)
    brings = [
        (expected_mg(stroke, mortar, in_mortar_mg, bulk_density_mg_per_mm3), stroke)
        for stroke in strokes(mortar, sheet_radius_mm, bed_mm)
    ]
    possible = [one for one in brings if one[0] <= most_mg] or [min(brings, key=lambda one: one[0])]
    enough = [one for one in possible if one[0] >= wanted_mg]
    return min(enough, key=lambda one: one[0])[1] if enough else max(possible, key=lambda one: one[0])[1]


def _along_wall_mm(mortar: Mortar, radius_mm: float) -> float:
    """The arc from the bowl's lowest point to where it is this wide."""
    bowl_mm = mortar.bowl_radius_mm
    return bowl_mm * math.asin(min(1.0, min(radius_mm, mortar.bore_mm / 2) / bowl_mm))


def _share_of_disc(radius_mm: float, half_width_mm: float, begin_mm: float) -> float:
    """The share of a disc no farther than the half width from its middle line, and ahead of `begin_mm` along that."""
    count = 200
    inside = 0.0
    for k in range(count):
        aside_mm = radius_mm * (2 * (k + 0.5) / count - 1)
        half_mm = math.sqrt(radius_mm**2 - aside_mm**2)
        if abs(aside_mm) <= half_width_mm:
            inside += max(0.0, half_mm - max(-half_mm, begin_mm))
    return inside * 2 * radius_mm / count / (math.pi * radius_mm**2) if radius_mm > 0 else 0.0
