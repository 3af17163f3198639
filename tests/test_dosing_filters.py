"""The compiled law reckons as the equations say that it stands for, at whatever times readings come; or not at all."""

import math

import numpy as np
import pytest
from dose_bench import dose_request
from scipy.linalg import expm
from scipy.stats import norm

from scuhand_bt.dosing import Observation, estimation, filters
from scuhand_bt.dosing.constraint import CHOICES, RISK, UNSEEN_ERROR, widest_mm
from scuhand_bt.dosing.estimation import Bank, Model
from scuhand_bt.dosing.identification import SHAPES, Array, G, K, Row, balance_by, transitions
from scuhand_bt.dosing.knowledge import Knowledge
from scuhand_bt.dosing.valve import FlowShape
from scuhand_bt.specs import BalanceBelief, PowderBelief

FLOW, MOST_SPREAD = 40.0, 0.6
READ, MASS = 0, 2


class Textbook:
    """The bank of `estimation`'s first lines by matrices: Kalman's equations for each model, Bayes' rule among them."""

    def __init__(self, models: list[Model], weights: Array, bank: Bank) -> None:
        self.bank, self.models, self.weights = bank, models, weights / weights.sum()
        x, p = np.array([10.0, 0.0, 10.0, FLOW, 0.0]), np.zeros((5, 5))
        p[np.ix_((READ, MASS), (READ, MASS))] = 0.4**2
        p[K, K], p[G, G] = (MOST_SPREAD * FLOW) ** 2, (0.1 * FLOW) ** 2
        self.x, self.p = [x.copy() for _ in models], [p.copy() for _ in models]
        self.passed, self.seen, self.phi = [np.zeros(3)], [np.zeros(3) for _ in models], [0.0 for _ in models]
        self.means = np.zeros(2)

    def update(self, row: Row, reference: float) -> float:
        now = self.passed[-1] + (row.dt_s, row.phi_s, row.slope_s)
        self.passed.append(now)
        self.means += (row.phi_s / row.dt_s - self.means) * (1.0 - np.exp(-row.dt_s / np.array(estimation.CHANGE_S)))
        tells = self.bank.temper * abs(self.means[0] - self.means[1]) / max(*self.means, 1e-9)
        best, innovations_mg, shown, score = int(np.argmax(self.weights)), [], [], 0.0
        for h, (delay_s, shape) in enumerate(self.models):
            pure, damping = SHAPES[shape]
            own = 2.0 * damping / ((1.0 - pure) * delay_s)
            times_s = np.array([each[0] for each in self.passed])
            until = self.passed[int(np.argmin(np.abs(times_s - (now[0] - pure * delay_s))))]
            window_s, phi_s, slope_s = until - self.seen[h]
            self.seen[h] = until
            rates = np.zeros((5, 5))
            rates[0, 1], rates[1, :3] = 1.0, (-own * own, -2.0 * damping * own, own * own)
            rates[MASS, K], rates[MASS, G] = phi_s / row.dt_s, slope_s / row.dt_s
            f, x, p = expm(rates * row.dt_s), self.x[h], self.p[h]
            k = x[K]
            p[K, K] += (estimation.EXPONENT_ERROR * row.changed * k) ** 2
            x, p = f @ x, f @ p @ f.T
            flow_mg = max(k, estimation.HELD_UP * reference) * phi_s
            p[MASS, MASS] += 1e-6 + 2.0 * self.bank.surge_mg * flow_mg + (estimation.UNEVEN * flow_mg) ** 2 / row.dt_s
            if phi_s > 0.0:
                bridged = estimation.BRIDGES_PER_S * max(reference - k, 0.0) ** 2
                walk = ((estimation.K_WALK_PER_S * reference) ** 2 + bridged) * row.dt_s
                p[K, K] = min(p[K, K] + walk, max(p[K, K], (MOST_SPREAD * reference) ** 2))
            before, self.phi[h] = self.phi[h], phi_s / window_s if window_s > 0.0 else self.phi[h]
            unsteady = (estimation.UNSTEADY_S * k * (self.phi[h] - before)) ** 2
            variance = p[READ, READ] + row.noise_mg**2 + unsteady + (self.bank.misfit * (x[MASS] - x[READ])) ** 2
            innovation_mg = row.reading_mg - x[READ]
            gain = p[:, READ] / variance
            self.x[h], self.p[h] = x + gain * innovation_mg, p - np.outer(gain, p[READ])
            self.x[h][K] = max(self.x[h][K], 0.0)
            innovations_mg.append(innovation_mg)
            shown.append(p[READ, READ] + unsteady)
            score = innovation_mg / math.sqrt(variance) if h == best else score
        squares = np.array(innovations_mg) ** 2 / (self.weights @ shown + row.noise_mg**2)
        weights = self.weights * np.exp(-0.5 * tells * np.minimum(squares, estimation.FARTHEST**2))
        self.weights = weights / weights.sum()
        return score

    def coming(self, phi_s: float, slope_s: float) -> tuple[Array, Array]:
        means_mg, variances = [], []
        for x, p, seen in zip(self.x, self.p, self.seen, strict=True):
            _, unseen_phi_s, unseen_slope_s = self.passed[-1] - seen
            way = np.array([0.0, 0.0, 1.0, unseen_phi_s + phi_s, unseen_slope_s + slope_s])
            mean_mg = max(way @ x, x[MASS])
            misfit = (self.bank.misfit * (mean_mg - x[READ])) ** 2
            means_mg.append(mean_mg)
            variances.append(way @ p @ way + 2.0 * self.bank.surge_mg * x[K] * way[K] + misfit)
        return np.array(means_mg), self.bank.erratic * np.array(variances)

    def over_all(self, means: Array, variances: Array) -> tuple[float, float]:
        mean = self.weights @ means
        return mean, math.sqrt(self.weights @ (variances + means**2) - mean**2)


BANKS = {
    "poles": [Model(0.4, "ringing"), Model(0.6, "two poles"), Model(0.9, "one pole"), Model(1.3, "lively")],
    "late": [Model(0.52, "mean"), Model(0.87, "late"), Model(1.03, "delay"), Model(2.41, "late")],
}


def rows_of(rng: np.random.Generator, count: int, periods_s: list[float]) -> list[Row]:
    """Of an opening that changes, rests, is a knock once, and comes again."""
    rows, left_mg = list[Row](), 10.0
    for number in range(count):
        dt_s, gap_mm = float(rng.choice(periods_s)), float(rng.uniform(0.4, 1.3)) * (number % 9 < 6)
        left_mg += 0.7 * FLOW * gap_mm**2.5 * dt_s
        noise_mg, knock_mg = float(rng.uniform(0.05, 0.4)), 60.0 * (number == 7)
        reading_mg = 0.8 * left_mg + 2.0 + knock_mg + noise_mg * float(rng.standard_normal())
        slope_s = 2.5 * gap_mm**1.5 * dt_s
        rows.append(Row(dt_s, gap_mm**2.5 * dt_s, slope_s, reading_mg, noise_mg, float(rng.choice([0.0, -0.3, 0.5]))))
    return rows


@pytest.mark.parametrize("kind", BANKS)
@pytest.mark.parametrize("periods_s", [[0.1], [0.05, 0.1, 0.11, 0.2, 0.7]])
@pytest.mark.parametrize("reference", [0.5 * FLOW, 2.0 * FLOW])
def test_a_bank_is_kalmans_filters_and_bayes_rule(kind: str, periods_s: list[float], reference: float) -> None:
    rng, weights = np.random.default_rng(4), np.array([3.0, 2.0, 2.5, 1.0])
    bank = Bank(BANKS[kind], weights, 0.5, 0.05)
    bank.erratic = 2.0
    bank.restart(10.0, 0.4, FLOW, MOST_SPREAD, 0.1)
    textbook = Textbook(list(BANKS[kind]), weights, bank)
    for row in rows_of(rng, 24, periods_s):
        expected = textbook.update(row, reference)
        assert bank.update(row, reference) == pytest.approx(expected, rel=1e-6, abs=1e-6)
        assert bank.weights == pytest.approx(textbook.weights, rel=1e-6)
        for way in ((0.0, 0.0), (0.6, 0.2), (2.0, -1.5)):
            (means_mg, variances), (expected_mg, expected_variances) = bank.coming(*way), textbook.coming(*way)
            assert means_mg == pytest.approx(expected_mg, rel=1e-6)
            assert variances == pytest.approx(expected_variances, rel=1e-5)
            most_mg = float(np.mean(means_mg)) + 3.0
            tails = norm.sf(most_mg, means_mg, np.sqrt(variances))
            assert bank.chance(*way, most_mg) == pytest.approx(bank.weights @ tails, rel=1e-9)
        means_mg, variances = textbook.coming(0.0, 0.0)
        behind_mg, behind_sd_mg = textbook.over_all(means_mg - [x[READ] for x in textbook.x], np.zeros(len(means_mg)))
        coefficient = textbook.over_all(np.array([x[K] for x in textbook.x]), np.array([p[K, K] for p in textbook.p]))
        assert (bank.mass_mg, bank.mass_sd_mg) == pytest.approx(textbook.over_all(means_mg, variances), rel=1e-5)
        assert bank.unseen_mg == pytest.approx(abs(behind_mg) + 2.0 * behind_sd_mg, rel=1e-5, abs=1e-5)
        assert (bank.coefficient, bank.coefficient_sd) == pytest.approx(coefficient, rel=1e-5)
        assert bank.delay_s == pytest.approx(textbook.weights @ [model.delay_s for model in textbook.models], rel=1e-6)


@pytest.mark.parametrize("reference", [FLOW, 4.0 * FLOW])
@pytest.mark.parametrize("aim", [0.5, 0.95])
@pytest.mark.parametrize(("known_gap_mm", "slope_s"), [(0.2, 0.05), (1.0, 0.05), (0.2, 0.5)])
def test_the_widest_opening_is_the_last_that_the_constraint_allows(
    reference: float, aim: float, known_gap_mm: float, slope_s: float
) -> None:
    """By the formula at the top of `constraint`, for little room and for much; and where the opening seems none."""
    weights, answered_s, speed_mm_per_s = np.array([2.0, 1.0]), 0.26, 4.0
    bank = Bank([Model(0.5, "two poles"), Model(1.5, "delay")], weights, 0.4, 0.05)
    bank.restart(10.0, 0.4, FLOW, MOST_SPREAD, 0.1)
    bank.erratic, bank.temper = 1.5, 0.0
    textbook = Textbook([Model(0.5, "two poles"), Model(1.5, "delay")], weights, bank)
    for number in range(18):
        row = Row(0.1, 0.02, slope_s, 10.0 + 0.3 * number, 0.1)
        textbook.update(row, FLOW)
        bank.update(row, FLOW)
    k, g = (np.array([x[which] for x in textbook.x]) for which in (K, G))
    kk, kg, gg = (np.array([p[which] for p in textbook.p]) for which in ((K, K), (K, G), (G, G)))

    def risk(gap_mm: float, aim_mg: float, most_mg: float) -> float:
        phi, slope, open_s = gap_mm**2.5, 2.5 * gap_mm**1.5, answered_s + gap_mm / 3.5 / speed_mm_per_s
        means_mg, variances = textbook.coming(phi * open_s, slope * answered_s + phi / speed_mm_per_s)
        flow, spread = np.maximum(k * phi + g * slope, 1e-9), kk * phi**2 + 2.0 * kg * phi * slope + gg * slope**2
        off = estimation.EXPONENT_ERROR * math.log(gap_mm / known_gap_mm) * flow
        lasting = spread + off**2 + (UNSEEN_ERROR * flow) ** 2
        walk = (estimation.K_WALK_PER_S * reference * phi) ** 2

        def deviations(reached_mg: Array, unseen_s: Array) -> Array:
            more = (walk * unseen_s + lasting) * unseen_s**2 + 2.0 * bank.surge_mg * flow * unseen_s
            return (reached_mg - most_mg) / np.sqrt(variances + (off * open_s) ** 2 + bank.erratic * more)

        reckoned = deviations(np.maximum(means_mg, aim_mg), np.maximum(aim_mg - means_mg, 0.0) / flow)
        seen = deviations(means_mg, bank.delays_s)
        return float(bank.weights @ norm.cdf(np.minimum(seen, reckoned)))

    gaps_mm = np.geomspace(0.05, 2.3, CHOICES).tolist()
    opened_mm = set[float]()
    for room_mg in np.geomspace(2.0, 2000.0, 40).tolist():
        aim_mg, most_mg = bank.mass_mg + aim * room_mg, bank.mass_mg + room_mg
        widest = widest_mm(
            bank, FlowShape(0.1, 2.5), aim_mg, most_mg, answered_s, speed_mm_per_s, 2.4, reference, known_gap_mm, 0.05
        )
        allowed_mm = [gap_mm for gap_mm in gaps_mm if risk(gap_mm, aim_mg, most_mg) <= RISK]
        assert widest == pytest.approx(0.1 + (allowed_mm or gaps_mm)[-1 if allowed_mm else 0])
        opened_mm.add(widest)
    assert len(opened_mm) > 8


def test_so_little_that_it_is_nothing_says_nothing_of_lumps() -> None:
    bank = Bank([Model(0.5, "two poles")], np.ones(1), 0.5, 0.02)
    bank.restart(0.0, 0.1, FLOW, 0.2)
    for number in range(10):
        bank.update(Row(0.1, 1e-4, 0.0, 2.0 * (number % 2), 0.1), FLOW)
    assert bank.surge_mg == 0.5


@pytest.mark.parametrize("shape", SHAPES)
def test_what_a_balance_shows_follows_what_has_reached_its_filter(shape: str) -> None:
    pure, damping = SHAPES[shape]
    steps_s, delay_s, arrived_mg = (0.1, 0.23), 0.8, np.array([3.0, 3.0, 10.0, 24.0, 24.0, 24.0])
    steps = np.array([0, 1, 0, 1, 1, 0])
    own, y, expected_mg = 2.0 * damping / ((1.0 - pure) * delay_s), np.zeros(3), []
    for step, came_mg in zip(steps.tolist(), np.diff(arrived_mg, prepend=0.0).tolist(), strict=True):
        rates = np.zeros((4, 4))  # y, y', M, and what M grows by in a second
        rates[0, 1], rates[2, 3] = 1.0, 1.0
        rates[1, :3] = -own * own, -2.0 * damping * own, own * own
        y = (expm(rates * steps_s[step]) @ np.append(y, came_mg / steps_s[step]))[:3]
        expected_mg.append(y[0])
    ways = [transitions(*np.array([[delay_s], [pure], [damping]]), step_s) for step_s in steps_s]
    still, adds = (np.array(each) for each in zip(*ways, strict=True))
    assert filters.shown(still, adds, steps, arrived_mg[None])[0] == pytest.approx(expected_mg, rel=1e-5)


# --- when readings come


def test_on_a_dead_time_a_line_that_is_lost_or_late_changes_nothing_of_what_has_left() -> None:
    """Of 3 s: a model that counted readings took the last 3 s for half as long, and missed what came in the rest."""
    jitter_s = np.random.default_rng(0).uniform(0.09, 0.11, 60)
    for periods_s in ([0.1] * 40 + [0.2] + [0.1] * 20, [0.1] * 40 + [0.19, 0.01] + [0.1] * 20, jitter_s):
        bank, time_s = Bank([Model(3.0, "delay")], np.ones(1), 0.1, 0.02), 0.0
        bank.restart(0.0, 0.1, FLOW, 0.2)
        for dt_s in periods_s:
            time_s += float(dt_s)
            since_s = max(time_s - 2.7, 0.0)
            shown_mg = FLOW * (since_s - 0.3 + (since_s + 0.3) * math.exp(-since_s / 0.15))
            bank.update(Row(float(dt_s), float(dt_s), 0.0, shown_mg, 0.1), FLOW)
            if time_s > 3.5:
                assert bank.mass_mg == pytest.approx(FLOW * time_s, abs=0.06 * FLOW * 3.0)
        assert bank.coefficient == pytest.approx(FLOW, rel=0.03)


def test_a_dead_time_that_ends_between_two_readings_is_taken_alike_however_their_times_are_rounded() -> None:
    scores = []
    for dt_s in (0.1 - 1e-9, 0.1, 0.1 + 1e-9):
        bank = Bank([Model(1.0, "late")], np.ones(1), 0.1, 0.02)  # 5.5 readings
        bank.restart(0.0, 0.1, FLOW, 0.2)
        scores.append([bank.update(Row(dt_s, dt_s, 0.0, 4.0 * number, 0.1), FLOW) for number in range(30)])
    assert scores[0] == pytest.approx(scores[1], abs=1e-5)
    assert scores[2] == pytest.approx(scores[1], abs=1e-5)


def watched(shape: str, apart_s: float | None) -> Knowledge:
    """3 s of an opening, whose lines come every 0.1 s; now and then two of them so near to each other."""
    belief = BalanceBelief(lag_s=0.3, doubt=0.1, shape=shape, fits=2, noise_mg=0.1)
    known, time_s = Knowledge(dose_request(powder=PowderBelief(coefficient=FLOW, doses=3), balance=belief)), 0.0
    for number in range(30):
        for step_s in (0.1, apart_s) if apart_s is not None and number % 7 == 6 else (0.1,):
            step = known.act(1.0, 0.0)
            next(step)
            time_s += step_s
            left_mg = FLOW * known.shape.value(1.0) * max(time_s - 0.8, 0.0)
            with pytest.raises(StopIteration):
                step.send(Observation(time_s, left_mg, 0.05, False))
    return known


@pytest.mark.parametrize("apart_s", [0.0, 1e-6, 4e-4])
@pytest.mark.parametrize("shape", ["two poles", "delay"])
def test_lines_that_come_all_at_once_are_readings_like_others(apart_s: float, shape: str) -> None:
    usual, known = watched(shape, None), watched(shape, apart_s)
    assert known.bank.mass_mg == pytest.approx(usual.bank.mass_mg, rel=0.02)
    assert known.bank.coefficient == pytest.approx(usual.bank.coefficient, rel=0.1)
    usually, found = (balance_by(each.rows, 0.0, 100.0) for each in (usual, known))
    assert usually is not None
    assert found is not None
    assert found.lag_s == pytest.approx(usually.lag_s, rel=0.05)


# --- what is no number


def test_a_reading_of_which_no_number_comes_ends_the_dose() -> None:
    bank = Bank([Model(0.5, "two poles")], np.ones(1), 0.1, 0.02)
    with pytest.raises(ArithmeticError, match=r"reading_mg=nan"):
        bank.update(Row(0.1, 0.0, 0.0, math.nan, 0.1), FLOW)


def test_what_cannot_be_reckoned_is_feared_and_opened_for_the_least() -> None:
    bank = Bank([Model(0.5, "two poles")], np.ones(1), 0.1, 0.02)
    assert bank.chance(math.nan, 0.0, 5.0) == 1.0
    figures = (0.26, 4.0, 2.4, FLOW, 0.5, 0.05)
    assert widest_mm(bank, FlowShape(0.1, 2.5), math.nan, math.nan, *figures) == pytest.approx(0.15)
