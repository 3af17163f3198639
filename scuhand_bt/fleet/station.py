"""A station: it takes one job of the queue after the other, and has each run by a program of its own.

What has become of a job is read from the run's journal, never remembered: whatever was killed and whenever, a station
that begins looks at the job that it has taken and goes on from there. A run that has not begun begins; one that goes on
is waited for, also one that a station before it has left behind; one that is complete is marked; one that was
interrupted is resumed, by a person or (`resumes`) once by itself; it is never begun a second time.
"""

import asyncio
import json
import math
import os
import secrets
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from procrastinate.exceptions import ConnectorException
from procrastinate.jobs import Status

from scuhand_bt.exit_codes import ExitCode
from scuhand_bt.fleet.needs import offer_of
from scuhand_bt.fleet.of_journal import came_to, key_of
from scuhand_bt.fleet.order import Order, write
from scuhand_bt.fleet.queue import ENDED, HELD_BACK, LONGEST_NAME, Queue, Taken
from scuhand_bt.journal.archive import state_of
from scuhand_bt.journal.follow import Follower
from scuhand_bt.journal.history import read_history
from scuhand_bt.journal.pace import time_left_s
from scuhand_bt.journal.presence import Held, Presence, is_held
from scuhand_bt.lab import Lab, load_lab, state_folder
from scuhand_bt.problems import Mark, Problem, SourceError
from scuhand_bt.run.control import say_wish
from scuhand_bt.run.holds import CELL

LOOK_S = 2.0
"""How often a station looks at its queue and its run."""
IDLE_LOOKS = 10
"""So many looks an idle station waits before it says anew what it has, and takes over what waits elsewhere."""
LEFT_STEP_S = 10.0
"""What is left of a run is said in steps of this: not at every look."""
LAST_WORDS = 600
"""Characters of what a refused run has said."""
RESUMED = "resume.txt"
"""What the last resumed run has said."""


@dataclass(frozen=True)
class Manner:
    """How a station runs its jobs."""

    simulated: bool = False
    unattended: bool = False
    resumes: bool = False
    """It resumes by itself a run that was killed."""
    operator: str | None = None


class Station:
    """The station of a lab; `work` until `leave`. `say` tells whoever watches, in lines."""

    def __init__(
        self,
        queue: Queue,
        lab: Path,
        name: str | None,
        manner: Manner,
        say: Callable[[str], None],
        look_s: float = LOOK_S,
    ) -> None:
        loaded = load_lab(lab)
        self.name = name or loaded.cell.cell
        if len(self.name) > LONGEST_NAME:
            what = f"a station's name has {LONGEST_NAME} characters at the most: give this one a --name"
            raise SourceError([Problem(Mark(str(lab), 0), what)])
        self._queue, self._lab, self._manner, self._say, self._look_s = queue, lab.absolute(), manner, say, look_s
        self._state = state_folder(loaded).absolute()
        self._orders = self._state / "queue"
        self._child: asyncio.subprocess.Process | None = None
        self._is_leaving = asyncio.Event()
        self._resumed: set[str] = set()
        self._keys: dict[Path, str] = {}
        self._now: Follower | None = None
        """The run that goes on."""
        self._idle, self._said = 0, ""
        self._waits = ""
        """For what the next station here will have to, too."""
        self._wrong = ""
        """In the lab, when it was read last: what that breaks is offered to nobody."""

    def leave(self) -> None:
        """Take no more jobs, and end when the run that goes on has ended."""
        self._is_leaving.set()

    async def work(self) -> None:
        """Until told to leave. SourceError for a name that is taken, or a lab that has broken meanwhile."""
        presence = await self._alone()
        if presence is None:
            return
        with presence:
            self._lock = presence
            await self._require_one_name()
            await self._enrol(load_lab(self._lab))
            while True:
                had_child = self._has_child
                try:
                    goes_on = await self._look()
                except ConnectorException as error:
                    self._tell_of_no_database(error)
                    goes_on = False
                except SourceError as error:  # a wrong lab or journal ends it: who looks at the queue is told
                    with suppress(ConnectorException):
                        await self._queue.tell(self.name, f"{ENDED}: {error}")
                    raise
                if self._is_leaving.is_set() and not had_child:  # whose end this look has seen to
                    with suppress(ConnectorException):
                        await self._queue.tell(self.name, f"{ENDED}; it {self._waits}" if self._waits else ENDED)
                    return
                if not goes_on:
                    await self._wait()

    @property
    def _has_child(self) -> bool:
        return self._child is not None and self._child.returncode is None

    async def _alone(self) -> Presence | None:
        """The lab's one place for a station; the run that a station before this one has left behind still has it."""
        self._orders.mkdir(parents=True, exist_ok=True)
        while not self._is_leaving.is_set():
            try:
                return Presence(self._orders)
            except Held:
                if not self._said:
                    self._tell("another station of this lab works, or the run that it has left goes on; waiting for it")
                await self._look_on()
                await self._wait()
        return None

    async def _look_on(self) -> None:
        """While this lab's place for a station is another's: say what its run does, which nobody else may."""
        try:
            taken = await self._queue.taken(self.name)
            journal = self._journal_of(taken.order.key) if taken is not None and taken.order is not None else None
            if taken is not None and journal is not None and is_held(journal):
                await self._goes_on(taken, journal)
        except ConnectorException as error:
            self._tell_of_no_database(error)

    async def _require_one_name(self) -> None:
        """SourceError where jobs of this station wait under another name: one may hold back all others of this cell."""
        for name in await self._queue.other_names(self.name, _identity(self._orders / "identity")):
            what = f"this lab's station has jobs as '{name}': begin it with --name '{name}', or cancel those first"
            raise SourceError([Problem(Mark(str(self._lab), 0), what)])

    async def _enrol(self, lab: Lab) -> None:
        """Say what the cell has now."""
        self._wrong = f"; wrong in its lab: {lab.problems[0]}" if lab.problems else ""
        manner = self._manner
        offer = offer_of(lab, simulated=manner.simulated, unattended=manner.unattended)
        if not await self._queue.enrol(self.name, _identity(self._orders / "identity"), offer):
            what = f"the station '{self.name}' of the queue is another lab's: give this one another --name"
            raise SourceError([Problem(Mark(str(self._lab), 0), f"{what}, or `scuhand-bt fleet --forget {self.name}`")])

    async def _wait(self) -> None:
        """Until the next look; less where the run ends before."""
        child = self._child if self._has_child else None  # one that has ended would not be waited for
        waits = child.wait() if child is not None else self._is_leaving.wait()
        done = asyncio.ensure_future(waits)
        await asyncio.wait([done], timeout=self._look_s)
        done.cancel()

    async def _look(self) -> bool:
        """One look at the queue and the run, and one step on; whether there is to be another one at once."""
        taken = await self._queue.taken(self.name)
        if taken is None:
            return not self._has_child and not self._is_leaving.is_set() and await self._take_next()
        if taken.order is None:
            return await self._over(taken, Status.FAILED, "", "another version of scuhand-bt has submitted it")
        journal = self._journal_of(taken.order.key)
        if self._has_child or (journal is not None and is_held(journal)):
            await self._goes_on(taken, journal)
            return False
        if journal is None and taken.run:
            return await self._journal_gone(taken)
        if journal is None:
            return await self._not_begun(taken, taken.order)
        return await self._has_begun(taken, journal)

    def _journal_of(self, key: str) -> Path | None:
        """The journal of the run that was begun for an order."""
        for journal in (*self._state.glob("runs/*.sqlite"), *self._state.glob("rescued-*/*.sqlite")):
            if journal not in self._keys and (found := key_of(journal)) is not None:
                self._keys[journal] = found
        return next((journal for journal, of in self._keys.items() if of == key and journal.exists()), None)

    async def _take_next(self) -> bool:
        if not self._manner.simulated and is_held(self._state / CELL):
            await self._note("another run has the cell")
            return False
        self._child = None
        if await self._queue.take(self.name) is not None:
            self._idle = 0
            return True
        self._idle += 1
        await self._note(f"waits for a job{self._wrong}")
        if self._idle % IDLE_LOOKS != 0:
            return False
        try:
            lab = load_lab(self._lab)
        except SourceError as error:  # as somebody edits it: what comes meanwhile is refused by its run
            self._tell(f"the lab is broken: {error}")
            return False
        await self._enrol(lab)  # what the cell has, and what is in its mortars, changes while no job comes
        return await self._queue.take_over(self.name)

    async def _goes_on(self, taken: Taken, journal: Path | None) -> None:
        run = journal.stem if journal is not None else taken.run  # of one that was taken away: it has begun
        if taken.job.abort_requested and journal is not None:
            with suppress(TimeoutError):
                say_wish(journal, "stop")
        does, left_s = self._doing(journal) if journal is not None else ("", None)
        state = f"runs job {taken.id}{', and ends with it' if self._is_leaving.is_set() else ''}"
        state += f": {does}" if does else ""
        await self._note(state, taken, run, does or "goes on", left_s)

    def _doing(self, journal: Path) -> tuple[str, float | None]:
        """What holds up a run that goes on, the question that it waits with, or a pause, "" for nothing; what is left.

        None where that cannot be told.
        """
        if self._now is None or self._now.path != journal:
            self._now = Follower(journal)
        now = self._now
        with suppress(SourceError):  # of one that is about to begin; or it is damaged, which its end tells
            now.look()
        state, question, _ = state_of(now.begun, now.waiting, now.ended, is_paused=now.is_paused, is_held=True)
        left_s = time_left_s(now, now.begun) if now.begun is not None else None
        if state == "waiting for a person":
            return f"waits for a person: {question}; `scuhand-bt answer {journal.stem}` answers", left_s
        return (f"is paused; `scuhand-bt resume {journal.stem}` continues" if state == "paused" else ""), left_s

    async def _not_begun(self, taken: Taken, order: Order) -> bool:
        """Nothing has moved for it: it begins, unless it was refused, or is not wanted any more."""
        folder = self._orders / order.key
        log = folder.with_suffix(".txt")  # not in there: a table may have any name
        if taken.job.abort_requested:
            return await self._over(taken, Status.ABORTED, "", "cancelled before it began")
        if self._child is not None:
            said = _last_words(log)
            if self._child.returncode == ExitCode.BAD_INPUT:
                return await self._refused(taken, order, said)
            what = f"it did not begin, and its program ended with {self._child.returncode}: {said or 'without a word'}"
            return await self._over(taken, Status.FAILED, "", what)
        if order.simulated != self._manner.simulated:  # it was queued for what this station was, by the same name
            of, here = ("simulated devices", "a real one") if order.simulated else ("the cell", "a simulated one")
            return await self._refused(taken, order, f"it is of {of}, and its station is {here} now")
        if self._is_leaving.is_set():
            return False
        try:
            write(await self._queue.files(order), folder)
        except (OSError, SourceError) as error:
            return await self._refused(taken, order, str(error))
        how = ["--dry-run", "--seed", str(order.seed)] if self._manner.simulated else []
        how += ["--unattended"] if self._manner.unattended else []
        self._say(f"job {taken.id}: {order.recipe} begins")
        await self._start(log, "run", str(folder / order.file), *how)
        return False

    async def _refused(self, taken: Taken, order: Order, why: str) -> bool:
        """This station cannot do it any more: it goes to the next one that could, if there is one."""
        others = [name for name in order.stations if name != self.name]
        if not others:
            return await self._over(taken, Status.FAILED, "", f"it did not begin: {why}")
        await self._queue.pass_on(taken.id, others, f"it did not begin at {self.name}: {why}")
        return await self._settled(f"job {taken.id} goes to {others[0]}: it did not begin: {why}")

    async def _journal_gone(self, taken: Taken) -> bool:
        """What it has done nobody knows: it is not begun a second time, here or elsewhere."""
        what = f"its run {taken.run} has begun, and its journal is not in {self._state / 'runs'}"
        if taken.job.abort_requested:
            return await self._over(taken, Status.ABORTED, taken.run, f"cancelled; {what}")
        what = f"{what}: bring it back, or look at the cell and `scuhand-bt cancel {taken.id}`"
        return await self._hold_back(taken, taken.run, what)

    async def _has_begun(self, taken: Taken, journal: Path) -> bool:
        """What its journal says it has come to, as nobody is at it now."""
        run, history = journal.stem, read_history(journal)
        if (ended := history.ended) is not None and history.is_complete:
            is_done = ended.exit_code in (ExitCode.OK, ExitCode.FLAGGED)
            status = Status.SUCCEEDED if is_done else Status.FAILED
            return await self._over(taken, status, run, came_to(history))
        if taken.job.abort_requested:
            return await self._over(taken, Status.ABORTED, run, f"cancelled; {came_to(history)}")
        resumes = self._manner.resumes and not self._is_leaving.is_set()
        if ended is None and resumes and run not in self._resumed:
            self._resumed.add(run)
            self._say(f"job {taken.id}: {run} was killed, and is resumed")
            await self._start(self._orders / RESUMED, "resume", run)
            return False
        what = f"{came_to(history)}; `scuhand-bt resume {run}` goes on with it"
        if ended is None and run in self._resumed and (said := _last_words(self._orders / RESUMED)):
            what = f"{what}. When this station resumed it: {said}"
        return await self._hold_back(taken, run, what)

    async def _hold_back(self, taken: Taken, run: str, what: str) -> bool:
        """A person looks first: no other job begins here."""
        self._waits = f"{HELD_BACK} {taken.id}: {what}"
        await self._note(self._waits, taken, run, what)
        return False

    async def _start(self, log: Path, *words: str) -> None:
        """A program for the run, which holds this lab's place for a station as long as it lives."""
        who = ["--operator", self._manner.operator] if self._manner.operator is not None else []
        command = [sys.executable, "-m", "scuhand_bt", *words, *who, "--quiet", "--lab", str(self._lab)]
        with log.open("wb") as output:
            self._child = await asyncio.create_subprocess_exec(
                *command,
                stdin=asyncio.subprocess.DEVNULL,
                stdout=output,
                stderr=asyncio.subprocess.STDOUT,
                cwd=self._state.parent,
                pass_fds=(self._lock.fileno(),),
            )

    async def _over(self, taken: Taken, status: Status, run: str, said: str) -> bool:
        await self._queue.note(taken.id, {"run": run, "said": said})
        await self._queue.finish(taken.id, status)
        return await self._settled(f"job {taken.id}: {status.value}: {said}")

    async def _settled(self, said: str) -> bool:
        """Nothing holds back this station's next job."""
        self._child, self._waits = None, ""
        self._tell(said)
        await self._enrol(load_lab(self._lab))  # a broken one takes no job
        return True

    async def _note(
        self, state: str, taken: Taken | None = None, run: str = "", said: str = "", left_s: float | None = None
    ) -> None:
        """What this station does now, for who looks at the queue."""
        self._tell(state)
        await self._queue.tell(self.name, state)
        left_s = LEFT_STEP_S * math.ceil(left_s / LEFT_STEP_S) if left_s is not None else None
        news = {"run": run, "said": said, "left_s": left_s}
        if taken is not None and not news.items() <= taken.job.task_kwargs.items():
            await self._queue.note(taken.id, news)

    def _tell_of_no_database(self, error: ConnectorException) -> None:
        self._tell(f"the queue's database is not reached ({' '.join(str(error.__cause__).split())}); trying again")

    def _tell(self, line: str) -> None:
        if line != self._said:
            self._say(line)
            self._said = line


def _last_words(log: Path) -> str:
    return log.read_text(encoding="utf-8", errors="replace").strip()[-LAST_WORDS:]


def _identity(path: Path) -> str:
    """Of this lab's station, among those of the queue; made anew where a power cut has left nothing of it."""
    written = path.read_text(encoding="utf-8") if path.exists() else ""
    if not written:
        written = json.dumps(secrets.token_hex(8))
        with path.open("w", encoding="utf-8") as file:  # on disk before the queue has it
            file.write(written)
            file.flush()
            os.fsync(file.fileno())
    return str(json.loads(written))
