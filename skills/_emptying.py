"""Empty the cone: what `return_leftover`, `discard`, `scoop` and `withdraw` share (docs/scoop.md, A stroke, step 1)."""

import math

import numpy as np

from scuhand_bt.device_specs.hand import MOUNTED_DIAMETER_MM
from scuhand_bt.motion import ApexPose
from scuhand_bt.motion.pouring import about_lip
from scuhand_bt.skill import Cell, Code, Discarded, Returned, SkillFailed, Source, Steps, pause

from ._opening import open_to_let_out

SHAKE_S = 3.0
"""Least time that a cone is shaken out, whatever it holds."""
SPARE = 2.0
"""Safety factor on the time that the learnt flow needs, as flow differs from load to load."""
DOUBT = 0.2
"""Share of the load limit by which the cone may hold more than believed: scoops vary."""
LONGEST_S = 300.0
"""And the longest."""
LEAVING_MM_PER_S = 60.0
LEAVING_TURNS_DEG = (0.0, 20.0, -20.0, 45.0, -45.0, 75.0, -75.0, 110.0, -110.0)
"""Turns of the cone about its own axis that are tried on the way out of a mortar."""
POURED_FROM_MM = 30.0
"""Height of the lip above the edge while the cone is poured out."""
POURING_DEG = (0.0, 20.0, 40.0, 60.0, 80.0)
"""Tilts of the axis on the way; between two of them the lip strays by some millimetres."""
POURING_MM_PER_S = 120.0
POURING_TURNS_DEG = (0.0, 90.0, -90.0, 60.0, -60.0)
"""Directions of pouring, from straight away from the arm. A mortar is poured into in the first one only."""
POURED_S = 1.0
"""Within this time all has slid out of a cone that is fully tilted."""


def empty_cone(cell: Cell, source: Source) -> Steps[None]:
    """Let all out through the valve: open it wide and vibrate for as long as the believed load needs."""
    yield from _shake_out(cell, source)
    cell.believed.emptied()


def _shake_out(cell: Cell, source: Source) -> Steps[None]:
    belief = cell.powder_beliefs.get(source.sheet_key, source.powder.belief)
    opening_mm = cell.spec.hand.max_opening_mm
    flow_mg_per_s = belief.coefficient * max(opening_mm - belief.threshold_mm, 0.1) ** belief.exponent
    most_mg = cell.believed.cone_mg + DOUBT * source.powder.load_limit_mg
    duration_s = min(LONGEST_S, SHAKE_S + SPARE * most_mg / flow_mg_per_s)
    while duration_s > 0.0:
        dwell_s = min(duration_s, cell.hand.longest_dwell_s)
        yield from cell.right_of_way.go(shaking=True)
        yield from cell.hand.pulse(opening_mm, dwell_s, vibration=1.0)
        duration_s -= dwell_s


def is_over(cell: Cell, source: Source) -> bool:
    """Whether the cone is in this source's mortar, or above it."""
    above_mm = cell.places_mm[source.station]
    return math.dist(cell.apex_mm()[:2], above_mm[:2]) <= source.mortar.bore_mm


def out_of_mortar(cell: Cell) -> Steps[None]:
    """Leave the mortar in which an earlier scoop was halted, as by a `timeout`, before anything else is done."""
    for source in under_the_cone(cell):
        if _dips_into(cell, source):
            yield from leave_mortar(cell, source)
            return


def _dips_into(cell: Cell, source: Source) -> bool:
    """Whether the cone's apex or lip is below this mortar's edge."""
    apex, rim_mm = cell.apex(), cell.hand.cone_diameter_mm / 2.0
    along_mm = math.sqrt(cell.spec.hand.sheet_radius_mm**2 - rim_mm**2)
    lip_mm = along_mm * apex.axis[2] - rim_mm * math.sqrt(max(0.0, 1.0 - apex.axis[2] ** 2))
    edge_mm = cell.spec.stations[source.station].position_mm[2] + source.mortar.height_mm
    return cell.apex_mm()[2] + min(0.0, lip_mm) < edge_mm


def under_the_cone(cell: Cell) -> list[Source]:
    """Sources whose mortar the cone is in or above, nearest first, of the lot that the sheet has touched.

    A scoop notes its lot before it goes in, and a stroke keeps the cone's mouth over its own mortar. So of mortars side
    by side the first one is that of a halted scoop.
    """
    over = [one for one in cell.sources.values() if one.sheet_key == cell.believed.sheet and is_over(cell, one)]
    return sorted(over, key=lambda source: _aside_mm(cell, source))


def _aside_mm(cell: Cell, source: Source) -> float:
    """Horizontal distance in mm from the middle of the cone's mouth to the middle of this source's mortar."""
    apex, rim_mm, slant_mm = cell.apex(), cell.hand.cone_diameter_mm, cell.spec.hand.sheet_radius_mm
    mouth_mm = 1000.0 * apex.position_m + math.sqrt(slant_mm**2 - (rim_mm / 2) ** 2) * apex.axis
    return math.dist(mouth_mm[:2].tolist(), cell.places_mm[source.station][:2])


def leave_mortar(cell: Cell, source: Source) -> Steps[None]:
    """Lift the cone straight up out of a mortar in which a scoop was halted, and let what it may hold back in."""
    believed = cell.believed
    believed.touched(source)
    for way in _ways_up(cell, source):
        try:
            yield from cell.touch(way, LEAVING_MM_PER_S, source.station)
            break
        except SkillFailed as failure:
            if failure.code not in (Code.ARM_NO_PATH, Code.ARM_UNREACHABLE):
                raise
    if len(way) == 1:  # only up, or no straight line was possible: a straight wrist has none
        yield from cell.move_to(source.station)
    yield from cell.right_of_way.go()
    yield from cell.hand.morph(MOUNTED_DIAMETER_MM)
    held_mg = believed.cone_mg
    most_mg = min(source.powder.load_limit_mg, held_mg + believed.sources_mg[source.name])
    believed.source_holds(source.name, held_mg + believed.sources_mg[source.name] - most_mg)
    # A run that stops from here on knows of a loaded cone, and makes no powder from nothing.
    believed.cone_holds(source, most_mg)
    yield from empty_cone(cell, source)
    believed.returned(source.name, most_mg)
    cell.record.event(Returned(source=source.name, expected_mg=held_mg))


def _ways_up(cell: Cell, source: Source) -> list[list[ApexPose]]:
    """Ways out of a mortar, best first: up, upright there, and to its place; upright on the way; or only up.

    Each is tried with the cone turned about its own axis too, which tips nothing out and may be easier for the arm.
    """
    from scipy.spatial.transform import Rotation  # deferred: slow to load

    now, place = cell.apex(), cell.place(source.station)
    assert now.seam is not None
    top_m = now.position_m.copy()
    # The rim hangs no lower than this below the apex.
    hangs_mm = cell.spec.hand.sheet_radius_mm * math.sqrt(max(0.0, 1.0 - now.axis[2] ** 2))
    top_m[2] = max(top_m[2], (cell.places_mm[source.station][2] + hangs_mm) / 1000)
    seams = [Rotation.from_rotvec(math.radians(deg) * now.axis).apply(now.seam) for deg in LEAVING_TURNS_DEG]
    ups = [ApexPose(top_m, now.axis, seam) for seam in seams]
    return [[up, *ends] for ends in ([ApexPose(top_m), place], [place], []) for up in ups]


def pour_rest(cell: Cell, source: Source) -> Steps[None]:
    """Pour out what may be left in a cone whose valve gives nothing more, before a scoop tilts it.

    It goes into the mortar or where leftovers are discarded; otherwise it would fall beside the mortar. Powder that
    would not slide stays in the cone, and is still accounted for.
    """
    if not slides_out(cell, source):
        return
    goes_to = vessel_for(cell, source) or source.station
    yield from cell.move_to(goes_to)
    _let_into(cell, goes_to, source, 0.0)
    yield from _let_out(cell, source, goes_to)
    if goes_to != source.station:
        cell.record.event(Discarded(expected_mg=0.0, source=source.name, to=goes_to))


def slides_out(cell: Cell, source: Source) -> bool:
    """Whether powder slides out of a tilted cone: its friction or repose is less than the sheet's slope."""
    half_deg = math.degrees(math.asin(cell.hand.cone_diameter_mm / 2.0 / cell.spec.hand.sheet_radius_mm))
    slope_deg = POURING_DEG[-1] + half_deg - 90.0
    return min(source.powder.wall_friction_deg, source.powder.repose_deg) < slope_deg


def vessel_for(cell: Cell, source: Source) -> str | None:
    """The station that leftovers of a source are discarded at; None where they are not."""
    if not source.is_discarded:
        return None
    return source.leftover_to or cell.spec.station_of_kind("waste").name


def _let_into(cell: Cell, station: str, source: Source, mass_mg: float) -> None:
    """Note a mass of this source in a vessel; a mortar or the waste bin is not one, and is left out."""
    if station in (vessel.name for vessel in cell.spec.vessels):
        cell.believed.let_into(station, source, mass_mg)


def _pour(cell: Cell, source: Source, station: str) -> Steps[None]:
    """Pour the cone out above a source's mortar or the vessel at another station.

    The cone is turned about its lip, which stands still over the middle, so that powder falls in whenever it begins to
    slide. It turns away from the arm; over a vessel it may turn sideways. Raises SkillFailed as `touch`.
    """
    if station == source.station:
        yield from cell.touch(_pouring(cell, station, source.mortar.height_mm, 0.0), POURING_MM_PER_S, station)
        yield from pause(cell, POURED_S)
        return
    for turn_deg in POURING_TURNS_DEG:
        try:
            yield from cell.touch(_pouring(cell, station, 0.0, turn_deg), POURING_MM_PER_S, None)
        except SkillFailed as failure:
            if turn_deg == POURING_TURNS_DEG[-1] or failure.code not in (Code.ARM_NO_PATH, Code.ARM_UNREACHABLE):
                raise
        else:
            break
    yield from pause(cell, POURED_S)


def _pouring(cell: Cell, station: str, height_mm: float, turn_deg: float) -> list[ApexPose]:
    """The cone's poses while it is poured out at a station, over an edge `height_mm` high.

    `turn_deg` is the direction, from straight away from the arm.
    """
    x_mm, y_mm, z_mm = cell.spec.stations[station].position_mm
    toward_rad = math.atan2(y_mm, x_mm) + math.radians(turn_deg)
    out = np.array([math.cos(toward_rad), math.sin(toward_rad), 0.0])
    lip_m = np.array([x_mm, y_mm, z_mm + height_mm + POURED_FROM_MM]) / 1000
    slant_mm = cell.spec.hand.sheet_radius_mm
    half_rad = math.asin(cell.hand.cone_diameter_mm / 2.0 / slant_mm)
    return about_lip(lip_m, out, [math.radians(deg) for deg in POURING_DEG], slant_mm / 1000, half_rad)


def put_away(cell: Cell) -> Steps[None]:
    """Empty the cone to where the recipe wants its leftovers: back into the mortar, or into a vessel."""
    source = cell.sources[cell.believed.cone_source or ""]
    if (vessel := vessel_for(cell, source)) is not None:
        yield from empty_at(cell, vessel)
        return
    yield from open_to_let_out(cell)
    yield from cell.move_to(source.station)
    held_mg = cell.believed.cone_mg
    yield from _let_out(cell, source, source.station)
    cell.believed.returned(source.name, held_mg)
    cell.record.event(Returned(source=source.name, expected_mg=held_mg))


def empty_at(cell: Cell, station: str) -> Steps[None]:
    """Empty the cone into the vessel at a station, from which nothing is scooped."""
    yield from open_to_let_out(cell)
    yield from cell.move_to(station)
    believed = cell.believed
    held_mg, source = believed.cone_mg, cell.sources[believed.cone_source or ""]
    _let_into(cell, station, source, 0.0)  # noted before: this lot is in the vessel even if this is halted
    yield from _let_out(cell, source, station)
    # What a poor scoop missed is counted as still in the mortar. Else the next stroke, made for less than there is,
    # would bring more than the cone may carry.
    missed_mg = min(held_mg, believed.missed_mg.get(source.name, 0.0))
    believed.returned(source.name, missed_mg)
    _let_into(cell, station, source, held_mg - missed_mg)
    cell.record.event(Discarded(expected_mg=held_mg - missed_mg, source=source.name, to=station))


def _let_out(cell: Cell, source: Source, station: str) -> Steps[None]:
    """Empty the cone where it stands, above a source's mortar or the vessel at another station.

    The valve is used first where a bridge may hold the load. Pouring over the lip then takes all, whatever the flow is;
    what is left would fall beside the mortar in the next stroke. The valve alone is used where the arm cannot pour or
    the powder would not slide.
    """
    is_poured = slides_out(cell, source)
    if cell.believed.is_load_doubted or not is_poured:
        yield from _shake_out(cell, source)
    if is_poured:
        try:
            yield from _pour(cell, source, station)
        except SkillFailed as failure:
            if failure.code not in (Code.ARM_NO_PATH, Code.ARM_UNREACHABLE):
                raise
            yield from _shake_out(cell, source)
    cell.believed.emptied()
