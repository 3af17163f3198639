"""Dosing on randomised plants: `harness.random_plants` says which families there are, and what differs in them.

    python -m benchmarks.dosing_random [--family beads msg lumps ...] [--plants 20] [--doses 10] [--targets 20 50 ...]
                                       [--controller adaptive oracle] [--seeds tuning|judging]
                                       [--balance lab poles mean delay adaptive ringing] [--steps] [--only INDEX ...]
                                       [--growing] [--json FILE]

Each plant is dosed on in one run of each target, within which a controller learns; with `--growing` in one of all
targets, in their order: what little doses have taught is what the first large one goes by. Success is |true error|
<= 2 mg, with Wilson's 95 % interval. `out` are doses reported in tolerance that are out of it; `false` are those given
up as `hand.no_flow` where the cone holds powder that would have come. Times against `oracle`'s are ratios of means.
"""

import argparse
import copy
import json
import math
import os
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.stats import binomtest

from benchmarks.rig import TOLERANCE_MG, Bench, Setting, shipped_powders
from harness.random_plants import BALANCES, FAMILIES, SETS, Drawn, RandomPlant, draw
from scuhand_bt.device_specs.hand import HandSpec
from scuhand_bt.dosing import CONTROLLERS
from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.sim.mass_ledger import CONE
from scuhand_bt.specs import BalanceBelief

TARGETS_MG = (20.0, 50.0, 500.0, 3000.0)
PLANT = f"{RandomPlant.__module__}:{RandomPlant.__name__}"
FAR_MG = 20.0
LOOKED_S, COMES_MG = 60.0, 3.0
"""A powder that gives so much in that time, shaken at full opening, flows."""


class Job(NamedTuple):
    """All runs of one plant, as a worker is given them: the oracle solves a plant once."""

    drawn: Drawn
    targets_mg: Sequence[float]
    controllers: Sequence[str]
    doses: int
    is_growing: bool


@dataclass(frozen=True)
class Dosed:
    """One dose."""

    family: str
    plant: int
    dose: int
    target_mg: float
    controller: str
    error_mg: float
    """By the true mass."""
    accepted: bool
    reason: str
    gives_still: bool
    """Given up as `hand.no_flow`, and the powder would have come."""
    duration_s: float
    cpu_s: float


class Trickling:
    """The clock's process: the world, and what falls from the apex while the valve is shut."""

    def __init__(self, bench: Bench) -> None:
        self._world = bench.world

    def step(self, now_s: float, limit_s: float) -> float:
        end_s = self._world.step(now_s, limit_s)
        if not self._world.is_open:
            load = self._world.load
            load.drop(end_s, load._flow.trickle(end_s - now_s, self._world.ledger.masses_mg[CONE]))
        return end_s

    def save(self) -> None:
        self._world.save()


def work(job: Job) -> list[Dosed]:
    runs = [list(job.targets_mg)] if job.is_growing else [[target_mg] * job.doses for target_mg in job.targets_mg]
    return [dose for run in runs for name in job.controllers for dose in run_of_doses(job.drawn, run, name)]


def run_of_doses(
    drawn: Drawn, targets_mg: Sequence[float], controller: str, believed_hand: HandSpec | None = None
) -> list[Dosed]:
    """Doses of these masses on one plant, one after another; what is learnt goes with them.

    None of a dish that the balance cannot weigh: it is refused before the dose.
    """
    powder = shipped_powders()[drawn.powder]
    setting = Setting(name=drawn.family, plant=PLANT, hand=drawn.hand, believed_hand=believed_hand or HandSpec())
    RandomPlant.at_hand = drawn
    belief, balance = powder.belief, BalanceBelief()
    doses = []
    for dose, target_mg in enumerate(targets_mg):
        began_s = time.process_time()
        RandomPlant.dose = dose
        try:
            bench = Bench(powder, target_mg, drawn.seed, dose, setting)
        except SkillFailed:
            continue
        bench.clock.process = Trickling(bench)
        trial = bench.dose(controller, belief, balance)
        belief, balance = bench.cell.powder_beliefs[powder.name], bench.cell.balance_belief
        doses.append(
            Dosed(
                family=drawn.family,
                plant=drawn.index,
                dose=dose,
                target_mg=target_mg,
                controller=controller,
                error_mg=trial.true_error_mg,
                accepted=trial.accepted,
                reason=trial.reason,
                gives_still=trial.reason == Code.HAND_NO_FLOW and gives_still(bench),
                duration_s=trial.duration_s,
                cpu_s=time.process_time() - began_s,
            )
        )
    return doses


def gives_still(bench: Bench) -> bool:
    """Whether powder would come from the cone if the valve were opened as wide as it goes, and shaken."""
    load, left_mg = bench.world.load, bench.world.ledger.masses_mg[CONE]
    flow, rng = copy.deepcopy((load._flow, load._flow_rng))
    came_mg = 0.0
    for _ in range(int(LOOKED_S / 0.02)):
        came_mg += flow.step(0.02, HandSpec().max_opening_mm, 1.0, left_mg - came_mg, rng)
        if came_mg >= COMES_MG:
            return True
    return False


def figures(doses: Sequence[Dosed], floor_s: float | None) -> dict[str, float]:
    """Of one family, target and controller; `floor_s` is the oracle's mean time."""
    errors_mg = np.array([dose.error_mg for dose in doses])
    times_s = np.array([dose.duration_s for dose in doses])
    good = np.abs(errors_mg) <= TOLERANCE_MG
    low, high = binomtest(int(good.sum()), len(doses)).proportion_ci(method="wilson")
    return {
        "doses": len(doses),
        "true": 100.0 * float(good.mean()),
        "low": 100.0 * low,
        "high": 100.0 * high,
        "reported": 100.0 * sum(dose.accepted for dose in doses) / len(doses),
        "out": sum(dose.accepted and not fine for dose, fine in zip(doses, good, strict=True)),
        "mean_mg": float(errors_mg.mean()),
        "median_mg": float(np.median(errors_mg)),
        "worst_mg": float(errors_mg.max()),
        "beyond_20mg": int(np.sum(errors_mg > FAR_MG)),
        "false_no_flow": sum(dose.gives_still for dose in doses),
        "median_s": float(np.median(times_s)),
        "p95_s": float(np.quantile(times_s, 0.95)),
        "mean_s": float(times_s.mean()),
        "of_oracle": float(times_s.mean()) / floor_s if floor_s else math.nan,
        "cpu_ms": 1000.0 * float(np.mean([dose.cpu_s for dose in doses])),
    }


HEAD = (
    f"{'family':10}{'target':>7} {'controller':11}{'doses':>6}{'true %':>7} {'(95 %)':>13}{'rep. %':>7}{'out':>4}"
    f"{'mean':>7}{'median':>7}{'worst':>8}{'>20':>4}{'false':>6}{'med. s':>8}{'p95 s':>7}{'/oracle':>8}{'ms':>6}"
)


def line(family: str, target_mg: float, controller: str, of: dict[str, float]) -> str:
    interval = f"({of['low']:.1f}-{of['high']:.1f})"
    ratio = "" if math.isnan(of["of_oracle"]) else f"{of['of_oracle']:.2f}"
    return (
        f"{family:10}{target_mg:7g} {controller:11}{of['doses']:6g}{of['true']:7.1f} {interval:>13}"
        f"{of['reported']:7.1f}{of['out']:4g}{of['mean_mg']:7.2f}{of['median_mg']:7.2f}{of['worst_mg']:8.1f}{of['beyond_20mg']:4g}"
        f"{of['false_no_flow']:6g}{of['median_s']:8.1f}{of['p95_s']:7.1f}{ratio:>8}{of['cpu_ms']:6.0f}"
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Run it; 2 for words that mean nothing, before any dose."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.dosing_random", description=__doc__)
    parser.add_argument("--family", nargs="+", default=["beads", "msg", "lumps"], choices=[*FAMILIES])
    parser.add_argument("--plants", type=int, default=20, help="of each family, drawn anew for each number")
    parser.add_argument("--doses", type=int, default=10, help="of each plant and target, in one run")
    parser.add_argument("--targets", nargs="+", type=float, default=list(TARGETS_MG), metavar="MG")
    parser.add_argument("--controller", nargs="+", default=["adaptive"], choices=["oracle", *CONTROLLERS])
    parser.add_argument("--seeds", default="tuning", choices=[*SETS])
    parser.add_argument("--balance", nargs="+", default=["lab"], choices=[*BALANCES])
    parser.add_argument("--steps", action="store_true", help="each balance's filter is changed once in its run")
    parser.add_argument("--growing", action="store_true", help="one dose of each target, all in one run")
    parser.add_argument("--only", nargs="+", type=int, default=[], metavar="INDEX", help="of the plants, these")
    parser.add_argument("--processes", type=int, default=os.cpu_count())
    parser.add_argument("--json", type=Path, help="every cell's figures, every dose and every plant")
    chosen = parser.parse_args(arguments)
    if min(chosen.plants, chosen.doses, chosen.processes, *chosen.targets) <= 0:
        parser.error("plants, doses, processes and targets are more than 0")
    if chosen.json is not None and not chosen.json.resolve().parent.is_dir():
        parser.error(f"there is no folder {chosen.json.parent} to write to")
    controllers = sorted(dict.fromkeys(chosen.controller), key=lambda name: name != "oracle")
    plants = {
        family: [
            drawn
            for drawn in draw(
                family,
                shipped_powders(),
                chosen.plants,
                seeds=chosen.seeds,
                balances=chosen.balance,
                doses=chosen.doses,
                steps=chosen.steps,
            )
            if not chosen.only or drawn.index in chosen.only
        ]
        for family in chosen.family
    }
    kept: dict[str, dict[str, float]] = {}
    doses: list[Dosed] = []
    print(HEAD)
    with ProcessPoolExecutor(chosen.processes, mp_context=get_context("spawn")) as pool:
        for family, of_family in plants.items():
            jobs = [Job(drawn, chosen.targets, controllers, chosen.doses, chosen.growing) for drawn in of_family]
            dosed = [dose for of_plant in pool.map(work, jobs) for dose in of_plant]
            doses += dosed
            for target_mg in chosen.targets:
                floor_s = None
                for name in controllers:
                    of_cell = [dose for dose in dosed if (dose.target_mg, dose.controller) == (target_mg, name)]
                    of = figures(of_cell, floor_s)
                    floor_s = of["mean_s"] if name == "oracle" else floor_s
                    kept[f"{family} | {target_mg:g} | {name}"] = of
                    print(line(family, target_mg, name, of), flush=True)
    if chosen.json is not None:
        drawn = [asdict(one) | {"hand": one.hand.model_dump()} for of_family in plants.values() for one in of_family]
        told = {"cells": kept, "plants": drawn, "doses": [asdict(dose) for dose in doses]}
        chosen.json.write_text(json.dumps(told, indent=1, default=float) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
