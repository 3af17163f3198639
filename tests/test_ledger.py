"""The lab's ledger, and what `verify` says is proven of a journal."""

import hashlib
import json
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
from conftest import Call
from journal_bench import tamper
from running import Ran, dry_run

from scuhand_bt.journal.hash_chain import COLUMNS, GENESIS, Entry, digest
from scuhand_bt.lab_state import ledger as of_ledger
from scuhand_bt.lab_state.ledger import KEY_VARIABLE, Ledger
from scuhand_bt.problems import SourceError

DOSE = """
recipe: one
workflow: fill_xrd_holder
defaults: {container: xrd_holder, source: beads}
samples: [{id: a, mass: 30 mg}]
"""


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> Ran:
    """A run, and another after it in the same lab."""
    folder = tmp_path_factory.mktemp("ran")
    ran = dry_run(folder, DOSE)
    dry_run(folder, DOSE, seed=1)
    return ran


@pytest.fixture
def runs(first: Ran, tmp_path: Path) -> Path:
    """A copy of those runs' state: `runs` and `lab.db`."""
    state = tmp_path / "state"
    state.mkdir()
    shutil.copytree(first.journal.parent, state / "runs")
    shutil.copy(first.journal.parent.parent / "lab.db", state)
    return state / "runs"


def rehash(journal: Path) -> None:
    """Make a whole chain of whatever is in a journal, as who knows how it is made would."""
    before = GENESIS
    with closing(sqlite3.connect(journal, isolation_level=None)) as database:
        for row in database.execute(f"SELECT {COLUMNS} FROM entry ORDER BY seq").fetchall():
            before = digest(before, Entry(*row))
            database.execute("UPDATE entry SET hash = ? WHERE seq = ?", (before, row[0]))


def head_of(journal: Path) -> tuple[int, str]:
    with closing(sqlite3.connect(journal)) as database:
        seq, head = database.execute("SELECT seq, hash FROM entry ORDER BY seq DESC LIMIT 1").fetchone()
    return seq, head.hex()


def forge(journal: Path, change: str = "UPDATE entry SET at = '2020' || substr(at, 5)") -> None:
    """Change a journal, and let its chain be whole."""
    tamper(journal, change)
    rehash(journal)


def forge_ledger(state: Path, run: str, journal: Path) -> None:
    """Write the ledger anew, so that it has a forged journal's heads."""
    with closing(sqlite3.connect(journal)) as database:
        hashes = dict(database.execute("SELECT seq, hash FROM entry"))
    before = of_ledger.GENESIS
    with closing(sqlite3.connect(state / "lab.db", isolation_level=None)) as database:
        query = "SELECT number, at, run, occasion, entries, head, key FROM ledger ORDER BY number"
        for number, *rest in database.execute(query).fetchall():
            line = [number, *rest]
            if line[2] == run:
                line[5] = hashes[line[4]].hex()
            before = hashlib.sha256((before + json.dumps(line, separators=(",", ":"))).encode()).hexdigest()
            database.execute("UPDATE ledger SET head = ?, hash = ? WHERE number = ?", (line[5], before, number))


def journals(runs: Path) -> list[Path]:
    """In the order in which they began."""
    found = {line.line.run: None for line in Ledger(runs.parent).verified().kept}
    return [runs / f"{run}.sqlite" for run in found]


def test_a_run_is_in_the_ledger_when_it_begins_and_when_it_ends_and_says_so(first: Ran, command: Call) -> None:
    found = Ledger(first.journal.parent.parent).verified()
    of_run = [one.line for one in found.of(first.session.run_id)]
    assert [line.occasion for line in of_run] == ["begun", "ended"]
    assert (of_run[-1].entries, of_run[-1].head) == head_of(first.journal)
    assert of_run[0].entries >= 1
    code, out, err = command("verify", first.journal)
    assert (code, err) == (0, "")
    proven, _, not_proven = out.partition("Not proven:")
    assert f"whole, head {found.head}) has its head" in proven
    assert "could have written a whole other chain, ledger and later runs" in not_proven


def test_a_journal_that_was_written_anew_with_a_whole_chain_is_noticed(runs: Path, command: Call) -> None:
    journal = journals(runs)[0]
    forge(journal, "UPDATE entry SET payload = replace(payload, 'a', 'b') WHERE kind = 'sample'")
    code, out, err = command("verify", journal)
    assert (code, out) == (3, "")
    assert "it was written anew" in err


def test_entries_cut_off_at_the_end_are_noticed_without_a_noted_head(runs: Path, command: Call) -> None:
    journal = journals(runs)[0]
    last, _ = head_of(journal)
    tamper(journal, f"DELETE FROM entry WHERE seq >= {last - 1}")
    code, _, err = command("verify", journal)
    assert code == 3
    assert "those at its end are missing" in err


def test_entries_added_after_the_end_are_told(runs: Path, command: Call) -> None:
    journal = journals(runs)[0]
    last, _ = head_of(journal)
    tamper(journal, f"INSERT INTO entry SELECT {last + 1}, 'paused', job, action, time_s, at, '{{}}', NULL, NULL, hash"
           f" FROM entry WHERE seq = {last}")  # fmt: skip
    rehash(journal)
    code, out, _ = command("verify", journal)
    assert code == 0
    assert "The last entry is not in the ledger" in out.partition("Not proven:")[2]


def test_an_altered_ledger_proves_nothing_and_is_told(runs: Path, command: Call) -> None:
    journal = journals(runs)[0]
    forge(journal)
    with closing(sqlite3.connect(runs.parent / "lab.db", isolation_level=None)) as database:
        database.execute("UPDATE ledger SET head = ? WHERE number = 2", (head_of(journal)[1],))
    for words in (("verify", journal), ("verify", journals(runs)[0])):
        code, _, err = command(*words)
        assert code == 3
        assert "line 2 (" in err
        assert "was altered" in err


def test_a_ledger_written_anew_is_shown_by_a_later_run_and_by_a_noted_head(runs: Path, command: Call) -> None:
    noted = Ledger(runs.parent).verified().head
    forged, later = journals(runs)
    forge(forged)
    forge_ledger(runs.parent, forged.stem, forged)
    assert command("verify", forged)[0] == 0  # which says what it does not prove
    code, _, err = command("verify", later)
    assert code == 3
    assert "the lab's ledger was written anew" in err
    assert not Ledger(runs.parent).verified().holds(noted)


def test_a_journal_apart_from_its_lab_is_proven_by_itself_alone(runs: Path, tmp_path: Path, command: Call) -> None:
    folder = tmp_path / "mail" / "attached"
    folder.mkdir(parents=True)
    journal = Path(shutil.copy(journals(runs)[0], folder))
    code, out, _ = command("verify", journal)
    assert code == 0
    assert "no line about it" in out.partition("Not proven:")[2]
    head = head_of(journal)[1]
    assert "nothing was altered, added or cut off since" in command("verify", journal, "--head", head)[1]


def test_verify_says_the_same_as_json(runs: Path, command: Call) -> None:
    told = json.loads(command("verify", journals(runs)[0], "--json")[1])
    assert told["problem"] is None
    assert len(told["proven"]) == 2
    assert len(told["open"]) == 2


def test_the_ledgers_head_can_be_noted_and_held_against_it(tmp_path: Path, command: Call) -> None:
    lab = tmp_path / "lab"
    assert command("init", lab)[0] == 0
    state = lab / ".scuhand"
    for number in range(3):
        Ledger(state).add(f"r{number}", "begun", 1, "0" * 64, durable=False)
    noted = Ledger(state).verified().head
    Ledger(state).add("r4", "begun", 1, "0" * 64, durable=False)
    code, out, _ = command("ledger", "--lab", lab, "--head", noted)
    assert code == 0
    assert "contains the head that you noted" in out
    assert command("ledger", "--lab", lab, "--head", "1" * 64)[0] == 3
    assert [line["run"] for line in json.loads(command("ledger", "--lab", lab, "--json")[1])["lines"]][-1] == "r4"
    with closing(sqlite3.connect(state / "lab.db", isolation_level=None)) as database:
        database.execute("DELETE FROM ledger WHERE number = 2")
    code, _, err = command("ledger", "--lab", lab)
    assert code == 3
    assert "line 2 is missing" in err


def test_a_signed_run_is_proven_by_the_key_and_nobody_else_can_write_it(
    tmp_path: Path, command: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("cryptography")
    keys = []
    for name in ("lab.key", "other.key"):
        code, out, _ = command("ledger", "--new-key", tmp_path / name)
        assert code == 0
        keys.append(out.split()[2])
    assert (tmp_path / "lab.key").stat().st_mode & 0o077 == 0
    assert command("ledger", "--new-key", tmp_path / "lab.key")[0] == 2
    monkeypatch.setenv(KEY_VARIABLE, str(tmp_path / "lab.key"))
    ran = dry_run(tmp_path, DOSE)
    code, out, _ = command("verify", ran.journal, "--key", keys[0])
    assert code == 0
    assert "is signed with this key" in out
    assert command("verify", ran.journal, "--key", keys[1])[0] == 3

    forge(ran.journal)
    forge_ledger(ran.journal.parent.parent, ran.journal.stem, ran.journal)
    code, _, err = command("verify", ran.journal, "--key", keys[0])
    assert code == 3
    assert "is not signed with this key" in err


def test_a_key_that_cannot_be_used_stops_before_anything_moves(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("cryptography")
    (tmp_path / "key").write_text("not a key", encoding="utf-8")
    monkeypatch.setenv(KEY_VARIABLE, str(tmp_path / "key"))
    with pytest.raises(SourceError, match="not a signing key"):
        dry_run(tmp_path, DOSE)
    assert not list(tmp_path.glob("runs/*.sqlite"))
