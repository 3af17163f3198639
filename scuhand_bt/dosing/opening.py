"""One opening while it lasts: how wide the valve is to be, and what of its powder has been seen.

* It begins so narrow that the sheet may stick and it is seen in time (`unseen.begins_mm`).
* It is as wide as the chance constraint allows (`constraint`), narrower as the target comes near; a lump is shaken out
  of a width that should bring its share.
* It is never widened while nothing is seen to come.
"""

import math
from typing import Literal

from scuhand_bt.dosing.constraint import RISK
from scuhand_bt.dosing.knowledge import NEAR_MG, RISEN, SURE, Knowledge
from scuhand_bt.dosing.unseen import begins_mm, hold_s, seen_s, sees_s

EVIDENT_S = 0.3
"""What has come no later than this ago still comes."""
CONFIRMS = 0.75
"""Of what should have come: less, until it should be seen, is a weak flow, or a balance that was set slower."""
PAUSED_S = 0.5
"""Powder that comes again after so long, and the delay, may have been let out all the while."""
QUIET_S, MOST_QUIET_S = 0.8, 2.0
"""Nothing has come for so long, and for the balance's delay, or so much of it: nothing comes."""
FLOWS = 0.2
"""Of its reference: a flow that is at least this strong is what was expected."""
ALARM = 1.3
"""A flow that is surely so many times the expected one, near the target, shuts the valve: the sheet has slipped."""
SURPRISE = 5.0
"""A reading so many standard deviations above prediction shuts the valve."""
SHAKE_S = 0.8
"""A lump's share is shaken out by an opening that should bring it in such a time."""

Seen = Literal["reached", "near", "surprise", "fear", "weak", "missing", "quiet", "lump"]
"""Why an opening should shut, by what was seen."""


class Opening:
    """From the command to open until what is seen says that it should shut."""

    def __init__(self, known: Knowledge, most_mg: float, lump_mg: float) -> None:
        """`most_mg`: no more is to have left in the end. `lump_mg`: a lump's share, 0 where none is shaken for."""
        self._known, self._most_mg, self._lump_mg = known, most_mg, lump_mg
        self._first_reference = known.reference
        self._begins_mm = begins_mm(known, most_mg - known.bank.mass_mg)
        # A lump cannot be let out in part: where it is shaken for, it may come.
        shaken_mm = max(known.shape.opening_mm(lump_mg / known.reference / SHAKE_S), known.least_mm)
        self._shaken_mm = min(shaken_mm, known.request.max_opening_mm)
        self._opening_mm = math.inf
        self._stuck_seen_s, self._came_s = known.time_s + seen_s(known), math.inf
        self._passed_s = 0.0
        """The integral of phi."""
        self._last = 0.0, known.bank.mass_mg, known.begin_mg
        """That, what had left, and the reading, when powder was seen to come last."""
        self._quiet_s = self._missing_mg = 0.0
        """So long nothing has been seen to come; what should have in such times before."""
        self._confirmed = 0.0, 0.0
        """The integral of phi and what had left when as much was seen as should have come."""
        self._doubted_s = 0.0

    def width_mm(self) -> float:
        """How wide the valve is to be until the next reading."""
        known = self._known
        wanted_mm = self._shaken_mm if self._lump_mg else known.widest_mm(self._most_mg)
        # What does not come yet, or no more, may come at any moment: no reason to open wider.
        comes = self._last[0] > 0.0 and self._quiet_s <= EVIDENT_S
        self._opening_mm = wanted_mm if comes else min(wanted_mm, self._opening_mm)
        # Of powder that begins to come late nothing can be seen yet.
        may_stick = not self._lump_mg and known.time_s < max(self._stuck_seen_s, self._came_s + sees_s(known))
        return min(self._opening_mm, self._begins_mm) if may_stick else self._opening_mm

    def hold_s(self, width_mm: float) -> float:
        """How long it is to stay so wide: until the next reading where a lump is waited for."""
        return self._known.until_next_s if self._lump_mg else hold_s(self._known, width_mm, self._most_mg)

    def see(self, score: float, *, is_first: bool) -> Seen | None:
        """Why to shut after a reading, of this innovation in standard deviations; None: stay open.

        `is_first`: no powder has come in this dose, and its first may show a balance that was set slower.
        """
        self._passed_s += self._known.rows[-1].phi_s
        if score > SURPRISE or self._is_too_strong():
            return "surprise"
        return self._enough() or self._lacks(is_first)

    def _is_too_strong(self) -> bool:
        known, bank = self._known, self._known.bank
        tail, _ = known.valve.closing(known.request.balance_period_s + bank.delay_s)
        unseen_mg = bank.coefficient * tail  # what flows while it cannot be seen yet, and until the valve is shut
        if 2.0 * unseen_mg <= self._most_mg - bank.mass_mg:
            return False
        return bank.coefficient - SURE * bank.coefficient_sd > ALARM * self._first_reference

    def _enough(self) -> Seen | None:
        """By what is predicted, if it is shut now, and by the next reading."""
        known, bank, period_s = self._known, self._known.bank, self._known.request.balance_period_s
        shut_mg, _ = bank.over_all(*bank.coming(*known.valve.closing(period_s / 2.0)))
        if shut_mg >= known.aim_mg:
            return "reached"
        if known.hurries and shut_mg >= known.aim_mg - NEAR_MG:
            return "near"
        if not self._lump_mg and bank.chance(*known.valve.closing(period_s), self._most_mg) > RISK:
            return "fear"
        return None

    def _lacks(self, is_first: bool) -> Seen | None:
        """By what should have come and was not seen."""
        known, delay_s = self._known, self._known.bank.delay_s
        has_risen = known.rows[-1].reading_mg - self._last[2] > RISEN * known.rows[-1].noise_mg
        self._confirm(has_risen)
        if is_first and self._came_s < math.inf and self._doubted_s > seen_s(known):
            return "weak"
        self._note(has_risen)
        last_s, last_mg, _ = self._last
        most_mg = max(last_mg + known.strongest * (self._passed_s - last_s), known.bank.mass_mg)
        if most_mg + self._missing_mg > self._most_mg:
            return "missing"
        if self._quiet_s > max(QUIET_S, sees_s(known)) + min(delay_s, MOST_QUIET_S):
            return "quiet"
        return "lump" if 0.0 < self._lump_mg < known.reference * self._passed_s else None

    def _confirm(self, has_risen: bool) -> None:
        """Whether as much has come as should have; not before the first has."""
        known, (confirmed_s, confirmed_mg) = self._known, self._confirmed
        is_new = has_risen and math.isinf(self._came_s)
        if is_new:
            self._came_s = known.time_s
        expected_mg = known.reference * (self._passed_s - confirmed_s)
        if is_new or known.bank.mass_mg - confirmed_mg > CONFIRMS * expected_mg:
            self._confirmed, self._doubted_s = (self._passed_s, known.bank.mass_mg), 0.0
        else:
            self._doubted_s += known.rows[-1].dt_s

    def _note(self, has_risen: bool) -> None:
        """Whether powder still comes."""
        known, row, (last_s, last_mg, _) = self._known, self._known.rows[-1], self._last
        came_mg, expected_mg = known.bank.mass_mg - last_mg, known.reference * (self._passed_s - last_s)
        if has_risen and came_mg > FLOWS * expected_mg:
            if self._quiet_s > known.bank.delay_s + PAUSED_S:
                self._missing_mg += max(0.0, expected_mg - came_mg)
            self._last, self._quiet_s = (self._passed_s, known.bank.mass_mg, row.reading_mg), 0.0
            known.follow()
        elif known.time_s >= self._stuck_seen_s or self._opening_mm <= self._begins_mm:
            self._quiet_s += row.dt_s
