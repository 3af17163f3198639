"""What a balance is, by its readings: its delay and its kind of filter (docs/dosing.md, What is known of the balance).

    y'' = w^2 (M - y) - 2 z w y'          reading(t) = y(t - d) + noise          T = d + 2 z / w

T is the mean delay, by which a steadily growing mass is read late. It is known without any model from a step of the
load (`balance_of`), and from an opening and its tail (`balance_by`):

    T = 1 / m  integral of (M - r) dt,     M = m Phi(t) / Phi(end),     Phi the integral of phi

with m what came of the opening and r the readings. How far the nearest shape of that T is off tells how sure it is.
"""

import math
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scuhand_bt.dosing.characteristic import LAST_MG, Curve, Step
from scuhand_bt.specs import BalanceBelief

Array = NDArray[np.float64]
READING, RATE, MASS, K, G = range(5)
"""Indices of a filter's state: (y, y', M, k, g)."""

SHAPES = {
    "ringing": (0.0, 0.5),
    "lively": (0.0, 0.75),
    "two poles": (0.0, 1.0),
    "one pole": (0.0, 2.5),
    "mean": (0.2, 1.0),
    "late": (0.55, 1.0),
    "delay": (0.9, 1.0),
}
"""Kinds of filters: the share d / T of the delay that is dead time, and the damping z of the rest, 2 z / w = T - d."""
STEP_DOUBT, OPENING_DOUBT = 0.12, 0.2
"""Standard deviation of the delay's logarithm by a step; and, at least, by an opening, as phi is a guess."""
ADAPTS, SLOWEST = 0.2, 6.0
"""A filter adapts if the last of a step takes longer than it should by this share of the delay. It is then up to
SLOWEST times slower for little changes."""
LEAST_LAST = 0.3
"""Least time that the last of a step should take, as a share of the delay, when that factor is computed."""
MOST_SLOW_MG = 200.0
"""The most that a filter that adapts may miss and be taken for slow."""
TENTH = 2.0
"""How many times later a step is than its last tenth, at most."""
LEAST_DOUBT = 0.08
"""Least doubt of what is believed: standard deviation of the delay's logarithm."""
UNLIKE = 0.15
"""A step is from another balance if a shape is nearer than the known one by this share of the step."""
TELLS = 1.0
"""Openings whose doubt is more than this tell nothing about the balance."""
LEAST_DELAY_S, LONGEST_S = 0.02, 10.0
"""Limits of a delay that an opening or a step may show."""
BEGINS_S = (0.0, 0.1, 0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0)
"""Times after the command to open at which powder may begin to come."""
LEAST_APART_S = 1e-3
"""Least difference of two times: lines that were held up come all at once."""
RINGS_SHARE = 0.01
"""A filter rings if it has shown more of a container than came, by this share."""
TOLD_SIGMAS = 5.0
"""A container tells how much of it is missing at a time to so many standard uncertainties of its weighing. A single
reading is off by about two."""
SHOWN_DIGITS = 0.5
"""What a balance may still have to show, in digits, when it counts as having shown all that came."""
TAIL = np.arange(0.1, 30.0, 0.1)
"""Times, in delays, at which a tail is evaluated; no shape takes longer to show 100 g to half of 0.1 mg."""
INDEPENDENT = 10.0
"""Number of independent differences between readings and a model."""
MASS_ERROR_MG, SETTLED = 0.1, 3.0
"""Error of the mass that came of an opening, besides noise; and the delays after which a balance shows it."""


class Row(NamedTuple):
    """A reading of an opening and its tail, as `Bank.update` takes it."""

    dt_s: float
    phi_s: float
    slope_s: float
    reading_mg: float
    noise_mg: float
    changed: float = 0.0
    """Change of the opening before it: the logarithm of the ratio of the gaps above the threshold."""


def transitions(
    delays_s: float | Array, pure: float | Array, damping: float | Array, dt_s: float | Array
) -> tuple[Array, Array]:
    """Transitions (…, 5, 5) over `dt_s` with the valve shut, and (…, 5) what k adds per unit of phi's integral.

    In closed form: (y - M, y') decays by exp(A t), A = ((0, 1), (-w^2, -2 z w)), and M grows linearly.
    """
    w = 2.0 * damping / np.maximum((1.0 - pure) * delays_s, LEAST_DELAY_S)
    s = damping * w
    root = np.sqrt((s * s - w * w + 1e-9).astype(complex))
    slow, fast = np.exp((root - s) * dt_s), np.exp(-(root + s) * dt_s)
    cosh, sinh = ((slow + fast) / 2.0).real, ((slow - fast) / (2.0 * root)).real
    e00, e01, e10, e11 = cosh + s * sinh, sinh, -w * w * sinh, cosh - s * sinh
    still, adds = np.zeros((*cosh.shape, 5, 5)), np.zeros((*cosh.shape, 5))
    still[..., READING, READING], still[..., READING, RATE], still[..., READING, MASS] = e00, e01, 1.0 - e00
    still[..., RATE, READING], still[..., RATE, RATE], still[..., RATE, MASS] = e10, e11, -e10
    still[..., MASS, MASS] = still[..., K, K] = still[..., G, G] = 1.0
    adds[..., READING] = 1.0 + (2.0 * s * (e00 - 1.0) + e10) / (w * w * dt_s)
    adds[..., RATE] = (1.0 - e00) / dt_s
    adds[..., MASS] = 1.0
    return still, adds


def shows_s(balance: BalanceBelief, masses_mg: Array, least_mg: float, came: Step | None = None) -> Array:
    """(N,) times [s] after which all but `least_mg` of masses (N,) [mg] that came at once is shown for good.

    No sooner than that share of a container that `came` was: a filter may ring for longer than any shape.
    """
    delay_s, (pure, damping) = 2.0 * balance.lag_s, SHAPES[balance.shape]
    shares = least_mg / np.maximum(masses_mg, least_mg)
    still, _ = transitions(delay_s, pure, damping, delay_s * TAIL)
    shown_s = pure * delay_s + _shown_s(delay_s * TAIL, still[:, READING, READING], shares)
    if came is None or not came.times_s:
        return shown_s
    told = np.maximum(shares, TOLD_SIGMAS * came.uncertainty_mg / abs(came.step_mg))
    return np.maximum(shown_s, _shown_s(np.array(came.times_s), np.array(came.missing), told))


def shown_by_s(balance: BalanceBelief, came: Step | None, shown: Curve, now_mg: float, readability_mg: float) -> float:
    """The time by which a balance has shown what has come since these readings [s].

    A change since a reading is shown at the latest as if all of it had come then.
    """
    times_s, readings_mg = np.reshape(shown, (-1, 2)).T
    late_s = shows_s(balance, np.abs(readings_mg - now_mg), SHOWN_DIGITS * readability_mg, came)
    return float(np.max(times_s + late_s, initial=-math.inf))


def _shown_s(times_s: Array, missing: Array, shares: Array) -> Array:
    """(N,) the first of the times from which on less than these shares (N,) are missing; the last one if none is."""
    most = np.maximum.accumulate(np.abs(missing[::-1]))  # the largest at any later time, as filters ring
    return times_s[::-1][np.maximum(np.searchsorted(most, shares) - 1, 0)]


def rings(balance: BalanceBelief, came: Step | None) -> bool:
    """Whether its filter swings back, by its shape or by how it has shown a container."""
    return SHAPES[balance.shape][1] < 1.0 or swing_of(came).lasts_s > 0.0


class Swing(NamedTuple):
    """How a filter that rings swings back."""

    lasts_s: float
    """How long it rises at a stretch: half a period; 0 if it does not ring."""
    share: float
    """Of how far it rose, by how much it falls then."""


def swing_of(came: Step | None) -> Swing:
    """How a filter has shown a container: until its peak, and from there on.

    Each swing is the same share of the one before. The first is less than that of a step where the container came
    slowly. A person who touches it may make it look like more than a filter can swing.
    """
    missing = np.array(came.missing if came is not None else ())
    if came is None or min(missing, default=0.0) >= -RINGS_SHARE:
        return Swing(0.0, 0.0)
    peak = int(missing.argmin())
    return Swing(came.times_s[peak], float(np.clip(missing[peak:].max() / -missing[peak], 0.0, 1.0)))


def swing_s(balance: BalanceBelief, came: Step | None = None) -> float:
    """How long its filter rises at a stretch as it rings [s], by its shape or by a container; 0 if it does not ring."""
    lasts_s, (pure, damping) = swing_of(came).lasts_s, SHAPES[balance.shape]
    if damping >= 1.0:
        return lasts_s
    delay_s = (1.0 - pure) * 2.0 * balance.lag_s
    return max(lasts_s, math.pi * delay_s / (2.0 * damping * math.sqrt(1.0 - damping * damping)))


def balance_of(step: Step, beyond: float = 0.0) -> BalanceBelief:
    """The balance by a step: its delay needs no model, its shape is the nearest one.

    A filter that adapts is quick for a step and slow for its last milligrams. Its delay is then set to the geometric
    mean of both, with a doubt that covers either. A last part that is longer by no more than `beyond` standard
    deviations counts as chance.
    """
    delay_s, (shape, far, linear_s) = step.delay_s, _nearest(step)
    slower = 1.0
    longer_s = max(ADAPTS * delay_s, beyond * step.last_uncertainty_s)
    if step.last_s > linear_s + longer_s:
        slower = min(step.last_s / max(linear_s, LEAST_LAST * delay_s), SLOWEST)
    apart = 0.5 * math.log(slower)
    doubt, adapts = math.hypot(STEP_DOUBT, apart), apart > STEP_DOUBT
    misfit = min(far / max(math.hypot(*step.missing), 1e-9), 1.0)
    lag_s = min(max(delay_s * math.sqrt(slower), LEAST_DELAY_S), LONGEST_S) / 2.0
    return BalanceBelief(
        lag_s=lag_s,
        doubt=doubt,
        shape=shape,
        adapts=adapts,
        slow_mg=_slow_mg(step, linear_s) if adapts else 0.0,
        misfit=misfit,
        fits=1,
        shown_s=max(delay_s, 0.0),
    )


def _slow_mg(step: Step, linear_s: float) -> float:
    """With less than this missing [mg], a filter that adapts is nearer to its slow speed than to its quick one."""
    between_s = math.sqrt(max(linear_s, LEAST_LAST * step.delay_s) * step.last_s)
    missing_mg = np.abs(step.missing) * abs(step.step_mg)
    times_s, slow_mg = np.array(step.times_s), LAST_MG

    def missed_s(mass_mg: float) -> float:
        return float(np.max(times_s[missing_mg > mass_mg], initial=0.0))

    while slow_mg < MOST_SLOW_MG and missed_s(slow_mg) - missed_s(2.0 * slow_mg) > math.log(2.0) * between_s:
        slow_mg *= 2.0
    return min(slow_mg, MOST_SLOW_MG)


def balance_by_hand(step: Step, beyond: float, least_s: float) -> BalanceBelief | None:
    """The balance by a container that a person has put down, where that shows a filter that adapts; else None.

    How long the hand took is in the step, but not in its last tenth. That must be longer than a plain filter's by
    `beyond` standard deviations, and by `least_s`.
    """
    last = step.let_go()
    if last is None or last.delay_s < LEAST_DELAY_S or not (found := balance_of(last, beyond)).adapts:
        return None
    if 2.0 * found.lag_s <= last.delay_s + least_s:
        return None
    later = max(min(step.delay_s / last.delay_s, TENTH), 1.0)
    return found.model_copy(update={"lag_s": min(later * found.lag_s, LONGEST_S / 2.0)})


def is_unlike(step: Step, shape: str) -> bool:
    """Whether a step does not fit this shape at any delay: another is nearer by more than `UNLIKE` of the step."""
    fits = _fits(step)
    nearest, _ = min(fits.values())
    return fits[shape][0] - nearest > UNLIKE * math.hypot(*step.missing)


def is_linear(step: Step, beyond: float) -> bool:
    """Whether the last of a step came too soon, by `beyond` standard deviations, for a filter that adapts."""
    _, _, linear_s = _nearest(step)
    return step.last_s + beyond * step.last_uncertainty_s < linear_s + ADAPTS * step.delay_s


def _nearest(step: Step) -> tuple[str, float, float]:
    """The shape nearest to a step, how far off it is [1], and the time the step's last part takes it [s]."""
    fits = _fits(step)
    shape = min(fits, key=lambda name: fits[name][0])
    return shape, *fits[shape]


@lru_cache(maxsize=4)
def _fits(step: Step) -> Mapping[str, tuple[float, float]]:
    """Per shape: how far off a step it is [1], and the time the step's last part takes it [s]."""
    delay_s, fits = step.delay_s, dict[str, tuple[float, float]]()
    for shape, (pure, damping) in SHAPES.items():
        still, _ = transitions(delay_s, pure, damping, np.maximum(np.array(step.times_s) - pure * delay_s, 1e-3))
        missing = tuple(still[:, READING, READING].tolist())
        fits[shape] = math.dist(missing, step.missing), max(step._replace(missing=missing).last_s, 0.0)
    return fits


def balance_by(rows: Sequence[Row], begin_mg: float, gained_mg: float) -> BalanceBelief | None:
    """The balance by an opening and its whole tail, of which `gained_mg` came; None where it shows no delay.

    Each shape is tried with several beginnings of the powder; the best fit counts. Its doubt comes from the spread of
    fits almost as good, the area that remains, and the error of the mass over the time looked at. `fits` and `noise_mg`
    are left to the caller.
    """
    dt_s, phi_s, _, readings_mg, noise_mg, _ = np.array(rows).T
    ends_s, shown_mg = np.cumsum(dt_s), readings_mg - begin_mg
    came_s = np.cumsum([phi_s * (ends_s > late_s) for late_s in BEGINS_S], axis=1)
    came_mg = (came_s / np.maximum(came_s[:, -1:], 1e-9) * gained_mg).repeat(len(SHAPES), axis=0)
    delays_s = (came_mg - shown_mg) @ dt_s / gained_mg
    possible = (delays_s > LEAST_DELAY_S) & (came_mg[:, -1] > 0.0)
    if not possible.any():
        return None
    shapes = np.array(list(SHAPES) * len(BEGINS_S))[possible]
    delays_s, came_mg = delays_s[possible], came_mg[possible]
    off_mg = shown_mg - _shown_mg(delays_s, shapes, dt_s, came_mg)
    squares = np.sum(off_mg**2, axis=1)
    best = int(np.argmin(squares))
    weights = np.exp(-INDEPENDENT / 2.0 * (squares / squares[best] - 1.0))
    spread_s = math.sqrt(weights @ (delays_s - delays_s[best]) ** 2 / weights.sum())
    area_s = float(np.maximum(np.abs(off_mg[best]) - noise_mg, 0.0) @ dt_s) / gained_mg
    looked_s = float(dt_s[phi_s > 0.0].sum()) + SETTLED * delays_s[best]
    doubt_s = math.hypot(spread_s, area_s, (noise_mg[-1] + MASS_ERROR_MG) / gained_mg * looked_s)
    return BalanceBelief(
        lag_s=min(float(delays_s[best]), LONGEST_S) / 2.0,
        doubt=math.hypot(OPENING_DOUBT, math.log1p(doubt_s / delays_s[best])),
        shape=str(shapes[best]),
        misfit=min(math.sqrt(squares[best] / np.sum((came_mg[best] - shown_mg) ** 2)), 1.0),
    )


def with_found(known: BalanceBelief, found: BalanceBelief | None) -> BalanceBelief:
    """The belief once an opening has told something, weighted by how sure that is.

    A contradiction widens the doubt: a filter that adapts has two speeds, and one that was changed a new one. No
    opening makes a balance quicker than its container allows, as powder that is held up looks like a quick balance.
    """
    if found is None or found.doubt > TELLS:
        return known
    shown_s = known.shown_s / 2.0
    least_s = shown_s * math.exp(-STEP_DOUBT)
    if found.lag_s < shown_s * math.exp(-2.0 * math.hypot(found.doubt, STEP_DOUBT)):
        found = found.model_copy(update={"lag_s": least_s})
    doubt = max(found.doubt, LEAST_DOUBT)
    if known.fits == 0:
        lag_s = max(found.lag_s, least_s)
        return found.model_copy(update={"fits": 1, "doubt": doubt, "lag_s": lag_s, "shown_s": known.shown_s})
    apart = math.log(found.lag_s / known.lag_s)
    share = known.doubt**2 / (known.doubt**2 + doubt**2)
    agreed = doubt * math.sqrt(share)
    contradicted = max(abs(apart) - 2.0 * math.hypot(doubt, known.doubt), 0.0)
    if known.adapts and contradicted == 0.0:  # one of its two speeds: the other is as likely in the next opening
        return known.model_copy(update={"fits": known.fits + 1})
    return known.model_copy(
        update={
            "fits": known.fits + 1,
            "lag_s": max(known.lag_s * math.exp(share * apart), least_s),
            "doubt": max(LEAST_DOUBT, math.hypot(agreed, contradicted)),
        }
    )


def _shown_mg(delays_s: Array, shapes: Sequence[str] | NDArray[np.str_], dt_s: Array, came_mg: Array) -> Array:
    """(H, N) what balances (H,) show of masses (H, N) that come over times `dt_s` (N,)."""
    from scuhand_bt.dosing import filters  # deferred: takes half a second

    pure, damping = np.array([SHAPES[shape] for shape in shapes]).T
    steps_s, steps = np.unique(np.round(dt_s, 3), return_inverse=True)
    still, adds = transitions(delays_s, pure, damping, steps_s[:, None])
    ends_s = np.append(0.0, np.cumsum(dt_s))
    late = zip(pure * delays_s, came_mg, strict=True)
    arrived_mg = np.array([np.interp(ends_s[1:] - late_s, ends_s, np.append(0.0, came)) for late_s, came in late])
    return filters.shown(still, adds, steps, arrived_mg)
