"""A plot of one dose: the reading, the estimate, the opening and the vibration against time.

matplotlib is an optional extra (`pip install scuhand-bt[plot]`) and is loaded on the first plot.
"""

from collections.abc import Sequence
from pathlib import Path

from scuhand_bt.report.dose_curves import Point


def plot_dose(points: Sequence[Point], target_mg: float, tolerance_mg: float, path: Path, title: str = "") -> None:
    """Write a PNG or SVG, by the path's suffix. ValueError for an empty curve, ImportError without matplotlib."""
    if not points:
        raise ValueError("this dose has no curve to plot")
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from scuhand_bt.report.lettering import write_figure

    times_s = [point[0] - points[0][0] for point in points]
    figure = Figure(figsize=(8.0, 6.0), layout="constrained")
    FigureCanvasAgg(figure)
    mass, near, valve = figure.subplots(3, 1, sharex=True, height_ratios=[3.0, 2.0, 1.7])
    readings_mg = [point[1] for point in points]
    stable = [index for index, point in enumerate(points) if point[4]]
    for axes in (mass, near):
        axes.axhspan(target_mg - tolerance_mg, target_mg + tolerance_mg, color="#cfe8cf", label="tolerance")
        axes.plot(times_s, [point[5] for point in points], color="#d68910", linewidth=1.0, label="estimate")
        axes.plot(times_s, readings_mg, color="#1f4e79", linewidth=1.2, label="reading")
        axes.plot(
            [times_s[i] for i in stable],
            [readings_mg[i] for i in stable],
            "o",
            color="#b03a2e",
            markersize=5,
            label="stable mean",
        )
    near.set_ylim(target_mg - 5.0 * tolerance_mg, target_mg + 3.0 * tolerance_mg)
    mass.set_ylabel("mass [mg]")
    near.set_ylabel("near the\ntarget [mg]")
    mass.legend(loc="lower right", frameon=False)
    mass.set_title(title or f"dose of {target_mg:g} mg", loc="left", parse_math=False)
    valve.step(times_s, [point[2] for point in points], where="post", color="#444444", label="opening")
    valve.set_ylabel("opening [mm]")
    valve.set_ylim(0.0, 1.1 * max(0.1, *(point[2] for point in points)))
    valve.set_xlabel("time [s]")
    shaking = valve.twinx()
    shaking.fill_between(
        times_s, [100.0 * point[3] for point in points], step="post", color="#7d3c98", alpha=0.25, linewidth=0.0
    )
    shaking.set_ylim(0.0, 110.0)
    shaking.set_ylabel("vibration [%]", color="#7d3c98")
    valve.set_zorder(shaking.get_zorder() + 1)  # the line before the areas
    valve.patch.set_visible(False)
    figure.align_ylabels([mass, near, valve])
    write_figure(figure, path, dpi=130)
