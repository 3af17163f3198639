"""Commands that keep what runs have left: backup, restore, vacuum."""

from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from scuhand_bt.cli.shared import LabOption, app, err, of_kind, out
from scuhand_bt.exit_codes import ExitCode
from scuhand_bt.problems import SourceError
from scuhand_bt.quantity import counted


@app.command()
def backup(
    archive: Annotated[Path, typer.Argument(help="The file to write (ZIP).", show_default=False)],
    lab: LabOption = None,
) -> None:
    """Copy the lab, its inventory and ledger, and the journals of all runs into one file; runs may go on meanwhile."""
    from scuhand_bt.api import find_lab, find_state
    from scuhand_bt.report import back_up

    of_kind(archive, ".zip", option="ARCHIVE")
    count = back_up(find_lab(None, lab), find_state(lab), archive)
    out.print(Text(f"{archive}: {counted(count, 'file')}."), soft_wrap=True)


@app.command()
def restore(
    archive: Annotated[Path, typer.Argument(help="A file that `backup` wrote.", show_default=False)],
    folder: Annotated[Path, typer.Argument(help="The folder to make; it must not be there yet.", show_default=False)],
) -> None:
    """Restore a lab from a backup, and check whether any journal in it was altered."""
    from scuhand_bt.api import PastRun, find_state
    from scuhand_bt.api.books import Ledger
    from scuhand_bt.report import restore

    journals = restore(archive, folder)
    wrong = []
    for journal in journals:
        try:
            if (problem := PastRun(journal).problem()) is not None:
                wrong.append(f"{journal}: {problem}")
        except SourceError as error:
            wrong.append(str(error))
    if (problem := Ledger(find_state(folder)).verified().problem) is not None:
        wrong.append(f"the lab's ledger: {problem}")
    out.print(Text(f"{folder}: restored, with {counted(len(journals), 'run')}."), soft_wrap=True)
    for what in wrong:
        err.print(Text(f"Copied unchanged, though not as it was written: {what}."))
    if wrong:
        raise typer.Exit(ExitCode.CELL_FAULT)


@app.command()
def vacuum(lab: LabOption = None) -> None:
    """Put the last entries of killed runs, which are in a log beside the journal, into the journal itself."""
    from scuhand_bt.api import NotHeard, PastRun, find_state

    count = 0
    for its in map(PastRun, sorted(find_state(lab).glob("runs/*.sqlite"))):
        try:
            count += its.make_one_file()
        except NotHeard:
            out.print(Text(f"{its.id} is still running, and was skipped."))
    out.print(f"{count} {'journal is' if count == 1 else 'journals are'} one file now; the others were.")
