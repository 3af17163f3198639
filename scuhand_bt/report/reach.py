"""Where the vertical cone's apex can be put, drawn over the cell: `scuhand-bt reach`.

A map from above: for each point of a grid the heights [mm] at which the closed form has a solution.
"""

from html import escape

import numpy as np

from scuhand_bt.cell_spec import CellSpec, Obstacle
from scuhand_bt.motion import ApexPose, unreachable_reason

STEP_MM = 20
HEIGHTS_MM = (20, 60, 100, 140, 180)
_X_MM, _Y_MM = (-500, 540), (-600, 600)
_AXIS_MM = 200
_WRITTEN_MM = 60
_SHADES = ("#eef3f7", "#d5e5ef", "#b5d3e4", "#8fbdd6", "#64a3c5", "#3d87b0")


def reach_page(cell: CellSpec) -> str:
    """A self-contained HTML page with the map, the bench's geometry and the stations marked."""
    offset_m = cell.hand.apex_offset_mm / 1e3
    parts = []
    for row in range(_X_MM[0], _X_MM[1], STEP_MM):
        for column in range(_Y_MM[0], _Y_MM[1], STEP_MM):
            count = sum(_reaches(row + STEP_MM / 2, column + STEP_MM / 2, z, offset_m) for z in HEIGHTS_MM)
            if count:
                parts.append(f'<rect {_box(row, column, STEP_MM, STEP_MM)} fill="{_SHADES[count]}" class="cell"/>')
    parts += _axes()
    parts += [_outline(obstacle) for obstacle in cell.geometry if obstacle.name != "table"]
    notes = []
    for station in cell.stations.values():
        x, y, z = station.position_mm
        u, v = _at(x, y)
        heights = [h for h in range(round(z), 500, 5) if _reaches(x, y, h, offset_m)]
        colour = "#1a7f37" if heights else "#c62828"
        parts.append(f'<circle cx="{u:.1f}" cy="{v:.1f}" r="7" fill="{colour}" stroke="#fff"/>')
        parts.append(f'<text x="{u + 11:.1f}" y="{v - 8:.1f}" class="station">{escape(station.name)}</text>')
        span = f"apex {heights[0]} to {heights[-1]} mm above the table" if heights else "cannot be reached"
        notes.append(
            f"<tr><td>{escape(station.name)}</td><td>{escape(station.kind)}</td><td>{x:g}, {y:g}, {z:g}</td>"
            f'<td style="color:{colour}">{span}</td></tr>'
        )
    u, v = _at(0, 0)
    parts.append(f'<circle cx="{u}" cy="{v}" r="50" fill="#333"/><text x="{u}" y="{v + 5}" class="arm">arm</text>')
    width, height = _Y_MM[1] - _Y_MM[0], _X_MM[1] - _X_MM[0]
    swatches = "".join(
        f'<span style="background:{_SHADES[k]}">&nbsp;&nbsp;{k} of {len(HEIGHTS_MM)}&nbsp;&nbsp;</span>'
        for k in range(1, len(HEIGHTS_MM) + 1)
    )
    return f"""<!doctype html><html lang="en"><meta charset="utf-8"><title>Reach of {escape(cell.cell)}</title>
<style>body{{font:15px system-ui,sans-serif;margin:24px auto;padding:0 16px;color:#222;max-width:1000px}}
svg{{background:#fafafa;width:100%;border:1px solid #ddd;border-radius:6px}}
text{{font-size:15px;paint-order:stroke;stroke:#fffc;stroke-width:4px}}.station{{font-size:17px;font-weight:600}}
.arm{{fill:#fff;stroke:none;text-anchor:middle}}.scale{{font-size:13px;fill:#666}}
.thing{{font-size:13px;fill:#444;text-anchor:middle}}
.cell{{shape-rendering:crispEdges}}.grid{{stroke:#0002;stroke-dasharray:3 5}}
.solid{{fill:#0001;stroke:#555;stroke-width:1.5}}
td,th{{padding:2px 18px 2px 0;text-align:left}}</style>
<h1>What the vertical cone can reach: {escape(cell.cell)}</h1>
<p>Seen from above, the arm reaching up the page. Shade: at how many of the apex heights
{", ".join(map(str, HEIGHTS_MM))} mm the arm has a solution. {swatches}</p>
<svg viewBox="0 0 {width} {height}" role="img" aria-label="Map of the cell from above">{"".join(parts)}</svg>
<table><tr><th>station</th><th>kind</th><th>x, y, z [mm]</th><th>vertical cone, from the station up</th></tr>
{"".join(notes)}</table>
<p>Kinematics only: what stands in the way is looked at when a motion is planned.</p></html>
"""


def _reaches(x_mm: float, y_mm: float, z_mm: float, offset_m: float) -> bool:
    return unreachable_reason(ApexPose(np.array([x_mm, y_mm, z_mm]) / 1e3), offset_m) is None


def _axes() -> list[str]:
    """Lines of equal x and y, with their millimetres."""
    left, right, low, high = _Y_MM[1], _Y_MM[0], *_X_MM
    parts = []
    for x_mm in range(low + _AXIS_MM // 2, high, _AXIS_MM):
        (u, v), (end, _) = _at(x_mm, left), _at(x_mm, right)
        parts.append(f'<path d="M{u} {v}H{end}" class="grid"/><text x="6" y="{v - 4}" class="scale">x {x_mm}</text>')
    for y_mm in range(right + _AXIS_MM, left, _AXIS_MM):
        (u, v), (_, end) = _at(low, y_mm), _at(high, y_mm)
        parts.append(f'<path d="M{u} {v}V{end}" class="grid"/><text x="{u + 4}" y="14" class="scale">y {y_mm}</text>')
    return parts


def _outline(obstacle: Obstacle) -> str:
    """A solid of the cell, with its name as a tooltip; those large enough are written on."""
    (x, y, _), name = obstacle.at_mm, escape(obstacle.name)
    if obstacle.box_mm is not None:
        deep, wide, _ = obstacle.box_mm
        shape, tag = f"{_box(x - deep / 2, y - wide / 2, deep, wide)}", "rect"
    elif obstacle.cylinder_mm is not None:
        deep = wide = obstacle.cylinder_mm[0]
        shape, tag = 'cx="{:.1f}" cy="{:.1f}" r="{}"'.format(*_at(x, y), deep / 2), "circle"
    else:
        return ""
    u, v = _at(x - deep / 2, y)
    label = f'<text x="{u:.1f}" y="{v - 6:.1f}" class="thing">{name}</text>' if min(deep, wide) > _WRITTEN_MM else ""
    return f'<{tag} {shape} class="solid"><title>{name}</title></{tag}>{label}'


def _at(x_mm: float, y_mm: float) -> tuple[float, float]:
    """x points up the page and y to the left, as they do when one stands behind the arm."""
    return _Y_MM[1] - y_mm, _X_MM[1] - x_mm


def _box(x_mm: float, y_mm: float, dx_mm: float, dy_mm: float) -> str:
    u, v = _at(x_mm + dx_mm, y_mm + dy_mm)
    return f'x="{u:.1f}" y="{v:.1f}" width="{dy_mm:.1f}" height="{dx_mm:.1f}"'
