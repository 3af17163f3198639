"""Every fault at three moments of a dose: `python -m benchmarks.faults [--seeds 3] [--json FILE]`."""

import argparse
import json
import tempfile
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.table import Table

from harness.fault_matrix import FAULTS, MOMENTS, Matrix


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--controller", default="adaptive")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    outcomes = []
    with tempfile.TemporaryDirectory() as folder:
        matrix = Matrix(Path(folder), controller=given.controller)
        for seed in range(given.seeds):
            moments = matrix.moments(seed)
            outcomes += [matrix.run(fault, moment, at_s, seed) for fault in FAULTS for moment, at_s in moments.items()]
    table = Table("fault", *MOMENTS, show_edge=False)
    for fault in FAULTS:
        cells = []
        for moment in MOMENTS:
            here = [outcome for outcome in outcomes if (outcome.fault, outcome.moment) == (fault, moment)]
            cells.append("\n".join(sorted({f"{o.code}{' WRONG: ' * bool(o.wrong)}{'; '.join(o.wrong)}" for o in here})))
        table.add_row(fault, *cells)
    console = Console(width=180)
    console.print(table)
    good = sum(not outcome.wrong for outcome in outcomes)
    console.print(f"{good} of {len(outcomes)} runs recovered, or ended safe with the right code.")
    if given.json is not None:
        given.json.write_text(json.dumps([asdict(outcome) for outcome in outcomes], indent=1) + "\n")


if __name__ == "__main__":
    main()
