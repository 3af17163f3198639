"""One lab, several processes: a random interleaving of all that users, edits, clocks, disks and power cuts do to a run.

Its seed decides all of it, as every process moves only between gates (`harness/gated.py`). At the end what was broken
is mended, and every run is resumed until it is complete or says why it cannot be; then it is judged
(`harness/interleaving_judge.py`).
"""

import random
import shutil
import sqlite3
import time
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import ClassVar

from harness.gated import FREE, Command, Computer, start
from harness.interleaved_lab import Done, Made, heads_of, make_lab, read_is_complete
from scuhand_bt.journal.history import read_history
from scuhand_bt.lab_state.ledger import Ledger
from scuhand_bt.problems import SourceError

POWER_CUTS_WEIGHT = 36
"""How much likelier a process is killed where that is a power cut, so that most of these interleavings have one."""
TICKS = 250
"""Of a run's 560, the most that it goes on at a time."""
TRIES = 8
CLOCKS_S = (-86400.0, 3600.0, 30 * 365 * 86400.0)


def interleave(made: Made) -> Done:
    """Let it happen, then mend what was broken, and let every run come to its end."""
    world = _Lab(Done(made))
    try:
        if made.script:
            for step in made.script:
                world.does(step)
        else:
            world.does("begin")
            for _ in range(made.steps):
                world.does(world.draw())
        world.to_the_end()
    except TimeoutError as hangs:
        world.done.wrong(str(hangs))
        world.ends()
    return world.done


class _Lab:
    """A lab and the processes that have to do with it."""

    def __init__(self, done: Done) -> None:
        self.done, self.made = done, done.made
        self.rng = random.Random(self.made.seed)
        self.live: list[Command] = []
        self._whole: dict[Path, str] = {}
        """What a file that is broken now was."""
        self._taken: dict[str, Path] = {}
        """Runs whose journal was taken away, and where it is."""
        self._clock_s = 0.0
        self._recipe, self._faults = make_lab(self.made)

    # --- what may happen

    WEIGHTS: ClassVar = {
        "go": 30, "finish": 3, "kill": 12, "resume": 16, "begin": 1, "elsewhere": 2, "stop": 2, "stop --now": 4,
        "pause": 2, "pause --now": 3, "look": 4, "inventory": 3, "half_save": 3, "edit": 2, "mend": 4, "clock": 3,
        "full": 2, "unlock": 3, "take": 2, "lose": 1, "replace": 1, "give_back": 3,
    }  # fmt: skip

    def draw(self) -> str:
        weights = self.WEIGHTS | ({"kill": POWER_CUTS_WEIGHT} if self.made.has_outages else {})
        return self.rng.choices(list(weights), list(weights.values()))[0]

    def does(self, step: str) -> None:
        """One step; `go:60` names the ticks, `kill@0` the process (the first that lives), the rest is drawn."""
        name, _, which = step.partition("@")
        name, _, amount = name.partition(":")
        waiting = [command for command in self.live if command.gate or command.is_wished_paused]
        one = waiting[int(which)] if which else self.rng.choice(waiting) if waiting else None
        doing = getattr(self, "_" + name.split()[0].replace("-", "_"))
        before = len(self.done.happened)
        doing(name, one, int(amount or self.rng.randint(1, TICKS)))
        if len(self.done.happened) > before:
            self.done.count[name] += 1

    def _said(self, what: str) -> None:
        self.done.happened.append(what)

    def _name(self) -> str | None:
        """A run that there is."""
        names = [path.stem for path in self.done.journals]
        return self.rng.choice(names) if names else None

    def _start(self, args: Sequence[str], *, run: str = "", ticks: int = 1, is_another: bool = False) -> Command:
        output = self.made.folder / f"out{len(self.done.ended) + len(self.live)}"
        computer = Computer(self._clock_s, is_another, ticks)
        command = start(args, output, self.made.motion, self.made.plant, computer, run)
        self.live.append(command)
        self._collect()
        return command

    def _collect(self) -> None:
        for command in [one for one in self.live if one.code is not None]:
            self.live.remove(command)
            self.done.ended.append(command)

    def _now(self, *args: str, run: str = "") -> Command:
        """A command that is over at once."""
        command = self._start(args, run=run)
        while command.code is None:
            command.go()
        self._collect()
        return command

    def _begin(self, name: str, one: Command | None, ticks: int) -> None:
        if len(self.done.journals) + len(self._taken) < 2:
            faults = ["--faults", str(self._faults)] if self.made.has_outages else []
            self._said("run")
            self._start(["run", str(self._recipe), "--dry-run", "--seed", str(self.made.seed), *faults], ticks=ticks)

    def _go(self, name: str, one: Command | None, ticks: int) -> None:
        if one is not None and one.gate:
            self._said(f"{one.args[0]} {one.process} goes on from its {one.gate}, {ticks} ticks")
            one.go(ticks)
            self._collect()

    def _finish(self, name: str, one: Command | None, ticks: int) -> None:
        self._go(name, one, FREE)

    def _kill(self, name: str, one: Command | None, ticks: int) -> None:
        if one is not None:
            self._said(f"{one.args[0]} {one.process} is killed")
            one.kill()
            self._collect()

    def _resume(self, name: str, one: Command | None, ticks: int) -> None:
        if (run := self._name()) is not None and len(self.live) < 4:
            self._said("resume")
            args = ["resume", run, "--lab", str(self.made.lab)]
            args += ["--accept-changes"] if self.rng.random() < 0.5 else []
            for other in self.live:
                if other.run == run and other.is_wished_paused:
                    other.is_wished_paused = False  # it is heard, or refused: either way it is told below
            self._start(args, run=run, ticks=ticks)
            for other in self.live:
                if not other.gate and other.code is None:
                    other.wait()
            self._collect()

    def _elsewhere(self, name: str, one: Command | None, ticks: int) -> None:
        """Another computer on the same disk, which locks nothing there: only the journal itself can tell them apart."""
        if (run := self._name()) is not None:
            self._said("resume on another computer")
            (self.done.runs / f"{run}.lock").unlink(missing_ok=True)
            args = ["resume", run, "--lab", str(self.made.lab), "--accept-changes"]
            self._start(args, run=run, ticks=ticks, is_another=True)

    def _stop(self, name: str, one: Command | None, ticks: int) -> None:
        if (run := self._name()) is not None:
            word, *now = name.split()
            self._said(f"{name}")
            listening = [
                other for other in self.live if other.run == run and other.gate == "tick" and not other.is_elsewhere
            ]
            done = self._now(word, run, *now, "--lab", str(self.made.lab))
            if listening and done.code != 0:
                self.done.wrong(f"'{name}' is refused by a run that goes on: {done.text.strip()}")
            if word == "pause" and listening:
                listening[0].is_wished_paused = True

    _pause = _stop

    def _look(self, name: str, one: Command | None, ticks: int) -> None:
        if (run := self._name()) is not None:
            args = self.rng.choice([["runs"], ["show", run], ["verify", run]])
            self._said(" ".join(args[:1]))
            done = self._now(*args, "--lab", str(self.made.lab))
            is_new = len(self.done.journals) + len(self._taken) > 0 and not heads_of(self.done.runs / f"{run}.sqlite")
            if done.code != 0 and not is_new:
                self.done.wrong(f"'{args[0]}' ends with {done.code}: {done.text.strip()}")

    def _inventory(self, name: str, one: Command | None, ticks: int) -> None:
        self._said("inventory set")
        done = self._now("inventory", "--lab", str(self.made.lab), "set", "cone", "0 mg")
        if done.code != (2 if self._whole else 0) and not (self._whole and done.code == 0):
            self.done.wrong(f"'inventory set' ends with {done.code}: {done.text.strip()}")

    def _half_save(self, name: str, one: Command | None, ticks: int) -> None:
        """An editor has written the first half of a file."""
        names = ["trees/fill.yaml", "trees/fill_crucible.yaml", "robot/powders.yaml", "recipes/shared.yaml"]
        path = self.made.lab / self.rng.choice([one for one in names if (self.made.lab / one).exists()])
        if path not in self._whole:
            self._whole[path] = path.read_text(encoding="utf-8")
            self._said(f"{path.name} is half saved")
            half = self._whole[path][: len(self._whole[path]) // 2]
            path.write_text(f"{half}\nsequence:\n", encoding="utf-8")

    def _edit(self, name: str, one: Command | None, ticks: int) -> None:
        path = self.made.lab / "trees" / "fill_xrd_holder.yaml"
        self._said(f"{path.name} is edited")
        with path.open("a", encoding="utf-8") as file:
            file.write("# seen\n")

    def _mend(self, name: str, one: Command | None, ticks: int) -> None:
        for path, text in self._whole.items():
            self._said(f"{path.name} is saved")
            path.write_text(text, encoding="utf-8")
        self._whole.clear()

    def _clock(self, name: str, one: Command | None, ticks: int) -> None:
        self._clock_s = self.rng.choice(CLOCKS_S)
        self._said(f"the clock is set by {self._clock_s:g} s")
        if one is not None and one.gate:
            one.go(ticks, "clock", self._clock_s)
            self._collect()

    def _full(self, name: str, one: Command | None, ticks: int) -> None:
        if one is not None and one.gate:
            self._said(f"the disk of {one.args[0]} {one.process} is full")
            one.is_mute = True
            one.go(ticks, "full", self.rng.choice([0, 4096, 200_000]))
            self._collect()

    def _unlock(self, name: str, one: Command | None, ticks: int) -> None:
        for lock in self.done.runs.glob("*.lock"):
            self._said("a lock is deleted")
            lock.unlink()

    def _take(self, name: str, one: Command | None, ticks: int) -> None:
        """A journal is moved away, perhaps from under the process that writes it."""
        if (run := self._name()) is not None:
            self._said("a journal is taken away")
            away = self.made.folder / "taken"
            away.mkdir(exist_ok=True)
            self._taken[run] = away
            for part in self.done.runs.glob(f"{run}.sqlite*"):
                part.rename(away / part.name)

    def _lose(self, name: str, one: Command | None, ticks: int) -> None:
        """A journal is deleted from under the process that writes it."""
        if one is not None and one.gate == "tick":
            self._said("a journal is deleted")
            self.done.deleted_s[one.run] = time.monotonic()
            for part in self.done.runs.glob(f"{one.run}.sqlite*"):
                part.unlink()

    def _replace(self, name: str, one: Command | None, ticks: int) -> None:
        """A journal is replaced by a copy of itself, as a tool that synchronises folders does."""
        busy = [other.run for other in self.live if other.gate == "tick"]
        run = self._name()
        if run is not None and run in busy:
            self._said("a journal is replaced")
            path = self.done.runs / f"{run}.sqlite"
            copy = path.with_suffix(".copy")
            with closing(sqlite3.connect(path)) as database, closing(sqlite3.connect(copy)) as other:
                database.backup(other)
            for part in self.done.runs.glob(f"{run}.sqlite*"):
                part.unlink()
            copy.rename(path)

    def _give_back(self, name: str, one: Command | None, ticks: int) -> None:
        """A journal that was taken away comes back, or the one that its run has rescued; first its process ends."""
        for run, away in list(self._taken.items()):
            if any(other.run == run for other in self.live):
                continue
            self._said("a journal is given back")
            for part in away.glob(f"{run}.sqlite*"):
                part.rename(self.done.runs / part.name)
            del self._taken[run]

    def _use_rescued(self) -> None:
        """Where a run has kept the rest of its journal elsewhere, that may be the journal from now on.

        Not where another went on with the run: there are two of its end then, and the journal has the true one.
        """
        for rescued in sorted(self.done.runs.parent.glob("rescued-*/*.sqlite")):
            path = self.done.runs / rescued.name
            heads, known = heads_of(rescued), heads_of(path)
            told = [one.line for one in Ledger(self.done.runs.parent).verified().of(path.stem)]
            is_whole = heads[: len(known)] == known and all(
                heads[line.entries - 1 : line.entries] == [bytes.fromhex(line.head)] for line in told
            )
            if is_whole and (not path.exists() or self.rng.random() < 0.5):
                self._said("a rescued journal is used")
                for part in self.done.runs.glob(f"{rescued.stem}.sqlite*"):
                    part.unlink()
                for part in rescued.parent.glob(f"{rescued.stem}.sqlite*"):
                    part.rename(self.done.runs / part.name)
            shutil.rmtree(rescued.parent)

    # --- the end

    def ends(self) -> None:
        """Every process is killed, at its gate or not."""
        for command in self.live:
            if command.code is None:
                command.kill()
        self._collect()

    def to_the_end(self) -> None:
        """Everything is mended, every process comes to its end, every run is resumed until nothing is left to do."""
        self._mend("mend", None, 0)
        for command in list(self.live):
            while command.code is None:
                if command.gate:
                    command.go()
                else:
                    command.is_wished_paused = False
                    self._now("resume", command.run, "--lab", str(self.made.lab), run=command.run)
                    command.wait()
            self._collect()
        self._give_back("give_back", None, 0)
        self._use_rescued()
        self._clock_s = 0.0
        for journal in self.done.journals:
            for _ in range(2 if self.made.careless else TRIES):
                try:
                    if read_history(journal).is_complete:
                        break
                except SourceError:
                    pass
                again = self._now(
                    "resume", journal.stem, "--lab", str(self.made.lab), "--accept-changes", run=journal.stem
                )
                if again.code == 2:
                    self.done.given_up[journal.stem] = again.text.strip().splitlines()[-1]
                    break
                self.done.given_up[journal.stem] = next(
                    (line.partition("Ended early: ")[2] for line in again.text.splitlines() if "Ended early" in line),
                    "",
                )
            else:
                continue
            if read_is_complete(journal):
                self.done.given_up.pop(journal.stem, None)
