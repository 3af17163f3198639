"""Pause, continue and stop: what a person wants of a run, from its terminal or from another process.

The states and what each leaves the cell in are in docs/run-behaviour.md. Another process leaves its wish as a
file beside the run's journal; the run's process looks for it ten times a second and takes it away.
"""

import json
import os
import threading
from pathlib import Path
from typing import Literal, get_args

from scuhand_bt.clock import Signal

Wish = Literal["pause", "pause_now", "continue", "stop", "stop_now"]
LOOK_S = 0.1


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
    """Hears, in this process, the wishes that others leave for its run."""

    def __init__(self, journal: Path, control: Control) -> None:
        self._wish = journal.with_suffix(".wish")
        self._wish.unlink(missing_ok=True)
        self._control = control
        self._gone = threading.Event()
        self._thread = threading.Thread(target=self._listen, daemon=True, name="wishes")
        self._thread.start()

    def _listen(self) -> None:
        while not self._gone.wait(LOOK_S):
            if (wish := take_wish(self._wish)) is not None:
                self._control.wish(wish)

    def end(self) -> None:
        """Hear no more."""
        self._gone.set()
        self._thread.join()


def leave_wish(journal: Path, wish: Wish) -> None:
    """Leave a wish for the process that has this run."""
    path = journal.with_suffix(".wish")
    draft = path.with_name(f"{path.name}.{os.getpid()}")
    draft.write_text(json.dumps(wish), encoding="utf-8")
    draft.replace(path)


def take_wish(path: Path) -> Wish | None:
    """The wish that was left, if there is one; it is taken away. What is no wish is none, and goes away as well."""
    try:
        wish = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except ValueError:  # not ours: it must not end the listening
        wish = None
    path.unlink(missing_ok=True)
    return wish if wish in get_args(Wish) else None
