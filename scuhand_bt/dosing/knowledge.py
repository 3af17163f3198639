"""What `adaptive` knows during one dose, and what it keeps of it.

* The bank of filters (`estimation`), begun anew with each opening, and the valve's path (`valve`).
* The reference: the flow's coefficient k where nothing is in the powder's way. An opening shows k = gained mass over
  the integral of phi; the reference goes at once to what is more, and little by little to what is less.
* How wide an opening may be: the chance constraint (`constraint`), and what a sheet that sticks would let out.
* How good its predictions turned out to be: `erratic`, by what factor their variance is too small.
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
"""The reference falls to no less than this share of itself in an opening."""
RISES, RISEN = 3, 3.0
"""Readings whose mean is above that of as many before, by so many standard deviations, still rise."""
PEAK, PEAK_NOISES, PEAK_LUMPS = 5, 4.0, 5.0
"""Readings that a flow's peak is taken over; so many standard deviations of one, and lumps, are no part of it."""
SURE = 1.5
"""So many standard deviations below what is believed of it the flow surely is."""
LEAST_MG, TELLING = 2.0, 20.0
"""Openings that neither brought this together nor should have, or so many times the noise, teach nothing yet."""
AIM_UNDER_MG = 0.1
"""Too little can be corrected, too much cannot."""
LEAST_SPARE_MG = 0.5
"""Above the target, where the balance is too uncertain for any verdict."""
SLACK_S = 0.1
"""Between a reading and the command that answers it."""
LEAST_HOLD_S = 0.1
"""No opening is shorter."""
WIDER, MOST_NARROWEST_MM = 1.4, 0.5
"""Where nothing comes from it, the narrowest opening grows by this factor, up to so far above the threshold."""
ERRATIC_GAIN, MOST_ERRATIC = 0.1, 25.0
"""How fast it is learnt that predictions are worse than they claim; and the most that one of them tells."""
DIFFERS = 0.5
"""By how much the flow may differ from what is believed, as a logarithm."""
HARDLY_EVER = 2.6
"""Standard deviations that a flow is above its reference once in 200 times."""
GUESSED_SPREAD, LEAST_KEPT_SPREAD = 0.3, 0.15
"""What doses are taken to differ by, at least: until a second one was seen, and ever."""
NEAR_MG = 20.0
"""On a balance that adapts an opening ends so far from the target, and the last of the dose comes out of others."""
FOLLOWS, FOLLOWS_SURELY = 0.04, 0.2
"""How far the reference goes after the flow with each sight of it; where the flow is surely stronger."""
LEAST_WEIGHT = 0.2
"""What a dose counts beside those before, at least."""


class Knowledge:
    """The bank, the valve's path, and the figures learnt beside them."""

    def __init__(self, request: DoseRequest) -> None:
        self.request, self.belief, self.balance = request, request.powder, request.balance
        self.shape = FlowShape(self.belief.threshold_mm, self.belief.exponent)
        self.valve = ValvePath(self.shape, request.valve_dead_time_s, request.valve_speed_mm_per_s)
        self.noise = Noise(self.balance.noise_mg, self.balance.shaken_noise_mg, request.readability_mg)
        self.reference = self.belief.coefficient
        """The flow's coefficient when nothing is in its way."""
        unknown = max(UNKNOWN_SPREAD, request.free_flow / (HARDLY_EVER * self.reference))
        self.spread = unknown if self.belief.doses == 0 else self.belief.spread
        """What a new opening's flow may be off by, relative to the reference."""
        self.error_mm = UNKNOWN_ERROR_MM if self.belief.doses == 0 else OPENING_ERROR_MM
        """What the opening is off by, and the threshold: their standard deviation."""
        self.seen = self.reference if self.belief.doses else 0.0
        """The greatest coefficient that powder was seen to flow with."""
        self.seen_now = 0.0
        """The same, in this dose."""
        self.erratic = self.belief.erratic
        """By what factor the variance of what was predicted is too small."""
        self.gap_mm = self.belief.gap_mm
        """The opening above the threshold that the reference was seen at."""
        self.surge_mg = self.belief.surge_mg
        self.uncertainty_mg = request.uncertainty_mg
        """The standard uncertainty of the mass that will be judged; it grows with the time that a dose takes."""
        self.doubt: Doubt | None = None
        self.time_s = 0.0
        self.rows: list[Row] = []
        self._needed_mm = max(self.belief.narrowest_mm / WIDER, NARROWEST_MM)
        """Above the threshold: from less, little comes. Each dose tries less than the one before."""
        self._ratios: list[tuple[float, float, float]] = []
        """Of openings: what came [mg], the coefficient against the belief's as a logarithm, and the mean gap [mm]."""
        self._told_of = np.zeros(3)
        """Of openings that nothing was learnt from yet: what came [mg], the integral of phi, and how long [s]."""
        self.begin(0.0, 1.0)

    # --- an opening ---

    def begin(self, mass_mg: float, sd_mg: float) -> None:
        """The balance is at rest, the valve shut, and this has been dosed, give or take `sd_mg`."""
        self.begin_mg, self._most_phi_s, self._shut_s = mass_mg, 0.0, 0.0
        self.surely = 0.0
        """The coefficient that powder has surely flowed with, in this opening."""
        self.bank = Bank.believing(self.balance, self.surge_mg)
        self.bank.erratic = self.erratic
        self.hurries = self.balance.adapts and self.aim_mg - mass_mg > 2.0 * NEAR_MG
        """Whether so much is to come that a filter which adapts shows its quick face; the last of a dose shows both."""
        if self.balance.adapts and not self.hurries:
            self.bank.temper = 0.0
        self.bank.restart(mass_mg, sd_mg, self.reference, self.spread, self.error_mm)
        self.rows.clear()
        self.narrowest_mm = self._needed_mm
        """The same, of this opening: what lets out more until it is answered than may come is no choice."""
        while self.narrowest_mm > NARROWEST_MM and not self._may_come(self.narrowest_mm):
            self.narrowest_mm = max(self.narrowest_mm / WIDER, NARROWEST_MM)

    def act(
        self, opening_mm: float, vibration: float, hold_s: float = math.inf
    ) -> Generator[Command, Observation, float]:
        """Hold a command until the next reading, or so long; the reading's innovation in standard deviations."""
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
        if phi_s > 0.0:  # what rises in the tail is the balance's: one that adapts takes longer than its model
            self.surely, self._shut_s = max(self.surely, self.bank.coefficient - self.bank.coefficient_sd), 0.0
        self._shut_s += dt_s
        if self._shut_s < self.bank.delay_s + PEAK * dt_s:  # powder that primed late shows when the valve is shut
            self.surely = max(self.surely, peak)
        return score

    def _peak(self) -> float:
        """The flow's coefficient as the steepest rise shows it, whatever the balance: it shows no rise too steep."""
        self._most_phi_s = max(self._most_phi_s, sum(row.phi_s for row in self.rows[-PEAK:]))
        if len(self.rows) <= PEAK:
            return 0.0
        rise_mg = self.rows[-1].reading_mg - self.rows[-1 - PEAK].reading_mg - PEAK_NOISES * self.rows[-1].noise_mg
        rise_mg -= LEAST_MG + PEAK_LUMPS * self.bank.surge_mg
        return rise_mg / self._most_phi_s if rise_mg > 0.0 < self._most_phi_s else 0.0

    @property
    def is_rising(self) -> bool:
        """Whether readings still go up, whatever the models of the balance say."""
        if len(self.rows) < 2 * RISES:
            return True
        readings_mg = [row.reading_mg for row in self.rows[-2 * RISES :]]
        rise_mg = sum(readings_mg[RISES:]) / RISES - sum(readings_mg[:RISES]) / RISES
        return rise_mg > RISEN * math.sqrt(2.0 / RISES) * self.rows[-1].noise_mg

    def predicted(self) -> tuple[float, float]:
        """Mean and standard deviation [mg] of what will have left once the valve is shut, if it is told to now."""
        means, variances = self.bank.coming(*self.valve.closing(0.0))
        return self.bank.over_all(means, variances / self.bank.erratic)

    def judge_prediction(self, predicted_mg: float, sd_mg: float) -> None:
        """What was predicted when the valve was told to shut, against what is known after the look.

        Only what came more than that is held against it.
        """
        more = max(self.bank.mass_mg - predicted_mg, 0.0) / math.hypot(sd_mg, self.noise.quiet_mg)
        self.erratic += ERRATIC_GAIN * (min(2.0 * more * more, MOST_ERRATIC) - self.erratic)
        self.erratic = max(self.erratic, 1.0)

    # --- how wide ---

    @property
    def most_mg(self) -> float:
        """No more may leave: a stable mean would call it too much."""
        spare_mg = acceptance_mg(self.request.tolerance_mg, self.uncertainty_mg)
        return self.request.target_mg + max(spare_mg, LEAST_SPARE_MG)

    @property
    def room_mg(self) -> float:
        """What may leave beside what has left."""
        return self.most_mg - self.bank.mass_mg

    @property
    def least_mg(self) -> float:
        """The mass that a stable mean would call in tolerance."""
        return self.request.target_mg - self.request.tolerance_mg + COVERAGE * self.uncertainty_mg

    @property
    def aim_mg(self) -> float:
        """The target; less by a lump where powder comes in lumps: they can be waited for, but not taken back."""
        least_mg = min(self.least_mg + AIM_UNDER_MG, self.request.target_mg)
        under_mg = self.bank.surge_mg + AIM_UNDER_MG * math.sqrt(self.erratic)
        return max(self.request.target_mg - under_mg, least_mg)

    @property
    def until_next_s(self) -> float:
        """How long an opening lasts that is to last until the next reading.

        Where readings are rare it ends without one that is late, or lost: the constraint has it answered by then; and
        elsewhere without several.
        """
        period_s = self.request.balance_period_s
        return self._late_s if period_s > LEAST_HOLD_S else silence_s(period_s)

    @property
    def _late_s(self) -> float:
        """Between a reading and the valve's answer to it."""
        return self.request.balance_period_s + SLACK_S

    def widest_mm(self, most_mg: float) -> float:
        """The opening that the chance constraint allows, for as much mass as this."""
        request, aim_mg = self.request, min(self.aim_mg, most_mg)
        hand = self._late_s + request.valve_dead_time_s, request.valve_speed_mm_per_s, request.max_opening_mm
        powder = self.reference, self._known_gap_mm, self.narrowest_mm
        return widest_mm(self.bank, self.shape, aim_mg, most_mg, *hand, *powder)

    @property
    def least_mm(self) -> float:
        """The opening from less than which little comes."""
        return self.shape.threshold_mm + self.narrowest_mm

    @property
    def strongest(self) -> float:
        """What the flow's coefficient may well be where nothing is in its way, for all that is not seen of it."""
        off = EXPONENT_ERROR * math.log(self._known_gap_mm / self.gap_mm)
        return self.reference * (1.0 + math.hypot(self.spread, off))

    @property
    def _known_gap_mm(self) -> float:
        """The opening above the threshold that the flow is seen at, or was when the valve was open last."""
        told_mm = self.valve.target_mm
        return max(told_mm - self.shape.threshold_mm, NARROWEST_MM) if told_mm > 0.0 else self.gap_mm

    # --- what is learnt ---

    def follow(self) -> None:
        """The reference goes after the flow: slowly, but at once where the flow is surely stronger."""
        bank = self.bank
        sure = bank.coefficient - SURE * bank.coefficient_sd > self.reference
        self.reference += (FOLLOWS_SURELY if sure else FOLLOWS) * (bank.coefficient - self.reference)

    def learn(self, gained_mg: float) -> None:
        """From an opening and its tail: what the balance is, and the flow."""
        phi_s = sum(row.phi_s for row in self.rows)
        noise_mg = self.noise.quiet_mg
        self.surge_mg = self.bank.surge_mg
        if phi_s <= 0.0:
            return
        least_mg = max(LEAST_MG, TELLING * noise_mg)
        if gained_mg > least_mg:
            self.balance = with_found(self.balance, balance_by(self.rows, self.begin_mg, gained_mg))
            self.error_mm = OPENING_ERROR_MM
        # Openings that bring little tell something together.
        open_s = sum(row.dt_s for row in self.rows if row.phi_s > 0.0)
        self._told_of += gained_mg, phi_s, open_s
        gained_mg, phi_s, open_s = self._told_of.tolist()
        if max(gained_mg, self.reference * phi_s) < least_mg:
            return
        self._told_of = np.zeros(3)
        gap_mm = float((phi_s / open_s) ** (1.0 / self.shape.exponent))
        if gained_mg > least_mg:
            self.gap_mm = gap_mm
        # It may have been bridged for a part of the time: what is faster than believed is believed at once, what is
        # slower little by little; what was seen to flow may always do so again. Narrow ones tell little.
        strongest = max(gained_mg / phi_s, noise_mg / phi_s, self.surely)
        told = self._told(gap_mm, max(gained_mg - PEAK_LUMPS * self.surge_mg, self.reference * phi_s))
        found = self.reference * (strongest / self.reference) ** told
        was_held_up = gained_mg < FREELY * self.reference * phi_s
        self.reference = max(found, SLOWER * self.reference)
        if gained_mg > LEAST_MG:  # where nothing came the cone may have been empty
            self.seen = max(self.seen, found)
            self._ratios.append((gained_mg, math.log(self.reference / self.belief.coefficient), gap_mm))
        elif gained_mg < RISEN * noise_mg:  # nothing at all, though something should have come
            self.seen *= SLOWER
        spread = max(self.belief.spread, GUESSED_SPREAD, 0.5 * (self.seen / self.reference - 1.0))
        if was_held_up:  # what comes when nothing is in its way is as little known as before
            spread = max(spread, self.spread)
        self.spread = min(spread, max(self.spread, UNKNOWN_SPREAD))

    def learn_coefficient(self, coefficient: float) -> None:
        """From pulses, each of which was weighed: what they have come to by now."""
        self.reference = coefficient
        self._ratios = [(1.0, math.log(coefficient / self.belief.coefficient), self.gap_mm)]

    def _told(self, gap_mm: float, mass_mg: float) -> float:
        """What an opening tells of the flow's coefficient, for what its width may be off, and for lumps by chance.

        `mass_mg` is what should have come of it, or what more came than a few lumps make: they explain no more.
        """
        width = self.shape.exponent * OPENING_ERROR_MM / gap_mm
        lumps = 2.0 * self.surge_mg / mass_mg
        return DIFFERS**2 / (DIFFERS**2 + width**2 + lumps)

    def little_came(self) -> None:
        """From the last opening: the powder needs more than so narrow a one.

        The next one may be wider than the constraint has it, and is shut by it at once if it flows: as wide as lets out
        no more until then than may come.
        """
        tried_mm = float(max(row.phi_s / row.dt_s for row in self.rows) ** (1.0 / self.shape.exponent))
        wider_mm = min(WIDER * max(tried_mm, self.narrowest_mm), MOST_NARROWEST_MM)
        if tried_mm < MOST_NARROWEST_MM and self._may_come(wider_mm):
            self._needed_mm = max(self._needed_mm, wider_mm)

    def _may_come(self, gap_mm: float) -> bool:
        """Whether no more than may come leaves an opening so far above the threshold until it is answered."""
        passes = self.valve.passes(self.shape.threshold_mm + gap_mm, LEAST_HOLD_S + SLACK_S)
        return self.strongest * passes < self.room_mg

    @property
    def knows_balance(self) -> bool:
        """Whether anything has been learnt of it."""
        return self.balance.fits > 0

    def doubt_balance(self, doubt: Doubt) -> None:
        """What a stable mean said is not what this balance was expected to say."""
        self.doubt = self.doubt or doubt
        if not self.balance.adapts:  # that creeps for longer than any model has it
            self.balance = self.balance.model_copy(update={"fits": 0, "doubt": 1.0})

    # --- what is kept ---

    def finish(self, reason: Reason, seen: Observation) -> Finish:
        """The dose's last word, with what was learnt."""
        noise = {"noise_mg": self.noise.quiet_mg, "shaken_noise_mg": self.noise.shaken_mg}
        balance = self.balance.model_copy(update=noise)
        if reason in ("empty", "no_flow"):  # an empty cone says nothing of a width
            self._needed_mm = self.belief.narrowest_mm
        return Finish(reason, seen.net_mg, seen.uncertainty_mg, self._powder(), balance, self.doubt)

    def _powder(self) -> PowderBelief:
        """The belief with this dose in it; as it was where no opening has told anything."""
        belief = self.belief
        if not self._ratios:
            return belief
        came_mg, ratios, gaps_mm = zip(*self._ratios, strict=True)
        ratio, gap_mm = np.average((ratios, gaps_mm), axis=1, weights=came_mg).tolist()
        weight = max(LEAST_WEIGHT, 1.0 / (belief.doses + 1.0))
        # The first dose corrects a guess; only from the second on do doses differ from what was learnt.
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

        Too uncertain for any verdict, it is done where it has come to the aim: no time makes it surer.
        """
        request = self.request
        is_untold = acceptance_mg(request.tolerance_mg, seen.uncertainty_mg) < 0.0
        under: Reason | None = "reached" if is_untold and seen.net_mg >= self.aim_mg else None
        reasons: dict[Verdict, Reason | None] = {"in tolerance": "reached", "over": "overshoot", "under": under}
        return reasons[judge(request.target_mg, request.tolerance_mg, seen.net_mg, seen.uncertainty_mg)]
