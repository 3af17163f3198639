"""A motion as a self-contained page, by plotly (extra `plot`): the arm moves in 3D over plots that follow it."""

import itertools
from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray
from plotly import graph_objects as go
from plotly.subplots import make_subplots

from scuhand_bt.motion.kinematics import Floats
from scuhand_bt.report.cell_mesh import CellMeshes, Indices, Mesh
from scuhand_bt.report.figure_page import figure_page
from scuhand_bt.report.motion_panels import COLOURS, Panel, spread
from scuhand_bt.report.show_move import (
    ARM_COLOUR,
    HAND_COLOURS,
    PATH_COLOUR,
    STANDING_COLOUR,
    STATION_COLOUR,
    ShownMove,
)

FRAMES_PER_S = 25
_COLUMNS = 2
_SCENE_SHARE = 0.45
"""Of the figure's height, what the 3D scene takes."""
_ROOM_MM = 20.0
_EYE = {"x": 1.35, "y": -1.35, "z": 0.85}
_LIGHT = {"x": 1000.0, "y": -2000.0, "z": 3000.0}


def move_page(move: ShownMove) -> str:
    """The motion as a self-contained HTML page."""
    intro = (
        f"<p>{move.motion.duration_s:.2f} s. Drag to turn, wheel to zoom; click a joint in the legend to hide it. "
        "Red: the way of the cone's apex. Green: where it stands at the stations.</p>"
    )
    return figure_page(move.title, move_figure(move), intro)


def move_figure(move: ShownMove) -> go.Figure:
    """The 3D scene over the five plots, with a frame of the animation for every 1/25 s."""
    shown, meshes = move.panels(), CellMeshes(move.scene)
    rows = 1 + -(-len(shown) // _COLUMNS)
    plots: list[list[dict[str, str] | None]]
    plots = [[{} if c + _COLUMNS * r < len(shown) else None for c in range(_COLUMNS)] for r in range(rows - 1)]
    figure = make_subplots(
        rows=rows,
        cols=_COLUMNS,
        specs=[[{"type": "scene", "colspan": _COLUMNS}, None], *plots],
        row_heights=[_SCENE_SHARE, *[(1 - _SCENE_SHARE) / (rows - 1)] * (rows - 1)],
        horizontal_spacing=0.16,
        vertical_spacing=0.075,
        subplot_titles=["", *(panel.name for panel in shown)],
    )
    _draw_cell(figure, meshes, move)
    for k, panel in enumerate(shown):
        _draw_panel(figure, panel, 2 + k // _COLUMNS, 1 + k % _COLUMNS, with_legend=k == 0)
    # What moves comes last: the arm, and a line at the present time in every plot.
    still = len(figure.data)
    _draw_arm_and_cursors(figure, meshes.arm(move.motion.start), shown)
    moving = list(range(still, len(figure.data)))
    times_s = np.linspace(0.0, move.motion.duration_s, max(2, int(move.motion.duration_s * FRAMES_PER_S)))
    arms = [meshes.arm(q) for q in move.motion.at(times_s)]
    figure.frames = [
        go.Frame(
            name=str(k),
            data=[go.Mesh3d(**_corners(arm)), *[go.Scatter(x=[t, t])] * len(shown)],
            traces=moving,
        )
        for k, (arm, t) in enumerate(zip(arms, times_s, strict=True))
    ]
    _add_controls(figure, times_s)
    # Of everything at all times: otherwise the scene would be scaled anew with every frame.
    solids_m = [mesh.points_m for mesh in itertools.chain(meshes.standing, *arms)]
    points_mm = 1000 * np.vstack([*solids_m, *move.places_m.values()])
    lows_mm, highs_mm = points_mm.min(axis=0) - _ROOM_MM, points_mm.max(axis=0) + _ROOM_MM
    axes = {
        f"{name}axis": {"title": f"{name} [mm]", "range": [low, high]}
        for name, low, high in zip("xyz", lows_mm, highs_mm, strict=True)
    }
    figure.update_scenes(**axes, aspectmode="data", camera={"eye": _EYE, "center": {"x": 0, "y": 0, "z": -0.15}})
    legend = {"title": "joint", "x": 0.58, "y": 0.14, "yanchor": "top", "orientation": "h"}
    figure.update_layout(height=1500, margin={"l": 60, "r": 110, "t": 10, "b": 50}, legend=legend)
    return figure


def _draw_cell(figure: go.Figure, meshes: CellMeshes, move: ShownMove) -> None:
    """What stands still, its names, the stations and the apex's way, in millimetres."""

    def add(trace: Any) -> None:
        figure.add_trace(trace, row=1, col=1)

    for mesh in meshes.standing:
        add(
            go.Mesh3d(
                **_corners([mesh]),
                **_triangles([mesh]),
                color=STANDING_COLOUR,
                opacity=0.22,
                flatshading=True,
                hoverinfo="name",
                name=escape(mesh.name),
            )
        )
        ends_mm = np.full((len(mesh.edges), 3, 3), np.nan)
        ends_mm[:, :2] = 1000 * mesh.points_m[mesh.edges]
        x, y, z = ends_mm.reshape(-1, 3).T
        edges = {"mode": "lines", "line": {"color": STANDING_COLOUR, "width": 2}, "hoverinfo": "skip"}
        add(go.Scatter3d(x=x, y=y, z=z, **edges, showlegend=False))
    x, y, z = 1000 * move.path_m(np.linspace(0.0, move.motion.duration_s, 200)).T
    add(
        go.Scatter3d(
            x=x, y=y, z=z, mode="lines", line={"color": PATH_COLOUR, "width": 5}, name="apex", showlegend=False
        )
    )
    x, y, z = 1000 * np.array(list(move.places_m.values())).T
    add(
        go.Scatter3d(
            x=x,
            y=y,
            z=z,
            mode="markers+text",
            text=list(move.places_m),
            textposition="top center",
            marker={"color": STATION_COLOUR, "size": 5},
            textfont={"color": STATION_COLOUR, "size": 12},
            name="station",
            showlegend=False,
        )
    )


def _corners(meshes: Sequence[Mesh]) -> dict[str, NDArray[np.float32]]:
    """The corners of solids [mm], as plotly takes them; single precision halves the page."""
    x, y, z = 1000 * np.vstack([mesh.points_m for mesh in meshes]).T.astype(np.float32)
    return {"x": x, "y": y, "z": z}


def _triangles(meshes: Sequence[Mesh]) -> dict[str, Indices]:
    """The triangles between these corners."""
    firsts = np.cumsum([0, *(len(mesh.points_m) for mesh in meshes[:-1])])
    i, j, k = np.vstack([mesh.triangles + first for mesh, first in zip(meshes, firsts, strict=True)]).T
    return {"i": i, "j": j, "k": k}


def _draw_arm_and_cursors(figure: go.Figure, arm: Sequence[Mesh], shown: Sequence[Panel]) -> None:
    """The arm, and a line in every plot at the beginning."""
    colours = [HAND_COLOURS.get(mesh.name, ARM_COLOUR) for mesh in arm for _ in mesh.triangles]
    look = {"facecolor": colours, "flatshading": True, "lighting": {"ambient": 0.65, "diffuse": 0.6, "specular": 0.05}}
    solid = go.Mesh3d(**_corners(arm), **_triangles(arm), **look, lightposition=_LIGHT, hoverinfo="skip")
    figure.add_trace(solid, row=1, col=1)
    for k, panel in enumerate(shown):
        line = go.Scatter(
            x=[0, 0],
            y=panel.span,
            mode="lines",
            line={"color": "#888", "width": 2},
            hoverinfo="skip",
            showlegend=False,
        )
        figure.add_trace(line, row=2 + k // _COLUMNS, col=1 + k % _COLUMNS)


def _draw_panel(figure: go.Figure, panel: Panel, row: int, col: int, *, with_legend: bool) -> None:
    at: dict[str, Any] = {"row": row, "col": col}
    joints = panel.values.shape[1] > 1
    for k, (column, colour) in enumerate(zip(panel.values.T, COLOURS, strict=False), start=1):
        name = f"j{k}" if joints else "spill angle"
        figure.add_trace(
            go.Scatter(
                x=panel.times_s.astype(np.float32),
                y=column.astype(np.float32),
                name=name,
                legendgroup=name,
                showlegend=joints and with_legend,
                line={"color": colour, "width": 1.6},
            ),
            **at,
        )
    low, high = panel.span
    labels = spread([limit for limit, _ in panel.limits], 0.07 * (high - low))
    for (limit, whose), label in zip(panel.limits, labels, strict=True):
        figure.add_trace(
            go.Scatter(
                x=panel.times_s[[0, -1]],
                y=[limit, limit],
                mode="lines",
                line={"dash": "dash", "color": "#888", "width": 1},
                hoverinfo="skip",
                showlegend=False,
            ),
            **at,
        )
        text = f"{limit:.3g} {whose}"
        figure.add_annotation(
            x=panel.times_s[-1], y=label, text=text, showarrow=False, xanchor="left", font_size=11, **at
        )
    figure.update_xaxes(title_text="time [s]", range=[0, float(panel.times_s[-1])], **at)
    figure.update_yaxes(range=[low, high], **at)


def _add_controls(figure: go.Figure, times_s: Floats) -> None:
    """Play, pause and a slider under the 3D scene."""

    def how(frame_ms: float) -> dict[str, Any]:
        frame = {"duration": frame_ms, "redraw": True}
        return {"frame": frame, "transition": {"duration": 0}, "mode": "immediate", "fromcurrent": True}

    steps = [
        {"method": "animate", "label": f"{t:.2f}", "args": [[frame.name], how(0.0)]}
        for t, frame in zip(times_s, figure.frames, strict=True)
    ]
    play = {"method": "animate", "label": "play", "args": [None, how(1000 * float(times_s[1]))]}
    pause = {"method": "animate", "label": "pause", "args": [[None], how(0.0)]}
    bottom = figure.layout.scene.domain.y[0]
    figure.update_layout(
        sliders=[
            {
                "steps": steps,
                "x": 0.14,
                "len": 0.86,
                "y": bottom,
                "pad": {"t": 0},
                "currentvalue": {"prefix": "time ", "suffix": " s"},
            }
        ],
        updatemenus=[
            {
                "type": "buttons",
                "direction": "left",
                "buttons": [play, pause],
                "showactive": False,
                "x": 0.0,
                "xanchor": "left",
                "y": bottom,
                "yanchor": "top",
                "pad": {"t": 20},
            }
        ],
    )
