"""What a constant of `adaptive` is worth: the same doses with it and with another value.

    python -m benchmarks.dosing_ablation estimation.SURPRISING=25 knowledge.AIM_UNDER_MG=0,adaptive.ALARM=2
                                         [--powders monosodium_glutamate] [--targets 50 500] [--doses 600]
                                         [--family msg --plants 20 --seeds tuning] [--json FILE]

Each word is a variant, of one constant or of several with commas between; the law as it is comes first. Plants and
seeds are the same for all, the shipped ones or, with `--family`, randomised ones. Doses of one seed go apart with the
first opening that differs: two variants differ by chance as much as two sets of seeds do. Intervals are Wilson's, 95 %.
"""

import argparse
import ast
import importlib
import json
import os
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.stats import binomtest

from benchmarks import dosing_random
from benchmarks.rig import DOSES_PER_RUN, TOLERANCE_MG, Setting, run_of_doses, shipped_powders
from harness.random_plants import FAMILIES, SETS, Drawn, draw

MODULES = tuple(
    importlib.import_module(f"scuhand_bt.dosing.{name}")
    for name in ("adaptive", "knowledge", "constraint", "estimation", "identification")
)
FIRST_RUN = 1000
"""Seeds of other runs than `benchmarks.dosing` judges by."""
Variant = Mapping[str, object]
"""Values of constants, by 'module.NAME'."""


class Job(NamedTuple):
    """One run of doses: on a shipped powder, or on a randomised plant."""

    target_mg: float
    powder: str
    run: int
    drawn: Drawn | None
    doses: int


def change(variant: Variant) -> None:
    """Give constants other values, in every module that has taken them over."""
    for name, value in variant.items():
        constant = name.split(".")[1]
        for module in MODULES:
            if hasattr(module, constant):
                setattr(module, constant, value)


def work(job: Job) -> list[tuple[float, float]]:
    """Of each dose the true error [mg] and the time [s]."""
    if job.drawn is not None:
        doses = dosing_random.run_of_doses(job.drawn, job.target_mg, "adaptive", job.doses)
        return [(dose.error_mg, dose.duration_s) for dose in doses]
    powder = shipped_powders()[job.powder]
    trials = run_of_doses(powder, job.target_mg, "adaptive", FIRST_RUN + job.run, Setting(), job.doses)
    return [(trial.true_error_mg, trial.duration_s) for trial in trials]


def figures(doses: Sequence[tuple[float, float]]) -> dict[str, float]:
    errors_mg, times_s = np.array(doses).T
    good = int(np.sum(np.abs(errors_mg) <= TOLERANCE_MG))
    low, high = binomtest(good, len(doses)).proportion_ci(method="wilson")
    return {
        "doses": len(doses),
        "true": 100.0 * good / len(doses),
        "low": 100.0 * low,
        "high": 100.0 * high,
        "over": int(np.sum(errors_mg > TOLERANCE_MG)),
        "beyond_20mg": int(np.sum(errors_mg > dosing_random.FAR_MG)),
        "worst_mg": float(errors_mg.max()),
        "mean_mg": float(errors_mg.mean()),
        "mean_s": float(times_s.mean()),
    }


def read_variant(text: str) -> dict[str, object]:
    """ValueError for what is no constant of the law, or no value."""
    variant: dict[str, object] = {}
    for part in text.split(","):
        name, _, value = part.partition("=")
        module, _, constant = name.partition(".")
        known = {of.__name__.rsplit(".", 1)[1]: of for of in MODULES}
        if not hasattr(known.get(module), constant) or not constant.isupper():
            raise ValueError(f"'{name}' is no constant of {', '.join(known)}")
        try:
            variant[name] = ast.literal_eval(value)
        except (SyntaxError, ValueError):
            raise ValueError(f"'{value}' is no value for {name}") from None
    return variant


def main(arguments: Sequence[str] | None = None) -> int:
    """Run it; 2 for words that mean nothing, before any dose."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.dosing_ablation", description=__doc__)
    parser.add_argument("variants", nargs="*", metavar="module.NAME=VALUE")
    parser.add_argument("--powders", nargs="+", default=["glass_beads", "monosodium_glutamate"])
    parser.add_argument("--targets", nargs="+", type=float, default=list(dosing_random.TARGETS_MG), metavar="MG")
    parser.add_argument("--doses", type=int, default=200, help="of each powder and target, in runs of ten")
    parser.add_argument("--family", nargs="+", choices=[*FAMILIES], help="randomised plants in place of powders")
    parser.add_argument("--plants", type=int, default=20, help="of each family; ten doses on each for each target")
    parser.add_argument("--seeds", default="tuning", choices=[*SETS])
    parser.add_argument("--processes", type=int, default=os.cpu_count())
    parser.add_argument("--json", type=Path)
    chosen = parser.parse_args(arguments)
    try:
        variants: dict[str, Variant] = {"as it is": {}} | {text: read_variant(text) for text in chosen.variants}
    except ValueError as error:
        parser.error(str(error))
    unknown = set(chosen.powders) - set(shipped_powders())
    if unknown:
        parser.error(f"no powder is called {', '.join(sorted(unknown))}")
    if min(chosen.doses, chosen.plants, chosen.processes, *chosen.targets) <= 0:
        parser.error("doses, plants, processes and targets are more than 0")
    jobs: dict[tuple[str, float], list[Job]] = {}
    for target_mg in chosen.targets:
        for family in chosen.family or ():
            plants = draw(family, shipped_powders(), chosen.plants, seeds=chosen.seeds, balances=["lab"], doses=10)
            jobs[family, target_mg] = [Job(target_mg, drawn.powder, 0, drawn, 10) for drawn in plants]
        for name in () if chosen.family else chosen.powders:
            starts = range(0, chosen.doses, DOSES_PER_RUN)
            runs = [(run, min(DOSES_PER_RUN, chosen.doses - start)) for run, start in enumerate(starts)]
            jobs[name, target_mg] = [Job(target_mg, name, run, None, count) for run, count in runs]
    kept: dict[str, dict[str, float]] = {}
    base_s: dict[tuple[str, float], float] = {}
    for text, variant in variants.items():
        print(text)
        with ProcessPoolExecutor(chosen.processes, get_context("spawn"), change, (variant,)) as pool:
            for cell, of_cell in jobs.items():
                of = figures([dose for doses in pool.map(work, of_cell) for dose in doses])
                slower = of["mean_s"] / base_s.setdefault(cell, of["mean_s"])
                kept[f"{text} | {cell[0]} | {cell[1]:g}"] = of
                print(
                    f"  {cell[0]:21}{cell[1]:6g} mg: {of['doses']:5g} doses, {of['true']:6.2f} % "
                    f"({of['low']:.1f}-{of['high']:.1f}), over {of['over']:3g}, worst {of['worst_mg']:+6.1f}, "
                    f"> 20 mg {of['beyond_20mg']:g}, mean {of['mean_mg']:+.2f} mg, "
                    f"{of['mean_s']:6.1f} s ({slower:.2f})",
                    flush=True,
                )
    if chosen.json is not None:
        chosen.json.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
