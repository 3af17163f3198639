"""Slows a course where, and only while, its joints would exceed their limits; its path stays the same.

    f_k = max over joints of  |q'| / v,  (|q''| / a)^(1/2),  (|q'''| / j)^(1/3)         in step k of the cubics

A step with f > 1 must take longer. One with less may take less time, but never less than requested. Neighbouring steps
have to follow, as a speed cannot change at once, so the factors' upper envelope is averaged over a window. This is
repeated with half of the correction each time. The quickest result is taken, slowed as a whole by what it still lacks.

Samples (m, n), times (m,) [s].
"""

import numpy as np

from scuhand_bt.motion.kinematics import Floats
from scuhand_bt.motion.timelaw import RateLimits
from scuhand_bt.motion.trajectory import JointTrajectory, through

ROUNDS = 30
WINDOW_S = 0.12
HALF_WAY = 0.5
"""The power of the factors used in a round; with the full power rounds would oscillate."""
QUICKER = 0.7
"""No round shortens a step by more than this factor."""
ENOUGH = 1.02
"""Largest remaining factor at which the rounds may end."""


def slowed(times_s: Floats, samples: Floats, rates: RateLimits) -> JointTrajectory:
    """The cubics through the samples, at the given times where the limits allow that."""
    from scipy.ndimage import maximum_filter1d, uniform_filter1d  # slow to load

    asked_s = np.diff(times_s)
    slower: Floats = np.ones_like(asked_s)
    best = through(times_s, samples)
    best = best.stretched(max(1.0, rates.stretch_for(best)))
    for _ in range(ROUNDS):
        steps_s = asked_s * slower
        motion = through(np.concatenate([[0.0], np.cumsum(steps_s)]), samples)
        factors = _factors(motion, rates)
        whole = motion.stretched(max(1.0, rates.stretch_for(motion)))
        if whole.duration_s < best.duration_s:
            best = whole
        if factors.max() < ENOUGH and slower.max() == 1.0:
            break
        width = max(3, round(WINDOW_S / float(np.median(steps_s))) | 1)
        envelope = np.maximum(maximum_filter1d(factors, width) ** HALF_WAY, QUICKER)
        logs = np.maximum(0.0, np.log(slower) + uniform_filter1d(np.log(envelope), width))
        slower = np.exp(uniform_filter1d(logs, 3))
    return best


def _factors(motion: JointTrajectory, rates: RateLimits) -> Floats:
    """How many times slower each step would have to be."""
    h = np.diff(motion.knots_s)[:, None]
    _, c1, c2, c3 = motion.coefficients
    speeds = np.maximum(np.abs(c1), np.abs(c1 + h * (2 * c2 + 3 * h * c3)))
    accelerations = np.maximum(np.abs(2 * c2), np.abs(2 * c2 + 6 * h * c3))
    factors: Floats = np.maximum.reduce(
        [
            (speeds / rates.speed).max(axis=1),
            np.sqrt((accelerations / rates.acceleration).max(axis=1)),
            np.cbrt((np.abs(6 * c3) / rates.jerk).max(axis=1)),
        ]
    )
    return factors
