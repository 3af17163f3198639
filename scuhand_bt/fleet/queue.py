"""The queue: procrastinate's jobs in a PostgreSQL database, and beside them what each station says of itself.

One job is one run. Its queue is its station's name, and so is its lock once it is taken: a station has one job at a
time, and none after one that died there until that is settled. A job that waits has no lock: else procrastinate looks
through all that wait for the same one before it gives out the first. A job is never tried again by itself. Times of the
database only.
"""

from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, replace
from datetime import datetime
from typing import Any

from procrastinate import App
from procrastinate.exceptions import UniqueViolation
from procrastinate.jobs import Job, Status
from psycopg.types.json import Jsonb
from pydantic import ValidationError

from scuhand_bt.fleet.database import opened
from scuhand_bt.fleet.needs import Offer, missing
from scuhand_bt.fleet.order import Files, Order, Submission
from scuhand_bt.problems import Mark, Problem, Problems, SourceError

TASK = "scuhand-bt run"
ABSENT_S = 60.0
"""A station that has not been heard of for so long is not there."""
ENDED = "has ended"
"""What a station says last that ends by itself: it is not there from then on."""
HELD_BACK = "has to wait for job"
"""What a station says whose run was interrupted."""
LONGEST_NAME = 128
"""The database takes no longer one for a job's queue."""
LAST = 2**63 - 1
"""The database counts no further."""
_ENROL = """
INSERT INTO scuhand_stations (name, identity, offer, state) VALUES (%(name)s, %(identity)s, %(offer)s, 'begins')
ON CONFLICT (name) DO UPDATE SET offer = excluded.offer, seen = now()
WHERE scuhand_stations.identity = excluded.identity RETURNING name
"""
_KNOWN = """
SELECT name, offer, state, extract(epoch FROM now() - seen)::float AS silent_s,
    count(job.id) AS jobs, coalesce(sum(coalesce(job.args->>'left_s', job.args->>'duration_s')::float), 0) AS ahead_s
FROM scuhand_stations LEFT JOIN procrastinate_jobs AS job ON queue_name = name AND status IN ('todo', 'doing')
GROUP BY name ORDER BY name
"""
_JOBS = """
SELECT job.id, queue_name AS station, status, abort_requested, args,
    CASE WHEN status IN ('todo', 'doing') THEN extract(epoch FROM now() - seen)::float END AS silent_s,
    (SELECT min(at) FROM procrastinate_events WHERE job_id = job.id) AS at
FROM (
    (SELECT * FROM procrastinate_jobs WHERE status = 'doing' ORDER BY id DESC LIMIT %(limit)s) UNION ALL
    (SELECT * FROM procrastinate_jobs WHERE status = 'todo' OR %(every)s AND status <> 'doing'
     ORDER BY id DESC LIMIT %(limit)s)) AS job LEFT JOIN scuhand_stations ON name = queue_name
ORDER BY status = 'doing' DESC, job.id DESC LIMIT %(limit)s
"""
"""In two parts, each by an index of its own: not all that wait are sorted for the few that are shown."""
_TAKE_OVER = """
UPDATE procrastinate_jobs SET queue_name = %(name)s WHERE id = (
    SELECT id FROM procrastinate_jobs WHERE status = 'todo' AND args->'stations' ? %(name)s
    ORDER BY priority DESC, id LIMIT 1 FOR UPDATE SKIP LOCKED) RETURNING id
"""
_PASS_ON = """
UPDATE procrastinate_jobs SET status = 'todo', lock = NULL, queue_name = %(first)s, args = args || %(news)s
WHERE id = %(number)s AND status = 'doing'
"""


@dataclass(frozen=True)
class KnownStation:
    """A station as it was last heard of, and what it has before it."""

    name: str
    offer: Offer | None
    """None for one of another version."""
    state: str
    silent_s: float
    jobs: int
    ahead_s: float
    """Forecast duration of its jobs; of one that is run, what is left of it."""

    @property
    def is_there(self) -> bool:
        return self.silent_s <= ABSENT_S and not self.has_ended

    @property
    def has_ended(self) -> bool:
        """By itself, and has said so."""
        return self.state.startswith(ENDED)


@dataclass(frozen=True)
class QueuedJob:
    """A job as a person looks at it."""

    id: int
    station: str
    status: str
    is_to_stop: bool
    recipe: str
    by: str
    simulated: bool
    run: str
    """The run's id at its station, once it has begun."""
    said: str
    """What it came to, or what its station says of it."""
    left_s: float | None
    """Of one whose run goes on, as its station last said."""
    silent_s: float | None
    """How long nothing was heard of its station; None for one that is over."""
    at: datetime

    @property
    def is_forsaken(self) -> bool:
        """Its station is not there: what was said of it may not be so any more."""
        return self.silent_s is not None and self.silent_s > ABSENT_S


@dataclass(frozen=True)
class Taken:
    """A job that a station has taken."""

    job: Job
    order: Order | None
    """None for one that another version has written."""

    @property
    def id(self) -> int:
        assert self.job.id is not None
        return self.job.id

    @property
    def run(self) -> str:
        """The run's id, once its station has told of it; "" until then."""
        return str(self.job.task_kwargs.get("run", ""))


def choose(submitted: Sequence[Submission], known: Sequence[KnownStation], only: str | None = None) -> list[Submission]:
    """For each the stations that can do it, first the one with the least before it.

    A station that is not there comes last. SourceError, with what is missing at which, where none can.
    """
    stations = [station for station in known if only in (None, station.name)]
    if not stations:
        names, none = [station.name for station in known], Problems()
        mark, what = ("--database", "") if only is None else ("--station", f" '{only}'")
        begin = "" if names else "`scuhand-bt station` at a cell begins one"
        none.add(Mark(mark, 0), f"there is no station{what}", begin, unknown=only or "", known=names)
        none.raise_any()
    ahead_s = {station.name: station.ahead_s for station in stations}
    chosen, problems = [], []
    for one in submitted:
        order, lacks = one.order, {station.name: _lacks(station, one) for station in stations}
        able = [station for station in stations if not lacks[station.name]]
        if not able:
            whys = [f"at {name} {'; '.join(lack)}" for name, lack in lacks.items()]
            problems.append(Problem(Mark(str(one.path), 0), f"no station can do it: {'; '.join(whys)}"))
            continue
        able.sort(key=lambda station: (not station.is_there, ahead_s[station.name], station.name))
        ahead_s[able[0].name] += order.duration_s
        order = order.model_copy(update={"stations": tuple(station.name for station in able)})
        chosen.append(replace(one, order=order))
    if problems:
        raise SourceError(problems)
    return chosen


def _lacks(station: KnownStation, one: Submission) -> list[str]:
    if station.offer is None:
        return ["another version of scuhand-bt works"]
    return missing(one.needs, station.offer)


class Queue:
    """An open queue. Its methods raise procrastinate's ConnectorException where the database is not reached."""

    def __init__(self, app: App) -> None:
        self._jobs, self._database = app.job_manager, app.connector

    # --- who submits, and who looks

    async def submit(self, submitted: Sequence[Submission]) -> list[int]:
        """A job for each, for the first of its stations, all of them or none; their numbers."""
        for files, text in {one.order.files: Jsonb(one.files) for one in submitted}.items():
            query = "INSERT INTO scuhand_recipes VALUES (%(hash)s, %(files)s) ON CONFLICT DO NOTHING"
            await self._database.execute_query_async(query, hash=files, files=text)
        jobs = [
            Job(
                queue=order.stations[0],
                lock=None,
                queueing_lock=order.key,
                task_name=TASK,
                task_kwargs=order.model_dump(mode="json"),
            )
            for order in (one.order for one in submitted)
        ]
        return [job.id or 0 for job in await self._jobs.batch_defer_jobs_async(jobs)]

    async def stations(self) -> list[KnownStation]:
        """All that were ever heard of."""
        rows = await self._database.execute_query_all_async(_KNOWN)
        return [KnownStation(**{**row, "offer": _offered(row["offer"])}) for row in rows]

    async def jobs(self, *, every: bool, limit: int) -> list[QueuedJob]:
        """Those that wait or are run, or also those that are over; first what is run, and the newest."""
        rows = await self._database.execute_query_all_async(_JOBS, every=every, limit=limit)
        return [_looked_at(row) for row in rows]

    async def cancel(self, number: int) -> bool:
        """A job that waits is not run, one that is run is to stop; False for one that is over, or was never there."""
        return abs(number) <= LAST and await self._jobs.cancel_job_by_id_async(number, abort=True)

    async def at_work_on(self, number: int) -> KnownStation | None:
        """The station that has taken a job and not settled it; None for one that waits, or is over."""
        query = "SELECT queue_name FROM procrastinate_jobs WHERE id = %(number)s AND status = 'doing'"
        rows = await self._database.execute_query_all_async(query, number=number)
        names = {row["queue_name"] for row in rows}
        return next((station for station in await self.stations() if station.name in names), None)

    async def forget(self, name: str) -> bool:
        """A station that is no more; False for one that is there or has jobs, or was never there."""
        absent = any(station.name == name and not station.is_there for station in await self.stations())
        query = """DELETE FROM scuhand_stations WHERE name = %(name)s AND NOT EXISTS (
            SELECT FROM procrastinate_jobs WHERE queue_name = name AND status IN ('todo', 'doing')) RETURNING name"""
        return absent and bool(await self._database.execute_query_all_async(query, name=name))

    # --- a station

    async def other_names(self, name: str, identity: str) -> list[str]:
        """Under which this station has jobs beside its name of now."""
        query = """SELECT name FROM scuhand_stations WHERE identity = %(identity)s AND name <> %(name)s AND EXISTS (
            SELECT FROM procrastinate_jobs WHERE queue_name = name AND status IN ('todo', 'doing')) ORDER BY name"""
        rows = await self._database.execute_query_all_async(query, name=name, identity=identity)
        return [row["name"] for row in rows]

    async def enrol(self, name: str, identity: str, offer: Offer) -> bool:
        """What this station has now; False where another one has its name."""
        named = {"name": name, "identity": identity, "offer": Jsonb(offer.model_dump(mode="json"))}
        return bool(await self._database.execute_query_all_async(_ENROL, **named))

    async def tell(self, name: str, state: str) -> None:
        """That a station is there, and what it does."""
        query = "UPDATE scuhand_stations SET state = %(state)s, seen = now() WHERE name = %(name)s"
        await self._database.execute_query_async(query, name=name, state=state)

    async def taken(self, name: str) -> Taken | None:
        """The job that this station has taken, and that is not settled."""
        query = "SELECT * FROM procrastinate_jobs WHERE lock = %(name)s AND status = 'doing'"
        rows = await self._database.execute_query_all_async(query, name=name)
        return _taken(Job.from_row(rows[0])) if rows else None

    async def take(self, name: str) -> Taken | None:
        """The next job of this station, which is its own from now on; None where none waits, or one is not settled."""
        try:
            # A station is no worker that is pruned.
            job = await self._jobs.fetch_job([name], None)  # type: ignore[arg-type]
        except UniqueViolation:
            return None
        return _taken(job) if job is not None else None

    async def files(self, order: Order) -> Files:
        """The recipe of an order, with its tables."""
        query = "SELECT files FROM scuhand_recipes WHERE hash = %(hash)s"
        files: Files = (await self._database.execute_query_one_async(query, hash=order.files))["files"]
        return files

    async def take_over(self, name: str) -> bool:
        """Whether there was a job that waits at another station, and that this one can do; it waits here now."""
        return bool(await self._database.execute_query_all_async(_TAKE_OVER, name=name))

    async def note(self, number: int, news: Mapping[str, str | float | None]) -> None:
        """What a job's `run` is, what there is to be `said` of it, and how much of it is left (`left_s`).

        That is None where it cannot be told, as nobody is at it.
        """
        query = "UPDATE procrastinate_jobs SET args = args || %(news)s WHERE id = %(number)s"
        await self._database.execute_query_async(query, number=number, news=Jsonb(dict(news)))

    async def pass_on(self, number: int, stations: Sequence[str], said: str) -> None:
        """A job that did not begin where it was taken waits for these stations, at the first of them."""
        news = Jsonb({"stations": list(stations), "said": said})
        await self._database.execute_query_async(_PASS_ON, number=number, first=stations[0], news=news)

    async def finish(self, number: int, status: Status) -> None:
        """A job is over."""
        await self._jobs.finish_job_by_id_async(number, status, delete_job=False)


@asynccontextmanager
async def open_queue(database: str) -> AsyncIterator[Queue]:
    """The queue in a database (a libpq connection string; "" for what PGSERVICE, PGHOST and so on say).

    Its tables are made if there are none. SourceError where it cannot be reached or used.
    """
    async with opened(database) as app:
        yield Queue(app)


def _offered(written: dict[str, Any]) -> Offer | None:
    try:
        return Offer.model_validate(written)
    except ValidationError:
        return None


def _taken(job: Job) -> Taken:
    try:
        return Taken(job, Order.model_validate(job.task_kwargs))
    except ValidationError:
        return Taken(job, None)


def _looked_at(row: dict[str, Any]) -> QueuedJob:
    args = row["args"]
    return QueuedJob(
        id=row["id"],
        station=row["station"],
        status=row["status"],
        is_to_stop=row["abort_requested"] and row["status"] == "doing",
        recipe=args.get("recipe", ""),
        by=args.get("by", ""),
        simulated=args.get("simulated", False),
        run=args.get("run", ""),
        said=args.get("said", ""),
        left_s=args.get("left_s") if row["status"] == "doing" else None,
        silent_s=row["silent_s"],
        at=row["at"],
    )
