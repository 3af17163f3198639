"""Runs on the real drivers, killed while they scoop and resumed: is the cone what the next program takes it for?

    python -m benchmarks.roller [--batches 20] [--kills 10] [--seed 0] [--lanes 1]

In real time, over twins in a process of their own (`harness/roller_kill.py`); a kill takes a quarter of a minute, most
of it waiting. So several batches may run beside each other, each a lane that wants half a core at most: on a computer
that is too busy the twins answer late, and runs end safe instead of scooping; `ended_safe_and_resumed` tells why they
did.
"""

import argparse
import json
import multiprocessing
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

from harness.roller_kill import Tally, kill_while_scooping

RESULTS = Path(__file__).with_name("roller_results.json")


def one_batch(kills: int, seed: int) -> Tally:
    """In a folder of its own."""
    with tempfile.TemporaryDirectory(prefix="roller-") as folder:
        return kill_while_scooping(Path(folder) / "batch", kills, seed)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--batches", type=int, default=20)
    parser.add_argument("--kills", type=int, default=10, help="in each batch")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--lanes", type=int, default=1, help="batches beside each other")
    parser.add_argument("--json", type=Path, default=RESULTS)
    given = parser.parse_args()
    tally, began_s = Tally(), time.monotonic()
    with ProcessPoolExecutor(given.lanes, multiprocessing.get_context("spawn")) as lanes:
        batches = [lanes.submit(one_batch, given.kills, seed) for seed in range(given.seed, given.seed + given.batches)]
        for batch in as_completed(batches):
            tally.add(batch.result())
            found = {
                "kills": tally.kills,
                "batches": tally.batches,
                "rims_mm": [round(tally.narrowest_mm, 2), round(tally.widest_mm, 2)],
                "rims_at_kills_mm": tally.at_kills_mm,
                "worst_belief_mm": round(tally.worst_belief_mm, 3),
                "dosed_mg": tally.dosed_mg,
                "doses_ended": tally.doses_ended,
                "ended_safe_and_resumed": tally.ended_safe,
                "problems": tally.problems,
                "took_s": round(time.monotonic() - began_s),
            }
            given.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
            print(f"{tally.kills} kills in {tally.batches} batches, problems: {tally.problems}", flush=True)


if __name__ == "__main__":
    main()
