"""Commands about runs that go on, or were interrupted: resume, pause, stop, answer."""

import sys
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.text import Text

from scuhand_bt.cli.batch import (
    DashboardFlag,
    EventsOption,
    GrootOption,
    QuietFlag,
    VerboseFlag,
    how_much,
    run_to_its_end,
    the_plan,
    told,
)
from scuhand_bt.cli.shared import JsonFlag, LabOption, OperatorOption, app, err, out, print_json, unknown
from scuhand_bt.cli.streams import unwatched
from scuhand_bt.exit_codes import ExitCode
from scuhand_bt.quantity import format_duration, format_mass

if TYPE_CHECKING:
    from collections.abc import Callable

    from scuhand_bt.journal.history import History
    from scuhand_bt.run.control import Control, Wish
    from scuhand_bt.run.session import Session

RunArgument = Annotated[
    str, typer.Argument(metavar="RUN", help="A run's id, a unique beginning of it, or 'last'.", show_default=False)
]
ByOption = Annotated[
    str | None, typer.Option("--operator", metavar="NAME", help="Who you are; default: the computer's user.")
]
NowFlag = Annotated[bool, typer.Option("--now", help="Halt what is at work: valve closed, vibration off, arm stopped.")]


def runs_folder(lab: Path | None) -> Path:
    """Where the runs of the lab (or of the one around this folder) are; nothing of the lab is read."""
    from scuhand_bt.lab import find_state

    return find_state(lab) / "runs"


@app.command()
def resume(
    run: RunArgument,
    accept_changes: Annotated[
        bool, typer.Option("--accept-changes", help="Go on though recipe, lab or program have changed; it is noted.")
    ] = False,
    yes: Annotated[bool, typer.Option("--yes", help="Go on without asking.")] = False,
    operator: OperatorOption = None,
    dashboard: DashboardFlag = False,
    groot: GrootOption = None,
    events: EventsOption = None,
    quiet: QuietFlag = False,
    verbose: VerboseFlag = False,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the canonical export here.")] = None,
    lab: LabOption = None,
) -> None:
    """Continue a paused run; go on with one that was stopped or killed, without doing anything twice."""
    from scuhand_bt.cli.persons import the_person
    from scuhand_bt.run.control import listens
    from scuhand_bt.run.holds import take_run
    from scuhand_bt.run.options import options_of
    from scuhand_bt.run.resume import checked_history, find_run, its_places, resumable
    from scuhand_bt.run.session import Session

    journal = find_run(runs_folder(lab), run)
    if _is_held(journal) or listens(journal):
        _wish(journal, "continue", "continues", operator)
        return
    with told(events) as tell, unwatched(), take_run(journal) as presence:  # before anything is read of it
        history = checked_history(journal)
        options = options_of(history, journal.parent, journal)
        plan, opened = the_plan(*its_places(journal, history.run))
        its_lab = opened.lab
        found = resumable(journal, history, plan, its_lab, accept_changes=accept_changes, presence=presence)
        for line in what_is_known(history, len(plan.recipe.samples)):
            out.print(Text(line))
        for change in found.changes:
            out.print(Text(f"Accepted: {change}."))
        person = the_person(operator, journal.parent.parent, is_asked=options.simulation is None)
        options = replace(options, person=person, may_torque=yes or out.is_terminal)
        if out.is_terminal and options.simulation is None and not yes:
            asked = "Is the cell as described, may the arm be held where it is, and may the run go on?"
            typer.confirm(asked, abort=True)

        def make(control: "Control") -> "Session":
            return Session(plan, its_lab, options, control=control, resumes=found)

        shows = how_much(quiet=quiet, verbose=verbose)
        run_to_its_end(make, json_file, shows, dashboard=dashboard, groot=groot, tell=tell)


@app.command()
def pause(run: RunArgument, now: NowFlag = False, operator: ByOption = None, lab: LabOption = None) -> None:
    """Pause a run before its next action, or now; `resume` continues it."""
    from scuhand_bt.run.resume import find_run

    journal = find_run(runs_folder(lab), run)
    done = "is halted and paused" if now else "pauses before its next action"
    _wish(journal, "pause_now" if now else "pause", done, operator)


@app.command()
def stop(run: RunArgument, now: NowFlag = False, operator: ByOption = None, lab: LabOption = None) -> None:
    """Stop a run after its current sample, or now; `resume` goes on with it later."""
    from scuhand_bt.run.resume import find_run

    journal = find_run(runs_folder(lab), run)
    _wish(journal, "stop_now" if now else "stop", "stops now" if now else "stops after its current sample", operator)


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
    """Answer the question that a run waits with, from anywhere on its computer; without ANSWER, show it.

    The first answer counts. Who gave it is in the run's journal.
    """
    from scuhand_bt.run.control import say_answer, waiting_question
    from scuhand_bt.run.questions import MEANINGS
    from scuhand_bt.run.resume import find_run

    journal = find_run(runs_folder(lab), run)
    try:
        asked = waiting_question(journal)
    except TimeoutError:
        raise _refused(journal, "it does not answer") from None
    if as_json and choice is None:
        meanings = {name: MEANINGS.get(name, "") for name in asked.choices} if asked is not None else {}
        print_json({**asdict(asked), "choices": meanings} if asked is not None else None)
        return
    if asked is None:
        raise _refused(journal, "no question waits" if _is_held(journal) else "it is not running")
    out.print(Text(f"{asked.text} (since {asked.at})"))
    if choice is None:
        for name in asked.choices:
            out.print(Text(f"  {name}: {MEANINGS.get(name, 'as the question says')}"))
        if not sys.stdin.isatty():
            out.print(Text(f"`scuhand-bt answer {journal.stem} ANSWER` answers it."), soft_wrap=True)
            return
    given = (typer.prompt("Answer") if choice is None else choice).strip().lower()
    if given not in asked.choices:
        raise unknown("answer", given, asked.choices)
    by, pin = _proof(journal, operator)
    _heard(journal, lambda: say_answer(journal, asked, given, by, pin), f"goes on with '{given}'")


def what_is_known(history: "History", samples: int) -> list[str]:
    """What is known of an interrupted run, and what is not, for whoever lets it go on."""
    believed = history.state.get("believed", {})
    run, done = history.run, {sample for sample, attempt in history.samples if history.jobs[sample, attempt].is_over}
    lines = [
        f"{run.recipe} ({run.mode}): interrupted at {format_duration(history.time_s)} of run time; "
        f"the last entry is of {history.at}.",
        f"{len(done)} of {samples} samples are finished.",
    ]
    if (unfinished := history.unfinished()) is not None:
        job, name = unfinished
        open_ones = [recorded.skill for recorded in job.actions.values() if recorded.outcome not in ("done", "failed")]
        at_work = f" '{open_ones[-1]}' had begun and not ended: how far it came is not known yet." if open_ones else ""
        why = f", and had failed: {job.failure}; it is taken up where it failed" if job.failure is not None else ""
        lines.append(f"'{name}' was under way{why}.{at_work}")
    if believed:
        source, pan = believed["cone_source"], believed["pan"]
        cone = f"about {format_mass(believed['cone_mg'])} from '{source}'" if source else "no powder"
        on_pan = f"'{pan['id']}' ({pan['name']})" if pan else "nothing that is known"
        lines.append(f"Before that action the cone held {cone}, and on the pan stood {on_pan}.")
    return lines


def _is_held(journal: Path) -> bool:
    """Whether a process has this run."""
    from scuhand_bt.journal.presence import is_held

    return is_held(journal)


def _wish(journal: Path, wish: "Wish", done: str, operator: str | None = None) -> None:
    """Say a wish to the process that has the run."""
    from scuhand_bt.run.control import say_wish

    name, pin = _proof(journal, operator) if operator is not None else (None, None)
    _heard(journal, lambda: say_wish(journal, wish, name, pin), done)


def _proof(journal: Path, operator: str | None) -> tuple[str | None, str | None]:
    """The name that was given, or the user's, and the PIN of who has one."""
    from scuhand_bt.lab_state.lab_db import user_name
    from scuhand_bt.lab_state.persons import Persons, person_name

    try:
        name = person_name(operator if operator is not None else user_name())
    except ValueError as error:
        raise typer.BadParameter(str(error), param_hint="--operator") from None
    has_pin = name in Persons(journal.parent.parent).names()
    pin = typer.prompt(f"PIN of {name}", hide_input=True) if has_pin and sys.stdin.isatty() else None
    return name, pin


def _heard(journal: Path, say: "Callable[[], str | None]", done: str) -> None:
    """Say something to the process that has the run, and what it answers."""
    from scuhand_bt.run.control import HEARD

    try:
        said = say()
    except TimeoutError:
        said = "it does not answer"
    if said is None:
        said = "another process is about to begin or to resume it" if _is_held(journal) else "it is not running"
    if said != HEARD:
        raise _refused(journal, said)
    out.print(Text(f"{journal.stem} {done}."))


def _refused(journal: Path, why: str) -> typer.Exit:
    err.print(Text(f"{journal.stem}: {why}."))
    return typer.Exit(ExitCode.BAD_INPUT)
