"""Commands about the cell between runs: what it is believed to hold, an operator's corrections, and who is told."""

from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Annotated

import typer
from rich.text import Text

from scuhand_bt.cli.listing import Listing
from scuhand_bt.cli.shared import JsonFlag, LabOption, OperatorOption, app, err, out, print_json, the_lab, unknown
from scuhand_bt.exit_codes import ExitCode
from scuhand_bt.quantity import MASS, parse

if TYPE_CHECKING:
    from scuhand_bt.api import Lab
    from scuhand_bt.api.books import Inventory, Stock, StockEntry, StockKind

group = typer.Typer(invoke_without_command=True)
app.add_typer(group, name="inventory")

PowderOption = Annotated[str | None, typer.Option(help="The powder there; default: what is known.", show_default=False)]
LotOption = Annotated[str | None, typer.Option(help="Its lot; default: what is known.", show_default=False)]


@group.callback()
def inventory(
    context: typer.Context,
    simulated: Annotated[bool, typer.Option("--simulated", help="What the last simulated run left instead.")] = False,
    lab: LabOption = None,
    as_json: JsonFlag = False,
) -> None:
    """Show what the cell is believed to hold between runs, or correct it with `inventory set`."""
    if context.invoked_subcommand is not None:
        context.obj = lab  # it may as well be named before the subcommand
        return
    stock = _inventory(the_lab(lab)).stock(simulated=simulated)
    if as_json:
        print_json([asdict(entry) for entry in stock.values()])
        return
    if not stock:
        out.print("Nothing is known yet: runs and `scuhand-bt inventory set` fill the inventory.")
        return
    table = Listing("what", "powder lot", "how much", "says")
    for entry in stock.values():
        table.add_row(Text(entry.place), Text(entry.lot_key or "–"), entry.in_words, Text(entry.origin))
    out.print(table)
    if simulated:
        out.print("SIMULATED: no run reads this.")


@group.command("set")
def set_entry(
    context: typer.Context,
    what: Annotated[
        str,
        typer.Argument(help="A mortar's or vessel's station, cone, sheet, changer, changer/KIND, a container's kind."),
    ],
    value: Annotated[str, typer.Argument(help="A mass (12 g); for the sheet: fresh, touched; else how many are used.")],
    powder: PowderOption = None,
    lot: LotOption = None,
    reason: Annotated[str | None, typer.Option(help="Why it is corrected; `audit` shows it.")] = None,
    operator: OperatorOption = None,
    lab: LabOption = None,
) -> None:
    """Correct the inventory: what is at a station or in the cone, a fresh sheet, slots or containers used."""
    from scuhand_bt.api import OpenLab
    from scuhand_bt.api.books import take_cell
    from scuhand_bt.cli.persons import the_person

    loaded = the_lab(lab or context.obj)
    stations = [station.name for station in loaded.cell.stations.values() if station.kind == "mortar"]
    vessels = [station.name for station in loaded.cell.vessels]
    if powder is not None and powder not in loaded.library.powders:
        raise unknown("powder", powder, loaded.library.powders)
    kind: StockKind
    changer = loaded.cell.changer
    if what == "changer" and changer.kinds and value != "0":
        ways = ", ".join(f"changer/{one}" for one in changer.kinds)
        raise typer.BadParameter(f"its slots are counted by kind: write {ways}, or 0 for all", param_hint="WHAT")
    if (of_changer := what.removeprefix("changer/")) != what:
        if of_changer not in changer.kinds:
            raise unknown("kind of the changer", of_changer, changer.kinds)
        kind, name = "changer", of_changer
    elif what in ("cone", "sheet", "changer"):
        kind, name = what, ""  # type: ignore[assignment]
    elif what in (*stations, *vessels):
        kind, name = "station", what
    elif what in loaded.library.containers:
        kind, name = "container", what
    else:
        raise unknown("thing", what, ["cone", "sheet", "changer", *stations, *vessels, *loaded.library.containers])
    kept = _inventory(loaded)
    entry = _entry(kind, name, value, powder, lot, kept.stock(simulated=False))
    if what in vessels and entry.mass_mg == 0.0:
        entry = replace(entry, powder="", lot="")
    slots = changer.slots_for(name) if name else changer.slot_count
    if kind == "changer" and changer.driver != "operator" and (entry.used or 0) > slots:
        what = f"'{value}' is more than the changer's {slots} slots; write 0 to {slots}"
        raise typer.BadParameter(what, param_hint="VALUE")
    state = OpenLab(loaded).state
    person = the_person(operator, state, is_asked=False)
    with take_cell(state):  # what a run has in the cell is not corrected beside it
        names = changer.kinds if kind == "changer" and not name and changer.kinds else (name,)
        for one in names:  # a changer that was filled again has all its kinds again
            kept.enter(replace(entry, name=one, reason=reason), person.name if person is not None else None)
    out.print(Text(f"{entry.place}: {entry.in_words}" + (f" of {entry.lot_key}" if entry.lot_key else "")))


def _entry(
    kind: "StockKind", name: str, value: str, powder: str | None, lot: str | None, stock: "Stock"
) -> "StockEntry":
    """The entry that an operator means; what is left out stays as it is known."""
    from scuhand_bt.api.books import StockEntry

    known = stock.get((kind, name))
    if kind in ("changer", "container"):
        if powder is not None or lot is not None:
            raise typer.BadParameter("it holds no powder", param_hint="--powder/--lot")
        if not value.isascii() or not value.isdigit() or len(value) > 9:
            raise typer.BadParameter(f"'{value}' is not a number of what is used; write 0 or more", param_hint="VALUE")
        return StockEntry(kind, name, used=int(value))
    if known is not None and powder in (None, known.powder):
        powder, lot = known.powder, known.lot if lot is None else lot
    powder, lot = powder or "", lot or ""
    if kind == "sheet":
        if value not in ("fresh", "touched"):
            raise typer.BadParameter(f"'{value}' is not a state of a sheet; write fresh or touched", param_hint="VALUE")
        used = known.used if known is not None else None
        if value == "fresh":
            return StockEntry(kind, used=(used or 0) + 1)
        used = used or 1
        mass_mg = None
    else:
        used, mass_mg = None, _mass_mg(value)
    is_empty_cone = kind == "cone" and mass_mg == 0.0
    if not powder and not is_empty_cone:
        raise typer.BadParameter("nothing is known of the powder yet; name it", param_hint="--powder")
    return StockEntry(kind, name, *(("", "") if is_empty_cone else (powder, lot)), mass_mg=mass_mg, used=used)


def _mass_mg(text: str) -> float:
    try:
        mass_mg = parse(text, MASS)
    except ValueError as error:
        raise typer.BadParameter(str(error), param_hint="VALUE") from None
    if mass_mg < 0:
        raise typer.BadParameter(f"'{text}' is less than 0", param_hint="VALUE")
    return mass_mg


@app.command("notify")
def try_notification(lab: LabOption = None) -> None:
    """Try the notification hook of robot/cell.yaml (`notify:`)."""
    from scuhand_bt.api.bench import try_notification

    try:
        error = try_notification(the_lab(lab))
    except ValueError as why:
        err.print(Text(f"{why}"))
        raise typer.Exit(ExitCode.BAD_INPUT) from None
    if error is not None:
        err.print(Text(error))
        raise typer.Exit(1)
    out.print("Sent.")


def _inventory(lab: "Lab") -> "Inventory":
    from scuhand_bt.api import OpenLab
    from scuhand_bt.api.books import Inventory

    return Inventory(OpenLab(lab).state, lab.cell.cell)
