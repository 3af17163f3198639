"""How long a batch takes at the cell: `python -m benchmarks.throughput [--seeds 20] [--by-hand] [--again]`.

Dry runs of `synthesis_batch` and of `xrd_holders` with the shipped lab: seconds of cell time a run and an XRD holder,
how many of their samples are good, and what the skills took of it. With `--by-hand` a person changes containers; with
`--again` a run before has learnt what the lots' scoops bring and how they flow, as a real cell keeps it: no load is
used up to know it. Skills that go on beside each other count for each. The processor's time a sample is that of the run
alone, as in a study: a process prepares the lab and the motions once, and the first run plans on the way what the later
ones find; told is the median of the runs. Other work on the computer lengthens it by half or more.
"""

import argparse
import multiprocessing
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from shutil import copytree
from statistics import median

from benchmarks.figures import show, spread
from scuhand_bt.journal.reader import open_journal
from scuhand_bt.lab import Lab, load_lab, starter_lab
from scuhand_bt.motion import MotionPlanner
from scuhand_bt.recipe.plan import Plan, make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.run.observers import BatchObserver
from scuhand_bt.run.options import Options
from scuhand_bt.run.outcome import BatchResult
from scuhand_bt.run.prepared_motion import prepared_motion
from scuhand_bt.run.session import Session
from scuhand_bt.run.simulation import DryRun

RECIPES = ("synthesis_batch", "xrd_holders")
AGAIN = 10_000
"""Added to the seed of the run before."""
ACTIONS = """
SELECT json_extract(began.payload, '$.skill'), SUM(ended.time_s - began.time_s)
FROM entry AS ended JOIN entry AS began ON began.seq = ended.action
WHERE ended.kind = 'action_ended' GROUP BY 1
"""


@dataclass(frozen=True)
class Ran:
    """One dry run."""

    seed: int
    duration_s: float
    good: int
    samples: int
    wrong: tuple[str, ...]
    """Samples that are said to be good, and are not."""
    flagged: tuple[str, ...]
    """Those that are not said to be."""
    holders_s: tuple[float, ...]
    """What each XRD holder took, from the end of the sample before it."""
    skills_s: dict[str, float]
    cpu_s: float
    """What the processor spent on the run, its journal and its world's file."""


@cache
def prepared(folder: Path, name: str) -> tuple[Plan, Lab, MotionPlanner]:
    """A recipe of the lab in `folder`, for all runs of this process."""
    lab = load_lab(folder)
    plan = make_plan(load_recipe(folder / "recipes" / f"{name}.yaml", lab), lab)
    return plan, lab, prepared_motion(plan, lab)


def _run(folder: Path, name: str, seed: int, runs: str, before: Session | None = None) -> tuple[Session, BatchResult]:
    """A dry run that knows what the one `before` has learnt of the lots."""
    plan, lab, motion = prepared(folder, name)
    session = Session(plan, lab, Options(DryRun(seed), None, Path(runs)), motion)
    if before is not None:
        session.cell.powder_beliefs = before.cell.powder_beliefs
        for source, share in before.cell.believed.seen_yields.items():
            session.cell.believed.scoops_bring(source, share)
    try:
        return session, session.run(BatchObserver())
    finally:
        session.close()


def one_run(folder: Path, name: str, seed: int, *, again: bool) -> Ran:
    """One dry run of it; the second one of these lots where it is done again."""
    prepared(folder, name)
    with tempfile.TemporaryDirectory() as runs:
        before = _run(folder, name, seed + AGAIN, runs)[0] if again else None
        began_s = time.process_time()
        session, result = _run(folder, name, seed, runs, before)
        cpu_s = time.process_time() - began_s
        with open_journal(session.journal.path) as (database, _):
            skills_s = dict(database.execute(ACTIONS).fetchall())
    samples = result.samples
    return Ran(
        seed,
        result.duration_s,
        sum(one.is_good for one in samples),
        len(samples),
        tuple(
            one.id
            for one in samples
            if one.is_good and abs((one.true_mg or 0.0) - (one.target_mg or 0.0)) > (one.tolerance_mg or 0.0)
        ),
        tuple(f"{one.id} ({one.code or one.verdict})" for one in samples if not one.is_good),
        tuple(one.duration_s for one in samples if one.container == "xrd_holder"),
        skills_s,
        cpu_s,
    )


@contextmanager
def lab_of(*, by_hand: bool) -> Iterator[Path]:
    """The shipped lab; a copy of it where a person changes containers."""
    if not by_hand:
        yield starter_lab()
        return
    with tempfile.TemporaryDirectory() as there:
        folder = Path(there)
        for part in ("robot", "skills", "trees", "recipes"):
            copytree(starter_lab() / part, folder / part)
        cell = folder / "robot" / "cell.yaml"
        cell.write_text(cell.read_text(encoding="utf-8").replace("driver: carousel", "driver: operator"), "utf-8")
        yield folder


def tell(name: str, ran: Sequence[Ran]) -> dict[str, float]:
    """Print what the runs of a recipe came to; its figures."""
    print(f"{name}: {spread([one.duration_s for one in ran], 's')}")
    print(f"  a holder: {spread([s for one in ran for s in one.holders_s], 's')}")
    for one in ran:
        print(f"  seed {one.seed}: {one.duration_s:.0f} s, {one.good} of {one.samples} good", *one.flagged, *one.wrong)
    taken: Counter[str] = Counter()
    for one in ran:
        taken.update({skill: took_s / len(ran) for skill, took_s in one.skills_s.items()})
    print("  skills: " + ", ".join(f"{skill} {took_s:.0f} s" for skill, took_s in taken.most_common(8)))
    holders_s = [took_s for one in ran for took_s in one.holders_s]
    return {
        f"{name}_worst_s": max(one.duration_s for one in ran),
        f"{name}_mean_s": sum(one.duration_s for one in ran) / len(ran),
        f"{name}_holder_mean_s": sum(holders_s) / len(holders_s),
        f"{name}_cpu_ms_a_sample": median(1000 * one.cpu_s / one.samples for one in ran),
        f"{name}_not_good": sum(one.samples - one.good for one in ran),
        f"{name}_wrongly_good": sum(len(one.wrong) for one in ran),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--recipes", nargs="+", default=RECIPES)
    parser.add_argument("--by-hand", action="store_true")
    parser.add_argument("--again", action="store_true", help="a run before has learnt of these lots")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.seeds)
    figures: dict[str, float] = {}
    context = multiprocessing.get_context("spawn")
    with lab_of(by_hand=options.by_hand) as folder, ProcessPoolExecutor(options.workers, mp_context=context) as pool:
        for name in options.recipes:
            figures |= tell(name, list(pool.map(partial(one_run, folder, name, again=options.again), seeds)))
    goals = {
        "synthesis_batch_worst_s": "<= 2700" if options.by_hand else "<= 900",
        "synthesis_batch_not_good": "0",
        "synthesis_batch_wrongly_good": "0",
        "xrd_holders_holder_mean_s": "<= 24",
        "xrd_holders_cpu_ms_a_sample": "<= 33",
        "xrd_holders_wrongly_good": "0",
    }
    show("Throughput", figures, goals, options.json)


if __name__ == "__main__":
    main()
