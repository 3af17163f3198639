"""What has left the nozzle, and how fast powder flows, from readings that lag behind.

State (y2, y1, M, k), with the balance as two equal poles of time constant tau:

    y1' = (M - y1) / tau,   y2' = (y1 - y2) / tau,   M' = k phi(D(t)),   k' = noise;     reading = y2 + noise

M [mg] is what has left the nozzle: while powder lands steadily its momentum weighs as much as what is in
flight (the hourglass problem, Tuinstra & Tuinstra, Europhysics News 41/4, 2010), so the pan reads what
has left. k [mg s^-1 mm^-n] is the flow's coefficient, phi the opening's (`scuhand_bt.dosing.valve`). Between two
readings phi is taken at its mean, for which the transition is exact. M is disturbed by surges: lumps of
mean mass m at a rate q/m give M the variance 2 m q dt; m is tuned until the innovations have the size that
they claim (adaptive Kalman filtering, Mehra, IEEE Trans. Autom. Control 17, 1972).
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

K_WALK_PER_S = 0.2
"""Relative random walk of k, per square root of a second."""
BRIDGED_WALK_PER_S = 1.0
"""The same where bridges form and break."""
BRIDGES_PER_S = 2.0
"""How often a bridge may form or break: where k is below its reference, it may return to it at any moment."""
UNSTEADY_S = 0.05
"""While the flow changes, what lands weighs otherwise than what is in flight: so many seconds of the change."""
SURGE_GAIN = 0.03
LARGEST_SURGE_MG = 12.0
SMALLEST_SURGE_MG = 0.01


class FlowFilter:
    """A Kalman filter over the balance's lag and the powder's flow."""

    def __init__(
        self,
        net_mg: float,
        coefficient: float,
        spread: float,
        surge_mg: float,
        lag_s: float,
        walk_per_s: float = K_WALK_PER_S,
    ) -> None:
        self.lag_s, self._walk_per_s = lag_s, walk_per_s
        self.log_likelihood = 0.0
        self.surge_mg = max(surge_mg, SMALLEST_SURGE_MG)
        self._x = np.array([net_mg, net_mg, net_mg, coefficient])
        self._p = np.diag([0.02, 0.02, 0.02, (spread * coefficient) ** 2])
        self._f = np.eye(4)
        self._mean_phi = 0.0

    @property
    def mass_mg(self) -> float:
        """What has left the nozzle."""
        return float(self._x[2])

    @property
    def mass_sd_mg(self) -> float:
        return math.sqrt(max(float(self._p[2, 2]), 0.0))

    @property
    def coefficient(self) -> float:
        """k, never negative."""
        return max(float(self._x[3]), 0.0)

    @property
    def coefficient_sd(self) -> float:
        return math.sqrt(max(float(self._p[3, 3]), 0.0))

    def widen(self, relative_sd: float, reference: float) -> None:
        """The opening has changed: what was learnt of k holds a little less."""
        self._p[3, 3] += (relative_sd * reference) ** 2

    def expect(self, coefficient: float) -> None:
        """Powder may begin to flow at any moment: nothing is known but the reference."""
        self._x[3] = coefficient
        self._p[3, :] = self._p[:, 3] = 0.0
        self._p[3, 3] = (0.5 * coefficient) ** 2

    def rescale(self, ratio: float) -> None:
        """phi was `ratio` times too small: so was k too large."""
        self._x[3] /= ratio
        self._p[3, :] /= ratio
        self._p[:, 3] /= ratio

    def restart(self, net_mg: float, sd_mg: float, reference: float, spread: float) -> None:
        """A stable mean, valve shut: the masses are known, k is what a new opening may be expected to show."""
        self._x = np.array([net_mg, net_mg, net_mg, reference])
        variance = sd_mg * sd_mg
        self._p = np.diag([variance, variance, variance, (spread * reference) ** 2])

    def update(self, dt_s: float, phi_s: float, reading_mg: float, noise_mg: float, reference: float) -> float:
        """Take in a reading `dt_s` after the last, over which phi integrated to `phi_s`.

        Returns the innovation in standard deviations.
        """
        tau = self.lag_s
        a = math.exp(-dt_s / tau)
        b = dt_s / tau * a
        mean_phi = phi_s / dt_s
        f = self._f
        f[0, 0], f[0, 1], f[0, 2] = a, b, 1.0 - a - b
        f[0, 3] = mean_phi * (dt_s - 2.0 * tau * (1.0 - a) + dt_s * a)
        f[1, 1], f[1, 2], f[1, 3] = a, 1.0 - a, mean_phi * (dt_s - tau * (1.0 - a))
        f[2, 3] = phi_s
        x = f @ self._x
        p = f @ self._p @ f.T
        flow_mg = max(self.coefficient, 0.1 * reference) * phi_s
        p[2, 2] += 2.0 * self.surge_mg * flow_mg + 1e-6
        p[1, 1] += (UNSTEADY_S * self.coefficient * (mean_phi - self._mean_phi)) ** 2
        self._mean_phi = mean_phi
        if phi_s > 0.0:
            bridged = max(reference - float(x[3]), 0.0)
            p[3, 3] += ((self._walk_per_s * reference) ** 2 + BRIDGES_PER_S * bridged * bridged) * dt_s
        variance = float(p[0, 0]) + noise_mg * noise_mg
        innovation_mg = reading_mg - float(x[0])
        gain = p[:, 0] / variance
        self._x = x + gain * innovation_mg
        self._p = p - np.outer(gain, p[0])
        if self._x[3] < 0.0:
            self._x[3] = 0.0
        score = innovation_mg / math.sqrt(variance)
        self.log_likelihood -= 0.5 * (math.log(variance) + score * score)
        if flow_mg > 0.01:
            told = 1.0 - noise_mg * noise_mg / variance  # noise alone says nothing about surges
            self.surge_mg *= math.exp(SURGE_GAIN * told * (min(score * score, 4.0) - 0.9))
            self.surge_mg = min(max(self.surge_mg, SMALLEST_SURGE_MG), LARGEST_SURGE_MG)
        return score


FIT_SPREAD = 3.0
"""How little is known of k when an opening is looked at afterwards."""


class Row(NamedTuple):
    """One reading of an opening and its tail, as `FlowFilter.update` takes it."""

    dt_s: float
    phi_s: float
    reading_mg: float
    noise_mg: float
    widened: float = 0.0
    """What k was widened by before it, relative to the reference."""


def likelihood(rows: Sequence[Row], coefficient: float, surge_mg: float, lag_s: float) -> tuple[float, float]:
    """How likely (natural logarithm) an opening's readings are, and the mean square of their innovations.

    Steady flow or one that stops and starts: the better of the two tells, so that a bridge passes neither for a
    lag nor for lumps.
    """
    best = (-math.inf, math.inf)
    for walk_per_s in (K_WALK_PER_S, BRIDGED_WALK_PER_S):
        trial = FlowFilter(rows[0].reading_mg, coefficient, FIT_SPREAD, surge_mg, lag_s, walk_per_s)
        unseen_mg = coefficient * rows[0].phi_s / rows[0].dt_s * 2.0 * lag_s
        trial.restart(rows[0].reading_mg, 0.15 + unseen_mg, coefficient, FIT_SPREAD)
        squares = 0.0
        for row in rows:
            if row.widened:
                trial.widen(row.widened, coefficient)
            squares += trial.update(row.dt_s, row.phi_s, row.reading_mg, row.noise_mg, coefficient) ** 2
            trial.surge_mg = surge_mg
        best = max(best, (trial.log_likelihood, squares / len(rows)))
    return best


LAST_ROWS = 150
"""An opening is looked at from so many readings before the end of its tail."""
LAGS_S = tuple(float(lag_s) for lag_s in np.geomspace(0.06, 1.6, 16))
CLEARER = 3.0
"""A lag is told when it is this much likelier (natural logarithm) than those two steps of the grid away."""


def fit_lag(rows: Sequence[Row], coefficient: float, surge_mg: float) -> float | None:
    """The lag per pole that makes an opening's readings likeliest; None if they do not tell.

    The maximum over a grid is refined by a parabola through its neighbours. A maximum at the end of the grid,
    one that is not clear, or one whose innovations are still far too large is refused.
    """
    if len(rows) < 12:
        return None
    rows = rows[-LAST_ROWS:]
    scores = [likelihood(rows, coefficient, surge_mg, lag_s) for lag_s in LAGS_S]
    best = max(range(len(scores)), key=lambda index: scores[index][0])
    if not 2 <= best < len(scores) - 2 or scores[best][1] > 3.0:
        return None
    likelihoods = [score for score, _ in scores]
    if likelihoods[best] - max(likelihoods[best - 2], likelihoods[best + 2]) < CLEARER:
        return None
    left, middle, right = likelihoods[best - 1 : best + 2]
    shift = 0.5 * (left - right) / (left - 2.0 * middle + right)
    return float(LAGS_S[best] * (LAGS_S[1] / LAGS_S[0]) ** shift)


SURGES_MG = tuple(float(surge_mg) for surge_mg in np.geomspace(SMALLEST_SURGE_MG, LARGEST_SURGE_MG, 8))


def fit_surge(rows: Sequence[Row], coefficient: float, believed_mg: float, lag_s: float, doubt: float) -> float:
    """The surge scale after an opening: the mean of its logarithm, by how likely each makes the readings.

    `doubt` is the standard deviation of the logarithm of what was believed before.
    """
    logs = np.log(SURGES_MG)
    scores = np.array([likelihood(rows[-LAST_ROWS:], coefficient, m, lag_s)[0] for m in SURGES_MG])
    scores -= 0.5 * ((logs - math.log(max(believed_mg, SMALLEST_SURGE_MG))) / doubt) ** 2
    weights = np.exp(scores - scores.max())
    return float(np.exp(weights @ logs / weights.sum()))
