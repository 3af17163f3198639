"""OMPL as a peer of the motion benchmark: its RRT-Connect with the range it chooses itself, simplified, by its wheel.

It gets our arm, cell and goal configurations, and asks our scene, without a margin, whether one configuration is free:
so what differs is how motions between two states are judged. At its usual resolution of 1 % of the space's extent, and
at a tenth of that. Its polylines get toppra's time law, which has no jerk limit.
"""

import time
from typing import Any

import numpy as np

from benchmarks.figures import spread
from benchmarks.motion_mplib import GOALS, Sampled
from benchmarks.motion_peers import toppra_s
from scuhand_bt.motion.kinematics import LIMITS_RAD
from scuhand_bt.motion.timelaw import rest_to_rest_s

RESOLUTIONS = (0.01, 0.001)
LEAST_M = 0.0002
"""In place of no margin, with which coal overlooks what is deep inside a thin wall."""
TIMEOUT_S = 10.0


def compare(bench: Any, tasks: list[Any], audit: Any) -> dict[str, Any]:
    """Its figures for the tasks, by resolution."""
    return {f"resolution {resolution:g}": _compared(bench, tasks, audit, resolution) for resolution in RESOLUTIONS}


def _compared(bench: Any, tasks: list[Any], audit: Any, resolution: float) -> dict[str, Any]:
    scene, plan_ms, ratios, touching = bench.planner.scene(LEAST_M), [], [], 0
    for task in tasks:
        goals = bench.free(task.goal)
        goals = goals[np.argsort(rest_to_rest_s(goals - task.start, bench.rates))][:GOALS]
        begin_s = time.thread_time()
        path = _planned(scene, task.start, goals, resolution)
        plan_ms.append(1e3 * (time.thread_time() - begin_s))
        if path is None:
            continue
        away = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(path, axis=0)).max(axis=1))])
        touching += audit.touches(Sampled(away.tolist(), path.tolist()))
        ratios.append(toppra_s(path, bench.rates) / bench.bound_s(task))
    return {
        "tasks": len(tasks),
        "failures": len(tasks) - len(ratios),
        "touching in the audit": touching,
        "plan_ms, CPU (without IK)": spread(plan_ms, "ms"),
        "duration / bound (no jerk limit)": spread(ratios, ""),
    }


def _planned(scene: Any, start: Any, goals: Any, resolution: float) -> Any:
    """A polyline (n, 7) to one of goals (m, 7); None where none is found in time."""
    from ompl import base, geometric, util

    util.setLogLevel(util.LogLevel.LOG_ERROR)
    space, bounds, joints = base.RealVectorStateSpace(len(start)), base.RealVectorBounds(len(start)), range(len(start))
    for joint in joints:
        bounds.setLow(joint, float(LIMITS_RAD[0, joint]))
        bounds.setHigh(joint, float(LIMITS_RAD[1, joint]))
    space.setBounds(bounds)

    def state(q: Any) -> Any:
        made = space.allocState()
        for joint in joints:
            made[joint] = float(q[joint])
        return made

    setup = geometric.SimpleSetup(space)
    setup.setStateValidityChecker(lambda at: not scene.hits(np.array([[at[joint] for joint in joints]]))[0])
    information = setup.getSpaceInformation()
    information.setStateValidityCheckingResolution(resolution)
    setup.setStartState(state(start))
    wanted = base.GoalStates(information)
    for goal in goals:
        wanted.addState(state(goal))
    setup.setGoal(wanted)
    setup.setPlanner(geometric.RRTConnect(information))
    setup.solve(TIMEOUT_S)
    if not setup.haveExactSolutionPath():
        return None
    setup.simplifySolution()
    return np.array([[one[joint] for joint in joints] for one in setup.getSolutionPath().getStates()])
