"""Strokes in beakers and jars: what they should bring, held against the height field, and what is left for the next."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from dose_bench import shipped_powders

from scuhand_bt.bench_spec import Station
from scuhand_bt.device_specs.hand import HandSpec
from scuhand_bt.dosing.bed import BENDS_MM
from scuhand_bt.dosing.jars import LEAST_MG, JarBed, along_floor, has_way, sure_doses
from scuhand_bt.dosing.ladle import LIP_GAP_MM, Ladle, NoStrokeError, Stroke
from scuhand_bt.dosing.swing import stroke_path
from scuhand_bt.dosing.vessel import Vessel
from scuhand_bt.motion.cell_solids import hollow_mortar
from scuhand_bt.sim.bed import HeightField
from scuhand_bt.specs import Mortar, Powder

POWDERS = shipped_powders()
BEADS, MSG = POWDERS["glass_beads"], POWDERS["monosodium_glutamate"]
SHEET_MM = 50.0
LADLE = Ladle(SHEET_MM)
LOAD_MG = 4750.0
HEADINGS_DEG = (90.0, 270.0, 120.0, 240.0, 60.0, 300.0)


def jar(bore_mm: float = 95.0, depth_mm: float = 40.0) -> Mortar:
    return Mortar(
        name="jar",
        bore_mm=bore_mm,
        depth_mm=depth_mm,
        height_mm=depth_mm + 15.0,
        outer_diameter_mm=bore_mm + 8.0,
        corner_mm=5.0,
    )


def bed_in(vessel: Mortar, mass_mg: float, powder: Powder = BEADS) -> JarBed:
    return JarBed(vessel, mass_mg, powder, LADLE)


def brought_mg(vessel: Mortar, powder: Powder, fill_mg: float, strokes: Sequence[Stroke]) -> list[float]:
    """What strokes collect one after another, by the height field."""
    field, there_mg, brought = HeightField(vessel, powder), fill_mg, list[float]()
    for stroke in strokes:
        brought.append(swept_mg(field, vessel, stroke, there_mg))
        there_mg -= brought[-1]
    return brought


def swept_mg(field: HeightField, vessel: Mortar, stroke: Stroke, there_mg: float, most_lost_mg: float = 1e-6) -> float:
    """What a stroke collects of so much, by the height field."""
    path, in_cone_mg, over_mg = stroke_path(Vessel.of(vessel), stroke, Ladle()), 0.0, 0.0
    for apex_mm, axis, rim_mm in zip(path.apex_mm, path.axis, path.rim_mm, strict=True):
        gained_mg, lost_mg = field.move(apex_mm, axis, float(rim_mm), there_mg - in_cone_mg, in_cone_mg)
        in_cone_mg, over_mg = in_cone_mg + gained_mg, over_mg + lost_mg
    over_mg += field.leave()
    assert over_mg <= most_lost_mg, "nothing goes over a jar's edge"
    return in_cone_mg


@pytest.mark.parametrize(
    ("bore_mm", "depth_mm", "corner_mm"), [(95.0, 40.0, 5.0), (110.0, 25.0, 25.0), (60.0, 50.0, 30.0)]
)
def test_a_jar_holds_what_its_profile_encloses(bore_mm: float, depth_mm: float, corner_mm: float) -> None:
    vessel = jar(bore_mm, depth_mm).model_copy(update={"corner_mm": corner_mm})
    profile = Vessel.of(vessel)
    out_mm, high_mm, _ = profile.wall(np.linspace(0.0, profile.to_edge_mm, 20_000))
    enclosed_mm3 = math.pi * float(((out_mm[1:] + out_mm[:-1]) / 2) ** 2 @ np.diff(high_mm))
    assert vessel.capacity_mm3 == pytest.approx(enclosed_mm3, rel=1e-3)
    assert (out_mm[-1], high_mm[-1]) == pytest.approx((bore_mm / 2, depth_mm))


@pytest.mark.parametrize(
    ("vessel", "powder", "fill_mg", "share"),
    [
        (jar(), BEADS, 12_000.0, (0.85, 1.15)),
        (jar(80.0, 30.0), BEADS, 12_000.0, (0.6, 1.0)),
        pytest.param(jar(), MSG, 40_000.0, (0.65, 1.0), marks=pytest.mark.slow),
        pytest.param(jar(110.0), MSG, 12_000.0, (0.95, 1.3), marks=pytest.mark.slow),
    ],
    ids=["12 g", "narrow", "40 g", "wide"],
)
def test_a_first_stroke_brings_about_what_it_should_by_the_height_field(
    vessel: Mortar, powder: Powder, fill_mg: float, share: tuple[float, float]
) -> None:
    bed = bed_in(vessel, fill_mg, powder)
    stroke = bed.chosen(LOAD_MG, 90.0)
    (came_mg,) = brought_mg(vessel, powder, fill_mg, [stroke])
    assert share[0] < came_mg / bed.expected_mg(stroke) < share[1]
    assert came_mg < powder.load_limit_mg


@pytest.mark.slow
@pytest.mark.parametrize("powder", [BEADS, MSG], ids=["beads", "msg"])
def test_what_no_stroke_reaches_is_known_to_be_left(powder: Powder) -> None:
    vessel, fill_mg, layer, there_mg, strokes = jar(), 12_000.0, None, 12_000.0, list[Stroke]()
    expected_mg = 0.0
    while True:
        bed = JarBed(vessel, there_mg, powder, LADLE, layer)
        stroke = max((bed.chosen(LOAD_MG, heading_deg) for heading_deg in HEADINGS_DEG), key=bed.expected_mg)
        if bed.expected_mg(stroke) < 100.0:
            break
        strokes.append(stroke)
        expected_mg, layer = expected_mg + bed.expected_mg(stroke), bed.left_by(stroke)
        there_mg -= bed.expected_mg(stroke)
    came_mg = sum(brought_mg(vessel, powder, fill_mg, strokes))
    assert len(strokes) >= len(HEADINGS_DEG)
    assert 0.75 * expected_mg < came_mg < 1.5 * expected_mg
    assert came_mg < 0.5 * fill_mg, "a rigid rim leaves most of a thin layer"


def unseen_loads_mg(vessel: Mortar, powder: Powder, fill: float) -> list[float]:
    """Loads that are poured back but for 50 mg, and never weighed, by the height field."""
    there_mg = fill * vessel.capacity_mm3 * powder.bulk_density_mg_per_mm3
    field, layer, loads_mg = HeightField(vessel, powder), None, list[float]()
    for heading_deg in (0.0, 180.0, 35.0):
        bed = JarBed(vessel, there_mg, powder, LADLE, layer)
        stroke = bed.chosen(0.95 * powder.load_limit_mg, heading_deg)
        loads_mg.append(swept_mg(field, vessel, stroke, there_mg, most_lost_mg=20.0))
        layer = bed.left_by(stroke)
        there_mg -= 50.0
    return loads_mg


@pytest.mark.parametrize("repose_deg", [30.0, 58.0])
@pytest.mark.parametrize(
    ("bore_mm", "depth_mm", "corner_mm", "fill"), [(110.0, 90.0, 10.0, 0.8), (85.0, 22.0, 6.0, 0.95)]
)
def test_of_a_deep_and_full_jar_loads_stay_within_what_may_be_carried_and_nothing_goes_over_its_edge(
    bore_mm: float, depth_mm: float, corner_mm: float, fill: float, repose_deg: float
) -> None:
    """At a large gap a stroke begins farther behind, and brought twice what was expected; its end pushed out 0.4 g."""
    vessel = jar(bore_mm, depth_mm).model_copy(update={"corner_mm": corner_mm})
    like = {"repose_deg": repose_deg, "bulk_density_mg_per_mm3": 1.0, "load_limit_mg": 3900.0}
    powder = POWDERS["lithium_carbonate"].model_copy(update=like)
    loads_mg = unseen_loads_mg(vessel, powder, fill)
    assert all(1500.0 < came_mg <= 1.2 * powder.load_limit_mg for came_mg in loads_mg)


def test_a_stroke_where_one_was_made_brings_next_to_nothing_and_one_across_it_less() -> None:
    bed = bed_in(jar(), 12_000.0)
    first, across = (bed.chosen(LOAD_MG, heading_deg) for heading_deg in (90.0, 150.0))
    then = JarBed(jar(), 12_000.0 - bed.expected_mg(first), BEADS, LADLE, bed.left_by(first))
    assert then.expected_mg(first) < 0.02 * bed.expected_mg(first)
    assert 0.2 * bed.expected_mg(across) < then.expected_mg(across) < 0.8 * bed.expected_mg(across)


def test_what_is_filled_in_is_there_for_the_next_strokes_and_for_those_after_them() -> None:
    bed = bed_in(jar(), 12_000.0)
    there, across = (replace(along_floor(jar(), SHEET_MM), heading_deg=heading_deg) for heading_deg in (90.0, 180.0))
    left = bed.left_by(there)
    filled = JarBed(jar(), left.mass_mg + 10_000.0, BEADS, LADLE, left)
    assert filled.expected_mg(there) > 2.0 * bed.expected_mg(there), "it lies in the middle"
    later = filled.left_by(across)
    again = JarBed(jar(), later.mass_mg, BEADS, LADLE, later)
    assert again.expected_mg(there) > 0.1 * bed.expected_mg(there), "and beside the stroke across"


def test_the_rest_of_a_load_that_is_poured_back_is_found_again() -> None:
    bed = bed_in(jar(), 12_000.0)
    first, across = (bed.chosen(LOAD_MG, heading_deg) for heading_deg in (90.0, 150.0))
    left, rest_mg = bed.left_by(first), 800.0
    without = JarBed(jar(), left.mass_mg, BEADS, LADLE, left)
    poured = JarBed(jar(), left.mass_mg + rest_mg, BEADS, LADLE, left)
    for stroke in (first, across):
        assert poured.expected_mg(stroke) - without.expected_mg(stroke) == pytest.approx(rest_mg, rel=0.1)
    field, there_mg, came_mg = HeightField(jar(), BEADS), 12_000.0, list[float]()
    for stroke in (first, across):
        came_mg.append(swept_mg(field, jar(), stroke, there_mg))
        there_mg += rest_mg - came_mg[-1]
    assert came_mg[1] == pytest.approx(poured.expected_mg(across), rel=0.2)


@pytest.mark.parametrize("wanted_mg", [300.0, 1000.0, 4750.0])
@pytest.mark.parametrize("fill_mg", [500.0, 12_000.0, 120_000.0])
def test_no_more_is_met_than_is_wanted_and_a_layer_is_several_grains(wanted_mg: float, fill_mg: float) -> None:
    bed = bed_in(jar(), fill_mg)
    stroke = bed.chosen(wanted_mg, 30.0)
    assert bed.most_mg(stroke) <= wanted_mg
    assert stroke.heading_deg == 30.0
    assert stroke.gap_mm == LIP_GAP_MM or stroke.gap_mm >= BEADS.grain_mm
    if stroke.gap_mm > 1.0:
        bends_mg = bed.most_mg(replace(stroke, gap_mm=stroke.gap_mm - 0.25 - BENDS_MM))
        assert bends_mg > wanted_mg, "a deeper one brings too much, or would if the sheet bends"


@pytest.mark.parametrize("is_discarded", [False, True])
def test_as_many_doses_as_are_sure_come_of_a_jar_by_the_height_field(is_discarded: bool) -> None:
    """In a narrow one, whose first stroke brings two thirds of what it should."""
    vessel, headings_deg, doses_mg = jar(80.0), (90.0, 270.0, 120.0, 240.0), [400.0] * 9
    bed = JarBed(vessel, 12_000.0, MSG, LADLE)
    sure = sure_doses(bed, doses_mg, headings_deg, is_discarded=is_discarded)
    field, there_mg, came = HeightField(vessel, MSG), 12_000.0, 0
    for dose_mg in doses_mg:
        missing_mg = dose_mg
        while missing_mg > 0.0 and (strokes := bed.strokes(2800.0, headings_deg)):
            if bed.expected_mg(strokes[0]) < LEAST_MG:
                break
            lifted_mg = swept_mg(field, vessel, strokes[0], there_mg)
            bed, missing_mg = bed.after(strokes[0]), missing_mg - lifted_mg
            back_mg = 0.0 if is_discarded else max(0.0, -missing_mg)
            bed, there_mg = bed.with_more(back_mg), there_mg - lifted_mg + back_mg
        came += missing_mg <= 0.0
    assert 1 <= sure <= came < 9


@pytest.mark.parametrize("vessel", [jar(60.0), jar(95.0, 100.0)], ids=["narrow", "deep"])
def test_a_jar_that_the_hand_has_no_way_in_is_refused_with_what_would_do(vessel: Mortar) -> None:
    with pytest.raises(
        NoStrokeError,
        match=r"cannot move along the floor .*; a bore of (\d+) mm \(if there is room for it\) or a depth of (\d+) mm",
    ) as no:
        bed_in(vessel, 12_000.0).chosen(LOAD_MG, 0.0)
    bore_mm, depth_mm = (float(part.split()[0]) for part in str(no.value).split(" of ")[-2:])
    assert has_way(jar(bore_mm, vessel.depth_mm), LADLE)
    assert has_way(jar(vessel.bore_mm, depth_mm), LADLE)


def test_a_wide_jar_has_a_way_for_the_cells_own_larger_sheet() -> None:
    """Its rim of 100 mm is beyond what the roller of the usual sheet makes."""
    large = HandSpec(sheet_radius_mm=62.0)
    assert has_way(jar(125.0, 30.0), Ladle.of(large))


def test_the_lip_stays_on_the_floor_and_nothing_else_comes_to_the_wall() -> None:
    for vessel in (jar(), jar(110.0, 50.0), jar(80.0, 30.0)):
        path, profile = stroke_path(Vessel.of(vessel), along_floor(vessel, SHEET_MM), Ladle()), Vessel.of(vessel)
        np.testing.assert_allclose(path.lip_mm[path.on_wall, 2], LIP_GAP_MM, atol=1e-6)
        assert np.abs(path.lip_mm[path.on_wall, 0]).max() <= profile.floor_mm + 1e-6
        assert profile.clearance_mm(path.apex_mm).min() >= 3.0


def test_a_hollow_jar_is_free_inside_and_solid_in_its_wall() -> None:
    vessel = jar()
    station = Station(name="bay", kind="mortar", position_mm=(200.0, 240.0, 0.0))
    walls = [one for one in hollow_mortar(station, vessel) if one.box_m is not None]
    for radius_mm, high_mm, is_solid in (
        (40.0, 0.5, False),
        (46.0, 22.0, False),
        (49.0, 22.0, True),
        (47.0, 1.0, True),
    ):
        at_m = np.array([0.2 + radius_mm / 1e3, 0.24, (15.0 + high_mm) / 1e3])
        inside = [
            np.all(np.abs(at_m - one.centre_m) < np.array(one.box_m) / 2) for one in walls if abs(one.yaw_rad) < 1e-9
        ]
        assert any(inside) == is_solid, (radius_mm, high_mm)


def test_no_jar_is_advised_that_does_not_hold_what_there_is() -> None:
    vessel = jar(53.2, 41.8)
    there_mg = 0.5 * vessel.capacity_mm3 * BEADS.bulk_density_mg_per_mm3
    with pytest.raises(NoStrokeError) as told:
        JarBed(vessel, there_mg, BEADS, LADLE).chosen(LOAD_MG, 0.0)
    assert "a bore of" in str(told.value)
    assert "a depth of" not in str(told.value), "it would do, for less"
    with pytest.raises(NoStrokeError, match="a depth of"):
        JarBed(vessel, there_mg / 5, BEADS, LADLE).chosen(LOAD_MG, 0.0)
