"""What a balance is, by what it shows, and what can be told with it.

Its delay, whatever its filter: where the load steps from m0 to m1 at t0, and r is read,

    T = 1 / (m1 - m0)  integral of (m1 - r) dt,     from t0 until r has come to m1:

n equal poles of tau have n tau, a mean over L has L/2, a dead time counts whole. While powder flows at a rate q, T q of
it is not shown yet: that is what a dose may overshoot by.

Its repeatability s [mg] is the standard deviation of weighings of one weight, taken off and put on again. It limits
small masses: what is weighed to a share R of itself, with k = 2, weighs at least

    m = k s / R           (EURAMET cg-18, appendix G)

USP 41 has R = 0.10 % (m = 2000 s), and s no less than 0.41 digits. A dose asks for its own R = T/m, tolerance by mass:
then the mass drops out, and the tolerance is to be at least k s, with a margin for days that are worse than that one.
"""

import statistics
from collections.abc import Sequence
from itertools import groupby, islice, pairwise
from typing import NamedTuple

from scuhand_bt.dosing.verdict import COVERAGE

LONGEST_DELAY_S = 6.2
"""Of a balance that the controllers can dose with: slower ones show too late what a valve has let out. Filters of 6 s,
and a reading or two more; the bank of the controller knows delays to 8 s."""
USP_SHARE = 0.001
USP_LEAST_DIGITS = 0.41
MARGIN = 2.0
"""cg-18 has a safety factor of two or more, for a repeatability that was measured once, on a quiet day."""
LAST_MG = 3.0
"""The last of a step: a filter that adapts to how much changes takes it for a little thing, and its time over it."""
STEP_SHARE = 0.01
"""A step has come when more than this share of it is shown."""

HELD_READINGS, HELD_DIGITS = 8, 5
"""A display that shows the same so often, and in the next reading more than so many digits more or less, held it."""

STILL_TAIL, STILL_FOLDS, STILL_KNOWN = 10, 16.0, 200
"""A display is frozen that shows the same for longer than its noise ever makes it. How often noise makes a run of equal
readings falls off with its length, by a factor of e in about what the longest ten exceed the tenth by, in the mean:
sixteen such factors do not come. What averages over seconds stands still for long, and is given as much longer.
"""
STILL_BEFORE, STILL_READINGS = 4, 50
"""So many runs of so many readings or more that are as far beyond what is shorter were no noise either, unless they are
most of what was seen of the pan at rest: the digits of such a balance are coarser than its noise."""

Curve = Sequence[tuple[float, float]]
"""Readings: times [s], growing, and masses [mg]."""


class Step(NamedTuple):
    """How a balance has shown a step of its load."""

    step_mg: float
    """Negative where the load was taken away."""
    times_s: tuple[float, ...]
    """Of N readings: so long after the step came, growing."""
    missing: tuple[float, ...]
    """(N,) so large a share of the step they did not show yet; negative where they showed too much."""
    uncertainty_mg: float = 0.0
    """Standard uncertainty of the weighing that it came to rest at."""

    @property
    def delay_s(self) -> float:
        """T: how late a steadily growing mass is read."""
        points = zip((0.0, *self.times_s), (1.0, *self.missing), strict=True)
        return sum((last + share) / 2.0 * (time_s - last_s) for (last_s, last), (time_s, share) in pairwise(points))

    @property
    def last_s(self) -> float:
        """T of the last `LAST_MG` of the step, from the last reading that missed more than that."""
        last = LAST_MG / self.step_mg
        points = [(time_s, min(share, last)) for time_s, share in self._shown_last]
        return sum((a + b) / 2.0 * (to_s - from_s) for (from_s, a), (to_s, b) in pairwise(points)) / last

    @property
    def last_uncertainty_s(self) -> float:
        """Standard uncertainty of `last_s`: the longer it was looked at, the more an error of the weighing makes."""
        times_s = [time_s for time_s, _ in self._shown_last]
        return (times_s[-1] - times_s[0]) * self.uncertainty_mg / LAST_MG

    @property
    def _shown_last(self) -> list[tuple[float, float]]:
        """Times and shares, from the last reading that missed more than `LAST_MG`."""
        last = LAST_MG / self.step_mg
        large = [number for number, share in enumerate(self.missing) if abs(share) > last]
        return list(zip(self.times_s, self.missing, strict=True))[large[-1] if large else 0 :]


def step_of(curve: Curve, before_mg: float, after_mg: float, latest_s: float) -> Step | None:
    """The step between two settled weighings; None where the curve does not show it from its beginning.

    The step came at `latest_s`, unless more than `STEP_SHARE` of it was shown earlier: then with the last reading that
    showed less. A false line among the readings does no harm.
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
    """The reading of now, no farther beyond those beside it than these are apart from theirs: a false line is.

    A peak of a filter that rings is not, which a median of three would flatten.
    """
    farther_mg = min(abs(last_mg - first_mg), abs(later_mg - next_mg))
    low_mg, high_mg = sorted((last_mg, next_mg))
    return min(max(now_mg, low_mg - farther_mg), high_mg + farther_mg)


def held_mg(readings_mg: Sequence[float], readability_mg: float) -> float:
    """The most that a display has held back: it stood still, to the digit, and then jumped; 0 for one that follows.

    What it holds back at the end nobody sees. A filter of a tenth of a second or more makes a ramp of whatever falls:
    the jump is what goes beyond the next change, which a flow that begins makes as well, and a motor's noise.
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
    """Whether a display has been showing the same, to the digit, for longer than its own noise allows.

    A balance that is as quiet as that at other times, or was seen for a short while only, is not told by this. When it
    stood still so before, a few times, that was not its noise either; one that does whenever nothing falls is so quiet.
    """
    newest = groupby(round(mg / readability_mg) for mg in reversed(readings_mg))
    last = sum(1 for _, equal in islice(newest, 1) for _ in equal)
    if last <= 1.0 + STILL_FOLDS:  # no noise makes shorter runs than single readings, nor of fewer folds than one
        return False
    before = [(digits, sum(1 for _ in equal)) for digits, equal in newest]
    noise = sorted(run for _, run in before)
    for number in range(max(0, len(noise) - STILL_BEFORE), len(noise)):
        if noise[number] >= STILL_READINGS and _is_beyond(noise[number], noise[:number]):
            # However long one of them was, a single one says nothing of the others.
            if sum(min(run, STILL_KNOWN) for run in noise[number:]) <= _wavered(before):
                noise = noise[:number]
            break
    return _is_beyond(last, noise)


def _wavered(runs: Sequence[tuple[int, int]]) -> int:
    """Readings between a step up and a step down: of runs of equal ones (digits, how many), those that noise ended.

    What goes one way was moved by what fell.
    """
    beside = zip(runs, runs[1:], runs[2:], strict=False)
    return sum(run for (last, _), (now, run), (next_one, _) in beside if (now - last) * (next_one - now) < 0)


def _is_beyond(run: int, noise: Sequence[int]) -> bool:
    """Whether so many equal readings are more than runs like these, growing, let expect."""
    if sum(noise) < STILL_KNOWN:
        return False
    tenth, *longest = noise[-STILL_TAIL:]
    fold = max(1.0, sum(run - tenth for run in longest) / STILL_TAIL)
    return run > tenth + STILL_FOLDS * fold


def noise_and_drift(curve: Curve) -> tuple[float, float]:
    """Of a pan on which nothing changes: the standard deviation of a reading about a line [mg], the line's slope
    [mg/s]. At least three readings."""
    times_s, values_mg = zip(*curve, strict=True)
    slope, start_mg = statistics.linear_regression(times_s, values_mg)
    off_mg = [value_mg - start_mg - slope * time_s for time_s, value_mg in curve]
    return (sum(mg * mg for mg in off_mg) / (len(off_mg) - 2)) ** 0.5, slope


def least_repeatability_mg(measured_mg: float | None, readability_mg: float) -> float:
    """What a balance may be credited with: a few weighings may agree by chance, or by rounding."""
    return max(measured_mg or 0.0, USP_LEAST_DIGITS * readability_mg)


def usp_minimum_weight_mg(repeatability_mg: float) -> float:
    """The least mass that this repeatability tells to 0.10 %."""
    return COVERAGE * repeatability_mg / USP_SHARE


def least_tolerance_mg(repeatability_mg: float) -> float:
    """The narrowest tolerance that this repeatability tells."""
    return MARGIN * COVERAGE * repeatability_mg
