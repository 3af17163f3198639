"""Carry out a controller's commands on a hand and a balance: the loop that every dose runs.

The controller (`scuhand_bt.dosing.controller`) decides, this loop acts and measures. However it ends, the valve is shut
and the motor off. It ends if no reading comes: after `silence_s` if the valve would stay open until then, else once the
balance is surely lost.
"""

import math
import statistics
from collections import deque
from contextlib import closing
from dataclasses import dataclass, field
from itertools import pairwise

from scuhand_bt.clock import Clock, Steps, pause
from scuhand_bt.devices.interfaces import Balance, Hand, Reading, StableMean
from scuhand_bt.dosing.bracket import HARDLY, LONGEST_WATCH_S, Gross, Reference, apart_mg, moved_mg, settled_from
from scuhand_bt.dosing.characteristic import Curve, Step
from scuhand_bt.dosing.controller import (
    LONGEST_UNWEIGHED_S,
    Controller,
    DoseRequest,
    Finish,
    Observation,
    Pulse,
    Stream,
    Weigh,
    silence_s,
)
from scuhand_bt.dosing.identification import SETTLED, rings, shown_by_s, swing_of
from scuhand_bt.events.doses import CurveRow, Pulsed
from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.record import Record
from scuhand_bt.specs import BalanceBelief

LOST_MG = 50.0
"""Powder does not leave the pan: a loss of this much means that the container was moved. The impact of a lump that
lands is less."""
LOST_READINGS = 3
RINGS, RINGING_S = 0.5, 10.0
"""A ringing filter shows too much, then less: by up to this share of what came in this time (damping 0.2), or by as
much as it did about the container."""


@dataclass(frozen=True, slots=True)
class CurvePoint:
    """One moment of a dose, for its plot."""

    time_s: float
    net_mg: float
    opening_mm: float
    """As read; or, for an opening that has ended since the last point, as commanded."""
    vibration: float
    stable: bool
    estimate_mg: float
    """The controller's estimate of what has left the nozzle."""

    def row(self) -> CurveRow:
        """A point of a `DoseCurve`, rounded to its meaningful digits."""
        return (
            round(self.time_s, 3),
            round(self.net_mg, 3),
            round(self.opening_mm, 3),
            round(self.vibration, 2),
            self.stable,
            round(self.estimate_mg, 3),
        )


@dataclass
class DoseRun:
    """The result of a dose."""

    finish: Finish
    last: Gross
    """Its last weighing. The finish rests on it if the controller verified it, unless the balance still swung then."""
    watched: list[tuple[Gross, Gross]]
    """Pairs of weighings of the same, valve shut, made whenever nobody had looked for long: they show drifts."""
    pulses: int
    vibration_s: float
    duration_s: float
    curve: list[CurvePoint] = field(default_factory=list)
    stepped_mg: float = 0.0
    """By how much its weighing changed as the balance swung out; 0 where that may have been its swing."""


BARREN_S = 60.0
"""Open for so long without a gain, nothing comes, whatever the controller hopes for. A fresh load primes within 10 s,
and an arch stands for 40 s at most before it is shaken."""
BARREN_READINGS = 60
"""And for at least so many readings, as a try is over when a few of them have shown nothing."""
GAIN_MG, AVERAGED = 1.0, 10
"""A gain is this much more, by a stable mean or the mean of so many readings: 5 standard deviations while shaken."""
WATCHES = 3
"""Most looks at a change that is hardly chance: to know it better, or until a filter has crept after the powder."""
LONGEST_S = 1800.0
"""Longest dose, whatever its controller does; the paper's slowest took 15 min."""


@dataclass
class _Flow:
    """How long the valve has been open since powder was last seen to come."""

    gained_mg: float
    barren_s: float = 0.0
    _recent_mg: deque[float] = field(default_factory=lambda: deque(maxlen=AVERAGED))

    def note(self, seen: Observation) -> None:
        self._recent_mg.append(seen.net_mg)
        level_mg = seen.net_mg if seen.stable else statistics.fmean(self._recent_mg)
        if (seen.stable or len(self._recent_mg) == AVERAGED) and level_mg > self.gained_mg + GAIN_MG:
            self.gained_mg, self.barren_s = level_mg, 0.0
        if seen.stable:
            self.gained_mg = min(self.gained_mg, level_mg)  # a push by a draught is no lasting gain


@dataclass
class _Kept:
    """What the pan has shown, and must go on showing."""

    rings: float
    """How far it may swing back, as a share of what came lately."""
    most_mg: float = -math.inf
    _least_mg: float = -math.inf
    _below: int = 0
    _lowest: deque[Observation] = field(default_factory=deque)  # lately, each the lowest since the one before it

    def require_nothing_lost(self, seen: Observation) -> None:
        """Raise SkillFailed container.moved if several readings in a row, or a stable mean, are too low."""
        self._below = self._below + 1 if seen.net_mg < self._least_mg else 0
        if self._below >= (1 if seen.stable else LOST_READINGS):
            lost = f"the pan shows {self.most_mg - seen.net_mg:.0f} mg less than earlier in this dose"
            raise SkillFailed(Code.CONTAINER_MOVED, lost)
        lowest = self._lowest
        while lowest and lowest[-1].net_mg >= seen.net_mg:
            lowest.pop()
        lowest.append(seen)
        while lowest[0].time_s < seen.time_s - RINGING_S:
            lowest.popleft()
        came_mg = 0.0 if seen.stable else seen.net_mg - lowest[0].net_mg
        self.most_mg = max(self.most_mg, seen.net_mg)
        self._least_mg = max(self._least_mg, seen.net_mg - max(LOST_MG, self.rings * came_mg))


def run_dose(
    controller: Controller,
    request: DoseRequest,
    hand: Hand,
    balance: Balance,
    clock: Clock,
    record: Record,
    reference: Reference,
    *,
    unwatched_s: float = LONGEST_UNWEIGHED_S,
    came: Step | None = None,
) -> Steps[DoseRun]:
    """Run a controller to its `Finish`; net masses are against `reference`, weighed with the hand in place.

    The pan is watched for drift after `unwatched_s` without a watch; never if that is infinite. `came` is how the
    balance has shown the container. Raises SkillFailed device.lost, balance.unstable, balance.overload (from the
    balance), container.moved.
    """
    begin_s = clock.now_s
    period_s = balance.spec.period_s
    curve: list[CurvePoint] = []
    pulses, vibration_s = 0, 0.0
    streaming = False
    last = reference.before
    watched: list[tuple[Gross, Gross]] = []
    stepped_mg = 0.0
    kept = _Kept(max(RINGS, swing_of(came).share))
    flow, barren_s = _Flow(reference.earlier.mass_mg), max(BARREN_S, BARREN_READINGS * period_s)

    def keep(point: CurvePoint) -> None:
        curve.append(point)
        if record.course is not None:
            record.course(point.row())

    def note(opening_mm: float, vibration: float) -> None:
        """Keep a moment of a pulse; what the hand does then is known from the command."""
        if balance.latest is not None:
            net_mg = balance.latest.value_mg - reference.zero_mg
            keep(CurvePoint(clock.now_s, net_mg, opening_mm, vibration, False, controller.estimate_mg))

    def weighed(mean: StableMean) -> Observation:
        nonlocal last
        last = Gross(mean.value_mg, mean.uncertainty_mg, mean.time_s)
        net_mg, u_mg = mean.value_mg - reference.zero_mg, reference.uncertainty_mg(last)
        return Observation(mean.time_s, net_mg, u_mg, True, hand.opening_mm)

    try:
        command = controller.decide(None)
        while not isinstance(command, Finish):
            acted_s = clock.now_s
            if acted_s - begin_s > LONGEST_S:
                hand.stop()
                mean = yield from balance.stable_mean(balance.spec.settles_s)
                ended = weighed(mean)
                record.event(_pulsed(Weigh(0.0), ended, acted_s, mean))
                command = Finish("step_limit", ended.net_mg, ended.uncertainty_mg)
                break
            held_mm = 0.0
            if isinstance(command, Stream):
                pulses += not streaming
                streaming = True
                hand.set_vibration(command.vibration)
                hand.set_opening(command.opening_mm)
                stays_open = command.opening_mm > 0.0 and command.hold_s == math.inf
                waiting = balance.next_reading(silence_s(period_s) if stays_open else None)
                if command.hold_s < math.inf:
                    reading, is_over = yield from _held(waiting, command.hold_s, hand, clock)
                    held_mm = command.opening_mm if is_over else 0.0
                else:
                    reading = yield from waiting
                seen = Observation(
                    reading.time_s,
                    reading.value_mg - reference.zero_mg,
                    balance.spec.readability_mg / math.sqrt(12.0),
                    False,
                    hand.opening_mm,
                )
                vibration_s += (clock.now_s - acted_s) * (command.vibration > 0.0)
                flow.barren_s += min(clock.now_s - acted_s, command.hold_s) * (command.opening_mm > 0.0)
                level = command.vibration
            else:
                streaming = False
                if isinstance(command, Pulse):
                    pulses += 1
                    note(command.opening_mm, command.vibration)
                    yield from hand.pulse(command.opening_mm, command.dwell_s, command.vibration)
                    note(0.0, 0.0)
                    flow.barren_s += command.dwell_s
                    vibration_s += (clock.now_s - acted_s) * (command.vibration > 0.0)
                else:
                    hand.stop()
                yield from pause(clock, command.wait_s)
                unwatched_since_s = watched[-1][1].time_s if watched else reference.before.time_s
                is_watched = clock.now_s - unwatched_since_s > unwatched_s
                if is_watched:  # a stable mean may still creep, or swing back, which would look like a drift
                    note(0.0, 0.0)
                    since = [(point.time_s, point.net_mg) for point in curve if point.time_s > unwatched_since_s]
                    rests_s = _rests_s(request.balance, came, since, clock.now_s, balance.spec.readability_mg)
                    yield from pause(clock, rests_s - clock.now_s)
                mean = yield from balance.stable_mean(balance.spec.settles_s)
                seen = weighed(mean)
                level = 0.0
                record.event(_pulsed(command, seen, acted_s, mean))
                if is_watched:
                    looks, digit_mg = [last], balance.spec.readability_mg
                    for _ in range(WATCHES):
                        weighed_s = last.time_s
                        yield from pause(clock, LONGEST_WATCH_S)
                        mean = yield from balance.stable_mean(balance.spec.settles_s)
                        seen = weighed(mean)
                        record.event(_pulsed(Weigh(), seen, weighed_s, mean))
                        looks.append(last)
                        first = settled_from(looks, digit_mg)
                        if abs(last.gross_mg - first.gross_mg) <= HARDLY * apart_mg(first, last, digit_mg):
                            break
                    watched.append((first, last))
            kept.require_nothing_lost(seen)
            flow.note(seen)
            command = controller.decide(seen)
            is_going_on = not isinstance(command, Finish) or command.reason == "step_limit"
            if seen.stable and flow.barren_s > barren_s and is_going_on:
                why = request.given_up(seen.net_mg - reference.earlier.mass_mg)
                command = Finish(why, seen.net_mg, seen.uncertainty_mg)
            shown_mm = max(seen.opening_mm, held_mm)
            keep(CurvePoint(seen.time_s, seen.net_mg, shown_mm, level, seen.stable, controller.estimate_mg))
        if rings(request.balance, came):  # others only creep on: what is lost after their last weighing is the zero's
            came_of = [now for before, now in pairwise(curve) if max(before.opening_mm, now.opening_mm) > 0.0]
            readings = [(point.time_s, point.net_mg) for point in came_of]
            net_mg, digit_mg = last.gross_mg - reference.zero_mg, balance.spec.readability_mg
            rests_s = shown_by_s(request.balance, came, readings, net_mg, digit_mg)
            if last.time_s < rests_s:  # it was weighed as it swung
                hand.stop()
                swinging = last
                yield from pause(clock, rests_s - clock.now_s)
                mean = yield from balance.stable_mean(balance.spec.settles_s)
                seen = weighed(mean)
                record.event(_pulsed(Weigh(), seen, swinging.time_s, mean))
                swings_mg = _swings_mg(request.balance, came, readings, net_mg, digit_mg, swinging.time_s)
                moved = abs(moved_mg(swinging, last, digit_mg))
                stepped_mg = moved if moved > swings_mg else 0.0
    finally:
        hand.stop()
    return DoseRun(command, last, watched, pulses, vibration_s, clock.now_s - begin_s, curve, stepped_mg)


def _rests_s(balance: BalanceBelief, came: Step | None, shown: Curve, now_s: float, readability_mg: float) -> float:
    """The time at which a balance, valve shut, has shown all of the powder [s].

    What is in the dead time is still to be seen. A filter that adapts takes `SETTLED` delays of its slow speed.
    """
    delay_s = 2.0 * balance.lag_s
    if balance.adapts:
        return now_s + SETTLED * delay_s * math.exp(balance.doubt)
    now_mg = shown[-1][1] if shown else 0.0
    return max(now_s + delay_s, shown_by_s(balance, came, shown, now_mg, readability_mg))


def _swings_mg(
    balance: BalanceBelief, came: Step | None, shown: Curve, now_mg: float, readability_mg: float, at_s: float
) -> float:
    """By how much a balance may have been off at a time at most [mg].

    That is twice as much, or more, as if all had come at once: it may have come bit by bit.
    """
    most_mg = max((abs(shown_mg - now_mg) for _, shown_mg in shown), default=0.0)
    swings_mg = readability_mg
    while swings_mg < most_mg and shown_by_s(balance, came, shown, now_mg, swings_mg) > at_s:
        swings_mg *= 2.0
    return swings_mg


def _held(waiting: Steps[Reading], hold_s: float, hand: Hand, clock: Clock) -> Steps[tuple[Reading, bool]]:
    """The next reading, and whether the valve was shut before it came, after `hold_s`."""
    end_s, is_over = clock.now_s + hold_s, False
    with closing(waiting):
        while True:
            try:
                wake = next(waiting)
            except StopIteration as over:
                reading: Reading = over.value
                return reading, is_over
            yield wake if is_over else wake._replace(until_s=min(wake.until_s, end_s))
            if not is_over and clock.now_s >= end_s:
                is_over = True
                hand.set_opening(0.0)


def _pulsed(command: Pulse | Weigh, seen: Observation, acted_s: float, mean: StableMean) -> Pulsed:
    """The event of a command and its weighing, with the balance's own lines."""
    commanded: dict[str, float] = {}
    if isinstance(command, Pulse):
        commanded = {"opening_mm": command.opening_mm, "dwell_s": command.dwell_s, "vibration": command.vibration}
    weighed = mean.written()
    return Pulsed(
        kind="pulse" if commanded else "settle",
        **commanded,
        began_s=acted_s,
        ended_s=seen.time_s,
        net_mg=seen.net_mg,
        uncertainty_mg=seen.uncertainty_mg,
        gross_mg=weighed.gross_mg,
        readings=weighed.readings,
    )
