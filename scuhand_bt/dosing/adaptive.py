"""Controller `adaptive`: one continuous opening steered by a filter, closed on the predicted final mass.

A dose: a first reading; openings (`opening`); after each the tail is watched and a stable mean verifies. Under:
open again. In tolerance, beyond two standard uncertainties of the mean: done. What keeps it safe:

* The balance's lag decides how much falls unseen. Until it was fitted from an opening of this balance, the
  pessimistic first guess holds and the first opening is a probe, at one opening, for a part of the dose.
* No flow means shake, or near the target shut and open again, not open wider: while nothing comes the opening holds and
  vibration rises. The flow's coefficient is never believed to be far below its reference when an opening is chosen
  (`dose_state`), so that a bridge that breaks lets out little more than was allowed for.
* Readings that are three times in a row more than five standard deviations above what was predicted shut the valve
  until a stable mean says why. A balance that falls silent shuts it in the dose loop.
* A hand that takes step commands only gets pulses limited by the same risk rule (`pulses`).
"""

import math
from collections.abc import Generator

from scuhand_bt.dosing.controller import Command, DoseRequest, Finish, Observation, Stream, Weigh
from scuhand_bt.dosing.dose_state import SLACK_S, Knowledge
from scuhand_bt.dosing.opening import Opening
from scuhand_bt.dosing.pulses import pulses

WATCH_LAGS = 2.0
"""How many lags of the balance the tail is watched for, before a stable mean is asked."""
RESTING, LONGEST_REST = 8, 200
"""A probe's tail is watched until so many readings rise no more, if they ever do."""
LISTENED = 12
"""Readings that tell an unknown balance's noise."""
MOST_OPENINGS = 25
LEFT_MG = 1.0
"""A probe that leaves at least so much is followed at once: the mean can wait."""


class Adaptive:
    """The default controller."""

    name = "adaptive"

    def __init__(self, request: DoseRequest) -> None:
        self._known = Knowledge(request)
        self._steps = self._stream() if request.streaming else pulses(self._known)
        self._started = False

    @property
    def estimate_mg(self) -> float:
        return self._known.filter.mass_mg

    def decide(self, seen: Observation | None) -> Command:
        try:
            if seen is None or not self._started:
                self._started = True
                return next(self._steps)
            return self._steps.send(seen)
        except StopIteration as end:
            finish: Finish = end.value
            return finish

    def _stream(self) -> Generator[Command, Observation, Finish]:
        known = self._known
        seen = yield Stream(0.0)
        known.time_s, start_mg = seen.time_s, seen.net_mg
        if not known.knows_balance:
            yield from self._listen()
        known.filter.restart(seen.net_mg, 2.0 * known.noise_mg, known.reference, known.unsure)
        for opening in range(MOST_OPENINGS):
            before_mg = known.filter.mass_mg
            known.begin_opening()
            probing = opening == 0 and not known.knows_balance
            ended = yield from Opening(known, probing).run()
            yield from self._watch_tail()
            if probing:
                yield from self._watch_rest()
            known.learn(known.filter.mass_mg - before_mg)
            if probing and ended == "reached" and known.filter.mass_mg < known.stop_mg - LEFT_MG:
                continue
            seen = yield Weigh()
            known.time_s = seen.time_s
            known.filter.restart(seen.net_mg, max(seen.uncertainty_mg, 0.05), known.reference, known.unsure)
            verdict = known.verdict(seen)
            if verdict is not None:
                return known.finish(verdict, seen)
            if ended == "dry":
                return known.finish(known.request.given_up(seen.net_mg - start_mg), seen)
        return known.finish("step_limit", seen)

    def _listen(self) -> Generator[Command, Observation, None]:
        """Valve shut: the noise of a balance that nothing is known of."""
        for _ in range(LISTENED):
            yield from self._known.act(0.0, 0.0)

    def _watch_rest(self) -> Generator[Command, Observation, None]:
        """Valve shut: readings until they rise no more than their noise."""
        known, half = self._known, RESTING // 2
        for _ in range(LONGEST_REST):
            recent = [row.reading_mg for row in known.record[-RESTING:]]
            rise_mg = (sum(recent[half:]) - sum(recent[:half])) / half
            if len(recent) == RESTING and rise_mg < 2.0 * known.noise_mg * math.sqrt(2.0 / half):
                return
            yield from known.act(0.0, 0.0)

    def _watch_tail(self) -> Generator[Command, Observation, None]:
        """Valve shut: readings until the balance has all but followed."""
        known, request = self._known, self._known.request
        shut_s = request.valve_dead_time_s + known.valve.opening_mm / request.valve_speed_mm_per_s
        wait_s = shut_s + SLACK_S + WATCH_LAGS * known.lag_s
        while wait_s > 0.0:
            dt_s, _, _ = yield from known.act(0.0, 0.0)
            wait_s -= dt_s
