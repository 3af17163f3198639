"""Controller `adaptive`, the default: one dose, opening by opening (docs/dosing.md, The policy).

Each opening (`opening`) shuts on the predicted final mass, or on one of the reasons of docs/dosing.md. A look with the
valve shut follows, until a stable mean is in tolerance or the load has given out. Where an opening brought nothing, the
next is tried again, then shaken gently, then fully (`shaking`). Only an opening in vain that was fully shaken makes the
controller believe in less flow, and so open wider.
"""

from collections.abc import Generator
from dataclasses import replace
from typing import Literal

import numpy as np

from scuhand_bt.dosing.controller import (
    LONGEST_UNWEIGHED_S,
    Command,
    DoseRequest,
    Doubt,
    Finish,
    Observation,
    Reason,
    Stream,
    Weigh,
)
from scuhand_bt.dosing.knowledge import Knowledge
from scuhand_bt.dosing.opening import SURPRISE, Opening, Seen
from scuhand_bt.dosing.pulses import pulses
from scuhand_bt.dosing.shaking import FAR_MG, FULL, shaken

MOST_OPENINGS = 200
"""Most openings of a dose."""
LOOKED, LOOKED_SD_MG, LEAST_SD_MG = 3, 0.3, 0.05
"""After a look, the mass is the mean of LOOKED readings, known to LOOKED_SD_MG; by a stable mean, to LEAST_SD_MG."""
LISTENED = 12
"""Readings from which an unknown balance's noise is learnt."""
PROBE_MG = 40.0
"""The most that one opening lets out onto an unknown balance."""
CAME_SHARE, CAME_MG, CAME_NOISES = 0.2, 20.0, 4.0
"""An opening was in vain unless it brought this share of what was expected (of at most CAME_MG), and more than
CAME_NOISES standard deviations of a reading."""
COMES_MG, COMES = 1.0, 3.0
"""Powder has come if M grew by at least COMES_MG and by COMES standard deviations."""
SLOW_SHARE = 0.5
"""An opening that brought less than this share of what was missing was too narrow."""
LUMPY_MG, LUMPS_LEFT, LUMP_SHARE, LAST_LUMPS = 0.7, 3.0, 0.12, 1.5
"""Lumps of more than LUMPY_MG are shaken out singly over the last LUMPS_LEFT of them. Each opening should then bring
LUMP_SHARE of a lump, or of what is missing over LAST_LUMPS if that is more."""
LUMPS_MISSED = 2.5
"""An opening through which so many lumps should have come, and none has, is too narrow for any."""
REST_MG = 0.3
"""A look ends when no more than this, and twice the noise, is unseen."""
LONGEST_LOOK_S = 25.0
DOUBTFUL_MG = 1.0
"""A stable mean may differ from what was expected by this much besides chance: powder drips."""
AGAIN_S = 3.0
"""A surprising stable mean is taken again after this."""
LONGEST_DOUBT_S = 120.0
"""After this long, surprising means come from an unsteady zero, and the last one counts."""
LEFT_MG = 1.0
"""With more than this missing to the aim, no stable mean is taken yet."""
PRIMES_S = 10.0
"""A fresh load may give nothing for so long, open and fully shaken, without a weaker flow to be concluded."""
LAST_MG = 500.0
"""With less than this missing, the rest of a load is left for a fresh one: shaken, it flows several times as fast,
which is seen late."""
RESTS_SHARE = 0.2
"""Share of a load. With more in the cone, powder that stops coming is the rest of a load; with less, the load's end is
near and tells how large it was."""
FLOWED_SHARE = 1 / 3
"""Share of a load that must have come; before that, a bridge is likelier than a rest."""
EMPTY_S, DRY_S = 8.0, 60.0
"""Time open and fully shaken without powder until a load is given up: a cone that is all but empty, and any other."""
SCOOPED_ANEW_S = 3.0
"""The same where less is in the cone than is missing, so that it must be scooped for anyway."""

Ended = Seen | Literal["dry", "long"]
"""Why an opening ended."""


class Adaptive:
    """The default controller."""

    name = "adaptive"

    def __init__(self, request: DoseRequest) -> None:
        self._known = Knowledge(request)
        self._steps = self._stream() if request.streaming else pulses(self._known)
        self._start_mg = self._weighed_s = 0.0
        """The first reading of the dose; the time of the last stable mean."""
        self._vibration = request.powder.vibration
        self._barren_s = self._barren_mg = 0.0
        """Time open and fully shaken without powder; the mass when powder last came, or when this opening began."""
        self._fruitless = 0
        """Openings in vain in a row."""
        self._has_come = False
        """Whether any opening has brought powder."""
        self._flowed_mg: float | None = None
        """The mass after the last opening that brought powder without extra shaking."""

    @property
    def estimate_mg(self) -> float:
        return self._known.bank.mass_mg

    def decide(self, seen: Observation | None) -> Command:
        try:
            return next(self._steps) if seen is None else self._steps.send(seen)
        except StopIteration as end:
            finish: Finish = end.value
            if self._flowed_mg is None:
                return finish
            return replace(finish, shaken_mg=max(0.0, finish.estimate_mg - self._flowed_mg))

    def _stream(self) -> Generator[Command, Observation, Finish]:
        known = self._known
        seen = yield Stream(0.0)
        self._weighed_s = known.time_s = seen.time_s
        self._start_mg = seen.net_mg
        if not known.knows_balance:
            for _ in range(LISTENED):
                yield from known.act(0.0, 0.0)
        known.begin(seen.net_mg, 2.0 * known.noise.quiet_mg)
        for _ in range(MOST_OPENINGS):
            ended = yield from self._open()
            predicted_mg, sd_mg = known.predicted()
            yield from self._look(REST_MG)
            if predicted_mg - known.begin_mg > COMES_MG:
                known.judge_prediction(predicted_mg, sd_mg)
            gave_out = self._gave_out(ebbs=self._take_in(ended))
            if gave_out is None and known.bank.mass_mg < known.aim_mg - LEFT_MG and ended not in ("reached", "long"):
                known.begin(float(np.mean([row.reading_mg for row in known.rows[-LOOKED:]])), LOOKED_SD_MG)
                continue
            seen = yield from self._weigh()
            known.begin(seen.net_mg, max(seen.uncertainty_mg, LEAST_SD_MG))
            verdict = known.verdict(seen) or gave_out
            if verdict is not None:
                return known.finish(verdict, seen)
        return known.finish("step_limit", seen)

    def _take_in(self, ended: Ended) -> bool:
        """Learn from an opening and its look; returns whether next to nothing came, by the flow seen in this dose."""
        known = self._known
        gained_mg = known.bank.mass_mg - known.begin_mg
        # An all but empty cone must bring powder while it is open: else a fresh load is sooner.
        if self._given_up != "empty":
            self._note_gain(CAME_SHARE * CAME_MG if known.room_mg > FAR_MG else COMES_MG)
        phi_s = sum(row.phi_s for row in known.rows)
        should_mg = known.seen_now * phi_s if self._has_come else 0.0
        ebbs = should_mg > CAME_MG and gained_mg < CAME_SHARE * should_mg and not self._is_lumpy
        expected_mg = known.reference * phi_s
        came = gained_mg > max(CAME_SHARE * min(expected_mg, CAME_MG), CAME_NOISES * known.noise.quiet_mg)
        self._has_come |= came
        if came and self._vibration <= known.belief.vibration:
            self._flowed_mg = known.bank.mass_mg
        if came or (self._vibration >= FULL and (self._has_come or self._barren_s > PRIMES_S)):
            known.learn(gained_mg)
        # Lumps come by chance: only after several openings in vain is the width too small for them.
        little = gained_mg < SLOW_SHARE * (known.aim_mg - known.begin_mg)
        enough = LUMPS_MISSED / LUMP_SHARE if self._lump_mg() else 2
        in_vain = not came and self._fruitless >= enough if self._is_lumpy else little
        if ended in ("quiet", "fear", "missing", "lump") and in_vain:
            known.little_came()
        self._shake(came)
        return ebbs

    def _weigh(self) -> Generator[Command, Observation, Observation]:
        """A stable mean; taken again, and the balance doubted, while it is far from what the readings predicted."""
        known = self._known
        yield from self._look(0.0)
        expected_mg, sd_mg = known.bank.mass_mg, known.bank.mass_sd_mg
        seen = yield Weigh()
        end_s = seen.time_s + LONGEST_DOUBT_S
        while abs(seen.net_mg - expected_mg) > (allowed_mg := SURPRISE * sd_mg + DOUBTFUL_MG) and seen.time_s < end_s:
            known.doubt_balance(Doubt(seen.net_mg - expected_mg, allowed_mg))
            expected_mg, sd_mg = seen.net_mg, seen.uncertainty_mg
            seen = yield Weigh(AGAIN_S)
        self._weighed_s = known.time_s = seen.time_s
        known.uncertainty_mg = max(known.uncertainty_mg, seen.uncertainty_mg)
        return seen

    def _gave_out(self, *, ebbs: bool = False) -> Reason | None:
        """Why the dose does not go on from this load; None if it does. `ebbs`: an opening brought next to nothing."""
        request, room_mg = self._known.request, self._known.room_mg
        came_mg, load_mg = request.came_mg + self._dosed_mg, request.came_mg + request.cone_mg
        may_scoop = request.may_scoop_again and came_mg > FLOWED_SHARE * load_mg
        is_empty = self._given_up == "empty"
        dry_s = EMPTY_S if is_empty or (may_scoop and room_mg > FAR_MG) else DRY_S
        # Not for lumps: so short a bridge would pass for the end, with more than half of the load behind it.
        if is_empty and self._has_come and not self._is_lumpy:
            dry_s = SCOOPED_ANEW_S if room_mg > max(request.cone_mg - self._dosed_mg, FAR_MG) else dry_s
        if self._barren_s > dry_s:
            return self._given_up
        comes_only_shaken = self._vibration > request.powder.vibration or ebbs
        # A fresh load brings as much as this one has brought so far sooner than this one does when it is shaken.
        fresh_mg = max(LAST_MG, came_mg) if is_empty and came_mg < (1.0 - RESTS_SHARE) * load_mg else LAST_MG
        return "rest" if may_scoop and comes_only_shaken and room_mg < fresh_mg else None

    @property
    def _given_up(self) -> Reason:
        return self._known.request.given_up(self._dosed_mg)

    @property
    def _dosed_mg(self) -> float:
        return self._known.bank.mass_mg - self._start_mg

    @property
    def _is_lumpy(self) -> bool:
        return self._known.bank.surge_mg > LUMPY_MG

    def _look(self, rest_mg: float) -> Generator[Command, Observation, None]:
        """Wait with the valve shut until the balance has shown all but `rest_mg`."""
        known, begin_s = self._known, self._known.time_s
        while known.time_s - begin_s <= LONGEST_LOOK_S:
            yield from known.act(0.0, 0.0)
            shut = known.valve.opening_mm == 0.0
            if shut and not known.is_rising and known.bank.unseen_mg < rest_mg + 2.0 * known.noise.quiet_mg:
                return

    def _open(self) -> Generator[Command, Observation, Ended]:
        """One opening, until it should shut; returns why."""
        known, bank = self._known, self._known.bank
        if known.aim_mg <= bank.mass_mg:
            return "reached"
        most_mg = known.most_mg if known.knows_balance else min(known.most_mg, bank.mass_mg + PROBE_MG)
        opening = Opening(known, most_mg, self._lump_mg())
        # Farther away, or where a fresh load is sooner, each opening has to bring powder by itself.
        is_far = known.room_mg > FAR_MG or self._given_up == "empty"
        self._barren_mg = bank.mass_mg if is_far else min(self._barren_mg, bank.mass_mg)
        while True:
            hold_s = opening.hold_s(width_mm := opening.width_mm())
            score = yield from known.act(width_mm, self._vibration, hold_s)
            may_be_slower = not self._has_come and not self._is_lumpy and most_mg - bank.mass_mg > FAR_MG
            if (seen := opening.see(score, is_first=may_be_slower)) is not None:
                return seen
            if self._vibration >= FULL:
                self._barren_s += min(known.rows[-1].dt_s, hold_s)
            self._note_gain(COMES_MG)
            if self._gave_out() is not None:
                return "dry"
            if known.time_s - self._weighed_s > LONGEST_UNWEIGHED_S:
                return "long"

    def _note_gain(self, least_mg: float) -> None:
        """Note whether powder has come.

        After short openings, or on a slow balance, most is seen once the valve is shut.
        """
        bank = self._known.bank
        gained_mg = bank.mass_mg - self._barren_mg
        if gained_mg > least_mg and gained_mg > COMES * bank.mass_sd_mg:
            self._barren_s, self._barren_mg = 0.0, bank.mass_mg

    def _lump_mg(self) -> float:
        """What an opening should bring where lumps are shaken out singly; 0 elsewhere."""
        known = self._known
        surge_mg, left_mg = known.bank.surge_mg, known.aim_mg - known.bank.mass_mg
        if not self._is_lumpy or left_mg > LUMPS_LEFT * surge_mg + 1.0:
            return 0.0
        return LUMP_SHARE * max(surge_mg, left_mg / LAST_LUMPS)

    def _shake(self, came: bool) -> None:
        self._fruitless = 0 if came else self._fruitless + 1
        level = shaken(self._fruitless, self._known.room_mg, has_come=self._has_come)
        self._vibration = max(self._known.belief.vibration, level)
