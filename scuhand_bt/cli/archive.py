"""Commands about what runs have left: runs, show, export."""

import sys
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import RenderableType
from rich.text import Text

from scuhand_bt.cli.listing import Listing
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
    from collections.abc import Iterable, Iterator

NEWEST = 50
"""So many runs are listed where not all are asked for."""


@app.command()
def runs(
    every: Annotated[bool, typer.Option("--all", help=f"Show all of them, not only the newest {NEWEST}.")] = False,
    as_json: JsonFlag = False,
    lab: LabOption = None,
) -> None:
    """List the lab's runs, the newest first, with the state and the number of good samples of each."""
    from scuhand_bt import api

    found = api.runs(lab)
    if as_json:
        print_json([asdict(one) for one in found])
        return
    table = Listing("run", "recipe", "mode", "started", "state", "good")
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
        str | None, typer.Option(metavar="SAMPLE", help="Show only the balance's own lines of one sample.")
    ] = None,
    as_json: JsonFlag = False,
    lab: LabOption = None,
) -> None:
    """Show what happened in a run: every action, dose, question, pause and fault, and whether its journal is whole."""
    from scuhand_bt.api import find_run

    its = find_run(run, lab)
    with its.told() as story:
        problem = story["chain"]["problem"]
        if not story["chain"]["entries"]:
            pass
        elif frames is not None:
            lines = its.frames(frames)
            if as_json:
                print_json(lines)
            for line in () if as_json else _frames(lines):
                out.print(line)
        elif as_json:
            from scuhand_bt.api import json_parts

            out.file.writelines(json_parts(story, indent=2))
            out.file.write("\n")
        else:
            _tell(story)
    if problem is not None:
        err.print(Text(f"The journal is not as it was written: {problem}."))
        raise typer.Exit(EXIT_ALTERED)


def _tell(story: Any) -> None:
    from scuhand_bt.api import SampleResult
    from scuhand_bt.report import chain_line, doses_table, header_lines, told

    for line in header_lines(story):
        out.print(Text(line))
    out.print("")
    if samples := [SampleResult.model_validate(values) for values in story["samples"]]:
        out.print(doses_table(samples, out.width))
        out.print("")
    del samples
    for happened in story["run"]:
        for line in told(happened):
            out.print(Text(line))
    out.print(Text(chain_line(story["chain"])))


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
    from scuhand_bt.api import canonical_parts, find_run
    from scuhand_bt.report import weighing_lines

    if as_csv == as_json:
        raise typer.BadParameter("choose one of them", param_hint="--csv/--json")
    if output is not None:
        of_kind(output, ".csv" if as_csv else ".json")
    with find_run(run, lab).opened() as contents:
        if (problem := contents.verified.problem) is not None:
            err.print(Text(f"Nothing was exported: the journal is not as it was written: {problem}."))
            raise typer.Exit(EXIT_ALTERED)
        parts = weighing_lines(contents) if as_csv else canonical_parts(contents)
        if output is None:
            sys.stdout.writelines(parts)
            return
        try:
            # Excel reads UTF-8 only behind a byte order mark; JSON must have none.
            _write(output, parts, "utf-8-sig" if as_csv else "utf-8")
        except OSError as error:
            raise typer.BadParameter(f"'{output}' cannot be written: {error.strerror}", param_hint="--output") from None
    out.print(Text(f"Written: {output}"))


def _write(output: Path, parts: "Iterable[str]", encoding: str) -> None:
    """Write a file that is whole, or as it was before."""
    new = output.with_name(f"{output.name}.part")
    try:
        with new.open("w", encoding=encoding, newline="") as file:
            file.writelines(parts)
        new.replace(output)
    finally:
        new.unlink(missing_ok=True)
