import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scuhand_bt.device_specs.hand import HandSpec
from scuhand_bt.dosing.cone import Cone, edge_travel_mm
from scuhand_bt.dosing.flow import PulseModel, basis, fit_coefficient
from scuhand_bt.dosing.paper import LONGEST_DWELL_S, SHORTEST_DWELL_S, solve_pulse
from scuhand_bt.specs import Mortar

MORTAR = Mortar(name="agate", bore_mm=90.0, depth_mm=30.0, height_mm=45.0, outer_diameter_mm=115.0)
diameters = st.floats(min_value=20.0, max_value=99.0)


def test_an_overlap_of_36_degrees_makes_the_90_mm_rim_of_the_paper() -> None:
    cone = Cone.from_overlap(36.0)
    assert cone.diameter_mm == pytest.approx(90.0)
    assert cone.half_angle_deg == pytest.approx(64.2, abs=0.05)
    assert cone.depth_mm == pytest.approx(21.8, abs=0.05)
    assert cone.volume_mm3 == pytest.approx(46_200, rel=0.005)


@given(diameters)
def test_overlap_and_roller_angle_lead_back_to_the_same_cone(diameter_mm: float) -> None:
    cone = Cone(diameter_mm)
    assert Cone.from_overlap(cone.overlap_deg).diameter_mm == pytest.approx(diameter_mm)
    assert Cone.from_roller(cone.roller_deg(HandSpec()), HandSpec()).diameter_mm == pytest.approx(diameter_mm)


@given(diameters, diameters)
def test_the_roller_turns_by_the_edges_way_along_the_rim(first_mm: float, second_mm: float) -> None:
    hand = HandSpec()
    turned_deg = abs(Cone(first_mm).roller_deg(hand) - Cone(second_mm).roller_deg(hand))
    assert turned_deg == pytest.approx(edge_travel_mm(first_mm, second_mm) * hand.roller_deg_per_mm, abs=1e-6)


@given(diameters)
def test_a_load_of_the_cones_volume_stands_at_its_rim(diameter_mm: float) -> None:
    cone = Cone(diameter_mm)
    assert cone.fill_height_mm(cone.volume_mm3 * 1.5, 1.5) == pytest.approx(cone.depth_mm)


@pytest.mark.parametrize("diameter_mm", [0.0, -1.0, 100.0, math.inf, math.nan])
def test_a_cone_the_sheet_cannot_make_is_refused(diameter_mm: float) -> None:
    with pytest.raises(ValueError, match="cannot make a cone"):
        Cone(diameter_mm)


def test_a_wide_cone_rests_on_its_rim_and_a_narrow_one_on_its_apex() -> None:
    assert Cone(89.0).resting_apex_mm(MORTAR) > 3.0
    assert Cone(70.0).resting_apex_mm(MORTAR) == 0.0


@given(st.floats(min_value=1e-4, max_value=50.0))
def test_the_shortest_dwell_is_taken_until_the_widest_opening_does_not_suffice(wanted: float) -> None:
    opening_mm, dwell_s = solve_pulse(wanted, 2.4, 4.0)
    assert 0.0 < opening_mm <= 2.4
    assert SHORTEST_DWELL_S <= dwell_s <= LONGEST_DWELL_S
    most = basis(2.4, LONGEST_DWELL_S, 4.0)
    assert basis(opening_mm, dwell_s, 4.0) == pytest.approx(min(wanted, most), rel=0.01, abs=2e-4)
    assert dwell_s == SHORTEST_DWELL_S or opening_mm == 2.4


@given(st.floats(min_value=0.1, max_value=500.0), st.lists(st.floats(min_value=0.1, max_value=2.4), min_size=1))
def test_the_fit_finds_the_coefficient_that_made_the_pulses(coefficient: float, openings_mm: list[float]) -> None:
    model = PulseModel(coefficient, 4.0)
    bases = [basis(opening_mm, 0.5, 4.0) for opening_mm in openings_mm]
    assert fit_coefficient(bases, [model.mass_mg(mm, 0.5) for mm in openings_mm]) == pytest.approx(coefficient)
