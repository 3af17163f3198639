"""Pause, continue and stop: what a person wants of a run, from its terminal or from another process.

The states, and how each leaves the cell, are in docs/run-behaviour.md. Another process sends its wish to the run's own
process over an abstract socket. So stopping a run needs no disk, folder or lab that works, and a wish reaches either
the process that has the run, which answers, or none.
"""

import hashlib
import json
import math
import os
import pwd
import selectors
import socket
import struct
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, cast, get_args

from scuhand_bt.clock import Signal
from scuhand_bt.devices.interfaces import Reading
from scuhand_bt.lab_state.persons import Persons, person_name
from scuhand_bt.problems import SourceError
from scuhand_bt.run.operator import Terminal
from scuhand_bt.run.questions import ANSWERED, UNKNOWN, Question, Questions, Who, wrong_pin

Shown = tuple[float, float, bool]
"""What a balance shows: run time [s], gross mass [mg], whether it is stable."""
Wish = Literal["pause", "pause_now", "continue", "stop", "stop_now"]
HEARD = "heard"
ANSWER_S = 5.0
"""A process that has a run answers within this time [s]; else it counts as not answering."""
SPOKEN_S = 1.0
"""How long a caller may take to send its message [s]."""
LONGEST = 4096
"""Most bytes of a message."""
MOST_CALLERS = 64
"""Most simultaneous callers; one more replaces the one that has waited longest."""


class Control:
    """What is wanted of a run now. `news` fires whenever that changes. Safe to call from any thread."""

    def __init__(self) -> None:
        self.news = Signal()
        self.is_pausing = False
        """No action may begin; `halts` says whether the one at work is halted too."""
        self.is_stopping = False
        """No sample may begin."""
        self.halts = False
        """What is at work is halted at once."""
        self.paused_by = self.continued_by = self.stopped_by = UNKNOWN
        """Who wished that last."""
        self.at_terminal = UNKNOWN
        """Who is taken as the author of a wish without a name."""
        self.questions = Questions()
        """What a person is asked."""
        self.terminal = Terminal()
        """Where the run's own operator answers."""
        self.balance: Callable[[], Reading | None] = lambda: None
        """What the balance shows now."""

    def wish(self, wish: Wish, who: Who | None = None) -> None:
        """Pause or stop, at the next safe point or now, or continue; without `who`, as the operator."""
        who = who or self.at_terminal
        if wish == "continue":
            self.is_pausing = self.halts = False
            self.continued_by = who
        elif wish in ("pause", "pause_now"):
            self.is_pausing = True
            self.paused_by = who
        else:
            self.is_stopping = True
            self.stopped_by = who
        if wish.endswith("_now"):
            self.halts = True
        self.news.fire()

    def toggle_pause(self) -> None:
        """Pause, or continue if it is paused."""
        self.wish("continue" if self.is_pausing else "pause")

    @property
    def stops_now(self) -> bool:
        """The run is to end at once."""
        return self.is_stopping and self.halts


@dataclass
class _Caller:
    """A connected caller, its deadline, and what it has sent so far."""

    line: socket.socket
    until_s: float
    heard: bytes = b""


class WishListener:
    """Receives, in this process, what others send to its run.

    All callers are served by one thread, so that nobody waits for a caller who sends nothing. Raises OSError if
    another process already listens for this run.
    """

    def __init__(self, journal: Path, control: Control) -> None:
        self._control = control
        self._persons = Persons(journal.parent.parent)
        self._has_ended = False
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            self._socket.bind(address_of(journal))
            self._socket.listen(MOST_CALLERS)
            self._socket.setblocking(False)
        except OSError:
            self._socket.close()
            raise
        self._thread = threading.Thread(target=self._listen, daemon=True, name="wishes")
        self._thread.start()

    def _listen(self) -> None:
        callers: dict[int, _Caller] = {}  # oldest first
        with selectors.DefaultSelector() as ready:
            ready.register(self._socket, selectors.EVENT_READ)
            while not self._has_ended:
                left_s = min((one.until_s for one in callers.values()), default=math.inf) - time.monotonic()
                for key, _ in ready.select(max(0.0, left_s) if callers else None):
                    if key.fileobj is self._socket:
                        self._take_calls(callers, ready)
                    elif (caller := callers.get(key.fd)) is not None and self._hears(caller):
                        _hang_up(caller, callers, ready)
                for caller in [one for one in callers.values() if one.until_s <= time.monotonic()]:
                    _hang_up(caller, callers, ready)
            for caller in list(callers.values()):
                _hang_up(caller, callers, ready)

    def _take_calls(self, callers: dict[int, _Caller], ready: selectors.BaseSelector) -> None:
        """Accept everybody who waits."""
        with suppress(OSError):  # nobody waits any more
            while True:
                line, _ = self._socket.accept()
                line.setblocking(False)
                if len(callers) >= MOST_CALLERS:
                    _hang_up(next(iter(callers.values())), callers, ready)
                callers[line.fileno()] = _Caller(line, time.monotonic() + SPOKEN_S)
                ready.register(line, selectors.EVENT_READ)

    def _hears(self, caller: _Caller) -> bool:
        """Receive from a caller; whether its message was complete and has been answered."""
        try:
            part = caller.line.recv(LONGEST)
            caller.heard += part
            if part and len(caller.heard) <= LONGEST:
                return False
            caller.line.sendall(self._answer(_said(caller.heard), _user_of(caller.line)).encode())
        except BlockingIOError:
            return False
        except OSError:  # gone
            pass
        return True

    def _answer(self, said: Any, user: int) -> str:
        match said:
            case {"wish": wish, "by": str() | None as name, "pin": str() | None as pin} if wish in get_args(Wish):
                if not may_wish(wish, user, os.getuid()):
                    return "only the user who started the run may let it go on"
                # A file is read only for a name that is given, so that stopping a run needs no disk.
                who = self._proven(name, pin, user) if name is not None else None
                self._control.wish(cast(Wish, wish), who or Who(_name_of(user)))
                return HEARD
            case {"answer": str(answer), "to": int(number), "by": str() | None as name, "pin": str() | None as pin}:
                return self._answered(answer, number, name, pin, user)
            case "question":
                asked = self._control.questions.waiting
                return json.dumps(asdict(asked) if asked is not None else None)
            case "balance":
                shown = self._control.balance()
                return json.dumps((shown.time_s, shown.value_mg, shown.stable) if shown is not None else None)
        return "this command is not known"

    def _answered(self, answer: str, number: int, name: str | None, pin: str | None, user: int) -> str:
        """Take an answer. It must come from a person who signs it with a PIN, or from the run's owner."""
        questions, asked = self._control.questions, self._control.questions.waiting
        if (why := questions.why_not(number, answer)) is not None or asked is None:
            return why or ANSWERED
        try:
            name = person_name(name if name is not None else _name_of(user))
        except ValueError as error:
            return str(error)
        who = self._proven(name, pin, user)
        if who is None and pin is not None:
            questions.note(wrong_pin(name, answer, asked.text))
            return "that is not the PIN"
        if who is None:
            return f"{name} signs with a PIN"
        if not who.signed and not may_wish("continue", user, os.getuid()):
            return "only the user who started the run, or a person with a PIN, may answer"
        return questions.give(number, answer, who) or HEARD

    def _proven(self, name: str | None, pin: str | None, user: int) -> Who | None:
        """Who that is: the given name, or the user's name in the system. None if a PIN does not prove it."""
        try:
            named = person_name(name if name is not None else _name_of(user))
            if named not in self._persons.names():
                return Who(named)
            return Who(named, signed=True) if pin is not None and self._persons.is_pin(named, pin) else None
        except (ValueError, SourceError):  # not a name, or an unreadable lab
            return None

    def end(self) -> None:
        """Stop listening."""
        self._has_ended = True
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._thread.join()
        self._socket.close()


def may_wish(wish: Wish, user: int, owner: int) -> bool:
    """Anyone on this computer may pause or stop a run; only its owner and root may continue it."""
    return wish != "continue" or user in (owner, 0)


def listens(journal: Path) -> bool:
    """Whether a process has this run and receives wishes, even if its lock was deleted."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as line, suppress(OSError):
        line.connect(address_of(journal))
        return True
    return False


def say_wish(journal: Path, wish: Wish, name: str | None = None, pin: str | None = None) -> str | None:
    """Send a wish to the process that has this run; returns its answer (`HEARD`), or None if no process listens.

    `name` is who wishes it, and `pin` proves that; without them it is the system's user. Raises TimeoutError if it
    does not answer.
    """
    return _say(journal, {"wish": wish, "by": name, "pin": pin})


def waiting_question(journal: Path) -> Question | None:
    """The question that a run waits with; None if none, or if no process listens. TimeoutError as for `say_wish`."""
    said = json.loads(_say(journal, "question") or "null")
    return Question(**{**said, "choices": tuple(said["choices"])}) if said is not None else None


def balance_now(journal: Path) -> Shown | None:
    """What a run's balance shows now; None for nothing, or if no process listens. TimeoutError as for `say_wish`."""
    said = json.loads(_say(journal, "balance") or "null")
    return (said[0], said[1], said[2]) if isinstance(said, list) else None


def say_answer(journal: Path, asked: Question, answer: str, name: str | None, pin: str | None) -> str | None:
    """Answer a run's question; returns `HEARD`, or why the answer does not count. Else as `say_wish`."""
    return _say(journal, {"answer": answer, "to": asked.number, "by": name, "pin": pin})


def _say(journal: Path, said: object) -> str | None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as line:
        line.settimeout(ANSWER_S)
        try:
            _connect(line, address_of(journal))
            line.sendall(json.dumps(said).encode())
            line.shutdown(socket.SHUT_WR)
            return b"".join(iter(lambda: line.recv(LONGEST), b"")).decode(errors="replace") or None
        except TimeoutError:
            raise
        except OSError:
            return None


def _connect(line: socket.socket, address: str) -> None:
    """Connect, and retry while too many others do. Raises TimeoutError, or OSError if no process listens."""
    until_s = time.monotonic() + ANSWER_S
    while True:
        try:
            return line.connect(address)
        except BlockingIOError:  # its queue is full
            if time.monotonic() > until_s:
                raise TimeoutError from None
            time.sleep(0.01)


def _hang_up(caller: _Caller, callers: dict[int, _Caller], ready: selectors.BaseSelector) -> None:
    ready.unregister(caller.line)
    del callers[caller.line.fileno()]
    caller.line.close()


def _said(heard: bytes) -> Any:
    """A caller's message; None if it is no JSON."""
    try:
        return json.loads(heard)
    except (ValueError, RecursionError):
        return None


def _name_of(user: int) -> str:
    try:
        return pwd.getpwuid(user).pw_name
    except KeyError:
        return f"user {user}"


def address_of(journal: Path) -> str:
    """The address of one run: in Linux' abstract namespace, which needs no file and ends with its process."""
    return f"\0scuhand-bt/{hashlib.sha256(os.fsencode(os.path.realpath(journal))).hexdigest()[:40]}"


def _user_of(line: socket.socket) -> int:
    """The user at the other end, according to the kernel."""
    _, user, _ = struct.unpack("3i", line.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))
    return int(user)
