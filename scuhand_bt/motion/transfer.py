"""From rest to rest: the quickest proven motion to any of several goal configurations.

1. The direct motion to each goal, in the order of its duration: the optimum of its end points.
2. Unless that is short enough: motions hardly longer than the optimum of some goal, in which every
   joint moves in its own time (`staggered`).
3. Else along a free polyline (`roadmap`), as a chain of optimal pieces that is then shortened (`chain`).

An empty cone is planned in the joints alone. For a load all of it is done in the joints, where tilting
is allowed up to the spill limit, and, where that finds nothing, with via points instead of 2, in the
level chart, where it does not happen. How long the search goes on is an `Effort`, counted in iterations.

Joints [rad] (7,), goals (n, 7), durations [s].
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from scuhand_bt.motion.collision import Scene
from scuhand_bt.motion.coordinates import Chart, JointChart, LevelChart
from scuhand_bt.motion.joint_schedules import Scheduler
from scuhand_bt.motion.kinematics import Floats
from scuhand_bt.motion.rrt_connect import Space, connect, shortened
from scuhand_bt.motion.timelaw import RateLimits, rest_to_rest_s
from scuhand_bt.motion.via_points import Chain, Shaper

_GIVEN_UP = 6
"""Rounds of staggered motions that find none, after which an empty cone's way is looked for otherwise."""
_LOADED_ROUNDS = 2
"""Times as many rounds for a load: more schedules tilt it too far, which is soon seen, and other ways are slower."""
_ITERATIONS = 4000
_LOADED_ITERATIONS = 120
"""In each of the two charts, where an iteration costs several times as much."""
_SHORTCUTS = 20
_DIRECT_PROOFS = 4
"""Of the direct motions that look free, so many of each batch are tried."""
STRIDE = 4
"""Neighbours on the elbow's circle are much alike: of the goal's configurations every fourth is looked at first."""
GOALS_AT_ONCE = 16
"""So many of them at once, from the nearest on."""
_QUICKER = 0.8
"""A goal is worth a search if its bound is below this share of the direct motion's duration."""
_ROOTS = 32
_NEAREST = 24
_LEAST_LEAN_DEG = 12.0
"""Below this much tilt, planning in the joints finds nothing that the level chart does not."""
_TILT_SHARE = 0.8
"""Of the spill limit, what a polyline may use for tilt; the rest is for acceleration."""


@dataclass(frozen=True, slots=True)
class Effort:
    """Budgets: rounds of staggered motions; for a load chains begun, batches of detours and rounds for each."""

    staggered: int
    chains: int
    detours: int
    rounds_each: int
    rounds_best: int
    near_optimum: float
    """A direct motion within this of the best goal's bound is not worth a search."""
    good_enough: float
    """Nor is any motion within this."""


LIVE = Effort(10, chains=1, detours=20, rounds_each=10, rounds_best=0, near_optimum=1.66, good_enough=1.07)
POLISHED = Effort(28, chains=2, detours=20, rounds_each=15, rounds_best=30, near_optimum=1.02, good_enough=1.02)


@dataclass(frozen=True, slots=True)
class Task:
    """What is to be planned: where from, where to, in which scene, how fast, with what in the cone.

    `goals` are free and come in the order of their bounds; those in `more` have not been looked at yet.
    """

    start: Floats
    goals: Floats
    more: Floats
    scene: Scene
    rates: RateLimits
    apex_offset_m: float
    spill_limit_deg: float | None = None

    def bounds_s(self, goals: Floats) -> Floats:
        """The least durations in which goals (n, 7) can be reached: (n,)."""
        return rest_to_rest_s(goals - self.start, self.rates)

    def free_goals(self, upto_s: float) -> Iterator[Floats]:
        """The goals that are free, a few at a time; looked at when they are asked for."""
        yield self.goals
        near = self.more[self.bounds_s(self.more) <= upto_s]
        for k in range(0, len(near), GOALS_AT_ONCE):
            some = near[k : k + GOALS_AT_ONCE]
            yield some[~self.scene.hits(some)]

    def charts(self) -> list[tuple[Chart, Space]]:
        """The charts to plan in, each with its space; the one whose motions are quicker first."""
        if self.spill_limit_deg is None:
            joints = JointChart(self.rates, self.start)
            return [(joints, Space(joints, self.scene))]
        level = LevelChart(self.rates, self.start)
        tilt_deg = _TILT_SHARE * self.spill_limit_deg
        # Between two axes that lean little enough the level chart's straight line leans no more: it needs no look.
        spaces: list[tuple[Chart, Space]] = [(level, Space(level, self.scene))]
        if tilt_deg > _LEAST_LEAN_DEG:
            leaning = JointChart(self.rates, self.start, level)
            spaces.insert(0, (leaning, Space(leaning, self.scene, tilt_deg)))
        return spaces


def plan(task: Task, effort: Effort, seed: int) -> Chain | None:
    """The quickest chain found within the effort, with its proven motion, or None; the seed decides the search."""
    searches = [_Search(task, chart, space) for chart, space in task.charts()]
    bound_s = float(task.bounds_s(task.goals[:1])[0])
    near_s, good_s = effort.near_optimum * bound_s, effort.good_enough * bound_s
    best: Chain | None = None
    # A load's motion is so much longer than the bound that a far goal may be as good as a near one.
    for goals in task.free_goals(near_s if task.spill_limit_deg is None else np.inf):
        best = _quickest([best, *(search.direct(goals, near_s) for search in searches)])
        if best is not None and best.duration_s <= near_s:
            return best
    rng = np.random.default_rng(seed)
    searches = [search for search in searches if len(search.ends)]
    known = best
    for search in searches:
        best = search.near(effort, known, rng, good_s)
        if best is not known:
            break
    if best is None:
        ways = (search.roadmap(effort, rng) for search in reversed(searches))
        best = next((way for way in ways if way is not None), None)
        rounds = (effort.staggered - _GIVEN_UP) // 2
        best = _quickest([search.staggered(rounds, best, rng, good_s) for search in searches])
    return best


def _quickest(chains: Sequence[Chain | None]) -> Chain | None:
    return min((chain for chain in chains if chain is not None), key=lambda chain: chain.duration_s, default=None)


class _Search:
    """The ways to find a chain, in one chart; goals are added in the order of their bounds."""

    def __init__(self, task: Task, chart: Chart, space: Space) -> None:
        self.task, self.chart, self.space = task, chart, space
        self.shaper = Shaper(space, task.rates, task.apex_offset_m, task.spill_limit_deg)
        self.start = chart.coordinates(task.start[None, :])[0]
        self.ends, self.bounds_s = np.empty((0, len(self.start))), np.empty(0)
        self.rates = task.rates if isinstance(chart, JointChart) else None
        self.loaded = task.spill_limit_deg is not None
        self.iterations = _LOADED_ITERATIONS if self.loaded else _ITERATIONS

    def direct(self, goals: Floats, upto_s: float) -> Chain | None:
        """Adds goals (n, 7), in the order of their bounds; the first direct motion to one of them that is proven.

        Only those that may be as short as `upto_s` are tried.
        """
        reached = goals[self.chart.covers(goals)]
        ends, bounds_s = self.chart.coordinates(reached), self.task.bounds_s(reached)
        self.bounds_s = np.concatenate([self.bounds_s, bounds_s])
        order = np.argsort(self.bounds_s, kind="stable")
        self.ends, self.bounds_s = np.concatenate([self.ends, ends])[order], self.bounds_s[order]
        worthwhile = ends[bounds_s <= upto_s]
        looks_free = self.space.glance(np.broadcast_to(self.start, worthwhile.shape), worthwhile)
        for end in worthwhile[looks_free][:_DIRECT_PROOFS]:
            direct = self.shaper.direct(self.start, end)
            if direct is not None:
                return direct
        return None

    def near(self, effort: Effort, known: Chain | None, rng: np.random.Generator, good_s: float) -> Chain | None:
        """Something quicker than what is known; or that, or None."""
        if self.rates is None:
            return _quickest([known, self.detours(effort, known, rng)])
        if self.loaded:
            return self.staggered(_LOADED_ROUNDS * effort.staggered, known, rng, good_s)
        return self.staggered(effort.staggered, known, rng, good_s, _GIVEN_UP)

    def staggered(
        self, rounds: int, known: Chain | None, rng: np.random.Generator, good_s: float, given_up: int | None = None
    ) -> Chain | None:
        """The quickest motion found in which every joint moves in its own time; or what is known."""
        if self.rates is None:
            return known
        scheduler = Scheduler(
            self.space, self.shaper, self.rates, self.start, self.ends[:_NEAREST], self.bounds_s[:_NEAREST]
        )
        return scheduler.search(known, rng, rounds, given_up, good_s)

    def detours(self, effort: Effort, known: Chain | None, rng: np.random.Generator) -> Chain | None:
        """The best chain begun with one via point, to goals that promise to be quicker than what is known."""
        worthwhile = self.ends[:_ROOTS]
        if known is not None:
            worthwhile = worthwhile[self.bounds_s[:_ROOTS] < _QUICKER * known.duration_s]
        chains = []
        for _ in range(effort.chains if len(worthwhile) else 0):
            begun: Chain | None = None
            for _ in range(effort.detours):
                begun = begun or self.shaper.detour(self.start, worthwhile, rng, np.inf)
            if begun is not None:
                chains.append(self.shaper.improved(begun, worthwhile, rng, effort.rounds_each))
        best = _quickest(chains)
        return None if best is None else self.shaper.improved(best, worthwhile, rng, effort.rounds_best)

    def roadmap(self, effort: Effort, rng: np.random.Generator) -> Chain | None:
        """The chain along a free polyline, for ways that one via point does not open."""
        goals = self.ends[:_ROOTS]
        path = connect(self.space, self.start, goals, rng, self.iterations)
        if path is None:
            return None
        chain = self.shaper.first(shortened(self.space, path, rng, _SHORTCUTS))
        rounds = (effort.rounds_each if self.loaded else effort.rounds_each // 3) + effort.rounds_best
        return None if chain is None else self.shaper.improved(chain, goals, rng, rounds)
