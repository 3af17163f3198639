"""Where the vertical cone's apex can be put, drawn in the cell: `scuhand-bt reach`.

For each point of a grid whether the closed form has a solution. Needs Jinja2, of the extra `plot`.
"""

from collections.abc import Iterator

import numpy as np

from scuhand_bt.cell_spec import Station
from scuhand_bt.lab import Lab
from scuhand_bt.motion import ApexPose, unreachable_reason
from scuhand_bt.motion.scenes import CONE_DIAMETER_M
from scuhand_bt.report import viewer
from scuhand_bt.report.page import rendered
from scuhand_bt.report.scene3d import scene_values

STEP_MM = 40
HEIGHTS_MM = (20, 60, 100, 140, 180)
_X_MM, _Y_MM = (-500, 540), (-600, 600)


def reach_page(lab: Lab) -> str:
    """A self-contained HTML page: the cell in 3D with what is reached, and a table of its stations."""
    cell, offset_m = lab.cell, lab.cell.hand.apex_offset_mm / 1e3
    heights_mm = {
        station.name: [z for z in range(round(station.position_mm[2]), 500, 5) if _reaches(station, z, offset_m)]
        for station in cell.stations.values()
    }
    largest = max(lab.library.mortars.values(), key=lambda mortar: mortar.outer_diameter_mm)
    planner = lab.motion_planner({one.name: largest for one in cell.stations.values() if one.kind == "mortar"})
    places_m = {name: [mm / 1e3 for mm in one.position_mm] for name, one in cell.stations.items()}
    reached = (([mm / 1e3 for mm in place], True) for place in _reached(offset_m))
    drawn = scene_values(planner, offset_m, [1000 * CONE_DIAMETER_M], places_m, dots=reached)
    title = f"What the vertical cone can reach: {cell.cell}"
    return rendered(
        "reach.html",
        title=title,
        heights=", ".join(map(str, HEIGHTS_MM)),
        packed=viewer.packed(drawn, [], title),
        rows=[_row(one, heights_mm[one.name]) for one in cell.stations.values()],
    )


def _reached(offset_m: float) -> Iterator[tuple[float, float, float]]:
    for x_mm in np.arange(_X_MM[0] + STEP_MM / 2, _X_MM[1], STEP_MM):
        for y_mm in np.arange(_Y_MM[0] + STEP_MM / 2, _Y_MM[1], STEP_MM):
            yield from ((x_mm, y_mm, z_mm) for z_mm in HEIGHTS_MM if _solvable(x_mm, y_mm, z_mm, offset_m))


def _row(station: Station, heights_mm: list[int]) -> tuple[str, str, str, str]:
    x, y, z = station.position_mm
    return station.name, station.kind, f"{x:g}, {y:g}, {z:g}", _span(heights_mm)


def _span(heights_mm: list[int]) -> str:
    if not heights_mm:
        return "cannot be reached"
    return f"apex {heights_mm[0]} to {heights_mm[-1]} mm above the table"


def _reaches(station: Station, z_mm: float, offset_m: float) -> bool:
    return _solvable(station.position_mm[0], station.position_mm[1], z_mm, offset_m)


def _solvable(x_mm: float, y_mm: float, z_mm: float, offset_m: float) -> bool:
    return unreachable_reason(ApexPose(np.array([x_mm, y_mm, z_mm]) / 1e3), offset_m) is None
