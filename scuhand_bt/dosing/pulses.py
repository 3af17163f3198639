"""`adaptive` for a hand that takes step commands only: pulses, each weighed (docs/dosing.md, Step commands).

A pulse aims at the mean mass x [mg] of which z standard deviations of its lumps, of mean mass m, stay within what is
missing (`within`). It is less for the error of the coefficient and for how equal pulses differ; both are standard
deviations of logarithms, and the second is measured from pulse to pulse. It is never too much if the sheet sticks.
"""

import math
from collections.abc import Generator

from scuhand_bt.dosing.controller import Command, Finish, Observation, Pulse, Weigh
from scuhand_bt.dosing.knowledge import Knowledge
from scuhand_bt.dosing.shaking import shaken
from scuhand_bt.dosing.unseen import NARROWER, STUCK_MM

DEVIATIONS = 2.5
"""z."""
SCATTER, SCATTER_PULSES = 0.5, 2.0
"""How equal pulses differ at first; this guess counts as SCATTER_PULSES of them."""
FIRST_MG, FIRST_UNSURE = 40.0, 0.5
"""The most that the first pulse of a dose aims at, and the least error of the coefficient in it."""
GROWS = 6.0
"""A pulse aims at no more than this many times the largest so far: to wider openings the law is extrapolated."""
SHAKEN_UNSURE = 1.0
"""Error of the coefficient when the powder is first shaken, or shaken harder."""
LEAST_TOLD_MG = 0.1
"""The least that a pulse counts as having brought."""
LEAST_UNSURE = 0.15
LEAST_PULSE_MG, PULSE_S = 0.3, 0.2
"""The least that a pulse aims at, and the time in which its opening should bring it."""
LEAST_GAP_MM = 0.1
"""The least opening of a pulse, above the threshold."""
SHORTEST_S, LONGEST_S = 0.05, 3.0
"""Limits of the time that a pulse stays open."""
SETTLES = 5.0
"""Time until the balance has shown what a pulse brought, in its lags."""
BARREN_SHARE = 0.2
"""A pulse that brings less than this share of what was expected was in vain."""
DOUBTED_PULSES, LOWERED, GIVEN_UP_PULSES = 8, 0.8, 20
"""After so many pulses in vain in a row each lowers the coefficient by LOWERED; after the last number the dose ends."""


def within(room_mg: float, surge_mg: float) -> float:
    """The mean mass x [mg] of which `DEVIATIONS` of its lumps stay within the room: x + z sqrt(2 m x) = room."""
    half = DEVIATIONS * math.sqrt(2.0 * surge_mg) / 2.0
    return (math.sqrt(half * half + max(room_mg, 0.0)) - half) ** 2


def pulses(known: Knowledge) -> Generator[Command, Observation, Finish]:
    """A whole dose."""
    sizing = _Sizing(known)
    seen = yield Weigh()
    start_mg = seen.net_mg
    for _ in range(known.request.step_limit):
        verdict = known.verdict(seen)
        if verdict is not None:
            return known.finish(verdict, seen)
        if sizing.barren > GIVEN_UP_PULSES:
            return known.finish(known.request.given_up(seen.net_mg - start_mg), seen)
        before_mg = seen.net_mg
        pulse = sizing.pulse(known.aim_mg - before_mg, known.most_mg - before_mg)
        seen = yield pulse
        known.begin(seen.net_mg, seen.uncertainty_mg)
        sizing.learn(pulse, seen.net_mg - before_mg)
    return known.finish("step_limit", seen)


class _Sizing:
    """The size of the next pulse, and its vibration."""

    def __init__(self, known: Knowledge) -> None:
        self.barren = 0
        """Pulses in vain in a row."""
        self._known = known
        self._coefficient, self._unsure = known.reference, max(known.spread, FIRST_UNSURE)
        self._brought_mg = FIRST_MG / GROWS
        """The largest pulse so far."""
        self._off: float | None = None
        """Error of the last pulse that brought something, as a logarithm."""
        self._told = SCATTER_PULSES, SCATTER_PULSES * SCATTER**2
        """The number of pulses that have told how they differ, and the sum of squares."""
        self._vibration = 0.0

    def pulse(self, remaining_mg: float, room_mg: float) -> Pulse:
        """The next pulse, with `remaining_mg` to the aim and `room_mg` to the limit."""
        known = self._known
        level = shaken(self.barren, room_mg, has_come=self._off is not None)
        vibration = max(known.belief.vibration, level)
        if vibration > self._vibration:
            self._unsure = max(self._unsure, SHAKEN_UNSURE)
        self._vibration = vibration
        allowance = DEVIATIONS * math.hypot(self._unsure, self._scatter)
        aim_mg = within(remaining_mg, known.bank.surge_mg) * math.exp(-allowance)
        aim_mg = max(LEAST_PULSE_MG, min(aim_mg, GROWS * self._brought_mg))
        opening_mm, dwell_s = self._sized(aim_mg)
        while aim_mg > LEAST_PULSE_MG and self._stuck_mg(opening_mm, dwell_s) > room_mg:
            aim_mg = max(LEAST_PULSE_MG, NARROWER * aim_mg)
            opening_mm, dwell_s = self._sized(aim_mg)
        return Pulse(opening_mm, dwell_s, vibration, SETTLES * known.balance.lag_s)

    def learn(self, pulse: Pulse, gained_mg: float) -> None:
        expected_mg = self._coefficient * self._passes(pulse.opening_mm, pulse.dwell_s)
        if gained_mg < BARREN_SHARE * expected_mg:
            self.barren += 1
            self._coefficient *= LOWERED if self.barren > DOUBTED_PULSES else 1.0
            return
        self.barren, self._brought_mg = 0, max(self._brought_mg, gained_mg)
        lumps = 2.0 * self._known.bank.surge_mg / expected_mg
        off = math.log(max(gained_mg, LEAST_TOLD_MG) / expected_mg)
        trust = self._unsure**2 / (self._unsure**2 + self._scatter**2 + lumps)
        if self._off is not None:  # the difference of two, as what both are off by is the coefficient's error
            count, squares = self._told
            self._told = count + 1.0, squares + max(0.0, (off - self._off) ** 2 / 2.0 - lumps)
        self._off = off
        self._coefficient *= math.exp(trust * off)
        self._unsure = max(LEAST_UNSURE, self._unsure * math.sqrt(1.0 - trust))
        self._known.learn_coefficient(self._coefficient)

    @property
    def _scatter(self) -> float:
        """How equal pulses differ, as a logarithm."""
        count, squares = self._told
        return math.sqrt(squares / count)

    def _sized(self, aim_mg: float) -> tuple[float, float]:
        """Opening [mm] and time [s] of a pulse that should bring `aim_mg`."""
        shape, phi_s = self._known.shape, aim_mg / self._coefficient
        opening_mm = max(shape.opening_mm(phi_s / PULSE_S), shape.threshold_mm + LEAST_GAP_MM)
        opening_mm = min(opening_mm, self._known.request.max_opening_mm)
        dwell_s = (phi_s - self._passes(opening_mm, 0.0)) / shape.value(opening_mm)
        return opening_mm, max(SHORTEST_S, min(LONGEST_S, dwell_s))

    def _stuck_mg(self, opening_mm: float, dwell_s: float) -> float:
        """What such a pulse brings if the sheet sticks and much flows."""
        return math.exp(self._scatter) * self._coefficient * self._passes(opening_mm + STUCK_MM, dwell_s)

    def _passes(self, opening_mm: float, dwell_s: float) -> float:
        """The integral of phi [mm^n s], including the valve's way there and back."""
        shape = self._known.shape
        ramps = 2.0 * shape.closing(opening_mm, 0.0, self._known.request.valve_speed_mm_per_s)
        return ramps + shape.value(opening_mm) * dwell_s
