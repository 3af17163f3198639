"""Choose the stroke to make in a bowl, and predict what it brings and leaves (docs/scoop.md, How much it takes).

Powder lies across the wall with a thickness t (`bed`). A stroke at a gap g pushes

    V = density w sum((x - slip) dA) + f b,        x = max(0, t - gap')

with gap' the layer that it leaves, w the share of the bed's disc that the rim's strip covers, b what lies high up
beside the strip, and f the share of b that is found. Of V a share slides in behind the lip; the rest lies before it as
a heap.

* `_pushed_mg` is V, with `_left_mm`, `slip_mm` and `_found_mg` its terms; `_before_lip` the share before the lip.
* `_ended`: the lip leaves the wall before that heap reaches the edge; `_falls_back` is the share of V that then stays.
* `_end_before_it_dips_mm`: it also leaves before the sheet, in a nearly full bowl, pushes powder over the edge.
* `_deep_enough` chooses the depth, `chosen` the rim.

The model is ours, and takes powder to stay as it was left. What a source really yields is learnt by weighing
(docs/scoop-belief.md). Masses in mg, lengths in mm.
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
"""The lip meets the wall this far behind the bed."""
BEHIND_MIDDLE_MM = 4.0
"""And at least this far behind the middle; a rim with which it would come later, for want of tilt, is not used. By the
height field strokes from here bring 0.8 of what is expected, and later ones 0.7 to nothing."""
WIDEST_SHARE = 0.92
"""The widest rim at the beginning, as a share of the bore or of the flat sheet, whichever is less."""
CLOSING_MM = 12.0
"""The rim closes by this in a stroke. That holds the powder, and lifts the handle's clamp over the mortar's edge."""
RIM_GRID_MM, GAP_GRID_MM, FINE_GRID_MM = 2.0, 0.25, 0.01
"""Grids of rims and gaps; the fine one is used where more than is wanted lies between two gaps."""
GRAINS_CLEAR, GRAINS_LEAST = 4.0, 1.25
"""A layer left is at least GRAINS_CLEAR grains, as grains jam under lower lips: by discrete elements, round grains jam
in a gap of half a grain and pass in one of one, and others are less even. It may be GRAINS_LEAST where the stroke would
otherwise bring less than `LITTLE_SHARE` of what is wanted."""
LITTLE_SHARE = 0.25
LEFT_SHARE, THICKER_MM = 0.05, 0.5
"""In a nearly full bowl strokes get less deep in steps of THICKER_MM, until one pushes nothing over the edge. One that
brings less than LEFT_SHARE of the first is not made."""
SWEPT_SHARE = 0.6
"""A stroke that takes all begins so far up the wall at least, as what others have left lies beside them."""
REACHED = 0.85
"""Share of a bed already scooped from that a stroke which takes all is expected to bring; the rest lies beside its rim.
Ours, by the height field."""
FALLS_BACK, FOUND_BESIDE = 0.25, 0.2
"""FALLS_BACK: share of what lies before a lip that leaves the wall which stays there (0.24 to 0.33 by the height field
in the small mortar). FOUND_BESIDE: least share of what has fallen back that a stroke finds."""
LOOSE_GRAINS = 0.7
"""The layer left is thinner than the gap by this share of a grain: grains whose tops are above the lip go along, and
beside a wall grains lie loosely. By discrete elements, from beds of 3 to 6 beads."""
NEAR_EDGE_MM = 1.0
"""The lip, and the heap before it, stay below the edge by this, or by a grain. Beside the lip the rim is higher, and
carries what lies before it over the edge."""
ENDS = 60
"""Places on the wall that are tried for the lip to leave it."""
SLIPS = 0.033
"""What slips past the lip, per mm by which the sheet is larger than the bowl. By one run of discrete elements: 1.06 g
came where 1.48 g were expected without it (bowl of 35 mm, sheet of 50 mm)."""
BENT_LIMIT = 1.1
"""The most that a stroke may bring if the sheet bends, in load limits: loads vary as much."""
SPARE, SPARE_MG = 2.0, 2000.0
"""A scoop is for this multiple of the dose, plus so much."""
DISCARDED_SPARE_MG = 500.0
"""So much more where leftovers go to waste, and twice that for a powder that comes only shaken. In dry runs of 50 and
300 mg less than that lost samples of titanium dioxide; 250 mg lost none of beads and MSG."""
LAST_SHARE = 1 / 3
"""The last share of a load, with which no dose is begun: it flows badly, and less than believed may be there."""
LOAD_AIM = 0.95
"""Share of the powder's load limit that a scoop aims at, at most, as loads vary."""


def scooped_for_mg(dose_mg: float, powder: Powder, *, is_discarded: bool) -> float:
    """The mass that a scoop for a dose should bring: more than the dose, as scoops vary and the last third flows badly.

    A surplus costs nothing where it stays for the next dose or goes back, but does where it `is_discarded`.
    """
    return SPARE * dose_mg + (DISCARDED_SPARE_MG * (1.0 + powder.belief.vibration) if is_discarded else SPARE_MG)


def expected_mg(stroke: Stroke, bed: Bed, sheet_radius_mm: float) -> float:
    """The mass that a stroke is expected to bring into the cone."""
    reached = REACHED if stroke.gap_mm <= LIP_GAP_MM and bed.was_scooped_from else 1.0
    return reached * _brings_mg(stroke, bed, sheet_radius_mm)


def most_mg(stroke: Stroke, bed: Bed, sheet_radius_mm: float) -> float:
    """The mass that a stroke brings if it also finds what the last one has missed."""
    found_mg = 0.0 if bed.if_found is None else _brings_mg(stroke, bed.if_found, sheet_radius_mm)
    return max(found_mg, _brings_mg(stroke, bed, sheet_radius_mm))


def _brings_mg(stroke: Stroke, bed: Bed, sheet_radius_mm: float) -> float:
    return (1.0 - _falls_back(stroke, bed, sheet_radius_mm)) * _pushed_mg(stroke, bed, sheet_radius_mm)


def slip_mm(stroke: Stroke, mortar: Mortar, sheet_radius_mm: float) -> float:
    """By how much the layer left is thicker than its gap; a lip on the wall lets nothing slip."""
    return SLIPS * max(0.0, sheet_radius_mm - mortar.bowl_radius_mm) if stroke.gap_mm > LIP_GAP_MM else 0.0


def layer_left(stroke: Stroke, bed: Bed, sheet_radius_mm: float) -> Layer:
    """The layer that a stroke is expected to leave; what falls back lies beside it."""
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


@lru_cache(maxsize=64)  # a tenth of a second each, and asked for by each question about a bed
def chosen(bed: Bed, ladle: Ladle, wanted_mg: float, widest_mm: float = math.inf) -> Stroke:
    """The widest stroke that brings no more than is wanted, as deep as it has to be, with a rim of at most `widest_mm`.

    Raises NoStrokeError where

    * what may be taken is thinner than one grain,
    * the bowl is so shallow, or so small for the sheet, that the lip leaves it before the sheet is level,
    * the lip cannot meet the wall behind the middle,
    * the bowl is so full that the sheet would push powder over the edge,
    * or vessel, sheet or handle allow no stroke with any rim.
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
    """Whether the swing goes on until the sheet is level, or the lip is where it should leave the wall.

    If the handle stops a wide rim earlier, all slides out again.
    """
    lip_mm, apex_mm = path.lip_mm[path.on_wall][-1], path.apex_mm[path.on_wall][-1]
    out_mm, _, steep = vessel.wall(np.array([min(stroke.end_mm, vessel.to_edge_mm)]))
    is_there = lip_mm[0] >= out_mm[0] - stroke.gap_mm * math.sin(steep[0]) - 2 * STEP_MM
    return bool(is_there or lip_mm[2] >= apex_mm[2])


def _within_edge(stroke: Stroke, path: StrokePath, bed: Bed, ladle: Ladle) -> Stroke:
    """The stroke, ending before the sheet pushes powder over the edge; less deep if it has to be.

    Raises NoStrokeError where next to nothing would come.
    """
    least_mg = LEFT_SHARE * most_mg(stroke, bed, ladle.slant_mm)
    while (end_mm := _end_before_it_dips_mm(stroke, path, bed)) is None:
        stroke = _ended(replace(stroke, gap_mm=stroke.gap_mm + THICKER_MM), bed, ladle.slant_mm)
        if most_mg(stroke, bed, ladle.slant_mm) < least_mg:
            raise _too_full(bed)
        path = stroke_path(Vessel.of(bed.mortar), replace(stroke, heading_deg=0.0), ladle)
    return replace(stroke, end_mm=end_mm)


def _end_before_it_dips_mm(stroke: Stroke, path: StrokePath, bed: Bed) -> float | None:
    """Where the lip leaves the wall so that the sheet behind it pushes nothing over the edge; None for nowhere.

    That is before the apex, where the lip has cut nothing, is as far below the bed as the bed is below the edge. Both
    are taken as level, as what strokes have hollowed out is room. The sheet has to be level by then.
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
    """The stroke of `chosen` for one rim."""
    deepest = across(bed.mortar, bed.radius_mm, open_mm)
    swept_mm = SWEPT_SHARE * bed.mortar.bowl_radius_mm * math.asin(bed.mortar.bore_mm / 2 / bed.mortar.bowl_radius_mm)
    whole = replace(deepest, begin_mm=min(deepest.begin_mm, -_on_grid(swept_mm, RIM_GRID_MM)))
    level_mm = bed.mortar.bowl_radius_mm * math.radians(_attack_deg(deepest, bed.mortar, sheet_radius_mm))
    # What lies beside comes along at any gap, so no less can be asked for.
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
        """Strokes with thicker and thicker layers, up to the first that takes nothing: all after it are the same."""
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
            f"{format_mass(bed.mass_mg)} of powder lie thinner than one grain of {bed.powder.grain_mm:g} mm, and at "
            f"most {format_mass(wanted_mg)} may be taken at once"
        )
    return stroke


def _beyond_middle(mortar: Mortar, sheet_radius_mm: float) -> NoStrokeError:
    return NoStrokeError(
        f"the lip of a sheet of {sheet_radius_mm:g} mm radius meets the wall only beyond the middle, past the powder, "
        f"in a bowl of {mortar.bore_mm:g} mm bore and {mortar.depth_mm:g} mm depth"
    )


def _too_full(bed: Bed) -> NoStrokeError:
    return NoStrokeError(
        f"a bowl of {bed.mortar.bore_mm:g} mm bore and {bed.mortar.depth_mm:g} mm depth is nearly full with "
        f"{format_mass(bed.mass_mg)}: the sheet would push powder over the edge as it dips in"
    )


def _never_level(mortar: Mortar, sheet_radius_mm: float) -> NoStrokeError:
    attack_deg = _attack_deg(across(mortar, 0.0, mortar.bore_mm), mortar, sheet_radius_mm)
    edge_deg = math.degrees(math.asin(mortar.bore_mm / 2 / mortar.bowl_radius_mm))
    return NoStrokeError(
        f"the lip comes near the bowl's edge before the sheet is level: a sheet of {sheet_radius_mm:g} mm radius meets "
        f"the wall at {attack_deg:.0f} deg, and the wall is {edge_deg:.0f} deg steep at its edge"
    )


def across(mortar: Mortar, bed_radius_mm: float, open_mm: float) -> Stroke:
    """The stroke that takes all within a bed of this radius, with such a rim, up to the edge."""
    behind_mm = mortar.bowl_radius_mm * math.asin(bed_radius_mm / mortar.bowl_radius_mm) + BEHIND_MM
    return Stroke(open_mm, open_mm - CLOSING_MM, begin_mm=-_on_grid(behind_mm, RIM_GRID_MM))


def _pushed_mg(stroke: Stroke, bed: Bed, sheet_radius_mm: float) -> float:
    """The mass V that comes before the lip, or into the mouth."""
    above_mg = max(_on_strip_mg(stroke, one, sheet_radius_mm) for one in (bed, bed.if_heaped or bed))
    return above_mg + _found_mg(stroke, bed, sheet_radius_mm)


def _on_strip_mg(stroke: Stroke, bed: Bed, sheet_radius_mm: float) -> float:
    u = min(1.0, stroke.open_mm / 2 / bed.radius_mm)
    strip = 2 / math.pi * (math.asin(u) + u * math.sqrt(1 - u * u))
    slips_mm = slip_mm(stroke, bed.mortar, sheet_radius_mm)
    return strip * bed.above_mg(_left_mm(stroke, bed.powder), slips_mm)


def bent_mg(stroke: Stroke, bed: Bed, sheet_radius_mm: float) -> float:
    """The mass that a stroke brings if the sheet bends and nothing slips past: of a thin bed far more.

    If the last stroke has bent, too, and its load was poured back, that lies as a heap on the way.
    """
    beds = (bed, bed.if_heaped or bed, bed.if_more or bed)
    return max(_bent_mg(stroke, one, sheet_radius_mm) for one in beds)


def _bent_mg(stroke: Stroke, bed: Bed, sheet_radius_mm: float) -> float:
    rim_mm = (stroke.open_mm + stroke.closed_mm) / 2
    leans_deg = math.degrees(math.asin(rim_mm / 2 / sheet_radius_mm)) - _attack_deg(stroke, bed.mortar, sheet_radius_mm)
    above_mg = bed.above_bent_mg(_left_mm(stroke, bed.powder), rim_mm, leans_deg)
    return (1.0 - _falls_back(stroke, bed, sheet_radius_mm)) * above_mg


def _found_mg(stroke: Stroke, bed: Bed, sheet_radius_mm: float) -> float:
    """The mass that a stroke is expected to find of what lies beside; one that presses on the wall finds all.

    Little is found of what the last stroke has missed, however well it slides: it was not on that one's way either.
    """
    if stroke.gap_mm < 0.0:
        return bed.beside_mg
    slid = max(FOUND_BESIDE, 1.0 - bed.powder.repose_deg / _attack_deg(stroke, bed.mortar, sheet_radius_mm))
    return slid * max(0.0, bed.beside_mg - bed.missed_mg) + FOUND_BESIDE * bed.missed_mg


def _left_mm(stroke: Stroke, powder: Powder) -> float:
    """The layer that passes under the lip, as a thickness at bulk density (gap' without the sides)."""
    return stroke.gap_mm - LOOSE_GRAINS * powder.grain_mm if stroke.gap_mm > LIP_GAP_MM else max(0.0, stroke.gap_mm)


def _ended(stroke: Stroke, bed: Bed, sheet_radius_mm: float) -> Stroke:
    """The stroke, with the place where its lip leaves the wall before the heap reaches the edge."""
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
    """The share of what is pushed that has not slid in where the wall has this slope [rad]."""
    attack_deg = _attack_deg(stroke, bed.mortar, sheet_radius_mm)
    return min(1.0, max(0.0, 1.0 - (math.degrees(steep) - attack_deg) / bed.powder.wall_friction_deg))


def _attack_deg(stroke: Stroke, mortar: Mortar, sheet_radius_mm: float) -> float:
    """The attack with the apex inside the bowl; 90 if the sheet is too large for any."""
    with suppress(NoStrokeError):
        return max(stroke.attack_deg, least_attack_deg(mortar.bowl_radius_mm, sheet_radius_mm))
    return 90.0


def _falls_back(stroke: Stroke, bed: Bed, sheet_radius_mm: float) -> float:
    """The share of what is pushed that stays on the wall where the lip leaves it; 0 if it goes to the edge."""
    if math.isinf(stroke.end_mm):
        return 0.0
    return FALLS_BACK * _before_lip(stroke.end_mm / bed.mortar.bowl_radius_mm, stroke, bed, sheet_radius_mm)


def _on_grid(length_mm: float, grid_mm: float) -> float:
    return grid_mm * round(length_mm / grid_mm)
