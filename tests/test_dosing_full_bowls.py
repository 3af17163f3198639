"""Strokes near a bowl's edge: nothing is pushed over it, and loads stay within what may be carried."""

import math
from dataclasses import replace

import numpy as np
import pytest
from stroke_bench import BEADS, LADLE, MORTAR, POWDERS, SHEET_MM, SMALL, through

from scuhand_bt.dosing.bed import Bed
from scuhand_bt.dosing.ladle import LIP_GAP_MM, Ladle, NoStrokeError
from scuhand_bt.dosing.strokes import BENT_LIMIT, chosen, expected_mg, layer_left
from scuhand_bt.dosing.swing import StrokePath, stroke_path
from scuhand_bt.dosing.swing_plane import least_attack_deg
from scuhand_bt.dosing.vessel import Vessel
from scuhand_bt.sim.bed import HeightField
from scuhand_bt.specs import Mortar, Powder


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


@pytest.mark.parametrize("fill", [0.1, 0.5, 0.8])
@pytest.mark.parametrize(("bore_mm", "depth_mm"), [(92.9, 21.9), (106.5, 28.6), (120.0, 38.7)])
def test_of_a_full_mortar_a_stroke_begins_above_its_edge(bore_mm: float, depth_mm: float, fill: float) -> None:
    """Its lip, which leaves a thick layer, may be there where it comes to the powder."""
    bowl = Mortar(name="bowl", bore_mm=bore_mm, depth_mm=depth_mm, height_mm=50.0, outer_diameter_mm=bore_mm + 10.0)
    bed = Bed(bowl, fill * bowl.capacity_mm3 * BEADS.bulk_density_mg_per_mm3, BEADS)
    path = stroke_path(Vessel.of(bowl), chosen(bed, LADLE, 4750.0), Ladle())
    assert min(path.lip_mm[0, 2], path.apex_mm[0, 2]) >= bowl.depth_mm + 9.0


def test_of_what_lay_before_a_lip_that_left_the_wall_some_is_not_expected() -> None:
    bed = Bed(SMALL, 4000.0, BEADS)
    stroke = chosen(bed, LADLE, math.inf)
    to_edge = replace(stroke, end_mm=math.inf)
    assert 0.8 < expected_mg(stroke, bed, SHEET_MM) / expected_mg(to_edge, bed, SHEET_MM) < 0.95


def test_coarser_grains_are_kept_farther_from_the_edge() -> None:
    fine = POWDERS["glass_beads"]
    coarse = fine.model_copy(update={"grain_mm": 3.0})
    ends_mm = [chosen(Bed(SMALL, 4000.0, powder), LADLE, 4750.0).end_mm for powder in (fine, coarse)]
    assert ends_mm[1] < ends_mm[0] - 2.0
    ends_mm = [chosen(Bed(MORTAR, 12_000.0, powder), LADLE, math.inf).end_mm for powder in (fine, coarse)]
    assert ends_mm[1] < ends_mm[0] - 1.5
