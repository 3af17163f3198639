"""The queue's database: its tables, and a line to it that notices when nobody answers.

Beside procrastinate's tables stand what each station says of itself, and the recipes of the jobs.
"""

import logging
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import psycopg
from procrastinate import App, PsycopgConnector
from procrastinate.schema import SchemaManager
from psycopg.conninfo import conninfo_to_dict, make_conninfo

from scuhand_bt.problems import Mark, Problem, SourceError

CONNECT_S = 5
ANSWER_S = 10
"""A database that has not heard of what it was sent for so long is not reached."""
_LINE: dict[str, Any] = {
    "client_encoding": "UTF8",
    "connect_timeout": CONNECT_S,
    "tcp_user_timeout": ANSWER_S * 1000,
    "keepalives_idle": ANSWER_S,
    "keepalives_interval": ANSWER_S,
    "keepalives_count": 1,
}
"""Else a network that is silent is waited for a quarter of an hour, and nothing else is done meanwhile; and names are
sent as the user's environment has it, which may have no word for them."""
_STATIONS = """
CREATE TABLE scuhand_stations (
    name text PRIMARY KEY, identity text NOT NULL, offer jsonb NOT NULL, state text NOT NULL,
    seen timestamptz NOT NULL DEFAULT now());
CREATE TABLE scuhand_recipes (hash text PRIMARY KEY, files jsonb NOT NULL);
"""
_LOCKED_WHEN_TAKEN = """
CREATE FUNCTION scuhand_lock() RETURNS trigger LANGUAGE plpgsql
    AS $$ BEGIN NEW.lock := NEW.queue_name; RETURN NEW; END $$;
CREATE TRIGGER scuhand_lock BEFORE UPDATE OF status ON procrastinate_jobs
    FOR EACH ROW WHEN (NEW.status = 'doing') EXECUTE FUNCTION scuhand_lock();
UPDATE procrastinate_jobs SET lock = NULL WHERE status = 'todo';
DROP INDEX IF EXISTS scuhand_jobs_of_station;
CREATE INDEX scuhand_open_jobs ON procrastinate_jobs (queue_name, priority DESC, id) WHERE status IN ('todo', 'doing');
"""
"""Also for a database that an earlier version has made."""


@asynccontextmanager
async def opened(database: str) -> AsyncIterator[App]:
    """procrastinate in a database (a libpq connection string; "" for what PGSERVICE, PGHOST and so on say).

    The queue's tables are made if there are none. SourceError where it cannot be reached or used.
    """
    _require_plain(database)
    where = Mark(f"the queue's database ({_shown(database) or 'by PGSERVICE, PGHOST …'})", 0)
    logging.getLogger("psycopg.pool").setLevel(logging.CRITICAL)  # what it says, the station says in words
    try:
        async with await psycopg.AsyncConnection.connect(database, **_LINE) as connection:
            if (kept_as := connection.info.parameter_status("server_encoding")) != "UTF8":
                what = f"it keeps texts as {kept_as}, and names may have any letters: make it anew with createdb's"
                raise SourceError([Problem(where, f"{what} --encoding=UTF8, as docs/fleet.md does")])
            await _make_tables(connection)
    except psycopg.Error as error:
        what = " ".join(str(error).split()) or type(error).__name__
        raise SourceError([Problem(where, f"{what}; docs/fleet.md sets it up")]) from None
    connector = PsycopgConnector(
        conninfo=database,
        min_size=1,
        max_size=1,
        kwargs=_LINE,
        configure=_planning_anew,
        timeout=CONNECT_S,
        reconnect_timeout=1.0,  # the next question tries again
    )
    app = App(connector=connector)
    async with app.open_async():
        yield app


def _shown(database: str) -> str:
    """A connection string as it may be told: without a password."""
    said = conninfo_to_dict(database)
    secret = [said.pop(name, None) for name in ("password", "sslpassword")]
    return make_conninfo("", **said) if any(secret) else database


def _require_plain(database: str) -> None:
    """SourceError for what libpq does not read as it was meant; it would tell a part of the password as the host."""
    where = Mark("--database", 0)
    try:
        conninfo_to_dict(database)
    except psycopg.Error:  # whose message has the part that is wrong
        what = (
            "this is no connection string of libpq's: such as postgresql://USER@HOST/NAME, or 'host=HOST dbname=NAME'"
        )
        raise SourceError([Problem(where, f"{what}, with the password in ~/.pgpass")]) from None
    scheme, _, address = database.partition("://")
    person, _, _ = address.rpartition("@")
    if scheme in ("postgresql", "postgres") and any(sign in person for sign in "/@"):
        what = "before the last '@' of an address stand a user and a password: write '/' as %2F there, and '@' as %40"
        raise SourceError([Problem(where, what)])


async def _planning_anew(connection: "psycopg.AsyncConnection[Any]") -> None:
    """A plan that is kept for whichever station looks through the jobs of all of them for this one's."""
    await connection.execute("SET plan_cache_mode = force_custom_plan")
    await connection.commit()


async def _make_tables(connection: "psycopg.AsyncConnection[Any]") -> None:
    async def is_there(table: str) -> bool:
        row = await (await connection.execute("SELECT to_regclass(%s)", (table,))).fetchone()
        return row is not None and row[0] is not None

    if not await is_there("scuhand_open_jobs"):
        await connection.execute("SELECT pg_advisory_xact_lock(hashtext('scuhand-bt'))")  # who is first makes them
        if not await is_there("procrastinate_jobs"):
            await connection.execute(SchemaManager.get_schema())
        if not await is_there("scuhand_stations"):
            await connection.execute(_STATIONS)
        if not await is_there("scuhand_open_jobs"):
            await connection.execute(_LOCKED_WHEN_TAKEN)
