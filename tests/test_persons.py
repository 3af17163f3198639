"""Who runs the cell, answers and corrects: by name, signed with a PIN if wished, and told by `audit`."""

import json
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
import typer
from conftest import Call
from journal_bench import HEADER
from running import dry_run, make_lab

from scuhand_bt.cli import persons as commands
from scuhand_bt.journal.events import Answered, Asked
from scuhand_bt.journal.reader import read
from scuhand_bt.journal.run_events import Continued, Ended, Paused, Resumed, RunBegun, Trouble
from scuhand_bt.journal.writer import Journal
from scuhand_bt.lab_state.persons import Persons, person_name
from scuhand_bt.run import operator as of_operator
from scuhand_bt.run.clock import WallClock
from scuhand_bt.run.operator import Person, PersonOperator
from scuhand_bt.run.questions import Questions

DOSE = """
recipe: one
workflow: fill_xrd_holder
defaults: {container: xrd_holder, source: beads}
samples: [{id: a, mass: 30 mg}]
"""


class Typed:
    """A person at a terminal, who types these."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *lines: str, hidden: tuple[str, ...] = ()) -> None:
        self._lines, self._hidden = iter(lines), iter(hidden)
        monkeypatch.setattr("sys.stdin", self)
        monkeypatch.setattr(of_operator, "getpass", lambda prompt: next(self._hidden))
        monkeypatch.setattr(typer, "prompt", self._prompted)

    def isatty(self) -> bool:
        return True

    def readline(self) -> str:
        return next(self._lines) + "\n"

    def _prompted(self, text: str, hide_input: bool = False, confirmation_prompt: bool = False) -> str:
        return next(self._hidden if hide_input else self._lines)


def ask(person: Person, choices: tuple[str, ...] = ("done", "stop")) -> tuple[str, list[Asked | Answered | Trouble]]:
    """What a person at a terminal answers, and what the journal is told."""
    told: list[Asked | Answered | Trouble] = []
    clock = WallClock()
    operator = PersonOperator(clock, told.append, person, Questions())
    steps = operator.ask("Is it?", choices)
    while True:
        try:
            clock.wait([next(steps)])
        except StopIteration as done:
            return done.value, told


def test_an_answer_carries_the_name_of_who_gave_it(monkeypatch: pytest.MonkeyPatch) -> None:
    Typed(monkeypatch, "what?", "DONE")
    answer, told = ask(Person("Eve"))
    assert answer == "done"
    assert told[-1] == Answered(question="Is it?", answer="done", by="Eve", signed=False)


def test_who_has_a_pin_signs_every_answer_with_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    persons = Persons(tmp_path)
    persons.enrol("Eve", "271828")
    Typed(monkeypatch, "done", "done", hidden=("314159", "271828"))
    answer, told = ask(Person("Eve", lambda pin: persons.is_pin("Eve", pin)))
    assert [one for one in told if isinstance(one, Answered)] == [
        Answered(question="Is it?", answer="done", by="Eve", signed=True)
    ]
    assert answer == "done"
    assert "That is not the PIN." in capsys.readouterr().out
    (noted,) = (one for one in told if isinstance(one, Trouble))
    assert noted.what == "a wrong PIN was given for Eve, to answer 'done': Is it?"


@pytest.mark.slow
def test_the_run_and_its_resumption_have_the_name_that_was_given(tmp_path: Path, command: Call) -> None:
    lab = make_lab(tmp_path / "lab")
    (lab / ".scuhand").mkdir()
    dry_run(lab / ".scuhand", DOSE, lab=lab, stop_at=30)
    assert command("resume", "last", "--lab", lab, "--operator", " Eve  Müller")[0] == 0
    (journal,) = (lab / ".scuhand" / "runs").glob("*.sqlite")
    (resumed,) = (event["payload"] for event in read(journal, "event") if event["kind"] == "resumed")
    assert (resumed["operator"], resumed["signed"]) == ("Eve Müller", False)
    trail = json.loads(command("audit", "last", "--lab", lab, "--json")[1])
    assert [deed["who"] for deed in trail if "resumed" in deed["what"]] == ["Eve Müller"]


def test_a_real_run_without_a_name_asks_and_is_refused_where_nobody_can_be_asked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(typer.BadParameter, match="needs the name of the person who runs it"):
        commands.the_person(None, tmp_path, is_asked=True)
    assert commands.the_person(None, tmp_path, is_asked=False) is None
    Typed(monkeypatch, "Eve")
    assert commands.the_person(None, tmp_path, is_asked=True) == Person("Eve")


def test_a_name_with_a_pin_is_nobodys_without_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    Persons(tmp_path).enrol("Eve", "271828")
    with pytest.raises(typer.BadParameter, match="cannot be asked for here"):
        commands.the_person("Eve", tmp_path, is_asked=False)
    Typed(monkeypatch, hidden=("1", "2", "3"))
    with pytest.raises(typer.BadParameter, match="wrong 3 times"):
        commands.the_person("Eve", tmp_path, is_asked=False)
    Typed(monkeypatch, hidden=("1", "271828"))
    person = commands.the_person("Eve", tmp_path, is_asked=False)
    assert person is not None
    assert person.is_pin is not None
    assert person.is_pin("271828")
    assert not person.is_pin("271829")


@pytest.mark.parametrize("name", ["", "  ", "a" * 81, "Eve\x1b[2J", "Eve\u202e"])
def test_a_name_that_cannot_be_read_is_none(name: str) -> None:
    with pytest.raises(ValueError, match="visible characters"):
        person_name(name)


def test_of_a_pin_only_a_salted_hash_is_kept_and_a_new_one_counts(tmp_path: Path) -> None:
    persons = Persons(tmp_path)
    persons.enrol("Eve", "271828")
    persons.enrol("Bob", "271828")
    with closing(sqlite3.connect(tmp_path / "lab.db")) as database:
        rows = database.execute("SELECT salt, hash FROM person").fetchall()
    assert len({salt for salt, _ in rows}) == len({kept for _, kept in rows}) == 2
    assert b"271828" not in (tmp_path / "lab.db").read_bytes()
    persons.enrol("Eve", "1414213")
    assert [persons.is_pin("Eve", pin) for pin in ("271828", "1414213")] == [False, True]
    assert not persons.is_pin("Mallory", "271828")
    with pytest.raises(ValueError, match="at least 6 characters"):
        persons.enrol("Eve", "12345")


def test_a_pin_is_changed_by_who_knows_it(tmp_path: Path, command: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    lab = make_lab(tmp_path / "lab")
    for hidden, code in ((("271828",), 0), (("1", "2", "3"), 2), (("271828", "314159"), 0)):
        Typed(monkeypatch, hidden=hidden)
        assert command("person", "Eve", "--lab", lab)[0] == code
    assert Persons(lab / ".scuhand").is_pin("Eve", "314159")
    assert command("person", "--lab", lab)[1] == "Eve\n"


def test_a_correction_has_a_name_and_a_reason_and_the_lab_tells_of_it(tmp_path: Path, command: Call) -> None:
    lab = make_lab(tmp_path / "lab")
    given = ("mortar_bay", "12 g", "--powder", "glass_beads", "--lab", lab)
    assert command("inventory", "set", *given, "--operator", "Eve", "--reason", "refilled")[0] == 0
    assert command("inventory", "set", "cone", "0 mg", "--lab", lab)[0] == 0
    refilled, emptied = json.loads(command("audit", "--lab", lab, "--json")[1])
    assert (refilled["who"], refilled["why"]) == ("Eve", "refilled")
    assert refilled["what"] == "corrected 'mortar_bay' to 12.0000 g of glass_beads"
    assert emptied["why"] == "no reason given"
    assert "operator Eve, " in command("inventory", "--lab", lab)[1]


def test_the_trail_of_a_run_says_who_did_what_and_what_is_not_known(tmp_path: Path, command: Call) -> None:
    journal = Journal(tmp_path / "r.sqlite", durable=False)
    journal.event(RunBegun.model_validate({**HEADER, "operator": "Eve", "signed": True}))
    journal.event(Asked(question="Is it?", choices=["done", "stop"]))
    journal.event(Answered(question="Is it?", answer="done", by="Eve", signed=True))
    journal.event(Answered(question="Is it?", answer="stop"))
    journal.event(Paused())
    journal.event(Continued(by="Bob"))
    journal.event(Ended(exit_code=130, reason="as was asked for", complete=False, by="Eve", signed=True))
    journal.event(Resumed(last_at="", changes=["the recipe has changed"], version="9", operator="Bob"))
    journal.close()
    trail = json.loads(command("audit", journal.path, "--json")[1])
    assert [(deed["who"], deed["what"].split()[0], deed["entry"]) for deed in trail] == [
        ("Eve (PIN)", "began", 1),
        ("Eve (PIN)", "answered", 3),
        ("not told", "answered", 4),
        ("not told", "paused", 5),
        ("Bob", "let", 6),
        ("Eve (PIN)", "stopped", 7),
        ("Bob", "resumed", 8),
    ]
    assert trail[-1]["why"] == "accepted: the recipe has changed"
    shown = command("show", journal.path)[1]
    assert "answered: done, by Eve, with PIN" in shown
    assert "continued, by Bob" in shown
    assert "ended with exit code 130: as was asked for by Eve, with PIN" in shown
