"""Cut supplies of wire twins at random moments, for random times, while the real drivers dose in real time.

    python -m benchmarks.power_cuts_wire [--cuts 200] [--a-batch 8] [--seed 0] [--json FILE]
    python -m benchmarks.power_cuts_wire --detection 200      # how soon it is known, without a run

About 30 s a cut. The figures of detection say how much of the computer was free meanwhile, and `--detection` has the
shipped latencies: the series has those of twins on a busy computer. `harness/wire_cuts.py` says what is looked at.
"""

import argparse
import json
import random
import sys
import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from harness.wire_cell import make_lab, twins_of
from harness.wire_cuts import Cut, Tally, cut_until_done
from harness.wire_detection import detect
from scuhand_bt.device_specs.arm import ArmOptions


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--cuts", type=int, default=200)
    parser.add_argument("--a-batch", type=int, default=8, help="cuts of one batch before it is let end")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--detection", type=int, default=0, metavar="N", help="N cuts without a run instead")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    rng, tally, seed = random.Random(given.seed), Tally(), given.seed
    with tempfile.TemporaryDirectory() as folder:
        if given.detection:
            lab, plan, motion = make_lab(Path(folder) / "lab", latency_s=ArmOptions().latency_s)
            with twins_of(lab, plan, motion, seed) as cell:
                tally.cuts = detect(cell, rng, given.detection)
        else:
            lab, plan, motion = make_lab(Path(folder) / "lab")
        while not given.detection and len(tally.cuts) < given.cuts:
            with twins_of(lab, plan, motion, seed) as cell:
                cut_until_done(cell, rng, given.a_batch, tally)
            seed += 1
            print(f"\r{len(tally.cuts)} cuts, {tally.batches} batches, {len(tally.problems)} problems", file=sys.stderr)
            if given.json:
                _write(given.json, tally)
    print(json.dumps(_figures(tally), indent=1))
    for problem in tally.problems:
        print(problem)
    if given.json:
        _write(given.json, tally)
    sys.exit(bool(tally.problems))


def _figures(tally: Tally) -> dict[str, Any]:
    said = {key: value for key, value in vars(tally).items() if key != "cuts"}
    return {"cuts": len(tally.cuts), **said, "by_supply": by_supply(tally.cuts)}


def by_supply(cuts: list[Cut]) -> dict[str, Any]:
    """How soon each was known [ms], how long it was, and the share of the computer that was free."""
    found = {}
    for supply in sorted({cut.supply for cut in cuts}):
        mine = [cut for cut in cuts if cut.supply == supply]
        known_ms = sorted(1000 * cut.known_s for cut in mine if cut.known_s is not None)
        found[supply] = {
            "cuts": len(mine),
            "known": len(known_ms),
            "median_ms": round(float(np.percentile(known_ms, 50))) if known_ms else None,
            "p99_ms": round(float(np.percentile(known_ms, 99))) if known_ms else None,
            "worst_ms": round(known_ms[-1]) if known_ms else None,
            "median_idle": round(float(np.median([cut.idle for cut in mine])), 2),
        }
    return found


def _write(path: Path, tally: Tally) -> None:
    whole = {**_figures(tally), "each": [asdict(cut) for cut in tally.cuts]}
    path.write_text(json.dumps(whole, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
