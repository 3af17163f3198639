"""Who is at the cell: a person by name, who proves it with a PIN if the lab knows one of this person's."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.text import Text

from scuhand_bt.cli.shared import LabOption, app, out

if TYPE_CHECKING:
    from scuhand_bt.api import Person
    from scuhand_bt.api.books import Persons

TRIES = 3


@app.command()
def person(
    name: Annotated[str | None, typer.Argument(help="Who signs with a PIN from now on.", show_default=False)] = None,
    lab: LabOption = None,
) -> None:
    """Give a person a PIN to sign with, or a new one; without a name, list who has one."""
    from scuhand_bt.api import find_state
    from scuhand_bt.api.books import Persons, person_name

    persons = Persons(find_state(lab))
    if name is None:
        out.print(Text("\n".join(persons.names()) or "Nobody signs with a PIN here."))
        return
    try:
        name = person_name(name)
        if name in persons.names():
            _prove(persons, name)
        persons.enrol(name, typer.prompt(f"New PIN of {name}", hide_input=True, confirmation_prompt=True))
    except ValueError as error:
        raise typer.BadParameter(str(error)) from None
    out.print(Text(f"{name} signs with this PIN from now on."))


def the_person(given: str | None, folder: Path, *, is_asked: bool) -> "Person | None":
    """The person of `--operator`, or of the question that comes without it where it `is_asked`; None for nobody named.

    `folder` holds the lab's database. Who has a PIN there is asked for it.
    """
    from scuhand_bt.api import Person
    from scuhand_bt.api.books import Persons, person_name

    if given is None and is_asked:
        if not sys.stdin.isatty():
            raise typer.BadParameter(
                "a run on the cell needs the name of the person who runs it", param_hint="--operator"
            )
        given = typer.prompt("Who are you")
    if given is None:
        return None
    try:
        name = person_name(given)
    except ValueError as error:
        raise typer.BadParameter(str(error), param_hint="--operator") from None
    persons = Persons(folder)
    if name not in persons.names():
        return Person(name)
    _prove(persons, name)
    return Person(name, lambda pin: persons.is_pin(name, pin))


def _prove(persons: "Persons", name: str) -> None:
    if not sys.stdin.isatty():
        raise typer.BadParameter(f"{name} signs with a PIN, which cannot be asked for here", param_hint="--operator")
    for _ in range(TRIES):
        if persons.is_pin(name, typer.prompt(f"PIN of {name}", hide_input=True)):
            return
        out.print("That is not the PIN.")
    raise typer.BadParameter(f"the PIN of {name} was wrong {TRIES} times", param_hint="--operator")
