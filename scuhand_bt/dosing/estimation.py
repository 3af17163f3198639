"""What has left the nozzle, how fast powder flows, and what the balance is, from readings that lag behind.

A bank of Kalman filters (multiple-model estimation: Magill, IEEE Trans. Autom. Control 10, 1965), one for each model of
the balance that is still thinkable, all of which see the same readings:

    y'' = w^2 (M - y) - 2 z w y'          M' = k phi(D) + g phi'(D)          reading(t) = y(t - d) + noise

M [mg] is what has left the nozzle: while powder lands steadily its momentum weighs as much as what is in flight (the
hourglass problem, Tuinstra & Tuinstra, Europhysics News 41/3, 2010), so the pan reads what has left. k [mg s^-1 mm^-n]
is the flow's coefficient, phi the opening's (`scuhand_bt.dosing.valve`), and g = k e, with e [mm] what the real opening
is off by. w, z and d are the balance's: natural frequency, damping and pure delay. Each filter runs d behind, and what
the valve let out since is added with its own uncertainty; between two readings phi is taken at its mean, for which
the transition is exact. A model's weight is how likely it makes the readings.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from scuhand_bt.dosing.identification import LEAST_DOUBT, MASS, READING, SHAPES, Array, G, K, Row, transitions
from scuhand_bt.specs import BalanceBelief

DELAYS_S = tuple(float(delay_s) for delay_s in np.geomspace(0.1, 8.0, 14))
"""Mean delays that a balance nothing is known of may have."""
NEAR = (-1.8, -1.2, -0.6, 0.0, 0.6, 1.2, 1.8)
"""Delays of a balance that was identified, in standard deviations of their logarithm from what was found."""
SAME_SHAPE = 0.98
"""Probability that the kind of filter was identified rightly."""
CHANGED, SLOWER = 0.01, 1.5
"""Probability that the balance has been set slower than in the opening before; by this factor at least."""
K_WALK_PER_S = 0.2
"""Relative random walk of k, per square root of a second."""
BRIDGES_PER_S = 2.0
"""How often a bridge may form or break: where k is below its reference, it may return to it at any moment."""
OPENING_ERROR_MM, UNKNOWN_ERROR_MM = 0.05, 0.15
"""Standard deviation of what the real opening is off by: the sheet buckles a little differently each time. At
first the threshold is a guess as well."""
UNSTEADY_S = 0.05
"""While the flow changes, what lands weighs otherwise than what is in flight: so many seconds of the change."""
LEAST_MISFIT = 0.01
"""No balance is just its model: the share of what is unseen that every model is taken to be off by, at least."""
UNEVEN = 0.1
"""How unevenly powder flows: the relative standard deviation of what comes in a second."""
TEMPER = 0.2
"""What a reading tells of the balance, as a share of what it would if errors were independent of each other."""
CHANGE_S = (0.3, 3.0)
"""A steady flow tells nothing of the balance: means of phi over these times must differ."""
LEAST_SPREAD = 0.5
"""Of k, relative to its reference: how unsure it can become while powder flows, at least."""
EXPONENT_ERROR = 0.5
"""What a powder's exponent may be off by: k holds the less, the more the opening has changed."""
SURGE_GAIN, LEAST_SURGE_MG, MOST_SURGE_MG = 0.03, 0.01, 12.0
"""How fast the lumps' mean mass follows the innovations while powder flows; and its bounds."""
AS_EXPECTED, SURPRISING = 0.9, 4.0
"""A squared innovation, in variances, that leaves it as it is; and from where on it counts no more."""
FARTHEST = 5.0
"""An innovation of more standard deviations tells no more: one lump or one knock rules out no model."""
LEAST_WEIGHT = 1e-3
"""Models less likely than this are dropped until the valve has been shut."""
UNKNOWN_SPREAD = 1.5
"""Of the flow of a powder that nothing was learnt of: it may be five times what is believed."""


class Model(NamedTuple):
    """A balance: its mean delay and its shape, one of `SHAPES`."""

    delay_s: float
    shape: str


class Bank:
    """The filters side by side, H of them: weights (H,), states (H, 5), covariances (H, 5, 5)."""

    def __init__(self, models: Sequence[Model], weights: Array, surge_mg: float, misfit: float) -> None:
        """`weights` (H,) need not add up to 1."""
        self.surge_mg, self.misfit = max(surge_mg, LEAST_SURGE_MG), max(misfit, LEAST_MISFIT)
        """The mean mass of the lumps that powder comes in; the share of what is unseen that the models are off by."""
        self.models, self.weights = list(models), weights / weights.sum()
        self.erratic = 1.0
        """By what factor the variances of what is coming have turned out to be too small."""
        self.restart(0.0, 1.0, 1.0, 1.0)

    @classmethod
    def believing(cls, balance: BalanceBelief, surge_mg: float) -> "Bank":
        """Near what is believed of the balance; and, as it may have been set slower, a little of longer delays.

        That it was set faster is never assumed: so it looks when a sheet that stuck lets out more than was expected.
        """
        if balance.fits == 0:
            models = [Model(delay_s, shape) for shape in SHAPES for delay_s in DELAYS_S]
            return cls(models, np.ones(len(models)), surge_mg, balance.misfit)
        far = np.array(NEAR) * max(balance.doubt, LEAST_DOUBT)
        near = [Model(2.0 * balance.lag_s * math.exp(step), shape) for shape in SHAPES for step in far]
        others = (1.0 - SAME_SHAPE) / (len(SHAPES) - 1)
        shares = np.array([SAME_SHAPE if shape == balance.shape else others for shape in SHAPES])
        ours = np.outer(shares, np.exp(-0.5 * np.square(NEAR))).ravel()
        slower = [Model(delay_s, balance.shape) for delay_s in DELAYS_S if delay_s > 2.0 * balance.lag_s * SLOWER]
        weights = np.append((1.0 - CHANGED) * ours / ours.sum(), np.full(len(slower), CHANGED / max(len(slower), 1)))
        return cls([*near, *slower], weights, surge_mg, balance.misfit)

    def restart(
        self, mass_mg: float, sd_mg: float, coefficient: float, spread: float, error_mm: float = OPENING_ERROR_MM
    ) -> None:
        """A balance at rest, valve shut: the mass is known to `sd_mg`, k is what a new opening may be expected to show.

        `spread` is k's standard deviation relative to `coefficient`, `error_mm` the opening's. The weights stay.
        """
        x, p = np.zeros(5), np.zeros((5, 5))
        x[[READING, MASS]], x[K] = mass_mg, coefficient
        p[np.ix_((READING, MASS), (READING, MASS))] = sd_mg**2
        self._most_sd = max(spread, LEAST_SPREAD)
        p[K, K], p[G, G] = (spread * coefficient) ** 2, (error_mm * coefficient) ** 2
        many = len(self.models)
        self._x, self._p = np.tile(x, (many, 1)), np.tile(p, (many, 1, 1))
        self._phi = np.zeros(many)
        self._unseen = np.zeros((2, many))
        self._means, self._changing = [0.0, 0.0], 0.0
        self._passed, self._readings = np.zeros((2, 256)), 0
        self._left: tuple[Array, Array] | None = None
        self._look_up()

    def _look_up(self) -> None:
        """What depends on which models there are."""
        self.delays_s = np.array([model.delay_s for model in self.models])
        self._pure, self._damping = np.array([SHAPES[model.shape] for model in self.models]).T
        self._transitions: dict[float, tuple[Array, Array]] = {}

    def _transition(self, dt_s: float) -> tuple[Array, Array]:
        dt_s = round(dt_s, 3)
        if dt_s not in self._transitions:
            self._transitions[dt_s] = transitions(self.delays_s, self._pure, self._damping, dt_s)
        return self._transitions[dt_s]

    def _late(self, dt_s: float, phi_s: float, slope_s: float) -> Array:
        """(2, H): phi's and its slope's integrals over what each model sees now; notes what is yet to see."""
        if self._readings + 1 == self._passed.shape[1]:
            self._passed = np.append(self._passed, np.zeros_like(self._passed), axis=1)
        self._readings += 1
        for mean, over_s in enumerate(CHANGE_S):
            self._means[mean] += (phi_s / dt_s - self._means[mean]) * -math.expm1(-dt_s / over_s)
        self._changing = abs(self._means[0] - self._means[1]) / max(*self._means, 1e-9)
        now = self._passed[:, self._readings] = self._passed[:, self._readings - 1] + (phi_s, slope_s)
        seen = np.maximum(self._readings - np.rint(self._pure * self.delays_s / dt_s).astype(int), 0)
        self._unseen = now[:, None] - self._passed[:, seen]
        return self._passed[:, seen] - self._passed[:, np.maximum(seen - 1, 0)]

    def update(self, row: Row, reference: float) -> float:
        """Take in a reading; `reference` is k where nothing is in the powder's way.

        Returns the likeliest model's innovation in standard deviations.
        """
        dt_s, self._left = row.dt_s, None
        self._p[:, K, K] += (EXPONENT_ERROR * row.changed * np.maximum(self._x[:, K], 0.0)) ** 2
        phi_s, slope_s = self._late(dt_s, row.phi_s, row.slope_s)
        still, adds = self._transition(dt_s)
        f = still.copy()
        f[:, :, K] += adds * phi_s[:, None]
        f[:, :, G] += adds * slope_s[:, None]
        x = np.matmul(f, self._x[:, :, None])[:, :, 0]
        p = np.matmul(np.matmul(f, self._p), f.transpose(0, 2, 1))
        k = np.maximum(self._x[:, K], 0.0)
        flow_mg = np.maximum(k, 0.1 * reference) * phi_s
        p[:, MASS, MASS] += 2.0 * self.surge_mg * flow_mg + (UNEVEN * flow_mg) ** 2 / dt_s + 1e-6
        bridged = np.maximum(reference - k, 0.0)
        walk = ((K_WALK_PER_S * reference) ** 2 + BRIDGES_PER_S * bridged**2) * dt_s * (phi_s > 0.0)
        p[:, K, K] = np.minimum(p[:, K, K] + walk, np.maximum(p[:, K, K], (self._most_sd * reference) ** 2))
        changed_mg = UNSTEADY_S * k * (phi_s / dt_s - self._phi)
        self._phi = phi_s / dt_s
        unseen_mg = x[:, MASS] - x[:, READING]
        unexplained = row.noise_mg**2 + changed_mg**2 + (self.misfit * unseen_mg) ** 2
        variance = p[:, READING, READING] + unexplained
        innovation_mg = row.reading_mg - x[:, READING]
        gain = p[:, :, READING] / variance[:, None]
        self._x = x + gain * innovation_mg[:, None]
        self._x[:, K] = np.maximum(self._x[:, K], 0.0)
        self._p = p - gain[:, :, None] * p[:, None, READING, :]
        best = int(np.argmax(self.weights))
        score = float(innovation_mg[best] / math.sqrt(variance[best]))
        if k[best] * phi_s[best] > 0.01:
            told = float(1.0 - unexplained[best] / variance[best])  # noise alone says nothing about lumps
            self.surge_mg *= math.exp(SURGE_GAIN * told * (min(score * score, SURPRISING) - AS_EXPECTED))
            self.surge_mg = min(max(self.surge_mg, LEAST_SURGE_MG), MOST_SURGE_MG)
        # One variance for all: a model that sees less unseen is not the likelier for claiming to know it better.
        common = float(self.weights @ p[:, READING, READING]) + row.noise_mg**2 + float(self.weights @ changed_mg**2)
        self._weigh(innovation_mg**2 / common)
        return score

    def _weigh(self, squares: Array) -> None:
        """The models' weights after a reading; those that are out of the question are dropped."""
        told = 0.5 * TEMPER * self._changing * np.minimum(squares, FARTHEST**2)
        logs = np.log(np.maximum(self.weights, 1e-300)) - told
        weights = np.exp(logs - logs.max())
        kept = weights > LEAST_WEIGHT
        self.weights = weights[kept] / weights[kept].sum()
        if not kept.all():
            self.models = [model for model, keep in zip(self.models, kept, strict=True) if keep]
            self._x, self._p, self._phi = self._x[kept], self._p[kept], self._phi[kept]
            self._unseen = self._unseen[:, kept]
            self._look_up()

    # --- what is known ---

    def coming(self, phi_s: Array | float = 0.0, slope_s: Array | float = 0.0) -> tuple[Array, Array]:
        """Mean [mg] and variance [mg^2] of the mass that will have left, by model, (..., H).

        Until then the integrals of phi and of its slope, (...), grow by as much.
        """
        phi_s = self._unseen[0] + np.asarray(phi_s)[..., None]
        slope_s = self._unseen[1] + np.asarray(slope_s)[..., None]
        p, k = self._p, np.maximum(self._x[:, K], 0.0)
        mean = self._x[:, MASS] + np.maximum(k * phi_s + self._x[:, G] * slope_s, 0.0)
        variance = p[:, MASS, MASS] + 2.0 * (p[:, MASS, K] * phi_s + p[:, MASS, G] * slope_s)
        variance += p[:, K, K] * phi_s**2 + 2.0 * p[:, K, G] * phi_s * slope_s + p[:, G, G] * slope_s**2
        variance += (self.misfit * (mean - self._x[:, READING])) ** 2
        return mean, (np.maximum(variance, 0.0) + 2.0 * self.surge_mg * k * phi_s) * self.erratic

    def flow(self, phi: Array, slope: Array) -> tuple[Array, Array]:
        """Mean and standard deviation of the flow [mg/s], by model, (..., H), at an opening's phi and slope."""
        phi, slope = phi[..., None], slope[..., None]
        p = self._p
        variance = p[:, K, K] * phi**2 + 2.0 * p[:, K, G] * phi * slope + p[:, G, G] * slope**2
        return np.maximum(self._x[:, K] * phi + self._x[:, G] * slope, 0.0), np.sqrt(np.maximum(variance, 0.0))

    @property
    def left(self) -> tuple[Array, Array]:
        """Mean [mg] and variance [mg^2] of what has left the nozzle by now, by model, (H,)."""
        if self._left is None:
            self._left = self.coming()
        return self._left

    @property
    def mass_mg(self) -> float:
        """What has left the nozzle."""
        return float(self.weights @ self.left[0])

    @property
    def mass_sd_mg(self) -> float:
        """Its standard deviation, with what the models differ by."""
        means, variances = self.left
        return math.sqrt(float(self.weights @ (variances + (means - self.weights @ means) ** 2)))

    @property
    def coefficient(self) -> float:
        """k, in mg s^-1 mm^-n."""
        return float(self.weights @ self._x[:, K])

    @property
    def coefficient_sd(self) -> float:
        """Its standard deviation, with what the models differ by."""
        spread = self.weights @ (self._p[:, K, K] + (self._x[:, K] - self.coefficient) ** 2)
        return math.sqrt(max(float(spread), 0.0))

    @property
    def delay_s(self) -> float:
        """The balance's mean delay."""
        return float(self.weights @ self.delays_s)

    @property
    def unseen_mg(self) -> float:
        """What has left and is not read yet, with twice what that may be off by."""
        means, _ = self.left
        behind = means - self._x[:, READING]
        mean = float(self.weights @ behind)
        return abs(mean) + 2.0 * math.sqrt(float(self.weights @ ((behind - mean) ** 2)))
