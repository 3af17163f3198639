"""What `adaptive` knows during a dose and keeps of it (docs/dosing.md, What is learnt).

* The bank of filters (`estimation`), restarted at each opening, and the valve's path (`valve`).
* The reference k_ref: the flow's coefficient with nothing in the powder's way. An opening shows its gain over the
  integral of phi.
* How wide an opening may be (`constraint`), and the narrowest that is useful.
* `erratic`: the factor by which the variance of predictions has proven too small.
"""

import math
from collections.abc import Generator

import numpy as np

from scuhand_bt.dosing.constraint import NARROWEST_MM, widest_mm
from scuhand_bt.dosing.controller import Command, DoseRequest, Doubt, Finish, Observation, Reason, Stream, silence_s
from scuhand_bt.dosing.estimation import (
    EXPONENT_ERROR,
    FREELY,
    OPENING_ERROR_MM,
    UNKNOWN_ERROR_MM,
    UNKNOWN_SPREAD,
    Bank,
)
from scuhand_bt.dosing.identification import LEAST_APART_S, Row, balance_by, with_found
from scuhand_bt.dosing.noise import Noise
from scuhand_bt.dosing.valve import FlowShape, ValvePath
from scuhand_bt.dosing.verdict import COVERAGE, acceptance_mg, judge
from scuhand_bt.specs import GAPS_MM, PowderBelief, Verdict

SLOWER = 0.7
"""One `learn` lowers the reference to no less than this share, as the powder may have been bridged. `follow` has no
such limit. `seen` falls by it where nothing came at all."""
RISES, RISEN = 3, 3.0
"""Readings still rise if the mean of RISES exceeds that of as many before by RISEN standard deviations."""
PEAK, PEAK_NOISES, PEAK_LUMPS = 5, 4.0, 5.0
"""Readings that a flow's peak is taken over, and the standard deviations and lumps that are no part of it."""
SURE = 1.5
"""The flow is surely at least what is believed less this many standard deviations."""
LEAST_MG, TELLING = 2.0, 20.0
"""Openings are added up until they brought, or should have brought, LEAST_MG or TELLING times the noise."""
AIM_UNDER_MG = 0.05
"""The aim is this far below the target: too little can be corrected, too much cannot."""
LEAST_SPARE_MG = 0.5
"""Above the target, the least limit where the balance is too uncertain for any verdict."""
SLACK_S = 0.1
"""Time between a reading and the command that answers it."""
LEAST_HOLD_S = 0.1
"""Shortest opening."""
WIDER, MOST_NARROWEST_MM = 1.4, 0.5
"""Where little comes, the narrowest opening grows by WIDER, up to MOST_NARROWEST_MM above the threshold."""
ERRATIC_GAIN, MOST_ERRATIC = 0.1, 25.0
"""Gain at which `erratic` is learnt, and the most that one prediction counts."""
DIFFERS = 0.5
"""Standard deviation of the flow's logarithm from opening to opening."""
HARDLY_EVER = 2.6
"""Standard deviations by which one flow in 200 exceeds its reference."""
GUESSED_SPREAD, LEAST_KEPT_SPREAD = 0.3, 0.15
"""Least spread between doses: until a second one was seen, and ever."""
NEAR_MG = 20.0
"""On a balance that adapts an opening ends at least this far short of the aim; the rest comes out of others."""
FOLLOWS, FOLLOWS_SURELY = 0.04, 0.2
"""Share of the difference by which the reference follows the flow at each sight; if that is surely stronger."""
LEAST_WEIGHT = 0.2
"""Least weight of a dose against those before it."""


class Knowledge:
    """The bank, the valve's path, and the figures learnt beside them."""

    def __init__(self, request: DoseRequest) -> None:
        self.request, self.belief, self.balance = request, request.powder, request.balance
        self.shape = FlowShape(self.belief.threshold_mm, self.belief.exponent)
        self.valve = ValvePath(self.shape, request.valve_dead_time_s, request.valve_speed_mm_per_s)
        self.noise = Noise(self.balance.noise_mg, self.balance.shaken_noise_mg, request.readability_mg)
        self.reference = self.belief.coefficient
        """k_ref, the flow's coefficient with nothing in its way."""
        unknown = max(UNKNOWN_SPREAD, request.free_flow / (HARDLY_EVER * self.reference))
        self.spread = unknown if self.belief.doses == 0 else self.belief.spread
        """Standard deviation of a new opening's flow, relative to the reference."""
        self.error_mm = UNKNOWN_ERROR_MM if self.belief.doses == 0 else OPENING_ERROR_MM
        """Standard deviation of the opening, and of the threshold."""
        self.seen = self.reference if self.belief.doses else 0.0
        """The greatest coefficient with which powder was seen to flow."""
        self.seen_now = 0.0
        """The same, in this dose."""
        self.erratic = self.belief.erratic
        """Factor by which the variance of predictions is too small."""
        self.gap_mm = self.belief.gap_mm
        """The opening above the threshold at which the reference was seen."""
        self.surge_mg = self.belief.surge_mg
        self.uncertainty_mg = request.uncertainty_mg
        """Standard uncertainty of the mass that will be judged; it grows as the dose takes longer."""
        self.doubt: Doubt | None = None
        self.time_s = 0.0
        self.rows: list[Row] = []
        self._needed_mm = max(self.belief.narrowest_mm / WIDER, NARROWEST_MM)
        """Narrowest useful opening, above the threshold. Each dose begins one step below that of the last."""
        self._ratios: list[tuple[float, float, float]] = []
        """Of each opening: what came [mg], log of the coefficient over the belief's, mean gap [mm]."""
        self._told_of = np.zeros(3)
        """Sums over openings not learnt from yet: what came [mg], integral of phi, time open [s]."""
        self.begin(0.0, 1.0)

    # --- an opening ---

    def begin(self, mass_mg: float, sd_mg: float) -> None:
        """Begin an opening: valve shut, balance at rest, the mass known to `sd_mg`."""
        self.begin_mg, self._most_phi_s, self._shut_s = mass_mg, 0.0, 0.0
        self.surely = 0.0
        """The coefficient with which powder has surely flowed in this opening."""
        self.bank = Bank.believing(self.balance, self.surge_mg)
        self.bank.erratic = self.erratic
        self.hurries = self.balance.adapts and self.aim_mg - mass_mg > 2.0 * self.near_mg
        """Whether so much is missing that an adapting filter shows its quick speed; the last of a dose shows both."""
        if self.balance.adapts and not self.hurries:
            self.bank.temper = 0.0
        self.bank.restart(mass_mg, sd_mg, self.reference, self.spread, self.error_mm)
        self.rows.clear()
        self.narrowest_mm = self._needed_mm
        """The narrowest useful opening now: none that lets out more than the room before it is answered."""
        while self.narrowest_mm > NARROWEST_MM and not self._may_come(self.narrowest_mm):
            self.narrowest_mm = max(self.narrowest_mm / WIDER, NARROWEST_MM)

    def act(
        self, opening_mm: float, vibration: float, hold_s: float = math.inf
    ) -> Generator[Command, Observation, float]:
        """Hold a command until the next reading, or for `hold_s`; returns the innovation [standard deviations]."""
        before_mm = self._known_gap_mm
        self.valve.command(self.time_s, opening_mm)
        changed = math.log(self._known_gap_mm / before_mm) if opening_mm > 0.0 else 0.0
        seen = yield Stream(opening_mm, vibration, hold_s)
        if seen.time_s > self.time_s + hold_s:
            self.valve.command(self.time_s + hold_s, 0.0)
        dt_s = max(seen.time_s - self.time_s, LEAST_APART_S)
        phi_s, slope_s = self.valve.advance(self.time_s, seen.time_s)
        self.time_s = seen.time_s
        shaking = vibration > 0.0
        noise_mg = self.noise.learn(seen.net_mg, self.bank.unseen_mg, shaking=shaking)
        row = Row(dt_s, phi_s, slope_s, seen.net_mg, noise_mg, changed)
        self.rows.append(row)
        score = self.bank.update(row, self.reference)
        self.seen_now = max(self.seen_now, self.surely)
        peak = 0.0 if shaking else self._peak()
        if phi_s > 0.0:  # a rise after shutting is the balance's: an adapting filter outlasts its model
            self.surely, self._shut_s = max(self.surely, self.bank.coefficient - self.bank.coefficient_sd), 0.0
        self._shut_s += dt_s
        if self._shut_s < self.bank.delay_s + PEAK * dt_s:  # powder that primed late shows once the valve is shut
            self.surely = max(self.surely, peak)
        return score

    def _peak(self) -> float:
        """The flow's coefficient by the steepest rise; no balance shows a rise steeper than the true one."""
        self._most_phi_s = max(self._most_phi_s, sum(row.phi_s for row in self.rows[-PEAK:]))
        if len(self.rows) <= PEAK:
            return 0.0
        rise_mg = self.rows[-1].reading_mg - self.rows[-1 - PEAK].reading_mg - PEAK_NOISES * self.rows[-1].noise_mg
        rise_mg -= LEAST_MG + PEAK_LUMPS * self.bank.surge_mg
        return rise_mg / self._most_phi_s if rise_mg > 0.0 < self._most_phi_s else 0.0

    @property
    def is_rising(self) -> bool:
        """Whether readings still rise, whatever the models say."""
        if len(self.rows) < 2 * RISES:
            return True
        readings_mg = [row.reading_mg for row in self.rows[-2 * RISES :]]
        rise_mg = sum(readings_mg[RISES:]) / RISES - sum(readings_mg[:RISES]) / RISES
        return rise_mg > RISEN * math.sqrt(2.0 / RISES) * self.rows[-1].noise_mg

    def predicted(self) -> tuple[float, float]:
        """Mean and standard deviation [mg] of the mass that will have left if the valve is told to shut now."""
        means, variances = self.bank.coming(*self.valve.closing(0.0))
        return self.bank.over_all(means, variances / self.bank.erratic)

    def judge_prediction(self, predicted_mg: float, sd_mg: float) -> None:
        """Update `erratic` by what was predicted at the command to shut and what the look shows.

        Only a surplus counts against the prediction.
        """
        more = max(self.bank.mass_mg - predicted_mg, 0.0) / math.hypot(sd_mg, self.noise.quiet_mg)
        self.erratic += ERRATIC_GAIN * (min(2.0 * more * more, MOST_ERRATIC) - self.erratic)
        self.erratic = max(self.erratic, 1.0)

    # --- how wide ---

    @property
    def most_mg(self) -> float:
        """The limit of the constraint: a stable mean would call more than this too much."""
        spare_mg = acceptance_mg(self.request.tolerance_mg, self.uncertainty_mg)
        return self.request.target_mg + max(spare_mg, LEAST_SPARE_MG)

    @property
    def room_mg(self) -> float:
        """What may still leave."""
        return self.most_mg - self.bank.mass_mg

    @property
    def near_mg(self) -> float:
        """On a balance that adapts, what is missing to the aim when the last of a dose begins."""
        return max(NEAR_MG, self.balance.slow_mg)

    @property
    def least_mg(self) -> float:
        """The least mass that a stable mean would call in tolerance."""
        return self.request.target_mg - self.request.tolerance_mg + COVERAGE * self.uncertainty_mg

    @property
    def aim_mg(self) -> float:
        """The mass to stop at: a lump below the target, as lumps can be waited for but not taken back."""
        least_mg = min(self.least_mg + AIM_UNDER_MG, self.request.target_mg)
        under_mg = self.bank.surge_mg + AIM_UNDER_MG * math.sqrt(self.erratic)
        return max(self.request.target_mg - under_mg, least_mg)

    @property
    def until_next_s(self) -> float:
        """Duration of an opening that may last until the next reading.

        With rare readings it ends even if that reading is late or lost, as the constraint counts on an answer by then.
        Otherwise several may be lost.
        """
        period_s = self.request.balance_period_s
        return self._late_s if period_s > LEAST_HOLD_S else silence_s(period_s)

    @property
    def _late_s(self) -> float:
        """Time from a reading until the valve answers the next one."""
        return self.request.balance_period_s + SLACK_S

    def widest_mm(self, most_mg: float) -> float:
        """The widest opening [mm] that the constraint allows for `most_mg`."""
        request, aim_mg = self.request, min(self.aim_mg, most_mg)
        hand = self._late_s + request.valve_dead_time_s, request.valve_speed_mm_per_s, request.max_opening_mm
        powder = self.reference, self._known_gap_mm, self.narrowest_mm
        return widest_mm(self.bank, self.shape, aim_mg, most_mg, *hand, *powder)

    @property
    def least_mm(self) -> float:
        """The narrowest useful opening [mm]."""
        return self.shape.threshold_mm + self.narrowest_mm

    @property
    def strongest(self) -> float:
        """The strongest coefficient to be reckoned with for what is not seen yet."""
        off = EXPONENT_ERROR * math.log(self._known_gap_mm / self.gap_mm)
        return self.reference * (1.0 + math.hypot(self.spread, off))

    @property
    def _known_gap_mm(self) -> float:
        """The opening above the threshold at which the flow is seen, or was when the valve was last open."""
        told_mm = self.valve.target_mm
        return max(told_mm - self.shape.threshold_mm, NARROWEST_MM) if told_mm > 0.0 else self.gap_mm

    # --- what is learnt ---

    def follow(self) -> None:
        """Let the reference follow the flow: slowly, but quickly where the flow is surely stronger."""
        bank = self.bank
        sure = bank.coefficient - SURE * bank.coefficient_sd > self.reference
        self.reference += (FOLLOWS_SURELY if sure else FOLLOWS) * (bank.coefficient - self.reference)

    def learn(self, gained_mg: float) -> None:
        """Learn the balance and the flow from an opening and its tail, once its mass is known."""
        phi_s = sum(row.phi_s for row in self.rows)
        noise_mg = self.noise.quiet_mg
        self.surge_mg = self.bank.surge_mg
        if phi_s <= 0.0:
            return
        least_mg = max(LEAST_MG, TELLING * noise_mg)
        if gained_mg > least_mg:
            self.balance = with_found(self.balance, balance_by(self.rows, self.begin_mg, gained_mg))
            self.error_mm = OPENING_ERROR_MM
        # Openings that bring little are added up.
        open_s = sum(row.dt_s for row in self.rows if row.phi_s > 0.0)
        self._told_of += gained_mg, phi_s, open_s
        gained_mg, phi_s, open_s = self._told_of.tolist()
        if max(gained_mg, self.reference * phi_s) < least_mg:
            return
        self._told_of = np.zeros(3)
        gap_mm = float((phi_s / open_s) ** (1.0 / self.shape.exponent))
        if gained_mg > least_mg:
            self.gap_mm = gap_mm
        # Powder may have been bridged for a while: a faster flow is believed at once, a slower one little by little.
        # What was seen to flow may always do so again. Narrow openings tell little.
        strongest = max(gained_mg / phi_s, noise_mg / phi_s, self.surely)
        told = self._told(gap_mm, max(gained_mg - PEAK_LUMPS * self.surge_mg, self.reference * phi_s))
        found = self.reference * (strongest / self.reference) ** told
        was_held_up = gained_mg < FREELY * self.reference * phi_s
        self.reference = max(found, SLOWER * self.reference)
        if gained_mg > LEAST_MG:  # where nothing came, the cone may have been empty
            self.seen = max(self.seen, found)
            self._ratios.append((gained_mg, math.log(self.reference / self.belief.coefficient), gap_mm))
        elif gained_mg < RISEN * noise_mg:  # nothing at all, though something should have come
            self.seen *= SLOWER
        spread = max(self.belief.spread, GUESSED_SPREAD, 0.5 * (self.seen / self.reference - 1.0))
        if was_held_up:  # held up, the unhindered flow is as uncertain as before
            spread = max(spread, self.spread)
        self.spread = min(spread, max(self.spread, UNKNOWN_SPREAD))

    def learn_coefficient(self, coefficient: float) -> None:
        """Take the coefficient found by weighed pulses."""
        self.reference = coefficient
        self._ratios = [(1.0, math.log(coefficient / self.belief.coefficient), self.gap_mm)]

    def _told(self, gap_mm: float, mass_mg: float) -> float:
        """The share of a new coefficient to believe, given the error of the width and the chance of lumps.

        `mass_mg` is what should have come, or what came beyond a few lumps: they explain no more than that.
        """
        width = self.shape.exponent * OPENING_ERROR_MM / gap_mm
        lumps = 2.0 * self.surge_mg / mass_mg
        return DIFFERS**2 / (DIFFERS**2 + width**2 + lumps)

    def little_came(self) -> None:
        """Widen the narrowest opening after one that brought little (docs/dosing.md, When little comes).

        It may be wider than the constraint allows, which shuts it as soon as powder flows; but it lets out no more than
        the room until then.
        """
        tried_mm = float(max(row.phi_s / row.dt_s for row in self.rows) ** (1.0 / self.shape.exponent))
        wider_mm = min(WIDER * max(tried_mm, self.narrowest_mm), MOST_NARROWEST_MM)
        if tried_mm < MOST_NARROWEST_MM and self._may_come(wider_mm):
            self._needed_mm = max(self._needed_mm, wider_mm)

    def _may_come(self, gap_mm: float) -> bool:
        """Whether an opening so far above the threshold lets out less than the room before it is answered."""
        passes = self.valve.passes(self.shape.threshold_mm + gap_mm, LEAST_HOLD_S + SLACK_S)
        return self.strongest * passes < self.room_mg

    @property
    def knows_balance(self) -> bool:
        """Whether anything is known of the balance, and more than a person's container can show."""
        return self.balance.fits > (1 if self.balance.may_be_late else 0)

    def doubt_balance(self, doubt: Doubt) -> None:
        """Note that a stable mean was far from the expected; the balance then counts as unknown."""
        self.doubt = self.doubt or doubt
        if not self.balance.adapts:  # an adapting filter creeps for longer than any model
            self.balance = self.balance.model_copy(update={"fits": 0, "doubt": 1.0})

    # --- what is kept ---

    def finish(self, reason: Reason, seen: Observation) -> Finish:
        """The dose's result, with what was learnt."""
        noise = {"noise_mg": self.noise.quiet_mg, "shaken_noise_mg": self.noise.shaken_mg}
        balance = self.balance.model_copy(update=noise)
        if reason in ("empty", "no_flow"):  # an empty cone tells nothing about a width
            self._needed_mm = self.belief.narrowest_mm
        return Finish(reason, seen.net_mg, seen.uncertainty_mg, self._powder(), balance, self.doubt)

    def _powder(self) -> PowderBelief:
        """The belief about the powder after this dose; unchanged where no opening has told anything."""
        belief = self.belief
        if not self._ratios:
            return belief
        came_mg, ratios, gaps_mm = zip(*self._ratios, strict=True)
        ratio, gap_mm = np.average((ratios, gaps_mm), axis=1, weights=came_mg).tolist()
        weight = max(LEAST_WEIGHT, 1.0 / (belief.doses + 1.0))
        # The first dose corrects a guess. Only from the second on do doses differ from what was learnt.
        if belief.doses == 0:
            spread = max(belief.spread, GUESSED_SPREAD)
        else:
            off = max(abs(ratio), math.log(max(self.seen_now, 1e-9) / belief.coefficient))
            spread = math.sqrt((1.0 - weight) * belief.spread**2 + weight * min(off * off, 1.0))
        learnt = {
            "coefficient": belief.coefficient * math.exp(weight * ratio),
            "gap_mm": float(np.clip(gap_mm, *GAPS_MM)),
            "narrowest_mm": self._needed_mm,
            "spread": min(max(spread, LEAST_KEPT_SPREAD), 1.0),
            "erratic": self.erratic,
            "surge_mg": belief.surge_mg + weight * (self.surge_mg - belief.surge_mg),
            "doses": belief.doses + 1,
        }
        return belief.model_copy(update=learnt)

    def verdict(self, seen: Observation) -> Reason | None:
        """What a stable mean says: done, too much, or None while there is more to dose.

        If it is too uncertain for any verdict, the dose is done at the aim, as time makes it no surer.
        """
        request = self.request
        is_untold = acceptance_mg(request.tolerance_mg, seen.uncertainty_mg) < 0.0
        under: Reason | None = "reached" if is_untold and seen.net_mg >= self.aim_mg else None
        reasons: dict[Verdict, Reason | None] = {"in tolerance": "reached", "over": "overshoot", "under": under}
        return reasons[judge(request.target_mg, request.tolerance_mg, seen.net_mg, seen.uncertainty_mg)]
