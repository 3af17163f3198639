"""From rest to rest: the quickest proven motion to any of several goal configurations.

1. The direct motion to each goal, in the order of its duration. It is the optimum of its end points;
   for two transfers in three one of the first goals is free.
2. Else, and where another goal could be reached sooner: through one random via point, or along a free
   polyline (`roadmap`), as a chain of optimal pieces that is then shortened (`chain`).

An empty cone is planned in the joints alone. For a load both are done in the joints, where tilting is
allowed up to the spill limit, and in the level chart, where it does not happen; the quicker one is
kept. How long the search goes on is an `Effort`, counted in iterations.

Joints [rad] (7,), goals (n, 7), durations [s].
"""

from dataclasses import dataclass

import numpy as np

from scuhand_bt.motion.chain import Chain, Shaper
from scuhand_bt.motion.charts import Chart, JointChart, LevelChart
from scuhand_bt.motion.collision import Scene
from scuhand_bt.motion.kinematics import Floats
from scuhand_bt.motion.roadmap import Space, connect, shortened
from scuhand_bt.motion.timelaw import RateLimits, rest_to_rest_s

_ITERATIONS = 4000
_LOADED_ITERATIONS = 300
"""In each of the two charts, where an iteration costs several times as much."""
_SHORTCUTS = 20
_GOALS_AT_ONCE = 12
_NEAR_OPTIMUM = 1.2
"""A direct motion this near to the bound of the best goal is not worth a search."""
_QUICKER = 0.8
"""A goal is worth a search if its bound is below this share of the direct motion's duration."""
_ROOTS = 32
_LEAST_LEAN_DEG = 4.0
"""Below this much tilt, planning in the joints finds nothing that the level chart does not."""
_TILT_SHARE = 0.8
"""Of the spill limit, what a polyline may use for tilt; the rest is for acceleration."""


@dataclass(frozen=True, slots=True)
class Effort:
    """Budgets: chains begun, batches of detours for each, then rounds for each chain and for the best."""

    chains: int
    detours: int
    rounds_each: int
    rounds_best: int


LIVE = Effort(chains=1, detours=1, rounds_each=6, rounds_best=0)
POLISHED = Effort(chains=2, detours=6, rounds_each=15, rounds_best=30)


@dataclass(frozen=True, slots=True)
class Task:
    """What is to be planned: where from, where to, in which scene, how fast, with what in the cone."""

    start: Floats
    goals: Floats
    scene: Scene
    rates: RateLimits
    apex_offset_m: float
    spill_limit_deg: float | None = None

    def charts(self) -> list[tuple[Chart, Space]]:
        """The charts to plan in, each with its space."""
        if self.spill_limit_deg is None:
            joints = JointChart(self.rates, self.start)
            return [(joints, Space(joints, self.scene))]
        level = LevelChart(self.rates, self.start)
        tilt_deg = _TILT_SHARE * self.spill_limit_deg
        leaning = JointChart(self.rates, self.start, level)
        spaces: list[tuple[Chart, Space]] = [(level, Space(level, self.scene, self.spill_limit_deg))]
        if tilt_deg > _LEAST_LEAN_DEG:
            spaces.append((leaning, Space(leaning, self.scene, tilt_deg)))
        return spaces


def plan(task: Task, effort: Effort, rng: np.random.Generator) -> Chain | None:
    """The quickest chain found within the effort, with its proven motion, or None."""
    goals = task.goals[np.argsort(rest_to_rest_s(task.goals - task.start, task.rates), kind="stable")]
    best: Chain | None = None
    for chart, space in task.charts():
        reached = np.array([goal for goal in goals if chart.covers(goal)])
        if len(reached):
            found = _best_in(chart, space, task, reached, effort, rng)
            if found is not None and (best is None or found.duration_s < best.duration_s):
                best = found
    return best


def _best_in(
    chart: Chart, space: Space, task: Task, goals: Floats, effort: Effort, rng: np.random.Generator
) -> Chain | None:
    shaper = Shaper(space, task.rates, task.apex_offset_m, task.spill_limit_deg)
    start = chart.coordinates(task.start[None, :])[0]
    ends = chart.coordinates(goals)
    bounds_s = rest_to_rest_s(goals - task.start, task.rates)
    best = _direct(space, shaper, start, ends)
    if best is not None and best.duration_s <= _NEAR_OPTIMUM * bounds_s[0]:
        return best
    worthwhile = ends[: _ROOTS if best is None else int((bounds_s < _QUICKER * best.duration_s).sum())][:_ROOTS]
    if not len(worthwhile):
        return best
    iterations = 0 if best is not None else _ITERATIONS if task.spill_limit_deg is None else _LOADED_ITERATIONS
    chains = []
    for _ in range(effort.chains):
        chain = _begun(space, shaper, start, worthwhile, effort.detours, iterations, rng)
        if chain is not None:
            chains.append(shaper.improved(chain, worthwhile, rng, effort.rounds_each))
    if chains:
        chain = shaper.improved(min(chains, key=_duration_s), worthwhile, rng, effort.rounds_best)
        best = chain if best is None else min(best, chain, key=_duration_s)
    return best


def _begun(
    space: Space, shaper: Shaper, start: Floats, goals: Floats, batches: int, iterations: int, rng: np.random.Generator
) -> Chain | None:
    """A first chain: by one via point if that will do, else, where one is needed, along a polyline."""
    best: Chain | None = None
    for _ in range(batches):
        chain = shaper.detour(start, goals, rng, np.inf if best is None else best.duration_s)
        best = best if chain is None else chain
    if best is None and iterations:
        path = connect(space, start, goals, rng, iterations)
        if path is not None:
            best = shaper.first(shortened(space, path, rng, _SHORTCUTS))
    return best


def _duration_s(chain: Chain) -> float:
    return chain.duration_s


def _direct(space: Space, shaper: Shaper, start: Floats, ends: Floats) -> Chain | None:
    """The first direct motion that is proven; a glance along the lines tells which are worth the proof."""
    rest = np.zeros((2, len(start)))
    for begin in range(0, len(ends), _GOALS_AT_ONCE):
        some = ends[begin : begin + _GOALS_AT_ONCE]
        for end in some[space.glance(np.broadcast_to(start, some.shape), some)]:
            line = np.array([start, end])
            direct = shaper.proven(line, rest, line)
            if direct is not None:
                return direct
    return None
