"""Ends a run that hangs: a skill that never yields, a device that never answers, a disk that never writes.

The devices look after themselves: when the run's tick is silent they close the valve and stop within 100 to 300 ms
(`devices/liveness.py`). Here it is seen to that the program ends, too. First whatever hangs is interrupted where it is,
as by an exception, and the run ends safe as after any other fault. What is deaf to that is ended with the program, once
the devices were told to stop and the journal what happened.
"""

import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TYPE_CHECKING

from scuhand_bt.api import Hung
from scuhand_bt.exit_codes import ExitCode

if TYPE_CHECKING:
    from scuhand_bt.api import Control, Session, Who

HANGS_S = 20.0
"""A tick takes milliseconds, the longest plan of a motion a few seconds."""
GRACE_S = 5.0
"""What was interrupted has ended by then, or is deaf."""
IMPATIENT_S = 1.0
"""Who wishes a second time that the run stops does not wait longer for a silent tick."""
LAST_WORDS_S = 2.0
"""The devices have been told to stop by then, and the journal has been written, or never will be."""
LOOK_S = 0.1
COMPUTES = 0.02
"""Share of its time in which a thread has the processor that waits for nothing else, however busy the computer is."""
SKILLS = "scuhand_lab.skills."


class Supervisor:
    """Stops a run when it is told to, and watches over it, from the thread that runs it."""

    def __init__(self, control: "Control") -> None:
        self._control = control
        self._session: Session | None = None
        self._is_over = False
        self._limit_s = HANGS_S
        self._main = threading.get_ident()

    def stop(self, who: "Who | None" = None) -> None:
        """Stop now, as the operator wishes, or somebody else.

        The second time at once: what does not answer has no more patience.

        A run that is silent is interrupted by Hung within `LOOK_S`; KeyboardInterrupt before there is one; after it
        nothing is to stop.
        """
        if not self._control.stops_now:
            self._control.wish("stop_now", who)
        elif self._session is None:
            raise KeyboardInterrupt
        elif not self._is_over:
            self._limit_s = IMPATIENT_S  # who watches interrupts, once: a second time would be in what ends the run

    @contextmanager
    def watching(self, session: "Session") -> Iterator[None]:
        """Whatever hangs of this session's run in here is ended."""
        self._session = session
        over = threading.Event()
        thread = threading.Thread(target=self._watch, args=(session, over), daemon=True, name="supervisor")
        before = signal.signal(signal.SIGALRM, self._interrupt)
        thread.start()
        try:
            yield
        finally:
            over.set()
            thread.join()
            self._is_over = True
            signal.signal(signal.SIGALRM, before)

    def _interrupt(self, number: int, frame: FrameType | None) -> None:
        silent_s = self._session.liveness.silent_s if self._session is not None else 0.0
        raise Hung(f"it did nothing for {silent_s:.1f} s, and did not yield")

    def _watch(self, session: "Session", over: threading.Event) -> None:
        """Count how long the tick is silent: by this thread's own looks, so that a program that slept is not blamed.

        A tick that computes, as one does that plans a motion, is held to what it has had of the processor: ten programs
        beside it are no fault of its skill.
        """
        processor = time.pthread_getcpuclockid(self._main)
        last_s, silent_s, is_interrupted = session.liveness.last_s, 0.0, False
        computed_s = time.clock_gettime(processor)
        while not over.wait(LOOK_S):
            before_s, last_s = last_s, session.liveness.last_s
            had_s, computed_s = computed_s, time.clock_gettime(processor)
            if last_s != before_s or last_s is None:
                silent_s, is_interrupted = 0.0, False
                continue
            is_waiting = computed_s - had_s < COMPUTES * LOOK_S
            silent_s += LOOK_S if is_waiting else min(computed_s - had_s, LOOK_S)
            if silent_s >= self._limit_s and not is_interrupted:
                is_interrupted = True
                signal.pthread_kill(self._main, signal.SIGALRM)
            if silent_s >= self._limit_s + GRACE_S:
                self._end(session)

    def _end(self, session: "Session") -> None:
        """Make the cell safe, write down what happened, and end the program, whatever hangs of it."""
        stack = sys._current_frames()[self._main]
        reason = f"{_who(stack)} hangs and cannot be ended; the program was ended with it"

        _at_most(LAST_WORDS_S, *(device.stop for device in session.cell.every_device.values()))
        time.sleep(LAST_WORDS_S / 2)  # the drivers' threads say it
        _at_most(LAST_WORDS_S, lambda: session.write_off(reason, "".join(traceback.format_stack(stack))))
        said = f"Ended early: {reason}.\nJournal: {session.journal.kept_in}\n"
        _at_most(LAST_WORDS_S, lambda: os.write(2, said.encode()))
        os._exit(ExitCode.CELL_FAULT)


def _at_most(longest_s: float, *actions: Callable[[], object]) -> None:
    """Do all at once, and wait for them no longer."""
    threads = [threading.Thread(target=action, daemon=True) for action in actions]
    for thread in threads:
        thread.start()
    end_s = time.monotonic() + longest_s
    for thread in threads:
        thread.join(max(0.0, end_s - time.monotonic()))


def _who(frame: FrameType | None) -> str:
    """The skill whose code this is called from, if it is a skill's."""
    while frame is not None:
        name = str(frame.f_globals.get("__name__", ""))
        if name.startswith(SKILLS):
            return f"the skill {name.removeprefix(SKILLS)}"
        frame = frame.f_back
    return "the run"
