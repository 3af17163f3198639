"""From rest to rest: the quickest proven motion to any of several goal configurations.

1. The direct motion to each goal, in the order of its duration: the optimum of its end points.
2. Unless that is short enough: motions hardly longer than the optimum of some goal, in which every
   joint moves in its own time (`joint_schedules`).
3. Where none is found: along a free polyline (`rrt_connect`), through via points that may then move (`via_points`).

An empty cone is planned in the joints alone. For a load all of it is done in the joints, where tilting
is allowed up to the spill limit, and, where nothing is known and that finds nothing, with via points instead of 2, in
the level coordinates, where it does not happen. How long the search goes on is an `Effort`, counted in iterations;
where all of it finds nothing it is begun again from other seeds, with twice the budget. What is `AtHand` may end it
sooner.

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
"""Times as many rounds for a load: more schedules tilt it too far, which is soon seen, and other ways are slower."""
_ITERATIONS = 4000
_LOADED_ITERATIONS = 120
"""In each of the two coordinates, where an iteration costs several times as much."""
_LEVELLED, _MOST_LEVELLED, _LOADED_CHANGES = 3, 8, 2
"""From so many of the empty cone's schedules a load's is tried, with so many times the changes; from more of them
where none of those can be levelled."""
ATTEMPTS = 3
"""Times that a search which finds nothing is made, each from another seed; after the first with twice the budget."""
_LOADED_DIRECTS = 4
"""Of the goals that are looked at together, to so many a direct motion is proven: a load's costs as much as an edge."""
_SHORTCUTS = 20
_DETOURS = 12
"""Batches of random via points that are looked at before a start is given up."""
_STRIDE = 4
"""Neighbours on the elbow's circle are much alike: of the goal's configurations every fourth is looked at first."""
_GOALS_AT_ONCE = 16
"""So many of them at once, from the nearest on."""
_MOST_GOALS = 64
"""So many free ones are enough: a pose whose yaw is free has hundreds."""
_ROOTS = 32
"""So many of the nearest goals are looked for by via points and trees."""
_NEAREST = 24
"""And so many by schedules."""
_LEAST_LEAN_DEG = 12.0
"""Below this much tilt, planning in the joints finds nothing that the level coordinates do not."""
_TILT_SHARE = 0.8
"""Of the spill limit, what a polyline may use for tilt; the rest is for acceleration."""


@dataclass(frozen=True, slots=True)
class Effort:
    """Budgets: rounds of schedules; in the level coordinates starts with one via point, and rounds for each."""

    schedule_rounds: int
    via_starts: int
    via_rounds: int
    idle_rounds: int
    """So many rounds in a row that find nothing quicker end a search that has found something."""
    near_optimum: float
    """A direct motion within this of the best goal's bound is not worth a search."""
    good_enough: float
    """Nor is any motion within this."""
    changes: int = 0
    """So many steps downhill are taken from the best schedule of a search."""
    starts: int = 1
    """So many searches of schedules are made."""
    is_brief: bool = False
    """Whether a load's way that no schedule finds is given up: most that there are are found by one, and that there is
    none costs hundreds of times as much to see."""


LIVE = Effort(schedule_rounds=10, via_starts=1, via_rounds=10, idle_rounds=7, near_optimum=1.66, good_enough=1.07)
BRIEF = replace(LIVE, is_brief=True)
PREPARED = replace(LIVE, schedule_rounds=100, via_rounds=40, idle_rounds=100, changes=20, starts=2)
"""Of loads between places, which are planned before the arm waits for them."""
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
    """A goal's configurations (n, 7) in the order they are looked at: some that are free, and those not looked at."""

    free: Floats
    more: Floats

    @classmethod
    def ranked(cls, q: Floats, start: Floats, rates: RateLimits, scene: Scene) -> "Goals":
        """From all configurations of a goal; none is free only where none of `q` is."""
        nearest = np.argsort(rest_to_rest_s(q - start, rates), kind="stable")
        free, more = q[:0], q[np.concatenate([nearest[k::_STRIDE] for k in range(_STRIDE)])]
        while len(more) and not len(free):
            some, more = more[:_GOALS_AT_ONCE], more[_GOALS_AT_ONCE:]
            free = some[~scene.hits(some)]
        return cls(free, more)


@dataclass(frozen=True, slots=True)
class Task:
    """What is to be planned: where from, where to, in which scene, how fast, with what in the cone."""

    start: Floats
    goals: Goals
    scene: Scene
    rates: RateLimits
    mount: Mount
    spill_limit_deg: float | None = None
    pose: ApexPose | None = None
    """Whose configurations the goals are, some of them; None where there are no others."""

    @property
    def leans(self) -> bool:
        """Whether there is a load that may lean: where it hardly may, a motion is level, as others are to be slowed."""
        return self.spill_limit_deg is not None and _TILT_SHARE * self.spill_limit_deg > _LEAST_LEAN_DEG

    def bounds_s(self, goals: Floats) -> Floats:
        """The least durations in which goals (n, 7) can be reached: (n,)."""
        return rest_to_rest_s(goals - self.start, self.rates)

    def free_goals(self, upto_s: float) -> Iterator[Floats]:
        """The goals that are free, a few at a time; looked at when they are asked for."""
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
        """The spaces to plan in, each in its coordinates; the one whose motions are quicker first."""
        if self.spill_limit_deg is None:
            return [Space(JointCoordinates(self.rates, self.mount.limits_rad), self.scene, self.mount)]
        level = level_coordinates(self.rates, self.mount, self.start)
        tilt_deg = _TILT_SHARE * self.spill_limit_deg
        # Between two axes that lean little enough a straight line of the level coordinates leans no more.
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
    """Keeps the task's limits: what comes is never slower."""
    least_s: float = 0.0
    """What takes less than this is of no use."""
    enough_s: float = 0.0
    """What takes no more than this is not improved on."""
    will_do: bool = False
    """Whether another motion will, if nothing is found: the search is made once, and not begun again."""
    attempts: int = ATTEMPTS
    """How often it is made otherwise."""
    is_quick: bool = False
    """Whether only direct motions and schedules of the joints are looked for, once."""
    patience: Patience = field(default_factory=Patience)

    def ends(self, best: JointTrajectory | None) -> bool:
        """Whether there is no more time for a search that has found this."""
        return self.patience.ends(self.will_do or best is not None)


def plan(task: Task, effort: Effort, seed: int, known: AtHand | None = None) -> JointTrajectory | None:
    """The quickest proven motion found within the effort, or None; the seed decides the search."""
    known = known or AtHand()
    # What is known for a stricter limit is level mostly: where tilting is allowed, it is what may be quicker.
    spaces = task.spaces() if known.motion is None and not known.is_quick else task.spaces()[:1]
    searches = [_Search(task, space, effort, known) for space in spaces]
    bound_s = float(task.bounds_s(task.goals.free[:1])[0])
    near_s, good_s = (max(known.enough_s, share * bound_s) for share in (effort.near_optimum, effort.good_enough))
    if known.is_quick and known.enough_s:
        near_s = good_s = known.enough_s
    best = known.motion
    # A load's motion is so much longer than the bound that a far goal may be as good as a near one.
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
        # Not begun from a direct motion, which may be so slow that improving on it stands still.
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
    """A load's motion downhill from the empty cone's schedules, which tilt it: they are quick and easily found."""
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
    """The ways to find a motion, in one space; goals are added in the order of their bounds."""

    def __init__(self, task: Task, space: Space, effort: Effort, known: AtHand) -> None:
        self._task, self._space, self._effort, self._known = task, space, effort, known
        self._prover = Prover(space, task.rates, task.mount, task.spill_limit_deg)
        self._via_points = ViaPointSearch(self._prover)
        self._start = space.coordinates.of(task.start[None, :])[0]
        self._loaded = task.spill_limit_deg is not None
        self.ends, self._bounds_s = np.empty((0, len(self._start))), np.empty(0)

    def add(self, goals: Floats) -> tuple[Floats, Floats]:
        """Adds goals (n, 7); those that these coordinates hold, and their bounds."""
        reached = goals[self._space.coordinates.covers(goals)]
        ends, bounds_s = self._space.coordinates.of(reached), self._task.bounds_s(reached)
        self._bounds_s = np.concatenate([self._bounds_s, bounds_s])
        order = np.argsort(self._bounds_s, kind="stable")
        self.ends, self._bounds_s = np.concatenate([self.ends, ends])[order], self._bounds_s[order]
        return ends, bounds_s

    def direct(self, goals: Floats, upto_s: float) -> JointTrajectory | None:
        """Adds goals (n, 7), in the order of their bounds; the first direct motion to one of them that is proven.

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
        """Something quicker than what is known; or that, or None."""
        if not isinstance(self._space.coordinates, JointCoordinates):
            return _quickest([known, self._by_detours(rng)])
        effort, task, best = self._effort, self._task, known
        for start in range(effort.starts):
            # Begun anew, a search ends elsewhere.
            found = self.schedules(None if start else known, rng, good_s)
            best = _quickest([best, found.motion])
            if best is not None and (best.duration_s <= good_s or self._known.ends(best)):
                break
            if effort.changes and found.best is not None:
                descent = Descent(self._prover, task.rates, self._start, task.spill_limit_deg, task.pose)
                best = descent.quicker(found.best, best, self._known.least_s, effort.changes, self._known.ends)
        return best

    def schedules(self, known: JointTrajectory | None, rng: np.random.Generator, good_s: float) -> ScheduleSearch:
        """A search of schedules that is done."""
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
        """The motion along a free polyline, for ways that nothing else opens, in `budget` times the iterations."""
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
