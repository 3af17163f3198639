"""Commands about what runs have left: runs, show, export."""

import sys
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from scuhand_bt.cli.shared import (
    EXIT_ALTERED,
    JournalArgument,
    JsonFlag,
    LabOption,
    app,
    err,
    of_kind,
    out,
    print_json,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

NEWEST = 50
"""So many runs are listed where not all are asked for."""


@app.command()
def runs(
    every: Annotated[bool, typer.Option("--all", help=f"All of them, not only the newest {NEWEST}.")] = False,
    as_json: JsonFlag = False,
    lab: LabOption = None,
) -> None:
    """List the lab's runs, the newest first: what each was, in what state it is, and how many samples are good."""
    from scuhand_bt import api

    found = api.runs(lab)
    if as_json:
        print_json([asdict(one) for one in found])
        return
    table = Table("run", "recipe", "mode", "started", "state", "good", show_edge=False)
    for one in found if every else found[:NEWEST]:
        good = f"{one.good}" if one.total is None else f"{one.good}/{one.total}"
        state = f"{one.state}: {one.reason}" if one.reason else one.state
        state += f" (since {datetime.fromisoformat(one.since).astimezone():%H:%M:%S})" if one.since else ""
        mode = "SIMULATED" if one.mode == "SIMULATED" else one.mode.partition(" (")[0]
        table.add_row(*(Text(cell) for cell in (one.id, one.recipe, mode, one.started, state, good)))
    out.print(table if found else Text(f"There are no runs in {api.find_state(lab) / 'runs'}."))
    if not every and len(found) > NEWEST:
        out.print(f"… and {len(found) - NEWEST} older ones (--all).")


@app.command()
def show(
    run: JournalArgument,
    frames: Annotated[
        str | None, typer.Option(metavar="SAMPLE", help="Only the balance's own lines while it weighed for a sample.")
    ] = None,
    as_json: JsonFlag = False,
    lab: LabOption = None,
) -> None:
    """Tell what happened in a run: every action, dose, question, pause and fault, and whether its journal is whole."""
    from scuhand_bt.api import find_run

    its = find_run(run, lab)
    story = its.story()
    problem = story["chain"]["problem"]
    if story["chain"]["entries"]:
        lines = its.frames(frames) if frames is not None else None
        if as_json:
            print_json(story if lines is None else lines)
        else:
            for part in _told(story) if lines is None else _frames(lines):
                out.print(part)
    if problem is not None:
        err.print(Text(f"The journal is not as it was written: {problem}."))
        raise typer.Exit(EXIT_ALTERED)


def _told(story: Any) -> "Iterator[RenderableType]":
    from scuhand_bt.api import SampleResult
    from scuhand_bt.report import chain_line, doses_table, header_lines, told

    yield from map(Text, header_lines(story))
    yield ""
    if story["samples"]:
        yield doses_table([SampleResult.model_validate(values) for values in story["samples"]], out.width)
        yield ""
    for happened in story["run"]:
        yield from map(Text, told(happened))
    yield Text(chain_line(story["chain"]))


def _frames(lines: Any) -> "Iterator[RenderableType]":
    for line in lines:
        stable = "stable" if line["stable"] else "moving"
        yield Text(f"{line['time_s']:10.3f} s  {line['value_mg']:12.3f} mg  {stable}  {line['raw']!r}")


@app.command()
def export(
    run: JournalArgument,
    as_csv: Annotated[bool, typer.Option("--csv", help="The weighing record, one row for every weighing.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="The canonical export, equal for equal runs.")] = False,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="The file to write; default: standard output.")
    ] = None,
    lab: LabOption = None,
) -> None:
    """Write a run's weighing record (CSV, for an audit or a spreadsheet) or its canonical export (JSON)."""
    from scuhand_bt.api import find_run
    from scuhand_bt.report import weighing_csv

    if as_csv == as_json:
        raise typer.BadParameter("one of them says what to write", param_hint="--csv/--json")
    if output is not None:
        of_kind(output, ".csv" if as_csv else ".json")
    its = find_run(run, lab)
    with its.opened() as contents:
        problem = contents.verified.problem
        text = weighing_csv(contents) if as_csv and problem is None else ""
    if not as_csv and problem is None:
        text = its.export()
    if problem is not None:
        err.print(Text(f"Nothing is exported from a journal that is not as it was written: {problem}."))
        raise typer.Exit(EXIT_ALTERED)
    if output is None:
        sys.stdout.write(text)
        return
    try:
        # Excel reads UTF-8 only behind a byte order mark; JSON must have none.
        output.write_text(text, encoding="utf-8-sig" if as_csv else "utf-8", newline="")
    except OSError as error:
        raise typer.BadParameter(f"'{output}' cannot be written: {error.strerror}", param_hint="--output") from None
    out.print(Text(f"Written: {output}"))
