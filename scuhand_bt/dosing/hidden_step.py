"""Steps of the zero that hide behind a balance's filter (docs/weighing.md, What counts as a step).

**As the pan becomes bare.** A container comes, and goes again; p is the share of it that the balance misses, by time.
If nothing else happens, the pan comes to rest as it did before, a little earlier or later: m p(t - d). A zero that is S
lower until t1, and then goes back, shows through the same filter: - S p(t - t1), with p = 1 before t1. Both are fitted
by least squares. A line of readings that falls behind looks similar: a step must explain the curve better than one that
was late from some reading on. A zero that stepped while the container came is found the same way, with the two
exchanged.

**As powder falls.** No powder leaves the pan, so falling readings are the zero's. There are two exceptions: a filter
that rings, and the end of a strong flow, whose impact (its rate times its fall time t_f) is gone. So what can have
come, with no mass negative, is fitted through the filter:

    sum of m_j (1 + t d/dt) (1 - p(t - t_j)),    m_j >= 0

with t = t_f and as much more as lies between two readings, within which all may have landed at once. A weaker impact is
such a sum, too. What falls beside the fit is the zero's.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from scuhand_bt.dosing.bracket import fallen_mg
from scuhand_bt.dosing.characteristic import Step
from scuhand_bt.dosing.identification import LEAST_APART_S, balance_of

Floats: TypeAlias = NDArray[np.float64]

EARLIER_S = np.arange(-0.3, 0.305, 0.01)
"""How much earlier or later a load may come than assumed: d."""
FINER_S = np.arange(-0.008, 0.01, 0.002)
"""Finer steps about the best of these: where the fit begins, a steep curve is off by milligrams in 5 ms."""
TAIL_MG = 100.0
"""The fit begins where this much of the load is still to be shown."""
BEND_SHARE = 0.25
"""Error of a curve between readings, as a share of its second differences (of a parabola, an eighth)."""
CLEARER = 30.0
"""A step must explain this many times the variance that remains; tried on the filters of its tests, not derived."""
LIKE, UNEXPLAINED = 3.0, 0.15
"""If more than LIKE remains, in variances of a reading, the two curves are not of one filter. One that adapts shows a
step more slowly than the load, and turns slow a little sooner or later: there no more than UNEXPLAINED may remain, as a
share of what is to be explained."""
SEEN_SHARE, SEEN_SIGMAS, SEEN_READINGS = 0.25, 2.0, 3
"""A step must show undisguised in SEEN_READINGS, by this share and deviations; else it is the curve's own shape."""
GAP_S = 0.2
"""Interval at which powder may come where readings are missing."""
LEAST_DIGITS, MOST_MG = 5.0, 50.0
"""Limits of a step that is looked for."""


def hidden_step_mg(came: Step, went: Step, readability_mg: float) -> float:
    """How far the zero stepped while a load came, or went again [mg]; 0 if it did not."""
    return max(_stepped_mg(came, went, readability_mg), _stepped_mg(went, came, readability_mg))


def _stepped_mg(sound: Step, step: Step, readability_mg: float) -> float:
    """How far the zero stepped in `step`, if it did not in `sound`."""
    mass_mg = abs(step.step_mg)
    shown_mg = mass_mg * np.asarray(step.missing)
    tail = int(np.argmax(np.abs(shown_mg) < TAIL_MG)) if len(shown_mg) else 0
    times_s, shown_mg = np.asarray(step.times_s)[tail:], shown_mg[tail:]
    if len(times_s) < 10:
        return 0.0

    def compared(earlier_s: Floats) -> tuple[Floats, Floats]:
        """(D, N) by how much the curve is off the other, and the variances of that."""
        expected_mg = mass_mg * _missing(sound, times_s - earlier_s[:, None])
        bends_mg = np.abs(np.diff(expected_mg, n=2, axis=1, append=np.zeros((len(earlier_s), 2))))
        bends_mg = np.maximum(bends_mg, np.maximum(np.roll(bends_mg, 1, axis=1), np.roll(bends_mg, -1, axis=1)))
        return shown_mg - expected_mg, readability_mg**2 + (BEND_SHARE * bends_mg) ** 2

    off_mg, variances = compared(EARLIER_S)
    nearest_s = EARLIER_S[(off_mg**2 / variances).sum(axis=1).argmin()]
    off_mg, variances = compared(np.concatenate((EARLIER_S, nearest_s + FINER_S)))
    misfits = off_mg**2 / variances
    misfit, until = misfits.sum(axis=1), misfits.cumsum(axis=1)
    late = float((until.min(axis=0) + (misfit[:, None] - until).min(axis=0)).min())
    back = _missing(sound, times_s - times_s[:, None])  # (T, N): a zero that goes back with each of the readings
    top, below = _summed(off_mg / variances, back), _summed(1.0 / variances, back**2)
    steps_mg = top / np.maximum(below, 1e-12)
    left = misfit[:, None] - np.where(np.abs(steps_mg) < MOST_MG, steps_mg * top, 0.0)
    best = np.unravel_index(int(left.argmin()), left.shape)
    stepped_mg, per_reading = abs(float(steps_mg[best])), left[best] / len(times_s)
    is_alike = left[best] < UNEXPLAINED * late if balance_of(sound).adapts else per_reading < LIKE
    is_clear = late - left[best] > CLEARER * per_reading and is_alike
    plain = int(misfit.argmin())
    seen_mg = np.abs(off_mg[plain])
    shows = (seen_mg > SEEN_SHARE * stepped_mg) & (seen_mg > SEEN_SIGMAS * np.sqrt(variances[plain]))
    is_seen = shows.sum() >= SEEN_READINGS and stepped_mg > LEAST_DIGITS * readability_mg
    return stepped_mg if is_clear and is_seen else 0.0


def fallen_beside_mg(times_s: Sequence[float], readings_mg: Sequence[float], came: Step, fall_s: float) -> float:
    """By how much readings (N,) fall [mg] that no powder explains, through a filter that showed a container as `came`.

    The powder falls for `fall_s` before it lands.
    """
    from scipy.optimize import nnls  # deferred: slow to load

    shown_mg, at_s = np.asarray(readings_mg), np.asarray(times_s)
    # With each reading, and in between where some are missing.
    arrives_s = np.concatenate([np.arange(*between, GAP_S) for between in pairwise(at_s)])
    landing_s = np.maximum(np.diff(arrives_s, prepend=arrives_s[0] - GAP_S), LEAST_APART_S)
    later_s = at_s[:, None] - arrives_s  # (N, M)
    comes = 1.0 - _missing(came, later_s)
    pushes = (1.0 + fall_s / landing_s) * (1.0 - _missing(came, later_s + landing_s) - comes)
    design = np.column_stack((comes + pushes, np.ones(len(at_s)), -np.ones(len(at_s))))
    masses_mg, _ = nnls(design, shown_mg)
    return fallen_mg(list(shown_mg - design @ masses_mg))


def _summed(weights: Floats, shares: Floats) -> Floats:
    """(D, N) by (T, N): (D, T). Not by BLAS, whose threads cost more than they gain for so few."""
    summed: Floats = np.einsum("dn,tn->dt", weights, shares)
    return summed


def _missing(step: Step, times_s: Floats) -> Floats:
    return np.interp(times_s, (0.0, *step.times_s), (1.0, *step.missing), left=1.0, right=0.0)
