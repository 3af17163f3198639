"""Commands about a recipe: run it, check it, plan it."""

import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from rich.table import Table
from rich.text import Text

from scuhand_bt.cli.shared import (
    PAGES,
    FaultsOption,
    JsonFlag,
    LabOption,
    OperatorOption,
    RecipeArgument,
    SeedOption,
    UnattendedFlag,
    app,
    err,
    note_problems,
    of_kind,
    on_signals,
    out,
    print_json,
)
from scuhand_bt.cli.streams import lines_into, unwatched
from scuhand_bt.cli.study import WorkersOption, tell_odds
from scuhand_bt.exit_codes import ExitCode
from scuhand_bt.quantity import RATIO, format_duration, format_mass, parse

if TYPE_CHECKING:
    from scuhand_bt.api import BatchObserver, BatchResult, Control, Lab, OnEvent, OpenLab, Plan, Sample, Session
    from scuhand_bt.groot import Publisher
    from scuhand_bt.study.night import Night
    from scuhand_bt.study.odds import Odds


HowMuch = Literal["quiet", "lines", "verbose", "picture"]
"""What is told of a run while it goes on: nothing, a line for each sample, for each action, or a picture that stays."""
DashboardFlag = Annotated[
    bool, typer.Option("--dashboard", help="Show the run on a page, too, as long as it goes on (extra `serve`).")
]
GrootOption = Annotated[
    int | None,
    typer.Option(
        "--groot", metavar="PORT", min=1, max=65535, help="Show the tree in Groot2 or btview, too (extra `groot`)."
    ),
]
EventsOption = Annotated[
    str | None,
    typer.Option("--events", metavar="FILE", help="Write all that happens as lines of JSON; - is the standard output."),
]
QuietFlag = Annotated[bool, typer.Option("--quiet", "-q", help="Tell only what it came to.")]
SLOWEST = 0.05
"""Of a cell's speeds: below, a move would last minutes."""
VerboseFlag = Annotated[bool, typer.Option("--verbose", help="Tell every action, line by line.")]


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
    faults: FaultsOption = None,
    unattended: UnattendedFlag = False,
    asks: Annotated[
        bool, typer.Option("--ask", help="Ask a person in a dry run or a rehearsal, as at the cell.")
    ] = False,
    step: Annotated[bool, typer.Option("--step", help="Ask before each action: single step.")] = False,
    slow: Annotated[
        str | None, typer.Option("--slow", metavar="20%", help="Arm, roller and changer at a share of their speeds.")
    ] = None,
    operator: OperatorOption = None,
    dashboard: DashboardFlag = False,
    groot: GrootOption = None,
    events: EventsOption = None,
    quiet: QuietFlag = False,
    verbose: VerboseFlag = False,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the canonical export here.")] = None,
    lab: LabOption = None,
) -> None:
    """Run a recipe on the cell; with --dry-run on simulated devices, with --rehearse on twins of the real ones."""
    from scuhand_bt import api
    from scuhand_bt.cli.persons import the_person

    if speed is not None and not 0 < speed < float("inf"):
        raise typer.BadParameter("must be more than 0", param_hint="--speed")
    if dry_run and rehearse:
        raise typer.BadParameter("a run is a dry run or a rehearsal", param_hint="--dry-run/--rehearse")
    if speed is not None and not dry_run:
        raise typer.BadParameter("only a dry run has a speed", param_hint="--speed")
    if plant is not None and not (dry_run or rehearse):
        raise typer.BadParameter("only a dry run or a rehearsal has simulated physics", param_hint="--plant")
    if faults is not None and not (dry_run or rehearse):
        raise typer.BadParameter("only a dry run or a rehearsal has faults at will", param_hint="--faults")
    if asks and not (dry_run or rehearse):
        raise typer.BadParameter("on the cell a person is asked anyway", param_hint="--ask")
    if asks and unattended:
        raise typer.BadParameter("an unattended run asks nobody", param_hint="--ask/--unattended")
    if step and unattended:
        raise typer.BadParameter("an unattended run asks nobody", param_hint="--step/--unattended")
    asks = asks or step  # of a simulated person a step is no step
    slow_ratio = _slow_ratio(slow) if slow is not None else 1.0
    if json_file is not None:
        of_kind(json_file, ".json", option="--json")
    if json_file is not None and (json_file.is_dir() or not json_file.absolute().parent.is_dir()):
        raise typer.BadParameter(f"'{json_file}' cannot be written", param_hint="--json")
    wrong = api.read_faults(faults) if faults is not None else None
    simulation: api.DryRun | api.Rehearsal | None = None
    if dry_run:
        simulation = api.DryRun(seed, plant, speed, wrong, asks)
    elif rehearse:
        simulation = api.Rehearsal(seed, plant, wrong, asks)

    def make(control: "Control") -> "Session":
        made, opened = the_plan(recipe, lab)
        person = the_person(operator, opened.state, is_asked=simulation is None)
        how: api.How = {"controller": controller, "unattended": unattended, "control": control}
        how |= {"single_step": step, "slow_ratio": slow_ratio}
        return opened.prepare(made, simulation, person=person, **how)

    with told(events) as tell, unwatched():
        shows = how_much(quiet=quiet, verbose=verbose)
        run_to_its_end(make, json_file, shows, dashboard=dashboard, groot=groot, tell=tell)


def _slow_ratio(text: str) -> float:
    try:
        ratio = parse(text, RATIO)
    except ValueError as error:
        raise typer.BadParameter(str(error), param_hint="--slow") from None
    if not SLOWEST <= ratio <= 1.0:
        raise typer.BadParameter(f"from {SLOWEST:.0%} to 100 %", param_hint="--slow")
    return ratio


@contextmanager
def told(events: str | None) -> "Iterator[OnEvent | None]":
    """Who is told of all that happens, by `--events`."""
    with ExitStack() as opened:
        try:
            put = opened.enter_context(lines_into(events))
        except OSError as error:
            problem = f"'{events}' cannot be written: {error.strerror}"
            raise typer.BadParameter(problem, param_hint="--events") from None
        yield None if put is None else lambda event: put(event.line())


def how_much(*, quiet: bool, verbose: bool) -> HowMuch:
    """What is to be told of a run while it goes on."""
    if quiet and verbose:
        raise typer.BadParameter("less, or more", param_hint="--quiet/--verbose")
    return "quiet" if quiet else "verbose" if verbose else "picture" if out.is_terminal else "lines"


def run_to_its_end(
    make: "Callable[[Control], Session]",
    json_file: Path | None,
    shows: HowMuch,
    *,
    dashboard: bool = False,
    groot: int | None = None,
    tell: "OnEvent | None" = None,
) -> None:
    """Run a session, and tell as much of it as wished; ends the command with its exit code.

    Ctrl-C stops it now, Ctrl-Z pauses and continues it, Ctrl-\\ stops it after this sample; a closed terminal does not.
    """
    from scuhand_bt import api
    from scuhand_bt.cli.serve import dashboard_beside, require_dashboard
    from scuhand_bt.cli.supervisor import Supervisor
    from scuhand_bt.report.live_terminal import LiveTerminal

    if dashboard:
        require_dashboard()
    began, control = time.monotonic(), api.Control()
    if shows == "picture" and sys.stdin.isatty():
        control.terminal = LiveTerminal()
    supervisor = Supervisor(control)
    others = {
        signal.SIGTSTP: control.toggle_pause,
        signal.SIGQUIT: lambda: control.wish("stop"),
        signal.SIGHUP: lambda: None,
        signal.SIGTERM: lambda: supervisor.stop(api.UNKNOWN),
    }
    with ExitStack() as opened:
        # To the last line: what the run came to is not to be changed any more.
        opened.enter_context(on_signals(supervisor.stop, others))
        observers: list[BatchObserver] = [] if groot is None else [opened.enter_context(_groot_at(groot))]
        try:
            session = make(control)
            if shows != "quiet":
                out.print(Text(session.title))
            for warning in session.warnings:
                err.print(Text(f"Note: {warning}"))
            with ExitStack() as shown:
                if dashboard:
                    page = shown.enter_context(dashboard_beside(session.journal.path))
                    out.print(Text(f"Dashboard: {page}"), soft_wrap=True)
                    out.file.flush()
                shown.enter_context(api.closing(session, tell))
                observers.append(_view(session, shows, shown))
                shown.enter_context(supervisor.watching(session))
                result = session.run(api.Observers(*observers))
        except (api.PlantError, api.NoCompiler) as error:
            err.print(Text(f"{error}"))
            raise typer.Exit(ExitCode.BAD_INPUT) from None
        _tell(session, result, time.monotonic() - began, shows)
        if json_file is not None:
            _export(session, result, json_file)
    raise typer.Exit(result.exit_code)


def _groot_at(port: int) -> "Publisher":
    try:
        from scuhand_bt.groot import Publisher

        return Publisher(port)
    except ModuleNotFoundError as error:
        problem = f"it needs {error.name}: pip install 'scuhand-bt[groot]'"
    except OSError as error:
        problem = f"cannot listen at port {port}: {error.strerror}"
    raise typer.BadParameter(problem, param_hint="--groot")


def _view(session: "Session", shows: HowMuch, shown: ExitStack) -> "BatchObserver":
    """What shows as much of the run as wished."""
    from scuhand_bt import api
    from scuhand_bt.report.live import LiveView, PlainLines
    from scuhand_bt.report.live_terminal import LiveTerminal

    if shows == "quiet":
        return api.BatchObserver()
    if shows == "picture":
        if isinstance(terminal := session.control.terminal, LiveTerminal):
            shown.enter_context(terminal.typing())
        return shown.enter_context(LiveView(out, session.cell, session.plan, session.control, session.mode))
    count, is_verbose = len(session.plan.recipe.samples), shows == "verbose"
    return PlainLines(lambda line: out.print(Text(line)), count, each_action=is_verbose)


def _tell(session: "Session", result: "BatchResult", seconds: float, shows: HowMuch) -> None:
    """What the run came to."""
    from scuhand_bt.report.doses import doses_table
    from scuhand_bt.report.live import end_line

    if shows != "quiet":
        out.print(doses_table(result.samples, out.width))
        for sample in result.samples:
            if sample.code is not None:
                out.print(Text(f"{sample.id}: {sample.verdict}, {sample.code}: {sample.detail}"), soft_wrap=True)
    out.print(Text(end_line(result, seconds)), soft_wrap=True)
    for rule in session.unused_rules:
        out.print(Text(f"Never came: {rule}"))
    for notice in session.notices:
        err.print(Text(notice))
    kept_in, path = session.journal.kept_in, session.journal.path
    if not result.is_complete and kept_in is not None:
        moved = f"`mv {kept_in} {path}` brings it back, then " if kept_in != path else ""
        out.print(Text(f"{moved}`scuhand-bt resume {session.run_id}` goes on with it."), soft_wrap=True)
    if kept_in == path and shows != "quiet":
        what = f"`scuhand-bt report {session.run_id}` writes its report, `scuhand-bt show {session.run_id}` tells all."
        out.print(Text(what), soft_wrap=True)
    out.print(Text(f"Journal: {kept_in or 'lost'}"))
    out.print(Text(f"Head of its chain: {session.journal.head}"))


def _export(session: "Session", result: "BatchResult", json_file: Path) -> None:
    """The canonical export, of the journal or of what was rescued of it."""
    from scuhand_bt.api import canonical

    try:
        json_file.write_text(canonical(session.journal.kept_in or session.journal.path), encoding="utf-8")
    except OSError as error:
        err.print(Text(f"'{json_file}' cannot be written: {error.strerror}; the journal has it all"))
        raise typer.Exit(result.exit_code or ExitCode.BAD_INPUT) from None


@app.command()
def plan(
    recipe: RecipeArgument,
    trials: Annotated[int, typer.Option(min=0, help="Dry runs to tell the odds by; with 0 there are none.")] = 4,
    workers: WorkersOption = None,
    night: Annotated[
        str | None, typer.Option(metavar="20:00-08:00", help="Say what is done in hours in which nobody comes.")
    ] = None,
    html: Annotated[
        Path | None, typer.Option("--html", help="Write it as a page, with the arm's motions (extra `report`).")
    ] = None,
    lab: LabOption = None,
    as_json: JsonFlag = False,
) -> None:
    """Show the jobs in their order, what to expect of them by dry runs, and every moment that needs a person."""
    if html is not None:
        of_kind(html, *PAGES, option="--html")
        if not trials:
            raise typer.BadParameter("a page tells what dry runs came to: at least one", param_hint="--trials")
    from scuhand_bt.report.doses import asked_cells, composed_lines

    made, opened = the_plan(recipe, lab)
    loaded = opened.lab
    hours = _night(night, trials) if night is not None else None
    notes = notes_of(made, opened, quiet=as_json)
    odds = _odds(made, loaded, trials, workers) if trials else None
    if html is not None and odds is not None:
        _preview(made, loaded, odds, html)
        return
    if as_json:
        print_json({**_plan_values(made), "odds": odds and asdict(odds), "notes": notes})
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
            ", ".join(source.name for source in sample.sources),
            sample.container.name if sample.container else "",
            *asked_cells(sample),
        )
    out.print(jobs)
    for line in composed_lines(made.recipe.samples):
        out.print(Text(line), soft_wrap=True)
    powders = Table("source", "powder", "samples", "needed with losses", "amount", show_edge=False)
    for demand in made.demands:
        source = demand.source
        needed, amount = format_mass(demand.needed_mg), format_mass(source.amount_mg)
        powders.add_row(source.name, source.powder.name, str(demand.samples), needed, amount)
    out.print()
    out.print(powders)
    if odds is not None:
        tell_odds(odds)
    rough = "" if odds is not None else f" Roughly {format_duration(made.duration_s)}, if nothing fails."
    out.print(f"\nSheet swaps: {made.swaps}.{rough}")
    out.print("Before the start: the sources filled and in their places, a fresh sheet in the hand.")
    if all(person.job is None for person in made.persons):
        out.print("After the start no person is needed.")
    for person in made.persons:
        when = odds.began_s.get(person.job or "") if odds is not None else None
        at = f" (after {format_duration(when.low)} to {format_duration(when.high)})" if when is not None else ""
        out.print(Text(f"A person is {person}{at}."))
    if hours is not None and odds is not None:
        from scuhand_bt.study.night import in_words

        for line in in_words(made, loaded, odds, hours):
            out.print(Text(line), soft_wrap=True)


def _night(text: str, trials: int) -> "Night":
    from scuhand_bt.study.night import read_night

    if not trials:
        raise typer.BadParameter("what a night holds is told by dry runs: at least one", param_hint="--trials")
    return read_night(text)


def _odds(made: "Plan", loaded: "Lab", trials: int, workers: int | None) -> "Odds":
    """By the first seeds, in the background; what fails there by itself says so."""
    from scuhand_bt.study.odds import odds_of
    from scuhand_bt.study.pool import all_trials, executor_of
    from scuhand_bt.study.trial import Setup

    setup = Setup(made.recipe.path.absolute(), loaded.folder.absolute())
    with executor_of(workers, None) as executor:
        found = dict(all_trials([(setup, seed) for seed in range(trials)], executor))
    return odds_of(made, [found[setup, seed] for seed in range(trials)])


def _preview(made: "Plan", lab: "Lab", odds: "Odds", page: Path) -> None:
    """Write the plan as a page."""
    try:
        from scuhand_bt.report.preview import preview

        page.write_text(preview(made, lab, odds), encoding="utf-8")
    except ModuleNotFoundError as error:
        raise typer.BadParameter(f"a page needs {error.name}: pip install 'scuhand-bt[report]'") from None
    except OSError as error:
        raise typer.BadParameter(f"'{page}' cannot be written: {error.strerror or error}") from None
    out.print(Text(f"Written: {page}"), soft_wrap=True)


def _composition_values(sample: "Sample") -> dict[str, Any] | None:
    return sample.composition.model_dump(exclude_unset=True) if sample.composition is not None else None


def _plan_values(made: "Plan") -> dict[str, Any]:
    return {
        "recipe": made.recipe.name,
        "jobs": [
            {
                "name": job.name,
                "workflow": job.workflow,
                "sample": job.sample.id if job.sample else None,
                "source": next((source.name for source in job.sample.sources), None) if job.sample else None,
                "sources": [source.name for source in job.sample.sources] if job.sample else [],
                "container": job.sample.container.name if job.sample and job.sample.container else None,
                "mass_mg": job.sample.mass_mg if job.sample else None,
                "tolerance_mg": job.sample.tolerance_mg if job.sample else None,
                "composition": _composition_values(job.sample) if job.sample else None,
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
        "persons": [{"job": person.job, "what": person.what, "where": str(person.mark)} for person in made.persons],
        "duration_s": made.duration_s,
    }


def notes_of(made: "Plan", opened: "OpenLab", *, quiet: bool) -> list[str]:
    """What a run on the real cell would be refused for, or ask; shown beside the result, as a dry run does not mind."""
    notes = [str(problem) for problem in opened.notes(made)]
    for note in () if quiet else notes:
        err.print(Text(f"Note: {note}"))
    return notes


def the_plan(recipe: Path, folder: Path | None) -> "tuple[Plan, OpenLab]":
    """A recipe's plan, and the lab it is for; SourceError for all that is wrong with it."""
    from scuhand_bt.api import open_lab

    opened = open_lab(folder, recipe=recipe)
    made = opened.plan(recipe)
    note_problems(opened.lab)
    return made, opened
