"""The command about many dry runs of a recipe."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from scuhand_bt.cli.shared import (
    JsonFlag,
    LabOption,
    RecipeArgument,
    app,
    err,
    of_kind,
    out,
    print_json,
    require_can_write,
    the_plan,
    write_picture,
)
from scuhand_bt.exit_codes import ExitCode
from scuhand_bt.quantity import format_duration, format_mass, listed

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from scuhand_bt.study import Chance, Odds, Range, Setup, Store, Task, Trial, Vary

WorkersOption = Annotated[int | None, typer.Option(min=1, help="Processes; default: one for each core.")]
ROUGH = 0.1
"""So far an estimate of a Sobol index may be from where it can be without a word: with a hundred draws many are."""
MOST_TRIALS = 1_000_000
"""Of a study; each waits in memory until it is begun."""


@app.command()
def study(
    recipe: RecipeArgument,
    trials: Annotated[int, typer.Option(min=1, help="Number of dry runs, with consecutive seeds; for each draw.")] = 20,
    first_seed: Annotated[int, typer.Option(min=0, max=10**12, help="Seed of the first dry run.")] = 0,
    vary: Annotated[Path | None, typer.Option("--vary", help="A file of what to vary (docs/study.md).")] = None,
    optimise: Annotated[
        int | None,
        typer.Option(
            min=2, metavar="CANDIDATES", help="Search this many candidates for better values of what --vary names."
        ),
    ] = None,
    workers: WorkersOption = None,
    dask: Annotated[str | None, typer.Option(metavar="ADDRESS", help="Run them on a Dask cluster.")] = None,
    controller: Annotated[str | None, typer.Option(help="The dosing controller.")] = None,
    plant: Annotated[str | None, typer.Option(help="Simulated physics of all dry runs: module:Class.")] = None,
    store: Annotated[Path | None, typer.Option("--store", help="Keep trials here, not in the lab's own file.")] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Write every sample of every trial, as CSV or Parquet.")
    ] = None,
    plot: Annotated[
        Path | None, typer.Option("--plot", help="Draw the results (PNG or SVG; needs the extra `plot`).")
    ] = None,
    lab: LabOption = None,
    as_json: JsonFlag = False,
) -> None:
    """Dry-run a recipe many times: its odds, and what they depend on. An interrupted study continues where it was."""
    from scuhand_bt.api import check_controller
    from scuhand_bt.report import plot_study
    from scuhand_bt.study import (
        TABLE_KINDS,
        Setup,
        all_trials,
        check_setups,
        ends_of,
        executor_of,
        files_hash,
        modules_hash,
        odds_of,
        open_store,
        read_vary,
        stopped_in_words,
        write_table,
    )

    for hint, file, kinds in (("--output", output, TABLE_KINDS), ("--plot", plot, (".png", ".svg"))):
        if file is not None:
            of_kind(file, *kinds, option=hint)
            if optimise is not None:
                raise typer.BadParameter("a search only proposes values, and writes no file", param_hint=hint)
            needed, extra = ("matplotlib", "plot") if file is plot else ("pyarrow", "study")
            require_can_write(file, *([needed] if file.suffix.lower() != ".csv" else []), extra=extra)
    if dask is not None and workers is not None:
        raise typer.BadParameter("a Dask cluster has its own workers", param_hint="--workers")
    check_controller(controller)
    made, opened = the_plan(recipe, lab)
    path, folder = recipe.absolute(), opened.lab.folder.absolute()
    files, modules = files_hash(path, folder), modules_hash(plant, folder)
    setup = Setup(path, folder, controller=controller, plant=plant, files=files, modules=modules)
    varied = read_vary(vary, setup.recipe, setup.lab) if vary is not None else None
    if varied is not None and controller is not None and "recipe.controller" in varied.vary:
        raise typer.BadParameter("--vary already names it", param_hint="--controller")
    kept_in = store or opened.state / "studies.sqlite"
    if optimise is not None:
        if varied is None:
            raise typer.BadParameter("name the values to search by --vary FILE", param_hint="--optimise")
        _require_few((optimise + 3) * trials)  # and those as written, and the best, on other seeds
        check_setups([replace(setup, changes=changes) for changes in varied.ends()])
        with _goes_on_later(kept_in), open_store(kept_in, setup) as kept, executor_of(workers, dask, _tell) as executor:
            seeds = range(first_seed, first_seed + trials)
            _propose(setup, varied, optimise, seeds, executor, kept, as_json=as_json)
        return
    draws = [setup] if varied is None else [replace(setup, changes=changes) for changes in varied.changes()]
    apart = list(dict.fromkeys(draws))  # of few names many draws are alike: the same dry runs tell nothing more
    _require_few(len(apart) * trials)
    if varied is not None:
        check_setups(ends_of(apart))
    tasks = [(draw, seed) for draw in apart for seed in range(first_seed, first_seed + trials)]
    found: dict[Task, Trial] = {}
    with _goes_on_later(kept_in), open_store(kept_in, setup) as kept, executor_of(workers, dask, _tell) as executor:
        going = all_trials(tasks, executor, kept)
        for task, one in as_they_end(going, len(tasks)):
            found[task] = one
    ordered = [(task, found[task]) for task in tasks]
    if output is not None:
        write_table(output, ordered)
    as_written = varied is None or not any(place.startswith("recipe.") for place in varied.vary)
    odds = odds_of(made, [one for _, one in ordered], as_written=as_written)
    dominant = _dominant(varied, draws, ordered) if varied is not None else {}
    if plot is not None:
        write_picture(plot, lambda: plot_study(odds, [one for _, one in ordered], dominant, plot, made.recipe.name))
    if as_json:
        print_json({**asdict(odds), "draws": len(apart), "indices": dominant})
        return
    tell_odds(odds)
    for line in stopped_in_words(odds):
        out.print(Text(line), soft_wrap=True)
    if dominant:
        tell_dominant(dominant, varied.design if varied is not None else "")
    out.print(Text(f"Trials are kept in {kept_in}"), soft_wrap=True)


def _require_few(many: int) -> None:
    if many > MOST_TRIALS:
        raise typer.BadParameter(f"these are {many} dry runs; at most {MOST_TRIALS} are allowed", param_hint="--trials")


def as_they_end(going: "Iterator[tuple[Task, Trial]]", many: int) -> "Iterator[tuple[Task, Trial]]":
    """So many trials, with how far they are on a terminal: how long they have gone on, before the first has ended."""
    columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn(), TextColumn("left"))
    with Progress(TextColumn("dry runs"), *columns, console=err, disable=not err.is_terminal) as progress:
        yield from progress.track(going, many)


def _tell(what: str) -> None:
    err.print(Text(f"{what}."), soft_wrap=True)


@contextmanager
def _goes_on_later(kept_in: Path) -> Iterator[None]:
    """What a Ctrl-C breaks off says what is left of it, and how it goes on."""
    try:
        yield
    except KeyboardInterrupt:
        left = f"Finished dry runs are kept in {kept_in}; the same command continues with the others."
        err.print(Text(f"Interrupted. {left}"), soft_wrap=True)
        raise typer.Exit(ExitCode.INTERRUPTED) from None


def _propose(
    setup: "Setup",
    vary: "Vary",
    candidates: int,
    seeds: range,
    executor: "Executor",
    kept: "Store",
    *,
    as_json: bool,
) -> None:
    """Show figures that are better, as a diff: nothing is changed."""
    from scuhand_bt.study import diff, optimised

    held_out = range(seeds.stop, seeds.stop + len(seeds))
    found = optimised(setup, vary, candidates, seeds, held_out, executor, kept)
    if as_json:
        print_json({**asdict(found), "changes": dict(found.changes)})
        return
    table = Table("on held-out seeds", "in tolerance", "a run takes", show_edge=False)
    for name, came in (("as written", found.as_written), ("proposed", found.proposed)):
        table.add_row(name, f"{came.good:.1%}", format_duration(came.duration_s))
    out.print(table)
    if found.refused:
        out.print(f"Of {candidates} candidates {found.refused} are not valid in a recipe or lab.")
    if found.proposed.good == 0.0:
        out.print(
            f"The best of {candidates} candidates brings no sample into tolerance; a study without --optimise says why."
        )
        return
    if not found.is_better:
        out.print(
            f"Of {candidates} candidates the best is not better than the present values, or by no more than chance: "
            "more `--trials` show a smaller difference.",
            soft_wrap=True,
        )
        return
    for line in diff(setup, found.changes):
        out.print(Text(line), soft_wrap=True)
    out.print("No file was changed: write what you want to use into the files.")


def tell_odds(odds: "Odds") -> None:
    """The odds, as a person reads them."""
    from scuhand_bt.study import RECKONED

    if odds.tells_intervals:
        by = f"{odds.trials} dry runs (intervals of 90 %)"
    elif odds.trials == 1:
        by = "1 dry run, too few for an interval"
    else:
        by = f"{odds.trials} dry runs, too few for an interval (ranges are of these runs)"
    out.print(f"\nBy {by}: it takes {_range(odds.duration_s, format_duration)}.")
    table = Table("source", "scoops", "powder used", *(f"left, {kind}" for kind in odds.left), show_edge=False)
    for name, scoops in odds.scoops.items():
        masses = (odds.used_mg[name], *(odds.leftovers_mg[name][kind] for kind in odds.left))
        table.add_row(name, _range(scoops, lambda count: f"{count:.0f}"), *(_range(one, format_mass) for one in masses))
    if odds.scoops:
        out.print(table)
        out.print(RECKONED, soft_wrap=True)
    if odds.samples:
        out.print(f"In tolerance: {odds.good:.1f} of {round(odds.asked, 1):g} samples are expected.")
    alike: dict[Chance, list[str]] = {}
    for name in odds.unlikely:
        alike.setdefault(odds.samples[name], []).append(name)
    for chance, names in alike.items():
        who = f"{names[0]} is" if len(names) == 1 else f"{listed(names, 'sample')} are each"
        what = f"Warning: {who} in tolerance with a probability of {chance.told}"
        out.print(Text(f"{what}."), soft_wrap=True)
    for what, count in odds.not_good.items():
        out.print(Text(f"{what}: {count:.2g} of a run's samples."))


def _range(found: "Range", told: Any) -> str:
    low, middle, high = told(found.low), told(found.middle), told(found.high)
    return f"{middle} ({low} to {high})" if low != high else str(middle)


def _dominant(vary: "Vary", draws: "list[Setup]", ordered: "list[tuple[Task, Trial]]") -> dict[str, dict[str, Any]]:
    """Of success and time: Sobol indices by place; or how each goes with its numbers (Spearman), the mean by name."""
    from scuhand_bt.study import goes_with, means_of

    figures: dict[str, dict[Setup, list[float]]] = {"good": {}, "duration_s": {}}
    for (setup, _), one in ordered:
        good = sum(sample.good for sample in one.samples) / max(len(one.samples), 1)
        figures["good"].setdefault(setup, []).append(good)
        figures["duration_s"].setdefault(setup, []).append(one.duration_s)
    means = {name: [sum(of[draw]) / len(of[draw]) for draw in draws] for name, of in figures.items()}
    if vary.design == "sobol":
        return {
            name: {place: {"first": first, "total": total} for place, (first, total) in vary.indices(of).items()}
            for name, of in means.items()
        }
    return {
        name: {place: {"rank": rank} for place, rank in goes_with(draws, of).items()}
        | {place: {"means": by_name} for place, by_name in means_of(draws, of).items()}
        for name, of in means.items()
    }


def tell_dominant(dominant: dict[str, dict[str, Any]], design: str) -> None:
    """What success and time depend on, as a person reads it."""
    columns = ("first", "total") if design == "sobol" else ("rank",)
    heads = {"first": "Sobol, first order", "total": "Sobol, total", "rank": "rank correlation"}
    for name, places in dominant.items():
        told = format_duration if name == "duration_s" else "{:.0%}".format
        by_name = {place: values["means"] for place, values in places.items() if "means" in values}
        ranked = [item for item in places.items() if item[0] not in by_name]
        table = Table(f"what {name} depends on", *(heads[column] for column in columns), show_edge=False)
        for place, values in sorted(ranked, key=lambda item: -abs(item[1][columns[-1]])):
            table.add_row(place, *(f"{values[column]:.2f}" for column in columns))
        means = Table(f"{name} with", "mean", show_edge=False)
        for place, named in by_name.items():
            for value, mean in named.items():
                means.add_row(f"{place}: {value}", told(mean))
        for one in (table, means):
            if one.rows:
                out.print()
                out.print(one)
    indices = [values for places in dominant.values() for values in places.values() if "total" in values]
    if any(not -ROUGH <= one["first"] <= one["total"] + ROUGH <= 1.0 + 2.0 * ROUGH for one in indices):
        out.print(
            "These shares are rough: some are not between 0 and 1, or a total is less than its first order. More "
            "`draws` make them better.",
            soft_wrap=True,
        )
