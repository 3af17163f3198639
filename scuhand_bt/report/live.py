"""What a person sees while a batch runs, and the table at its end."""

import time
from collections.abc import Callable, Iterator, Sequence
from datetime import timedelta

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from rich.box import SIMPLE
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.panel import Panel
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from scuhand_bt.cell.cell import Cell
from scuhand_bt.journal.results import DoseResult, SampleResult
from scuhand_bt.quantity import format_duration, format_mass
from scuhand_bt.recipe.plan import Job, Plan
from scuhand_bt.run.batch import BatchObserver
from scuhand_bt.run.control import Control
from scuhand_bt.run.outcome import BatchResult

REFRESH_S = 0.1
LAST_DOSES = 8
WIDE = 120
"""Columns of a terminal that shows the whole table of doses."""
HOLDS = "holds (sim.)"
"""What is in the container, which only a simulation can tell: of several powders all."""
WIDE_COLUMNS = (
    "id", "container", "target", "dispensed", "error mg", "tol. mg", "pulses", "scoops", "vibr. s", "seconds",
    "verdict", "controller", HOLDS,
)  # fmt: skip
NARROW_COLUMNS = ("id", "target", "dispensed", "error mg", "seconds", "verdict")
KEYS = "Ctrl-Z pauses, Ctrl-\\ stops after this sample, Ctrl-C stops now"
_STATUS = {
    Status.SUCCESS: ("✓", "green"),
    Status.FAILURE: ("✗", "red"),
    Status.RUNNING: ("▶", "bold yellow"),
    Status.INVALID: ("·", "dim"),
}


class PlainLines(BatchObserver):
    """The batch as plain lines, for a log: one for every sample that ends."""

    def __init__(self, write: Callable[[str], None], total: int) -> None:
        self._write = write
        self._total = total
        self._ended: set[str] = set()

    def job_started(self, job: Job, number: int) -> None:
        if job.sample is None:
            self._write(f"{job.name}")

    def sample_ended(self, result: SampleResult) -> None:
        if result.verdict == "not run" or (result.id in self._ended and result.is_good):
            return
        self._ended.add(result.id)
        self._write(f"[{len(self._ended)}/{self._total}] {result.id}: {_in_words(result)}")

    def sample_known(self, result: SampleResult) -> None:
        self._ended.add(result.id)


class LiveView(BatchObserver):
    """The current job's tree, progress and time left, the balance, and the finished doses; on a terminal."""

    def __init__(self, console: Console, cell: Cell, plan: Plan, control: Control) -> None:
        self._cell = cell
        self._control = control
        self._wish_shown = KEYS
        self._plan = plan
        self._total = len(plan.recipe.samples)
        self._results: dict[str, SampleResult] = {}
        self._job: Job | None = None
        self._root: Behaviour | None = None
        self._shown_at = 0.0
        self._live = Live(console=console, auto_refresh=False, transient=True)

    def __enter__(self) -> "LiveView":
        self._live.__enter__()
        return self

    def __exit__(self, *exception: object) -> None:
        self._live.__exit__(None, None, None)

    def ticked(self, root: Behaviour) -> None:
        self._root = root
        now, wish = time.monotonic(), self._wish()
        if now - self._shown_at >= REFRESH_S or wish != self._wish_shown:
            self._shown_at, self._wish_shown = now, wish
            self._live.update(self._picture(), refresh=True)

    def job_started(self, job: Job, number: int) -> None:
        self._job = job

    def sample_ended(self, result: SampleResult) -> None:
        self._results[result.id] = result

    def _picture(self) -> Group:
        done = len(self._results)
        left_s = self._time_left_s()
        progress = Table.grid(padding=(0, 1))
        progress.add_row(
            ProgressBar(total=max(self._total, 1), completed=done, width=40),
            f"{done}/{self._total} samples",
            f"about {format_duration(left_s)} left" if left_s is not None else "",
        )
        reading = self._cell.balance.latest
        balance = "no reading"
        if reading is not None:
            balance = f"{reading.value_mg / 1000:10.4f} g  {'stable' if reading.stable else 'moving'}"
            empty_mg = self._cell.believed.pan_empty_mg
            if empty_mg is not None:
                balance += f"   net {format_mass(reading.value_mg - empty_mg)}"
        status = Table.grid(padding=(0, 2))
        status.add_row("balance", balance)
        status.add_row("valve", f"{self._cell.hand.opening_mm:.2f} mm")
        status.add_row("run time", str(timedelta(seconds=round(self._cell.clock.now_s))))
        status.add_row("", self._wish_shown)
        tree = Text() if self._root is None else tree_text(self._root)
        name = self._job.name if self._job is not None else ""
        parts: list[RenderableType] = [
            progress,
            Panel(tree, title=Text(name), title_align="left"),
            status,
        ]
        if self._results:
            parts.append(doses_table(list(self._results.values())[-LAST_DOSES:], self._live.console.width))
        return Group(*parts)

    def _wish(self) -> str:
        """What was asked of the run, or can be."""
        if self._control.is_stopping:
            return "stopping"
        return "paused before the next action; Ctrl-Z continues" if self._control.is_pausing else KEYS

    def _time_left_s(self) -> float | None:
        """The mean time of the samples until now, for those left; the plan's forecast before the first."""
        done = len(self._results)
        if not done:
            return self._plan.duration_s
        return self._cell.clock.now_s / done * (self._total - done)


def tree_text(root: Behaviour, indent: int = 0) -> Text:
    """A tree as indented lines, each node with the sign of its status."""
    sign, style = _STATUS[root.status]
    text = Text("  " * indent + f"{sign} {root.name}\n", style=style)
    for child in root.children:
        text.append_text(tree_text(child, indent + 1))
    return text


def doses_table(results: Sequence[SampleResult], width: int = WIDE) -> Table:
    """The samples as a table, each dose of one with several in a row of its own below it.

    In less than `WIDE` columns it is without what can be looked up elsewhere.
    """
    is_judged = any(result.true_mg is not None for result in results)
    columns = [name for name in (WIDE_COLUMNS if width >= WIDE else NARROW_COLUMNS) if name != HOLDS or is_judged]
    table = Table(box=SIMPLE, show_edge=False, pad_edge=False, padding=(0, 1, 0, 0))
    for name in columns:
        is_text = name in ("id", "container", "verdict", "controller")
        table.add_column(name, justify="left" if is_text else "right", no_wrap=name in ("id", "verdict"))
    for result in results:
        for row in _rows(result):
            table.add_row(*(row.get(name, "") for name in columns))
    return table


def _rows(result: SampleResult) -> Iterator[dict[str, str | Text]]:
    """A sample's rows, by column."""
    is_single = len(result.doses) < 2
    verdict = result.verdict if result.code is None else f"{result.verdict}, {result.code}"
    style = "yellow" if result.is_open else "green" if result.is_good else "red"
    yield {
        "id": result.id,
        "container": result.container or "",
        **(_masses(result) if is_single else {}),
        "pulses": str(result.pulses),
        "scoops": str(result.scoops),
        "vibr. s": f"{result.vibration_s:.0f}",
        "seconds": f"{result.duration_s:.0f}",
        "verdict": Text(verdict, style=style),
        "controller": result.controller or "",
    }
    for dose in () if is_single else result.doses:
        style = "green" if dose.is_good else "yellow" if dose.is_open else "red"
        yield {"id": f"  {_name(dose, result)}", **_masses(dose), "verdict": Text(dose.verdict, style=style)}


def _masses(one: SampleResult | DoseResult) -> dict[str, str | Text]:
    has_error = one.error_mg is not None
    return {
        "target": format_mass(one.target_mg) if one.target_mg is not None else "",
        "dispensed": format_mass(one.dispensed_mg) if one.dispensed_mg is not None else "–",
        "error mg": f"{one.error_mg:+.1f} ± {one.uncertainty_mg:.1f}" if has_error else "–",
        "tol. mg": f"{one.tolerance_mg:g}" if one.tolerance_mg is not None else "",
        HOLDS: format_mass(one.true_mg) if one.true_mg is not None else "–",
    }


def _name(dose: DoseResult, result: SampleResult) -> str:
    """Which of a sample's doses it is."""
    is_one_container = len({one.container for one in result.doses}) == 1
    return dose.lot if is_one_container else f"{dose.container}: {dose.lot}"


def end_line(result: BatchResult, seconds: float) -> str:
    """One sentence about the whole run."""
    good = sum(1 for sample in result.samples if sample.is_good)
    line = f"{good} of {len(result.samples)} samples good; {format_duration(result.duration_s)} of run time"
    line += f", computed in {seconds:.1f} s"
    return f"{line}. Ended early: {result.reason}" if result.reason else f"{line}."


def _in_words(result: SampleResult) -> str:
    if result.dispensed_mg is None or result.target_mg is None or result.error_mg is None:
        return f"{result.verdict}" + (f" ({result.code}: {result.detail})" if result.code else "")
    if len(result.doses) < 2:
        said = _dispensed(result.dispensed_mg, result.target_mg, result.error_mg)
    else:
        doses = ((dose, _dispensed(dose.dispensed_mg, dose.target_mg, dose.error_mg)) for dose in result.doses)
        said = "; ".join(f"{_name(dose, result)} {masses}, {dose.verdict}" for dose, masses in doses)
    line = f"{said} in {result.pulses} pulses, {format_duration(result.duration_s)}: {result.verdict}"
    return line + (f" ({result.code})" if result.code else "")


def _dispensed(dispensed_mg: float, target_mg: float, error_mg: float) -> str:
    return f"{format_mass(dispensed_mg)} of {format_mass(target_mg)} ({error_mg:+.1f} mg)"
