"""The commands beside a station's: submit, queue, fleet and cancel, and what they say."""

import json
from pathlib import Path

import pytest
from conftest import REPOSITORY, Call
from fleet_bench import but, enrolled, run

from scuhand_bt.fleet.needs import Offer
from scuhand_bt.fleet.order import Submission
from scuhand_bt.fleet.queue import ENDED, HELD_BACK, choose, open_queue
from scuhand_bt.problems import SourceError

pytestmark = pytest.mark.xdist_group("postgres")


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
    assert command("cancel", 10**20, *where).stderr.startswith(f"job {10**20} is neither waiting nor running")
    assert "is empty" in command("queue", *where).stdout
    assert "here" in command("fleet", *where).stdout
    assert command("fleet", "--forget", "nobody", *where).returncode == 2
    code, _, said = command("fleet", "--forget", "here", *where)
    assert code == 2
    assert "'here' is running, it was heard of" in said, (
        "it would be back with its next job, and none comes to it until then"
    )
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
    stops = (0, "job 1 stops at 'here' after its current sample.\n")
    assert command("cancel", 1, *where)[:2] == stops

    async def interrupted(number: int) -> None:
        async with open_queue(database) as queue:
            await queue.tell("here", f"{HELD_BACK} {number}: it was killed")

    run(interrupted(10))
    assert command("cancel", 1, *where)[:2] == stops, "the station has just taken this one, after one that was given up"
    run(interrupted(1))
    assert command("cancel", 1, *where).stdout.startswith("job 1 is given up at 'here', whose run was interrupted: ")
    assert "last heard of" not in command("queue", *where).stdout
    run(silent(3))
    assert "'here' was last heard of 3 h 00 min ago" in command("queue", *where).stdout
    assert "last heard of" not in command("queue", "--all", "--most", 9, *where).stdout.splitlines()[-1], "it is over"
    said = command("cancel", 1, *where).stdout
    assert said.startswith("job 1 is to stop, but 'here', which has taken it, was last heard of 3 h 00 min ago: ")
