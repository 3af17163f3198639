"""Commands that draw: the arm's reach, one of its motions, one dose."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from rich.table import Table
from rich.text import Text

from scuhand_bt.cli.archive import JournalArgument, find_journal
from scuhand_bt.cli.shared import PAGES, LabOption, app, of_kind, out, the_lab, unknown

if TYPE_CHECKING:
    from scuhand_bt.lab import Lab
    from scuhand_bt.motion import MotionPlanner
    from scuhand_bt.motion.kinematics import Floats

OutputOption = Annotated[Path | None, typer.Option("-o", "--output", help="The file to write.", show_default=False)]


@app.command()
def reach(
    output: OutputOption = None,
    task: Annotated[
        Literal["dispense", "scoop"], typer.Option(help="The upright cone's map, or the swing at each mortar.")
    ] = "dispense",
    lab: LabOption = None,
) -> None:
    """Draw where the upright cone can be put, over the cell and its stations (HTML; needs the extra `plot`).

    With --task scoop: tell in which directions the arm can swing the cone through each mortar, and what is in the way.
    """
    if task == "scoop":
        if output is not None:
            raise typer.BadParameter("'--task scoop' writes a table, and no file: leave out '-o'")
        _tell_directions(the_lab(lab))
        return
    path = of_kind(output or Path("reach.html"), *PAGES)
    loaded = the_lab(lab)

    def write() -> None:
        from scuhand_bt.report.reach import reach_page

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
    from scuhand_bt.motion import Mount
    from scuhand_bt.motion.scenes import CONE_DIAMETER_M
    from scuhand_bt.report.scene3d import scene_values
    from scuhand_bt.report.show_move import ShownMove

    path = of_kind(output or Path(f"{start}-{goal}.html"), *PAGES, ".png")
    loaded = the_lab(lab)
    kinds = loaded.library.containers
    if container is not None and container not in kinds:
        raise unknown("container", container, kinds)
    for name in (start, goal):
        if name not in loaded.cell.stations:
            raise unknown("station", name, loaded.cell.stations)
    planner, places_m = _planner(loaded, container)
    there = planner.move(planner.home(), start)
    limit_deg = _carrying_deg(loaded, load, powder, gentle)
    motion = planner.move(there.end, goal, spill_limit_deg=limit_deg)
    title = f"{start} to {goal}"
    if limit_deg is not None:
        carried = f"{load} of {powder}" if load else "a load"
        title += f" with {carried}, spill angle up to {motion.spill_limit_deg:.0f}°"
    offset_m = loaded.cell.hand.apex_offset_mm / 1000
    scene, usual_mm = planner.scene(), 1000 * CONE_DIAMETER_M
    on_pan = [kinds[container]] if container is not None else []
    drawn = scene_values(planner, offset_m, [usual_mm], places_m, on_pan)
    mount = Mount.of(loaded.cell.hand)
    move = ShownMove(title, motion, scene, planner.rates, mount, places_m, drawn, container)
    picture = path.with_suffix(".png")

    def write_page() -> None:
        from scuhand_bt.report.move_page import move_page

        path.write_text(move_page(move), encoding="utf-8")

    def write_picture() -> None:
        from scuhand_bt.report.move_picture import move_png

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
    from scuhand_bt.journal.reader import open_contents
    from scuhand_bt.report.dose_curves import dose_curves
    from scuhand_bt.report.dose_plot import plot_dose

    path = of_kind(output or Path(f"{sample}.png"), ".png", ".svg")
    with open_contents(find_journal(run, lab)) as contents:
        found = list(dose_curves(contents))
    of_sample = [one for one in found if one.sample == sample]
    if not of_sample:
        raise unknown("sample with a dose", sample, {one.sample for one in found})
    dose, points = of_sample[-1].dose, of_sample[-1].points
    if not points:
        raise typer.BadParameter(f"the run ended before the curve of '{sample}' was written")
    title = f"{sample}: {dose.dispensed_mg:.1f} mg of {dose.target_mg:g} mg, {dose.controller}"
    _write(path, lambda: plot_dose(points, dose.target_mg, dose.tolerance_mg, path, title))


def _carrying_deg(lab: "Lab", load: str | None, powder: str | None, gentle: str | None) -> float | None:
    """What a run would carry a load of a powder within, and no more than `gentle`; None for an empty cone."""
    from scuhand_bt.cell.cell import carrying_limit_deg
    from scuhand_bt.dosing.cone import Cone
    from scuhand_bt.motion.scenes import CONE_DIAMETER_M
    from scuhand_bt.quantity import ANGLE, MASS, parse

    if (load is None) != (powder is None):
        raise typer.BadParameter("--load and --powder belong together: how much, and of what")
    limits_deg = []
    try:
        if gentle is not None:
            limits_deg.append(parse(gentle, ANGLE))
        if load is not None and powder is not None:
            if powder not in lab.library.powders:
                raise unknown("powder", powder, lab.library.powders)
            kind, rim_mm, load_mg = lab.library.powders[powder], 1000 * CONE_DIAMETER_M, parse(load, MASS)
            full_mg = kind.bulk_density_mg_per_mm3 * Cone(rim_mm, lab.cell.hand.sheet_radius_mm).volume_mm3
            if not 0 < load_mg < full_mg:
                raise ValueError(f"--load is more than nothing and less than the full cone's {full_mg / 1000:.1f} g")
            limits_deg.append(carrying_limit_deg(lab.cell, kind, load_mg, rim_mm))
    except ValueError as error:
        raise typer.BadParameter(str(error)) from None
    if limits_deg and min(limits_deg) <= 0:
        raise typer.BadParameter("--gentle is an angle above zero")
    return min(limits_deg, default=None)


def _planner(lab: "Lab", container: str | None) -> "tuple[MotionPlanner, dict[str, Floats]]":
    """The lab's cell with a mortar at every mortar station; and the apex positions [m] (3,) of all stations."""
    import numpy as np

    from scuhand_bt.cell.places import at_station, over_balance, over_mortar
    from scuhand_bt.motion import ApexPose

    kind = lab.library.containers.get(container or "")
    largest = max(lab.library.mortars.values(), key=lambda mortar: mortar.outer_diameter_mm)
    stations = lab.cell.stations.values()
    planner = lab.motion_planner({s.name: largest for s in stations if s.kind == "mortar"})
    planner.set_geometry(container=kind)
    places_m: dict[str, Floats] = {}
    for station in stations:
        if station.kind == "mortar":
            position_mm = over_mortar(station, largest)
        elif station.kind == "balance":
            shortest = min(lab.library.containers.values(), key=lambda one: one.height_mm)
            position_mm = over_balance(lab.cell, kind or shortest)[1]
        else:
            position_mm = at_station(station)
        places_m[station.name] = np.array(position_mm) / 1000
        planner.add_place(station.name, ApexPose(places_m[station.name]))
    return planner, places_m


def _tell_directions(lab: "Lab") -> None:
    from scuhand_bt.report.scoop_reach import directions

    out.print("The handle's length and mount are read off a picture: measure yours, and set them in robot/cell.yaml.")
    table = Table("station", "mortar", "direction", "tilt", "time", "what is in the way", box=None)
    for one in directions(lab):
        possible = (f"{one.tilt_deg:.0f}°", f"{one.duration_s:.1f} s") if one.tilt_deg is not None else ("–", "–")
        table.add_row(one.station, one.mortar, f"{one.heading_deg:.0f}°", *possible, Text(one.why_not))
    out.print(table)


def _write(path: Path, write: Callable[[], object]) -> None:
    try:
        write()
    except OSError as error:
        raise typer.BadParameter(f"'{path}' cannot be written: {error.strerror}") from None
    except ModuleNotFoundError as error:
        raise typer.BadParameter(f"'{path}' needs {error.name}: pip install 'scuhand-bt[plot]'") from None
    out.print(Text(f"Written: {path}"))
