"""From a polyline to a motion: a chain of time-optimal pieces through via points that may move.

    minimise   sum_k T(p_k, v_k; p_{k+1}, v_{k+1})        over via points p_k and the speeds v_k there

T is the jerk-limited optimum between two states (`timelaw`), each solved in microseconds; that the
whole motion is free, keeps the joints' limits and keeps the load is then *proven* (`collision`,
`spill`). A chain is not bound to its polyline: it is shortened by a random search that proposes many
chains, ranks them by duration, proves only those that would be quicker, widens its steps after a
success and narrows them after a failure, and tries again in a direction that has just paid.

Chart coordinates (m, 7), times [s].
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from scuhand_bt.motion.coordinates import JointChart
from scuhand_bt.motion.kinematics import Floats
from scuhand_bt.motion.rrt_connect import Space
from scuhand_bt.motion.spill import spill_stretch
from scuhand_bt.motion.timelaw import RateLimits, TimeLaw, cubics, rest_to_rest_s
from scuhand_bt.motion.trajectory import JointTrajectory, through

_FIRST_SPEEDS = (1.6, 1.2, 0.8, 0.4)
_PROPOSALS = 16
_PROVEN_PER_ROUND = 3
_FIRST_SPREAD = 0.2
_SPEED_PER_RAD = 3.0
"""How much a via's speed is varied [rad/s] where its position is varied by 1 rad."""
_FASTEST = 0.98
_DETOURS = 64
_DETOUR_SPREAD = 0.5
_GRID_S = 0.01


@dataclass(frozen=True, slots=True)
class Chain:
    """Via points and speeds (m, 7), ends included, and the proven motion through them."""

    points: Floats
    speeds: Floats
    motion: JointTrajectory
    polyline: Floats
    """The free polyline it began as."""

    @property
    def duration_s(self) -> float:
        return self.motion.duration_s


class Shaper:
    """Makes chains in one space and proves them.

    `rates` are the joints' limits; `spill_limit_deg` the load's, None for an empty cone.
    """

    def __init__(self, space: Space, rates: RateLimits, apex_offset_m: float, spill_limit_deg: float | None) -> None:
        self._space = space
        self._law = TimeLaw(space.chart.rates)
        self._rates = rates
        self._offset_m = apex_offset_m
        self._spill_deg = spill_limit_deg

    def proven(self, points: Floats, speeds: Floats, polyline: Floats, quicker_than_s: float = np.inf) -> Chain | None:
        """The chain as a motion that is free and within all limits; None if it is not, or not quicker."""
        pieces = self._law.chain(points, speeds)
        if pieces is None or sum(piece.duration for piece in pieces) >= quicker_than_s:
            return None
        motion = self.proof(cubics(pieces), quicker_than_s)
        return None if motion is None else Chain(points, speeds, motion, polyline)

    def direct(self, start: Floats, end: Floats) -> Chain | None:
        """The optimum from rest to rest along the line, if it is proven."""
        line = np.array([start, end])
        if self._follows_lines and not self._space.free(start, end):
            return None
        return self._along(line)

    @property
    def _follows_lines(self) -> bool:
        """Whether a motion along the chart's straight lines is proven as soon as they are."""
        return isinstance(self._space.chart, JointChart) and self._spill_deg is None

    def _along(self, free_lines: Floats) -> Chain | None:
        """At rest in every vertex, exactly along lines that have been proven as such."""
        course = self._law.straight(free_lines)
        motion = course if self._follows_lines else self.proof(course)
        return None if motion is None else Chain(free_lines, np.zeros_like(free_lines), motion, free_lines)

    def proof(self, course: JointTrajectory, quicker_than_s: float = np.inf) -> JointTrajectory | None:
        """A motion in the chart's coordinates as a proven one of the joints, as slow as it must be."""
        motion = course
        if not isinstance(self._space.chart, JointChart):
            times_s = np.linspace(0.0, course.duration_s, int(course.duration_s / _GRID_S) + 2)
            motion = through(times_s, self._space.chart.joints(course.at(times_s)))
            motion = motion.stretched(max(1.0, self._rates.stretch_for(motion)))
        if self._spill_deg is not None:
            factor = spill_stretch(motion, self._offset_m, self._spill_deg)
            if factor is None:
                return None
            motion = motion.stretched(factor).keeping(self._spill_deg)
        if motion.duration_s >= quicker_than_s:
            return None
        return motion if self._space.scene.proves(motion) else None

    def first(self, path: Floats) -> Chain | None:
        """A proven chain through a free polyline's vertices, as quick as a few guesses of its speeds find."""
        for scale in _FIRST_SPEEDS:
            chain = self.proven(path, self._passing(path, scale), path)
            if chain is not None:
                return chain
        return self._along(path)

    def detour(self, start: Floats, goals: Floats, rng: np.random.Generator, quicker_than_s: float) -> Chain | None:
        """The quickest chain found through one random via point near a line to one of the goals (n, 7).

        Most obstacles need no more than one via point, and looking at many at once is cheap: the via
        points themselves, then a glance along both legs, then the few quickest chains are proven.
        """
        limits = self._space.chart.rates
        ends = goals[rng.integers(len(goals), size=_DETOURS)]
        vias = start + rng.uniform(0.2, 0.8, (_DETOURS, 1)) * (ends - start)
        vias += rng.normal(size=vias.shape) * _DETOUR_SPREAD * self._space.chart.scatter
        shortest_s = rest_to_rest_s(np.abs(vias - start) + np.abs(ends - vias), limits)
        order = np.argsort(shortest_s, kind="stable")
        order = order[shortest_s[order] < quicker_than_s]
        space, starts = self._space, np.broadcast_to(start, vias.shape)
        looks: tuple[Callable[[np.ndarray], np.ndarray], ...] = (
            lambda k: ~space.blocked(space.chart.joints(vias[k])),
            lambda k: space.glance(starts[k], vias[k]),
            lambda k: space.glance(vias[k], ends[k]),
        )
        for looks_free in looks:
            if len(order):
                order = order[looks_free(order)]
        quickest: list[tuple[float, int, Floats, Floats]] = []
        for k in order:
            points = np.array([start, vias[k], ends[k]])
            speeds = self._passing(points, 1.2)
            pieces = self._law.chain(points, speeds)
            if pieces is not None:
                quickest.append((sum(piece.duration for piece in pieces), int(k), points, speeds))
        quickest.sort(key=lambda found: found[:2])
        for duration_s, _, points, speeds in quickest[:_PROVEN_PER_ROUND]:
            chain = self.proven(points, speeds, points, quicker_than_s) if duration_s < quicker_than_s else None
            if chain is not None:
                return chain
        return None

    def _passing(self, points: Floats, scale: float) -> Floats:
        """Speeds at a polyline's vertices: towards the one after next, rest at both ends."""
        legs_s = rest_to_rest_s(np.diff(points, axis=0), self._space.chart.rates)
        speeds = np.zeros_like(points)
        speeds[1:-1] = scale * (points[2:] - points[:-2]) / (legs_s[1:] + legs_s[:-1])[:, None]
        return self._capped(speeds)

    def _capped(self, speeds: Floats) -> Floats:
        capped: Floats = np.clip(speeds, -_FASTEST * self._law.limits.speed, _FASTEST * self._law.limits.speed)
        return capped

    def improved(self, chain: Chain, goals: Floats, rng: np.random.Generator, rounds: int) -> Chain:
        """A quicker chain to any of the goals (n, 7), after at most `rounds` of proposals."""
        spread, direction = _FIRST_SPREAD, np.zeros((2, *chain.points.shape))
        for _ in range(rounds):
            if len(chain.points) == 2:
                break
            proposals: list[tuple[float, int, Floats, Floats]] = []
            for points, speeds in self._proposals(chain, goals, spread, direction, rng):
                pieces = self._law.chain(points, speeds)
                if pieces is not None:
                    proposals.append((sum(piece.duration for piece in pieces), len(proposals), points, speeds))
            proposals.sort(key=lambda proposal: proposal[:2])
            better = None
            for duration_s, _, points, speeds in proposals[:_PROVEN_PER_ROUND]:
                if duration_s >= chain.duration_s:
                    break
                better = self.proven(points, speeds, chain.polyline, chain.duration_s)
                if better is not None:
                    break
            if better is None:
                spread = max(0.6 * spread, 0.01)
                direction = 0.5 * direction
                continue
            spread = min(1.5 * spread, 0.6)
            if better.points.shape == chain.points.shape:
                direction = np.stack([better.points - chain.points, better.speeds - chain.speeds])
                # The ends are where they are: another goal is no direction to go on in.
                direction[:, [0, -1]] = 0.0
            else:
                direction = np.zeros((2, *better.points.shape))
            chain = better
        return chain

    def _proposals(
        self, chain: Chain, goals: Floats, spread: float, direction: Floats, rng: np.random.Generator
    ) -> Iterator[tuple[Floats, Floats]]:
        """Points and speeds near the chain's: one via left out; one or all moved; now and then another goal."""
        vias = len(chain.points) - 2
        if vias > 1:
            dropped = int(rng.integers(1, vias + 1))
            yield np.delete(chain.points, dropped, axis=0), np.delete(chain.speeds, dropped, axis=0)
        for _ in range(_PROPOSALS):
            step = np.zeros_like(direction)
            moved = slice(1, -1) if rng.uniform() < 0.4 else int(rng.integers(1, vias + 1))
            step[:, moved] = rng.normal(size=step[:, moved].shape) * self._space.chart.scatter
            step *= spread * rng.uniform(0.3, 1.2)
            step[1] *= _SPEED_PER_RAD
            if rng.uniform() < 0.4:
                step = step / 2 + direction * rng.uniform(0.3, 2.0)
            points = chain.points + step[0]
            if rng.uniform() < 0.15:
                points[-1] = goals[rng.integers(len(goals))]
            yield points, self._capped(chain.speeds + step[1])
