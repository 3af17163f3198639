"""Which lumps of titanium dioxide the paper's Table I can tell apart, by their kind and their mean mass.

    python -m benchmarks.lumps [--doses 40]

The paper's controller doses the shipped titanium dioxide with lumps of three kinds (exponential masses, as shipped;
exponential ones that grow with the cube of the gap; equal ones) and of a range of mean masses. A setting's likelihood
is that of the mean, the spread and the successes that the paper has of ten doses, at each of its four targets, among
tens drawn from the simulated ones (synthetic likelihood: Wood, Nature 466, 1102, 2010). What follows for trials stands
in docs/calibration.md.
"""

import argparse
import math
from collections.abc import Sequence
from itertools import product

import numpy as np

from benchmarks.calibration import PAPERS_TRIALS, TABLES, TITANIUM, Cell
from benchmarks.rig import DOSES_PER_RUN, TABLES_IMPLY, TOLERANCE_MG, Setting, run_of_doses, shipped_powders
from scuhand_bt.sim.powder import OurPowderFlow
from scuhand_bt.specs import Powder

MASSES_MG = (1.0, 1.7, 2.9, 5.0, 8.5)
KINDS = {"exponential": (0.0, None), "gap": (3.0, None), "equal": (0.0, "benchmarks.lumps:EqualLumps")}
"""Exponent of the gap, and physics."""
TENS = 4000
LEAST_MG = 0.01
LEAST_SD = (0.1, 0.05, 0.3)
"""Of a ten's mean [mg], logarithm of its spread, and successes: no simulation of a few doses is surer."""


class EqualLumps:
    """A plant whose lumps have one mass each."""

    def flow(self, powder: Powder) -> OurPowderFlow:
        return OurPowderFlow(powder, equal_lumps=True)


def masses_of(cell: Cell, kind: str, lump_mg: float, doses: int) -> np.ndarray:
    """What is reported of so many doses [mg]."""
    exponent, plant = KINDS[kind]
    powder = shipped_powders()[cell.powder]
    figures = {"surge_mg": lump_mg, "surge_exponent": exponent}
    powder = powder.model_copy(update={"simulation": powder.simulation.model_copy(update=figures)})
    setting = Setting(plant=plant, departures=TABLES_IMPLY)
    errors = [
        trial.reported_error_mg
        for run in range(math.ceil(doses / DOSES_PER_RUN))
        for trial in run_of_doses(powder, cell.target_mg, cell.controller, run, setting)
    ]
    return cell.target_mg + np.array([error for error in errors if math.isfinite(error)])


def log_likelihood(cell: Cell, masses_mg: np.ndarray) -> float:
    """Of the paper's mean, spread and successes, as normal as those of tens drawn from these masses."""
    tens = np.random.default_rng(1).choice(masses_mg, (TENS, PAPERS_TRIALS))
    logs = np.log(np.maximum(tens.std(axis=1, ddof=1), LEAST_MG))
    successes = np.sum(np.abs(tens - cell.target_mg) <= TOLERANCE_MG, axis=1)
    drawn = np.column_stack([tens.mean(axis=1), logs, successes])
    covariance = np.cov(drawn, rowvar=False) + np.diag(np.square(LEAST_SD))
    off = np.array([cell.mass_mg, math.log(cell.sd_mg), cell.successes]) - drawn.mean(axis=0)
    _, log_det = np.linalg.slogdet(2.0 * math.pi * covariance)
    return float(-0.5 * (off @ np.linalg.solve(covariance, off) + log_det))


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a row for each kind and mass: the likelihood's logarithm, and each target's mean error and spread."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.lumps", description=__doc__)
    parser.add_argument("--doses", type=int, default=40, help="of each setting at each target, in runs of ten")
    asked = parser.parse_args(arguments)
    cells = [cell for cell in TABLES if cell.powder == TITANIUM]
    print("| lumps | mean mass | log likelihood |", *(f"{cell.target_mg:g} mg |" for cell in cells))
    print("|", " | ".join(["---"] * (3 + len(cells))), "|")
    for kind, lump_mg in product(KINDS, MASSES_MG):
        doses = [(cell, masses_of(cell, kind, lump_mg, asked.doses)) for cell in cells]
        likely = sum(log_likelihood(*one) for one in doses)
        came = " | ".join(f"{mg.mean() - cell.target_mg:+.1f} ± {mg.std(ddof=1):.1f}" for cell, mg in doses)
        print(f"| {kind} | {lump_mg:g} mg | {likely:.0f} | {came} |", flush=True)


if __name__ == "__main__":
    main()
