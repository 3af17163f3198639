"""Makes a schedule quicker by linear programs over all its times and turning points at once.

A search of schedules (`joint_schedules`) ends near an optimum. From there

    minimise T      over turning points, waits, slower legs and pauses of every joint, and T;
                    if the goal is a pose, also over the end, along the arm's self-motion
    d_i + grad d_i . dq_i >= margin        for near pairs, at samples of the motion
    spill angle    <= limit                at each of them
    legs and rests <= T                    for every joint

is solved repeatedly, linearised for small changes. A change that makes the motion touch something is not taken, but
the next program includes what it would touch. Results count only once they are proven, as any motion.

Joints [rad] (n,), times [s]. x holds turning points, waits, slower first legs, pauses, slower second legs, and T: (5 n
+ 1,).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from scuhand_bt.motion.clearances import Clearances, Near
from scuhand_bt.motion.joint_schedules import Schedules, merged_ramps_s, one_after_another
from scuhand_bt.motion.kinematics import ApexPose, Floats, apex
from scuhand_bt.motion.proof import Prover
from scuhand_bt.motion.spill import apex_motion, spill_angles_deg
from scuhand_bt.motion.timelaw import RateLimits, legs
from scuhand_bt.motion.trajectory import JointTrajectory, of_jerk_steps

_SAMPLES = np.arange(1, 49) / 48
_MARGIN = 1.1
"""Multiple of the scene's margin that samples keep, as in between it may be less."""
_SPILL_DEG = 0.8
"""Distance from the spill limit that samples keep, for the same reason."""
_M_PER_DEG = 1e-3
"""Weight of the spill angle: a degree too much counts as this distance too near."""
_OVERLAP_M = 6e-4
"""An overlap up to this may vanish with denser samples, so such a schedule is tried."""
_S_PER_M, _SLACK_S_PER_M = 200.0, 400.0
"""Cost of an overlap: when changes are compared, and as slack in a program."""
_FIRST_TRUST_RAD, _LEAST_TRUST_RAD, _MOST_TRUST_RAD = 0.12, 0.01, 0.3
"""First, least and largest trust region of a change."""
_S_PER_RAD = 1 / 3
"""Trust region of times, relative to that of joints."""
_WIDER, _NARROWER = 1.5, 0.4
"""Factors on the trust region after a success, and after a failure."""
_HEEDED = 2
"""How many programs include what earlier ones touched, before the trust region shrinks."""
_STRAIGHT_RAD = 1e-6
_STEP = 1e-5
"""Step of finite differences."""
_MOST_PROVEN = 12
"""How many schedules are tried to be proven."""
_TIGHTNESSES, _MORE_MARGIN, _MORE_CHANGES = 3, 0.15, 4
"""How often an unproven result is improved again; with how much more margin each time, and how many changes."""
_WATCHED_FOR = 4
"""Changes after which the near pairs are determined again."""
_SHARE_OF_T = 0.1
"""Largest change of the duration in one program."""
_LEAST_GAIN_S = 5e-4
"""A change that gains less is not taken."""
_ROUNDING = 1e-12


@dataclass(frozen=True, slots=True)
class _Look:
    """A schedule with its samples, near pairs and spill angles."""

    x: Floats
    goal: Floats
    q: Floats
    near: Near
    spills_deg: Floats | None
    overlap_m: float

    @property
    def worth_s(self) -> float:
        return float(self.x[-1]) + _S_PER_M * self.overlap_m


class Descent:
    """Improves schedules from one start. `pose` is what the goal may move along; None if it is one configuration."""

    def __init__(
        self,
        prover: Prover,
        limits: RateLimits,
        start: Floats,
        spill_limit_deg: float | None = None,
        pose: ApexPose | None = None,
    ) -> None:
        self._prover, self._limits, self._start, self._pose = prover, limits, start, pose
        self._limit_deg, self._spill_deg = spill_limit_deg, spill_limit_deg
        self._n, self._windows_rad = len(start), prover.mount.limits_rad
        self._margin_m = prover.space.scene.margin_m
        self._clearances = Clearances(prover.space.scene)
        self._straight, self._watched = np.zeros(self._n, dtype=bool), list[list[int]]()

    def quicker(
        self,
        schedule: Schedules,
        than: JointTrajectory | None,
        least_s: float,
        changes: int,
        ends: Callable[[JointTrajectory | None], bool],
    ) -> JointTrajectory | None:
        """Something quicker than `than`, from a schedule, or `than` itself; within so many changes, or until `ends`."""
        x, goal = self._begun(schedule)
        for tightness in range(_TIGHTNESSES):
            self._margin_m = (_MARGIN + tightness * _MORE_MARGIN) * self._prover.space.scene.margin_m
            self._spill_deg = None if self._limit_deg is None else self._limit_deg - (1 + tightness) * _SPILL_DEG
            reached = self._reached(x, goal, least_s, changes, lambda: ends(than))
            if (motion := self._proven(reached, than)) is not None:
                return motion
            # A nearly free result is improved again with a little more margin.
            last = reached[-1]
            if ends(than) or last.overlap_m > _OVERLAP_M or (than is not None and last.x[-1] >= than.duration_s):
                break
            x, goal, changes = last.x, last.goal, _MORE_CHANGES
        return than

    def _reached(self, x: Floats, goal: Floats, least_s: float, changes: int, ends: Callable[[], bool]) -> list[_Look]:
        """A sequence of ever better schedules."""
        reached, trust_rad = [self._looked(x, goal, True)], _FIRST_TRUST_RAD
        for k in range(changes):
            best = reached[-1]
            is_quick = best.x[-1] <= least_s and best.overlap_m <= 0.0
            if trust_rad < _LEAST_TRUST_RAD or is_quick or ends():
                break
            found, trust_rad = self._changed(best, trust_rad, least_s, k % _WATCHED_FOR == 0, ends)
            if found is None:
                break
            reached.append(found)
            trust_rad = min(_WIDER * trust_rad, _MOST_TRUST_RAD)
        return reached

    def _proven(self, reached: list[_Look], than: JointTrajectory | None) -> JointTrajectory | None:
        """The quickest that can be proven and is quicker than `than`."""
        limit_s = np.inf if than is None else than.duration_s
        tried = [one for one in reached if one.overlap_m < _OVERLAP_M and one.x[-1] < limit_s]
        for one in sorted(tried, key=lambda one: float(one.x[-1]))[:_MOST_PROVEN]:
            times_s, steps = self._steps(one.x[None], one.goal[None])
            course = of_jerk_steps(self._start, times_s[0], steps[0], float(one.x[-1]))
            motion = self._prover.proven(course, limit_s)
            if motion is not None:
                return motion
        return None

    # What a schedule is here ------------------------------------------------------------------------

    def _begun(self, schedule: Schedules) -> tuple[Floats, Floats]:
        """x and the goal of a schedule; joints without time for their turning points go straight."""
        goal, turns, total_s = schedule.goals[0], schedule.turns[0].copy(), float(schedule.durations_s[0])
        late = self._needed_s(turns, goal) > total_s
        turns[late] = goal[late]
        self._straight = np.abs(turns - goal) < _STRAIGHT_RAD
        spare_s = np.maximum(total_s - self._needed_s(turns, goal), 0.0)
        return self._fitted(np.concatenate([turns, *(spare_s * schedule.shares[0, :, :4].T), [total_s]]), goal), goal

    def _needed_s(self, turns: Floats, goals: Floats) -> Floats:
        """The least time that each joint's legs take, (..., n)."""
        firsts, first_steps, first_s = legs(turns - self._start, self._limits)
        seconds, second_steps, second_s = legs(goals - turns, self._limits)
        needed_s: Floats = first_s + second_s - merged_ramps_s(firsts, first_steps, seconds, second_steps)
        return needed_s

    def _fitted(self, x: Floats, goal: Floats) -> Floats:
        """x made feasible: within the windows, without negative rests, and as long as the slowest joint needs."""
        n, fitted = self._n, x.copy()
        fitted[:n] = np.where(self._straight, goal, np.clip(x[:n], *self._windows_rad))
        fitted[n:-1] = np.maximum(x[n:-1], 0.0)
        fitted[-1] = max(x[-1], float((x[-1] - self._left_s(fitted[None], goal[None])).max()) + _ROUNDING)
        return fitted

    def _left_s(self, x: Floats, goals: Floats) -> Floats:
        """How long each joint of schedules (m, 5 n + 1) waits at the end: (m, n)."""
        rests_s = x[:, self._n : -1].reshape(len(x), 4, self._n).sum(axis=1)
        left_s: Floats = x[:, -1:] - self._needed_s(self._turns(x, goals), goals) - rests_s
        return left_s

    def _turns(self, x: Floats, goals: Floats) -> Floats:
        return np.where(self._straight, goals, x[:, : self._n])

    def _steps(self, x: Floats, goals: Floats) -> tuple[Floats, Floats]:
        """Times and jerk steps of schedules (m, 5 n + 1) with goals (m, n): (m, n, 16) each."""
        turns, rests_s = self._turns(x, goals), x[:, self._n : -1].reshape(len(x), 4, self._n).transpose(0, 2, 1)
        first, second = legs(turns - self._start, self._limits), legs(goals - turns, self._limits)
        return one_after_another(first, second, merged_ramps_s(*first[:2], *second[:2]), rests_s)

    def _courses(self, x: Floats, goals: Floats) -> tuple[Floats, Floats | None]:
        """Positions of schedules at the samples (m, samples, n), and their spill angles there (m, samples)."""
        times_s, steps = self._steps(x, goals)
        since = np.maximum((x[:, -1:] * _SAMPLES)[:, :, None, None] - times_s[:, None], 0.0)
        states = [np.einsum("nmjk,njk->nmj", since**power, steps) for power in (3, 2, 1)]
        q = self._start + states[0] / 6
        if self._spill_deg is None:
            return q, None
        flat = [one.reshape(-1, self._n) for one in (q, states[1] / 2, states[2])]
        angles_deg = spill_angles_deg(*apex_motion(flat[0], flat[1], flat[2], self._prover.mount))
        return q, angles_deg.reshape(q.shape[:2])

    def _looked(self, x: Floats, goal: Floats, is_anew: bool = False) -> _Look:
        q, spills_deg = self._courses(x[None], goal[None])
        if is_anew:
            self._watched = self._clearances.watched(q[0])
        near = self._clearances.near(q[0], self._watched)
        overlap_m = self._margin_m - float(near.distances_m.min(initial=self._margin_m))
        if spills_deg is None or self._spill_deg is None:
            return _Look(x, goal, q[0], near, None, overlap_m)
        spilt_m = _M_PER_DEG * (float(spills_deg.max()) - self._spill_deg)
        return _Look(x, goal, q[0], near, spills_deg[0], max(overlap_m, spilt_m))

    # The ends of a pose -----------------------------------------------------------------------------

    def _missed(self, q: Floats) -> Floats:
        """A configuration's error from the pose: apex [m], axis, and the seam if it has one."""
        assert self._pose is not None
        reached, pose = apex(q, self._prover.mount), self._pose
        missed = [reached.position_m - pose.position_m, np.linalg.svd(pose.axis[None])[2][1:] @ reached.axis]
        if pose.seam is not None and reached.seam is not None:
            missed.append(np.atleast_1d(np.cross(pose.axis, pose.seam) @ reached.seam))
        return np.concatenate(missed)

    def _slopes(self, q: Floats) -> Floats:
        missed = self._missed(q)
        return np.stack([(self._missed(q + _STEP * one) - missed) / _STEP for one in np.eye(self._n)], axis=1)

    def _own_motion(self, goal: Floats) -> Floats:
        """The directions of self-motion, in which the arm moves while its end stays: (n, 2), or fewer."""
        if self._pose is None:
            return np.zeros((self._n, 0))
        slopes = self._slopes(goal)
        own: Floats = np.linalg.svd(slopes)[2][len(slopes) :].T
        return own

    def _at_pose(self, q: Floats) -> Floats:
        for _ in range(8):
            missed = self._missed(q)
            if np.abs(missed).max() < _ROUNDING:
                break
            q = q - np.linalg.pinv(self._slopes(q)) @ missed
        return q

    # Programs ---------------------------------------------------------------------------------------

    def _changed(
        self, best: _Look, trust_rad: float, least_s: float, is_anew: bool, ends: Callable[[], bool]
    ) -> tuple[_Look | None, float]:
        """A better schedule, or None, and the trust region in which it was found."""
        own, size = self._own_motion(best.goal), len(best.x)
        moves = np.eye(size + own.shape[1]) * _STEP
        x, goals = best.x + np.vstack([0 * moves[:1], moves])[:, :size], np.tile(best.goal, (len(moves) + 1, 1))
        goals[size + 1 :] += _STEP * own.T
        q, spills_deg = self._courses(x, goals)
        left_s = self._left_s(x, goals)
        slopes = np.moveaxis(q[1:] - q[0], 0, 2) / _STEP
        tilting = None if spills_deg is None else ((spills_deg[1:] - spills_deg[0]) / _STEP).T
        rows, limits = self._kept(best, slopes, tilting, 0.0)
        fits = [(-(left_s[1:] - left_s[0]).T / _STEP, left_s[0], 0.0)]
        for sign, window in ((1.0, self._windows_rad[1]), (-1.0, self._windows_rad[0])):
            fits.append((sign * np.hstack([np.zeros((self._n, size)), own]), sign * (window - best.goal), 0.0))
        rows += [np.column_stack([slope, np.zeros(len(slope))]) for slope, _, _ in fits]
        limits += [limit for _, limit, _ in fits]
        known = len(rows)
        while trust_rad >= _LEAST_TRUST_RAD and not ends():
            for _ in range(_HEEDED):
                change = self._solved(best, rows, limits, trust_rad, least_s, own.shape[1])
                if change is None or ends():
                    break
                goal = self._at_pose(best.goal + own @ change[size:]) if own.size else best.goal
                looked = self._looked(self._fitted(best.x + change[:size], goal), goal)
                if looked.worth_s < best.worth_s - _LEAST_GAIN_S:
                    return self._looked(looked.x, goal, True) if is_anew else looked, trust_rad
                touched = self._kept(looked, slopes, tilting, change)
                rows, limits = rows + touched[0], limits + touched[1]
            rows, limits, trust_rad = rows[:known], limits[:known], _NARROWER * trust_rad
        return None, trust_rad

    def _kept(
        self, looked: _Look, slopes: Floats, tilting: Floats | None, change: Floats | float
    ) -> tuple[list[Floats], list[Floats]]:
        """Rows and limits of a program that keep near pairs apart, and the load level, as seen after a change."""
        near = looked.near
        away = -np.einsum("kn,knx->kx", near.gradients, slopes[near.at])
        rows, limits = [away], [near.distances_m - self._margin_m]
        if tilting is not None and looked.spills_deg is not None and self._spill_deg is not None:
            rows.append(_M_PER_DEG * tilting)
            limits.append(_M_PER_DEG * (self._spill_deg - looked.spills_deg))
        # The slopes are from before the change, so the limits are shifted back by it.
        limits = [limit + row @ np.broadcast_to(change, row.shape[1]) for row, limit in zip(rows, limits, strict=True)]
        return [np.column_stack([row, -np.ones(len(row))]) for row in rows], limits

    def _solved(
        self, best: _Look, rows: list[Floats], limits: list[Floats], trust_rad: float, least_s: float, free: int
    ) -> Floats | None:
        """Solve one program: the change of x, and of the end."""
        from scipy.optimize import linprog  # takes half a second to load

        n, size, total_s = self._n, len(best.x), float(best.x[-1])
        most = np.concatenate([np.where(self._straight, 0.0, trust_rad), np.full(4 * n, _S_PER_RAD * trust_rad), [0.0]])
        low, high = -most, most.copy()
        low[:n] = np.where(self._straight, 0.0, np.maximum(low[:n], self._windows_rad[0] - best.x[:n]))
        high[:n] = np.where(self._straight, 0.0, np.minimum(high[:n], self._windows_rad[1] - best.x[:n]))
        low[n:-1] = np.maximum(low[n:-1], -best.x[n:-1])
        low[-1], high[-1] = min(max(-_SHARE_OF_T * total_s, least_s - total_s), 0.0), _SHARE_OF_T * total_s
        ends = np.full(free, trust_rad)
        costs = np.zeros(size + free + 1)
        costs[size - 1], costs[-1] = 1.0, _SLACK_S_PER_M
        bounds = np.column_stack([np.concatenate([low, -ends, [0.0]]), np.concatenate([high, ends, [np.inf]])])
        matrix, limit = np.vstack(rows), np.concatenate(limits)
        # Rows that no change within the bounds can violate are left out.
        matters = np.maximum(matrix[:, :-1] * bounds[:-1, 0], matrix[:, :-1] * bounds[:-1, 1]).sum(axis=1) > limit
        solved = linprog(costs, matrix[matters], limit[matters], bounds=bounds, method="highs-ds")
        found: Floats | None = None if solved.x is None else solved.x[:-1]
        return found
