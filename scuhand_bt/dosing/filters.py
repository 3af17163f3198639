"""The compiled arithmetic of the bank and of the constraint, for H models, many times a second.

`estimation` and `constraint` tell what it means. Constants are passed in, as a compiled function would keep those that
it was compiled with. It is compiled when this module is imported (`scuhand_bt.dosing.prepare`), which takes some
seconds the first time; never within a dose.

    x (H, 5), p (H, 5, 5)    states (y, y', M, k, g) and their covariances
    unseen (H, 2)            integrals of phi [mm^n s] and of its slope that a model, which runs late, has yet to see
    weights (H,)             of the models, adding up to 1
    delays_s (H,)            their mean delays
    surge_mg, misfit, erratic    as in the bank
"""

import math

import numpy as np
from numpy.typing import NDArray

from scuhand_bt.compiled import compiled
from scuhand_bt.dosing.identification import MASS, RATE, READING, Array, G, K

Filters = tuple[Array, Array, Array, Array, Array, float, float, float]
"""x, p, unseen, weights, delays_s, surge_mg, misfit, erratic."""
_FILTERS = "Tuple((f8[:,::1], f8[:,:,::1], f8[:,::1], f8[::1], f8[::1], f8, f8, f8))"


@compiled(f"UniTuple(f8, 2)({_FILTERS}, i8, f8, f8)")
def coming_by(filters: Filters, h: int, phi_s: float, slope_s: float) -> tuple[float, float]:
    """Mean [mg] and variance [mg^2] of the mass that will have left by model `h`, once the integrals grew by these."""
    x, p, unseen, _, _, surge_mg, misfit, erratic = filters
    k, mass_mg = x[h, K], x[h, MASS]
    a, b = unseen[h, 0] + phi_s, unseen[h, 1] + slope_s
    mean_mg = max(mass_mg + k * a + x[h, G] * b, mass_mg)
    of_mass = p[h, MASS, MASS] + 2.0 * (a * p[h, MASS, K] + b * p[h, MASS, G])
    of_flow = a * a * p[h, K, K] + 2.0 * a * b * p[h, K, G] + b * b * p[h, G, G]
    of_model = (misfit * (mean_mg - x[h, READING])) ** 2
    return mean_mg, erratic * max(of_mass + of_flow + 2.0 * surge_mg * k * a + of_model, 0.0)


@compiled(f"f8[:,::1]({_FILTERS}, f8, f8)")
def coming(filters: Filters, phi_s: float, slope_s: float) -> Array:
    """`coming_by` for all models: (2, H)."""
    many = len(filters[0])
    both = np.empty((2, many))
    for h in range(many):
        both[0, h], both[1, h] = coming_by(filters, h, phi_s, slope_s)
    return both


@compiled("f8(f8)")
def below(deviations: float) -> float:
    """The standard normal distribution function."""
    return 0.5 * math.erfc(-deviations / math.sqrt(2.0))


@compiled(f"f8({_FILTERS}, f8, f8, f8)")
def chance(filters: Filters, phi_s: float, slope_s: float, most_mg: float) -> float:
    """The probability that more than `most_mg` will have left, once the integrals grew by these."""
    weights, of_more = filters[3], 0.0
    for h in range(len(weights)):
        mean_mg, variance = coming_by(filters, h, phi_s, slope_s)
        of_more += weights[h] * below((mean_mg - most_mg) / math.sqrt(variance))
    return of_more if of_more < 1.0 else 1.0  # 1 also where it is not a number: what cannot be computed is feared


@compiled("UniTuple(f8, 2)(f8[:], f8[:], f8[:])")
def over_all(weights: Array, means: Array, variances: Array) -> tuple[float, float]:
    """Mean and standard deviation of a mixture of models (H,)."""
    mean = (weights * means).sum()
    return mean, math.sqrt(max((weights * (variances + (means - mean) ** 2)).sum(), 0.0))


@compiled(f"UniTuple(f8, 5)({_FILTERS})")
def known(filters: Filters) -> tuple[float, float, float, float, float]:
    """The mass that has left, the mean delay, what is not read yet plus twice its uncertainty, k and its deviation."""
    x, p, _, weights, delays_s, _, _, _ = filters
    means_mg, _ = coming(filters, 0.0, 0.0)
    behind_mg, sd_mg = over_all(weights, means_mg - x[:, READING], np.zeros(len(weights)))
    k, k_sd = over_all(weights, x[:, K], p[:, K, K])
    return (weights * means_mg).sum(), (weights * delays_s).sum(), abs(behind_mg) + 2.0 * sd_mg, k, k_sd


@compiled(f"i8({_FILTERS}, f8[:,::1], f8, f8, f8, f8, f8, f8, f8)")
def widest(
    filters: Filters,
    choices: Array,
    aim_mg: float,
    most_mg: float,
    known_gap_mm: float,
    risk: float,
    exponent_error: float,
    unseen_error: float,
    walk_per_s: float,
) -> int:
    """The last of (N, 6) `choices` that keeps the chance constraint; 0 if none does.

    A choice is the gap [mm], phi, its slope, both integrals until it is shut, and the first of these over phi [s].
    `walk_per_s` is k's random walk in k's unit, per root second.
    """
    x, p, _, weights, delays_s, surge_mg, _, erratic = filters
    for number in range(len(choices) - 1, 0, -1):
        gap_mm, phi, slope, phi_s, slope_s, open_s = choices[number]
        off = exponent_error * math.log(gap_mm / known_gap_mm)
        walk = (walk_per_s * phi) ** 2
        risks = 0.0
        for h in range(len(weights)):
            mean_mg, variance = coming_by(filters, h, phi_s, slope_s)
            flow = max(x[h, K] * phi + x[h, G] * slope, 0.0)
            of_flow = max(phi * phi * p[h, K, K] + 2.0 * phi * slope * p[h, K, G] + slope * slope * p[h, G, G], 0.0)
            variance += (off * flow * open_s) ** 2
            lasting = (off * flow) ** 2 + of_flow + (unseen_error * flow) ** 2
            lumps_mg = 2.0 * surge_mg * flow
            # The excess is seen after the delay; or the valve shuts before, when the expected mass reaches the aim.
            left_s = max(aim_mg - mean_mg, 0.0) / max(flow, 1e-9)
            deviations = np.inf
            for unseen_s, reached_mg in ((delays_s[h], mean_mg), (left_s, max(mean_mg, aim_mg))):
                more = ((walk * unseen_s + lasting) * unseen_s + lumps_mg) * unseen_s
                deviations = min(deviations, (reached_mg - most_mg) / math.sqrt(variance + erratic * more))
            risks += weights[h] * below(deviations)
            if risks > risk:
                break
        if risks <= risk:
            return number
    return 0


@compiled("void(f8[::1], f8[:,::1], f8[:,::1])")
def carry(x: Array, p: Array, f: Array) -> None:
    """Carry a state (5,) and its covariance (5, 5) over a transition f (5, 5), in place; k and g stay as they are."""
    y, rate, mass, k, g = x
    for i in range(K):
        x[i] = f[i, 0] * y + f[i, 1] * rate + f[i, 2] * mass + f[i, 3] * k + f[i, 4] * g
    for j in range(5):
        y, rate, mass, k, g = p[:, j]
        for i in range(K):
            p[i, j] = f[i, 0] * y + f[i, 1] * rate + f[i, 2] * mass + f[i, 3] * k + f[i, 4] * g
    for i in range(5):
        y, rate, mass, k, g = p[i]
        for j in range(K):
            p[i, j] = y * f[j, 0] + rate * f[j, 1] + mass * f[j, 2] + k * f[j, 3] + g * f[j, 4]


@compiled(
    f"UniTuple(f8, 4)({_FILTERS}, f8[:,:,::1], f8[:,::1], Tuple((f8[::1], f8[::1], i8[::1], f8[:,::1])), "
    "UniTuple(f8, 4), f8, f8, f8, UniTuple(f8, 6), f8)"
)
def take_in(
    filters: Filters,
    still: Array,
    adds: Array,
    late: tuple[Array, Array, NDArray[np.int64], Array],
    row: tuple[float, float, float, float],
    reference: float,
    most_sd: float,
    tells: float,
    assumed: tuple[float, float, float, float, float, float],
    farthest: float,
) -> tuple[float, float, float, float]:
    """Take in a reading, in place: x, p, unseen, weights, phi and seen are as they are after it.

    * `still` (H, 5, 5), `adds` (H, 5): from `transitions`; the columns of k and g in `still` are filled in here.
    * `late`: `late_s` (H,), by how much models run late; `phi` (H,), its value where each has seen to; `seen` (H,), the
      number of that reading; `passed` (R, 3), per reading its time and both integrals until then.
    * `row`: time since the last reading, this reading, its noise, the change of the opening (logarithm).
    * `most_sd`: the most that k's deviation may reach, in k's unit; `tells`: how much a reading tells about the
      balance.

    Returns, of the likeliest model: its innovation in standard deviations, the share of its variance that is not the
    powder's, k, and what has come since the last reading [mg].
    """
    x, p, unseen, weights, _, surge_mg, misfit, _ = filters
    late_s, phi, seen, passed = late
    dt_s, reading_mg, noise_mg, changed = row
    walk_per_s, bridges_per_s, held_up, uneven, unsteady_s, exponent_error = assumed
    many, last = len(weights), len(passed) - 1
    best = np.argmax(weights)
    told = (0.0, 0.0, 0.0, 0.0)
    innovations_mg, common = np.empty(many), 0.0
    for h in range(many):
        before, at, due_s = seen[h], last, passed[last, 0] - late_s[h]
        # Up to the nearest reading; of two equally near the later one, however times are rounded.
        while at > before and passed[at, 0] + passed[at - 1, 0] > 2.0 * due_s + 1e-6:
            at -= 1
        seen[h] = at
        phi_s, slope_s = passed[at, 1] - passed[before, 1], passed[at, 2] - passed[before, 2]
        unseen[h, 0], unseen[h, 1] = passed[last, 1] - passed[at, 1], passed[last, 2] - passed[at, 2]
        k = x[h, K]
        p[h, K, K] += (exponent_error * changed * k) ** 2
        for i in range(K):
            still[h, i, K], still[h, i, G] = adds[h, i] * phi_s, adds[h, i] * slope_s
        carry(x[h], p[h], still[h])
        flow_mg = max(k, held_up * reference) * phi_s
        p[h, MASS, MASS] += 1e-6 + 2.0 * surge_mg * flow_mg + (uneven * flow_mg) ** 2 / dt_s
        if phi_s > 0.0:
            walk = (walk_per_s * reference) ** 2 + bridges_per_s * max(reference - k, 0.0) ** 2
            p[h, K, K] = min(p[h, K, K] + walk * dt_s, max(p[h, K, K], most_sd**2))
        phi_before = phi[h]
        if at > before:
            phi[h] = phi_s / (passed[at, 0] - passed[before, 0])
        unsteady = (unsteady_s * k * (phi[h] - phi_before)) ** 2
        unexplained = noise_mg**2 + unsteady + (misfit * (x[h, MASS] - x[h, READING])) ** 2
        common += weights[h] * (p[h, READING, READING] + unsteady)
        variance = p[h, READING, READING] + unexplained
        innovations_mg[h] = reading_mg - x[h, READING]
        if h == best:
            told = (innovations_mg[h] / math.sqrt(variance), unexplained / variance, k, k * phi_s)
        with_reading = p[h, READING].copy()
        for i in range(5):
            gain = p[h, i, READING] / variance
            x[h, i] += gain * innovations_mg[h]
            for j in range(5):
                p[h, i, j] -= gain * with_reading[j]
        x[h, K] = max(x[h, K], 0.0)
    # One variance for all: a model must not gain by claiming to know more than the others.
    for h in range(many):
        square = innovations_mg[h] ** 2 / (common + noise_mg**2)
        weights[h] *= math.exp(-0.5 * tells * min(square, farthest**2))
    weights /= weights.sum()
    return told


@compiled("f8[:,::1](f8[:,:,:,::1], f8[:,:,::1], i8[::1], f8[:,::1])")
def shown(still: Array, adds: Array, steps: NDArray[np.intp], arrived_mg: Array) -> Array:
    """(H, N) what models show at N times, where the masses (H, N) have reached the filter by then.

    `steps` (N,) gives the index of each step's `transitions`, (S, H, 5, 5) and (S, H, 5).
    """
    shown_mg = np.empty_like(arrived_mg)
    for h in range(len(arrived_mg)):
        reading = rate = mass = 0.0
        for n in range(len(steps)):
            way, add, more = still[steps[n], h], adds[steps[n], h], arrived_mg[h, n] - mass
            reading, rate = (
                way[READING, READING] * reading
                + way[READING, RATE] * rate
                + way[READING, MASS] * mass
                + add[READING] * more,
                way[RATE, READING] * reading + way[RATE, RATE] * rate + way[RATE, MASS] * mass + add[RATE] * more,
            )
            mass = arrived_mg[h, n]
            shown_mg[h, n] = reading
    return shown_mg
