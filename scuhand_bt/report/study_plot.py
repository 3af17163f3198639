"""What a study came to, as a picture: time, odds, powder, failures, and what success and time depend on.

matplotlib is an optional extra (`pip install scuhand-bt[plot]`) and is loaded on the first plot.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any

from scuhand_bt.dosing.verdict import LIKELY
from scuhand_bt.study.odds import Odds
from scuhand_bt.study.trial import Trial

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOST_NAMED = 30
"""Samples that have a line of their own; of more it is told how many have which odds."""
BLUE, GREEN, RED, GREY = "#1f4e79", "#cfe8cf", "#b03a2e", "#444444"
LEAST_IN, LINE_IN, LINE = 2.8, 0.32, 30
"""A row's least height, what a line that has a name takes of it, and letters of a name on one line."""
WORDS = {"good": "success", "duration_s": "time"}


def plot_study(
    odds: Odds, trials: Sequence[Trial], depends: Mapping[str, Mapping[str, Mapping[str, Any]]], path: Path, title: str
) -> None:
    """Write a PNG or SVG, by the path's suffix. ImportError without matplotlib, OSError.

    `depends` tells of `good` and of `duration_s`, by place, what they depend on: `first` and `total` (Sobol indices),
    `rank` (Spearman), or the `means` by name.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from scuhand_bt.report.lettering import write_figure

    ranked = {what: {at: one for at, one in found.items() if "means" not in one} for what, found in depends.items()}
    named = {
        what: {f"{at}: {name}": mean for at, one in found.items() for name, mean in one.get("means", {}).items()}
        for what, found in depends.items()
    }
    lines = [min(len(odds.samples), MOST_NAMED), max(len(trials[0].used_mg), len(odds.not_good))]
    lines += [max(len(places) for places in found.values()) for found in (ranked, named) if any(found.values())]
    heights_in = [max(LEAST_IN, 1.2 + LINE_IN * many) for many in lines]
    figure = Figure(figsize=(12.0, sum(heights_in)), layout="constrained")
    FigureCanvasAgg(figure)
    # Each row is laid out by itself: long names in one leave the others their width.
    rows = figure.subfigures(len(lines), 1, squeeze=False, height_ratios=heights_in).flat
    (time, chances), (powder, failures), *others = (row.subplots(1, 2).tolist() for row in rows)
    _draw_time(time, odds, trials)
    _draw_chances(chances, odds)
    _draw_powder(powder, trials)
    _bars(failures, odds.not_good, "what failed" if odds.not_good else "nothing failed", "samples a run", RED)
    failures.set_xlim(left=0.0)
    if any(ranked.values()):
        for axes, (what, places) in zip(others[0], ranked.items(), strict=True):
            _draw_ranks(axes, f"what {WORDS[what]} depends on", places)
    if any(named.values()):
        for axes, (what, means) in zip(others[-1], named.items(), strict=True):
            scale, unit = (100.0, "in tolerance [%]") if what == "good" else (1.0 / 60.0, "a run [min]")
            by_name = {name: scale * mean for name, mean in means.items()}
            _bars(axes, by_name, f"{WORDS[what]} by name, on average", unit, BLUE)
    figure.suptitle(f"{title}, dry runs (SIMULATED): {len(trials)}", parse_math=False)
    write_figure(figure, path, dpi=130)


def _draw_time(axes: "Axes", odds: Odds, trials: Sequence[Trial]) -> None:
    from matplotlib.ticker import MaxNLocator

    expected = odds.duration_s
    label = "interval of 90 %" if odds.tells_intervals else "too few for an interval"
    axes.axvspan(expected.low / 60.0, expected.high / 60.0, color=GREEN, label=label)
    axes.hist([one.duration_s / 60.0 for one in trials], bins="auto", color=BLUE)
    axes.axvline(expected.middle / 60.0, color=RED, label="median")
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set(title="how long a run takes", xlabel="a run [min]", ylabel="dry runs")
    axes.legend(framealpha=1.0)  # the interval may be behind it, in the same green


def _draw_chances(axes: "Axes", odds: Odds) -> None:
    axes.set_title("how likely samples are in tolerance")
    axes.axvline(100.0 * LIKELY, color=RED, linestyle=":")
    axes.set_xlabel(f"probability [%]; below {LIKELY:.0%} is warned of (dots)")
    chances = odds.samples
    if len(chances) > MOST_NAMED:
        axes.hist([100.0 * one.probability for one in chances.values()], bins=20, range=(0.0, 100.0), color=BLUE)
        axes.set_ylabel("samples")
        return
    axes.set_xlim(0.0, 102.0)
    for at, one in enumerate(chances.values()):
        axes.plot([100.0 * one.low, 100.0 * one.high], [at, at], color=BLUE)
        axes.plot(100.0 * one.probability, at, "o", color=BLUE)
    _name_lines(axes, list(chances))


def _draw_powder(axes: "Axes", trials: Sequence[Trial]) -> None:
    """A box from quarter to quarter, its median, and the least and the most."""
    names = list(trials[0].used_mg)
    axes.set(title="powder used", xlabel="a run [g]")
    if names:
        used_g = [[one.used_mg[name] / 1000.0 for one in trials] for name in names]
        axes.boxplot(used_g, orientation="horizontal", positions=range(len(names)), whis=(0.0, 100.0), widths=0.5)
    _name_lines(axes, names)


def _draw_ranks(axes: "Axes", title: str, places: Mapping[str, Mapping[str, float]]) -> None:
    is_sobol = any("total" in one for one in places.values())
    total = {place: one["total" if is_sobol else "rank"] for place, one in places.items()}
    label = "Sobol index: total, and first order (black)" if is_sobol else "rank correlation (Spearman)"
    _bars(axes, total, title, label, BLUE)
    if is_sobol:
        axes.barh(range(len(places)), [one["first"] for one in places.values()], height=0.3, color="black")
    else:
        axes.set_xlim(-1.0, 1.0)
    axes.axvline(0.0, color=GREY, linewidth=0.8)


def _bars(axes: "Axes", values: Mapping[str, float], title: str, label: str, color: str) -> None:
    axes.barh(range(len(values)), list(values.values()), height=0.6, color=color)
    axes.set(title=title, xlabel=label)
    if not any(values.values()):
        axes.set_xticks([0.0])  # an axis of nothing would be one of hundredths about it
    _name_lines(axes, list(values))


def _name_lines(axes: "Axes", names: Sequence[str]) -> None:
    """The first one on top."""
    lines = ["\n".join(wrap(name.replace(".", ". "), LINE)).replace(". ", ".") for name in names]
    axes.set_yticks(range(len(names)), lines, fontsize=8, parse_math=False)
    axes.set_ylim(max(len(names), 1) - 0.5, -0.5)
