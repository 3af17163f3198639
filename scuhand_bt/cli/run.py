"""The command that runs a recipe, and how any run is begun, shown and told of."""

import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from rich.text import Text

from scuhand_bt.cli.shared import (
    GETS_READY,
    FaultsOption,
    LabOption,
    OperatorOption,
    RecipeArgument,
    SeedOption,
    UnattendedFlag,
    app,
    err,
    of_kind,
    on_signals,
    out,
    the_plan,
    told_if_long,
)
from scuhand_bt.cli.streams import lines_into, unwatched
from scuhand_bt.exit_codes import ExitCode
from scuhand_bt.quantity import RATIO, parse

if TYPE_CHECKING:
    from scuhand_bt.api import BatchObserver, BatchResult, Control, OnEvent, Session
    from scuhand_bt.cli.supervisor import Supervisor
    from scuhand_bt.groot import Publisher

HowMuch = Literal["quiet", "lines", "verbose", "picture"]
"""What is told of a run while it goes on: nothing, a line for each sample, for each action, or a picture that stays."""
DashboardFlag = Annotated[
    bool, typer.Option("--dashboard", help="Also show the run on a web page while it goes on (extra `serve`).")
]
GrootOption = Annotated[
    int | None,
    typer.Option(
        "--groot", metavar="PORT", min=1, max=65535, help="Also show the tree in Groot2 or btview (extra `groot`)."
    ),
]
EventsOption = Annotated[
    str | None,
    typer.Option("--events", metavar="FILE", help="Write all that happens as lines of JSON; - for standard output."),
]
QuietFlag = Annotated[bool, typer.Option("--quiet", "-q", help="Show only the result.")]
SLOWEST = 0.05
"""Of a cell's speeds: below, a move would last minutes."""
ExportOption = Annotated[Path | None, typer.Option("--json", help="Write the canonical export here.")]
VerboseFlag = Annotated[bool, typer.Option("--verbose", help="Show every action, line by line.")]


@app.command()
def run(
    recipe: RecipeArgument,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Run on simulated devices.")] = False,
    rehearse: Annotated[
        bool, typer.Option("--rehearse", help="Run in real time with the real drivers, against twins.")
    ] = False,
    seed: SeedOption = 0,
    speed: Annotated[float | None, typer.Option(help="Show a dry run at this many times real time.")] = None,
    controller: Annotated[str | None, typer.Option(help="The dosing controller.")] = None,
    plant: Annotated[
        str | None, typer.Option(help="Simulated physics to use instead of the built-in ones: module:Class.")
    ] = None,
    faults: FaultsOption = None,
    unattended: UnattendedFlag = False,
    asks: Annotated[
        bool, typer.Option("--ask", help="Ask a person in a dry run or a rehearsal, as at the cell.")
    ] = False,
    step: Annotated[bool, typer.Option("--step", help="Ask before each action: single step.")] = False,
    slow: Annotated[
        str | None,
        typer.Option("--slow", metavar="20%", help="Run arm, roller and changer at this share of their speeds."),
    ] = None,
    operator: OperatorOption = None,
    dashboard: DashboardFlag = False,
    groot: GrootOption = None,
    events: EventsOption = None,
    quiet: QuietFlag = False,
    verbose: VerboseFlag = False,
    json_file: ExportOption = None,
    lab: LabOption = None,
) -> None:
    """Run a recipe on the cell; with --dry-run on simulated devices, with --rehearse on twins of the real ones."""
    from scuhand_bt import api
    from scuhand_bt.cli.persons import the_person

    if speed is not None and not 0 < speed < float("inf"):
        raise typer.BadParameter("must be more than 0", param_hint="--speed")
    if dry_run and rehearse:
        raise typer.BadParameter("a run cannot be both; choose one", param_hint="--dry-run/--rehearse")
    if speed is not None and not dry_run:
        raise typer.BadParameter("only a dry run has a speed", param_hint="--speed")
    if plant is not None and not (dry_run or rehearse):
        raise typer.BadParameter("only a dry run or a rehearsal has simulated physics", param_hint="--plant")
    if faults is not None and not (dry_run or rehearse):
        raise typer.BadParameter("only a dry run or a rehearsal can have faults by a file", param_hint="--faults")
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
        with told_if_long(GETS_READY, quiet=quiet):
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
        raise typer.BadParameter("choose one of them", param_hint="--quiet/--verbose")
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
    from scuhand_bt.cli.serve import require_dashboard
    from scuhand_bt.cli.supervisor import Supervisor
    from scuhand_bt.report import LiveTerminal

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
            result = _watched(session, supervisor, observers, shows, tell, dashboard=dashboard)
        except (api.PlantError, api.NoCompiler) as error:
            err.print(Text(f"{error}"))
            raise typer.Exit(ExitCode.BAD_INPUT) from None
        _tell(session, result, time.monotonic() - began, shows)
        if json_file is not None:
            _export(session, result, json_file)
    raise typer.Exit(result.exit_code)


def _watched(
    session: "Session",
    supervisor: "Supervisor",
    observers: "list[BatchObserver]",
    shows: HowMuch,
    tell: "OnEvent | None",
    *,
    dashboard: bool,
) -> "BatchResult":
    """What the session comes to, shown as it goes on."""
    from scuhand_bt import api
    from scuhand_bt.cli.serve import dashboard_beside

    with ExitStack() as shown:
        if dashboard:
            page = shown.enter_context(dashboard_beside(session.journal.path))
            out.print(Text(f"Dashboard: {page}"), soft_wrap=True)
            out.file.flush()
        shown.enter_context(api.closing(session, tell))
        view = _view(session, shows, shown)
        shown.enter_context(supervisor.watching(session))
        return session.run(api.Observers(*observers, view))


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
    from scuhand_bt.report import LiveTerminal, LiveView, PlainLines

    if shows == "quiet":
        return api.BatchObserver()
    if shows == "picture":
        if isinstance(terminal := session.control.terminal, LiveTerminal):
            shown.enter_context(terminal.typing())
        before = session.before()
        return shown.enter_context(LiveView(out, session.cell, session.plan, session.control, session.mode, before))
    count, is_verbose = len(session.plan.recipe.samples), shows == "verbose"
    return PlainLines(lambda line: out.print(Text(line)), count, each_action=is_verbose)


def _tell(session: "Session", result: "BatchResult", seconds: float, shows: HowMuch) -> None:
    """What the run came to."""
    from scuhand_bt.report import doses_table, end_line, said_of

    if shows != "quiet":
        out.print(doses_table(result.samples, out.width))
        for sample in result.samples:
            if sample.code is not None:
                out.print(Text(f"{sample.id}: {said_of(sample)}, {sample.code}: {sample.detail}"), soft_wrap=True)
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
        what = f"`scuhand-bt report {session.run_id}` writes its report, `scuhand-bt show {session.run_id}` shows all."
        out.print(Text(what), soft_wrap=True)
    out.print(Text(f"Journal: {kept_in or 'lost'}"))
    out.print(Text(f"Head of its chain: {session.journal.head}"))


def _export(session: "Session", result: "BatchResult", json_file: Path) -> None:
    """The canonical export, of the journal or of what was rescued of it."""
    from scuhand_bt.api import PastRun

    try:
        json_file.write_text(PastRun(session.journal.kept_in or session.journal.path).export(), encoding="utf-8")
    except OSError as error:
        err.print(Text(f"'{json_file}' cannot be written: {error.strerror}; the journal has everything"))
        raise typer.Exit(result.exit_code or ExitCode.BAD_INPUT) from None
