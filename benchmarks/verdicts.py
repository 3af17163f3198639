"""The falsification suite: `python -m benchmarks.verdicts [--doses 125] [--worlds NAME …] [--json FILE]`.

Worlds that try to make the product say a false 'in tolerance' (`harness.worlds`), on the shipped recipes and some
more, as dry runs. It is judged by the simulated world's true masses, after the run. Ends with 1 if any container was
reported good and was not, or a run with exit code 0 left one out of tolerance; worlds with something that no weighing
can tell are shown below the others, and not counted.
"""

import argparse
import json
import math
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path

from rich.console import Console
from rich.table import Table

from harness.falsify import Falsifier, Tally
from harness.worlds import BY_NAME, WORLDS

DOSES = 125
"""Of each world; ten thousand in all."""
_falsifier: Falsifier


def _begin(folder: str, controller: str | None) -> None:
    global _falsifier
    _falsifier = Falsifier(Path(folder), controller=controller)


def _run(name: str, doses: int, first_seed: int) -> Tally:
    return _falsifier.run(BY_NAME[name], doses, first_seed)


def show(tallies: list[Tally], console: Console) -> None:
    """The table, in the order of the registry."""
    sound_s = next((tally.seconds_per_dose for tally in tallies if tally.world == "sound"), math.nan)
    columns = ("world", "doses", "good", "FALSE GOOD", "worst beyond", "flagged (truly good)", "no dose", "time")
    for title, has_limit in (("Worlds", False), ("Beyond any weighing", True)):
        table = Table(*columns, "codes", title=title, show_edge=False)
        for tally in tallies:
            if (BY_NAME[tally.world].limit is not None) != has_limit:
                continue
            false = f"{len(tally.false_goods)}" + f", {len(tally.false_zeros)} runs" * bool(tally.false_zeros)
            slower = tally.seconds_per_dose / sound_s
            table.add_row(
                tally.world,
                str(tally.doses),
                str(tally.good),
                f"[red]{false}" if tally.false_goods else false,
                f"{tally.worst_mg:.1f} mg" if tally.false_goods else "",
                f"{tally.flagged.total()} ({tally.good_flagged})",
                str(tally.failed.total()),
                "" if math.isnan(slower) else f"{slower:.2f}",
                ", ".join(f"{code} {count}" for code, count in (tally.flagged + tally.failed).most_common(4)),
            )
        if table.row_count:
            console.print(table)


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--doses", type=int, default=DOSES, help="of each world")
    parser.add_argument("--worlds", nargs="+", choices=BY_NAME, default=list(BY_NAME), metavar="NAME")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--controller")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--list", action="store_true", help="name the worlds, and what is wrong in them")
    given = parser.parse_args()
    console = Console(width=200)
    if given.list:
        for world in WORLDS:
            console.print(f"{world.name:24} {world.summary}" + f" ({world.limit})" * (world.limit is not None))
        return 0
    tallies: dict[str, Tally] = {}
    with (
        tempfile.TemporaryDirectory() as folder,
        ProcessPoolExecutor(given.processes, get_context("spawn"), _begin, (folder, given.controller)) as pool,
    ):
        waiting = {pool.submit(_run, name, given.doses, given.first_seed): name for name in given.worlds}
        for done in as_completed(waiting):
            tally = tallies[waiting[done]] = done.result()
            print(f"{tally.world}: {tally.doses} doses, {len(tally.false_goods)} false goods", file=sys.stderr)
    in_order = [tallies[name] for name in BY_NAME if name in tallies]
    show(in_order, console)
    counted = [tally for tally in in_order if BY_NAME[tally.world].limit is None]
    false_goods = sum(len(tally.false_goods) for tally in counted)
    false_zeros = sum(len(tally.false_zeros) for tally in counted)
    broken = [what for tally in in_order for what in tally.broken]
    doses = sum(tally.doses for tally in counted)
    console.print(
        f"{false_goods} false goods in {doses} doses; {false_zeros} runs with exit code 0 that were not good."
    )
    console.print(*(f"broken: {what}" for what in broken), sep="\n")
    if given.json is not None:
        given.json.write_text(json.dumps([tally.values() for tally in in_order], indent=1) + "\n", encoding="utf-8")
    return int(false_goods > 0 or false_zeros > 0 or bool(broken))


if __name__ == "__main__":
    raise SystemExit(main())
