"""What `adaptive` knows within a dose, how wide it dares to open, and what it keeps from the dose.

    x + z sqrt(2 m x) = e,   q = x / (H (1 + s))            flow while e [mg] remains

x [mg] is what may fall unseen when z standard deviations of its surges are allowed for, m [mg] the powder's
surge scale, H [s] how long powder falls unseen (dead time, period, and as much of the balance's lag as the
flow is not known well enough to see through), s the relative uncertainty of the flow.
"""

import math
from collections.abc import Generator

from scuhand_bt.dosing.controller import Command, DoseRequest, Finish, Observation, Reason, Stream
from scuhand_bt.dosing.estimation import FlowFilter, Row, fit_lag
from scuhand_bt.dosing.valve import FlowShape, ValvePath
from scuhand_bt.specs import BalanceBelief, PowderBelief

VALVE_ERROR_MM = 0.04
"""What the real opening may be off by; it makes the flow at small openings uncertain."""
GUARD = 2.0
DEVIATIONS = 2.5
"""How many standard deviations of the surges that may fall unseen are allowed for."""
SLACK_S = 0.15
DOUBTED, UNKNOWN = 0.6, 1.0 / 3.0
"""The coefficient is never taken to be below this share of its reference: of a learnt one, of a guess."""
SEEN_LATE = 0.5
"""Share of the balance's lag that even a well-known flow is not seen through."""
GENTLE, FULL = 0.4, 1.0
LAG_MARGIN = 1.06
"""A lag believed too long costs a moment, one believed too short costs an overshoot."""
NOISES = 20
"""How many second differences the noise is the mean of."""
LAG_FITS = 8
"""After this many openings that told it, the balance's lag is known."""


def within(remaining_mg: float, surge_mg: float) -> float:
    """The mean mass x that may fall so that `DEVIATIONS` of its surges stay within what remains.

    Solves x + z sqrt(2 m x) = e, the variance of x in lumps of exponential mean mass m being 2 m x.
    """
    half = DEVIATIONS * math.sqrt(2.0 * surge_mg) / 2.0
    return (math.sqrt(half * half + max(remaining_mg, 0.0)) - half) ** 2


class Knowledge:
    """The filter, the valve's path, and the figures learnt beside them, during one dose."""

    def __init__(self, request: DoseRequest) -> None:
        self.request = request
        self.belief = request.powder
        self.shape = FlowShape(self.belief.threshold_mm, self.belief.exponent)
        self.valve = ValvePath(self.shape, request.valve_dead_time_s, request.valve_speed_mm_per_s)
        self.lag_s, self.fits = request.balance.lag_s, request.balance.fits
        self.noise_mg = max(request.balance.noise_mg, request.readability_mg / math.sqrt(12.0))
        self.shaking_noise_mg = max(self.noise_mg, 0.3)
        self.reference = self.belief.coefficient
        """The flow's coefficient when nothing is in its way."""
        self.filter = FlowFilter(0.0, self.reference, self.belief.spread, self.belief.surge_mg, self.lag_s)
        self.vibration = self.belief.vibration
        """The level it shakes at when nothing is amiss."""
        self.stalls = 0
        self.time_s = 0.0
        self.flow_s = self.shaken_s = 0.0
        self.record: list[Row] = []
        self._best = 0.0
        """The largest reference of this dose: what shaking may bring back."""
        self._known_s = 0.0 if self.belief.doses == 0 else 10.0
        self._recent_mg: list[float] = []
        self._noises = 0 if self.fits == 0 else NOISES
        self._ratios: list[float] = []

    def act(
        self, opening_mm: float, vibration: float, mobility: float = 1.0
    ) -> Generator[Command, Observation, tuple[float, float, float]]:
        """Hold a command until the next reading; (time, integral of phi, innovation in standard deviations)."""
        self.valve.command(self.time_s, opening_mm)
        seen = yield Stream(opening_mm, vibration)
        dt_s = seen.time_s - self.time_s
        phi_s = mobility * self.valve.advance(self.time_s, seen.time_s)
        self.time_s = seen.time_s
        self._learn_noise(seen.net_mg, phi_s, dt_s, vibration)
        noise_mg = self.shaking_noise_mg if vibration > 0.0 else self.noise_mg
        self.record.append(Row(dt_s, phi_s, seen.net_mg, noise_mg))
        return dt_s, phi_s, self.filter.update(dt_s, phi_s, seen.net_mg, noise_mg, self.reference)

    # --- how wide ---

    @property
    def stop_mg(self) -> float:
        """The predicted final mass to close at: under the target by the surge scale, inside the tolerance."""
        request = self.request
        guard_mg = GUARD * math.sqrt(2.0) * max(0.5 * self.noise_mg, request.readability_mg / math.sqrt(12.0))
        return request.target_mg - min(self.filter.surge_mg + 0.1, max(0.0, request.tolerance_mg - guard_mg - 0.1))

    @property
    def flows_only_shaken(self) -> bool:
        """Shaken not because it stalls now and then, but to flow at all: it pauses when shaking does."""
        return self.belief.vibration > GENTLE

    @property
    def unsure(self) -> float:
        """Relative uncertainty of a powder's flow that nothing was learnt of yet, or that is known."""
        return max(self.belief.spread, 0.5) if self.belief.doses == 0 else self.belief.spread

    def opening_mm(self, remaining_mg: float) -> float:
        """The opening for what remains."""
        request, estimate = self.request, self.filter
        surge_mg = estimate.surge_mg
        reserve_mg = surge_mg if self.flows_only_shaken else 0.0
        unseen_mg = within(remaining_mg - reserve_mg, surge_mg)
        doubted = DOUBTED if self._known_s > 3.0 else UNKNOWN
        coefficient = max(estimate.coefficient, doubted * self.reference)
        unsure = min(1.0, estimate.coefficient_sd / coefficient)
        lag_s = 2.0 * self.lag_s
        late_s = request.valve_dead_time_s + request.balance_period_s + SLACK_S
        flow = unseen_mg / (
            (late_s + lag_s * min(1.0, SEEN_LATE + 2.0 * unsure + surge_mg / request.tolerance_mg)) * (1.0 + unsure)
        )
        slowest = 0.3 * request.tolerance_mg / (0.15 * lag_s + 0.1)
        slowest = min(slowest, max(0.5 / surge_mg, 0.08 * surge_mg) / (late_s + lag_s))
        opening_mm = self.shape.opening_mm(max(flow, slowest) / coefficient)
        return min(max(opening_mm, self.shape.threshold_mm + 0.05), request.max_opening_mm)

    @property
    def likely_coefficient(self) -> float:
        """What a flow that is well known is taken to be at least."""
        return max(self.filter.coefficient, DOUBTED * self.reference)

    def note_change(self, from_mm: float, to_mm: float) -> None:
        """Another opening: the valve's error weighs differently in the flow."""
        from_gap_mm, to_gap_mm = (max(mm - self.shape.threshold_mm, 0.05) for mm in (from_mm, to_mm))
        change = self.shape.exponent * VALVE_ERROR_MM * abs(1.0 / from_gap_mm - 1.0 / to_gap_mm)
        if change > 0.0:
            self.filter.widen(min(change, 0.5), self.filter.coefficient)

    def follow_reference(self) -> None:
        """Slowly, but at once where the flow is surely stronger."""
        estimate = self.filter
        sure = estimate.coefficient - 1.5 * estimate.coefficient_sd > self.reference
        self.reference += (0.2 if sure else 0.04) * (estimate.coefficient - self.reference)
        self._best = max(self._best, self.reference)
        self._known_s += self.request.balance_period_s

    def expect_best(self) -> None:
        """Shaking may bring back the best flow of this dose at any moment."""
        self.reference = max(self.reference, self._best)
        self.filter.expect(self.reference)

    # --- what is learnt ---

    def _learn_noise(self, reading_mg: float, phi_s: float, dt_s: float, vibration: float) -> None:
        """From second differences, which a slowly changing mass leaves alone."""
        recent = self._recent_mg
        recent.append(reading_mg)
        if len(recent) < 3:
            return
        second_mg = recent[-1] - 2.0 * recent[-2] + recent[-3]
        del recent[0]
        curving_mg = self.filter.coefficient * phi_s * dt_s / self.lag_s
        before_mg = self.shaking_noise_mg if vibration > 0.0 else self.noise_mg
        if curving_mg > before_mg or abs(second_mg) > 12.0 * before_mg:
            return
        self._noises = min(self._noises + 1, NOISES)
        weight = 1.0 / self._noises if vibration == 0.0 else 1.0 / NOISES
        floor_mg = self.request.readability_mg / math.sqrt(12.0)
        after_mg = max(floor_mg, math.sqrt((1.0 - weight) * before_mg**2 + weight * second_mg**2 / 6.0))
        if vibration > 0.0:
            self.shaking_noise_mg = after_mg
        else:
            self.noise_mg = after_mg

    def identify_lag(self) -> None:
        """The balance's lag, from this opening; the geometric mean of all that told one."""
        if self.fits >= LAG_FITS:
            return
        rows = [row._replace(noise_mg=max(row.noise_mg, self.noise_mg)) for row in self.record]
        lag_s = fit_lag(rows, self.reference, self.filter.surge_mg)
        if lag_s is None:
            return
        weight = 1.0 / (self.fits + 1)
        self.lag_s *= (LAG_MARGIN * lag_s / self.lag_s) ** weight
        self.fits += 1
        self.filter.lag_s = self.lag_s
        last_mg = sum(row.reading_mg for row in self.record[-3:]) / 3.0
        self.filter.restart(last_mg, 0.3, self.reference, self.belief.spread)

    def learn_flow(self, gained_mg: float) -> None:
        """The coefficient that this opening showed."""
        phi_s = sum(row.phi_s for row in self.record)
        if phi_s > 0.0 and gained_mg > 4.0:
            self._ratios.append(math.log(max(gained_mg / phi_s, 1e-3) / self.belief.coefficient))

    # --- what is kept ---

    def finish(self, reason: Reason, seen: Observation) -> Finish:
        """The dose's last word, with what was learnt."""
        balance = BalanceBelief(lag_s=self.lag_s, noise_mg=self.noise_mg, fits=self.fits)
        return Finish(reason, seen.net_mg, seen.uncertainty_mg, self._powder(), balance)

    def _powder(self) -> PowderBelief:
        belief = self.belief
        if not self._ratios:
            return belief
        ratio = sum(self._ratios) / len(self._ratios)
        weight = max(0.2, 1.0 / (belief.doses + 1.0))
        spread = math.sqrt((1.0 - weight) * belief.spread**2 + weight * min(ratio * ratio, 1.0))
        needs_shaking = self.shaken_s > 0.6 * self.flow_s > 0.0
        return PowderBelief(
            coefficient=belief.coefficient * math.exp(weight * ratio),
            threshold_mm=belief.threshold_mm,
            exponent=belief.exponent,
            spread=min(max(spread, 0.15), 1.0),
            surge_mg=belief.surge_mg + weight * (self.filter.surge_mg - belief.surge_mg),
            vibration=max(belief.vibration, GENTLE) if needs_shaking else belief.vibration,
            doses=belief.doses + 1,
        )

    def verdict(self, seen: Observation) -> Reason | None:
        """What a stable mean says: done, too much, or None while there is more to dose."""
        error_mg = seen.net_mg - self.request.target_mg
        if abs(error_mg) <= self.request.tolerance_mg - GUARD * seen.uncertainty_mg:
            return "reached"
        return "overshoot" if error_mg > 0.0 else None
