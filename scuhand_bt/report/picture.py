"""One screen about a run that goes on: what it does and why, what waits for a person, and the newest doses.

It fits the terminal, whatever its size from 80 × 24 on: what a person has to see, the question and its answers, the
last verdict and what can be done, has its place first, and the tree and the doses share what is left.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime

from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.measure import Measurement
from rich.progress_bar import ProgressBar
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from scuhand_bt.journal.results import SampleResult
from scuhand_bt.quantity import counted, format_duration, format_mass
from scuhand_bt.report.doses import dose_name, doses_table, said_of
from scuhand_bt.run.questions import MEANINGS

SIGNS: Mapping[str, tuple[str, str]] = {
    "done": ("✓", "green"),
    "failed": ("✗", "red"),
    "running": ("▶", "bold yellow"),
    "to come": ("·", "dim"),
    "skipped": ("–", "dim"),
}
"""How each state of a node is shown: by its sign, and by a colour where there are colours."""


SIDE_BY_SIDE = 120
"""Columns in which the doses stand beside the tree, and not below it."""
LEAST_TREE = 44
"""Columns that a tree with its reasons needs beside a table."""


@dataclass(frozen=True)
class Node:
    """A line of the current job's tree."""

    depth: int
    name: str
    state: str
    """Of `SIGNS`."""
    why: str = ""
    """Of one that failed."""


@dataclass(frozen=True)
class Asked:
    """The question that waits."""

    text: str
    choices: Sequence[str]
    at: str
    """Since when, ISO 8601."""


@dataclass(frozen=True)
class Shown:
    """What there is to see of a run at one moment."""

    recipe: str
    mode: str
    total: int
    results: Sequence[SampleResult] = ()
    """The newest last."""
    run_time_s: float = 0.0
    left_s: float | None = None
    job: str = ""
    """What is under way, with its target, powder, container and attempt."""
    tree: Sequence[Node] = ()
    readings: str = ""
    """The balance and the valve."""
    soon: str = ""
    """What a person is going to be asked for."""
    state: str = ""
    """What was asked of the run; empty where it just goes on."""
    keys: str = ""
    """What can be asked of it."""
    question: Asked | None = None
    typed: str | None = None
    """What was typed in answer to it; None where it is not answered here."""
    note: str = ""
    """What is to be said of that."""


class Picture:
    """Draws it, in as many lines as the terminal has."""

    def __init__(self, shown: Shown) -> None:
        self._shown = shown

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        width, height = options.max_width, options.height or console.size.height
        above = list(self._lines(console, options, self._above(width)))
        below = list(self._lines(console, options, self._below()))
        room = height - len(above) - len(below)
        middle = self._middle(console, options, room) if room > 0 else []
        middle += [[Segment("")] for _ in range(room - len(middle))]
        for number, line in enumerate([*above, *middle, *below][:height]):
            if number:
                yield Segment.line()
            yield from line

    def __rich_measure__(self, console: Console, options: ConsoleOptions) -> Measurement:
        return Measurement(options.max_width, options.max_width)

    def _above(self, width: int) -> Iterator[RenderableType]:
        shown = self._shown
        yield _one_line(f" {shown.mode}: {shown.recipe} ", "reverse")
        done, good = len(shown.results), sum(result.is_good for result in shown.results)
        left = f", about {format_duration(shown.left_s)} left" if shown.left_s is not None else ""
        progress = Table.grid(padding=(0, 1))
        said = f"{done}/{shown.total} samples, {good} good; {format_duration(shown.run_time_s)} of run time{left}"
        bar = ProgressBar(total=max(shown.total, 1), completed=done, width=max(8, min(40, width - len(said) - 2)))
        progress.add_row(bar, _one_line(said))
        yield progress
        yield _one_line(shown.job, "bold")
        if shown.readings:
            yield _one_line(shown.readings)
        if shown.soon:
            yield _one_line(shown.soon, "yellow")

    def _below(self) -> Iterator[RenderableType]:
        shown = self._shown
        if shown.results:
            last = shown.results[-1]
            style = "green" if last.is_good else "yellow" if last.is_open else "red"
            yield Text(f"last: {last.id}: {in_words(last)}", style=style)
        if shown.question is not None:
            asked = shown.question
            waited_s = (datetime.now().astimezone() - datetime.fromisoformat(asked.at)).total_seconds()
            yield Text(f"? {asked.text} (waits for {format_duration(max(0.0, waited_s))})", style="bold yellow")
            for name in asked.choices:
                line = Text(f"  {name}", style="bold")
                yield line.append(f": {MEANINGS[name]}" if name in MEANINGS else "", style="not bold")
            if shown.note:
                yield Text(shown.note, style="red")
            if shown.typed is not None:
                yield _one_line(f"> {shown.typed}▏", "bold")
        yield _one_line(shown.state or shown.keys, "bold yellow" if shown.state else "dim")

    def _middle(self, console: Console, options: ConsoleOptions, room: int) -> list[list[Segment]]:
        newest = list(reversed(self._shown.results))
        width = options.max_width
        if width >= SIDE_BY_SIDE:
            table: RenderableType = doses_table(newest[: max(0, room - 2)], width - LEAST_TREE) if newest else ""
            room_for_tree = width - Measurement.get(console, options, table).maximum - 2
            pair = Table.grid(padding=(0, 2))
            pair.add_column(width=max(room_for_tree - 2, 1))
            pair.add_column()
            pair.add_row(_drawn(self._shown.tree, room), table)
            return list(self._lines(console, options, [pair]))[:room]
        table = doses_table(newest[:room], width)
        doses = list(self._lines(console, options, [table])) if newest and room > 4 else []
        doses = doses[: max(room // 2, room - len(self._shown.tree))]
        of_tree = room - len(doses)
        return list(self._lines(console, options, [_drawn(self._shown.tree, of_tree)]))[:of_tree] + doses

    @staticmethod
    def _lines(
        console: Console, options: ConsoleOptions, renderables: Iterable[RenderableType]
    ) -> Iterator[list[Segment]]:
        for one in renderables:
            yield from console.render_lines(one, options.update(height=None), pad=False)


def in_grams(gross_mg: float, *, is_stable: bool) -> str:
    """What the balance shows."""
    return f"balance {gross_mg / 1000:.4f} g, {'stable' if is_stable else 'moving'}"


def in_words(result: SampleResult) -> str:
    """A sample's result in a sentence, with the reason of one that failed."""
    why = f" ({result.code}: {result.detail})" if result.code else ""
    if result.dispensed_mg is None or result.target_mg is None or result.error_mg is None:
        return f"{result.verdict}{why}"
    if len(result.doses) < 2:
        said = _dispensed(result.dispensed_mg, result.target_mg, result.error_mg)
    else:
        doses = ((dose, _dispensed(dose.dispensed_mg, dose.target_mg, dose.error_mg)) for dose in result.doses)
        said = "; ".join(f"{dose_name(dose, result)} {masses}, {said_of(dose)}" for dose, masses in doses) + ";"
    pulses = counted(result.pulses, "pulse")
    line = f"{said} in {pulses}, {format_duration(result.duration_s)}: {said_of(result)}"
    return line + why


def _dispensed(dispensed_mg: float, target_mg: float, error_mg: float) -> str:
    return f"{format_mass(dispensed_mg)} of {format_mass(target_mg)} ({error_mg:+.1f} mg)"


def _drawn(tree: Sequence[Node], room: int) -> Text:
    """As many lines of the tree as there is room for, those around what is at work."""
    running = [place for place, node in enumerate(tree) if node.state == "running"]
    deepest = running[-1] if running else len(tree) - 1
    first = max(0, min(deepest - room // 2, len(tree) - room))
    text = Text(no_wrap=True, overflow="ellipsis")
    for node in tree[first : first + max(room, 0)]:
        sign, style = SIGNS[node.state]
        why = f": {node.why}" if node.why else ""
        text.append(f"{'  ' * node.depth}{sign} {node.name}{why}\n", style=style)
    text.rstrip()
    return text


def _one_line(text: str, style: str = "") -> Text:
    return Text(text, style=style, no_wrap=True, overflow="ellipsis")
