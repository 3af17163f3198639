"""What a container has gained, by the weighings around it: in worlds whose zero moves in ways of our choosing."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scuhand_bt.dosing.bracket import (
    SOUND_DIGITS_PER_S,
    Closed,
    Drift,
    Gross,
    Net,
    Reference,
    apart_mg,
    close,
    differ_mg,
    dose_between,
    drift_between,
    drift_of_dose,
    fallen_mg,
    held,
    later_mg,
    moved_mg,
    settled_from,
    significant,
    standing,
    together,
    total,
    unseen_mg,
    walk_mg,
    watch_s,
)

READABILITY_MG, NOISE_MG = 0.1, 0.046
EMPTY_MG = 25_000.0
Zero = Callable[[float], float]


STILL, STEADY = Net(0.0, 0.0), Drift(0.0, 0.0)


class Scale:
    """A balance with a zero of its own, and times at which it is asked."""

    def __init__(self, zero: Zero, seed: int | None = None) -> None:
        self.zero = zero
        self.rng = None if seed is None else np.random.default_rng(seed)

    def weigh(self, time_s: float, load_mg: float) -> Gross:
        noise_mg = 0.0 if self.rng is None else NOISE_MG * self.rng.standard_normal()
        return Gross(load_mg + self.zero(time_s) + noise_mg, NOISE_MG, time_s)


def dosed(scale: Scale, true_mg: float, late_mg: float = 0.0) -> tuple[Net, Closed]:
    """A container of one dose: placed at 8 s, dosed from 26 s to 40 s, lifted at 50 s; `late_mg` drips at 45 s."""
    bare, loaded = scale.weigh(0.0, 0.0), scale.weigh(8.0, EMPTY_MG)
    before, after = scale.weigh(26.0, EMPTY_MG), scale.weigh(40.0, EMPTY_MG + true_mg)
    watched = scale.weigh(42.5, EMPTY_MG + true_mg)
    dose, drift = dose_between(((loaded, before), (after, watched)), READABILITY_MG)
    lifted, bare_again = scale.weigh(50.0, EMPTY_MG + true_mg + late_mg), scale.weigh(58.0, 0.0)
    return dose, close(
        [dose],
        [Net(drift.rate * 16.5, drift.uncertainty * 16.5)],
        drift,
        bare,
        loaded,
        lifted,
        bare_again,
        READABILITY_MG,
    )


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
    assert abs(dose.mass_mg - 50.0) <= (1e-6 if abs(rate) > 0.015 else 2.1 * dose.uncertainty_mg)
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
        def weigh(self, time_s: float, load_mg: float) -> Gross:
            one = super().weigh(time_s, load_mg)
            fading_mg = force_mg * math.exp(-time_s / 150.0) if load_mg else 0.0
            return Gross(one.gross_mg + fading_mg, one.uncertainty_mg, time_s)

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
    agree = drift_of_dose([Drift(0.02, 0.005), Drift(0.03, 0.03)], [10.0], 0.1)
    assert agree.rate == pytest.approx(0.02, abs=0.001)
    assert agree.uncertainty < 0.005
    differ = drift_of_dose([Drift(0.0, 0.005), Drift(0.5, 0.03)], [10.0], 0.1)
    assert differ.rate == pytest.approx(0.25)
    assert differ.uncertainty > 0.14


def test_the_difference_is_shared_by_what_is_least_known() -> None:
    scale = Scale(lambda t: 0.0)
    bare, loaded = scale.weigh(0.0, 0.0), scale.weigh(8.0, EMPTY_MG)
    lifted, again = scale.weigh(50.0, EMPTY_MG + 80.2), scale.weigh(58.0, 0.0)
    closed = close(
        [Net(30.0, 0.1), Net(50.0, 0.2)], [STILL, STILL], Drift(0.0, 0.004), bare, loaded, lifted, again, READABILITY_MG
    )
    first, second = (dose.mass_mg for dose in closed.doses)
    assert second - 50.0 == pytest.approx(4.0 * (first - 30.0))
    assert 0.0 < first + second - 80.0 < 0.2


# --- the equations, by numbers worked out by hand


def test_a_zero_wanders_by_a_digit_in_a_minute_and_with_the_root_of_time() -> None:
    assert walk_mg(0.1, 60.0) == pytest.approx(0.1)
    assert walk_mg(0.2, 15.0) == pytest.approx(0.1)
    assert walk_mg(0.1, 0.0) == walk_mg(0.1, -5.0) == 0.0


def test_two_weighings_are_apart_by_both_of_their_uncertainties_and_the_walk_between_them() -> None:
    assert apart_mg(Gross(1.0, 2.0, 30.0), Gross(5.0, 3.0, 90.0), 6.0) == pytest.approx(7.0)


def test_a_weighing_has_moved_when_it_is_more_than_four_standard_deviations_away() -> None:
    before = Gross(100.0, 3.0, 0.0)
    moved = [moved_mg(before, Gross(gross_mg, 4.0, 0.0), 0.1) for gross_mg in (79.9, 80.0, 120.0, 120.1)]
    assert moved == pytest.approx([-20.1, 0.0, 0.0, 20.1])


def test_a_drift_is_a_change_over_its_time_and_so_is_its_uncertainty() -> None:
    drift = drift_between(Gross(100.0, 2.0, 30.0), Gross(112.0, 3.0, 90.0), 6.0)
    assert (drift.rate, drift.uncertainty) == (pytest.approx(0.2), pytest.approx(7.0 / 60.0))


def test_a_drift_within_three_standard_deviations_is_none_and_within_two_no_more_uncertain_than_a_sound_one() -> None:
    assert significant(Drift(0.25, 0.125), 0.1) == Drift(0.0, pytest.approx(0.005))
    assert significant(Drift(-0.25, 0.125), 0.1) == Drift(0.0, pytest.approx(0.005))
    assert significant(Drift(0.002, 0.001), 0.1) == Drift(0.0, 0.001)
    for rate in (0.26, -0.26, 0.375, -0.375):
        assert significant(Drift(rate, 0.125), 0.1) == Drift(0.0, 0.125)
    for rate in (0.38, -0.38):
        assert significant(Drift(rate, 0.125), 0.1) == Drift(rate, 0.125)


def test_drifts_are_weighed_by_their_certainty_until_they_are_three_standard_deviations_apart() -> None:
    one, other = Drift(11.0, 3.0), Drift(25.0, 4.0)
    near = drift_of_dose([one, other], [10.0], 1000.0)
    assert (near.rate, near.uncertainty) == (pytest.approx(11.0 + 14.0 * 9.0 / 25.0), pytest.approx(12.0 / 5.0))
    back = drift_of_dose([other, one], [10.0], 1000.0)
    assert (back.rate, back.uncertainty) == (pytest.approx(near.rate), pytest.approx(near.uncertainty))
    far = drift_of_dose([one, Drift(27.0, 4.0)], [10.0], 0.1)
    assert far.rate == pytest.approx(19.0)
    assert far.uncertainty == pytest.approx(math.sqrt(2.5**2 + 16.0**2 / 3.0))
    assert drift_of_dose([Drift(27.0, 4.0), one], [10.0], 0.1).uncertainty == pytest.approx(far.uncertainty)


@pytest.mark.parametrize("duration_s", [5.0, 15.0, 30.0, 45.0])
def test_a_creep_that_sets_in_when_the_valve_opens_is_within_its_dose_s_uncertainty(duration_s: float) -> None:
    def crept_mg(time_s: float) -> float:
        return 6.0 * -math.expm1(-max(time_s, 0.0) / 60.0)

    before, after = Gross(1000.0, 0.02, 0.0), Gross(1050.0 + crept_mg(duration_s), 0.02, duration_s)
    later = Gross(1050.0 + crept_mg(duration_s + 8.0), 0.02, duration_s + 8.0)
    gained, _ = dose_between(((Gross(1000.0, 0.02, -5.0), before), (after, later)), 0.1)
    assert abs(gained.mass_mg - 50.0) < 2.0 * gained.uncertainty_mg


@pytest.mark.parametrize("size_mg", [-6.0, 4.0, 6.0])
def test_a_creep_that_is_over_before_its_dose_is_told_by_interrupting_it(size_mg: float) -> None:
    def weighed(mass_mg: float, time_s: float) -> Gross:
        return Gross(mass_mg + size_mg * -math.expm1(-max(time_s, 0.0) / 60.0), 0.04, time_s)

    still = (weighed(1000.0, -4.0), weighed(1000.0, 0.0))
    ends = [(weighed(1000.0 + 25.0 * t, t), weighed(1000.0 + 25.0 * t, t + 8.0)) for t in (30.0, 68.0, 106.0, 144.0)]
    gained, drift = dose_between((still, *ends), 0.1)
    assert abs(gained.mass_mg - 25.0 * 144.0) < 2.0 * gained.uncertainty_mg < abs(size_mg)
    unseen, _ = dose_between((still, ends[-1]), 0.1)
    assert abs(unseen.mass_mg - 25.0 * 144.0) > 2.0 * unseen.uncertainty_mg
    assert drift.rate * size_mg > 0.0


@pytest.mark.parametrize(
    ("dose_s", "tolerance_mg", "expected_s"),
    [(30.0, 2.0, 30.0 * 0.05 / 0.5), (30.0, 5.0, 30.0 * 0.05 / 1.25), (100.0, 2.0, 8.0), (1.0, 50.0, 0.5)],
)
def test_a_dose_is_watched_until_its_drift_is_known_to_a_quarter_of_the_tolerance(
    dose_s: float, tolerance_mg: float, expected_s: float
) -> None:
    before, now = Gross(1000.0, 0.03, 5.0), Gross(1100.0, 0.04, 5.0 + dose_s)
    assert watch_s(before, now, tolerance_mg) == pytest.approx(expected_s)


def test_the_drift_of_a_dose_is_the_sum_of_its_parts() -> None:
    none, some = Drift(0.0, 0.01), Drift(0.1, 0.01)
    before = Drift(0.5, 0.001)
    drift = drift_of_dose([before, none, some, some], [10.0, 20.0, 30.0], 0.1)
    assert drift.rate * 60.0 == pytest.approx(20.0 * 0.05 + 30.0 * 0.1)
    began_mg = 20.0 * 0.1 / math.sqrt(3.0)
    chances_mg = [share_s * 0.01 for share_s in (10.0 + 10.0, 10.0 + 15.0, 15.0)]
    assert drift.uncertainty * 60.0 == pytest.approx(math.hypot(began_mg, *chances_mg))


def test_a_drift_in_an_interrupted_dose_that_chance_would_rarely_make_is_its_doubt() -> None:
    still = Drift(0.0, 0.001)
    for rate, u in ((0.019, 0.005), (0.021, 0.01), (0.0249, 0.01)):
        some = Drift(rate, 0.01)
        assert drift_of_dose([still, some, some], [20.0, 0.001], 0.1) == Drift(0.0, pytest.approx(u, rel=1e-3))
    some = Drift(0.0251, 0.01)
    doubted = drift_of_dose([still, some, some], [20.0, 0.001], 0.1)
    assert (doubted.rate, doubted.uncertainty, doubted.is_doubted) == (0.0, pytest.approx(0.0251), True)
    some = Drift(0.035, 0.01)
    assert drift_of_dose([still, some, some], [20.0, 0.001], 0.1).rate == pytest.approx(0.035)


def test_what_is_just_within_its_bound_may_be_chance() -> None:
    less, more = Drift(1.0, 3.0), Drift(16.0, 4.0)  # 3 standard deviations apart
    assert drift_of_dose([less, more], [10.0], 0.1) == Drift(0.0, pytest.approx(math.hypot(0.64 * 3.0, 0.36 * 4.0)))
    still, some = Drift(0.0, 1.0), Drift(2.5, 1.0)  # 2.5 of them from none
    assert not drift_of_dose([still, some, some], [1.0, 0.0], 0.1).is_doubted
    moved_mg = 20.0  # 4 of them
    bare, again = Gross(0.0, 3.0, 0.0), Gross(moved_mg, 4.0, 3.0)
    loaded, lifted = Gross(1000.0, 0.1, 1.0), Gross(1000.0 + moved_mg, 0.1, 2.0)
    assert close([STILL], [STILL], STEADY, bare, loaded, lifted, again, 0.0).stepped_mg == 0.0


def test_each_drift_belongs_to_a_dose() -> None:
    weighings = Gross(0.0, 0.1, 0.0), Gross(9.0, 0.1, 1.0), Gross(9.0, 0.1, 2.0), Gross(0.0, 0.1, 3.0)
    with pytest.raises(ValueError, match="argument 2 is longer"):
        close([STILL], [STILL, STILL], STEADY, *weighings, 0.1)


BEFORE, LATER = Gross(1000.0, 0.3, 100.0), Gross(1050.0, 0.4, 115.0)
READ_MG = 2.4
"""A walk of 1.2 mg in 15 s, so that BEFORE and LATER are 1.3 mg apart."""


def test_a_dose_without_a_second_weighing_has_a_sound_balances_drift_in_its_uncertainty() -> None:
    dose, drift = dose_between(((BEFORE, BEFORE), (LATER, LATER)), READ_MG)
    assert (drift.rate, drift.uncertainty) == (0.0, pytest.approx(0.12))
    assert dose.mass_mg == 50.0
    assert dose.uncertainty_mg == pytest.approx(math.hypot(1.3, 0.12 * 15.0))


@pytest.mark.parametrize("is_before", [True, False])
def test_a_drift_on_one_side_of_a_dose_is_taken_out_of_it(is_before: bool) -> None:
    still = Gross(1000.0 - 40.0, 0.3, 85.0) if is_before else Gross(1050.0 - 40.0, 0.4, 100.0)
    pairs = ((still, BEFORE), (LATER, LATER)) if is_before else ((BEFORE, BEFORE), (still, LATER))
    dose, drift = dose_between(pairs, READ_MG)
    assert drift.rate == pytest.approx(40.0 / 15.0)
    assert dose.mass_mg == pytest.approx(50.0 - 40.0)
    shared_mg = 0.3 if is_before else 0.4
    of_drift_mg = math.hypot(shared_mg, shared_mg, 1.2)
    assert dose.uncertainty_mg == pytest.approx(math.sqrt(1.3**2 + of_drift_mg**2 + 2.0 * shared_mg**2))


def test_a_drift_before_a_dose_counts_the_error_of_the_weighing_between_twice() -> None:
    earlier = Gross(1000.0 - 90.0, 0.3, 70.0)
    dose, drift = dose_between(((earlier, BEFORE), (LATER, LATER)), READ_MG)
    assert (drift.rate, dose.mass_mg) == (pytest.approx(3.0), pytest.approx(5.0))
    of_drift_mg = math.sqrt(0.3**2 + 0.3**2 + 2.4**2 / 2.0) / 30.0 * 15.0
    twice_mg = 0.3 * math.sqrt(2.0 * 15.0 / 30.0)
    assert dose.uncertainty_mg == pytest.approx(math.sqrt(1.3**2 + of_drift_mg**2 + twice_mg**2))


def test_drifts_before_and_after_a_dose_are_both_taken_into_account() -> None:
    earlier, after = Gross(1000.0 - 90.0, 0.3, 70.0), Gross(1050.0 - 20.0, 0.4, 105.0)
    _, drift = dose_between(((earlier, BEFORE), (after, LATER)), READ_MG)
    assert 2.0 < drift.rate < 3.0


def test_a_net_mass_counts_from_what_the_pan_weighed_and_what_had_come_before() -> None:
    against = Reference(BEFORE, Drift(0.5, 0.2), Net(30.0, 1.5), READ_MG)
    assert against.zero_mg == 970.0
    assert against.uncertainty_mg(LATER) == pytest.approx(math.sqrt(1.3**2 + 3.0**2 + 1.5**2))


def test_what_the_bare_pan_is_going_to_tell_counts_before_it_has_told() -> None:
    bare, loaded, other = Gross(0.0, 0.3, 80.0), Gross(970.0, 0.4, 90.0), Net(20.0, 0.5)
    later = later_mg(bare, loaded, [other], READ_MG)
    changing_s = 2 * 10.0
    expected = 2 * (0.3**2 + 0.4**2) + READ_MG**2 * changing_s / 60.0 + (0.05 * READ_MG * changing_s) ** 2 + 0.5**2
    assert later == pytest.approx(math.sqrt(expected))
    against = Reference(BEFORE, Drift(0.0, 1.0), Net(0.0, 0.0), READ_MG, later)
    alone_mg = Reference(BEFORE, Drift(0.0, 1.0), Net(0.0, 0.0), READ_MG).uncertainty_mg(LATER)
    assert alone_mg == pytest.approx(math.hypot(1.3, 15.0))
    both_mg = alone_mg * later / math.hypot(alone_mg, later)
    assert against.uncertainty_mg(LATER) == pytest.approx(1.5 * both_mg)
    assert against.in_the_end_mg(0.1, Drift(0.0, 1.0)) == 0.1, "what is told alone is told no worse"
    assert against.in_the_end_mg(0.0, Drift(0.0, 1.0)) == 0.0
    sure = replace(against, later_mg=0.5)
    assert sure.in_the_end_mg(1.0, Drift(0.0, 1.0)) == pytest.approx(1.5 / math.hypot(1.0, 2.0))
    for drift in (Drift(0.1, 1.0), Drift(0.0, 1.0, is_doubted=True)):
        assert against.in_the_end_mg(alone_mg, drift) == alone_mg, "it may grow with the container"


def bracketed(*doses: Net, bare_again_mg: float = 12.0, lifted_mg: float = 1110.0) -> Closed:
    """Weighings of 0.1 mg each over 70 s, 20 s of them to change containers, with a drift of 0.02 ± 0.005 mg/s."""
    bare, loaded = Gross(10.0, 0.1, 7.0), Gross(1010.0, 0.1, 17.0)
    lifted, again = Gross(lifted_mg, 0.1, 67.0), Gross(bare_again_mg, 0.1, 77.0)
    return close(doses, [STILL] * len(doses), Drift(0.02, 0.005), bare, loaded, lifted, again, 0.6)


def test_by_the_bare_pan_a_container_has_gained_what_the_zero_and_the_drift_leave() -> None:
    closed = bracketed(Net(98.0, 0.3))
    assert closed.net.mass_mg == pytest.approx(1110.0 - 1010.0 - 2.0 + 0.02 * 20.0)
    assert closed.net.uncertainty_mg == pytest.approx(math.sqrt(4 * 0.01 + 0.12 + 0.01))
    assert closed.zero_mg == 2.0
    assert closed.difference_mg == pytest.approx(0.4)
    assert closed.allowance_mg == pytest.approx(4.0 * math.sqrt(0.17 + 0.09))
    assert (closed.stepped_mg, closed.closes) == (0.0, True)
    (dose,) = closed.doses
    assert dose.mass_mg == pytest.approx(98.0 + 0.4 * 0.09 / 0.26)
    assert dose.uncertainty_mg == pytest.approx(0.3 * math.sqrt(0.17 / 0.26))


def test_a_difference_beyond_chance_makes_every_result_less_certain_by_as_much() -> None:
    closed = bracketed(Net(57.0, 0.3), Net(40.0, 0.4))
    assert closed.difference_mg == pytest.approx(1.4)
    variance = 0.17 + 0.09 + 0.16
    birge = 1.4 / math.sqrt(variance)
    assert birge > 2.0
    for dose, mass_mg, u_mg in zip(closed.doses, (57.0, 40.0), (0.3, 0.4), strict=True):
        share = u_mg**2 / variance
        assert dose.mass_mg == pytest.approx(mass_mg + 1.4 * share)
        assert dose.uncertainty_mg == pytest.approx(birge * u_mg * math.sqrt(1.0 - share))
    less = bracketed(Net(99.8, 0.3))
    assert less.difference_mg == pytest.approx(-1.4)
    assert less.doses[0].uncertainty_mg > 2.0 * 0.3 * math.sqrt(0.17 / 0.26)


def test_a_bare_pan_that_moved_beyond_the_walk_and_the_drift_closes_nothing() -> None:
    assert bracketed(Net(94.0, 0.3), bare_again_mg=16.0).stepped_mg == pytest.approx(4.6)
    assert bracketed(Net(100.0, 0.3), bare_again_mg=8.0).stepped_mg == pytest.approx(-3.4)
    assert bracketed(Net(94.0, 0.3), bare_again_mg=14.3).stepped_mg == 0.0
    steady = bracketed(Net(98.0, 0.3))
    for difference_mg, stepped_mg, closes in (
        (2.0, 0.0, True),
        (-2.0, 0.0, True),
        (2.1, 0.0, False),
        (0.0, 0.1, False),
        (0.0, -0.1, False),
    ):
        one = replace(steady, difference_mg=difference_mg, allowance_mg=2.0, stepped_mg=stepped_mg)
        assert one.closes is closes
    assert not replace(steady, difference_mg=-2.1, allowance_mg=2.0).closes


def test_what_stands_on_the_pan_is_told_by_the_bare_pan_before_or_after_it_whatever_the_zero() -> None:
    bare, loaded = Gross(-9100.0, 0.1, 20.0), Gross(150.0, 0.2, 10.0)
    one, other = standing(bare, loaded, 0.1), standing(replace(bare, time_s=0.0), loaded, 0.1)
    assert one.mass_mg == other.mass_mg == 9250.0
    drifted_mg = SOUND_DIGITS_PER_S * 0.1 * 10.0
    assert one.uncertainty_mg == pytest.approx(math.hypot(0.1, 0.2, walk_mg(0.1, 10.0), drifted_mg))
    assert one.uncertainty_mg == pytest.approx(other.uncertainty_mg)


def test_what_a_container_holds_is_what_it_weighs_more_than_empty_and_drift_and_span_are_doubts() -> None:
    span_mg = 1e-5 * 9200.0
    once = held(Net(9200.0, 0.3), [Net(9240.0, 0.4)])
    assert (once.mass_mg, once.uncertainty_mg) == (40.0, pytest.approx(math.hypot(0.5, span_mg)))
    about = held(Net(9200.0, 0.3), [Net(9240.0, 0.4), Net(9242.0, 0.2)])
    u_mg = math.hypot(0.5, span_mg, 2.0 / math.sqrt(12.0))
    assert (about.mass_mg, about.uncertainty_mg) == (41.0, pytest.approx(u_mg))


def unshown(zero_mg: float, drifted: Net) -> Closed:
    """One dose of 100 ± 0.3 mg, and what was taken out of it as the drift's, over a bare pan that moves so far."""
    bare, loaded = Gross(10.0, 0.1, 7.0), Gross(1010.0, 0.1, 17.0)
    lifted, again = Gross(1110.0, 0.1, 67.0), Gross(10.0 + zero_mg, 0.1, 77.0)
    return close([Net(100.0, 0.3)], [drifted], Drift(0.0, 0.0), bare, loaded, lifted, again, 0.1)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_drift_that_the_bare_pan_does_not_show_is_the_doubt_of_the_bracket(sign: float) -> None:
    plain_mg = unshown(0.0, STILL).net.uncertainty_mg
    for zero_mg, missing_mg in (
        (0.0, 4.0),
        (-1.0 * sign, 4.0),
        (1.0 * sign, 3.0),
        (4.0 * sign, 0.0),
        (9.0 * sign, 0.0),
    ):
        net = unshown(zero_mg, Net(4.0 * sign, 0.1)).net
        assert net.uncertainty_mg == pytest.approx(math.hypot(plain_mg, missing_mg))


def test_nothing_is_surer_than_the_drift_that_was_taken_out_of_it() -> None:
    sure, unsure = unshown(0.0, STILL).doses[0], unshown(0.0, Net(0.0, 0.25)).doses[0]
    assert sure.uncertainty_mg < 0.25 < unsure.uncertainty_mg < 0.3
    assert unsure.mass_mg == sure.mass_mg


def test_readings_that_fall_and_stay_below_while_powder_comes_tell_a_step_of_the_zero() -> None:
    rising_mg = [0.5 * at for at in range(20)]
    assert fallen_mg(rising_mg) == 0.0
    fell_mg = [*rising_mg, *(mg - 5.0 for mg in (10.0, 10.5, 11.0, 11.5, 12.0, 12.5, 13.0))]
    assert fallen_mg(fell_mg) == pytest.approx(8.5 - 6.0), "of the medians, what comes meanwhile hides the rest"
    lump_mg = [*rising_mg, 60.0, 30.0, *(10.0 + 0.5 * at for at in range(20))]
    assert fallen_mg(lump_mg) == 0.0
    assert fallen_mg([9.0, 8.0, 7.0, 6.0, 5.0, 4.0, 3.0, 2.0, 1.0]) == 0.0, "too few to tell"
    assert fallen_mg([5.0] * 5 + [4.0] * 5) == 1.0


# --- small rules that others stand on


@pytest.mark.parametrize(
    ("shown_mg", "first"),
    [
        ((0.0, 2.0, 2.9, 3.2), 2),  # a filter: each rise is less than half of the one before
        ((0.0, 2.0, 3.0, 3.4), 2),
        ((0.0, 2.0, 3.1, 3.2), 0),  # rises on by more than half as much
        ((0.0, -2.0, -2.1, -2.1), 0),  # what falls is no filter
        ((0.0, 0.0, 0.0, 0.0), 0),
        ((0.0, 10.0, 13.0, 16.0, 16.0), 1),  # it has come to rest, and then something rises on
        ((0.0, 2.0), 0),  # nobody can tell yet
    ],
)
def test_a_drift_is_told_from_where_a_filter_has_come_to_rest(shown_mg: tuple[float, ...], first: int) -> None:
    looks = [Gross(EMPTY_MG + mg, 0.05, 8.0 * number) for number, mg in enumerate(shown_mg)]
    assert settled_from(looks, READABILITY_MG) is looks[first]


def test_what_was_seen_counts_for_what_was_not_as_two_observations_do() -> None:
    """4.30 is Student's t of two degrees of freedom at 95 %."""
    assert unseen_mg(0.0, 0.0, 20.0) == 0.0
    assert unseen_mg(2.0, 0.0, 20.0) == pytest.approx(4.3)
    assert unseen_mg(0.0, 0.1, 20.0) == pytest.approx(4.3)
    assert unseen_mg(3.0, 0.2, 20.0) == pytest.approx(5.0 * 2.15)


def test_two_results_of_one_thing_may_be_apart_by_four_standard_deviations() -> None:
    assert differ_mg(Net(10.0, 0.3), Net(12.5, 0.4)) == (2.5, pytest.approx(2.0))


def test_two_weighings_together_are_one_midway_that_is_surer() -> None:
    assert together(Gross(10.0, 0.3, 4.0), Gross(12.0, 0.4, 8.0)) == Gross(11.0, 0.25, 6.0)


def test_parts_that_share_no_weighing_add_up() -> None:
    assert total([Net(10.0, 0.3), Net(2.0, 0.4)]) == Net(12.0, 0.5)


def test_what_took_no_time_is_watched_for_the_shortest() -> None:
    assert watch_s(Gross(0.0, 0.05, 3.0), Gross(0.0, 0.05, 3.0), 2.0) == 0.5
