"""The lab's database: brought up to date, and refused or left alone where it is newer, damaged or held."""

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
from conftest import problems_of
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from scuhand_bt.lab_state.beliefs import LabState
from scuhand_bt.lab_state.inventory import Inventory, StockEntry
from scuhand_bt.lab_state.lab_db import MIGRATIONS, writing_lab_db
from scuhand_bt.problems import SourceError


def learnt_before(folder: Path) -> None:
    """A database as the first version of the schema had it."""
    with closing(sqlite3.connect(folder / "lab.db")) as database, database:
        database.execute(MIGRATIONS[0])
        database.execute("PRAGMA user_version=1")
        belief = '{"coefficient": 70.5, "doses": 3}'
        row = ("powder", "glass_beads/L7", 0, "before", "2026-01-01T00:00:00+00:00", belief)
        database.execute("INSERT INTO learnt (kind, name, simulated, run, at, belief) VALUES (?,?,?,?,?,?)", row)


def test_a_database_of_the_first_schema_is_brought_up_to_date_with_what_it_holds(tmp_path: Path) -> None:
    learnt_before(tmp_path)
    assert LabState(tmp_path).powders(simulated=False)["glass_beads/L7"].belief.doses == 3
    Inventory(tmp_path, "starter").enter(StockEntry("cone", mass_mg=0.0))
    assert set(Inventory(tmp_path, "starter").stock(simulated=False)) == {("cone", "")}
    assert LabState(tmp_path).powders(simulated=False)["glass_beads/L7"].run == "before"


def test_a_migration_that_breaks_leaves_the_database_as_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    learnt_before(tmp_path)
    before = (tmp_path / "lab.db").read_bytes()
    with monkeypatch.context() as patch:
        patch.setattr("scuhand_bt.lab_state.lab_db.MIGRATIONS", (*MIGRATIONS, "CREATE NONSENSE"))
        assert len(problems_of(lambda: LabState(tmp_path).powders(simulated=False))) == 1
    assert (tmp_path / "lab.db").read_bytes() == before
    assert LabState(tmp_path).powders(simulated=False)


def test_a_database_of_a_newer_program_is_refused_and_left_alone(tmp_path: Path) -> None:
    learnt_before(tmp_path)
    with closing(sqlite3.connect(tmp_path / "lab.db")) as database, database:
        database.execute("PRAGMA user_version=99")
    before = (tmp_path / "lab.db").read_bytes()
    with pytest.raises(SourceError, match=r"lab\.db:1:1: .* has the schema 99, and this program knows [0-9]+; a newer"):
        LabState(tmp_path).powders(simulated=False)
    assert (tmp_path / "lab.db").read_bytes() == before


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_a_damaged_database_is_one_clear_problem_or_still_read(tmp_path: Path, data: st.DataObject) -> None:
    for path in tmp_path.glob("lab.db*"):
        path.unlink()
    Inventory(tmp_path, "starter").enter(StockEntry("station", "mortar_bay", "glass_beads", "L7", 5000.0))
    content = bytearray((tmp_path / "lab.db").read_bytes())
    if data.draw(st.booleans()):
        del content[data.draw(st.integers(1, len(content) - 1)) :]
    else:
        content[data.draw(st.integers(0, len(content) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    (tmp_path / "lab.db").write_bytes(content)
    said = problems_of(lambda: Inventory(tmp_path, "starter").stock(simulated=False))
    assert all("the lab's database" in problem for problem in said)


def test_nothing_is_made_by_looking(tmp_path: Path) -> None:
    assert Inventory(tmp_path / "none", "starter").stock(simulated=False) == {}
    assert not (tmp_path / "none").exists()


def test_a_database_that_another_process_holds_is_said_to_be_locked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    Inventory(tmp_path, "starter").enter(StockEntry("cone", mass_mg=0.0))
    with writing_lab_db(tmp_path):
        connect = sqlite3.connect
        monkeypatch.setattr(sqlite3, "connect", lambda path, **more: connect(path, **{**more, "timeout": 0.05}))
        with pytest.raises(SourceError, match="cannot be used: database is locked"):
            Inventory(tmp_path, "starter").enter(StockEntry("cone", mass_mg=0.0))
