"""A fleet of cells as discrete events (simpy): cells with their queues, persons with shifts, refills, faults."""

import random
import statistics
from collections import Counter, deque
from collections.abc import Generator, Sequence
from dataclasses import dataclass, field
from typing import Any

import simpy

from scuhand_bt.fleet.station import IDLE_LOOKS, LOOK_S

DAY_S = 86400.0
BEGINS_S = 9 * 3600.0
"""Of the day, when the simulated time begins, and each day's recipes are submitted."""
AHEAD_DAYS = 1.5
"""So much is before every cell then, by the forecasts: more than it can do."""
SHARES = ("runs", "set up", "person", "fault", "no job")
KITS = (("glass_beads", "monosodium_glutamate", "titanium_dioxide"), ("glass_beads", "monosodium_glutamate"))
"""Powders of the cells, in turn."""


@dataclass(frozen=True)
class Assumed:
    """What no dry run tells."""

    cells_a_person: float = 4.0
    shift_h: tuple[float, float] = (8.0, 20.0)
    """Of every person, every day; (0, 24) is round the clock."""
    walk_s: float = 120.0
    """Until a person who is free stands at the cell."""
    set_up_s: float = 300.0
    """To fill mortars and changer, and mount a sheet."""
    fault_every_h: float = 50.0
    """Of running, a device fails, and a person sees to it."""
    repair_s: float = 1200.0
    """On average, exponential; also to look at a run that stopped by itself."""


@dataclass(frozen=True)
class DryRun:
    """One of those that are drawn from."""

    duration_s: float
    good: int
    samples: int
    stopped: bool
    persons_s: list[float]
    """When a person is needed in it."""
    used_mg: dict[str, float]
    """Of each source."""


@dataclass(frozen=True)
class Kind:
    """A recipe: its plan's figures, and its dry runs."""

    name: str
    forecast_s: float
    samples: int
    amounts_mg: dict[str, float]
    lots: list[str]
    able: list[bool]
    """By kit, whether such a cell can do it."""
    runs: list[DryRun]


@dataclass
class Cell:
    """One cell: its waiting jobs, what stands in it, and what its time went into."""

    kit: int
    queue: deque["Job"] = field(default_factory=deque)
    ahead_s: float = 0.0
    lots: list[str] = field(default_factory=list)
    left_mg: dict[str, float] = field(default_factory=dict)
    slots_used: int = 0
    spent_s: Counter[str] = field(default_factory=Counter)
    good: int = 0
    jobs: int = 0


@dataclass(eq=False)
class Job:
    kind: Kind
    at_s: float
    cell: Cell


class Fleet:
    """So many cells in so many days, with more to do than they can."""

    def __init__(self, kinds: Sequence[Kind], cells: int, assumed: Assumed, seed: int, slots: int) -> None:
        self.kinds, self.assumed, self.slots, self.rng = kinds, assumed, slots, random.Random(seed)
        self.now = simpy.Environment()
        self.persons = simpy.Resource(self.now, max(1, round(cells / assumed.cells_a_person)))
        self.persons_s = 0.0
        self.cells = [Cell(number % len(KITS)) for number in range(cells)]
        self.waits_s: list[float] = []
        self.taken_over = 0
        self.now.process(self._submits())
        for cell in self.cells:
            self.now.process(self._works(cell))

    def totals(self) -> tuple[Counter[str], int, int]:
        """What the cells' time went into until now, their good samples, and their jobs."""
        spent_s = Counter[str]()
        for cell in self.cells:
            spent_s.update(cell.spent_s)
        return spent_s, sum(cell.good for cell in self.cells), sum(cell.jobs for cell in self.cells)

    def _submits(self) -> Generator[simpy.Event, Any, None]:
        mean_s = statistics.mean(kind.forecast_s for kind in self.kinds)
        while True:
            before_s = sum(cell.ahead_s for cell in self.cells)
            for _ in range(round((AHEAD_DAYS * DAY_S * len(self.cells) - before_s) / mean_s)):
                self._submit(self.rng.choice(self.kinds))
            yield self.now.timeout(DAY_S)

    def _submit(self, kind: Kind) -> None:
        able = [cell for cell in self.cells if kind.able[cell.kit]]
        cell = min(able, key=lambda one: one.ahead_s)
        cell.queue.append(Job(kind, self.now.now, cell))
        cell.ahead_s += kind.forecast_s

    def _next(self, cell: Cell) -> Job | None:
        if cell.queue:
            return cell.queue.popleft()
        able = (other for other in self.cells if other.queue and other.queue[0].kind.able[cell.kit])
        if (other := min(able, key=lambda one: one.queue[0].at_s, default=None)) is None:
            return None
        self.taken_over += 1
        return other.queue.popleft()

    def _works(self, cell: Cell) -> Generator[simpy.Event, Any, None]:
        while True:
            if not cell.queue:
                yield from self._spend(cell, "no job", LOOK_S * IDLE_LOOKS)
            if (job := self._next(cell)) is None:
                continue
            self.waits_s.append(self.now.now - job.at_s)
            kind, run = job.kind, self.rng.choice(job.kind.runs)
            if self._lacks(cell, kind, run):
                yield from self._person(cell, "set up", self.assumed.set_up_s)
                cell.lots, cell.left_mg, cell.slots_used = kind.lots, dict(kind.amounts_mg), 0
            cell.slots_used += min(kind.samples, self.slots)
            yield from self._run(cell, run)
            job.cell.ahead_s -= kind.forecast_s
            cell.left_mg = {name: mass_mg - run.used_mg.get(name, 0.0) for name, mass_mg in cell.left_mg.items()}
            cell.good, cell.jobs = cell.good + run.good, cell.jobs + 1

    def _lacks(self, cell: Cell, kind: Kind, run: DryRun) -> bool:
        is_short = any(cell.left_mg.get(name, 0.0) < 1.1 * mass_mg for name, mass_mg in run.used_mg.items())
        return cell.lots != kind.lots or is_short or cell.slots_used + kind.samples > self.slots

    def _run(self, cell: Cell, run: DryRun) -> Generator[simpy.Event, Any, None]:
        """A dry run's time, held up where it needs a person, or a device fails. What a person then does is in it."""
        at_s, stops = 0.0, [(when_s, "person", 0.0) for when_s in run.persons_s]
        fault_s = self.rng.expovariate(1.0 / (self.assumed.fault_every_h * 3600))
        if fault_s < run.duration_s or run.stopped:
            repair_s = self.rng.expovariate(1.0 / self.assumed.repair_s)
            stops.append((min(fault_s, run.duration_s), "fault", repair_s))
        for when_s, why, takes_s in sorted(stops):
            yield from self._spend(cell, "runs", when_s - at_s)
            yield from self._person(cell, why, takes_s)
            at_s = when_s
        yield from self._spend(cell, "runs", run.duration_s - at_s)

    def _person(self, cell: Cell, why: str, takes_s: float) -> Generator[simpy.Event, Any, None]:
        """Until one is there and has done it; what is begun in a shift is ended after it."""
        began_s = self.now.now
        with self.persons.request() as free:
            yield free
            first_s, last_s = (hour * 3600 for hour in self.assumed.shift_h)
            of_day_s = (BEGINS_S + self.now.now) % DAY_S
            if not first_s <= of_day_s < last_s:
                yield self.now.timeout((first_s - of_day_s) % DAY_S)
            yield self.now.timeout(self.assumed.walk_s + takes_s)
            self.persons_s += self.assumed.walk_s + takes_s
        cell.spent_s[why] += self.now.now - began_s

    def _spend(self, cell: Cell, on: str, seconds: float) -> Generator[simpy.Event, Any, None]:
        yield self.now.timeout(seconds)
        cell.spent_s[on] += seconds


def simulate(
    kinds: Sequence[Kind], cells: int, assumed: Assumed, *, days: int, seed: int, slots: int
) -> dict[str, Any]:
    """A fleet's figures for each day, after a first one that does not count."""
    fleet = Fleet(kinds, cells, assumed, seed, slots)
    fleet.now.run(DAY_S)
    spent_s, good, jobs = fleet.totals()
    fleet.now.run(DAY_S * (1 + days))
    after_s, good_after, jobs_after = fleet.totals()
    after_s.subtract(spent_s)
    shares = {name: after_s[name] / after_s.total() for name in SHARES}
    on_shift_s = (days + 1) * (assumed.shift_h[1] - assumed.shift_h[0]) * 3600 * fleet.persons.capacity
    return {
        "samples_a_day": (good_after - good) / days,
        "jobs_a_day": (jobs_after - jobs) / days,
        "shares": shares,
        "persons_busy": fleet.persons_s / on_shift_s,
        "wait_h": statistics.median(fleet.waits_s) / 3600,
        "taken_over": fleet.taken_over / len(fleet.waits_s),
    }
