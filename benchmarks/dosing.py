"""The dosing benchmark: controllers compared on the same plants and seeds, judged by the true mass.

    python -m benchmarks.dosing [--plant module:Class] [--controllers paper,adaptive,oracle]
                                [--trials 200] [--rows all] [--json FILE]

Success is |true error| <= 2 mg; "reported" is what the cell would call in tolerance. The interval is the
two-sided 95 % Clopper-Pearson interval of the true success. `oracle` sees the true mass: the floor. `paper` weighs and
stops as its experiments did, without the lab's bracket and guard band, which would make it slower; `paper_unwaiting` is
`paper` without the fixed wait of its rig: `--rows waiting` tells how much of its time that is.
"""

import argparse
import json
import os
import sys
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.stats import beta

from benchmarks.rig import DOSES_PER_RUN, TOLERANCE_MG, UNWAITING, Setting, Trial, run_of_doses, shipped_powders
from scuhand_bt.device_specs.balance import BalanceResponseSpec, BalanceSpec
from scuhand_bt.device_specs.hand import HandSpec
from scuhand_bt.dosing import CONTROLLERS
from scuhand_bt.sim.plant import PlantError, load_plant
from scuhand_bt.specs import Powder

TARGETS_MG = (20.0, 50.0, 500.0, 3000.0)
CALIBRATED, REDO = "as calibrated", "redo"
REDO_UP_TO_MG = 50.0
"""Small doses are thrown away for a new one; a recipe's `redo`, once."""
WAITING = (CALIBRATED, "lag 1.0 s", "lag 1.6 s")
"""The rows that tell what waiting for the balance costs `paper`."""
FREE_FLOWING = ("glass_beads", "monosodium_glutamate")


def settings(plant: str | None) -> dict[str, Setting]:
    """The rows: the lab as calibrated, and what should not matter. Controllers are told of none of it."""

    def lag(lag_s: float) -> Setting:
        return Setting(plant=plant, balance=BalanceSpec(simulation=BalanceResponseSpec(lag_s=lag_s)))

    return {
        CALIBRATED: Setting(plant=plant),
        "noise x 4": Setting(plant=plant, balance=BalanceSpec(simulation=BalanceResponseSpec(noise_mg=0.32))),
        "readability 1 mg": Setting(plant=plant, balance=BalanceSpec(readability_mg=1.0)),
        "output 5 Hz": Setting(plant=plant, balance=BalanceSpec(period_s=0.2)),
        "lag 1.0 s": lag(1.0),
        "lag 1.6 s": lag(1.6),
        "dead time 0.25 s": Setting(plant=plant, hand=HandSpec(valve_dead_time_s=0.25), believed_hand=HandSpec()),
        "prior x 2": Setting(plant=plant, belief_factor=2.0),
        "prior / 2": Setting(plant=plant, belief_factor=0.5),
        "fill 70 %": Setting(plant=plant, load_ratio=0.7),
        REDO: Setting(plant=plant, redo=True),
    }


def cells_of(row: str, powders: Sequence[str]) -> list[tuple[str, float]]:
    """Which powders and targets a row is about."""
    if row == CALIBRATED:
        return [(name, target_mg) for name in powders for target_mg in TARGETS_MG]
    if row == REDO:
        return [(name, target_mg) for name in powders for target_mg in TARGETS_MG if target_mg <= REDO_UP_TO_MG]
    return [(name, target_mg) for name in powders if name in FREE_FLOWING for target_mg in TARGETS_MG]


class Job(NamedTuple):
    """One run of doses, as a worker is given it."""

    row: str
    setting: Setting
    powder: Powder
    target_mg: float
    controller: str
    run: int
    doses: int


def work(job: Job) -> list[Trial]:
    return run_of_doses(job.powder, job.target_mg, job.controller, job.run, job.setting, job.doses)


def summary(trials: Sequence[Trial]) -> dict[str, float]:
    """The figures of one cell."""
    true_mg = np.array([trial.true_error_mg for trial in trials])
    durations_s = np.array([trial.duration_s for trial in trials])
    hits = int(np.sum(np.abs(true_mg) <= TOLERANCE_MG))
    accepted = [abs(trial.true_error_mg) for trial in trials if trial.accepted]
    return {
        "trials": len(trials),
        "true": 100.0 * hits / len(trials),
        "low": 100.0 * (float(beta.ppf(0.025, hits, len(trials) - hits + 1)) if hits else 0.0),
        "high": 100.0 * (float(beta.ppf(0.975, hits + 1, len(trials) - hits)) if hits < len(trials) else 1.0),
        "reported": 100.0 * sum(trial.accepted for trial in trials) / len(trials),
        "mean_mg": float(true_mg.mean()),
        "sd_mg": float(true_mg.std()),
        "worst_mg": float(true_mg.max()),
        "worst_accepted_mg": max(accepted, default=0.0),
        "beyond_20mg": int(np.sum(true_mg > 20.0)),
        "beyond_30mg": int(np.sum(true_mg > 30.0)),
        "steps": float(np.mean([trial.steps for trial in trials])),
        "mean_s": float(durations_s.mean()),
        "p95_s": float(np.quantile(durations_s, 0.95)),
    }


HEAD = (
    f"{'row':17}{'powder':23}{'target':>7} {'controller':16}{'true %':>7} {'(95 %)':>13} {'rep. %':>7}"
    f"{'mean':>8}{'sd':>6}{'worst':>7}{'steps':>6}{'mean s':>8}{'p95 s':>7}{'/paper':>7}"
)


def line(key: tuple[str, str, float, str], figures: dict[str, float], paper_s: float | None) -> str:
    row, powder, target_mg, controller = key
    ratio = f"{figures['mean_s'] / paper_s:7.2f}" if paper_s else f"{'':7}"
    interval = f"({figures['low']:.1f}-{figures['high']:.1f})"
    return (
        f"{row:17}{powder:23}{target_mg:7g} {controller:16}{figures['true']:7.1f} {interval:>13} "
        f"{figures['reported']:7.1f}{figures['mean_mg']:8.2f}{figures['sd_mg']:6.2f}{figures['worst_mg']:7.1f}"
        f"{figures['steps']:6.1f}{figures['mean_s']:8.1f}{figures['p95_s']:7.1f}{ratio}"
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark; 2 for an unknown controller, plant or row, before any dose."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.dosing", description=__doc__)
    parser.add_argument("--plant", help="module:Class of a plant; none for the calibrated one")
    parser.add_argument("--controllers", default="paper,adaptive,oracle")
    parser.add_argument("--powders", default="", help="names, all if empty")
    parser.add_argument("--trials", type=int, default=200, help="per cell, in runs of ten")
    parser.add_argument("--rows", default=CALIBRATED, help="comma-separated; 'all', 'robust' and 'waiting' are groups")
    parser.add_argument("--json", type=Path)
    chosen = parser.parse_args(arguments)
    controllers = chosen.controllers.split(",")
    powders, rows = shipped_powders(), settings(chosen.plant)
    picked = list(powders) if not chosen.powders else chosen.powders.split(",")
    robust = [row for row in rows if row not in (CALIBRATED, REDO)]
    groups = {"all": list(rows), "robust": robust, "waiting": list(WAITING)}
    wanted = [row for part in chosen.rows.split(",") for row in groups.get(part, [part])]
    problems = [
        f"no controller is called '{name}'" for name in controllers if name not in {*CONTROLLERS, "oracle", UNWAITING}
    ]
    problems += [f"no powder is called '{name}'" for name in picked if name not in powders]
    problems += [f"no row is called '{row}'; there are {', '.join(rows)}" for row in wanted if row not in rows]
    problems += ["trials: at least one"] if chosen.trials < 1 else []
    if chosen.json is not None and not chosen.json.resolve().parent.is_dir():
        problems.append(f"there is no folder {chosen.json.parent} to write to")
    try:
        plant = load_plant(chosen.plant)
        for name in picked if not problems else ():
            plant.probe(powders[name], BalanceSpec())
    except PlantError as error:
        problems.append(str(error))
    if problems:
        print("\n".join(problems), file=sys.stderr)
        return 2
    cells = [
        (row, name, target_mg, controller)
        for row in wanted
        for name, target_mg in cells_of(row, picked)
        for controller in controllers
    ]
    doses = [min(DOSES_PER_RUN, chosen.trials - start) for start in range(0, chosen.trials, DOSES_PER_RUN)]
    jobs = [
        Job(row, rows[row], powders[name], target_mg, controller, run, count)
        for row, name, target_mg, controller in cells
        for run, count in enumerate(doses)
    ]
    print(HEAD)
    with ProcessPoolExecutor(os.cpu_count(), mp_context=get_context("spawn")) as pool:
        outcome = pool.map(work, jobs, chunksize=1)
        try:
            report(cells, ([trial for _ in doses for trial in next(outcome)] for _ in cells), chosen.json)
        except PlantError as error:
            pool.shutdown(cancel_futures=True)
            print(error, file=sys.stderr)
            return 2
    return 0


def report(cells: Sequence[tuple[str, str, float, str]], trials: Iterable[list[Trial]], path: Path | None) -> None:
    """Prints and keeps each cell as soon as its doses are done."""
    results: dict[str, dict[str, float]] = {}
    paper_s: dict[tuple[str, str, float], float] = {}
    for cell, of_cell in zip(cells, trials, strict=True):
        figures = summary(of_cell)
        if cell[3] == "paper":
            paper_s[cell[:3]] = figures["mean_s"]
        results[" | ".join(map(str, cell))] = figures
        print(line(cell, figures, paper_s.get(cell[:3])), flush=True)
        if path is not None:
            keep(path, results)


def keep(path: Path, results: dict[str, dict[str, float]]) -> None:
    """Add figures to those of a file, cell by cell: a benchmark that is stopped has kept what it finished."""
    kept = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    path.write_text(json.dumps(kept | results, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
