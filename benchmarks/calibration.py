"""The paper's Tables I and II beside the simulation: its controllers on the simulated powders.

    python -m benchmarks.calibration [--trials 200] [--write] [--departures implied]

Success and mass are the reported ones, as in the paper. Its figures are of ten trials: a simulated success agrees if a
binomial of its rate gives the paper's count within its central 95 %, a simulated mean and spread if they lie in the
95 % intervals of the paper's (Student's t, chi-square). The last lines count what agrees. `--write` replaces the
table in docs/calibration.md; `--departures` chooses those of `paper` from its listing (`Departure`, by name; `all`,
`none`, or `implied`, those that the tables bear witness to).
"""

import argparse
import math
import os
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.stats import binom, chi2, t

from benchmarks.rig import DOSES_PER_RUN, TABLES_IMPLY, TOLERANCE_MG, Setting, Trial, run_of_doses, shipped_powders
from scuhand_bt.specs import Departure

PAGE = Path(__file__).parent.parent / "docs" / "calibration.md"
BEGIN, END = "<!-- tables -->\n", "<!-- end of tables -->\n"
PAPERS_TRIALS = 10
FAR = 0.3
"""Mean steps and times are to be within this share of the paper's."""


class Cell(NamedTuple):
    """One cell of Tables I and II (Takahashi et al., ICRA 2026), and what is simulated for it."""

    label: str
    powder: str
    controller: str
    target_mg: float
    successes: int
    """Of ten."""
    mass_mg: float
    sd_mg: float
    steps: int
    time_s: float
    misprint: str = ""
    """The figure that the paper's others contradict: `mass` or `time`."""


BEADS, MSG, TITANIUM = "glass_beads", "monosodium_glutamate", "titanium_dioxide"
TABLES = (
    Cell("glass beads", BEADS, "paper", 20, 9, 20.0, 1.3, 8, 59),
    Cell("glass beads", BEADS, "paper", 50, 9, 49.9, 2.5, 9, 65),
    Cell("glass beads", BEADS, "paper", 500, 10, 498.6, 0.4, 19, 141),
    Cell("glass beads", BEADS, "paper", 3000, 10, 2998.8, 0.67, 19, 173),
    Cell("MSG", MSG, "paper", 20, 10, 18.6, 0.5, 14, 49, "time"),
    Cell("MSG", MSG, "paper", 50, 10, 43.9, 0.5, 17, 158, "mass"),
    Cell("MSG", MSG, "paper", 500, 8, 500.5, 1.9, 24, 205),
    Cell("MSG", MSG, "paper", 3000, 10, 2999.1, 1.5, 36, 327),
    Cell("titanium dioxide", TITANIUM, "paper", 20, 8, 20.2, 2.8, 13, 106),
    Cell("titanium dioxide", TITANIUM, "paper", 50, 5, 52.4, 3.5, 14, 123),
    Cell("titanium dioxide", TITANIUM, "paper", 500, 4, 503.5, 3.5, 19, 164),
    Cell("titanium dioxide", TITANIUM, "paper", 3000, 4, 3003.6, 2.8, 39, 344),
    Cell("beads, `direct_pid`", BEADS, "direct_pid", 20, 4, 16.2, 2.3, 90, 683),
    Cell("beads, `direct_pid`", BEADS, "direct_pid", 500, 10, 498.9, 0.8, 38, 369),
    Cell("beads, `direct_pid`", BEADS, "direct_pid", 3000, 0, 3423.0, 244.6, 11, 103),
)
FINE = tuple(
    cell._replace(label="titanium dioxide, fine", powder="titanium_dioxide_fine")
    for cell in TABLES
    if cell.powder == TITANIUM
)
"""The variant whose lumps shrink with the gap, held against the same cells."""


def agrees(cell: Cell, rate: float) -> bool:
    """Whether the paper's count lies in the two-sided 95 % region of a binomial with the simulated rate."""
    low, high = binom.ppf([0.025, 0.975], PAPERS_TRIALS, rate)
    return bool(low <= cell.successes <= high)


def mean_interval(cell: Cell) -> tuple[float, float]:
    """The two-sided 95 % interval [mg] of the mean that the paper's ten trials tell."""
    half_mg = float(t.ppf(0.975, PAPERS_TRIALS - 1)) * cell.sd_mg / math.sqrt(PAPERS_TRIALS)
    return cell.mass_mg - half_mg, cell.mass_mg + half_mg


def spread_interval(cell: Cell) -> tuple[float, float]:
    """The two-sided 95 % interval [mg] of the standard deviation that they tell, if masses are normal."""
    low, high = chi2.ppf([0.025, 0.975], PAPERS_TRIALS - 1)
    return cell.sd_mg * math.sqrt((PAPERS_TRIALS - 1) / high), cell.sd_mg * math.sqrt((PAPERS_TRIALS - 1) / low)


def far(simulated: float, papers: float) -> bool:
    return abs(simulated / papers - 1.0) > FAR


class Result(NamedTuple):
    """What the simulation came to in a cell."""

    cell: Cell
    rate: float
    masses_mg: np.ndarray
    steps: float
    time_s: float

    @classmethod
    def of(cls, cell: Cell, trials: Sequence[Trial]) -> "Result":
        errors_mg = np.array([trial.reported_error_mg for trial in trials])
        return cls(
            cell,
            float(np.mean(np.abs(errors_mg) <= TOLERANCE_MG)),
            cell.target_mg + errors_mg[np.isfinite(errors_mg)],
            float(np.mean([trial.steps for trial in trials])),
            float(np.mean([trial.duration_s for trial in trials])),
        )

    @property
    def misfits(self) -> list[str]:
        """Which of its figures do not agree with the paper's, the misprinted ones apart."""
        cell = self.cell
        low_mg, high_mg = mean_interval(cell)
        least_mg, most_mg = spread_interval(cell)
        wrong = {
            "success": not agrees(cell, self.rate),
            "mass": not low_mg <= self.masses_mg.mean() <= high_mg,
            "spread": not least_mg <= self.masses_mg.std(ddof=1) <= most_mg,
            "steps": far(self.steps, cell.steps),
            "time": far(self.time_s, cell.time_s),
        }
        return [name for name, is_wrong in wrong.items() if is_wrong and name != cell.misprint]

    def row(self) -> str:
        cell, misfits = self.cell, self.misfits
        low_mg, high_mg = mean_interval(cell)
        least_mg, most_mg = spread_interval(cell)
        figures = {
            "success": (f"{PAPERS_TRIALS * self.rate:.1f}", f"{cell.successes}", ""),
            "mass": (f"{self.masses_mg.mean():.1f}", f"{cell.mass_mg:g}", f": {low_mg:.1f} to {high_mg:.1f}"),
            "spread": (f"{self.masses_mg.std(ddof=1):.2f}", f"{cell.sd_mg:g}", f": {least_mg:.2f} to {most_mg:.2f}"),
            "steps": (f"{self.steps:.1f}", f"{cell.steps}", ""),
            "time": (f"{self.time_s:.0f}", f"{cell.time_s:g}", ""),
        }
        shown = [
            f"{f'**{ours}**' if name in misfits else ours} ({papers}{'†' if name == cell.misprint else interval})"
            for name, (ours, papers, interval) in figures.items()
        ]
        return f"| {cell.label} | {cell.target_mg:g} mg | {' | '.join(shown)} |"


HEAD = (
    "| powder | target | success of 10 | mean mass [mg] | its spread [mg] | steps | time [s] |",
    "| --- | --- | --- | --- | --- | --- | --- |",
)


def count(results: Sequence[Result]) -> str:
    """How many of the cells agree in what, in a sentence."""
    said = []
    for name in ("success", "mass", "spread", "steps", "time"):
        held = [result for result in results if result.cell.misprint != name]
        said.append(f"{name} {sum(name not in result.misfits for result in held)} of {len(held)}")
    return f"Cells that agree: {', '.join(said)}."


def simulated(cell: Cell, run: int, doses: int, departures: tuple[Departure, ...] = TABLES_IMPLY) -> list[Trial]:
    setting = Setting(departures=departures)
    return run_of_doses(shipped_powders()[cell.powder], cell.target_mg, cell.controller, run, setting, doses)


def departures_of(text: str) -> tuple[Departure, ...]:
    """The departures of an argument; ValueError for one that is not known."""
    groups: dict[str, tuple[Departure, ...]] = {"all": tuple(Departure), "none": (), "implied": TABLES_IMPLY}
    return groups[text] if text in groups else tuple(Departure(name) for name in text.split(","))


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table and the counts; 2 for a wrong number of trials."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.calibration", description=__doc__)
    parser.add_argument("--trials", type=int, default=200, help="per cell, in runs of ten")
    parser.add_argument("--write", action="store_true", help="replace the table in docs/calibration.md")
    parser.add_argument("--departures", default="implied", help="implied, all, none, or names with commas")
    chosen = parser.parse_args(arguments)
    if chosen.trials < 1:
        parser.error("trials: at least one")
    try:
        departures = departures_of(chosen.departures)
    except ValueError:
        parser.error(f"departures: implied, all, none, or some of {','.join(Departure)}")
    if chosen.write and departures != TABLES_IMPLY:
        parser.error("--write: the page's table is of the implied departures")
    doses = [min(DOSES_PER_RUN, chosen.trials - start) for start in range(0, chosen.trials, DOSES_PER_RUN)]
    cells = (*TABLES, *FINE)
    jobs = [(cell, run, count, departures) for cell in cells for run, count in enumerate(doses)]
    results = []
    with ProcessPoolExecutor(os.cpu_count(), mp_context=get_context("spawn")) as pool:
        outcome = pool.map(simulated, *zip(*jobs, strict=True))
        print("\n".join(HEAD))
        for cell in cells:
            results.append(Result.of(cell, [trial for _ in doses for trial in next(outcome)]))
            print(results[-1].row(), flush=True)
    counts = f"{count(results[: len(TABLES)])}\nWith fine titanium dioxide: {count(results[len(TABLES) :])}"
    print(counts)
    if chosen.write:
        before, rest = PAGE.read_text(encoding="utf-8").split(BEGIN)
        table = "\n".join([*HEAD, *(result.row() for result in results), "", counts, ""])
        PAGE.write_text(before + BEGIN + table + END + rest.split(END)[1], encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
