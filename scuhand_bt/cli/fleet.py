"""Commands about several cells on one queue: a cell's station, and what is submitted to it and looked at."""

import asyncio
import signal
from collections.abc import Coroutine
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer
from rich.text import Text

from scuhand_bt.cli.listing import Listing
from scuhand_bt.cli.shared import JsonFlag, LabOption, UnattendedFlag, app, err, out, print_json, the_lab, the_plan
from scuhand_bt.exit_codes import ExitCode
from scuhand_bt.problems import Mark, Problem, SourceError
from scuhand_bt.quantity import format_duration

if TYPE_CHECKING:
    from scuhand_bt.fleet import KnownStation, QueuedJob

T = TypeVar("T")
DatabaseOption = Annotated[
    str,
    typer.Option(
        "--database",
        envvar="SCUHAND_DATABASE",
        help="The queue's PostgreSQL database, as libpq names it; default: what PGSERVICE, PGHOST … say.",
    ),
]
SHOWN, MOST_SHOWN = 30, 1_000_000


@app.command()
def station(
    name: Annotated[str | None, typer.Option("--name", help="Its name in the queue; default: the cell's.")] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="A simulated station, for dry runs.")] = False,
    unattended: UnattendedFlag = False,
    resumes: Annotated[bool, typer.Option("--resume", help="Resume a killed run once, without a person.")] = False,
    operator: Annotated[str | None, typer.Option(metavar="NAME", help="Who is at the cell, for its runs.")] = None,
    database: DatabaseOption = "",
    lab: LabOption = None,
) -> None:
    """Take the queue's jobs for this cell, one after the other. After SIGTERM it takes no more."""
    _require_fleet()
    from scuhand_bt.fleet import Manner, Station, open_queue

    if not dry_run and operator is None:
        raise typer.BadParameter("a run on the cell needs a person's name", param_hint="--operator")
    if name is not None and not (name.strip() and name.isprintable()):
        raise typer.BadParameter("a name must have only visible letters", param_hint="--name")
    folder = the_lab(lab).folder
    if operator is not None:
        _require_unsigned(operator, lab)

    async def work() -> None:
        async with open_queue(database) as queue:
            manner = Manner(dry_run, unattended, resumes, operator)
            made = Station(queue, folder, name, manner, _say)
            for number in (signal.SIGINT, signal.SIGTERM):
                asyncio.get_running_loop().add_signal_handler(number, made.leave)
            _say(f"Station '{made.name}'{' (SIMULATED)' if dry_run else ''}.")
            await made.work()

    _answered(work())


@app.command()
def submit(
    recipes: Annotated[list[Path], typer.Argument(help="Recipe files (YAML); each is a job.", show_default=False)],
    dry_run: Annotated[bool, typer.Option("--dry-run", help="For simulated stations.")] = False,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the dry runs.")] = 0,
    at: Annotated[str | None, typer.Option("--station", metavar="NAME", help="Only there.")] = None,
    database: DatabaseOption = "",
    lab: LabOption = None,
    as_json: JsonFlag = False,
) -> None:
    """Check recipes, and queue each for a station that has what it needs; if one is refused, none is queued."""
    _require_fleet()
    from scuhand_bt.fleet import choose, open_queue, submission_of

    asked = [submission_of(the_plan(recipe, lab)[0], simulated=dry_run, seed=seed) for recipe in recipes]

    async def queue_them() -> "tuple[list[int], list[KnownStation], list[str]]":
        async with open_queue(database) as queue:
            known = await queue.stations()
            chosen = choose(asked, known, at)
            return await queue.submit(chosen), known, [one.order.stations[0] for one in chosen]

    numbers, known, where = _answered(
        queue_them(), "it is not known whether it was queued: look with `scuhand-bt queue`"
    )
    if as_json:
        print_json([{"job": job, "station": name} for job, name in zip(numbers, where, strict=True)])
        return
    absent = {one.name for one in known if not one.is_there}
    for number, recipe, name in zip(numbers, recipes, where, strict=True):
        out.print(Text(f"job {number}: {recipe} at {name}"), soft_wrap=True)
    for name in dict.fromkeys(name for name in where if name in absent):
        err.print(Text(f"Note: no station that can do it is running now; it waits until {name} begins"))


@app.command()
def queue(
    every: Annotated[bool, typer.Option("--all", help="Show finished jobs, too.")] = False,
    most: Annotated[int, typer.Option(min=1, max=MOST_SHOWN, help="Show at most this many, the newest ones.")] = SHOWN,
    database: DatabaseOption = "",
    as_json: JsonFlag = False,
) -> None:
    """List the running and the waiting jobs, of each the newest first."""
    _require_fleet()
    from scuhand_bt.fleet import open_queue

    async def jobs() -> "list[QueuedJob]":
        async with open_queue(database) as queue:
            return await queue.jobs(every=every, limit=most + 1)

    found = _answered(jobs())
    found, others = found[:most], found[most:]
    if as_json:
        print_json([{**asdict(job), "at": job.at.isoformat()} for job in found])
        return
    table = Listing("job", "recipe", "station", "status", "by", "since", "run", "")
    for job in found:
        status = f"{job.status}, to stop" if job.is_to_stop else job.status
        said = job.said
        if job.is_forsaken:
            said = f"'{job.station}' was last heard of {format_duration(job.silent_s or 0.0)} ago{said and ': '}{said}"
        elif job.left_s is not None:
            status += f", {format_duration(job.left_s)} left"
        recipe = f"{job.recipe} (SIMULATED)" if job.simulated else job.recipe
        since = f"{job.at.astimezone():%Y-%m-%d %H:%M}"
        table.add_row(str(job.id), recipe, job.station, status, job.by, since, job.run, said)
    out.print(table if found else "The queue is empty.")
    if others:
        out.print(f"… and more: `--most` shows more than {most}.")


@app.command()
def cancel(
    job: Annotated[int, typer.Argument(help="The job's number.", show_default=False)], database: DatabaseOption = ""
) -> None:
    """Take a job out of the queue; a running one stops after its current sample."""
    _require_fleet()
    from scuhand_bt.fleet import HELD_BACK, open_queue

    async def cancelled() -> "tuple[bool, KnownStation | None]":
        async with open_queue(database) as queue:
            is_cancelled = await queue.cancel(job)
            return is_cancelled, await queue.at_work_on(job) if is_cancelled else None

    is_cancelled, by = _answered(cancelled(), "it is not known whether it was cancelled: look with `scuhand-bt queue`")
    if not is_cancelled:
        err.print(Text(f"job {job} is neither waiting nor running; `scuhand-bt queue --all` lists all"))
        raise typer.Exit(ExitCode.BAD_INPUT)
    if by is None:
        said = "is cancelled."
    elif by.is_there and by.state.startswith(f"{HELD_BACK} {job}:"):  # not for one before it
        said = f"is given up at '{by.name}', whose run was interrupted: the next one begins there; look at the cell."
    elif by.is_there:
        said = f"stops at '{by.name}' after its current sample."
    else:
        heard = "has ended" if by.has_ended else f"was last heard of {format_duration(by.silent_s)} ago"
        said = (
            f"is to stop, but '{by.name}', which has taken it, {heard}: its run goes on until the station is back, and "
            "a run that was interrupted is given up then; look at the cell first."
        )
    out.print(Text(f"job {job} {said}"), soft_wrap=True)


@app.command()
def fleet(
    forget: Annotated[str | None, typer.Option(metavar="NAME", help="Forget a station that no longer exists.")] = None,
    database: DatabaseOption = "",
    as_json: JsonFlag = False,
) -> None:
    """List the stations: what each does, when it was last heard of, and how much work is waiting for it."""
    _require_fleet()
    from scuhand_bt.fleet import ABSENT_S, open_queue

    async def stations() -> "tuple[bool, list[KnownStation]]":
        async with open_queue(database) as queue:
            is_gone = forget is None or await queue.forget(forget)
            return is_gone, await queue.stations()

    is_gone, found = _answered(stations())
    if not is_gone:
        known = {one.name: one for one in found}
        why = "is not a station of the queue" if forget not in known else "has jobs"
        if forget in known and known[forget].is_there:
            why = f"is running, it was heard of in the last {format_duration(ABSENT_S)}: end it first"
        raise typer.BadParameter(f"'{forget}' {why}", param_hint="--forget")
    if as_json:
        offers = [one.offer.model_dump(mode="json") if one.offer is not None else None for one in found]
        print_json([{**asdict(one), "offer": offer} for one, offer in zip(found, offers, strict=True)])
        return
    table = Listing("station", "cell", "heard of", "jobs", "before it", "state")
    for one in found:
        heard = "now" if one.is_there else f"{format_duration(one.silent_s)} ago"
        ahead = format_duration(one.ahead_s) if one.jobs else ""
        state = one.state if one.is_there or one.has_ended else f"was: {one.state}"
        table.add_row(one.name, _cell_of(one), heard, str(one.jobs), ahead, state)
    out.print(table if found else "There are no stations.")


def _cell_of(station: "KnownStation") -> str:
    if station.offer is None:
        return "of another version"
    return f"{station.offer.cell} (SIMULATED)" if station.offer.simulated else station.offer.cell


def _require_unsigned(operator: str, lab: Path | None) -> None:
    """BadParameter for a person in whose name no run could begin when a job comes."""
    from scuhand_bt.api import find_state
    from scuhand_bt.api.books import Persons, person_name

    try:
        name = person_name(operator)
    except ValueError as error:
        raise typer.BadParameter(str(error), param_hint="--operator") from None
    if name in Persons(find_state(lab)).names():
        what = f"{name} signs with a PIN, which nobody can enter when a job comes: name a person without a PIN"
        raise typer.BadParameter(what, param_hint="--operator")


def _require_fleet() -> None:
    try:
        import procrastinate  # noqa: F401
    except ImportError as error:
        raise typer.BadParameter(f"a queue needs {error.name}: pip install 'scuhand-bt[fleet]'") from None


def _answered(asked: "Coroutine[Any, Any, T]", else_: str = "") -> T:
    """What the database answers; SourceError where it went away meanwhile."""
    from procrastinate.exceptions import ConnectorException

    try:
        return asyncio.run(asked)
    except ConnectorException as error:
        why = " ".join(str(error.__cause__ or error).split())
        what = f"the connection to the queue's database was lost ({why}); {else_}".removesuffix("; ")
        raise SourceError([Problem(Mark("--database", 0), what)]) from None


def _say(line: str) -> None:
    out.print(Text(line), soft_wrap=True)
    out.file.flush()
