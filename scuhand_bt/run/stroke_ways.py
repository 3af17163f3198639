"""The strokes that a run makes in a mortar, chosen as the skill does, and whether the arm can make them."""

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from scuhand_bt.cell.scooping import planned_out, planned_stroke
from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.device_specs.hand import MOUNTED_DIAMETER_MM
from scuhand_bt.dosing.beds import bed_for, expected_mg, strokes_in
from scuhand_bt.dosing.cone import Cone
from scuhand_bt.dosing.jars import COUNTED_ON_DEG, SIZES_MM, WIDEST_MM, JarBed, sure_doses
from scuhand_bt.dosing.ladle import LIP_GAP_MM, Ladle, NoStrokeError, Stroke
from scuhand_bt.dosing.strokes import LOAD_AIM, scooped_for_mg
from scuhand_bt.dosing.swing import stroke_path
from scuhand_bt.dosing.vessel import Vessel
from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.quantity import format_mass
from scuhand_bt.recipe.demand import Demand
from scuhand_bt.specs import Source

if TYPE_CHECKING:
    from scuhand_bt.motion import MotionPlanner

STEP_DEG = 30
"""Step between the directions in which a stroke is looked for [deg]."""
LEAST_BED_MG = 30.0
"""A mortar with less than this is not scooped any more."""
WORTH_SHARE = 0.01
"""A stroke is to bring at least this share of bed and load limit, or `LEAST_BED_MG`. A run takes less to mean that the
mortar is empty."""

FIRST_SHARE = 0.08
"""A first stroke must bring at least this share of bed and load limit, or all that is needed. In dry runs of 8 doses of
500 mg of MSG, bowls of 55 to 58 mm (share 0.01 to 0.07) gave at most one dose. One of 60 mm (0.12) gave five."""
POOR_SHARE, POOR_DOSES = 0.15, 2.0
"""Below this share, and below this many of the largest dose, doses take several scoops each. By the height field, for
8 doses of 500 mg from 6 g: in a bowl of 60 and 20 mm (share 0.12 for MSG, 0.10 for titanium dioxide) the last four
doses take 8 and 12 scoops (22 in a dry run); in one of 62 and 21 mm (0.22, 0.19) 4 and 2."""


class MortarCannotBeScooped(SkillFailed):
    """What is in this `source` cannot be scooped, wherever it stands."""

    def __init__(self, source: str, why: str) -> None:
        super().__init__(Code.ARM_NO_PATH, f"'{source}' cannot be scooped from: {why}")
        self.source, self.why = source, why


def require_first(cell: CellSpec, demand: Demand) -> None:
    """Raises MortarCannotBeScooped if the first stroke in the bed that a plan begins with brings too little.

    Also if no stroke could be made after a refill.
    """
    source = demand.source
    worth_mg = FIRST_SHARE * _at_once_mg(source)
    stroke_worth(cell, source, source.amount_mg, min(worth_mg, demand.needed_mg))
    if demand.refilled_mg is not None:
        try:
            stroke_in(cell, source, demand.refilled_mg)
        except MortarCannotBeScooped as failure:
            raise MortarCannotBeScooped(source.name, f"once it is refilled, {failure.why}") from None


def poor_first_mg(cell: CellSpec, source: Source, largest_mg: float) -> float | None:
    """What the first stroke brings, if doses (of `largest_mg` at most) then take several scoops each.

    None if it brings more, or if no stroke is possible.
    """
    try:
        _, brings_mg = _first(cell, source, source.amount_mg)
    except ValueError:  # no stroke, or an impossible vessel, which is reported where it is written
        return None
    return brings_mg if brings_mg < min(POOR_SHARE * _at_once_mg(source), POOR_DOSES * largest_mg) else None


def one_load_mg(cell: CellSpec, source: Source, bed_mg: float) -> float | None:
    """What one scoop should bring from such a bed, if level; None if no stroke is possible."""
    try:
        _, brings_mg = _first(cell, source, bed_mg)
    except ValueError:  # as above
        return None
    return min(brings_mg, LOAD_AIM * source.powder.load_limit_mg)


def _at_once_mg(source: Source) -> float:
    """The most that a first stroke could bring."""
    return min(source.amount_mg, source.powder.load_limit_mg)


def stroke_worth(cell: CellSpec, source: Source, bed_mg: float, worth_mg: float) -> Stroke:
    """The stroke made in such a bed. Raises MortarCannotBeScooped, with a remedy, if it brings less than `worth_mg`."""
    is_jar = source.mortar.corner_mm is not None
    try:
        stroke, brings_mg = _first(cell, source, bed_mg)
    except NoStrokeError as error:
        why = str(error)
    else:
        if brings_mg >= worth_mg:
            return stroke
        brings = f"a stroke brings only {format_mass(brings_mg)} of {format_mass(bed_mg)}"
        why = f"{brings} in this jar; fill in more, or take a mortar"
        if not is_jar:
            why = f"{brings} in this bowl, without a heap over its edge"
    if not is_jar:  # for a jar, `why` has the remedy
        why += _would_do(cell, source, bed_mg, worth_mg)
    raise MortarCannotBeScooped(source.name, why)


def _would_do(cell: CellSpec, source: Source, bed_mg: float, worth_mg: float) -> str:
    """The nearest bore, depth and smaller filling with which a stroke would bring enough, as text; "" if none would."""
    bowl = source.mortar
    wall_mm = bowl.outer_diameter_mm - bowl.bore_mm

    def is_worth(bore_mm: float, depth_mm: float, bed_mg: float = bed_mg) -> bool:
        sizes = {"bore_mm": bore_mm, "depth_mm": depth_mm, "outer_diameter_mm": bore_mm + wall_mm}
        other = source.model_copy(update={"mortar": bowl.model_copy(update=sizes)})
        try:
            return bed_mg <= other.capacity_mg and _first(cell, other, bed_mg)[1] >= worth_mg
        except NoStrokeError:
            return False

    bores_mm = np.arange(bowl.bore_mm, WIDEST_MM, SIZES_MM) + SIZES_MM
    depths_mm = np.arange(SIZES_MM, bowl.bore_mm / 2, SIZES_MM)
    nearest_mm = sorted(depths_mm.tolist(), key=lambda depth_mm: abs(depth_mm - bowl.depth_mm))
    bore_mm = next((mm for mm in bores_mm.tolist() if is_worth(mm, bowl.depth_mm)), None)
    depth_mm = next((mm for mm in nearest_mm if is_worth(bowl.bore_mm, mm)), None)
    lesser_mg = (share / 100 * bed_mg for share in range(95, 0, -5))
    less_mg = next((mg for mg in lesser_mg if is_worth(bowl.bore_mm, bowl.depth_mm, mg)), None)
    would = [f"a bore of {bore_mm:g} mm (if there is room for it)"] if bore_mm is not None else []
    would += [f"a depth of {depth_mm:g} mm"] if depth_mm is not None else []
    would += [f"{format_mass(less_mg)} in it"] if less_mg is not None else []
    return f"; {' or '.join(would)} would do" if would else ""


def _first(cell: CellSpec, source: Source, bed_mg: float) -> tuple[Stroke, float]:
    """The first stroke in such a bed, and what it should bring. Raises NoStrokeError if there is none."""
    ladle = Ladle.of(cell.hand)
    bed = bed_for(source.mortar, bed_mg, source.powder, ladle)
    stroke = next(strokes_in(bed, ladle, source.powder.load_limit_mg, [0.0]))
    return stroke, expected_mg(stroke, bed, ladle.slant_mm)


def wishes_mg(demand: Demand) -> list[float]:
    """How much scoops of a plan are to bring: the load limit, and what the smallest dose asks for."""
    source, limit_mg = demand.source, demand.source.powder.load_limit_mg
    least_mg = scooped_for_mg(min(demand.doses_mg), source.powder, is_discarded=source.is_discarded)
    return list(dict.fromkeys([limit_mg, min(limit_mg, least_mg)]))


def stroke_in(cell: CellSpec, source: Source, bed_mg: float) -> Stroke:
    """The stroke made in a bed on a plan's way through a mortar. Raises MortarCannotBeScooped if it brings nothing."""
    worth_mg = min(LEAST_BED_MG, WORTH_SHARE * min(bed_mg, source.powder.load_limit_mg))
    return stroke_worth(cell, source, bed_mg, worth_mg)


def strokes_along(
    cell: CellSpec, source: Source, bed_mg: float, wanted_mg: float, along_deg: Sequence[float]
) -> Iterator[Stroke]:
    """The strokes tried in such a bed to bring `wanted_mg`. MortarCannotBeScooped if they would bring nothing."""
    stroke_in(cell, source, bed_mg)
    ladle = Ladle.of(cell.hand)
    bed = bed_for(source.mortar, bed_mg, source.powder, ladle)
    return strokes_in(bed, ladle, wanted_mg, along_deg)


def strokes_in_jar(motion: "MotionPlanner", cell: CellSpec, demand: Demand) -> None:
    """Plan the strokes in a jar for a plan's doses (until its first refill), as the skill chooses them.

    Raises SkillFailed arm.* if the arm can make none; MortarCannotBeScooped if those that it can make are not sure to
    bring all doses, or fewer than the plan counts on before the first refill.
    """
    source, why_not = demand.source, dict[tuple[float, bool], str]()

    def arm_can(stroke: Stroke) -> bool:
        way = stroke.heading_deg, stroke.gap_mm <= LIP_GAP_MM  # with the lip on the floor the hand is nearest the wall
        if way not in why_not:
            why_not[way] = ""
            try:
                swing_and_out(motion, cell, source, stroke)
            except (NoStrokeError, SkillFailed) as error:
                why_not[way] = str(error)
        return not why_not[way]

    everywhere_deg = list(headings_deg(cell, source.station))
    jar = JarBed(source.mortar, source.amount_mg, source.powder, Ladle.of(cell.hand))
    doses_mg = demand.doses_mg
    if source.refill_mg is not None:
        doses_mg = doses_mg[: max(1, sure_doses(jar, doses_mg, COUNTED_ON_DEG, is_discarded=source.is_discarded))]
    sure = sure_doses(jar, doses_mg, everywhere_deg, is_discarded=source.is_discarded, may_be=arm_can)
    if why_not and all(why_not.values()):
        why = why_not[min(why_not, key=lambda way: everywhere_deg.index(way[0]))]
        raise SkillFailed(Code.ARM_NO_PATH, f"at '{source.station}' no stroke is possible in any direction: {why}")
    if sure < len(doses_mg):
        brings = f"{sure} of its doses ({format_mass(sum(doses_mg[:sure]))})"
        of = f"of {format_mass(source.amount_mg)} in this jar"
        needed = f"{len(doses_mg)} ({format_mass(sum(doses_mg))}) are needed"
        needed += " before it is refilled" if source.refill_mg is not None else ""
        gone, returned = "", "Fill"
        if source.is_discarded:
            gone = ", and what is left of each load is thrown away"
            if sure_doses(jar, doses_mg, everywhere_deg, is_discarded=False, may_be=arm_can) == len(doses_mg):
                returned = "Write `leftover: return`, with which all doses are sure, fill"
        raise MortarCannotBeScooped(
            source.name,
            f"the strokes that the arm can make at '{source.station}' are sure to bring {brings} {of}, but {needed}"
            f"{gone}. The rest lies in front of the wall and beside the strokes. {returned} in more, take a mortar, or "
            "a place where the arm can make strokes in more directions (`scuhand-bt reach --task scoop`)",
        )


def headings_deg(cell: CellSpec, station: str) -> Iterator[float]:
    """The directions of strokes in a mortar, about the vertical from x [deg]; the one across the arm's reach first."""
    x_mm, y_mm, _ = cell.stations[station].position_mm
    across_deg = math.degrees(math.atan2(y_mm, x_mm)) + 90.0
    for turn_deg in range(0, 360, STEP_DEG):
        yield (across_deg + turn_deg) % 360.0


def swing_and_out(
    motion: "MotionPlanner", cell: CellSpec, source: Source, stroke: Stroke, *, is_brief: bool = False
) -> float:
    """Plan a stroke, its load's way to the mortar's place, and opening the cone. Returns the swing's duration [s].

    `is_brief`: search only briefly for the load's way. Raises NoStrokeError or SkillFailed arm.* if one of these is
    not possible.
    """
    path = stroke_path(Vessel.of(source.mortar), stroke, Ladle.of(cell.hand))
    try:
        begin = motion.standing_at(source.station)
        swing = planned_stroke(motion, begin, path, cell, source.station, source.mortar)
        rim_mm = float(path.rim_mm[-1])
        motion.set_geometry(rim_mm / 1000)
        there = planned_out(motion, swing, cell, source, rim_mm, is_brief=is_brief).end
        motion.reform(
            there,
            source.station,
            MOUNTED_DIAMETER_MM,
            lambda rim_mm: math.radians(Cone(rim_mm, cell.hand.sheet_radius_mm).roller_deg(cell.hand)),
        )
    finally:
        motion.set_geometry()
    return swing.duration_s
