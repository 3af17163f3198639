"""The person at the cell: one who answers at a terminal or from elsewhere, a simulated one, or nobody."""

import sys
import threading
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from getpass import getpass
from typing import Protocol

from scuhand_bt.clock import Clock, Signal, Steps, Wake
from scuhand_bt.devices.interfaces import SEEN, Operator
from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.journal.events import Answered, Asked
from scuhand_bt.journal.run_events import Trouble
from scuhand_bt.problems import harmless
from scuhand_bt.run.questions import Question, Questions, Who, wrong_pin
from scuhand_bt.sim.faults import Faults
from scuhand_bt.specs import Container

Tell = Callable[[Asked | Answered | Trouble], None]
"""Writes a question, its answer or a wrong PIN into the journal."""
ANSWER_S = 60.0
"""Run time that a simulated person takes to come, do what is asked, and say so [s]."""
AT_HAND = 1 / 3
"""The share of `ANSWER_S` for doing it and saying so, which is all that a person at the cell needs."""
LOOK_S = 0.1
"""How often it is checked whether what was asked for is done [s]."""


@dataclass(frozen=True)
class Person:
    """Who runs the cell and answers."""

    name: str
    is_pin: Callable[[str], bool] | None = None
    """Checks the PIN, if this person signs every answer with one."""


class Chances(Protocol):
    """What goes wrong (`sim/faults.py`), in this cell or in twins elsewhere."""

    def comes(self, fault: str, now_s: float) -> bool:
        """Whether this momentary fault occurs now."""
        ...


class SimulatedOperator:
    """Does what is asked, in a minute of run time by default; refuses where `faults` says so."""

    def __init__(self, clock: Clock, tell: Tell, answer_s: float = ANSWER_S, faults: Chances | None = None) -> None:
        self._clock = clock
        self._tell = tell
        self._answer_s = answer_s
        self._faults: Chances = faults or Faults()
        self.sees: Callable[[], Collection[str]] = tuple
        """The answers to questions about what it can see."""
        self._comes_s: float | None = None
        """From when on it stands at the cell [s], for a call or its next request; None if it was not called."""

    def expect(self) -> None:
        if self._comes_s is None:
            self._comes_s = self._clock.now_s + self._answer_s * (1.0 - AT_HAND)

    def dismiss(self) -> None:
        self._comes_s = None

    def ask(self, question: str, choices: Sequence[str] = ("done", "stop")) -> Steps[str]:
        self._tell(Asked(question=question, choices=list(choices)))
        self.expect()
        yield from self._until(self._comes_s)
        yield from self._until(self._clock.now_s + self._answer_s * AT_HAND)
        self._comes_s = None
        return self._answered(question, choices)

    def ask_until(
        self, question: str, choices: Sequence[str], is_seen: Callable[[], bool], does: Callable[[], None]
    ) -> Steps[str]:
        self._tell(Asked(question=question, choices=list(choices)))
        at_hand_s = self._clock.now_s + self._answer_s * AT_HAND
        self.expect()
        yield from self._until(self._comes_s)
        yield from self._until(at_hand_s)
        if self._faults.comes("operator.refuses", self._clock.now_s):
            self._comes_s = None
            self._tell(Answered(question=question, answer=choices[-1]))
            return choices[-1]
        does()
        given_up_s = self._clock.now_s + self._answer_s
        while self._clock.now_s < given_up_s:
            if is_seen():
                self._tell(Answered(question=question, answer=SEEN))
                return SEEN
            yield Wake(min(given_up_s, self._clock.now_s + LOOK_S))
        return self._answered(question, choices)

    def _until(self, time_s: float | None) -> Steps[None]:
        while time_s is not None and self._clock.now_s < time_s:
            yield Wake(time_s)

    def _answered(self, question: str, choices: Sequence[str]) -> str:
        refuses = self._faults.comes("operator.refuses", self._clock.now_s)
        seen = self.sees()
        answer = choices[-1] if refuses else next((one for one in choices if one in seen), choices[0])
        self._tell(Answered(question=question, answer=answer))
        return answer


class Nobody:
    """The operator of an unattended run: every question fails."""

    def expect(self) -> None:
        """Nobody comes."""

    def dismiss(self) -> None:
        """Nobody leaves."""

    def ask(self, question: str, choices: Sequence[str] = ("done", "stop")) -> Steps[str]:
        raise SkillFailed(Code.OPERATOR_ABSENT, f"the run is unattended, but had to ask: {question}")

    def ask_until(
        self, question: str, choices: Sequence[str], is_seen: Callable[[], bool], does: Callable[[], None]
    ) -> Steps[str]:
        return self.ask(question, choices)


class PersonOperator:
    """Asks a person, who answers at the run's terminal or from elsewhere; the first answer counts.

    It waits as long as nobody answers, while the guards keep watching.
    """

    def __init__(
        self, clock: Clock, tell: Tell, person: Person, questions: Questions, terminal: "Terminal | None" = None
    ) -> None:
        self._clock = clock
        self._tell = tell
        self._questions = questions
        self._terminal = terminal or Terminal()
        self._listener = _Listener(questions, person, self._terminal)

    @property
    def is_asking(self) -> bool:
        """Whether a question waits."""
        return self._questions.waiting is not None

    def expect(self) -> None:
        """Nothing to do: persons are notified, and come by themselves."""

    def dismiss(self) -> None:
        """Nothing to do."""

    def ask(self, question: str, choices: Sequence[str] = ("done", "stop")) -> Steps[str]:
        answer = yield from self._ask(question, choices, None)
        return answer

    def ask_until(
        self, question: str, choices: Sequence[str], is_seen: Callable[[], bool], does: Callable[[], None]
    ) -> Steps[str]:
        answer = yield from self._ask(question, choices, is_seen)
        if answer == choices[0]:
            does()
        return answer

    def _ask(self, question: str, choices: Sequence[str], is_seen: Callable[[], bool] | None) -> Steps[str]:
        questions = self._questions
        turn = Wake.on(questions.news)
        while (asked := questions.ask(question, choices)) is None:
            yield turn  # another action's question is waiting
            turn = Wake.on(questions.news)
        try:
            self._tell(Asked(question=question, choices=list(choices)))
            self._terminal.show(asked)
            self._listener.listen()
            while True:
                news = Wake.on(questions.news, self._clock.now_s + (60.0 if is_seen is None else LOOK_S))
                for note in questions.take_notes():
                    self._tell(Trouble(what=note))
                if (given := questions.given()) is not None:
                    break
                if is_seen is not None and is_seen():
                    self._tell(Answered(question=question, answer=SEEN))
                    return SEEN
                yield news
        finally:
            questions.withdraw()
        self._tell(Answered(question=question, answer=given.answer, by=given.who.name, signed=given.who.signed))
        return given.answer


class Terminal:
    """The run's own terminal, where a person may answer: its standard streams."""

    @property
    def is_there(self) -> bool:
        return sys.stdin.isatty()

    def show(self, question: Question) -> None:
        """Show a question that waits, and how to answer it where nobody can type."""
        elsewhere = "" if self.is_there else " (answer from elsewhere: `scuhand-bt answer last ANSWER`)"
        self.say(f"{question.text} [{'/'.join(question.choices)}]{elsewhere}")

    def say(self, text: str) -> None:
        """Print something about an answer."""
        print(harmless(text), flush=True)

    def readline(self) -> str:
        """A line that was typed; "" at the end of input."""
        return sys.stdin.readline()

    def hidden(self, prompt: str) -> str:
        """A line that is typed without echo."""
        return getpass(prompt)


class _Listener:
    """Reads answers from the run's terminal, if it has one, on its own thread. The terminal may vanish."""

    def __init__(self, questions: Questions, person: Person, terminal: Terminal) -> None:
        self._questions = questions
        self._person = person
        self._terminal = terminal
        self._asked = threading.Semaphore(0)
        self._thread: threading.Thread | None = None

    def listen(self) -> None:
        """A question waits."""
        if not self._terminal.is_there:
            return
        if self._thread is None:
            self._thread = threading.Thread(target=self._read, daemon=True, name="terminal")
            self._thread.start()
        self._asked.release()

    def _read(self) -> None:
        while True:
            self._asked.acquire()
            while self._questions.waiting is not None:
                try:
                    line = self._terminal.readline()
                except (EOFError, OSError, ValueError):
                    return
                if not line:
                    return
                self._hear(line.strip().lower())

    def _hear(self, answer: str) -> None:
        person, asked = self._person, self._questions.waiting
        if asked is None or not answer:
            return
        if answer not in asked.choices:
            self._terminal.say(f"'{answer}' is no answer; there are: {', '.join(asked.choices)}")
            return
        if person.is_pin is not None:
            try:
                is_right = person.is_pin(self._terminal.hidden(f"PIN of {person.name}: "))
            except (EOFError, OSError):
                return
            if not is_right:
                self._questions.note(wrong_pin(person.name, answer, asked.text))
                self._terminal.say("That is not the PIN.")
                return
        self._questions.give(asked.number, answer, Who(person.name, person.is_pin is not None))


UNKNOWN = ""
"""The pan may hold something that an earlier run has left."""


class OperatorChanger:
    """A container changer that is the operator's hands; a simulation follows through `place` and `remove`.

    `may_be_loaded`: an earlier run may have left a container on the pan.
    """

    needs_person = True
    fault = None

    def __init__(
        self,
        operator: Operator,
        place: Callable[[Container], None] = lambda container: None,
        remove: Callable[[], None] = lambda: None,
        *,
        may_be_loaded: bool = False,
    ) -> None:
        self.news = Signal()
        self.is_stopped = True
        self._operator = operator
        self._place = place
        self._remove = remove
        self._on_pan: str | None = UNKNOWN if may_be_loaded else None

    def stop(self) -> None:
        """Nothing moves by itself."""

    def bring(self, container: Container) -> Steps[None]:
        if self._on_pan == container.id:
            return
        if self._on_pan not in (None, UNKNOWN):
            raise SkillFailed(Code.CONTAINER_MISSING, f"the pan is not free: '{self._on_pan}' stands on it")
        yield from self._do(f"Put the {container.name} '{container.id}' on the pan.")
        self._place(container)
        self._on_pan = container.id
        self.news.fire()

    def take_away(self) -> Steps[None]:
        if self._on_pan is not None:
            yield from self._do("Take the container off the pan.")
            self._removed()

    def hand_over(self, to: Container, is_bare: Callable[[], bool]) -> Steps[None]:
        # No other question has this answer, so one that comes a moment too late is not taken for the next one's.
        off = f"'{self._on_pan}'" if self._on_pan else "the container"
        request = (
            f"Take {off} off the pan. No answer is needed: the bare pan is then weighed by itself, and you will be "
            f"asked to put the {to.name} '{to.id}' on it."
        )
        answer = yield from self._operator.ask_until(request, ("off", "stop"), is_bare, self._remove)
        if answer == "stop":
            raise SkillFailed(Code.OPERATOR_REFUSED, request)
        self._on_pan = None
        self.news.fire()

    def clear(self) -> Steps[None]:
        yield from self._do("Take everything off the pan: it has to be weighed bare.")
        self._removed()

    def _removed(self) -> None:
        self._remove()
        self._on_pan = None
        self.news.fire()

    def _do(self, request: str) -> Steps[None]:
        answer = yield from self._operator.ask(request)
        if answer != "done":
            raise SkillFailed(Code.OPERATOR_REFUSED, request)
