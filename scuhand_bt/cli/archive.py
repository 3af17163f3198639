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

from scuhand_bt.cli.ongoing import runs_folder
from scuhand_bt.cli.shared import JsonFlag, LabOption, app, err, of_kind, out, print_json
from scuhand_bt.exit_codes import ExitCode

if TYPE_CHECKING:
    from collections.abc import Iterator

    from scuhand_bt.journal.reader import Contents

EXIT_ALTERED = ExitCode.CELL_FAULT
NEWEST = 50
"""So many runs are listed where not all are asked for."""
JournalArgument = Annotated[
    str,
    typer.Argument(
        metavar="RUN", help="A run's id, a unique beginning of it, 'last', or a journal's file.", show_default=False
    ),
]


def find_journal(run: str, lab: Path | None) -> Path:
    """The journal of a run, by its file or as `find_run` finds it. Raises SourceError if there is none."""
    from scuhand_bt.run.resume import find_run

    path = Path(run)
    return path if path.suffix == ".sqlite" or path.is_file() else find_run(runs_folder(lab), run)


@app.command()
def runs(
    every: Annotated[bool, typer.Option("--all", help=f"All of them, not only the newest {NEWEST}.")] = False,
    as_json: JsonFlag = False,
    lab: LabOption = None,
) -> None:
    """List the lab's runs, the newest first: what each was, in what state it is, and how many samples are good."""
    from scuhand_bt.journal.archive import summaries

    found = summaries(runs_folder(lab))
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
    out.print(table if found else Text(f"There are no runs in {runs_folder(lab)}."))
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
    from scuhand_bt.journal.archive import frames as frames_of
    from scuhand_bt.journal.archive import story
    from scuhand_bt.journal.reader import open_contents

    parts: list[RenderableType] = []
    with open_contents(find_journal(run, lab)) as contents:
        problem = contents.verified.problem
        if contents.verified.entries:
            found = frames_of(contents, frames) if frames is not None else story(contents)
            if as_json:
                print_json(found)
            else:
                parts = list(_frames(found) if frames else _told(found))
    for part in parts:
        out.print(part)
    if problem is not None:
        err.print(Text(f"The journal is not as it was written: {problem}."))
        raise typer.Exit(EXIT_ALTERED)


def _told(story: Any) -> "Iterator[RenderableType]":
    from scuhand_bt.journal.results import SampleResult
    from scuhand_bt.report.doses import doses_table
    from scuhand_bt.report.run_story import chain_line, header_lines, told

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
    from scuhand_bt.journal.reader import open_contents

    if as_csv == as_json:
        raise typer.BadParameter("one of them says what to write", param_hint="--csv/--json")
    if output is not None:
        of_kind(output, ".csv" if as_csv else ".json")
    with open_contents(find_journal(run, lab)) as contents:
        problem = contents.verified.problem
        text = "" if problem is not None else _exported(contents, as_csv=as_csv)
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


def _exported(contents: "Contents", *, as_csv: bool) -> str:
    from scuhand_bt.journal.export import canonical_of
    from scuhand_bt.report.weighing_record import weighing_record

    return weighing_record(contents) if as_csv else canonical_of(contents)
