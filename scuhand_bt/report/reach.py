"""Where the vertical cone's apex can be put, drawn in the cell: `scuhand-bt reach`.

For each point of a grid whether the closed form has a solution. Needs Jinja2, of the extra `plot`.
"""

import math
from collections.abc import Iterator
from functools import cache

import numpy as np

from scuhand_bt.bench_spec import Station
from scuhand_bt.lab import Lab, read_mount
from scuhand_bt.motion import ApexPose, Mount, solutions
from scuhand_bt.motion.kinematics import Floats
from scuhand_bt.motion.scenes import CONE_DIAMETER_M
from scuhand_bt.report import viewer
from scuhand_bt.report.page import rendered
from scuhand_bt.report.scene3d import scene_values

STEP_MM = 40
HEIGHTS_MM = (20, 60, 100, 140, 180)
_X_MM, _Y_MM = (-500, 540), (-600, 600)


def reach_page(lab: Lab) -> str:
    """A self-contained HTML page: the cell in 3D with what is reached, and a table of its stations."""
    cell, mount = lab.cell, read_mount(lab)
    heights_mm = {
        station.name: [z for z in range(round(station.position_mm[2]), 500, 5) if _reaches(station, z, mount)]
        for station in cell.stations.values()
    }
    largest = max(lab.library.mortars.values(), key=lambda mortar: mortar.outer_diameter_mm)
    planner = lab.motion_planner({one.name: largest for one in cell.stations.values() if one.kind == "mortar"})
    places_m = {name: [mm / 1e3 for mm in one.position_mm] for name, one in cell.stations.items()}
    reached = (([mm / 1e3 for mm in place], True) for place in _reached(mount))
    drawn = scene_values(planner, mount.offset_m, [1000 * CONE_DIAMETER_M], places_m, dots=reached)
    title = f"What the vertical cone can reach: {cell.cell}"
    return rendered(
        "reach.html",
        title=title,
        heights=", ".join(map(str, HEIGHTS_MM)),
        packed=viewer.packed(drawn, [], title),
        rows=[_row(one, heights_mm[one.name]) for one in cell.stations.values()],
    )


def _reached(mount: Mount) -> Iterator[tuple[float, float, float]]:
    for x_mm in np.arange(_X_MM[0] + STEP_MM / 2, _X_MM[1], STEP_MM):
        for y_mm in np.arange(_Y_MM[0] + STEP_MM / 2, _Y_MM[1], STEP_MM):
            yield from ((x_mm, y_mm, z_mm) for z_mm in HEIGHTS_MM if _solvable(x_mm, y_mm, z_mm, mount))


def _row(station: Station, heights_mm: list[int]) -> tuple[str, str, str, str]:
    x, y, z = station.position_mm
    return station.name, station.kind, f"{x:g}, {y:g}, {z:g}", _span(heights_mm)


def _span(heights_mm: list[int]) -> str:
    if not heights_mm:
        return "cannot be reached"
    return f"apex {heights_mm[0]} to {heights_mm[-1]} mm above the table"


def _reaches(station: Station, z_mm: float, mount: Mount) -> bool:
    return _solvable(station.position_mm[0], station.position_mm[1], z_mm, mount)


def _solvable(x_mm: float, y_mm: float, z_mm: float, mount: Mount) -> bool:
    low, high = mount.limits_rad[:, 0]
    turned = math.atan2(y_mm, x_mm) + _first_joints(round(math.hypot(x_mm, y_mm)), round(z_mm), mount)
    turned = (turned + math.pi) % (2 * math.pi) - math.pi
    return bool(((turned >= low) & (turned <= high)).any())


@cache
def _first_joints(out_mm: int, z_mm: int, mount: Mount) -> Floats:
    """Joint 1 of all solutions straight ahead, as if it had no limits: elsewhere they are the same, turned by it."""
    limits = mount.limits_rad.copy()
    limits[:, 0] = -math.pi, math.pi
    joints: Floats = solutions(ApexPose(np.array([out_mm, 0.0, z_mm]) / 1e3), mount, limits)[:, 0]
    return joints
