"""A journal is written beside the run's tick; one that is lost ends the run within a second, and is whole elsewhere."""

import itertools
import shutil
import sqlite3
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from conftest import Bench, FakeCell, wait_until
from journal_bench import problem_of
from resuming import Run, Watch
from running import Watching, make_lab
from test_rehearse import HEAD, session_of

from scuhand_bt.clock import Steps, Wake
from scuhand_bt.devices.liveness import LIMIT_S, Liveness
from scuhand_bt.events.entry import Note
from scuhand_bt.journal.migrations import in_memory
from scuhand_bt.journal.reader import read
from scuhand_bt.journal.store import Row, Store
from scuhand_bt.journal.writer import LOOK_S, Journal
from scuhand_bt.lab import load_lab
from scuhand_bt.record import Record, RecordLost
from scuhand_bt.run.resume import world_path
from scuhand_bt.run.simulation import Rehearsal
from scuhand_bt.skill import Skill

NOTE = Note("lab.note", {})


def wait_for(condition: Callable[[], bool], longest_s: float = 5.0) -> float:
    """Seconds until it holds."""
    began_s = time.monotonic()
    while not condition():
        assert time.monotonic() - began_s < longest_s
        time.sleep(0.01)
    return time.monotonic() - began_s


# --- a file that is lost


def lose(path: Path, how: str) -> None:
    if how == "removed":
        path.unlink()
    elif how == "replaced":
        shutil.copy(path, path.with_name("copy"))
        path.with_name("copy").replace(path)
    else:
        shutil.rmtree(path.parent)
    if how == "folder replaced":
        path.parent.touch()


@pytest.mark.parametrize("how", ["removed", "replaced", "folder removed", "folder replaced"])
def test_a_run_whose_journal_is_lost_ends_safe_within_a_second_and_its_whole_story_is_kept_elsewhere(
    tmp_path: Path, how: str
) -> None:
    run = Run(tmp_path, make_lab(tmp_path / "lab"))
    lost_at, seen = [0.0], []

    class Losing(Watch):
        def ticked(self, root: Any) -> None:
            super().ticked(root)
            if self.ticks == 60:
                lose(self.session.journal.path, how)
                lost_at[0] = time.monotonic()
            elif lost_at[0]:
                seen.append(time.monotonic() - lost_at[0])

    watch = Losing()
    result = run.go(watch)
    journal = watch.session.journal
    assert result.exit_code == 3
    assert str(journal.kept_in) in result.reason
    assert journal.kept_in not in (None, journal.path)
    assert max(seen, default=0.0) < 1.0
    assert all(watch.session.cell.device(name).is_stopped for name in ("arm", "hand", "balance", "changer"))
    assert problem_of(journal.kept_in, journal.head) is None
    kinds = [row["kind"] for row in read(journal.kept_in, "entry")]
    assert kinds[0] == "run"
    assert kinds[-2:] == ["ended", "matter"]


@pytest.mark.parametrize("is_beside", [False, True])
def test_a_lost_journal_is_noticed_within_a_second_though_nothing_is_written(tmp_path: Path, is_beside: bool) -> None:
    journal = Journal(tmp_path / "runs" / "r.sqlite", durable=False)
    journal.is_beside = is_beside
    journal.event(NOTE)
    journal.settle()
    before = journal.news.count
    journal.path.unlink()
    assert wait_for(lambda: journal.news.count > before) < 1.0
    with pytest.raises(RecordLost, match="it was taken away; what happened is in"):
        journal.keep_up()
    journal.keep_up()
    journal.close()
    assert journal.kept_in is not None
    assert len(read(journal.kept_in, "entry")) == 1


def test_a_journal_that_is_lost_before_its_first_entry_has_it_elsewhere(tmp_path: Path) -> None:
    journal = Journal(tmp_path / "runs" / "r.sqlite", durable=False)
    journal.path.unlink()
    with pytest.raises(RecordLost):
        journal.event(NOTE)
    journal.close()
    assert journal.kept_in is not None
    assert len(read(journal.kept_in, "entry")) == 1


@pytest.mark.parametrize("how", ["removed", "replaced"])
def test_what_was_rescued_is_whole_once_it_is_moved_to_where_the_journal_was(tmp_path: Path, how: str) -> None:
    """Of the file that is gone SQLite leaves another beside it, which it would read into the next one of that name."""
    journal = Journal(tmp_path / "runs" / "r.sqlite", durable=False)
    journal.event(NOTE)
    lose(journal.path, how)
    with pytest.raises(RecordLost):
        journal.event(NOTE)
    journal.event(NOTE)
    journal.close()
    assert journal.kept_in is not None
    journal.kept_in.replace(journal.path)
    assert len(read(journal.path, "entry")) == 3
    assert problem_of(journal.path, journal.head) is None


def test_what_happens_in_a_dry_run_is_on_disk_once_its_time_goes_on(tmp_path: Path) -> None:
    found = list[str]()

    class Noting(Watch):
        def ticked(self, root: Any) -> None:
            super().ticked(root)
            if self.ticks == 5:
                journal, clock = self.session.journal, self.session.cell.clock
                journal.event(NOTE)
                clock.wait([Wake(clock.now_s + 0.02)])
                found.extend(entry["kind"] for entry in read(journal.path, "entry"))

    Run(tmp_path, make_lab(tmp_path / "lab")).go(Noting())
    assert NOTE.kind in found


def test_what_a_dry_run_tells_after_its_end_is_on_disk_while_its_world_is_kept_with_it(tmp_path: Path) -> None:
    run, kept = Run(tmp_path, make_lab(tmp_path / "lab")), dict[str, bool]()

    def heard(event: Any) -> None:
        kept[event.entry()[0]] = world_path(run.journal).exists()

    assert run.go(Watch(), heard=heard).is_complete
    assert kept["ended"]
    assert kept["matter"]
    assert not world_path(run.journal).exists()


def test_a_run_whose_journal_is_lost_says_so_as_why_it_ended(tmp_path: Path) -> None:
    class Losing(Watch):
        def ticked(self, root: Any) -> None:
            super().ticked(root)
            if self.ticks == 5:
                lose(self.session.journal.path, "removed")

    result = Run(tmp_path, make_lab(tmp_path / "lab")).go(Losing())
    assert result.reason.startswith("the journal ")


# --- beside the tick


class SlowDisk:
    """Every write waits until it is let go."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.is_held = False
        self.batches: list[int] = []
        add = Store.add

        def slow(store: Store, rows: Sequence[Row]) -> None:
            self.batches.append(len(rows))
            wait_for(lambda: not self.is_held)
            add(store, rows)

        monkeypatch.setattr(Store, "add", slow)


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch) -> SlowDisk:
    return SlowDisk(monkeypatch)


@pytest.fixture
def journal(tmp_path: Path, disk: SlowDisk) -> Iterator[Journal]:
    journal = Journal(tmp_path / "runs" / "r.sqlite", durable=True)
    journal.is_beside = True
    yield journal
    disk.is_held = False
    journal.close()


def test_nobody_waits_for_a_disk_but_what_asks_to(journal: Journal, disk: SlowDisk) -> None:
    disk.is_held = True
    for number in range(20):
        journal.event(Note("lab.note", {"number": number}))
    first, last = journal.waits(1), journal.waits()
    assert first is not None
    assert last is not None
    assert not last.has_fired
    kept = Record(journal.event, journal.waits).kept()
    next(kept)
    disk.is_held = False
    wait_for(lambda: last.has_fired and journal.waits() is None)
    with pytest.raises(StopIteration):
        next(kept)
    assert [row["payload"]["number"] for row in read(journal.path, "event")] == list(range(20)), "in their order"
    assert problem_of(journal.path, journal.head) is None
    assert len(disk.batches) <= 3, "what has waited goes on disk together"


def test_what_is_told_of_a_run_is_on_disk_before(journal: Journal, disk: SlowDisk) -> None:
    heard = []
    journal.heard = lambda event: heard.append(len(read(journal.path, "event")))
    disk.is_held = True
    journal.event(NOTE)
    time.sleep(2 * LOOK_S)
    assert heard == []
    disk.is_held = False
    journal.settle()
    assert wait_for(lambda: heard == [1]) < 1.0


def test_a_journal_is_whole_once_it_is_closed(journal: Journal, disk: SlowDisk) -> None:
    for _ in range(5):
        journal.event(NOTE)
    journal.close()
    assert len(read(journal.path, "entry")) == 5
    assert [path.name for path in journal.path.parent.iterdir()] == ["r.sqlite"]


def test_an_action_begins_once_it_is_on_disk_that_it_does_and_all_before_it(
    bench: Bench, disk: SlowDisk, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Work(Skill[None]):
        """Note when it begins."""

        def run(self, cell: FakeCell) -> Steps[None]:  # type: ignore[override]
            cell.note("begun")
            yield from wait_until(cell, cell.clock.now_s + 1.0)

    journals: list[Journal] = []

    def open_journal(path: Path, *, durable: bool) -> Journal:
        journals.append(Journal(path, durable=True))
        journals[0].is_beside = True
        return journals[0]

    def let_go() -> None:
        disk.is_held = False
        journals[0].settle()

    monkeypatch.setattr("conftest.Journal", open_journal)
    disk.is_held = True
    bench.agenda.at(5.0, let_go)
    bench.run("work:", {"work": Work})
    assert bench.log == [(5.0, "begun")]
    assert bench.actions() == [("work", "done")]


@pytest.mark.slow
@pytest.mark.real_time
def test_an_action_waits_for_a_slow_disk_and_the_control_does_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A rehearsal on twins, in real time, with every other write half a second long."""
    add, beat = Store.add, Liveness.beat
    writes, beats_s = [0], list[float]()

    def slow(store: Store, rows: Sequence[Row]) -> None:
        writes[0] += 1
        if writes[0] % 2 == 0:
            time.sleep(0.5)
        add(store, rows)

    def noted(liveness: Liveness) -> None:
        beats_s.append(time.monotonic())
        beat(liveness)

    opened = "workflow: open\ntree: {sequence: [{check_valve: }, {check_valve: }]}\n"
    lab = load_lab(make_lab(tmp_path / "lab", trees__open=opened))
    session = session_of(tmp_path, lab, Rehearsal(), HEAD + "  - {id: a, workflow: open}\n")
    monkeypatch.setattr(Store, "add", slow)
    monkeypatch.setattr(Liveness, "beat", noted)
    beats_at_rest = []
    try:
        result = session.run(Watching(session, at_tick=lambda root: beats_at_rest.append(len(beats_s))))
    finally:
        session.close()
    assert result.exit_code == 0, result.reason
    assert writes[0] >= 4, "two of them slow"
    at_work_s = beats_s[: beats_at_rest[-1]]
    assert max(later - sooner for sooner, later in itertools.pairwise(at_work_s)) < LIMIT_S
    doing = [(row["skill"], row["outcome"]) for row in read(session.journal.path, "action")]
    assert doing[:2] == [("check_valve", "done")] * 2


# --- Python 3.13 warns of a database that is found open when memory is tidied up


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[sqlite3.Connection]:
    """All databases that are opened."""
    connect, opened = sqlite3.connect, list[sqlite3.Connection]()

    def kept(*arguments: Any, **options: Any) -> sqlite3.Connection:
        opened.append(connect(*arguments, **options))
        return opened[-1]

    monkeypatch.setattr(sqlite3, "connect", kept)
    return opened


def is_open(database: sqlite3.Connection) -> bool:
    try:
        database.execute("SELECT 1")
    except sqlite3.ProgrammingError:
        return False
    return True


def test_a_file_that_is_no_database_and_entries_that_do_not_fit_leave_none_open(
    opened: list[sqlite3.Connection], tmp_path: Path
) -> None:
    (tmp_path / "text").write_text("no database, whatever its name says, and longer than a header", encoding="utf-8")
    with pytest.raises(sqlite3.DatabaseError):
        Store(tmp_path / "text", durable=False)
    with pytest.raises(sqlite3.ProgrammingError):
        in_memory(iter([((), b"")]))  # type: ignore[list-item]
    assert [is_open(database) for database in opened] == [False, False]
    store = Store(tmp_path / "runs" / "a.sqlite", durable=False)
    assert store.moved([((), b"")]) is None  # type: ignore[list-item]
    assert len(opened) > 3
    assert [database for database in opened if is_open(database)] == [store.db]
    store.close()
    assert {path.name for path in tmp_path.iterdir()} == {"text", "runs"}
