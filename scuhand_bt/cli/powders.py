"""Commands about the lab's powders: what is believed of each lot, since when and by which run, and to forget it."""

from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table
from rich.text import Text

from scuhand_bt.cli.shared import LabOption, app, lab_state, out, the_lab, unknown

if TYPE_CHECKING:
    from scuhand_bt.api.books import PowderBelief

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
        for learnt in state.powders(simulated=simulated).values():
            table.add_row(Text(learnt.name), *_belief_cells(learnt.belief), Text(learnt.origin), learnt.at)
    out.print(table)


@group.command("forget")
def forget(
    context: typer.Context,
    name: Annotated[str, typer.Argument(help="A powder, for all of its lots, or POWDER/LOT.", show_default=False)],
    lab: LabOption = None,
) -> None:
    """Forget what real doses have taught of a powder lot: it was dried, sieved, or is another than it is called."""
    loaded = the_lab(lab or context.obj)
    state = lab_state(loaded)
    lots = state.forget_powders(name)
    if not lots and name not in loaded.library.powders:
        raise unknown("powder lot", name, [*loaded.library.powders, *state.powders(simulated=False)])
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
