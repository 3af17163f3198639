"""Which stroke is made: by what lies in the mortar, and what is wanted in the cone.

Powder lies across the wall in a thickness t, with g of it below a lip's gap (`bed`). What has fallen back before lips
that left the wall, b in all, lies high up instead, beside the strip of the strokes that come, which are turned; on a
wall of the attack's slope beta it slides down where that is steeper than its repose rho. A stroke with half of its rim
e, in a bed of radius r, is expected to push

    density w(e / r) sum(max(0, t - g) dA) + f b,    f = 1 - rho / beta, at least 0.2,
    w(u) = 2 / pi (asin u + u sqrt(1 - u^2)), at most 1

w is the strip's share of a disc. Where the sheet, of radius L, is too large for the bowl, of radius R, the axis leans
beyond level until the lip is past the bottom: the powder is pushed before it, and some slips past. So of a thickness x
above the gap comes

    x - s,    s = min(SLIPS (L - R), x / 3) where L > R and the lip is off the wall, else 0

and the layer is thicker by SLIPS (L - R). In a bowl filled above half its depth the swing cuts a shallow lens, and what
has been poured back lies on its way whole: there t is that of a heap as steep as its repose, where that brings more.
The form is ours, and takes powder to stay as it was left; what a source
really yields of it is learnt from weighing (`cell/believed.py`).

Of what is pushed, V in all, the sheet's slope lets a share slide in behind the lip: none where it is level, at the
attack beta, and all where it is as steep as the friction on it, delta. The rest lies before the lip, over its width w,
between the wall and a slope of its own, which is at most its repose rho; where the wall is phi steep its top is higher
than the lip by no more than

    H = sqrt(2 p V / w / (cot phi + cot rho)),    p = 1 - (phi - beta) / delta, from 0 to 1

The lip leaves the wall before h(phi) + H comes near the edge, over which that would be pushed; where H is 0, a grain
below it, as beside the lip the rim is higher. Of what lies before it there, p V, the share `FALLS_BACK` stays in the
mortar. No stroke pushes so much that it would have to leave the wall before the sheet is level.

Behind a lip that leaves a thick layer the sheet dips into the powder as it comes level, near the edge where the stroke
has begun, and pushes up there what it displaces. So the lip leaves the wall before the apex is as deep in the bed as
the bed's surface is below the edge, both if it were level, as what strokes have hollowed out is room; where the sheet
is not level by then, the layer is thicker.

Of a gap of less than a grain, grains jam under the lip, and it pushes all there is. So a stroke leaves nothing, or a
layer of `GRAINS_CLEAR` grains at least. Masses in mg, lengths in mm.
"""

import math
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from itertools import chain, count

import numpy as np

from scuhand_bt.dosing.bed import Bed, Layer
from scuhand_bt.dosing.ladle import LIP_GAP_MM, Ladle, NoStrokeError, Stroke
from scuhand_bt.dosing.swing import StrokePath, stroke_path
from scuhand_bt.dosing.swing_plane import STEP_MM, Floats, least_attack_deg
from scuhand_bt.dosing.vessel import Vessel
from scuhand_bt.quantity import format_mass
from scuhand_bt.specs import Mortar, Powder

BEHIND_MM = 4.0
"""The lip comes to the wall so far behind the bed."""
BEHIND_MIDDLE_MM = 4.0
"""And so far behind the middle at least, though it comes later where the axis would have to be tilted too much:
by the height field strokes from there bring 0.8 of what is expected, and those from beyond it 0.7 to nothing."""
WIDEST_SHARE = 0.92
"""Of the bore, or of the flat sheet: the widest rim that a stroke begins with."""
CLOSING_MM = 12.0
"""How much the rim closes around the powder, which lifts the handle's clamp over the mortar's edge."""
RIM_GRID_MM, GAP_GRID_MM, FINE_GRID_MM = 2.0, 0.25, 0.01
"""Strokes differ by so much at least; gaps by the last where more than is wanted lies between two of the others."""
GRAINS_CLEAR, GRAINS_LEAST = 4.0, 1.25
"""By discrete elements round grains jam in a gap of half of one, and pass in one of one; others are less even. Where a
layer of so many leaves less than `LITTLE_SHARE` of what is wanted to be taken, it is thinner."""
LITTLE_SHARE = 0.25
LEFT_SHARE, THICKER_MM = 0.05, 0.5
"""Of what a stroke would bring, the least that is taken where it would push powder over a full bowl's edge; and in what
steps such a one is looked for."""
SWEPT_SHARE = 0.6
"""A stroke that takes all there is begins so far up the wall at least: what others have left lies beside them."""
REACHED = 0.85
"""Of what others have left, the share that a stroke that takes all finds: what lies beside its rim it does not. By the
height field; ours."""
FALLS_BACK, FOUND_BESIDE = 0.25, 0.2
"""Of what lies before a lip that leaves the wall, the share that stays there, 0.24 to 0.33 by the height field in the
smaller mortar; and of what has fallen back, the share that a stroke finds at least."""
LOOSE_GRAINS = 0.7
"""Grains whose tops are above the lip go along, and beside a wall grains lie loosely: so much of one, of what is below
the gap, is not left. By discrete elements beds of 3 to 6 beads were so much thicker than they were heavy."""
NEAR_EDGE_MM = 1.0
"""The lip, and the heap before it, are to be lower than the mortar's edge by this, or by a grain: beside the lip the
rim is higher, and carries what lies before it over the edge."""
ENDS = 60
"""Places on the wall that are looked at, from the lowest to the edge."""
SLIPS = 0.033
"""By discrete elements: 1.06 g, where without it 1.48 g were expected of a bowl of 35 mm and a sheet of 50 mm."""
BENT_LIMIT = 1.1
"""Times the load limit that a stroke of a sheet which bends may bring: loads vary as much."""
SPARE, SPARE_MG = 2.0, 2000.0
"""Times what is to be dosed that a scoop is to bring, and so much more."""
DISCARDED_SPARE_MG = 500.0
"""So much more where the rest goes to waste, and twice that of a powder that comes only shaken: in dry runs of 50 and
300 mg less than that of titanium dioxide loses samples, and 250 mg of beads and MSG none."""
LAST_SHARE = 1 / 3
"""Of a load, what a dose is not begun with: the end of it flows badly, and less may be there than is believed."""
LOAD_AIM = 0.95
"""Share of the powder's load limit that a scoop aims at, at most: what it collects varies."""


def scooped_for_mg(dose_mg: float, powder: Powder, *, is_discarded: bool) -> float:
    """What a scoop for a dose is to bring: it may be less than expected, and the last third of it flows badly.

    What is more costs nothing where it stays for the next dose or goes back; not where it `is_discarded`.
    """
    return SPARE * dose_mg + (DISCARDED_SPARE_MG * (1.0 + powder.belief.vibration) if is_discarded else SPARE_MG)


def expected_mg(stroke: Stroke, bed: Bed, sheet_radius_mm: float) -> float:
    """What a stroke is expected to bring into the cone."""
    reached = REACHED if stroke.gap_mm <= LIP_GAP_MM and bed.was_scooped_from else 1.0
    return reached * _brings_mg(stroke, bed, sheet_radius_mm)


def most_mg(stroke: Stroke, bed: Bed, sheet_radius_mm: float) -> float:
    """What a stroke brings that finds all that it may, also what the last one has missed."""
    found_mg = 0.0 if bed.if_found is None else _brings_mg(stroke, bed.if_found, sheet_radius_mm)
    return max(found_mg, _brings_mg(stroke, bed, sheet_radius_mm))


def _brings_mg(stroke: Stroke, bed: Bed, sheet_radius_mm: float) -> float:
    return (1.0 - _falls_back(stroke, bed, sheet_radius_mm)) * _pushed_mg(stroke, bed, sheet_radius_mm)


def slip_mm(stroke: Stroke, mortar: Mortar, sheet_radius_mm: float) -> float:
    """How much thicker than its gap what a stroke leaves is; past a lip on the wall nothing slips."""
    return SLIPS * max(0.0, sheet_radius_mm - mortar.bowl_radius_mm) if stroke.gap_mm > LIP_GAP_MM else 0.0


def layer_left(stroke: Stroke, bed: Bed, sheet_radius_mm: float) -> Layer:
    """What a stroke is expected to leave; what falls back lies beside it."""
    pushed_mg = _pushed_mg(stroke, bed, sheet_radius_mm)
    falls_back_mg = _falls_back(stroke, bed, sheet_radius_mm) * pushed_mg
    beside_mg = bed.beside_mg - _found_mg(stroke, bed, sheet_radius_mm) + falls_back_mg
    bent_mg = _bent_mg(stroke, bed.if_heaped or bed, sheet_radius_mm)
    if stroke.gap_mm <= LIP_GAP_MM:
        left_mg = bed.mass_mg - expected_mg(stroke, bed, sheet_radius_mm)
        return Layer(LIP_GAP_MM, max(0.0, left_mg - beside_mg), min(beside_mg, left_mg))
    return Layer(
        _left_mm(stroke, bed.powder) + slip_mm(stroke, bed.mortar, sheet_radius_mm),
        bed.mass_mg - pushed_mg - (beside_mg - falls_back_mg),
        beside_mg,
        more_mg=max(0.0, bent_mg - (pushed_mg - falls_back_mg)),
        is_lens=bed.is_lens,
    )


@lru_cache(maxsize=64)  # a tenth of a second each, and asked for once for each question about a bed
def chosen(bed: Bed, ladle: Ladle, wanted_mg: float, widest_mm: float = math.inf) -> Stroke:
    """The stroke that brings so much and no more, or the most that it may push: the widest, as deep as it has to be.

    Its rim is at most `widest_mm`.

    NoStrokeError where grains are so coarse that all that may be taken is less than one of them is thick, and where the
    bowl is so shallow, or so small for the sheet, that the lip leaves it before the sheet is level, whatever is taken;
    where the lip cannot come to the wall behind its middle; where it is so full that the sheet would push powder over
    its edge; and where the vessel, the sheet or the handle allow none with any rim.
    """
    sheet_radius_mm, why = ladle.slant_mm, list[NoStrokeError]()
    widest_mm = min(widest_mm, _on_grid(WIDEST_SHARE * min(bed.mortar.bore_mm, 2 * sheet_radius_mm), RIM_GRID_MM))
    for open_mm in np.arange(widest_mm, ladle.rim_limits_mm[0] + CLOSING_MM, -RIM_GRID_MM).tolist():
        stroke = _deep_enough(bed, sheet_radius_mm, wanted_mg, open_mm)
        try:
            path = stroke_path(Vessel.of(bed.mortar), replace(stroke, heading_deg=0.0), ladle)
        except NoStrokeError as error:
            why.append(error)
            continue
        if path.lip_mm[path.on_wall][0, 0] > -BEHIND_MIDDLE_MM:
            why.append(_beyond_middle(bed.mortar, sheet_radius_mm))
        elif _keeps_what_it_takes(stroke, path, Vessel.of(bed.mortar)):
            return _within_edge(stroke, path, bed, ladle)
    raise why[0] if why else _never_level(bed.mortar, sheet_radius_mm)


def _keeps_what_it_takes(stroke: Stroke, path: StrokePath, vessel: Vessel) -> bool:
    """Whether the swing goes on until the sheet is level, or the lip is where it is to leave the wall.

    Where the handle stops a wide rim before, all slides out again.
    """
    lip_mm, apex_mm = path.lip_mm[path.on_wall][-1], path.apex_mm[path.on_wall][-1]
    out_mm, _, steep = vessel.wall(np.array([min(stroke.end_mm, vessel.to_edge_mm)]))
    is_there = lip_mm[0] >= out_mm[0] - stroke.gap_mm * math.sin(steep[0]) - 2 * STEP_MM
    return bool(is_there or lip_mm[2] >= apex_mm[2])


def _within_edge(stroke: Stroke, path: StrokePath, bed: Bed, ladle: Ladle) -> Stroke:
    """The stroke, or one that ends before the sheet pushes powder over the edge; if it has to be, less deep.

    NoStrokeError where such a one brings next to nothing.
    """
    least_mg = LEFT_SHARE * most_mg(stroke, bed, ladle.slant_mm)
    while (end_mm := _end_before_it_dips_mm(stroke, path, bed)) is None:
        stroke = _ended(replace(stroke, gap_mm=stroke.gap_mm + THICKER_MM), bed, ladle.slant_mm)
        if most_mg(stroke, bed, ladle.slant_mm) < least_mg:
            raise _too_full(bed)
        path = stroke_path(Vessel.of(bed.mortar), replace(stroke, heading_deg=0.0), ladle)
    return replace(stroke, end_mm=end_mm)


def _end_before_it_dips_mm(stroke: Stroke, path: StrokePath, bed: Bed) -> float | None:
    """Where the lip leaves the wall so that the sheet, behind it, pushes nothing over the edge; None for nowhere.

    That is before the apex, where the lip has cut nothing, is as far below the bed, if that were level, as the bed is
    below the edge; and the sheet is to be level by then.
    """
    lip_mm, apex_mm = path.lip_mm[path.on_wall], path.apex_mm[path.on_wall]
    radius_mm, level_mm = bed.mortar.bowl_radius_mm, Bed(bed.mortar, bed.mass_mg, bed.powder).surface_mm
    deepest_mm = 2 * level_mm - bed.mortar.depth_mm + max(NEAR_EDGE_MM, bed.powder.grain_mm)
    is_uncut = np.hypot(apex_mm[:, 0], radius_mm - apex_mm[:, 2]) > radius_mm - stroke.gap_mm
    dips = is_uncut & (apex_mm[:, 2] < deepest_mm)
    if not dips.any():
        return stroke.end_mm
    last = int(dips.argmax()) - 1
    if last < 0 or lip_mm[last, 2] < apex_mm[last, 2]:
        return None
    return radius_mm * math.atan2(lip_mm[last, 0], radius_mm - lip_mm[last, 2])


def _deep_enough(bed: Bed, sheet_radius_mm: float, wanted_mg: float, open_mm: float) -> Stroke:
    """As `chosen`, with a rim."""
    deepest = across(bed.mortar, bed.radius_mm, open_mm)
    swept_mm = SWEPT_SHARE * bed.mortar.bowl_radius_mm * math.asin(bed.mortar.bore_mm / 2 / bed.mortar.bowl_radius_mm)
    whole = replace(deepest, begin_mm=min(deepest.begin_mm, -_on_grid(swept_mm, RIM_GRID_MM)))
    level_mm = bed.mortar.bowl_radius_mm * math.radians(_attack_deg(deepest, bed.mortar, sheet_radius_mm))
    # What lies beside comes along at any gap: no less than that can be asked for.
    wanted_mg = max(wanted_mg, _found_mg(deepest, bed, sheet_radius_mm))

    little_mg = LITTLE_SHARE * min(wanted_mg, bed.mass_mg)
    bent_limit_mg = BENT_LIMIT * max(wanted_mg, bed.powder.load_limit_mg)

    def may_be(ended: Stroke) -> bool:
        brings_mg = most_mg(ended, bed, sheet_radius_mm)
        return (
            ended.end_mm >= level_mm
            and brings_mg <= wanted_mg
            and (brings_mg <= little_mg or bent_mg(ended, bed, sheet_radius_mm) <= bent_limit_mg)
        )

    def first(strokes: Iterable[Stroke]) -> Stroke:
        for stroke in strokes:
            if may_be(ended := _ended(stroke, bed, sheet_radius_mm)):
                return ended
        raise _never_level(bed.mortar, sheet_radius_mm)

    def layered(grains: float, from_mm: float = 0.0, grid_mm: float = GAP_GRID_MM) -> Iterator[Stroke]:
        """Up to the first that leaves all that lies there: what comes after it is the same."""
        for steps in count(math.ceil(max(grains * bed.powder.grain_mm, from_mm) / grid_mm)):
            stroke = replace(deepest, gap_mm=steps * grid_mm)
            yield stroke
            all_beds = (bed, bed.if_found or bed, bed.if_heaped or bed)
            if all(one.above_mg(_left_mm(stroke, bed.powder)) <= 0.0 for one in all_beds):
                return

    stroke = first(chain([whole], layered(GRAINS_CLEAR)))
    if most_mg(stroke, bed, sheet_radius_mm) < little_mg:
        stroke = first(layered(GRAINS_LEAST))
    deeper_mm = stroke.gap_mm - GAP_GRID_MM
    if most_mg(stroke, bed, sheet_radius_mm) < little_mg and deeper_mm >= GRAINS_LEAST * bed.powder.grain_mm:
        deeper = _ended(replace(deepest, gap_mm=deeper_mm), bed, sheet_radius_mm)
        stroke = stroke if may_be(deeper) else first(layered(GRAINS_LEAST, deeper_mm, FINE_GRID_MM))
    if most_mg(stroke, bed, sheet_radius_mm) <= 0.0:
        raise NoStrokeError(
            f"{format_mass(bed.mass_mg)} of grains of {bed.powder.grain_mm:g} mm lie less thick than one of them, and "
            f"no more than {format_mass(wanted_mg)} may be taken at once"
        )
    return stroke


def _beyond_middle(mortar: Mortar, sheet_radius_mm: float) -> NoStrokeError:
    return NoStrokeError(
        f"with a sheet of {sheet_radius_mm:g} mm the lip comes to the wall of a bowl of {mortar.bore_mm:g} mm bore and "
        f"{mortar.depth_mm:g} mm depth beyond its middle, past the powder"
    )


def _too_full(bed: Bed) -> NoStrokeError:
    return NoStrokeError(
        f"of {format_mass(bed.mass_mg)} in a bowl of {bed.mortar.bore_mm:g} mm bore and {bed.mortar.depth_mm:g} mm "
        f"depth, which they nearly fill, the sheet would push some over the edge as it dips into them"
    )


def _never_level(mortar: Mortar, sheet_radius_mm: float) -> NoStrokeError:
    attack_deg = _attack_deg(across(mortar, 0.0, mortar.bore_mm), mortar, sheet_radius_mm)
    edge_deg = math.degrees(math.asin(mortar.bore_mm / 2 / mortar.bowl_radius_mm))
    return NoStrokeError(
        f"a sheet of {sheet_radius_mm:g} mm meets the bowl's wall at {attack_deg:.0f} deg, which is {edge_deg:.0f} deg "
        f"steep at its edge: the lip comes near that before the sheet is level"
    )


def across(mortar: Mortar, bed_radius_mm: float, open_mm: float) -> Stroke:
    """The stroke that takes all that lies no farther than that from the middle, with such a rim, to the edge."""
    behind_mm = mortar.bowl_radius_mm * math.asin(bed_radius_mm / mortar.bowl_radius_mm) + BEHIND_MM
    return Stroke(open_mm, open_mm - CLOSING_MM, begin_mm=-_on_grid(behind_mm, RIM_GRID_MM))


def _pushed_mg(stroke: Stroke, bed: Bed, sheet_radius_mm: float) -> float:
    """What comes before the lip of a stroke, and into the mouth."""
    above_mg = max(_on_strip_mg(stroke, one, sheet_radius_mm) for one in (bed, bed.if_heaped or bed))
    return above_mg + _found_mg(stroke, bed, sheet_radius_mm)


def _on_strip_mg(stroke: Stroke, bed: Bed, sheet_radius_mm: float) -> float:
    u = min(1.0, stroke.open_mm / 2 / bed.radius_mm)
    strip = 2 / math.pi * (math.asin(u) + u * math.sqrt(1 - u * u))
    slips_mm = slip_mm(stroke, bed.mortar, sheet_radius_mm)
    return strip * bed.above_mg(_left_mm(stroke, bed.powder), slips_mm)


def bent_mg(stroke: Stroke, bed: Bed, sheet_radius_mm: float) -> float:
    """What a stroke brings if the sheet bends and nothing slips past it: of a thin bed far more than is expected.

    If the last one has, too, and its load was poured back, that lies as a heap on its way.
    """
    beds = (bed, bed.if_heaped or bed, bed.if_more or bed)
    return max(_bent_mg(stroke, one, sheet_radius_mm) for one in beds)


def _bent_mg(stroke: Stroke, bed: Bed, sheet_radius_mm: float) -> float:
    rim_mm = (stroke.open_mm + stroke.closed_mm) / 2
    leans_deg = math.degrees(math.asin(rim_mm / 2 / sheet_radius_mm)) - _attack_deg(stroke, bed.mortar, sheet_radius_mm)
    above_mg = bed.above_bent_mg(_left_mm(stroke, bed.powder), rim_mm, leans_deg)
    return (1.0 - _falls_back(stroke, bed, sheet_radius_mm)) * above_mg


def _found_mg(stroke: Stroke, bed: Bed, sheet_radius_mm: float) -> float:
    """What a stroke is expected to come upon of what lies beside: one that presses on the wall scrapes it all off.

    Of what the last one has missed little, however well the powder slides: it was not on that one's way, either.
    """
    if stroke.gap_mm < 0.0:
        return bed.beside_mg
    slid = max(FOUND_BESIDE, 1.0 - bed.powder.repose_deg / _attack_deg(stroke, bed.mortar, sheet_radius_mm))
    return slid * max(0.0, bed.beside_mg - bed.missed_mg) + FOUND_BESIDE * bed.missed_mg


def _left_mm(stroke: Stroke, powder: Powder) -> float:
    """How much passes under the lip, as the thickness that it has at its bulk density."""
    return stroke.gap_mm - LOOSE_GRAINS * powder.grain_mm if stroke.gap_mm > LIP_GAP_MM else max(0.0, stroke.gap_mm)


def _ended(stroke: Stroke, bed: Bed, sheet_radius_mm: float) -> Stroke:
    """With the place where the lip leaves the wall; none where it goes to the edge."""
    pushed_mg = max(_pushed_mg(stroke, one, sheet_radius_mm) for one in (bed, bed.if_found or bed))
    mortar, volume_mm3 = bed.mortar, pushed_mg / bed.powder.bulk_density_mg_per_mm3
    edge = math.asin(mortar.bore_mm / 2 / mortar.bowl_radius_mm)
    steeps: Floats = np.linspace(0.0, edge, ENDS + 1)[1:]
    on_wall, beside = 1 / np.tan(steeps), 1 / math.tan(math.radians(bed.powder.repose_deg))
    before_mm3 = volume_mm3 * np.array([_before_lip(steep, stroke, bed, sheet_radius_mm) for steep in steeps.tolist()])
    heap_mm = np.sqrt(2 * before_mm3 / stroke.closed_mm / (on_wall + beside))
    below_edge_mm = mortar.depth_mm - mortar.bowl_radius_mm * (1 - np.cos(steeps))
    is_over = heap_mm > below_edge_mm - max(NEAR_EDGE_MM, bed.powder.grain_mm)
    return replace(stroke, end_mm=mortar.bowl_radius_mm * float(steeps[max(0, int(is_over.argmax()) - 1)]))


def _before_lip(steep: float, stroke: Stroke, bed: Bed, sheet_radius_mm: float) -> float:
    """The share of what is pushed that has not slid in where the wall is so steep [rad]."""
    attack_deg = _attack_deg(stroke, bed.mortar, sheet_radius_mm)
    return min(1.0, max(0.0, 1.0 - (math.degrees(steep) - attack_deg) / bed.powder.wall_friction_deg))


def _attack_deg(stroke: Stroke, mortar: Mortar, sheet_radius_mm: float) -> float:
    """The attack as it is while the apex is in the bowl; 90 where the sheet is too large for any."""
    with suppress(NoStrokeError):
        return max(stroke.attack_deg, least_attack_deg(mortar.bowl_radius_mm, sheet_radius_mm))
    return 90.0


def _falls_back(stroke: Stroke, bed: Bed, sheet_radius_mm: float) -> float:
    """The share of what is pushed that lies on the wall before the lip where that leaves it, below the edge."""
    if math.isinf(stroke.end_mm):
        return 0.0
    return FALLS_BACK * _before_lip(stroke.end_mm / bed.mortar.bowl_radius_mm, stroke, bed, sheet_radius_mm)


def _on_grid(length_mm: float, grid_mm: float) -> float:
    return grid_mm * round(length_mm / grid_mm)
