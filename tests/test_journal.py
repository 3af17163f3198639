"""The journal: what is written is there, chained, and found to be altered if it was; old ones are read."""

import json
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from journal_bench import HEADER, RESULT, problem_of, tamper, write_run, write_version_1

from harness.damaged_journals import Judge, mutations
from scuhand_bt.journal.events import ActionStarted, JobStarted
from scuhand_bt.journal.export import canonical
from scuhand_bt.journal.hash_chain import COLUMNS
from scuhand_bt.journal.history import read_history
from scuhand_bt.journal.reader import open_contents, open_journal, read
from scuhand_bt.journal.run_events import Paused, Resumed, RunBegun
from scuhand_bt.journal.store import SCHEMA_VERSION
from scuhand_bt.journal.writer import Journal
from scuhand_bt.problems import SourceError
from scuhand_bt.record import RecordLost
from scuhand_bt.run.resume import checked_history


@pytest.fixture
def run(tmp_path: Path) -> Path:
    journal = write_run(tmp_path / "r.sqlite")
    journal.close()
    return journal.path


def test_what_is_written_is_read_back_in_order(run: Path) -> None:
    kinds = [row["kind"] for row in read(run, "entry")]
    assert kinds[:3] == ["run", "job_started", "action_started"]
    assert [row["skill"] for row in read(run, "action")] == ["tare", "dispense"]
    assert [(row["outcome"], row["code"]) for row in read(run, "action")] == [
        ("done", None),
        ("failed", "hand.no_flow"),
    ]
    assert read(run, "action")[1]["result"] == {"detail": "no powder comes"}
    assert read(run, "dose")[0]["payload"]["dispensed_mg"] == 20.3
    assert {row["key"]: row["value"] for row in read(run, "run")}["simulated"] == "true"


def test_a_killed_program_leaves_an_action_started(tmp_path: Path) -> None:
    journal = Journal(tmp_path / "r.sqlite", durable=False)
    journal.event(RunBegun.model_validate(HEADER))
    journal.job_started(JobStarted(name="a", sample="a", attempt=1, workflow="w"))
    journal.action_started(ActionStarted(path="w/0/tare", visit=1, skill="tare", inputs={}))
    history = read_history(journal.path)  # while the program still has it
    journal.close()
    assert history.jobs["a", 1].actions["w/0/tare", 1].outcome == "started"
    assert history.ended is None


def test_entries_can_be_neither_changed_nor_taken_away(run: Path) -> None:
    with closing(sqlite3.connect(run)) as database:
        for statement in ("UPDATE entry SET time_s = 0", "DELETE FROM entry"):
            with pytest.raises(sqlite3.IntegrityError, match="only added"):
                database.execute(statement)


def test_a_whole_journal_is_whole_and_its_head_is_what_the_run_printed(tmp_path: Path) -> None:
    journal = write_run(tmp_path / "r.sqlite")
    journal.close()
    assert problem_of(journal.path, journal.head) is None
    assert "it is another run" in (problem_of(journal.path, "0" * 64) or "")


def test_a_journal_goes_on_where_another_program_left_it(run: Path) -> None:
    journal = Journal(run, durable=False)
    journal.event(Resumed(last_at="", changes=[], version=""))
    journal.close()
    assert problem_of(run, journal.head) is None


@pytest.mark.parametrize(
    ("change", "found"),
    [
        ("UPDATE entry SET payload = replace(payload, '20.3', '20.0') WHERE kind = 'dose'", "(dose,"),
        ("UPDATE entry SET at = '2020-01-01T00:00:00+00:00' WHERE seq = 3", "entry 3 "),
        ("UPDATE entry SET time_s = time_s + 1 WHERE seq = 5", "entry 5 "),
        ("UPDATE entry SET kind = 'note' WHERE seq = 5", "entry 5 "),
        ("UPDATE entry SET job = NULL WHERE seq = 5", "entry 5 "),
        ("UPDATE entry SET action = 2 WHERE seq = 5", "entry 5 "),
        ("UPDATE entry SET state = '{}' WHERE seq = 5", "entry 5 "),
        ("UPDATE entry SET frames = zeroblob(9) WHERE frames IS NOT NULL", "(frames,"),
        ("UPDATE entry SET hash = zeroblob(32) WHERE seq = 4", "entry 4 "),
        ("DELETE FROM entry WHERE seq = 6", "entry 6 is missing"),
        ("DELETE FROM entry WHERE seq = 1", "entry 1 is missing"),
        ("DELETE FROM entry", "there is no entry"),
        ("UPDATE entry SET seq = seq + 1000 WHERE seq > 7", "entry 8 is missing"),
        ("INSERT INTO entry SELECT 0, kind, job, action, time_s, at, payload, state, frames, hash FROM entry "
         "WHERE seq = 3", "entry 0 is out of place"),
    ],
)  # fmt: skip
def test_every_change_is_found_and_says_where(run: Path, change: str, found: str) -> None:
    tamper(run, change)
    assert found in (problem_of(run) or "")
    with pytest.raises(SourceError, match=r"not as it was written|the journal is empty"):
        checked_history(run)


def test_nothing_after_an_altered_entry_is_believed(run: Path) -> None:
    tamper(run, "UPDATE entry SET payload = replace(payload, '9200', '9300') WHERE kind = 'tare'")
    assert read(run, "dose") == []
    assert [row["kind"] for row in read(run, "entry")] == ["run", "job_started", "action_started"]


def test_only_the_head_tells_of_a_tail_cut_off(tmp_path: Path) -> None:
    journal = write_run(tmp_path / "r.sqlite")
    journal.close()
    tamper(journal.path, "DELETE FROM entry WHERE kind = 'ended'")
    assert problem_of(journal.path) is None
    assert "are missing" in (problem_of(journal.path, journal.head) or "")


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_value_of_any_entry_may_change_and_it_is_found(tmp_path: Path, data: st.DataObject) -> None:
    journal = write_run(tmp_path / "any.sqlite")
    journal.close()
    try:
        column = data.draw(st.sampled_from([*COLUMNS.split(", ")[1:], "hash"]))
        seq = data.draw(st.integers(1, len(read(journal.path, "entry"))))
        value: Any = data.draw(
            {"hash": st.binary(), "frames": st.binary(), "time_s": st.floats(-1e9, 1e9)}.get(
                column, st.integers(0, 99) if column in ("job", "action") else st.text(st.characters(codec="utf-8"))
            )
        )
        with closing(sqlite3.connect(journal.path, isolation_level=None)) as database:
            database.execute("DROP TRIGGER entries_stay")
            before = database.execute(f"SELECT {column} FROM entry WHERE seq = ?", (seq,)).fetchone()[0]
            database.execute(f"UPDATE entry SET {column} = ? WHERE seq = ?", (value, seq))
        assert (problem_of(journal.path) is None) == (value == before)
    finally:
        journal.path.unlink()


def test_damaged_journals_end_in_a_clean_error_or_a_correct_result(run: Path, tmp_path: Path) -> None:
    figures = mutations(run, tmp_path / "damaged", 200)
    assert figures["mutations_broken"] == figures["mutations_unnoticed"] == 0
    assert figures["mutations_found"] > 10
    assert figures["mutations_found_by_the_head"] > 10
    assert figures["mutations_refused"] > 10


def test_the_judge_of_damaged_journals_notices_what_the_chain_would_not(run: Path) -> None:
    judge = Judge(run)
    tamper(run, "DELETE FROM entry WHERE kind = 'ended'")
    assert judge.outcome(run) == "found by the head"


@pytest.mark.parametrize("content", [b"", b"not a database", b"SQLite format 3\0" + bytes(100)])
def test_a_file_that_is_no_journal_is_said_to_be_none(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "x.sqlite"
    path.write_bytes(content)
    with pytest.raises(SourceError, match="not a run's journal"), open_journal(path):
        pass


def test_a_folder_and_nothing_are_no_journals(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "gone.sqlite"):
        with pytest.raises(SourceError, match="no such journal"), open_journal(path):
            pass


def test_a_newer_journal_is_refused(run: Path) -> None:
    with closing(sqlite3.connect(run)) as database:
        database.execute(f"PRAGMA user_version={SCHEMA_VERSION + 1}")
    with pytest.raises(SourceError, match="a newer scuhand-bt wrote it"):
        read(run, "entry")


def test_a_name_with_signs_of_an_address_is_a_name(tmp_path: Path) -> None:
    journal = write_run(tmp_path / "50%?#a b.sqlite")
    journal.close()
    assert problem_of(journal.path, journal.head) is None


def test_reading_changes_nothing(run: Path) -> None:
    before = run.read_bytes()
    canonical(run)
    assert run.read_bytes() == before
    assert [path.name for path in run.parent.iterdir()] == [run.name]


def test_a_lost_journal_says_so_once(tmp_path: Path) -> None:
    journal = write_run(tmp_path / "r.sqlite")
    journal._store.db.execute("PRAGMA query_only=ON")  # as a full disk
    with pytest.raises(RecordLost, match="cannot be written any more"):
        journal.event(Paused())
    journal.event(Paused())
    journal.close()
    assert problem_of(journal.path, None) is None
    assert journal.kept_in is not None
    assert problem_of(journal.kept_in, journal.head) is None


def test_readings_are_written_as_they_came(run: Path) -> None:
    from scuhand_bt.journal.archive import frames

    with open_contents(run) as contents:
        lines = frames(contents, "a")
    assert [line["raw"] for line in lines] == ["S D     9.2015 g\r\n", "S S     9.2025 g\r\n"]
    assert [line["stable"] for line in lines] == [False, True]


@pytest.fixture
def old_run(tmp_path: Path) -> Path:
    write_version_1(tmp_path / "old.sqlite")
    return tmp_path / "old.sqlite"


def test_a_journal_of_version_1_is_read_as_one_of_today_and_not_touched(old_run: Path) -> None:
    before = old_run.read_bytes()
    actions = [(row["skill"], row["started_s"], row["ended_s"], row["outcome"]) for row in read(old_run, "action")]
    assert actions == [("tare", 0.0, 4.0, "done"), ("dispense", 4.0, 40.0, "failed"), ("tare", 40.0, None, "started")]
    assert [(row["name"], row["outcome"]) for row in read(old_run, "job")] == [("a", "done"), ("b", None)]
    export = json.loads(canonical(old_run))
    assert export["run"]["simulated"] == "true"
    assert export["samples"] == [RESULT]
    assert export["pulses"][0]["net_mg"] == 20.3
    kinds = [row["kind"] for row in read(old_run, "entry")]
    assert kinds.index("tare") < kinds.index("action_ended") < kinds.index("pulse") < kinds.index("sample")
    first = read(old_run, "entry")[1]
    assert first["at"].startswith("2026-05-04T08:00:00")
    assert old_run.read_bytes() == before


def test_a_run_of_version_1_is_not_resumed(old_run: Path) -> None:
    with pytest.raises(SourceError, match=r"an older scuhand-bt wrote it.*start a new run"):
        checked_history(old_run)
