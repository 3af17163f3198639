"""A benchmark's figures as a table beside their goals, and as JSON."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table


def show(title: str, figures: Mapping[str, float], goals: Mapping[str, str], file: Path | None) -> None:
    """Print the figures, and write them to a file."""
    table = Table("figure", "measured", "goal", title=title)
    for key, value in figures.items():
        table.add_row(key, f"{value:.3g}" if value < 1000 else f"{value:.0f}", goals.get(key, ""))
    Console().print(table)
    if file is not None:
        file.write_text(json.dumps(figures, indent=1) + "\n")


def spread(values: Sequence[float], unit: str) -> str:
    """Median, 95th percentile, worst and mean, in words."""
    if not values:
        return "none"
    median, p95 = np.percentile(values, [50, 95])
    return f"median {median:.3g}, p95 {p95:.3g}, worst {max(values):.3g}, mean {np.mean(values):.3g} {unit}"
