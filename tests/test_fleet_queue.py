"""The queue in its database: who gets which job, what is known of stations, and a database that is no such."""

import asyncio
import socket
import subprocess

import pytest
from conftest import Call
from fleet_bench import but, enrolled, run
from procrastinate.jobs import Status

from harness.postgres import Server
from scuhand_bt.fleet.database import ANSWER_S
from scuhand_bt.fleet.needs import Offer
from scuhand_bt.fleet.order import Submission
from scuhand_bt.fleet.queue import ENDED, open_queue

pytestmark = pytest.mark.xdist_group("postgres")


def test_a_station_has_one_job_at_a_time_in_the_order_of_their_coming(
    database: str, order: Submission, offer: Offer
) -> None:
    async def check() -> None:
        async with enrolled(database, offer, "one", "two") as queue:
            here = but(order, stations=("one",))
            orders = [but(here, key=key) for key in ("first", "second")]
            first, second = await queue.submit(orders)
            assert await queue.files(orders[0].order) == order.files
            taken = await queue.take("one")
            assert taken is not None
            assert (taken.id, taken.order) == (first, orders[0].order)
            assert await queue.take("one") is None, "it has one"
            assert await queue.take("two") is None, "and these are not for it"
            assert (again := await queue.taken("one")) is not None
            assert again.id == first
            await queue.finish(first, Status.SUCCEEDED)
            assert (after := await queue.take("one")) is not None
            assert after.id == second

    run(check())


def test_an_idle_station_takes_over_the_oldest_job_that_it_can_do_and_none_that_is_run(
    database: str, order: Submission, offer: Offer
) -> None:
    async def check() -> None:
        async with enrolled(database, offer, "one", "two", "three") as queue:
            both = but(order, stations=("one", "two"))
            numbers = await queue.submit([but(both, key=key) for key in "abc"])
            assert await queue.take("one") is not None
            assert not await queue.take_over("three")
            assert await queue.take_over("two")
            assert (taken := await queue.take("two")) is not None
            assert taken.id == numbers[1]
            assert {job.id: job.station for job in await queue.jobs(every=False, limit=9)} == {
                numbers[0]: "one",
                numbers[1]: "two",
                numbers[2]: "one",
            }

    run(check())


def test_what_stations_say_of_themselves_is_seen_with_what_is_before_them(
    database: str, order: Submission, offer: Offer
) -> None:
    async def check() -> None:
        async with enrolled(database, offer, "one", "two") as queue:
            assert not await queue.enrol("one", "another lab's", offer), "its name is taken"
            here = but(order, stations=("one",), duration_s=70.0)
            numbers = await queue.submit([but(here, key=key) for key in "ab"])
            await queue.tell("one", "dreams")
            one, two = await queue.stations()
            assert (one.state, one.jobs, one.ahead_s, one.offer, one.is_there) == ("dreams", 2, 140.0, offer, True)
            assert (two.jobs, two.ahead_s) == (0, 0.0)
            assert not await queue.forget("one"), "it has jobs"
            assert [await queue.cancel(number) for number in numbers] == [True, True]
            assert not await queue.cancel(numbers[0]), "it is over"
            assert await queue.take("one") is None
            assert not await queue.forget("one"), "it is there"
            await queue.tell("one", ENDED)
            assert await queue.forget("one")
            assert [station.name for station in await queue.stations()] == ["two"]

    run(check())


def test_two_programs_may_make_the_tables_at_once_and_later_ones_find_them(database: str) -> None:
    async def look() -> None:
        async with open_queue(database) as queue:
            assert await queue.stations() == []

    async def check() -> None:
        await asyncio.gather(look(), look(), look())
        await look()

    run(check())


BEFORE = """
DROP TRIGGER scuhand_lock ON procrastinate_jobs; DROP FUNCTION scuhand_lock; DROP INDEX scuhand_open_jobs;
CREATE INDEX scuhand_jobs_of_station ON procrastinate_jobs (lock, status, priority, id);
UPDATE procrastinate_jobs SET lock = queue_name;
"""
"""To a database as the versions before had it, in which a job had its station's lock while it waited, too."""


def test_jobs_of_an_earlier_version_are_taken_in_their_order_and_the_one_that_runs_holds_back_the_others(
    database: str, order: Submission, offer: Offer
) -> None:
    async def check() -> None:
        async with enrolled(database, offer, "one") as queue:
            here = but(order, stations=("one",))
            numbers = await queue.submit([but(here, key=key) for key in "abc"])
            assert await queue.take("one") is not None
        subprocess.run(["psql", "-X", "-q", database, "-c", BEFORE], check=True, capture_output=True)
        async with open_queue(database) as queue:
            assert (taken := await queue.taken("one")) is not None
            assert taken.id == numbers[0]
            assert await queue.take("one") is None, "it has one"
            assert [station.jobs for station in await queue.stations()] == [3]
            for number, following in zip(numbers, [*numbers[1:], None], strict=True):
                await queue.finish(number, Status.SUCCEEDED)
                after = await queue.take("one")
                assert (after and after.id) == following

    run(check())


def test_a_database_that_cannot_keep_any_letter_is_told_and_a_users_own_letters_do_not_count(
    postgres: Server, database: str, offer: Offer, command: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As Debian makes it where no language is set; each command ended with a traceback."""
    ascii_only = "CREATE DATABASE letters ENCODING 'SQL_ASCII' LOCALE 'C' TEMPLATE template0"
    subprocess.run(["psql", "-X", "-q", postgres.address(), "-c", ascii_only], check=True, capture_output=True)
    code, _, err = command("queue", "--database", postgres.address("letters"))
    assert code == 2
    assert "it keeps texts as SQL_ASCII" in err
    assert "createdb's --encoding=UTF8" in err
    monkeypatch.setenv("PGCLIENTENCODING", "LATIN1")

    async def check() -> None:
        async with enrolled(database, offer, "局") as queue:
            assert [one.name for one in await queue.stations()] == ["局"]

    run(check())


def test_a_network_that_is_silent_is_no_database_within_seconds(database: str) -> None:
    """A station stood still until the network was back, or for a quarter of an hour, and no SIGTERM ended it."""

    async def check() -> None:
        async with open_queue(database) as queue, queue._database.pool.connection() as connection:
            with socket.fromfd(connection.fileno(), socket.AF_INET, socket.SOCK_STREAM) as line:
                assert line.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT) == ANSWER_S * 1000
                assert line.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE) == 1
                assert line.getsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE) == ANSWER_S

    run(check())


def test_a_database_that_is_not_there_is_said_with_where_and_what_to_read(command: Call) -> None:
    for words in (["queue"], ["fleet"], ["cancel", 1], ["station", "--dry-run"]):
        code, _, err = command(*words, "--database", "host=127.0.0.1 port=1")
        assert code == 2
        assert "the queue's database (host=127.0.0.1 port=1)" in err
        assert "Connection refused" in err
        assert err.strip().endswith("docs/fleet.md sets it up")
    for database in ("postgresql://me:sesame@127.0.0.1:1/q", "host=127.0.0.1 port=1 dbname=q user=me password=sesame"):
        err = command("queue", "--database", database).stderr
        assert "sesame" not in err
        assert all(part in err for part in ("user=me", "dbname=q", "host=127.0.0.1", "port=1"))


@pytest.mark.parametrize(
    ("database", "what"),
    [
        ("host=db pasword=sesame", "no connection string of libpq's"),
        ("sesame", "no connection string of libpq's"),
        ("postgresql://me:sesame@[::1/q", "no connection string of libpq's"),
        ("postgresql://me:ses/ame@db/q", "write '/' as %2F there"),  # libpq reads a port "ses"
        ("postgresql://me:x@sesame@db/q", "'@' as %40"),  # and here a host "sesame@db"
        ("postgresql://127.0.0.1:1/q?sslpassword=sesame", "Connection refused"),
    ],
)
def test_a_database_that_is_named_wrongly_is_said_without_any_part_of_its_password(
    database: str, what: str, command: Call
) -> None:
    code, _, err = command("queue", "--database", database)
    assert code == 2
    assert what in err
    assert not any(part in err for part in ("sesame", "ses/", "ame@"))
