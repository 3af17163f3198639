"""What the one posture of each place costs: `python -m benchmarks.motion_choice [--layouts N] [--first SEED]
[--json FILE]`.

In cells that nobody drew (`harness/motion_layouts.py`) the arm goes the 15 ways of a small batch: to either mortar,
from there to the pan and back, twice, with a load at 20 degrees, with it to the waste, to the sheets, and at last to
park. As it is planned each way ends in its place's one posture. Against that stand the same ways each of which ends in
what configuration it likes, and begins where the one before has ended; polished as well. So a choice is greedy: the
whole may be longer than with one posture.

Planning is told as CPU time of its thread, of a planner that has planned nothing: every way once.
"""

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.figures import spread
from harness.motion_layouts import Layout, layouts
from scuhand_bt.motion import transfer

LIMIT_DEG = 20.0


def batch() -> list[tuple[str, bool]]:
    """Where the arm goes from park, and whether with a load."""
    ways = []
    for mortar in ("mortar_bay", "mortar_bay_2"):
        rounds = [("balance", True), (mortar, True)] * 2
        ways += [(mortar, False), *rounds, ("waste", True), ("sheet_swap", False)]
    return [*ways, ("park", False)]


def planned(layout: Layout, is_free: bool) -> tuple[list[float], float]:
    """How long each way takes [s], and what planning all of them did [s of CPU]."""
    planner, durations_s = layout.planner(), list[float]()
    q = planner.standing_at("park")
    begin_s = time.thread_time()
    for place, is_loaded in batch():
        goal, limit_deg = layout.places[place] if is_free else place, LIMIT_DEG if is_loaded else None
        motion = planner.move(q, goal, spill_limit_deg=limit_deg, effort=transfer.POLISHED)
        durations_s.append(motion.duration_s)
        q = motion.end
    return durations_s, time.thread_time() - begin_s


def measure(count: int, first: int) -> dict[str, Any]:
    """All of it: whole batches, and the ways of empty cones and of loads apart."""
    is_loaded = np.array([loaded for _, loaded in batch()])
    ratios: dict[str, list[float]] = {"batch": [], "empty": [], "loads": []}
    cpu_s: dict[str, list[float]] = {"one posture": [], "free choice": []}
    for layout in layouts(count, first):
        (one, one_cpu_s), (free, free_cpu_s) = planned(layout, False), planned(layout, True)
        for name, which in (("batch", is_loaded | True), ("empty", ~is_loaded), ("loads", is_loaded)):
            ratios[name].append(float(np.array(one)[which].sum() / np.array(free)[which].sum()))
        cpu_s["one posture"].append(one_cpu_s)
        cpu_s["free choice"].append(free_cpu_s)
        print(f"seed {layout.seed}: {sum(one):.1f} s, {sum(free):.1f} s by free choice", flush=True)
    return {
        "ways": len(batch()) * count,
        **{f"one posture / free choice, {name}": spread(some, "") for name, some in ratios.items()},
        "of each layout": [round(one, 2) for one in ratios["batch"]],
        **{f"CPU, {name}": spread(some, "s") for name, some in cpu_s.items()},
    }


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.motion_choice", description=__doc__)
    parser.add_argument("--layouts", type=int, default=8)
    parser.add_argument("--first", type=int, default=9710, help="the first seed")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    figures = measure(given.layouts, given.first)
    for key, value in figures.items():
        print(f"{key:34} {value}")
    if given.json:
        given.json.write_text(json.dumps({"arguments": vars(given) | {"json": None}, **figures}, indent=1) + "\n")


if __name__ == "__main__":
    main()
