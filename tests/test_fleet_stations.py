"""A station by itself: one of its lab, under a name of its own, and what it says of itself while it is idle."""

import asyncio
from pathlib import Path

import pytest
from conftest import Call
from fleet_bench import all_over, job_for, run, works
from running import make_lab

from scuhand_bt.fleet.needs import Offer
from scuhand_bt.fleet.queue import open_queue
from scuhand_bt.fleet.station import Manner, Station
from scuhand_bt.journal.presence import Presence
from scuhand_bt.lab_state.inventory import Inventory, StockEntry
from scuhand_bt.lab_state.persons import Persons
from scuhand_bt.problems import SourceError

pytestmark = pytest.mark.xdist_group("postgres")


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


def test_a_station_that_cannot_read_a_journal_begins_no_job_and_says_why_in_the_queue(
    database: str, tmp_path: Path
) -> None:
    """`fleet` told nothing of it: what the station said last stood there."""
    lab = make_lab(tmp_path / "lab")
    (lab / ".scuhand" / "runs").mkdir(parents=True)
    (lab / ".scuhand" / "runs" / "old.sqlite").write_bytes(b"no journal" * 999)

    async def check() -> None:
        async with open_queue(database) as queue:
            station = Station(queue, lab, "here", Manner(simulated=True), print, look_s=0.1)
            await queue.submit([job_for(lab, "here")])
            with pytest.raises(SourceError, match=r"old.sqlite: .*; no job begins here meanwhile"):
                await station.work()
            (known,) = await queue.stations()
            assert known.state.startswith("has ended: ")
            assert "old.sqlite" in known.state

    run(check())


def test_a_real_station_asks_whose_its_runs_are(command: Call) -> None:
    code, _, err = command("station")
    assert code == 2
    assert "--operator" in err


@pytest.mark.parametrize(
    ("name", "why"),
    [
        (" ", "a person's name must have 1 to 80 visible"),
        ("a\x1b[31m", "visible characters"),
        ("Ada", "Ada signs with a PIN"),
    ],
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
    assert "a name must have only visible letters" in refused.stderr
