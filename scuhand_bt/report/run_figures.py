"""The figures of a run's report. Nothing in them is told by colour alone: shapes, hatches and lightness tell it too."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from scuhand_bt.journal.results import DoseResult, SampleResult
from scuhand_bt.quantity import counted
from scuhand_bt.report.dose_curves import CurveOfDose, Point
from scuhand_bt.report.doses import dose_name
from scuhand_bt.report.svg import INK, as_svg, drawing, new_figure, plain_axes
from scuhand_bt.report.time_spent import ACTIVITIES, Activity, JobTime

BEYOND = 3.0
"""An error larger than so many tolerances is drawn at the edge, as an arrow."""
FEW = 40
"""So many doses still have their names below them."""
LONGEST_NAME = 28
_FILLS: Mapping[Activity, tuple[str, str]] = {
    "moving": ("#1b4965", ""),
    "scooping": ("#a3671f", "//"),
    "emptying the cone": ("#e8c48a", ""),
    "changing containers": ("#6ba3c7", ".."),
    "changing the sheet": ("#8d99ae", "xx"),
    "settling and weighing": ("#cfe0ea", ""),
    "dosing": ("#2e7d4f", "\\\\"),
    "waiting for persons": ("#c44536", "--"),
    "paused": ("#f2c14e", "++"),
    "other": ("#9a9a9a", "||"),
}
"""A colour and a hatch for each; neighbours differ in lightness, so that grey tells them apart."""
_SETS = (("o", "A"), ("s", "B"))


def errors_figure(runs: Sequence[Sequence[SampleResult]]) -> str:
    """The error of every dose in tolerances, with twice its standard uncertainty, in the order of the first run.

    A second run is drawn beside the first, with squares for circles. Empty without a dose.
    """
    order = {
        name: place for place, name in enumerate(dict.fromkeys(_name(*one) for run in runs for one in _doses(run)))
    }
    if not order:
        return ""
    with drawing():
        figure = new_figure(9.5, 3.6)
        axes = plain_axes(figure.subplots())
        axes.axhspan(-1.0, 1.0, color="#8fbf9f", alpha=0.35, linewidth=0)
        for line in (-1.0, 0.0, 1.0):
            axes.axhline(line, color=INK, linewidth=0.8 if line else 0.5, linestyle="--" if line else "-")
        for number, run in enumerate(runs):
            aside = 0.0 if len(runs) == 1 else (-0.15, 0.15)[number]
            _draw_errors(axes, run, order, aside, *(_SETS[number] if len(runs) > 1 else ("o", "")))
        worst = max((abs(dose.error_mg) / dose.tolerance_mg for run in runs for _, dose in _doses(run)), default=0.0)
        limit = 1.5 if worst <= 1.2 else BEYOND + 0.3
        axes.set_ylim(-limit, limit)
        axes.set_ylabel("error in tolerances")
        axes.set_xlim(-0.7, max(len(order), 1) - 0.3)
        if len(order) <= FEW:
            _name_places(axes, list(order))
        else:
            axes.set_xlabel("dose")
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, 1.16), ncols=6, frameon=False, fontsize=8)
        return as_svg(figure, f"The error of {counted(len(order), 'dose')}, each as a multiple of its tolerance")


def times_figure(jobs: Sequence[JobTime]) -> str:
    """For each job in its order, how long each activity took, one above the other; empty without a job."""
    if not jobs:
        return ""
    used = [one for one in ACTIVITIES if any(job.spent_s[one] > 0 for job in jobs)]
    with drawing():
        figure = new_figure(9.5, 3.8)
        axes = plain_axes(figure.subplots())
        places = [place + side for place in range(len(jobs)) for side in (-0.4, 0.4)]
        if len(jobs) > FEW:  # as areas: a thousand bars of eight parts are no picture any more
            places = [place + side for place in range(len(jobs)) for side in (-0.5, 0.5)]
        base_s = [0.0] * len(jobs)
        for activity in used:
            colour, hatch = _FILLS[activity]
            top_s = [low + job.spent_s[activity] for low, job in zip(base_s, jobs, strict=True)]
            if len(jobs) > FEW:
                lows, tops = ([value for value in values for _ in range(2)] for values in (base_s, top_s))
                axes.fill_between(places, lows, tops, label=activity, facecolor=colour, linewidth=0)
            else:
                heights = [top - low for low, top in zip(base_s, top_s, strict=True)]
                style: dict[str, Any] = {"color": colour, "edgecolor": INK, "linewidth": 0.4, "hatch": hatch}
                axes.bar(range(len(jobs)), heights, 0.8, base_s, label=activity, **style)
            base_s = top_s
        if len(jobs) <= FEW:
            _name_places(axes, [job.name for job in jobs])
        else:
            axes.set_xlabel("job")
        axes.set_ylabel("run time [s]")
        axes.margins(x=0.01)
        axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=5, frameon=False, fontsize=8)
        return as_svg(
            figure, f"What the time of {counted(len(jobs), 'job')} was spent on; the table below has the numbers"
        )


class CurveFigures:
    """Draws one dose after the other in one figure: to make a new one would take most of the time."""

    def __init__(self) -> None:
        with drawing():
            self._figure: Figure = new_figure(3.4, 2.3, is_laid_out=False)
            self._figure.subplots_adjust(left=0.16, right=0.985, top=0.96, bottom=0.16, hspace=0.12)
            mass, valve = self._figure.subplots(2, 1, sharex=True, height_ratios=[3.0, 1.0])
            self._mass, self._valve = plain_axes(mass), plain_axes(valve)
            self._band = mass.axhspan(0.0, 1.0, color="#8fbf9f", alpha=0.5, linewidth=0)
            (self._estimate,) = mass.plot([], [], color="#b8651b", linewidth=0.9, linestyle="--")
            (self._reading,) = mass.plot([], [], color=INK, linewidth=1.0)
            (self._stable,) = mass.plot([], [], "o", color=INK, markersize=3, clip_on=False)
            (self._opening,) = valve.plot([], [], color=INK, linewidth=0.9, drawstyle="steps-post")
            (self._vibration,) = valve.plot(
                [], [], color="#b8651b", linewidth=0.9, linestyle=":", drawstyle="steps-post"
            )
            mass.set_ylabel("mg", labelpad=1)
            valve.set_ylabel("mm", labelpad=1)
            valve.set_xlabel("time [s]", labelpad=0)
            for axes in (mass, valve):
                axes.locator_params(nbins=4)
                axes.tick_params(labelsize=7, length=2, pad=2)
            valve.locator_params(axis="y", nbins=2)

    def draw(self, curve: CurveOfDose) -> str:
        """A dose: reading, estimate and tolerance above, opening and vibration (dotted, of 1) below."""
        points = _thinned(curve.points)
        times_s = [point[0] - points[0][0] for point in points]
        target_mg, tolerance_mg = curve.dose.target_mg, curve.dose.tolerance_mg
        with drawing():
            self._band.set_bounds(0.0, target_mg - tolerance_mg, 1.0, 2 * tolerance_mg)
            self._reading.set_data(times_s, [point[1] for point in points])
            self._estimate.set_data(times_s, [point[5] for point in points])
            stable = [(time_s, point[1]) for time_s, point in zip(times_s, points, strict=True) if point[4]]
            self._stable.set_data([one[0] for one in stable], [one[1] for one in stable])
            self._opening.set_data(times_s, [point[2] for point in points])
            self._vibration.set_data(times_s, [point[3] for point in points])
            top_mg = max(target_mg + tolerance_mg, *(point[1] for point in points))
            self._mass.set_ylim(-0.05 * top_mg, 1.06 * top_mg)
            self._valve.set_ylim(0.0, 1.15 * max(0.1, *(max(point[2], point[3]) for point in points)))
            self._valve.set_xlim(0.0, max(times_s[-1], 0.1))
            return as_svg(self._figure, f"The course of the dose of {curve.sample}")


MOST_POINTS = 160


def _thinned(points: Sequence[Point]) -> Sequence[Point]:
    """No more points than a small picture shows; those of a stable mean, and the last, always."""
    step = math.ceil(len(points) / MOST_POINTS)
    last = len(points) - 1
    return [point for place, point in enumerate(points) if place % step == 0 or point[4] or place == last]


def _name_places(axes: Axes, names: Sequence[str]) -> None:
    """Names below the places 0, 1, …; a long one is cut in its middle, as names often differ only by their ends."""
    half = LONGEST_NAME // 2
    short = [name if len(name) <= LONGEST_NAME else f"{name[: half - 1]}…{name[-half:]}" for name in names]
    axes.set_xticks(range(len(names)), short, rotation=60, ha="right", fontsize=7, parse_math=False)


def _draw_errors(
    axes: Axes, run: Sequence[SampleResult], order: Mapping[str, int], aside: float, marker: str, which: str
) -> None:
    groups: dict[str, list[tuple[float, float, float]]] = {}
    for result, dose in _doses(run):
        error = dose.error_mg / dose.tolerance_mg
        kind = "beyond" if abs(error) > BEYOND else "good" if dose.is_good else "open" if dose.is_open else "flagged"
        of_error = (order[_name(result, dose)] + aside, error, 2 * dose.uncertainty_mg / dose.tolerance_mg)
        groups.setdefault(kind, []).append(of_error)
    size = 4.5 if len(order) <= FEW else 2.5
    for kind, points in groups.items():
        x, y, spread = zip(*points, strict=True)
        label = f"{which}: {kind}" if which else kind
        style: dict[str, Any] = {
            "markersize": size,
            "color": INK,
            "ecolor": INK,
            "elinewidth": 0.7,
            "linestyle": "none",
        }
        if kind == "beyond":
            edge = [math.copysign(BEYOND, one) for one in y]
            axes.plot(x, edge, "x", color="#b03a2e", markersize=size + 2, label=f"{label} {BEYOND:g} tolerances")
        elif kind == "good":
            axes.errorbar(x, y, spread, fmt=marker, label=label, **style)
        elif kind == "open":
            axes.errorbar(x, y, spread, fmt=marker, mfc="none", label=label, **style)
        else:
            style |= {"markersize": size + 2, "color": "#b03a2e"}
            axes.errorbar(x, y, spread, fmt="^" if marker == "o" else "v", mfc="none", label=label, **style)


def _doses(run: Sequence[SampleResult]) -> list[tuple[SampleResult, DoseResult]]:
    return [(result, dose) for result in run for dose in result.doses if dose.tolerance_mg > 0]


def _name(result: SampleResult, dose: DoseResult) -> str:
    return result.id if len(result.doses) < 2 else f"{result.id}: {dose_name(dose, result)}"
