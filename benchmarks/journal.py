"""What a journal costs: `python -m benchmarks.journal [--runs 5] [--mutations 1000] [--json FILE]`.

Runs `synthesis_batch.yaml` dry, in turns with a journal and with one that writes nothing, and times what is spent
within the journal and within the file of the simulated world; then once with every entry forced onto the disk.
Last, it damages many copies of a journal, and sees that nothing takes one for whole that is not.
"""

import argparse
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from typing import Any
from unittest.mock import patch

from benchmarks.figures import show
from harness.damaged_journals import mutations
from scuhand_bt.devices.interfaces import Reading
from scuhand_bt.events.entry import Event, Note
from scuhand_bt.journal.reader import read
from scuhand_bt.journal.writer import Journal
from scuhand_bt.lab import Lab, load_lab, starter_lab
from scuhand_bt.motion import MotionPlanner
from scuhand_bt.recipe.plan import Plan, make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.run import session
from scuhand_bt.run.observers import BatchObserver
from scuhand_bt.run.options import Options
from scuhand_bt.run.prepared_motion import prepared_motion
from scuhand_bt.run.session import Session
from scuhand_bt.run.simulation import DryRun
from scuhand_bt.sim.world import World

OWN_OF = 20_000
"""Empty calls that a stopwatch's own cost is measured by."""
RECIPE = starter_lab() / "recipes" / "synthesis_batch.yaml"
_WRITING = (
    *("job_started", "job_resumed", "job_ended", "action_started", "action_ended"),
    *("flush", "event"),
)


class NoJournal(Journal):
    """Does what a run needs of its journal, its world's file included, and writes nothing."""

    def weighed(self, reading: Reading) -> None:
        pass

    def _append(self, event: Event | Note, *, with_state: bool = False, frames: bytes | None = None) -> int:
        self.before_commit()
        return 0


class Stopwatch:
    """The time spent within some methods, without that within some others that they call, and without its own."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self.spent_s = {"journal": 0.0, "world": 0.0}
        self._clock = clock
        self._within: list[str] = []
        self._since_s = 0.0
        self.own_s = 0.0
        nothing = self.timing("journal", lambda: None)
        for _ in range(OWN_OF):
            nothing()
        self.own_s = self.spent_s["journal"] / OWN_OF
        self.spent_s["journal"] = 0.0

    def timing(self, what: str, method: Callable[..., Any]) -> Callable[..., Any]:
        def timed(*args: Any, **kwargs: Any) -> Any:
            self.spent_s[what] -= self.own_s
            self._turn()
            self._within.append(what)
            try:
                return method(*args, **kwargs)
            finally:
                self._turn()
                self._within.pop()

        return timed

    def _turn(self) -> None:
        now_s = self._clock()
        if self._within:
            self.spent_s[self._within[-1]] += now_s - self._since_s
        self._since_s = now_s


@contextmanager
def watched(stopwatch: Stopwatch) -> Iterator[None]:
    """Every write of the journal and of the world's file, timed."""
    patches = [patch.object(Journal, name, stopwatch.timing("journal", getattr(Journal, name))) for name in _WRITING]
    patches.append(patch.object(World, "save", stopwatch.timing("world", World.save)))
    for one in patches:
        one.start()
    try:
        yield
    finally:
        for one in patches:
            one.stop()


class Bench:
    """One batch, planned once."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._lab: Lab = load_lab(starter_lab())
        self._plan: Plan = make_plan(load_recipe(RECIPE, self._lab), self._lab)
        began_s = time.process_time()
        self._motion: MotionPlanner = prepared_motion(self._plan, self._lab)
        self.planning_s = time.process_time() - began_s
        self.journal = Path()

    def run(self, clock: Callable[[], float] = time.process_time) -> float:
        """Seconds of one dry run, without the planning before it."""
        began_s = clock()
        run = Session(self._plan, self._lab, Options(DryRun(), None, self._folder), self._motion)
        run.run(BatchObserver())
        run.close()
        self.journal = run.journal.path
        return clock() - began_s


def durable(path: Path, **kwargs: Any) -> Journal:
    return Journal(path, durable=True)


def virtual_s(journal: Path) -> float:
    """How long the run would have taken on a real cell."""
    return float(read(journal, "entry")[-1]["time_s"])


def overhead(bench: Bench, runs: int) -> dict[str, float]:
    """Alternating runs with a journal and without, and what the stopwatch says of the former."""
    bench.run()
    whole, without, inside, world = [], [], [], []
    for _ in range(runs):
        whole.append(bench.run())
        with patch.object(session, "Journal", NoJournal):
            without.append(bench.run())
        stopwatch = Stopwatch(time.process_time)
        with watched(stopwatch):
            timed_s = bench.run()
        inside.append(stopwatch.spent_s["journal"] / timed_s)
        world.append(stopwatch.spent_s["world"] / timed_s)
    run_s, bare_s = median(whole), median(without)
    stopwatch = Stopwatch(time.perf_counter)
    with patch.object(session, "Journal", durable), watched(stopwatch):
        durable_s = bench.run(time.perf_counter)
    return {
        "planning_cpu_s": bench.planning_s,
        "run_cpu_s": run_s,
        "run_without_journal_cpu_s": bare_s,
        "journal_percent_of_run": 100 * median(inside),
        "journal_percent_by_difference": 100 * (run_s - bare_s) / run_s,
        "journal_percent_of_dry_run": 100 * median(inside) * run_s / (run_s + bench.planning_s),
        "world_file_percent_of_run": 100 * median(world),
        "durable_run_wall_s": durable_s,
        "durable_journal_wall_s": stopwatch.spent_s["journal"],
        "durable_journal_percent_of_run": 100 * stopwatch.spent_s["journal"] / durable_s,
        "virtual_run_s": virtual_s(bench.journal),
        "journal_kb": bench.journal.stat().st_size / 1024,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--mutations", type=int, default=1000)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        bench = Bench(folder / "runs")
        figures = overhead(bench, options.runs)
        figures |= mutations(bench.journal, folder / "mutated", options.mutations)
    goals = {
        "journal_percent_of_dry_run": "< 5",
        "mutations_broken": "0",
        "mutations_unnoticed": "0",
    }
    show("The journal", figures, goals, options.json)


if __name__ == "__main__":
    main()
