"""`adaptive` where the hand takes step commands only: pulses, each weighed.

A pulse is to bring the mean mass x [mg] of which z standard deviations of its surges, of mean mass m, stay within what
remains (`within`), less for what the flow's coefficient may be off by, and for how pulses alike differ: both are
standard deviations of logarithms, and the second is seen from pulse to pulse. If the sheet sticks in it, it is not to
be too much either.
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
"""By how much pulses alike differ, until they have shown it: that counts as so many of them."""
FIRST_MG, FIRST_UNSURE = 40.0, 0.5
"""The first pulse of a dose is to bring no more; what the coefficient may be off by in it, at least."""
GROWS = 6.0
"""Times the most that a pulse has brought that the next one is to bring, at most: to wider openings the law is
extrapolated."""
SHAKEN_UNSURE = 1.0
"""What a coefficient may be off by when the powder is shaken, or harder than before."""
LEAST_TOLD_MG = 0.1
"""What a pulse has brought counts as so much at least."""
LEAST_UNSURE = 0.15
LEAST_PULSE_MG, PULSE_S = 0.3, 0.2
"""No pulse is to bring less; and it is so wide that it brings what it should in such a time."""
LEAST_GAP_MM = 0.1
"""Above the threshold: the least opening of a pulse."""
SHORTEST_S, LONGEST_S = 0.05, 3.0
"""Of the time that a pulse stays open."""
SETTLES = 5.0
"""Times the balance's lag, after which it has shown what a pulse brought."""
BARREN_SHARE = 0.2
"""A pulse that brings less than this share of what was expected brings nothing."""
DOUBTED_PULSES, LOWERED, GIVEN_UP_PULSES = 8, 0.8, 20
"""After so many barren pulses in a row the coefficient is lowered by a factor; after more the dose ends."""


def within(room_mg: float, surge_mg: float) -> float:
    """The mean mass x [mg] of which `DEVIATIONS` of its surges stay within the room: x + z sqrt(2 m x) = room."""
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
    """How large the next pulse is to be, and how hard it is shaken."""

    def __init__(self, known: Knowledge) -> None:
        self.barren = 0
        """Pulses in a row that brought nothing."""
        self._known = known
        self._coefficient, self._unsure = known.reference, max(known.spread, FIRST_UNSURE)
        self._brought_mg = FIRST_MG / GROWS
        """The most that a pulse has brought."""
        self._off: float | None = None
        """By what the last pulse that brought something was off, as a logarithm."""
        self._told = SCATTER_PULSES, SCATTER_PULSES * SCATTER**2
        """So many pulses have told how much they differ; the sum of the squares."""
        self._vibration = 0.0

    def pulse(self, remaining_mg: float, room_mg: float) -> Pulse:
        """The next one, with so much to the aim, and so much to what is too much."""
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
        if self._off is not None:  # one after another: what they are off by alike is the coefficient's
            count, squares = self._told
            self._told = count + 1.0, squares + max(0.0, (off - self._off) ** 2 / 2.0 - lumps)
        self._off = off
        self._coefficient *= math.exp(trust * off)
        self._unsure = max(LEAST_UNSURE, self._unsure * math.sqrt(1.0 - trust))
        self._known.learn_coefficient(self._coefficient)

    @property
    def _scatter(self) -> float:
        """By how much pulses alike differ."""
        count, squares = self._told
        return math.sqrt(squares / count)

    def _sized(self, aim_mg: float) -> tuple[float, float]:
        """Opening [mm], and how long it stays so wide [s], of a pulse that is to bring so much."""
        shape, phi_s = self._known.shape, aim_mg / self._coefficient
        opening_mm = max(shape.opening_mm(phi_s / PULSE_S), shape.threshold_mm + LEAST_GAP_MM)
        opening_mm = min(opening_mm, self._known.request.max_opening_mm)
        dwell_s = (phi_s - self._passes(opening_mm, 0.0)) / shape.value(opening_mm)
        return opening_mm, max(SHORTEST_S, min(LONGEST_S, dwell_s))

    def _stuck_mg(self, opening_mm: float, dwell_s: float) -> float:
        """What such a pulse brings where the sheet sticks, and much flows."""
        return math.exp(self._scatter) * self._coefficient * self._passes(opening_mm + STUCK_MM, dwell_s)

    def _passes(self, opening_mm: float, dwell_s: float) -> float:
        """Integral of phi [mm^n s], over the valve's way there and back, too."""
        shape = self._known.shape
        ramps = 2.0 * shape.closing(opening_mm, 0.0, self._known.request.valve_speed_mm_per_s)
        return ramps + shape.value(opening_mm) * dwell_s
