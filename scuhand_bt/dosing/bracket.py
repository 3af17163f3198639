"""What a container has gained, by weighings that bracket it, with the uncertainty of that.

A dose is the difference of two weighings with the hand in place and the valve shut, less the drift between them:

    D = g1 - g0 - r T,      u(D)^2 = u0^2 + u1^2 + w^2 T + (T u(r))^2

g gross [mg], T the time between them [s], r the drift's rate [mg/s] as it was before and after the dose and whenever it
was interrupted, w the random walk of the zero [mg/s^0.5]. What the container has gained is told once more when it has
gone, by the bare pan before and after it (A-B-A, as for mass standards: OIML R 111-1, C.5; NIST SOP 4):

    N = (l1 - a1) - (l0 - a0)

a bare pan, l loaded pan, the hand away. D and N share no weighing: a zero that steps between g0 and g1 is in D alone;
one that steps between a and l, and what drips after g1, is in N alone. They are adjusted to each other by least
squares; where they are farther apart than chance, neither is believed. A force that grows with the container, and goes
with it, is in N though the drift in D tells of it: N is no surer than what was taken out of D and the bare pan does not
show, and nothing that is adjusted is surer than that drift.

A zero that steps between g0 and g1 and back between l1 and a1 is in both alike, as is one that steps between a0 and l0
and back in the dose: no weighing of that container tells. That there are such steps is told by those that are seen,
and the largest of them tells how large the others may be: it enters u of every dose of the run.

The budget of u has these terms: readability and repeatability (in the u of each weighing), drift (r), zero (w).
Eccentricity drops out of the differences: the container does not move between g0 and g1, nor the carousel's places.
The balance's sensitivity is the check weight's business (`check_weight`). Air's buoyancy is not corrected: masses are
conventional ones, 0.03 % (2.5 g/cm3) to 0.06 % (1.6 g/cm3) less than mass (OIML D 28).
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from scuhand_bt.dosing.controller import LONGEST_UNWEIGHED_S

AGREEMENT = 4.0
"""Standard deviations of their difference by which two results of one thing may be apart: by chance 1 in 16 000 are."""
HARDLY, RARELY, SURELY = 2.0, 2.5, 3.0
"""Standard deviations of a drift: by chance 1 in 20, 1 in 80, and 1 in 400 are farther from none."""
SOUND_DIGITS_PER_S = 0.05
"""A sound balance that has warmed up drifts no faster (standard deviation), in digits: 3 in a minute. One that does is
seen by A-B-A: the drift is in D and N with opposite signs."""
SPAN_SHARE = 1e-5
"""By how much a balance's span may differ (standard deviation) before and after it was off: 2 ppm/K over 5 K."""
WATCHED_SHARE = 0.25
"""Of the tolerance: the pan is watched after a dose until the drift in it is known to this."""
SHORTEST_WATCH_S, LONGEST_WATCH_S = 0.5, 8.0
HIDES_S = LONGEST_UNWEIGHED_S + LONGEST_WATCH_S
"""From one look at the drift of a dose to the end of the next."""
FELL_READINGS = 5
"""A lump that lands weighs more for a moment; a median of so many readings does not show it."""
ADJUSTED = 1.5
"""Beside the guard band of two standard uncertainties, a dose leaves room for being adjusted by one of them."""
WALK_DIGITS = 1.0
"""Random walk of a sound balance's zero: standard deviation after a minute, in digits."""


@dataclass(frozen=True, slots=True)
class Gross:
    """The gross mass at a time: a stable mean with its standard uncertainty."""

    gross_mg: float
    uncertainty_mg: float
    time_s: float


@dataclass(frozen=True, slots=True)
class Drift:
    """The rate [mg/s] at which readings change while nothing falls, and its standard uncertainty."""

    rate: float
    uncertainty: float
    is_doubted: bool = False
    """Chance would rarely have made what was seen, and nothing is taken out for it."""


@dataclass(frozen=True, slots=True)
class Net:
    """A mass gained, with its standard uncertainty."""

    mass_mg: float
    uncertainty_mg: float


def walk_mg(readability_mg: float, duration_s: float) -> float:
    """How far a sound balance's zero may have wandered (standard deviation)."""
    return WALK_DIGITS * readability_mg * math.sqrt(max(0.0, duration_s) / 60.0)


def apart_mg(before: Gross, after: Gross, readability_mg: float) -> float:
    """The standard deviation of the difference of two weighings of one thing."""
    walked_mg = walk_mg(readability_mg, after.time_s - before.time_s)
    return math.hypot(before.uncertainty_mg, after.uncertainty_mg, walked_mg)


def moved_mg(before: Gross, after: Gross, readability_mg: float) -> float:
    """By how much two weighings of one thing differ; 0 within chance. The zero has moved, or something has come."""
    difference_mg = after.gross_mg - before.gross_mg
    return difference_mg if abs(difference_mg) > AGREEMENT * apart_mg(before, after, readability_mg) else 0.0


def together(first: Gross, again: Gross) -> Gross:
    """Two weighings of one thing as one, midway between them: a steady drift is in it as it was then."""
    u_mg = math.hypot(first.uncertainty_mg, again.uncertainty_mg) / 2.0
    return Gross((first.gross_mg + again.gross_mg) / 2.0, u_mg, (first.time_s + again.time_s) / 2.0)


def settled_from(looks: Sequence[Gross], readability_mg: float) -> Gross:
    """Which weighing of one thing, at like intervals, the last is to be held against for a drift.

    A filter that creeps after powder rises, and within an interval by less than half as much as in the one before. What
    falls, or rises on, is no filter, however much less it becomes: a zero that began to creep with the powder.
    """
    first = 0
    while first + 2 < len(looks):
        rose_mg = moved_mg(looks[first], looks[first + 1], readability_mg)
        if rose_mg <= 0.0 or looks[first + 2].gross_mg - looks[first + 1].gross_mg > 0.5 * rose_mg:
            break
        first += 1
    return looks[first]


def fallen_mg(readings_mg: Sequence[float]) -> float:
    """By how much readings fall while powder comes, and stay below: no powder leaves the pan, so it is the zero.

    The largest difference of two medians of `FELL_READINGS` readings, of which the first ends before the second begins.
    """
    if len(readings_mg) < 2 * FELL_READINGS:
        return 0.0
    medians_mg = np.median(sliding_window_view(np.asarray(readings_mg), FELL_READINGS), axis=1)
    highest_mg = np.maximum.accumulate(medians_mg)[:-FELL_READINGS]
    return max(0.0, float((highest_mg - medians_mg[FELL_READINGS:]).max()))


def rising_s(before: Gross, curve: Sequence[tuple[float, float]], after: Gross) -> float:
    """How long the gain between two weighings took from a fifth to four fifths, by medians of the readings in between.

    Where readings are missing it may have taken all that time.
    """
    half, times_s, medians_mg = FELL_READINGS // 2, np.empty(0), np.empty(0)
    if len(curve) >= FELL_READINGS:
        times_s, readings_mg = np.transpose(curve)
        times_s = times_s[half:-half]
        medians_mg = np.median(sliding_window_view(readings_mg, FELL_READINGS), axis=1)
    times_s = np.concatenate(([before.time_s], times_s, [after.time_s]))
    shares = (medians_mg - before.gross_mg) / (after.gross_mg - before.gross_mg)
    shares = np.concatenate(([0.0], shares, [1.0]))
    return float(times_s[np.flatnonzero(shares < 0.8)[-1] + 1] - times_s[(shares > 0.2).argmax() - 1])


def unseen_mg(stepped_mg: float, drift_mg_per_s: float, lasted_s: float) -> float:
    """What the largest step and drift that a run has seen add to the standard uncertainty of a dose that hides others.

    A drift that goes on for longer than `HIDES_S` shows when the dose is interrupted, and is in its own uncertainty.
    Each is a standard deviation by few observations: as for two degrees of freedom, 4.30 of it cover what 2 of a known
    one do (JCGM 100:2008, G.3).
    """
    return math.hypot(stepped_mg, drift_mg_per_s * min(lasted_s, HIDES_S)) * 4.30 / 2.0


def drift_between(before: Gross, after: Gross, readability_mg: float) -> Drift:
    """By two weighings of one thing at different times."""
    duration_s = after.time_s - before.time_s
    return Drift((after.gross_mg - before.gross_mg) / duration_s, apart_mg(before, after, readability_mg) / duration_s)


def is_hardly_chance(drift: Drift) -> bool:
    """Whether chance makes one drift in twenty as large as this."""
    return abs(drift.rate) > HARDLY * drift.uncertainty


def significant(drift: Drift, readability_mg: float) -> Drift:
    """A drift that may be chance is none; where chance would hardly make it, the balance is not taken for sound."""
    if abs(drift.rate) > SURELY * drift.uncertainty:
        return drift
    if is_hardly_chance(drift):
        return Drift(0.0, drift.uncertainty)
    return Drift(0.0, min(drift.uncertainty, SOUND_DIGITS_PER_S * readability_mg))


def drift_of_dose(seen: Sequence[Drift], parts_s: Sequence[float], readability_mg: float) -> Drift:
    """During a dose, by the drifts seen before it, at each time that it was interrupted, and after it.

    `parts_s` is how long each part between two of them was. In a part the drift is the weighted mean of those at its
    ends, where these agree. Where they do not, it began or ended in between, and may have been faster there than at
    either end: a creep that sets in when the valve opens is. A sum that is no more than chance is none. What was
    interrupted is judged by what was seen from then on: before the valve opened nothing could be known of such a creep;
    and a sum that chance would rarely make, though it might, is its doubt.
    """
    interrupted = len(seen) > 2
    moved_mg, coefficients_s, spread_mg = 0.0, [0.0] * len(seen), 0.0
    for part, duration_s in enumerate(parts_s):
        before, after = seen[part : part + 2]
        difference, chance = after.rate - before.rate, math.hypot(before.uncertainty, after.uncertainty)
        weight = after.uncertainty**2 / chance**2
        if interrupted and part == 0:
            weight = 0.0
        elif abs(difference) > SURELY * chance:
            weight, spread_mg = 0.5, math.hypot(spread_mg, difference * duration_s / math.sqrt(3.0))
        moved_mg += duration_s * (weight * before.rate + (1.0 - weight) * after.rate)
        coefficients_s[part] += duration_s * weight
        coefficients_s[part + 1] += duration_s * (1.0 - weight)
    chances_mg = (by_s * drift.uncertainty for by_s, drift in zip(coefficients_s, seen, strict=True))
    lasted_s = sum(parts_s)
    drift = Drift(moved_mg / lasted_s, math.hypot(spread_mg, *chances_mg) / lasted_s)
    if spread_mg > 0.0:
        return drift
    found = significant(drift, readability_mg)
    is_doubted = interrupted and found.rate == 0.0 and abs(drift.rate) > RARELY * drift.uncertainty
    return Drift(0.0, abs(drift.rate), is_doubted=True) if is_doubted else found


def watch_s(before: Gross, now: Gross, tolerance_mg: float) -> float:
    """How long the pan is to be watched after a dose, so that the drift in it is told to a part of the tolerance."""
    doubt_mg = math.hypot(before.uncertainty_mg, now.uncertainty_mg) * (now.time_s - before.time_s)
    return min(max(doubt_mg / (WATCHED_SHARE * tolerance_mg), SHORTEST_WATCH_S), LONGEST_WATCH_S)


def dose_between(weighed: Sequence[tuple[Gross, Gross]], readability_mg: float) -> tuple[Net, Drift]:
    """What came between the first pair of weighings and the last, and the drift that was taken out.

    Each pair weighs the same twice: before the dose, at each time that it was interrupted, and after it. A pair of one
    weighing tells no drift. A drift that is not significant is not taken out, as a zero that walks has none; its doubt
    stays.
    """
    pairs = [pair for pair in weighed if pair[0] != pair[1]]
    seen = [drift_between(*pair, readability_mg) for pair in pairs]
    if len(seen) > 1:
        parts_s = [after[1].time_s - before[1].time_s for before, after in pairwise(pairs)]
        drift = drift_of_dose(seen, parts_s, readability_mg)
    else:
        drift = significant(seen[0], readability_mg) if seen else Drift(0.0, SOUND_DIGITS_PER_S * readability_mg)
    before, later = weighed[0][1], weighed[-1][1]
    duration_s = later.time_s - before.time_s
    mass_mg = later.gross_mg - before.gross_mg
    u_mg = math.hypot(apart_mg(before, later, readability_mg), drift.uncertainty * duration_s)
    if drift.rate == 0.0:
        return Net(mass_mg, u_mg), drift
    # A weighing that the dose rests on is in the drift too: its error counts for both.
    shared, watched_s = (before if pairs[0] == weighed[0] else later), pairs[0][1].time_s - pairs[0][0].time_s
    twice_mg = shared.uncertainty_mg * math.sqrt(2.0 * duration_s / watched_s)
    return Net(mass_mg - drift.rate * duration_s, math.hypot(u_mg, twice_mg)), drift


def standing(bare: Gross, loaded: Gross, readability_mg: float) -> Net:
    """What stands on the pan, by the bare pan soon before it or after it; whatever the zero is."""
    first, last = sorted((bare, loaded), key=lambda weighing: weighing.time_s)
    drifted_mg = SOUND_DIGITS_PER_S * readability_mg * (last.time_s - first.time_s)
    return Net(loaded.gross_mg - bare.gross_mg, math.hypot(apart_mg(first, last, readability_mg), drifted_mg))


def differ_mg(first: Net, again: Net) -> tuple[float, float]:
    """By how much two results of one thing differ, and how far they may be apart by chance."""
    difference_mg = again.mass_mg - first.mass_mg
    return difference_mg, AGREEMENT * math.hypot(first.uncertainty_mg, again.uncertainty_mg)


def held(empty: Net, full: Sequence[Net]) -> Net:
    """What a container holds, by what it weighed empty, and what it weighs now: once, or about the bare pan (A-B-A).

    Between the two its balance may have been off, and have another zero, as each is a difference by itself; and a
    little other span, which counts with all of the container's mass. What the weighings of now differ by is a drift,
    or a loss, which may have been anywhere between them.
    """
    masses_mg = [one.mass_mg for one in full]
    drifted_mg = (max(masses_mg) - min(masses_mg)) / math.sqrt(12.0)
    span_mg = SPAN_SHARE * empty.mass_mg
    u_mg = math.hypot(empty.uncertainty_mg, max(one.uncertainty_mg for one in full), drifted_mg, span_mg)
    return Net(sum(masses_mg) / len(full) - empty.mass_mg, u_mg)


def total(nets: Iterable[Net]) -> Net:
    """The sum of what shares no weighing."""
    parts = list(nets)
    return Net(sum(one.mass_mg for one in parts), math.hypot(*(one.uncertainty_mg for one in parts)))


@dataclass(frozen=True, slots=True)
class Reference:
    """What a dose is weighed against, just before the valve opens: a net mass reads 0 at `zero_mg`."""

    before: Gross
    drift: Drift
    """Before the dose."""
    earlier: Net
    """What the same powder has brought into this container by earlier doses."""
    readability_mg: float
    later_mg: float = math.inf
    """Standard uncertainty of what the bare pan is going to tell once the container has gone; infinite if it is not."""

    @property
    def zero_mg(self) -> float:
        return self.before.gross_mg - self.earlier.mass_mg

    def uncertainty_mg(self, now: Gross) -> float:
        """The standard uncertainty to be expected in the end of a mass weighed now, by the drift before the dose."""
        drifted_mg = self.drift.uncertainty * (now.time_s - self.before.time_s)
        walked_mg = apart_mg(self.before, now, self.readability_mg)
        return self.in_the_end_mg(math.hypot(walked_mg, drifted_mg, self.earlier.uncertainty_mg), self.drift)

    def in_the_end_mg(self, uncertainty_mg: float, drift: Drift) -> float:
        """What is left of a dose's uncertainty when the container has gone, as `close` adjusts it, and room for that.

        A drift that was seen, or doubted, may grow with the container: its doubt is taken to stay.
        """
        if uncertainty_mg == 0.0 or drift.rate != 0.0 or drift.is_doubted:
            return uncertainty_mg
        return min(uncertainty_mg, ADJUSTED / math.hypot(1.0 / uncertainty_mg, 1.0 / self.later_mg))


def later_mg(bare: Gross, loaded: Gross, others: Iterable[Net], readability_mg: float) -> float:
    """The standard uncertainty to be expected of one dose by the bare pan, before the container has gone.

    As it came, so it is going to go: the weighings and the change are taken to be like those before its first dose. The
    `others` are the doses of other powders in it, which N tells of in one.
    """
    changing_s = 2.0 * (loaded.time_s - bare.time_s)
    weighed_mg = math.sqrt(2.0) * math.hypot(bare.uncertainty_mg, loaded.uncertainty_mg)
    drifted_mg = SOUND_DIGITS_PER_S * readability_mg * changing_s
    walked_mg = walk_mg(readability_mg, changing_s)
    return math.hypot(weighed_mg, walked_mg, drifted_mg, *(one.uncertainty_mg for one in others))


@dataclass(frozen=True, slots=True)
class Closed:
    """A bracket after its container has gone: the doses adjusted, and whether they may be believed."""

    doses: tuple[Net, ...]
    net: Net
    """N: what the container has gained by the bare pan."""
    zero_mg: float
    """How far the bare pan's reading has moved."""
    difference_mg: float
    """N less all doses."""
    allowance_mg: float
    """How far they may be apart."""
    stepped_mg: float
    """By how much the bare pan's reading has moved, less the drift; 0 where a sound zero walks as far."""

    @property
    def closes(self) -> bool:
        """A zero that has stepped may have done so at any moment, and twice: D and N then agree by chance."""
        return abs(self.difference_mg) <= self.allowance_mg and self.stepped_mg == 0.0


def close(
    doses: Sequence[Net],
    drifted: Sequence[Net],
    drift: Drift,
    bare_before: Gross,
    loaded_before: Gross,
    loaded_after: Gross,
    bare_after: Gross,
    readability_mg: float,
) -> Closed:
    """Hold the doses into a container against what it has gained by the bare pan.

    `drifted` is what was taken out of each dose as the drift's, `drift` the one seen about them. Where results differ
    by more than one standard deviation, the adjusted uncertainties grow by as much (the Birge ratio: Phys. Rev. 40,
    207, 1932).
    """
    weighings = (bare_before, loaded_before, loaded_after, bare_after)
    changing_s = (loaded_before.time_s - bare_before.time_s) + (bare_after.time_s - loaded_after.time_s)
    zero_mg = bare_after.gross_mg - bare_before.gross_mg
    net = Net(
        loaded_after.gross_mg - loaded_before.gross_mg - zero_mg + drift.rate * changing_s,
        math.hypot(
            *(one.uncertainty_mg for one in weighings),
            walk_mg(readability_mg, changing_s),
            drift.uncertainty * changing_s,
            _unshown_mg(sum(one.mass_mg for one in drifted), zero_mg),
        ),
    )
    difference_mg = net.mass_mg - sum(dose.mass_mg for dose in doses)
    variance = net.uncertainty_mg**2 + sum(dose.uncertainty_mg**2 for dose in doses)
    chance_mg = math.sqrt(variance)
    birge = max(1.0, abs(difference_mg) / chance_mg)
    adjusted = []
    for dose, taken_out in zip(doses, drifted, strict=True):
        share = dose.uncertainty_mg**2 / variance
        lasting_mg = min(taken_out.uncertainty_mg, dose.uncertainty_mg)
        own_mg = math.sqrt(dose.uncertainty_mg**2 - lasting_mg**2)
        u_mg = math.hypot(birge * own_mg * math.sqrt(1.0 - share), lasting_mg)
        adjusted.append(Net(dose.mass_mg + share * difference_mg, u_mg))
    lasted_s = bare_after.time_s - bare_before.time_s
    walked_mg = math.hypot(apart_mg(bare_before, bare_after, readability_mg), drift.uncertainty * lasted_s)
    steady_mg = zero_mg - drift.rate * lasted_s
    stepped_mg = steady_mg if abs(steady_mg) > AGREEMENT * walked_mg else 0.0
    return Closed(tuple(adjusted), net, zero_mg, difference_mg, AGREEMENT * chance_mg, stepped_mg)


def _unshown_mg(drifted_mg: float, zero_mg: float) -> float:
    """What was taken out of doses as a drift's and has not moved the bare pan: it came and went with the container."""
    shown_mg = min(max(zero_mg, min(drifted_mg, 0.0)), max(drifted_mg, 0.0))
    return drifted_mg - shown_mg
