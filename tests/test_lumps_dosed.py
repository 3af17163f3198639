"""Powders in lumps that need a wider gap than is believed, or that a balance shows late: dosed, and not given up."""

import pytest
from dose_bench import Bench, Dosed, Setting, shipped_powders

from harness.random_physics import BalanceFigures, FlowFigures
from harness.random_plants import Drawn, RandomPlant
from scuhand_bt.specs import BalanceBelief, PowderBelief

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


def dosed(
    powder: PowderBelief, balance: BalanceBelief, figures: BalanceFigures, target_mg: float, seed: int, dose: int = 0
) -> Dosed:
    RandomPlant.at_hand = Drawn("lumps", 0, seed, WHITE.name, COHESIVE, Setting().hand, figures)
    bench = Bench(WHITE, target_mg, seed, dose, Setting(plant="harness.random_plants:RandomPlant"))
    return bench.dose("adaptive", powder, balance)


@pytest.mark.parametrize("seed", range(3))
def test_lumps_that_a_narrow_gap_holds_back_are_tried_wider(seed: int) -> None:
    """Its last milligrams came through no gap that was tried for a minute, in one dose of six."""
    powder, balance = WHITE.belief, BalanceBelief(lag_s=0.25, doubt=0.12, shape="mean", fits=1)
    for dose in range(2):
        done = dosed(powder, balance, MEAN, 20.0, seed, dose)
        assert done.run.finish.reason != "no_flow"
        powder, balance = done.learnt(powder, balance)


def test_an_opening_of_lumps_is_open_for_longer_than_its_balance_is_late() -> None:
    """Two hundred openings of 0.6 s each brought 1.5 of 3 g, and taught that the balance is twice as quick as it is."""
    known = BalanceBelief(lag_s=0.215, doubt=0.12, shape="delay", fits=1)
    done = dosed(WHITE.belief, known, LATE, 3000.0, 2)
    assert done.run.finish.reason in ("reached", "overshoot")
    assert done.run.finish.balance is not None
    assert done.run.finish.balance.lag_s > 0.19
