"""All that a plan will ask of the arm, found possible before it moves.

Between all places: empty past each container; with a fresh sheet's cone, where that is another than loads are carried
in; with the heaviest load from each mortar to each container and to where it is discarded, which are the ways back too;
straight down where a workflow says so; and for each mortar a stroke, in some direction, in the bed that the plan begins
with and in the one that it leaves, with the way out of it.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace

from scuhand_bt.cell.cell import carrying_limit_deg
from scuhand_bt.cell.places import over_balance
from scuhand_bt.cell.scooping import planned_stroke
from scuhand_bt.cell_spec import MOUNTED_DIAMETER_MM, CellSpec
from scuhand_bt.devices.interfaces import Joints
from scuhand_bt.dosing.cone import Cone
from scuhand_bt.dosing.strokes import Bed, chosen
from scuhand_bt.dosing.swing import Ladle, NoStrokeError, stroke_path
from scuhand_bt.dosing.vessel import Vessel
from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.motion import MotionPlanner
from scuhand_bt.recipe.plan import Plan
from scuhand_bt.specs import ContainerKind, Source

STEP_DEG = 30
"""Between the directions in which a stroke is looked for."""
LEAST_BED_MG = 30.0
"""Less in a mortar is not scooped any more."""
LOWERING_M_PER_S = 0.06


def prepare_ways(motion: MotionPlanner, plan: Plan, cell: CellSpec, kinds: Sequence[ContainerKind]) -> None:
    """Plan all of them; SkillFailed arm.* for one that there is not."""
    pans = [(kind, over_balance(cell, kind)[0]) for kind in kinds]
    scooped = [demand for demand in plan.demands if demand.needed_mg > 0]
    limits_deg = {demand.source.name: _limit_deg(cell, demand.source) for demand in scooped}
    carries = [
        (source.station, place, limits_deg[source.name])
        for source in (demand.source for demand in scooped)
        for place in dict.fromkeys([*(place for _, place in pans), *_discarding(cell, source)])
    ]
    motion.prepare(pans, carries)
    _with_fresh_sheet(motion, cell, pans)
    for (kind, place), demand in itertools.product(pans, scooped):
        motion.set_geometry(container=kind)
        begin, limit_deg = motion.standing_at(demand.source.station), limits_deg[demand.source.name]
        for from_above_mm in sorted(above_mm for over, above_mm in plan.descents if over == place):
            down = motion.descent(place, from_above_mm / 1000, LOWERING_M_PER_S, limit_deg)
            motion.move(begin, down.start, spill_limit_deg=limit_deg)
    motion.set_geometry()
    for demand in scooped:
        left_mg = demand.source.amount_mg - demand.needed_mg
        for bed_mg in dict.fromkeys([demand.source.amount_mg, max(left_mg, LEAST_BED_MG)]):
            _stroke(motion, cell, demand.source, bed_mg)


def _limit_deg(cell: CellSpec, source: Source) -> float:
    """Of the heaviest load."""
    return carrying_limit_deg(cell, source.powder, source.powder.load_limit_mg, MOUNTED_DIAMETER_MM)


def _discarding(cell: CellSpec, source: Source) -> list[str]:
    if source.leftover != "discard":
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


def _stroke(motion: MotionPlanner, cell: CellSpec, source: Source, bed_mg: float) -> None:
    """A stroke in some direction, and from its end to where loads are carried from."""
    hand, mortar = cell.hand, source.mortar
    try:
        stroke = chosen(Bed(mortar, bed_mg, source.powder), hand.sheet_radius_mm, source.powder.load_limit_mg)
    except NoStrokeError as error:
        raise SkillFailed(Code.ARM_NO_PATH, f"'{source.name}' cannot be scooped from: {error}") from None
    x_mm, y_mm, _ = cell.stations[source.station].position_mm
    across_deg = math.degrees(math.atan2(y_mm, x_mm)) + 90.0
    begin, why = motion.standing_at(source.station), ""
    for turn_deg in range(0, 360, STEP_DEG):
        try:
            turned = replace(stroke, heading_deg=(across_deg + turn_deg) % 360.0)
            path = stroke_path(Vessel.of(mortar), turned, Ladle.of(hand))
            swing = planned_stroke(motion, begin, path, cell, source.station, mortar)
            _out_of_mortar(motion, cell, source, swing.end[:-1], float(path.rim_mm[-1]))
        except (NoStrokeError, SkillFailed) as error:
            why = why or str(error)
        else:
            return
        finally:
            motion.set_geometry()
    where = f"at '{source.station}' no stroke of {stroke.open_mm:.0f} mm is possible in any direction"
    raise SkillFailed(Code.ARM_NO_PATH, f"{where}: {why}")


def _out_of_mortar(motion: MotionPlanner, cell: CellSpec, source: Source, end: Joints, rim_mm: float) -> None:
    motion.set_geometry(rim_mm / 1000)
    limit_deg = carrying_limit_deg(cell, source.powder, source.powder.load_limit_mg, rim_mm)
    there = motion.move(end, source.station, spill_limit_deg=limit_deg).end
    motion.reform(
        there,
        source.station,
        MOUNTED_DIAMETER_MM,
        lambda rim_mm: math.radians(Cone(rim_mm, cell.hand.sheet_radius_mm).roller_deg(cell.hand)),
    )
