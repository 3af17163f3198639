"""Joint schedules: each joint moves in its own time, in motions hardly longer than the slowest joint needs.

From rest to rest the slowest joint sets the duration. All others have spare time, and *when* they use it decides what
the arm touches. A schedule gives each joint one leg from start to goal, or two legs by way of a turning point. Each
leg is time-optimal from rest to rest or uniformly slower, and the joint's spare time is divided among waiting, going
slower and pausing:

    wait | first leg | pause | second leg | wait        durations add up to T for every joint

A joint that turns back need not rest there. Unless it pauses, its second leg begins while the first one's braking ramp
still fades, as the two ramps of jerk cancel. So the duration T is chosen first, and the search is for a schedule of
that duration that touches nothing. A leg is the sum of eight jerk steps at the times t_i,

    q(t) = q0 + sum_i s_i/6 max(0, t - t_i)^3

so hundreds of schedules can be sampled at once with a few array operations.

Joints that turn at different times tilt a load. So for a load most schedules are drawn *in step*: all joints rest at
their turning points at once, with the cone level. Changes of the best one loosen that where it is quicker.

Joints [rad] (n, 7), durations and times [s]; the caller provides the random generator.
"""

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from scuhand_bt.motion.coordinates import Coordinates
from scuhand_bt.motion.kinematics import Floats
from scuhand_bt.motion.proof import Prover
from scuhand_bt.motion.timelaw import RateLimits, legs, rest_to_rest_s
from scuhand_bt.motion.trajectory import JointTrajectory, of_jerk_steps

Legs: TypeAlias = tuple[Floats, Floats, Floats]
"""For every joint: times and jerk steps (..., 8), and the duration (...)."""

_PROPOSALS = 160
"""Schedules per round."""
_LOOKS = tuple(
    (tuple((2 * k + 1) / 2 ** (level + 1) for k in range(2**level)), kept) for level, kept in enumerate((80, 40, 16, 6))
)
"""Stages of the first look: the sample times as shares of the duration, ever finer, and how many schedules are kept."""
_LAST_LOOK = np.array([(2 * k + 1) / 32 for k in (7, 8, 5, 10, 3, 12, 6, 9, 4, 11, 1, 14, 2, 13, 0, 15)])
"""Sample times of the last look, at which the rest is tested against everything; the middle comes first."""
_MOST_PROVEN = 3
"""How many schedules that pass the last look are proven."""
_NEAR_PART = 0.7
"""Share of the proposals that are changes of the best schedule instead of new ones."""
_NEAR_SPAN = 0.6
_TURNING = np.array([0.7, 0.8, 0.7, 0.95, 0.7, 0.7, 0.7])
"""How often each joint gets a turning point; most often the elbow, as opening it lifts the hand over obstacles."""
_TURN_RAD = np.array([0.3, 0.3, 0.3, 0.2, 0.3, 0.3, 0.3])
"""Standard deviation of a turning point about the joint's straight way."""
_LIFT_RAD = np.array([0.0, 0.0, 0.0, 0.25, 0.0, 0.0, 0.0])
"""Mean offset of a turning point from the straight way: the elbow's is towards the stretched arm."""
_ANY_TURNING, _ANY_TURN_RAD = 0.75, 0.3
"""The first two for every joint of an arm of another kind, whose elbow is not known."""
_IN_STEP_PART = 0.6
"""Share of a load's new proposals that are in step."""
_IN_STEP_RAD = 0.3
"""Standard deviation of their turning points."""
_LEAST_SHARE = 0.01
"""Least share of the spare time of each part, so that a schedule in step can be changed to one that is not."""
_FIRST_UPTO = 2.0
"""Longest duration in the first round, relative to the least bound; half more in each round that finds nothing."""
_QUICKER = 0.985
"""Later schedules must be quicker than the best by this factor."""
_LEAST_S = 1e-9


@dataclass(frozen=True, slots=True)
class Schedules:
    """n schedules: goals (n, 7), durations (n,), turning points (n, 7), shares of the spare time (n, 7, 5)."""

    goals: Floats
    durations_s: Floats
    turns: Floats
    shares: Floats

    def __len__(self) -> int:
        return len(self.durations_s)

    def taken(self, which: np.ndarray) -> "Schedules":
        return Schedules(self.goals[which], self.durations_s[which], self.turns[which], self.shares[which])


def jerk_steps(start: Floats, some: Schedules, limits: RateLimits) -> tuple[Floats, Floats]:
    """Times and jerk steps of every joint of every schedule: (n, 7, 16) each.

    A joint without time for its turning point goes straight.
    """
    total_s = some.durations_s[:, None]
    firsts, first_steps, first_s = legs(some.turns - start, limits)
    seconds, second_steps, second_s = legs(some.goals - some.turns, limits)
    merged_s = merged_ramps_s(firsts, first_steps, seconds, second_steps)
    late = first_s + second_s - merged_s > total_s
    if late.any():
        joint = np.nonzero(late)[1]
        limits_of = RateLimits(limits.speed[joint], limits.acceleration[joint], limits.jerk[joint])
        firsts[late], first_steps[late], first_s[late] = legs((some.goals - start)[late], limits_of)
        second_steps[late], second_s[late], merged_s[late] = 0.0, 0.0, 0.0
    spare = np.maximum(total_s - first_s - second_s + merged_s, 0.0)[..., None] * some.shares
    return one_after_another((firsts, first_steps, first_s), (seconds, second_steps, second_s), merged_s, spare)


def one_after_another(first: Legs, second: Legs, merged_s: Floats, spare: Floats) -> tuple[Floats, Floats]:
    """Times and jerk steps (..., 16) of two legs that overlap by `merged_s`; `spare` [s] (..., 5) are the other
    parts.
    """
    (firsts, first_steps, first_s), (seconds, second_steps, second_s) = first, second
    slow_first = 1 + spare[..., 1] / np.maximum(first_s, _LEAST_S)
    slow_second = 1 + spare[..., 3] / np.maximum(second_s, _LEAST_S)
    begin = spare[..., 0]
    again = begin + first_s * slow_first + spare[..., 2] - merged_s
    times_s = np.concatenate(
        [begin[..., None] + firsts * slow_first[..., None], again[..., None] + seconds * slow_second[..., None]],
        axis=-1,
    )
    steps = np.concatenate(
        [first_steps / slow_first[..., None] ** 3, second_steps / slow_second[..., None] ** 3], axis=-1
    )
    return times_s, steps


def merged_ramps_s(firsts: Floats, first_steps: Floats, seconds: Floats, second_steps: Floats) -> Floats:
    """How much two legs may overlap [s]: the shorter ramp where a joint turns back. Times and jerk steps (..., 8).

    The last ramp of the first leg and the first ramp of the second then have opposite jerks and accelerations of the
    same sign. Both are linear in time, so their sum never exceeds the larger. Slowed legs have longer ramps.
    """
    turns_back = first_steps[..., 0] * second_steps[..., 0] < 0
    merged_s: Floats = np.where(turns_back, np.minimum(firsts[..., 1], seconds[..., 1]), 0.0)
    return merged_s


def positions(start: Floats, times_s: Floats, steps: Floats, at_s: Floats) -> Floats:
    """Positions of n schedules at m times each (n, m): (n, m, 7)."""
    since = np.maximum(at_s[:, :, None, None] - times_s[:, None], 0.0)
    moved: Floats = np.einsum("nmjk,njk->nmj", since * since * since, steps)
    return start + moved / 6


class ScheduleSearch:
    """Searches schedules from a start to goals (n, 7) that are sorted by their bounds [s] (n,).

    `level` are the coordinates in which a load's cone is kept level; None for an empty one.
    """

    def __init__(
        self,
        prover: Prover,
        limits: RateLimits,
        start: Floats,
        goals: Floats,
        bounds_s: Floats,
        level: Coordinates | None = None,
    ) -> None:
        self._prover, self._limits, self._level = prover, limits, level
        self._start, self._goals, self._bounds_s = start, goals, bounds_s
        self.motion: JointTrajectory | None = None
        self.best: Schedules | None = None
        """The schedule of the quickest motion found."""
        self._habits = (_TURNING, _TURN_RAD, _LIFT_RAD)
        if prover.mount.arm is not None:
            same = np.ones(len(start))
            self._habits = (_ANY_TURNING * same, _ANY_TURN_RAD * same, 0 * same)

    def quickest(
        self,
        known: JointTrajectory | None,
        rng: np.random.Generator,
        rounds: int,
        wanted_s: tuple[float, float],
        idle_rounds: int,
        ends: Callable[[JointTrajectory | None], bool],
    ) -> JointTrajectory | None:
        """The quickest proven schedule within so many rounds, or `known`.

        `wanted_s`: no duration below the first is drawn, and a motion within the second ends the search. So do
        `idle_rounds` in a row that find nothing quicker, and `ends`, which is asked with the best motion so far.
        """
        best, idle = known, 0
        wanted_least_s, good_s = wanted_s
        least_s = max(float(self._bounds_s[0]), wanted_least_s)
        for k in range(rounds):
            if best is not None and (best.duration_s <= good_s or idle >= idle_rounds):
                break
            if ends(best):
                break
            most_s = (_FIRST_UPTO + k / 2) * least_s if best is None else _QUICKER * best.duration_s
            some = self._fresh(_PROPOSALS, least_s, most_s, rng)
            if self.best is not None and (bound_s := max(self._bound_s(self.best), wanted_least_s)) <= most_s:
                some = self._near(self.best, some, (bound_s, most_s), rng)
            found = self._first_proven(some, best)
            idle += 1
            if found is not None:
                (best, self.best), idle = found, 0
        return best

    def _fresh(self, count: int, least_s: float, most_s: float, rng: np.random.Generator) -> Schedules:
        durations_s = least_s + (most_s - least_s) * rng.uniform(size=count)
        reachable = np.searchsorted(self._bounds_s, durations_s, side="right")
        goals = self._goals[(rng.uniform(size=count) * np.maximum(reachable, 1)).astype(int)]
        turning_of, turn_rad, lift_rad = self._habits
        turning = rng.uniform(size=goals.shape) < turning_of * rng.choice((0.4, 1.0), (count, 1))
        between = self._start + rng.uniform(size=goals.shape) * (goals - self._start)
        turns = np.where(turning, between + lift_rad + turn_rad * rng.normal(size=goals.shape), goals)
        shares = rng.exponential(size=(*goals.shape, 5)) ** 2
        shares /= shares.sum(axis=2, keepdims=True)
        fresh = Schedules(goals, durations_s, self._within(turns), shares)
        return fresh if self._level is None else self._in_step(fresh, self._level, rng)

    def _in_step(self, some: Schedules, level: Coordinates, rng: np.random.Generator) -> Schedules:
        """Change the first ones so that all joints turn at once, with the cone level, if they have time."""
        count = int(_IN_STEP_PART * len(some))
        goals, total_s = some.goals[:count], some.durations_s[:count]
        c = self._start + rng.uniform(size=(count, 1)) * (goals - self._start) + self._habits[2]
        c += _IN_STEP_RAD * rng.normal(size=c.shape)
        c[:, -2:] = 0.0  # the axis' horizontal components
        turns = self._within(level.joints(c))
        firsts, first_steps, first_s = legs(turns - self._start, self._limits)
        seconds, second_steps, second_s = legs(goals - turns, self._limits)
        merged_s = merged_ramps_s(firsts, first_steps, seconds, second_steps)
        earliest_s, latest_s = first_s.max(axis=1), total_s - second_s.max(axis=1)
        turned_s = earliest_s + (latest_s - earliest_s) * rng.uniform(size=count)
        slower_s = np.stack([turned_s[:, None] - first_s, (total_s - turned_s)[:, None] - second_s], axis=2)
        rests_s = np.insert(np.maximum(slower_s, 0.0), 1, merged_s, axis=2)
        shares = np.full((*goals.shape, 5), _LEAST_SHARE)
        shares[..., 1:4] += rests_s / np.maximum(rests_s.sum(axis=2, keepdims=True), _LEAST_S)
        shares /= shares.sum(axis=2, keepdims=True)
        has_time = latest_s >= earliest_s
        all_turns, all_shares = some.turns.copy(), some.shares.copy()
        all_turns[:count][has_time], all_shares[:count][has_time] = turns[has_time], shares[has_time]
        return Schedules(some.goals, some.durations_s, all_turns, all_shares)

    def _near(
        self, parent: Schedules, fresh: Schedules, span_s: tuple[float, float], rng: np.random.Generator
    ) -> Schedules:
        """Replace part of the fresh ones by changes of the parent, with durations within a span."""
        least_s, most_s = span_s
        count = int(_NEAR_PART * len(fresh))
        size = rng.uniform(0.05, 0.6, (count, 1))
        goals = np.repeat(parent.goals, count, axis=0)
        durations_s = most_s - (most_s - least_s) * rng.uniform(size=count) ** 2 * _NEAR_SPAN
        turns = np.broadcast_to(parent.turns, goals.shape)
        turns = np.where(turns != goals, turns + size * 0.5 * rng.normal(size=goals.shape), turns)
        back = rng.uniform(size=goals.shape) < 0.1
        turns = np.where(back, goals, turns)
        shares = parent.shares * np.exp(3 * size[..., None] * rng.normal(size=(*goals.shape, 5)))
        shares = shares / shares.sum(axis=2, keepdims=True)
        kept = fresh.taken(np.arange(count, len(fresh)))
        return Schedules(
            np.concatenate([goals, kept.goals]),
            np.concatenate([durations_s, kept.durations_s]),
            np.concatenate([self._within(turns), kept.turns]),
            np.concatenate([shares, kept.shares]),
        )

    def _bound_s(self, schedule: Schedules) -> float:
        """The shortest duration in which the schedule's goal can be reached."""
        return float(rest_to_rest_s(schedule.goals[0] - self._start, self._limits))

    def _within(self, q: Floats) -> Floats:
        inside: Floats = np.clip(q, *self._prover.mount.limits_rad)
        return inside

    def _first_proven(self, some: Schedules, best: JointTrajectory | None) -> tuple[JointTrajectory, Schedules] | None:
        """The shortest of the schedules that can be proven."""
        limit_s = np.inf if best is None else best.duration_s
        some = some.taken(np.argsort(some.durations_s, kind="stable"))
        times_s, steps = jerk_steps(self._start, some, self._limits)
        looking_free = self._look_free(some.durations_s, times_s, steps)
        for k in itertools.islice(looking_free, _MOST_PROVEN):
            course = of_jerk_steps(self._start, times_s[k], steps[k], float(some.durations_s[k]))
            motion = self._prover.proven(course, limit_s)
            if motion is not None:
                return motion, some.taken(np.array([k]))
        return None

    def _look_free(self, durations_s: Floats, times_s: Floats, steps: Floats) -> Iterator[int]:
        """The schedules that look free, in order; those that are hit drop out look by look."""
        left = np.arange(len(durations_s))
        space = self._prover.space
        for shares, kept in _LOOKS:
            q = positions(self._start, times_s[left], steps[left], durations_s[left, None] * np.array(shares))
            left = left[~space.first_look(q.reshape(-1, q.shape[2])).reshape(q.shape[:2]).any(axis=1)][:kept]
            if not len(left):
                return
        q = positions(self._start, times_s[left], steps[left], durations_s[left, None] * _LAST_LOOK)
        yield from (int(k) for k, course in zip(left, q, strict=True) if not space.any_blocked(course))
