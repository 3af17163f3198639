"""Lumps that are shaken out singly are seen when their short opening has ended: they have come all the same."""

from dose_bench import Bench, shipped_powders

from scuhand_bt.dosing.adaptive import DRY_S, Adaptive

POWDER = shipped_powders()["titanium_dioxide"]


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
