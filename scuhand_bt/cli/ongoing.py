"""Commands about runs that go on, or were interrupted: resume, pause, stop, answer."""

import sys
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer
from rich.text import Text

from scuhand_bt.cli.run import (
    DashboardFlag,
    EventsOption,
    ExportOption,
    GrootOption,
    QuietFlag,
    VerboseFlag,
    how_much,
    run_to_its_end,
    told,
)
from scuhand_bt.cli.shared import (
    GETS_READY,
    JsonFlag,
    LabOption,
    OperatorOption,
    RunArgument,
    UnattendedFlag,
    app,
    err,
    note_problems,
    out,
    print_json,
    told_if_long,
    unknown,
)
from scuhand_bt.cli.streams import unwatched
from scuhand_bt.exit_codes import ExitCode

if TYPE_CHECKING:
    from collections.abc import Callable

    from scuhand_bt.api import Control, PastRun, Session, Wish

ByOption = Annotated[
    str | None, typer.Option("--operator", metavar="NAME", help="Who you are; default: the computer's user.")
]
NowFlag = Annotated[
    bool, typer.Option("--now", help="Halt running actions at once: valve closed, vibration off, arm stopped.")
]


@app.command()
def resume(
    run: RunArgument,
    accept_changes: Annotated[
        bool, typer.Option("--accept-changes", help="Resume even if recipe, lab or program have changed; it is noted.")
    ] = False,
    yes: Annotated[bool, typer.Option("--yes", help="Go on without asking.")] = False,
    operator: OperatorOption = None,
    unattended: UnattendedFlag = False,
    dashboard: DashboardFlag = False,
    groot: GrootOption = None,
    events: EventsOption = None,
    quiet: QuietFlag = False,
    verbose: VerboseFlag = False,
    json_file: ExportOption = None,
    lab: LabOption = None,
) -> None:
    """Continue a paused run; go on with one that was stopped or killed, without doing anything twice."""
    from scuhand_bt.api import find_run, take_up
    from scuhand_bt.cli.persons import the_person

    its = find_run(run, lab)
    if its.is_going_on:
        _wish(its, "continue", "continues", operator)
        return
    with told(events) as tell, unwatched(), take_up(its, accept_changes=accept_changes) as found:
        note_problems(found.lab.lab)
        for line in found.known:
            out.print(Text(line))
        for change in found.changes:
            out.print(Text(f"Accepted: {change}."))
        person = the_person(operator, its.state, is_asked=found.is_on_the_cell)
        if out.is_terminal and found.is_on_the_cell and not yes:
            asked = "Is the cell as described, may the arm be held where it is, and may the run go on?"
            typer.confirm(asked, abort=True)

        may_torque = yes or out.is_terminal
        # Whoever resumes it by hand is there, also if nobody was when it began.
        attended = False if unattended else True if out.is_terminal and found.is_on_the_cell else None

        def make(control: "Control") -> "Session":
            with told_if_long(GETS_READY, quiet=quiet):
                return found.prepare(person=person, may_torque=may_torque, attended=attended, control=control)

        shows = how_much(quiet=quiet, verbose=verbose)
        run_to_its_end(make, json_file, shows, dashboard=dashboard, groot=groot, tell=tell)


@app.command()
def pause(run: RunArgument, now: NowFlag = False, operator: ByOption = None, lab: LabOption = None) -> None:
    """Pause a run before its next action, or now; `resume` continues it."""
    from scuhand_bt.api import find_run

    done = "is halted and paused" if now else "pauses before its next action"
    _wish(find_run(run, lab), "pause_now" if now else "pause", done, operator)


@app.command()
def stop(run: RunArgument, now: NowFlag = False, operator: ByOption = None, lab: LabOption = None) -> None:
    """Stop a run after its current sample, or now; `resume` goes on with it later."""
    from scuhand_bt.api import find_run

    done = "stops now" if now else "stops after its current sample"
    _wish(find_run(run, lab), "stop_now" if now else "stop", done, operator)


@app.command()
def answer(
    run: RunArgument,
    choice: Annotated[
        str | None, typer.Argument(metavar="ANSWER", help="One of the question's choices.", show_default=False)
    ] = None,
    operator: ByOption = None,
    as_json: JsonFlag = False,
    lab: LabOption = None,
) -> None:
    """Answer the question that a run is waiting on, from anywhere on its computer; without ANSWER, show it.

    The first answer counts. Who gave it is in the run's journal.
    """
    from scuhand_bt.api import NotHeard, find_run

    its = find_run(run, lab)
    try:
        asked = its.question()
    except NotHeard as why:
        raise _refused(its, str(why)) from None
    if as_json and choice is None:
        print_json({**asdict(asked), "choices": asked.meanings} if asked is not None else None)
        return
    if asked is None:
        raise _refused(its, "no question waits" if its.is_going_on else "it is not running")
    out.print(Text(f"{asked.text} (since {asked.at})"))
    if choice is None:
        for name, meaning in asked.meanings.items():
            out.print(Text(f"  {name}: {meaning or 'as the question says'}"))
        if not sys.stdin.isatty():
            out.print(Text(f"`scuhand-bt answer {its.id} ANSWER` answers it."), soft_wrap=True)
            return
    given = (typer.prompt("Answer") if choice is None else choice).strip().lower()
    if given not in asked.choices:
        raise unknown("answer", given, asked.choices)
    by, pin = _proof(its, operator)
    _heard(its, lambda: its.answer(asked, given, by, pin), f"goes on with '{given}'")


def _wish(run: "PastRun", wish: "Wish", done: str, operator: str | None = None) -> None:
    """Say a wish to the process that has the run."""
    name, pin = _proof(run, operator) if operator is not None else (None, None)
    _heard(run, lambda: run.wish(wish, name, pin), done)


def _proof(run: "PastRun", operator: str | None) -> tuple[str | None, str | None]:
    """The name that was given, or the user's, and the PIN of who has one."""
    from scuhand_bt.api.books import Persons, person_name, user_name

    try:
        name = person_name(operator if operator is not None else user_name())
    except ValueError as error:
        raise typer.BadParameter(str(error), param_hint="--operator") from None
    has_pin = name in Persons(run.state).names()
    pin = typer.prompt(f"PIN of {name}", hide_input=True) if has_pin and sys.stdin.isatty() else None
    return name, pin


def _heard(run: "PastRun", say: "Callable[[], None]", done: str) -> None:
    """Say something to the process that has the run, and tell what came of it."""
    from scuhand_bt.api import NotHeard

    try:
        say()
    except NotHeard as why:
        raise _refused(run, str(why)) from None
    out.print(Text(f"{run.id} {done}."))


def _refused(run: "PastRun", why: str) -> typer.Exit:
    err.print(Text(f"{run.id}: {why}."))
    return typer.Exit(ExitCode.BAD_INPUT)
