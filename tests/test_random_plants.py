"""The randomised plants are what they say: their draws, their powders and their balances."""

from dataclasses import replace

import numpy as np
import pytest
from dose_bench import shipped_powders

from harness.random_physics import BalanceFigures, DrawnBalance, DrawnFlow, FlowFigures
from harness.random_plants import BALANCES, FAMILIES, LONGEST_DELAY_S, Drawn, draw

POWDERS = shipped_powders()
QUIET = BalanceFigures(noise_mg=0.0, shake_mg=0.0, drift_mg=0.0, momentum=0.0)
EVEN = FlowFigures(flow_mg_per_s=50.0, load_spread=0.0, opening_spread=0.0, noise=0.0)
STEP_S = 0.02


def fallen_mg(flow: DrawnFlow, duration_s: float, opening_mm: float, vibration: float = 0.0, seed: int = 1) -> float:
    rng = np.random.default_rng(seed)
    steps = round(duration_s / STEP_S)
    return sum(flow.step(STEP_S, opening_mm, vibration, 5000.0, rng) for _ in range(steps))


@pytest.mark.parametrize("family", FAMILIES)
def test_a_draw_is_the_same_each_time_and_no_plant_to_judge_by_is_one_to_tune_with(family: str) -> None:
    tuning, again = draw(family, POWDERS, 8), draw(family, POWDERS, 8)
    judging = draw(family, POWDERS, 8, seeds="judging")
    assert tuning == again
    assert not {drawn.seed for drawn in tuning} & {drawn.seed for drawn in judging}
    assert not {drawn.flow for drawn in tuning} & {drawn.flow for drawn in judging}


def test_each_eighth_of_a_prior_is_drawn_once_in_eight_plants() -> None:
    eighths = sorted(int((drawn.flow.exponent - 2.0) / 1.2 * 8) for drawn in draw("beads", POWDERS, 8))
    assert eighths == list(range(8))


def test_believed_flow_of_five_times_is_five_times_what_the_lab_believes_at_1_mm() -> None:
    belief = POWDERS["glass_beads"].belief
    believed = belief.coefficient * (1.0 - belief.threshold_mm) ** belief.exponent
    flows = {round(drawn.flow.flow_mg_per_s / believed, 6) for drawn in draw("flow", POWDERS, 40)}
    assert flows == {0.1, 0.5, 2.0, 5.0}


@pytest.mark.parametrize("kind", ["poles", "mean", "delay", "ringing", "adaptive"])
def test_a_steadily_growing_mass_is_read_late_by_the_delay(kind: str) -> None:
    figures = replace(QUIET, kind=kind, delay_s=1.5, patience=1.0)
    balance, rng = DrawnBalance(figures), np.random.default_rng(0)
    for step in range(1000):
        on_pan_mg = 25_000.0 + 10.0 * STEP_S * step
        reading_mg = balance.step(STEP_S, on_pan_mg, 0.0, 0.0, rng)
    assert (on_pan_mg - reading_mg) / 10.0 == pytest.approx(1.5, abs=STEP_S)


@pytest.mark.parametrize("kind", ["poles", "mean", "delay", "ringing", "adaptive"])
def test_a_balance_at_rest_shows_what_it_carries_whatever_its_steps(kind: str) -> None:
    balance, rng = DrawnBalance(replace(QUIET, kind=kind)), np.random.default_rng(0)
    assert balance.step(0.1, 25_000.0, 0.0, 0.0, rng) == pytest.approx(25_000.0)
    for dt_s in (1e-9, 0.1, 0.02, 0.1):
        balance.step(dt_s, 25_300.0, 0.0, 0.0, rng)
    for _ in range(200):
        reading_mg = balance.step(0.1, 25_300.0, 0.0, 0.0, rng)
    assert reading_mg == pytest.approx(25_300.0, abs=1e-3)


def test_an_adaptive_balance_is_slower_in_small_things() -> None:
    def shown_after_1_s(jump_mg: float) -> float:
        balance, rng = DrawnBalance(replace(QUIET, kind="adaptive", patience=5.0)), np.random.default_rng(0)
        balance.step(STEP_S, 0.0, 0.0, 0.0, rng)
        for _ in range(50):
            reading_mg = balance.step(STEP_S, jump_mg, 0.0, 0.0, rng)
        return reading_mg / jump_mg

    assert shown_after_1_s(5.0) < 0.5 * shown_after_1_s(500.0)


@pytest.mark.parametrize("later", [False, True])
def test_a_filter_changes_in_its_dose_once_powder_has_landed_and_stays_so(later: bool) -> None:
    drawn = next(one for one in draw("beads", POWDERS, 40, steps=True) if one.change_s == 0.5)
    balance, rng = drawn.balance_of(drawn.change_dose + later), np.random.default_rng(0)
    for _ in range(100):
        balance.step(STEP_S, 25_000.0, 0.0, 0.0, rng)
    assert balance.figures == (drawn.later if later else drawn.balance)
    for _ in range(30):
        balance.step(STEP_S, 25_000.0, 0.1, 0.0, rng)
    assert balance.figures == drawn.later != drawn.balance
    assert drawn.balance_of(drawn.change_dose - 1).figures == drawn.balance


@pytest.mark.parametrize("balance", BALANCES)
def test_no_delay_is_longer_than_the_longest(balance: str) -> None:
    def delays_s(drawn: Drawn) -> tuple[float, ...]:
        assert drawn.later is not None
        return drawn.balance.delay_s, drawn.later.delay_s

    of_all = [delay_s for one in draw("msg", POWDERS, 30, balances=[balance], steps=True) for delay_s in delays_s(one)]
    assert 0.04 < min(of_all) < max(of_all) <= LONGEST_DELAY_S


@pytest.mark.parametrize("kind", ["one size", "exponential"])
def test_lumps_change_how_powder_comes_and_not_how_much(kind: str) -> None:
    lumpy = replace(EVEN, lump_share=0.8, lump_mg=5.0, lump_kind=kind)
    assert fallen_mg(DrawnFlow(lumpy), 60.0, 1.0) == pytest.approx(fallen_mg(DrawnFlow(EVEN), 60.0, 1.0), rel=0.1)


def test_a_fresh_load_primes_in_its_time_and_only_when_it_is_shaken() -> None:
    figures = replace(EVEN, gravity=0.0, prime_s=5.0)
    flow = DrawnFlow(figures)
    assert fallen_mg(flow, 60.0, 1.0) == 0.0
    assert fallen_mg(flow, 4.9, 1.0, vibration=1.0) == 0.0
    assert fallen_mg(flow, 1.0, 1.0, vibration=1.0) > 30.0


def test_narrow_openings_arch_and_wide_ones_never_do() -> None:
    figures = replace(EVEN, arch_mg=2.0, arch_mm=1.0)
    assert fallen_mg(DrawnFlow(figures), 60.0, 0.3) < 0.5 * fallen_mg(DrawnFlow(EVEN), 60.0, 0.3)
    assert fallen_mg(DrawnFlow(figures), 60.0, 1.0) == fallen_mg(DrawnFlow(EVEN), 60.0, 1.0)
    shaken_mg = fallen_mg(DrawnFlow(figures), 60.0, 0.3, vibration=1.0)
    assert shaken_mg > 1.5 * fallen_mg(DrawnFlow(figures), 60.0, 0.3)


def test_what_was_on_its_way_when_the_valve_shut_still_falls() -> None:
    flow, rng = DrawnFlow(replace(EVEN, transit_s=0.1, trickle_s=0.5)), np.random.default_rng(0)
    for _ in range(100):
        flow.step(STEP_S, 1.0, 0.0, 5000.0, rng)
    late_mg = flow.step(STEP_S, 0.0, 0.0, 5000.0, rng)
    late_mg += sum(flow.trickle(STEP_S, 5000.0) for _ in range(200))
    assert late_mg == pytest.approx(50.0 * 0.1, rel=0.15)
