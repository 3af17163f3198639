"""A step of the zero that a balance's filter hides: while the bare pan is not yet at rest, and while powder falls."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from harness.bench import Bench
from harness.falsify import Falsifier, Tally
from harness.ills_forces import Between
from harness.worlds import WORLDS, HostileWorld
from scuhand_bt.dosing.bracket import fallen_mg
from scuhand_bt.dosing.characteristic import Step, step_of
from scuhand_bt.dosing.hidden_step import fallen_beside_mg, hidden_step_mg

FALL_S = 0.128
"""Of 80 mm."""
FINE_S, PERIOD_S, DIGIT_MG, MASS_MG = 0.005, 0.1, 0.1, 9200.0
TIMES_S = np.arange(0.0, 14.0, FINE_S)
Filter = Callable[[np.ndarray], np.ndarray]


def poles(tau_s: float) -> Filter:
    def filtered(load_mg: np.ndarray) -> np.ndarray:
        for _ in range(2):
            shown_mg = np.empty_like(load_mg)
            shown_mg[0] = now_mg = load_mg[0]
            for number in range(1, len(load_mg)):
                now_mg += (load_mg[number] - now_mg) * -np.expm1(-FINE_S / tau_s)
                shown_mg[number] = now_mg
            load_mg = shown_mg
        return load_mg

    return filtered


def mean(over_s: float) -> Filter:
    many = round(over_s / FINE_S)
    return lambda load_mg: np.convolve(np.r_[np.full(many - 1, load_mg[0]), load_mg], np.full(many, 1 / many), "valid")


def ringing(damping: float, own_per_s: float = 5.0) -> Filter:
    def filtered(load_mg: np.ndarray) -> np.ndarray:
        shown_mg, speed = np.empty_like(load_mg), 0.0
        shown_mg[0] = load_mg[0]
        for number in range(1, len(load_mg)):
            pull = own_per_s**2 * (load_mg[number] - shown_mg[number - 1])
            speed += FINE_S * (pull - 2.0 * damping * own_per_s * speed)
            shown_mg[number] = shown_mg[number - 1] + FINE_S * speed
        return shown_mg

    return filtered


def adapting(quick_s: float, slow_s: float, within_mg: float) -> Filter:
    def filtered(load_mg: np.ndarray) -> np.ndarray:
        shown_mg = np.empty_like(load_mg)
        shown_mg[0] = first_mg = load_mg[0]
        for number in range(1, len(load_mg)):
            is_near = abs(load_mg[number] - shown_mg[number - 1]) < within_mg
            step = -np.expm1(-FINE_S / (slow_s if is_near else quick_s))
            first_mg += (load_mg[number] - first_mg) * step
            shown_mg[number] = shown_mg[number - 1] + (first_mg - shown_mg[number - 1]) * step
        return shown_mg

    return filtered


FILTERS = {
    "0.3 s": poles(0.3),
    "0.6 s": poles(0.6),
    "a mean": mean(1.0),
    "ringing": ringing(0.5),
    "adapting": adapting(0.2, 0.8, 8.0),
}


def shown(
    filtered: Filter, load_mg: np.ndarray, changed_s: float, rng: np.random.Generator, late_s: float = 0.0
) -> Step:
    every = round(PERIOD_S / FINE_S)
    times_s = TIMES_S[::every] + rng.uniform(0.0, late_s, len(TIMES_S[::every]))
    if late_s:  # and one is lost
        times_s[np.searchsorted(times_s, changed_s + rng.uniform(0.5, 4.0)) :] += PERIOD_S
    values_mg = filtered(load_mg)[::every] + 0.05 * rng.standard_normal(len(times_s))
    values_mg = np.round(values_mg / DIGIT_MG) * DIGIT_MG
    curve = list(zip(times_s.tolist(), values_mg.tolist(), strict=True))
    step = step_of(curve, float(values_mg[:5].mean()), float(values_mg[-5:].mean()), changed_s)
    assert step is not None
    return step


def told_mg(
    filtered: Filter, stepped_mg: float, after_s: float, seed: int = 0, late_s: float = 0.0, *, coming: bool = False
) -> float:
    """What is told of a zero that steps so long after the container went, or came; by readings that may be so late."""
    rng = np.random.default_rng(seed)

    def step(before_mg: float, after_mg: float, has_step: bool) -> Step:
        at_s = 1.0 + rng.uniform(0.0, PERIOD_S)
        zero_mg = np.where(at_s + after_s > TIMES_S, 0.0, stepped_mg) if has_step else 0.0
        return shown(filtered, np.where(at_s > TIMES_S, before_mg, after_mg) + zero_mg, at_s, rng, late_s)

    return hidden_step_mg(step(0.0, MASS_MG, coming), step(MASS_MG + 35.0, 0.0, not coming), DIGIT_MG)


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize("seed", range(5))
def test_a_pan_that_comes_to_rest_as_it_did_before_hides_nothing(name: str, seed: int) -> None:
    assert told_mg(FILTERS[name], 0.0, 0.0, seed) == 0.0


@pytest.mark.parametrize("off_s", [-0.005, 0.005])
def test_a_pan_that_is_steep_where_the_fit_begins_hides_nothing_when_the_load_came_5_ms_beside(off_s: float) -> None:
    """It passes what it is to show, as filters of Butterworth's and Bessel's kind do."""
    steep, rng, told = ringing(0.5, 2.0), np.random.default_rng(0), []
    for _ in range(10):
        at_s = 1.0 + FINE_S * rng.integers(20)
        came = shown(steep, np.where(at_s > TIMES_S, 0.0, MASS_MG), at_s, rng)
        went = shown(steep, np.where(at_s > TIMES_S, MASS_MG + 35.0, 0.0), at_s + off_s, rng)
        told.append(hidden_step_mg(came, went, DIGIT_MG))
    assert max(told) == 0.0


@pytest.mark.parametrize("name", FILTERS)
def test_readings_that_arrive_unevenly_hardly_ever_tell_a_step(name: str) -> None:
    told = [told_mg(FILTERS[name], 0.0, 0.0, seed, late_s=0.05) for seed in range(40)]
    assert sum(mg > 0.0 for mg in told) <= 2


@pytest.mark.parametrize("stepped_mg", [3.0, -3.0, 1.5])
@pytest.mark.parametrize(
    ("name", "after_s"), [("0.3 s", 3.0), ("0.3 s", 3.3), ("0.6 s", 6.0), ("a mean", 1.4), ("adapting", 4.0)]
)
@pytest.mark.parametrize("coming", [False, True])
def test_a_step_on_a_pan_that_is_not_yet_at_rest_is_told(
    name: str, after_s: float, stepped_mg: float, coming: bool
) -> None:
    told = told_mg(FILTERS[name], stepped_mg, after_s, coming=coming)
    assert told > abs(stepped_mg) / 2.0, "what doubt 2.15 times as wide covers"


@pytest.mark.parametrize("after", [poles(0.45), poles(0.6), mean(1.0), ringing(0.3)])
def test_two_curves_of_different_filters_tell_no_step(after: Filter) -> None:
    rng, at_s = np.random.default_rng(0), 1.05
    came = shown(FILTERS["0.3 s"], np.where(at_s > TIMES_S, 0.0, MASS_MG), at_s, rng)
    went = shown(after, np.where(at_s > TIMES_S, MASS_MG + 35.0, 0.0), at_s, rng)
    assert hidden_step_mg(came, went, DIGIT_MG) == 0.0


def test_a_filter_that_turns_slow_a_moment_sooner_or_later_hides_nothing() -> None:
    """Two looks at one container, of a simulated run on such a filter, from 400 mg on: they looked like 1.6 mg."""
    curves = json.loads((Path(__file__).parent / "adapting_container.json").read_text(encoding="utf-8"))
    steps = [
        Step(
            one["step_mg"],
            tuple(one["first_s"] + PERIOD_S * number for number in range(len(one["missing_mg"]))),
            tuple(missing_mg / abs(one["step_mg"]) for missing_mg in one["missing_mg"]),
        )
        for one in (curves["came"], curves["went"])
    ]
    assert hidden_step_mg(*steps, DIGIT_MG) == 0.0


def test_too_little_of_a_curve_tells_nothing() -> None:
    short = Step(-MASS_MG, (0.1, 0.2), (0.5, 0.0))
    assert hidden_step_mg(short, short, DIGIT_MG) == 0.0


@dataclass
class Once(Between):
    """It pushes at one container only, from when powder falls."""

    container: str = ""
    after_s: float = 0.0

    def force_mg(self, bench: Bench, dt_s: float) -> float:
        is_another = bench.container not in (None, self.container)
        if is_another or bench.now_s < bench.at.get("opened", 0.0) + self.after_s:
            return 0.0
        return super().force_mg(bench, dt_s)


@pytest.mark.slow
def test_the_only_step_of_a_run_is_found_where_it_ends_on_a_pan_that_comes_to_rest(tmp_path: Path) -> None:
    ill = Once("opened", "bare", (-3.0,), later_s=3.0, container="b-xrd-2", after_s=3.5)
    falsifier, tally = Falsifier(tmp_path, ("short",)), Tally("once")
    falsifier.run_once(HostileWorld("once", "", lambda: [ill]), "short", 54002, tally)
    assert ill._seen_s is not None, "it came"
    assert tally.false_goods == []
    assert tally.flagged["balance.bracket_open"] > 0


def fell_mg(filtered: Filter, zero_mg: np.ndarray, seed: int, dose_mg: float = 50.0) -> tuple[float, float]:
    """By how much the readings of a dose in pulses fall, and by how much beside what powder explains."""
    rng = np.random.default_rng(seed)
    came = shown(filtered, np.where(TIMES_S < 1.0, 0.0, MASS_MG), 1.0, rng)
    pours = np.isin(np.arange(len(TIMES_S)) // 60, (6, 14, 15, 27))  # 0.3 s each
    landed_mg = dose_mg * np.cumsum(pours) / pours.sum()
    load_mg = 20.0 + landed_mg + FALL_S * np.gradient(landed_mg, FINE_S) + zero_mg
    every = round(PERIOD_S / FINE_S)
    times_s, values_mg = (
        TIMES_S[::every],
        filtered(load_mg)[::every] + 0.05 * rng.standard_normal(len(TIMES_S[::every])),
    )
    values_mg = np.round(values_mg / DIGIT_MG) * DIGIT_MG
    return fallen_mg(values_mg.tolist()), fallen_beside_mg(times_s.tolist(), values_mg.tolist(), came, FALL_S)


LIVELY = ringing(0.15)


@pytest.mark.parametrize("seed", range(5))
def test_readings_that_ring_fall_by_no_more_than_powder_explains(seed: int) -> None:
    all_mg, beside_mg = fell_mg(LIVELY, np.zeros_like(TIMES_S), seed)
    assert all_mg > 5.0, "or nothing is asked"
    assert beside_mg < 0.25


@pytest.mark.parametrize("seed", range(5))
def test_a_quick_balance_that_felt_a_strong_flow_land_falls_by_no_more_than_powder_explains(seed: int) -> None:
    all_mg, beside_mg = fell_mg(poles(0.06), np.zeros_like(TIMES_S), seed, dose_mg=500.0)
    assert all_mg > 3.0, "or nothing is asked"
    assert beside_mg < 0.25


@pytest.mark.parametrize("at_s", [3.0, 7.0, 10.5])
@pytest.mark.parametrize("filtered", [LIVELY, FILTERS["0.3 s"]])
def test_a_zero_that_falls_behind_a_filter_that_rings_is_told(filtered: Filter, at_s: float) -> None:
    _, beside_mg = fell_mg(filtered, np.where(at_s > TIMES_S, 0.0, -3.0), 0)
    assert beside_mg > 1.5


@pytest.mark.slow
def test_doses_on_a_balance_that_rings_are_good(tmp_path: Path) -> None:
    falsifier, tally = Falsifier(tmp_path, ("short",)), Tally("ringing")
    ringing = next(world for world in WORLDS if world.name == "ringing")
    for seed in range(70002, 70007):
        falsifier.run_once(ringing, "short", seed, tally)
    assert tally.false_goods == []
    assert tally.good >= 0.9 * tally.doses, "one in thirty is taken for a step of the zero"
