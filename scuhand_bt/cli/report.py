"""The command that makes a run's report, or compares two runs."""

from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from scuhand_bt.cli.archive import EXIT_ALTERED, JournalArgument, find_journal
from scuhand_bt.cli.shared import PAGES, LabOption, app, err, of_kind, out


@app.command()
def report(
    run: JournalArgument,
    other: Annotated[
        str | None, typer.Argument(metavar="OTHER", help="Another run, to compare it with.", show_default=False)
    ] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="The page to write (.html).", show_default=False)
    ] = None,
    pdf: Annotated[bool, typer.Option("--pdf", help="Write it as a PDF (.pdf).")] = False,
    lab: LabOption = None,
) -> None:
    """Write a run's report as one page that needs no network, or compare two runs (needs the extra `report`)."""
    from scuhand_bt.journal.reader import open_contents

    suffixes = (".pdf",) if pdf else PAGES
    journals = [find_journal(name, lab) for name in (run, other) if name is not None]
    path = of_kind(output or Path("-and-".join(journal.stem for journal in journals) + suffixes[0]), *suffixes)
    try:
        from scuhand_bt.report.run_report import comparison, run_report, write_pdf

        with ExitStack() as opened:
            contents = [opened.enter_context(open_contents(journal)) for journal in journals]
            page = run_report(*contents) if len(contents) == 1 else comparison(*contents)
            problems = [one.verified.problem for one in contents]
        if pdf:
            write_pdf(page, path)
        else:
            path.write_text(page, encoding="utf-8")
    except ModuleNotFoundError as error:
        raise typer.BadParameter(f"a report needs {error.name}: pip install 'scuhand-bt[report]'") from None
    except OSError as error:
        raise typer.BadParameter(f"'{path}' cannot be written: {error.strerror or error}") from None
    out.print(Text(f"Written: {path}"), soft_wrap=True)
    for journal, problem in zip(journals, problems, strict=True):
        if problem is not None:
            err.print(Text(f"{journal.stem}: the journal is not as it was written: {problem}."))
    if any(problem is not None for problem in problems):
        raise typer.Exit(EXIT_ALTERED)
