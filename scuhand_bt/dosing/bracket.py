"""What a container has gained, by weighings that bracket it, with its uncertainty (docs/weighing.md).

**D, the dose**, between two weighings with the hand in place and the valve shut, less the drift between them:

    D = g1 - g0 - r T,      u(D)^2 = u0^2 + u1^2 + w^2 T + (T u(r))^2

g gross [mg], T the time between them [s], r the drift's rate [mg/s], w the random walk of the zero [mg/s^0.5].

**N, the bracket**, once the container has gone (A-B-A, as for mass standards: OIML R 111-1, C.5; NIST SOP 4):

    N = (l1 - a1) - (l0 - a0)

a bare pan, l loaded pan, the hand away. D and N share no weighing, and `close` combines them by least squares. Where
they differ by more than chance, neither is believed. A force that grows with the container, and goes with it, is in N.
So N is no surer than the drift that was subtracted from D and that the bare pan does not show.

One disturbance may be in D and N alike. The largest step that a run has seen tells how large such steps may be, and
enters u of every dose (`unseen_mg`). Masses are conventional ones (OIML D 28).
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from scuhand_bt.dosing.controller import LONGEST_UNWEIGHED_S

AGREEMENT = 4.0
"""Results of one thing agree within so many standard deviations of their difference; by chance 1 in 16 000 do not."""
HARDLY, RARELY, SURELY = 2.0, 2.5, 3.0
"""Limits of a drift that is chance, in its standard deviations, exceeded in 1 of 20, of 80 and of 400."""
SOUND_DIGITS_PER_S = 0.05
"""Standard deviation of the drift of a sound, warm balance: 3 digits a minute. A balance that drifts faster is found by
A-B-A, as the drift is in D and N with opposite signs."""
SPAN_SHARE = 1e-5
"""Standard deviation of a balance's span before and after it was off: 2 ppm/K over 5 K."""
WATCHED_SHARE = 0.25
"""Share of the tolerance to which the drift of a dose is to be known; the pan is watched for so long."""
SHORTEST_WATCH_S, LONGEST_WATCH_S = 0.5, 8.0
HIDES_S = LONGEST_UNWEIGHED_S + LONGEST_WATCH_S
"""From one look at the drift of a dose to the end of the next."""
FELL_READINGS = 5
"""Readings of a median; a lump that lands weighs more for a moment, which that does not show."""
ADJUSTED = 1.5
"""Room that a dose leaves for the adjustment of D, as a factor on the expected combined uncertainty."""
WALK_DIGITS = 1.0
"""Random walk of a sound balance's zero: standard deviation after a minute, in digits."""


@dataclass(frozen=True, slots=True)
class Gross:
    """A gross mass at a time: a stable mean with its standard uncertainty."""

    gross_mg: float
    uncertainty_mg: float
    time_s: float


@dataclass(frozen=True, slots=True)
class Drift:
    """The rate [mg/s] at which readings change while nothing falls, and its standard uncertainty."""

    rate: float
    uncertainty: float
    is_doubted: bool = False
    """Whether chance would rarely make what was seen, though nothing is subtracted for it."""


@dataclass(frozen=True, slots=True)
class Net:
    """A mass gained, with its standard uncertainty."""

    mass_mg: float
    uncertainty_mg: float


def walk_mg(readability_mg: float, duration_s: float) -> float:
    """How far a sound balance's zero may have wandered (standard deviation) [mg]."""
    return WALK_DIGITS * readability_mg * math.sqrt(max(0.0, duration_s) / 60.0)


def apart_mg(before: Gross, after: Gross, readability_mg: float) -> float:
    """Standard deviation of the difference of two weighings of one thing [mg]."""
    walked_mg = walk_mg(readability_mg, after.time_s - before.time_s)
    return math.hypot(before.uncertainty_mg, after.uncertainty_mg, walked_mg)


def moved_mg(before: Gross, after: Gross, readability_mg: float) -> float:
    """The difference of two weighings of one thing [mg]; 0 within chance.

    Else the zero has moved, or something has come.
    """
    difference_mg = after.gross_mg - before.gross_mg
    return difference_mg if abs(difference_mg) > AGREEMENT * apart_mg(before, after, readability_mg) else 0.0


def together(first: Gross, again: Gross) -> Gross:
    """Two weighings of one thing as one, midway between them, as a steady drift would have it."""
    u_mg = math.hypot(first.uncertainty_mg, again.uncertainty_mg) / 2.0
    return Gross((first.gross_mg + again.gross_mg) / 2.0, u_mg, (first.time_s + again.time_s) / 2.0)


def settled_from(looks: Sequence[Gross], readability_mg: float) -> Gross:
    """The weighing with which the last is to be compared for a drift, of weighings of one thing at equal intervals.

    A filter that creeps after powder rises by less than half as much in each interval as in the one before. What falls,
    or rises on, is a zero that began to creep with the powder.
    """
    first = 0
    while first + 2 < len(looks):
        rose_mg = moved_mg(looks[first], looks[first + 1], readability_mg)
        if rose_mg <= 0.0 or looks[first + 2].gross_mg - looks[first + 1].gross_mg > 0.5 * rose_mg:
            break
        first += 1
    return looks[first]


def fallen_mg(readings_mg: Sequence[float]) -> float:
    """By how much readings fall, and stay below, while powder comes [mg]: no powder leaves the pan, so it is the zero.

    The largest difference of two medians of `FELL_READINGS` readings that do not overlap.
    """
    if len(readings_mg) < 2 * FELL_READINGS:
        return 0.0
    medians_mg = np.median(sliding_window_view(np.asarray(readings_mg), FELL_READINGS), axis=1)
    highest_mg = np.maximum.accumulate(medians_mg)[:-FELL_READINGS]
    return max(0.0, float((highest_mg - medians_mg[FELL_READINGS:]).max()))


def rising_s(before: Gross, curve: Sequence[tuple[float, float]], after: Gross) -> float:
    """How long the gain between two weighings took from a fifth to four fifths [s], by medians of readings.

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
    """Standard uncertainty that the largest step and drift seen in a run add to a dose, which may hide others [mg].

    A drift that lasts longer than `HIDES_S` shows when the dose is interrupted, and is in its own uncertainty. The
    standard deviation rests on few observations: for two degrees of freedom 4.30 take the place of 2 (JCGM 100:2008,
    G.3).
    """
    return math.hypot(stepped_mg, drift_mg_per_s * min(lasted_s, HIDES_S)) * 4.30 / 2.0


def drift_between(before: Gross, after: Gross, readability_mg: float) -> Drift:
    """The drift by two weighings of one thing."""
    duration_s = after.time_s - before.time_s
    return Drift((after.gross_mg - before.gross_mg) / duration_s, apart_mg(before, after, readability_mg) / duration_s)


def is_hardly_chance(drift: Drift) -> bool:
    """Whether chance exceeds such a drift in less than one of twenty."""
    return abs(drift.rate) > HARDLY * drift.uncertainty


def significant(drift: Drift, readability_mg: float) -> Drift:
    """The drift to subtract: none if it may be chance. If that is unlikely, its uncertainty counts in full."""
    if abs(drift.rate) > SURELY * drift.uncertainty:
        return drift
    if is_hardly_chance(drift):
        return Drift(0.0, drift.uncertainty)
    return Drift(0.0, min(drift.uncertainty, SOUND_DIGITS_PER_S * readability_mg))


def drift_of_dose(seen: Sequence[Drift], parts_s: Sequence[float], readability_mg: float) -> Drift:
    """The drift of a dose, by those seen before it, at each interruption, and after it.

    `parts_s` is the duration of each part between two of them. Where the drifts at a part's ends agree, it has their
    weighted mean. Where they do not, it began or ended in between, and may have been faster there than at either end. A
    sum that may be chance is none. In an interrupted dose the drift before the valve opened does not count, as it says
    nothing about a creep that set in later; and a sum that chance rarely explains is its doubt.
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
    """How long to watch the pan after a dose [s], so that its drift is known to a share of the tolerance."""
    doubt_mg = math.hypot(before.uncertainty_mg, now.uncertainty_mg) * (now.time_s - before.time_s)
    return min(max(doubt_mg / (WATCHED_SHARE * tolerance_mg), SHORTEST_WATCH_S), LONGEST_WATCH_S)


def dose_between(weighed: Sequence[tuple[Gross, Gross]], readability_mg: float) -> tuple[Net, Drift]:
    """What came between the first pair of weighings and the last, and the drift that was subtracted.

    Each pair weighs the same twice: before the dose, at each interruption, and after it. A pair of equal weighings
    tells no drift. An insignificant drift is not subtracted, as a zero that walks has none; its uncertainty stays.
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
    # A weighing of the dose is in the drift too, and its error counts for both.
    shared, watched_s = (before if pairs[0] == weighed[0] else later), pairs[0][1].time_s - pairs[0][0].time_s
    twice_mg = shared.uncertainty_mg * math.sqrt(2.0 * duration_s / watched_s)
    return Net(mass_mg - drift.rate * duration_s, math.hypot(u_mg, twice_mg)), drift


def standing(bare: Gross, loaded: Gross, readability_mg: float) -> Net:
    """What stands on the pan, by the bare pan soon before or after, whatever the zero is."""
    first, last = sorted((bare, loaded), key=lambda weighing: weighing.time_s)
    drifted_mg = SOUND_DIGITS_PER_S * readability_mg * (last.time_s - first.time_s)
    return Net(loaded.gross_mg - bare.gross_mg, math.hypot(apart_mg(first, last, readability_mg), drifted_mg))


def differ_mg(first: Net, again: Net) -> tuple[float, float]:
    """By how much two results of one thing differ, and how far chance may put them apart [mg]."""
    difference_mg = again.mass_mg - first.mass_mg
    return difference_mg, AGREEMENT * math.hypot(first.uncertainty_mg, again.uncertainty_mg)


def held(empty: Net, full: Sequence[Net]) -> Net:
    """What a container holds, by its weight empty and now: weighed once, or about the bare pan (A-B-A).

    Between the two the balance may have been off. Its zero may differ, as each is a difference by itself; a different
    span counts with the container's whole mass. Weighings of now that differ show a drift or a loss anywhere between
    them.
    """
    masses_mg = [one.mass_mg for one in full]
    drifted_mg = (max(masses_mg) - min(masses_mg)) / math.sqrt(12.0)
    span_mg = SPAN_SHARE * empty.mass_mg
    u_mg = math.hypot(empty.uncertainty_mg, max(one.uncertainty_mg for one in full), drifted_mg, span_mg)
    return Net(sum(masses_mg) / len(full) - empty.mass_mg, u_mg)


def total(nets: Iterable[Net]) -> Net:
    """The sum of results that share no weighing."""
    parts = list(nets)
    return Net(sum(one.mass_mg for one in parts), math.hypot(*(one.uncertainty_mg for one in parts)))


@dataclass(frozen=True, slots=True)
class Reference:
    """What a dose is weighed against just before the valve opens: a net mass reads 0 at `zero_mg`."""

    before: Gross
    drift: Drift
    """Before the dose."""
    earlier: Net
    """What earlier doses of this powder have brought into this container."""
    readability_mg: float
    later_mg: float = math.inf
    """Expected standard uncertainty of N once the container has gone; infinite if it does not count."""

    @property
    def zero_mg(self) -> float:
        return self.before.gross_mg - self.earlier.mass_mg

    def uncertainty_mg(self, now: Gross) -> float:
        """Standard uncertainty to expect in the end of a mass weighed now, by the drift before the dose [mg]."""
        drifted_mg = self.drift.uncertainty * (now.time_s - self.before.time_s)
        walked_mg = apart_mg(self.before, now, self.readability_mg)
        return self.in_the_end_mg(math.hypot(walked_mg, drifted_mg, self.earlier.uncertainty_mg), self.drift)

    def in_the_end_mg(self, uncertainty_mg: float, drift: Drift) -> float:
        """What will be left of a dose's uncertainty once `close` has combined D and N, with room for the adjustment.

        A drift that was seen, or is doubted, may grow with the container, so its doubt stays.
        """
        if uncertainty_mg == 0.0 or drift.rate != 0.0 or drift.is_doubted:
            return uncertainty_mg
        return min(uncertainty_mg, ADJUSTED / math.hypot(1.0 / uncertainty_mg, 1.0 / self.later_mg))


def later_mg(bare: Gross, loaded: Gross, others: Iterable[Net], readability_mg: float) -> float:
    """Expected standard uncertainty of one dose by N, before the container has gone [mg].

    Its going is taken to be like its coming. `others` are doses of other powders in it, which N has in one sum.
    """
    changing_s = 2.0 * (loaded.time_s - bare.time_s)
    weighed_mg = math.sqrt(2.0) * math.hypot(bare.uncertainty_mg, loaded.uncertainty_mg)
    drifted_mg = SOUND_DIGITS_PER_S * readability_mg * changing_s
    walked_mg = walk_mg(readability_mg, changing_s)
    return math.hypot(weighed_mg, walked_mg, drifted_mg, *(one.uncertainty_mg for one in others))


@dataclass(frozen=True, slots=True)
class Closed:
    """A bracket after its container has gone: the combined doses, and whether to believe them."""

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
    """By how much the bare pan's reading has moved, less the drift; 0 where a sound zero wanders as far."""

    @property
    def closes(self) -> bool:
        """Whether D and N agree and the zero has not stepped: it may have done so twice, and they agree by chance."""
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
    """Combine the doses into a container with what it has gained by the bare pan.

    `drifted` is what was subtracted from each dose for drift, `drift` what was seen about them. Where results differ by
    more than one standard deviation, uncertainties grow by as much (the Birge ratio: Phys. Rev. 40, 207, 1932).
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
    """What was subtracted for drift and has not moved the bare pan: it came and went with the container."""
    shown_mg = min(max(zero_mg, min(drifted_mg, 0.0)), max(drifted_mg, 0.0))
    return drifted_mg - shown_mg
