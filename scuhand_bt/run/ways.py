"""All that a plan will ask of the arm, found possible before it moves.

Between all places: empty past each container; with a fresh sheet's cone, where that is another than loads are carried
in; with the heaviest load from each mortar to each container and to where it is discarded, which are the ways back too;
straight down where a workflow says so; and for each mortar a stroke, in some direction, in the bed that the plan begins
with and in the one that it leaves, with the way out of it.
"""

import itertools
import math
from collections.abc import Collection, Sequence

import numpy as np

from scuhand_bt.bench_spec import Obstacle, Point, Station, turned
from scuhand_bt.cell.carrying import carrying_limit_deg
from scuhand_bt.cell.places import all_places, over_balance
from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.device_specs.hand import MOUNTED_DIAMETER_MM
from scuhand_bt.dosing.ladle import NoStrokeError, Stroke
from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.motion import ApexPose, MotionPlanner
from scuhand_bt.motion.cell_solids import are_in_each_other, full_mortar, solids_of
from scuhand_bt.recipe.demand import Demand
from scuhand_bt.recipe.plan import Plan
from scuhand_bt.run.stroke_ways import (
    LEAST_BED_MG,
    MortarCannotBeScooped,
    headings_deg,
    require_first,
    strokes_along,
    strokes_in_jar,
    swing_and_out,
    wishes_mg,
)
from scuhand_bt.specs import ContainerKind, Mortar, Source

LOWERING_M_PER_S = 0.06
OUT_MM, TURNS_DEG = (280.0, 310.0, 340.0), (35.0, 50.0, 65.0, 80.0)
"""Where a mortar may stand that lacks a way where it does: from the arm's base, and aside of straight ahead."""
STANDS_MM = (20.0, 40.0)
"""Or on a stand, as high as this, where it is: handle and wrist come low beside a mortar that is flat and thin."""
BESIDE_MM, STOOD_ON_MM = 10.0, 1.0
"""What it is to be clear of what stands beside it; and what comes no higher than that is under it."""


class MortarStandsBadly(SkillFailed):
    """A mortar, at this `station`, cannot be scooped from, stood over, or carried from."""

    def __init__(self, code: str, detail: str, station: str) -> None:
        super().__init__(code, detail)
        self.station = station


def prepare_ways(motion: MotionPlanner, plan: Plan, cell: CellSpec, kinds: Sequence[ContainerKind]) -> None:
    """Plan all of them; SkillFailed arm.* for one that there is not.

    MortarStandsBadly says where that mortar might stand instead: what is proposed has all the ways. No place helps
    where MortarCannotBeScooped is raised.
    """
    scooped = [demand for demand in plan.demands if demand.needed_mg > 0]
    for demand in scooped:
        require_first(cell, demand)
    try:
        _ways(motion, plan, cell, kinds, scooped)
    except MortarCannotBeScooped:
        raise
    except SkillFailed:
        motion.patience_s = 0.0  # from now on only whether there is a way counts, and not how quick it is
        lacks = [_lacks(motion, cell, kinds, demand) for demand in scooped]
        badly = [(demand, lack) for demand, lack in zip(scooped, lacks, strict=True) if lack is not None]
        if not badly:
            raise
        (first, why), *others = badly
        left_out = {demand.source.station for demand, _ in others}
        rest = [demand for demand, lack in zip(scooped, lacks, strict=True) if lack is None]
        where = _elsewhere(motion, plan, cell, kinds, [first, *rest], left_out)
        raise MortarStandsBadly(why.code, f"{why.detail}. {where}", first.source.station) from None


def _carries(cell: CellSpec, source: Source, kinds: Sequence[ContainerKind]) -> list[tuple[str, str, float]]:
    """From a mortar and to where its powder goes, with the spill limit [deg] of the heaviest load."""
    goes_to = [*(over_balance(cell, kind)[0] for kind in kinds), *_discarding(cell, source)]
    return [(source.station, place, _limit_deg(cell, source)) for place in dict.fromkeys(goes_to)]


def _lacks(motion: MotionPlanner, cell: CellSpec, kinds: Sequence[ContainerKind], demand: Demand) -> SkillFailed | None:
    """Why a mortar, where it stands, cannot be stood over, carried from, or scooped from; None where it can."""
    source = demand.source
    try:
        motion.set_geometry()
        for station, place, limit_deg in _carries(cell, source, kinds):
            motion.move(motion.standing_at(station), place, spill_limit_deg=limit_deg)
        _strokes(motion, cell, demand)
    except SkillFailed as failure:
        return failure
    return None


def _beds_mg(demand: Demand) -> list[float]:
    """What the plan begins with in a mortar, what a refill brings it to, and what it leaves."""
    amount_mg = demand.source.amount_mg
    left_mg = max(amount_mg - demand.needed_mg, LEAST_BED_MG)
    return list(dict.fromkeys([amount_mg, demand.refilled_mg or amount_mg, left_mg]))


def _ways(
    motion: MotionPlanner, plan: Plan, cell: CellSpec, kinds: Sequence[ContainerKind], scooped: Sequence[Demand]
) -> None:
    """All ways of a plan that scoops so much; SkillFailed for one that there is not."""
    motion.set_geometry()
    for demand in scooped:  # mostly what fails, and soon known beside all ways between places
        _strokes(motion, cell, demand)
    pans = [(kind, over_balance(cell, kind)[0]) for kind in kinds]
    limits_deg = {demand.source.name: _limit_deg(cell, demand.source) for demand in scooped}
    motion.prepare(pans, [carry for demand in scooped for carry in _carries(cell, demand.source, kinds)])
    _with_fresh_sheet(motion, cell, pans)
    for (kind, place), demand in itertools.product(pans, scooped):
        motion.set_geometry(container=kind)
        begin, limit_deg = motion.standing_at(demand.source.station), limits_deg[demand.source.name]
        for from_above_mm in sorted(above_mm for over, above_mm in plan.descents if over == place):
            down = motion.descent(place, from_above_mm / 1000, LOWERING_M_PER_S, limit_deg)
            motion.move(begin, down.start, spill_limit_deg=limit_deg)
    motion.set_geometry()


def _limit_deg(cell: CellSpec, source: Source) -> float:
    """Of the heaviest load."""
    return carrying_limit_deg(cell, source.powder, source.powder.load_limit_mg, MOUNTED_DIAMETER_MM)


def _discarding(cell: CellSpec, source: Source) -> list[str]:
    if not source.is_discarded:
        return []
    return [source.leftover_to or cell.station_of_kind("waste").name]


def _with_fresh_sheet(motion: MotionPlanner, cell: CellSpec, pans: Sequence[tuple[ContainerKind, str]]) -> None:
    """A fresh sheet's cone goes everywhere but over a container: loads are carried in another."""
    fresh_mm, over = cell.hand.options.start_diameter_mm, {place for _, place in pans}
    if fresh_mm == MOUNTED_DIAMETER_MM:
        return
    for kind in (None, *(kind for kind, _ in pans)):
        motion.set_geometry(fresh_mm / 1000, kind)
        for first, second in itertools.combinations([name for name in motion.places if name not in over], 2):
            motion.move(motion.standing_at(first), second)
    motion.set_geometry()


def _strokes(motion: MotionPlanner, cell: CellSpec, demand: Demand) -> None:
    """In a mortar the first strokes that may be made and the last; in a jar as many as should bring what is needed."""
    if demand.source.mortar.corner_mm is not None:
        strokes_in_jar(motion, cell, demand)
        return
    for bed_mg, wanted_mg in _asked_mg(demand):
        _stroke(motion, cell, demand.source, bed_mg, wanted_mg)


def _strokes_there(motion: MotionPlanner, cell: CellSpec, demand: Demand, asked_mg: list[tuple[float, float]]) -> None:
    """Those of a bowl at one of several places: what fails comes first in `asked_mg`, for the next one."""
    for number, (bed_mg, wanted_mg) in enumerate(asked_mg):
        try:
            _stroke(motion, cell, demand.source, bed_mg, wanted_mg)
        except SkillFailed:
            asked_mg.insert(0, asked_mg.pop(number))
            raise


def _asked_mg(demand: Demand) -> list[tuple[float, float]]:
    """The beds of a bowl, and what is wanted of each."""
    return list(itertools.product(_beds_mg(demand), wishes_mg(demand)))


def _stroke(motion: MotionPlanner, cell: CellSpec, source: Source, bed_mg: float, wanted_mg: float) -> None:
    """A stroke in some direction, and from its end to where loads are carried from: at length only where that is not
    soon found for any.
    """
    why, tried = "", list[Stroke]()

    def is_possible(stroke: Stroke, *, is_brief: bool) -> bool:
        nonlocal why
        try:
            swing_and_out(motion, cell, source, stroke, is_brief=is_brief)
        except (NoStrokeError, SkillFailed) as error:
            why = why or str(error)
            return False
        return True

    for stroke in strokes_along(cell, source, bed_mg, wanted_mg, list(headings_deg(cell, source.station))):
        if is_possible(stroke, is_brief=True):
            return
        tried.append(stroke)
    if any(is_possible(stroke, is_brief=False) for stroke in tried):
        return
    where = f"at '{source.station}' no stroke is possible in any direction"
    raise SkillFailed(Code.ARM_NO_PATH, f"{where}: {why}")


def _elsewhere(
    motion: MotionPlanner,
    plan: Plan,
    cell: CellSpec,
    kinds: Sequence[ContainerKind],
    scooped: Sequence[Demand],
    left_out: Collection[str],
) -> str:
    """Where the first one's mortar might stand, of some places about the arm the nearest that has all ways, or else
    where it is, higher; a sentence.

    All are looked at with the mortar there: strokes, loads carried to the pan, and the same for the others. To the
    stations that are left out, which are to be moved as well, nothing has a way.
    """
    source = scooped[0].source
    station = cell.stations[source.station]
    x_mm, y_mm, z_mm = station.position_mm
    places = [
        (
            round(out_mm * math.cos(math.radians(turn_deg)), -1),
            round(out_mm * math.sin(math.radians(turn_deg)), -1),
            z_mm,
        )
        for out_mm, turn_deg in itertools.product(OUT_MM, (*TURNS_DEG, *(-turn_deg for turn_deg in TURNS_DEG)))
    ]
    places.sort(key=lambda place_mm: math.dist(place_mm, station.position_mm))
    asked_mg = [] if source.mortar.corner_mm is not None else _asked_mg(scooped[0])
    for wished_mm in (*places, *((x_mm, y_mm, z_mm + stand_mm) for stand_mm in STANDS_MM)):
        written_mm, place_mm = _as_written(station, wished_mm)
        if not _has_room(cell, station.name, place_mm, source):
            continue
        there = station.model_copy(update={"position_mm": place_mm})
        moved = cell.model_copy(update={"stations": {**cell.stations, station.name: there}})
        sources = plan.recipe.sources
        planner = MotionPlanner(motion.urdf, moved, {one.station: one.mortar for one in sources.values()})
        planner.patience_s = motion.patience_s
        gone_to = {name: one for name, one in sources.items() if one.station not in left_out}
        try:
            for name, position_mm in all_places(moved, gone_to, kinds).items():
                planner.add_place(name, ApexPose(np.array(position_mm) / 1000))
            _strokes_there(planner, moved, scooped[0], asked_mg)
            _ways(planner, plan, moved, kinds, scooped)
        except MortarCannotBeScooped:
            raise
        except SkillFailed:
            continue
        at = ", ".join(f"{mm:g} mm" for mm in written_mm)
        return f"With '{station.name}' at [{at}] it can scoop there, and carry what it has scooped to where it goes"
    return f"'{station.name}' may be at none of the places that were tried: look at `scuhand-bt reach --task scoop`"


def _as_written(station: Station, place_mm: Point) -> tuple[Point, Point]:
    """How the cell's file has a place for a station, to 0.1 mm, and where what is written there really is."""
    if (frame := station.of_frame) is None:
        return place_mm, place_mm
    x_mm, y_mm, z_mm = (round(mm, 1) + 0.0 for mm in frame.written_mm(place_mm))
    return (x_mm, y_mm, z_mm), frame.moved_mm((x_mm, y_mm, z_mm))


def _has_room(cell: CellSpec, name: str, place_mm: tuple[float, float, float], source: Source) -> bool:
    """Whether the mortar there would be clear of other stations, and of what stands as high as it does."""
    half_mm = source.mortar.outer_diameter_mm / 2 + BESIDE_MM
    for other in cell.stations.values():
        if (
            other.name != name
            and other.kind in ("mortar", "waste")
            and math.dist(other.position_mm[:2], place_mm[:2]) < (2 * half_mm)
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
        x_mm, y_mm = turned(*aside_mm, -math.radians(solid.yaw_deg))  # as a box lies
        if is_as_high and abs(x_mm) < wide_mm / 2 + half_mm and abs(y_mm) < deep_mm / 2 + half_mm:
            return False
    return True


def _stands_in_mesh(solid: Obstacle, place_mm: Point, mortar: Mortar) -> bool:
    """Whether its surface is where the mortar would be, but for what that stands on.

    In one that encloses it no way of the arm is found.
    """
    x_mm, y_mm, z_mm = place_mm
    there = Station(name="there", kind="mortar", position_mm=(x_mm, y_mm, z_mm + STOOD_ON_MM))
    height_mm = mortar.height_mm - STOOD_ON_MM
    wide = {"outer_diameter_mm": mortar.outer_diameter_mm + 2 * BESIDE_MM, "height_mm": height_mm}
    (surface,) = solids_of([solid])
    return are_in_each_other(full_mortar(there, mortar.model_copy(update=wide)), surface)
