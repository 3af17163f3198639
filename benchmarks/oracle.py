"""The floor: the best dose of one who sees the truth, by dynamic programming on the plant's own flow.

It knows what has left the nozzle, the real opening, and the state of the powder: how strongly this load flows through
this opening now, whether it is primed or bridged. It knows the distribution of what comes next and not the draws.

    V(r, 0) = max( good(r),  E V(r - x, j) - p t )                       shut: end the dose, or open to j
    V(r, i) = max( E V(r - x, i),  E V(r - x, j),  E V(r - x, 0) ) - p t     hold, go to j, or shut and be still

r [mg] is what is missing, i one of `OPENINGS` openings, x [mg] what leaves meanwhile, the valve's dead time and way
included, t [s] how long that takes, p `PRICE_PER_S`. good(r) is 1 in tolerance, less where it is not surely so, and a
little less away from the target. x is sampled from the plant's flow at its median state; a flow f times as strong is
what comes at the opening where the median flow is f times as strong. r only falls, so
that one pass from below solves it.

Nothing but the hand limits its opening. The motor runs while the valve is open, and stops at the command to shut.
"""

import copy
import math
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scuhand_bt.cell.cell import Cell
from scuhand_bt.cell.dose_loop import DoseRun
from scuhand_bt.cell.weighing import weigh_until_still, weighing_of
from scuhand_bt.cell_spec import HandSpec
from scuhand_bt.clock import Steps, Wake
from scuhand_bt.dosing import DoseRequest, Finish
from scuhand_bt.sim.hand import FADE_MM
from scuhand_bt.sim.mass_ledger import CONE, FLIGHT
from scuhand_bt.sim.plant import PowderFlow
from scuhand_bt.sim.world import World

Floats = NDArray[np.float64]
PRICE_PER_S = 0.0003
"""A hundredth of success is worth half a minute."""
GUARD_MG, UNSURE, ASIDE = 0.25, 0.05, 0.01
"""This near to the edge of the tolerance a dose cannot be shown to be good, which costs so much; and so much is lost
from the target to the edge."""
OPENINGS = 16
NARROWEST_MG_PER_S = 0.3
MODEL_WIDEST_MM = 3.2
"""A strong load flows through the hand's widest opening as a median one through this."""
BY = (-8, -5, -3, -2, -1, 1, 3)
"""The other openings that are considered."""
SAMPLES = 192
DOUBT = 0.05
"""How far the masses of the true state may be off those of the nearest one of the model, as a share."""
STEP_S, LOOK_S = 0.02, 0.04
STILL_S = 0.2
"""After the valve is shut the truth is looked at again."""
FALLS_S = 1.0
"""What trickles later than that still counts."""
CONE_MG = 4000.0
ROUNDS = 10
"""Of moves between openings without anything coming."""
QUIET_S = 0.5
"""What has not come for so long is tried to be brought by shutting the valve and opening it anew."""
LONGEST_S = 900.0


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


def flowing(flow: PowderFlow, opening_mm: float, in_cone_mg: float) -> tuple[PowderFlow, float]:
    """What this flow is once it flows, at this opening and shaken, and how strongly [mg/s]; it is not changed."""
    flow = copy.copy(flow)
    for _ in range(30):
        masses_mg = [flow.step(STEP_S, opening_mm, 1.0, in_cone_mg, MIDDLE) for _ in range(20)]
        if (recent_mg := sum(masses_mg[15:])) > 0.0:
            return flow, recent_mg / (5.0 * STEP_S)
        flow.step(0.5, opening_mm, 1.0, in_cone_mg, MIDDLE)  # it primes
    return flow, 0.0


def steady(flow: PowderFlow, opening_mm: float, in_cone_mg: float = CONE_MG) -> tuple[PowderFlow, float]:
    """The same once the apex has filled."""
    flow, rate = flowing(flow, opening_mm, in_cone_mg)
    while rate > 0.0:
        before = rate
        flow, rate = flowing(flow, opening_mm, in_cone_mg)
        if rate <= 1.001 * before:
            break
    return flow, rate


class Model:
    """A plant's median flow through a hand's valve, and what is best done with it."""

    def __init__(self, new: Callable[[], PowderFlow], hand: HandSpec, tolerance_mg: float) -> None:
        self._new, self._hand = new, hand
        self._rng = np.random.default_rng(20_260_303)
        widths_mm = np.linspace(0.02, MODEL_WIDEST_MM, 80)
        rates = np.array([steady(new(), float(width_mm))[1] for width_mm in widths_mm])
        rates = np.maximum.accumulate(rates)
        comes = rates > 0.0
        self._widths_mm, self._log_rates = widths_mm[comes], np.log(rates[comes]) + 1e-9 * np.arange(comes.sum())
        slowest = min(max(NARROWEST_MG_PER_S, rates[comes][0]), rates[-1] / 10.0)
        self.log_rates = np.linspace(math.log(slowest), self._log_rates[-1], OPENINGS)
        self.openings_mm = np.array([self.opening_mm(math.exp(rate)) for rate in self.log_rates])
        self.tails_mg = [self.tail_mg(steady(new(), width)[0], width, CONE_MG) for width in self.openings_mm]
        self._solve(tolerance_mg)

    def tail_mg(self, flow: PowderFlow, opening_mm: float, in_cone_mg: float) -> float:
        """What is to be expected of the flow if it is shut now."""
        flow = copy.copy(flow)
        way_mm = (self._way(opening_mm, 0.0) if opening_mm > 0.0 else []) + [0.0] * round(FALLS_S / STEP_S)
        return sum(flow.step(STEP_S, at_mm, 0.0, in_cone_mg, MIDDLE) for at_mm in way_mm)

    def rate(self, opening_mm: float) -> float:
        """The median flow [mg/s]."""
        if opening_mm < self._widths_mm[0]:
            return 0.0
        return math.exp(np.interp(opening_mm, self._widths_mm, self._log_rates))

    def opening_mm(self, rate: float) -> float:
        """Where the median flow is this [mg/s]."""
        return float(np.interp(math.log(rate), self._log_rates, self._widths_mm))

    def action(self, missing_mg: float, index: int) -> int:
        """What is best done at one of the openings, or (-1) shut: the opening to go to, or -1; the same to stay."""
        at = min(int(np.searchsorted(self._missing_mg, missing_mg)), len(self._missing_mg) - 1)
        return int(self._best[index + 1, at])

    # --- sampling ---

    def _way(self, from_mm: float, to_mm: float) -> list[float]:
        """Openings of the steps from the command to go on."""
        dead = round(self._hand.valve_dead_time_s / STEP_S)
        step_mm = self._hand.valve_speed_mm_per_s * STEP_S
        steps = max(1, math.ceil(abs(to_mm - from_mm) / step_mm))
        return [from_mm] * dead + [float(at_mm) for at_mm in np.linspace(from_mm, to_mm, steps + 1)[1:]]

    def _fallen(self, flow: PowderFlow, ways_mm: Iterable[list[float]], vibration: float) -> Floats:
        """What has left by each step of such ways [mg], one row for each."""
        rows = []
        for way_mm in ways_mm:
            one, rng = copy.copy(flow), self._rng
            rows.append([one.step(STEP_S, opening_mm, vibration, CONE_MG, rng) for opening_mm in way_mm])
        return np.cumsum(np.array(rows), axis=1)

    def _opened(self) -> list[float]:
        """A way from shut to wide open, which is never quite as wide as it is told."""
        valve, rng = self._hand.simulation, self._rng
        error_mm = valve.opening_mm * rng.standard_normal()
        error_mm += valve.stick_mm if rng.random() < valve.stick_probability else 0.0
        way_mm = self._way(0.0, float(self.openings_mm[-1]))
        return [max(0.0, at_mm + error_mm * min(1.0, at_mm / FADE_MM)) for at_mm in way_mm]

    def _moves(self) -> Iterator[tuple[int, int, float, Floats]]:
        """From an opening, to another (-1 is shut): the time that it takes [s], and what may leave meanwhile [mg]."""
        widths_mm = [float(width_mm) for width_mm in self.openings_mm]
        running = [steady(self._new(), width_mm)[0] for width_mm in widths_mm]
        primed = copy.copy(running[0])
        primed.step(STEP_S, 0.0, 0.0, CONE_MG, MIDDLE)
        opened_mg = self._fallen(primed, [self._opened() for _ in range(SAMPLES)], 1.0)
        still, falls = round(STILL_S / STEP_S), round(FALLS_S / STEP_S)
        for index, (flow, width_mm) in enumerate(zip(running, widths_mm, strict=True)):
            steps = len(self._way(0.0, width_mm))
            yield -1, index, STEP_S * steps, opened_mg[:, steps - 1]
            look = round(LOOK_S / STEP_S)
            held_mg = self._fallen(flow, [[width_mm] * (2 * SAMPLES * look)], 1.0)[0, look - 1 :: look]
            yield index, index, LOOK_S, np.diff(held_mg, prepend=0.0)
            way_mm = self._way(width_mm, 0.0)
            shut_mg = self._fallen(flow, [way_mm + [0.0] * (still + falls)] * SAMPLES, 0.0)[:, -1]
            yield index, -1, STEP_S * (len(way_mm) + still), shut_mg
            for by in BY:
                if 0 <= index + by < OPENINGS:
                    way_mm = self._way(width_mm, widths_mm[index + by])
                    fallen_mg = self._fallen(flow, [way_mm] * SAMPLES, 1.0)[:, -1]
                    yield index, index + by, STEP_S * len(way_mm), fallen_mg + self._over_mg(flow, way_mm, index + by)

    def _over_mg(self, flow: PowderFlow, way_mm: list[float], to: int) -> float:
        """What is in the apex after such a way, beyond what will be there at this opening."""
        flow = copy.copy(flow)
        for at_mm in way_mm:
            flow.step(STEP_S, at_mm, 1.0, CONE_MG, MIDDLE)
        return max(0.0, self.tail_mg(flow, float(self.openings_mm[to]), CONE_MG) - self.tails_mg[to])

    # --- solving ---

    def _solve(self, tolerance_mg: float) -> None:
        moves = sorted(self._moves(), key=lambda move: move[0])
        off = [np.exp(DOUBT * self._rng.standard_normal(len(masses_mg))) for _, _, _, masses_mg in moves]
        widest_mg = max(float(np.max(masses_mg)) for _, _, _, masses_mg in moves)
        fine_mg, coarse_mg = np.arange(-tolerance_mg, 12.0, 0.2), np.geomspace(12.0, max(50.0, 2.0 * widest_mg), 140)
        self._missing_mg = missing_mg = np.concatenate([[-tolerance_mg - 0.001], fine_mg, coarse_mg])
        origins, targets = (np.array([move[side] for move in moves]) + 1 for side in (0, 1))
        costs = PRICE_PER_S * np.array([move[2] for move in moves])
        chances = np.array([_chances(missing_mg, move[3] * by) for move, by in zip(moves, off, strict=True)])
        first = np.searchsorted(origins, np.arange(OPENINGS + 1))
        aside = np.abs(missing_mg) / tolerance_mg
        good = np.where(aside <= 1.0, 1.0 - ASIDE * aside - UNSURE * (aside > 1.0 - GUARD_MG / tolerance_mg), 0.0)
        values = self._values = np.zeros((OPENINGS + 1, len(missing_mg)))
        self._best = np.full(values.shape, -1)
        for at in range(1, len(missing_mg)):
            below = np.einsum("mr,mr->m", chances[:, at, :at], values[targets, :at]) - costs
            stays = chances[:, at, at]
            holds = (origins == targets) & (stays < 1.0)
            here = np.zeros(OPENINGS + 1)
            here[0] = good[at]
            for _ in range(ROUNDS):
                worth = below + stays * here[targets]
                worth[holds] = below[holds] / (1.0 - stays[holds])  # held until something comes
                here = np.maximum.reduceat(worth, first)
                here[0] = max(here[0], good[at])
            values[:, at] = here
            for origin in range(OPENINGS + 1):
                end = first[origin + 1] if origin < OPENINGS else len(moves)
                self._best[origin, at] = targets[first[origin] + int(np.argmax(worth[first[origin] : end]))] - 1
            self._best[here <= 0.0, at] = -1  # all is lost: no more than need be
            if good[at] >= here[0]:
                self._best[0, at] = -1


def _chances(missing_mg: Floats, masses_mg: Floats) -> Floats:
    """From each state to each, by linear interpolation; what is beyond the tolerance goes to the first one."""
    after_mg = np.maximum(missing_mg[:, None] - masses_mg[None, :], missing_mg[0])
    after_mg[after_mg < missing_mg[1]] = missing_mg[0]
    upper = np.clip(np.searchsorted(missing_mg, after_mg, side="left"), 1, None)
    share = (after_mg - missing_mg[upper - 1]) / (missing_mg[upper] - missing_mg[upper - 1])
    states = len(missing_mg)
    rows = np.arange(states)[:, None] * states
    flat = np.bincount((rows + upper).ravel(), share.ravel(), states * states)
    flat += np.bincount((rows + upper - 1).ravel(), (1.0 - share).ravel(), states * states)
    return (flat.reshape(states, states) / len(masses_mg)).astype(np.float32)


MODELS: dict[str, Model] = {}
"""By all that makes a plant's flow and its valve: the doses of one plant share one."""


def model_of(world: World, request: DoseRequest) -> Model:
    """What is known of this world's powder and valve."""
    load, hand = world.load, world._hand.spec
    assert load.source is not None
    powder = world._sources[load.source].powder
    key = f"{vars(load._plant.flow(powder))} {hand!r} {request.tolerance_mg}"
    if key not in MODELS:
        MODELS[key] = Model(lambda: load._plant.flow(powder), hand, request.tolerance_mg)
    return MODELS[key]


class Oracle:
    """One dose's eyes and hands."""

    def __init__(self, request: DoseRequest, cell: Cell, world: World, container: str) -> None:
        self.request, self.openings = request, 0
        self._world, self._container, self._clock = world, container, cell.clock
        self._hand = world._hand
        self._model = model_of(world, request)
        self._strength = 1.0

    @property
    def missing_mg(self) -> float:
        """What has yet to leave the nozzle."""
        left_mg = self._world.true_mass(self._container) + self._world.ledger.masses_mg[FLIGHT]
        return self.request.target_mg - left_mg

    def dose(self) -> Steps[str]:
        """Until it is best to end; why it ended."""
        end_s = self._clock.now_s + LONGEST_S
        while self._clock.now_s < end_s:
            _, to = self._look()
            if to < 0:
                return "reached" if abs(self.missing_mg) <= self.request.tolerance_mg else "overshoot"
            self.openings += 1
            yield from self._go_to(to)
            yield from self._steer()
            self._hand.stop()
            yield from self._wait(self._way_s(0.0) + STILL_S)
        return "step_limit"

    def _steer(self) -> Steps[None]:
        """One opening of the valve, until it is to be shut."""
        quiet_s, before_mg = 0.0, self.missing_mg
        while self._world.ledger.masses_mg[CONE] > 0.0:
            index, to = self._look()
            if to < 0 or (quiet_s > QUIET_S and self._is_freed_by_shutting()):
                return
            if to == index:
                yield from self._wait(LOOK_S)
            else:
                yield from self._go_to(to)
            quiet_s = 0.0 if self.missing_mg < before_mg else quiet_s + LOOK_S
            before_mg = self.missing_mg

    def _look(self) -> tuple[int, int]:
        """Which of the model's openings the real one is, by how strongly the powder flows or will flow; what is best.

        The model's tail and the real one are not quite the same: what is more counts as if it had left.
        """
        gap_mm, model = self._hand.gap_mm, self._model
        known = model.rate(gap_mm)
        tail_mg = model.tail_mg(self._flow, gap_mm, self._in_cone_mg)
        if known <= 0.0:
            return -1, model.action(self.missing_mg - tail_mg, -1)
        flow, now = steady(self._flow, gap_mm, self._in_cone_mg)
        self._strength = now / known if now > 0.0 else self._strength
        index = int(np.argmin(np.abs(model.log_rates - math.log(known * self._strength))))
        tail_mg = max(tail_mg, model.tail_mg(flow, gap_mm, self._in_cone_mg))
        return index, model.action(self.missing_mg - tail_mg + model.tails_mg[index], index)

    def _go_to(self, index: int) -> Steps[None]:
        """The opening that lets as much through as the median flow does at this one."""
        hand = self._hand
        real_mm = self._model.opening_mm(math.exp(self._model.log_rates[index]) / self._strength)
        error_mm = hand._error_mm if hand.opening_mm > 0.0 else hand._sample_error_mm
        servo_mm = real_mm - error_mm
        servo_mm = servo_mm if servo_mm >= FADE_MM else real_mm / max(0.2, 1.0 + error_mm / FADE_MM)
        servo_mm = min(max(servo_mm, 0.02), hand.spec.max_opening_mm)
        hand.set_vibration(1.0)
        hand.set_opening(servo_mm)
        yield from self._wait(self._way_s(servo_mm))

    def _is_freed_by_shutting(self) -> bool:
        """Nothing comes now, and would if the valve were shut and opened anew."""
        flow, gap_mm = copy.copy(self._flow), self._hand.gap_mm

        def comes() -> bool:
            return sum(flow.step(STEP_S, gap_mm, 1.0, self._in_cone_mg, MIDDLE) for _ in range(10)) > 0.0

        if comes():
            return False
        flow.step(STEP_S, 0.0, 0.0, self._in_cone_mg, MIDDLE)
        return comes()

    @property
    def _flow(self) -> PowderFlow:
        flow = self._world.load._flow
        assert flow is not None
        return flow

    @property
    def _in_cone_mg(self) -> float:
        return self._world.ledger.masses_mg[CONE]

    def _way_s(self, opening_mm: float) -> float:
        spec = self._hand.spec
        return spec.valve_dead_time_s + abs(opening_mm - self._hand.opening_mm) / spec.valve_speed_mm_per_s

    def _wait(self, duration_s: float) -> Steps[None]:
        end_s = self._clock.now_s + duration_s
        while self._clock.now_s < end_s - 1e-9:
            yield Wake(end_s)


def run_oracle(dispense: Any, cell: Cell, world: World, container: str) -> Steps[DoseRun]:
    """A dose as `dispense` makes it, weighed before and watched afterwards like any other."""
    assert cell.believed.bracket is not None
    _, mean = yield from weigh_until_still(cell, cell.believed.bracket.last, dispense._allowed_mg)
    before, begin_s = weighing_of(mean), cell.clock.now_s
    oracle = Oracle(dispense.request(cell), cell, world, container)
    reason: Any = yield from oracle.dose()
    last = weighing_of((yield from cell.balance.stable_mean()))
    duration_s = cell.clock.now_s - begin_s
    _, mean = yield from weigh_until_still(cell, last, 0.0, dispense._watch_s(before, last))
    finish = Finish(reason, world.true_mass(container), math.sqrt(2.0) * mean.uncertainty_mg)
    return DoseRun(finish, weighing_of(mean), oracle.openings, 0.0, duration_s)
