"""What is believed to lie in a mortar's bowl, as its last strokes have left it (docs/scoop.md, The bed).

A stroke at a gap leaves a layer, not a level bed. What has come since lies level on it, or as a heap. With h the wall's
height, phi its slope, r the distance from the middle as a share of half the bore:

    layer      t = min(g, (level - h) cos phi),      g = gap + S r^2, where the wall keeps powder, else gap
    bed        t = max(t, (level' - h) cos phi)

with the levels such that the masses are right: m = density sum(t dA). A bed that was never scooped from is level.
Masses in mg, lengths in mm.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from scuhand_bt.dosing.ladle import LIP_GAP_MM
from scuhand_bt.dosing.swing_plane import Floats
from scuhand_bt.specs import Mortar, Powder

SIDES_MM = 0.4
"""S: how much thicker the layer is at the bore's edge. By the height field."""
BENDS_MM = 0.5
"""How far the sheet may bend down to the wall: assumed, not measured. What is expected takes a rigid one."""
RINGS = 100
THIN_MM, THIN_MG = 0.01, 1.0


@dataclass(frozen=True, slots=True)
class Pass:
    """A stroke that was made along a jar's floor: the layer under its lip, and its heading."""

    heading_deg: float
    left_mm: float


@dataclass(frozen=True, slots=True)
class Layer:
    """What the last stroke has left on a mortar's wall: a mass, nowhere thicker than the gap.

    With the lip on the wall, it lies wherever the stroke has not reached it.
    """

    gap_mm: float
    mass_mg: float
    beside_mg: float = 0.0
    """Besides, what has fallen back before lips that left the wall: high up, where the next strokes find little."""
    missed_mg: float = 0.0
    """The part of `beside_mg` that the last stroke should have found and did not; the next one may still find it."""
    more_mg: float = 0.0
    """What the last stroke may have brought besides, if the sheet bends; it is then poured back with the load."""
    is_lens: bool = False
    """Whether this stroke, or one before it, cut into a bowl that was more than half full."""
    passes: tuple[Pass, ...] = ()
    """In a jar (`jars.py`): the last stroke along each heading."""


class Bed:
    """What is believed to lie in a bowl: what was left in a layer, and on it what has come since."""

    def __init__(
        self, mortar: Mortar, mass_mg: float, powder: Powder, layer: Layer | None = None, *, is_heaped: bool = False
    ) -> None:
        radius_mm, half_mm = mortar.bowl_radius_mm, mortar.bore_mm / 2
        self.mortar, self.mass_mg, self.powder = mortar, mass_mg, powder
        self._out_mm = (np.arange(RINGS) + 0.5) * half_mm / RINGS
        cosine = np.sqrt(1 - (self._out_mm / radius_mm) ** 2)
        self._area_mm2 = 2 * math.pi * self._out_mm * half_mm / RINGS / cosine
        stays = self._out_mm < radius_mm * math.sin(math.radians(powder.repose_deg))
        self._sides_mm = stays * SIDES_MM * (self._out_mm / half_mm) ** 2

        def level_mm(level_mm: float, falls: float = 0.0) -> Floats:
            thick_mm: Floats = np.maximum(level_mm - falls * self._out_mm - radius_mm * (1 - cosine), 0.0) * cosine
            return thick_mm

        self._falls = math.tan(math.radians(powder.repose_deg)) if is_heaped else 0.0

        self.if_found: Bed | None
        """This bed, if the last stroke missed nothing and what its load lacked was poured back as a heap."""
        self.was_scooped_from = layer is not None
        self.beside_mg = min(layer.beside_mg, mass_mg) if layer is not None else 0.0
        self.missed_mg = min(layer.missed_mg, mass_mg) if layer is not None else 0.0
        self.if_found = None
        if layer is not None and self.missed_mg > 0.0:
            found = replace(layer, beside_mg=layer.beside_mg - layer.missed_mg, missed_mg=0.0)
            self.if_found = Bed(mortar, mass_mg, powder, found, is_heaped=True)
        mass_mg -= self.beside_mg
        self._thick_mm: Floats = np.zeros(RINGS)
        if layer is not None and layer.gap_mm > LIP_GAP_MM:
            self._fill(lambda at_mm: np.minimum(level_mm(at_mm), layer.gap_mm + self._sides_mm), layer.mass_mg)
            self._thick_mm *= min(1.0, mass_mg / max(layer.mass_mg, THIN_MM))
        left_mm = self._thick_mm
        self._fill(lambda at_mm: np.maximum(level_mm(at_mm, self._falls), left_mm), mass_mg)
        self._lies = self._thick_mm > (left_mm if is_heaped else 0.0) + THIN_MM

        self.if_heaped: Bed | None = None
        """This bed, if what came since the last stroke lies as a heap; only above half the depth."""
        self.if_more: Bed | None = None
        """The same, if the last stroke has also brought all that it may."""
        self._is_full = is_heaped or self.mass_mg > powder.bulk_density_mg_per_mm3 * mortar.capacity_mm3 / 2
        self.is_lens = self._is_full or (layer is not None and layer.is_lens)
        is_high = not is_heaped and self.surface_mm > mortar.depth_mm / 2
        if layer is not None and is_high and mass_mg > layer.mass_mg + THIN_MG:
            more = replace(layer, mass_mg=max(0.0, layer.mass_mg - layer.more_mg))
            self.if_heaped = Bed(mortar, self.mass_mg, powder, layer, is_heaped=True)
            self.if_more = Bed(mortar, self.mass_mg, powder, more, is_heaped=True)

    def _fill(self, up_to: Callable[[float], Floats], mass_mg: float) -> None:
        """Set the thickness to that up to the level that makes this mass."""
        low_mm, high_mm = 0.0, self.mortar.depth_mm + self._falls * self.mortar.bore_mm / 2
        while high_mm - low_mm > THIN_MM:
            middle_mm = (low_mm + high_mm) / 2
            if self._mass_mg(up_to(middle_mm)) < mass_mg:
                low_mm = middle_mm
            else:
                high_mm = middle_mm
        thick_mm = up_to(high_mm)
        self._thick_mm = thick_mm * (mass_mg / max(self._mass_mg(thick_mm), THIN_MM))

    @property
    def radius_mm(self) -> float:
        """The radius within which there is powder; of a heap, its own."""
        return float(self._out_mm[self._lies].max(initial=self._out_mm[0]))

    @property
    def surface_mm(self) -> float:
        """The greatest height of powder above the bowl's lowest point."""
        radius_mm = self.mortar.bowl_radius_mm
        cosine = np.sqrt(1 - (self._out_mm / radius_mm) ** 2)
        return float((radius_mm * (1 - cosine) + self._thick_mm / cosine)[self._thick_mm > THIN_MM].max(initial=0.0))

    def above_mg(self, gap_mm: float, slip_mm: float = 0.0) -> float:
        """The mass farther from the wall than a gap, less what slips past the lip."""
        left_mm = gap_mm + self._sides_mm if gap_mm > LIP_GAP_MM else gap_mm
        above_mm = np.maximum(self._thick_mm - left_mm, 0.0)
        return self._mass_mg(above_mm - np.minimum(slip_mm, above_mm / 3))

    def above_bent_mg(self, gap_mm: float, rim_mm: float, leans_deg: float) -> float:
        """The mass farther from the wall than a rim that has bent down to it.

        The rim's plane leans by `leans_deg` from the wall's normal at the lip. It is narrower than the bowl; in a bowl
        more than half full it may be wider than the circle that the lip follows.
        """
        radius_mm, curved = self.mortar.bowl_radius_mm, 2 / rim_mm * math.cos(math.radians(leans_deg))
        followed_mm = max(radius_mm - gap_mm, rim_mm / 3)
        narrower = curved - 1 / followed_mm if self._is_full else max(0.0, curved - 1 / radius_mm)
        left_mm = np.maximum(0.0, max(0.0, gap_mm - BENDS_MM) + narrower * self._out_mm**2 / 4)
        return self._mass_mg(np.maximum(self._thick_mm - left_mm, 0.0))

    def _mass_mg(self, thick_mm: Floats) -> float:
        return self.powder.bulk_density_mg_per_mm3 * float(thick_mm @ self._area_mm2)
