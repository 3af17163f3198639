"""Commands about a cell's devices: twins of them, and a doctor for them."""

import sys
from collections.abc import Mapping
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
)
from scuhand_bt.exit_codes import ExitCode

if TYPE_CHECKING:
    from scuhand_bt.lab import Lab
    from scuhand_bt.run.hands import Hands
    from scuhand_bt.sim.fault_rules import FaultFile
    from scuhand_bt.sim.wire.bench import WireBench
    from scuhand_bt.specs import Source


@app.command()
def twins(
    recipe: Annotated[
        Path | None, typer.Argument(help="A recipe: its powders are in the mortars.", show_default=False)
    ] = None,
    cell: Annotated[Path | None, typer.Option("--cell", help="A lab's robot/cell.yaml, instead of --lab.")] = None,
    lab: LabOption = None,
    seed: SeedOption = 0,
    faults: FaultsOption = None,
) -> None:
    """Start twins of the cell's devices on ports that any program can open, until Ctrl-C.

    What a person does at the cell is told them in lines: `place xrd_holder a`, `remove`, …
    """
    from scuhand_bt.cli.batch import the_plan
    from scuhand_bt.clock import Signal, Wake
    from scuhand_bt.run.clock import WallClock
    from scuhand_bt.run.hands import Hands
    from scuhand_bt.sim.fault_rules import read_faults

    wrong = read_faults(faults) if faults is not None else None
    made, opened = the_plan(recipe, lab) if recipe is not None else (None, None)
    loaded = opened.lab if opened is not None else _lab_of_cell(cell, lab)
    bench = _bench(loaded, seed, wrong, made.recipe.sources if made is not None else None)
    stop, clock = Signal(), WallClock(bench.check)
    stopped = Wake.on(stop)  # seen however early it comes
    with on_signals(stop.fire), bench:
        table = Table("device", "driver", "port", show_edge=False)
        for device in bench.spec.device_names:
            spec = bench.spec.section(device)
            table.add_row(device, spec.driver, spec.port or "-")
        out.print(Text(f"Twins of the cell '{bench.spec.cell}', SIMULATED (seed {seed}); Ctrl-C ends them."))
        out.print(table)
        sys.stdout.flush()
        Thread(target=_obey_lines, args=(Hands(bench, loaded),), daemon=True, name="hands").start()
        clock.wait([stopped])


def _obey_lines(hands: "Hands") -> None:
    """Do what comes on the standard input, and say what was done."""
    for line in sys.stdin:
        if line.strip():
            out.print(Text(hands.obey(line)), soft_wrap=True)
            sys.stdout.flush()


@app.command()
def doctor(
    lab: LabOption = None,
    twins: Annotated[bool, typer.Option("--twins", help="Look at twins of the devices instead.")] = False,
    yes: Annotated[bool, typer.Option("--yes", help="The cone is empty: valve and motor may move.")] = False,
    as_json: JsonFlag = False,
) -> None:
    """Look at every device of the cell, and say what is wrong and what to do."""
    from contextlib import nullcontext
    from dataclasses import asdict

    from scuhand_bt.devices.doctor import examine
    from scuhand_bt.run.clock import WallClock

    loaded = the_lab(lab)
    bench = _bench(loaded) if twins else None
    spec = bench.spec if bench is not None else loaded.cell
    if not (yes or as_json) and sys.stdin.isatty():
        yes = typer.confirm("Self-test: the valve opens by 1 mm and the motor vibrates. Is the cone empty?")
    with bench or nullcontext():
        findings = list(examine(spec, WallClock(), self_test=yes))
    failed = sum(finding.verdict == "FAIL" for finding in findings)
    if as_json:
        values = {"cell": spec.cell, "simulated": twins, "ok": not failed, "findings": [asdict(f) for f in findings]}
        print_json(values)
    else:
        out.print(Text(f"The cell '{spec.cell}', {'SIMULATED: twins of its devices' if twins else 'real devices'}"))
        table = Table("device", "check", "found", "expected", "verdict", "what to do", show_edge=False)
        for f in findings:
            style = {"ok": "", "FAIL": "red", "not done": "dim"}[f.verdict]
            table.add_row(f.device, f.check, f.found, f.expected, f.verdict, f.what_to_do, style=style)
        out.print(table)
        out.print(f"{len(findings)} checks, {failed} failed." if failed else f"{len(findings)} checks, none failed.")
    raise typer.Exit(ExitCode.CELL_FAULT if failed else 0)


def _lab_of_cell(cell: Path | None, folder: Path | None) -> "Lab":
    """The lab that is named by its folder or by its robot/cell.yaml, else the nearest one."""
    from scuhand_bt.lab import CELL_FILE

    if cell is not None:
        if folder is not None:
            raise typer.BadParameter("name the lab by its folder or by its cell's file", param_hint="--cell/--lab")
        folder = cell.absolute().parent.parent
        if folder / CELL_FILE != cell.absolute():
            raise typer.BadParameter(f"'{cell}' is no lab's {CELL_FILE}", param_hint="--cell")
    return the_lab(folder)


def _bench(
    lab: "Lab",
    seed: int = 0,
    faults: "FaultFile | None" = None,
    sources: "Mapping[str, Source] | None" = None,
) -> "WireBench":
    """The twins of a lab's cell; ends with a message where they cannot be made."""
    from scuhand_bt.run.make_cell import bench_of
    from scuhand_bt.sim.plant import PlantError
    from scuhand_bt.sim.wire.hand import NoCompiler

    try:
        return bench_of(lab, seed, faults, sources)
    except (PlantError, NoCompiler) as error:
        err.print(Text(f"{error}"))
        raise typer.Exit(ExitCode.BAD_INPUT) from None
