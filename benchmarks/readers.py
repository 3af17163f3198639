"""What reading a long run takes: `python -m benchmarks.readers [--samples 5000] [--journal FILE] [--json FILE]`.

Peak memory and seconds of the processor of `show` and `export` on the journal of so many samples. It is grown from a
dry run of `GROWN_FROM` samples: all that its jobs wrote comes again and again, with numbers, names and times of their
own, in one whole chain. `--journal` reads one that there is.
"""

import argparse
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from benchmarks.batch import generated_recipe
from benchmarks.figures import show
from scuhand_bt.journal.events import JobStarted
from scuhand_bt.journal.hash_chain import COLUMNS, GENESIS, Entry, digest
from scuhand_bt.journal.reader import open_journal
from scuhand_bt.journal.run_events import Ended
from scuhand_bt.journal.store import Store
from scuhand_bt.lab import load_lab, starter_lab
from scuhand_bt.recipe.plan import make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.run.observers import BatchObserver
from scuhand_bt.run.options import Options
from scuhand_bt.run.session import Session
from scuhand_bt.run.simulation import DryRun

GROWN_FROM = 100
READERS = {
    "show": ("show",),
    "show_json": ("show", "--json"),
    "export_json": ("export", "--json"),
    "export_csv": ("export", "--csv"),
}
GOAL_MB = 200
_NAME = re.compile(r"\bs(\d{5})\b")
"""Of a sample, wherever it stands."""


def short_run(folder: Path) -> Path:
    """The journal of one dry run."""
    lab = load_lab(starter_lab())
    plan = make_plan(load_recipe(generated_recipe(folder, GROWN_FROM), lab), lab)
    session = Session(plan, lab, Options(DryRun(1), None, folder))
    session.run(BatchObserver())
    session.close()
    return session.journal.path


def grown(journal: Path, path: Path, copies: int) -> Path:
    """A journal in which all that the jobs of another one wrote stands so many times."""
    with open_journal(journal) as (database, _):
        found = [Entry(*row) for row in database.execute(f"SELECT {COLUMNS} FROM entry ORDER BY seq")]
    store = Store(path, durable=False)
    last = GENESIS
    for some in _batches(found, copies):
        rows = []
        for entry in some:
            last = digest(last, entry)
            rows.append((entry, last))
        store.add(rows)
    store.close()
    return path


def _batches(found: list[Entry], copies: int) -> Iterator[list[Entry]]:
    """What is before the jobs, their entries so many times, and what is behind them."""
    first = next(number for number, one in enumerate(found) if one.kind == JobStarted.KIND)
    behind = next(number for number, one in enumerate(found) if one.kind == Ended.KIND)
    within, lasts_s = found[first:behind], found[behind - 1].time_s
    yield found[:first]
    shift = 0
    for copy in range(copies):
        shift = copy * len(within)
        yield [_again(one, shift, copy * lasts_s, copy * GROWN_FROM) for one in within]
    yield [_again(one, shift, copies * lasts_s, 0) for one in found[behind:]]


def _again(one: Entry, shift: int, later_s: float, names: int) -> Entry:
    def moved(seq: int | None) -> int | None:
        return None if seq is None else seq + shift

    payload = _NAME.sub(lambda name: f"s{int(name[1]) + names:05d}", one.payload)
    return one._replace(
        seq=one.seq + shift,
        job=moved(one.job),
        action=moved(one.action),
        time_s=one.time_s + later_s,
        payload=payload,
    )


def cost(*arguments: str) -> tuple[float, float]:
    """Peak memory [MB] and seconds of the processor of one command, by itself: a child's of a child counts as well."""
    used = "import resource, subprocess, sys; subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL, check=True); "
    used += "u = resource.getrusage(resource.RUSAGE_CHILDREN); print(u.ru_maxrss / 1024, u.ru_utime + u.ru_stime)"
    command = [sys.executable, "-c", used, sys.executable, "-m", "scuhand_bt", *arguments]
    memory_mb, cpu_s = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
    return float(memory_mb), float(cpu_s)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=5000)
    parser.add_argument("--journal", type=Path)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        journal = options.journal
        if journal is None:
            (folder / "runs").mkdir()
            copies = options.samples // GROWN_FROM
            journal = grown(short_run(folder), folder / "runs" / "grown.sqlite", copies)
        figures = {"journal_mb": journal.stat().st_size / 2**20}
        for what, arguments in READERS.items():
            figures[f"{what}_mb"], figures[f"{what}_cpu_s"] = cost(*arguments, str(journal))
    show("Readers", figures, {f"{what}_mb": f"< {GOAL_MB}" for what in READERS}, options.json)


if __name__ == "__main__":
    main()
