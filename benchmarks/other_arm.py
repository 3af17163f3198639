"""The shipped recipes on another arm: `python -m benchmarks.other_arm [--arm xarm7] [--seeds 1 2] [--recipes NAME ...]
[--json FILE]`.

Each recipe runs dry in the lab of `examples/`, made anew, as `scuhand-bt run` does it: how many samples were good, with
what exit code it ended, and the CPU time it took in all.
"""

import argparse
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from harness.example_labs import example_lab

GOOD = re.compile(r"(\d+) of (\d+) samples good")
PATIENCE_S = 1800


def ran(arm: str, recipe: str, seed: int) -> dict[str, Any]:
    """One recipe in a lab of its own."""
    with TemporaryDirectory() as folder:
        lab = Path(folder)
        example_lab(arm, lab)
        command = [sys.executable, "-m", "scuhand_bt", "run", str(lab / "recipes" / recipe), "--dry-run"]
        begun = os.times()
        ended = subprocess.run(
            [*command, "--seed", str(seed), "--lab", str(lab)], capture_output=True, text=True, timeout=PATIENCE_S
        )
        now = os.times()
    cpu_s = now.children_user + now.children_system - begun.children_user - begun.children_system
    said = GOOD.search(ended.stdout)
    good, of = (int(one) for one in said.groups()) if said else (0, 0)
    found: dict[str, Any] = {"good": good, "of": of, "exit": ended.returncode, "cpu_s": round(cpu_s, 1)}
    if ended.returncode or good < of or not said:
        found["said"] = (ended.stdout + ended.stderr)[-1500:]
    return found


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.other_arm", description=__doc__)
    parser.add_argument("--arm", default="xarm7", help="whose lab, of examples/")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1])
    parser.add_argument("--recipes", nargs="+", help="of the starter lab's, by file name; all if not given")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    with TemporaryDirectory() as folder:
        shipped = sorted(path.name for path in example_lab(given.arm, Path(folder)).folder.glob("recipes/*.yaml"))
    figures: dict[str, Any] = {}
    for seed in given.seeds:
        for recipe in given.recipes or shipped:
            figures[f"{recipe}, seed {seed}"] = one = ran(given.arm, recipe, seed)
            print(f"{recipe}, seed {seed}: {one}", flush=True)
            if given.json:
                given.json.write_text(json.dumps(figures, indent=1) + "\n")


if __name__ == "__main__":
    main()
