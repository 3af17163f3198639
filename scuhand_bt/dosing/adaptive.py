"""Controller `adaptive`: one continuous opening steered by a filter, closed on the predicted final mass.

    x + z sqrt(2 m x) = e,   q = x / (H (1 + s))            flow while e [mg] remains
    close when  M + k Phi_close(D) + q T / 2  >=  stop,     stop = target - min(m + 0.1, tolerance - guard)

x [mg] is what may fall unseen when z standard deviations of its surges are allowed for, m [mg] the powder's
surge scale, H [s] how long powder falls unseen (dead time, period, and as much of the balance's lag as the
flow is not known well enough to see through), s the relative uncertainty of the flow. M and k come from
`FlowFilter`, Phi_close from the valve's tail, T is the balance's period. Closing early by the surge scale
makes the best of lumps, which can be waited for but not taken back.

A dose: a first reading; openings; after each the tail is watched and a stable mean verifies. Under: open
again. In tolerance, beyond two standard uncertainties of the mean: done. What keeps it safe:

* The balance's lag decides how much falls unseen. Until it was fitted from an opening of this balance, the
  pessimistic first guess holds and the first opening is a probe, at one opening, for a part of the dose.
* No flow means shake, not open wider: while nothing comes the opening holds and vibration rises. The flow's
  coefficient is never believed to be far below its reference when an opening is chosen, so that a bridge
  that breaks lets out little more than was allowed for.
* Readings that are three times in a row more than five standard deviations above what was predicted shut the valve
  until a stable mean says why. A balance that falls silent shuts it in the dose loop.
* A hand that takes step commands only gets pulses limited by the same risk rule.
"""

import math
from collections.abc import Generator

from scuhand_bt.dosing.controller import Command, DoseRequest, Finish, Observation, Pulse, Reason, Settle, Stream
from scuhand_bt.dosing.estimation import FlowFilter, Row, fit_lag
from scuhand_bt.dosing.valve import FlowShape, ValvePath
from scuhand_bt.specs import BalanceBelief, PowderBelief

Openings = Generator[Command, Observation, str]

VALVE_ERROR_MM = 0.04
"""What the real opening may be off by; it makes the flow at small openings uncertain."""
GUARD = 2.0
DEVIATIONS = 2.5
"""How many standard deviations of the surges that may fall unseen are allowed for."""
SLACK_S = 0.15
WATCH_LAGS = 2.0
"""How many lags of the balance the tail is watched for, before a stable mean is asked."""
PROBE_SHARE, PROBE_MG = 0.4, 60.0
QUIET_SHARE = 0.2
"""Less than this share of what the reference flow would have brought is no flow."""
DOUBTED, UNKNOWN = 0.6, 1.0 / 3.0
"""The coefficient is never taken to be below this share of its reference: of a learnt one, of a guess."""
DRY_MG = 3.0
SEEN_LATE = 0.25
"""Share of the balance's lag that even a well-known flow is not seen through."""
LUMPY_MG = 0.7
"""Lumps of this mean mass are worth looking at one by one, where shaking alone brings them."""
LUMPS_LEFT = 1.5
SHAKE_S, SHAKE_SHARE = 0.3, 0.12
"""One shake, and the mass it should bring, as a share of a lump."""
PAUSED = 0.1
"""Share of the flow that is allowed for while such a powder is not shaken."""
GENTLE, FULL = 0.4, 1.0
MOST_OPENINGS = 25
LAG_MARGIN = 1.06
"""A lag believed too long costs a moment, one believed too short costs an overshoot."""
LONGEST_BARREN_S = 120.0
"""Open and shaken for so long without a gain that can be told from noise: dry, whatever was expected."""
LAG_FITS = 8
"""After this many openings that told it, the balance's lag is known."""


def within(remaining_mg: float, surge_mg: float) -> float:
    """The mean mass x that may fall so that `DEVIATIONS` of its surges stay within what remains.

    Solves x + z sqrt(2 m x) = e, the variance of x in lumps of exponential mean mass m being 2 m x.
    """
    half = DEVIATIONS * math.sqrt(2.0 * surge_mg) / 2.0
    return (math.sqrt(half * half + max(remaining_mg, 0.0)) - half) ** 2


class Adaptive:
    """The default controller."""

    name = "adaptive"

    def __init__(self, request: DoseRequest) -> None:
        self._request = request
        self._belief = request.powder
        self._shape = FlowShape(self._belief.threshold_mm, self._belief.exponent)
        self._valve = ValvePath(self._shape, request.valve_dead_time_s, request.valve_speed_mm_per_s)
        self._lag_s, self._fits = request.balance.lag_s, request.balance.fits
        self._noise_mg = max(request.balance.noise_mg, request.readability_mg / math.sqrt(12.0))
        self._shaking_noise_mg = max(self._noise_mg, 0.3)
        self._reference = self._belief.coefficient
        self._filter = FlowFilter(0.0, self._reference, self._belief.spread, self._belief.surge_mg, self._lag_s)
        self._vibration = self._belief.vibration
        self._time_s = 0.0
        self._recent_mg: list[float] = []
        self._record: list[Row] = []
        self._ratios: list[float] = []
        self._best = 0.0
        """The largest reference of this dose: what shaking may bring back."""
        self._stalls = 0
        self._known_s = 0.0 if self._belief.doses == 0 else 10.0
        self._flow_s = self._shaken_s = 0.0
        self._steps = self._stream() if request.streaming else self._pulses()
        self._started = False

    @property
    def estimate_mg(self) -> float:
        return self._filter.mass_mg

    def decide(self, seen: Observation | None) -> Command:
        try:
            if seen is None or not self._started:
                self._started = True
                return next(self._steps)
            return self._steps.send(seen)
        except StopIteration as end:
            finish: Finish = end.value
            return finish

    # --- the dose ---

    def _stream(self) -> Generator[Command, Observation, Finish]:
        request = self._request
        seen = yield Stream(0.0)
        self._time_s, start_mg = seen.time_s, seen.net_mg
        self._filter.restart(seen.net_mg, 2.0 * self._noise_mg, self._reference, self._unsure)
        for opening in range(MOST_OPENINGS):
            before_mg = self._filter.mass_mg
            self._record.clear()
            probing = opening == 0 and self._fits == 0
            ended = yield from self._open(probing)
            yield from self._watch_tail(probing)
            if self._fits < LAG_FITS:
                self._identify()
            if probing and ended == "reached" and self._filter.mass_mg < self._stop_mg - 1.0:
                self._learn_flow(before_mg, self._filter.mass_mg)
                continue
            seen = yield Settle()
            self._time_s = seen.time_s
            self._learn_flow(before_mg, seen.net_mg)
            self._filter.restart(seen.net_mg, max(seen.uncertainty_mg, 0.05), self._reference, self._belief.spread)
            verdict = self._verdict(seen)
            if verdict is not None:
                return self._finish(verdict, seen)
            if ended == "dry":
                return self._finish(request.given_up(seen.net_mg - start_mg), seen)
        return self._finish("step_limit", seen)

    def _verdict(self, seen: Observation) -> Reason | None:
        """What a stable mean says: done, too much, or None while there is more to dose."""
        error_mg = seen.net_mg - self._request.target_mg
        if abs(error_mg) <= self._request.tolerance_mg - GUARD * seen.uncertainty_mg:
            return "reached"
        return "overshoot" if error_mg > 0.0 else None

    def _open(self, probing: bool) -> Openings:
        """One continuous opening. Returns "reached", "surprise", or "dry" if nothing came at last."""
        valve, estimate = self._valve, self._filter
        stop_mg = self._stop_mg
        if probing:
            stop_mg = min(
                stop_mg, estimate.mass_mg + max(6.0, min(PROBE_SHARE * (stop_mg - estimate.mass_mg), PROBE_MG))
            )
        if estimate.mass_mg >= stop_mg:
            return "reached"
        opening_mm = self._opening_mm(stop_mg - estimate.mass_mg)
        vibration = self._vibration
        quiet_s = flowing_s = barren_s = 0.0
        expected_mg, evident_mg, barren_mg = 0.0, estimate.mass_mg, estimate.mass_mg
        surprises = 0
        while True:
            dt_s, phi_s, score = yield from self._act(opening_mm, vibration)
            surprises = surprises + 1 if score > 5.0 else 0
            if surprises >= 3:
                return "surprise"
            phi = self._shape.value(valve.opening_mm)
            flow = estimate.coefficient * phi
            tail_mg = estimate.coefficient * self._shape.closing(
                valve.opening_mm, self._request.valve_dead_time_s, self._request.valve_speed_mm_per_s
            )
            # A lump that was only imagined costs another opening; one that is waited for costs a moment.
            doubt_mg = min(1.0, estimate.surge_mg) * estimate.mass_sd_mg
            if estimate.mass_mg - doubt_mg + tail_mg + flow * self._request.balance_period_s / 2.0 >= stop_mg:
                return "reached"
            self._flow_s += dt_s
            self._shaken_s += dt_s * (vibration > 0.0)
            barren_s += dt_s
            if estimate.mass_mg - barren_mg > max(0.5, 3.0 * estimate.mass_sd_mg):
                barren_s, barren_mg = 0.0, estimate.mass_mg
            if barren_s > LONGEST_BARREN_S:
                return "dry"
            expected_mg += self._reference * phi_s
            if estimate.mass_mg - evident_mg > QUIET_SHARE * expected_mg + 2.0 * self._noise_mg:
                evident_mg, expected_mg, quiet_s = estimate.mass_mg, 0.0, 0.0
                flowing_s += dt_s
                self._follow_reference()
            elif expected_mg > 3.0 * estimate.surge_mg + self._reference * phi * (0.6 + 2.0 * self._lag_s):
                quiet_s, flowing_s = quiet_s + dt_s, 0.0
            remaining_mg = stop_mg - estimate.mass_mg
            wanted_mm = opening_mm if probing else self._opening_mm(remaining_mg)
            if not probing and self._comes_in_lumps and remaining_mg < LUMPS_LEFT * estimate.surge_mg + 1.0:
                level = max(vibration, self._vibration)
                opening_mm = yield from self._shake_and_look(opening_mm, level)
                if estimate.mass_mg >= stop_mg:
                    return "reached"
                quiet_s = 0.0 if estimate.mass_mg - evident_mg > 0.5 else quiet_s + dt_s
                continue
            patience_s = 0.8 + 2.0 * self._lag_s
            if quiet_s > 0.0:
                level = max(self._vibration, FULL if quiet_s > patience_s else GENTLE)
                if level > vibration:
                    self._stalls += vibration == 0.0
                    self._reference = max(self._reference, self._best)
                    estimate.expect(self._reference)
                    wanted_mm, vibration = self._opening_mm(stop_mg - estimate.mass_mg), level
                wanted_mm = min(wanted_mm, opening_mm)
                if quiet_s > 2.0 * patience_s:  # shaken, and still next to nothing: what was believed is wrong
                    if opening_mm >= self._request.max_opening_mm and estimate.mass_mg - evident_mg < DRY_MG:
                        if quiet_s > 6.0 * patience_s:
                            return "dry"
                    else:
                        self._reference *= 0.97
                        wanted_mm = min(self._request.max_opening_mm, opening_mm * 1.02)
            elif vibration > self._vibration and flowing_s > 1.0 and self._stalls < 3:
                vibration = self._vibration
            if self._stalls >= 3:
                self._vibration = max(self._vibration, GENTLE)
            self._note_change(opening_mm, wanted_mm)
            opening_mm = wanted_mm

    def _shake_and_look(self, opening_mm: float, vibration: float) -> Generator[Command, Observation, float]:
        """Where only shaking lets powder out: a short shake, then a look without it. Returns the opening."""
        period_s = self._request.balance_period_s
        shakes = max(1, round(SHAKE_S / period_s))
        flow = SHAKE_SHARE * self._filter.surge_mg / (shakes * period_s)
        coefficient = max(self._filter.coefficient, DOUBTED * self._reference)
        wanted_mm = min(self._shape.opening_mm(flow / coefficient), self._request.max_opening_mm)
        self._note_change(opening_mm, wanted_mm)
        for _ in range(shakes):
            yield from self._act(wanted_mm, vibration)
        self._shaken_s += shakes * period_s
        self._flow_s += shakes * period_s
        for _ in range(max(2, round((2.0 * self._lag_s + SLACK_S) / period_s))):
            yield from self._act(wanted_mm, 0.0, PAUSED)
        return wanted_mm

    @property
    def _comes_in_lumps(self) -> bool:
        return self._vibration > 0.0 and self._filter.surge_mg > LUMPY_MG

    def _watch_tail(self, probing: bool) -> Generator[Command, Observation, None]:
        """Valve shut: readings until the balance has all but followed."""
        shut_s = self._request.valve_dead_time_s + self._valve.opening_mm / self._request.valve_speed_mm_per_s
        wait_s = shut_s + SLACK_S + (3.5 if probing else WATCH_LAGS) * self._lag_s
        while wait_s > 0.0:
            dt_s, _, _ = yield from self._act(0.0, 0.0)
            wait_s -= dt_s

    def _act(
        self, opening_mm: float, vibration: float, mobility: float = 1.0
    ) -> Generator[Command, Observation, tuple[float, float, float]]:
        """Hold a command until the next reading; (time, integral of phi, innovation in standard deviations)."""
        self._valve.command(self._time_s, opening_mm)
        seen = yield Stream(opening_mm, vibration)
        dt_s = seen.time_s - self._time_s
        phi_s = mobility * self._valve.advance(self._time_s, seen.time_s)
        self._time_s = seen.time_s
        self._learn_noise(seen.net_mg, phi_s, dt_s, vibration)
        noise_mg = self._shaking_noise_mg if vibration > 0.0 else self._noise_mg
        self._record.append(Row(dt_s, phi_s, seen.net_mg, noise_mg))
        return dt_s, phi_s, self._filter.update(dt_s, phi_s, seen.net_mg, noise_mg, self._reference)

    # --- how wide ---

    @property
    def _stop_mg(self) -> float:
        request = self._request
        guard_mg = GUARD * math.sqrt(2.0) * max(0.5 * self._noise_mg, request.readability_mg / math.sqrt(12.0))
        return request.target_mg - min(self._filter.surge_mg + 0.1, max(0.0, request.tolerance_mg - guard_mg - 0.1))

    @property
    def _unsure(self) -> float:
        """Relative uncertainty of a powder's flow that nothing was learnt of yet, or that is known."""
        return max(self._belief.spread, 0.5) if self._belief.doses == 0 else self._belief.spread

    def _opening_mm(self, remaining_mg: float) -> float:
        """The opening for what remains."""
        request, estimate = self._request, self._filter
        surge_mg = estimate.surge_mg
        unseen_mg = within(remaining_mg, surge_mg)
        doubted = DOUBTED if self._known_s > 3.0 else UNKNOWN
        coefficient = max(estimate.coefficient, doubted * self._reference)
        unsure = min(1.0, estimate.coefficient_sd / coefficient)
        lag_s = 2.0 * self._lag_s
        late_s = request.valve_dead_time_s + request.balance_period_s + SLACK_S
        flow = unseen_mg / (
            (late_s + lag_s * min(1.0, SEEN_LATE + 2.0 * unsure + surge_mg / request.tolerance_mg)) * (1.0 + unsure)
        )
        slowest = 0.3 * request.tolerance_mg / (0.15 * lag_s + 0.1)
        slowest = min(slowest, max(0.25 / surge_mg, 0.08 * surge_mg) / (late_s + lag_s))
        opening_mm = self._shape.opening_mm(max(flow, slowest) / coefficient)
        return min(max(opening_mm, self._shape.threshold_mm + 0.05), request.max_opening_mm)

    def _note_change(self, from_mm: float, to_mm: float) -> None:
        """Another opening: the valve's error weighs differently in the flow."""
        from_gap_mm, to_gap_mm = (max(mm - self._shape.threshold_mm, 0.05) for mm in (from_mm, to_mm))
        change = self._shape.exponent * VALVE_ERROR_MM * abs(1.0 / from_gap_mm - 1.0 / to_gap_mm)
        if change > 0.0:
            self._filter.widen(min(change, 0.5), self._filter.coefficient)

    def _follow_reference(self) -> None:
        """Slowly, but at once where the flow is surely stronger."""
        estimate = self._filter
        sure = estimate.coefficient - 1.5 * estimate.coefficient_sd > self._reference
        self._reference += (0.2 if sure else 0.04) * (estimate.coefficient - self._reference)
        self._best = max(self._best, self._reference)
        self._known_s += self._request.balance_period_s

    # --- what is learnt ---

    def _learn_noise(self, reading_mg: float, phi_s: float, dt_s: float, vibration: float) -> None:
        """From second differences, which a slowly changing mass leaves alone."""
        recent = self._recent_mg
        recent.append(reading_mg)
        if len(recent) < 3:
            return
        second_mg = recent[-1] - 2.0 * recent[-2] + recent[-3]
        del recent[0]
        curving_mg = self._filter.coefficient * phi_s * dt_s / self._lag_s
        before_mg = self._shaking_noise_mg if vibration > 0.0 else self._noise_mg
        if curving_mg > before_mg or abs(second_mg) > 12.0 * before_mg:
            return
        floor_mg = self._request.readability_mg / math.sqrt(12.0)
        after_mg = max(floor_mg, math.sqrt(0.95 * before_mg**2 + 0.05 * second_mg**2 / 6.0))
        if vibration > 0.0:
            self._shaking_noise_mg = after_mg
        else:
            self._noise_mg = after_mg

    def _identify(self) -> None:
        """The balance's lag, from this opening; the geometric mean of all that told one."""
        lag_s = fit_lag(self._record, self._reference, self._filter.surge_mg)
        if lag_s is None:
            return
        weight = 1.0 / (self._fits + 1)
        self._lag_s *= (LAG_MARGIN * lag_s / self._lag_s) ** weight
        self._fits += 1
        self._filter.lag_s = self._lag_s
        last_mg = sum(row.reading_mg for row in self._record[-3:]) / 3.0
        self._filter.restart(last_mg, 0.3, self._reference, self._belief.spread)

    def _learn_flow(self, before_mg: float, after_mg: float) -> None:
        """The coefficient that this opening showed."""
        phi_s = sum(row.phi_s for row in self._record)
        gained_mg = after_mg - before_mg
        if phi_s > 0.0 and gained_mg > 4.0:
            self._ratios.append(math.log(max(gained_mg / phi_s, 1e-3) / self._belief.coefficient))

    def _finish(self, reason: Reason, seen: Observation) -> Finish:
        belief = self._belief
        if self._ratios:
            ratio = sum(self._ratios) / len(self._ratios)
            weight = max(0.2, 1.0 / (belief.doses + 1.0))
            spread = math.sqrt((1.0 - weight) * belief.spread**2 + weight * min(ratio * ratio, 1.0))
            needs_shaking = self._shaken_s > 0.6 * self._flow_s > 0.0
            belief = PowderBelief(
                coefficient=belief.coefficient * math.exp(weight * ratio),
                threshold_mm=belief.threshold_mm,
                exponent=belief.exponent,
                spread=min(max(spread, 0.15), 1.0),
                surge_mg=belief.surge_mg + weight * (self._filter.surge_mg - belief.surge_mg),
                vibration=max(belief.vibration, GENTLE) if needs_shaking else belief.vibration,
                doses=belief.doses + 1,
            )
        balance = BalanceBelief(lag_s=self._lag_s, noise_mg=self._noise_mg, fits=self._fits)
        return Finish(reason, seen.net_mg, seen.uncertainty_mg, belief, balance)

    # --- a hand without streaming ---

    def _pulses(self) -> Generator[Command, Observation, Finish]:
        """Step commands, each no larger than the risk rule allows."""
        request, shape = self._request, self._shape
        speed = request.valve_speed_mm_per_s
        seen = yield Settle()
        start_mg = seen.net_mg
        coefficient, unsure, vibration, barren = self._reference, max(self._unsure, 0.5), self._vibration, 0
        for _ in range(request.step_limit):
            verdict = self._verdict(seen)
            if verdict is not None:
                return self._finish(verdict, seen)
            before_mg = seen.net_mg
            remaining_mg = self._stop_mg - before_mg
            surge_mg = self._filter.surge_mg
            aim_mg = within(remaining_mg, surge_mg)
            aim_mg = max(aim_mg / (1.0 + 2.0 * unsure), 0.3)
            opening_mm = shape.opening_mm(aim_mg / coefficient / 0.4)
            opening_mm = min(max(opening_mm, shape.threshold_mm + 0.1), request.max_opening_mm)
            ramps = 2.0 * shape.closing(opening_mm, 0.0, speed)
            dwell_s = max(0.05, min(3.0, (aim_mg / coefficient - ramps) / shape.value(opening_mm)))
            seen = yield Pulse(opening_mm, dwell_s, vibration, 5.0 * self._lag_s)
            self._filter.restart(seen.net_mg, seen.uncertainty_mg, coefficient, unsure)
            gained_mg = seen.net_mg - before_mg
            expected_mg = coefficient * (ramps + shape.value(opening_mm) * dwell_s)
            if gained_mg < QUIET_SHARE * expected_mg:
                barren += 1
                vibration = min(FULL, vibration + GENTLE)
                if barren > 8:
                    coefficient *= 0.8
                if barren > 20:
                    return self._finish(request.given_up(seen.net_mg - start_mg), seen)
            else:
                barren = 0
                trust = unsure**2 / (unsure**2 + 0.04 + 2.0 * surge_mg / expected_mg)
                coefficient *= (max(gained_mg, 0.1) / expected_mg) ** trust
                unsure = max(0.15, unsure * math.sqrt(1.0 - trust))
        return self._finish("step_limit", seen)
