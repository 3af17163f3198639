"""The question that a run waits with, and its answer, from wherever it comes: the first one counts.

Questions are numbered, so that an answer to one is never taken for an answer to the next.
"""

import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from scuhand_bt.clock import Signal, wall_time

MEANINGS: Mapping[str, str] = {
    "go": "the action begins",
    "done": "it is done: the run goes on",
    "off": "it is off the pan, but the balance has not noticed",
    "stop": (
        "the run stops and can be resumed; at an action's question, the recipe's policy for `operator.refused` decides"
    ),
    "flag": "the dose is kept and marked; the batch goes on",
    "redo": "the sample is done once more in a new container, then flagged",
    "skip_sample": "the sample is left undone; the batch goes on",
    "again": "the action starts again from its beginning",
    "same": "the same container stands there, and counts with what it weighs now",
    "another": "another container stands there: the dosed one no longer counts, and its sample fails",
    "zero": "only the balance's zero has moved: the earlier weighings are corrected by it",
    "powder": "powder was added or lost: what the pan shows counts as it is",
    "recipe": "the source holds what the recipe says",
    "inventory": "the source holds what the inventory says",
    "fresh": "a fresh sheet is in the hand",
    "emptied": "the vessel is empty and clean, or was changed",
    "filled": "every slot of the changer holds a container again",
}
"""What an answer says, and what then happens. A lab's skill may offer others, which its question must explain."""
ANSWERED = "it was answered already"
ANOTHER = "another question is waiting now"


@dataclass(frozen=True)
class Who:
    """Who said something to a run; None if unknown. `signed`: proven by a PIN."""

    name: str | None = None
    signed: bool = False


UNKNOWN = Who()
"""Whoever sent a signal, or wrote an older journal."""


@dataclass(frozen=True)
class Question:
    """A question that waits for one of its choices."""

    number: int
    text: str
    choices: tuple[str, ...]
    at: str
    """Since when it waits, ISO 8601 with its offset from UTC."""

    @property
    def meanings(self) -> dict[str, str]:
        """What each choice means; "" for one that a lab's skill has made up."""
        return {choice: MEANINGS.get(choice, "") for choice in self.choices}


@dataclass(frozen=True)
class Given:
    """An answer, and who gave it."""

    answer: str
    who: Who


class Questions:
    """The questions of one run, one at a time. Safe to use from any thread.

    `news` fires when something was said, and when the next question may be asked.
    """

    def __init__(self) -> None:
        self.news = Signal()
        self._lock = threading.Lock()
        self._number = 0
        self._asked: Question | None = None
        self._given: Given | None = None
        self._notes: list[str] = []

    @property
    def waiting(self) -> Question | None:
        """The question that nobody has answered yet."""
        return self._asked if self._given is None else None

    def ask(self, text: str, choices: Sequence[str]) -> Question | None:
        """Ask a question; None while another one waits."""
        with self._lock:
            if self._asked is not None:
                return None
            self._number += 1
            self._given, self._asked = None, Question(self._number, text, tuple(choices), wall_time())
            return self._asked

    def give(self, number: int, answer: str, who: Who) -> str | None:
        """Answer the question with this number. Returns why the answer does not count, or None if it does."""
        with self._lock:
            if (why := self.why_not(number, answer)) is not None:
                return why
            self._given = Given(answer, who)
        self.news.fire()
        return None

    def why_not(self, number: int, answer: str) -> str | None:
        """Why this answer to the question with this number would not count now; None if it would."""
        if (asked := self._asked) is None or asked.number != number:
            return ANOTHER
        if self._given is not None:
            return ANSWERED
        return None if answer in asked.choices else f"it is answered with one of: {', '.join(asked.choices)}"

    def given(self) -> Given | None:
        """The answer to the last question."""
        return self._given

    def note(self, what: str) -> None:
        """Note something that went wrong in answering, for the journal."""
        with self._lock:
            self._notes.append(what)
        self.news.fire()

    def take_notes(self) -> list[str]:
        """The notes since the last call."""
        with self._lock:
            notes, self._notes = self._notes, []
        return notes

    def withdraw(self) -> None:
        """Let no question wait any more."""
        with self._lock:
            self._asked = None
        self.news.fire()


def wrong_pin(name: str, answer: str, question: str) -> str:
    """What the journal says about a wrong PIN."""
    return f"a wrong PIN was given for {name}, to answer '{answer}': {question}"
