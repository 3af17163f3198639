"""Grains, mortar and cone at a few moments of a stroke, from the side and from above."""

import math
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.dem.cases import SLANT_MM, Case
from scuhand_bt.sim.bed import wall_mm

SLICE_MM = 8.0
"""Half the thickness of what is shown from the side."""


def draw(case: Case, found: dict[str, Any], path: Path) -> None:
    """A picture of the first stroke."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    moments = found["pictures"]
    figure, rows = plt.subplots(2, len(moments), figsize=(3.2 * len(moments), 5.6), squeeze=False, layout="constrained")
    bore_mm, depth_mm = case.mortar.bore_mm, case.mortar.depth_mm
    across = np.linspace(-bore_mm / 2, bore_mm / 2, 99)
    around = np.linspace(0.0, 2 * math.pi, 60)[:, None]
    for moment, side, above in zip(moments, *rows, strict=True):
        grains, apex, axis = (np.array(moment[key]) for key in ("grains_mm", "apex_mm", "axis"))
        tilt, alpha = math.atan2(axis[0], axis[2]), math.asin(moment["rim_mm"] / 2 / SLANT_MM)
        near = np.abs(grains[:, 1]) < SLICE_MM
        side.plot(across[[0, *range(99), -1]], [depth_mm, *wall_mm(case.mortar, np.abs(across)), depth_mm], "k", lw=1)
        side.scatter(grains[near, 0], grains[near, 2], s=9, c="tab:olive")
        for angle in (tilt - alpha, tilt + alpha):
            side.plot(
                apex[0] + SLANT_MM * np.array([0.0, math.sin(angle)]),
                apex[2] + SLANT_MM * np.array([0.0, math.cos(angle)]),
                "tab:red",
            )
        side.set(aspect="equal", xlim=(-65, 65), ylim=(-5, depth_mm + 55), title=f"{moment['time_s']:.2f} s")
        aside, over = np.array([math.cos(tilt), 0.0, -math.sin(tilt)]), np.array([0.0, 1.0, 0.0])
        outwards = np.cos(around) * aside + np.sin(around) * over
        rim = apex + SLANT_MM * (math.cos(alpha) * axis + math.sin(alpha) * outwards)
        above.add_patch(plt.Circle((0, 0), bore_mm / 2, fill=False, lw=1))
        shown = above.scatter(grains[:, 0], grains[:, 1], s=9, c=grains[:, 2], vmin=0.0, vmax=depth_mm)
        above.plot(rim[:, 0], rim[:, 1], "tab:red")
        above.plot(*apex[:2], "+", c="tab:red")
        above.set(aspect="equal", xlim=(-65, 65), ylim=(-50, 50))
    figure.colorbar(shown, ax=rows[1], label="height [mm]", shrink=0.8)
    figure.suptitle(f"{case.fill_mg / 1000:g} g of coarse beads and the cone, in red: from the side, and from above")
    figure.savefig(path, dpi=70)
    plt.close(figure)
