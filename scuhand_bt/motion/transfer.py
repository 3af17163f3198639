"""From rest to rest: the quickest proven motion to any of several goal configurations.

1. The direct motion to each goal, in the order of its duration. It is the optimum of its end points;
   for two transfers in three one of the first goals is free.
2. Else a free polyline (`roadmap`), made into a chain of optimal pieces and shortened (`chain`).

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

_DIRECT_GOALS = 16
_ROOTS = 32
_LEAST_LEAN_DEG = 4.0
"""Below this much tilt, planning in the joints finds nothing that the level chart does not."""
_TILT_SHARE = 0.8
"""Of the spill limit, what a polyline may use for tilt; the rest is for acceleration."""


@dataclass(frozen=True, slots=True)
class Effort:
    """Budgets: polylines tried, iterations to find each, shortcuts, rounds for each chain and for the best."""

    polylines: int
    iterations: int
    shortcuts: int
    rounds_each: int
    rounds_best: int


LIVE = Effort(polylines=1, iterations=3000, shortcuts=20, rounds_each=8, rounds_best=0)
POLISHED = Effort(polylines=3, iterations=3000, shortcuts=30, rounds_each=8, rounds_best=40)


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
    rest = np.zeros((2, len(start)))
    for end in ends[:_DIRECT_GOALS]:
        line = np.array([start, end])
        direct = shaper.proven(line, rest, line)
        if direct is not None:
            return direct
    best: Chain | None = None
    for _ in range(effort.polylines):
        path = connect(space, start, ends[:_ROOTS], rng, effort.iterations)
        if path is None:
            continue
        chain = shaper.first(shortened(space, path, rng, effort.shortcuts))
        if chain is None:
            continue
        chain = shaper.improved(chain, rng, effort.rounds_each)
        if best is None or chain.duration_s < best.duration_s:
            best = chain
    return None if best is None else shaper.improved(best, rng, effort.rounds_best)
