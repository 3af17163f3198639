"""The command that makes a run's report, or compares two runs."""

from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from scuhand_bt.cli.shared import EXIT_ALTERED, PAGES, JournalArgument, LabOption, app, err, of_kind, out


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
    from scuhand_bt.api import find_run

    suffixes = (".pdf",) if pdf else PAGES
    found = [find_run(name, lab) for name in (run, other) if name is not None]
    path = of_kind(output or Path("-and-".join(one.id for one in found) + suffixes[0]), *suffixes)
    try:
        from scuhand_bt.report import comparison, page_of_run, write_pdf

        with ExitStack() as opened:
            contents = [opened.enter_context(one.opened()) for one in found]
            page = page_of_run(*contents) if len(contents) == 1 else comparison(*contents)
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
    for one, problem in zip(found, problems, strict=True):
        if problem is not None:
            err.print(Text(f"{one.id}: the journal is not as it was written: {problem}."))
    if any(problem is not None for problem in problems):
        raise typer.Exit(EXIT_ALTERED)
