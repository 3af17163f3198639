"""Commands about the lab's powders: what is believed of each lot and its scoops, since when and by which run, and to
forget it.
"""

from datetime import datetime
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table
from rich.text import Text

from scuhand_bt.cli.shared import LabOption, app, lab_state, out, the_lab, unknown

if TYPE_CHECKING:
    from scuhand_bt.api.books import LabState, PowderBelief

group = typer.Typer(invoke_without_command=True)
app.add_typer(group, name="powders")


@group.callback()
def powders(context: typer.Context, lab: LabOption = None) -> None:
    """Show what the lab believes of its powders, since when and by which run; `powders forget` forgets it."""
    if context.invoked_subcommand is not None:
        context.obj = lab
        return
    loaded = the_lab(lab)
    state = lab_state(loaded)
    table = Table(
        "powder lot", "C'", "onset mm", "exponent", "spread", "surge mg", "vibration", "doses", "learnt", "at"
    )
    for name, powder in loaded.library.powders.items():
        table.add_row(name, *_belief_cells(powder.belief), "first guess (robot/powders.yaml)", "", style="dim")
    for simulated in (False, True):
        for name, learnt in state.powders(simulated=simulated).items():
            table.add_row(Text(name), *_belief_cells(learnt.belief), Text(learnt.origin), learnt.at)
    out.print(table)
    if (scoops := _scoops(state)).row_count:
        out.print(scoops)


def _scoops(state: "LabState") -> Table:
    """What scoops bring of what is expected of them."""
    from scuhand_bt.api.books import YIELD_BELIEVED_FOR

    table = Table("scoops of", "in", "bring of what is expected", "learnt", "at")
    now = datetime.now().astimezone()
    for simulated in (False, True):
        for (lot, mortar), learnt in state.yields(simulated=simulated).items():
            is_old = learnt.is_older_than(YIELD_BELIEVED_FOR, now)
            told = f"{learnt.share:.0%}{f', older than {YIELD_BELIEVED_FOR.days} days: learnt anew' if is_old else ''}"
            table.add_row(Text(lot), Text(mortar), told, Text(learnt.origin), learnt.at)
    return table


@group.command("forget")
def forget(
    context: typer.Context,
    name: Annotated[str, typer.Argument(help="A powder, for all of its lots, or POWDER/LOT.", show_default=False)],
    lab: LabOption = None,
) -> None:
    """Forget what real doses have taught of a powder lot: it was dried, sieved, or is another than it is called."""
    from scuhand_bt.api import OpenLab
    from scuhand_bt.api.books import take_cell

    loaded = the_lab(lab or context.obj)
    state = lab_state(loaded)
    with take_cell(OpenLab(loaded).state):  # a run that goes on would believe it still, and write it anew
        lots = state.forget_powders(name)
    simulated = {*state.powders(simulated=True), *(lot for lot, _ in state.yields(simulated=True))}
    if not lots and name not in {*loaded.library.powders, *simulated}:
        raise unknown("powder lot", name, {*loaded.library.powders, *state.powders(simulated=False)})
    out.print(Text(f"Forgotten: {', '.join(lots)}." if lots else f"Nothing was learnt of '{name}' on real devices."))


def _belief_cells(belief: "PowderBelief") -> list[str]:
    return [
        f"{belief.coefficient:.1f}",
        f"{belief.threshold_mm:.2f}",
        f"{belief.exponent:.2f}",
        f"{belief.spread:.0%}",
        f"{belief.surge_mg:.1f}",
        f"{belief.vibration:.0%}",
        str(belief.doses),
    ]
