"""Cells that nobody drew: `python -m benchmarks.motion_layouts [--layouts N] [--first SEED] [--tasks N] [--arm xarm7]
[--meshes] [--live] [--json FILE]`.

Each seed is a bench (`harness/motion_layouts.py`). In each the arm goes between its places and to poses near them,
empty and with loads that may lean by 10, 15, 20 and 31.8 degrees, every load over the same ways. Each motion is judged
by `harness/motion_audit.py`, which shares nothing with the planner. A load that may lean more should never be slower:
how often it is, and by how much, is told as `not monotone`.

Planning is timed as the CPU time of its thread, `live` ways and those between places apart: a run plans the latter
before it begins, and polishes an empty cone's. Loads are planned by a planner that has planned nothing before: the
first on a way pays for all that it is measured by. Other work on the machine lengthens CPU times, too: by how much is
seen from a fixed piece of work before every task (`slowdown`, over its fastest), and told besides.

`--live` measures nothing but that, of ways that a run plans as it goes: by counts alone, and with the patience that a
run has, here of CPU time, so that other work does not cut it short.
"""

import argparse
import itertools
import json
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.figures import spread
from benchmarks.motion import Bench as StarterBench
from harness.example_labs import example_lab
from harness.motion_audit import Audit
from harness.motion_layouts import CONTAINER, LIMITS_DEG, STARTER, Bench, Layout, carries, layouts, tasks
from scuhand_bt.failures import SkillFailed
from scuhand_bt.motion import MotionPlanner, patience
from scuhand_bt.motion.timelaw import rest_to_rest_s

WIDER = {"xarm7": 1.4}
"""Times as far as from the CRANE-X7 everything stands from the arms of examples/."""
SLOWER = 1.01
"""A motion is not monotone where it takes more than this over one with a stricter limit."""


class Measured:
    """What came of all layouts."""

    def __init__(self) -> None:
        self._machine = StarterBench()
        self.counts: Counter[str] = Counter()
        self.plan_ms: dict[str, list[float]] = {}
        self.slowdowns: list[float] = []
        self.durations_s: dict[str, list[float]] = {}
        self.ratios: list[float] = []
        self.clearances_mm: list[float] = []
        self.slower: list[float] = []
        self.failures: list[str] = []
        self.not_monotone: list[str] = []

    def moved(
        self, layout: Layout, planner: MotionPlanner, audit: Audit, task: tuple[Any, ...], limit_deg: float | None
    ) -> float | None:
        """Plan one task and judge it: its duration [s], None if there is none."""
        first, second, near = task
        start = planner.standing_at(first)
        kind = "empty" if limit_deg is None else f"{limit_deg:g} deg"
        timed = f"{kind}, {'between places' if near is None else 'live'}"
        self.counts[f"tasks, {kind}"] += 1
        self.slowdowns.append(self._machine.slowdown())
        begin_s = time.thread_time()
        try:
            motion = planner.move(start, near or second, spill_limit_deg=limit_deg)
        except SkillFailed as failure:
            self.counts[f"failures, {kind}"] += 1
            self.failures.append(f"seed {layout.seed}, {first} to {second}, {kind}: {failure.detail}")
            return None
        finally:
            self.plan_ms.setdefault(timed, []).append(1e3 * (time.thread_time() - begin_s))
        verdict = audit.of(motion)
        self.counts["touching"] += verdict.clearance_m < 0
        self.counts["over a limit"] += verdict.over_limit > 1e-3
        self.counts["spilled"] += limit_deg is not None and verdict.spill_deg > limit_deg
        self.clearances_mm.append(1e3 * verdict.clearance_m)
        self.durations_s.setdefault(kind, []).append(motion.duration_s)
        if limit_deg is None and near is None:
            self.ratios.append(motion.duration_s / float(rest_to_rest_s(motion.end - motion.start, planner.rates)))
        return motion.duration_s

    def carried(self, layout: Layout, planner: MotionPlanner, audit: Audit, task: tuple[Any, ...]) -> None:
        """One way with every load, the loosest first: what is known for stricter limits must not be needed."""
        taken_s = [self.moved(layout, planner, audit, task, limit) for limit in reversed(LIMITS_DEG)][::-1]
        for k, loose_s in enumerate(taken_s[1:], 1):
            known = [one for one in taken_s[:k] if one is not None]
            if known:
                self.counts["pairs of limits"] += 1
                ratio = np.inf if loose_s is None else loose_s / min(known)
                self.slower.append(ratio)
                if ratio > SLOWER:
                    self.counts["not monotone"] += 1
                    way = f"seed {layout.seed}, {task[0]} to {task[1]}{'' if task[2] is None else ' or near'}"
                    self.not_monotone.append(f"{way}: {LIMITS_DEG[k]:g} deg takes {ratio:.2f} times as long")

    def figures(self) -> dict[str, Any]:
        """All of it by name."""
        found: dict[str, Any] = {
            key: self.counts[key]
            for key in sorted({*self.counts, "touching", "over a limit", "spilled", "not monotone"})
        }
        found["least clearance"] = f"{min(self.clearances_mm):.2f} mm"
        found["looser / best stricter, worst"] = round(max(self.slower, default=0.0), 3)
        slowdown = float(np.mean(self.slowdowns))
        found["slowdown"] = spread(self.slowdowns, "")
        for kind, plan_ms in sorted(self.plan_ms.items()):
            found[f"CPU, {kind}"] = spread(plan_ms, "ms")
            found[f"CPU over the slowdown, {kind}"] = spread([one / slowdown for one in plan_ms], "ms")
        for kind, durations_s in self.durations_s.items():
            found[f"duration, {kind}"] = spread(durations_s, "s")
        found["duration / bound, empty, between places"] = spread(self.ratios, "")
        found["failed"], found["slower than a stricter limit"] = self.failures, self.not_monotone
        return found


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.motion_layouts", description=__doc__)
    parser.add_argument("--layouts", type=int, default=20)
    parser.add_argument("--first", type=int, default=1, help="the first seed")
    parser.add_argument("--tasks", type=int, default=40, help="empty transfers per layout")
    parser.add_argument("--carries", type=int, default=15, help="loaded ways per layout, each at every limit")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--arm", choices=["crane_x7", *WIDER], default="crane_x7", help="whose lab, of examples/")
    parser.add_argument("--meshes", action="store_true", help="a portal stands in each besides, an STL or OBJ file")
    parser.add_argument("--live", action="store_true", help="nothing but the time that planning takes")
    given = parser.parse_args()
    with TemporaryDirectory() as folder:
        bench = STARTER
        if given.arm in WIDER:
            bench = Bench(example_lab(given.arm, Path(folder)), WIDER[given.arm])
        figures = (live if given.live else measure)(
            given, replace(bench, meshes=Path(folder)) if given.meshes else bench
        )
    for key, value in figures.items():
        print(f"{key:34} {value}")
    if given.json:
        given.json.write_text(json.dumps({"arguments": vars(given) | {"json": None}, **figures}, indent=1) + "\n")


def live(given: argparse.Namespace, bench: Bench) -> dict[str, Any]:
    """How long ways take to plan that are not between two places, and how long they are then."""
    machine, found = StarterBench(), dict[str, Any]()
    patience.now_s = time.thread_time
    drawn = list(layouts(given.layouts, given.first, bench))
    for patience_s, limit_deg in itertools.product(
        (patience.FOR_EVER_S, patience.LIVE_S), (None, LIMITS_DEG[0], LIMITS_DEG[-1])
    ):
        plan_ms, slowdowns, durations_s, failed = list[float](), list[float](), list[float](), 0
        for layout in drawn:
            ways = tasks(layout, given.tasks) if limit_deg is None else carries(layout, given.carries)
            planner = layout.planner()
            planner.patience_s = patience_s
            for first, _, near in ways:
                if near is None:
                    continue
                start = planner.standing_at(first)
                slowdowns.append(machine.slowdown())
                begin_s = time.thread_time()
                try:
                    durations_s.append(planner.move(start, near, spill_limit_deg=limit_deg).duration_s)
                except SkillFailed:
                    failed += 1
                plan_ms.append(1e3 * (time.thread_time() - begin_s))
        slowdown = float(np.mean(slowdowns))
        name = f"{'empty' if limit_deg is None else f'{limit_deg:g} deg'}, patience {patience_s:g} s"
        found[name] = {
            "ways": len(plan_ms),
            "failed": failed,
            "CPU": spread(plan_ms, "ms"),
            "slowdown": spread(slowdowns, ""),
            "CPU over the slowdown": spread([one / slowdown for one in plan_ms], "ms"),
            "duration": spread(durations_s, "s"),
        }
        print(name, found[name], flush=True)
    return found


def measure(given: argparse.Namespace, bench: Bench) -> dict[str, Any]:
    """All of it on one kind of bench."""
    measured = Measured()
    for layout in layouts(given.layouts, given.first, bench):
        planner = layout.planner()
        audit = Audit(layout.lab.urdf, layout.cell, layout.mortars, CONTAINER)
        for task in tasks(layout, given.tasks):
            measured.moved(layout, planner, audit, task, None)
        planner = layout.planner()
        for task in carries(layout, given.carries):
            measured.carried(layout, planner, audit, task)
        print(f"seed {layout.seed}: {dict(measured.counts)}", flush=True)
    return measured.figures()


if __name__ == "__main__":
    main()
