"""A fleet of cells: what it does in a day, what holds it up, what its queue costs, and whether kills break it.

    python -m benchmarks.fleet [--days 5] [--seeds 2]    # 1 to 256 cells as discrete events
    python -m benchmarks.fleet --draw 8                  # the dry runs that these are drawn from, anew
    python -m benchmarks.fleet --queue 100000            # submitting to and taking from a PostgreSQL of its own
    python -m benchmarks.fleet --chaos 100 [--seed 0]    # stations, runs, submitters and the server killed so often

Each part replaces its own figures in fleet_results.json. The simulated fleet (`fleet_model.py`) works at the shipped
recipes. Durations, good samples, powder used, the moments that need a person and runs that stop by themselves are those
of real dry runs, each on a cell of its own (`study/some_cell.py`); which cell can do what is told by the product's own
function. What no dry run tells is assumed, and stands in `Assumed`.
"""

import argparse
import asyncio
import json
import statistics
import sys
import tempfile
import time
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from procrastinate.jobs import Status
from pydantic import TypeAdapter

from benchmarks.fleet_model import KITS, Assumed, DryRun, Kind, simulate
from harness.fleet import Chaos, chaos
from harness.postgres import server
from scuhand_bt.fleet.needs import Offer, missing, needs_of, offer_of
from scuhand_bt.fleet.order import submission_of
from scuhand_bt.fleet.queue import open_queue
from scuhand_bt.lab import Lab, load_lab, starter_lab
from scuhand_bt.recipe.plan import make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.study.trial import Setup, trial

RESULTS = Path(__file__).with_name("fleet_results.json")
RECIPES = ("xrd_holders", "pellet_dies", "crucibles", "synthesis_batch")
CELLS = (1, 4, 16, 64, 256)
STAFFS = {
    "1 to 4 cells, 8 to 20 h": Assumed(),
    "1 to 4 cells, round the clock": Assumed(shift_h=(0.0, 24.0)),
    "1 to each cell, round the clock": Assumed(cells_a_person=1.0, shift_h=(0.0, 24.0)),
}
"""How many persons there are, and when."""
STATIONS = 16
"""Of the queue that is measured."""
SINGLE = 1000
"""So many jobs are submitted by themselves, the others by hundreds."""
CLAIMS = 300


def draw(seeds: int) -> list[Kind]:
    """The shipped recipes, each with so many dry runs."""
    lab = load_lab(starter_lab())
    offer = offer_of(lab, simulated=True, unattended=False)
    offers = [offer.model_copy(update={"names": {**offer.names, "powder": kit}}) for kit in KITS]
    return [_kind(name, lab, offers, seeds) for name in RECIPES]


def _kind(name: str, lab: Lab, offers: Sequence[Offer], seeds: int) -> Kind:
    path = starter_lab() / "recipes" / f"{name}.yaml"
    plan = make_plan(load_recipe(path, lab), lab)
    persons = [one.job for one in plan.persons if one.job is not None]
    runs = []
    for seed in range(seeds):
        one = trial(Setup(path, lab.folder), seed)
        good = sum(sample.good for sample in one.samples)
        needed_s = [one.began_s[job] for job in persons if job in one.began_s]
        stopped = one.exit_code not in (0, 1)
        runs.append(DryRun(one.duration_s, good, len(one.samples), stopped, needed_s, dict(one.used_mg)))
        print(name, seed, f"{one.duration_s:.0f} s, {good} of {len(one.samples)} good", flush=True)
    needs, sources = needs_of(plan, simulated=True), plan.recipe.sources.values()
    return Kind(
        name,
        plan.duration_s,
        len(plan.recipe.samples),
        {source.name: source.amount_mg for source in sources},
        sorted(source.sheet_key for source in sources),
        [not missing(needs, offer) for offer in offers],
        runs,
    )


def fleets(kinds: Sequence[Kind], *, days: int, seeds: int) -> list[dict[str, Any]]:
    """Every size of fleet with each staff, the mean over the seeds."""
    slots, rows = load_lab(starter_lab()).cell.changer.slots, []
    assert isinstance(slots, int), "the starter lab's slots take containers of any kind"
    for staff, assumed in STAFFS.items():
        for cells in CELLS:
            found = [simulate(kinds, cells, assumed, days=days, seed=seed, slots=slots) for seed in range(seeds)]
            means = {key: statistics.mean(one[key] for one in found) for key in found[0] if key != "shares"}
            shares = {key: statistics.mean(one["shares"][key] for one in found) for key in found[0]["shares"]}
            bottleneck = max((key for key in shares if key != "runs"), key=shares.__getitem__)
            rows.append({"cells": cells, "persons": staff, **means, "shares": shares, "bottleneck": bottleneck})
            told = ", ".join(f"{key} {share:.1%}" for key, share in shares.items())
            print(
                f"{cells} cells, persons {staff}: {means['samples_a_day']:.0f} good samples a day; {told}", flush=True
            )
    return rows


async def queue_costs(database: str, jobs: int) -> dict[str, Any]:
    """What a job costs the queue: milliseconds of submitting, taking, looking and finishing, with so many waiting."""
    lab = load_lab(starter_lab())
    offer = offer_of(lab, simulated=True, unattended=False)
    recipe = starter_lab() / "recipes" / f"{RECIPES[-1]}.yaml"
    one = submission_of(make_plan(load_recipe(recipe, lab), lab), simulated=True)
    names = [f"cell-{number}" for number in range(STATIONS)]
    orders = [
        replace(one, order=one.order.model_copy(update={"key": f"{n}", "stations": (names[n % STATIONS],)}))
        for n in range(jobs)
    ]
    took_ms: dict[str, list[float]] = {}

    async def timed(what: str, done: Awaitable[Any], count: int = 1) -> Any:
        began_s = time.perf_counter()
        result = await done
        took_ms.setdefault(what, []).append((time.perf_counter() - began_s) * 1000 / count)
        return result

    async with open_queue(database) as queue:
        for name in names:
            await queue.enrol(name, name, offer)
        for first in range(0, jobs - SINGLE, 100):
            await timed("submit, of 100 at once", queue.submit(orders[first : first + 100]), 100)
        for last in orders[-SINGLE:]:
            await timed("submit", queue.submit([last]))
        for number in range(CLAIMS):
            name = names[number % STATIONS]
            taken = await timed("take", queue.take(name))
            await timed("look", queue.taken(name))
            await timed("tell", queue.tell(name, "runs"))
            await timed("finish", queue.finish(taken.id, Status.SUCCEEDED))
        await timed("take over, nothing", queue.take_over("another"))
        await timed("list the stations", queue.stations())
        await timed("list the jobs", queue.jobs(every=False, limit=30))
    return {"jobs": jobs, "ms": {what: _spread(found) for what, found in took_ms.items()}}


def _spread(found: Sequence[float]) -> dict[str, float]:
    ordered = sorted(found)
    return {"mean": statistics.mean(ordered), "p99": ordered[int(0.99 * (len(ordered) - 1))], "most": ordered[-1]}


def at_least(least: int) -> Callable[[str], int]:
    """A whole number of an argument, which is not less."""

    def number(text: str) -> int:
        if (given := int(text)) < least:
            raise argparse.ArgumentTypeError(f"{given}: it is at least {least}")
        return given

    return number


def main(words: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--days", type=at_least(1), default=5)
    parser.add_argument("--seeds", type=at_least(1), default=2)
    part = parser.add_mutually_exclusive_group()
    part.add_argument("--draw", type=at_least(1), metavar="SEEDS")
    part.add_argument("--queue", type=at_least(SINGLE), metavar="JOBS")
    part.add_argument("--chaos", type=at_least(1), metavar="KILLS")
    parser.add_argument("--seed", type=int, default=0, help="of the chaos")
    parser.add_argument("--json", type=Path, default=RESULTS)
    given = parser.parse_args(words)
    results = json.loads(given.json.read_text(encoding="utf-8")) if given.json.exists() else {}
    if given.draw:
        results["kinds"] = [asdict(kind) for kind in draw(given.draw)]
        for of_others in ("fleets", "assumed"):  # which were simulated with other dry runs
            results.pop(of_others, None)
    elif given.queue:
        with server() as made:
            results["queue"] = asyncio.run(queue_costs(made.address(), given.queue))
        print(json.dumps(results["queue"], indent=1))
    elif given.chaos:
        with server() as made, tempfile.TemporaryDirectory() as folder:
            found = chaos(Path(folder), made, kills=given.chaos, seed=given.seed)
        results["chaos"] = TypeAdapter(Chaos).dump_python(found, mode="json")  # `asdict` counts a Counter's pairs
        print(json.dumps(results["chaos"], indent=1))
    elif "kinds" not in results:
        parser.error(f"{given.json} has no dry runs that a fleet's are drawn from: --draw SEEDS makes some")
    else:
        kinds = [Kind(**{**kind, "runs": [DryRun(**run) for run in kind["runs"]]}) for kind in results["kinds"]]
        results["fleets"] = fleets(kinds, days=given.days, seeds=given.seeds)
        results["assumed"] = asdict(Assumed())
    given.json.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    sys.exit(bool(given.chaos and results["chaos"]["tally"]["problems"]))


if __name__ == "__main__":
    main()
