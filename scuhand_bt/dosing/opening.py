"""One continuous opening of `adaptive`, from the command to open to the command to shut.

    close when  M + k Phi_close(D) + q T / 2  >=  stop,     stop = target - min(m + 0.1, tolerance - guard)

M [mg] and k come from `FlowFilter`, Phi_close from the valve's tail, T is the balance's period, m [mg] the powder's
surge scale. Closing early by it makes the best of lumps, which can be waited for but not taken back.

While nothing comes the opening holds and vibration rises: no flow means shake, not open wider. Near the target, where
what is shaken loose may be too much, the valve is shut and opened again first.
"""

from collections.abc import Generator
from typing import Literal

from scuhand_bt.dosing.controller import LONGEST_UNWEIGHED_S, Command, Observation
from scuhand_bt.dosing.dose_state import FULL, GENTLE, SLACK_S, Knowledge

Ended = Literal["reached", "surprise", "dry", "long"]
"""Closed on the prediction; shut on readings far above it; nothing came at last; the pan wants to be weighed."""
PROBE_SHARE, PROBE_MG = 0.4, 60.0
SURPRISE, SURPRISES = 5.0, 3
"""So many readings in a row, so many standard deviations above prediction, shut the valve."""
QUIET_SHARE = 0.2
"""Less than this share of what the reference flow would have brought is no flow."""
SURELY, SOON_S = 2.0, 1.0
"""What is in tolerance by so many standard deviations is enough, where the rest would take longer than this."""
DRY_MG = 3.0
LUMPY_MG = 0.7
"""Lumps of this mean mass are worth looking at one by one, where shaking alone brings them."""
LUMPS_LEFT = 3.0
SHAKE_S, SHAKE_SHARE, SHAKE_LUMPS = 0.3, 0.12, 1.5
"""One shake, the share of a lump it should bring, and up to how many lumps from the target; more further away."""
LISTEN_MG_PER_LAG, LISTEN_LAGS = 0.3, 3
"""How slowly, and how long, a powder that is believed to need shaking is listened to once without it."""
STILL_COMES = 0.4
"""The share of the expected flow that must still come for it to flow without being shaken."""
PAUSED = 0.1
"""Share of the flow that is allowed for while such a powder is not shaken."""
LONGEST_BARREN_S = 120.0
"""Open and shaken for so long without a gain that can be told from noise: dry, whatever was expected."""
SPARED_MG, REOPENED = 30.0, 2
"""This near to the target a bridge is broken by shutting and opening the valve; by shaking only when that has failed so
often in a row."""
REOPEN_S = 0.3
"""So long nothing has come when the valve is shut to break a bridge."""
MOST_STALLS = 1
"""A powder that stalls this often in a dose is shaken from then on: what bridged once bridges again."""


class Opening:
    """Steers one opening; `run` is its life."""

    def __init__(self, known: Knowledge, probing: bool) -> None:
        self._known = known
        self._probing = probing
        self._stop_mg = known.stop_mg
        mass_mg = known.filter.mass_mg
        if probing:
            self._stop_mg = min(
                self._stop_mg, mass_mg + max(6.0, min(PROBE_SHARE * (self._stop_mg - mass_mg), PROBE_MG))
            )
        self._opening_mm = known.opening_mm(known.stop_mg - mass_mg)
        self._vibration = known.vibration
        self._surprises = 0
        self._listened = known.belief.doses > 0
        self._quiet_s = self._flowing_s = self._barren_s = 0.0
        self._expected_mg = 0.0
        self._evident_mg = self._barren_mg = mass_mg

    @property
    def _remaining_mg(self) -> float:
        return self._stop_mg - self._known.filter.mass_mg

    def run(self) -> Generator[Command, Observation, Ended]:
        """Until it should shut."""
        known = self._known
        begin_s = known.time_s
        if self._remaining_mg <= 0.0:
            return "reached"
        while True:
            dt_s, phi_s, score = yield from known.act(self._opening_mm, self._vibration)
            if self._is_surprised(score):
                return "surprise"
            if self._will_reach():
                return "reached"
            known.flow_s += dt_s
            known.shaken_s += dt_s * (self._vibration > 0.0)
            if self._is_barren(dt_s):
                return "dry"
            if known.time_s - begin_s > LONGEST_UNWEIGHED_S:
                return "long"
            self._look_for_flow(dt_s, phi_s)
            if self._takes_lumps_singly():
                if not self._listened:
                    yield from self._listen()
                    continue
                yield from self._shake_and_look()
                if self._remaining_mg <= 0.0:
                    return "reached"
                came = known.filter.mass_mg - self._evident_mg > 0.5
                self._quiet_s = 0.0 if came else self._quiet_s + dt_s
                continue
            if self._is_dry():
                return "dry"
            if self._is_bridged:
                yield from self._reopen()
            else:
                self._steer()

    # --- when it ends ---

    def _is_surprised(self, score: float) -> bool:
        self._surprises = self._surprises + 1 if score > SURPRISE else 0
        return self._surprises >= SURPRISES

    def _will_reach(self) -> bool:
        """Closed now, the mass ends where it should."""
        known, request, estimate = self._known, self._known.request, self._known.filter
        opening_mm = known.valve.opening_mm
        tail = known.shape.closing(opening_mm, request.valve_dead_time_s, request.valve_speed_mm_per_s)
        coming_mg = estimate.coefficient * (tail + known.shape.value(opening_mm) * request.balance_period_s / 2.0)
        # A lump that was only imagined costs another opening; one that is waited for costs a moment.
        doubt_mg = min(1.0, estimate.surge_mg) * estimate.mass_sd_mg
        predicted_mg = estimate.mass_mg + coming_mg
        if predicted_mg - doubt_mg >= self._stop_mg:
            return True
        flow = estimate.coefficient * known.shape.value(opening_mm)
        slow = self._stop_mg - predicted_mg > SOON_S * flow
        return slow and predicted_mg - SURELY * estimate.mass_sd_mg >= known.enough_mg

    @property
    def _is_spared(self) -> bool:
        """Near the target a powder that flows by itself is not shaken: it would come in more than its usual lumps."""
        known = self._known
        return not known.flows_only_shaken and self._remaining_mg < SPARED_MG and known.reopened < REOPENED

    @property
    def _is_bridged(self) -> bool:
        return self._is_spared and self._vibration == 0.0 and self._quiet_s > REOPEN_S

    def _reopen(self) -> Generator[Command, Observation, None]:
        """A bridge breaks as the valve shuts and opens; then powder comes as it usually does."""
        known = self._known
        known.reopened += 1
        while known.valve.opening_mm > 0.0:
            yield from known.act(0.0, 0.0)
        known.trust_valve()
        known.filter.expect(known.reference)
        self._opening_mm = known.opening_mm(self._remaining_mg)
        self._evident_mg, self._expected_mg, self._quiet_s = known.filter.mass_mg, 0.0, 0.0

    def _is_barren(self, dt_s: float) -> bool:
        estimate = self._known.filter
        self._barren_s += dt_s
        if estimate.mass_mg - self._barren_mg > max(0.5, 3.0 * estimate.mass_sd_mg):
            self._barren_s, self._barren_mg = 0.0, estimate.mass_mg
        return self._barren_s > LONGEST_BARREN_S

    def _is_dry(self) -> bool:
        """Shaken for long at the widest opening, and next to nothing came."""
        widest = self._opening_mm >= self._known.request.max_opening_mm
        little = self._known.filter.mass_mg - self._evident_mg < DRY_MG
        return widest and little and self._quiet_s > 6.0 * self._patience_s

    # --- is powder coming? ---

    @property
    def _patience_s(self) -> float:
        return 0.8 + 2.0 * self._known.lag_s

    def _look_for_flow(self, dt_s: float, phi_s: float) -> None:
        """How long powder has been seen to come, or not to come."""
        known, estimate = self._known, self._known.filter
        self._expected_mg += known.reference * phi_s
        if estimate.mass_mg - self._evident_mg > QUIET_SHARE * self._expected_mg + 2.0 * known.noise_mg:
            self._evident_mg, self._expected_mg, self._quiet_s = estimate.mass_mg, 0.0, 0.0
            self._flowing_s += dt_s
            known.reopened = 0
            known.follow_reference()
            return
        if self._quiet_s == 0.0:
            known.follow_reference()
        unseen_mg = known.reference * known.shape.value(known.valve.opening_mm) * (0.6 + 2.0 * known.lag_s)
        if self._expected_mg > 3.0 * estimate.surge_mg + unseen_mg:
            self._quiet_s, self._flowing_s = self._quiet_s + dt_s, 0.0

    # --- what next ---

    def _steer(self) -> None:
        """The next opening and vibration."""
        known = self._known
        if self._is_spared:
            self._vibration = 0.0
        wanted_mm = self._opening_mm if self._probing else known.opening_mm(self._remaining_mg)
        if self._quiet_s > 0.0:
            wanted_mm = self._opening_mm if self._is_spared else self._coax(wanted_mm)
        elif self._vibration > known.vibration and self._flowing_s > 1.0 and known.stalls < MOST_STALLS:
            self._vibration = known.vibration
        if known.stalls >= MOST_STALLS:
            known.vibration = max(known.vibration, GENTLE)
        self._set_opening(wanted_mm)

    def _coax(self, wanted_mm: float) -> float:
        """Nothing comes: shake; only after long shaking doubt what was believed, and open wider."""
        known, patience_s = self._known, self._patience_s
        level = max(known.vibration, FULL if self._quiet_s > patience_s else GENTLE)
        if level > self._vibration:
            known.stalls += self._vibration == 0.0
            known.expect_best()
            wanted_mm, self._vibration = known.opening_mm(self._remaining_mg), level
        widest = self._opening_mm >= known.request.max_opening_mm
        little = known.filter.mass_mg - self._evident_mg < DRY_MG
        if self._quiet_s > 2.0 * patience_s and not (widest and little):
            known.reference *= 0.97
            return min(known.request.max_opening_mm, self._opening_mm * 1.02)
        return min(wanted_mm, self._opening_mm)

    def _set_opening(self, wanted_mm: float) -> None:
        self._known.note_change(self._opening_mm, wanted_mm)
        self._opening_mm = wanted_mm

    # --- lumps, one by one ---

    def _takes_lumps_singly(self) -> bool:
        surge_mg = self._known.filter.surge_mg
        lumpy = self._known.flows_only_shaken and surge_mg > LUMPY_MG
        return not self._probing and lumpy and self._remaining_mg < LUMPS_LEFT * surge_mg + 1.0

    def _listen(self) -> Generator[Command, Observation, None]:
        """A powder of the first time, no longer shaken: once the balance has followed, does it still come?"""
        known, period_s = self._known, self._known.request.balance_period_s
        self._listened = True
        slow_mm = known.shape.opening_mm(LISTEN_MG_PER_LAG / known.lag_s / known.likely_coefficient)
        self._set_opening(min(self._opening_mm, slow_mm))
        looks = max(4, round(LISTEN_LAGS * known.lag_s / period_s))
        for _ in range(2 * looks):
            yield from known.act(self._opening_mm, 0.0, PAUSED)
        before_mg, expected_mg = known.record[-1].reading_mg, 0.0
        for _ in range(looks):
            _, phi_s, _ = yield from known.act(self._opening_mm, 0.0, PAUSED)
            expected_mg += known.likely_coefficient * phi_s / PAUSED
        gained_mg = known.record[-1].reading_mg - before_mg
        if gained_mg > max(STILL_COMES * expected_mg, SURPRISE * known.noise_mg):
            known.pauses = False
            flow = gained_mg / (looks * period_s)
            known.filter.restart(
                known.record[-1].reading_mg + 2.0 * known.lag_s * flow, 0.3, known.reference, known.unsure
            )

    def _shake_and_look(self) -> Generator[Command, Observation, None]:
        """A short shake, then a look without it; with the valve shut, if powder comes unshaken too."""
        known, period_s = self._known, self._known.request.balance_period_s
        shakes = max(1, round(SHAKE_S / period_s))
        share_mg = SHAKE_SHARE * max(known.filter.surge_mg, self._remaining_mg / SHAKE_LUMPS)
        flow = share_mg / (shakes * period_s)
        wanted_mm = known.shape.opening_mm(flow / known.likely_coefficient)
        self._set_opening(min(wanted_mm, known.request.max_opening_mm))
        level = max(self._vibration, known.vibration)
        for _ in range(shakes):
            yield from known.act(self._opening_mm, level)
        known.shaken_s += shakes * period_s
        known.flow_s += shakes * period_s
        look_mm, mobility = (self._opening_mm, PAUSED) if known.pauses else (0.0, 1.0)
        for _ in range(max(2, round((2.0 * known.lag_s + SLACK_S) / period_s))):
            yield from known.act(look_mm, 0.0, mobility)
