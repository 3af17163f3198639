"""A motion as a self-contained page: the arm moves in 3D over plots that follow it (extra `plot`)."""

from collections.abc import Iterator

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes

from scuhand_bt.report import viewer
from scuhand_bt.report.motion_panels import COLOURS, Panel, spread
from scuhand_bt.report.page import rendered
from scuhand_bt.report.show_move import ShownMove
from scuhand_bt.report.svg import INK, as_svg, drawing, new_figure, plain_axes

ROWS_PER_S = 25
_LEFT, _WIDE, _BOTTOM, _HIGH = 0.12, 0.74, 0.19, 0.75
"""Where a plot's axes are in it, as shares: the style of the page has the cursor there (`.cursor`)."""


def page_of_move(move: ShownMove) -> str:
    """The motion as a page."""
    motion = move.motion
    steps = max(1, int(motion.duration_s * ROWS_PER_S))
    rows = motion.at(np.linspace(0.0, motion.duration_s, steps + 1))
    played = {
        "job": move.title,
        "at_s": 0.0,
        "step_s": motion.duration_s / steps,
        "joints_rad": np.round(rows, 5).tolist(),
        "cone_mm": move.drawn["cones"][0]["mm"],
        "pan": move.container,
    }
    return rendered(
        "move.html",
        title=move.title,
        duration=f"{motion.duration_s:.2f} s.",
        packed=viewer.packed(move.drawn, [played], f"The arm's motion: {move.title}"),
        plots=list(_plots(move)),
    )


def _plots(move: ShownMove) -> Iterator[tuple[str, Markup]]:
    for k, panel in enumerate(move.panels()):
        with drawing():
            figure = new_figure(4.6, 2.6, is_laid_out=False)
            axes = plain_axes(figure.add_axes((_LEFT, _BOTTOM, _WIDE, _HIGH)))
            _draw(axes, panel, with_legend=k == 0)
            yield panel.name, Markup(as_svg(figure, f"{panel.name} over time"))


def _draw(axes: Axes, panel: Panel, *, with_legend: bool) -> None:
    for k, (column, colour) in enumerate(zip(panel.values.T, COLOURS, strict=False), start=1):
        axes.plot(panel.times_s, column, color=colour, linewidth=1.2, label=f"j{k}")
    low, high = panel.span
    labels = spread([limit for limit, _ in panel.limits], 0.08 * (high - low))
    for (limit, whose), place in zip(panel.limits, labels, strict=True):
        axes.axhline(limit, color=INK, linestyle="--", linewidth=0.6)
        axes.annotate(f" {limit:.3g} {whose}", (1, place), xycoords=("axes fraction", "data"), fontsize=7, va="center")
    axes.set(xlabel="time [s]", ylim=(low, high), xlim=(0.0, float(panel.times_s[-1])))
    if with_legend:
        axes.legend(ncols=4, fontsize=6, loc="upper right")
