"""A scoop: powder out of a mortar into the cone, by closing the cone along the mortar's wall.

The bowl is a sphere of radius R about a centre C. A cone whose rim touches the wall keeps touching it
however it swings about C; so the stroke swings the cone from one side of the bowl to its middle, while the
rim's diameter shrinks and the apex follows the height that the rim, or the apex, rests at. The sheet is
pressed over its contact by a compliance over-travel, which its softness takes up.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

from scuhand_bt.cell_spec import MOUNTED_DIAMETER_MM
from scuhand_bt.dosing.cone import Cone
from scuhand_bt.dosing.scooping import BEST_SHARE, FULL_STROKE_MM, bed_diameter_mm, collected_share
from scuhand_bt.motion import ApexPose
from scuhand_bt.skill import (
    Cell,
    Code,
    Milligrams,
    Millimetres,
    MillimetresPerSecond,
    Returned,
    Scooped,
    Skill,
    SkillFailed,
    Source,
    Steps,
)

from ._emptying import empty_cone, empty_into

WALL_GAP_MM = 4.0
"""Between the mortar's bore and the largest rim that goes in."""
STROKE_MM = 24.0
"""How much the rim's diameter shrinks in a stroke."""
NARROWEST_MM = 46.0
"""The smallest rim that a scoop begins with."""
LOAD_AIM = 0.95
"""Share of the powder's load limit that a scoop aims at: what it collects varies."""
BED_GAP_MM = 6.0
"""The rim meets the wall this much wider than the powder bed."""
MAX_SWING_DEG = 8.0
STROKE_POINTS = 8
NOTHING_LEFT_MG = 30.0
"""Less than this, believed to be in a mortar, is not worth a scoop."""


@dataclass(frozen=True)
class Stroke:
    """One scoop through a mortar: the rim from `open_mm` to `closed_mm`, from `swing_deg` to upright."""

    open_mm: float
    closed_mm: float
    swing_deg: float


class Scoop(Skill[Milligrams]):
    """Scoop powder from a source into the cone; gives the mass that the cone is expected to hold.

    A load that gave out too early is let out into its mortar before: as a poor scoop, or a bridge, it is in the way.
    """

    raises = (Code.HAND_WRONG_POWDER, Code.SOURCE_EMPTY)
    devices = ("arm", "hand")
    typical_s = 18.0
    interrupted = "repeat"

    source: Source
    over_travel_mm: Annotated[Millimetres, Field(gt=0, le=10)] = 3.0
    speed_mm_per_s: Annotated[MillimetresPerSecond, Field(gt=0, le=200)] = 40.0

    def run(self, cell: Cell) -> Steps[Milligrams]:
        source, believed = self.source, cell.believed
        if believed.is_load_doubted and believed.cone_source is not None:
            loaded = cell.sources[believed.cone_source]
            yield from cell.move_to(loaded.station)
            yield from empty_into(cell, loaded)
        self._require_clean(cell)
        in_mortar_mg = believed.sources_mg[source.name]
        if in_mortar_mg < NOTHING_LEFT_MG:
            raise SkillFailed(Code.SOURCE_EMPTY, f"'{source.name}' is believed to hold {in_mortar_mg:.0f} mg")
        stroke = self._choose_stroke(cell, in_mortar_mg)
        yield from cell.move_to(source.station)
        believed.touched(source)
        yield from cell.hand.morph(stroke.open_mm)
        press, *follow = self._poses(cell, stroke)
        yield from cell.touch([press], self.speed_mm_per_s, source.station)
        path = cell.contact(follow, self.speed_mm_per_s, source.station)
        cell.hand.start_morph(stroke.closed_mm, path.duration_s)
        yield from cell.arm.follow(path)
        yield from cell.hand.morph(stroke.closed_mm)
        yield from cell.touch([cell.place(source.station)], self.speed_mm_per_s, source.station)
        yield from cell.hand.morph(MOUNTED_DIAMETER_MM)
        return self._believe(cell, stroke, in_mortar_mg)

    def settle(self, cell: Cell) -> Steps[None]:
        """Out of the mortar, straight up; what the cone may hold goes back into it, so that nothing is unknown."""
        source, believed = self.source, cell.believed
        above_mm = cell.places_mm[source.station]
        aside_mm = math.dist(cell.apex_mm()[:2], above_mm[:2])
        if aside_mm > source.mortar.bore_mm / 2:
            return
        believed.touched(source)
        yield from cell.touch([cell.place(source.station)], self.speed_mm_per_s, source.station)
        yield from cell.hand.morph(MOUNTED_DIAMETER_MM)
        held_mg = believed.cone_mg
        believed.cone_holds(source, source.powder.load_limit_mg)
        yield from empty_cone(cell)
        believed.returned(source.name, held_mg)
        cell.record.event(Returned(source=source.name, expected_mg=held_mg))

    def _require_clean(self, cell: Cell) -> None:
        believed = cell.believed
        if believed.sheet not in (None, self.source.sheet_key):
            raise SkillFailed(
                Code.HAND_WRONG_POWDER, f"the sheet has touched {believed.sheet}, not {self.source.sheet_key}"
            )
        if believed.cone_source not in (None, self.source.name) and believed.cone_mg > 0:
            raise SkillFailed(Code.HAND_WRONG_POWDER, f"the cone still holds powder from '{believed.cone_source}'")

    def _choose_stroke(self, cell: Cell, in_mortar_mg: float) -> Stroke:
        """The rim as wide as the bed; narrower, and then a shorter stroke, where that would overload the cone."""
        mortar, powder = self.source.mortar, self.source.powder
        bed_mm = bed_diameter_mm(mortar, in_mortar_mg, powder.bulk_density_mg_per_mm3)
        room_mg = LOAD_AIM * powder.load_limit_mg - cell.believed.cone_mg
        share = max(0.0, room_mg) / (BEST_SHARE * in_mortar_mg)
        widest_mm = min(mortar.bore_mm, 2 * cell.spec.hand.sheet_radius_mm) - WALL_GAP_MM
        wanted_mm = bed_mm * math.sqrt(share) if share < 1.0 else bed_mm + BED_GAP_MM
        open_mm = min(widest_mm, max(NARROWEST_MM, wanted_mm))
        reach = min(1.0, (open_mm / bed_mm) ** 2)
        stroke_mm = STROKE_MM if share >= reach else FULL_STROKE_MM * share / reach
        bowl_mm = mortar.bowl_radius_mm
        room_deg = math.degrees(math.asin(mortar.bore_mm / 2 / bowl_mm) - math.asin(open_mm / 2 / bowl_mm))
        return Stroke(open_mm, open_mm - stroke_mm, min(MAX_SWING_DEG, max(0.0, room_deg - 2.0)))

    def _poses(self, cell: Cell, stroke: Stroke) -> Iterator[ApexPose]:
        """The apex pressed onto the wall, then along the stroke; poses of the cone swinging about the bowl's centre."""
        mortar = self.source.mortar
        x_mm, y_mm, z_mm = cell.spec.stations[self.source.station].position_mm
        bottom_mm = z_mm + mortar.height_mm - mortar.depth_mm
        centre = np.array([x_mm, y_mm, bottom_mm + mortar.bowl_radius_mm])
        outward = np.array([x_mm, y_mm, 0.0]) / math.hypot(x_mm, y_mm)
        for done in np.linspace(0.0, 1.0, STROKE_POINTS):
            diameter_mm = stroke.open_mm + (stroke.closed_mm - stroke.open_mm) * done
            rest_mm = Cone(diameter_mm, cell.spec.hand.sheet_radius_mm).resting_apex_mm(mortar)
            swing = math.radians(stroke.swing_deg * (1.0 - done))
            axis = math.cos(swing) * np.array([0.0, 0.0, 1.0]) + math.sin(swing) * outward
            reach_mm = mortar.bowl_radius_mm - rest_mm + self.over_travel_mm
            yield ApexPose((centre - reach_mm * axis) / 1000, axis)

    def _believe(self, cell: Cell, stroke: Stroke, in_mortar_mg: float) -> float:
        """What the stroke should have collected, kept as what the cone and the mortar are believed to hold."""
        source, believed = self.source, cell.believed
        bed_mm = bed_diameter_mm(source.mortar, in_mortar_mg, source.powder.bulk_density_mg_per_mm3)
        share = collected_share(stroke.open_mm, stroke.closed_mm, self.over_travel_mm, bed_mm)
        before_mg = believed.cone_mg
        believed.scooped(source, share * in_mortar_mg)
        cell.record.event(
            Scooped(
                source=source.name,
                expected_mg=believed.cone_mg - before_mg,
                open_mm=stroke.open_mm,
                closed_mm=stroke.closed_mm,
                swing_deg=stroke.swing_deg,
            )
        )
        return believed.cone_mg
