"""The delay and repeatability of a balance, and what its display shows of its own faults.

**Delay**, whatever the filter: where the load steps from m0 to m1 at t0, and r is read,

    T = 1 / (m1 - m0)  integral of (m1 - r) dt,     from t0 until r has come to m1

n equal poles of tau have n tau, a mean over L has L/2, a dead time counts whole. While powder flows at a rate q, T q of
it is not shown yet, and a dose may overshoot by that.

**Repeatability** s [mg]: the standard deviation of weighings of one weight, taken off and put on again. The least mass
that can be weighed to a share R of itself is

    m = k s / R           (EURAMET cg-18, appendix G), k = 2

USP 41 has R = 0.10 % (m = 2000 s), and s no less than 0.41 digits. A dose has its own R, tolerance by mass. Then the
mass drops out: the tolerance is to be at least k s, with a margin for worse days.
"""

import statistics
from collections.abc import Sequence
from itertools import groupby, islice, pairwise
from typing import NamedTuple

from scuhand_bt.dosing.verdict import COVERAGE

LONGEST_DELAY_S = 6.2
"""Longest delay of a balance that the controllers can dose with: filters of 6 s, and a reading or two more. The bank
knows delays to 8 s."""
USP_SHARE = 0.001
USP_LEAST_DIGITS = 0.41
MARGIN = 2.0
"""Safety factor of two or more by cg-18, for a repeatability measured once, on a quiet day."""
LAST_MG = 3.0
"""The last part of a step, which a filter that adapts treats as a small change, and slowly."""
STEP_SHARE = 0.01
"""A step has come when more than this share of it is shown."""
HAND_SHARE, SWINGS_SHARE = 0.1, 0.03
"""A person's hand has let go of a container when less than the first share of it is missing. A filter swings back if it
then shows more than there is, by the second share of what was missing."""
RESTS = 4.0
"""By so many times the time until no more than `LAST_MG` is missing, a filter has come to rest."""

HELD_READINGS, HELD_DIGITS = 8, 5
"""A display that shows the same for HELD_READINGS, and then jumps by more than HELD_DIGITS, held its value."""

STILL_TAIL, STILL_FOLDS, STILL_KNOWN = 10, 16.0, 200
"""A display is frozen if it shows the same for longer than its noise ever makes it. Runs of equal readings get rarer
with their length, by a factor of e per fold; the fold is the mean excess of the longest ten over the tenth. STILL_FOLDS
such factors do not come by chance. A balance that averages over seconds has long runs, and so long folds."""
STILL_BEFORE, STILL_READINGS = 4, 50
"""Up to STILL_BEFORE runs of STILL_READINGS or more, as far beyond shorter ones, were not noise either. Except that
they are most of what was seen of the pan at rest: then the digits are coarser than the noise."""

Curve = Sequence[tuple[float, float]]
"""Readings: times [s], growing, and masses [mg]."""


class Step(NamedTuple):
    """How a balance has shown a step of its load."""

    step_mg: float
    """Negative where the load was taken away."""
    times_s: tuple[float, ...]
    """Of N readings: time after the step came, growing."""
    missing: tuple[float, ...]
    """(N,): the share of the step not shown yet; negative where too much is shown."""
    uncertainty_mg: float = 0.0
    """Standard uncertainty of the weighing at which it came to rest."""

    @property
    def delay_s(self) -> float:
        """T: how late a steadily growing mass is read."""
        points = zip((0.0, *self.times_s), (1.0, *self.missing), strict=True)
        return sum((last + share) / 2.0 * (time_s - last_s) for (last_s, last), (time_s, share) in pairwise(points))

    @property
    def last_s(self) -> float:
        """T of the step's last `LAST_MG`, from the last reading that missed more than that."""
        last = LAST_MG / abs(self.step_mg)
        points = [(time_s, min(share, last)) for time_s, share in self._shown_last]
        return sum((a + b) / 2.0 * (to_s - from_s) for (from_s, a), (to_s, b) in pairwise(points)) / last

    @property
    def last_uncertainty_s(self) -> float:
        """Standard uncertainty of `last_s`, which grows with the time looked at."""
        times_s = [time_s for time_s, _ in self._shown_last]
        return (times_s[-1] - times_s[0]) * self.uncertainty_mg / LAST_MG

    def let_go(self) -> "Step | None":
        """Its last tenth, which no hand is in any more; None where too little is seen of it, or where it swings back.

        A hand that pressed on the pan leaves from above. What is read long after, before the person says that they are
        done, is left out: it makes `last_s` less certain.
        """
        touched = [number for number, share in enumerate(self.missing) if abs(share) > HAND_SHARE]
        if not touched:
            return None
        begins_s, whole = self.times_s[touched[-1]], self.missing[touched[-1]]
        rests_s = begins_s + RESTS * (self._shown_last[0][0] - begins_s)
        rest = [
            (time_s - begins_s, share / whole)
            for time_s, share in zip(self.times_s, self.missing, strict=True)
            if begins_s < time_s <= rests_s
        ]
        if min((share for _, share in rest), default=-1.0) < -SWINGS_SHARE:
            return None
        times_s, shares = zip(*rest, strict=True)
        return Step(abs(self.step_mg * whole), times_s, tuple(map(abs, shares)), self.uncertainty_mg)

    @property
    def _shown_last(self) -> list[tuple[float, float]]:
        """Times and shares, from the last reading that missed more than `LAST_MG`."""
        last = LAST_MG / abs(self.step_mg)
        large = [number for number, share in enumerate(self.missing) if abs(share) > last]
        return list(zip(self.times_s, self.missing, strict=True))[large[-1] if large else 0 :]


def step_of(curve: Curve, before_mg: float, after_mg: float, latest_s: float) -> Step | None:
    """The step between two settled weighings; None where the curve does not show its beginning.

    The step came at `latest_s`, unless more than `STEP_SHARE` of it was shown earlier; then with the last reading that
    showed less. A single false reading does no harm.
    """
    step_mg = after_mg - before_mg
    fives = zip(*(curve[first:] for first in range(5)), strict=False) if step_mg else ()
    missing = [(five[2][0], (after_mg - _true_mg(*(value_mg for _, value_mg in five))) / step_mg) for five in fives]
    unmoved = [number for number, (_, share) in enumerate(missing) if share > 1.0 - STEP_SHARE]
    if not unmoved or unmoved[-1] == len(missing) - 1:
        return None
    begin_s = min(latest_s, missing[unmoved[-1]][0])
    after = [(time_s - begin_s, share) for time_s, share in missing if time_s > begin_s]
    return Step(step_mg, tuple(time_s for time_s, _ in after), tuple(share for _, share in after))


def _true_mg(first_mg: float, last_mg: float, now_mg: float, next_mg: float, later_mg: float) -> float:
    """The present reading, cut off where it is farther from its neighbours than these are from theirs.

    A false line is that, and a peak of a ringing filter is not; a median of three would flatten that.
    """
    farther_mg = min(abs(last_mg - first_mg), abs(later_mg - next_mg))
    low_mg, high_mg = sorted((last_mg, next_mg))
    return min(max(now_mg, low_mg - farther_mg), high_mg + farther_mg)


def held_mg(readings_mg: Sequence[float], readability_mg: float) -> float:
    """The largest jump [mg] of a display that stood still, to the digit, before it; 0 for one that follows.

    What is held back at the end cannot be seen. A filter of a tenth of a second or more makes a ramp of whatever falls.
    So the jump is what exceeds the next change, as a flow that begins, and a motor's noise, make changes too.
    """
    digits = [round(mg / readability_mg) for mg in readings_mg]
    changes = [now - last for last, now in pairwise(digits)]
    held, still = 0, 1
    for change, following in zip(changes, (*changes[1:], 0), strict=False):
        beyond = abs(change) - abs(following)
        if still >= HELD_READINGS and beyond > HELD_DIGITS:
            held = max(held, beyond)
        still = 1 if change else still + 1
    return held * readability_mg


def is_frozen(readings_mg: Sequence[float], readability_mg: float) -> bool:
    """Whether a display has shown the same, to the digit, for longer than its own noise allows.

    A balance that is as quiet at other times, or was seen only briefly, does not count as frozen. If it stood still
    like this a few times before, that was not noise either; unless it does so whenever nothing falls.
    """
    newest = groupby(round(mg / readability_mg) for mg in reversed(readings_mg))
    last = sum(1 for _, equal in islice(newest, 1) for _ in equal)
    if last <= 1.0 + STILL_FOLDS:  # noise makes no runs shorter than one reading, and no folds shorter than one
        return False
    before = [(digits, sum(1 for _ in equal)) for digits, equal in newest]
    noise = sorted(run for _, run in before)
    for number in range(max(0, len(noise) - STILL_BEFORE), len(noise)):
        if noise[number] >= STILL_READINGS and _is_beyond(noise[number], noise[:number]):
            # A single one, however long, tells nothing about the others.
            if sum(min(run, STILL_KNOWN) for run in noise[number:]) <= _wavered(before):
                noise = noise[:number]
            break
    return _is_beyond(last, noise)


def _wavered(runs: Sequence[tuple[int, int]]) -> int:
    """Readings in runs between a step up and a step down, of runs (digits, length): those that noise ended.

    A run between two steps in the same direction was moved by falling powder.
    """
    beside = zip(runs, runs[1:], runs[2:], strict=False)
    return sum(run for (last, _), (now, run), (next_one, _) in beside if (now - last) * (next_one - now) < 0)


def _is_beyond(run: int, noise: Sequence[int]) -> bool:
    """Whether a run of equal readings is longer than these runs, sorted, let expect."""
    if sum(noise) < STILL_KNOWN:
        return False
    tenth, *longest = noise[-STILL_TAIL:]
    fold = max(1.0, sum(run - tenth for run in longest) / STILL_TAIL)
    return run > tenth + STILL_FOLDS * fold


def noise_and_drift(curve: Curve) -> tuple[float, float]:
    """Noise about a line [mg], and the line's slope [mg/s], of at least three readings at rest."""
    times_s, values_mg = zip(*curve, strict=True)
    slope, start_mg = statistics.linear_regression(times_s, values_mg)
    off_mg = [value_mg - start_mg - slope * time_s for time_s, value_mg in curve]
    return (sum(mg * mg for mg in off_mg) / (len(off_mg) - 2)) ** 0.5, slope


def least_repeatability_mg(measured_mg: float | None, readability_mg: float) -> float:
    """The repeatability that a balance may be credited with: a few weighings may agree by chance, or by rounding."""
    return max(measured_mg or 0.0, USP_LEAST_DIGITS * readability_mg)


def usp_minimum_weight_mg(repeatability_mg: float) -> float:
    """The least mass that this repeatability can weigh to 0.10 %."""
    return COVERAGE * repeatability_mg / USP_SHARE


def least_tolerance_mg(repeatability_mg: float) -> float:
    """The narrowest tolerance that this repeatability allows."""
    return MARGIN * COVERAGE * repeatability_mg
