"""The paper's Tables I and II beside the simulation: its controllers on the simulated powders.

    python -m benchmarks.calibration [--trials 200] [--write]

Success is by the reported mass, as in the paper; the last lines count what agrees. `--write` replaces the
table in docs/calibration.md.
"""

import argparse
import os
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.stats import binom

from benchmarks.rig import DOSES_PER_RUN, TOLERANCE_MG, Setting, Trial, run_of_doses, shipped_powders
from scuhand_bt.dosing.controller import Departure

PAGE = Path(__file__).parent.parent / "docs" / "calibration.md"
BEGIN, END = "<!-- tables -->\n", "<!-- end of tables -->\n"
PAPERS_TRIALS = 10
TABLES_IMPLY = frozenset(Departure) - {Departure.GUARD}
"""The departures from the paper's listing that its own tables bear witness to (docs/calibration.md)."""
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
    def agrees(self) -> bool:
        return agrees(self.cell, self.rate)

    @property
    def far(self) -> list[str]:
        """Which of mean steps and time are too far from the paper's."""
        pairs = {"steps": (self.steps, self.cell.steps), "time": (self.time_s, self.cell.time_s)}
        return [name for name, pair in pairs.items() if far(*pair) and self.cell.misprint != name]

    def row(self) -> str:
        cell = self.cell
        dagger = {name: "†" if cell.misprint == name else "" for name in ("mass", "time")}
        mass = f"{self.masses_mg.mean():.1f} ± {self.masses_mg.std():.2f}"
        shown = {"steps": f"{self.steps:.1f}", "time": f"{self.time_s:.1f}"}
        shown |= {name: f"**{shown[name]}**" for name in self.far}
        return (
            f"| {cell.label} | {cell.target_mg:g} mg | {PAPERS_TRIALS * self.rate:.1f} ({cell.successes}) "
            f"| {'yes' if self.agrees else '**no**'} | {mass} ({cell.mass_mg:g}{dagger['mass']} ± {cell.sd_mg:g}) "
            f"| {shown['steps']} ({cell.steps}) | {shown['time']} ({cell.time_s:g}{dagger['time']}) |"
        )


HEAD = (
    "| powder | target | success of 10 | agrees | mass [mg] | steps | time [s] |",
    "| --- | --- | --- | --- | --- | --- | --- |",
)


def count(results: Sequence[Result]) -> str:
    """What agrees of the 15 cells, in a sentence."""
    agreeing = sum(result.agrees for result in results)
    away = [f"{result.cell.label} {result.cell.target_mg:g} mg ({', '.join(result.far)})" for result in results]
    away = [text for text, result in zip(away, results, strict=True) if result.far]
    return (
        f"{agreeing} of {len(results)} cells agree in success; steps and times farther than {FAR:.0%} from the "
        f"paper's: {'; '.join(away) or 'none'}."
    )


def simulated(cell: Cell, run: int, doses: int) -> list[Trial]:
    return run_of_doses(
        shipped_powders()[cell.powder], cell.target_mg, cell.controller, run, Setting(departures=TABLES_IMPLY), doses
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table and the counts; 2 for a wrong number of trials."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.calibration", description=__doc__)
    parser.add_argument("--trials", type=int, default=200, help="per cell, in runs of ten")
    parser.add_argument("--write", action="store_true", help="replace the table in docs/calibration.md")
    chosen = parser.parse_args(arguments)
    if chosen.trials < 1:
        parser.error("trials: at least one")
    doses = [min(DOSES_PER_RUN, chosen.trials - start) for start in range(0, chosen.trials, DOSES_PER_RUN)]
    cells = (*TABLES, *FINE)
    jobs = [(cell, run, count) for cell in cells for run, count in enumerate(doses)]
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
