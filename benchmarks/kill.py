"""Kill a dry run again and again, resume it until it is done, and hold the end against the world's true masses.

    python -m benchmarks.kill [--kills 500] [--recipe recipes/synthesis_batch.yaml] [--seed 0] [--json FILE]
    python -m benchmarks.kill --rehearse --kills 100 --a-batch 10 --recipe recipes/xrd_holders.yaml

With `--rehearse` it is a rehearsal, over the wire and in real time (about half a minute a kill), whose twins' process
is killed now and then, too; the end is judged by the world's file, and not by the journal.

Some tens of kills are made on one batch before it is let end; then the next seed begins.
"""

import argparse
import json
import random
import sys
import tempfile
import time
from dataclasses import asdict
from pathlib import Path

from harness.kill import Kill, Tally, at_any_time, in_rehearsals, kill_until_done, make_batch, run_child
from scuhand_bt.motion import MotionPlanner


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--kills", type=int, default=500)
    parser.add_argument("--a-batch", type=int, default=20, help="kills of one batch before it is let end")
    parser.add_argument("--recipe", type=Path, default=Path("recipes/synthesis_batch.yaml"))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--rehearse", action="store_true")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    rng, tally, seed = random.Random(given.seed), Tally(), given.seed
    motion: MotionPlanner | None = None
    whole_s = 0.0
    while tally.kills < given.kills:
        with tempfile.TemporaryDirectory() as folder:
            batch = make_batch(given.recipe, Path(folder) / "runs", seed, motion)
            motion = batch.motion
            batch.rehearses = given.rehearse
            if not (whole_s or given.rehearse):
                began = time.monotonic()
                run_child(make_batch(given.recipe, Path(folder) / "whole", seed, motion), None, Kill())
                whole_s = time.monotonic() - began
            count = min(given.a_batch, given.kills - tally.kills)
            kills = in_rehearsals(rng, count) if given.rehearse else at_any_time(rng, whole_s, given.a_batch)
            kill_until_done(batch, kills, tally)
        seed += 1
        print(
            f"\r{tally.kills} kills, {tally.batches} batches, {len(tally.problems)} problems",
            end="",
            file=sys.stderr,
        )
        if given.json:  # after each batch: a rehearsal takes its time, and may be ended
            given.json.write_text(json.dumps(asdict(tally), indent=1) + "\n", encoding="utf-8")
    print(file=sys.stderr)
    print(
        f"{tally.kills} kills of {given.recipe.name}: {tally.while_dosing} in a dose, {tally.while_resuming} resuming"
    )
    if given.rehearse:
        print(
            f"{tally.of_twins} of the twins, too; {tally.ended_safe} rehearsals ended safe by themselves, and went on"
        )
    print(f"{tally.doses} doses in {tally.batches} batches; worst recorded against true: {tally.worst_error_mg:.2f} mg")
    print(f"worst imbalance of mass: {tally.worst_imbalance_mg:.1e} mg")
    for problem in tally.problems:
        print(problem)
    sys.exit(bool(tally.problems))


if __name__ == "__main__":
    main()
