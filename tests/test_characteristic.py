"""What a balance is, by what it shows: its delay, noise and drift, and what its repeatability can tell."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from scuhand_bt.dosing.characteristic import (
    Curve,
    least_repeatability_mg,
    least_tolerance_mg,
    noise_and_drift,
    step_of,
    usp_minimum_weight_mg,
)

BARE_MG, LOADED_MG, CAME_S = 12.0, 8012.0, 4.03


def curve(
    shown: Callable[[float], float], began_s: float = CAME_S, period_s: float = 0.1, end_s: float = 40.0
) -> list[tuple[float, float]]:
    """What a balance shows that follows a step, `shown` being the share at a time after it."""
    times_s = np.arange(0.0, end_s, period_s)
    step_mg = LOADED_MG - BARE_MG
    return [(float(t), BARE_MG + step_mg * (shown(float(t) - began_s) if t > began_s else 0.0)) for t in times_s]


def delay_s_of(readings: Curve, before_mg: float, after_mg: float, latest_s: float) -> float:
    step = step_of(readings, before_mg, after_mg, latest_s)
    assert step is not None
    return step.delay_s


def two_poles(tau_s: float) -> Callable[[float], float]:
    return lambda t: 1.0 - (1.0 + t / tau_s) * math.exp(-t / tau_s)


def late(shown: Callable[[float], float], by_s: float) -> Callable[[float], float]:
    return lambda t: shown(t - by_s) if t > by_s else 0.0


@pytest.mark.parametrize(
    ("shown", "delay_s"),
    [
        (two_poles(0.3), 0.6),
        (two_poles(1.6), 3.2),
        (lambda t: min(1.0, t / 4.0), 2.0),
        (late(two_poles(0.3), 1.0), 1.6),
        (lambda t: 1.0 - math.exp(-0.5 * t) * (math.cos(4.0 * t) + 0.125 * math.sin(4.0 * t)), 1.0 / 16.25),
    ],
    ids=["two poles", "slow poles", "moving mean", "dead time", "ringing"],
)
@pytest.mark.parametrize("sign", [1.0, -1.0], ids=["up", "down"])
def test_the_delay_of_any_filter_is_told_by_a_step(
    shown: Callable[[float], float], delay_s: float, sign: float
) -> None:
    readings = [(t, sign * mg) for t, mg in curve(shown)]
    assert delay_s_of(readings, sign * BARE_MG, sign * LOADED_MG, CAME_S) == pytest.approx(delay_s, abs=0.06)


def test_a_step_at_an_unknown_moment_counts_from_where_it_shows() -> None:
    readings = curve(late(two_poles(0.3), 1.0))
    assert delay_s_of(readings, BARE_MG, LOADED_MG, math.inf) == pytest.approx(0.6, abs=0.1)


def test_a_step_that_has_shown_before_it_was_told_counts_from_where_it_shows() -> None:
    readings = curve(two_poles(0.3))
    assert delay_s_of(readings, BARE_MG, LOADED_MG, CAME_S + 5.0) == pytest.approx(0.6, abs=0.1)


@pytest.mark.parametrize("began_s", [-10.0, 100.0], ids=["it was over", "it never came"])
def test_a_step_that_was_not_seen_tells_no_delay(began_s: float) -> None:
    readings = curve(two_poles(0.3), began_s=began_s)
    assert step_of(readings, BARE_MG, LOADED_MG, 0.0) is None


def test_a_false_line_here_and_there_tells_no_other_delay() -> None:
    readings = [(t, 1e6 if number % 5 in (0, 2) else mg) for number, (t, mg) in enumerate(curve(two_poles(0.3)))]
    for latest_s in (CAME_S, math.inf):
        assert delay_s_of(readings, BARE_MG, LOADED_MG, latest_s) == pytest.approx(0.6, abs=0.2)


def test_the_peaks_of_a_filter_that_rings_are_kept_as_they_are() -> None:
    readings = curve(lambda t: 1.0 - math.exp(-0.5 * t) * math.cos(4.0 * t))
    step = step_of(readings, BARE_MG, LOADED_MG, CAME_S)
    assert step is not None
    shown_mg = [mg for t, mg in readings if t > CAME_S + 0.2]
    missing_mg = [LOADED_MG - share * step.step_mg for share in step.missing][-len(shown_mg) + 2 :]
    assert missing_mg == pytest.approx(shown_mg[:-2], abs=1.0)


def test_no_readings_and_no_step_tell_no_delay() -> None:
    assert step_of([], BARE_MG, LOADED_MG, CAME_S) is None
    assert step_of(curve(two_poles(0.3)), BARE_MG, BARE_MG, CAME_S) is None


def test_noise_is_what_scatters_about_the_drift() -> None:
    rng = np.random.default_rng(5)
    times_s = np.arange(400) * 0.1
    readings = [(t, 5.0 + 0.02 * t + mg) for t, mg in zip(times_s.tolist(), rng.normal(0.0, 0.3, 400), strict=True)]
    noise_mg, drift = noise_and_drift(readings)
    assert noise_mg == pytest.approx(0.3, rel=0.1)
    assert drift == pytest.approx(0.02, abs=0.005)


def test_the_minimum_weight_is_two_thousand_times_the_repeatability_and_that_no_less_than_041_digits() -> None:
    assert usp_minimum_weight_mg(least_repeatability_mg(None, 0.1)) == pytest.approx(82.0)
    assert usp_minimum_weight_mg(least_repeatability_mg(0.02, 0.1)) == pytest.approx(82.0)
    assert usp_minimum_weight_mg(least_repeatability_mg(0.1, 0.1)) == pytest.approx(200.0)


def test_a_tolerance_leaves_room_for_four_standard_deviations() -> None:
    assert least_tolerance_mg(0.3) == pytest.approx(1.2)
