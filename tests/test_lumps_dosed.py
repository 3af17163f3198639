"""Powders in lumps that need a wider gap than is believed, or that a balance shows late: dosed, and not given up."""

from collections.abc import Iterator
from dataclasses import replace

import pytest
from dose_bench import Bench, Dosed, Setting, shipped_powders

from harness.random_physics import BalanceFigures, FlowFigures
from harness.random_plants import Drawn, RandomPlant
from scuhand_bt.specs import BalanceBelief

WHITE = shipped_powders()["titanium_dioxide"]
LATE = BalanceFigures(kind="delay", delay_s=0.43, noise_mg=0.12, shake_mg=0.4)
MEAN = BalanceFigures(kind="mean", delay_s=0.5, noise_mg=0.1, shake_mg=0.3)
COHESIVE = FlowFigures(
    flow_mg_per_s=5.0,
    exponent=2.67,
    threshold_mm=0.44,
    gravity=0.3,
    load_spread=0.06,
    opening_spread=0.15,
    noise=0.2,
    noise_s=1.0,
    heel=0.29,
    prime_s=7.0,
    arch_mg=0.72,
    arch_mm=0.7,
    arch_s=0.12,
    arch_tail=1.9,
    lump_share=0.76,
    lump_mg=2.74,
)
"""Of titanium dioxide a threshold of 0.2 mm is believed."""
BRIDGING = replace(
    COHESIVE,
    flow_mg_per_s=11.4,
    exponent=3.1,
    threshold_mm=0.31,
    gravity=1.0,
    load_spread=0.2,
    opening_spread=0.11,
    noise=0.1,
    heel=0.47,
    prime_s=3.8,
    arch_mg=1.56,
    arch_mm=0.97,
    arch_s=0.04,
    lump_share=0.64,
    lump_mg=2.37,
    lump_kind="one size",
)
POLES = BalanceFigures(kind="poles", poles=4, delay_s=0.59, momentum=0.05, noise_mg=0.04, shake_mg=0.34, drift_mg=0.03)


def dosed(
    flow: FlowFigures, figures: BalanceFigures, shape: str, target_mg: float, seed: int, doses: int
) -> Iterator[Dosed]:
    """Doses one after another, within which is learnt; how late the balance is was known before."""
    powder, balance = WHITE.belief, BalanceBelief(lag_s=figures.delay_s / 2.0, doubt=0.12, shape=shape, fits=1)
    RandomPlant.at_hand = Drawn("lumps", 0, seed, WHITE.name, flow, Setting().hand, figures)
    for dose in range(doses):
        bench = Bench(WHITE, target_mg, seed, dose, Setting(plant="harness.random_plants:RandomPlant"))
        done = bench.dose("adaptive", powder, balance)
        powder, balance = done.learnt(powder, balance)
        yield done


@pytest.mark.parametrize("seed", range(3))
def test_lumps_that_a_narrow_gap_holds_back_come_through_a_wider_one(seed: int) -> None:
    """A minute of openings that let none through gave up one dose of six."""
    assert all(done.run.finish.reason != "no_flow" for done in dosed(COHESIVE, MEAN, "mean", 20.0, seed, 2))


@pytest.mark.parametrize("seed", [6, 10])
def test_where_lumps_should_have_been_shaken_out_and_were_not_it_opens_wider(seed: int) -> None:
    assert all(done.run.finish.reason == "reached" for done in dosed(BRIDGING, POLES, "two poles", 50.0, seed, 2))


@pytest.mark.slow
def test_an_opening_of_lumps_is_open_for_longer_than_its_balance_is_late() -> None:
    """Two hundred openings of 0.6 s each brought 1.5 of 3 g, and taught that the balance is twice as quick as it is."""
    (done,) = dosed(COHESIVE, LATE, "delay", 3000.0, 2, 1)
    assert done.run.finish.reason in ("reached", "overshoot")
    assert done.run.finish.balance is not None
    assert done.run.finish.balance.lag_s > 0.19
