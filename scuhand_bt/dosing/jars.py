"""Strokes in beakers and jars: which is made, what it brings, and what it leaves (docs/scoop.md, Beakers and jars).

A stroke along a heading goes from x0, where the hand can bring the lip down behind the middle, to f, where the floor
ends. x0 is farther behind for a larger gap, as the edge is less in the hand's way. A rigid rim of radius a touches a
level floor in one point; y beside that it is higher, and farther behind, by

    z = (a - sqrt(a^2 - y^2)) cos(alpha - beta),    dx = (a - sqrt(a^2 - y^2)) sin(alpha - beta)

with alpha the cone's half-angle, beta the attack. So along x0 < x < f - dx a stroke at a gap g leaves t <= g + z, and
brings what was thicker. All else stays: behind its beginning, beside its rim, before the wall.

The bed is as thick everywhere as the strokes made so far let it be, up to one level that makes its mass. What has come
since, as leftovers do, lies on that as a heap in the middle.

A sheet may bend (assumed) and bring more, which makes a larger heap once poured back. A stroke that leaves a layer is
not made if it would then bring more than the load limit. The model is ours, and takes powder to stay as it was left;
what a source really yields is learnt by weighing (docs/scoop-belief.md). Masses in mg, lengths in mm.
"""

import math
from bisect import bisect_left
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from scuhand_bt.dosing.bed import BENDS_MM, THIN_MG, THIN_MM, Layer, Pass
from scuhand_bt.dosing.ladle import LIP_GAP_MM, Ladle, NoStrokeError, Stroke
from scuhand_bt.dosing.strokes import (
    CLOSING_MM,
    GAP_GRID_MM,
    GRAINS_CLEAR,
    GRAINS_LEAST,
    LAST_SHARE,
    LITTLE_SHARE,
    LOAD_AIM,
    LOOSE_GRAINS,
    RIM_GRID_MM,
    scooped_for_mg,
)
from scuhand_bt.dosing.swing import stroke_path
from scuhand_bt.dosing.swing_plane import Floats
from scuhand_bt.dosing.vessel import Vessel
from scuhand_bt.specs import Mortar, Powder

RIM_SHARE = 0.8
"""The rim at the beginning, as a share of the bore or of the flat sheet, whichever is less. A wider one brings more at
first (by the height field, a third more in a jar of 95 mm). But the arm can make it in half as many directions, and all
together bring less."""
FOUND_AGAIN = 0.6
"""Share of what it meets that a stroke after the first brings: what was pushed aside lies beside it or before the wall.
By the height field 1 to 0.4 of 12 g, and 0.75 to 0.35 of 40 g."""
LEAST_MG = 100.0
"""A stroke expected to bring less is not made: what is left lies where no stroke comes."""
SURE_SHARE = 0.65
"""Share of what a jar's strokes should bring that a plan counts on. By the height field all strokes through 12 and 30 g
of beads, MSG and titanium dioxide bring 0.67 to 0.78 of it in a jar of 80 mm, 1.0 to 1.4 in 95 and 110 mm."""
WIDEST_MM, SIZES_MM = 150.0, 5.0
"""Largest bore, and steps of the sizes, that are proposed in place of a jar in which no stroke is possible."""
COUNTED_ON_DEG = (90.0, 270.0, 120.0, 240.0)
"""Directions that a plan counts on before the arm is asked; in the jars that were tried it can make 4 to 6."""
FROM_WALL_MM = 7.0
"""Distance of the lip from the wall as the cone turns upright, in a jar filled above half. What it pushes lies there,
and goes over the edge of a nearly full jar: by the height field 0.1 to 0.9 g from 1 to 4 mm, and none from 6.4 mm."""
RUNS_MM = 5.0
"""How far a stroke goes is computed at gaps in these steps, and interpolated between."""
CELL_MM = 2.0
"""Cell size of the grid that holds the bed's thickness."""


class JarBed:
    """What is believed to lie in a beaker or jar that such a hand scoops from."""

    def __init__(
        self, mortar: Mortar, mass_mg: float, powder: Powder, ladle: Ladle, layer: Layer | None = None
    ) -> None:
        self.mortar, self.mass_mg, self.powder, self._ladle = mortar, mass_mg, powder, ladle
        half_mm, corner_mm, layer = mortar.bore_mm / 2, corner_of(mortar), layer or Layer(0.0, mass_mg)
        self._layer = layer
        line_mm = np.arange(CELL_MM / 2 - half_mm, half_mm, CELL_MM)
        x_mm, y_mm = (axis.ravel() for axis in np.meshgrid(line_mm, line_mm, indexing="ij"))
        out_mm = np.hypot(x_mm, y_mm)
        self._x_mm, self._y_mm = x_mm[out_mm < half_mm], y_mm[out_mm < half_mm]
        into_mm = np.maximum(out_mm[out_mm < half_mm] - (half_mm - corner_mm), 0.0)
        self._high_mm = corner_mm - np.sqrt(corner_mm**2 - into_mm**2)
        self._mg_per_mm = powder.bulk_density_mg_per_mm3 * CELL_MM**2
        self.missed_mg = min(layer.missed_mg, mass_mg)
        self._passes, self._came_mg = layer.passes, max(0.0, mass_mg - layer.mass_mg)
        self._left_mm = self._level(min(layer.mass_mg, mass_mg))
        self._thick_mm = self._left_mm + self._heap(self._came_mg)
        # If more came than expected, unseen, the heap that was poured back is larger.
        more_mg = layer.more_mg if self._came_mg > THIN_MG else 0.0
        self._heavy_mm = self._left_mm + self._heap(self._came_mg + more_mg)

    def expected_mg(self, stroke: Stroke) -> float:
        """The mass that a stroke is expected to bring into the cone."""
        of_heap_mg = self._of_heap_mg(stroke)
        found = FOUND_AGAIN if self._passes else 1.0
        return found * (self.most_mg(stroke) - of_heap_mg) + of_heap_mg

    def most_mg(self, stroke: Stroke) -> float:
        """The mass that a stroke brings if it keeps all that it meets."""
        return self._above_mg(self._thick_mm, self._passed(stroke))

    def _bent_mg(self, thick_mm: Floats, stroke: Stroke) -> float:
        """The mass that it brings if the sheet bends down to the floor."""
        left = self._passed(stroke)
        return self._above_mg(thick_mm, replace(left, left_mm=max(0.0, left.left_mm - BENDS_MM)))

    def left_by(self, stroke: Stroke) -> Layer:
        """The layer that a stroke is expected to leave."""
        over_mm = (self._came_mg - self._of_heap_mg(stroke)) / (self._mg_per_mm * len(self._high_mm))
        others = [one for one in self._passes if one.heading_deg != stroke.heading_deg]
        raised = (replace(one, left_mm=one.left_mm + over_mm) for one in others)
        passes = (*raised, self._passed(stroke))
        expected_mg = self.expected_mg(stroke)
        more_mg = max(0.0, self._bent_mg(self._thick_mm, stroke) - expected_mg)
        return Layer(stroke.gap_mm, self.mass_mg - expected_mg, more_mg=more_mg, passes=passes)

    def with_more(self, mass_mg: float) -> "JarBed":
        """The bed after a mass is poured into its middle."""
        return JarBed(self.mortar, self.mass_mg + mass_mg, self.powder, self._ladle, self._layer)

    def after(self, stroke: Stroke) -> "JarBed":
        """The bed after a stroke that has brought what is expected."""
        left = self.left_by(stroke)
        return JarBed(self.mortar, left.mass_mg, self.powder, self._ladle, left)

    def strokes(self, wanted_mg: float, headings_deg: Iterable[float]) -> list[Stroke]:
        """The `chosen` stroke along each heading, the most productive first."""
        along = [self.chosen(wanted_mg, heading_deg) for heading_deg in headings_deg]
        return sorted(along, key=self.expected_mg, reverse=True)

    def chosen(self, wanted_mg: float, heading_deg: float) -> Stroke:
        """The stroke along a heading that brings no more than is wanted, as deep as it has to be.

        Raises NoStrokeError, naming sizes with which it could, where the hand can make none in such a vessel.
        """
        if not has_way(self.mortar, self._ladle):
            raise _no_way(self.mortar, self._ladle, self.mass_mg / self.powder.bulk_density_mg_per_mm3)
        deepest = replace(along_floor(self.mortar, self._ladle.slant_mm), heading_deg=heading_deg)
        most_mg = self.most_mg(deepest)
        if most_mg <= wanted_mg:
            return deepest
        stroke = self._layered(deepest, wanted_mg, GRAINS_CLEAR)
        if self.most_mg(stroke) < LITTLE_SHARE * min(wanted_mg, most_mg):
            stroke = self._layered(deepest, wanted_mg, GRAINS_LEAST)
        return stroke

    def _layered(self, deepest: Stroke, wanted_mg: float, grains: float) -> Stroke:
        """The deepest stroke that brings no more than is wanted and leaves a layer of so many grains or more."""

        def at(steps: int) -> Stroke:
            gap_mm = steps * GAP_GRID_MM
            return replace(deepest, gap_mm=gap_mm, end_mm=_end_mm(self.mortar, self._ladle.slant_mm, gap_mm))

        bent_limit_mg = max(wanted_mg, self.powder.load_limit_mg)

        def may_be(steps: int) -> bool:
            return self.most_mg(at(steps)) <= wanted_mg and self._bent_mg(self._heavy_mm, at(steps)) <= bent_limit_mg

        clear, all_left = (
            math.ceil(mm / GAP_GRID_MM)
            for mm in (grains * self.powder.grain_mm, self._thick_mm.max() + LOOSE_GRAINS * self.powder.grain_mm)
        )
        steps = range(clear, max(clear, all_left) + 1)
        return at(steps[bisect_left(steps, True, key=may_be)])

    def _passed(self, stroke: Stroke) -> Pass:
        loose_mm = LOOSE_GRAINS * self.powder.grain_mm if stroke.gap_mm > LIP_GAP_MM else 0.0
        return Pass(stroke.heading_deg, stroke.gap_mm - loose_mm)

    def _of_heap_mg(self, stroke: Stroke) -> float:
        """What a stroke meets of the heap in the middle."""
        return self.most_mg(stroke) - self._above_mg(self._left_mm, self._passed(stroke))

    def _above_mg(self, thick_mm: Floats, passed: Pass) -> float:
        return self._mg_per_mm * float(np.maximum(thick_mm - self._most_mm(passed), 0.0).sum())

    def _heap(self, came_mg: float) -> Floats:
        """Thickness of what has come since, poured onto the middle, at its repose."""
        steep = math.tan(math.radians(self.powder.repose_deg))
        high_mm = math.cbrt(3 * steep**2 * came_mg / self.powder.bulk_density_mg_per_mm3 / math.pi)
        thick_mm: Floats = np.maximum(high_mm - steep * np.hypot(self._x_mm, self._y_mm), 0.0)
        return thick_mm * (came_mg / max(self._mg_per_mm * float(thick_mm.sum()), THIN_MM))

    def _level(self, mass_mg: float) -> Floats:
        """Thickness of a mass everywhere: up to one level, and no thicker than strokes have left it."""
        most_mm = np.full_like(self._high_mm, self.mortar.depth_mm)
        for one in self._passes:
            most_mm = np.minimum(most_mm, self._most_mm(one))

        def thick_mm(level_mm: float) -> Floats:
            thick_mm: Floats = np.minimum(np.maximum(level_mm - self._high_mm, 0.0), most_mm)
            return thick_mm

        low_mm, high_mm = 0.0, self.mortar.depth_mm
        while high_mm - low_mm > THIN_MM:
            middle_mm = (low_mm + high_mm) / 2
            if self._mg_per_mm * float(thick_mm(middle_mm).sum()) < mass_mg:
                low_mm = middle_mm
            else:
                high_mm = middle_mm
        thick = thick_mm(high_mm)
        return thick * (mass_mg / max(self._mg_per_mm * float(thick.sum()), THIN_MM))

    def _most_mm(self, one: Pass) -> Floats:
        """The greatest thickness that a stroke leaves; infinite where it does not go."""
        heading, (begin_mm, end_mm) = math.radians(one.heading_deg), _run_mm(self.mortar, self._ladle, one.left_mm)
        along_mm = self._x_mm * math.cos(heading) + self._y_mm * math.sin(heading)
        aside_mm = self._y_mm * math.cos(heading) - self._x_mm * math.sin(heading)
        stroke = along_floor(self.mortar, self._ladle.slant_mm)
        share = np.clip((along_mm - stroke.begin_mm) / (stroke.end_mm - stroke.begin_mm), 0.0, 1.0)
        rim_mm = (stroke.open_mm + (stroke.closed_mm - stroke.open_mm) * share) / 2
        leans = np.arcsin(rim_mm / self._ladle.slant_mm) - math.radians(stroke.attack_deg)
        off_mm = rim_mm - np.sqrt(np.maximum(rim_mm**2 - aside_mm**2, 0.0))
        goes = (np.abs(aside_mm) < rim_mm) & (along_mm > begin_mm) & (along_mm < end_mm - off_mm * np.sin(leans))
        most_mm: Floats = np.where(goes, one.left_mm + off_mm * np.cos(leans), math.inf)
        return most_mm


def along_floor(mortar: Mortar, sheet_radius_mm: float) -> Stroke:
    """The stroke that takes all on its way along a jar's floor."""
    widest_mm = RIM_SHARE * min(mortar.bore_mm, 2 * sheet_radius_mm)
    open_mm, closed_mm = (RIM_GRID_MM * round(rim_mm / RIM_GRID_MM) for rim_mm in (widest_mm, widest_mm - CLOSING_MM))
    floor_mm = mortar.bore_mm / 2 - corner_of(mortar)
    return Stroke(open_mm, closed_mm, -floor_mm, end_mm=floor_mm)


def after_dose(
    bed: JarBed,
    dose_mg: float,
    headings_deg: Sequence[float],
    *,
    is_discarded: bool,
    may_be: Callable[[Stroke], bool] = lambda stroke: True,
) -> JarBed | None:
    """The bed after a dose, by the strokes that `scoop` would make; None where the dose is not sure to come.

    `SURE_SHARE` of what the strokes should bring is counted on. A surplus is poured back, unless it `is_discarded`:
    then the last of each load goes with it. `may_be` tells whether the arm can make a stroke. Raises NoStrokeError
    where the hand can make none in such a vessel.
    """
    wanted_mg = scooped_for_mg(dose_mg, bed.powder, is_discarded=is_discarded)
    wanted_mg, brought_mg = min(wanted_mg, LOAD_AIM * bed.powder.load_limit_mg), 0.0
    sure = SURE_SHARE * (1.0 - LAST_SHARE) if is_discarded else SURE_SHARE
    while sure * brought_mg < dose_mg:
        worth = (one for one in bed.strokes(wanted_mg, headings_deg) if bed.expected_mg(one) >= LEAST_MG)
        if (stroke := next(filter(may_be, worth), None)) is None:
            return None
        brought_mg += bed.expected_mg(stroke)
        bed = bed.after(stroke)
    return bed if is_discarded else bed.with_more(brought_mg - dose_mg)


def sure_doses(
    bed: JarBed,
    doses_mg: Sequence[float],
    headings_deg: Sequence[float],
    *,
    is_discarded: bool,
    may_be: Callable[[Stroke], bool] = lambda stroke: True,
) -> int:
    """How many doses, one after another, are sure to come out of a jar; see `after_dose`."""
    for number, dose_mg in enumerate(doses_mg):
        left = after_dose(bed, dose_mg, headings_deg, is_discarded=is_discarded, may_be=may_be)
        if left is None:
            return number
        bed = left
    return len(doses_mg)


def _end_mm(mortar: Mortar, sheet_radius_mm: float, gap_mm: float) -> float:
    """Where a stroke at such a gap ends: at the floor's end, or earlier if the turning cone would pour there."""
    stroke = along_floor(mortar, sheet_radius_mm)
    if gap_mm <= mortar.depth_mm / 2:
        return stroke.end_mm
    turns_mm = sheet_radius_mm * (1.0 - math.cos(math.radians(stroke.attack_deg)))
    return min(stroke.end_mm, mortar.bore_mm / 2 - FROM_WALL_MM - turns_mm)


def has_way(mortar: Mortar, ladle: Ladle) -> bool:
    """Whether the hand can bring the lip along a jar's floor, whatever the arm can."""
    try:
        _run_at_mm(mortar, ladle, LIP_GAP_MM)
    except NoStrokeError:
        return False
    return True


def _no_way(mortar: Mortar, ladle: Ladle, bed_mm3: float) -> NoStrokeError:
    def would(size: dict[str, float]) -> bool:
        other = mortar.model_copy(update=size)
        return bed_mm3 <= other.capacity_mm3 and has_way(other, ladle)

    def first(sizes: Iterable[dict[str, float]]) -> dict[str, float]:
        return next(filter(would, sizes), {})

    bores_mm = np.arange(mortar.bore_mm, WIDEST_MM, SIZES_MM) + SIZES_MM
    depths_mm = np.arange(mortar.depth_mm, corner_of(mortar) + SIZES_MM, -SIZES_MM) - SIZES_MM
    wider = first({"bore_mm": bore, "outer_diameter_mm": bore} for bore in bores_mm.tolist())
    lower = first({"depth_mm": depth} for depth in depths_mm.tolist())
    wanted = [f"a bore of {wider['bore_mm']:g} mm (if there is room for it)"] if wider else []
    wanted += [f"a depth of {lower['depth_mm']:g} mm"] if lower else []
    return NoStrokeError(
        f"the hand, with a sheet of {ladle.slant_mm:g} mm radius, cannot move along the floor of a jar of "
        f"{mortar.bore_mm:g} mm bore and {mortar.depth_mm:g} mm depth without touching its wall; "
        f"{' or '.join(wanted) or 'a mortar'} would do"
    )


def corner_of(jar: Mortar) -> float:
    """The corner's radius; raises ValueError for a bowl."""
    if jar.corner_mm is None:
        raise ValueError(f"'{jar.name}' is a bowl")
    return jar.corner_mm


def _run_mm(mortar: Mortar, ladle: Ladle, gap_mm: float) -> Floats:
    """The lip's run (begin, end) along the floor at a gap: (2,). Raises NoStrokeError where it has no way."""
    below = math.floor(gap_mm / RUNS_MM)
    first, then = (_run_at_mm(mortar, ladle, max(LIP_GAP_MM, step * RUNS_MM)) for step in (below, below + 1))
    run: Floats = first + (gap_mm / RUNS_MM - below) * (then - first)
    return run


@lru_cache(maxsize=256)
def _run_at_mm(mortar: Mortar, ladle: Ladle, gap_mm: float) -> Floats:
    stroke = replace(along_floor(mortar, ladle.slant_mm), gap_mm=gap_mm, end_mm=_end_mm(mortar, ladle.slant_mm, gap_mm))
    path = stroke_path(Vessel.of(mortar), stroke, ladle)
    run: Floats = path.lip_mm[path.on_wall][[0, -1], 0]
    return run
