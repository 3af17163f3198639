"""Which stroke is made of a mortar's bed, and what it is expected to bring; held against the height field."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from daily import first_daily
from dose_bench import shipped_powders
from hypothesis import given, settings
from hypothesis import strategies as st

from scuhand_bt.cell.believed import Believed
from scuhand_bt.dosing.bed import Bed, Layer
from scuhand_bt.dosing.beds import bed_for, strokes_for_less, strokes_in
from scuhand_bt.dosing.ladle import LIP_GAP_MM, Ladle, NoStrokeError, Stroke
from scuhand_bt.dosing.strokes import (
    BENT_LIMIT,
    GRAINS_CLEAR,
    LITTLE_SHARE,
    bent_mg,
    chosen,
    expected_mg,
    layer_left,
    most_mg,
)
from scuhand_bt.dosing.swing import StrokePath, stroke_path
from scuhand_bt.dosing.swing_plane import least_attack_deg
from scuhand_bt.dosing.vessel import Vessel
from scuhand_bt.sim.bed import HeightField
from scuhand_bt.specs import Mortar, Powder, Source

MORTAR = Mortar(name="agate", bore_mm=90.0, depth_mm=30.0, height_mm=45.0, outer_diameter_mm=115.0)
SMALL = Mortar(name="small", bore_mm=65.0, depth_mm=22.0, height_mm=36.0, outer_diameter_mm=85.0)
SHEET_MM = 50.0
LADLE = Ladle(SHEET_MM)
POWDERS = shipped_powders()
BEADS = POWDERS["glass_beads"]
ACROSS_DEG = (90.0, 270.0, 120.0, 240.0)


def through(stroke: Stroke, field: HeightField, in_mortar_mg: float, mortar: Mortar) -> tuple[float, float]:
    """What a stroke collects, and what goes over the edge, by the height field."""
    path = stroke_path(Vessel.of(mortar), stroke, Ladle())
    in_cone_mg = spilled_mg = 0.0
    for apex_mm, axis, rim_mm in zip(path.apex_mm, path.axis, path.rim_mm, strict=True):
        left_mg = in_mortar_mg - in_cone_mg - spilled_mg
        gained_mg, lost_mg = field.move(apex_mm, axis, float(rim_mm), left_mg, in_cone_mg)
        in_cone_mg += gained_mg
        spilled_mg += lost_mg
    return in_cone_mg, spilled_mg + field.leave()


masses_mg = st.floats(200.0, 30_000.0)


@given(masses_mg, st.floats(100.0, 6000.0))
@settings(max_examples=30, deadline=None)
def test_no_more_is_expected_than_is_wanted_or_there(in_mortar_mg: float, wanted_mg: float) -> None:
    bed = Bed(MORTAR, in_mortar_mg, BEADS)
    stroke = chosen(bed, LADLE, wanted_mg)
    assert expected_mg(stroke, bed, SHEET_MM) <= min(wanted_mg, in_mortar_mg) + 1e-6
    if stroke.gap_mm > LIP_GAP_MM:
        clear_mm = GRAINS_CLEAR * BEADS.grain_mm
        assert stroke.gap_mm >= clear_mm
        deeper = replace(stroke, gap_mm=stroke.gap_mm - 0.25 if stroke.gap_mm - 0.25 >= clear_mm else LIP_GAP_MM)
        may_bring_mg = BENT_LIMIT * max(wanted_mg, bed.powder.load_limit_mg)
        is_too_much = most_mg(deeper, bed, SHEET_MM) > wanted_mg or bent_mg(deeper, bed, SHEET_MM) > may_bring_mg
        assert is_too_much, "a deeper one would have brought too much"
    else:
        assert expected_mg(stroke, bed, SHEET_MM) > 0.8 * in_mortar_mg or stroke.gap_mm == LIP_GAP_MM


@given(masses_mg, st.floats(0.5, 10.0), st.floats(0.1, 1.0))
@settings(max_examples=60, deadline=None)
def test_all_that_is_in_a_mortar_is_in_its_bed(in_mortar_mg: float, gap_mm: float, share: float) -> None:
    bed = Bed(MORTAR, in_mortar_mg, BEADS, Layer(gap_mm, share * in_mortar_mg))
    assert bed.above_mg(0.0) == pytest.approx(in_mortar_mg, rel=1e-6)


def test_of_a_layer_nothing_is_above_the_lip_that_has_left_it() -> None:
    first = Bed(MORTAR, 20_000.0, BEADS)
    stroke = chosen(first, LADLE, 4000.0)
    left_mg = 20_000.0 - expected_mg(stroke, first, SHEET_MM)
    assert Bed(MORTAR, left_mg, BEADS, Layer(stroke.gap_mm, left_mg)).above_mg(stroke.gap_mm) < 0.02 * left_mg
    assert Bed(MORTAR, left_mg, BEADS).above_mg(stroke.gap_mm) > 0.1 * left_mg, "a level bed of as much would be higher"


def test_a_layer_of_which_less_is_left_than_a_stroke_should_leave_is_thinner() -> None:
    layer = Layer(5.0, 12_000.0)
    whole, thinner = (Bed(MORTAR, mass_mg, BEADS, layer) for mass_mg in (12_000.0, 9000.0))
    assert whole.above_mg(3.0) > 1000.0
    assert thinner.above_mg(3.75) == pytest.approx(0.75 * whole.above_mg(5.0), abs=1.0)
    assert thinner.above_mg(0.75 * 3.0) == pytest.approx(0.75 * whole.above_mg(3.0), rel=0.02)


def test_what_is_poured_back_lies_on_the_layer() -> None:
    layer = Layer(5.0, 12_000.0)
    without, more = (Bed(MORTAR, mass_mg, BEADS, layer) for mass_mg in (12_000.0, 14_000.0))
    assert more.above_mg(5.0) - without.above_mg(5.0) == pytest.approx(2000.0, rel=0.2)


def test_a_rim_narrower_than_the_bed_brings_its_strip() -> None:
    bed = Bed(MORTAR, 20_000.0, BEADS)
    wide = chosen(bed, LADLE, math.inf)
    narrow = replace(wide, open_mm=bed.radius_mm)
    assert expected_mg(narrow, bed, SHEET_MM) == pytest.approx(0.609 * expected_mg(wide, bed, SHEET_MM), rel=1e-3)


@pytest.mark.parametrize(("sheet_mm", "slip_mm"), [(SHEET_MM, 0.033 * 15.0), (35.0, 0.0)])
def test_of_a_bowl_that_the_sheet_is_too_large_for_less_is_expected_and_a_thicker_layer_left(
    sheet_mm: float, slip_mm: float
) -> None:
    bed = Bed(SMALL, 4000.0, BEADS)
    stroke = chosen(bed, Ladle(sheet_mm), 1500.0)
    brought_mg = expected_mg(replace(stroke, end_mm=math.inf), bed, sheet_mm)
    above_mg = bed.above_mg(stroke.gap_mm - 0.7 * BEADS.grain_mm)
    assert 2 / 3 * above_mg < brought_mg <= above_mg
    assert (brought_mg < 0.9 * above_mg) == (slip_mm > 0.0)
    layer = layer_left(stroke, bed, sheet_mm)
    assert layer.gap_mm == pytest.approx(stroke.gap_mm - 0.7 * BEADS.grain_mm + slip_mm, abs=0.01)
    assert layer.mass_mg == pytest.approx(4000.0 - brought_mg)


@pytest.mark.parametrize(
    ("mortar", "fill_mg", "wanted_mg", "least", "most"),
    [(MORTAR, 20_000.0, 3500.0, 0.85, 1.25), (SMALL, 8000.0, 1500.0, 0.75, 1.3)],
    ids=["shipped", "small"],
)
@pytest.mark.parametrize("name", first_daily("monosodium_glutamate", "glass_beads", "titanium_dioxide"))
def test_strokes_one_after_another_bring_what_is_expected_of_the_layers(
    name: str, mortar: Mortar, fill_mg: float, wanted_mg: float, least: float, most: float
) -> None:
    powder = POWDERS[name]
    field, layer, in_mortar_mg = HeightField(mortar, powder), None, fill_mg
    ratios = []
    for heading_deg in ACROSS_DEG:
        bed = Bed(mortar, in_mortar_mg, powder, layer)
        stroke = replace(chosen(bed, LADLE, wanted_mg), heading_deg=heading_deg)
        in_cone_mg, lost_mg = through(stroke, field, in_mortar_mg, mortar)
        in_mortar_mg -= in_cone_mg + lost_mg
        ratios.append(in_cone_mg / expected_mg(stroke, bed, SHEET_MM))
        layer = layer_left(stroke, bed, SHEET_MM)
    if name == "titanium_dioxide" and mortar is SMALL:
        most = 1.6  # more of what such steep powder has left beside comes along than is expected; the loads tell
    assert all(least < ratio < most for ratio in ratios), ratios


@pytest.mark.parametrize("name", first_daily("glass_beads", "monosodium_glutamate"))
@pytest.mark.parametrize(("bore_mm", "depth_mm"), [(110.0, 50.0), (120.0, 40.0), (95.0, 40.0), (110.0, 30.0)])
def test_in_wide_and_deep_bowls_the_swing_goes_on_until_what_it_took_stays_in(
    bore_mm: float, depth_mm: float, name: str
) -> None:
    """With the widest rim the handle stopped it halfway, and of 3.8 g that were expected 0.1 to 3.1 came."""
    bowl = Mortar(
        name="bowl", bore_mm=bore_mm, depth_mm=depth_mm, height_mm=depth_mm + 12, outer_diameter_mm=bore_mm + 20
    )
    bed = Bed(bowl, 10_000.0, POWDERS[name])
    stroke = chosen(bed, LADLE, 4000.0)
    in_cone_mg, lost_mg = through(stroke, HeightField(bowl, POWDERS[name]), bed.mass_mg, bowl)
    assert in_cone_mg == pytest.approx(expected_mg(stroke, bed, SHEET_MM), rel=0.12)
    assert lost_mg < 10.0


@pytest.mark.parametrize(
    ("bore_mm", "depth_mm", "fill_mg"), [(127.4, 42.4, 5000.0), (70.0, 24.0, 750.0), (65.0, 22.0, 750.0)]
)
def test_the_lip_comes_to_the_wall_behind_the_powder_with_every_rim(
    bore_mm: float, depth_mm: float, fill_mg: float
) -> None:
    """Where it came beyond the middle, 0.1 of 3.3 g came, and nothing of 0.6 g, and all was believed to be there."""
    bowl = Mortar(name="bowl", bore_mm=bore_mm, depth_mm=depth_mm, height_mm=50.0, outer_diameter_mm=bore_mm + 16.6)
    bed = Bed(bowl, fill_mg, BEADS)
    strokes = list(strokes_in(bed, LADLE, 3800.0, [0.0]))
    for stroke in strokes:
        path = stroke_path(Vessel.of(bowl), stroke, Ladle())
        assert path.lip_mm[path.on_wall][0, 0] < -4.0, stroke
    if bore_mm < 100.0:
        in_cone_mg, _ = through(strokes[-1], HeightField(bowl, BEADS), fill_mg, bowl)
        assert in_cone_mg > 0.75 * expected_mg(strokes[-1], bed, SHEET_MM)


def test_a_stroke_is_chosen_for_the_cells_own_hand() -> None:
    """A thicker clamp meets the edge halfway: with the rim of the usual hand all slid out again."""
    bowl = Mortar(name="bowl", bore_mm=111.0, depth_mm=46.0, height_mm=55.0, outer_diameter_mm=125.0)
    bed, thick = Bed(bowl, 10_000.0, BEADS), Ladle(SHEET_MM, handle_radius_mm=23.0)
    stroke = chosen(bed, thick, 4000.0)
    path = stroke_path(Vessel.of(bowl), stroke, thick)
    assert path.lip_mm[path.on_wall][-1, 2] > path.apex_mm[path.on_wall][-1, 2], "it is level before the lip leaves"
    assert stroke.open_mm < chosen(bed, LADLE, 4000.0).open_mm


def test_a_bowl_in_which_the_lip_comes_beyond_the_middle_is_refused() -> None:
    bowl = Mortar(name="bowl", bore_mm=54.0, depth_mm=26.7, height_mm=35.0, outer_diameter_mm=72.0)
    with pytest.raises(NoStrokeError, match="beyond the middle, past the powder"):
        chosen(Bed(bowl, 2900.0, BEADS), LADLE, 3800.0)


def test_narrower_strokes_are_tried_once_the_widest_has_been_in_every_direction() -> None:
    strokes = strokes_in(Bed(MORTAR, 12_000.0, BEADS), LADLE, 4000.0, [90.0, 270.0])
    assert [(stroke.open_mm, stroke.heading_deg) for stroke in strokes] == [
        *((82.0, 90.0), (82.0, 270.0), (74.0, 90.0), (74.0, 270.0)),
        *((66.0, 90.0), (66.0, 270.0), (58.0, 90.0), (58.0, 270.0)),
    ]


def test_those_for_less_keep_farther_from_the_wall_than_any_for_all() -> None:
    """A dose was lost where the arm could not bring the lip so low, with 25 g in the mortar."""
    bed = Bed(MORTAR, 12_000.0, BEADS)
    for_all, for_less = (list(some(bed, LADLE, 4000.0, [90.0])) for some in (strokes_in, strokes_for_less))
    assert min(stroke.gap_mm for stroke in for_less) > max(stroke.gap_mm for stroke in for_all)
    assert for_less[0] == replace(chosen(bed, LADLE, 2000.0), heading_deg=90.0)


def test_of_the_last_of_a_small_bowl_a_little_is_taken_where_there_is_no_stroke_for_more() -> None:
    """The last sample was lost to arm.no_path, with half a gram in the mortar, of which strokes bring a fifth each."""
    bowl = Mortar(name="small", bore_mm=65.0, depth_mm=22.0, height_mm=36.0, outer_diameter_mm=85.0)
    bed = Bed(bowl, 493.0, POWDERS["monosodium_glutamate"], Layer(gap_mm=0.1, mass_mg=29.1, beside_mg=635.4))
    with pytest.raises(NoStrokeError, match="beyond the middle, past the powder"):
        chosen(bed, LADLE, 490.0)
    stroke = next(strokes_for_less(bed, LADLE, 1960.0, [90.0]))
    assert expected_mg(stroke, bed, LADLE.slant_mm) == pytest.approx(99.0, abs=1.0)


def test_the_less_there_is_the_more_of_it_lies_at_the_sides_where_strokes_leave_it() -> None:
    """Taken to lie as thick everywhere, what was left brought 1.04 of what was expected at first and 0.75 at last."""
    powder = POWDERS["monosodium_glutamate"]
    field, layer, in_mortar_mg = HeightField(MORTAR, powder), None, 20_000.0
    shares = []
    for heading_deg in ACROSS_DEG:
        bed = Bed(MORTAR, in_mortar_mg, powder, layer)
        stroke = replace(chosen(bed, LADLE, 4500.0), heading_deg=heading_deg)
        in_cone_mg, lost_mg = through(stroke, field, in_mortar_mg, MORTAR)
        in_mortar_mg -= in_cone_mg + lost_mg
        shares.append(in_cone_mg / expected_mg(stroke, bed, SHEET_MM))
        layer = layer_left(stroke, bed, SHEET_MM)
    assert in_mortar_mg < 4000.0
    assert min(shares) > 0.88, shares


@pytest.mark.parametrize(("name", "apart"), [("glass_beads", 1.4), ("monosodium_glutamate", 1.35)])
def test_half_of_each_load_returned_the_small_mortar_goes_on_giving_what_is_expected(name: str, apart: float) -> None:
    """What falls back lies beside the strokes: taken to lie level, a sixth stroke brought half of what was expected."""
    powder = POWDERS[name]
    field, layer, in_mortar_mg = HeightField(SMALL, powder), None, 12_000.0
    shares, lifted_mg = [], []
    for heading_deg in (*ACROSS_DEG, 60.0, 300.0):
        bed = Bed(SMALL, in_mortar_mg, powder, layer)
        stroke = replace(chosen(bed, LADLE, 4000.0), heading_deg=heading_deg)
        in_cone_mg, lost_mg = through(stroke, field, in_mortar_mg, SMALL)
        in_mortar_mg -= in_cone_mg / 2 + lost_mg
        lifted_mg.append(in_cone_mg)
        shares.append(in_cone_mg / expected_mg(stroke, bed, SHEET_MM))
        layer = layer_left(stroke, bed, SHEET_MM)
    assert max(shares) / min(shares) < apart, shares
    assert min(lifted_mg) > 0.6 * lifted_mg[0], lifted_mg


@pytest.mark.parametrize(
    ("loose_grains", "least", "most", "off_by"),
    [(0.0, 0.8, 0.9, 0.1), (0.7, 0.95, 1.05, 0.1), (2.0, 1.15, 1.3, 0.15)],
)
def test_how_loosely_grains_lie_on_a_wall_no_lab_knows_and_the_first_load_tells(
    loose_grains: float, least: float, most: float, off_by: float
) -> None:
    """The skill takes what was seen of round ones."""
    figures = BEADS.simulation.model_copy(update={"grain_mm": 0.5, "loose_grains": loose_grains})
    powder = BEADS.model_copy(update={"grain_mm": 0.5, "simulation": figures})
    source = Source.model_construct(name="lot", mortar=MORTAR, powder=powder, lot="1")
    field, believed, in_mortar_mg = HeightField(MORTAR, powder), Believed(), 20_000.0
    believed.source_holds("lot", in_mortar_mg)
    off = []
    for heading_deg in ACROSS_DEG:
        bed = Bed(MORTAR, believed.sources_mg["lot"], powder, believed.layers.get("lot"))
        wanted_mg = 3500.0 / believed.yields.get("lot", 1.0)
        stroke = replace(chosen(bed, LADLE, wanted_mg), heading_deg=heading_deg)
        came_mg, _ = through(stroke, field, in_mortar_mg, MORTAR)
        in_mortar_mg -= came_mg
        believed.scooped(source, expected_mg(stroke, bed, SHEET_MM), layer_left(stroke, bed, SHEET_MM))
        off.append(came_mg / believed.cone_mg)
        believed.dosing_ended(came_mg, 0.0)
        believed.gave_out(is_short=False)
    assert least < off[0] < most
    assert sum(abs(share - 1.0) for share in off[1:]) / 3 < off_by, off


@pytest.mark.parametrize("mortar", [MORTAR, SMALL], ids=["shipped", "small"])
@pytest.mark.parametrize("name", ["glass_beads", "monosodium_glutamate", "titanium_dioxide"])
@pytest.mark.parametrize("fill_mg", [1500.0, 4000.0, 8000.0, 12_000.0])
def test_nothing_is_pushed_over_a_mortars_edge(name: str, mortar: Mortar, fill_mg: float) -> None:
    powder = POWDERS[name]
    stroke = chosen(Bed(mortar, fill_mg, powder), LADLE, 0.95 * powder.load_limit_mg)
    _, lost_mg = through(stroke, HeightField(mortar, powder), fill_mg, mortar)
    assert lost_mg < 0.002 * fill_mg


def sunk_mm3(path: StrokePath, level_mm: float, step_mm: float = 2.0) -> float:
    """The most of the cone that is below a level, counted in cubes: of that, more than it takes up is pushed aside."""
    line = np.arange(-60.0, 60.0, step_mm)
    cubes = np.stack(np.meshgrid(line, line, np.arange(0.0, level_mm, step_mm), indexing="ij"), axis=-1).reshape(-1, 3)
    half_mm = path.rim_mm / 2
    most_mm3 = 0.0
    for apex_mm, axis, half in list(zip(path.apex_mm, path.axis, half_mm, strict=True))[::4]:
        high_mm = math.sqrt(SHEET_MM**2 - half**2)
        along_mm = (cubes - apex_mm) @ axis
        out_mm = np.sqrt(np.maximum(((cubes - apex_mm) ** 2).sum(axis=1) - along_mm**2, 0.0))
        inside = (along_mm > 0.0) & (along_mm < high_mm) & (out_mm < half / high_mm * along_mm)
        most_mm3 = max(most_mm3, float(inside.sum()) * step_mm**3)
    return most_mm3


@pytest.mark.parametrize(("repose_deg", "fill"), [(30.0, 0.75), (30.0, 0.85), (58.0, 0.8)])
@pytest.mark.parametrize(("bore_mm", "depth_mm"), [(94.6, 41.8), (90.0, 30.0)])
def test_in_a_mortar_that_is_nearly_full_the_sheet_pushes_nothing_over_the_edge(
    bore_mm: float, depth_mm: float, fill: float, repose_deg: float
) -> None:
    """Behind the lip it dips into the bed: swung to where the lip was to go, it pushed out up to 0.4 g."""
    powder = BEADS.model_copy(update={"repose_deg": repose_deg})
    bowl = Mortar(name="bowl", bore_mm=bore_mm, depth_mm=depth_mm, height_mm=50.0, outer_diameter_mm=bore_mm + 8.0)
    in_mortar_mg = fill * bowl.capacity_mm3 * powder.bulk_density_mg_per_mm3
    bed = Bed(bowl, in_mortar_mg, powder)
    stroke = chosen(bed, LADLE, 2500.0)
    in_cone_mg, lost_mg = through(stroke, HeightField(bowl, powder), in_mortar_mg, bowl)
    assert in_cone_mg > 100.0
    assert lost_mg < 5.0
    free_mm3 = (1.0 - fill) * bowl.capacity_mm3
    sunk = sunk_mm3(stroke_path(Vessel.of(bowl), stroke, Ladle()), bed.surface_mm)
    assert sunk < free_mm3 / 3 + in_cone_mg / powder.bulk_density_mg_per_mm3


def test_a_bowl_that_was_nearly_full_goes_on_giving_loads_as_it_empties() -> None:
    """What the strokes have hollowed out is room for what the sheet dips into: else loads of 4 g became 0.2 g."""
    bowl = Mortar(name="bowl", bore_mm=102.7, depth_mm=31.7, height_mm=39.5, outer_diameter_mm=117.5)
    like = {"repose_deg": 50.8, "wall_friction_deg": 29.0, "bulk_density_mg_per_mm3": 0.48, "load_limit_mg": 6300.0}
    powder = BEADS.model_copy(update={**like, "grain_mm": 0.3})
    field, layer, there_mg = HeightField(bowl, powder), None, 42_500.0
    for heading_deg in (90.0, 270.0, 120.0, 240.0, 60.0, 300.0):
        bed = Bed(bowl, there_mg, powder, layer)
        stroke = replace(chosen(bed, LADLE, 5985.0), heading_deg=heading_deg)
        came_mg, spilled_mg = through(stroke, field, there_mg, bowl)
        assert 3000.0 < came_mg < 6300.0
        assert spilled_mg < 10.0
        layer = layer_left(stroke, bed, SHEET_MM)
        there_mg -= came_mg + spilled_mg


def unseen_loads_mg(mortar: Mortar, powder: Powder, fill: float, wanted_mg: float) -> list[tuple[float, float]]:
    """Of loads that are poured back but for 50 mg, and never weighed: what is expected, and what the field brings."""
    there_mg = fill * mortar.capacity_mm3 * powder.bulk_density_mg_per_mm3
    field, layer, loads_mg = HeightField(mortar, powder), None, list[tuple[float, float]]()
    for heading_deg in (0.0, 180.0, 30.0, 330.0, 210.0):
        bed = Bed(mortar, there_mg, powder, layer)
        stroke = replace(chosen(bed, LADLE, wanted_mg), heading_deg=heading_deg)
        came_mg, _ = through(stroke, field, there_mg, mortar)
        loads_mg.append((expected_mg(stroke, bed, SHEET_MM), came_mg))
        layer = layer_left(stroke, bed, SHEET_MM)
        there_mg -= 50.0
    return loads_mg


def full_bowl(repose_deg: float, g_per_cm3: float, bore_mm: float = 130.0) -> tuple[Mortar, Powder]:
    bowl = Mortar(name="bowl", bore_mm=bore_mm, depth_mm=45.0, height_mm=53.0, outer_diameter_mm=bore_mm + 8.0)
    like = {"repose_deg": repose_deg, "bulk_density_mg_per_mm3": g_per_cm3, "load_limit_mg": 3900.0}
    return bowl, POWDERS["lithium_carbonate"].model_copy(update=like)


@pytest.mark.parametrize("wanted_mg", [2150.0, 3705.0])
@pytest.mark.parametrize("fill", [0.55, 0.65])
def test_of_a_full_bowl_loads_that_go_back_unseen_stay_within_what_may_be_carried(
    fill: float, wanted_mg: float
) -> None:
    """Of a dense, cohesive powder each heap lay whole on the next stroke's way, which went deeper: 3.1 to 5.4 g."""
    loads_mg = unseen_loads_mg(*full_bowl(58.0, 2.5), fill, wanted_mg)
    assert all(came_mg <= BENT_LIMIT * 3900.0 for _, came_mg in loads_mg)
    assert all(came_mg > 1500.0 for _, came_mg in loads_mg)


def test_what_is_poured_back_into_a_full_bowl_is_expected_to_lie_on_the_strokes_way() -> None:
    """Spread level, of which a stroke takes little, it had the next ones go deeper: 1.3 to 1.8 of what was expected."""
    loads_mg = unseen_loads_mg(*full_bowl(38.0, 0.85), 0.65, 2150.0)
    assert all(0.9 < came_mg / should_mg < 1.4 for should_mg, came_mg in loads_mg)


@pytest.mark.parametrize(("bore_mm", "depth_mm"), [(90.0, 30.0), (110.0, 40.0)])
def test_a_mortar_full_to_the_edge_is_not_scooped_from(bore_mm: float, depth_mm: float) -> None:
    bowl = Mortar(name="bowl", bore_mm=bore_mm, depth_mm=depth_mm, height_mm=50.0, outer_diameter_mm=bore_mm + 8.0)
    with pytest.raises(NoStrokeError, match="over the edge"):
        chosen(Bed(bowl, bowl.capacity_mm3 * BEADS.bulk_density_mg_per_mm3, BEADS), LADLE, 4750.0)


def test_a_lip_that_went_to_the_small_mortars_edge_would_push_powder_over_it() -> None:
    for fill_mg in (2000.0, 4000.0):
        stroke = chosen(Bed(SMALL, fill_mg, BEADS), LADLE, 4750.0)
        to_edge = replace(stroke, end_mm=math.inf)
        _, lost_mg = through(to_edge, HeightField(SMALL, BEADS), fill_mg, SMALL)
        assert lost_mg > 5.0


def test_the_more_is_pushed_the_earlier_the_lip_leaves_the_wall_but_not_before_the_sheet_is_level() -> None:
    ends_mm = [chosen(Bed(SMALL, fill_mg, BEADS), LADLE, math.inf).end_mm for fill_mg in (500.0, 2000.0, 4000.0)]
    assert ends_mm == sorted(ends_mm, reverse=True)
    assert len(set(ends_mm)) == 3
    level_mm = SMALL.bowl_radius_mm * math.radians(least_attack_deg(SMALL.bowl_radius_mm, SHEET_MM))
    much = chosen(Bed(SMALL, 12_000.0, POWDERS["titanium_dioxide"]), LADLE, math.inf)
    assert much.gap_mm > LIP_GAP_MM, "there is more than may be pushed"
    assert level_mm <= much.end_mm < level_mm + 2.0
    little = chosen(Bed(MORTAR, 4000.0, BEADS), LADLE, math.inf)
    below_edge_mm = MORTAR.depth_mm - Vessel.of(MORTAR).wall(np.array([little.end_mm]))[1][0]
    assert 1.0 <= below_edge_mm < 1.8, "it slides into the cone before; the rim is higher"


@pytest.mark.parametrize(("bore_mm", "depth_mm"), [(30.0, 10.0), (50.0, 17.0), (120.0, 10.0)])
def test_a_bowl_in_which_the_sheet_is_never_level_is_refused(bore_mm: float, depth_mm: float) -> None:
    """Too small for the sheet, or shallower than the attack is steep: no gap is deep enough."""
    bowl = Mortar(name="bowl", bore_mm=bore_mm, depth_mm=depth_mm, height_mm=45.0, outer_diameter_mm=bore_mm + 10.0)
    with pytest.raises(NoStrokeError, match="before the sheet is level"):
        chosen(Bed(bowl, 2000.0, BEADS), LADLE, 4750.0)


@pytest.mark.parametrize("fill", [0.1, 0.5, 0.8])
@pytest.mark.parametrize(("bore_mm", "depth_mm"), [(92.9, 21.9), (106.5, 28.6), (120.0, 38.7)])
def test_of_a_full_mortar_a_stroke_begins_above_its_edge(bore_mm: float, depth_mm: float, fill: float) -> None:
    """Its lip, which leaves a thick layer, may be there where it comes to the powder."""
    bowl = Mortar(name="bowl", bore_mm=bore_mm, depth_mm=depth_mm, height_mm=50.0, outer_diameter_mm=bore_mm + 10.0)
    bed = Bed(bowl, fill * bowl.capacity_mm3 * BEADS.bulk_density_mg_per_mm3, BEADS)
    path = stroke_path(Vessel.of(bowl), chosen(bed, LADLE, 4750.0), Ladle())
    assert min(path.lip_mm[0, 2], path.apex_mm[0, 2]) >= bowl.depth_mm + 9.0


@pytest.mark.parametrize("bore_mm", [91.3, 120.7])
def test_half_of_a_sphere_is_one_however_it_is_rounded(bore_mm: float) -> None:
    bowl = Mortar(name="bowl", bore_mm=bore_mm, depth_mm=bore_mm / 2, height_mm=70.0, outer_diameter_mm=bore_mm + 10.0)
    bed = Bed(bowl, 8000.0, BEADS)
    assert expected_mg(chosen(bed, LADLE, 4750.0), bed, SHEET_MM) > 0.0
    assert np.isfinite(HeightField(bowl, BEADS).surface_mm()).all()


def test_of_more_than_is_wanted_between_two_gaps_of_the_grid_a_part_is_taken() -> None:
    """Of a powder of which little may be taken at once, in a large full mortar."""
    powder = BEADS.model_copy(update={"load_limit_mg": 500.0})
    bowl = Mortar(name="large", bore_mm=130.0, depth_mm=40.0, height_mm=50.0, outer_diameter_mm=140.0)
    in_mortar_mg, layer = 0.5 * bowl.capacity_mm3 * powder.bulk_density_mg_per_mm3, None
    for _ in range(12):
        bed = Bed(bowl, in_mortar_mg, powder, layer)
        stroke = chosen(bed, LADLE, 475.0)
        expected = expected_mg(stroke, bed, SHEET_MM)
        assert 0.9 * LITTLE_SHARE * 475.0 <= expected <= 475.0
        in_mortar_mg, layer = in_mortar_mg - expected, layer_left(stroke, bed, SHEET_MM)


def test_of_what_lay_before_a_lip_that_left_the_wall_some_is_not_expected() -> None:
    bed = Bed(SMALL, 4000.0, BEADS)
    stroke = chosen(bed, LADLE, math.inf)
    to_edge = replace(stroke, end_mm=math.inf)
    assert 0.8 < expected_mg(stroke, bed, SHEET_MM) / expected_mg(to_edge, bed, SHEET_MM) < 0.95


def test_of_coarse_grains_a_layer_is_left_that_they_pass_through_or_none() -> None:
    coarse = BEADS.model_copy(update={"grain_mm": 1.0})
    bed = Bed(MORTAR, 12_000.0, coarse)
    gaps_mm = {chosen(bed, LADLE, wanted_mg).gap_mm for wanted_mg in (100.0, 1000.0, 4000.0, 8000.0, 12_000.0)}
    assert min(gaps_mm) == LIP_GAP_MM
    assert min(gaps_mm - {LIP_GAP_MM}) >= 4.0


def test_of_grains_as_coarse_as_the_bed_is_thick_a_thinner_layer_is_left_but_never_is_nothing_expected() -> None:
    coarse = BEADS.model_copy(update={"grain_mm": 3.0})
    for mortar, fill_mg in itertools.product((MORTAR, SMALL), (6000.0, 8000.0, 12_000.0)):
        bed = Bed(mortar, fill_mg, coarse)
        stroke = chosen(bed, LADLE, 4750.0)
        assert LIP_GAP_MM < stroke.gap_mm < 4 * 3.0
        assert stroke.gap_mm > 3.0, "a grain passes"
        assert expected_mg(stroke, bed, SHEET_MM) > 30.0
    pebbles = BEADS.model_copy(update={"grain_mm": 15.0})
    with pytest.raises(NoStrokeError, match="thinner than one grain of 15 mm"):
        chosen(Bed(MORTAR, 6000.0, pebbles), LADLE, 2000.0)
    said = r"500\.0 mg of powder lie thinner than one grain of 3 mm, and at most 25\.0 mg may be taken"
    with pytest.raises(NoStrokeError, match=said):
        chosen(Bed(MORTAR, 500.0, coarse), LADLE, 25.0)


@pytest.mark.parametrize(
    ("name", "mortar", "fill_mg", "strokes", "left"),
    [("glass_beads", MORTAR, 12_000.0, 4, 0.02), ("monosodium_glutamate", SMALL, 6000.0, 8, 0.03)],
)
def test_a_few_strokes_leave_next_to_nothing_and_less_is_believed_to_be_there_only_as_it_is(
    name: str, mortar: Mortar, fill_mg: float, strokes: int, left: float
) -> None:
    powder = POWDERS[name]
    field, layer, there_mg, believed_mg = HeightField(mortar, powder), None, fill_mg, fill_mg
    for heading_deg in (*ACROSS_DEG, 60.0, 300.0, 30.0, 330.0)[:strokes]:
        bed = Bed(mortar, believed_mg, powder, layer)
        stroke = replace(chosen(bed, LADLE, 4750.0), heading_deg=heading_deg)
        in_cone_mg, lost_mg = through(stroke, field, there_mg, mortar)
        there_mg -= in_cone_mg + lost_mg
        layer, believed_mg = layer_left(stroke, bed, SHEET_MM), believed_mg - expected_mg(stroke, bed, SHEET_MM)
        assert abs(believed_mg - there_mg) < 0.09 * fill_mg
    assert there_mg < left * fill_mg


@pytest.mark.parametrize(("filled", "is_lens"), [(0.45, False), (0.55, True)])
def test_a_stroke_in_a_bowl_more_than_half_full_cuts_a_lens_and_so_do_those_after_it(
    filled: float, is_lens: bool
) -> None:
    fill_mg = filled * SMALL.capacity_mm3 * BEADS.bulk_density_mg_per_mm3
    bed = Bed(SMALL, fill_mg, BEADS)
    layer = layer_left(chosen(bed, LADLE, 2000.0), bed, SHEET_MM)
    assert layer.is_lens == is_lens
    then = Bed(SMALL, 0.8 * fill_mg, BEADS, layer)
    assert layer_left(chosen(then, LADLE, 2000.0), then, SHEET_MM).is_lens == is_lens


def test_coarser_grains_are_kept_farther_from_the_edge() -> None:
    fine = POWDERS["glass_beads"]
    coarse = fine.model_copy(update={"grain_mm": 3.0})
    ends_mm = [chosen(Bed(SMALL, 4000.0, powder), LADLE, 4750.0).end_mm for powder in (fine, coarse)]
    assert ends_mm[1] < ends_mm[0] - 2.0
    ends_mm = [chosen(Bed(MORTAR, 12_000.0, powder), LADLE, math.inf).end_mm for powder in (fine, coarse)]
    assert ends_mm[1] < ends_mm[0] - 1.5


def test_after_a_load_that_brought_nothing_a_stroke_is_chosen_that_brings_some_wherever_that_lies() -> None:
    in_mortar_mg, most_mg = 12_000.0, 4750.0
    layer = layer_left(
        chosen(Bed(SMALL, in_mortar_mg, BEADS), LADLE, most_mg), Bed(SMALL, in_mortar_mg, BEADS), SHEET_MM
    )
    missed = replace(layer, beside_mg=layer.beside_mg + most_mg, missed_mg=most_mg)
    bed, there = Bed(SMALL, in_mortar_mg, BEADS, missed), Bed(SMALL, in_mortar_mg - most_mg, BEADS, layer)
    stroke = chosen(bed, LADLE, 0.8 * most_mg)
    assert expected_mg(stroke, bed, SHEET_MM) <= 0.8 * most_mg
    assert expected_mg(stroke, there, SHEET_MM) > 0.1 * most_mg


@pytest.mark.parametrize("name", ["titanium_dioxide", "monosodium_glutamate", "glass_beads"])
@pytest.mark.parametrize(("mortar", "fill_mg"), [(MORTAR, 20_000.0), (SMALL, 12_000.0)], ids=["larger", "small"])
def test_after_a_load_that_was_poured_back_the_next_one_is_within_the_limit(
    name: str, mortar: Mortar, fill_mg: float
) -> None:
    """By the height field, where that lies as a heap in the middle: of titanium dioxide 4.8 to 5.4 g came of 4."""
    powder, field = POWDERS[name], HeightField(mortar, POWDERS[name])
    bed = Bed(mortar, fill_mg, powder)
    first = chosen(bed, LADLE, 0.95 * powder.load_limit_mg)
    should_mg, layer = expected_mg(first, bed, SHEET_MM), layer_left(first, bed, SHEET_MM)
    assert through(first, field, fill_mg, mortar)[0] > 0.5 * should_mg
    missed = replace(layer, beside_mg=layer.beside_mg + should_mg, missed_mg=should_mg)
    then = chosen(Bed(mortar, fill_mg, powder, missed), LADLE, 0.8 * powder.load_limit_mg)
    lifted_mg, lost_mg = through(then, field, fill_mg, mortar)
    assert 0.2 * should_mg < lifted_mg < 0.95 * powder.load_limit_mg
    assert lost_mg < 1.0


def test_less_than_what_lies_beside_and_comes_along_is_no_wish_that_cannot_be_met() -> None:
    bed = Bed(SMALL, 12_000.0, BEADS, Layer(2.0, 7000.0, beside_mg=5000.0))
    stroke = chosen(bed, LADLE, 300.0)
    assert 300.0 < expected_mg(stroke, bed, SHEET_MM) < 0.51 * 5000.0


HEAVY = BEADS.model_copy(update={"bulk_density_mg_per_mm3": 2.5, "load_limit_mg": 2000.0, "repose_deg": 40.0})
LIGHT = BEADS.model_copy(update={"bulk_density_mg_per_mm3": 1.23, "load_limit_mg": 1500.0, "repose_deg": 47.0})


@pytest.mark.parametrize(
    ("mortar", "powder", "fill_mg"),
    [
        (MORTAR, HEAVY, 5000.0),
        (SMALL, LIGHT, 2445.0),
        (Mortar(name="bowl", bore_mm=73.4, depth_mm=26.2, height_mm=34.0, outer_diameter_mm=94.0), LIGHT, 2445.0),
    ],
)
def test_of_a_thin_bed_a_sheet_that_bends_brings_no_more_than_may_be_carried(
    mortar: Mortar, powder: Powder, fill_mg: float
) -> None:
    stroke = chosen(Bed(mortar, fill_mg, powder), LADLE, 0.95 * powder.load_limit_mg)
    loads_mg, _ = through(stroke, HeightField(mortar, powder), fill_mg, mortar)
    assert 0.5 * powder.load_limit_mg < loads_mg < 1.15 * powder.load_limit_mg


@pytest.mark.parametrize(("bore_mm", "depth_mm", "fill"), [(120.0, 30.0, 0.45), (130.0, 45.0, 0.3)])
def test_of_a_wide_bowl_of_dense_powder_the_first_load_is_near_the_limit(
    bore_mm: float, depth_mm: float, fill: float
) -> None:
    """A rim leans from the wall's upright, and so scrapes more of a flat bowl: 3.8 to 4.1 g came of 3.1."""
    bowl = Mortar(name="bowl", bore_mm=bore_mm, depth_mm=depth_mm, height_mm=53.0, outer_diameter_mm=bore_mm + 8.0)
    like = {"repose_deg": 48.0, "wall_friction_deg": 33.0, "bulk_density_mg_per_mm3": 2.4, "load_limit_mg": 3100.0}
    powder = BEADS.model_copy(update=like)
    fill_mg = fill * bowl.capacity_mm3 * 2.4
    stroke = chosen(Bed(bowl, fill_mg, powder), LADLE, 0.95 * 3100.0)
    came_mg, _ = through(stroke, HeightField(bowl, powder), fill_mg, bowl)
    assert 0.7 * 3100.0 < came_mg < 1.18 * 3100.0


def test_where_half_a_millimetre_is_more_than_the_load_limit_a_stroke_is_made_that_should_keep_it() -> None:
    bowl = Mortar(name="bowl", bore_mm=110.0, depth_mm=34.0, height_mm=42.0, outer_diameter_mm=130.0)
    powder = HEAVY.model_copy(update={"bulk_density_mg_per_mm3": 4.0, "load_limit_mg": 300.0})
    bed = Bed(bowl, 20_000.0, powder)
    assert 0.2 * 300.0 < expected_mg(chosen(bed, Ladle(60.0), 285.0), bed, 60.0) <= 285.0


def test_a_question_about_the_same_bed_is_answered_once() -> None:
    """A check asks ten times, each dry run of a plan again: a tenth of a second each."""
    first, again = (chosen(bed_for(MORTAR, 9_876.0, BEADS, LADLE), LADLE, 2_345.0) for _ in range(2))
    assert first is again
    assert chosen(bed_for(MORTAR, 9_875.0, BEADS, LADLE), LADLE, 2_345.0) is not first
