"""Commands about the cell's balance: what is known of it and since when, and to forget that."""

from collections.abc import Mapping
from datetime import datetime
from typing import Annotated

import typer
from rich.text import Text

from scuhand_bt.cli.listing import Listing
from scuhand_bt.cli.shared import JsonFlag, LabOption, app, lab_state, out, print_json, the_lab

group = typer.Typer(invoke_without_command=True)
app.add_typer(group, name="balance")

WORDS: Mapping[str, tuple[str, str]] = {
    "delay_s": ("shows a load late by", "s"),
    "check_weight_error_mg": ("weighs a check weight off by", "mg"),
    "repeatability_mg": ("repeatability", "mg"),
    "noise_mg": ("noise of a reading", "mg"),
    "drift_mg_per_s": ("drift", "mg/s"),
    "minimum_weight_mg": ("minimum weight by USP 41", "mg"),
    "lag_s": ("half its delay, by doses", "s"),
    "lag_doubt": ("doubt of that", "%"),
    "filter": ("its filter, by doses", ""),
    "filter_misfit": ("error of that filter, of what is yet to be shown", "%"),
    "noise_in_doses_mg": ("noise of a reading, by doses", "mg"),
    "shaken_noise_in_doses_mg": ("the same while it is shaken", "mg"),
}
"""What each figure is called, and its unit."""


@group.callback()
def balance(
    context: typer.Context,
    simulated: Annotated[bool, typer.Option("--simulated", help="What simulated runs have measured.")] = False,
    lab: LabOption = None,
    as_json: JsonFlag = False,
) -> None:
    """Show what is known of the balance, since when and by which run; `balance forget` forgets it."""
    if context.invoked_subcommand is not None:
        context.obj = lab
        return
    from scuhand_bt.api.books import BALANCE_BELIEVED_FOR

    loaded = the_lab(lab)
    state = lab_state(loaded)
    rows = state.balance_figures(loaded.cell.balance.readability_mg, simulated=simulated)
    if as_json:
        keys = ("balance", "figure", "value", "says", "at")
        print_json([dict(zip(keys, row, strict=True)) for row in rows])
        return
    if not rows:
        out.print("Nothing is known yet: `scuhand-bt run recipes/start_of_day.yaml` and doses measure the balance.")
        return
    table = Listing("balance", "what", "figure", "says", "at")
    for name, figure, value, says, at in rows:
        words, unit = WORDS.get(figure, (figure, ""))  # which another version has measured
        table.add_row(Text(name), words, Text(_told(value, unit)), Text(says), at)
    out.print(table)
    if simulated:
        out.print("SIMULATED: no run reads this.")
    for name, learnt in state.balances(simulated=simulated).items():
        if learnt.is_older_than(BALANCE_BELIEVED_FOR, datetime.now().astimezone()):
            days = f"more than {BALANCE_BELIEVED_FOR.days} days ago"
            out.print(Text(f"{name}: its delay was learnt from doses {days}; the next dose learns it anew."))


def _told(value: float | str, unit: str) -> str:
    if isinstance(value, str):
        return value
    return f"{value:.0%}" if unit == "%" else f"{value:.3g} {unit}"


@group.command("forget")
def forget(context: typer.Context, lab: LabOption = None) -> None:
    """Forget what was measured and learnt of the balance: use it after a repair, a move or new settings."""
    from scuhand_bt.api import OpenLab
    from scuhand_bt.api.books import take_cell

    loaded = the_lab(lab or context.obj)
    with take_cell(OpenLab(loaded).state):  # a run that goes on would believe it still, and write it anew
        names = lab_state(loaded).forget_balances()
    out.print(Text(f"Forgotten: {'; '.join(names)}." if names else "Nothing was known."))
