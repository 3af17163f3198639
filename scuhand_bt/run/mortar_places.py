"""Where a badly placed mortar might stand instead: places around the arm, at its height or on a stand."""

import math
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from itertools import product

from scuhand_bt.bench_spec import Obstacle, Point, Station, turned
from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.motion.cell_solids import are_in_each_other, full_mortar, solids_of
from scuhand_bt.specs import Mortar, Source

OUT_MM, TURNS_DEG = (280.0, 310.0, 340.0), (35.0, 50.0, 65.0, 80.0)
"""Candidate places in polar coordinates: distance from the arm's base, and angle from straight ahead to either side."""
STANDS_MM, NEAREST = (20.0, 40.0), 8
"""Heights of stands to try, at the mortar's own place and the `NEAREST` others. Over a flat vessel the hand is low."""
BESIDE_MM, STOOD_ON_MM = 10.0, 1.0
"""The clearance that it needs beside other things; and the height up to which something counts as being under it."""


@dataclass(frozen=True)
class Place:
    """A candidate for a mortar's foot: as written in the cell's file, where that is, and how much higher than now."""

    station: str
    written_mm: Point
    really_mm: Point
    stand_mm: float
    is_elsewhere: bool = True

    def said(self) -> str:
        """As text, for whoever is to put the mortar there."""
        at = ", ".join(f"{mm:g} mm" for mm in self.written_mm)
        if not self.is_elsewhere:
            return f"'{self.station}' where it is"
        if not self.stand_mm:
            return f"'{self.station}' at [{at}]"
        is_on_table = self.written_mm[2] == self.stand_mm
        how = f"on a stand of {self.stand_mm:g} mm" if is_on_table else f"its foot {self.stand_mm:g} mm higher than now"
        return f"'{self.station}' at [{at}], {how},"


def places_for(cell: CellSpec, source: Source, others: Collection[Source], *, may_stay: bool) -> Iterator[Place]:
    """Candidates: the present place, others at its height from the nearest on, then ever higher stands.

    `others` are the sources whose mortars stand there meanwhile, of which it must be clear.
    """
    station = cell.stations[source.station]
    if may_stay and _has_room(cell, source, station.position_mm, others):
        yield Place(station.name, station.position_mm, station.position_mm, 0.0, is_elsewhere=False)
    x_mm, y_mm, z_mm = station.position_mm
    turns_deg = (*TURNS_DEG, *(-turn_deg for turn_deg in TURNS_DEG))
    aside_mm = [
        (round(out_mm * math.cos(turn_rad), -1), round(out_mm * math.sin(turn_rad), -1))
        for out_mm, turn_rad in product(OUT_MM, map(math.radians, turns_deg))
    ]
    aside_mm.sort(key=lambda there_mm: math.dist(there_mm, (x_mm, y_mm)))

    def with_room(there_mm: tuple[float, float], stand_mm: float) -> Iterator[Place]:
        written_mm, really_mm = _as_written(station, (*there_mm, z_mm + stand_mm))
        if _has_room(cell, source, really_mm, others):
            yield Place(station.name, written_mm, really_mm, stand_mm)

    nearest_mm = [(x_mm, y_mm)]
    for there_mm in aside_mm:
        for place in with_room(there_mm, 0.0):
            nearest_mm.append(there_mm)
            yield place
    for there_mm, stand_mm in product(nearest_mm[: 1 + NEAREST], STANDS_MM):
        yield from with_room(there_mm, stand_mm)


def _as_written(station: Station, place_mm: Point) -> tuple[Point, Point]:
    """How the cell's file writes a place for a station, rounded to 0.1 mm, and where that is."""
    if (frame := station.of_frame) is None:
        return place_mm, place_mm
    x_mm, y_mm, z_mm = (round(mm, 1) + 0.0 for mm in frame.written_mm(place_mm))
    return (x_mm, y_mm, z_mm), frame.moved_mm((x_mm, y_mm, z_mm))


def _has_room(cell: CellSpec, source: Source, place_mm: Point, others: Collection[Source]) -> bool:
    """Whether the mortar would be clear there of other stations, and of solids at its height.

    The mortars of `others` are known; at stations that the plan does not use, one as wide as this is assumed.
    """
    half_mm = source.mortar.outer_diameter_mm / 2 + BESIDE_MM
    halves_mm = {one.station: one.mortar.outer_diameter_mm / 2 + BESIDE_MM for one in others}
    for other in cell.stations.values():
        apart_mm = half_mm + halves_mm.get(other.name, half_mm)
        if (
            other.name != source.station
            and other.kind in ("mortar", "waste")
            and math.dist(other.position_mm[:2], place_mm[:2]) < apart_mm
        ):
            return False
    for solid in cell.geometry:
        if solid.box_mm is not None:
            wide_mm, deep_mm, high_mm = solid.box_mm
        elif solid.cylinder_mm is not None:
            (deep_mm, high_mm), wide_mm = solid.cylinder_mm, solid.cylinder_mm[0]
        else:
            if _stands_in_mesh(solid, place_mm, source.mortar):
                return False
            continue
        is_as_high = abs(solid.at_mm[2] - place_mm[2] - source.mortar.height_mm / 2) < (
            (high_mm + source.mortar.height_mm) / 2
        )
        aside_mm = (place_mm[0] - solid.at_mm[0], place_mm[1] - solid.at_mm[1])
        x_mm, y_mm = turned(*aside_mm, -math.radians(solid.yaw_deg))  # in the box's own frame
        if is_as_high and abs(x_mm) < wide_mm / 2 + half_mm and abs(y_mm) < deep_mm / 2 + half_mm:
            return False
    return True


def _stands_in_mesh(solid: Obstacle, place_mm: Point, mortar: Mortar) -> bool:
    """Whether the mesh's surface is where the mortar would be, apart from what it stands on.

    A mesh that encloses the mortar is not found here, but then the arm has no way to it.
    """
    x_mm, y_mm, z_mm = place_mm
    there = Station(name="there", kind="mortar", position_mm=(x_mm, y_mm, z_mm + STOOD_ON_MM))
    height_mm = mortar.height_mm - STOOD_ON_MM
    wide = {"outer_diameter_mm": mortar.outer_diameter_mm + 2 * BESIDE_MM, "height_mm": height_mm}
    (surface,) = solids_of([solid])
    return are_in_each_other(full_mortar(there, mortar.model_copy(update=wide)), surface)
