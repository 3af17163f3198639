"""What a container has gained, by weighings that bracket it, with the uncertainty of that.

A dose is the difference of two weighings with the hand in place and the valve shut, less the drift between them:

    D = g1 - g0 - r T,      u(D)^2 = u0^2 + u1^2 + w^2 T + (T u(r))^2

g gross [mg], T the time between them [s], r the drift's rate [mg/s] as it was before and after the dose, w the random
walk of the zero [mg/s^0.5]. What the container has gained is told once more when it has gone, by the bare pan before
and after it (A-B-A, as for mass standards: OIML R 111-1, C.5; NIST SOP 4):

    N = (l1 - a1) - (l0 - a0)

a bare pan, l loaded pan, the hand away. D and N share no weighing: a zero that steps between g0 and g1 is in D alone;
one that steps between a and l, and what drips after g1, is in N alone. They are adjusted to each other by least
squares; where they are farther apart than chance, neither is believed.

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

AGREEMENT = 4.0
"""Standard deviations of their difference by which two results of one thing may be apart: by chance 1 in 16 000 are."""
SOUND_DIGITS_PER_S = 0.05
"""A sound balance that has warmed up drifts no faster (standard deviation), in digits: 3 in a minute. One that does is
seen by A-B-A: the drift is in D and N with opposite signs."""
SPAN_SHARE = 1e-5
"""By how much a balance's span may differ (standard deviation) before and after it was off: 2 ppm/K over 5 K."""
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


def unseen_mg(stepped_mg: float) -> float:
    """What the largest of a few steps that were seen adds to the standard uncertainty of a dose that hides another.

    It is a standard deviation by few observations: as for two degrees of freedom, 4.30 of it cover what 2 of a known
    one do (JCGM 100:2008, G.3).
    """
    return stepped_mg * 4.30 / 2.0


def drift_between(before: Gross, after: Gross, readability_mg: float) -> Drift:
    """By two weighings of one thing at different times."""
    duration_s = after.time_s - before.time_s
    return Drift((after.gross_mg - before.gross_mg) / duration_s, apart_mg(before, after, readability_mg) / duration_s)


def significant(drift: Drift, readability_mg: float) -> Drift:
    """A drift that is no more than chance (two standard deviations) is none, or no faster than a sound balance's."""
    if abs(drift.rate) > 2.0 * drift.uncertainty:
        return drift
    return Drift(0.0, min(drift.uncertainty, SOUND_DIGITS_PER_S * readability_mg))


def drift_of_dose(before: Drift, after: Drift, readability_mg: float) -> Drift:
    """During a dose, by the drift before it and after it.

    Where they agree, their weighted mean, or none where that is no more than chance. Where they do not, it began or
    ended in between, and may have been faster there than at either end: a creep that sets in when the valve opens is.
    """
    difference, chance = after.rate - before.rate, math.hypot(before.uncertainty, after.uncertainty)
    if abs(difference) > AGREEMENT * chance:
        return Drift((before.rate + after.rate) / 2.0, math.hypot(chance / 2.0, difference / math.sqrt(3.0)))
    weight = after.uncertainty**2 / chance**2
    rate = weight * before.rate + (1.0 - weight) * after.rate
    return significant(Drift(rate, before.uncertainty * after.uncertainty / chance), readability_mg)


def dose_between(earlier: Gross, before: Gross, after: Gross, later: Gross, readability_mg: float) -> tuple[Net, Drift]:
    """What came between `before` and `after`, and the drift that was taken out.

    `earlier` and `before` weigh the same, and so do `after` and `later`; one given twice tells no drift. A drift that
    is not significant is not taken out, as a zero that walks has none; its doubt stays.
    """
    seen = [drift_between(one, two, readability_mg) for one, two in ((earlier, before), (after, later)) if one != two]
    unseen = Drift(0.0, SOUND_DIGITS_PER_S * readability_mg)
    if len(seen) == 2:
        drift = drift_of_dose(seen[0], seen[1], readability_mg)
    else:
        drift = significant(seen[0], readability_mg) if seen else unseen
    duration_s = later.time_s - before.time_s
    mass_mg = later.gross_mg - before.gross_mg
    u_mg = math.hypot(apart_mg(before, later, readability_mg), drift.uncertainty * duration_s)
    if drift.rate == 0.0:
        return Net(mass_mg, u_mg), drift
    # A weighing that the dose rests on is in the drift too: its error counts for both.
    shared, watched_s = (
        (before, before.time_s - earlier.time_s) if earlier != before else (later, later.time_s - after.time_s)
    )
    twice_mg = shared.uncertainty_mg * math.sqrt(2.0 * duration_s / watched_s)
    return Net(mass_mg - drift.rate * duration_s, math.hypot(u_mg, twice_mg)), drift


def standing(bare: Gross, loaded: Gross, readability_mg: float) -> Net:
    """What stands on the pan, by the bare pan soon before it or after it; whatever the zero is."""
    first, last = sorted((bare, loaded), key=lambda weighing: weighing.time_s)
    drifted_mg = SOUND_DIGITS_PER_S * readability_mg * (last.time_s - first.time_s)
    return Net(loaded.gross_mg - bare.gross_mg, math.hypot(apart_mg(first, last, readability_mg), drifted_mg))


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

    @property
    def zero_mg(self) -> float:
        return self.before.gross_mg - self.earlier.mass_mg

    def uncertainty_mg(self, now: Gross) -> float:
        """The standard uncertainty to be expected of a net mass weighed now, by the drift before the dose."""
        drifted_mg = self.drift.uncertainty * (now.time_s - self.before.time_s)
        return math.hypot(apart_mg(self.before, now, self.readability_mg), drifted_mg, self.earlier.uncertainty_mg)


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
    drift: Drift,
    bare_before: Gross,
    loaded_before: Gross,
    loaded_after: Gross,
    bare_after: Gross,
    readability_mg: float,
) -> Closed:
    """Hold the doses into a container against what it has gained by the bare pan.

    `drift` is the one seen about the doses. Where results differ by more than one standard deviation, the adjusted
    uncertainties grow by as much (the Birge ratio: Phys. Rev. 40, 207, 1932).
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
        ),
    )
    difference_mg = net.mass_mg - sum(dose.mass_mg for dose in doses)
    variance = net.uncertainty_mg**2 + sum(dose.uncertainty_mg**2 for dose in doses)
    chance_mg = math.sqrt(variance)
    birge = max(1.0, abs(difference_mg) / chance_mg)
    adjusted = []
    for dose in doses:
        share = dose.uncertainty_mg**2 / variance
        u_mg = birge * dose.uncertainty_mg * math.sqrt(1.0 - share)
        adjusted.append(Net(dose.mass_mg + share * difference_mg, u_mg))
    lasted_s = bare_after.time_s - bare_before.time_s
    walked_mg = math.hypot(apart_mg(bare_before, bare_after, readability_mg), drift.uncertainty * lasted_s)
    steady_mg = zero_mg - drift.rate * lasted_s
    stepped_mg = steady_mg if abs(steady_mg) > AGREEMENT * walked_mg else 0.0
    return Closed(tuple(adjusted), net, zero_mg, difference_mg, AGREEMENT * chance_mg, stepped_mg)
