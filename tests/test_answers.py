"""Questions to a person are answered from anywhere: the first answer counts, and the journal has who gave it."""

import json
import os
import pwd
import queue
import socket
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest
import typer
from conftest import Call, Ended
from journal_bench import HEADER
from resuming import Run, Watch
from running import make_lab
from test_stopping import as_nobody

from scuhand_bt.journal.archive import summary
from scuhand_bt.journal.events import ActionEnded, ActionStarted, Answered, Asked, JobStarted
from scuhand_bt.journal.follow import Follower
from scuhand_bt.journal.presence import Presence
from scuhand_bt.journal.reader import read
from scuhand_bt.journal.run_events import RunBegun, Trouble
from scuhand_bt.journal.writer import Journal
from scuhand_bt.lab_state.persons import Persons
from scuhand_bt.run import control as control_module
from scuhand_bt.run.batch import ANSWERS
from scuhand_bt.run.clock import WallClock
from scuhand_bt.run.control import HEARD, Control, WishListener, say_answer, say_wish, waiting_question
from scuhand_bt.run.operator import Person, PersonOperator
from scuhand_bt.run.questions import MEANINGS, Given, Questions, Who
from scuhand_bt.run.simulation import DryRun

USER = pwd.getpwuid(os.getuid()).pw_name
RECIPE = """
recipe: asks
workflow: ask
samples: [{id: a}]
"""
ASK = "workflow: ask\ntree: {sequence: [{ask_operator: {question: Is the shield shut?}}, {park: }]}\n"
TWICE = ASK.replace("{park: }", "{ask_operator: {question: Is the shield shut?}}")


class WhenAsked(Watch):
    """Does something once a question waits, in the run's own process, as another one would."""

    def __init__(self, does: Callable[[], object]) -> None:
        super().__init__()
        self._does = does
        self.is_done = False

    def ticked(self, root: Any) -> None:
        super().ticked(root)
        if not self.is_done and self.session.control.questions.waiting is not None:
            self.is_done = True
            self._does()


@pytest.fixture
def run(tmp_path: Path) -> Run:
    run = Run(tmp_path, make_lab(tmp_path / "lab", trees__ask=ASK), RECIPE)
    run.folder = run.lab_folder / ".scuhand" / "runs"
    return run


def go(run: Run, does: Callable[[], object]) -> Any:
    """Run it, asking a person; `does` is done when a question waits."""
    watch = WhenAsked(does)
    result = run.go(watch, simulation=DryRun(asks=True))
    assert watch.is_done
    return result


def told(run: Run, kind: str) -> list[dict[str, Any]]:
    return [{**row["payload"], "time_s": row["time_s"]} for row in read(run.journal, "event") if row["kind"] == kind]


def test_a_question_is_seen_and_answered_from_another_process(run: Run, command: Call) -> None:
    said: list[Ended] = []

    def answer() -> None:
        for arguments in (["runs", "--json"], ["runs"], ["answer", "last"], ["answer", "last", "yes"]):
            said.append(command(*arguments, "--lab", run.lab_folder))
        said.append(command("answer", "last", "done", "--operator", " Eve  Müller", "--lab", run.lab_folder))

    assert go(run, answer).exit_code == 0
    listed, shown, asked, wrong, given = said
    (one,) = json.loads(listed.stdout)
    assert (one["state"], one["reason"]) == ("waiting for a person", "Is the shield shut?")
    assert (datetime.now().astimezone() - datetime.fromisoformat(one["since"])).total_seconds() < 60
    assert "waiting for a person: Is the shield shut? (since " in " ".join(shown.stdout.split())
    assert "Is the shield shut?" in asked.stdout
    assert f"done: {MEANINGS['done']}" in asked.stdout
    assert f"stop: {MEANINGS['stop']}" in asked.stdout
    assert (wrong.returncode, "known: done, stop" in wrong.stderr) == (2, True)
    assert (given.returncode, "goes on with 'done'" in given.stdout) == (0, True)
    (answered,) = told(run, "answered")
    assert (answered["answer"], answered["by"], answered["signed"]) == ("done", "Eve Müller", False)
    assert "complete" in command("runs", "--lab", run.lab_folder).stdout


def test_while_a_dry_run_waits_for_a_person_its_time_is_that_persons(run: Run) -> None:
    said = []

    def soon() -> None:
        timer = threading.Timer(0.5, lambda: said.append(answer_now(run)))
        timer.start()

    go(run, soon)
    assert said == [HEARD]
    (asked,), (answered,) = told(run, "asked"), told(run, "answered")
    assert 0.3 < answered["time_s"] - asked["time_s"] < 20


def answer_now(run: Run, answer: str = "done", name: str | None = None, pin: str | None = None) -> str | None:
    asked = waiting_question(run.journal)
    assert asked is not None
    return say_answer(run.journal, asked, answer, name, pin)


def test_an_answer_that_says_no_more_is_the_users_of_the_computer(run: Run) -> None:
    go(run, lambda: answer_now(run, "stop"))
    (answered,) = told(run, "answered")
    assert (answered["answer"], answered["by"]) == ("stop", USER)


def test_the_first_answer_counts_and_none_is_taken_for_the_next_questions(run: Run, tmp_path: Path) -> None:
    (run.lab_folder / "trees" / "ask.yaml").write_text(TWICE, encoding="utf-8")
    said = []

    def answer() -> None:
        asked = waiting_question(run.journal)
        assert asked is not None
        said.extend(
            say_answer(run.journal, asked, choice, by, None) for choice, by in (("done", "Eve"), ("stop", "Bob"))
        )

        def late() -> None:
            while (now := waiting_question(run.journal)) is None or now == asked:
                pass
            said.append(say_answer(run.journal, asked, "stop", "Bob", None))
            said.append(say_answer(run.journal, now, "done", "Bob", None))

        threading.Thread(target=late).start()

    assert go(run, answer).exit_code == 0
    assert said == [HEARD, "it was answered already", "another question is waiting now", HEARD]
    assert [(one["answer"], one["by"]) for one in told(run, "answered")] == [("done", "Eve"), ("done", "Bob")]


def test_a_question_takes_one_answer() -> None:
    questions = Questions()
    asked = questions.ask("Is it?", ("done", "stop"))
    said = [
        questions.give(asked.number, answer, Who(by))
        for answer, by in (("yes", "Ada"), ("done", "Eve"), ("stop", "Bob"))
    ]
    assert said == ["it is answered with one of: done, stop", None, "it was answered already"]
    assert questions.given() == Given("done", Who("Eve"))


def test_who_has_a_pin_answers_with_it_and_a_wrong_one_is_noted(run: Run) -> None:
    Persons(run.lab_folder / ".scuhand").enrol("Eve", "271828")
    said = []

    def answer() -> None:
        for pin in (None, "314159", "271828"):
            said.append(answer_now(run, "done", "Eve", pin))

    go(run, answer)
    assert said == ["Eve signs with a PIN", "that is not the PIN", HEARD]
    (answered,) = told(run, "answered")
    assert (answered["by"], answered["signed"]) == ("Eve", True)
    (trouble,) = told(run, "trouble")
    assert trouble["what"] == "a wrong PIN was given for Eve, to answer 'done': Is the shield shut?"


def test_what_is_no_name_and_no_answer_comes_into_no_journal(tmp_path: Path) -> None:
    journal, control = tmp_path / "runs" / "r.sqlite", Control()
    asked = control.questions.ask("Is it?", ("done", "stop"))
    listener = WishListener(journal, control)
    for answer, name in (("\ud800", "Eve"), ("done", "\ud800"), ("done", "Eve\x1b[2J"), ("x" * 3000, None)):
        assert say_answer(journal, asked, answer, name, "271828") not in (HEARD, None)
    assert control.questions.take_notes() == []
    assert control.questions.waiting is not None
    assert say_wish(journal, "pause", "\ud800") == HEARD
    assert control.paused_by == Who(USER)
    listener.end()


def test_the_command_asks_for_the_pin_of_who_has_one(run: Run, command: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    Persons(run.lab_folder / ".scuhand").enrol("Eve", "271828")
    monkeypatch.setattr(sys, "stdin", Terminal())
    monkeypatch.setattr(typer, "prompt", lambda text, **options: "271828" if "PIN of Eve" in text else "done")
    go(run, lambda: command("answer", "last", "--operator", "Eve", "--lab", run.lab_folder))
    (answered,) = told(run, "answered")
    assert (answered["answer"], answered["by"], answered["signed"]) == ("done", "Eve", True)


@pytest.mark.skipif(os.getuid() != 0, reason="only root can be somebody else")
def test_another_user_of_the_computer_answers_only_with_a_pin(tmp_path: Path) -> None:
    (tmp_path / "runs").mkdir()
    journal, control = tmp_path / "runs" / "r.sqlite", Control()
    Persons(tmp_path).enrol("Eve", "271828")
    asked = control.questions.ask("Is it?", ("done", "stop"))
    listener = WishListener(journal, control)

    def says(name: str | None, pin: str | None) -> Callable[[], None]:
        def say() -> None:
            said = say_answer(journal, asked, "done", name, pin)
            assert said == HEARD, said

        return say

    assert "only the user who started the run, or a person with a PIN, may answer" in as_nobody(says(None, None))
    assert "only the user who started the run, or a person with a PIN, may answer" in as_nobody(says("Bob", None))
    assert control.questions.waiting is not None
    assert as_nobody(says("Eve", "271828")) == "ok"
    given = control.questions.given()
    assert given is not None
    assert given.who == Who("Eve", signed=True)
    listener.end()


def test_where_no_question_waits_there_is_nothing_to_answer(run: Run, command: Call) -> None:
    run.go(Watch("stop_now", 1), simulation=DryRun(asks=True))
    idle = command("answer", "last", "done", "--lab", run.lab_folder)
    assert (idle.returncode, "it is not running" in idle.stderr) == (2, True)


def test_a_notification_has_the_question_and_its_choices(run: Run, tmp_path: Path) -> None:
    told_of = tmp_path / "told"
    program = tmp_path / "tell"
    program.write_text(f'#!/bin/sh\necho "$(cat)" >> {told_of}\n', encoding="utf-8")
    program.chmod(0o755)
    cell = run.lab_folder / "robot" / "cell.yaml"
    cell.write_text(cell.read_text(encoding="utf-8") + f"\nnotify: {{command: [{program}]}}\n", encoding="utf-8")
    go(run, lambda: answer_now(run))
    notices = [json.loads(line) for line in told_of.read_text(encoding="utf-8").splitlines()]
    (asked,) = (notice for notice in notices if notice["state"] == "needs person")
    assert (asked["reason"], asked["choices"]) == ("Is the shield shut?", ["done", "stop"])


# --- who paused and stopped


def test_who_paused_continued_and_stopped_a_run_is_in_its_journal(run: Run, command: Call) -> None:
    def pauses() -> None:
        command("pause", "last", "--now", "--operator", "Bob", "--lab", run.lab_folder)
        threading.Timer(0.2, continues).start()

    def continues() -> None:
        assert say_wish(run.journal, "continue", "Eve") == HEARD
        while waiting_question(run.journal) is None:
            pass
        assert say_wish(run.journal, "stop_now") == HEARD

    assert go(run, pauses).exit_code == 130
    assert [told(run, kind)[-1]["by"] for kind in ("paused", "continued", "ended")] == ["Bob", "Eve", USER]


def test_a_stop_counts_whatever_becomes_of_its_name(run: Run, command: Call) -> None:
    Persons(run.lab_folder / ".scuhand").enrol("Eve", "271828")
    result = go(run, lambda: command("stop", "last", "--now", "--operator", "Eve", "--lab", run.lab_folder))
    assert result.exit_code == 130
    assert (told(run, "ended")[-1]["by"], told(run, "ended")[-1]["signed"]) == (USER, False)


def test_what_is_wished_at_the_runs_terminal_is_its_operators(run: Run) -> None:
    watch = Watch("stop_now", 1)
    run.go(watch, simulation=DryRun(asks=True), person=Person("Ada"))
    assert told(run, "ended")[-1]["by"] == "Ada"


def test_ten_thousand_callers_who_hang_up_keep_nobody_from_stopping_the_run(tmp_path: Path) -> None:
    journal, control = tmp_path / "r.sqlite", Control()
    listener = WishListener(journal, control)
    said = [b"", b"{", b'{"wish": {}}', b'{"answer": "done", "to": "1", "by": null, "pin": null}', b"[" * 5000, b"\xff"]
    for number in range(10_000):
        with socket.socket(socket.AF_UNIX) as caller:
            caller.connect(control_module.address_of(journal))
            with suppress(OSError):  # it does not listen to the end
                caller.sendall(said[number % len(said)])
    began_s = time.monotonic()
    assert say_wish(journal, "stop_now") == HEARD
    assert time.monotonic() - began_s < 5.0
    assert control.stops_now
    listener.end()


# --- the run's terminal


class Terminal:
    """A terminal whose lines come when the test says."""

    def __init__(self) -> None:
        self.lines: queue.SimpleQueue[str] = queue.SimpleQueue()

    def isatty(self) -> bool:
        return True

    def readline(self) -> str:
        return self.lines.get()


class Asking:
    """A person who is asked one question after the other."""

    def __init__(self) -> None:
        self.told: list[Asked | Answered | Trouble] = []
        self.questions, self._clock = Questions(), WallClock()
        self._operator = PersonOperator(self._clock, self.told.append, Person("Ada"), self.questions)

    def ask(self, does: Callable[[], object]) -> Answered:
        steps = self._operator.ask("Is it?")
        wake = next(steps)
        does()
        while True:
            self._clock.wait([wake])
            try:
                wake = next(steps)
            except StopIteration:
                last = self.told[-1]
                assert isinstance(last, Answered)
                return last


def test_an_answer_from_elsewhere_leaves_the_terminal_to_the_next_question(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal, asking = Terminal(), Asking()
    monkeypatch.setattr(sys, "stdin", terminal)
    first = asking.ask(lambda: asking.questions.give(1, "done", Who("Eve")))
    second = asking.ask(lambda: terminal.lines.put("Stop\n"))
    assert (first.answer, first.by) == ("done", "Eve")
    assert (second.answer, second.by) == ("stop", "Ada")


@pytest.mark.parametrize("is_terminal", [True, False])
def test_a_question_that_nobody_can_answer_by_typing_says_how_to_answer_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], is_terminal: bool
) -> None:
    terminal, asking = Terminal(), Asking()
    monkeypatch.setattr(terminal, "isatty", lambda: is_terminal)
    monkeypatch.setattr(sys, "stdin", terminal)
    asking.ask(lambda: asking.questions.give(1, "done", Who("Eve")))
    told = capsys.readouterr().out
    assert told.startswith("Is it? [done/stop]")
    assert ("`scuhand-bt answer last ANSWER`" in told) is not is_terminal


@pytest.mark.parametrize("gone", ["", OSError("hung up")])
def test_a_question_whose_terminal_has_gone_waits_for_an_answer_from_elsewhere(
    monkeypatch: pytest.MonkeyPatch, gone: str | OSError
) -> None:
    class Gone(Terminal):
        def readline(self) -> str:
            if isinstance(gone, OSError):
                raise gone
            return gone

    monkeypatch.setattr(sys, "stdin", Gone())
    asking = Asking()
    given = asking.ask(lambda: threading.Timer(0.1, lambda: asking.questions.give(1, "done", Who("Eve"))).start())
    assert given.by == "Eve"


# --- what is told of it


def test_every_answer_that_the_engine_offers_has_a_meaning() -> None:
    assert set(ANSWERS) <= MEANINGS.keys()
    assert {"done", "stop", "again", "same", "another", "zero", "powder", "recipe", "inventory"} <= MEANINGS.keys()


@pytest.mark.parametrize(
    ("options", "why"),
    [(["--ask"], "a person is asked anyway"), (["--ask", "--dry-run", "--unattended"], "asks nobody")],
)
def test_a_person_is_asked_where_that_means_something(command: Call, options: list[str], why: str) -> None:
    code, _, error = command("run", "recipes/xrd_holders.yaml", *options)
    assert (code, why in " ".join(error.split())) == (2, True)


# --- what is seen of it in the journal alone


@pytest.mark.parametrize(
    ("asks", "is_halted", "state"),
    [(True, False, "waiting for a person"), (True, True, "running"), (False, False, "running")],
)
def test_a_run_waits_only_for_a_real_person_and_until_its_action_has_ended(
    tmp_path: Path, asks: bool, is_halted: bool, state: str
) -> None:
    journal = Journal(tmp_path / "r.sqlite", durable=False)
    journal.event(RunBegun.model_validate({**HEADER, "mode": "SIMULATED", "options": {"asks": asks}}))
    journal.job_started(JobStarted(name="a", sample="a", attempt=1, workflow="ask"))
    action = journal.action_started(ActionStarted(path="ask", visit=1, skill="ask", inputs={}), weighs=False)
    journal.action = action
    journal.event(Asked(question="Is it?", choices=["done", "stop"]))
    if is_halted:
        journal.action_ended(action, ActionEnded(outcome="halted", code=None, result=None))
    with Presence(journal.path):
        one = summary(journal.path)
    assert (one.state, one.reason, bool(one.since)) == (
        state,
        *(("Is it?", True) if state != "running" else ("", False)),
    )
    followed = Follower(journal.path)
    followed.look()
    assert (followed.waiting.asked is None) == is_halted
    journal.close()
