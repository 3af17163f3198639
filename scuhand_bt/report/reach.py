"""Where the vertical cone's apex can be put, drawn over the cell: `scuhand-bt reach`.

A map from above: for each point of a grid the heights [mm] at which the closed form has a solution.
Needs plotly, of the extra `plot`.
"""

from html import escape
from typing import Any

import numpy as np
from plotly import graph_objects as go

from scuhand_bt.cell_spec import CellSpec, Station
from scuhand_bt.motion import ApexPose, Mount, solutions
from scuhand_bt.report.figure_page import figure_page

STEP_MM = 20
HEIGHTS_MM = (20, 60, 100, 140, 180)
_X_MM, _Y_MM = (-500, 540), (-600, 600)
_WRITTEN_MM = 60
_BASE_RADIUS_MM = 50
_SHADES = [f"rgba(45,125,185,{0.13 * k:.2f})" for k in range(len(HEIGHTS_MM) + 1)]
"""By how many heights are reached; translucent, so that it reads on a light and on a dark page."""
_REACHED, _OUT_OF_REACH = "#1a7f37", "#c62828"


def reach_page(cell: CellSpec) -> str:
    """A self-contained HTML page with the map, the bench's geometry and the stations marked."""
    mount = Mount.of(cell.hand)
    heights_mm = {
        station.name: [z for z in range(round(station.position_mm[2]), 500, 5) if _reaches(station, z, mount)]
        for station in cell.stations.values()
    }
    rows = [_row(station, heights_mm[station.name]) for station in cell.stations.values()]
    intro = (
        "<p>Seen from above, the arm reaching up the page. Shade: at how many of the apex heights "
        f"{', '.join(map(str, HEIGHTS_MM))} mm above the table the arm has a solution.</p>"
    )
    below = (
        "<table><tr><th>station</th><th>kind</th><th>x, y, z [mm]</th>"
        f"<th>vertical cone, from the station up</th></tr>{''.join(rows)}</table>"
        "<p>Kinematics only: what stands in the way is looked at when a motion is planned.</p>"
    )
    return figure_page(f"What the vertical cone can reach: {cell.cell}", _map(cell, heights_mm, mount), intro, below)


def _row(station: Station, heights_mm: list[int]) -> str:
    x, y, z = station.position_mm
    colour = _REACHED if heights_mm else _OUT_OF_REACH
    return (
        f"<tr><td>{escape(station.name)}</td><td>{escape(station.kind)}</td><td>{x:g}, {y:g}, {z:g}</td>"
        f'<td><span style="color:{colour}">&#9679;</span> {_span(heights_mm)}</td></tr>'
    )


def _span(heights_mm: list[int]) -> str:
    if not heights_mm:
        return "cannot be reached"
    return f"apex {heights_mm[0]} to {heights_mm[-1]} mm above the table"


def _reaches(station: Station, z_mm: float, mount: Mount) -> bool:
    return _solvable(station.position_mm[0], station.position_mm[1], z_mm, mount)


def _solvable(x_mm: float, y_mm: float, z_mm: float, mount: Mount) -> bool:
    return len(solutions(ApexPose(np.array([x_mm, y_mm, z_mm]) / 1e3), mount)) > 0


def _map(cell: CellSpec, heights_mm: dict[str, list[int]], mount: Mount) -> go.Figure:
    """x points up the page and y to the left, as they do when one stands behind the arm."""
    x_mm, y_mm = (np.arange(low + STEP_MM / 2, high, STEP_MM) for low, high in (_X_MM, _Y_MM))
    reached = [[[z for z in HEIGHTS_MM if _solvable(x, y, z, mount)] for y in y_mm] for x in x_mm]
    count = len(HEIGHTS_MM) + 1
    figure = go.Figure(
        go.Heatmap(
            x=y_mm,
            y=x_mm,
            z=[[len(heights) for heights in row] for row in reached],
            text=[[", ".join(map(str, heights)) or "none" for heights in row] for row in reached],
            hovertemplate="x %{y:.0f}, y %{x:.0f} mm<br>heights: %{text} mm<extra></extra>",
            colorscale=[[edge / count, _SHADES[k]] for k in range(count) for edge in (k, k + 1)],
            zmin=-0.5,
            zmax=count - 0.5,
            colorbar={"title": "heights", "tickvals": list(range(count))},
        )
    )
    solid: dict[str, Any] = {"line": {"color": "#777", "width": 1.5}, "fillcolor": "rgba(128,128,128,0.2)"}
    for obstacle in cell.geometry:
        size_mm = obstacle.box_mm or (obstacle.cylinder_mm or (0.0,))[:1] * 2
        if obstacle.name == "table" or not size_mm[0]:
            continue
        (x, y, _), (deep, wide) = obstacle.at_mm, size_mm[:2]
        kind = "rect" if obstacle.box_mm is not None else "circle"
        sides = {"x0": y - wide / 2, "x1": y + wide / 2, "y0": x - deep / 2, "y1": x + deep / 2}
        figure.add_shape(type=kind, **sides, **solid)
        if min(deep, wide) > _WRITTEN_MM:
            figure.add_annotation(x=y, y=x + deep / 2, text=escape(obstacle.name), showarrow=False, yanchor="bottom")
    r = _BASE_RADIUS_MM
    figure.add_shape(type="circle", x0=-r, x1=r, y0=-r, y1=r, fillcolor="#555", line_width=0)
    figure.add_annotation(x=0, y=0, text="arm", showarrow=False, font_color="#fff")
    stations = list(cell.stations.values())
    figure.add_trace(
        go.Scatter(
            x=[station.position_mm[1] for station in stations],
            y=[station.position_mm[0] for station in stations],
            mode="markers+text",
            text=[f"<b>{escape(station.name)}</b>" for station in stations],
            textposition="top center",
            marker={
                "size": 13,
                "color": [_REACHED if heights_mm[station.name] else _OUT_OF_REACH for station in stations],
                "line": {"color": "#fff", "width": 1},
            },
            customdata=[_span(heights_mm[station.name]) for station in stations],
            hovertemplate="%{text}: %{customdata}<extra></extra>",
        )
    )
    figure.update_xaxes(title_text="y [mm]", range=_Y_MM[::-1], constrain="domain")
    figure.update_yaxes(title_text="x [mm]", range=_X_MM, scaleanchor="x", constrain="domain")
    figure.update_layout(height=860, margin={"l": 60, "r": 40, "t": 20, "b": 50})
    return figure
