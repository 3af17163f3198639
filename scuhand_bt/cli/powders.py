"""Commands about the lab's powders: what is believed of each lot and its scoops, since when and by which run, and to
forget it.
"""

from datetime import datetime
from typing import TYPE_CHECKING, Annotated

import typer
from rich.text import Text

from scuhand_bt.cli.listing import Listing
from scuhand_bt.cli.shared import JsonFlag, LabOption, app, lab_state, out, print_json, the_lab, unknown

if TYPE_CHECKING:
    from scuhand_bt.api.books import PowderBelief, Taught

group = typer.Typer(invoke_without_command=True)
app.add_typer(group, name="powders")

FIGURES = {
    "C'": ("coefficient", ".1f"),
    "seen at mm": ("gap_mm", ".2f"),
    "onset mm": ("threshold_mm", ".2f"),
    "narrowest mm": ("narrowest_mm", ".2f"),
    "exponent": ("exponent", ".2f"),
    "spread": ("spread", ".0%"),
    "erratic": ("erratic", ".1f"),
    "surge mg": ("surge_mg", ".1f"),
    "vibration": ("vibration", ".0%"),
    "doses": ("doses", "d"),
}
"""What each figure of a `PowderBelief` is called, and how it is written."""
GUESSED = "robot/powders.yaml"
"""Who says a first guess."""


@group.callback()
def powders(context: typer.Context, lab: LabOption = None, as_json: JsonFlag = False) -> None:
    """Show what the lab believes of its powders, since when and by which run; `powders forget` forgets it."""
    if context.invoked_subcommand is not None:
        context.obj = lab
        return
    loaded = the_lab(lab)
    state = lab_state(loaded)
    from scuhand_bt.api.books import FLOW_BELIEVED_FOR, YIELD_BELIEVED_FOR

    now, kinds = datetime.now().astimezone(), (False, True)
    flows = [one for simulated in kinds for one in state.powders(simulated=simulated).items()]
    learnt = [(name, one, one.is_older_than(FLOW_BELIEVED_FOR, now)) for name, one in flows]
    yields = [one for simulated in kinds for one in state.yields(simulated=simulated).items()]
    scoops = [(of, one, one.is_older_than(YIELD_BELIEVED_FOR, now)) for of, one in yields]
    if as_json:
        guesses = [_values(name, powder.belief, None) for name, powder in loaded.library.powders.items()]
        beliefs = guesses + [_values(name, one.belief, one) | {"too_old": is_old} for name, one, is_old in learnt]
        brought = [
            {"lot": lot, "mortar": mortar, "share": one.share, **_taught(one), "too_old": is_old}
            for (lot, mortar), one, is_old in scoops
        ]
        print_json({"beliefs": beliefs, "scoops": brought})
        return
    table = Listing("powder lot", *FIGURES, "by")
    for name, powder in loaded.library.powders.items():
        table.add_row(Text(name), *_belief_cells(powder.belief), "first guess", style="dim")
    for name, one, _ in learnt:
        table.add_row(Text(name), *_belief_cells(one.belief), "SIMULATED" if one.simulated else "doses")
    out.print(table)
    if learnt:
        origins = Listing("powder lot", "learnt", "at")
        for name, one, is_old in learnt:
            old = f", more than {FLOW_BELIEVED_FOR.days} days ago: only a first guess again" if is_old else ""
            origins.add_row(Text(name), Text(one.origin), f"{one.at}{old}")
        out.print("", origins, sep="\n")
    if scoops:
        brings = Listing("scoops of", "in", "bring of what is expected", "learnt", "at")
        for of, brought_by, is_old in scoops:
            old = f", older than {YIELD_BELIEVED_FOR.days} days: learnt anew" if is_old else ""
            brings.add_row(*map(Text, of), f"{brought_by.share:.0%}{old}", Text(brought_by.origin), brought_by.at)
        out.print("", brings, sep="\n")


@group.command("forget")
def forget(
    context: typer.Context,
    name: Annotated[str, typer.Argument(help="A powder, for all of its lots, or POWDER/LOT.", show_default=False)],
    lab: LabOption = None,
) -> None:
    """Forget what was learnt of a powder lot by real doses: use it if the lot was dried, sieved or mixed up."""
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
    return [format(getattr(belief, field), written) for field, written in FIGURES.values()]


def _values(name: str, belief: "PowderBelief", learnt: "Taught | None") -> dict[str, object]:
    """For JSON; None: a first guess, which no run has taught."""
    return {"lot": name, **belief.model_dump(), **_taught(learnt)}


def _taught(learnt: "Taught | None") -> dict[str, object]:
    if learnt is None:
        return {"says": GUESSED, "simulated": False, "at": ""}
    return {"says": learnt.run, "simulated": learnt.simulated, "at": learnt.at}
