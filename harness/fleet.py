"""A fleet on loopback: simulated stations, submitters and a PostgreSQL, killed again and again, and then judged.

Every station, run, submitter and server is a program of its own. A station is ended with SIGKILL, alone (its run goes
on as an orphan) or with its run; a submitter at any moment; the server as by a power cut or in order, and started
again. In the end nothing is killed any more, the queue is worked off, and each run is held against its simulated world.
"""

import asyncio
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from harness.kill import Tally, judge
from harness.postgres import Server
from scuhand_bt.fleet.of_journal import key_of
from scuhand_bt.fleet.queue import QueuedJob, open_queue
from scuhand_bt.journal.store import read_only
from scuhand_bt.lab import load_lab, starter_lab
from scuhand_bt.recipe.plan import make_plan
from scuhand_bt.recipe.recipe import load_recipe

RECIPE = """recipe: chaos
workflow: fill_xrd_holder
sources:
  mortar-1: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 8 g}
defaults: {source: mortar-1, container: xrd_holder, tolerance: 3 mg}
samples:
  - {id: x, mass: 40 mg, repeat: 48}
on_failure: {dose.overshoot: flag, dose.not_reached: flag, otherwise: stop}
"""
COMMAND = (sys.executable, "-m", "scuhand_bt")
PATIENCE_S = 600.0
"""So long the queue may take to be worked off, once nothing is killed any more."""


@dataclass
class Chaos:
    """What was done, and what came of it."""

    kills: Counter[str] = field(default_factory=Counter)
    acknowledged: int = 0
    unacknowledged: int = 0
    """Submitters that were killed before they had an answer."""
    jobs: Counter[str] = field(default_factory=Counter)
    """By their status in the end."""
    resumed: int = 0
    """Runs that were taken up again at least once."""
    tally: Tally = field(default_factory=Tally)


class Fleet:
    """Some simulated stations in labs of their own, below a folder."""

    def __init__(self, folder: Path, server: Server, stations: int) -> None:
        self.server, self.labs = server, {f"cell-{n}": folder / f"cell-{n}" for n in range(1, stations + 1)}
        for lab in self.labs.values():
            for part in ("robot", "skills", "trees"):
                shutil.copytree(starter_lab() / part, lab / part, ignore=shutil.ignore_patterns("__pycache__"))
        self.recipe = next(iter(self.labs.values())) / "chaos.yaml"
        self.recipe.write_text(RECIPE, encoding="utf-8")
        self.environment = {**os.environ, "SCUHAND_DATABASE": server.address(), "OMP_NUM_THREADS": "1"}
        self.log = (folder / "stations.txt").open("ab")
        self.running: dict[str, subprocess.Popen[bytes]] = {}

    def start(self, name: str) -> None:
        words = ("station", "--dry-run", "--resume", "--name", name, "--lab", str(self.labs[name]))
        self.running[name] = self._program(*words, stdout=self.log, stderr=self.log)

    def see_to(self) -> None:
        """A station that has ended by itself, as its database was away when it began, begins again: systemd's part."""
        for name, program in list(self.running.items()):
            if program.poll() is not None:
                self.start(name)

    def kill(self, name: str, *, with_run: bool) -> None:
        program = self.running.pop(name)
        if with_run:
            os.killpg(program.pid, signal.SIGKILL)
        else:
            program.kill()
        program.wait()

    def submit(self, seed: int) -> "subprocess.Popen[bytes]":
        words = ("submit", str(self.recipe), "--dry-run", "--seed", str(seed), "--json")
        return self._program(*words, stdout=subprocess.PIPE, stderr=subprocess.PIPE)

    def jobs(self) -> list[QueuedJob]:
        async def all_of_them() -> list[QueuedJob]:
            async with open_queue(self.server.address()) as queue:
                return await queue.jobs(every=True, limit=10_000)

        return asyncio.run(all_of_them())

    def end(self) -> None:
        for name in list(self.running):
            self.kill(name, with_run=True)
        self.log.close()

    def _program(self, *words: str, **streams: Any) -> "subprocess.Popen[bytes]":
        """In a group of its own, as a person's terminal makes one."""
        return subprocess.Popen([*COMMAND, *words], env=self.environment, start_new_session=True, **streams)


def chaos(folder: Path, server: Server, *, kills: int, seed: int, pause_s: tuple[float, float] = (0.5, 6.0)) -> Chaos:
    """Submit, run and kill, so many times, at moments between which as long passes; then let it end, and judge."""
    rng, done, fleet = random.Random(seed), Chaos(), Fleet(folder, server, stations=3)
    try:
        for name in fleet.labs:
            fleet.start(name)
        _await_stations(fleet)
        while done.kills.total() < kills:
            fleet.see_to()
            submitter, to_kill = fleet.submit(done.kills.total()), rng.random() < 0.3
            time.sleep(rng.uniform(*pause_s))
            if to_kill and submitter.poll() is None:
                submitter.kill()
                done.kills["submitter"] += 1
            what = rng.choices(("station", "station and run", "server"), (3, 5, 2))[0]
            if what == "server":
                server.restart("immediate" if rng.random() < 0.5 else "fast")
            else:
                name = rng.choice(list(fleet.running))
                fleet.kill(name, with_run=what == "station and run")
                fleet.start(name)
            done.kills[what] += 1
            answer, _ = submitter.communicate(timeout=PATIENCE_S)
            if submitter.returncode == 0:
                done.acknowledged += len(json.loads(answer))
            else:
                done.unacknowledged += 1
        _await_end(fleet)
        _judge(fleet, done)
    finally:
        fleet.end()
    return done


def _await_stations(fleet: Fleet) -> None:
    async def are_there() -> bool:
        async with open_queue(fleet.server.address()) as queue:
            return len(await queue.stations()) == len(fleet.labs)

    _await(lambda: asyncio.run(are_there()))


def _await_end(fleet: Fleet) -> None:
    def is_at_its_end() -> bool:
        fleet.see_to()
        return all(job.status not in ("todo", "doing") for job in fleet.jobs())

    _await(is_at_its_end)


def _await(is_so: Any) -> None:
    until_s = time.monotonic() + PATIENCE_S
    while not is_so():
        if time.monotonic() > until_s:
            raise TimeoutError("the fleet has not come to its end")
        time.sleep(1.0)


def _judge(fleet: Fleet, done: Chaos) -> None:
    """Each job is over and was run once; no run is without its job; every world holds what its journal says."""
    problems = done.tally.problems
    jobs = fleet.jobs()
    done.jobs.update(job.status for job in jobs)
    if not done.acknowledged <= len(jobs) <= done.acknowledged + done.unacknowledged:
        problems.append(f"{len(jobs)} jobs; {done.acknowledged} were acknowledged, {done.unacknowledged} were not")
    runs = {path.stem: path for lab in fleet.labs.values() for path in (lab / ".scuhand" / "runs").glob("*.sqlite")}
    begun = {name: key for name, path in runs.items() if (key := key_of(path)) is not None}
    problems += [f"order {key} was run {times} times" for key, times in Counter(begun.values()).items() if times > 1]
    if set(begun) != {job.run for job in jobs if job.run}:
        problems.append(f"runs {sorted(begun)} are not those of the jobs {sorted(job.run for job in jobs)}")
    lab = load_lab(next(iter(fleet.labs.values())))
    plan = make_plan(load_recipe(fleet.recipe, lab), lab)
    for job in jobs:
        if job.status != "succeeded" or not job.run:
            problems.append(f"job {job.id}: {job.status}: {job.said}")
            continue
        judge(plan, f"job {job.id}", runs[job.run], done.tally)
        done.tally.batches += 1
        entries = read_only(runs[job.run])
        done.resumed += bool(entries.execute("SELECT count(*) FROM entry WHERE kind = 'resumed'").fetchone()[0])
        entries.close()
