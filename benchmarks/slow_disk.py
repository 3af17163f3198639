"""What a slow disk does to a run's control: `python -m benchmarks.slow_disk [--runs 3] [--json FILE]`.

Rehearses a recipe that moves the valve (the real drivers, in real time, against twins), with the disk as it is and with
every fourth forced write (`fsync`, `fdatasync`) a second long: a library that is loaded before all others sleeps in it.
Counted are the runs that do not come to their end; how long the run's tick is silent between two beats, for which the
drivers stop the arm and close the valve after 70 ms; and the longest that the tick was within the journal. Real time
needs a computer that has it to spare: elsewhere runs are lost with any disk.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path
from typing import Any
from unittest.mock import patch

from benchmarks.figures import show
from scuhand_bt.devices.liveness import LIMIT_S, Liveness
from scuhand_bt.journal.writer import Journal
from scuhand_bt.lab import load_lab, starter_lab
from scuhand_bt.recipe.plan import make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.run.observers import BatchObserver
from scuhand_bt.run.options import Options
from scuhand_bt.run.session import Session
from scuhand_bt.run.simulation import Rehearsal

ROOT = Path(__file__).parent.parent
SLEEPING = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <unistd.h>
static int calls;
static int slow(const char *name, int file) {
    if (__sync_add_and_fetch(&calls, 1) % 4 == 0) usleep(999999);
    return ((int (*)(int)) dlsym(RTLD_NEXT, name))(file);
}
int fsync(int file) { return slow("fsync", file); }
int fdatasync(int file) { return slow("fdatasync", file); }
"""
RECIPE = """\
recipe: slow-disk
workflow: turns
sources:
  beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 20 g}
samples:
  - {id: a}
"""
TREE = "workflow: turns\ntree: {repeat: {times: 4, child: {check_valve: }}}\n"
TICKS = ("event", "job_started", "job_ended", "action_started", "action_ended", "keep_up")
"""What the tick calls of the journal."""


class Beats(BatchObserver):
    """Notes how many beats there had been at each tick: what comes after the last one is no control."""

    def __init__(self, beats_s: list[float]) -> None:
        self._beats_s = beats_s
        self.count = 0

    def ticked(self, root: Any) -> None:
        self.count = len(self._beats_s)


def rehearse(folder: Path, seed: int) -> dict[str, Any]:
    """One dose: whether it came to its end, and the gaps between the beats of its tick [s]."""
    beats_s: list[float] = []
    within_s: list[float] = []
    beat = Liveness.beat

    def timed(method: Callable[..., Any]) -> Callable[..., Any]:
        def call(*args: Any, **others: Any) -> Any:
            began_s = time.monotonic()
            try:
                return method(*args, **others)
            finally:
                within_s.append(time.monotonic() - began_s)

        return call

    def noted(liveness: Liveness) -> None:
        beats_s.append(time.monotonic())
        beat(liveness)

    path = folder / "recipe.yaml"
    path.write_text(RECIPE, encoding="utf-8")
    for part in ("robot", "skills", "trees"):
        shutil.copytree(starter_lab() / part, folder / part)
    (folder / "trees" / "turns.yaml").write_text(TREE, encoding="utf-8")
    lab = load_lab(folder)
    session = Session(make_plan(load_recipe(path, lab), lab), lab, Options(Rehearsal(seed), folder=folder / "runs"))
    observer = Beats(beats_s)
    began_s = time.monotonic()
    with ExitStack() as patched:
        patched.enter_context(patch.object(Liveness, "beat", noted))
        for name in TICKS:
            patched.enter_context(patch.object(Journal, name, timed(getattr(Journal, name))))
        try:
            result = session.run(observer)
        finally:
            session.close()
    at_work_s = beats_s[: observer.count]
    return {
        "is_lost": not result.is_complete,
        "within_s": within_s,
        "reason": result.reason,
        "duration_s": time.monotonic() - began_s,
        "gaps_s": [later - sooner for sooner, later in pairwise(at_work_s)],
    }


def measured(name: str, runs: int, environment: dict[str, str]) -> dict[str, float]:
    """Figures of some runs, each in a process of its own."""
    found: list[dict[str, Any]] = []
    for seed in range(runs):
        with tempfile.TemporaryDirectory() as folder:
            command = [sys.executable, "-m", "benchmarks.slow_disk", "--one", folder, "--seed", str(seed)]
            done = subprocess.run(
                command, cwd=ROOT, env={**os.environ, **environment}, capture_output=True, text=True, check=True
            )
        found.append(json.loads(done.stdout.splitlines()[-1]))
        if found[-1]["is_lost"]:
            print(f"{name}, seed {seed}: {found[-1]['reason']}", file=sys.stderr)
    gaps_s = sorted(gap for one in found for gap in one["gaps_s"])
    within_s = sorted(part for one in found for part in one["within_s"])
    return {
        f"{name}_runs_lost": sum(one["is_lost"] for one in found),
        f"{name}_mean_duration_s": sum(one["duration_s"] for one in found) / runs,
        f"{name}_gap_median_ms": 1000 * gaps_s[len(gaps_s) // 2],
        f"{name}_gap_p99_ms": 1000 * gaps_s[int(0.99 * len(gaps_s))],
        f"{name}_gap_p999_ms": 1000 * gaps_s[int(0.999 * len(gaps_s))],
        f"{name}_gap_longest_ms": 1000 * gaps_s[-1],
        f"{name}_gaps_beyond_limit": sum(gap > LIMIT_S for gap in gaps_s),
        f"{name}_journal_p99_ms": 1000 * within_s[int(0.99 * len(within_s))],
        f"{name}_journal_longest_ms": 1000 * within_s[-1],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--one", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--seed", type=int, default=0, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one is not None:
        print(json.dumps(rehearse(options.one, options.seed)))
        return
    with tempfile.TemporaryDirectory() as folder:
        source, library = Path(folder, "slow.c"), Path(folder, "slow.so")
        source.write_text(SLEEPING, encoding="utf-8")
        subprocess.run(["cc", "-shared", "-fPIC", "-o", library, source, "-ldl"], check=True)
        figures = measured("disk", options.runs, {})
        figures |= measured("slow_disk", options.runs, {"LD_PRELOAD": str(library)})
    goals = {"slow_disk_runs_lost": "0", "slow_disk_gaps_beyond_limit": "as with the disk as it is"}
    show("A slow disk", figures, goals, options.json)


if __name__ == "__main__":
    main()
