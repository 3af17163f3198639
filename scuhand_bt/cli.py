"""The command line. Each command is a few lines over the public API; heavy imports wait until they are needed."""

import io
import json
import shutil
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

import scuhand_bt
from scuhand_bt.failures import CATALOGUE, SkillFailed
from scuhand_bt.quantity import Unit, format_duration, format_mass
from scuhand_bt.yaml_source import SourceError

if TYPE_CHECKING:
    from scuhand_bt.clock import Signal
    from scuhand_bt.lab import Lab
    from scuhand_bt.plan import Plan
    from scuhand_bt.run.batch import BatchResult
    from scuhand_bt.run.session import Session
    from scuhand_bt.sim.wire.bench import WireBench
    from scuhand_bt.specs import PowderBelief

EXIT_BAD_INPUT = 2
EXIT_CELL_FAULT = 3

app = typer.Typer(
    help="Scoop and dispense powders by recipe. Exit codes: 0 all doses in tolerance; 1 finished with flagged doses; "
    "2 bad input; 3 cell fault; 130 interrupted.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
out = Console(highlight=False, width=None if sys.stdout.isatty() else 160)
err = Console(stderr=True, highlight=False, soft_wrap=True)

RecipeArgument = Annotated[Path, typer.Argument(help="A recipe file (YAML).", show_default=False)]
LabOption = Annotated[
    Path | None, typer.Option("--lab", help="The lab's folder; default: the nearest one upward from the recipe.")
]
SeedOption = Annotated[int, typer.Option(min=0, help="Seed of all randomness of a simulation.")]
NameArgument = Annotated[str | None, typer.Argument(help="Show this one in full.", show_default=False)]
JsonFlag = Annotated[bool, typer.Option("--json", help="Write JSON to the standard output.")]


def main() -> None:
    """Entry point: runs a command and turns bad input into located lines and an exit code."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal that cannot show '±' is no reason to break
    try:
        app()
    except SourceError as error:
        for problem in error.problems:
            err.print(Text(str(problem)))
        count = len(error.problems)
        if count > 1:
            err.print(f"{count} problems; nothing was moved.")
        sys.exit(EXIT_BAD_INPUT)
    except SkillFailed as error:
        remedy = CATALOGUE[error.code].remedy if error.code in CATALOGUE else ""
        err.print(Text(f"{error}. {remedy}".rstrip()))
        sys.exit(EXIT_CELL_FAULT)


def _version(wanted: bool) -> None:
    if wanted:
        out.print(f"scuhand-bt {scuhand_bt.__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    pass


def _plan(recipe: Path, folder: Path | None) -> "tuple[Plan, Lab]":
    from scuhand_bt.lab import find_lab, load_lab
    from scuhand_bt.plan import make_plan
    from scuhand_bt.recipe import load_recipe

    lab = load_lab(find_lab(recipe, folder))
    return make_plan(load_recipe(recipe, lab), lab), lab


@app.command()
def run(
    recipe: RecipeArgument,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Run on simulated devices.")] = False,
    rehearse: Annotated[
        bool, typer.Option("--rehearse", help="Run in real time with the real drivers, against twins.")
    ] = False,
    seed: SeedOption = 0,
    speed: Annotated[float | None, typer.Option(help="Watch a dry run at so many times real time.")] = None,
    controller: Annotated[str | None, typer.Option(help="The dosing controller.")] = None,
    plant: Annotated[str | None, typer.Option(help="Simulated physics to use instead of ours: module:Class.")] = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the canonical export here.")] = None,
    lab: LabOption = None,
) -> None:
    """Run a recipe on the cell; with --dry-run on simulated devices, with --rehearse on twins of the real ones."""
    from scuhand_bt.live import doses_table, end_line

    if speed is not None and not 0 < speed < float("inf"):
        raise typer.BadParameter("must be more than 0", param_hint="--speed")
    if dry_run and rehearse:
        raise typer.BadParameter("a run is a dry run or a rehearsal", param_hint="--dry-run/--rehearse")
    if speed is not None and not dry_run:
        raise typer.BadParameter("only a dry run has a speed", param_hint="--speed")
    if plant is not None and not (dry_run or rehearse):
        raise typer.BadParameter("only a dry run or a rehearsal has simulated physics", param_hint="--plant")
    if json_file is not None and (json_file.is_dir() or not json_file.absolute().parent.is_dir()):
        raise typer.BadParameter(f"'{json_file}' cannot be written", param_hint="--json")
    began = time.monotonic()
    made, loaded = _plan(recipe, lab)
    from scuhand_bt.run.session import Options, Session
    from scuhand_bt.run.setup import DryRun, Rehearsal
    from scuhand_bt.sim.plant import PlantError
    from scuhand_bt.sim.wire.hand import NoCompiler

    simulation = DryRun(seed, plant, speed) if dry_run else Rehearsal(seed, plant) if rehearse else None
    what = f"{made.recipe.name}: {len(made.recipe.samples)} samples on the cell '{loaded.cell.cell}'"
    mode = f"{simulation.mode} (seed {seed})" if simulation is not None else "real devices"
    try:
        session = Session(made, loaded, Options(simulation, controller))
        out.print(Text(f"{what}, {mode}"))
        with stopping_on_signals(session.stop):
            result = _watched(session)
    except (PlantError, NoCompiler) as error:
        err.print(Text(f"{error}"))
        raise typer.Exit(EXIT_BAD_INPUT) from None
    out.print(doses_table(result.samples))
    out.print(Text(end_line(result, time.monotonic() - began)))
    out.print(Text(f"Journal: {session.journal.path}"))
    if json_file is not None:
        from scuhand_bt.run.export import canonical

        json_file.write_text(canonical(session.journal.path), encoding="utf-8")
    raise typer.Exit(result.exit_code)


def _watched(session: "Session") -> "BatchResult":
    """Run with the live view on a terminal, else with plain lines."""
    from scuhand_bt.live import LiveView, PlainLines

    try:
        if out.is_terminal:
            with LiveView(out, session.cell, session.plan) as view:
                return session.run(view)
        return session.run(PlainLines(lambda line: out.print(Text(line)), len(session.plan.recipe.samples)))
    finally:
        session.close()


@contextmanager
def stopping_on_signals(stop: "Signal") -> Iterator[None]:
    """Ctrl-C and SIGTERM end the run safely instead of the process at once."""
    before = {number: signal.signal(number, lambda *_: stop.fire()) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@app.command()
def check(recipe: RecipeArgument, lab: LabOption = None, as_json: JsonFlag = False) -> None:
    """Check a recipe, its tables and its workflows, without running anything."""
    from scuhand_bt.lab import find_lab, load_lab
    from scuhand_bt.plan import make_plan
    from scuhand_bt.recipe import load_recipe

    try:
        loaded = load_lab(find_lab(recipe, lab))
        checked = load_recipe(recipe, loaded)
        make_plan(checked, loaded)
    except SourceError as error:
        if not as_json:
            raise
        problems = [
            {"file": p.mark.file, "line": p.mark.line, "column": p.mark.column, "message": p.message}
            for p in error.problems
        ]
        out.print_json(json.dumps({"ok": False, "problems": problems}))
        raise typer.Exit(EXIT_BAD_INPUT) from None
    if as_json:
        out.print_json(json.dumps({"ok": True, "samples": len(checked.samples), "problems": []}))
    else:
        out.print(Text(f"{recipe}: {len(checked.samples)} samples, no problem found."))


@app.command()
def plan(recipe: RecipeArgument, lab: LabOption = None, as_json: JsonFlag = False) -> None:
    """Show the jobs in their order, the powder each source needs, and every moment that needs a person."""
    made, _ = _plan(recipe, lab)
    if as_json:
        out.print_json(json.dumps(_plan_values(made)))
        return
    jobs = Table("#", "job", "workflow", "source", "container", "mass", "tolerance", show_edge=False)
    for number, job in enumerate(made.jobs, start=1):
        sample = job.sample
        if sample is None:
            jobs.add_row(str(number), job.name, job.workflow, "", "", "", "", style="cyan")
            continue
        jobs.add_row(
            str(number),
            sample.id,
            sample.workflow,
            sample.source.name if sample.source else "",
            sample.container.name if sample.container else "",
            format_mass(sample.mass_mg) if sample.mass_mg is not None else "",
            f"{sample.tolerance_mg:g} mg" if sample.tolerance_mg is not None else "",
        )
    out.print(jobs)
    powders = Table("source", "powder", "samples", "needed with losses", "amount", show_edge=False)
    for demand in made.demands:
        source = demand.source
        needed, amount = format_mass(demand.needed_mg), format_mass(source.amount_mg)
        powders.add_row(source.name, source.powder.name, str(demand.samples), needed, amount)
    out.print()
    out.print(powders)
    out.print(f"\nSheet swaps: {made.swaps}. Estimated duration: {format_duration(made.duration_s)}.")
    out.print("Before the start: the sources filled and in their places, a fresh sheet in the hand.")
    if not made.persons:
        out.print("After the start no person is needed.")
    for person in made.persons:
        out.print(Text(f"A person is needed at '{person.job}': {person.what}."))


def _plan_values(made: "Plan") -> dict[str, Any]:
    return {
        "recipe": made.recipe.name,
        "jobs": [
            {
                "name": job.name,
                "workflow": job.workflow,
                "sample": job.sample.id if job.sample else None,
                "source": job.sample.source.name if job.sample and job.sample.source else None,
                "container": job.sample.container.name if job.sample and job.sample.container else None,
                "mass_mg": job.sample.mass_mg if job.sample else None,
                "tolerance_mg": job.sample.tolerance_mg if job.sample else None,
            }
            for job in made.jobs
        ],
        "swaps": made.swaps,
        "sources": [
            {
                "name": demand.source.name,
                "powder": demand.source.powder.name,
                "samples": demand.samples,
                "needed_mg": demand.needed_mg,
                "amount_mg": demand.source.amount_mg,
            }
            for demand in made.demands
        ],
        "persons": [{"job": person.job, "what": person.what} for person in made.persons],
        "duration_s": made.duration_s,
    }


@app.command()
def skills(name: NameArgument = None, lab: LabOption = None) -> None:
    """List the lab's skills, or show one with its parameters."""
    from scuhand_bt.lab import find_lab, load_lab
    from scuhand_bt.tree.wires import of_field

    library = load_lab(find_lab(None, lab)).library
    if name is None:
        table = Table("skill", "what it is for", show_edge=False)
        for key, skill in library.skills.items():
            table.add_row(key, skill.summary())
        out.print(table)
        return
    if name not in library.skills:
        raise typer.BadParameter(f"unknown skill '{name}'; known: {', '.join(library.skills)}")
    skill = library.skills[name]
    out.print(f"{name}: {skill.summary()}")
    out.print(f"commands: {', '.join(skill.devices) or 'nothing'}; gives: {of_field(skill.result_type()).name}")
    table = Table("parameter", "type", "default", show_edge=False)
    for key, parameter in library.parameters(name).items():
        field = next(info for field_name, info in skill.model_fields.items() if (info.alias or field_name) == key)
        unit = next((f" {mark.unit}" for mark in field.metadata if isinstance(mark, Unit)), "")
        table.add_row(key, parameter.wire.name, "required" if parameter.required else f"{field.default}{unit}")
    out.print(table)


@app.command()
def trees(name: NameArgument = None, lab: LabOption = None) -> None:
    """List the lab's workflows, or show one; all of them are checked."""
    from scuhand_bt.lab import find_lab, load_lab
    from scuhand_bt.tree.check import check_workflows
    from scuhand_bt.yaml_source import Problems

    loaded = load_lab(find_lab(None, lab))
    problems = Problems()
    check_workflows(loaded.library, loaded.library.workflows, problems)
    problems.raise_any()
    if name is not None:
        if name not in loaded.library.workflows:
            raise typer.BadParameter(f"unknown workflow '{name}'; known: {', '.join(loaded.library.workflows)}")
        out.print(Text((loaded.folder / "trees" / f"{name}.yaml").read_text(encoding="utf-8").rstrip()))
        return
    table = Table("workflow", "inputs", "what it is for", show_edge=False)
    for key, workflow in loaded.library.workflows.items():
        inputs = ", ".join(f"{declared.name}: {declared.type.name}" for declared in workflow.inputs.values())
        table.add_row(key, inputs, workflow.summary)
    out.print(table)


@app.command()
def powders(lab: LabOption = None) -> None:
    """Show what the lab believes of its powders and its balance, and which run taught it."""
    from scuhand_bt.lab import find_lab, load_lab
    from scuhand_bt.run.learnt import LabState
    from scuhand_bt.run.session import state_folder

    loaded = load_lab(find_lab(None, lab))
    state = LabState(state_folder(loaded))
    table = Table("powder lot", "C'", "onset mm", "exponent", "spread", "surge mg", "vibration", "doses", "learnt")
    for name, powder in loaded.library.powders.items():
        table.add_row(name, *_belief_cells(powder.belief), "first guess (robot/powders.yaml)", style="dim")
    for simulated in (False, True):
        for learnt in state.powders(simulated=simulated).values():
            table.add_row(learnt.name, *_belief_cells(learnt.belief), learnt.origin)
    out.print(table)
    for simulated in (False, True):
        for balance in state.balances(simulated=simulated).values():
            figures = f"lag {balance.belief.lag_s:.2f} s, noise {balance.belief.noise_mg:.2f} mg"
            out.print(Text(f"balance of '{balance.name}': {figures} ({balance.origin})"))


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


@app.command()
def twins(
    cell: Annotated[Path | None, typer.Option("--cell", help="A lab's robot/cell.yaml, instead of --lab.")] = None,
    lab: LabOption = None,
    seed: SeedOption = 0,
) -> None:
    """Start twins of the cell's devices on ports that any program can open, until Ctrl-C."""
    from scuhand_bt.clock import Signal, Wake
    from scuhand_bt.run.clock import WallClock

    bench = _bench(_lab_of_cell(cell, lab), seed)
    stop, clock = Signal(), WallClock(bench.check)
    with stopping_on_signals(stop), bench:
        table = Table("device", "driver", "port", show_edge=False)
        for device in ("arm", "hand", "balance"):
            spec = getattr(bench.spec, device)
            table.add_row(device, spec.driver, spec.port)
        out.print(Text(f"Twins of the cell '{bench.spec.cell}', SIMULATED (seed {seed}); Ctrl-C ends them."))
        out.print(table)
        sys.stdout.flush()
        clock.wait([Wake.on(stop)])


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

    from scuhand_bt.lab import find_lab, load_lab
    from scuhand_bt.run.clock import WallClock
    from scuhand_bt.run.doctor import examine

    loaded = load_lab(find_lab(None, lab))
    bench = _bench(loaded) if twins else None
    spec = bench.spec if bench is not None else loaded.cell
    if not (yes or as_json) and sys.stdin.isatty():
        yes = typer.confirm("Self-test: the valve opens by 1 mm and the motor vibrates. Is the cone empty?")
    with bench or nullcontext():
        findings = list(examine(spec, WallClock(), self_test=yes))
    failed = sum(finding.verdict == "FAIL" for finding in findings)
    if as_json:
        values = {"cell": spec.cell, "simulated": twins, "ok": not failed, "findings": [asdict(f) for f in findings]}
        out.print_json(json.dumps(values))
    else:
        out.print(Text(f"The cell '{spec.cell}', {'SIMULATED: twins of its devices' if twins else 'real devices'}"))
        table = Table("device", "check", "found", "expected", "verdict", "what to do", show_edge=False)
        for f in findings:
            style = {"ok": "", "FAIL": "red", "not done": "dim"}[f.verdict]
            table.add_row(f.device, f.check, f.found, f.expected, f.verdict, f.what_to_do, style=style)
        out.print(table)
        out.print(f"{len(findings)} checks, {failed} failed." if failed else f"{len(findings)} checks, none failed.")
    raise typer.Exit(EXIT_CELL_FAULT if failed else 0)


def _lab_of_cell(cell: Path | None, folder: Path | None) -> "Lab":
    """The lab that is named by its folder or by its robot/cell.yaml, else the nearest one."""
    from scuhand_bt.lab import CELL_FILE, find_lab, load_lab

    if cell is not None:
        if folder is not None:
            raise typer.BadParameter("name the lab by its folder or by its cell's file", param_hint="--cell/--lab")
        folder = cell.absolute().parent.parent
        if folder / CELL_FILE != cell.absolute():
            raise typer.BadParameter(f"'{cell}' is no lab's {CELL_FILE}", param_hint="--cell")
    return load_lab(find_lab(None, folder))


def _bench(lab: "Lab", seed: int = 0) -> "WireBench":
    """The twins of a lab's cell; ends with a message where they cannot be made."""
    from scuhand_bt.run.setup import bench_of
    from scuhand_bt.sim.plant import PlantError
    from scuhand_bt.sim.wire.hand import NoCompiler

    try:
        return bench_of(lab, seed)
    except (PlantError, NoCompiler) as error:
        err.print(Text(f"{error}"))
        raise typer.Exit(EXIT_BAD_INPUT) from None


@app.command()
def init(folder: Annotated[Path, typer.Argument(help="The new lab's folder.", show_default=False)]) -> None:
    """Make a lab of your own: a copy of the starter lab's robot, skills, trees and recipes."""
    from scuhand_bt.lab import starter_lab

    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise typer.BadParameter(f"'{folder}' exists and is not empty")
    for part in ("robot", "skills", "trees", "recipes"):
        ignore = shutil.ignore_patterns("__pycache__", ".scuhand")
        try:
            shutil.copytree(starter_lab() / part, folder / part, ignore=ignore)
        except OSError as error:
            raise typer.BadParameter(f"'{folder}' cannot be written: {error}") from None
    out.print(Text(f"A lab in {folder}. Try: scuhand-bt run {folder / 'recipes' / 'xrd_holders.yaml'} --dry-run"))


if __name__ == "__main__":
    main()
