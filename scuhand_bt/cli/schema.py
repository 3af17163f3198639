"""The command that gives editors the schemas of a lab's files."""

from typing import Annotated

import typer
from rich.text import Text

from scuhand_bt.cli.shared import LabOption, app, out, the_lab, unknown


@app.command()
def schema(
    kind: Annotated[
        str | None,
        typer.Argument(help="recipe, workflow, cell, powders, containers, faults or test.", show_default=False),
    ] = None,
    write: Annotated[bool, typer.Option("--write", help="Write all of them into the lab's folder `schemas`.")] = False,
    lab: LabOption = None,
) -> None:
    """Show the JSON Schema of one kind of file, with the lab's own skills, workflows, powders and containers in it."""
    from scuhand_bt.kit import KINDS_OF_FILES, write_schemas, written

    loaded = the_lab(lab)
    if write:
        for path in write_schemas(loaded):
            out.print(Text(str(path)), soft_wrap=True)
        return
    if kind is None or kind not in KINDS_OF_FILES:
        raise unknown("kind of file", kind or "", KINDS_OF_FILES)
    out.file.write(written(kind, loaded))
