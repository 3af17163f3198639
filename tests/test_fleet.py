"""Several cells on one queue: who can do what, a job is one run, and whatever dies, nothing is done twice."""

import asyncio
import base64
import json
import os
import re
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine, Iterator
from contextlib import asynccontextmanager, closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from conftest import REPOSITORY, Call, LabFolder
from procrastinate.jobs import Status
from running import make_lab

from harness.fleet import chaos
from harness.postgres import Server, server, tools
from scuhand_bt.events.entry import Event
from scuhand_bt.fleet.database import ANSWER_S
from scuhand_bt.fleet.needs import Offer, missing, needs_of, offer_of
from scuhand_bt.fleet.order import Submission, submission_of, write
from scuhand_bt.fleet.queue import ENDED, HELD_BACK, KnownStation, Queue, QueuedJob, Taken, choose, open_queue
from scuhand_bt.fleet.station import Manner, Station
from scuhand_bt.journal.events import Answered, Asked
from scuhand_bt.journal.presence import Presence
from scuhand_bt.journal.reader import read
from scuhand_bt.journal.results import SampleResult
from scuhand_bt.journal.run_events import Continued, Ended, Paused, RunBegun
from scuhand_bt.journal.writer import Journal
from scuhand_bt.lab import Lab, load_lab
from scuhand_bt.lab_state.inventory import Inventory, StockEntry
from scuhand_bt.lab_state.persons import Persons
from scuhand_bt.problems import SourceError
from scuhand_bt.recipe.plan import Plan, make_plan
from scuhand_bt.recipe.recipe import load_recipe
from tests.test_journal import HEADER, RESULT

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


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> Plan:
    return plan_of(make_lab(tmp_path_factory.mktemp("lab")))


@pytest.fixture
def order(plan: Plan) -> Submission:
    return submission_of(plan, simulated=True)


def but(one: Submission, **changes: Any) -> Submission:
    """The same, with another order."""
    return replace(one, order=one.order.model_copy(update=changes))


def job_for(lab: Path, *stations: str) -> Submission:
    """A simulated run of a lab's own recipe, for these."""
    return but(submission_of(plan_of(lab), simulated=True), stations=stations)


@pytest.fixture(scope="module")
def offer(starter: Lab) -> Offer:
    return offer_of(starter, simulated=True, unattended=False)


# --- who can do it


def test_a_station_with_all_that_a_recipe_names_lacks_nothing(plan: Plan, offer: Offer) -> None:
    assert missing(needs_of(plan, simulated=True), offer) == []


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"simulated": False}, "it is a real one, and simulated devices are asked for"),
        ({"maximum_mg": 100.0}, "its balance's maximum is 100.0 mg, and "),
        (
            {"least_tolerance_mg": 2.5},
            "the narrowest tolerance that its balance can tell is 2.5 mg, and the recipe's is 2",
        ),
        ({"lots": {"mortar_bay": "glass_beads/GB-0"}}, "its mortar_bay holds glass_beads/GB-0, not glass_beads/GB-1"),
        ({"powder": ()}, "it has no powder 'glass_beads'"),
        ({"container": ()}, "it has no container 'xrd_holder'"),
        ({"mortar": ()}, "it has no mortar 'agate_mortar'"),
        ({"workflow": ("finish_batch",)}, "it has no workflow 'fill_xrd_holder'"),
        ({"mortar station": ("mortar_bay_2",)}, "it has no mortar station 'mortar_bay'"),
        ({"slots": {"alumina_crucible": 9}}, "its changer has no slot for 'xrd_holder'"),
        ({"unattended": True, "slots": {}}, "it is unattended, and a person changes its containers"),
        (
            {"unattended": True, "slots": {"": 1}},
            "it is unattended, and its changer has slots for 1 of the 2 containers",
        ),
        (
            {"unattended": True, "slots": {"xrd_holder": 1}},
            "it is unattended, and its changer has slots for 'xrd_holder' for 1 of the 2 containers",
        ),
    ],
)
def test_what_a_station_lacks_is_said(plan: Plan, offer: Offer, changes: dict[str, Any], words: str) -> None:
    names = {**offer.names, **{key: value for key, value in changes.items() if key in offer.names}}
    others = {key: value for key, value in changes.items() if key not in offer.names}
    (lack,) = missing(needs_of(plan, simulated=True), offer.model_copy(update={"names": names, **others}))
    assert lack.startswith(words)


def test_a_check_weight_has_to_be_within_a_station_s_maximum(lab_folder: LabFolder, offer: Offer) -> None:
    text = "recipe: start\nworkflow: start_of_day\nsamples: [{id: check, weight: 20 g}]\n"
    needs = needs_of(plan_of(lab_folder.folder, "start.yaml", text), simulated=True)
    (lack,) = missing(needs, offer.model_copy(update={"maximum_mg": 10_000.0}))
    assert lack == "its balance's maximum is 10.0000 g, and 20.0000 g would stand on it"


def test_a_station_lacks_the_vessel_for_leftovers_or_it_holds_another_lot(plan: Plan, offer: Offer) -> None:
    beads = plan.recipe.sources["beads"].model_copy(update={"leftover": "discard", "leftover_to": "jar"})
    spare = beads.model_copy(update={"name": "spare", "station": "mortar_bay_2", "lot": "GB-2"})  # nobody takes from it
    demands = (replace(plan.demands[0], source=beads), replace(plan.demands[0], source=spare, samples=0))
    needs = needs_of(replace(plan, demands=demands), simulated=True)
    assert missing(needs, offer) == ["it has no vessel 'jar'"]
    has_jar = offer.model_copy(update={"names": {**offer.names, "vessel": ("waste", "jar")}})
    assert missing(needs, has_jar) == []
    others = has_jar.model_copy(update={"lots": {"jar": "glass_beads/GB-0"}})
    assert missing(needs, others) == ["its jar holds glass_beads/GB-0, not glass_beads/GB-1"]


@pytest.mark.parametrize("changes", [{"slots": {}}, {"slots": {"": 1}}, {"unattended": True, "slots": {"": 2}}])
def test_a_changer_that_a_person_sees_to_or_that_holds_all_lacks_nothing(
    plan: Plan, offer: Offer, changes: dict[str, Any]
) -> None:
    assert missing(needs_of(plan, simulated=True), offer.model_copy(update=changes)) == []


@pytest.mark.parametrize(
    ("changer", "slots"),
    [
        ("driver: carousel, slots: 24", {"": 24}),
        ("driver: carousel, slots: {xrd_holder: 3, alumina_crucible: 2}", {"xrd_holder": 3, "alumina_crucible": 2}),
        ("driver: operator", {}),
    ],
)
def test_a_station_offers_the_slots_of_its_changer(lab_folder: LabFolder, changer: str, slots: dict[str, int]) -> None:
    lab_folder.replace("robot/cell.yaml", "driver: carousel, slots: 24", changer)
    assert offer_of(lab_folder.load(), simulated=True, unattended=True).slots == slots


def test_a_station_offers_no_workflow_that_leads_to_what_is_broken(lab_folder: LabFolder) -> None:
    """A job went there, and failed."""
    sound = set(offer_of(lab_folder.load(), simulated=True, unattended=True).names["workflow"])
    lab_folder.write("skills/shake.py", "def x(:")
    lab_folder.write("trees/shaken.yaml", "workflow: shaken\ntree: {sequence: [{shake: {duration: 1 s}}]}\n")
    lab_folder.write("trees/outer.yaml", "workflow: outer\ntree: {optional: {child: {shaken: }}}\n")
    lab_folder.write("trees/wrong.yaml", "workflow: wrong\ntree: {parallel: [{park: }, {tour: }]}\n")
    lab_folder.write("trees/right.yaml", "workflow: right\ntree: {sequence: [{park: }, {tour: }]}\n")
    offered = set(offer_of(lab_folder.load(), simulated=True, unattended=True).names["workflow"])
    assert {"scoop_and_dispense", "clean_up"} <= sound
    assert offered == sound | {"right"}


def test_an_unattended_station_lacks_the_person_that_a_plan_needs(tmp_path: Path, offer: Offer) -> None:
    lab = make_lab(tmp_path / "lab")
    cell = (lab / "robot" / "cell.yaml").read_text().replace("driver: carousel, slots: 24", "driver: operator")
    (lab / "robot" / "cell.yaml").write_text(cell)
    needs = needs_of(plan_of(lab), simulated=True)
    (lack,) = missing(needs, offer.model_copy(update={"unattended": True}))
    assert lack.startswith("it is unattended, and a person is needed at 'a-1'")
    assert missing(needs, offer) == []


def test_a_real_station_offers_the_lots_of_its_inventory_and_a_simulated_one_any(lab_folder: LabFolder) -> None:
    lab = lab_folder.load()
    inventory = Inventory(lab.folder / ".scuhand", lab.cell.cell)
    inventory.enter(StockEntry("station", "mortar_bay", "glass_beads", "GB-7", mass_mg=5000.0))
    inventory.enter(StockEntry("station", "mortar_bay_2", "glass_beads", "GB-8", mass_mg=0.0))
    assert offer_of(lab, simulated=False, unattended=False).lots == {"mortar_bay": "glass_beads/GB-7"}
    assert offer_of(lab, simulated=True, unattended=False).lots == {}


def known(offer: Offer, name: str, ahead_s: float, silent_s: float = 1.0) -> KnownStation:
    return KnownStation(name, offer, "", silent_s, 1, ahead_s)


def test_an_order_goes_where_least_is_before_it_and_to_who_is_not_there_last(order: Submission, offer: Offer) -> None:
    stations = [known(offer, "busy", 5000.0), known(offer, "gone", 0.0, 61.0), known(offer, "idle", 4000.0)]
    (one,) = choose([order], stations)
    assert one.order.stations == ("idle", "busy", "gone")
    many = choose([but(order, duration_s=600.0)] * 4, stations)
    assert [each.order.stations[0] for each in many] == ["idle", "idle", "busy", "idle"], (
        "what goes there counts at once"
    )
    assert choose([order], stations, only="busy")[0].order.stations == ("busy",)


def test_an_order_that_no_station_can_do_says_what_is_missing_where(
    order: Submission, offer: Offer, plan: Plan
) -> None:
    bare = offer.model_copy(update={"names": {**offer.names, "powder": (), "mortar": ()}})
    stations = [known(bare, "bare", 0.0), known(offer.model_copy(update={"simulated": False}), "real", 0.0)]
    with pytest.raises(SourceError) as error:
        choose([order], stations)
    assert str(error.value) == (
        f"{plan.recipe.path}: no station can do it: at bare it has no powder 'glass_beads'; it has no mortar "
        "'agate_mortar'; at real it is a real one, and simulated devices are asked for"
    )


def test_where_there_is_no_station_or_none_of_that_name_it_is_said_what_there_is(
    order: Submission, offer: Offer
) -> None:
    begin = "`scuhand-bt station` at a cell begins one"
    stations = [known(offer, "first", 0.0), known(offer, "second", 0.0)]
    for of, only, said in (
        ([], None, f"--database: there is no station; {begin}"),
        ([], "frist", f"--station: there is no station 'frist'; {begin}"),
        (stations, "frist", "--station: there is no station 'frist'; known: first, second; did you mean 'first'?"),
    ):
        with pytest.raises(SourceError) as error:
            choose([order], of, only)
        assert str(error.value) == said


# --- what an order carries


def test_an_order_carries_the_recipe_and_its_tables_byte_for_byte(tmp_path: Path) -> None:
    lab = make_lab(tmp_path / "lab")
    (lab / "tables").mkdir()
    table = "\ufeffid;mass [mg]\r\nb;30,5\r\n".encode()
    (lab / "tables" / "t.csv").write_bytes(table)
    text = RECIPE.format(count=1).replace("samples: [", "samples: [{table: tables/t.csv}, ")
    made = submission_of(plan_of(lab, text=text), simulated=True)
    write(json.loads(json.dumps(made.files)), tmp_path / "there")
    assert (tmp_path / "there" / "queued.yaml").read_text() == text
    assert (tmp_path / "there" / "tables" / "t.csv").read_bytes() == table


def test_a_recipe_whose_name_no_database_can_keep_is_refused(tmp_path: Path) -> None:
    plan = plan_of(make_lab(tmp_path / "lab"), "b\udcff.yaml")
    with pytest.raises(SourceError, match="is not UTF-8: give it another one"):
        submission_of(plan, simulated=True)


def test_a_table_elsewhere_is_refused_by_who_submits_and_by_who_would_write_it(tmp_path: Path) -> None:
    lab = make_lab(tmp_path / "lab")
    (lab / "t.csv").write_text("id,mass\nb,30 mg\n")
    (lab / "recipes").mkdir()
    text = RECIPE.format(count=1).replace("samples: [", "samples: [{table: ../t.csv}, ")
    plan = plan_of(lab, "recipes/r.yaml", text)
    with pytest.raises(SourceError, match="put the table beside it"):
        submission_of(plan, simulated=True)
    for name in ("../out.csv", "/tmp/out.csv"):
        with pytest.raises(SourceError, match="the recipe's own folder"):
            write({name: ""}, tmp_path / "there")


@pytest.mark.parametrize("table", ["tables/../t.csv", "{lab}/t.csv"])
def test_a_table_that_no_station_would_write_is_refused_before_its_recipe_is_queued(tmp_path: Path, table: str) -> None:
    """It is beside its recipe, but the station's copy would not find it there: the job failed in the night."""
    lab = make_lab(tmp_path / "lab")
    (lab / "tables").mkdir()
    (lab / "t.csv").write_text("id,mass\nb,30 mg\n")
    text = RECIPE.format(count=1).replace("samples: [", f"samples: [{{table: {table.format(lab=lab)}}}, ")
    plan = plan_of(lab, text=text)
    with pytest.raises(SourceError, match=r"queued.yaml:6:\d+: .* from its own folder on"):
        submission_of(plan, simulated=True)


# --- the queue


@pytest.fixture(scope="module")
def postgres() -> Iterator[Server]:
    if tools() is None:
        pytest.skip("no PostgreSQL here: apt install postgresql")
    with server() as made:
        yield made


@pytest.fixture
def database(postgres: Server, request: pytest.FixtureRequest) -> str:
    """A new database for each test."""
    name = f"d{abs(hash(request.node.nodeid))}"
    create = ["psql", "-X", "-q", postgres.address(), "-c", f"CREATE DATABASE {name}"]
    subprocess.run(create, check=True, capture_output=True)
    return postgres.address(name)


@asynccontextmanager
async def enrolled(database: str, offer: Offer, *names: str) -> AsyncIterator[Queue]:
    async with open_queue(database) as queue:
        for name in names:
            assert await queue.enrol(name, f"identity of {name}", offer)
        yield queue


def run(coroutine: Coroutine[Any, Any, None]) -> None:
    asyncio.run(asyncio.wait_for(coroutine, PATIENCE_S))


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


# --- stations, with runs in programs of their own


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


def begun_for(order: Submission) -> RunBegun:
    """The first word of a run that a station has begun, on the cell."""
    path = f"/queue/{order.order.key}/r.yaml"
    header = {**HEADER, "mode": "real devices", "simulated": False, "recipe_path": path, "planned_s": 100.0}
    return RunBegun.model_validate(header)


def all_over(jobs: list[QueuedJob]) -> bool:
    return all(job.status not in ("todo", "doing") for job in jobs)


def journals(lab: Path) -> list[Path]:
    return sorted((lab / ".scuhand" / "runs").glob("*.sqlite"))


def test_jobs_are_run_once_each_and_marked_from_their_journals_and_one_that_cannot_begin_says_why(
    database: str, tmp_path: Path
) -> None:
    lab, said = make_lab(tmp_path / "lab"), list[str]()
    (lab / "output.txt").write_text("id,mass\nb,30 mg\n")  # its name was that of what the run says
    text = RECIPE.format(count=1).replace("samples: [", "samples: [{table: output.txt}, ")
    good, bad = plan_of(lab, text=text), plan_of(lab, "bad.yaml")

    async def check() -> None:
        async with open_queue(database) as queue:
            station = Station(queue, lab, "here", Manner(simulated=True), said.append, look_s=0.1)
            wrong = submission_of(bad, simulated=True)
            wrong = replace(wrong, files={"bad.yaml": base64.b64encode(b"recipe: bad\n").decode()})
            orders = [wrong, submission_of(good, simulated=True, seed=5)]
            await queue.submit([but(order, stations=("here",)) for order in orders])
            first, second = await works(station, queue, all_over)
            assert (first.status, first.run) == ("failed", "")
            assert first.said.startswith("it did not begin: ")
            assert "bad.yaml:1:1: 'samples' is missing" in first.said
            (journal,) = journals(lab)
            assert (second.status, second.run) == ("succeeded", journal.stem)
            assert second.said == "done (2 in tolerance)"
            facts = {row["key"]: row["value"] for row in read(journal, "run")}
            assert (facts["simulated"], facts["seed"]) == ("true", "5")

    run(check())
    assert "job 2: succeeded: done (2 in tolerance)" in said


@pytest.mark.parametrize("simulated", [True, False])
def test_a_station_that_is_a_real_one_now_runs_no_dry_run_that_waits_for_it_and_a_simulated_one_nothing_else(
    database: str, tmp_path: Path, simulated: bool
) -> None:
    """By the name of its cell a station has both: what was queued for a dry run moved the cell."""
    lab = make_lab(tmp_path / "lab")
    order = submission_of(plan_of(lab), simulated=not simulated)

    async def check() -> None:
        async with open_queue(database) as queue:
            station = Station(queue, lab, "here", Manner(simulated, operator="Ada"), print, look_s=0.1)
            await queue.submit([but(order, stations=("here",))])
            (job,) = await works(station, queue, all_over)
            assert (job.status, job.run) == ("failed", "")
            assert job.said == (
                "it did not begin: it is of the cell, and its station is a simulated one now"
                if simulated
                else "it did not begin: it is of simulated devices, and its station is a real one now"
            )

    run(check())
    assert journals(lab) == []


def test_a_job_that_its_station_cannot_do_any_more_goes_to_the_next_one_and_fails_at_the_last(
    database: str, tmp_path: Path
) -> None:
    """An idle station whose powder had gone took over what others could do, job for job, and failed all."""
    labs = {name: make_lab(tmp_path / name) for name in ("first", "second")}
    order = submission_of(plan_of(labs["second"]), simulated=True)
    powders = labs["first"] / "robot" / "powders.yaml"
    powders.write_text(powders.read_text().replace("glass_beads:", "other_beads:"))

    async def check() -> None:
        async with open_queue(database) as queue:
            first, second = (
                Station(queue, lab, name, Manner(simulated=True), print, look_s=0.1) for name, lab in labs.items()
            )
            numbers = await queue.submit(
                [but(order, stations=("first", "second")), but(order, key="b", stations=("first",))]
            )
            passed, failed = await works(first, queue, lambda jobs: jobs[1].status == "failed")
            assert (passed.id, passed.station, passed.status, passed.run) == (numbers[0], "second", "todo", "")
            assert passed.said.startswith("it did not begin at first: ")
            assert "unknown powder 'glass_beads'" in passed.said
            assert failed.said.startswith("it did not begin: ")
            assert not await queue.take_over("first"), "it does not come back"
            done, _ = await works(second, queue, all_over)
            assert (done.status, done.said) == ("succeeded", "done (2 in tolerance)")

    run(check())
    assert [len(journals(lab)) for lab in labs.values()] == [0, 1]


def test_a_program_that_has_not_said_that_it_refuses_sends_its_job_to_no_other_station(
    database: str, tmp_path: Path
) -> None:
    lab = make_lab(tmp_path / "lab")

    async def check() -> None:
        async with open_queue(database) as queue:
            await queue.submit([job_for(lab, "here", "there")])
            station = Station(queue, lab, "here", Manner(simulated=True), print, look_s=0.1)

            def kill_it(jobs: list[QueuedJob]) -> bool:
                if (child := station._child) is not None and child.returncode is None:
                    child.send_signal(signal.SIGKILL)
                return station._child is None and jobs[0].status == "failed"

            (job,) = await works(station, queue, kill_it)
            assert job.station == "here"
            assert job.said == "it did not begin, and its program ended with -9: without a word"

    run(check())
    assert journals(lab) == []


def test_a_run_whose_journal_is_gone_is_not_begun_again_and_holds_its_station_until_it_is_cancelled(
    database: str, tmp_path: Path
) -> None:
    """As where a lab's folder came back from a backup that is older than the run."""
    lab = make_lab(tmp_path / "lab")

    async def check() -> None:
        async with open_queue(database) as queue:
            await queue.submit([job_for(lab, "here", "there")])
            await queue.take("here")
            await queue.note(1, {"run": "night"})
            station = Station(queue, lab, "here", Manner(simulated=True, resumes=True), print, look_s=0.1)
            (job,) = await works(station, queue, lambda jobs: jobs[0].said != "" or jobs[0].run != "night")
            assert (job.status, job.run) == ("doing", "night")
            assert job.said.startswith("its run night has begun, and its journal is not in ")
            await queue.cancel(1)
            station = Station(queue, lab, "here", Manner(simulated=True, resumes=True), print, look_s=0.1)
            (job,) = await works(station, queue, all_over)
            assert (job.status, job.run) == ("aborted", "night")

    run(check())
    assert journals(lab) == []


def test_a_run_that_was_killed_holds_its_station_until_it_is_resumed_and_is_then_marked(
    database: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lab = make_lab(tmp_path / "lab")
    order = submission_of(plan_of(lab, count=8), simulated=True)

    async def check() -> None:
        async with open_queue(database) as queue:
            short = submission_of(plan_of(lab, "short.yaml", count=1), simulated=True)
            await queue.submit([but(one, stations=("here",)) for one in (order, short)])
            station = Station(queue, lab, "here", Manner(simulated=True), print, look_s=0.1)

            async def kill_it(jobs: list[QueuedJob]) -> bool:
                if jobs[0].run and (child := station._child) is not None and child.returncode is None:
                    child.send_signal(signal.SIGKILL)
                if "was killed" not in jobs[0].said:
                    return False
                before = looks[0]
                await asyncio.sleep(1.0)
                assert looks[0] - before <= 11, "it looks every 0.1 s, and not all the time"
                return True

            looks, taken = [0], queue.taken

            async def looked(name: str) -> Taken | None:
                looks[0] += 1
                return await taken(name)

            monkeypatch.setattr(queue, "taken", looked)
            await works(station, queue, kill_it)
            (journal,) = journals(lab)
            (state,) = [one.state for one in await queue.stations()]
            assert f"`scuhand-bt resume {journal.stem}` goes on with it" in state
            station = Station(queue, lab, "here", Manner(simulated=True, resumes=True), print, look_s=0.1)
            first, second = await works(station, queue, lambda jobs: jobs[0].status != "doing" and jobs[1].run != "")
            assert (first.status, first.run, first.said) == ("succeeded", journal.stem, "done (8 in tolerance)")
            assert second.status == "doing"

    run(check())
    assert len(journals(lab)) == 2


def test_the_queue_tells_a_sample_that_is_not_good_though_in_tolerance_from_those_that_are(
    database: str, tmp_path: Path, order: Submission
) -> None:
    """Its dose was not confirmed by the bare pan: the queue counted it with the others, the run did not."""
    lab = make_lab(tmp_path / "lab")

    async def check() -> None:
        async with open_queue(database) as queue:
            await queue.submit([but(order, stations=("here",))])
            await queue.take("here")
            with closing(Journal(lab / ".scuhand" / "runs" / "night.sqlite", durable=False)) as written:
                written.event(begun_for(order))
                for name, code in (("a", None), ("b", "balance.bracket_open")):
                    written.event(SampleResult.model_validate({**RESULT, "id": name, "code": code}))
                written.event(Ended(exit_code=1, reason="", complete=True))
            station = Station(queue, lab, "here", Manner(operator="Ada"), print, look_s=0.1)
            (job,) = await works(station, queue, all_over)
            assert (job.status, job.said) == ("succeeded", "done (1 in tolerance, 1 in tolerance but not good)")

    run(check())


def test_what_holds_up_a_run_and_how_much_of_it_is_left_is_said_in_the_queue_and_of_its_station(
    database: str, tmp_path: Path, order: Submission
) -> None:
    lab = make_lab(tmp_path / "lab")
    path = lab / ".scuhand" / "runs" / "night.sqlite"
    asked = "Is a fresh sheet in the hand?"

    async def check() -> None:
        async with open_queue(database) as queue:
            await queue.submit([but(order, stations=("here",))])
            await queue.take("here")
            written = Journal(path, durable=False)

            def writes(event: Event) -> None:
                written.event(event)
                written.flush()

            writes(begun_for(order))
            station = Station(queue, lab, "here", Manner(operator="Ada"), print, look_s=0.1)

            with Presence(path):
                working = asyncio.ensure_future(station.work())
                answers = f"waits for a person: {asked}; `scuhand-bt answer night` answers"
                for at_s, event, said, left_s in (
                    (0.0, None, "", 100.0),
                    (0.0, Asked(question=asked, choices=["yes", "no"]), answers, 100.0),
                    (12.0, Answered(question=asked, answer="yes"), "", 90.0),
                    (45.0, Paused(), "is paused; `scuhand-bt resume night` continues", 60.0),
                    (200.0, Continued(), "", 60.0),
                    (232.0, Asked(question=asked, choices=["yes", "no"]), answers, 30.0),
                ):
                    written.now_s = lambda at_s=at_s: at_s
                    if event is not None:
                        writes(event)
                    state = f"runs job 1: {said}" if said else "runs job 1"
                    while [one.state for one in await queue.stations()] != [state]:
                        await asyncio.sleep(0.05)
                    told = [(said or "goes on", left_s)]
                    while [(one.said, one.left_s) for one in await queue.jobs(every=False, limit=9)] != told:
                        await asyncio.sleep(0.05)
                    assert [one.ahead_s for one in await queue.stations()] == [left_s]
            while "goes on with it" not in (told := await queue.jobs(every=False, limit=9))[0].said:
                await asyncio.sleep(0.05)
            assert [one.left_s for one in told] == [None], "nobody is at it now"
            assert [one.ahead_s for one in await queue.stations()] == [order.order.duration_s]
            station.leave()
            await working
            written.close()

    run(check())


def test_a_station_that_waits_for_the_run_of_one_before_it_says_what_that_does(
    database: str, tmp_path: Path, order: Submission, offer: Offer
) -> None:
    """The queue stood still from the death of a station until the end of its run."""
    lab, said = make_lab(tmp_path / "lab"), list[str]()
    path = lab / ".scuhand" / "runs" / "night.sqlite"
    for folder in ("runs", "queue"):
        (lab / ".scuhand" / folder).mkdir(parents=True)

    async def check() -> None:
        async with enrolled(database, offer, "here") as queue:
            await queue.submit([but(order, stations=("here",))])
            await queue.take("here")
            with Presence(path), Presence(lab / ".scuhand" / "queue"), closing(Journal(path, durable=False)) as written:
                written.event(begun_for(order))
                written.event(Paused())
                written.flush()
                station = Station(queue, lab, "here", Manner(operator="Ada"), said.append, look_s=0.1)
                working = asyncio.ensure_future(station.work())
                told = "is paused; `scuhand-bt resume night` continues"
                while [(one.said, one.left_s) for one in await queue.jobs(every=False, limit=9)] != [(told, 100.0)]:
                    await asyncio.sleep(0.05)
                assert [one.state for one in await queue.stations()] == [f"runs job 1: {told}"]
                await asyncio.sleep(0.5)
                station.leave()
                await working

    run(check())
    waits = "another station of this lab works, or the run that it has left goes on; waiting for it"
    assert said[:2] == [waits, "runs job 1: is paused; `scuhand-bt resume night` continues"]


@pytest.mark.slow
def test_a_station_that_ends_with_its_run_at_a_ctrl_c_says_what_that_has_come_to(database: str, tmp_path: Path) -> None:
    lab = make_lab(tmp_path / "lab")
    order = submission_of(plan_of(lab, count=30), simulated=True)

    async def check() -> None:
        async with open_queue(database) as queue:
            await queue.submit([but(order, stations=("here",))])
            station = Station(queue, lab, "here", Manner(simulated=True, resumes=True), print, look_s=0.1)

            async def interrupted(jobs: list[QueuedJob]) -> bool:
                if not jobs[0].run:
                    return False
                station.leave()
                while [one.state for one in await queue.stations()] != ["runs job 1, and ends with it"]:
                    await asyncio.sleep(0.05)
                child = station._child
                assert child is not None
                child.send_signal(signal.SIGINT)
                return True

            await works(station, queue, interrupted)
            ((job,), (known,)) = await queue.jobs(every=False, limit=9), await queue.stations()
            goes_on = f"`scuhand-bt resume {job.run}` goes on with it"
            assert job.status == "doing"
            assert job.said.startswith("interrupted (")
            assert job.said.endswith(goes_on)
            assert known.state == f"has ended; it has to wait for job {job.id}: {job.said}"

    run(check())


@pytest.mark.slow
def test_a_job_that_is_cancelled_while_it_is_run_stops_after_its_sample(database: str, tmp_path: Path) -> None:
    lab = make_lab(tmp_path / "lab")
    order = submission_of(plan_of(lab, count=300), simulated=True)

    async def check() -> None:
        async with open_queue(database) as queue:
            (number,) = await queue.submit([but(order, stations=("here",))])
            station = Station(queue, lab, "here", Manner(simulated=True), print, look_s=0.1)

            async def cancelled(jobs: list[QueuedJob]) -> bool:
                if jobs[0].run and jobs[0].status == "doing" and not jobs[0].is_to_stop:
                    await queue.cancel(number)
                return jobs[0].status == "aborted"

            (job,) = await works(station, queue, cancelled)
            assert job.said.startswith("cancelled; ")
            assert "interrupted" not in job.said, "no sample is left half done"

    run(check())
    (journal,) = journals(lab)
    ended = [row["payload"] for row in read(journal, "event") if row["kind"] == "ended"]
    assert [one["complete"] for one in ended] == [False]


def test_a_station_whose_identity_a_power_cut_has_left_empty_begins(database: str, tmp_path: Path) -> None:
    lab, said = make_lab(tmp_path / "lab"), list[str]()
    identity = lab / ".scuhand" / "queue" / "identity"
    identity.parent.mkdir(parents=True)
    identity.touch()

    async def check() -> None:
        async with open_queue(database) as queue:
            station = Station(queue, lab, None, Manner(simulated=True), said.append, look_s=0.1)
            working = asyncio.ensure_future(station.work())
            while "waits for a job" not in said and not working.done():
                await asyncio.sleep(0.05)
            station.leave()
            await working

    run(check())
    assert identity.read_text()


def test_a_lab_has_one_station_and_a_name_one_lab(database: str, tmp_path: Path, command: Call) -> None:
    labs = [make_lab(tmp_path / name) for name in ("one", "two")]
    said: list[str] = []

    async def check() -> None:
        async with open_queue(database) as queue:
            station = Station(queue, labs[0], None, Manner(simulated=True), said.append, look_s=0.1)
            (labs[0] / ".scuhand").mkdir()
            with Presence(labs[0] / ".scuhand" / "queue"):  # as the run of a station that was killed
                waiting = asyncio.ensure_future(station.work())
                while not said:
                    await asyncio.sleep(0.05)
                assert "waiting for it" in said[0]
                assert await queue.stations() == []
            while "waits for a job" not in said:
                await asyncio.sleep(0.05)
            other = Station(queue, labs[1], "starter", Manner(simulated=True), said.append, look_s=0.1)
            with pytest.raises(SourceError, match="is another lab's"):
                await other.work()
            (here,) = await queue.stations()
            assert here.is_there
            station.leave()
            await waiting
            (gone,) = await queue.stations()
            assert (gone.state, gone.is_there) == ("has ended", False), "it was there for a minute more"

    run(check())
    out = command("fleet", "--database", database).stdout
    assert "has ended" in out
    assert "was:" not in out
    assert " now " not in out


@pytest.mark.slow
def test_a_station_that_has_jobs_takes_none_under_another_name(database: str, tmp_path: Path, offer: Offer) -> None:
    """A run that was killed held back the others of its cell only until the station was called otherwise."""
    lab = make_lab(tmp_path / "lab")

    async def check() -> None:
        async with open_queue(database) as queue:
            await queue.submit([job_for(lab, "one")])
            station = Station(queue, lab, "one", Manner(simulated=True), print, look_s=0.1)
            other = Station(queue, lab, "two", Manner(simulated=True), print, look_s=0.1)
            assert await queue.take("one") is not None
            (lab / ".scuhand" / "queue").mkdir(parents=True)
            (lab / ".scuhand" / "queue" / "identity").write_text('"of the lab"')
            assert await queue.enrol("one", "of the lab", offer)
            with pytest.raises(SourceError, match="this lab's station has jobs as 'one': begin it with --name 'one'"):
                await other.work()
            await works(station, queue, all_over)
            await works(other, queue, lambda jobs: True)

    run(check())


def test_an_idle_station_says_anew_what_its_cell_has(
    database: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A mortar that was filled since, a powder that was added: none of it was known before the next job had been run.

    And one that was forgotten while it works is there again; one whose lab is broken just then goes on, and one that
    lacks its powders, as their file is wrong, says so.
    """
    lab, said = make_lab(tmp_path / "lab"), list[str]()
    monkeypatch.setattr("scuhand_bt.fleet.station.IDLE_LOOKS", 2)

    async def check() -> None:
        async with open_queue(database) as queue:
            station = Station(queue, lab, "here", Manner(operator="Ada"), said.append, look_s=0.05)

            async def lots() -> dict[str, str]:
                return {key: lot for one in await queue.stations() if one.offer for key, lot in one.offer.lots.items()}

            working = asyncio.ensure_future(station.work())
            while "waits for a job" not in said:
                await asyncio.sleep(0.05)
            assert await lots() == {}
            await queue._database.execute_query_async("DELETE FROM scuhand_stations")
            cell = lab / "robot" / "cell.yaml"
            text = cell.read_text()
            cell.write_text(text.replace("cell: starter", "cell: [starter"))
            while not any(line.startswith("the lab is broken: ") for line in said):
                await asyncio.sleep(0.05)
            cell.write_text(text)
            powders = lab / "robot" / "powders.yaml"
            known = powders.read_text()
            powders.write_text(f"{known}sand: [\n")
            while not said[-1].startswith(f"waits for a job; wrong in its lab: {powders}:"):
                await asyncio.sleep(0.05)
            assert {said[-1]} == {one.state for one in await queue.stations()}
            powders.write_text(known)
            Inventory(lab / ".scuhand", "starter").enter(
                StockEntry("station", "mortar_bay", "glass_beads", "GB-7", 5e3)
            )
            while await lots() != {"mortar_bay": "glass_beads/GB-7"} or said[-1] != "waits for a job":
                await asyncio.sleep(0.05)
            station.leave()
            await working

    run(check())


@pytest.mark.slow
def test_a_run_goes_on_and_is_marked_while_the_database_is_away(
    postgres: Server, database: str, tmp_path: Path
) -> None:
    lab, said = make_lab(tmp_path / "lab"), list[str]()
    order = submission_of(plan_of(lab, count=20), simulated=True)

    async def check() -> None:
        async with open_queue(database) as queue:
            await queue.submit([but(order, stations=("here",))])
            station = Station(queue, lab, "here", Manner(simulated=True), said.append, look_s=0.1)
            working = asyncio.ensure_future(station.work())
            while "runs job 1" not in said:
                await asyncio.sleep(0.05)
            await asyncio.to_thread(postgres.stop, "immediate")
            while not any("is not reached" in line for line in said):
                await asyncio.sleep(0.05)
            await asyncio.to_thread(postgres.start)
            while not any(line.startswith("job 1: ") and "succeeded" in line for line in said):
                await asyncio.sleep(0.05)
            station.leave()
            await working

    run(check())
    assert len(journals(lab)) == 1


def test_commands_submit_list_and_cancel(database: str, tmp_path: Path, command: Call, offer: Offer) -> None:
    async def enrol() -> None:
        async with enrolled(database, offer, "here"):
            pass

    async def end() -> None:
        async with open_queue(database) as queue:
            await queue.tell("here", ENDED)

    run(enrol())
    recipe = REPOSITORY / "recipes" / "synthesis_batch.yaml"
    where = ("--database", database)
    assert command("submit", recipe, *where)[0] == 2, "the only station is simulated"
    code, out, _ = command("submit", recipe, "--dry-run", *where)
    assert (code, out) == (0, f"job 1: {recipe} at here\n")
    code, out, _ = command("queue", "--json", *where)
    (job,) = json.loads(out)
    assert (job["recipe"], job["station"], job["status"], job["simulated"]) == ("synthesis-batch", "here", "todo", True)
    assert "SIMULATED" in command("queue", *where).stdout
    assert command("cancel", 1, *where).returncode == 0
    assert command("cancel", 1, *where).returncode == 2
    (job,) = json.loads(command("queue", "--all", "--json", *where).stdout)
    assert (job["status"], job["is_to_stop"]) == ("cancelled", False), "it has stopped"
    assert command("cancel", 10**20, *where).stderr.startswith(f"job {10**20} neither waits nor is it run")
    assert "is empty" in command("queue", *where).stdout
    assert "here" in command("fleet", *where).stdout
    assert command("fleet", "--forget", "nobody", *where).returncode == 2
    code, _, said = command("fleet", "--forget", "here", *where)
    assert code == 2
    assert "'here' is there" in said, "it would be back with its next job, and none comes to it until then"
    run(end())
    assert "no stations" in command("fleet", "--forget", "here", *where).stdout


def test_what_is_run_is_listed_first_and_that_there_is_more_is_said(
    database: str, command: Call, offer: Offer, order: Submission
) -> None:
    """With a full queue the job that is run was not seen, nor that any was left out."""

    async def submitted() -> None:
        async with enrolled(database, offer, "here") as queue:
            await queue.submit([but(order, stations=("here",), key=str(number)) for number in range(4)])
            assert await queue.take("here") is not None

    run(submitted())
    where = ("--most", 3, "--database", database)
    for every in ([], ["--all"]):
        assert [job["id"] for job in json.loads(command("queue", "--json", *every, *where).stdout)] == [1, 4, 3]
    assert command("queue", *where).stdout.endswith("… and more: `--most` shows more than 3.\n")
    assert "and more" not in command("queue", "--most", 4, "--database", database).stdout


def test_a_station_of_another_version_is_listed_and_gets_no_jobs(
    database: str, tmp_path: Path, command: Call, offer: Offer, order: Submission
) -> None:
    """What an earlier one has written stays in the queue: every `submit` and `fleet` ended in a traceback."""

    async def enrol() -> None:
        async with enrolled(database, offer, "older") as queue:
            await queue._database.execute_query_async('UPDATE scuhand_stations SET offer = \'{"cell": "c"}\'')
            with pytest.raises(SourceError, match="no station can do it: at older another version of scuhand-bt works"):
                choose([order], await queue.stations())

    run(enrol())
    assert "of another version" in command("fleet", "--database", database).stdout
    (one,) = json.loads(command("fleet", "--json", "--database", database).stdout)
    assert (one["name"], one["offer"]) == ("older", None)


def test_cancel_says_what_becomes_of_the_job(database: str, order: Submission, offer: Offer, command: Call) -> None:
    where = ("--database", database)

    async def submitted() -> None:
        async with enrolled(database, offer, "here") as queue:
            await queue.submit([but(order, stations=("here",), key=key) for key in ("first", "second")])
            assert await queue.take("here") is not None

    async def silent(hours: int) -> None:
        async with open_queue(database) as queue:
            query = "UPDATE scuhand_stations SET seen = now() - %(hours)s * interval '1 hour'"
            await queue._database.execute_query_async(query, hours=hours)

    run(submitted())
    assert command("cancel", 2, *where)[:2] == (0, "job 2 is cancelled.\n")
    assert command("cancel", 1, *where)[:2] == (0, "job 1 stops at 'here' after its current sample.\n")

    async def interrupted() -> None:
        async with open_queue(database) as queue:
            await queue.tell("here", f"{HELD_BACK} 1: it was killed")

    run(interrupted())
    assert command("cancel", 1, *where).stdout.startswith("job 1 is given up at 'here', whose run was interrupted: ")
    assert "last heard of" not in command("queue", *where).stdout
    run(silent(3))
    assert "'here' was last heard of 3 h 00 min ago" in command("queue", *where).stdout
    assert "last heard of" not in command("queue", "--all", "--most", 9, *where).stdout.splitlines()[-1], "it is over"
    said = command("cancel", 1, *where).stdout
    assert said.startswith("job 1 is to stop, but 'here', which has taken it, was last heard of 3 h 00 min ago: ")


def test_a_real_station_asks_whose_its_runs_are(command: Call) -> None:
    code, _, err = command("station")
    assert code == 2
    assert "--operator" in err


@pytest.mark.parametrize(
    ("name", "why"),
    [(" ", "a person's name has 1 to 80 signs"), ("a\x1b[31m", "that can be read"), ("Ada", "Ada signs with a PIN")],
)
def test_a_station_refuses_an_operator_in_whose_name_no_run_could_begin(
    name: str, why: str, command: Call, tmp_path: Path
) -> None:
    """It began, and every job that it took was refused by its run."""
    lab = make_lab(tmp_path / "lab")
    Persons(lab / ".scuhand").enrol("Ada", "123456")
    refused = command("station", "--operator", name, "--lab", lab, "--database", "host=127.0.0.1 port=1")
    assert refused.returncode == 2
    assert why in " ".join(refused.stderr.replace("│", " ").split())


def test_a_station_has_no_name_that_is_too_long_for_the_queue(command: Call, tmp_path: Path, database: str) -> None:
    """It began, and every job that was to go there was told as a database that went away."""
    here = ("--dry-run", "--lab", make_lab(tmp_path / "lab"), "--database", database)
    code, _, err = command("station", "--name", 129 * "n", *here)
    assert code == 2
    assert "128 characters at the most" in err


@pytest.mark.parametrize("name", ["", "  ", "a\nb", "\x1b[31mred"])
def test_a_station_has_a_name_that_can_be_seen(name: str, command: Call) -> None:
    refused = command("station", "--dry-run", "--name", name, "--database", "host=127.0.0.1 port=1")
    assert refused.returncode == 2
    assert "a name is of letters that can be seen" in refused.stderr


@pytest.mark.slow
def test_no_kill_makes_a_fleet_do_anything_twice_or_lose_a_job(postgres: Server, tmp_path: Path) -> None:
    done = chaos(tmp_path, postgres, kills=12, seed=0)
    assert done.tally.problems == []
    assert done.kills.total() >= 12
    assert done.jobs == {"succeeded": done.jobs["succeeded"]}


# --- the page

PAGE = (REPOSITORY / "docs" / "fleet.md").read_text(encoding="utf-8")
ETC = "/etc/postgresql/15/main"
PASSWORD = "correct horse"


@pytest.mark.slow
@pytest.mark.skipif(tools() is None, reason="no PostgreSQL here: apt install postgresql")
def test_the_queue_is_set_up_and_used_as_the_page_says(tmp_path: Path) -> None:
    """Server and clients with the page's own commands and files; only places, the port and the password differ."""
    setup, use = re.findall(r"^```sh\n(.*?)^```", PAGE, re.M | re.S)
    settings, access, service, password, _ = re.findall(r"^```ini\n(.*?)^```", PAGE, re.M | re.S)
    with server() as made:
        data = made.folder / "data"
        for line in setup.splitlines()[1:]:
            words = shlex.split(line.replace(ETC, str(data)))
            assert words[:3] == ["sudo", "-u", "postgres"]
            made.run(*words[3:], answers=f"{PASSWORD}\n{PASSWORD}\n")
        with (data / "postgresql.conf").open("a") as file:
            file.write(settings.replace(ETC, str(data)).replace("'*'", "'127.0.0.1'"))
        (data / "pg_hba.conf").write_text(access)
        made.restart()
        home = tmp_path / "home"
        (home / ".postgresql").mkdir(parents=True)
        (home / ".postgresql" / "root.crt").write_bytes((data / "queue.crt").read_bytes())
        (home / ".pg_service.conf").write_text(service)
        (home / ".pgpass").write_text(password.replace("5432", str(made.port)).replace("the password", PASSWORD))
        (home / ".pgpass").chmod(0o600)
        lab = make_lab(tmp_path / "lab")
        shutil.copytree(REPOSITORY / "recipes", lab / "recipes")
        here = {**os.environ, "HOME": str(home), "PGHOSTADDR": "127.0.0.1", "PGPORT": str(made.port)}
        (variable, station, *commands) = (shlex.split(line)[1:] for line in use.splitlines())
        environment = {**here, **dict([variable[0].split("=")])}

        def command(*words: str) -> "subprocess.CompletedProcess[str]":
            program = [sys.executable, "-m", "scuhand_bt", *words]
            return subprocess.run(program, env=environment, cwd=lab, capture_output=True, text=True)

        said = tmp_path / "said.txt"
        with said.open("w") as output:
            works = subprocess.Popen(
                [sys.executable, "-m", "scuhand_bt", *station], env=environment, cwd=lab, stdout=output, stderr=output
            )
        try:
            await_line(said, "waits for a job")
            submit, queue, fleet = commands
            assert command(*submit).stdout == "job 1: recipes/xrd_holders.yaml at trial\n"
            await_line(said, "job 1: succeeded: done (8 in tolerance)")
            assert "succeeded" in command(*queue).stdout
            assert "trial" in command(*fleet).stdout
            plain = command("queue", "--database", "service=scuhand sslmode=disable")
            assert (plain.returncode, "no encryption" in plain.stderr) == (2, True)
            (home / ".pgpass").unlink()
            assert "password" in command("queue").stderr
        finally:
            works.terminate()
            assert works.wait() == 0


def await_line(file: Path, line: str) -> None:
    until_s = time.monotonic() + PATIENCE_S
    while line not in file.read_text().splitlines():
        assert time.monotonic() < until_s, file.read_text()
        time.sleep(0.1)
