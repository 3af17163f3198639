"""The doses of a run as rows of text: what the terminal's table and the report's say of each, they say alike."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from rich.box import SIMPLE
from rich.table import Table
from rich.text import Text

from scuhand_bt.journal.results import DoseResult, SampleResult
from scuhand_bt.quantity import format_mass, format_tolerance

if TYPE_CHECKING:
    from scuhand_bt.recipe.plan import Plan
    from scuhand_bt.recipe.sample import Sample
    from scuhand_bt.specs import Source

HOLDS = "holds (sim.)"
"""What is in the container, which only a simulation can tell: of several powders all, and so in the sample's row."""
RECORDED = "recorded"
COMPOSITION = "composition"
"""What it came to, in atoms per formula of the product."""
WIDE_COLUMNS = (
    "id", "container", "target", "dispensed", "error mg", "tol. mg", "pulses", "scoops", "vibr. s", "seconds",
    "verdict", "controller", HOLDS, RECORDED, COMPOSITION,
)  # fmt: skip
NARROW_COLUMNS = ("id", "target", "dispensed", "error mg", "seconds", "verdict")
TEXT_COLUMNS = ("id", "container", "verdict", "controller", RECORDED, COMPOSITION)
FOLDED = ("verdict", RECORDED, COMPOSITION)
LEAST_VERDICT = 16
"""Columns that each of these has at least, if it needs them."""
STYLES = {"good": "green", "open": "yellow", "bad": "red"}


Tone = Literal["good", "open", "bad"]
"""`open`: in tolerance as far as it is known, and its container is still to go."""


@dataclass(frozen=True)
class DoseRow:
    """A row of the table: of a sample, or of one dose of a sample with several."""

    cells: Mapping[str, str]
    """The text of each column; a column that is absent is empty."""
    tone: Tone
    numbers: Mapping[str, float | None]
    """What the cells of numbers stand for, in mg or s, by column."""
    is_part: bool = False
    """One dose of the sample whose row is above."""


def said_of(one: SampleResult | DoseResult) -> str:
    """Its verdict; what is over or under by less than its tolerance is so only for all that is not known of it."""
    if isinstance(one, SampleResult):
        told = {said_of(dose) for dose in one.doses if dose.verdict == one.verdict}
        return told.pop() if len(told) == 1 else one.verdict
    is_unsure = one.verdict in ("over", "under") and abs(one.error_mg) <= one.tolerance_mg
    return f"{one.verdict}, not surely" if is_unsure else one.verdict


def columns_for(results: Sequence[SampleResult]) -> list[str]:
    """The columns of a table of these: what a simulation tells, or a workflow records, where there is any."""
    left_out = {HOLDS} if all(result.true_mg is None for result in results) else set()
    left_out |= {RECORDED} if not any(result.recorded for result in results) else set()
    left_out |= {COMPOSITION} if not any(result.composition for result in results) else set()
    return [name for name in WIDE_COLUMNS if name not in left_out]


def dose_rows(result: SampleResult) -> Iterator[DoseRow]:
    """A sample's row, and below it one for each of its doses where there are several."""
    is_single, is_one_container = len(result.doses) < 2, _is_one_container(result)
    verdict = said_of(result) if result.code is None else f"{said_of(result)}, {result.code}"
    counts = {
        "pulses": str(result.pulses),
        "scoops": str(result.scoops),
        "vibr. s": f"{result.vibration_s:.0f}",
        "seconds": f"{result.duration_s:.0f}",
    }
    yield DoseRow(
        {
            "id": result.id,
            "container": result.container or "",
            **(_masses(result) if is_single else {}),
            **(_held(result) if is_one_container else {}),
            **counts,
            "verdict": verdict,
            "controller": result.controller or "",
            RECORDED: "; ".join(f"{one.name} {one}" for one in result.recorded),
            COMPOSITION: str(result.composition) if result.composition is not None else "",
        },
        tone_of(result),
        {
            **(_numbers(result) if is_single else {}),
            **({HOLDS: result.true_mg} if is_one_container else {}),
            "pulses": result.pulses,
            "scoops": result.scoops,
            "vibr. s": result.vibration_s,
            "seconds": result.duration_s,
        },
    )
    for dose in () if is_single else result.doses:
        yield DoseRow(
            {
                "id": dose_name(dose, result),
                **_masses(dose),
                **({} if is_one_container else _held(dose)),
                "verdict": said_of(dose),
            },
            tone_of(dose),
            {**_numbers(dose), **({} if is_one_container else {HOLDS: dose.true_mg})},
            is_part=True,
        )


def asked_cells(sample: "Sample") -> tuple[str, str]:
    """What a sample asks for: masses and tolerances; of several powders side by side, as they are given."""
    masses_mg, tolerances_mg = asked_mg(sample)
    known = [format_tolerance(one) for one in tolerances_mg if one is not None]
    return " + ".join(map(format_mass, masses_mg)), f"{' + '.join(known)} mg" if known else ""


def asked_mg(sample: "Sample") -> tuple[list[float], list[float | None]]:
    """The masses that a sample asks for, and their tolerances, in mg."""
    masses_mg = _side_by_side(sample, "masses") or [ask.mass_mg for ask in sample.asks]
    alone = [] if sample.tolerance_mg is None else [sample.tolerance_mg]
    return masses_mg, [*_side_by_side(sample, "tolerances")] or [ask.tolerance_mg for ask in sample.asks] or [*alone]


def _side_by_side(sample: "Sample", name: str) -> list[float]:
    given = sample.inputs.get(name)
    return [one for one in given if isinstance(one, float)] if isinstance(given, tuple) else []


def amount_cell(plan: "Plan", source: "Source") -> str:
    """What a source holds at the start, and what a person puts into its mortar on the way."""
    amount, refills = format_mass(source.amount_mg), plan.refills[source.name]
    return f"{amount} + {refills} × {format_mass(source.refill_mg or 0.0)}" if refills else amount


def composed_lines(samples: "Iterable[Sample]") -> Iterator[str]:
    """What each composed sample is made of, in the order in which it is dosed."""
    for sample in samples:
        if (made := sample.composition) is not None:
            parts = (
                f"{format_mass(one.target_mg)} ± {format_tolerance(one.tolerance_mg)} mg of {one.lot} ({one.formula})"
                for one in made.powders
            )
            asked = " ".join(f"{one.element} {one.asked:.4g}" for one in made.elements)
            yield f"{sample.id}: {made.product} ({asked}, each within {100.0 * made.tolerance:g} %): {', '.join(parts)}"


def tone_of(one: SampleResult | DoseResult) -> Tone:
    """How good it is, for a colour and a sign."""
    return "open" if one.is_open else "good" if one.is_good else "bad"


def doses_table(results: Sequence[SampleResult], width: int | None = None) -> Table:
    """The samples as a table for a terminal, each dose of one with several in a row of its own below it.

    Where not all of its columns fit into `width`, it is without what can be looked up elsewhere. The verdict, what was
    recorded and a composition are folded and never cut; nothing else is.
    """
    rows = [row for result in results for row in dose_rows(result)]
    columns = columns_for(results)
    if width is not None and sum(2 + _width(name, rows) for name in columns) > width:
        columns = [*NARROW_COLUMNS, *(name for name in columns if name in (RECORDED, COMPOSITION))]
    table = Table(box=SIMPLE, show_edge=False, pad_edge=False, padding=(0, 1, 0, 0))
    for name in columns:
        justify: Literal["left", "right"] = "left" if name in TEXT_COLUMNS else "right"
        is_folded = name in FOLDED
        least = min(_width(name, rows), LEAST_VERDICT) if is_folded else None
        table.add_column(name, justify=justify, no_wrap=not is_folded, overflow="fold", min_width=least)
    for row in rows:
        cells: dict[str, str | Text] = {**row.cells}
        cells["id"] = _indent(row) + row.cells["id"]
        cells["verdict"] = Text(row.cells["verdict"], style=STYLES[row.tone])
        table.add_row(*(cells.get(name, "") for name in columns))
    return table


def _width(name: str, rows: Sequence[DoseRow]) -> int:
    """Of a column as far as it is not folded."""
    cells = [len(row.cells.get(name, "")) + (len(_indent(row)) if name == "id" else 0) for row in rows]
    widest = max([len(name), *cells])
    return min(widest, LEAST_VERDICT) if name in FOLDED else widest


def _indent(row: DoseRow) -> str:
    return "  " if row.is_part else ""


def dose_name(dose: DoseResult, result: SampleResult) -> str:
    """Which of a sample's doses it is."""
    return dose.lot if _is_one_container(result) else f"{dose.container}: {dose.lot}"


def _is_one_container(result: SampleResult) -> bool:
    return len({one.container for one in result.doses}) < 2


def _masses(one: SampleResult | DoseResult) -> dict[str, str]:
    has_error = one.error_mg is not None
    return {
        "target": format_mass(one.target_mg) if one.target_mg is not None else "",
        "dispensed": format_mass(one.dispensed_mg) if one.dispensed_mg is not None else "–",
        "error mg": f"{one.error_mg:+.1f} ± {one.uncertainty_mg:.1f}" if has_error else "–",
        "tol. mg": format_tolerance(one.tolerance_mg) if one.tolerance_mg is not None else "",
    }


def _held(one: SampleResult | DoseResult) -> dict[str, str]:
    return {HOLDS: format_mass(one.true_mg) if one.true_mg is not None else "–"}


def _numbers(one: SampleResult | DoseResult) -> dict[str, float | None]:
    return {
        "target": one.target_mg,
        "dispensed": one.dispensed_mg,
        "error mg": one.error_mg,
        "tol. mg": one.tolerance_mg,
    }
