"""What a study costs: `python -m benchmarks.studies [--doses 2000] [--dask] [--json FILE]`.

Trials of eight XRD holders, each on a cell of its own, as `scuhand-bt study` runs them: by one process, by two, and
with `--dask` by two workers of a Dask cluster on this computer. `…_s` is everything from the first process on, its
imports and the motions that each worker prepares included; doses a second are counted once every worker has ended a
trial. All of it is only of worth on a computer that does nothing else: the load before is told beside it.
"""

import argparse
import os
import resource
import time
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from importlib.util import find_spec
from itertools import islice
from pathlib import Path

from benchmarks.figures import show
from scuhand_bt.lab import starter_lab
from scuhand_bt.study.pool import all_trials, executor_of
from scuhand_bt.study.trial import Setup

RECIPE = starter_lab() / "recipes" / "xrd_holders.yaml"
WORKERS = 2


def rate(executor: Executor, workers: int, trials: int) -> tuple[float, int]:
    """Doses a second once every worker may have ended its first trial, and all doses that were made."""
    setup = Setup(RECIPE, starter_lab())
    found = all_trials([(setup, seed) for seed in range(trials)], executor)
    doses = sum(len(one.samples) for _, one in islice(found, workers))
    began_s, first = time.perf_counter(), doses
    doses += sum(len(one.samples) for _, one in found)
    return (doses - first) / (time.perf_counter() - began_s), doses


def children_cpu_s() -> float:
    """Of all processes that were waited for."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def by_processes(workers: int, trials: int) -> dict[str, float]:
    """A study by so many processes."""
    began_s, before_s = time.perf_counter(), children_cpu_s()
    with executor_of(workers, None) as executor:
        doses_per_s, doses = rate(executor, workers, trials)
    cpu_s = children_cpu_s() - before_s
    return {
        f"workers_{workers}_doses": doses,
        f"workers_{workers}_s": time.perf_counter() - began_s,
        f"workers_{workers}_doses_per_s": doses_per_s,
        f"workers_{workers}_cpu_ms_per_dose": 1000 * cpu_s / doses,
    }


@contextmanager
def cluster() -> Iterator[str]:
    """A Dask scheduler with workers of one thread each, and its address."""
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=WORKERS, threads_per_worker=1, processes=True, dashboard_address=None, host="127.0.0.1"
    ) as made:
        yield made.scheduler_address


def by_dask(trials: int) -> dict[str, float]:
    """The same trials by a Dask cluster of as many workers."""
    with cluster() as address, executor_of(None, address) as executor:
        doses_per_s, _ = rate(executor, WORKERS, trials)
    return {"dask_doses_per_s": doses_per_s}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--doses", type=int, default=2000)
    parser.add_argument("--dask", action="store_true", help="also by a Dask cluster (extra `dask`)")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    if options.dask and find_spec("distributed") is None:
        parser.error("there is no Dask here: pip install '.[dask]'")
    trials = options.doses // 8
    figures = {"load_average_before": os.getloadavg()[0]}
    figures |= by_processes(1, max(2, trials // 2))
    figures |= by_processes(WORKERS, trials)
    figures["workers_ratio"] = figures["workers_2_doses_per_s"] / figures["workers_1_doses_per_s"]
    if options.dask:
        figures |= by_dask(trials)
        figures["dask_over_pool"] = figures["workers_2_doses_per_s"] / figures["dask_doses_per_s"]
    goals = {"workers_2_s": "< 60 for 2000 doses", "workers_ratio": ">= 1.7", "dask_over_pool": "<= 1.25"}
    show("A study", figures, goals, options.json)


if __name__ == "__main__":
    main()
