"""What the queue says of a job that is run: what its journal has come to, what holds it up, how much is left."""

import asyncio
from contextlib import closing
from pathlib import Path

import pytest
from fleet_bench import all_over, but, enrolled, run, works
from journal_bench import HEADER, RESULT
from running import make_lab

from scuhand_bt.events.entry import Event
from scuhand_bt.fleet.needs import Offer
from scuhand_bt.fleet.order import Submission
from scuhand_bt.fleet.queue import open_queue
from scuhand_bt.fleet.station import Manner, Station
from scuhand_bt.journal.events import Answered, Asked
from scuhand_bt.journal.presence import Presence
from scuhand_bt.journal.results import SampleResult
from scuhand_bt.journal.run_events import Continued, Ended, Paused, RunBegun
from scuhand_bt.journal.writer import Journal

pytestmark = pytest.mark.xdist_group("postgres")


def begun_for(order: Submission) -> RunBegun:
    """The first word of a run that a station has begun, on the cell."""
    path = f"/queue/{order.order.key}/r.yaml"
    header = {**HEADER, "mode": "real devices", "simulated": False, "recipe_path": path, "planned_s": 100.0}
    return RunBegun.model_validate(header)


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
