"""In tolerance or not: the guard band, and the uncertainty that makes it."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scuhand_bt.dosing.verdict import acceptance_mg, chance_with_lumps, judge

masses = st.floats(-50.0, 5000.0)
tolerances = st.floats(0.1, 50.0)
uncertainties = st.floats(0.0, 2.0)


@pytest.mark.parametrize(
    ("net_mg", "uncertainty_mg", "verdict"),
    [
        (52.0, 0.0, "in tolerance"),
        (52.001, 0.0, "over"),
        (47.999, 0.0, "under"),
        (51.5, 0.25, "in tolerance"),
        (51.5, 0.2501, "over"),
        (48.5, 0.25, "in tolerance"),
        (48.5, 0.2501, "under"),
        (50.0, 1.0, "in tolerance"),
        (50.0, 1.001, "under"),
    ],
)
def test_a_dose_is_in_tolerance_by_two_standard_uncertainties(
    net_mg: float, uncertainty_mg: float, verdict: str
) -> None:
    assert judge(50.0, 2.0, net_mg, uncertainty_mg) == verdict


@given(masses, tolerances, masses, uncertainties)
def test_what_is_accepted_stays_in_tolerance_wherever_its_expanded_uncertainty_takes_it(
    target_mg: float, tolerance_mg: float, net_mg: float, uncertainty_mg: float
) -> None:
    if judge(target_mg, tolerance_mg, net_mg, uncertainty_mg) == "in tolerance":
        for true_mg in (net_mg - 2.0 * uncertainty_mg, net_mg + 2.0 * uncertainty_mg):
            assert abs(true_mg - target_mg) <= tolerance_mg + 1e-9


@given(masses, tolerances, st.floats(-60.0, 60.0), uncertainties)
def test_what_is_not_accepted_is_named_by_its_side(
    target_mg: float, tolerance_mg: float, error_mg: float, uncertainty_mg: float
) -> None:
    verdict = judge(target_mg, tolerance_mg, target_mg + error_mg, uncertainty_mg)
    if abs(error_mg) > acceptance_mg(tolerance_mg, uncertainty_mg) + 1e-9:
        assert verdict == ("over" if target_mg + error_mg > target_mg else "under")


def test_a_lump_of_tau_mg_ends_within_a_tolerance_with_this_chance() -> None:
    """Of lumps that weigh 4 mg on average, 1 - 1/e are lighter than the 4 mg from 48 to 52."""
    assert chance_with_lumps(2.0, 4.0) == pytest.approx(0.632, abs=1e-3)
    assert chance_with_lumps(0.1, 0.5) == pytest.approx(0.330, abs=1e-3)
    assert chance_with_lumps(2.0, 1e-6) == pytest.approx(1.0)
    assert chance_with_lumps(2.0, 0.0) == 1.0
