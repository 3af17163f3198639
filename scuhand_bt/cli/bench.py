"""Commands about a cell's devices: twins of them, and a doctor for them."""

import sys
from dataclasses import asdict
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table
from rich.text import Text

from scuhand_bt.cli.shared import (
    FaultsOption,
    JsonFlag,
    LabOption,
    SeedOption,
    app,
    err,
    on_signals,
    out,
    print_json,
    the_lab,
    the_plan,
)
from scuhand_bt.cli.streams import unwatched
from scuhand_bt.exit_codes import ExitCode

if TYPE_CHECKING:
    from scuhand_bt.api import Lab
    from scuhand_bt.api.bench import TwinsProcess


@app.command()
def twins(
    words: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[RECIPE | WORDS]",
            help="A recipe, whose powders are in the mortars; or what a person does at running twins.",
            show_default=False,
        ),
    ] = None,
    cell: Annotated[Path | None, typer.Option("--cell", help="A lab's robot/cell.yaml, instead of --lab.")] = None,
    lab: LabOption = None,
    seed: SeedOption = 0,
    plant: Annotated[str | None, typer.Option(help="Physics to use instead of ours: module:Class.")] = None,
    faults: FaultsOption = None,
    at: Annotated[
        Path | None,
        typer.Option("--at", help="The folder of their world and ports; default: the lab's .scuhand/twins."),
    ] = None,
    new: Annotated[bool, typer.Option("--new", help="Begin a new world, even if there is one.")] = False,
    of_run: Annotated[bool, typer.Option("--of-run", hidden=True)] = False,
) -> None:
    """Run twins of the cell's devices until Ctrl-C, on ports that any program can open. Their world is kept on disk.

    From another terminal, or in lines here, they are told what a person does at the cell: `scuhand-bt twins place
    xrd_holder a`, `… remove`, `… refill beads 5 g`, `… look`, `… end`.
    """
    from scuhand_bt.api import NoCompiler, PlantError, read_faults
    from scuhand_bt.api.bench import make_twins, tell_twins

    words = words or []
    if words and not _is_recipe(words):
        answer = tell_twins(words, at=at, lab=lab)
        (out if answer.is_done else err).print(Text(answer.said), soft_wrap=True)
        raise typer.Exit(0 if answer.is_done else ExitCode.BAD_INPUT)
    wrong = read_faults(faults) if faults is not None else None
    made, opened = the_plan(Path(words[0]), lab) if words else (None, None)
    loaded = opened.lab if opened is not None else _lab_of_cell(cell, lab)
    sources = made.recipe.sources if made is not None else {}
    try:
        process = make_twins(loaded, sources, at=at, seed=seed, plant=plant, faults=wrong, is_new=new, of_run=of_run)
        with unwatched(), on_signals(process.end), process:  # their world goes on, whoever reads what is told of it
            spec = process.bench.spec
            again = "; they continue where they stopped" if process.goes_on else ""
            out.print(Text(f"Twins of the cell '{spec.cell}', SIMULATED (seed {seed}){again}. Ctrl-C ends them."))
            for device in spec.device_names:
                section = spec.section(device)
                out.print(Text(f"{device:<12} {section.driver:<18} {section.port or '-'}"), soft_wrap=True)
            sys.stdout.flush()
            Thread(target=_obey_lines, args=(process,), daemon=True, name="hands").start()
            process.go_on()
    except (PlantError, NoCompiler) as error:
        err.print(Text(f"{error}"))
        raise typer.Exit(ExitCode.BAD_INPUT) from None


def _is_recipe(words: list[str]) -> bool:
    """A file is named, and not what a person does."""
    return len(words) == 1 and Path(words[0]).suffix in (".yaml", ".yml")


def _obey_lines(twins: "TwinsProcess") -> None:
    """Do what comes on the standard input, and say what was done."""
    for line in sys.stdin:
        if line.strip():
            answer = twins.obey(line.split())
            out.print(Text(answer.said), soft_wrap=True)
            sys.stdout.flush()
            if answer.is_last:
                twins.end()


@app.command()
def doctor(
    lab: LabOption = None,
    twins: Annotated[bool, typer.Option("--twins", help="Check twins of the devices instead.")] = False,
    yes: Annotated[
        bool, typer.Option("--yes", help="Confirm that the cone is empty: valve and motor may move.")
    ] = False,
    as_json: JsonFlag = False,
) -> None:
    """Check every device of the cell, and say what is wrong and what to do."""

    from scuhand_bt.api import NoCompiler, PlantError
    from scuhand_bt.api.bench import examine
    from scuhand_bt.commissioning import commissioned

    loaded = the_lab(lab)
    if not (yes or as_json) and sys.stdin.isatty():
        yes = typer.confirm("Self-test: the valve opens by 1 mm and the motor vibrates. Is the cone empty?")
    try:
        findings = examine(loaded, twins=twins, self_test=yes)
    except (PlantError, NoCompiler) as error:
        err.print(Text(f"{error}"))
        raise typer.Exit(ExitCode.BAD_INPUT) from None
    if not twins:
        findings += commissioned(loaded)
    failed = sum(finding.verdict == "FAIL" for finding in findings)
    if as_json:
        values = [asdict(finding) for finding in findings]
        print_json({"cell": loaded.cell.cell, "simulated": twins, "ok": not failed, "findings": values})
    else:
        out.print(
            Text(f"The cell '{loaded.cell.cell}', {'SIMULATED: twins of its devices' if twins else 'real devices'}")
        )
        table = Table("device", "check", "found", "expected", "verdict", "what to do", show_edge=False)
        for f in findings:
            style = {"ok": "", "FAIL": "red", "not done": "dim"}[f.verdict]
            table.add_row(f.device, f.check, f.found, f.expected, f.verdict, f.what_to_do, style=style)
        out.print(table)
        out.print(f"{len(findings)} checks, {failed} failed." if failed else f"{len(findings)} checks, none failed.")
    raise typer.Exit(ExitCode.CELL_FAULT if failed else 0)


def _lab_of_cell(cell: Path | None, folder: Path | None) -> "Lab":
    """The lab that is named by its folder or by its robot/cell.yaml, else the nearest one."""
    from scuhand_bt.api.bench import folder_of_cell

    if cell is not None:
        if folder is not None:
            raise typer.BadParameter(
                "name the lab by its folder or by its cell's file, not by both", param_hint="--cell/--lab"
            )
        try:
            folder = folder_of_cell(cell)
        except ValueError as error:
            raise typer.BadParameter(f"{error}", param_hint="--cell") from None
    return the_lab(folder)
