"""The writer of journals: what becomes of each call, and of each kind of value."""

import json
import math
import sqlite3
import subprocess
import sys
import time
import zlib
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dose_bench import DISH, MORTAR, shipped_powders
from pydantic import BaseModel, Field

from scuhand_bt.devices.interfaces import Reading
from scuhand_bt.events.cell import Discarded, Returned, SheetSwapped
from scuhand_bt.events.doses import Dose, Pulsed
from scuhand_bt.events.entry import Note
from scuhand_bt.journal import store, writer
from scuhand_bt.journal.events import ActionEnded, ActionStarted, JobEnded, JobStarted
from scuhand_bt.journal.hash_chain import GENESIS, Entry, digest, verify
from scuhand_bt.journal.plain import plain, to_json
from scuhand_bt.journal.results import SoFar
from scuhand_bt.journal.run_events import Trouble
from scuhand_bt.journal.store import SCHEMA_VERSION
from scuhand_bt.journal.writer import FLUSH_S, Journal
from scuhand_bt.record import RecordLost
from scuhand_bt.specs import Source

BEADS = shipped_powders()["glass_beads"]
DOSE = Dose(
    target_mg=20.0,
    tolerance_mg=2.0,
    dispensed_mg=20.3,
    uncertainty_mg=0.05,
    pulses=3,
    vibration_s=1.5,
    duration_s=30.0,
    controller="paper",
    verdict="in tolerance",
)
SETTLE = Pulsed(kind="settle", net_mg=20.3, uncertainty_mg=0.05)
DONE = ActionEnded(outcome="done", code=None, result=None)


def begun(skill: str, path: str = "w/0") -> ActionStarted:
    return ActionStarted(path=path, visit=1, skill=skill, inputs={})


def job(name: str) -> JobStarted:
    return JobStarted(name=name, sample=None, attempt=1, workflow="w")


@dataclass
class Point:
    x_mm: float
    on: BaseModel | None = None


class Aliased(BaseModel):
    mass_mg: float = Field(alias="mass")
    path: Path = Path("a/b")


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "new" / "folder" / "r.sqlite"


@pytest.fixture
def journal(path: Path) -> Iterator[Journal]:
    journal = Journal(path, durable=False)
    yield journal
    journal.close()


def rows(path: Path, columns: str = "kind, job, action") -> list[tuple[Any, ...]]:
    with closing(sqlite3.connect(path)) as database:
        return database.execute(f"SELECT {columns} FROM entry ORDER BY seq").fetchall()


def payloads(path: Path) -> list[Any]:
    return [json.loads(payload) for (payload,) in rows(path, "payload")]


# --- values


@pytest.mark.parametrize(
    ("value", "kept"),
    [
        (DISH, "dish (petri_dish)"),
        (BEADS, "glass_beads"),
        (Source(name="store", station="bay", mortar=MORTAR, powder=BEADS, amount_mg=1.0), "store"),
        (Aliased(mass=2.5), {"mass_mg": 2.5, "path": "a/b"}),
        (Point(1.5), {"x_mm": 1.5, "on": None}),
        (np.array([[1.0, 2.0]]), [[1.0, 2.0]]),
        (np.float64(0.5), 0.5),
        (np.int64(7), 7),
        ("text", "text"),
        (3, 3),
        (0.25, 0.25),
        (True, True),
        (None, None),
        (Path("a/b"), "a/b"),
        (Point, str(Point)),
    ],
)
def test_each_kind_of_value_is_kept_as_json_can_keep_it(value: Any, kept: Any) -> None:
    assert plain(value) == kept
    assert type(plain(value)) is type(kept)
    assert json.loads(to_json({"value": value})) == {"value": kept}


def test_keys_are_sorted_and_what_is_no_mapping_is_kept_too() -> None:
    assert to_json({"b": 1, "a": [2]}) == '{"a": [2], "b": 1}'
    assert to_json(Point(1.5)) == '{"on": null, "x_mm": 1.5}'
    assert to_json(Aliased(mass=2.5)) == '{"mass_mg": 2.5, "path": "a/b"}'


def test_what_is_no_number_is_kept_by_its_name_wherever_it_stands() -> None:
    value = {"b": [math.nan, 1.5, {"c": -math.inf}], "a": math.inf, "d": DISH, "e": 2.0, "f": "nan"}
    assert json.loads(to_json(value)) == {
        "a": "inf",
        "b": ["nan", 1.5, {"c": "-inf"}],
        "d": "dish (petri_dish)",
        "e": 2.0,
        "f": "nan",
    }
    assert to_json(value).startswith('{"a"'), "sorted all the same"
    assert json.loads(to_json(Point(math.nan))) == {"x_mm": "nan", "on": None}


# --- the file


@pytest.mark.parametrize(("durable", "synchronous"), [(True, 2), (False, 0)])
def test_a_real_run_is_on_disk_when_a_call_returns_and_a_dry_one_need_not(
    path: Path, durable: bool, synchronous: int
) -> None:
    journal = Journal(path, durable=durable)
    assert journal._store.db.execute("PRAGMA synchronous").fetchone() == (synchronous,)
    assert journal._store.db.execute("PRAGMA journal_mode").fetchone() == ("wal",)
    assert journal._store.db.execute("PRAGMA user_version").fetchone() == (SCHEMA_VERSION,) == (2,)
    journal.close()


def test_every_call_is_committed_when_it_returns(journal: Journal, path: Path) -> None:
    journal.event(SheetSwapped(sheets_used=2))
    assert rows(path, "kind, time_s") == [("sheet", 0.0)], "seen by another connection; no clock runs yet"


def test_a_closed_journal_is_one_file_and_a_discarded_one_none(journal: Journal, path: Path) -> None:
    journal.event(SheetSwapped(sheets_used=2))
    assert len(list(path.parent.iterdir())) == 3
    journal.close()
    assert [file.name for file in path.parent.iterdir()] == ["r.sqlite"]
    Journal(path.with_name("another.sqlite"), durable=False).discard()
    other = Journal(path.with_name("other.sqlite"), durable=False)
    other.event(SheetSwapped(sheets_used=2))
    reader = sqlite3.connect(other.path)  # keeps the write-ahead log
    reader.execute("SELECT * FROM entry").fetchone()
    other.discard()
    assert [file.name for file in path.parent.iterdir()] == ["r.sqlite"]
    reader.close()
    with pytest.raises(sqlite3.ProgrammingError):
        other._store.db.execute("SELECT 1")


def test_a_second_program_goes_on_with_number_and_chain(journal: Journal, path: Path) -> None:
    assert journal.head == GENESIS.hex()
    journal.event(Note("lab.first", {}))
    first = journal.head
    journal.close()
    again = Journal(path, durable=False)
    assert again.head == first
    again.event(Note("lab.second", {}))
    again.close()
    assert rows(path, "seq, kind") == [(1, "lab.first"), (2, "lab.second")]
    with closing(sqlite3.connect(path)) as database:
        assert verify(database, again.head) == verify(database)
        assert verify(database).problem is None
        assert (verify(database).entries, verify(database).head) == (2, again.head)


# --- jobs, actions, and what belongs to them


def test_what_happens_belongs_to_the_job_and_the_action_that_are_under_way(journal: Journal, path: Path) -> None:
    journal.event(Trouble(what="early"))
    journal.job_started(JobStarted(name="a", sample="s", attempt=2, workflow="fill"))
    tare = journal.action_started(ActionStarted(path="fill/0/tare", visit=1, skill="tare", inputs={"mass": 1.0}))
    assert tare == 3
    journal.event(Note("lab.between", {}))
    journal.action = tare
    journal.event(SETTLE)
    journal.event(DOSE)
    journal.action_ended(tare, ActionEnded(outcome="done", code=None, result="dish (petri_dish)"))
    journal.event(Note("lab.after", {}))
    journal.action = tare
    journal.job_ended(JobEnded(outcome="failed", code="hand.no_flow", detail="no powder"))
    assert rows(path) == [
        ("trouble", None, None),
        ("job_started", None, None),
        ("action_started", 2, None),
        ("lab.between", 2, None),
        ("pulse", 2, 3),
        ("dose", 2, 3),
        ("action_ended", 2, 3),
        ("lab.after", 2, None),
        ("job_ended", 2, None),
    ]
    said = payloads(path)
    assert said[1] == {"name": "a", "sample": "s", "attempt": 2, "workflow": "fill"}
    assert said[2] == {"path": "fill/0/tare", "visit": 1, "skill": "tare", "inputs": {"mass": 1.0}}
    assert said[4] == {"kind": "settle", "net_mg": 20.3, "uncertainty_mg": 0.05}, "and nothing of what was not set"
    assert said[5]["dispensed_mg"] == 20.3
    assert said[6] == {"outcome": "done", "code": None, "result": "dish (petri_dish)"}
    assert said[8] == {"outcome": "failed", "code": "hand.no_flow", "detail": "no powder"}


def test_a_new_action_and_a_new_job_begin_with_nothing_of_the_old(journal: Journal, path: Path) -> None:
    journal.job_started(job("a"))
    journal.action = journal.action_started(begun("one"))
    journal.event(DOSE)
    assert journal.so_far.doses == [DOSE]
    journal.action_started(begun("two", "w/1"))
    journal.job_started(job("b"))
    assert journal.so_far.doses == []
    assert rows(path)[-2:] == [("action_started", 1, None), ("job_started", None, None)]


def test_a_job_that_is_resumed_goes_on_as_itself_with_its_dose(journal: Journal, path: Path) -> None:
    journal.action = 99
    journal.job_resumed(5, SoFar([DOSE]))
    assert (journal.job, journal.so_far.doses) == (5, [DOSE])
    journal.event(Note("lab.x", {}))
    assert rows(path) == [("job_resumed", 5, None), ("lab.x", 5, None)]
    assert payloads(path)[0] == {}


def test_the_cells_state_is_written_with_an_actions_begin_and_end_where_it_changed(
    journal: Journal, path: Path
) -> None:
    state = {"cone_mg": 0.0}
    journal.state = lambda: dict(state)
    scoop = journal.action_started(begun("scoop"))
    state["cone_mg"] = 3000.0
    journal.event(Note("lab.scooped", {}))
    journal.action_ended(scoop, DONE)
    move = journal.action_started(begun("move", "w/1"))
    journal.action_ended(move, DONE)
    state["cone_mg"] = 0.0
    journal.action_started(begun("park", "w/2"))
    states = [None if text is None else json.loads(text) for (text,) in rows(path, "state")]
    assert states == [{"cone_mg": 0.0}, None, {"cone_mg": 3000.0}, None, None, {"cone_mg": 0.0}]


@pytest.mark.parametrize(
    "emptied", [Returned(source="a", expected_mg=1.0), Discarded(source="a", expected_mg=1.0, to="w")]
)
def test_a_cone_that_was_emptied_in_mid_action_is_known_to_be_empty(
    journal: Journal, path: Path, emptied: Returned | Discarded
) -> None:
    """It may tip from then on: a run that was killed as it did could not be resumed, as no load is carried so."""
    state = {"cone_mg": 3000.0}
    journal.state = lambda: dict(state)
    journal.action_started(begun("scoop"))
    state["cone_mg"] = 0.0
    journal.event(emptied)
    assert json.loads(rows(path, "state")[-1][0]) == {"cone_mg": 0.0}


def test_the_world_is_kept_before_an_entry_and_listeners_are_told_after_it(journal: Journal, path: Path) -> None:
    order: list[tuple[str, int]] = []
    journal.before_commit = lambda: order.append(("before", len(rows(path))))
    journal.heard = lambda event: order.append((repr(event), len(rows(path))))
    journal.now_s = lambda: 12.5
    swapped, note = SheetSwapped(sheets_used=4), Note("lab.sieved", {"mesh_mm": 0.5})
    journal.event(swapped)
    journal.event(note)
    journal.job_started(job("a"))
    assert order == [("before", 0), (repr(swapped), 1), ("before", 1), (repr(note), 2), ("before", 2)]
    assert rows(path, "time_s") == [(12.5,)] * 3


def test_what_a_dry_run_gathers_at_one_moment_is_written_in_one_piece_and_the_world_kept_once(
    journal: Journal, path: Path
) -> None:
    order: list[tuple[str, int]] = []
    journal.before_commit = lambda: order.append(("before", len(rows(path))))
    journal.heard = lambda event: order.append(("heard", len(rows(path))))
    journal.gathers = True
    journal.event(SheetSwapped(sheets_used=4))
    action = journal.action_started(begun("scoop"))
    time.sleep(2.0 * writer.LOOK_S)  # who looks whether the file is still there takes nothing before the world is kept
    assert (order, rows(path)) == ([], [])
    assert journal.waits(action) is None, "what it does takes time"
    for _ in range(2):
        journal.commit()
        assert order == [("before", 0), ("heard", 2)]
    journal.event(SheetSwapped(sheets_used=5))
    journal.close()
    assert order[2:] == [("before", 2), ("heard", 3)]


# --- readings


def reading(number: int) -> Reading:
    return Reading(9000.0 + number, number % 2 == 0, 1.23456 + number, "g", b"S S 9.00%d g\xff\r\n" % number)


def test_readings_are_kept_only_while_an_action_weighs_and_belong_to_it(journal: Journal, path: Path) -> None:
    journal.weighed(reading(0))
    still = journal.action_started(begun("move"))
    journal.weighed(reading(1))
    journal.action_ended(still, DONE)
    action = journal.action_started(begun("dispense", "w/1"), weighs=True)
    journal.weighed(reading(2))
    journal.weighed(reading(3))
    journal.action_ended(action, DONE)
    journal.weighed(reading(4))
    journal.flush()
    assert [row for row in rows(path) if row[0] == "frames"] == [("frames", None, action)]
    (frames,) = [frames for (frames,) in rows(path, "frames") if frames is not None]
    assert json.loads(zlib.decompress(frames)) == [
        [3.2346, "S S 9.002 g\xff\r\n", 9002.0, "g", True],
        [4.2346, "S S 9.003 g\xff\r\n", 9003.0, "g", False],
    ]
    assert [said for said in payloads(path) if "readings" in said] == [{"readings": 2}]
    kinds = [kind for kind, *_ in rows(path)]
    assert kinds.index("frames") < len(kinds) - 1, "before the action's end"


def test_readings_wait_for_half_a_second_and_are_written_once(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = 100.0
    monkeypatch.setattr(writer.time, "monotonic", lambda: now_s)
    journal = Journal(path, durable=False)
    journal.action_started(begun("dispense"), weighs=True)
    journal.weighed(reading(0))
    journal.flush()
    now_s = 100.49
    journal.weighed(reading(1))
    journal.flush(FLUSH_S)
    assert len(rows(path)) == 2, "not yet"
    now_s = 100.5
    journal.flush(FLUSH_S)
    assert len(rows(path)) == 3
    journal.flush()
    assert len(rows(path)) == 3, "nothing waits any more"
    journal.close()


def test_of_two_that_weigh_the_later_one_has_the_readings_until_it_ends(journal: Journal, path: Path) -> None:
    first = journal.action_started(begun("watch"), weighs=True)
    second = journal.action_started(begun("dispense", "w/1"), weighs=True)
    journal.weighed(reading(0))
    journal.action_ended(second, DONE)
    journal.weighed(reading(1))
    journal.action_ended(first, DONE)
    assert [action for kind, _, action in rows(path) if kind == "frames"] == [second, first]


# --- a journal that is lost


def test_a_lost_journal_says_so_once_and_what_is_told_to_it_then_is_kept_elsewhere(
    journal: Journal, path: Path
) -> None:
    journal.event(SheetSwapped(sheets_used=2))
    head = journal.head
    assert journal.kept_in == path
    journal._store.db.execute("PRAGMA query_only=ON")  # as a full disk
    with pytest.raises(RecordLost, match=r"r\.sqlite cannot be written any more"):
        journal.event(SheetSwapped(sheets_used=2))
    journal.before_commit = lambda: pytest.fail("nothing is kept any more")
    assert journal.action_started(begun("park")) == 3
    journal.close()
    assert len(rows(path)) == 1
    rescued = journal.kept_in
    assert rescued is not None
    assert (rescued.parent.parent, rescued.name) == (path.parent.parent, path.name)
    assert rows(rescued, "seq, kind") == [(1, "sheet"), (2, "sheet"), (3, "action_started")]
    with closing(sqlite3.connect(path)) as database:
        assert database.execute("PRAGMA journal_mode").fetchone() == ("delete",), "one file again"
    for file, last in ((path, head), (rescued, journal.head)):
        with closing(sqlite3.connect(file)) as database:
            assert verify(database, last).problem is None


def test_what_can_be_kept_nowhere_is_said_to_be_and_the_cell_can_still_be_made_safe(
    journal: Journal, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    journal.event(SheetSwapped(sheets_used=2))

    def full(**where: Any) -> str:
        raise OSError("No space left on device")

    monkeypatch.setattr(store, "mkdtemp", full)
    path.unlink()
    with pytest.raises(RecordLost, match=r"it was taken away; what happens now is kept nowhere"):
        journal.event(SheetSwapped(sheets_used=2))
    journal.event(SheetSwapped(sheets_used=3))
    assert journal.kept_in is None


# --- the chain


def test_an_entrys_hash_is_over_the_one_before_and_all_of_its_own_values() -> None:
    entry = Entry(1, "pulse", 2, None, 1.5, "2026-01-01T00:00:00+00:00", '{"a": 1}', None, b"raw")
    others = [
        entry._replace(**{name: value})
        for name, value in {
            "seq": 2,
            "kind": "dose",
            "job": 3,
            "action": 2,
            "time_s": 1.25,
            "at": "",
            "payload": "{}",
            "state": "{}",
            "frames": None,
        }.items()
    ]
    hashes = {digest(GENESIS, one) for one in [entry, *others, entry._replace(frames=b"")]}
    assert len(hashes) == 11
    assert digest(b"another", entry) not in hashes


def test_the_hash_of_a_known_entry_stays_what_it_is() -> None:
    """Journals of years ago are checked by it."""
    entry = Entry(1, "run", None, None, 0.0, "2026-01-01T00:00:00.000+00:00", '{"ü": 1}', None, None)
    assert digest(GENESIS, entry).hex() == "87bf6e3a3b9fd1d62f940d5b94474378df4106cc8b9ad4dae72366288510d8b6"
    assert (
        digest(GENESIS, entry._replace(frames=b"\x00\x01")).hex()
        == "b052f286880bc5395610e35bbb5ed62076f5437bce03a9a8abe8c45c37340746"
    )


def test_a_value_of_a_kind_that_no_journal_has_is_an_alteration() -> None:
    with closing(sqlite3.connect(":memory:")) as database:
        database.execute(f"CREATE TABLE entry ({', '.join([*Entry._fields, 'hash'])})")
        entry = Entry(1, "run", None, None, 0.0, "at", "{}", None, None)
        database.execute(f"INSERT INTO entry VALUES ({', '.join('?' * 10)})", (*entry, digest(GENESIS, entry)))
        assert verify(database).problem is None
        database.execute("UPDATE entry SET payload = x'7b7d'")
        assert verify(database).problem == "entry 1 (run, at) was altered"


def test_a_program_that_closes_no_journal_ends_all_the_same(tmp_path: Path) -> None:
    forgets = "import sys, pathlib, scuhand_bt.journal.writer as w; w.Journal(pathlib.Path(sys.argv[1]), durable=False)"
    told = [sys.executable, "-c", forgets, str(tmp_path / "a.sqlite")]
    assert subprocess.run(told, timeout=30, check=False).returncode == 0
