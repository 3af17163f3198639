"""Figures of drivers and twins: `python -m benchmarks.devices [--json FILE] [--only SECTION …]`.

Streaming's jitter; how soon the arm stands and the valve closes when the host dies or hangs; one rehearsed
dose (its processor time, and how far the arm's path was from the planned one); a million bytes into every
parser; hundreds of unplugs of every device. On an otherwise idle computer, `nice -n -15`; half an hour.
"""

import argparse
import json
import os
import platform
from collections.abc import Callable, Iterable
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks import devices_motion, devices_wires
from benchmarks.devices_wires import Figures

GOALS = {
    "jitter_p99_ms": "< 3",
    "arm_stands_ms_max": "<= 100",
    "watchdogs_trip_ms_max": "<= 100",
    "valve_moves_ms_max": "<= 300",
    "motor_off_ms_max": "<= 300",
    "cpu_percent": "< 60",
    "path_mm_max": "<= 1",
    "path_deg_max": "<= 0.5",
    "same_verdict": "True",
    "accepted_wrong": "0",
    "crashes": "0",
    "lost_reported": "every cycle",
    "ended_safe": "every cycle",
    "came_back": "every cycle",
}
"""The goals, by the figure's name."""

SECTIONS: dict[str, Callable[[int], Iterable[tuple[str, Figures]]]] = {
    "streaming": lambda cycles: [("streaming", devices_motion.streaming())],
    "stops": lambda cycles: devices_motion.stops(),
    "rehearsal": lambda cycles: [("rehearsal of an XRD dose", devices_motion.rehearsal())],
    "parsers": lambda cycles: devices_wires.parsers(),
    "unplugs": devices_wires.unplugs,
}


def machine() -> dict[str, object]:
    """Where it was measured, and what else went on there."""
    models = [line.split(":", 1)[1] for line in Path("/proc/cpuinfo").read_text().splitlines() if "model name" in line]
    return {
        "processor": models[0].strip() if models else platform.processor(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        "niceness": os.nice(0),
        "load_1min": os.getloadavg()[0],
    }


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.devices", description=__doc__)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--only", nargs="+", choices=SECTIONS, default=list(SECTIONS), metavar="SECTION")
    parser.add_argument("--cycles", type=int, default=500, help="unplugs of each device")
    given = parser.parse_args()
    results: dict[str, object] = {"machine": machine()}
    console = Console()
    console.print(results["machine"])
    for section in given.only:
        for title, figures in SECTIONS[section](given.cycles):
            figures["load_1min"] = os.getloadavg()[0]
            results[title] = figures
            table = Table("figure", "measured", "goal", title=title, title_justify="left")
            for name, value in figures.items():
                table.add_row(name, f"{value:.4g}" if isinstance(value, float) else str(value), GOALS.get(name, ""))
            console.print(table)
            if given.json is not None:
                given.json.write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()
