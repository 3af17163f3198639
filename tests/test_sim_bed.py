"""The height field of a mortar's powder, by what a person would see who moved a cone through it."""

import json
import math

import numpy as np
import pytest
from dose_bench import shipped_powders
from hypothesis import given, settings
from hypothesis import strategies as st

from scuhand_bt.dosing.ladle import Ladle, Stroke
from scuhand_bt.dosing.swing import StrokePath, headings_deg, stroke_path
from scuhand_bt.dosing.vessel import Vessel
from scuhand_bt.sim.bed import CELL_MM, HeightField, passing_mm
from scuhand_bt.sim.cone_over import ConePose, Floats
from scuhand_bt.specs import Mortar, Powder

MORTAR = Mortar(name="agate", bore_mm=90.0, depth_mm=30.0, height_mm=45.0, outer_diameter_mm=115.0)
POWDERS = shipped_powders()
BEADS = POWDERS["glass_beads"]
UP = np.array([0.0, 0.0, 1.0])


class Bench:
    """A mortar, its bed, and how much is where."""

    def __init__(self, fill_mg: float = 12_000.0, powder: Powder = BEADS) -> None:
        self.bed = HeightField(MORTAR, powder)
        self.mortar_mg, self.cone_mg, self.spilled_mg = fill_mg, 0.0, 0.0

    def move(self, apex_mm: Floats, axis: Floats, rim_mm: float) -> None:
        gained_mg, lost_mg = self.bed.move(apex_mm, axis, rim_mm, self.mortar_mg, self.cone_mg)
        self.cone_mg += gained_mg
        self.mortar_mg -= gained_mg + lost_mg
        self.spilled_mg += lost_mg

    def go(self, path: StrokePath, to: int | None = None) -> None:
        for apex_mm, axis, rim_mm in list(zip(path.apex_mm, path.axis, path.rim_mm, strict=True))[:to]:
            self.move(apex_mm, axis, float(rim_mm))

    def take(self) -> float:
        """Lift what is in the cone away."""
        self.bed.leave()
        taken_mg, self.cone_mg = self.cone_mg, 0.0
        return taken_mg


def swing(open_mm: float, closed_mm: float, heading_deg: float = 0.0) -> StrokePath:
    return stroke_path(Vessel.of(MORTAR), Stroke(open_mm, closed_mm, -45.0, heading_deg=heading_deg), Ladle())


WIDE = swing(84.0, 76.0)


def test_a_cone_that_closes_upright_takes_nothing() -> None:
    bench = Bench()
    for height_mm, rim_mm in [(40.0, 66.0), (0.6, 66.0), (0.6, 54.0), (0.6, 42.0), (40.0, 42.0)]:
        bench.move(height_mm * UP, UP, rim_mm)
    assert bench.take() < 1.0
    assert bench.mortar_mg == pytest.approx(12_000.0, abs=1.0)


def test_a_lip_along_the_wall_takes_nearly_all() -> None:
    bench = Bench()
    bench.go(WIDE)
    assert bench.take() > 0.7 * 12_000.0


def test_narrow_strokes_take_less_and_the_next_ones_turned_collect_the_rest() -> None:
    bench, taken_mg = Bench(), []
    for heading_deg in headings_deg(4):
        bench.go(swing(60.0, 50.0, heading_deg))
        taken_mg.append(bench.take())
    assert 4000.0 < taken_mg[0] < 11_000.0
    assert sum(taken_mg) > 0.9 * 12_000.0
    assert taken_mg[0] < 1.05 * _first_mg(84.0, 76.0)


def _first_mg(open_mm: float, closed_mm: float) -> float:
    bench = Bench()
    bench.go(swing(open_mm, closed_mm))
    return bench.take()


def test_wider_gaps_than_a_grain_leave_what_is_below_them() -> None:
    lifted = Bench()
    for apex_mm, axis, rim_mm in zip(WIDE.apex_mm, WIDE.axis, WIDE.rim_mm, strict=True):
        lifted.move(apex_mm + 4.0 * UP, axis, float(rim_mm))
    scraped = Bench()
    scraped.go(WIDE)
    assert lifted.take() < scraped.take() - 1000.0


def test_grains_that_do_not_fit_under_the_lip_are_pushed_along() -> None:
    taken_mg = {}
    for grain_mm in (2.1, 2.4):
        figures = BEADS.simulation.model_copy(update={"grain_mm": grain_mm, "film_mm": 0.0})
        bench = Bench(6000.0)
        bench.bed = HeightField(MORTAR, BEADS.model_copy(update={"simulation": figures}), gives_mm=0.0)
        bench.go(stroke_path(Vessel.of(MORTAR), Stroke(84.0, 76.0, -45.0, gap_mm=2.0), Ladle()))
        taken_mg[grain_mm] = bench.take()
    assert taken_mg[2.1] < taken_mg[2.4] - 500.0


def test_the_wall_keeps_its_film() -> None:
    filmed = BEADS.model_copy(update={"simulation": BEADS.simulation.model_copy(update={"film_mm": 0.2})})
    left_mg = {}
    for name, powder in {"clean": BEADS, "filmed": filmed}.items():
        bench = Bench(4000.0, powder)
        for heading_deg in (0.0, 180.0, 90.0):
            bench.go(swing(84.0, 76.0, heading_deg))
            bench.take()
        left_mg[name] = bench.mortar_mg
    assert left_mg["filmed"] > left_mg["clean"] + 200.0


def tipped(bench: Bench, aside_mm: float) -> None:
    """Carry it aside from where a stroke ends, and tip it forwards."""
    for step_mm in np.arange(0.0, aside_mm + 1.0, 2.0):
        bench.move(WIDE.apex_mm[-1] + [step_mm, 0.0, 5.0], UP, 76.0)
    for tilt in np.radians(np.arange(0, 140, 2)):
        axis = np.array([math.sin(tilt), 0.0, math.cos(tilt)])
        bench.move(WIDE.apex_mm[-1] + [aside_mm, 0.0, 5.0], axis, 76.0)


def test_a_cone_that_is_tipped_over_the_mortar_gives_back_what_it_took() -> None:
    bench = Bench()
    bench.go(WIDE)
    held_mg = bench.cone_mg
    tipped(bench, 0.0)
    assert bench.cone_mg < 0.1 * held_mg
    assert bench.spilled_mg < 1.0


def test_a_cone_that_is_tipped_over_the_mortars_edge_spills() -> None:
    bench = Bench()
    bench.go(WIDE)
    held_mg = bench.cone_mg
    tipped(bench, 40.0)
    assert bench.cone_mg < 0.1 * held_mg
    assert bench.spilled_mg > 0.4 * held_mg


@pytest.mark.parametrize("name", ["glass_beads", "titanium_dioxide"])
def test_a_heap_is_no_steeper_than_its_repose(name: str) -> None:
    bench = Bench(500.0, POWDERS[name])
    for mortar_mg in (500.0, 10_000.0):
        bench.mortar_mg = mortar_mg
        bench.move(np.array([0.0, 0.0, 60.0]), UP, 60.0)
    bench.bed.leave()
    surface = bench.bed.surface_mm()
    steepest = np.abs(np.diff(surface, axis=0)).max() / CELL_MM
    wall = 45.0 / math.sqrt(48.75**2 - 45.0**2)  # the bare wall, at the edge
    assert steepest <= max(wall, math.tan(math.radians(POWDERS[name].repose_deg))) + 0.02
    middle = len(surface) // 2
    down = surface[middle, middle] - surface[middle + 4, middle]
    assert down == pytest.approx(4 * CELL_MM * math.tan(math.radians(POWDERS[name].repose_deg)), rel=0.25)


motions = st.lists(
    st.tuples(
        st.floats(-60.0, 60.0), st.floats(-60.0, 60.0), st.floats(-5.0, 60.0),
        st.floats(0.0, 120.0), st.floats(0.0, 360.0), st.floats(20.0, 95.0),
    ),
    min_size=2,
    max_size=6,
)  # fmt: skip


@settings(max_examples=12, deadline=None)
@given(motions, st.floats(10.0, 40_000.0), st.sampled_from(sorted(POWDERS)))
def test_no_powder_is_made_or_lost_however_the_cone_goes(
    todo: list[tuple[float, ...]], fill_mg: float, name: str
) -> None:
    bench = Bench(fill_mg, POWDERS[name])
    for x_mm, y_mm, z_mm, tilt_deg, heading_deg, rim_mm in todo:
        tilt, heading = math.radians(tilt_deg), math.radians(heading_deg)
        axis = np.array([math.sin(tilt) * math.cos(heading), math.sin(tilt) * math.sin(heading), math.cos(tilt)])
        bench.move(np.array([x_mm, y_mm, z_mm]), axis, rim_mm)
        assert min(bench.mortar_mg, bench.cone_mg, bench.spilled_mg) >= -1e-6
        assert bench.mortar_mg + bench.cone_mg + bench.spilled_mg == pytest.approx(fill_mg)
        assert bench.bed.in_mortar_mg == pytest.approx(bench.mortar_mg, abs=1e-6 * fill_mg)
        assert bench.bed.in_cone_mg == pytest.approx(bench.cone_mg, abs=1e-6 * fill_mg)


def test_a_bed_that_was_kept_in_a_stroke_goes_on_as_it_would_have() -> None:
    whole, half = Bench(), Bench()
    whole.go(WIDE)
    middle = len(WIDE.times_s) // 2
    half.go(WIDE, middle)
    kept = json.loads(json.dumps(half.bed.kept))
    half.bed = HeightField(MORTAR, BEADS)
    half.bed.kept = kept
    for apex_mm, axis, rim_mm in list(zip(WIDE.apex_mm, WIDE.axis, WIDE.rim_mm, strict=True))[middle - 1 :]:
        half.move(apex_mm, axis, float(rim_mm))
    assert half.take() == pytest.approx(whole.take(), rel=0.02)


def test_what_came_back_lies_in_a_heap_and_is_taken_with_the_rest() -> None:
    bench = Bench(1000.0)
    bench.go(WIDE)
    first_mg = bench.take()
    bench.mortar_mg += 5000.0
    bench.go(WIDE)
    assert bench.take() > first_mg + 2500.0


@pytest.mark.parametrize("tilt_deg", [0.0, 30.0, 75.0, 110.0, 170.0])
def test_a_leaning_cone_is_as_low_as_the_lowest_of_its_apex_and_its_rim(tilt_deg: float) -> None:
    lean = math.radians(tilt_deg)
    pose = ConePose(np.array([1.0, 2.0, 30.0]), np.array([math.sin(lean), 0.0, math.cos(lean)]), 80.0, 50.0)
    assert pose.lowest_mm == pytest.approx(pose.outline_mm(3600)[:, 2].min(), abs=1e-3)


def test_a_lip_takes_grains_whose_tops_are_above_it_and_passes_one_layer_of_them() -> None:
    """As by discrete elements: 2.27 mm of 2 mm beads stayed under a lip at 3.5 mm, 1.38 mm of 1.5 mm ones at 1.5 mm."""
    assert passing_mm(np.array([3.5]), 2.0, 0.7)[0] == pytest.approx(2.27, rel=0.1)
    assert passing_mm(np.array([1.5]), 1.5, 0.7)[0] == pytest.approx(1.38, rel=0.1)
    assert passing_mm(np.array([3.5]), 0.1, 0.7)[0] == pytest.approx(3.43)
