"""The arm's motion, measured: `python -m benchmarks.motion [--json FILE] [--peers] [--mplib DIR] [--scoops N]`.

Tasks are seeded, a third each: mortar to pan and back; between random level poses; from any free
configuration to inside the shield. Each plan is checked by an *audit of its own*: plain Pinocchio (no
pool, no broad phase, no margin; contacts enabled, without which coal misses penetrations), at instants
between which no point of any shape's hull moves more than 1 mm. Durations are compared with L, the
jerk-limited optimum to the best free goal with nothing in the way, and for plans that are not direct with
toppra's time law (which has no jerk limit) on the free polyline that RRT-Connect and shortcuts find for
the same task, where toppra is installed. Planning is timed on the wall and in CPU time. Other work on
the machine lengthens both; how much is seen from a fixed piece of work, done before every task: CPU time
over that slowdown is what quiet cores would take.
"""

import argparse
import itertools
import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from benchmarks import motion_memory, motion_mplib, motion_ompl, motion_peers
from benchmarks.figures import spread
from benchmarks.motion_inverse import MOUNT, SEED, inverse_kinematics
from scuhand_bt.failures import SkillFailed
from scuhand_bt.lab import load_lab, starter_lab
from scuhand_bt.motion import MotionPlanner, rrt_connect, spill_limit_deg, transfer
from scuhand_bt.motion.coordinates import JointCoordinates
from scuhand_bt.motion.free_space import Space
from scuhand_bt.motion.inverse import solutions, unreachable_reason
from scuhand_bt.motion.kinematics import LIMITS_RAD, ApexPose, Floats, apex
from scuhand_bt.motion.places import RELAXED_RAD, reaching_out
from scuhand_bt.motion.spill import apex_motion, spill_angles_deg
from scuhand_bt.motion.timelaw import RateLimits, rest_to_rest_s
from scuhand_bt.motion.trajectory import JointTrajectory

GENTLE_DEG = 10.0
AUDIT_M = 0.001
PEER_TASKS = 150


@dataclass
class Task:
    """One transfer: a start configuration and a goal pose."""

    kind: str
    start: Floats
    goal: ApexPose


@dataclass
class Outcome:
    """What came of a task at one effort."""

    task: Task
    plan_s: float
    cpu_s: float
    motion: JointTrajectory | None
    bound_s: float
    slowdown: float


class Bench:
    """The starter lab's cell, and tasks in it."""

    def __init__(self) -> None:
        lab = load_lab(starter_lab())
        mortar = lab.library.mortars["agate_mortar"]
        mortars = {"mortar_bay": mortar, "mortar_bay_2": mortar}
        self.planner = MotionPlanner(lab.urdf, lab.cell, mortars)
        self.planner.set_geometry(container=lab.library.containers["alumina_crucible"])
        self.cell = lab.cell
        self.scene = self.planner.scene()
        self.rates = self.planner.rates
        some = np.random.default_rng(SEED).uniform(LIMITS_RAD[0], LIMITS_RAD[1], (40, 7))
        self._work = some
        self._fastest_s = min(self._worked_s() for _ in range(300))

    def _worked_s(self) -> float:
        """CPU time of a fixed piece of work of the planner's kind: collision checks and small arrays."""
        begin_s, q = time.process_time(), self._work
        self.scene.hits(q)
        for _ in range(30):
            q = np.where(q > 0, q * 0.99, q + 0.01)
        return time.process_time() - begin_s

    def slowdown(self) -> float:
        """How many times slower than at its fastest this machine works now."""
        self._fastest_s = min(self._fastest_s, worked_s := self._worked_s())
        return worked_s / self._fastest_s

    def over(self, station: str, height_mm: float, rng: np.random.Generator | None = None) -> ApexPose:
        x, y, z = self.cell.stations[station].position_mm
        dx, dy = (0.0, 0.0) if rng is None else rng.uniform(-8, 8, 2)
        return ApexPose(np.array([x + dx, y + dy, z + height_mm]) / 1e3)

    def free(self, pose: ApexPose) -> Floats:
        q = solutions(pose, MOUNT)
        return q[~self.scene.hits(q)] if len(q) else q

    def tasks(self, count: int) -> list[Task]:
        rng = np.random.default_rng(SEED)
        tasks: list[Task] = []
        while len(tasks) < count:
            kind = ("mortar and pan", "random pair", "anywhere to pan")[len(tasks) % 3]
            mortar = self.over(str(rng.choice(["mortar_bay", "mortar_bay_2"])), rng.uniform(70, 120), rng)
            pan = self.over("balance", rng.uniform(75, 100), rng)
            if kind == "mortar and pan":
                first, second = (mortar, pan) if rng.uniform() < 0.5 else (pan, mortar)
            elif kind == "random pair":
                first, second = (ApexPose(rng.uniform([0.15, -0.28, 0.03], [0.42, 0.28, 0.2])) for _ in range(2))
            else:
                first, second = mortar, pan
            starts, goals = self.free(first), self.free(second)
            if kind == "anywhere to pan":
                starts = rng.uniform(LIMITS_RAD[0], LIMITS_RAD[1], (20, 7))
                starts = starts[~self.scene.hits(starts)]
            if len(starts) and len(goals):
                tasks.append(Task(kind, starts[rng.integers(len(starts))], second))
        return tasks

    def carries(self, count: int) -> list[Task]:
        """Loaded moves from a mortar to the pan and back, from the posture the arm takes there."""
        rng = np.random.default_rng(SEED + 1)
        tasks = []
        for k in range(count):
            mortar = self.over(str(rng.choice(["mortar_bay", "mortar_bay_2"])), rng.uniform(75, 110), rng)
            pan = self.over("balance", rng.uniform(78, 95), rng)
            first, second = (mortar, pan) if k % 2 else (pan, mortar)
            starts = self.free(reaching_out(first, MOUNT))
            relaxed = np.array([np.arctan2(first.position_m[1], first.position_m[0]), *RELAXED_RAD[1:]])
            tasks.append(Task("carry", starts[np.argmin(np.linalg.norm(starts - relaxed, axis=1))], second))
        return tasks

    def run(self, task: Task, effort: transfer.Effort) -> Outcome:
        """One task from pose to proven motion, timed: IK, ranking, path, time law, certificate; planned once only."""
        slowdown = self.slowdown()
        begin_s, begin_cpu_s = time.perf_counter(), time.process_time()
        try:
            motion = self.planner.move(task.start, task.goal, effort=effort)
        except SkillFailed:
            motion = None
        plan_s, cpu_s = time.perf_counter() - begin_s, time.process_time() - begin_cpu_s
        return Outcome(task, plan_s, cpu_s, motion, self.bound_s(task), (slowdown + self.slowdown()) / 2)

    def bound_s(self, task: Task) -> float:
        """The jerk-limited optimum to the best of the goal's free configurations, with nothing in the way."""
        return float(rest_to_rest_s(self.free(task.goal) - task.start, self.rates).min())

    def polyline(self, outcome: Outcome) -> Floats | None:
        """What a usual planner finds for the task: RRT-Connect to the same goal and others, then shortcuts."""
        task, rng = outcome.task, np.random.default_rng([SEED, 1])
        space = Space(JointCoordinates(self.rates, MOUNT.limits_rad), self.scene, MOUNT)
        goals = self.free(task.goal)
        goals[:, 6] = task.start[6]
        goals = goals[np.argsort(rest_to_rest_s(goals - task.start, self.rates))][:32]
        path = rrt_connect.connect(space, task.start, goals, rng, 4000)
        return None if path is None else rrt_connect.shortened(space, path, rng, 60)


class Audit:
    """An exact check of whole motions that shares no code with the planner's own proof."""

    def __init__(self, bench: Bench) -> None:
        scene = bench.scene
        self.model, self.shapes = scene.model, scene.shapes
        self.data, self.shape_data = self.model.createData(), pin.GeometryData(self.shapes)
        for request in self.shape_data.collisionRequests:
            request.enable_contact = True
            request.security_margin = 0.0
        self.hulls = [_box_corners(thing) for thing in self.shapes.geometryObjects if thing.parentJoint > 0]
        self.joints = [thing.parentJoint for thing in self.shapes.geometryObjects if thing.parentJoint > 0]

    def touches(self, motion: JointTrajectory) -> bool:
        count = max(64, int(motion.duration_s / 0.002))
        times_s = np.linspace(0.0, motion.duration_s, count)
        previous = self._points(motion.sample(0.0))
        if self._hit(motion.sample(0.0)):
            return True
        for begin_s, end_s in itertools.pairwise(times_s):
            points = self._points(motion.sample(end_s))
            moved_m = float(np.linalg.norm(points - previous, axis=1).max())
            for time_s in np.linspace(begin_s, end_s, int(moved_m / AUDIT_M) + 2)[1:]:
                if self._hit(motion.sample(time_s)):
                    return True
            previous = points
        return False

    def _points(self, q: Floats) -> Floats:
        pin.forwardKinematics(self.model, self.data, q)
        return np.vstack(
            [
                corners @ self.data.oMi[joint].rotation.T + self.data.oMi[joint].translation
                for joint, corners in zip(self.joints, self.hulls, strict=True)
            ]
        )

    def _hit(self, q: Floats) -> bool:
        return bool(pin.computeCollisions(self.model, self.data, self.shapes, self.shape_data, q, True))


def _box_corners(thing: pin.GeometryObject) -> Floats:
    shape = thing.geometry
    shape.computeLocalAABB()
    box = shape.aabb_local
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    local = box.min_ + corners * (box.max_ - box.min_)
    placed: Floats = local @ thing.placement.rotation.T + thing.placement.translation
    return placed


def excess(motion: JointTrajectory, rates: RateLimits) -> float:
    """By how much the worst sample of a motion is beyond a limit, as a share of it; negative inside."""
    times_s = np.linspace(0.0, motion.duration_s, 2000)
    worst = -np.inf
    for k, limit in ((1, rates.speed), (2, rates.acceleration), (3, rates.jerk)):
        worst = max(worst, float((np.abs(motion.at(times_s, k)) / limit).max() - 1))
    q = motion.at(times_s)
    return max(worst, float((LIMITS_RAD[0] - q).max()), float((q - LIMITS_RAD[1]).max()))


def is_direct(motion: JointTrajectory) -> bool:
    """Whether a motion runs along a straight line of the joints."""
    shares = np.linspace(0.0, 1.0, 50)
    q = motion.at(shares * motion.duration_s) - motion.start
    distances = motion.end - motion.start
    along = q @ distances / (distances @ distances)
    return bool(np.abs(q - along[:, None] * distances).max() < 1e-9)


def transfers(bench: Bench, tasks: list[Task], effort: transfer.Effort, audit: Audit, peers: bool) -> dict[str, Any]:
    """Every figure of the transfers at one effort."""
    outcomes = [bench.run(task, effort) for task in tasks]
    solved = [(o, o.motion) for o in outcomes if o.motion is not None]
    direct = [motion for _, motion in solved if is_direct(motion)]
    others = [(o, motion) for o, motion in solved if not is_direct(motion)]
    ends = [apex(motion.end, MOUNT).position_m - o.task.goal.position_m for o, motion in solved]
    ratios = []
    if peers:
        lines = [(motion, bench.polyline(o)) for o, motion in others]
        ratios = [
            motion.duration_s / motion_peers.toppra_s(path, bench.rates) for motion, path in lines if path is not None
        ]
    optima_s = [float(rest_to_rest_s(motion.end - motion.start, bench.rates)) for motion in direct]
    slowdown = float(np.mean([o.slowdown for o in outcomes]))
    quiet_ms = [o.cpu_s * 1e3 / slowdown for o in outcomes]
    result = {
        "tasks": len(tasks),
        "failures": len(tasks) - len(solved),
        "touching in the audit": sum(audit.touches(motion) for _, motion in solved),
        "plan_ms, wall": spread([o.plan_s * 1e3 for o in outcomes], "ms"),
        "plan_ms, CPU": spread([o.cpu_s * 1e3 for o in outcomes], "ms"),
        "slowdown": spread([o.slowdown for o in outcomes], ""),
        "plan_ms, CPU of quiet cores": spread(quiet_ms, "ms"),
        "direct": len(direct),
        "direct / optimum": spread([m.duration_s / s for m, s in zip(direct, optima_s, strict=True)], ""),
        "duration / bound": spread([motion.duration_s / o.bound_s for o, motion in solved], ""),
        "others / toppra": spread(ratios, ""),
        "beyond limits": max(excess(motion, bench.rates) for _, motion in solved),
        "apex error_m": float(np.abs(ends).max()),
    }
    for kind in dict.fromkeys(task.kind for task in tasks):
        result[f"CPU_ms, {kind}"] = spread([o.cpu_s * 1e3 for o in outcomes if o.task.kind == kind], "ms")
    return result


def carrying(bench: Bench, tasks: list[Task], limit_deg: float, effort: transfer.Effort) -> dict[str, Any]:
    """Loaded moves between mortar and pan against the same tasks with an empty cone."""
    ratios, plan_ms, worst_deg, failures = [], [], 0.0, 0
    slowdowns = []
    for task in tasks:
        slowdowns.append(bench.slowdown())
        begin_s = time.process_time()
        try:
            motion = bench.planner.move(task.start, task.goal, spill_limit_deg=limit_deg, effort=effort)
        except SkillFailed:
            failures += 1
            continue
        finally:
            plan_ms.append((time.process_time() - begin_s) * 1e3)
        ratios.append(motion.duration_s / bench.planner.move(task.start, task.goal, effort=effort).duration_s)
        times_s = np.linspace(0.0, motion.duration_s, int(motion.duration_s / 0.001))
        angles = spill_angles_deg(*apex_motion(motion.at(times_s), motion.at(times_s, 1), motion.at(times_s, 2), MOUNT))
        worst_deg = max(worst_deg, float(angles.max()))
    return {
        "limit_deg": round(limit_deg, 2),
        "tasks": len(tasks),
        "failures": failures,
        "duration / empty": spread(ratios, ""),
        "plan_ms, CPU": spread(plan_ms, "ms"),
        "slowdown": spread(slowdowns, ""),
        "worst spill_deg": worst_deg,
    }


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.motion", description=__doc__)
    parser.add_argument("--tasks", type=int, default=1000)
    parser.add_argument("--polished", type=int, default=300, help="of the tasks, how many are polished too")
    parser.add_argument("--carrying", type=int, default=40, help="loaded moves per limit")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--mplib", type=Path, help="compare with mplib, in this environment; made if there is none")
    parser.add_argument(
        "--peers", action="store_true", help="compare with pink, toppra and OMPL, which must be installed"
    )
    parser.add_argument("--scoops", type=int, help="nothing but the memory that so many scoops take")
    given = parser.parse_args()
    if given.scoops:
        show("memory", motion_memory.scoops(given.scoops))
        return
    bench = Bench()
    audit = Audit(bench)
    tasks = bench.tasks(given.tasks)
    moves = bench.carries(given.carrying)
    own_deg = spill_limit_deg(64.16, 45.0, 5000 / 1.5, 25.0, 18.0)
    results: dict[str, Any] = {"inverse kinematics": inverse_kinematics()}
    show("inverse kinematics", results["inverse kinematics"])
    for name, effort, some in (
        ("live", transfer.LIVE, tasks),
        ("polished", transfer.POLISHED, tasks[: given.polished]),
    ):
        if not some:
            continue
        bench = Bench()  # what another effort has planned would be kept
        bench.run(moves[0], effort)  # libraries and scenes warm up
        results[f"transfers, {name}"] = transfers(bench, some, effort, audit, given.peers)
        show(f"transfers, {name}", results[f"transfers, {name}"])
        for load, limit_deg in (("5 g of glass beads", own_deg), ("gentle", GENTLE_DEG)):
            title = f"carrying {load}, {name}"
            results[title] = carrying(Bench(), moves, limit_deg, effort)
            show(title, results[title])
    if given.peers:
        rng = np.random.default_rng(SEED)
        poses = [ApexPose(rng.uniform([0.15, -0.28, 0.03], [0.42, 0.28, 0.35])) for _ in range(400)]
        poses = [pose for pose in poses if unreachable_reason(pose, MOUNT) is None]
        results["peers"] = motion_peers.pink_ik(bench.planner.urdf, poses, MOUNT)
        show("peers", results["peers"])
        results["peer OMPL"] = motion_ompl.compare(bench, tasks[:PEER_TASKS], audit)
        show("peer OMPL", results["peer OMPL"])
    if given.mplib:
        results["peer mplib"] = motion_mplib.compare(bench, tasks[:PEER_TASKS], audit, given.mplib)
        show("peer mplib", results["peer mplib"])
    if given.json:
        given.json.write_text(json.dumps(results, indent=2) + "\n")


GOALS = {
    "failures": "0",
    "touching in the audit": "0",
    "plan_ms, wall": "live 3 / 50 / 75, polished p95 400",
    "plan_ms, CPU of quiet cores": "live 3 / 50 / 75, polished p95 400",
    "direct / optimum": "1.001",
    "duration / bound": "live 1.30, polished 1.17",
    "others / toppra": "live 1.07, polished 0.86",
    "beyond limits": "1e-6",
    "duration / empty": "own limit 1.35, gentle 2.4",
    "missed": "0",
    "wrongly none": "0",
    "ik_ms, CPU": "median 0.3",
    "none_ms, CPU": "1",
}
"""The goals, printed beside what was measured."""


def show(title: str, figures: dict[str, Any]) -> None:
    print(f"\n{title}", flush=True)
    for name, value in figures.items():
        print(f"  {name:36} {value}" + (f"   (goal: {GOALS[name]})" if name in GOALS else ""), flush=True)


if __name__ == "__main__":
    main()
