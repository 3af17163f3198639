"""`adaptive` where the hand takes step commands only: pulses, each weighed.

A pulse is to bring the mean mass x [mg] of which z standard deviations of its surges, of mean mass m, stay within what
remains (`within`), less for what the flow's coefficient may be off by, and for how pulses alike differ: both are
standard deviations of logarithms.
"""

import math
from collections.abc import Generator

from scuhand_bt.dosing.controller import Command, Finish, Observation, Pulse, Weigh
from scuhand_bt.dosing.knowledge import FULL, GENTLE, Knowledge

DEVIATIONS = 2.5
"""z."""
SCATTER = 0.3
"""By how much pulses alike differ."""
GROWS = 6.0
"""Times the most that a pulse has brought that the next one is to bring, at most: to wider openings the law is
extrapolated."""
SHAKEN_UNSURE = 1.0
"""What a coefficient may be off by once the powder is shaken for the first time, or harder."""
LEAST_TOLD_MG = 0.1
"""What a pulse has brought counts as so much at least."""
LEAST_UNSURE = 0.15
LEAST_PULSE_MG, PULSE_S = 0.3, 0.4
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
        pulse = sizing.pulse(known.aim_mg - before_mg)
        seen = yield pulse
        known.begin(seen.net_mg, seen.uncertainty_mg)
        sizing.learn(pulse, seen.net_mg - before_mg)
    return known.finish("step_limit", seen)


class _Sizing:
    """The pulses' coefficient, how unsure it is, and the vibration."""

    def __init__(self, known: Knowledge) -> None:
        self.coefficient, self.unsure = known.reference, max(known.spread, 0.5)
        self.brought_mg = 0.0
        """The most that a pulse has brought."""
        self.barren = 0
        """Pulses in a row that brought nothing."""
        self._known = known
        self._vibration = known.belief.vibration

    def pulse(self, remaining_mg: float) -> Pulse:
        known, request = self._known, self._known.request
        spread = math.hypot(self.unsure, SCATTER)
        aim_mg = within(remaining_mg, known.bank.surge_mg) * math.exp(-DEVIATIONS * spread)
        if self.brought_mg > 0.0:
            aim_mg = min(aim_mg, GROWS * self.brought_mg)
        aim_mg = max(aim_mg, LEAST_PULSE_MG)
        opening_mm = known.shape.opening_mm(aim_mg / self.coefficient / PULSE_S)
        opening_mm = min(max(opening_mm, known.shape.threshold_mm + LEAST_GAP_MM), request.max_opening_mm)
        steady = (aim_mg / self.coefficient - self._ramps(opening_mm)) / known.shape.value(opening_mm)
        return Pulse(
            opening_mm, max(SHORTEST_S, min(LONGEST_S, steady)), self._vibration, SETTLES * known.balance.lag_s
        )

    def learn(self, pulse: Pulse, gained_mg: float) -> None:
        phi_s = self._ramps(pulse.opening_mm) + self._known.shape.value(pulse.opening_mm) * pulse.dwell_s
        expected_mg = self.coefficient * phi_s
        if gained_mg < BARREN_SHARE * expected_mg:
            self.barren += 1
            if self._vibration < FULL:
                self.unsure = max(self.unsure, SHAKEN_UNSURE)
            self._vibration = min(FULL, self._vibration + GENTLE)
            self.coefficient *= LOWERED if self.barren > DOUBTED_PULSES else 1.0
            return
        self.barren, self.brought_mg = 0, max(self.brought_mg, gained_mg)
        trust = self.unsure**2 / (self.unsure**2 + SCATTER**2 + 2.0 * self._known.bank.surge_mg / expected_mg)
        self.coefficient *= float((max(gained_mg, LEAST_TOLD_MG) / expected_mg) ** trust)
        self.unsure = max(LEAST_UNSURE, self.unsure * float((1.0 - trust) ** 0.5))
        self._known.learn_coefficient(self.coefficient)

    def _ramps(self, opening_mm: float) -> float:
        """Integral of phi [mm^n s] over the valve's way there and back."""
        return 2.0 * self._known.shape.closing(opening_mm, 0.0, self._known.request.valve_speed_mm_per_s)
