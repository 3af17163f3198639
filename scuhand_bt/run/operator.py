"""The person at the cell: at this terminal, simulated, or nobody."""

import queue
import sys
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from getpass import getpass

from scuhand_bt.clock import Clock, Signal, Steps, Wake
from scuhand_bt.devices.interfaces import Operator
from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.journal.events import Answered, Asked, Trouble
from scuhand_bt.sim.faults import Faults
from scuhand_bt.specs import Container

Tell = Callable[[Asked | Answered | Trouble], None]
"""Writes a question, its answer, or a wrong PIN into the journal."""
ANSWER_S = 60.0
"""Run time that a simulated person takes to do what is asked."""


@dataclass(frozen=True)
class Person:
    """Who runs the cell and answers."""

    name: str
    is_pin: Callable[[str], bool] | None = None
    """Who has a PIN has proven by it who this is, and signs every answer with it."""


class SimulatedOperator:
    """Does what is asked, in a minute of run time unless told otherwise; refuses where `faults` has it so."""

    def __init__(self, clock: Clock, tell: Tell, answer_s: float = ANSWER_S, faults: Faults | None = None) -> None:
        self._clock = clock
        self._tell = tell
        self._answer_s = answer_s
        self._faults = faults or Faults()
        self.sees: Callable[[], str] = lambda: ""
        """What it answers where it is asked about what it can see."""

    def ask(self, question: str, choices: Sequence[str] = ("done", "stop")) -> Steps[str]:
        self._tell(Asked(question=question, choices=list(choices)))
        ready_s = self._clock.now_s + self._answer_s
        while self._clock.now_s < ready_s:
            yield Wake(ready_s)
        refuses = self._faults.comes("operator.refuses", self._clock.now_s)
        seen = self.sees()
        answer = choices[-1] if refuses else seen if seen in choices else choices[0]
        self._tell(Answered(question=question, answer=answer))
        return answer


class Nobody:
    """An unattended run's operator: whatever is asked, nobody is there."""

    def ask(self, question: str, choices: Sequence[str] = ("done", "stop")) -> Steps[str]:
        raise SkillFailed(Code.OPERATOR_ABSENT, f"the run is unattended; it was to be asked: {question}")


class TerminalOperator:
    """Asks on the terminal; the answer is read on a thread, so that the cell stays watched meanwhile."""

    def __init__(self, clock: Clock, tell: Tell, show: Callable[[str], None], person: Person) -> None:
        self._clock = clock
        self._person = person
        self._tell = tell
        self._show = show

    def ask(self, question: str, choices: Sequence[str] = ("done", "stop")) -> Steps[str]:
        if not sys.stdin.isatty():
            raise SkillFailed(Code.OPERATOR_ABSENT, question)
        self._tell(Asked(question=question, choices=list(choices)))
        person = self._person
        while True:
            self._show(f"{question} [{'/'.join(choices)}]")
            answer = (yield from self._read(question, sys.stdin.readline)).strip().lower()
            if answer not in choices:
                continue
            if person.is_pin is not None:
                pin = yield from self._read(question, lambda: getpass(f"PIN of {person.name}: ") + "\n")
                if not person.is_pin(pin.removesuffix("\n")):
                    what = f"a wrong PIN was given for {person.name}, to answer '{answer}': {question}"
                    self._tell(Trouble(what=what))
                    self._show("That is not the PIN.")
                    continue
            self._tell(Answered(question=question, answer=answer, by=person.name, signed=person.is_pin is not None))
            return answer

    def _read(self, question: str, read: Callable[[], str]) -> Steps[str]:
        lines: queue.SimpleQueue[str] = queue.SimpleQueue()
        is_read = Signal()

        def put() -> None:
            try:
                lines.put(read())
            except (EOFError, OSError, ValueError):
                lines.put(GONE)
            is_read.fire()

        threading.Thread(target=put, daemon=True).start()
        while lines.empty():
            yield Wake.on(is_read, self._clock.now_s + 60.0)
        if (line := lines.get()) == GONE:
            raise SkillFailed(Code.OPERATOR_ABSENT, question)
        return line


GONE = ""
"""What is read where nobody can answer any more."""
UNKNOWN = ""
"""Whatever an earlier run may have left on the pan."""


class OperatorChanger:
    """A container changer that is the operator's hands; `place` and `remove` let a simulation follow.

    `may_be_loaded`: a run before this one may have left a container on the pan.
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
            self._remove()
            self._on_pan = None
            self.news.fire()

    def _do(self, request: str) -> Steps[None]:
        answer = yield from self._operator.ask(request)
        if answer != "done":
            raise SkillFailed(Code.OPERATOR_REFUSED, request)
