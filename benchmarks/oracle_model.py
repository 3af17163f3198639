"""What is best done in a dose, of one who knows the plant: dynamic programming on its own flow, sampled.

    V(r, shut) = max( good(r),  E V(r - x, j) - p t )                         end the dose, or open to j
    V(r, i) = max( E V(r - x, i),  E V(r - x, j),  E V(r - x, shut) ) - p t     hold, go to j, or shut and be still

r [mg] is what has yet to leave the cone, i one of `OPENINGS` openings, x [mg] what leaves it meanwhile, the valve's
dead time and way included, t [s] how long that takes, p `PRICE_PER_S`; good(r) is 1 in tolerance, less where it is not
surely so, and a little less away from the target. x is sampled from the plant's flow, from its median state on. r only
falls, so that one pass from below solves it.

A best of many samples flatters itself, and would hop between openings whose samples had few lumps. So the samples are
two halves: what one half says is best is worth what the other says of it, and V is the mean of both. What is done is
the best by all samples. Where V itself was lucky is still sought, which a small price of each move forbids.
"""

import copy
import math
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scuhand_bt.device_specs.hand import HandSpec
from scuhand_bt.sim.hand import FADE_MM
from scuhand_bt.sim.plant import PowderFlow

Floats = NDArray[np.float64]
SHUT = -1
PRICE_PER_S = 0.0003
"""A hundredth of success is worth half a minute."""
GUARD_MG, UNSURE, ASIDE = 0.25, 0.02, 0.005
"""This near to the edge of the tolerance a dose cannot be shown to be good, which costs so much; and so much is lost
from the target to the edge."""
OPENINGS = 16
NARROWEST_MG_PER_S = 0.3
MODEL_WIDEST_MM = 3.2
"""A strong load flows through the hand's widest opening as a median one through this."""
DOWN, UP = (-1, -2, -3, -5, -8), (1, 3)
"""The other openings that are considered."""
MOVE_PRICE = 0.0005
SAMPLES = 400
LOOKS, LOOKED_MG, FREED_LOOKS = 1500, 600.0, 50
LONGEST_LOOK_S, LOOK_MG = 0.32, 0.1
"""Of samples where little comes, which are taken in steps of `COARSE_S`. After `FREED_LOOKS` it is opened anew."""
COARSE_S = 0.08
DOUBT = 0.05
"""How far the masses of the true state may be off those of the nearest one of the model, as a share."""
STEP_S, LOOK_S = 0.02, 0.04
STILL_S = 0.2
"""After the valve is shut the truth is looked at again."""
FALLS_S = 20.0
"""Whatever is in the apex has fallen by then."""
CONE_MG = 4000.0
LEAST_MG = 1e-6
"""Less is rounding."""
ROUNDS = 10
"""Of moves between openings without anything coming."""


class Middling:
    """In a generator's place: of every distribution its middle, so that a flow goes its most likely way."""

    def standard_normal(self) -> float:
        return 0.0

    def random(self) -> float:
        return 0.5

    def standard_exponential(self) -> float:
        return 1.0

    def uniform(self, low: float, high: float) -> float:
        return (low + high) / 2.0

    def poisson(self, mean: float) -> float:
        return mean

    def standard_gamma(self, shape: float) -> float:
        return shape


MIDDLE: Any = Middling()


def apex_mg(flow: PowderFlow, in_cone_mg: float) -> float:
    """What is between the cone and the air, and falls once the valve is shut."""
    return copy.copy(flow).step(FALLS_S, 0.0, 0.0, in_cone_mg, MIDDLE)


def flowing(flow: PowderFlow, opening_mm: float, vibration: float, in_cone_mg: float) -> tuple[PowderFlow, float]:
    """What this flow is once it flows, at this opening and so shaken, and how strongly [mg/s]; it is not changed."""
    flow = copy.copy(flow)

    def leaves_mg(steps: int) -> float:
        before_mg = apex_mg(flow, in_cone_mg)
        out_mg = sum(flow.step(STEP_S, opening_mm, vibration, in_cone_mg, MIDDLE) for _ in range(steps))
        return out_mg + apex_mg(flow, in_cone_mg) - before_mg

    alike = [0.0]
    for _ in range(40):
        left_mg = leaves_mg(5)
        if left_mg <= LEAST_MG:
            flow.step(0.5, opening_mm, vibration, in_cone_mg, MIDDLE)  # it primes, or is bridged
        alike = [*alike, left_mg] if 0.7 * alike[-1] < left_mg < 1.4 * alike[-1] else [left_mg]
        if len(alike) == 3:
            return flow, left_mg / (5.0 * STEP_S)
    return flow, 0.0


def steady(flow: PowderFlow, opening_mm: float, vibration: float) -> tuple[PowderFlow, float]:
    """The same of a fresh load, once the apex has filled."""
    for _ in range(5):
        flow, rate = flowing(flow, opening_mm, vibration, CONE_MG)
    return flow, rate


class Model:
    """A plant's median flow through a hand's valve, and what is best done with it."""

    def __init__(
        self, new: Callable[[], PowderFlow], hand: HandSpec, tolerance_mg: float, vibration: float = 1.0
    ) -> None:
        """ValueError where nothing flows that is so shaken while the valve is open."""
        self._new, self._hand, self.vibration = new, hand, vibration
        self._rng = np.random.default_rng(20_260_303)
        widths_mm = np.linspace(0.02, MODEL_WIDEST_MM, 80)
        rates = np.array([steady(new(), float(width_mm), vibration)[1] for width_mm in widths_mm])
        rates = np.maximum.accumulate(rates)
        comes = rates > 0.0
        if not comes.any():
            raise ValueError("nothing flows through any opening")
        self._widths_mm, self._log_rates = widths_mm[comes], np.log(rates[comes]) + 1e-9 * np.arange(comes.sum())
        slowest = min(max(NARROWEST_MG_PER_S, rates[comes][0]), rates[-1] / 10.0)
        self.log_rates = np.linspace(math.log(slowest), self._log_rates[-1], OPENINGS)
        self.openings_mm = np.array([self.opening_mm(math.exp(rate)) for rate in self.log_rates])
        self.closings_mg = [
            self.closing_mg(steady(new(), width, vibration)[0], width, CONE_MG) for width in self.openings_mm
        ]
        self._solve(tolerance_mg)

    def closing_mg(self, flow: PowderFlow, opening_mm: float, in_cone_mg: float) -> float:
        """What is to be expected to leave the cone yet if it is shut now."""
        closed = copy.copy(flow)
        out_mg = sum(closed.step(STEP_S, at_mm, 0.0, in_cone_mg, MIDDLE) for at_mm in self._way(opening_mm, 0.0))
        return out_mg + apex_mg(closed, in_cone_mg) - apex_mg(flow, in_cone_mg)

    def rate(self, opening_mm: float) -> float:
        """The median flow [mg/s]."""
        if opening_mm < self._widths_mm[0]:
            return 0.0
        return math.exp(np.interp(opening_mm, self._widths_mm, self._log_rates))

    def opening_mm(self, rate: float) -> float:
        """Where the median flow is this [mg/s]."""
        return float(np.interp(math.log(rate), self._log_rates, self._widths_mm))

    def action(self, missing_mg: float, index: int) -> int:
        """What is best done at one of the openings, or `SHUT`: where to go, or the same to stay."""
        at = min(int(np.searchsorted(self._missing_mg, missing_mg)), len(self._missing_mg) - 1)
        return int(self._best[index + 1, at])

    def worth(self, missing_mg: float) -> float:
        """V, shut: the chance of success, all but the price of its time."""
        return float(np.interp(missing_mg, self._missing_mg, self._values[0]))

    # --- sampling ---

    def _way(self, from_mm: float, to_mm: float) -> list[float]:
        """Mean openings of the steps from the command to go on."""
        dead_s, speed = self._hand.valve_dead_time_s, self._hand.valve_speed_mm_per_s
        way_mm = to_mm - from_mm
        steps = max(1, math.ceil((dead_s + abs(way_mm) / speed) / STEP_S - 1e-6))
        gone_mm = (speed * max(0.0, (step + 0.5) * STEP_S - dead_s) for step in range(steps))
        return [from_mm + math.copysign(min(gone, abs(way_mm)), way_mm) for gone in gone_mm]

    def _leaving(
        self, flow: PowderFlow, way_mm: Iterable[float], vibration: float, every: int, step_s: float = STEP_S
    ) -> list[float]:
        """What has left the cone [mg] by each so many steps of a way."""
        flow, left_mg, out_mg = copy.copy(flow), [], -apex_mg(flow, CONE_MG)
        for step, opening_mm in enumerate(way_mm, 1):
            out_mg += flow.step(step_s, opening_mm, vibration, CONE_MG, self._rng)
            if step % every == 0:
                left_mg.append(out_mg + apex_mg(flow, CONE_MG))
        return left_mg

    def _held(self, flow: PowderFlow, index: int) -> tuple[float, Floats]:
        """How long an opening is held at a time [s], and what leaves the cone in that [mg], bridges included."""
        rate = math.exp(self.log_rates[index])
        look_s = min(max(LOOK_S, LOOK_MG / rate), LONGEST_LOOK_S)
        step_s = COARSE_S if look_s >= COARSE_S else STEP_S
        steps = round(look_s / step_s)
        looks = max(LOOKS, math.ceil(LOOKED_MG / (rate * look_s)))
        way_mm = [float(self.openings_mm[index])] * (FREED_LOOKS * steps)
        parts = (self._leaving(flow, way_mm, self.vibration, steps, step_s) for _ in range(looks // FREED_LOOKS))
        return steps * step_s, np.concatenate([np.diff(left_mg) for left_mg in parts])

    def _opened(self) -> list[float]:
        """A way from shut to wide open, which is never quite as wide as it is told."""
        valve, rng = self._hand.simulation, self._rng
        error_mm = valve.opening_mm * rng.standard_normal()
        error_mm += valve.stick_mm if rng.random() < valve.stick_probability else 0.0
        way_mm = self._way(0.0, float(self.openings_mm[-1]))
        return [max(0.0, at_mm + error_mm * min(1.0, at_mm / FADE_MM)) for at_mm in way_mm]

    def _moves(self) -> Iterator[tuple[int, int, float, Floats]]:
        """From an opening, to another: the time that it takes [s], and what may leave the cone meanwhile [mg]."""
        widths_mm = [float(width_mm) for width_mm in self.openings_mm] + [0.0]
        running = [steady(self._new(), width_mm, self.vibration)[0] for width_mm in widths_mm[:-1]]
        primed = copy.copy(running[0])
        primed.step(FALLS_S, 0.0, 0.0, CONE_MG, MIDDLE)
        opened_mg = np.array([self._leaving(primed, self._opened(), self.vibration, 1) for _ in range(SAMPLES)])
        for index, flow in enumerate(running):
            steps = len(self._way(0.0, widths_mm[index]))
            yield SHUT, index, STEP_S * steps, opened_mg[:, steps - 1]
            yield index, index, *self._held(flow, index)
            way_mm = self._way(widths_mm[index], 0.0)
            shut_mg = [self._leaving(flow, way_mm, 0.0, len(way_mm))[0] for _ in range(SAMPLES)]
            yield index, SHUT, STEP_S * len(way_mm) + STILL_S, np.array(shut_mg)
            for by in (DOWN, UP):
                ends = [index + step for step in by if 0 <= index + step < OPENINGS]
                if ends:  # on the way to the farthest one the others are passed
                    way_mm = self._way(widths_mm[index], widths_mm[ends[-1]])
                    left_mg = np.array([self._leaving(flow, way_mm, self.vibration, 1) for _ in range(SAMPLES)])
                for to in ends:
                    steps = len(self._way(widths_mm[index], widths_mm[to]))
                    yield index, to, STEP_S * steps, left_mg[:, steps - 1]

    # --- solving ---

    def _solve(self, tolerance_mg: float) -> None:
        moves = sorted(self._moves(), key=lambda move: move[0])
        off = [np.exp(DOUBT * self._rng.standard_normal(len(masses_mg))) for _, _, _, masses_mg in moves]
        widest_mg = max(float(np.max(masses_mg)) for _, _, _, masses_mg in moves)
        fine_mg, coarse_mg = np.arange(-tolerance_mg, 12.0, 0.2), np.geomspace(12.0, max(50.0, 2.0 * widest_mg), 140)
        self._missing_mg = missing_mg = np.concatenate([[-tolerance_mg - 0.001], fine_mg, coarse_mg])
        origins, targets = (np.array([move[side] for move in moves]) + 1 for side in (0, 1))
        costs = PRICE_PER_S * np.array([move[2] for move in moves]) + MOVE_PRICE * (origins != targets)
        halves = [np.array_split(move[3] * by, 2) for move, by in zip(moves, off, strict=True)]
        chances = np.array([[_chances(missing_mg, half[one]) for half in halves] for one in (0, 1)])
        aside = np.abs(missing_mg) / tolerance_mg
        good = np.where(aside <= 1.0, 1.0 - ASIDE * aside - UNSURE * (aside > 1.0 - GUARD_MG / tolerance_mg), 0.0)
        choices = _choices(origins)
        self._values = values = np.zeros((OPENINGS + 1, len(missing_mg)))
        self._best = np.full(values.shape, SHUT)
        for at in range(1, len(missing_mg)):
            below = np.einsum("hmr,mr->hm", chances[:, :, at, :at], values[targets, :at]) - costs
            stays, leaves = chances[:, :, at, at], chances[:, :, at, :at].sum(axis=2)
            holds = (origins == targets) & (leaves > 0.0)
            here = np.zeros(OPENINGS + 1)
            here[0] = good[at]
            for _ in range(ROUNDS):
                worth = below + stays * here[targets]
                worth[holds] = below[holds] / leaves[holds]  # held until something comes
                ends = np.full((2, 1), good[at])
                open_to = np.concatenate([worth, ends, np.full((2, 1), -np.inf)], axis=1)[:, choices]
                chosen = open_to.argmax(axis=2)[::-1, :, None]
                here = np.take_along_axis(open_to, chosen, axis=2)[:, :, 0].mean(axis=0)
            values[:, at] = here
            best = choices[np.arange(OPENINGS + 1), open_to.mean(axis=0).argmax(axis=1)]
            self._best[:, at] = np.append(targets - 1, SHUT)[best]
            self._best[here <= 0.0, at] = SHUT  # all is lost: no more than need be


def _choices(origins: NDArray[np.int64]) -> NDArray[np.int64]:
    """Of each origin its moves; where it is shut the dose may end too, which is the one after the last move.

    The one after that is none, and fills the rows.
    """
    moves = [np.flatnonzero(origins == origin) for origin in range(OPENINGS + 1)]
    moves[0] = np.append(moves[0], len(origins))
    most = max(map(len, moves))
    return np.array([np.pad(row, (0, most - len(row)), constant_values=len(origins) + 1) for row in moves])


def _chances(missing_mg: Floats, masses_mg: Floats) -> Floats:
    """From each state to each, by linear interpolation; what is beyond the tolerance goes to the first one."""
    after_mg = np.maximum(missing_mg[:, None] - np.maximum(masses_mg, 0.0)[None, :], missing_mg[0])
    after_mg[after_mg < missing_mg[1]] = missing_mg[0]
    upper = np.clip(np.searchsorted(missing_mg, after_mg, side="left"), 1, None)
    share = (after_mg - missing_mg[upper - 1]) / (missing_mg[upper] - missing_mg[upper - 1])
    states = len(missing_mg)
    rows = np.arange(states)[:, None] * states
    flat = np.bincount((rows + upper).ravel(), share.ravel(), states * states)
    flat += np.bincount((rows + upper - 1).ravel(), (1.0 - share).ravel(), states * states)
    return (flat.reshape(states, states) / len(masses_mg)).astype(np.float32)
