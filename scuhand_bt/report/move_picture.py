"""A motion as a PNG, by matplotlib (extra `plot`): the arm at five moments, and the plots."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection  # type: ignore[import-untyped]

from scuhand_bt.report.cell_mesh import CellMeshes
from scuhand_bt.report.lettering import write_figure
from scuhand_bt.report.motion_panels import COLOURS, spread
from scuhand_bt.report.show_move import (
    ARM_COLOUR,
    HAND_COLOURS,
    PATH_COLOUR,
    STANDING_COLOUR,
    STATION_COLOUR,
    ShownMove,
)


def move_png(move: ShownMove, file: Path) -> None:
    """The motion's plots, and the arm at five moments, as a PNG."""
    figure = Figure(figsize=(13, 11), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(f"{move.title}: {move.motion.duration_s:.2f} s", fontsize=15)
    grid = figure.add_gridspec(3, 2, height_ratios=[1.35, 1, 1])
    _draw_arm(figure.add_subplot(grid[0, 0], projection="3d", computed_zorder=False), move)
    for k, panel in enumerate(move.panels()):
        axes = figure.add_subplot(grid[(k + 1) // 2, (k + 1) % 2])
        for joint, (column, colour) in enumerate(zip(panel.values.T, COLOURS, strict=False), start=1):
            axes.plot(panel.times_s, column, color=colour, lw=1.2, label=f"j{joint}")
        low, high = panel.span
        labels = spread([limit for limit, _ in panel.limits], 0.055 * (high - low))
        for (limit, whose), place in zip(panel.limits, labels, strict=True):
            axes.axhline(limit, color="#555", ls="--", lw=0.8)
            text = f" {limit:.3g} {whose}"
            axes.annotate(text, (1, place), xycoords=("axes fraction", "data"), fontsize=8, va="center")
        axes.set(title=panel.name, xlabel="time [s]", ylim=(low, high), xlim=(0, move.motion.duration_s))
        if k == 0:
            axes.legend(ncols=4, fontsize=7, loc="upper right")
    write_figure(figure, file, dpi=110)


def _draw_arm(view: Any, move: ShownMove) -> None:
    """The arm at five moments among the cell's solids, in 3D axes of matplotlib."""
    meshes = CellMeshes(move.scene)
    for mesh in meshes.standing:
        polygons, edges = mesh.points_m[mesh.triangles], mesh.points_m[mesh.edges]
        view.add_collection3d(Poly3DCollection(polygons, facecolor=STANDING_COLOUR, alpha=0.15, zorder=-1))
        view.add_collection3d(Line3DCollection(edges, color=STANDING_COLOUR, lw=0.5, zorder=-1))
    for share in np.linspace(0.0, 1.0, 5):
        for mesh in meshes.arm(move.motion.sample(share * move.motion.duration_s)):
            colour = HAND_COLOURS.get(mesh.name, ARM_COLOUR)
            polygons = mesh.points_m[mesh.triangles]
            look = {"facecolor": colour, "alpha": 0.06 + 0.5 * share**2, "zorder": 1 + share}
            view.add_collection3d(Poly3DCollection(polygons, **look))
    times_s = np.linspace(0.0, move.motion.duration_s, 200)
    view.plot(*move.path_m(times_s).T, color=PATH_COLOUR, lw=1.6, zorder=3)
    for name, place_m in move.places_m.items():
        view.plot(*place_m[:, None], "o", color=STATION_COLOUR, ms=4, zorder=4)
        view.text(*place_m, f" {name}", fontsize=7, color=STATION_COLOUR, zorder=4)
    view.set(xlim=(-0.1, 0.5), ylim=(-0.38, 0.38), zlim=(0, 0.5), xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    view.set_box_aspect((0.6, 0.76, 0.5), zoom=1.25)
    view.view_init(elev=26, azim=-40)
