"""Figures of whole batches: `python -m benchmarks.batch [--samples 1000] [--json FILE]`.

Times the command line from a cold start, and a generated batch of many samples: checking it, running it
dry, its memory, and whether a tick at its end costs what a tick at its beginning does.
"""

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from array import array
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from statistics import quantiles

from py_trees.behaviour import Behaviour

from benchmarks.figures import show
from scuhand_bt.lab import load_lab, starter_lab
from scuhand_bt.recipe.plan import Job, make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.run.observers import BatchObserver
from scuhand_bt.run.options import Options
from scuhand_bt.run.prepared_motion import prepared_motion
from scuhand_bt.run.session import Session
from scuhand_bt.run.simulation import DryRun

ROOT = starter_lab()
WINDOW = 20
"""Jobs over which a tick's cost is taken, at the beginning and at the end."""


def generated_recipe(folder: Path, samples: int) -> Path:
    """A batch of small doses from a table; of one powder, so that its first and last jobs do the same work."""
    rows = ["id,mass", *(f"s{i:05d},{20 + 10 * (i % 4)} mg" for i in range(samples))]
    (folder / "samples.csv").write_text("\n".join(rows) + "\n")
    recipe = folder / "generated.yaml"
    recipe.write_text(
        "recipe: generated\nworkflow: fill_xrd_holder\nsources:\n"
        "  beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 100 g}\n"
        "defaults: {source: beads, container: xrd_holder}\nsamples:\n  - {table: samples.csv}\n"
        "on_failure: {otherwise: skip_sample}\n"
    )
    return recipe


def command(*arguments: str) -> tuple[float, int]:
    """Wall seconds and exit code of one cold start of the command line."""
    began = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-m", "scuhand_bt", *arguments, "--lab", str(ROOT)], capture_output=True, check=False
    )
    return time.perf_counter() - began, done.returncode


class TickTimes(BatchObserver):
    """Measures every tick of a run, by job."""

    def __init__(self) -> None:
        self.ticks_us = defaultdict[int, "array[float]"](lambda: array("d"))
        self.job = 0

    def job_started(self, job: Job, number: int) -> None:
        self.job = number

    def timing(self, tick: Callable[[Behaviour], None]) -> Callable[[Behaviour], None]:
        def timed(root: Behaviour) -> None:
            began = time.perf_counter()
            tick(root)
            self.ticks_us[self.job].append((time.perf_counter() - began) * 1e6)

        return timed

    def cost_us(self, first: int, last: int) -> float:
        """The lower quartile: what a tick costs of itself, where no skill has a step to do."""
        return quantiles((cost for job in range(first, last) for cost in self.ticks_us[job]), n=4)[0]


def big_run(recipe: Path, folder: Path, controller: str | None) -> dict[str, float]:
    """The generated batch in this process."""
    times = TickTimes()
    Behaviour.tick_once = times.timing(Behaviour.tick_once)
    began = time.perf_counter()
    lab = load_lab(ROOT)
    plan = make_plan(load_recipe(recipe, lab), lab)
    session = Session(plan, lab, Options(DryRun(), controller, folder))
    result = session.run(times)
    session.close()
    wall_s = time.perf_counter() - began
    jobs = len(plan.jobs)
    head_us, tail_us = times.cost_us(0, WINDOW), times.cost_us(jobs - WINDOW - 1, jobs - 1)
    return {
        "wall_s": wall_s,
        "exit_code": result.exit_code,
        "in_tolerance": sum(sample.verdict == "in tolerance" for sample in result.samples),
        "memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "tick_us_at_10": head_us,
        "tick_us_at_end": tail_us,
        "tick_ratio": tail_us / head_us,
        "virtual_h": result.duration_s / 3600,
    }


def seeds(folder: Path, count: int) -> dict[str, float]:
    """One small batch with many seeds: every run ends, and its powder is all there."""
    lab = load_lab(ROOT)
    plan = make_plan(load_recipe(ROOT / "recipes" / "xrd_holders.yaml", lab), lab)
    motion = prepared_motion(plan, lab)
    loaded_mg = sum(source.amount_mg for source in plan.recipe.sources.values())
    worst_mg, verdicts, began = 0.0, 0, time.perf_counter()
    for seed in range(count):
        session = Session(plan, lab, Options(DryRun(seed), None, folder), motion)
        result = session.run(TickTimes())
        session.close()
        assert session.world is not None
        worst_mg = max(worst_mg, abs(session.world.ledger.total_mg - loaded_mg))
        verdicts += sum(1 for sample in result.samples if sample.verdict in ("in tolerance", "under", "over"))
    return {
        f"seeds_{count}_s": time.perf_counter() - began,
        "seeds_doses": count * len(plan.recipe.samples),
        "seeds_doses_with_verdict": verdicts,
        "seeds_worst_imbalance_mg": worst_mg,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=1000)
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--controller")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    figures: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        os.chdir(folder)
        recipe = generated_recipe(folder, options.samples)
        batch = str(ROOT / "recipes" / "synthesis_batch.yaml")
        figures["check_24_s"] = min(command("check", batch)[0] for _ in range(3))
        figures["check_many_s"] = min(command("check", str(recipe))[0] for _ in range(3))
        figures["dry_run_24_s"] = min(command("run", batch, "--dry-run")[0] for _ in range(3))
        figures |= seeds(folder, options.seeds)
        figures |= big_run(recipe, folder, options.controller)
    limits = {
        "dry_run_24_s": "< 10",
        "check_many_s": "< 2",
        "wall_s": "< 180",
        "memory_mb": "< 400",
        "tick_ratio": "0.9 to 1.1",
        "seeds_worst_imbalance_mg": "< 1e-6",
    }
    show(f"Batches ({options.samples} generated samples)", figures, limits, options.json)


if __name__ == "__main__":
    main()
