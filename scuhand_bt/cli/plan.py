"""The command that shows what a recipe comes to: its jobs in their order, their odds, and when a person is needed."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table
from rich.text import Text

from scuhand_bt.cli.check import line_of, values_of
from scuhand_bt.cli.shared import (
    PAGES,
    JsonFlag,
    LabOption,
    RecipeArgument,
    app,
    err,
    notes_of,
    of_kind,
    out,
    print_json,
    require_can_write,
    the_plan,
)
from scuhand_bt.cli.study import MOST_TRIALS, WorkersOption, as_they_end, tell_odds
from scuhand_bt.exit_codes import ExitCode
from scuhand_bt.quantity import format_duration, format_mass

if TYPE_CHECKING:
    from scuhand_bt.api import Lab, Plan, Sample
    from scuhand_bt.study import Night, Odds, Setup, Trial

NO_NIGHT = "; nothing is said about the night"


@app.command()
def plan(
    recipe: RecipeArgument,
    trials: Annotated[
        int, typer.Option(min=0, max=MOST_TRIALS, help="Number of dry runs that estimate the odds; 0 for none.")
    ] = 4,
    workers: WorkersOption = None,
    night: Annotated[
        str | None, typer.Option(metavar="20:00-08:00", help="Show what is done in these hours, in which nobody comes.")
    ] = None,
    html: Annotated[
        Path | None, typer.Option("--html", help="Write it as a page, with the arm's motions (extra `report`).")
    ] = None,
    lab: LabOption = None,
    as_json: JsonFlag = False,
) -> None:
    """Show the jobs in their order, what to expect of them by dry runs, and every moment that needs a person."""
    from scuhand_bt.report import changer_lines

    if html is not None:
        of_kind(html, *PAGES, option="--html")
        if not trials:
            raise typer.BadParameter("a page needs at least one dry run", param_hint="--trials")
        require_can_write(html, "jinja2", extra="report")
    made, opened = the_plan(recipe, lab)
    loaded = opened.lab
    setup = _setup(made, loaded) if trials else None
    hours = _night(night, trials) if night is not None else None

    def tried(of: "Plan") -> "Odds":
        assert setup is not None, "whatever tells odds has dry runs"
        return _odds(of, _trials(replace(setup, order=of.recipe.order), trials, workers))

    notes = notes_of(made, opened, quiet=as_json, ways=bool(trials))
    doubts = opened.doubts(made)
    odds: Odds | None
    if html is not None:
        odds = tried(made)
        persons = list(_of_persons(made, loaded, odds, hours, tried))
        _preview(made, loaded, odds, html, doubts=list(map(line_of, doubts)), persons=persons)
        return
    if as_json:
        odds = tried(made) if trials else None
        night_values = None
        if odds is not None and hours is not None:
            night_values = _night_values(made, loaded, odds, hours, tried)
        values = {**_plan_values(made), "odds": odds and asdict(odds), "night": night_values}
        print_json({**values, "problems": list(map(values_of, doubts)), "notes": notes})
        return
    _tell_jobs(made)
    out.file.flush()
    ended, is_broken_off = [], False
    try:
        for one in _trials(setup, trials, workers) if setup is not None else ():
            ended.append(one)
    except KeyboardInterrupt:
        is_broken_off = True
        hours = None  # what ended first was quick, and a night would seem to hold more than it does
    odds = _odds(made, ended) if ended else None
    if odds is not None:
        from scuhand_bt.study import CELLS

        tell_odds(odds)
        out.print(CELLS, soft_wrap=True)
    for doubt in doubts:
        out.print(Text(line_of(doubt)), soft_wrap=True)
    rough = "" if odds is not None else f" Roughly {format_duration(made.duration_s)}, if nothing fails."
    fewer = f" ({made.fewest_swaps} with `order: fastest`)" if made.fewest_swaps < made.swaps else ""
    out.print(f"\nSheet swaps between samples: {made.swaps}{fewer}.{rough}")
    out.print("Before the start: the sources filled and in their places, a fresh sheet in the hand.")
    for line in changer_lines(made, loaded.cell):
        out.print(Text(line), soft_wrap=True)
    if all(person.job is None for person in made.persons) and not _is_asked_all_the_same(made, odds):
        out.print("After the start no person is needed.")
    for person, when in odds.persons_s(made) if odds is not None else ((one, None) for one in made.persons):
        first, last = (format_duration(when.low), format_duration(when.high)) if when is not None else ("", "")
        at = f" (after {first} to {last})" if first != last else f" (after {first})" if first else ""
        out.print(Text(f"A person is {person}{at}."), soft_wrap=True)
    if odds is not None:
        for line in _of_persons(made, loaded, odds, hours, tried):
            out.print(Text(line), soft_wrap=True)
    if is_broken_off:
        had = f"{len(ended)} of {trials} dry runs had ended; these are the quickest, and others may take longer"
        told = had if ended else "no dry run had ended, so there are no odds; try fewer --trials"
        err.print(Text(f"Interrupted: {told}{NO_NIGHT if night is not None else ''}."), soft_wrap=True)
        raise typer.Exit(ExitCode.INTERRUPTED)


def _tell_jobs(made: "Plan") -> None:
    """What is known without a dry run: the jobs in their order, and what they need of each source."""
    from scuhand_bt.report import amount_cell, asked_cells, composed_lines

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
        needed, amount = format_mass(demand.needed_mg), amount_cell(made, source)
        powders.add_row(source.name, source.powder.name, str(demand.samples), needed, amount)
    out.print()
    out.print(powders)


def _night(text: str, trials: int) -> "Night":
    from scuhand_bt.study import FEWEST, read_night

    if trials < FEWEST:  # they do not tell how much runs differ, and their times were taken for certain
        raise typer.BadParameter(f"--night needs at least {FEWEST} dry runs", param_hint="--trials")
    return read_night(text)


def _night_values(
    made: "Plan", loaded: "Lab", odds: "Odds", hours: "Night", tried: "Callable[[Plan], Odds]"
) -> dict[str, Any]:
    from scuhand_bt.study import better_order, fates

    better = better_order(made, loaded, odds, hours, tried)
    samples = [asdict(fate) for fate in fates(made, odds, hours)]
    return {"lasts_s": hours.lasts_s, "samples": samples, "better_order": better and asdict(better)}


def _setup(made: "Plan", loaded: "Lab") -> "Setup":
    """What is tried: the files as they are now, with which the plan was made, whatever becomes of them meanwhile."""
    from scuhand_bt.study import Setup, files_hash, modules_hash

    recipe, folder = made.recipe.path.absolute(), loaded.folder.absolute()
    files, modules = files_hash(recipe, folder), modules_hash(None, folder)
    return Setup(recipe, folder, order=made.recipe.order, files=files, modules=modules)


def _trials(setup: "Setup", trials: int, workers: int | None) -> "Iterator[Trial]":
    """By the first seeds, as they end, in the background and in the plan's order; what fails there says so itself."""
    from scuhand_bt.study import all_trials, executor_of, last_tried

    with last_tried(setup) as kept, executor_of(workers, None) as executor:
        going = all_trials([(setup, seed) for seed in range(trials)], executor, kept)
        for _, one in as_they_end(going, trials):
            yield one


def _odds(made: "Plan", ended: "Iterable[Trial]") -> "Odds":
    from scuhand_bt.study import odds_of

    return odds_of(made, sorted(ended, key=lambda one: one.seed))


def _is_asked_all_the_same(made: "Plan", odds: "Odds | None") -> bool:
    from scuhand_bt.study import unforeseen

    return odds is not None and bool(odds.stopped or unforeseen(made, odds))


def _of_persons(
    made: "Plan", lab: "Lab", odds: "Odds", hours: "Night | None", tried: "Callable[[Plan], Odds]"
) -> Iterator[str]:
    """How often somebody comes, and what is done in hours in which nobody does."""
    from scuhand_bt.study import in_words, stays_in_words, stopped_in_words, unforeseen_in_words

    yield from stopped_in_words(odds)
    yield from unforeseen_in_words(made, odds)
    yield from stays_in_words(made, odds, hours)
    if hours is not None:
        yield from in_words(made, lab, odds, hours, tried)


def _preview(
    made: "Plan", lab: "Lab", odds: "Odds", page: Path, *, doubts: Sequence[str], persons: Sequence[str]
) -> None:
    """Write the plan as a page."""
    from scuhand_bt.report import preview_page

    page.write_text(preview_page(made, lab, odds, doubts=doubts, of_persons=persons), encoding="utf-8")
    out.print(Text(f"Written: {page}"), soft_wrap=True)


def _composition_values(sample: "Sample") -> dict[str, Any] | None:
    return sample.composition.model_dump(exclude_unset=True) if sample.composition is not None else None


def _plan_values(made: "Plan") -> dict[str, Any]:
    from scuhand_bt.report import asked_mg

    asked = {job.name: asked_mg(job.sample) if job.sample else ([], []) for job in made.jobs}
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
                "masses_mg": asked[job.name][0],
                "tolerances_mg": asked[job.name][1],
                "composition": _composition_values(job.sample) if job.sample else None,
            }
            for job in made.jobs
        ],
        "swaps": made.swaps,
        "fewest_swaps": made.fewest_swaps,
        "sources": [
            {
                "name": demand.source.name,
                "powder": demand.source.powder.name,
                "samples": demand.samples,
                "needed_mg": demand.needed_mg,
                "amount_mg": demand.source.amount_mg,
                "refills": made.refills[demand.source.name],
            }
            for demand in made.demands
        ],
        "persons": [{"job": person.job, "what": person.what, "where": str(person.mark)} for person in made.persons],
        "duration_s": made.duration_s,
    }
