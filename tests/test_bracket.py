"""What a container has gained, by the weighings around it: in worlds whose zero moves in ways of our choosing."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scuhand_bt.dosing.bracket import (
    Closed,
    Drift,
    Net,
    Weighing,
    close,
    dose_between,
    mean_drift,
    walk_mg,
)

READABILITY_MG, NOISE_MG = 0.1, 0.046
EMPTY_MG = 25_000.0
Zero = Callable[[float], float]


class Scale:
    """A balance with a zero of its own, and times at which it is asked."""

    def __init__(self, zero: Zero, seed: int | None = None) -> None:
        self.zero = zero
        self.rng = None if seed is None else np.random.default_rng(seed)

    def weigh(self, time_s: float, load_mg: float) -> Weighing:
        noise_mg = 0.0 if self.rng is None else NOISE_MG * self.rng.standard_normal()
        return Weighing(load_mg + self.zero(time_s) + noise_mg, NOISE_MG, time_s)


def dosed(scale: Scale, true_mg: float, late_mg: float = 0.0) -> tuple[Net, Closed]:
    """A container of one dose: placed at 8 s, dosed from 26 s to 40 s, lifted at 50 s; `late_mg` drips at 45 s."""
    bare, loaded = scale.weigh(0.0, 0.0), scale.weigh(8.0, EMPTY_MG)
    before, after = scale.weigh(26.0, EMPTY_MG), scale.weigh(40.0, EMPTY_MG + true_mg)
    watched = scale.weigh(42.5, EMPTY_MG + true_mg)
    dose, drift = dose_between(loaded, before, after, watched, READABILITY_MG)
    lifted, bare_again = scale.weigh(50.0, EMPTY_MG + true_mg + late_mg), scale.weigh(58.0, 0.0)
    return dose, close([dose], drift, bare, loaded, lifted, bare_again, READABILITY_MG)


def test_a_still_zero_leaves_the_plain_difference() -> None:
    dose, closed = dosed(Scale(lambda t: 3.0), 50.0)
    assert dose.mass_mg == pytest.approx(50.0)
    assert closed.net.mass_mg == pytest.approx(50.0)
    assert closed.closes
    assert closed.doses[0].mass_mg == pytest.approx(50.0)
    assert closed.doses[0].uncertainty_mg < min(dose.uncertainty_mg, closed.net.uncertainty_mg)


@given(st.floats(-0.3, 0.3))
def test_a_steady_drift_is_taken_out(rate: float) -> None:
    dose, closed = dosed(Scale(lambda t: rate * t), 50.0)
    assert abs(dose.mass_mg - 50.0) <= (1e-6 if abs(rate) > 0.01 else 2.0 * dose.uncertainty_mg)
    assert abs(closed.doses[0].mass_mg - 50.0) <= 2.0 * closed.doses[0].uncertainty_mg


@given(st.floats(-8.0, 8.0), st.floats(1.0, 57.0))
def test_a_zero_that_steps_at_any_moment_is_flagged_or_stays_within_its_uncertainty(
    step_mg: float, at_s: float
) -> None:
    _, closed = dosed(Scale(lambda t: step_mg * (t >= at_s)), 50.0)
    (adjusted,) = closed.doses
    if closed.closes:
        assert abs(adjusted.mass_mg - 50.0) <= 2.0 * adjusted.uncertainty_mg + 0.15


@pytest.mark.parametrize("late_mg", [1.0, 4.0, -3.0])
def test_what_drips_after_the_last_weighing_opens_the_bracket(late_mg: float) -> None:
    _, closed = dosed(Scale(lambda t: 0.0), 50.0, late_mg)
    assert not closed.closes
    assert closed.difference_mg == pytest.approx(late_mg)


@pytest.mark.parametrize("force_mg", [8.0, -8.0, 4.0])
def test_a_force_on_the_container_that_fades_is_flagged_or_stays_within_its_uncertainty(force_mg: float) -> None:
    class Warm(Scale):
        def weigh(self, time_s: float, load_mg: float) -> Weighing:
            one = super().weigh(time_s, load_mg)
            fading_mg = force_mg * math.exp(-time_s / 150.0) if load_mg else 0.0
            return Weighing(one.gross_mg + fading_mg, one.uncertainty_mg, time_s)

    _, closed = dosed(Warm(lambda t: 0.0), 50.0)
    (adjusted,) = closed.doses
    assert not closed.closes or abs(adjusted.mass_mg - 50.0) <= 2.0 * adjusted.uncertainty_mg + 0.1


def test_a_sound_balance_closes_and_is_off_by_no_more_than_it_says() -> None:
    opened, beyond, walk = 0, 0, walk_mg(READABILITY_MG, 0.5)
    for seed in range(1000):
        rng = np.random.default_rng((1, seed))
        zero = np.cumsum(walk * rng.standard_normal(120))
        dose, closed = dosed(Scale(lambda t, zero=zero: float(zero[int(2.0 * t)]), seed), 50.0)
        opened += not closed.closes
        beyond += abs(closed.doses[0].mass_mg - 50.0) > 2.0 * closed.doses[0].uncertainty_mg
        assert dose.uncertainty_mg < 0.15
    assert opened <= 3
    assert beyond <= 30


def test_drifts_that_contradict_each_other_are_not_averaged_away() -> None:
    agree = mean_drift(Drift(0.01, 0.005), Drift(0.02, 0.03))
    assert agree.rate == pytest.approx(0.01, abs=0.001)
    assert agree.uncertainty < 0.005
    differ = mean_drift(Drift(0.0, 0.005), Drift(0.5, 0.03))
    assert differ.rate == pytest.approx(0.25)
    assert differ.uncertainty > 0.14


def test_the_difference_is_shared_by_what_is_least_known() -> None:
    scale = Scale(lambda t: 0.0)
    bare, loaded = scale.weigh(0.0, 0.0), scale.weigh(8.0, EMPTY_MG)
    lifted, again = scale.weigh(50.0, EMPTY_MG + 80.2), scale.weigh(58.0, 0.0)
    closed = close([Net(30.0, 0.1), Net(50.0, 0.2)], Drift(0.0, 0.004), bare, loaded, lifted, again, READABILITY_MG)
    first, second = (dose.mass_mg for dose in closed.doses)
    assert second - 50.0 == pytest.approx(4.0 * (first - 30.0))
    assert 0.0 < first + second - 80.0 < 0.2
