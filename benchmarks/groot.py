"""What it costs a run to be watched: `python -m benchmarks.groot [--runs 4] [--json FILE]`.

Dry runs of the shipped holders, in turn: alone, with `--groot` and btview's client asking twenty times a second for
the states and the blackboards, and with `--events FILE`. Counted is the processor's time of the run's process; a run at
full speed has no time to spare, so that all of what the watching takes is seen.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import closing, suppress
from pathlib import Path
from statistics import median

from benchmarks.figures import show
from harness.ports import unused_port
from scuhand_bt.lab import starter_lab

LOOKS_PER_S = 20


def cost_s(*options: str) -> float:
    """Of the processor, for one run in a lab that has learnt nothing."""
    with tempfile.TemporaryDirectory() as folder:
        for part in ("robot", "skills", "trees", "recipes"):
            shutil.copytree(starter_lab() / part, Path(folder) / part)
        recipe = str(Path(folder) / "recipes" / "xrd_holders.yaml")
        command = [sys.executable, "-m", "scuhand_bt", "run", recipe, "--dry-run", "--seed", "1", "--quiet", *options]
        process = subprocess.Popen(command, cwd=folder, stdout=subprocess.DEVNULL)
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    assert process.returncode in (0, 1), process.returncode
    return used.ru_utime + used.ru_stime


def looks_of(port: int, over: threading.Event, answers: list[int]) -> None:
    """Ask as a viewer does, until it is over."""
    from btview.client import Groot2Client

    with closing(Groot2Client(port=port, timeout_ms=500)) as viewer:
        tree = ""
        while not over.wait(1 / LOOKS_PER_S):
            with suppress(Exception):  # there is no run yet, or no job
                viewer.poll()
                if viewer.tree_uuid != tree:
                    viewer.fetch_tree()
                    tree = viewer.tree_uuid
                viewer.fetch_blackboard()
                answers[0] += 1


def watched_s(answers: list[int]) -> float:
    """The cost of a run with a viewer."""
    port = unused_port()
    over = threading.Event()
    thread = threading.Thread(target=looks_of, args=(port, over, answers))
    thread.start()
    try:
        return cost_s("--groot", str(port))
    finally:
        over.set()
        thread.join()


def main() -> None:
    """Measure, and show."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=4)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    found: dict[str, list[float]] = {"alone": [], "groot": [], "events": []}
    answers, began_s = [0], time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(given.runs):
            found["alone"].append(cost_s())
            found["groot"].append(watched_s(answers))
            found["events"].append(cost_s("--events", str(Path(folder) / "events.jsonl")))
    figures: dict[str, float] = {f"{name}_s": median(costs) for name, costs in found.items()}
    for name in ("groot", "events"):
        figures[f"{name}_over_alone"] = median(
            one / alone for one, alone in zip(found[name], found["alone"], strict=True)
        )
    figures |= {"looks": answers[0], "took_s": time.monotonic() - began_s}
    title = f"{given.runs} dry runs each, seconds of the processor"
    show(title, figures, {"groot_over_alone": "1.05 or less"}, given.json)


if __name__ == "__main__":
    main()
