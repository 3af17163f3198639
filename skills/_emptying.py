"""What `return_leftover`, `discard`, `scoop` and `withdraw` share: letting everything out of the cone."""

import math

import numpy as np

from scuhand_bt.device_specs.hand import MOUNTED_DIAMETER_MM
from scuhand_bt.motion import ApexPose
from scuhand_bt.motion.pouring import about_lip
from scuhand_bt.skill import Cell, Code, Discarded, Returned, SkillFailed, Source, Steps, pause

from ._opening import open_to_let_out

SHAKE_S = 3.0
SPARE = 2.0
"""Times as long as the flow that was learnt would need: it differs from load to load."""
DOUBT = 0.2
"""The cone may hold more than believed, by this share of the load limit: scoops vary."""
LONGEST_S = 300.0
LEAVING_MM_PER_S = 60.0
LEAVING_TURNS_DEG = (0.0, 20.0, -20.0, 45.0, -45.0, 75.0, -75.0, 110.0, -110.0)
POURED_FROM_MM = 30.0
"""The lip above the mortar's edge while the cone is poured out."""
POURING_DEG = (0.0, 20.0, 40.0, 60.0, 80.0)
"""The axis' tilts on the way: between two of them the lip strays by some millimetres."""
POURING_MM_PER_S = 120.0
POURING_TURNS_DEG = (0.0, 90.0, -90.0, 60.0, -60.0)
"""The directions that it is poured in, from straight away from the arm: into a mortar that one, into a vessel any."""
POURED_S = 1.0
"""Tilted so far, all has slid out within this time."""


def empty_cone(cell: Cell, source: Source) -> Steps[None]:
    """Open the valve wide and vibrate for as long as the believed load of a source needs, then believe it empty."""
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
    """Where a workflow goes on after a scoop that was halted in its mortar, as by a `timeout`: out of that first."""
    for source in cell.sources.values():
        if source.sheet_key == cell.believed.sheet and is_over(cell, source) and _dips_into(cell, source):
            yield from leave_mortar(cell, source)
            return


def _dips_into(cell: Cell, source: Source) -> bool:
    """Whether the cone's apex or its lip is lower than this mortar's edge."""
    apex, rim_mm = cell.apex(), cell.hand.cone_diameter_mm / 2.0
    along_mm = math.sqrt(cell.spec.hand.sheet_radius_mm**2 - rim_mm**2)
    lip_mm = along_mm * apex.axis[2] - rim_mm * math.sqrt(max(0.0, 1.0 - apex.axis[2] ** 2))
    edge_mm = cell.spec.stations[source.station].position_mm[2] + source.mortar.height_mm
    return cell.apex_mm()[2] + min(0.0, lip_mm) < edge_mm


def aside_mm(cell: Cell, source: Source) -> float:
    """How far the middle of the cone's mouth, which a stroke has over its mortar, is from that of this source's."""
    apex, rim_mm, slant_mm = cell.apex(), cell.hand.cone_diameter_mm, cell.spec.hand.sheet_radius_mm
    mouth_mm = 1000.0 * apex.position_m + math.sqrt(slant_mm**2 - (rim_mm / 2) ** 2) * apex.axis
    return math.dist(mouth_mm[:2].tolist(), cell.places_mm[source.station][:2])


def leave_mortar(cell: Cell, source: Source) -> Steps[None]:
    """Out of a mortar in which a scoop was halted, straight up; what the cone may hold goes back into it.

    So nothing is unknown.
    """
    believed = cell.believed
    believed.touched(source)
    for way in _ways_up(cell, source):
        try:
            yield from cell.touch(way, LEAVING_MM_PER_S, source.station)
            break
        except SkillFailed as failure:
            if failure.code not in (Code.ARM_NO_PATH, Code.ARM_UNREACHABLE):
                raise
    if len(way) == 1:  # as far up as that, or, where a wrist that is straight goes no line at all, from here
        yield from cell.move_to(source.station)
    yield from cell.right_of_way.go()
    yield from cell.hand.morph(MOUNTED_DIAMETER_MM)
    held_mg = believed.cone_mg
    most_mg = min(source.powder.load_limit_mg, held_mg + believed.sources_mg[source.name])
    believed.source_holds(source.name, held_mg + believed.sources_mg[source.name] - most_mg)
    believed.cone_holds(source, most_mg)  # known to be loaded, and no powder made, where this is halted, too
    yield from empty_cone(cell, source)
    believed.returned(source.name, most_mg)
    cell.record.event(Returned(source=source.name, expected_mg=held_mg))


def _ways_up(cell: Cell, source: Source) -> list[list[ApexPose]]:
    """Straight up out of a mortar, then upright on the spot and to its place; or upright on the way there; or only up.

    The arm cannot go each of them, but may with the cone turned about its own axis meanwhile, which tips nothing out.
    """
    from scipy.spatial.transform import Rotation  # which not every command has to load

    now, place = cell.apex(), cell.place(source.station)
    assert now.seam is not None
    top_m = now.position_m.copy()
    hangs_mm = cell.spec.hand.sheet_radius_mm * math.sqrt(max(0.0, 1.0 - now.axis[2] ** 2))  # its rim, at most
    top_m[2] = max(top_m[2], (cell.places_mm[source.station][2] + hangs_mm) / 1000)
    seams = [Rotation.from_rotvec(math.radians(deg) * now.axis).apply(now.seam) for deg in LEAVING_TURNS_DEG]
    ups = [ApexPose(top_m, now.axis, seam) for seam in seams]
    return [[up, *ends] for ends in ([ApexPose(top_m), place], [place], []) for up in ups]


def pour_rest(cell: Cell, source: Source) -> Steps[None]:
    """Pour out what a cone that gives nothing more may hold still, before a scoop tips it.

    It goes into the mortar, or into what its leftovers are discarded into: on the way to a stroke it would fall beside
    the mortar. Where the powder would not slide, it stays, and is known to.
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
    """Whether a powder slides out of a cone that is poured: the sheet's lower side is then so steep."""
    half_deg = math.degrees(math.asin(cell.hand.cone_diameter_mm / 2.0 / cell.spec.hand.sheet_radius_mm))
    slope_deg = POURING_DEG[-1] + half_deg - 90.0
    return min(source.powder.wall_friction_deg, source.powder.repose_deg) < slope_deg


def vessel_for(cell: Cell, source: Source) -> str | None:
    """The station of what leftovers of a source are discarded into; None where they are not."""
    if not source.is_discarded:
        return None
    return source.leftover_to or cell.spec.station_of_kind("waste").name


def _let_into(cell: Cell, station: str, source: Source, mass_mg: float) -> None:
    """Where it is a vessel's, so much of a source is in that one: neither a mortar nor the waste bin."""
    if station in (vessel.name for vessel in cell.spec.vessels):
        cell.believed.let_into(station, source, mass_mg)


def _pour(cell: Cell, source: Source, station: str) -> Steps[None]:
    """Turn the cone over its lip above a source's mortar, or the vessel at another station, as a ladle is.

    The lip stands still above the middle, and the cone is turned about it, away from the arm, over a vessel else to its
    side: whenever powder begins to slide, it falls in there. SkillFailed as `touch`.
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
    """The cone's poses as it is poured out over what stands so high at a station, so far aside from straight out."""
    x_mm, y_mm, z_mm = cell.spec.stations[station].position_mm
    toward_rad = math.atan2(y_mm, x_mm) + math.radians(turn_deg)
    out = np.array([math.cos(toward_rad), math.sin(toward_rad), 0.0])
    lip_m = np.array([x_mm, y_mm, z_mm + height_mm + POURED_FROM_MM]) / 1000
    slant_mm = cell.spec.hand.sheet_radius_mm
    half_rad = math.asin(cell.hand.cone_diameter_mm / 2.0 / slant_mm)
    return about_lip(lip_m, out, [math.radians(deg) for deg in POURING_DEG], slant_mm / 1000, half_rad)


def put_away(cell: Cell) -> Steps[None]:
    """What is in the cone goes where the recipe wants it; back into its mortar, unless it is to be discarded."""
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
    _let_into(cell, station, source, 0.0)  # whatever comes of it, the vessel has that lot in it
    yield from _let_out(cell, source, station)
    # Else the next stroke, made for less than there is, would bring more than the cone may carry.
    missed_mg = min(held_mg, believed.missed_mg.get(source.name, 0.0))
    believed.returned(source.name, missed_mg)
    _let_into(cell, station, source, held_mg - missed_mg)
    cell.record.event(Discarded(expected_mg=held_mg - missed_mg, source=source.name, to=station))


def _let_out(cell: Cell, source: Source, station: str) -> Steps[None]:
    """Empty the cone where it stands, above a source's mortar or the vessel at another station.

    What a bridge may hold through the valve, open and shaken; then over the lip, which takes all, whatever the flow
    is: what is left in a cone falls out as the next stroke tips it, beside the mortar. Through the valve alone where
    the arm cannot pour, or the powder would not slide.
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
