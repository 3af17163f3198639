"""Commands that draw: the arm's reach, one of its motions, one dose."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from rich.table import Table
from rich.text import Text

from scuhand_bt.cli.shared import PAGES, JournalArgument, LabOption, app, of_kind, out, the_lab, unknown, write_picture
from scuhand_bt.quantity import ANGLE, MASS, parse

if TYPE_CHECKING:
    from scuhand_bt.api import Lab

OutputOption = Annotated[Path | None, typer.Option("-o", "--output", help="The file to write.", show_default=False)]


@app.command()
def reach(
    output: OutputOption = None,
    task: Annotated[
        Literal["dispense", "scoop"], typer.Option(help="The upright cone's map, or the swing at each mortar.")
    ] = "dispense",
    powder: Annotated[
        str | None, typer.Option(help="With --task scoop: of which powder; default: the lab's first.")
    ] = None,
    lab: LabOption = None,
) -> None:
    """Draw where the upright cone can be put, over the cell and its stations (HTML; needs the extra `plot`).

    With --task scoop: say in which directions the arm can make the strokes of a run through each mortar, and what is
    in the way.
    """
    if task == "scoop":
        if output is not None:
            raise typer.BadParameter("'--task scoop' writes a table, and no file: leave out '-o'")
        _tell_directions(the_lab(lab), powder)
        return
    if powder is not None:
        raise typer.BadParameter("'--powder' is only for '--task scoop'")
    path = of_kind(output or Path("reach.html"), *PAGES)
    loaded = the_lab(lab)

    def write() -> None:
        from scuhand_bt.report import reach_page

        path.write_text(reach_page(loaded), encoding="utf-8")

    _write(path, write)


@app.command("show-move")
def show_move(
    start: Annotated[str, typer.Argument(help="A station's name.", show_default=False)],
    goal: Annotated[str, typer.Argument(help="Another one.", show_default=False)],
    output: OutputOption = None,
    container: Annotated[str | None, typer.Option(help="What stands on the pan; default: nothing.")] = None,
    load: Annotated[str | None, typer.Option(help='What the cone carries, e.g. "3 g"; default: nothing.')] = None,
    powder: Annotated[str | None, typer.Option(help="Of which powder.")] = None,
    gentle: Annotated[str | None, typer.Option(help='The largest spill angle, e.g. "10 deg".')] = None,
    lab: LabOption = None,
) -> None:
    """Draw the arm's motion between two stations: an animated 3D page with plots, and a PNG beside it.

    With -o FILE.png the PNG alone. Both need the extra `plot`.
    """
    from scuhand_bt.report import shown_move

    path = of_kind(output or Path(f"{start}-{goal}.html"), *PAGES, ".png")
    loaded = the_lab(lab)
    if container is not None and container not in loaded.library.containers:
        raise unknown("container", container, loaded.library.containers)
    if powder is not None and powder not in loaded.library.powders:
        raise unknown("powder", powder, loaded.library.powders)
    for name in (start, goal):
        if name not in loaded.cell.stations:
            raise unknown("station", name, loaded.cell.stations)
    if (load is None) != (powder is None):
        raise typer.BadParameter("give both --load and --powder, or neither")
    try:
        load_mg = parse(load, MASS) if load is not None else None
        gentle_deg = parse(gentle, ANGLE) if gentle is not None else None
        move = shown_move(loaded, start, goal, container, load_mg, powder, gentle_deg)
    except ValueError as error:
        raise typer.BadParameter(str(error)) from None
    picture = path.with_suffix(".png")

    def write_page() -> None:
        from scuhand_bt.report import page_of_move

        path.write_text(page_of_move(move), encoding="utf-8")

    def write_picture() -> None:
        from scuhand_bt.report import move_png

        move_png(move, picture)

    if path != picture:
        _write(path, write_page)
    _write(picture, write_picture)


@app.command()
def plot(
    run: JournalArgument,
    sample: Annotated[str, typer.Argument(help="The sample whose dose to draw.", show_default=False)],
    output: OutputOption = None,
    lab: LabOption = None,
) -> None:
    """Draw one dose: reading, estimate, opening and vibration against time (PNG or SVG; needs the extra `plot`).

    Of a sample that was dosed again, the last container's.
    """
    from scuhand_bt.api import find_run
    from scuhand_bt.report import curves_of_doses, plot_dose

    path = of_kind(output or Path(f"{sample}.png"), ".png", ".svg")
    with find_run(run, lab).opened() as contents:
        found = list(curves_of_doses(contents))
    of_sample = [one for one in found if one.sample == sample]
    if not of_sample:
        raise unknown("sample with a dose", sample, {one.sample for one in found})
    dose, points = of_sample[-1].dose, of_sample[-1].points
    if not points:
        raise typer.BadParameter(f"the run ended before the curve of '{sample}' was written")
    title = f"{sample}: {dose.dispensed_mg:.1f} mg of {dose.target_mg:g} mg, {dose.controller}"
    _write(path, lambda: plot_dose(points, dose.target_mg, dose.tolerance_mg, path, title))


def _tell_directions(lab: "Lab", name: str | None) -> None:
    from scuhand_bt.report import directions

    powders = lab.library.powders
    if name is not None and name not in powders:
        raise unknown("powder", name, powders)
    powder = powders[name or next(iter(powders))]
    out.print("The handle's length and mount are read off a picture: measure yours, and set them in robot/cell.yaml.")
    out.print(f"Strokes of {powder.name}: the first one in a mortar that is a fifth full, and the last one.")
    table = Table("station", "mortar", "direction", "first", "last", "what is in the way", box=None)
    for one in directions(lab, powder):
        times = (f"{time_s:.1f} s" if time_s is not None else "–" for time_s in (one.first_s, one.last_s))
        table.add_row(one.station, one.mortar, f"{one.heading_deg:.0f}°", *times, Text(one.why_not))
    out.print(table)


def _write(path: Path, write: Callable[[], object]) -> None:
    write_picture(path, write)
    out.print(Text(f"Written: {path}"))
