"""Commands about what can be proven, and by whom it was done: verify, ledger, audit."""

import re
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from scuhand_bt.cli.listing import Listing
from scuhand_bt.cli.shared import (
    EXIT_ALTERED,
    JournalArgument,
    JsonFlag,
    LabOption,
    app,
    err,
    out,
    print_json,
    the_lab,
)
from scuhand_bt.exit_codes import ExitCode
from scuhand_bt.problems import SourceError
from scuhand_bt.quantity import counted

SHOWN_LINES = 10


@app.command()
def verify(
    run: JournalArgument,
    head: Annotated[str | None, typer.Option(metavar="HASH", help="The head that the run printed at its end.")] = None,
    key: Annotated[str | None, typer.Option(metavar="KEY", help="The public key that the lab signs with.")] = None,
    as_json: JsonFlag = False,
    lab: LabOption = None,
) -> None:
    """Check whether a journal was altered, and say what is proven of that and what is not."""
    from scuhand_bt.api import find_run
    from scuhand_bt.api.books import Ledger, LedgerFound
    from scuhand_bt.report import NO_CHAIN, proof_of

    head, key = _digits(head, "--head"), _digits(key, "--key")
    its = find_run(run, lab)
    try:
        ledger = Ledger(its.state).verified()
    except SourceError as error:
        err.print(Text(f"Note: {error}"))
        ledger = LedgerFound((), None)
    with its.opened(head) as contents:
        entries, its_head = contents.verified.entries, contents.verified.head
        proof = proof_of(contents, ledger, head, key) if contents.is_chained else None
    if proof is None:
        err.print(Text(f"{its.path}: {NO_CHAIN}."))
        raise typer.Exit(ExitCode.BAD_INPUT)
    if as_json:
        print_json({"run": its.id, "entries": entries, "head": its_head, **asdict(proof)})
    elif proof.problem is None:
        out.print(Text(f"{its.id}: {entries} entries. Head: {its_head}"))
        for title, lines in (("Proven:", proof.proven), ("Not proven:", proof.open)):
            out.print(title)
            for line in lines:
                out.print(Text(f"- {line}"), soft_wrap=True)
    if proof.problem is not None:
        err.print(Text(f"{its.path}: {proof.problem}."))
        raise typer.Exit(EXIT_ALTERED)


@app.command()
def ledger(
    head: Annotated[str | None, typer.Option(metavar="HASH", help="A head of the ledger that you noted.")] = None,
    new_key: Annotated[Path | None, typer.Option(metavar="FILE", help="Make a key to sign with, and stop.")] = None,
    as_json: JsonFlag = False,
    lab: LabOption = None,
) -> None:
    """Show the lab's ledger, with the heads of all runs, and check whether it was altered: note its head."""
    from scuhand_bt.api import find_state
    from scuhand_bt.api.books import KEY_VARIABLE, Ledger

    if new_key is not None:
        out.print(
            Text(f"Public key: {_made(new_key)}\nSet {KEY_VARIABLE}={new_key.absolute()} where runs are started.")
        )
        return
    head = _digits(head, "--head")
    found = Ledger(find_state(lab)).verified()
    problem = found.problem
    if problem is None and head is not None and not found.holds(head):
        problem = f"it never had the head {head}: it was rewritten, or belongs to another lab"
    wrong = next((one.line.number for one in found.kept if one.line.key is not None and not one.is_signed), None)
    if problem is None and wrong is not None:
        problem = f"line {wrong} was not signed with the key that it names"
    if as_json:
        lines = [{**one.line._asdict(), "hash": one.hash, "signature": one.signature} for one in found.kept]
        print_json({"head": found.head, "problem": problem, "lines": lines})
    else:
        table = Listing("line", "at", "run", "when", "entries", "head", "signed with")
        for line in (one.line for one in found.kept[-SHOWN_LINES:]):
            cells = (line.number, line.at, line.run, line.occasion, line.entries, line.head[:16], (line.key or "")[:16])
            table.add_row(*(Text(str(cell)) for cell in cells))
        out.print(table)
    if problem is not None:
        err.print(Text(f"The lab's ledger is not as it was written: {problem}."))
        raise typer.Exit(EXIT_ALTERED)
    if not as_json:
        out.print(f"{counted(len(found.kept), 'line')}, each fits the one before it. Head of the ledger: {found.head}")
        if head is not None:
            out.print("It contains the head that you noted: nothing before that was altered.")


@app.command()
def audit(
    run: Annotated[
        str | None, typer.Argument(help="A run, as for `show`; default: the lab's own records.", show_default=False)
    ] = None,
    as_json: JsonFlag = False,
    lab: LabOption = None,
) -> None:
    """Show the audit trail of a run, or of the lab's own records: who did what, when, and why."""
    from scuhand_bt.api import OpenLab, find_run
    from scuhand_bt.api.books import Inventory, Persons
    from scuhand_bt.report import deeds_in_lab, deeds_of_run

    problem = None
    if run is not None:
        with find_run(run, lab).opened() as contents:
            deeds, problem = list(deeds_of_run(contents)), contents.verified.problem
    else:
        loaded = the_lab(lab)
        state = OpenLab(loaded).state
        deeds = list(deeds_in_lab(Inventory(state, loaded.cell.cell).corrections(), Persons(state).enrolled()))
    if as_json:
        print_json([asdict(deed) for deed in deeds])
    else:
        table = Listing("at", "who", "what", "why", "entry")
        for deed in deeds:
            cells = (deed.at, deed.who, deed.what, deed.why, "" if deed.entry is None else str(deed.entry))
            table.add_row(*map(Text, cells))
        out.print(table if deeds else "There are no records yet.")
    if problem is not None:
        err.print(Text(f"The journal is not as it was written: {problem}."))
        raise typer.Exit(EXIT_ALTERED)


def _digits(text: str | None, option: str) -> str | None:
    """64 hexadecimal digits, as heads and keys are written."""
    if text is None:
        return None
    if re.fullmatch("[0-9a-f]{64}", digits := text.strip().lower()):
        return digits
    raise typer.BadParameter("it must have 64 hexadecimal digits", param_hint=option)


def _made(path: Path) -> str:
    from scuhand_bt.api.books import NEEDED, new_key

    try:
        return new_key(path)
    except OSError as error:
        raise typer.BadParameter(f"'{path}' cannot be written: {error.strerror}", param_hint="--new-key") from None
    except ModuleNotFoundError:
        raise typer.BadParameter(NEEDED, param_hint="--new-key") from None
