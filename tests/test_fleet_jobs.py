"""What becomes of jobs at stations, with runs in programs of their own: whatever dies, nothing is done twice."""

import asyncio
import base64
import signal
from dataclasses import replace
from pathlib import Path

import pytest
from fleet_bench import RECIPE, all_over, but, job_for, plan_of, run, works
from running import make_lab

from harness.fleet import chaos
from harness.postgres import Server
from scuhand_bt.fleet.order import submission_of
from scuhand_bt.fleet.queue import QueuedJob, Taken, open_queue
from scuhand_bt.fleet.station import Manner, Station
from scuhand_bt.journal.reader import read

pytestmark = pytest.mark.xdist_group("postgres")


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


def test_a_run_whose_journal_is_taken_away_while_it_goes_on_holds_its_station(database: str, tmp_path: Path) -> None:
    """The station ended with an error, and the queue said that the run goes on."""
    lab, told = make_lab(tmp_path / "lab"), list[str]()
    order = submission_of(plan_of(lab, count=300), simulated=True)

    async def check() -> None:
        async with open_queue(database) as queue:
            await queue.submit([but(order, stations=("here",))])
            station = Station(queue, lab, "here", Manner(simulated=True), print, look_s=0.1)

            def is_held_back(jobs: list[QueuedJob]) -> bool:
                assert jobs[0].run or not told, "it may be begun again"
                if jobs[0].run:
                    told.append(jobs[0].run)
                    for journal in journals(lab):
                        journal.unlink()
                return "was taken away" in jobs[0].said

            (job,) = await works(station, queue, is_held_back)
            assert (job.status, set(told)) == ("doing", {job.run})
            (known,) = await queue.stations()
            assert known.state.startswith("has ended; it has to wait for job 1: ")

    run(check())
    assert journals(lab) == [], "no second run"


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
            cell = lab / "robot/cell.yaml"
            before = cell.read_text(encoding="utf-8")
            cell.write_text(f"{before}# later\n", encoding="utf-8")
            station = Station(queue, lab, "here", Manner(simulated=True, resumes=True), print, look_s=0.1)
            (first, _) = await works(station, queue, lambda jobs: "cell.yaml has changed" in jobs[0].said)
            assert "was killed" in first.said
            cell.write_text(before, encoding="utf-8")
            station = Station(queue, lab, "here", Manner(simulated=True, resumes=True), print, look_s=0.1)
            first, second = await works(station, queue, lambda jobs: jobs[0].status != "doing" and jobs[1].run != "")
            assert (first.status, first.run, first.said) == ("succeeded", journal.stem, "done (8 in tolerance)")
            assert second.status == "doing"

    run(check())
    assert len(journals(lab)) == 2


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


@pytest.mark.slow
def test_no_kill_makes_a_fleet_do_anything_twice_or_lose_a_job(postgres: Server, tmp_path: Path) -> None:
    done = chaos(tmp_path, postgres, kills=12, seed=0)
    assert done.tally.problems == []
    assert done.kills.total() >= 12
    assert done.jobs == {"succeeded": done.jobs["succeeded"]}
