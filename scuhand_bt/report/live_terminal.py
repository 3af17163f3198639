"""The run's terminal while a picture stays on it: what is typed is shown in the picture, not where the cursor is."""

import os
import select
import signal
import sys
import termios
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

from scuhand_bt.run.operator import Terminal
from scuhand_bt.run.questions import Question

_LOOK_S = 0.2


class LiveTerminal(Terminal):
    """Reads a person's answers key by key. Only within `typing` a question is answered here."""

    def __init__(self) -> None:
        self.typed: str | None = None
        """What stands in the line that is being typed, of a PIN only that it does; None where nothing can be."""
        self.note = ""
        """What was said last of an answer."""
        self._is_open = False

    @contextmanager
    def typing(self) -> Iterator[None]:
        """The keys are this terminal's, and echo nothing; the signals of Ctrl-C, Ctrl-Z and Ctrl-\\ stay.

        A terminal that is gone by the end, or in whose background the run is, is left as it is.
        """
        file = sys.stdin.fileno()
        before = _taken(file)
        if before is None:
            yield
            return
        self._is_open, self.typed = True, ""
        try:
            yield
        finally:
            self._is_open = False
            # Who was put into the background meanwhile would be stopped here.
            signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTTOU})
            with suppress(termios.error):
                termios.tcsetattr(file, termios.TCSADRAIN, before)

    def show(self, question: Question) -> None:
        self.note = ""

    def say(self, text: str) -> None:
        self.note = text

    def readline(self) -> str:
        return self._line(lambda typed: typed)

    def hidden(self, prompt: str) -> str:
        return self._line(lambda typed: prompt + "•" * len(typed)).removesuffix("\n")

    def _line(self, shown: Callable[[str], str]) -> str:
        """A line with its end, as it is typed; "" where nothing comes any more."""
        line = ""
        self.typed = shown(line)
        while True:
            if (key := self._key()) == "":
                return ""
            if key in "\r\n":
                self.typed = ""
                return f"{line}\n"
            if key in "\x7f\b":
                line = line[:-1]
            elif key == "\x15":  # Ctrl-U
                line = ""
            elif key.isprintable():
                line += key
            self.typed = shown(line)

    def _key(self) -> str:
        """The next key; "" where the terminal has gone, or the picture."""
        file = sys.stdin.fileno()
        key = b""
        while self._is_open:
            if not select.select([file], [], [], _LOOK_S)[0]:
                continue
            if not (part := os.read(file, 1)):
                return ""
            key += part
            try:
                return key.decode()
            except UnicodeDecodeError:
                if len(key) >= 4:
                    key = b""
        return ""


def _taken(file: int) -> list[Any] | None:
    """How the terminal was before its keys were taken; None where that cannot be, or is another program's business."""
    try:
        before = termios.tcgetattr(file)
        if os.tcgetpgrp(file) != os.getpgrp():
            return None
        tty.setcbreak(file)
    except (OSError, termios.error):
        return None
    return before
