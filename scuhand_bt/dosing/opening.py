"""One opening while it lasts: how wide the valve is, and why it should shut (docs/dosing.md, One opening).

The width is the smallest of what the constraint allows, of the beginning width until a stuck sheet would have been
noticed (`unseen.begins_mm`), and of the last width while no powder is seen to come. A lump is shaken out of a width
that should bring its share.
"""

import math
from typing import Literal

from scuhand_bt.dosing.constraint import RISK
from scuhand_bt.dosing.knowledge import RISEN, SURE, Knowledge
from scuhand_bt.dosing.unseen import begins_mm, hold_s, seen_s, sees_s

EVIDENT_S = 0.3
"""Powder seen within this time still comes."""
CONFIRMS = 0.75
"""Less than this share of what is expected is a weak flow, or a balance that was set slower (`weak`)."""
PAUSED_S = 0.5
"""After a pause longer than this and the delay, powder may have been let out all the while."""
QUIET_S, MOST_QUIET_S = 0.8, 2.0
"""Nothing comes if nothing was seen for QUIET_S and the balance's delay, or MOST_QUIET_S of it (`quiet`)."""
FLOWS = 0.2
"""A flow of at least this share of its reference is what was expected."""
ALARM = 1.3
"""Near the target, a flow surely so many times the expected one shuts the valve: the sheet slipped (`surprise`)."""
SURPRISE = 5.0
"""So does a reading this many standard deviations above its prediction."""
SHAKE_S = 0.8
"""Time in which an opening should bring a lump's share."""

Seen = Literal["reached", "near", "surprise", "fear", "weak", "missing", "quiet", "lump"]
"""Why an opening should shut, by what was seen (docs/dosing.md, Why an opening shuts)."""


class Opening:
    """An opening, from the command to open until it should shut."""

    def __init__(self, known: Knowledge, most_mg: float, lump_mg: float) -> None:
        """`most_mg`: the limit of the constraint. `lump_mg`: a lump's share, 0 unless lumps are shaken out singly."""
        self._known, self._most_mg, self._lump_mg = known, most_mg, lump_mg
        self._first_reference = known.reference
        self._begins_mm = begins_mm(known, most_mg - known.bank.mass_mg)
        # A lump cannot be let out in part, so the constraint does not narrow its opening.
        shaken_mm = max(known.shape.opening_mm(lump_mg / known.reference / SHAKE_S), known.least_mm)
        self._shaken_mm = min(shaken_mm, known.request.max_opening_mm)
        self._opening_mm = math.inf
        self._stuck_seen_s, self._came_s = known.time_s + seen_s(known), math.inf
        self._passed_s = 0.0
        """The integral of phi so far."""
        self._last = 0.0, known.bank.mass_mg, known.begin_mg
        """At the last sight of powder: the integral of phi, the mass that had left, and the reading."""
        self._quiet_s = self._missing_mg = 0.0
        """Time without a sight of powder; what should have come in earlier such times."""
        self._confirmed = 0.0, 0.0
        """The integral of phi and the mass when as much was last seen as should have come."""
        self._doubted_s = 0.0

    def width_mm(self) -> float:
        """The valve's opening until the next reading."""
        known = self._known
        wanted_mm = self._shaken_mm if self._lump_mg else known.widest_mm(self._most_mg)
        # Powder that does not come is no reason to open wider: it may come at any moment.
        comes = self._last[0] > 0.0 and self._quiet_s <= EVIDENT_S
        self._opening_mm = wanted_mm if comes else min(wanted_mm, self._opening_mm)
        # Powder that begins late shows neither fault before it is seen.
        may_stick = not self._lump_mg and known.time_s < max(self._stuck_seen_s, self._came_s + sees_s(known))
        return min(self._opening_mm, self._begins_mm) if may_stick else self._opening_mm

    def hold_s(self, width_mm: float) -> float:
        """How long to stay so wide; until the next reading where lumps are shaken out."""
        return self._known.until_next_s if self._lump_mg else hold_s(self._known, width_mm, self._most_mg)

    def see(self, score: float, *, is_first: bool) -> Seen | None:
        """Why to shut after a reading whose innovation is `score` standard deviations; None to stay open.

        `is_first`: the dose's first powder, which may show a balance that was set slower.
        """
        self._passed_s += self._known.rows[-1].phi_s
        if score > SURPRISE or self._is_too_strong():
            return "surprise"
        return self._enough() or self._lacks(is_first)

    def _is_too_strong(self) -> bool:
        known, bank = self._known, self._known.bank
        tail, _ = known.valve.closing(known.request.balance_period_s + bank.delay_s)
        unseen_mg = bank.coefficient * tail  # what flows before it is seen, and until the valve is shut
        if 2.0 * unseen_mg <= self._most_mg - bank.mass_mg:
            return False
        return bank.coefficient - SURE * bank.coefficient_sd > ALARM * self._first_reference

    def _enough(self) -> Seen | None:
        """Whether to shut by what is predicted, shut now or at the next reading."""
        known, bank, period_s = self._known, self._known.bank, self._known.request.balance_period_s
        shut_mg, _ = bank.over_all(*bank.coming(*known.valve.closing(period_s / 2.0)))
        if shut_mg >= known.aim_mg:
            return "reached"
        if known.hurries and shut_mg >= known.aim_mg - known.near_mg:
            return "near"
        if not self._lump_mg and bank.chance(*known.valve.closing(period_s), self._most_mg) > RISK:
            return "fear"
        return None

    def _lacks(self, is_first: bool) -> Seen | None:
        """Whether to shut for powder that should have come and was not seen."""
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
        """Note whether as much has come as should have, from the first powder on."""
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
        """Note whether powder still comes."""
        known, row, (last_s, last_mg, _) = self._known, self._known.rows[-1], self._last
        came_mg, expected_mg = known.bank.mass_mg - last_mg, known.reference * (self._passed_s - last_s)
        if has_risen and came_mg > FLOWS * expected_mg:
            if self._quiet_s > known.bank.delay_s + PAUSED_S:
                self._missing_mg += max(0.0, expected_mg - came_mg)
            self._last, self._quiet_s = (self._passed_s, known.bank.mass_mg, row.reading_mg), 0.0
            known.follow()
        elif known.time_s >= self._stuck_seen_s or self._opening_mm <= self._begins_mm:
            self._quiet_s += row.dt_s
