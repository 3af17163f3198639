"""One motion of the arm to look at: `scuhand-bt show-move A B`.

A self-contained page with the arm moving in 3D among the cell's solids, and the joints' position, speed,
acceleration and jerk and the cone's spill angle over time, each with its limits; and the same as a PNG.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from scuhand_bt.motion.collision import SHAPES, Scene
from scuhand_bt.motion.kinematics import Floats, apex_positions_m
from scuhand_bt.motion.timelaw import RateLimits
from scuhand_bt.motion.trajectory import JointTrajectory
from scuhand_bt.report.motion_panels import COLOURS, Panel, panel_svg, panels, spread
from scuhand_bt.report.move_viewer import PAGE

FRAMES_PER_S = 40
_SIDES = 24


@dataclass(frozen=True, slots=True)
class ShownMove:
    """A motion with all that is shown beside it; `places_m` are the stations' apex positions (3,) by name."""

    title: str
    motion: JointTrajectory
    scene: Scene
    rates: RateLimits
    apex_offset_m: float
    places_m: Mapping[str, Floats]

    def panels(self) -> list[Panel]:
        return panels(self.motion, self.rates, self.apex_offset_m)

    def path_m(self, times_s: Floats) -> Floats:
        """Where the apex is: (n, 3)."""
        return apex_positions_m(self.motion.at(times_s), self.apex_offset_m)[0]


def move_page(move: ShownMove) -> str:
    """The motion as a self-contained HTML page."""
    duration_s = move.motion.duration_s
    times_s = np.linspace(0.0, duration_s, max(2, int(duration_s * FRAMES_PER_S)))
    data = {
        "frames": [_moving(move.scene, q) for q in move.motion.at(times_s)],
        "solids": _standing(move.scene),
        "places": {name: np.round(place_m, 4).tolist() for name, place_m in move.places_m.items()},
        "path": np.round(move.path_m(times_s), 4).tolist(),
        "duration": duration_s,
    }
    # "</" would end the script, whatever it stands in.
    text = json.dumps(data, separators=(",", ":")).replace("</", "<\\/")
    plots = "".join(panel_svg(panel) for panel in move.panels())
    return PAGE.replace("%TITLE%", escape(move.title)).replace("%PLOTS%", plots).replace("%DATA%", text)


def move_png(move: ShownMove, file: Path) -> None:
    """The motion's plots, and the arm at five moments, as a PNG; ImportError without matplotlib (extra `plot`)."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

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
    figure.savefig(file, dpi=110)


def _draw_arm(view: Any, move: ShownMove) -> None:
    """The arm at five moments among the cell's solids, in 3D axes of matplotlib."""
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection  # type: ignore[import-untyped]

    def faces(polygons: list[Floats], colour: str, alpha: float, order: float) -> None:
        edges = {"edgecolor": "#777", "linewidth": 0.4} if order < 0 else {}
        view.add_collection3d(Poly3DCollection(polygons, facecolor=colour, alpha=alpha, zorder=order, **edges))

    for solid in _standing(move.scene):
        corners = solid.get("corners")
        if corners is None:
            low, high = (_rim(solid, k) for k in (0, 1))
            # Apart: matplotlib pads polygons of different lengths with whatever memory holds.
            faces([*np.stack([low[:-1], low[1:], high[1:], high[:-1]], axis=1)], "#a98f6c", 0.25, -1)
            faces([high], "#a98f6c", 0.25, -1)
        else:
            sides = [np.array([corners[k] for k in side]) for side in _SIDES_OF_BOX]
            faces(sides, "#5b7db1" if solid["arm"] else "#9fb2c4", 0.9 if solid["arm"] else 0.18, -1)
    for share in np.linspace(0.0, 1.0, 5):
        alpha = 0.12 + 0.7 * share**2
        for shape in _moving(move.scene, move.motion.sample(share * move.motion.duration_s)):
            kind, radius_m, first, last = shape
            if kind == "cone":
                rim = _rim({"ends": [first, last], "radius": radius_m}, 0)
                tip = np.broadcast_to(last, (len(rim) - 1, 3))
                faces([*np.stack([rim[:-1], rim[1:], tip], axis=1)], "#e08a1e", alpha, 1 + share)
            else:
                view.plot(
                    *np.array([first, last]).T,
                    lw=500 * radius_m,
                    alpha=alpha,
                    color="#5b7db1",
                    solid_capstyle="round" if kind == "capsule" else "butt",
                    zorder=1 + share,
                )
    times_s = np.linspace(0.0, move.motion.duration_s, 200)
    view.plot(*move.path_m(times_s).T, color="#c62828", lw=1.6, zorder=3)
    for name, place_m in move.places_m.items():
        view.plot(*place_m[:, None], "o", color="#1a7f37", ms=4, zorder=4)
        view.text(*place_m, f" {name}", fontsize=7, color="#1a7f37", zorder=4)
    view.set(xlim=(-0.1, 0.5), ylim=(-0.38, 0.38), zlim=(0, 0.5), xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    view.set_box_aspect((0.6, 0.76, 0.5), zoom=1.25)
    view.view_init(elev=26, azim=-40)


def _moving(scene: Scene, q: Floats) -> list[tuple[str, float, list[float], list[float]]]:
    """The arm's round shapes at a configuration: kind, radius and the two ends of the axis [m]."""
    data, shapes = scene.model.createData(), pin.GeometryData(scene.shapes)
    pin.updateGeometryPlacements(scene.model, data, scene.shapes, shapes, q)
    found = []
    for thing, placement in zip(scene.shapes.geometryObjects, shapes.oMg, strict=True):
        shape = thing.geometry
        if thing.parentJoint == 0 or isinstance(shape, coal.Box):
            continue
        kind = "clamps" if thing.name == "clamps" else type(shape).__name__.lower()
        found.append((kind, float(shape.radius), *_ends(placement, shape.halfLength)))
    return found


def _standing(scene: Scene) -> list[dict[str, Any]]:
    """Everything that stands still but the table: boxes by their corners, cylinders by their axis and radius [m]."""
    found: list[dict[str, Any]] = []
    for k, thing in enumerate(scene.shapes.geometryObjects):
        if thing.parentJoint != 0 or thing.name == "table":
            continue
        shape, arm = thing.geometry, k < SHAPES
        solid: dict[str, Any] = {"name": "" if arm else thing.name, "arm": arm}
        if isinstance(shape, coal.Box):
            signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
            solid["corners"] = [_point(thing.placement, corner) for corner in signs * shape.halfSide]
        else:
            solid["ends"], solid["radius"] = _ends(thing.placement, shape.halfLength), float(shape.radius)
        found.append(solid)
    return found


_SIDES_OF_BOX = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
"""Corners in the order of `_standing`, counter-clockwise from outside; the page knows them too."""


def _ends(placement: pin.SE3, half_m: float) -> tuple[list[float], list[float]]:
    return _point(placement, np.array([0.0, 0.0, -half_m])), _point(placement, np.array([0.0, 0.0, half_m]))


def _point(placement: pin.SE3, point_m: Floats) -> list[float]:
    rounded: list[float] = np.round(placement.act(point_m), 4).tolist()
    return rounded


def _rim(round_solid: Mapping[str, Any], end: int) -> Floats:
    """A closed circle around one end of a cylinder's or cone's axis: (n, 3)."""
    first, last = np.array(round_solid["ends"])
    along = (last - first) / np.linalg.norm(last - first)
    across = np.cross(along, (1.0, 0.0, 0.0) if abs(along[2]) > 0.9 else (0.0, 0.0, 1.0))
    across /= np.linalg.norm(across)
    angles = np.linspace(0.0, 2 * np.pi, _SIDES + 1)[:, None]
    rim: Floats = (first, last)[end] + round_solid["radius"] * (
        np.cos(angles) * across + np.sin(angles) * np.cross(along, across)
    )
    return rim
