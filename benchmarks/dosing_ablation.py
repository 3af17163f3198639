"""What a constant of `adaptive` is worth: the same doses with it and with another value.

    python -m benchmarks.dosing_ablation estimation.SURPRISING=25 knowledge.AIM_UNDER_MG=0,adaptive.ALARM=2
                                         [--powders monosodium_glutamate] [--targets 50 500] [--doses 600]
                                         [--family msg --plants 20 --seeds tuning] [--balance lab poles ...]
                                         [--steps] [--json FILE]
    python -m benchmarks.dosing_ablation --listed [--json benchmarks/dosing_ablation.json]

Each word is a variant, of one constant or of several with commas between; the law as it is comes first. Plants and
seeds are the same for all, the shipped ones or, with `--family`, randomised ones. Doses of one seed go apart with the
first opening that differs: two variants differ by chance as much as two sets of seeds do. Intervals are Wilson's, 95 %.

`--listed` measures each variant of `dosing_constants.yaml` in its worlds, on shipped plants and on randomised ones
(`WORLDS`), and keeps what is done: a run that was broken off goes on. `dosing_tables` shows what comes of it.
"""

import argparse
import ast
import importlib
import json
import os
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

import numpy as np
import yaml
from scipy.stats import binomtest

from benchmarks import dosing_random
from benchmarks.dosing_worth import AGAIN, AS_IT_IS
from benchmarks.rig import DOSES_PER_RUN, TOLERANCE_MG, Setting, run_of_doses, shipped_powders
from harness.random_plants import BALANCES, FAMILIES, SETS, Drawn, draw
from scuhand_bt.device_specs.hand import HandSpec

MODULES = tuple(
    importlib.import_module(f"scuhand_bt.dosing.{name}")
    for name in (
        "adaptive",
        "opening",
        "unseen",
        "knowledge",
        "noise",
        "constraint",
        "estimation",
        "identification",
        "pulses",
        "shaking",
    )
)
FIRST_RUN = 1000
"""Seeds of other runs than `benchmarks.dosing` judges by."""
LISTED = Path(__file__).with_name("dosing_constants.yaml")
LISTED_RESULTS = Path(__file__).with_name("dosing_ablation.json")
OTHER_SEEDS = 5000
"""Added to a run's, or a plant's: the law as it is, once more, says what chance alone makes of these figures."""
Variant = Mapping[str, object]
"""Values of constants, by 'module.NAME'."""


class World(NamedTuple):
    """What listed variants are measured in: powders, families taken for them, targets, and how many doses of a cell."""

    powders: Sequence[str]
    families: Sequence[str]
    targets_mg: Sequence[float]
    doses: int
    plants: int
    doses_on_plant: int
    streaming: bool = True
    balances: Sequence[str] = ("lab",)
    steps: bool = False
    """Each balance's filter is changed once in a plant's run."""


FREE = World(("glass_beads", "monosodium_glutamate"), ("beads", "msg"), dosing_random.TARGETS_MG, 30, 8, 2)
LUMPS = World(("titanium_dioxide", "titanium_dioxide_fine"), ("lumps",), (20.0, 500.0), 30, 16, 2)
WORLDS = {"free": FREE, "lumps": LUMPS, "steps": FREE._replace(streaming=False)}


class Job(NamedTuple):
    """One run of doses: on a shipped powder, or on a randomised plant."""

    target_mg: float
    powder: str
    run: int
    drawn: Drawn | None
    doses: int
    streaming: bool = True


Told = tuple[float, float, bool]
"""Of a dose: its true error [mg], its time [s], and whether it was reported in tolerance."""


@contextmanager
def changed(variant: Variant) -> Iterator[None]:
    """Other values of constants, in every module that has taken them over."""
    before = [
        (module, constant, getattr(module, constant))
        for constant in (name.split(".")[1] for name in variant)
        for module in MODULES
        if hasattr(module, constant)
    ]
    values = {name.split(".")[1]: value for name, value in variant.items()}
    try:
        for module, constant, _ in before:
            setattr(module, constant, values[constant])
        yield
    finally:
        for module, constant, value in before:
            setattr(module, constant, value)


def work(variant: Variant, job: Job) -> list[Told]:
    hand = HandSpec(streaming=job.streaming)
    with changed(variant):
        if job.drawn is not None:
            drawn = replace(job.drawn, hand=job.drawn.hand.model_copy(update={"streaming": job.streaming}))
            doses = dosing_random.run_of_doses(drawn, [job.target_mg] * job.doses, "adaptive", hand)
            return [(dose.error_mg, dose.duration_s, dose.accepted) for dose in doses]
        powder = shipped_powders()[job.powder]
        trials = run_of_doses(powder, job.target_mg, "adaptive", FIRST_RUN + job.run, Setting(hand=hand), job.doses)
        return [(trial.true_error_mg, trial.duration_s, trial.accepted) for trial in trials]


def jobs_of(
    world: World, randomised: bool, seeds: str = "tuning", other: int = 0
) -> dict[tuple[str, float], list[Job]]:
    """By family or powder, and target; `other` is added to all seeds."""
    jobs: dict[tuple[str, float], list[Job]] = {}
    for target_mg in world.targets_mg:
        for family in world.families if randomised else ():
            count = world.doses_on_plant
            plants = draw(
                family,
                shipped_powders(),
                world.plants,
                seeds=seeds,
                balances=world.balances,
                doses=count,
                steps=world.steps,
            )
            jobs[family, target_mg] = [
                Job(target_mg, drawn.powder, 0, replace(drawn, seed=drawn.seed + other), count, world.streaming)
                for drawn in plants
            ]
        for name in () if randomised else world.powders:
            starts = range(0, world.doses, DOSES_PER_RUN)
            runs = [(run, min(DOSES_PER_RUN, world.doses - start)) for run, start in enumerate(starts)]
            jobs[name, target_mg] = [
                Job(target_mg, name, other + run, None, count, world.streaming) for run, count in runs
            ]
    return jobs


def figures(doses: Sequence[Told]) -> dict[str, float]:
    errors_mg, times_s, accepted = np.array(doses, dtype=float).T
    good = int(np.sum(np.abs(errors_mg) <= TOLERANCE_MG))
    low, high = binomtest(good, len(doses)).proportion_ci(method="wilson")
    return {
        "doses": len(doses),
        "true": 100.0 * good / len(doses),
        "low": 100.0 * low,
        "high": 100.0 * high,
        "reported": int(accepted.sum()),
        "out": int(np.sum((accepted > 0.0) & (np.abs(errors_mg) > TOLERANCE_MG))),
        "over": int(np.sum(errors_mg > TOLERANCE_MG)),
        "beyond_20mg": int(np.sum(errors_mg > dosing_random.FAR_MG)),
        "worst_mg": float(errors_mg.max()),
        "mean_mg": float(errors_mg.mean()),
        "sd_mg": float(errors_mg.std()),
        "mean_s": float(times_s.mean()),
        "sd_s": float(times_s.std()),
    }


def read_variant(text: str) -> dict[str, object]:
    """ValueError for what is no constant of the law, or no value."""
    variant: dict[str, object] = {}
    for part in re.split(r",(?![^(]*\))", text):  # a tuple has commas of its own
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


def measure_listed(path: Path, processes: int) -> None:
    """Each listed variant in its world, into `path`; what stands there already is not run again."""
    kept = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    listed = yaml.safe_load(LISTED.read_text(encoding="utf-8"))
    todo = [(AS_IT_IS, 0), (AGAIN, OTHER_SEEDS)]
    with ProcessPoolExecutor(processes, get_context("spawn")) as pool:
        for name, variants in listed.items():
            for text, other in [*todo, *((text, 0) for text in variants)]:
                variant = {} if text in (AS_IT_IS, AGAIN) else read_variant(text)
                for plants in ("shipped", "randomised"):
                    for cell, of_cell in jobs_of(WORLDS[name], plants == "randomised", other=other).items():
                        key = f"{name} | {plants} | {text} | {cell[0]} | {cell[1]:g}"
                        if key not in kept:
                            told = [dose for doses in pool.map(partial(work, variant), of_cell) for dose in doses]
                            kept[key] = figures(told)
                            path.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")
                print(f"{name} | {text}", flush=True)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run it; 2 for words that mean nothing, before any dose."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.dosing_ablation", description=__doc__)
    parser.add_argument("variants", nargs="*", metavar="module.NAME=VALUE")
    parser.add_argument(
        "--listed", action="store_true", help=f"the variants of {LISTED.name}, on either kind of plants"
    )
    parser.add_argument("--powders", nargs="+", default=["glass_beads", "monosodium_glutamate"])
    parser.add_argument("--targets", nargs="+", type=float, default=list(dosing_random.TARGETS_MG), metavar="MG")
    parser.add_argument("--doses", type=int, default=200, help="of each powder and target, in runs of ten")
    parser.add_argument("--family", nargs="+", choices=[*FAMILIES], help="randomised plants in place of powders")
    parser.add_argument("--plants", type=int, default=20, help="of each family; ten doses on each for each target")
    parser.add_argument("--seeds", default="tuning", choices=[*SETS])
    parser.add_argument("--balance", nargs="+", default=["lab"], choices=[*BALANCES], help="of randomised plants")
    parser.add_argument("--steps", action="store_true", help="each of their filters is changed once in its run")
    parser.add_argument("--processes", type=int, default=os.cpu_count())
    parser.add_argument("--json", type=Path)
    chosen = parser.parse_args(arguments)
    if chosen.listed:
        measure_listed(chosen.json or LISTED_RESULTS, chosen.processes)
        return 0
    try:
        variants: dict[str, Variant] = {AS_IT_IS: {}} | {text: read_variant(text) for text in chosen.variants}
    except ValueError as error:
        parser.error(str(error))
    unknown = set(chosen.powders) - set(shipped_powders())
    if unknown:
        parser.error(f"no powder is called {', '.join(sorted(unknown))}")
    if min(chosen.doses, chosen.plants, chosen.processes, *chosen.targets) <= 0:
        parser.error("doses, plants, processes and targets are more than 0")
    world = World(
        chosen.powders,
        chosen.family or (),
        chosen.targets,
        chosen.doses,
        chosen.plants,
        DOSES_PER_RUN,
        balances=chosen.balance,
        steps=chosen.steps,
    )
    jobs = jobs_of(world, bool(chosen.family), chosen.seeds)
    kept: dict[str, dict[str, float]] = {}
    base_s: dict[tuple[str, float], float] = {}
    with ProcessPoolExecutor(chosen.processes, get_context("spawn")) as pool:
        for text, variant in variants.items():
            print(text)
            for cell, of_cell in jobs.items():
                of = figures([dose for doses in pool.map(partial(work, variant), of_cell) for dose in doses])
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
