"""What looking through evidence costs: `python -m benchmarks.evidence [--json FILE]`.

Lists ten thousand runs (one journal under ten thousand names): with no index yet, with it, and after one has changed.
Kills a dry run of a thousand samples at its 950th, and takes it up until its first action begins. All in seconds of the
processor, the program's start included.
"""

import argparse
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.batch import generated_recipe
from benchmarks.figures import show
from scuhand_bt.journal.runs_index import SETTLED_S
from scuhand_bt.lab import starter_lab

RUNS = 10_000
SAMPLES, KILLED_AT = 1000, 950
UNTIL_THE_FIRST_ACTION = """
import os, sys, time
from scuhand_bt.cli import main
from scuhand_bt.journal.writer import Journal

def action_started(self, *args, **kwargs):
    os.write(1, f"\\ncpu {time.process_time()}\\n".encode())
    os._exit(0)

Journal.action_started = action_started
main()
"""


def lab(folder: Path) -> Path:
    """A copy of the starter lab, without its recipes."""
    for part in ("robot", "skills", "trees"):
        shutil.copytree(starter_lab() / part, folder / part, ignore=shutil.ignore_patterns("__pycache__"))
    (folder / "recipes").mkdir()
    return folder


def command(*arguments: object) -> float:
    """Seconds of the processor for one cold start of the command line."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, "-m", "scuhand_bt", *map(str, arguments)], stdout=subprocess.DEVNULL, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


def listing(folder: Path) -> dict[str, float]:
    place = lab(folder)
    recipe = generated_recipe(place / "recipes", 1)
    command("run", recipe, "--dry-run")
    runs = place / ".scuhand" / "runs"
    (journal,) = runs.glob("*.sqlite")
    for number in range(RUNS - 2):
        os.link(journal, runs / f"{number:05d}.sqlite")
    changing = runs / "changing.sqlite"
    shutil.copy(journal, changing)
    time.sleep(SETTLED_S + 0.5)
    figures = {"list_without_index_cpu_s": command("runs", "--lab", place)}
    figures["list_cpu_s"] = min(command("runs", "--lab", place) for _ in range(3))
    changing.touch()
    figures["list_after_a_change_cpu_s"] = command("runs", "--lab", place)
    figures["list_all_as_json_cpu_s"] = command("runs", "--lab", place, "--json")
    return figures


def taking_up(folder: Path) -> dict[str, float]:
    place = lab(folder)
    recipe = generated_recipe(place / "recipes", SAMPLES)
    arguments = [sys.executable, "-u", "-m", "scuhand_bt", "run", str(recipe), "--dry-run"]
    with subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True) as run:
        assert run.stdout is not None
        for line in run.stdout:
            if line.startswith(f"[{KILLED_AT}/"):
                run.kill()
                break
    again = ["resume", "last", "--yes", "--lab", str(place)]
    said = subprocess.run(
        [sys.executable, "-c", UNTIL_THE_FIRST_ACTION, *again], stdout=subprocess.PIPE, text=True, check=True
    )
    (cpu,) = (line for line in said.stdout.splitlines() if line.startswith("cpu "))
    return {"resume_to_first_action_cpu_s": float(cpu.split()[1])}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        figures = listing(Path(name) / "many") | taking_up(Path(name) / "long")
    goals = {"list_cpu_s": "< 1", "list_after_a_change_cpu_s": "< 1", "resume_to_first_action_cpu_s": "< 2"}
    show(f"Evidence ({RUNS} runs; a run of {SAMPLES} samples)", figures, goals, options.json)


if __name__ == "__main__":
    main()
