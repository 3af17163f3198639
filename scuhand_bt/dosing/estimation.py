"""What has left the nozzle, and how fast powder flows, from readings that lag behind.

State (yn, .. y1, M, k), with the balance as n equal poles of time constant tau, together a delay of n tau:

    y1' = (M - y1) / tau,  yi' = (y(i-1) - yi) / tau,  M' = k phi(D(t)),  k' = noise;   reading = yn + noise

M [mg] is what has left the nozzle: while powder lands steadily its momentum weighs as much as what is in
flight (the hourglass problem, Tuinstra & Tuinstra, Europhysics News 41/3, 2010), so the pan reads what
has left. k [mg s^-1 mm^-n] is the flow's coefficient, phi the opening's (`scuhand_bt.dosing.valve`). Between two
readings phi is taken at its mean, for which the transition is exact. No balance is just n poles: what it has not
shown yet, M - yn, is taken to be off by a share of it, the misfit. M is disturbed by surges: lumps of
mean mass m at a rate q/m give M the variance 2 m q dt; m is tuned until the innovations have the size that
they claim (adaptive Kalman filtering, Mehra, IEEE Trans. Autom. Control 17, 1972).
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Values = Any
"""A float, or an array of them for as many filters side by side."""

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


def transition(dt_s: float, lag_s: Values, poles: int) -> tuple[Array, Array]:
    """(..., n + 2, n + 2) of the state over `dt_s` but for k's column; that column, per unit of phi's integral.

    What enters one pole passes i poles in dt with the probability of i events of a Poisson process of rate 1/tau.
    """
    tau = np.asarray(2.0 * np.asarray(lag_s) / poles)
    passes, arrived, ramp = np.exp(-dt_s / tau), np.ones_like(tau), np.full_like(tau, dt_s)
    f = np.zeros((*tau.shape, poles + 2, poles + 2))
    f[..., -2, -2] = f[..., -1, -1] = 1.0
    column = np.zeros((*tau.shape, poles + 2))
    column[..., -2] = 1.0
    for i in range(poles):
        for row in range(poles - i):
            f[..., row, row + i] = passes
        arrived = arrived - passes
        ramp = ramp - tau * arrived
        f[..., poles - 1 - i, -2] = arrived
        column[..., poles - 1 - i] = ramp / dt_s
        passes = passes * dt_s / tau / (i + 1)
    return f, column


class FlowFilter:
    """A Kalman filter over the balance's lag and the powder's flow.

    `surge_mg`, `lag_s` and `walk_per_s` may be arrays that broadcast: as many filters side by side, which see the same.
    """

    def __init__(
        self,
        net_mg: float,
        coefficient: float,
        spread: float,
        surge_mg: Values,
        lag_s: Values,
        poles: int = 2,
        misfit: float = 0.0,
        walk_per_s: Values = K_WALK_PER_S,
    ) -> None:
        self._shape = np.broadcast_shapes(np.shape(surge_mg), np.shape(lag_s), np.shape(walk_per_s))
        self._walk_per_s = walk_per_s
        self.log_likelihood: Values = 0.0
        self.surge_mg: Values = np.maximum(surge_mg, SMALLEST_SURGE_MG)
        self.set_balance(lag_s, poles, misfit)
        self._mean_phi = 0.0
        self.restart(net_mg, math.sqrt(0.02), coefficient, spread)

    def set_balance(self, lag_s: Values, poles: int, misfit: float) -> None:
        """Half the balance's delay, the poles that share it, and the misfit; `restart` must follow."""
        self.lag_s, self.poles, self.misfit = lag_s, poles, misfit
        self._transitions: dict[float, tuple[Array, Array]] = {}

    @property
    def mass_mg(self) -> float:
        """What has left the nozzle."""
        return float(self._x[-2])

    @property
    def mass_sd_mg(self) -> float:
        return math.sqrt(max(float(self._p[-2, -2]), 0.0))

    @property
    def coefficient(self) -> float:
        """k, never negative."""
        return max(float(self._x[-1]), 0.0)

    @property
    def coefficient_sd(self) -> float:
        return math.sqrt(max(float(self._p[-1, -1]), 0.0))

    def widen(self, relative_sd: float, reference: float) -> None:
        """The opening has changed: what was learnt of k holds a little less."""
        self._p[..., -1, -1] += (relative_sd * reference) ** 2

    def expect(self, coefficient: float) -> None:
        """Powder may begin to flow at any moment: nothing is known but the reference."""
        self._x[-1] = coefficient
        self._p[-1, :] = self._p[:, -1] = 0.0
        self._p[-1, -1] = (0.5 * coefficient) ** 2

    def rescale(self, ratio: float) -> None:
        """phi was `ratio` times too small: so was k too large."""
        self._x[-1] /= ratio
        self._p[-1, :] /= ratio
        self._p[:, -1] /= ratio

    def restart(self, net_mg: float, sd_mg: Values, reference: float, spread: float) -> None:
        """A stable mean, valve shut: the masses are known, k is what a new opening may be expected to show."""
        size = self.poles + 2
        self._x = np.full((*self._shape, size), net_mg)
        self._x[..., -1] = reference
        self._p = np.eye(size) * np.broadcast_to(np.square(sd_mg), self._shape)[..., None, None]
        self._p[..., -1, -1] = (spread * reference) ** 2

    def _transition(self, dt_s: float) -> tuple[Array, Array]:
        dt_s = round(dt_s, 6)
        if dt_s not in self._transitions:
            self._transitions[dt_s] = transition(dt_s, self.lag_s, self.poles)
        return self._transitions[dt_s]

    def update(self, dt_s: float, phi_s: float, reading_mg: float, noise_mg: float, reference: float) -> Values:
        """Take in a reading `dt_s` after the last, over which phi integrated to `phi_s`.

        Returns the innovation in standard deviations.
        """
        mean_phi = phi_s / dt_s
        f, column = self._transition(dt_s)
        f = f.copy()
        f[..., :-1, -1] = column[..., :-1] * phi_s
        x = (f @ self._x[..., None])[..., 0]
        p = f @ self._p @ np.swapaxes(f, -1, -2)
        k = np.maximum(self._x[..., -1], 0.0)
        flow_mg = np.maximum(k, 0.1 * reference) * phi_s
        p[..., -2, -2] += 2.0 * self.surge_mg * flow_mg + 1e-6
        p[..., -3, -3] += (UNSTEADY_S * k * (mean_phi - self._mean_phi)) ** 2
        self._mean_phi = mean_phi
        if phi_s > 0.0:
            bridged = np.maximum(reference - x[..., -1], 0.0)
            p[..., -1, -1] += ((self._walk_per_s * reference) ** 2 + BRIDGES_PER_S * bridged * bridged) * dt_s
        unexplained = noise_mg * noise_mg + np.square(self.misfit * (x[..., -2] - x[..., 0]))
        variance = p[..., 0, 0] + unexplained
        innovation_mg = reading_mg - x[..., 0]
        gain = p[..., :, 0] / variance[..., None]
        self._x = x + gain * innovation_mg[..., None]
        self._p = p - gain[..., :, None] * p[..., None, 0, :]
        self._x[..., -1] = np.maximum(self._x[..., -1], 0.0)
        score = innovation_mg / np.sqrt(variance)
        self.log_likelihood = self.log_likelihood - 0.5 * (np.log(variance) + score * score)
        if self._shape == () and flow_mg > 0.01:
            told = 1.0 - unexplained / variance  # noise alone says nothing about surges
            self.surge_mg = self.surge_mg * math.exp(SURGE_GAIN * told * (min(score * score, 4.0) - 0.9))
            self.surge_mg = min(max(float(self.surge_mg), SMALLEST_SURGE_MG), LARGEST_SURGE_MG)
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


def likelihood(
    rows: Sequence[Row], coefficient: float, surge_mg: Values, lag_s: Values, poles: int
) -> tuple[Array, Array]:
    """How likely (natural logarithm) an opening's readings are, and the mean square of their innovations.

    Steady flow or one that stops and starts: the better of the two tells, so that a bridge passes neither for a
    lag nor for lumps.
    """
    walks = np.array([[K_WALK_PER_S], [BRIDGED_WALK_PER_S]])
    trial = FlowFilter(rows[0].reading_mg, coefficient, FIT_SPREAD, surge_mg, lag_s, poles, walk_per_s=walks)
    unseen_mg = coefficient * rows[0].phi_s / rows[0].dt_s * 2.0 * np.asarray(lag_s)
    trial.restart(rows[0].reading_mg, 0.15 + unseen_mg, coefficient, FIT_SPREAD)
    squares = np.zeros(())
    for row in rows:
        if row.widened:
            trial.widen(row.widened, coefficient)
        squares = squares + np.square(trial.update(row.dt_s, row.phi_s, row.reading_mg, row.noise_mg, coefficient))
    scores = np.asarray(trial.log_likelihood)
    better = np.argmax(scores, axis=0)[None]
    return np.take_along_axis(scores, better, 0)[0], np.take_along_axis(squares / len(rows), better, 0)[0]


LAST_ROWS = 150
"""An opening is looked at from so many readings before the end of its tail."""
LAGS_S = tuple(float(lag_s) for lag_s in np.geomspace(0.06, 1.6, 16))
CLEARER = 3.0
"""A lag is told when it is this much more likely (natural logarithm) than those two steps of the grid away."""


def fit_lag(rows: Sequence[Row], coefficient: float, surge_mg: float, poles: int = 2) -> float | None:
    """The lag that makes an opening's readings likeliest; None if they do not tell.

    The maximum over a grid is refined by a parabola through its neighbours. A maximum at the end of the grid,
    one that is not clear, or one whose innovations are still far too large is refused.
    """
    if len(rows) < 12:
        return None
    scores, squares = likelihood(rows[-LAST_ROWS:], coefficient, surge_mg, np.array(LAGS_S), poles)
    best = int(np.argmax(scores))
    if not 2 <= best < len(LAGS_S) - 2 or squares[best] > 3.0:
        return None
    if scores[best] - max(scores[best - 2], scores[best + 2]) < CLEARER:
        return None
    left, middle, right = scores[best - 1 : best + 2]
    shift = 0.5 * (left - right) / (left - 2.0 * middle + right)
    return float(LAGS_S[best] * (LAGS_S[1] / LAGS_S[0]) ** shift)


SURGES_MG = tuple(float(surge_mg) for surge_mg in np.geomspace(SMALLEST_SURGE_MG, LARGEST_SURGE_MG, 8))


def fit_surge(
    rows: Sequence[Row], coefficient: float, believed_mg: float, lag_s: float, doubt: float, poles: int = 2
) -> float:
    """The surge scale after an opening: the mean of its logarithm, by how likely each makes the readings.

    `doubt` is the standard deviation of the logarithm of what was believed before.
    """
    logs = np.log(SURGES_MG)
    scores, _ = likelihood(rows[-LAST_ROWS:], coefficient, np.array(SURGES_MG), lag_s, poles)
    scores = scores - 0.5 * ((logs - math.log(max(believed_mg, SMALLEST_SURGE_MG))) / doubt) ** 2
    weights = np.exp(scores - scores.max())
    return float(np.exp(weights @ logs / weights.sum()))


POLES = (2, 3, 4, 6)
"""A moving mean is followed best by four or more; one pole would follow a flow that stopped early."""
SETTLED = 5
"""Readings at the end of a tail that tell what all came to."""


class StepFit(NamedTuple):
    """A balance as it followed a short opening: see `BalanceBelief`."""

    lag_s: float
    poles: int
    misfit: float


def fit_step(rows: Sequence[Row], noise_mg: float) -> StepFit | None:
    """How a balance followed an opening and its whole tail, if the flow was phi's; None if nothing came.

    The area between what has left and what is read is the delay times the mass, whatever the balance's filter. The
    number of poles is the one that follows the readings best.
    """
    before_mg, after_mg = rows[0].reading_mg, sum(row.reading_mg for row in rows[-SETTLED:]) / SETTLED
    fell = np.cumsum([row.phi_s for row in rows])
    if len(rows) < 2 * SETTLED or fell[-1] <= 0.0 or after_mg - before_mg < 3.0 * noise_mg:
        return None
    fell /= fell[-1]
    read = (np.array([row.reading_mg for row in rows]) - before_mg) / (after_mg - before_mg)
    lag_s = float(np.sum((fell - read) * np.array([row.dt_s for row in rows]))) / 2.0
    if not LAGS_S[0] < lag_s < LAGS_S[-1]:
        return None
    noise = 2.0 * noise_mg / (after_mg - before_mg)
    fits = ((float(np.max(np.abs(read - _followed(rows, fell, lag_s, poles)))), poles) for poles in POLES)
    misfit, poles = min(fits)
    return StepFit(lag_s, poles, max(0.0, misfit - noise))


def _followed(rows: Sequence[Row], fell: Array, lag_s: float, poles: int) -> Array:
    """What a balance of these poles reads while `fell` falls."""
    state, readings = np.zeros(poles + 2), []
    for row, more in zip(rows, np.diff(fell, prepend=0.0), strict=True):
        f, column = transition(row.dt_s, lag_s, poles)
        state = f @ state + column * more
        readings.append(state[0])
    return np.array(readings)
