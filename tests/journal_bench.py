"""Journals for tests: a small run of today, one of version 1, and what tampers with them."""

import json
import sqlite3
from contextlib import closing
from pathlib import Path

from scuhand_bt.devices.interfaces import Reading
from scuhand_bt.events.doses import Dose, Pulsed
from scuhand_bt.events.weighings import Tared
from scuhand_bt.journal.events import ActionEnded, ActionStarted, JobEnded, JobStarted
from scuhand_bt.journal.reader import open_contents
from scuhand_bt.journal.results import SampleResult
from scuhand_bt.journal.run_events import Ended, RunBegun
from scuhand_bt.journal.writer import Journal

STARTED = "2026-05-04T08:00:00+02:00"
HEADER = {
    "run": "r", "recipe": "two", "recipe_hash": "0" * 64, "recipe_path": "two.yaml", "mode": "SIMULATED", "seed": 3,
    "simulated": True, "plant": None, "controller": "paper", "version": "0.1.0", "cell": "starter", "started": STARTED,
}  # fmt: skip
DOSE = Dose(
    target_mg=20.0, tolerance_mg=2.0, dispensed_mg=20.3, uncertainty_mg=0.05, pulses=3, vibration_s=1.5,
    duration_s=30.0, controller="paper", verdict="in tolerance",
)  # fmt: skip
RESULT = {
    "id": "a", "container": "xrd_holder", "target_mg": 20.0, "dispensed_mg": 20.3, "error_mg": 0.3,
    "uncertainty_mg": 0.05, "tolerance_mg": 2.0, "pulses": 3, "scoops": 1, "vibration_s": 1.5, "duration_s": 30.0,
    "controller": "paper", "verdict": "in tolerance", "code": None, "detail": None, "true_mg": 20.2, "attempt": 1,
}  # fmt: skip


def write_run(path: Path) -> Journal:
    """A small run, still open."""
    journal = Journal(path, durable=False)
    now_s = iter(range(1000))
    journal.now_s = lambda: float(next(now_s))
    journal.event(RunBegun.model_validate(HEADER))
    journal.job_started(JobStarted(name="a", sample="a", attempt=1, workflow="fill_xrd_holder"))
    tare = journal.action_started(ActionStarted(path="fill/0/tare", visit=1, skill="tare", inputs={}))
    journal.action = tare
    journal.event(Tared(gross_mg=9200.0))
    journal.action_ended(tare, ActionEnded(outcome="done", code=None, result=9200.0))
    dispense = journal.action_started(
        ActionStarted(path="fill/1/dispense", visit=1, skill="dispense", inputs={"mass": 20.0}), weighs=True
    )
    journal.weighed(Reading(9201.5, False, 4.1, "g", b"S D     9.2015 g\r\n"))
    journal.weighed(Reading(9202.5, True, 4.2, "g", b"S S     9.2025 g\r\n"))
    journal.flush()
    journal.action = dispense
    journal.event(Pulsed(kind="settle", net_mg=20.3, uncertainty_mg=0.05))
    journal.event(DOSE)
    failed = ActionEnded(outcome="failed", code="hand.no_flow", result={"detail": "no powder comes"})
    journal.action_ended(dispense, failed)
    journal.job_ended(JobEnded(outcome="done"))
    journal.event(SampleResult.model_validate(RESULT))
    journal.event(Ended(exit_code=0, reason="", complete=True))
    return journal


def problem_of(path: Path, head: str | None = None) -> str | None:
    with open_contents(path, head) as contents:
        return contents.verified.problem


def tamper(run: Path, *statements: str) -> None:
    """What somebody does who knows SQLite."""
    with closing(sqlite3.connect(run, isolation_level=None)) as database:
        database.executescript("DROP TRIGGER entries_stay; DROP TRIGGER entries_last;")
        for statement in statements:
            database.execute(statement)


VERSION_1 = """
CREATE TABLE run (key TEXT PRIMARY KEY, value TEXT NOT NULL) STRICT;
CREATE TABLE job (
    id INTEGER PRIMARY KEY, name TEXT NOT NULL, sample TEXT, attempt INTEGER NOT NULL, workflow TEXT NOT NULL,
    started_s REAL NOT NULL, ended_s REAL, outcome TEXT, code TEXT, detail TEXT) STRICT;
CREATE TABLE action (
    id INTEGER PRIMARY KEY, job INTEGER NOT NULL REFERENCES job(id), path TEXT NOT NULL, visit INTEGER NOT NULL,
    skill TEXT NOT NULL, inputs TEXT NOT NULL, started_s REAL NOT NULL, ended_s REAL, outcome TEXT NOT NULL,
    code TEXT, result TEXT) STRICT;
CREATE TABLE pulse (
    id INTEGER PRIMARY KEY, action INTEGER REFERENCES action(id), time_s REAL NOT NULL, payload TEXT NOT NULL) STRICT;
CREATE TABLE dose (
    id INTEGER PRIMARY KEY, job INTEGER NOT NULL REFERENCES job(id), time_s REAL NOT NULL,
    payload TEXT NOT NULL) STRICT;
CREATE TABLE event (
    id INTEGER PRIMARY KEY, action INTEGER REFERENCES action(id), time_s REAL NOT NULL, kind TEXT NOT NULL,
    payload TEXT NOT NULL) STRICT;
PRAGMA user_version=1;
"""


def write_version_1(path: Path) -> None:
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        database.executescript(VERSION_1)
        header = {**HEADER, "plant": "null", "seed": "3", "simulated": "true", "libraries": '{"numpy": "2.0"}'}
        database.executemany("INSERT INTO run VALUES (?, ?)", header.items())
        database.execute("INSERT INTO job VALUES (1, 'a', 'a', 1, 'fill', 0.0, 40.0, 'done', NULL, NULL)")
        database.execute("INSERT INTO job VALUES (2, 'b', 'b', 1, 'fill', 40.0, NULL, NULL, NULL, NULL)")
        actions = [
            (1, 1, "fill/0/tare", 1, "tare", "{}", 0.0, 4.0, "done", None, "9200.0"),
            (2, 1, "fill/1/dispense", 1, "dispense", '{"mass": 20.0}', 4.0, 40.0, "failed", "hand.no_flow", None),
            (3, 2, "fill/0/tare", 1, "tare", "{}", 40.0, None, "started", None, None),
        ]
        database.executemany("INSERT INTO action VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)", actions)
        pulse = json.dumps({"kind": "settle", "net_mg": 20.3, "uncertainty_mg": 0.05})
        database.execute("INSERT INTO pulse VALUES (1, 2, 39.0, ?)", (pulse,))
        database.execute("INSERT INTO dose VALUES (1, 1, 40.0, ?)", (DOSE.model_dump_json(by_alias=False),))
        points = {"points": [[4.0, 0.0, 0.0, 0.0, False, 0.0], [39.0, 20.3, 0.5, 0.5, True, 20.3]]}
        events = [
            (1, 1, 4.0, "tare", '{"gross_mg": 9200.0}'),
            (2, 2, 40.0, "dose_curve", json.dumps(points)),
            (3, 2, 40.0, "sample", json.dumps(RESULT)),
        ]
        database.executemany("INSERT INTO event VALUES (?, ?, ?, ?, ?)", events)
