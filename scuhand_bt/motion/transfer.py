"""From rest to rest: the quickest proven motion to any of several goal configurations (docs/motion.md).

1. Direct motions: the time optimum to each goal, the shortest first.

2. Unless one is short enough: joint schedules, hardly longer than the optimum of some goal (`joint_schedules`).

3. If these find none: a free polyline (`rrt_connect`), then via points that may move (`via_points`).

An empty cone is planned only in the joints. A load is planned in the joints too, within part of its spill limit for
tilt. If nothing is known and that finds nothing, it is planned in level coordinates, with via points instead of 2. An
`Effort` is a budget in iterations. If the whole search finds nothing, it is repeated with other seeds and twice the
budget. What is `AtHand` may end it sooner.

Joints [rad] (7,), goals (n, 7), durations [s].
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from scuhand_bt.motion.collision import Scene
from scuhand_bt.motion.coordinates import JointCoordinates, level_coordinates
from scuhand_bt.motion.free_space import Space
from scuhand_bt.motion.joint_schedules import ScheduleSearch
from scuhand_bt.motion.kinematics import ApexPose, Floats, Mount
from scuhand_bt.motion.patience import Patience
from scuhand_bt.motion.proof import Prover
from scuhand_bt.motion.rrt_connect import connect, shortened
from scuhand_bt.motion.schedule_descent import Descent
from scuhand_bt.motion.timelaw import RateLimits, rest_to_rest_s
from scuhand_bt.motion.trajectory import JointTrajectory
from scuhand_bt.motion.via_points import ViaPointSearch, ViaTrajectory

_LOADED_ROUNDS = 2
"""Factor on the rounds for a load: more schedules tilt it too far, which is quick to find, and other ways are
slower."""
_ITERATIONS = 4000
"""Iterations of RRT-Connect for an empty cone."""
_LOADED_ITERATIONS = 120
"""The same for a load in each of the two coordinates, where an iteration costs several times as much."""
_LEVELLED, _MOST_LEVELLED, _LOADED_CHANGES = 3, 8, 2
"""From how many of the empty cone's schedules a load's is tried; from how many at most if none of these works; and the
factor on the number of changes."""
ATTEMPTS = 3
"""How often a search that finds nothing is made, each with another seed; after the first with twice the budget."""
_LOADED_DIRECTS = 4
"""For how many goals of a batch a load's direct motion is proven, which costs as much as an edge."""
_SHORTCUTS = 20
"""Attempts to shorten a polyline."""
_DETOURS = 12
"""Batches of random via points that are tried for a start."""
_STRIDE = 4
"""Every fourth of a goal's configurations is tried first, as neighbours on the elbow's circle are much alike."""
_GOALS_AT_ONCE = 16
"""How many of them are tested at once, from the nearest on."""
_MOST_GOALS = 64
"""So many free ones suffice; a pose with a free yaw has hundreds."""
_ROOTS = 32
"""How many of the nearest goals are used by via points and trees."""
_NEAREST = 24
"""How many are used by schedules."""
_LEAST_LEAN_DEG = 12.0
"""With less tilt than this, planning in the joints finds nothing that level coordinates do not."""
_TILT_SHARE = 0.8
"""The share of the spill limit that a polyline may use for tilt; the rest is for acceleration."""


@dataclass(frozen=True, slots=True)
class Effort:
    """Budgets: rounds of schedules; in level coordinates, starts with one via point, and rounds for each."""

    schedule_rounds: int
    via_starts: int
    via_rounds: int
    idle_rounds: int
    """A search that has found something ends after so many rounds in a row without anything quicker."""
    near_optimum: float
    """A direct motion within this factor of the best goal's bound is taken without a search."""
    good_enough: float
    """Any motion within this factor ends the search."""
    changes: int = 0
    """How many steps of `schedule_descent` improve the best schedule of a search."""
    starts: int = 1
    """How many searches of schedules are made."""
    is_brief: bool = False
    """Give up a load's way that no schedule finds. Most existing ways are found by one, and showing that there is none
    costs hundreds of times as much."""


LIVE = Effort(schedule_rounds=10, via_starts=1, via_rounds=10, idle_rounds=7, near_optimum=1.66, good_enough=1.07)
BRIEF = replace(LIVE, is_brief=True)
PREPARED = replace(LIVE, schedule_rounds=100, via_rounds=40, idle_rounds=100, changes=20, starts=2)
"""For loads between places, which are planned before the arm waits for them."""
POLISHED = Effort(
    schedule_rounds=60,
    via_starts=2,
    via_rounds=30,
    idle_rounds=30,
    near_optimum=1.02,
    good_enough=1.02,
    changes=10,
    starts=2,
)


@dataclass(frozen=True, slots=True)
class Goals:
    """A goal's configurations (n, 7) in the order of testing: some that are free, and those not tested yet."""

    free: Floats
    more: Floats

    @classmethod
    def ranked(cls, q: Floats, start: Floats, rates: RateLimits, scene: Scene) -> "Goals":
        """From all configurations of a goal. `free` is empty only if none of `q` is free."""
        nearest = np.argsort(rest_to_rest_s(q - start, rates), kind="stable")
        free, more = q[:0], q[np.concatenate([nearest[k::_STRIDE] for k in range(_STRIDE)])]
        while len(more) and not len(free):
            some, more = more[:_GOALS_AT_ONCE], more[_GOALS_AT_ONCE:]
            free = some[~scene.hits(some)]
        return cls(free, more)


@dataclass(frozen=True, slots=True)
class Task:
    """What to plan: from where, to where, in which scene, at which rates, with what in the cone."""

    start: Floats
    goals: Goals
    scene: Scene
    rates: RateLimits
    mount: Mount
    spill_limit_deg: float | None = None
    pose: ApexPose | None = None
    """The pose to which the goals belong, which has more configurations; None if there are no others."""

    @property
    def leans(self) -> bool:
        """Whether there is a load with a worthwhile tilt limit. With less, motions are level or slowed ones of
        others.
        """
        return self.spill_limit_deg is not None and _TILT_SHARE * self.spill_limit_deg > _LEAST_LEAN_DEG

    def bounds_s(self, goals: Floats) -> Floats:
        """The least durations in which goals (n, 7) can be reached: (n,)."""
        return rest_to_rest_s(goals - self.start, self.rates)

    def free_goals(self, upto_s: float) -> Iterator[Floats]:
        """The free goals, a few at a time; they are tested only when asked for."""
        yield self.goals.free
        near = self.goals.more[self.bounds_s(self.goals.more) <= upto_s]
        count = len(self.goals.free)
        for k in range(0, len(near), _GOALS_AT_ONCE):
            if count >= _MOST_GOALS:
                return
            some = near[k : k + _GOALS_AT_ONCE]
            free = some[~self.scene.hits(some)]
            count += len(free)
            yield free

    def spaces(self) -> list[Space]:
        """The spaces to plan in, each with its coordinates; the one with quicker motions first."""
        if self.spill_limit_deg is None:
            return [Space(JointCoordinates(self.rates, self.mount.limits_rad), self.scene, self.mount)]
        level = level_coordinates(self.rates, self.mount, self.start)
        tilt_deg = _TILT_SHARE * self.spill_limit_deg
        # A straight line of level coordinates leans no more than its ends do.
        covered = bool(level.covers(self.start[None, :])[0])
        spaces = [Space(level, self.scene, self.mount)] if covered else []
        if tilt_deg > _LEAST_LEAN_DEG or not covered:
            joints = JointCoordinates(self.rates, self.mount.limits_rad, level)
            spaces.insert(0, Space(joints, self.scene, self.mount, tilt_deg))
        return spaces


@dataclass(frozen=True, slots=True)
class AtHand:
    """What is known before a search."""

    motion: JointTrajectory | None = None
    """A motion that keeps the task's limits; the result is never slower."""
    least_s: float = 0.0
    """A motion that takes less than this has no advantage."""
    enough_s: float = 0.0
    """A motion that takes no longer than this is not improved on."""
    will_do: bool = False
    """Whether another motion will do if nothing is found: the search is then made only once."""
    attempts: int = ATTEMPTS
    """How often it is made otherwise."""
    is_quick: bool = False
    """Search only direct motions and joint schedules, once."""
    patience: Patience = field(default_factory=Patience)

    def ends(self, best: JointTrajectory | None) -> bool:
        """Whether time is up for a search that has found this."""
        return self.patience.ends(self.will_do or best is not None)


def plan(task: Task, effort: Effort, seed: int, known: AtHand | None = None) -> JointTrajectory | None:
    """The quickest proven motion found within the effort, or None. The seed determines the search."""
    known = known or AtHand()
    # A motion known for a stricter limit is mostly level. Only the space that allows tilt may have a quicker one.
    spaces = task.spaces() if known.motion is None and not known.is_quick else task.spaces()[:1]
    searches = [_Search(task, space, effort, known) for space in spaces]
    bound_s = float(task.bounds_s(task.goals.free[:1])[0])
    near_s, good_s = (max(known.enough_s, share * bound_s) for share in (effort.near_optimum, effort.good_enough))
    if known.is_quick and known.enough_s:
        near_s = good_s = known.enough_s
    best = known.motion
    # A load's motion is so much longer than the bound that any goal may be the best.
    for goals in task.free_goals(near_s if task.spill_limit_deg is None else np.inf):
        upto_s = near_s if best is None else min(near_s, best.duration_s)
        best = _quickest([best, *(search.direct(goals, upto_s) for search in searches)])
        if best is not None and best.duration_s <= near_s:
            return best
        if known.ends(best):
            return best
    if effort.changes and task.leans:
        best = _quickest([best, _levelled(task, effort, seed, known, good_s)])
        if best is not None and (best.duration_s <= good_s or known.is_quick):
            return best
    searches = [search for search in searches if len(search.ends)]
    if known.is_quick:
        # Not started from a direct motion, which may be too slow to be improved on.
        return _quickest([best, *(one.quicker_than(None, np.random.default_rng(seed), good_s) for one in searches)])
    if effort.is_brief and task.spill_limit_deg is not None:
        return best
    for attempt in range(1 if known.will_do else known.attempts):
        rng = np.random.default_rng([seed, attempt] if attempt else seed)
        for search in searches:
            quicker = search.quicker_than(best, rng, good_s)
            if quicker is not best:
                return quicker
        if best is None:
            ways = (search.by_rrt_connect(rng, min(2, 1 + attempt)) for search in reversed(searches))
            best = next((way for way in ways if way is not None), None)
        if best is not None:
            break
    return best


def _levelled(task: Task, effort: Effort, seed: int, known: AtHand, good_s: float) -> JointTrajectory | None:
    """A load's motion, found by `schedule_descent` from the empty cone's schedules.

    These are quick and easily found, but tilt the load too far; the linear programs correct that.
    """
    empty = replace(task, spill_limit_deg=None)
    space, best = empty.spaces()[0], known.motion
    prover = Prover(space, task.rates, task.mount, task.spill_limit_deg)
    search = _Search(empty, space, effort, known)
    for goals in task.free_goals(np.inf):
        search.add(goals)
    for start in range(_MOST_LEVELLED):
        is_enough = best is not None and (best.duration_s <= good_s or start >= _LEVELLED)
        if is_enough or known.ends(best):
            break
        rng = np.random.default_rng([seed, start])
        schedule = search.schedules(None, rng, good_s).best
        if schedule is not None:
            descent = Descent(prover, task.rates, task.start, task.spill_limit_deg, task.pose)
            best = descent.quicker(schedule, best, known.least_s, _LOADED_CHANGES * effort.changes, known.ends)
    return best


def _quickest(motions: Iterable[JointTrajectory | None]) -> JointTrajectory | None:
    return min((motion for motion in motions if motion is not None), key=lambda one: one.duration_s, default=None)


class _Search:
    """The ways to find a motion in one space; goals are added in the order of their bounds."""

    def __init__(self, task: Task, space: Space, effort: Effort, known: AtHand) -> None:
        self._task, self._space, self._effort, self._known = task, space, effort, known
        self._prover = Prover(space, task.rates, task.mount, task.spill_limit_deg)
        self._via_points = ViaPointSearch(self._prover)
        self._start = space.coordinates.of(task.start[None, :])[0]
        self._loaded = task.spill_limit_deg is not None
        self.ends, self._bounds_s = np.empty((0, len(self._start))), np.empty(0)

    def add(self, goals: Floats) -> tuple[Floats, Floats]:
        """Add goals (n, 7). Returns those that these coordinates cover, and their bounds."""
        reached = goals[self._space.coordinates.covers(goals)]
        ends, bounds_s = self._space.coordinates.of(reached), self._task.bounds_s(reached)
        self._bounds_s = np.concatenate([self._bounds_s, bounds_s])
        order = np.argsort(self._bounds_s, kind="stable")
        self.ends, self._bounds_s = np.concatenate([self.ends, ends])[order], self._bounds_s[order]
        return ends, bounds_s

    def direct(self, goals: Floats, upto_s: float) -> JointTrajectory | None:
        """Add goals (n, 7), in the order of their bounds; returns the first proven direct motion to one of them.

        Only those that may be as short as `upto_s` are tried.
        """
        ends, bounds_s = self.add(goals)
        worthwhile = ends[bounds_s <= upto_s]
        looks_free = self._space.glance(np.broadcast_to(self._start, worthwhile.shape), worthwhile)
        tried = worthwhile[looks_free][: _LOADED_DIRECTS if self._loaded else None]
        directs = (self._prover.direct(self._start, end) for end in tried)
        return next((direct for direct in directs if direct is not None), None)

    def quicker_than(
        self, known: JointTrajectory | None, rng: np.random.Generator, good_s: float
    ) -> JointTrajectory | None:
        """Something quicker than `known`; else `known`."""
        if not isinstance(self._space.coordinates, JointCoordinates):
            return _quickest([known, self._by_detours(rng)])
        effort, task, best = self._effort, self._task, known
        for start in range(effort.starts):
            # A new search may end in another local optimum.
            found = self.schedules(None if start else known, rng, good_s)
            best = _quickest([best, found.motion])
            if best is not None and (best.duration_s <= good_s or self._known.ends(best)):
                break
            if effort.changes and found.best is not None:
                descent = Descent(self._prover, task.rates, self._start, task.spill_limit_deg, task.pose)
                best = descent.quicker(found.best, best, self._known.least_s, effort.changes, self._known.ends)
        return best

    def schedules(self, known: JointTrajectory | None, rng: np.random.Generator, good_s: float) -> ScheduleSearch:
        """A completed search of schedules."""
        ends, bounds_s, coordinates = self.ends[:_NEAREST], self._bounds_s[:_NEAREST], self._space.coordinates
        level = coordinates.level if isinstance(coordinates, JointCoordinates) else None
        search = ScheduleSearch(self._prover, self._task.rates, self._start, ends, bounds_s, level)
        rounds = (_LOADED_ROUNDS if self._loaded else 1) * self._effort.schedule_rounds
        wanted_s = (self._known.least_s, good_s)
        search.motion = search.quickest(known, rng, rounds, wanted_s, self._effort.idle_rounds, self._known.ends)
        return search

    def _by_detours(self, rng: np.random.Generator) -> JointTrajectory | None:
        """The best motion that begins with one via point."""
        found = []
        for _ in range(self._effort.via_starts):
            begun: ViaTrajectory | None = None
            for _ in range(_DETOURS):
                if begun is not None or self._known.ends(None):
                    break
                begun = self._via_points.detour(self._start, self.ends[:_ROOTS], rng)
            found.append(self._improved(begun, rng))
        return _quickest(found)

    def by_rrt_connect(self, rng: np.random.Generator, budget: int) -> JointTrajectory | None:
        """The motion along a free polyline, in `budget` times the iterations."""
        iterations = budget * (_LOADED_ITERATIONS if self._loaded else _ITERATIONS)
        path = connect(self._space, self._start, self.ends[:_ROOTS], rng, iterations, lambda: self._known.ends(None))
        if path is None:
            return None
        return self._improved(self._via_points.through_polyline(shortened(self._space, path, rng, _SHORTCUTS)), rng)

    def _improved(self, begun: ViaTrajectory | None, rng: np.random.Generator) -> JointTrajectory | None:
        if begun is None:
            return None
        effort, goals = self._effort, self.ends[:_ROOTS]
        found = self._via_points.improved(begun, goals, rng, effort.via_rounds, effort.idle_rounds, self._known.ends)
        return found.motion
