"""The loop that carries a controller's commands out: what it measures, and when it gives up."""

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, cast

import pytest

from scuhand_bt.cell.dose_loop import DoseRun, run_dose
from scuhand_bt.clock import Steps, Wake
from scuhand_bt.device_specs.balance import BalanceSpec
from scuhand_bt.devices.interfaces import Balance, Hand, Reading, StableMean
from scuhand_bt.dosing import Command, DoseRequest, Finish, Observation, Pulse, Stream, Weigh
from scuhand_bt.dosing.bracket import Drift, Gross, Net, Reference
from scuhand_bt.dosing.characteristic import Step
from scuhand_bt.dosing.controller import silence_s
from scuhand_bt.events.doses import Pulsed
from scuhand_bt.events.entry import Note, SkillEvent
from scuhand_bt.failures import SkillFailed
from scuhand_bt.record import Record
from scuhand_bt.run.clock import VirtualClock
from scuhand_bt.specs import BalanceBelief

EMPTY_MG = 25_000.0
NOTHING = Net(0.0, 0.0)
BEGAN_S = 100.0
MEAN_UNCERTAINTY_MG = 0.1


class Scripted:
    """A controller that says these commands, and keeps what it is told."""

    name = "scripted"
    estimate_mg = 0.0

    def __init__(self, commands: Iterable[Command]) -> None:
        self._commands = iter(commands)
        self.seen: list[Observation] = []

    def decide(self, seen: Observation | None) -> Command:
        if seen is not None:
            self.seen.append(seen)
        return next(self._commands, Finish("reached", 0.0, 0.0))


class Pan:
    """A balance that shows these net masses, one after the other, every 0.1 s or `after_s`; the same while nothing is
    commanded."""

    def __init__(self, clock: VirtualClock, net_mg: Iterable[float], controller: Scripted) -> None:
        self.spec = BalanceSpec(readability_mg=0.1)
        self.latest: Reading | None = None
        self.timeouts_s: list[float | None] = []
        self.after_s = 0.1
        self._clock, self._net_mg, self._controller = clock, iter(net_mg), controller
        self._weighed = (-1, 0.0)
        self.creep_mg: Iterator[float] = itertools.repeat(0.0)

    def next_reading(self, timeout_s: float | None = None) -> Steps[Reading]:
        self.timeouts_s.append(timeout_s)
        end_s = self._clock.now_s + self.after_s
        while self._clock.now_s < end_s:
            yield Wake(end_s)
        self.latest = Reading(EMPTY_MG + next(self._net_mg), False, self._clock.now_s)
        return self.latest

    def stable_mean(self, timeout_s: float = 30.0) -> Steps[StableMean]:
        yield from ()
        if self._weighed[0] != len(self._controller.seen):
            self._weighed = (len(self._controller.seen), next(self._net_mg))
        return StableMean(EMPTY_MG + self._weighed[1] + next(self.creep_mg), MEAN_UNCERTAINTY_MG, self._clock.now_s)


class Valve:
    """A hand that notes what it is told."""

    opening_mm = 0.0

    def __init__(self, clock: VirtualClock) -> None:
        self.told: list[Any] = []
        self._clock = clock

    def stop(self) -> None:
        self.told.append("stop")

    def set_opening(self, opening_mm: float) -> None:
        self.told.append(opening_mm)

    def set_vibration(self, level: float) -> None:
        self.told.append(("vibrate", level))

    def pulse(self, opening_mm: float, dwell_s: float, vibration: float = 0.0) -> Steps[None]:
        self.told.append(("pulse", opening_mm, dwell_s, vibration))
        end_s = self._clock.now_s + dwell_s
        while self._clock.now_s < end_s:
            yield Wake(end_s)


class Recorded(Record):
    """Keeps what is recorded of pulses."""

    def __init__(self) -> None:
        super().__init__(self._hear)
        self.pulses: list[Mapping[str, Any]] = []

    def _hear(self, event: SkillEvent | Note) -> None:
        if isinstance(event, Pulsed):
            self.pulses.append(event.model_dump(exclude_unset=True))


class Loop:
    """Runs the loop on a scripted controller and balance."""

    cone_mg = 5000.0
    believed = BalanceBelief(lag_s=0.3)
    came: Step | None = None

    def __init__(self, commands: Iterable[Command], net_mg: Iterable[float]) -> None:
        self.clock = VirtualClock()
        self.clock.wait([Wake(BEGAN_S)])
        self.controller, self.valve = Scripted(commands), Valve(self.clock)
        self.pan = Pan(self.clock, net_mg, self.controller)
        self.record = Recorded()

    def run(self, against: Reference | None = None) -> DoseRun:
        hand, balance = cast(Hand, self.valve), cast(Balance, self.pan)
        asked = DoseRequest(100.0, 2.0, 0.3, 2.4, 4.0, 0.1, self.cone_mg, balance=self.believed)
        devices = hand, balance, self.clock, self.record
        steps = run_dose(self.controller, asked, *devices, against or reference(), came=self.came)
        try:
            while True:
                self.clock.wait([next(steps)])
        except StopIteration as end:
            return cast(DoseRun, end.value)


def reference(drift: float = 0.0, earlier: Net = NOTHING) -> Reference:
    """The empty container, weighed as the loop begins."""
    return Reference(Gross(EMPTY_MG, MEAN_UNCERTAINTY_MG, BEGAN_S), Drift(0.0, drift), earlier, 0.1)


def streaming(*net_mg: float) -> Loop:
    return Loop([Stream(1.0)] * len(net_mg), net_mg)


def test_a_net_mass_is_the_difference_of_two_means_and_has_the_uncertainty_of_both() -> None:
    loop = Loop([Weigh()], [10.0])
    loop.run()
    (seen,) = loop.controller.seen
    assert (seen.net_mg, seen.stable) == (10.0, True)
    assert seen.uncertainty_mg == pytest.approx(math.sqrt(2.0) * MEAN_UNCERTAINTY_MG, rel=1e-9)


def test_the_balances_zero_wanders_with_the_square_root_of_time() -> None:
    loop = Loop([Weigh(15.0)], [10.0])
    loop.run()
    a_digit_a_minute_mg = 0.1 * math.sqrt(15.0 / 60.0)
    both_mg = math.hypot(math.sqrt(2.0) * MEAN_UNCERTAINTY_MG, a_digit_a_minute_mg)
    assert loop.controller.seen[0].uncertainty_mg == pytest.approx(both_mg, rel=1e-9)


def test_the_doubt_of_a_drift_grows_with_time_and_earlier_doses_keep_theirs() -> None:
    loop = Loop([Weigh(15.0)], [10.0])
    loop.run(reference(drift=0.04, earlier=Net(4.0, 0.3)))
    (seen,) = loop.controller.seen
    assert seen.net_mg == 14.0
    known_mg = math.hypot(math.sqrt(2.0) * MEAN_UNCERTAINTY_MG, 0.05, 0.3)
    assert seen.uncertainty_mg == pytest.approx(math.hypot(known_mg, 0.6), rel=1e-9)


def test_a_long_dose_is_weighed_twice_whenever_nobody_has_looked_for_half_a_minute() -> None:
    loop = Loop([Weigh(16.0)] * 6, [10.0, 20.0, 30.0, 40.0, 50.0, 60.0])
    watched = loop.run().watched
    assert [now.gross_mg - EMPTY_MG for _, now in watched] == [20.0, 40.0, 60.0]
    assert all(before.gross_mg == now.gross_mg for before, now in watched)
    assert [now.time_s - before.time_s for before, now in watched] == [pytest.approx(8.0)] * 3
    assert [at.net_mg for at in loop.controller.seen] == [10.0, 20.0, 30.0, 40.0, 50.0, 60.0]
    assert loop.controller.seen[1].time_s == watched[0][1].time_s, "the controller is told of the second one"


@pytest.mark.parametrize(
    ("creep_mg", "seen_mg", "for_s"),
    [
        ([0.0, 0.28], (0.0, 0.28), 8.0),
        ([0.0, 0.31, 0.29], (0.0, 0.29), 16.0),
        ([0.0, -0.31, -0.4, -0.5], (0.0, -0.5), 24.0),
        ([0.0, 0.6, 0.8], (0.6, 0.8), 8.0),
        ([0.0, 1.6, 2.2, 2.4], (2.2, 2.4), 8.0),
        ([0.0, 0.6, 1.0, 1.2], (0.0, 1.2), 24.0),
        ([0.0, 0.6, 1.2, 1.8], (0.0, 1.8), 24.0),
        ([0.0, -0.6, -0.7, -0.7], (0.0, -0.7), 24.0),
    ],
)
def test_what_chance_would_hardly_make_is_watched_on_and_a_filter_is_let_settle_but_no_zero_that_creeps(
    creep_mg: list[float], seen_mg: tuple[float, float], for_s: float
) -> None:
    loop = Loop([Weigh(31.0)], [20.0])
    loop.pan.creep_mg = iter(creep_mg)
    ((before, now),) = loop.run().watched
    assert [one.gross_mg - EMPTY_MG - 20.0 for one in (before, now)] == pytest.approx(seen_mg)
    assert now.time_s - before.time_s == pytest.approx(for_s)


@pytest.mark.parametrize(
    "believed", [BalanceBelief(lag_s=1.0), BalanceBelief(lag_s=1.0 / 6.0, doubt=math.log(2.0), adapts=True)]
)
def test_what_a_slow_filter_has_yet_to_show_of_the_powder_is_no_drift(believed: BalanceBelief) -> None:
    """Nor what one that adapts has, which takes its time over the last of it."""
    loop, shut_s, missing_mg = Loop([Weigh(31.0)], [20.0]), BEGAN_S + 31.0, 0.25
    loop.believed = believed
    loop.pan.creep_mg = (-missing_mg * math.exp(shut_s - loop.clock.now_s) for _ in itertools.count())
    ((before, now),) = loop.run().watched
    assert now.gross_mg - before.gross_mg < 0.15 * missing_mg
    assert now.time_s - before.time_s == pytest.approx(8.0)


def test_what_a_filter_that_rings_swings_back_by_is_no_drift() -> None:
    """By how much it has shown since the powder came it is known how long it rings: here more than a minute."""
    loop = Loop([Stream(1.0), Stream(0.0), Weigh(31.0)], [0.0, 100.0, 100.0])
    loop.believed = BalanceBelief(lag_s=2.0, shape="ringing")
    loop.pan.creep_mg = (100.0 * math.exp((BEGAN_S - loop.clock.now_s) / 8.0) for _ in itertools.count())
    ((before, now),) = loop.run().watched
    assert abs(now.gross_mg - before.gross_mg) < 0.05
    assert before.time_s - BEGAN_S < 80.0


def swinging(lasts_s: float) -> Step:
    """How a filter shows a container that swings about it every second, and to 1/e within this time."""
    times_s = [0.1 * number for number in range(1, 1000)]
    missing = (math.cos(math.tau * time_s) * math.exp(-time_s / lasts_s) for time_s in times_s)
    return Step(EMPTY_MG, tuple(times_s), tuple(missing), MEAN_UNCERTAINTY_MG)


@pytest.mark.parametrize("commands", [[Stream(1.0), Stream(0.0), Weigh(31.0)], [Pulse(1.0, 0.5, 0.0)]])
def test_what_a_filter_swings_by_for_as_long_as_it_did_about_the_container_is_not_weighed(
    commands: list[Command],
) -> None:
    """Neither for a drift nor in the end; the shape that it is believed to have rings no longer than a second."""
    loop = Loop(commands, [0.0, 100.0, 100.0] if len(commands) > 1 else [100.0, 100.0])
    loop.pan.latest = Reading(EMPTY_MG, True, BEGAN_S)
    loop.believed, loop.came = BalanceBelief(lag_s=0.05, shape="ringing"), swinging(8.0)
    run = loop.run()
    shown_s = 8.0 * math.log(100.0 / 0.05)
    assert run.last.time_s - BEGAN_S == pytest.approx(shown_s + 8.0 * len(run.watched), abs=1.5)
    assert [before.time_s - BEGAN_S for before, _ in run.watched] == pytest.approx(
        [shown_s] * len(run.watched), abs=1.5
    )


def test_a_weighing_after_all_has_been_shown_is_not_made_again() -> None:
    loop = Loop([Stream(1.0), Stream(0.0), Weigh(9.0)], [0.0, 100.0, 100.0])
    loop.came = swinging(1.0)
    assert loop.run().last.time_s - BEGAN_S == pytest.approx(0.2 + 9.0)
    assert len(loop.record.pulses) == 1


@pytest.mark.parametrize(("moved_mg", "stepped_mg"), [(-7.0, 7.0), (7.0, 7.0), (-3.5, 0.0), (3.5, 0.0)])
def test_what_changes_by_more_than_a_filter_may_still_swing_while_it_is_waited_for_is_a_step(
    moved_mg: float, stepped_mg: float
) -> None:
    """It may be off by 1.8 mg when the controller weighs for the last time."""
    loop = Loop([Pulse(1.0, 0.5, wait_s=4.0)], [100.0, 100.0])
    loop.pan.latest = Reading(EMPTY_MG, True, BEGAN_S)
    loop.came = swinging(1.0)
    loop.pan.creep_mg = iter([0.0, moved_mg])
    run = loop.run()
    assert len(loop.record.pulses) == 2
    assert run.stepped_mg == pytest.approx(stepped_mg)


def test_of_a_filter_that_has_long_shown_all_nothing_more_is_waited_for_than_its_delay() -> None:
    loop = Loop([Stream(1.0), Stream(0.0), Weigh(31.0)], [0.0, 100.0, 100.0])
    loop.believed = BalanceBelief(lag_s=1.0)
    ((before, _),) = loop.run().watched
    assert before.time_s - BEGAN_S == pytest.approx(0.2 + 31.0 + 2.0)


def test_a_single_reading_is_as_uncertain_as_its_rounding() -> None:
    loop = streaming(5.0)
    loop.run()
    (seen,) = loop.controller.seen
    assert (seen.net_mg, seen.stable) == (5.0, False)
    assert seen.uncertainty_mg == pytest.approx(0.1 / math.sqrt(12.0))


def test_a_pan_that_loses_what_a_lump_may_have_feigned_goes_on() -> None:
    streaming(0.0, 100.0, 50.0, 50.0, 50.0, 50.0).run()


def test_a_pan_that_loses_more_three_times_running_has_lost_its_container() -> None:
    loop = streaming(0.0, 100.0, 49.0, 49.0, 49.0, 49.0)
    with pytest.raises(SkillFailed, match=r"container\.moved: the pan shows 51 mg less than earlier in this dose"):
        loop.run()
    assert len(loop.pan.timeouts_s) == 5, "at the third reading"
    assert loop.valve.told[-1] == "stop"


def test_a_filter_that_rings_after_much_has_come_has_not_lost_its_container() -> None:
    streaming(0.0, 500.0, 1100.0, 1000.0, 940.0, 930.0, 940.0, 1000.0).run()


def test_what_a_ringing_filter_would_not_show_is_a_loss_however_much_has_come() -> None:
    with pytest.raises(SkillFailed, match=r"container\.moved"):
        streaming(0.0, 500.0, 1100.0, 540.0, 540.0, 540.0).run()


@pytest.mark.parametrize(
    ("missing", "lowest_mg", "is_lost"),
    [
        ((0.0, -0.62, 0.0, 0.4, 0.0), 430.0, False),
        ((0.0, -0.62, 0.0, 0.4, 0.0), 370.0, True),
        ((0.0, -0.02, 0.0, 0.4, 0.0), -40.0, True),  # touched: no filter swings so far
    ],
)
def test_a_filter_that_has_swung_back_farther_about_the_container_may_do_so_in_the_dose(
    missing: tuple[float, ...], lowest_mg: float, is_lost: bool
) -> None:
    loop = streaming(0.0, 500.0, 1100.0, lowest_mg, lowest_mg, lowest_mg, 700.0)
    loop.came = Step(EMPTY_MG, (1.0, 2.0, 3.0, 4.0, 5.0), missing)
    if is_lost:
        with pytest.raises(SkillFailed, match=r"container\.moved"):
            loop.run()
    else:
        loop.run()


def test_at_rest_nothing_rings_however_much_has_just_come() -> None:
    loop = Loop([Stream(1.0)] * 3 + [Weigh(), Weigh()], [0.0, 500.0, 1000.0, 1000.0, 940.0])
    with pytest.raises(SkillFailed, match=r"container\.moved"):
        loop.run()


def test_what_came_long_ago_rings_no_more() -> None:
    with pytest.raises(SkillFailed, match=r"container\.moved"):
        streaming(0.0, *[1000.0] * 110, 940.0, 940.0, 940.0).run()


def test_two_low_readings_are_a_knock() -> None:
    streaming(100.0, 0.0, 0.0, 100.0, 0.0, 0.0, 100.0).run()


def test_one_stable_mean_too_low_is_enough() -> None:
    with pytest.raises(SkillFailed, match=r"container\.moved"):
        Loop([Weigh(), Weigh(), Weigh()], [100.0, 49.0, 100.0]).run()
    Loop([Weigh(), Weigh()], [100.0, 50.0]).run()


def test_openings_are_counted_and_the_valve_is_shut_at_the_end() -> None:
    loop = Loop([Stream(1.0), Stream(0.5), Weigh(), Stream(0.4), Pulse(0.3, 0.1)], [float(mg) for mg in range(9)])
    assert loop.run().pulses == 3
    assert loop.valve.told[-1] == "stop"


def test_a_dose_without_end_is_ended_after_half_an_hour() -> None:
    def for_ever() -> Iterator[Command]:
        while True:
            yield Stream(0.0)

    loop = Loop(for_ever(), itertools.repeat(7.0))
    run = loop.run()
    assert (run.finish.reason, run.finish.estimate_mg) == ("step_limit", 7.0)
    assert 1800.0 < run.duration_s <= 1800.2
    assert loop.valve.told[-3:] == [0.0, "stop", "stop"], "shut before the balance is asked"
    assert run.finish.uncertainty_mg == pytest.approx(reference().uncertainty_mg(run.last))
    last = loop.record.pulses[-1]
    assert (last["kind"], last["net_mg"], last["gross_mg"]) == ("settle", 7.0, EMPTY_MG + 7.0)


def slow(commands: Iterable[Command], net_mg: Iterable[float], after_s: float = 1.0, period_s: float = 1.0) -> Loop:
    """On a balance that is to tell a reading so often, and tells each `after_s` after the one before."""
    loop = Loop(commands, net_mg)
    loop.pan.spec, loop.pan.after_s = BalanceSpec(period_s=period_s), after_s
    return loop


def test_an_opening_ends_when_it_is_over_though_no_reading_has_come() -> None:
    loop = slow([Stream(1.0, 0.5, hold_s=0.4), Stream(1.0, hold_s=1.1)], [10.0, 20.0])
    loop.run()
    assert loop.valve.told == [("vibrate", 0.5), 1.0, 0.0, ("vibrate", 0.0), 1.0, "stop"]
    assert loop.controller.seen[0].time_s == pytest.approx(BEGAN_S + 1.0)


@pytest.mark.parametrize(
    ("after_s", "told"), [(0.3, [1.0, 1.0, "stop"]), (2.0, [1.0, 0.0, 1.0, 0.0, "stop"])], ids=["early", "lost"]
)
def test_a_reading_that_comes_early_is_answered_and_none_that_is_lost_is_waited_for_with_the_valve_open(
    after_s: float, told: list[Any]
) -> None:
    loop = slow([Stream(1.0, hold_s=0.4), Stream(1.0, hold_s=1.1)], [10.0, 20.0], after_s)
    loop.run()
    assert [what for what in loop.valve.told if what != ("vibrate", 0.0)] == told


def test_the_course_of_a_dose_has_an_opening_that_was_over_before_its_reading() -> None:
    loop = slow([Stream(1.0, hold_s=0.4), Stream(0.0)], [10.0, 20.0])
    assert [point.opening_mm for point in loop.run().curve] == [1.0, 0.0]


def test_only_while_the_valve_was_open_nothing_came_of_the_cone() -> None:
    for hold_s, is_given_up in ((0.2, False), (0.3, True)):
        loop = slow([*[Stream(1.0, hold_s=hold_s)] * 250, Weigh(), Stream(0.0)], [0.0] * 252)
        assert (loop.run().finish.reason == "no_flow") == is_given_up


@pytest.mark.parametrize(("period_s", "expected_s"), [(0.05, 0.3), (0.1, 0.3), (0.2, 0.6), (1.0, 3.0)])
def test_an_open_valve_waits_three_periods_for_a_reading(period_s: float, expected_s: float) -> None:
    assert silence_s(period_s) == pytest.approx(expected_s)
    loop = streaming(1.0)
    loop.pan.spec = BalanceSpec(period_s=period_s)
    loop.run()
    assert loop.pan.timeouts_s == [pytest.approx(expected_s)]


@pytest.mark.parametrize("command", [Stream(1.0, hold_s=0.3), Stream(0.0)], ids=["shuts by itself", "shut"])
def test_a_valve_that_is_shut_waits_until_the_balance_is_lost(command: Stream) -> None:
    loop = Loop([command], [1.0])
    loop.run()
    assert loop.pan.timeouts_s == [None], "as long as the balance itself says"


def test_the_hand_does_what_the_controller_says_and_closes_before_the_balance_is_asked() -> None:
    loop = Loop([Stream(1.0, 0.5), Weigh(), Pulse(0.3, 0.1, 1.0)], [1.0, 2.0, 3.0])
    loop.run()
    assert loop.valve.told == [("vibrate", 0.5), 1.0, "stop", ("pulse", 0.3, 0.1, 1.0), "stop"]


def test_vibration_is_counted_while_the_motor_runs() -> None:
    streams = [Stream(1.0, 0.5), Stream(1.0), Stream(1.0)]
    loop = Loop([*streams, Pulse(0.3, 0.25, 0.1), Pulse(0.3, 7.0)], [1.0, 2.0, 3.0, 4.0, 5.0])
    run = loop.run()
    assert run.vibration_s == pytest.approx(0.1 + 0.25)
    assert run.duration_s == pytest.approx(3 * 0.1 + 0.25 + 7.0)
    assert run.pulses == 3


def test_a_pulse_and_a_settling_are_recorded_with_what_they_came_to() -> None:
    loop = Loop([Pulse(0.3, 0.25, 1.0), Weigh(0.5)], [3.0, 4.0])
    loop.run()
    pulse, settle = loop.record.pulses
    assert (pulse["kind"], settle["kind"]) == ("pulse", "settle")
    assert (pulse["opening_mm"], pulse["dwell_s"], pulse["vibration"]) == (0.3, 0.25, 1.0)
    assert (pulse["began_s"], pulse["ended_s"]) == (BEGAN_S, BEGAN_S + 0.25)
    assert (pulse["net_mg"], pulse["gross_mg"], pulse["readings"]) == (3.0, EMPTY_MG + 3.0, ())
    assert (settle["net_mg"], settle["ended_s"]) == (4.0, BEGAN_S + 0.75)
    assert "opening_mm" not in settle


def test_the_curve_has_every_reading_and_both_ends_of_a_pulse_in_plain_numbers() -> None:
    loop = Loop([Stream(1.0, 0.5678), Pulse(0.3, 0.2504, 1.0)], [1.23456, 3.0])
    loop.valve.opening_mm, loop.controller.estimate_mg = 0.98765, 5.43219
    loop.pan.latest = None
    assert tuple(point.row() for point in loop.run().curve) == (
        (BEGAN_S + 0.1, 1.235, 0.988, 0.57, False, 5.432),
        (BEGAN_S + 0.1, 1.235, 0.3, 1.0, False, 5.432),
        (BEGAN_S + 0.35, 1.235, 0.0, 0.0, False, 5.432),
        (BEGAN_S + 0.35, 3.0, 0.988, 0.0, True, 5.432),
    )


def test_a_pulse_before_any_reading_is_no_point_of_the_curve() -> None:
    assert len(Loop([Pulse(0.3, 0.25, 1.0)], [3.0]).run().curve) == 1


def test_a_wait_before_weighing_is_as_long_as_it_was_asked_for() -> None:
    for wait_s in (0.0, 0.7, 30.0):
        assert Loop([Weigh(wait_s)], [3.0]).run().duration_s == pytest.approx(wait_s)


def test_a_minute_of_pulses_without_a_gain_ends_the_dose_whatever_its_controller_hopes_for() -> None:
    run = Loop([Pulse(1.0, 1.0)] * 200, [0.0] * 40 + [1.1] * 160).run()
    assert (run.finish.reason, run.finish.estimate_mg) == ("no_flow", pytest.approx(1.1))
    assert run.pulses == 41 + 61, "the gain at the 41st begins a new minute"
    assert Loop([Pulse(1.0, 1.0)] * 200, [0.0] * 200).run().pulses == 61


@pytest.mark.parametrize(("came_mg", "reason"), [(240.0, "no_flow"), (260.0, "empty")])
def test_a_barren_minute_is_an_empty_cone_where_that_has_given_what_it_should_hold(came_mg: float, reason: str) -> None:
    loop = Loop([Pulse(1.0, 1.0)] * 100, [came_mg] * 100)
    loop.cone_mg = 1000.0
    assert loop.run(reference(earlier=Net(500.0, 0.1))).finish.reason == reason


def test_what_the_weighing_after_a_barren_minute_shows_counts_and_so_does_a_controllers_own_word() -> None:
    stream = [Stream(1.0)] * 650
    for mean_mg, commands in ((5.0, [*stream, Weigh(), Stream(0.0)]), (0.0, [*stream, Weigh()])):
        assert Loop(commands, [0.0] * 650 + [mean_mg] * 2).run().finish.reason == "reached"


@pytest.mark.parametrize(("seconds", "reason"), [(59, "reached"), (61, "no_flow")])
def test_a_stream_that_brings_nothing_is_told_by_the_weighing_after_a_minute(seconds: int, reason: str) -> None:
    commands = [*[Stream(1.0)] * (10 * seconds), Weigh(), *[Stream(0.0)] * 100, Weigh()]
    assert Loop(commands, [0.0] * len(commands)).run().finish.reason == reason


@pytest.mark.parametrize(("readings", "reason"), [(59, "reached"), (61, "no_flow")])
def test_where_readings_are_rare_a_minute_is_too_short_for_a_controller_to_have_tried(
    readings: int, reason: str
) -> None:
    loop = slow([*[Stream(1.0)] * readings, Weigh(), Stream(0.0)], [0.0] * (readings + 2), 2.0, 2.0)
    assert loop.run().finish.reason == reason


def test_a_shut_valve_is_no_reason_to_give_up() -> None:
    assert Loop([Stream(0.0), Weigh()] * 700, [0.0] * 1400).run().finish.reason == "reached"


@pytest.mark.parametrize(
    ("seconds", "word", "reason"),
    [(61, "step_limit", "no_flow"), (59, "step_limit", "step_limit"), (61, "overshoot", "overshoot")],
)
def test_a_minute_counts_from_when_powder_last_came_by_the_readings(seconds: int, word: Any, reason: str) -> None:
    coming = [float(mg) for mg in range(50)]
    still = [50.0 + 0.4 * (-1) ** number for number in range(10 * seconds)]
    commands = [*[Stream(1.0)] * (len(coming) + len(still)), Weigh(), Finish(word, 50.0, 0.1)]
    assert Loop(commands, [*coming, *still, 50.2]).run().finish.reason == reason


def test_what_a_draught_has_pushed_is_no_gain_that_stays() -> None:
    commands = [Stream(1.0)] * 20 + [Weigh()] + ([Stream(1.0)] * 200 + [Weigh()]) * 4
    net_mg = [*[9.0] * 20, 0.0]
    for gained_mg in (2.0, 4.0, 6.0, 8.0):
        net_mg += [gained_mg] * 201
    assert Loop(commands, net_mg).run().finish.reason == "reached"
