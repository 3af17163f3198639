"""What `adaptive` knows within a dose, how wide it dares to open, and what it keeps from the dose.

How wide follows from `risk`: as fast as what remains allows, and never slower than the flow whose unseen part the
tolerance forgives. What may come at worst is the flow's coefficient by its readings plus `DEVIATIONS` of its standard
deviation, though not more than a new opening may show: a bridge that breaks lets out the usual flow, not any.
"""

import math
from collections.abc import Generator

from scuhand_bt.dosing.controller import Command, DoseRequest, Finish, Observation, Reason, Stream
from scuhand_bt.dosing.estimation import FlowFilter, Row, fit_lag, fit_step, fit_surge
from scuhand_bt.dosing.risk import DEVIATIONS, fastest
from scuhand_bt.dosing.valve import FlowShape, ValvePath
from scuhand_bt.dosing.verdict import COVERAGE, judge
from scuhand_bt.specs import BalanceBelief, PowderBelief, Verdict

VALVE_ERROR_MM = 0.04
"""What the real opening may be off by; it makes the flow at small openings uncertain."""
EXPONENT_ERROR = 1.0
"""What a powder's exponent may be off by: its coefficient changes with the opening."""
FORGIVEN = 0.85
"""Share of the room above the aim, inside the tolerance, that the unseen part of the slowest flow may be off by."""
LUMPS_UNSEEN = 0.08
"""A flow of less than so many lumps in the time that is not seen gains nothing."""
SLACK_S = 0.15
DOUBTED, UNKNOWN = 0.6, 1.0 / 3.0
"""The coefficient is never taken to be below this share of its reference: of a learnt one, of a guess."""
GENTLE, FULL = 0.4, 1.0
LAG_MARGIN = 1.03
"""A lag believed too long costs a moment, one believed too short costs an overshoot."""
LEAST_MG = 4.0
"""An opening that brought less teaches nothing."""
AIM_UNDER_MG = 0.9
"""Besides the surge scale: too little can be corrected, too much cannot, and the last of a dose flows slowest."""
MOST_SLIP_MM = 0.4
"""How far a sheet that stuck may slip."""
UNSURE = 1.0
"""How unsure a new opening is at least: sheets stick and slip."""
GUESSED_SPREAD = 0.3
"""What doses are taken to differ by, at least, until a second one was seen."""
GUESS_DOUBT, SURGE_DOUBT = 1.5, 0.4
"""Standard deviation of the logarithm of a surge scale that was guessed, and that was learnt."""
NOISES = 20
"""How many second differences the noise is the mean of."""
WORST_MISFIT = 0.08
"""A probe that is followed no better tells nothing; the less its model is off, the more the balance is trusted."""
LEAST_DOUBT = 0.72
"""A sheet that slipped lets out ever more than it should as the valve narrows: readings that have followed tell."""
LONGEST_PROBE_S, LONGEST_PROBE_LAGS = 2.0, 3.0
"""Over a longer time than both the flow changes, and its changes pass for the balance's."""
LAG_FITS = 5
"""After this many openings that told it, the lag that lumps were seen through is known."""
NEEDS_SHAKING = 0.3
"""A powder that was shaken for this share of the time it was open for is shaken from the start."""


class Knowledge:
    """The filter, the valve's path, and the figures learnt beside them, during one dose."""

    def __init__(self, request: DoseRequest) -> None:
        self.request = request
        self.belief = request.powder
        self.shape = FlowShape(self.belief.threshold_mm, self.belief.exponent)
        self.valve = ValvePath(self.shape, request.valve_dead_time_s, request.valve_speed_mm_per_s)
        balance = request.balance
        self.lag_s, self.poles, self.misfit, self.fits = balance.lag_s, balance.poles, balance.misfit, balance.fits
        self.noise_mg = max(balance.noise_mg, request.readability_mg / math.sqrt(12.0))
        self.shaking_noise_mg = max(self.noise_mg, 0.3)
        self.reference = self.belief.coefficient
        """The flow's coefficient when nothing is in its way."""
        self.filter = FlowFilter(0.0, self.reference, self.belief.spread, self.belief.surge_mg, self.lag_s)
        self.filter.set_balance(self.lag_s, self.poles, self._filter_misfit)
        self.filter.restart(0.0, self.noise_mg, self.reference, self.belief.spread)
        self.vibration = self.belief.vibration
        """The level it shakes at when nothing is wrong."""
        self.pauses = self.belief.pauses
        """Whether it stops when it is no longer shaken."""
        self._usual = self.reference
        self.stalls = 0
        self.reopened = 0
        """How often the valve was shut and opened again since powder last came."""
        self.time_s = 0.0
        self.flow_s = self.shaken_s = 0.0
        self.record: list[Row] = []
        self._best = 0.0
        """The largest reference of this dose: what shaking may bring back."""
        self._known_s = 0.0 if self.belief.doses == 0 else 10.0
        self._recent_mg: list[float] = []
        self._noises = 0 if self.fits == 0 else NOISES
        self._widened = 0.0
        self._surge_mg = self.belief.surge_mg
        self._log_flow = self._clear_flow = 0.0
        """The coefficient's logarithm, summed by how clear it was, and how clear in all."""
        self._ratios: list[float] = []
        """Openings' coefficients against the belief's, as logarithms."""

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
        self.record.append(Row(dt_s, phi_s, seen.net_mg, noise_mg, self._widened))
        self._widened = 0.0
        return dt_s, phi_s, self.filter.update(dt_s, phi_s, seen.net_mg, noise_mg, self.reference)

    # --- how wide ---

    @property
    def stop_mg(self) -> float:
        """The predicted final mass to close at: under the target by the surge scale, inside the tolerance."""
        request = self.request
        return request.target_mg - min(
            float(self.filter.surge_mg) + AIM_UNDER_MG, max(0.0, request.tolerance_mg - self._guard_mg - 0.1)
        )

    @property
    def _guard_mg(self) -> float:
        return COVERAGE * self.request.uncertainty_mg

    @property
    def enough_mg(self) -> float:
        """The mass that a stable mean would call in tolerance."""
        return self.request.target_mg - self.request.tolerance_mg + self._guard_mg

    @property
    def flows_only_shaken(self) -> bool:
        """Shaken not because it stalls now and then, but to flow at all: it pauses when shaking does."""
        return self.belief.vibration > GENTLE

    @property
    def knows_balance(self) -> bool:
        """A balance that was seen through lumps only is not known well enough for a powder that flows steadily."""
        return self.fits > 0 if self.flows_only_shaken else self.misfit < WORST_MISFIT

    @property
    def _filter_misfit(self) -> float:
        """In lumps what the balance's model leaves unexplained would hide them."""
        return 0.0 if self.flows_only_shaken else self.misfit

    @property
    def _doubt(self) -> float:
        """The share of the balance's lag that is not trusted to be seen through."""
        if self.flows_only_shaken:
            return 1.0
        lumps = float(self.filter.surge_mg) / self.request.tolerance_mg
        return min(1.0, max(LEAST_DOUBT, lumps, self.misfit / WORST_MISFIT))

    @property
    def unsure(self) -> float:
        """Relative uncertainty of a new opening's flow."""
        return max(self.belief.spread, UNSURE)

    def opening_mm(self, remaining_mg: float) -> float:
        """The opening for what remains."""
        request, estimate = self.request, self.filter
        surge_mg = estimate.surge_mg
        reserve_mg = surge_mg if self.flows_only_shaken else 0.0
        doubted = DOUBTED if self._known_s > 3.0 else UNKNOWN
        coefficient = max(estimate.coefficient, doubted * self.reference)
        worst = min(
            estimate.coefficient + DEVIATIONS * estimate.coefficient_sd,
            max(estimate.coefficient, self.reference) * (1.0 + DEVIATIONS * self.unsure),
        )
        unsure = (worst - estimate.coefficient) / (DEVIATIONS * coefficient)
        late_s = request.valve_dead_time_s + request.balance_period_s + SLACK_S
        unseen_s = late_s + 2.0 * self.lag_s
        flow = fastest(remaining_mg - reserve_mg, late_s + self._doubt * 2.0 * self.lag_s, unseen_s, unsure, surge_mg)
        room_mg = request.target_mg - self.stop_mg + request.tolerance_mg - self._guard_mg
        forgiven = fastest(FORGIVEN * room_mg, 0.0, unseen_s, unsure, surge_mg)
        opening_mm = self.shape.opening_mm(max(flow, forgiven, LUMPS_UNSEEN * surge_mg / unseen_s) / coefficient)
        return min(max(opening_mm, self.belief.threshold_mm + 0.05), request.max_opening_mm)

    @property
    def likely_coefficient(self) -> float:
        """What a flow that is well known is taken to be at least."""
        return max(self.filter.coefficient, DOUBTED * self.reference)

    def note_change(self, from_mm: float, to_mm: float) -> None:
        """Another opening: the valve's error weighs differently in the flow, and so does the exponent's."""
        from_gap_mm, to_gap_mm = (max(mm - self.shape.threshold_mm, 0.05) for mm in (from_mm, to_mm))
        change = self.shape.exponent * VALVE_ERROR_MM * abs(1.0 / from_gap_mm - 1.0 / to_gap_mm)
        change += EXPONENT_ERROR * abs(math.log(to_gap_mm / from_gap_mm))
        if change > 0.0:
            self._widened = min(change, 0.5)
            self.filter.widen(self._widened, self.filter.coefficient)

    def begin_opening(self) -> None:
        """What is learnt of it is learnt of this opening alone."""
        self.record.clear()
        self.trust_valve()

    def trust_valve(self) -> None:
        """The valve is where it is told to be, until its flow says otherwise."""
        self.shape = self.valve.shape = FlowShape(self.belief.threshold_mm, self.belief.exponent)
        self._usual = self.reference

    def _has_slipped(self) -> bool:
        """A flow far above what is known of the powder: the valve is wider than it was told, its sheet slipped."""
        estimate, opening_mm = self.filter, self.valve.opening_mm
        if self.belief.doses == 0 or self.flows_only_shaken or opening_mm <= self.shape.threshold_mm:
            return False
        if estimate.coefficient - 2.0 * estimate.coefficient_sd < (1.0 + 2.0 * self.belief.spread) * self._usual:
            return False
        ratio = estimate.coefficient / self._usual
        slip_mm = self.shape.slip_mm(opening_mm, ratio)
        if slip_mm > MOST_SLIP_MM:
            return False
        self.shape = self.valve.shape = FlowShape(self.shape.threshold_mm - slip_mm, self.shape.exponent)
        estimate.rescale(ratio)
        self.reference = self._usual
        return True

    def follow_reference(self) -> None:
        """The reference goes after the flow: slowly, but at once where the flow is surely stronger."""
        if self._has_slipped():
            return
        estimate = self.filter
        sure = estimate.coefficient - 1.5 * estimate.coefficient_sd > self.reference
        self.reference += (0.2 if sure else 0.04) * (estimate.coefficient - self.reference)
        self.reference = min(self.reference, self.belief.coefficient * (1.0 + 4.0 * self.unsure))
        self._best = max(self._best, self.reference)
        clear = (estimate.coefficient / max(estimate.coefficient_sd, 1e-9)) ** 2
        if estimate.coefficient > 0.3 * self.reference:
            self._log_flow += clear * math.log(estimate.coefficient)
            self._clear_flow += clear
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

    def learn(self, gained_mg: float) -> None:
        """From an opening and its tail: the balance's lag, the surge scale, the flow."""
        rows = [row._replace(noise_mg=max(row.noise_mg, self.noise_mg)) for row in self.record]
        phi_s = sum(row.phi_s for row in rows)
        if phi_s <= 0.0 or gained_mg < LEAST_MG:
            return
        if self.flows_only_shaken:
            self._identify_lag(rows)
            # Lumps are its flow, and the largest matter: the filter has followed them.
            self._surge_mg += max(0.2, 1.0 / (self.belief.doses + 1.0)) * (self.filter.surge_mg - self._surge_mg)
        else:
            if not self.knows_balance:
                self._identify_balance(rows, gained_mg)
            if self.knows_balance:
                self._learn_surges(rows)
        if self._clear_flow > 0.0:
            self._ratios.append(self._log_flow / self._clear_flow - math.log(self.belief.coefficient))
            self._log_flow = self._clear_flow = 0.0

    def _identify_balance(self, rows: list[Row], gained_mg: float) -> None:
        """The balance's filter, and with it the flow; a probe that is long or fits badly tells neither."""
        fit = fit_step(rows, self.noise_mg)
        open_s = sum(row.dt_s for row in rows if row.phi_s > 0.0)
        if fit is None or fit.misfit > WORST_MISFIT or open_s > max(LONGEST_PROBE_S, LONGEST_PROBE_LAGS * fit.lag_s):
            return
        self.lag_s, self.poles, self.misfit = LAG_MARGIN * fit.lag_s, fit.poles, fit.misfit
        self.fits += 1
        found = gained_mg / sum(row.phi_s for row in rows)
        # It may have been bridged for a part of the time: what is faster than believed is believed at once.
        self.reference = max(found, math.sqrt(found * self.reference))
        self._use_balance(rows)

    def _identify_lag(self, rows: list[Row]) -> None:
        """In lumps a probe has no shape; the lag is the geometric mean of what is likeliest for each opening."""
        lag_s = fit_lag(rows, self.reference, self._surge_mg, self.poles) if self.fits < LAG_FITS else None
        if lag_s is None:
            return
        self.lag_s *= (LAG_MARGIN * lag_s / self.lag_s) ** (1.0 / (self.fits + 1))
        self.fits += 1
        self._use_balance(rows)

    def _use_balance(self, rows: list[Row]) -> None:
        """From now on; the tail is over, and what it ended at is known."""
        self.filter.set_balance(self.lag_s, self.poles, self._filter_misfit)
        last_mg = sum(row.reading_mg for row in rows[-3:]) / 3.0
        self.filter.restart(last_mg, 0.3, self.reference, self.unsure)

    def _learn_surges(self, rows: list[Row]) -> None:
        doubt = GUESS_DOUBT if self.belief.doses == 0 else SURGE_DOUBT
        self._surge_mg = fit_surge(rows, self.reference, self._surge_mg, self.lag_s, doubt, self.poles)
        self.filter.surge_mg = self._surge_mg

    def note_coefficient(self, coefficient: float) -> None:
        """What the pulses of this dose say of the flow; the last word counts."""
        self._ratios = [math.log(coefficient / self.belief.coefficient)]

    # --- what is kept ---

    def finish(self, reason: Reason, seen: Observation) -> Finish:
        """The dose's last word, with what was learnt."""
        balance = BalanceBelief(
            lag_s=self.lag_s, poles=self.poles, misfit=self.misfit, noise_mg=self.noise_mg, fits=self.fits
        )
        return Finish(reason, seen.net_mg, seen.uncertainty_mg, self._powder(), balance)

    def _powder(self) -> PowderBelief:
        belief = self.belief
        if not self._ratios:
            return belief
        ratio = sum(self._ratios) / len(self._ratios)
        weight = max(0.2, 1.0 / (belief.doses + 1.0))
        # The first dose corrects a guess; only from the second on do doses differ from what was learnt.
        if belief.doses == 0:
            spread = max(belief.spread, GUESSED_SPREAD)
        else:
            spread = math.sqrt((1.0 - weight) * belief.spread**2 + weight * min(ratio * ratio, 1.0))
        needs_shaking = self.shaken_s > NEEDS_SHAKING * self.flow_s > 0.0
        return PowderBelief(
            coefficient=belief.coefficient * math.exp(weight * ratio),
            threshold_mm=belief.threshold_mm,
            exponent=belief.exponent,
            spread=min(max(spread, 0.15), 1.0),
            surge_mg=self._surge_mg,
            vibration=max(belief.vibration, GENTLE) if needs_shaking else belief.vibration,
            pauses=self.pauses,
            doses=belief.doses + 1,
        )

    def verdict(self, seen: Observation) -> Reason | None:
        """What a stable mean says: done, too much, or None while there is more to dose."""
        request = self.request
        reasons: dict[Verdict, Reason | None] = {"in tolerance": "reached", "over": "overshoot", "under": None}
        return reasons[judge(request.target_mg, request.tolerance_mg, seen.net_mg, seen.uncertainty_mg)]
