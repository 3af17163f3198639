"""How far the best known motions are: `python -m benchmarks.motion_optimum [--tasks N] [--json FILE]`.

Between mortar and pan, in the draught shield, a polished motion takes longer than its bound, which knows no obstacles.
Against it stand the best of ten searches of 80 rounds each, among all near goals, and local optima begun from three of
them: in each joint `STEPS` equal steps of constant jerk, and sequential linear programs over all of them, the duration
and the end, of which yaw and swivel are free. With s = t / T and the jerk as u / T^3

    minimise T      |q'(s)| <= v T,   |q''(s)| <= a T^2,   |u| <= j T^3,   d_k + grad d_k (q - q_ref) >= margin

where T^2 and T^3 stand for their tangents, below them: so what a program finds keeps all limits. What comes out is
proven free as any motion is, and counts only then; it may miss the goal by a millimetre. It is no bound from below:
there may be something quicker.
"""

import argparse
import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse
from scipy.optimize import linprog

from benchmarks.figures import spread
from benchmarks.motion import Bench, Task
from benchmarks.motion_inverse import MOUNT
from scuhand_bt.motion import transfer
from scuhand_bt.motion.clearances import Clearances
from scuhand_bt.motion.collision import Scene
from scuhand_bt.motion.joint_schedules import ScheduleSearch
from scuhand_bt.motion.kinematics import LIMITS_RAD, ApexPose, Floats, apex
from scuhand_bt.motion.proof import Prover
from scuhand_bt.motion.timelaw import RateLimits, rest_to_rest_s
from scuhand_bt.motion.trajectory import JointTrajectory

SEARCHES, ROUNDS, GOALS = 10, 80, 24
BEGUN, OTHER_RAD = 3, 0.25
"""So many local optima, from motions that differ by so much somewhere."""
STEPS, SAMPLES, PROGRAMS = 36, 72, 18
MARGIN_M = 0.0056
"""A little more than what a proof asks for at its own, closer samples."""
FIRST_TRUST_RAD, LEAST_TRUST_RAD, MOST_TRUST_RAD = 0.15, 0.002, 0.4
MISSED, OVERLAP = 1e-3, 4e-4
"""Of the end's pose [m, 1] and of the margin [m], what does not count."""


def _integrals(s: Floats, order: int) -> Floats:
    """What each of STEPS unit jerks adds to the derivative of an order at s (m,): (m, STEPS)."""
    begins = np.arange(STEPS) / STEPS
    since, after = np.maximum(s[:, None] - begins, 0.0), np.maximum(s[:, None] - begins - 1 / STEPS, 0.0)
    power = 3 - order
    return (since**power - after**power) / (6.0, 2.0, 1.0)[order]


def _missed(q: Floats, goal: ApexPose) -> Floats:
    """By what the apex [m] and the axis (two components beside the goal's) miss a goal: (5,)."""
    reached = apex(q, MOUNT)
    beside = np.linalg.svd(goal.axis[None, :])[2][1:]
    return np.concatenate([reached.position_m - goal.position_m, beside @ reached.axis])


@dataclass
class Local:
    """A local optimum's search from one motion."""

    scene: Scene
    rates: RateLimits
    goal: ApexPose
    start: Floats

    def __post_init__(self) -> None:
        joints = sparse.eye(len(self.start))
        knots, samples = (np.arange(STEPS) + 1) / STEPS, (np.arange(SAMPLES) + 1) / SAMPLES
        self._at = sparse.kron(sparse.csr_matrix(_integrals(samples, 0)), joints, format="csr")
        self._speeds = sparse.kron(sparse.csr_matrix(_integrals(knots, 1)), joints, format="csr")
        self._accelerations = sparse.kron(sparse.csr_matrix(_integrals(knots, 2)), joints, format="csr")
        self._samples, self._clearances = samples, Clearances(self.scene)

    def quicker(self, motion: JointTrajectory) -> JointTrajectory | None:
        """The last motion that keeps everything; None if none does."""
        course, duration_s = motion.at(self._samples * motion.duration_s), motion.duration_s
        near, merit, trust_rad, best = self._near(course), np.inf, FIRST_TRUST_RAD, None
        for _ in range(PROGRAMS):
            solved = self._solved(course, duration_s, near, trust_rad)
            if solved is None:
                trust_rad /= 2
                continue
            there = (self._at @ solved[:-2]).reshape(course.shape) + self.start
            near_there = self._near(there)
            overlap_m = max((MARGIN_M - distance_m for _, distance_m, _ in near_there), default=0.0)
            missed = float(np.abs(_missed(there[-1], self.goal)).max())
            worth = float(solved[-2]) + 20 * (max(overlap_m, 0.0) + missed)
            if worth < merit:
                course, duration_s, near, merit = there, float(solved[-2]), near_there, worth
                trust_rad = min(1.3 * trust_rad, MOST_TRUST_RAD)
                if overlap_m < OVERLAP and missed < MISSED:
                    best = self._motion(solved[:-2], duration_s)
            elif (trust_rad := trust_rad / 2) < LEAST_TRUST_RAD:
                break
        return best if best is not None and self.scene.proves(best) else None

    def _near(self, course: Floats) -> list[tuple[int, float, Floats]]:
        near = self._clearances.near(course, self._clearances.watched(course))
        return list(zip(near.at.tolist(), near.distances_m.tolist(), near.gradients, strict=True))

    def _solved(
        self, course: Floats, duration_s: float, near: list[tuple[int, float, Floats]], trust_rad: float
    ) -> Floats | None:
        """Jerks (STEPS * 7), duration and what the margins lack, of one program."""
        rows, limits = list[Any](), list[Floats]()
        jerks = self._at.shape[1]

        def keep(matrix: Any, per_s: Floats, per_slack: Floats, limit: Floats) -> None:
            rows.append(sparse.hstack([matrix, sparse.csr_matrix(np.column_stack([per_s, per_slack]))]))
            limits.append(limit)

        reference = (course - self.start).ravel()
        windows = [np.tile(one - self.start, SAMPLES) for one in LIMITS_RAD]
        inside = {
            1: np.minimum(reference + trust_rad, windows[1]),
            -1: -np.maximum(reference - trust_rad, windows[0]),
        }
        for sign in (1, -1):
            v, a, j = (np.tile(one, STEPS) for one in (self.rates.speed, self.rates.acceleration, self.rates.jerk))
            keep(sign * self._speeds, -v, 0 * v, 0 * v)
            keep(sign * self._accelerations, -2 * duration_s * a, 0 * a, -(duration_s**2) * a)
            keep(sign * sparse.eye(jerks), -3 * duration_s**2 * j, 0 * j, -2 * duration_s**3 * j)
            keep(sign * self._at, 0 * reference, 0 * reference, inside[sign])
        if near:
            slopes = sparse.lil_matrix((len(near), reference.size))
            for row, (k, _, gradient) in enumerate(near):
                slopes[row, 7 * k : 7 * k + 7] = -gradient
            lacking = [d - MARGIN_M - gradient @ (course[k] - self.start) for k, d, gradient in near]
            keep(slopes.tocsr() @ self._at, np.zeros(len(near)), -np.ones(len(near)), np.array(lacking))
        missed = _missed(course[-1], self.goal)
        turned = [(_missed(course[-1] + 1e-6 * one, self.goal) - missed) / 1e-6 for one in np.eye(7)]
        jacobian = np.stack(turned, axis=1)
        ends = sparse.vstack([self._speeds[-7:], self._accelerations[-7:], sparse.csr_matrix(jacobian) @ self._at[-7:]])
        at_end = np.concatenate([np.zeros(14), jacobian @ (course[-1] - self.start) - missed])
        solved = linprog(
            np.concatenate([np.zeros(jerks), [1.0, 200.0]]),
            sparse.vstack(rows, format="csc"),
            np.concatenate(limits),
            sparse.hstack([ends, sparse.csr_matrix((len(at_end), 2))], format="csc"),
            at_end,
            [(None, None)] * jerks + [(0.75 * duration_s, 1.3 * duration_s), (0, None)],
            method="highs",
        )
        return solved.x

    def _motion(self, jerks: Floats, duration_s: float) -> JointTrajectory:
        """The cubics of the steps, as slow as their speeds between the knots ask for."""
        knots = np.arange(STEPS) / STEPS
        u = jerks.reshape(STEPS, 7)
        c0, c1, c2 = (_integrals(knots, order) @ u / duration_s**order for order in range(3))
        cubics = np.stack([c0 + self.start, c1, c2 / 2, u / duration_s**3 / 6])
        motion = JointTrajectory(np.append(knots, 1.0) * duration_s, cubics)
        return motion.stretched(max(1.0, self.rates.stretch_for(motion)))


def _searched(bench: Bench, task: Task) -> list[JointTrajectory]:
    """What SEARCHES find, the quickest first."""
    free = bench.free(task.goal)
    bounds_s = rest_to_rest_s(free - task.start, bench.rates)
    order = np.argsort(bounds_s)[:GOALS]
    asked = transfer.Task(task.start, transfer.Goals(free, free[:0]), bench.scene, bench.rates, MOUNT)
    prover = Prover(asked.spaces()[0], bench.rates, MOUNT, None)
    found = []
    for seed in range(SEARCHES):
        search = ScheduleSearch(prover, bench.rates, task.start, free[order], bounds_s[order])
        rng = np.random.default_rng(seed)
        found.append(search.quickest(None, rng, ROUNDS, (0.0, 0.0), ROUNDS, lambda _: False))
    return sorted((one for one in found if one is not None), key=lambda one: one.duration_s)


def _differing(motions: list[JointTrajectory]) -> list[JointTrajectory]:
    shares, chosen = np.linspace(0, 1, 9), list[JointTrajectory]()
    for one in motions:
        q = one.at(shares * one.duration_s)
        if all(np.abs(q - other.at(shares * other.duration_s)).max() > OTHER_RAD for other in chosen):
            chosen.append(one)
    return chosen[:BEGUN]


def measure(count: int) -> dict[str, Any]:
    """Durations over the bound."""
    bench = Bench()
    tasks = [task for task in bench.tasks(3 * count) if task.kind == "mortar and pan"]
    ratios: dict[str, list[float]] = {"polished": [], "ten searches": [], "local optima": []}
    cpu_s: dict[str, list[float]] = {name: [] for name in ratios}
    for task in tasks:
        times_s = [time.thread_time()]
        polished = bench.planner.move(task.start, task.goal, effort=transfer.POLISHED)
        times_s.append(time.thread_time())
        known = sorted([polished, *_searched(bench, task)], key=lambda one: one.duration_s)
        times_s.append(time.thread_time())
        local = Local(bench.scene, bench.rates, task.goal, task.start)
        optima = [one for one in map(local.quicker, _differing(known)) if one is not None]
        times_s.append(time.thread_time())
        bests_s = polished.duration_s, known[0].duration_s, min(one.duration_s for one in [known[0], *optima])
        bound_s = bench.bound_s(task)
        for name, best_s, took_s in zip(ratios, bests_s, np.diff(times_s), strict=True):
            ratios[name].append(best_s / bound_s)
            cpu_s[name].append(float(took_s))
        print({name: round(some[-1], 2) for name, some in ratios.items()}, flush=True)
    return {
        "tasks": len(tasks),
        **{f"duration / bound, {name}": spread(some, "") for name, some in ratios.items()},
        **{f"CPU, {name}": spread(some, "s") for name, some in cpu_s.items()},
    }


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.motion_optimum", description=__doc__)
    parser.add_argument("--tasks", type=int, default=10)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    figures = measure(given.tasks)
    for key, value in figures.items():
        print(f"{key:34} {value}")
    if given.json:
        given.json.write_text(json.dumps({"arguments": vars(given) | {"json": None}, **figures}, indent=1) + "\n")


if __name__ == "__main__":
    main()
