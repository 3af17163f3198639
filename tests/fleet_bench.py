"""Orders for a fleet, a queue with stations enrolled, and one that works until something is so."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from scuhand_bt.fleet.needs import Offer
from scuhand_bt.fleet.order import Submission, submission_of
from scuhand_bt.fleet.queue import Queue, QueuedJob, open_queue
from scuhand_bt.fleet.station import Station
from scuhand_bt.lab import load_lab
from scuhand_bt.recipe.plan import Plan, make_plan
from scuhand_bt.recipe.recipe import load_recipe

RECIPE = """recipe: queued
workflow: fill_xrd_holder
sources:
  beads: {{station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 20 g, lot: GB-1}}
defaults: {{source: beads, container: xrd_holder, tolerance: 2 mg}}
samples: [{{id: a, mass: 30 mg, repeat: {count}}}]
"""
PATIENCE_S = 300.0


def plan_of(lab: Path, name: str = "queued.yaml", text: str | None = None, count: int = 2) -> Plan:
    recipe = lab / name
    recipe.write_text(text or RECIPE.format(count=count), encoding="utf-8")
    loaded = load_lab(lab)
    return make_plan(load_recipe(recipe, loaded), loaded)


def but(one: Submission, **changes: Any) -> Submission:
    """The same, with another order."""
    return replace(one, order=one.order.model_copy(update=changes))


def job_for(lab: Path, *stations: str) -> Submission:
    """A simulated run of a lab's own recipe, for these."""
    return but(submission_of(plan_of(lab), simulated=True), stations=stations)


@asynccontextmanager
async def enrolled(database: str, offer: Offer, *names: str) -> AsyncIterator[Queue]:
    async with open_queue(database) as queue:
        for name in names:
            assert await queue.enrol(name, f"identity of {name}", offer)
        yield queue


def run(coroutine: Coroutine[Any, Any, None]) -> None:
    asyncio.run(asyncio.wait_for(coroutine, PATIENCE_S))


async def works(
    station: Station, queue: Queue, until: Callable[[list[QueuedJob]], Awaitable[bool] | bool]
) -> list[QueuedJob]:
    """Let a station work until something is so of the jobs; these, the oldest first."""
    working = asyncio.ensure_future(station.work())
    try:
        while True:
            jobs = sorted(await queue.jobs(every=True, limit=99), key=lambda job: job.id)
            if working.done():
                await working
            if (is_so := until(jobs)) is True or (not isinstance(is_so, bool) and await is_so):
                return jobs
            await asyncio.sleep(0.05)
    finally:
        station.leave()
        await working


def all_over(jobs: list[QueuedJob]) -> bool:
    return all(job.status not in ("todo", "doing") for job in jobs)
