"""What has left the nozzle, the flow, and the balance, by readings that lag behind (docs/dosing.md, The bank).

A bank of Kalman filters (multiple-model estimation: Magill, IEEE Trans. Autom. Control 10, 1965), one per plausible
balance, sees the same readings:

    y'' = w^2 (M - y) - 2 z w y'          M' = k phi(D) + g phi'(D)          reading(t) = y(t - d) + noise

The symbols are those of docs/dosing.md. M [mg] is what has left the nozzle: while powder lands steadily, its momentum
weighs as much as what is in flight (the hourglass problem, Tuinstra & Tuinstra, Europhysics News 41/3, 2010). Each
filter runs its dead time d behind; what the valve has let out since is added as a prediction. Between two readings phi
is taken at its mean, for which the transition is exact. A filter's weight is its likelihood.
"""

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from scuhand_bt.dosing import filters
from scuhand_bt.dosing.identification import LEAST_DOUBT, MASS, READING, SHAPES, Array, G, K, Row, transitions
from scuhand_bt.specs import BalanceBelief

DELAYS_S = tuple(float(delay_s) for delay_s in np.geomspace(0.1, 8.0, 14))
"""Mean delays of an unknown balance's filters."""
NEAR = (-1.8, -1.2, -0.6, 0.0, 0.6, 1.2, 1.8)
"""Delays of a known balance's filters, in standard deviations of their logarithm."""
SAME_SHAPE = 0.98
"""Probability that the balance's shape was identified rightly."""
CHANGED, SET_SLOWER = 0.01, 1.5
"""Probability that the balance was set slower since the last opening, by SET_SLOWER at least."""
K_WALK_PER_S = 0.2
"""Random walk of k, relative to k_ref, per root second."""
BRIDGES_PER_S = 2.0
"""Rate at which bridges may break: below its reference, k may return to it at any moment."""
OPENING_ERROR_MM, UNKNOWN_ERROR_MM = 0.05, 0.15
"""Standard deviation of the real opening from the commanded one, as the sheet buckles a little differently each time.
The second includes the threshold, as long as that is a guess."""
UNSTEADY_S = 0.05
"""While the flow changes, what lands weighs otherwise than what is in flight: by so many seconds of the change."""
LEAST_MISFIT = 0.01
"""Least error of the balance's model, as a share of what is unseen."""
UNEVEN = 0.1
"""Unevenness of the flow: relative standard deviation of what comes in a second."""
TEMPER = 0.2
"""What a reading tells about the balance, as a share of what it would if errors were independent."""
CHANGE_S = (0.3, 3.0)
"""The means of phi over these times must differ: a steady flow tells nothing about a delay."""
FREELY = 0.5
"""Powder that flows with less than this share of what is expected may be held up: bridged, or not primed."""
HELD_UP = 0.1
"""Least flow that lumps are reckoned with, as a share of the reference."""
LEAST_SPREAD = 0.5
"""Least standard deviation that k may reach while powder flows, relative to its reference."""
EXPONENT_ERROR = 0.5
"""Error of the powder's exponent: k is less certain the more the opening has changed."""
SURGE_GAIN, LEAST_SURGE_MG, MOST_SURGE_MG = 0.03, 0.01, 12.0
"""Gain at which the lumps' mean mass follows the innovations while powder flows, and its bounds."""
FLOWING_MG = 0.01
"""Less than this between two readings tells nothing about lumps."""
AS_EXPECTED, SURPRISING = 0.9, 4.0
"""A squared innovation, in variances, that leaves the lumps' mass unchanged; and the most that one counts."""
FARTHEST = 5.0
"""An innovation counts for this many standard deviations at most, so that one lump or knock rules out no model."""
UNKNOWN_SPREAD = 1.5
"""Relative standard deviation of the flow of a powder never dosed: it may be five times what is believed."""


class Model(NamedTuple):
    """A balance: its mean delay and its shape, one of `SHAPES`."""

    delay_s: float
    shape: str


class Bank:
    """H filters side by side: weights (H,), states (H, 5), covariances (H, 5, 5)."""

    def __init__(self, models: Sequence[Model], weights: Array, surge_mg: float, misfit: float) -> None:
        """`weights` (H,) need not add up to 1."""
        self.surge_mg, self.misfit = max(surge_mg, LEAST_SURGE_MG), max(misfit, LEAST_MISFIT)
        """Mean mass of lumps; error of the models as a share of what is unseen."""
        self.weights = weights / weights.sum()
        self.delays_s = np.array([model.delay_s for model in models])
        self.pure, self._damping = np.array([SHAPES[model.shape] for model in models]).T
        self._transitions: dict[float, tuple[Array, Array]] = {}
        self.temper = TEMPER
        """0 where the delay so far tells nothing about that of smaller amounts (a filter that adapts)."""
        self.erratic = 1.0
        """Factor by which the variances of predictions have proven too small."""
        self.restart(0.0, 1.0, 1.0, 1.0)

    @classmethod
    def believing(cls, balance: BalanceBelief, surge_mg: float) -> "Bank":
        """The bank of a balance as believed, with a little weight on longer delays: it may have been set slower.

        A balance set faster is never assumed: a sheet that has stuck and lets out more than expected looks the same.
        """
        shape, doubt = balance.shape if balance.fits else None, max(balance.doubt, LEAST_DOUBT)
        surely = 1.0 / len(SHAPES) if balance.may_be_late else SAME_SHAPE
        return cls(*_thinkable(balance.lag_s, doubt, shape, surely), surge_mg, balance.misfit)

    def restart(
        self, mass_mg: float, sd_mg: float, coefficient: float, spread: float, error_mm: float = OPENING_ERROR_MM
    ) -> None:
        """Restart from a balance at rest with the valve shut: the mass is known to `sd_mg`.

        k is what a new opening may show, with `spread` its standard deviation relative to `coefficient`; `error_mm` is
        that of the opening. The weights stay.
        """
        x, p = np.zeros(5), np.zeros((5, 5))
        x[[READING, MASS]], x[K] = mass_mg, coefficient
        p[np.ix_((READING, MASS), (READING, MASS))] = sd_mg**2
        self._most_sd = max(spread, LEAST_SPREAD)
        p[K, K], p[G, G] = (spread * coefficient) ** 2, (error_mm * coefficient) ** 2
        many = len(self.weights)
        self._x, self._p = np.tile(x, (many, 1)), np.tile(p, (many, 1, 1))
        # Of the last row each has seen, as `take_in` has it
        self._phi, self._seen = np.zeros(many), np.zeros(many, np.int64)
        self._unseen = np.zeros((many, 2))  # integrals of phi and of its slope
        self._means = [0.0, 0.0]
        self._passed = np.zeros((1, 3))  # per reading: its time, and both integrals until then
        self._tell()

    def _over(self, dt_s: float) -> tuple[Array, Array]:
        dt_s = round(dt_s, 3)
        if dt_s not in self._transitions:
            self._transitions[dt_s] = transitions(self.delays_s, self.pure, self._damping, dt_s)
        return self._transitions[dt_s]

    @property
    def held(self) -> filters.Filters:
        """The arguments of compiled functions."""
        arrays = self._x, self._p, self._unseen, self.weights, self.delays_s
        return *arrays, self.surge_mg, self.misfit, self.erratic

    def update(self, row: Row, reference: float) -> float:
        """Take in a reading; returns the likeliest model's innovation in standard deviations. `reference` is k_ref.

        Raises ArithmeticError where the result is not a number: compiled code reports none, and no opening may go by
        it.
        """
        for mean, over_s in enumerate(CHANGE_S):
            self._means[mean] += (row.phi_s / row.dt_s - self._means[mean]) * -math.expm1(-row.dt_s / over_s)
        changing = abs(self._means[0] - self._means[1]) / max(*self._means, 1e-9)
        now = np.add(self._passed[-1:], (row.dt_s, row.phi_s, row.slope_s))
        self._passed = np.concatenate((self._passed, now))
        still, adds = self._over(row.dt_s)
        late = self.pure * self.delays_s, self._phi, self._seen, self._passed
        now_told = row.dt_s, row.reading_mg, row.noise_mg, row.changed
        sure = reference, self._most_sd * reference, self.temper * changing
        assumed = K_WALK_PER_S, BRIDGES_PER_S, HELD_UP, UNEVEN, UNSTEADY_S, EXPONENT_ERROR
        told = filters.take_in(self.held, still, adds, late, now_told, *sure, assumed, FARTHEST)
        score, unexplained, k, came_mg = told
        if came_mg > FLOWING_MG:
            more = min(score * score, SURPRISING) - AS_EXPECTED
            if more > 0.0 or k > FREELY * reference:  # a bridge does not show that there are no lumps
                by_powder = 1.0 - unexplained  # noise alone tells nothing about lumps
                self.surge_mg *= math.exp(SURGE_GAIN * by_powder * more)
                self.surge_mg = min(max(self.surge_mg, LEAST_SURGE_MG), MOST_SURGE_MG)
        self._tell()
        if not math.isfinite(score + self.mass_mg + self.unseen_mg + self.coefficient + self.coefficient_sd):
            raise ArithmeticError(f"the dosing law cannot compute with {row}")
        return score

    def _tell(self) -> None:
        """Set what is known after a reading, by all models together and including what they have not seen yet."""
        self.mass_mg, self.delay_s, self.unseen_mg, self.coefficient, self.coefficient_sd = filters.known(self.held)
        """The mass that has left; the balance's mean delay; what is not read yet, plus twice its uncertainty; k [mg
        s^-1 mm^-n] and its standard deviation."""

    # --- what is known ---

    def over_all(self, means: Array, variances: Array) -> tuple[float, float]:
        """Mean and standard deviation of a mixture of models (H,) with these means and variances."""
        return filters.over_all(self.weights, means, variances)

    @property
    def mass_sd_mg(self) -> float:
        """The standard deviation of `mass_mg`."""
        _, sd_mg = self.over_all(*self.coming(0.0, 0.0))
        return sd_mg

    def coming(self, phi_s: float, slope_s: float) -> Array:
        """(2, H) means [mg] and variances [mg^2] of the mass that will have left, by model.

        The integrals of phi [mm^n s] and of its slope grow by the arguments until then.
        """
        return filters.coming(self.held, phi_s, slope_s)

    def chance(self, phi_s: float, slope_s: float, most_mg: float) -> float:
        """The probability that more than `most_mg` will have left then."""
        return filters.chance(self.held, phi_s, slope_s, most_mg)


@lru_cache(maxsize=16)  # as costly as five readings, and asked for at every opening
def _thinkable(lag_s: float, doubt: float, shape: str | None, surely: float) -> tuple[Sequence[Model], Array]:
    """The models (H) and weights (H,) of a balance believed to be so; of an unknown one if `shape` is None.

    `surely` is the probability that the shape is right.
    """
    if shape is None:
        models = [Model(delay_s, kind) for kind in SHAPES for delay_s in DELAYS_S]
        return models, np.ones(len(models))
    near = [Model(2.0 * lag_s * math.exp(step * doubt), kind) for kind in SHAPES for step in NEAR]
    others = (1.0 - surely) / (len(SHAPES) - 1)
    shares = np.array([surely if kind == shape else others for kind in SHAPES])
    ours = np.outer(shares, np.exp(-0.5 * np.square(NEAR))).ravel()
    slower = [Model(delay_s, shape) for delay_s in DELAYS_S if delay_s > 2.0 * lag_s * SET_SLOWER]
    weights = np.append((1.0 - CHANGED) * ours / ours.sum(), np.full(len(slower), CHANGED / max(len(slower), 1)))
    return [*near, *slower], weights
