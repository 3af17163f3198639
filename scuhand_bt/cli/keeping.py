"""Commands that keep what runs have left: backup, restore, vacuum."""

from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from scuhand_bt.cli.ongoing import runs_folder
from scuhand_bt.cli.shared import LabOption, app, err, out
from scuhand_bt.exit_codes import ExitCode
from scuhand_bt.problems import SourceError


@app.command()
def backup(
    archive: Annotated[Path, typer.Argument(help="The file to write (ZIP).", show_default=False)],
    lab: LabOption = None,
) -> None:
    """Copy the lab, its inventory and ledger, and the journals of all runs into one file; runs may go on meanwhile."""
    from scuhand_bt.lab import find_lab
    from scuhand_bt.report.backup import back_up

    count = back_up(find_lab(None, lab), runs_folder(lab).parent, archive)
    out.print(Text(f"{archive}: {count} files."), soft_wrap=True)


@app.command()
def restore(
    archive: Annotated[Path, typer.Argument(help="A file that `backup` wrote.", show_default=False)],
    folder: Annotated[Path, typer.Argument(help="The folder to make; it must not be there yet.", show_default=False)],
) -> None:
    """Make a lab anew from a backup, and find out whether every journal in it is as it was written."""
    from scuhand_bt.journal.reader import open_verified
    from scuhand_bt.lab_state.ledger import Ledger
    from scuhand_bt.report.backup import STATE, restore

    journals = restore(archive, folder)
    wrong = []
    for journal in journals:
        try:
            with open_verified(journal) as (_, _, verified):
                if verified.problem is not None:
                    wrong.append(f"{journal}: {verified.problem}")
        except SourceError as error:
            wrong.append(str(error))
    if (problem := Ledger(folder / STATE).verified().problem) is not None:
        wrong.append(f"the lab's ledger: {problem}")
    out.print(Text(f"{folder}: restored, with {len(journals)} runs."), soft_wrap=True)
    for what in wrong:
        err.print(Text(f"Not as it was written, and copied as it was: {what}."))
    if wrong:
        raise typer.Exit(ExitCode.CELL_FAULT)


@app.command()
def vacuum(lab: LabOption = None) -> None:
    """Make one file of every run that was killed, and whose last entries are in a log beside its journal."""
    from scuhand_bt.journal.copies import make_one_file
    from scuhand_bt.journal.presence import Held

    count = 0
    for journal in sorted(runs_folder(lab).glob("*.sqlite")):
        try:
            count += make_one_file(journal)
        except Held:
            out.print(Text(f"{journal.stem} goes on, and is left alone."))
    out.print(f"{count} {'journal is' if count == 1 else 'journals are'} one file now; the others were.")
