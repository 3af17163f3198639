"""Cut the power of dry runs at random moments, their devices changed by it, and hold the verdicts against the truth.

    python -m benchmarks.power_cuts [--cuts 300] [--seed 0] [--only outage.zero_moved] [--json FILE]

Some cuts are made on one batch before it is let end; then the next seed begins.
"""

import argparse
import json
import random
import sys
import tempfile
from pathlib import Path

from harness.power_cut import Tally, cut_until_done, make_power_batch
from scuhand_bt.motion import MotionPlanner
from scuhand_bt.sim.fault_rules import OUTAGES


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--cuts", type=int, default=300)
    parser.add_argument("--a-batch", type=int, default=5, help="cuts of one batch before it is let end")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", choices=["", *OUTAGES], help="what every cut does, and nothing else")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    rng, tally, seed = random.Random(given.seed), Tally(), given.seed
    motion: MotionPlanner | None = None
    while tally.cuts < given.cuts:
        with tempfile.TemporaryDirectory() as folder:
            batch = make_power_batch(Path(folder), seed, motion, given.only)
            motion = batch.motion
            cut_until_done(batch, rng, given.a_batch, tally)
        seed += 1
        print(f"\r{tally.cuts} cuts, {tally.batches} batches, {len(tally.problems)} problems", end="", file=sys.stderr)
    print(file=sys.stderr)
    print(f"{tally.cuts} power cuts in {tally.batches} batches, {tally.while_dosing} of them within a dose")
    print(f"what they did: {', '.join(f'{name} {count}' for name, count in sorted(tally.came.items()))}")
    print(
        f"{tally.doses} doses: {tally.good} good, flagged {dict(tally.flagged)}; {tally.given_up} containers given up"
    )
    print(
        f"worst recorded against true of the good: {tally.worst_error_mg:.2f} mg; "
        f"batches that stayed as they were: {dict(tally.stuck)}"
    )
    print(f"worst imbalance of mass: {tally.worst_imbalance_mg:.1e} mg")
    for problem in tally.problems:
        print(problem)
    if given.json:
        given.json.write_text(json.dumps(vars(tally), indent=1) + "\n", encoding="utf-8")
    sys.exit(bool(tally.problems))


if __name__ == "__main__":
    main()
