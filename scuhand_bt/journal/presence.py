"""Who has a run: one process at a time, by a lock on a file beside the journal.

The system frees the lock however the process ends.
"""

import fcntl
import os
from contextlib import suppress
from pathlib import Path
from typing import TextIO


class Held(Exception):  # noqa: N818 - it says what is so
    """Another process has this run."""


class Presence:
    """This process's hold on a run. Raises Held if it is another's."""

    def __init__(self, journal: Path) -> None:
        self._lock = _locked(journal.with_suffix(".lock"))

    def fileno(self) -> int:
        """What a program that is to share this hold is given; it lasts until the last of them has ended."""
        return self._lock.fileno()

    def end(self) -> None:
        """Let go of the run; once is enough."""
        if not self._lock.closed:
            path = Path(self._lock.name)
            with suppress(OSError):  # gone already, or another's: only this one is taken away
                if os.path.samestat(os.fstat(self._lock.fileno()), path.stat()):
                    path.unlink()
            self._lock.close()

    def __enter__(self) -> "Presence":
        return self

    def __exit__(self, *exception: object) -> None:
        self.end()


def _locked(path: Path) -> TextIO:
    """The lock's file, locked. Raises Held if it is another's."""
    while True:
        lock = path.open("a+")
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            lock.close()
            raise Held from None
        if path.exists() and os.path.samestat(os.fstat(lock.fileno()), path.stat()):
            return lock
        lock.close()  # whoever had it has just ended, and taken the file away


def is_held(journal: Path) -> bool:
    """Whether a process runs this run now."""
    try:
        with journal.with_suffix(".lock").open() as lock:  # which a folder that is only to be read allows
            fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)  # shared: who only looks is not taken for who runs it
    except FileNotFoundError:
        return False
    except OSError:
        return True
    return False
