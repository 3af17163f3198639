"""Which stroke is chosen of a mortar's bed, and what it is expected to bring; held against the height field."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from daily import first_daily
from hypothesis import given, settings
from hypothesis import strategies as st
from stroke_bench import BEADS, LADLE, MORTAR, POWDERS, SHEET_MM, SMALL, masses_mg, through

from scuhand_bt.dosing.bed import Bed, Layer
from scuhand_bt.dosing.beds import bed_for, strokes_for_less, strokes_in
from scuhand_bt.dosing.ladle import LIP_GAP_MM, Ladle, NoStrokeError
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
from scuhand_bt.dosing.swing import stroke_path
from scuhand_bt.dosing.vessel import Vessel
from scuhand_bt.sim.bed import HeightField
from scuhand_bt.specs import Mortar, Powder


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


def test_a_rim_narrower_than_the_bed_brings_its_strip() -> None:
    bed = Bed(MORTAR, 20_000.0, BEADS)
    wide = chosen(bed, LADLE, math.inf)
    narrow = replace(wide, open_mm=bed.radius_mm)
    assert expected_mg(narrow, bed, SHEET_MM) == pytest.approx(0.609 * expected_mg(wide, bed, SHEET_MM), rel=1e-3)


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


@pytest.mark.parametrize(("bore_mm", "depth_mm"), [(30.0, 10.0), (50.0, 17.0), (120.0, 10.0)])
def test_a_bowl_in_which_the_sheet_is_never_level_is_refused(bore_mm: float, depth_mm: float) -> None:
    """Too small for the sheet, or shallower than the attack is steep: no gap is deep enough."""
    bowl = Mortar(name="bowl", bore_mm=bore_mm, depth_mm=depth_mm, height_mm=45.0, outer_diameter_mm=bore_mm + 10.0)
    with pytest.raises(NoStrokeError, match="before the sheet is level"):
        chosen(Bed(bowl, 2000.0, BEADS), LADLE, 4750.0)


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
