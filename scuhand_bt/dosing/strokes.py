"""Which stroke is made: by what lies in the mortar, and what is wanted in the cone.

A lip that follows the wall at a gap g takes what lies above that, and leaves a layer as thick as the gap, not a level
bed. So a bed's thickness t, across the wall, is where the wall is h high and phi steep

    t = min(layer, (level - h) cos phi),    level so that  m = density sum(t dA)

and a stroke with half of its rim e, in a bed of radius r, is expected to bring

    density w(e / r) sum(max(0, t - g) dA),    w(u) = 2 / pi (asin u + u sqrt(1 - u^2)), at most 1

w is the strip's share of a disc. The form is ours, and takes powder to stay as it was left; what a source really yields
of it is learnt from weighing (`cell/believed.py`). Masses in mg, lengths in mm.
"""

import math
from dataclasses import replace

import numpy as np

from scuhand_bt.dosing.swing import Floats, Stroke
from scuhand_bt.specs import Mortar

BEHIND_MM = 4.0
"""The lip comes to the wall so far behind the bed."""
WIDEST_SHARE = 0.92
"""Of the bore, or of the flat sheet: the widest rim that a stroke begins with."""
CLOSING_MM = 12.0
"""How much the rim closes around the powder, which lifts the handle's clamp over the mortar's edge."""
RIM_GRID_MM, GAP_GRID_MM = 2.0, 0.25
"""Strokes differ by so much at least."""
RINGS = 100
THIN_MM = 0.01


class Bed:
    """What is believed to lie in a mortar: so much, no thicker than `layer_mm`; without that, level."""

    def __init__(self, mortar: Mortar, mass_mg: float, density_mg_per_mm3: float, layer_mm: float = math.inf) -> None:
        radius_mm, half_mm = mortar.bowl_radius_mm, mortar.bore_mm / 2
        self.mortar, self._density = mortar, density_mg_per_mm3
        self._out_mm = (np.arange(RINGS) + 0.5) * half_mm / RINGS
        cosine = np.sqrt(1 - (self._out_mm / radius_mm) ** 2)
        self._area_mm2 = 2 * math.pi * self._out_mm * half_mm / RINGS / cosine

        def filled_mm(level_mm: float) -> Floats:
            above_mm = level_mm - radius_mm * (1 - cosine)
            thick_mm: Floats = np.clip(above_mm * cosine, 0.0, layer_mm)
            return thick_mm

        low_mm, level_mm = 0.0, mortar.depth_mm
        while level_mm - low_mm > THIN_MM:
            middle_mm = (low_mm + level_mm) / 2
            if self._mass_mg(filled_mm(middle_mm)) < mass_mg:
                low_mm = middle_mm
            else:
                level_mm = middle_mm
        thick_mm = filled_mm(level_mm)
        self._thick_mm: Floats = thick_mm * (mass_mg / max(self._mass_mg(thick_mm), THIN_MM))

    @property
    def radius_mm(self) -> float:
        """How far from the middle there is powder."""
        return float(self._out_mm[self._thick_mm > THIN_MM].max(initial=self._out_mm[0]))

    def above_mg(self, gap_mm: float) -> float:
        """What is farther from the wall than that."""
        return self._mass_mg(np.maximum(self._thick_mm - gap_mm, 0.0))

    def _mass_mg(self, thick_mm: Floats) -> float:
        return self._density * float(thick_mm @ self._area_mm2)


def expected_mg(stroke: Stroke, bed: Bed) -> float:
    """What a stroke is expected to bring into the cone."""
    u = min(1.0, stroke.open_mm / 2 / bed.radius_mm)
    strip = 2 / math.pi * (math.asin(u) + u * math.sqrt(1 - u * u))
    return strip * bed.above_mg(max(0.0, stroke.gap_mm))


def chosen(bed: Bed, sheet_radius_mm: float, wanted_mg: float) -> Stroke:
    """The stroke that brings so much and no more, or the most that there is: the widest, as deep as it has to be."""
    mortar = bed.mortar
    widest_mm = WIDEST_SHARE * min(mortar.bore_mm, 2 * sheet_radius_mm)
    behind_mm = mortar.bowl_radius_mm * math.asin(bed.radius_mm / mortar.bowl_radius_mm) + BEHIND_MM
    rims_mm = (_on_grid(widest_mm, RIM_GRID_MM), _on_grid(widest_mm - CLOSING_MM, RIM_GRID_MM))
    stroke = Stroke(*rims_mm, begin_mm=-_on_grid(behind_mm, RIM_GRID_MM))
    while expected_mg(stroke, bed) > wanted_mg:
        stroke = replace(stroke, gap_mm=_on_grid(stroke.gap_mm + GAP_GRID_MM, GAP_GRID_MM))
    return stroke


def _on_grid(length_mm: float, grid_mm: float) -> float:
    return grid_mm * round(length_mm / grid_mm)
