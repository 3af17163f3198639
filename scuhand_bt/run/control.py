"""Pause, continue and stop: what a person wants of a run, from its terminal or from another process.

The states and what each leaves the cell in are in docs/run-behaviour.md. Another process says its wish to the run's
own, over a socket that has a name and no file: no disk, folder or lab has to be sound for a run to be stopped, a wish
reaches the process that has the run now or none, and that answers.
"""

import hashlib
import os
import socket
import struct
import threading
from contextlib import suppress
from pathlib import Path
from typing import Literal, get_args

from scuhand_bt.clock import Signal

Wish = Literal["pause", "pause_now", "continue", "stop", "stop_now"]
HEARD = "heard"
ANSWER_S = 5.0
"""A process that has a run answers within this time, or does not any more."""
SPOKEN_S = 1.0
"""And who is to say something has said it by then."""


class Control:
    """What is wanted of a run now. `news` fires whenever that changes; safe to call from any thread."""

    def __init__(self) -> None:
        self.news = Signal()
        self.is_pausing = False
        """No action may begin; `halts` says whether the one at work goes on to its end."""
        self.is_stopping = False
        """No sample may begin."""
        self.halts = False
        """What is at work is halted at once."""

    def wish(self, wish: Wish) -> None:
        """Pause at the next safe point or now, continue, stop after this sample or now."""
        if wish == "continue":
            self.is_pausing = self.halts = False
        elif wish in ("pause", "pause_now"):
            self.is_pausing = True
        else:
            self.is_stopping = True
        if wish.endswith("_now"):
            self.halts = True
        self.news.fire()

    def toggle_pause(self) -> None:
        """Pause, or continue if it is paused already."""
        self.wish("continue" if self.is_pausing else "pause")

    @property
    def stops_now(self) -> bool:
        """The run is to end at once."""
        return self.is_stopping and self.halts


class WishListener:
    """Hears, in this process, what others wish of its run. Raises OSError where another process listens for it."""

    def __init__(self, journal: Path, control: Control) -> None:
        self._control = control
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            self._socket.bind(_address(journal))
            self._socket.listen()
        except OSError:
            self._socket.close()
            raise
        self._thread = threading.Thread(target=self._listen, daemon=True, name="wishes")
        self._thread.start()

    def _listen(self) -> None:
        while True:
            try:
                caller, _ = self._socket.accept()
            except OSError:  # it was shut down
                return
            with caller, suppress(OSError):
                caller.settimeout(SPOKEN_S)
                caller.sendall(self._answer(caller.recv(64).decode(errors="replace"), _user_of(caller)).encode())

    def _answer(self, said: str, user: int) -> str:
        for wish in get_args(Wish):
            if said == wish:
                if not may_wish(wish, user, os.getuid()):
                    return "whose run it is has to let it go on"
                self._control.wish(wish)
                return HEARD
        return "that is no wish"

    def end(self) -> None:
        """Hear no more."""
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._thread.join()
        self._socket.close()


def may_wish(wish: Wish, user: int, owner: int) -> bool:
    """Anyone at this computer may stop a run; its owner (and root) may let it go on."""
    return wish != "continue" or user in (owner, 0)


def say_wish(journal: Path, wish: Wish) -> str | None:
    """Say a wish to the process that has this run, and hear what it answers: `HEARD`; None where none listens.

    Raises TimeoutError where it does not answer.
    """
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as line:
        line.settimeout(ANSWER_S)
        try:
            line.connect(_address(journal))
            line.sendall(wish.encode())
            return line.recv(64).decode(errors="replace") or None
        except TimeoutError:
            raise
        except OSError:
            return None


def _address(journal: Path) -> str:
    """A name that belongs to one run; of Linux' own, which are no files and end with their process."""
    return f"\0scuhand-bt/{hashlib.sha256(os.fsencode(os.path.realpath(journal))).hexdigest()[:40]}"


def _user_of(line: socket.socket) -> int:
    """Who is at the other end, as the kernel has it."""
    _, user, _ = struct.unpack("3i", line.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))
    return int(user)
