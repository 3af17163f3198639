"""Where the vertical cone's apex can be put, drawn over the cell: `scuhand-bt reach`.

A map from above: for each point of a grid the heights [mm] at which the closed form has a solution.
"""

from html import escape

import numpy as np

from scuhand_bt.motion import ApexPose, unreachable_reason
from scuhand_bt.specs import CellSpec

STEP_MM = 20
HEIGHTS_MM = (20, 60, 100, 140, 180)
_X_MM, _Y_MM = (-150, 525), (-480, 480)
_SHADES = ("#eef3f7", "#d5e5ef", "#b5d3e4", "#8fbdd6", "#64a3c5", "#3d87b0")


def reach_page(cell: CellSpec) -> str:
    """A self-contained HTML page with the map, the bench's geometry and the stations marked."""
    offset_m = cell.hand.apex_offset_mm / 1e3
    parts = []
    for row in range(_X_MM[0], _X_MM[1], STEP_MM):
        for column in range(_Y_MM[0], _Y_MM[1], STEP_MM):
            count = sum(_reaches(row + STEP_MM / 2, column + STEP_MM / 2, z, offset_m) for z in HEIGHTS_MM)
            if count:
                parts.append(_rect(row, column, STEP_MM, STEP_MM, f'fill="{_SHADES[count]}"'))
    for obstacle in cell.geometry:
        x, y, _ = obstacle.at_mm
        if obstacle.name == "table":
            continue
        line = f'fill="#0001" stroke="#555" stroke-width="1.5"><title>{escape(obstacle.name)}</title'
        if obstacle.box_mm is not None:
            a, b, _ = obstacle.box_mm
            parts.append(_rect(x - a / 2, y - b / 2, a, b, line).replace("/>", "></rect>"))
        elif obstacle.cylinder_mm is not None:
            u, v = _at(x, y)
            parts.append(f'<circle cx="{u:.1f}" cy="{v:.1f}" r="{obstacle.cylinder_mm[0] / 2}" {line}></circle>')
    notes = []
    for station in cell.stations.values():
        x, y, z = station.position_mm
        u, v = _at(x, y)
        heights = [h for h in range(0, 260, 5) if _reaches(x, y, h, offset_m)]
        colour = "#1a7f37" if heights else "#c62828"
        parts.append(f'<circle cx="{u:.1f}" cy="{v:.1f}" r="6" fill="{colour}"/>')
        parts.append(f'<text x="{u + 10:.1f}" y="{v - 8:.1f}">{escape(station.name)}</text>')
        span = f"apex {heights[0]} to {heights[-1]} mm above the table" if heights else "cannot be reached"
        notes.append(f"<tr><td>{escape(station.name)}</td><td>{x:g}, {y:g}, {z:g}</td><td>{span}</td></tr>")
    u, v = _at(0, 0)
    parts.append(f'<circle cx="{u}" cy="{v}" r="50" fill="#333"/><text x="{u}" y="{v + 5}" {_WHITE}>arm</text>')
    width, height = _Y_MM[1] - _Y_MM[0], _X_MM[1] - _X_MM[0]
    swatches = "".join(
        f'<span style="background:{_SHADES[k]}">&nbsp;&nbsp;{k} of {len(HEIGHTS_MM)}&nbsp;&nbsp;</span>'
        for k in range(1, len(HEIGHTS_MM) + 1)
    )
    return f"""<!doctype html><html lang="en"><meta charset="utf-8"><title>Reach of {escape(cell.cell)}</title>
<style>body{{font:15px system-ui,sans-serif;margin:24px;color:#222;max-width:1000px}}
svg{{background:#fafafa;width:100%}}
text{{font-size:15px;paint-order:stroke;stroke:#fffc;stroke-width:4px}}td{{padding:2px 18px 2px 0}}</style>
<h1>What the vertical cone can reach: {escape(cell.cell)}</h1>
<p>Seen from above, the arm reaching up the page. Shade: at how many of the apex heights
{", ".join(map(str, HEIGHTS_MM))} mm the arm has a solution. {swatches}</p>
<svg viewBox="0 0 {width} {height}" role="img" aria-label="Map of the cell from above">{"".join(parts)}</svg>
<table><tr><th align="left">station</th><th align="left">x, y, z [mm]</th><th align="left">vertical cone</th></tr>
{"".join(notes)}</table>
<p>Kinematics only: what stands in the way is looked at when a motion is planned.</p></html>
"""


_WHITE = 'fill="white" text-anchor="middle" style="stroke:none"'


def _reaches(x_mm: float, y_mm: float, z_mm: float, offset_m: float) -> bool:
    return unreachable_reason(ApexPose(np.array([x_mm, y_mm, z_mm]) / 1e3), offset_m) is None


def _at(x_mm: float, y_mm: float) -> tuple[float, float]:
    """x points up the page and y to the left, as they do when one stands behind the arm."""
    return _Y_MM[1] - y_mm, _X_MM[1] - x_mm


def _rect(x_mm: float, y_mm: float, dx_mm: float, dy_mm: float, style: str) -> str:
    u, v = _at(x_mm + dx_mm, y_mm + dy_mm)
    return f'<rect x="{u:.1f}" y="{v:.1f}" width="{dy_mm:.1f}" height="{dx_mm:.1f}" {style}/>'
