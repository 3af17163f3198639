"""Commands that write something new to be filled in: `new device`."""

from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from scuhand_bt.cli.shared import app, out

group = typer.Typer(no_args_is_help=True, help="Write templates to make your own.")
app.add_typer(group, name="new")


@group.command()
def device(
    name: Annotated[str, typer.Argument(help="Its name, as a module's: radwag, room_air, …", show_default=False)],
    kind: Annotated[str, typer.Option("--kind", help="balance, changer, sensor, scanner, ioniser, capper or watcher.")],
    folder: Annotated[
        Path | None, typer.Option("--folder", help="Where to write it; default: scuhand-NAME here.")
    ] = None,
) -> None:
    """Write a package for a device of your own: driver, twin, protocol page and conformance test."""
    from scuhand_bt.kit import write_device

    written = write_device(name, kind, folder or Path(f"scuhand-{name}"))
    for path in written:
        out.print(Text(str(path)))
    test = next(path for path in written if path.name.startswith("test_"))
    out.print(Text(f"It passes its test as it is: python -m pytest {test}. Now change it to your device's protocol."))
