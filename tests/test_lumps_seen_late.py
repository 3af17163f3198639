"""Lumps are seen when their opening has ended, if it was short or the balance is slow: they have come all the same."""

import pytest
from dose_bench import Bench, Setting, shipped_powders

from harness.random_physics import BalanceFigures, DrawnBalance
from scuhand_bt.device_specs.balance import BalanceSpec
from scuhand_bt.dosing.adaptive import DRY_S, Adaptive
from scuhand_bt.specs import BalanceBelief

POWDER = shipped_powders()["titanium_dioxide"]
KNOWN = BalanceBelief(lag_s=1.5, doubt=0.12, shape="delay", fits=1)


class Late:
    """A balance that shows everything 3 s late."""

    def balance(self, spec: BalanceSpec) -> DrawnBalance:
        return DrawnBalance(BalanceFigures(kind="delay", delay_s=3.0))


def dry_after(came_mg: float, target_mg: float = 50.0) -> bool:
    """Whether a load is given up after an opening that has filled the minute, and of which this was seen once shut."""
    controller = Adaptive(Bench(POWDER, target_mg).request())
    controller._known.bank.restart(20.0 + came_mg, 0.1, 30.0, 0.3)
    controller._known.begin_mg = controller._barren_mg = 20.0
    controller._barren_s = DRY_S + 1.0
    controller._take_in("lump")
    return controller._gave_out() is not None


def test_what_is_seen_when_the_valve_is_shut_has_come() -> None:
    """3 of 180 doses were given up as `hand.no_flow`, 6 to 9 mg short, though 3 mg had come in the minute before."""
    assert dry_after(0.3)
    assert not dry_after(3.0)


def test_far_from_the_target_a_fresh_load_is_sooner_there() -> None:
    assert dry_after(3.0, target_mg=500.0)
    assert not dry_after(5.0, target_mg=500.0)


def dry_after_openings(*masses_mg: float, target_mg: float = 50.0, load_ratio: float = 1.0) -> bool:
    """Whether a load is given up after openings that began with these masses, of which two fill the minute."""
    controller = Adaptive(Bench(POWDER, target_mg, setting=Setting(load_ratio=load_ratio)).request())
    for mass_mg in masses_mg:
        controller._known.begin(mass_mg, 0.1)
        next(controller._open())
        controller._barren_s += 0.6 * DRY_S
        controller._take_in("reached")
    return controller._gave_out() is not None


def test_near_the_target_what_several_openings_have_brought_together_has_come() -> None:
    """4 mg came by less than 1 mg an opening, in the minute after which a load was given up 4 mg short."""
    assert not dry_after_openings(20.0, 20.7, 21.4)
    assert dry_after_openings(20.0, 20.7, 20.9)


def test_where_a_fresh_load_is_sooner_there_one_opening_must_bring_more() -> None:
    assert dry_after_openings(20.0, 22.5, 25.0, target_mg=500.0)
    assert dry_after_openings(20.0, 22.5, 25.0, load_ratio=0.15), "the cone is all but empty"


def test_what_has_come_is_more_than_the_least_that_there_was() -> None:
    """A zero that has fallen hides no powder."""
    assert not dry_after_openings(20.0, 19.5, 20.6)


@pytest.mark.parametrize("seed", range(2))
def test_a_load_is_not_given_up_that_brings_much_in_each_opening(seed: int) -> None:
    """Each was over before its powder was seen: 100 mg each, and a load of which 8 s of them were taken for its end."""
    bench = Bench(POWDER, 1100.0, seed, setting=Setting(plant=f"{__name__}:Late", load_ratio=0.5))
    done = bench.dose("adaptive", balance=KNOWN, may_scoop_again=True)
    assert done.run.finish.reason in ("reached", "overshoot")
