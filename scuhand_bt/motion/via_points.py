"""Motions through via points: piecewise time-optimal, with via points and speeds that may move.

    minimise   sum_k T(p_k, v_k; p_{k+1}, v_{k+1})        over via points p_k and the speeds v_k there

T is the jerk-limited optimum between two states (`timelaw`), solved in microseconds; the whole motion is then *proven*
(`proof`). It starts from a free polyline, or from one random via point, and is not bound to that. A random search
shortens it: it proposes many changes, ranks them by duration, and proves only those that would be quicker. Steps widen
after a success and narrow after a failure.

Planning coordinates (m, 7), times [s].
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from scuhand_bt.motion.kinematics import Floats
from scuhand_bt.motion.proof import Prover
from scuhand_bt.motion.timelaw import cubics, rest_to_rest_s
from scuhand_bt.motion.trajectory import JointTrajectory

_FIRST_SPEEDS = (1.6, 1.2, 0.8, 0.4)
"""Speeds at the polyline's vertices that are tried in turn, relative to the mean speed of the two legs."""
_DETOUR_SPEED = 1.2
_PROPOSALS = 16
_PROVEN_PER_ROUND = 3
_FIRST_SPREAD = 0.2
_SPEED_PER_RAD = 3.0
"""Variation of a via point's speed [rad/s] relative to that of its position [rad]."""
_FASTEST = 0.98
"""Largest speed at a via point, relative to the limit."""
_DETOURS = 64
_DETOUR_SPREAD = 0.5


@dataclass(frozen=True, slots=True)
class ViaTrajectory:
    """Via points and their speeds (m, 7), ends included, and the proven motion through them."""

    points: Floats
    speeds: Floats
    motion: JointTrajectory


class ViaPointSearch:
    """Finds and shortens motions through via points in one space."""

    def __init__(self, prover: Prover) -> None:
        self._prover = prover
        self._space = prover.space
        self._law = prover.law

    def through_polyline(self, path: Floats) -> ViaTrajectory | None:
        """A motion through a free polyline's vertices (m, 7), as quick as a few guesses of the speeds allow."""
        for scale in _FIRST_SPEEDS:
            found = self._first_proven([(path, self._passing_speeds(path, scale))])
            if found is not None:
                return found
        motion = self._prover.along(path)
        return None if motion is None else ViaTrajectory(path, np.zeros_like(path), motion)

    def detour(self, start: Floats, goals: Floats, rng: np.random.Generator) -> ViaTrajectory | None:
        """The quickest motion found through one random via point near a line to one of the goals (n, 7).

        Most obstacles need only one via point, and testing many at once is cheap: first the via points themselves,
        then a glance along both legs, then a proof of the few quickest motions.
        """
        limits = self._space.coordinates.rates
        ends = goals[rng.integers(len(goals), size=_DETOURS)]
        vias = start + rng.uniform(0.2, 0.8, (_DETOURS, 1)) * (ends - start)
        vias += rng.normal(size=vias.shape) * _DETOUR_SPREAD * self._space.coordinates.scatter
        order = np.argsort(rest_to_rest_s(np.abs(vias - start) + np.abs(ends - vias), limits), kind="stable")
        space, starts = self._space, np.broadcast_to(start, vias.shape)
        looks: tuple[Callable[[np.ndarray], np.ndarray], ...] = (
            lambda k: ~space.blocked(space.coordinates.joints(vias[k])),
            lambda k: space.glance(starts[k], vias[k]),
            lambda k: space.glance(vias[k], ends[k]),
        )
        for looks_free in looks:
            if len(order):
                order = order[looks_free(order)]
        ways = [np.array([start, vias[k], ends[k]]) for k in order]
        return self._first_proven((points, self._passing_speeds(points, _DETOUR_SPEED)) for points in ways)

    def improved(
        self,
        found: ViaTrajectory,
        goals: Floats,
        rng: np.random.Generator,
        rounds: int,
        idle_rounds: int,
        ends: Callable[[JointTrajectory | None], bool],
    ) -> ViaTrajectory:
        """A quicker motion to any of the goals (n, 7), after `rounds` at most, or `idle_rounds` without improvement.

        It ends sooner if `ends` says so, which is asked with the best motion so far.
        """
        spread, idle = _FIRST_SPREAD, 0
        for _ in range(rounds):
            if len(found.points) == 2 or idle >= idle_rounds or ends(found.motion):
                break
            better = self._first_proven(self._proposals(found, goals, spread, rng), found.motion.duration_s)
            spread = max(0.6 * spread, 0.01) if better is None else min(1.5 * spread, 0.6)
            found, idle = better or found, idle + 1 if better is None else 0
        return found

    def _first_proven(
        self, candidates: Iterable[tuple[Floats, Floats]], quicker_than_s: float = np.inf
    ) -> ViaTrajectory | None:
        """The quickest of the candidate points and speeds (m, 7) that is proven; only the few quickest are tried."""
        solved = [(points, speeds, self._law.pieces(points, speeds)) for points, speeds in candidates]
        timed = [
            (sum(piece.duration for piece in pieces), points, speeds, pieces)
            for points, speeds, pieces in solved
            if pieces is not None
        ]
        timed.sort(key=lambda one: one[0])
        for duration_s, points, speeds, pieces in timed[:_PROVEN_PER_ROUND]:
            if duration_s >= quicker_than_s:
                break
            motion = self._prover.proven(cubics(pieces), quicker_than_s)
            if motion is not None:
                return ViaTrajectory(points, speeds, motion)
        return None

    def _passing_speeds(self, points: Floats, scale: float) -> Floats:
        """Speeds at a polyline's vertices: along the chord between the neighbours, zero at both ends."""
        legs_s = rest_to_rest_s(np.diff(points, axis=0), self._space.coordinates.rates)
        speeds = np.zeros_like(points)
        speeds[1:-1] = scale * (points[2:] - points[:-2]) / (legs_s[1:] + legs_s[:-1])[:, None]
        return self._capped(speeds)

    def _capped(self, speeds: Floats) -> Floats:
        capped: Floats = np.clip(speeds, -_FASTEST * self._law.limits.speed, _FASTEST * self._law.limits.speed)
        return capped

    def _proposals(
        self, found: ViaTrajectory, goals: Floats, spread: float, rng: np.random.Generator
    ) -> Iterator[tuple[Floats, Floats]]:
        """Changes of a motion: one via point dropped; one or all moved; now and then another goal."""
        vias = len(found.points) - 2
        if vias > 1:
            dropped = int(rng.integers(1, vias + 1))
            yield np.delete(found.points, dropped, axis=0), np.delete(found.speeds, dropped, axis=0)
        for _ in range(_PROPOSALS):
            step = np.zeros((2, *found.points.shape))
            moved = slice(1, -1) if rng.uniform() < 0.4 else int(rng.integers(1, vias + 1))
            step[:, moved] = rng.normal(size=step[:, moved].shape) * self._space.coordinates.scatter
            step *= spread * rng.uniform(0.3, 1.2)
            step[1] *= _SPEED_PER_RAD
            points = found.points + step[0]
            if rng.uniform() < 0.15:
                points[-1] = goals[rng.integers(len(goals))]
            yield points, self._capped(found.speeds + step[1])
