"""The guards' limits, each from both sides, on readings that are given one by one."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any, cast

import pytest
from dose_bench import DISH, PAN

from scuhand_bt.cell.believed import Believed
from scuhand_bt.cell.cell import Cell
from scuhand_bt.cell.pan_bracket import Bracket
from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.clock import Signal
from scuhand_bt.device_specs.balance import BalanceSpec
from scuhand_bt.devices.interfaces import Reading
from scuhand_bt.dosing.bracket import Gross
from scuhand_bt.dosing.characteristic import Step
from scuhand_bt.failures import SkillFailed
from scuhand_bt.run.guards import Guards
from scuhand_bt.specs import BalanceBelief

EMPTY_MG = 25_000.0
BARE, EMPTY = Gross(0.0, 0.0, 0.0), Gross(EMPTY_MG, 0.0, 0.0)
LAG_S = 0.125
SETTLES_S = 4.0 * LAG_S
PERIOD_S = 0.125
BLOCK = 4
"""Readings of one average, half a second."""


class Part:
    """A device that may have a fault; as a hand it has an opening, as a balance a reading."""

    def __init__(self) -> None:
        self.news = Signal()
        self.fault: SkillFailed | None = None
        self.opening_mm = 0.0
        self.latest: Reading | None = None


@dataclass
class Scene:
    """A cone over the pan, on which a container stands, with what the balance shows given by the test."""

    spec: CellSpec = field(
        default_factory=lambda: CellSpec(
            cell="scene", balance=BalanceSpec(period_s=PERIOD_S, readability_mg=0.1), stations={"balance": PAN}
        )
    )
    believed: Believed = field(
        default_factory=lambda: Believed(
            pan=DISH, pan_empty_mg=EMPTY_MG, pan_gross_mg=EMPTY_MG, bracket=Bracket(DISH.id, BARE, EMPTY, EMPTY)
        )
    )
    balance_belief: BalanceBelief = field(default_factory=lambda: BalanceBelief(lag_s=LAG_S))
    came: Step | None = None
    apex: tuple[float, float, float] = (PAN.position_mm[0], PAN.position_mm[1], 140.0)
    now_s: float = 10.0

    def __post_init__(self) -> None:
        self.parts = {name: Part() for name in ("arm", "hand", "balance", "changer")}
        self.hand, self.balance = self.parts["hand"], self.parts["balance"]
        self.guards = Guards(cast(Cell, self))

    def device(self, name: str) -> Any:
        return self.parts[name]

    def apex_mm(self) -> tuple[float, float, float]:
        return self.apex

    def shows(self, net_mg: float, after_s: float = PERIOD_S) -> SkillFailed | None:
        """A reading comes, and the guards look."""
        self.now_s += after_s
        self.balance.latest = Reading(EMPTY_MG + net_mg, False, self.now_s)
        return self.guards.look()

    def trips(self, net_mg: Iterable[float], after_s: float = PERIOD_S) -> float | None:
        """After how long the guards trip [s], of readings that come one after the other; None if they do not."""
        began_s = self.now_s
        for mass_mg in net_mg:
            if self.shows(mass_mg, after_s) is not None:
                return self.now_s - began_s
        return None


@pytest.fixture
def scene() -> Scene:
    return Scene()


# --- the devices


def test_the_guards_are_woken_by_every_device_and_once_by_two_that_share_their_news(scene: Scene) -> None:
    shared = scene.parts["changer"].news = scene.parts["arm"].news
    guards = Guards(cast(Cell, scene))
    wakes = guards.wakes()
    assert len(wakes) == 3
    for signal in (shared, scene.hand.news, scene.balance.news):
        before = [wake.has_fired for wake in wakes]
        signal.fire()
        assert sum(wake.has_fired for wake in wakes) == sum(before) + 1


@pytest.mark.parametrize("device", ["arm", "hand", "balance", "changer"])
def test_a_devices_fault_is_told_though_no_reading_has_come(scene: Scene, device: str) -> None:
    assert scene.guards.look() is None
    fault = SkillFailed("device.lost", "it is gone")
    scene.parts[device].fault = fault
    assert scene.guards.look() is fault


# --- a dose that runs away


def opened(scene: Scene, target_mg: float, opening_mm: float = 0.06) -> Scene:
    scene.hand.opening_mm = opening_mm
    scene.believed.dosing_towards(target_mg, "glass_beads", EMPTY)
    return scene


@pytest.mark.parametrize(
    ("target_mg", "net_mg", "runs_away"),
    [
        (20.0, 120.0, False),
        (20.0, 120.1, True),
        (500.0, 600.0, False),
        (500.0, 600.1, True),
        (3000.0, 3600.0, False),
        (3000.0, 3600.1, True),
    ],
)
def test_beyond_the_target_is_by_100_mg_or_a_fifth_of_it(
    scene: Scene, target_mg: float, net_mg: float, runs_away: bool
) -> None:
    assert (opened(scene, target_mg).trips([net_mg] * 40) is not None) is runs_away


def test_it_has_run_away_after_two_seconds_and_says_what_it_saw(scene: Scene) -> None:
    opened(scene, 20.0, 1.234)
    assert scene.shows(500.0) is None
    assert scene.shows(500.0, 1.99) is None
    fault = scene.shows(503.0, 0.02)
    assert (
        str(fault) == "dose.runaway: the container holds 503 mg, the target is 20 mg, and the valve is open by 1.23 mm"
    )


def test_exactly_two_seconds_are_enough(scene: Scene) -> None:
    opened(scene, 20.0)
    scene.now_s = 0.0
    scene.shows(500.0, 1.0)
    assert scene.shows(500.0, 2.0) is not None


def test_a_valve_that_stands_at_a_twentieth_of_a_millimetre_is_shut(scene: Scene) -> None:
    assert opened(scene, 20.0, 0.05).trips([500.0] * 40) is None
    assert opened(Scene(), 20.0, 0.051).trips([500.0] * 40) is not None


def test_the_two_seconds_begin_anew_after_a_reading_that_is_not_beyond(scene: Scene) -> None:
    opened(scene, 20.0)
    assert scene.trips([500.0] * 15 + [100.0] + [500.0] * 16) is None
    assert scene.trips([500.0]) is not None


def test_the_two_seconds_begin_anew_after_the_valve_was_shut(scene: Scene) -> None:
    opened(scene, 20.0)
    assert scene.trips([500.0] * 15) is None
    scene.hand.opening_mm = 0.0
    scene.shows(500.0)
    scene.hand.opening_mm = 1.0
    assert scene.trips([500.0] * 16) is None
    assert scene.trips([500.0]) is not None


@pytest.mark.parametrize("unknown", ["target", "empty mass"])
def test_without_a_target_or_an_empty_mass_nothing_runs_away_and_the_two_seconds_begin_anew(
    scene: Scene, unknown: str
) -> None:
    opened(scene, 20.0)
    assert scene.trips([500.0] * 15) is None
    if unknown == "target":
        scene.believed.dosing_ended(0.0, EMPTY_MG)
    else:
        scene.believed.brought(DISH, from_changer=False)
        scene.believed.placed(BARE, EMPTY)
    assert scene.trips([500.0] * 40) is None
    scene.believed.tared(EMPTY)
    scene.believed.dosing_towards(20.0, "glass_beads", EMPTY)
    assert scene.trips([500.0] * 16) is None
    assert scene.trips([500.0]) is not None


# --- a leak


def rising(rate: float, begin_mg: float = 0.0) -> Iterator[float]:
    """What a balance shows for a minute whose pan gains so much a second."""
    return (begin_mg + rate * PERIOD_S * reading for reading in range(600))


def blocks(*means_mg: float, wobble_mg: float = 0.0, rests: int = 1) -> list[float]:
    """Readings of which so many have this mean, after the pan has settled and has rested for so many averages."""
    around = [wobble_mg, -wobble_mg] * (BLOCK // 2)
    before = [means_mg[0]] * (round(SETTLES_S / PERIOD_S) + rests * BLOCK)
    return before + [mean_mg + off_mg for mean_mg in means_mg for off_mg in around] + [means_mg[-1]]


FOUND_S = PERIOD_S + SETTLES_S + 9 * BLOCK * PERIOD_S
"""A leak that goes on from an opening is found when the pan should have settled and nine averages have been taken."""
RESTED_S = PERIOD_S + SETTLES_S + 6 * BLOCK * PERIOD_S
"""One that begins when it has, and has rested for an average, after five more."""


def test_a_steady_leak_is_found_after_nine_averages_and_its_rate_is_said(scene: Scene) -> None:
    assert scene.trips(rising(1.5)) == pytest.approx(FOUND_S)
    scene = Scene()
    faults = [fault for mg in rising(1.5) if (fault := scene.shows(mg)) is not None]
    assert str(faults[0]) == "hand.leak: the valve is shut, but the pan below it gains 1.5 mg/s"


@pytest.mark.parametrize(("rate", "is_leak"), [(0.99, False), (1.01, True), (-1.5, False)])
def test_a_leak_is_a_milligram_a_second(scene: Scene, rate: float, is_leak: bool) -> None:
    assert (scene.trips(rising(rate)) is not None) is is_leak


def test_a_rise_of_exactly_the_least_counts(scene: Scene) -> None:
    assert scene.trips(blocks(0.0, 0.5, 1.0, 1.5, 2.0)) == pytest.approx(RESTED_S)
    assert Scene().trips(blocks(0.0, 0.499, 0.998, 1.497, 1.996)) is None


def test_four_rises_are_a_leak_and_three_are_not(scene: Scene) -> None:
    assert scene.trips(blocks(0.0, 1.0, 2.0, 3.0, 3.0, 3.0)) is None
    assert Scene().trips(blocks(0.0, 1.0, 2.0, 3.0, 4.0)) is not None


def test_of_a_rise_that_goes_on_ever_since_seven_are_no_leak_and_eight_are() -> None:
    rises_mg = [float(mg) for mg in range(9)]
    assert Scene().trips(blocks(*rises_mg[:8], rests=0)) is None
    assert Scene().trips(blocks(*rises_mg, rests=0)) == pytest.approx(FOUND_S)
    assert Scene().trips(blocks(0.0, 3.0, *[3.0 + mg for mg in rises_mg[1:7]], 9.5, rests=0)) is None, "it slows down"


def test_rises_before_a_rest_do_not_count(scene: Scene) -> None:
    assert scene.trips(blocks(0.0, 1.0, 2.0, 2.0, 3.0, 4.0, 4.0)) is None
    assert Scene().trips(blocks(0.0, 1.0, 2.0, 2.0, 3.0, 4.0, 5.0, 6.0)) == pytest.approx(RESTED_S + 3 * 0.5)


def test_what_slows_down_to_less_than_half_is_settling(scene: Scene) -> None:
    assert scene.trips(blocks(0.0, 2.0, 4.0, 6.0, 7.0)) == pytest.approx(RESTED_S), "half is a leak"
    assert Scene().trips(blocks(0.0, 2.0, 4.0, 6.0, 6.99)) is None


def test_only_the_last_four_rises_are_compared(scene: Scene) -> None:
    assert scene.trips(blocks(0.0, 20.0, 22.0, 24.0, 26.0, 28.0)) == pytest.approx(RESTED_S + 0.5)


def test_the_rate_is_the_mean_of_four_rises(scene: Scene) -> None:
    faults = [fault for mg in blocks(0.0, 2.0, 3.0, 5.0, 6.0) if (fault := scene.shows(mg)) is not None]
    assert "gains 3.0 mg/s" in str(faults[0])


@pytest.mark.parametrize(("wobble_mg", "is_leak"), [(0.66, True), (0.67, False)])
def test_a_rise_counts_from_three_standard_errors_of_its_average(scene: Scene, wobble_mg: float, is_leak: bool) -> None:
    # +w, -w, +w, -w: a standard deviation of w, and of their mean w / 2.
    found_s = scene.trips(blocks(0.0, 1.0, 2.0, 3.0, 4.0, wobble_mg=wobble_mg))
    assert (found_s is not None) is is_leak


def test_a_coarse_balance_must_rise_by_half_a_digit(scene: Scene) -> None:
    coarse = CellSpec(
        cell="coarse", balance=BalanceSpec(period_s=PERIOD_S, readability_mg=4.0), stations={"balance": PAN}
    )
    assert Scene(coarse).trips(blocks(0.0, 1.99, 3.98, 5.97, 7.96)) is None
    assert Scene(coarse).trips(blocks(0.0, 2.0, 4.0, 6.0, 8.0)) == pytest.approx(RESTED_S)


def test_a_slow_balance_is_averaged_over_three_quarters_of_its_lag_and_given_four_lags_to_settle() -> None:
    slow = Scene(balance_belief=BalanceBelief(lag_s=2.0))
    assert slow.trips(rising(1.5)) == pytest.approx(4.0 * 2.0 + PERIOD_S + 9 * 1.5)
    just = Scene(balance_belief=BalanceBelief(lag_s=2.0))
    assert just.trips(rising(0.99)) is None


def ringing(delay_s: float, damping: float, mass_mg: float) -> Iterator[float]:
    """What a balance that rings shows in a minute of a mass that has come at once."""
    own = 2.0 * damping / delay_s
    faded, swings = damping * own, own * math.sqrt(1.0 - damping * damping)
    for time_s in (PERIOD_S * reading for reading in range(480)):
        swing = math.cos(swings * time_s) + faded / swings * math.sin(swings * time_s)
        yield mass_mg * (1.0 - math.exp(-faded * time_s) * swing)


@pytest.mark.parametrize("delay_s", [0.6, 1.0, 4.0])
@pytest.mark.parametrize(("damping", "shape"), [(0.3, "ringing"), (0.4, "ringing"), (0.5, "ringing"), (0.65, "lively")])
def test_the_swings_of_a_balance_that_rings_are_no_leak(delay_s: float, damping: float, shape: str) -> None:
    for mass_mg in (30.0, 500.0, 3000.0):
        scene = Scene(balance_belief=BalanceBelief(lag_s=delay_s / 2.0, shape=shape))
        assert scene.trips(ringing(delay_s, damping, mass_mg)) is None


@pytest.mark.parametrize(("hertz", "damping"), [(0.15, 0.2), (0.2, 0.15), (0.5, 0.15)])
def test_swings_for_as_long_as_a_filter_swung_about_the_container_are_no_leak(hertz: float, damping: float) -> None:
    """No shape rings as long for its delay."""
    delay_s = 2.0 * damping / (math.tau * hertz)
    missing = tuple(1.0 - share for share in ringing(delay_s, damping, 1.0))
    came = Step(EMPTY_MG, tuple(PERIOD_S * reading for reading in range(480)), missing)
    belief = BalanceBelief(lag_s=delay_s / 2.0, shape="ringing")
    for mass_mg in (30.0, 500.0, 3000.0):
        assert Scene(balance_belief=belief, came=came).trips(ringing(delay_s, damping, mass_mg)) is None
    found_s = Scene(balance_belief=belief, came=came).trips(rising(1.5))
    assert found_s == pytest.approx(2.0 * delay_s + 9 * max(0.5, 0.5 / hertz / 3.0), rel=0.2)


def test_a_leak_over_a_balance_that_rings_is_found_after_nine_averages_of_a_third_of_its_swing() -> None:
    scene = Scene(balance_belief=BalanceBelief(lag_s=0.5, shape="ringing"))
    swing_s = math.pi / math.sqrt(0.75)  # damped by a half, and 1 s late: its own frequency is 1 / s
    found_s = scene.trips(rising(1.5))
    assert found_s == pytest.approx(4.0 * 0.5 + 9 * swing_s / 3.0, abs=9 * PERIOD_S)


def test_a_balance_of_few_readings_is_averaged_over_three_of_them() -> None:
    spec = CellSpec(cell="seldom", balance=BalanceSpec(period_s=1.0, readability_mg=0.1), stations={"balance": PAN})
    seldom = Scene(spec)
    assert seldom.trips((1.5 * second for second in range(60)), after_s=1.0) == pytest.approx(2.0 + 9 * 3.0)
    assert Scene(spec).trips((0.99 * second for second in range(60)), after_s=1.0) is None


def test_a_leak_is_looked_for_where_the_apex_is_within_60_mm_of_the_pan() -> None:
    x_mm, y_mm, _ = PAN.position_mm
    over = Scene(apex=(x_mm + 36.0, y_mm - 48.0, 500.0))
    assert over.trips(rising(1.5)) is not None, "60 mm in the plane, at any height"
    beside = Scene(apex=(x_mm + 36.1, y_mm - 48.0, 140.0))
    assert beside.trips(rising(1.5)) is None


def test_a_reading_that_is_seen_again_counts_once(scene: Scene) -> None:
    """A rise of 0.49 mg is none; the first reading of each block is high, and is looked at ever more often."""
    for place, net_mg in enumerate(blocks(0.0, 0.49, 0.98, 1.47, 1.96)):
        is_first = place % BLOCK == 0
        assert scene.shows(net_mg + 0.5 * is_first) is None
        for _ in range(is_first * (place // BLOCK - 1)):
            assert scene.guards.look() is None


def test_while_containers_are_changed_nothing_is_watched_and_then_it_begins_anew(scene: Scene) -> None:
    assert scene.trips(blocks(0.0, 1.0, 2.0, 3.0)) is None
    scene.believed.changing_container()
    assert scene.trips(rising(1.5, 4.0)) is None
    scene.believed.placed(BARE, EMPTY)
    assert scene.trips(rising(1.5)) == pytest.approx(FOUND_S)


def test_after_the_valve_was_open_the_pan_settles_and_nine_averages_are_taken_anew(scene: Scene) -> None:
    assert scene.trips(blocks(0.0, 1.0, 2.0, 3.0)) is None
    scene.hand.opening_mm = 1.0
    assert scene.trips(blocks(3.0, 4.0)) is None
    scene.hand.opening_mm = 0.0
    assert scene.trips(rising(1.5, 5.0)) == pytest.approx(FOUND_S)


def test_what_rises_while_the_pan_settles_does_not_count(scene: Scene) -> None:
    readings = [100.0 * place for place in range(4)] + [1000.0 + mg for mg in rising(1.5)]
    assert scene.trips(readings) == pytest.approx(FOUND_S)
