"""Kill a run again and again, resume it until it is done, and hold the end against the world's true masses.

A child process runs the batch and is ended with SIGKILL at a random moment, also while it resumes. The simulated
world of a dry run lives on in its file, as the powder would (the valve stays open until its dead-man closes it). A
rehearsal's lives on in the process of its twins, which is killed now and then, too; it is judged by that world's file.
"""

import math
import os
import random
import signal
import tempfile
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import closing, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from py_trees.common import Status

from scuhand_bt.events.entry import Event, Note
from scuhand_bt.exit_codes import ExitCode
from scuhand_bt.journal.hash_chain import verify
from scuhand_bt.journal.history import read_history
from scuhand_bt.journal.reader import read
from scuhand_bt.journal.store import read_only
from scuhand_bt.lab import Lab, find_lab, load_lab
from scuhand_bt.motion import MotionPlanner
from scuhand_bt.problems import SourceError
from scuhand_bt.recipe.plan import Plan, make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.run.observers import BatchObserver
from scuhand_bt.run.options import Options
from scuhand_bt.run.prepared_motion import prepared_motion
from scuhand_bt.run.resume import checked_history, resumable
from scuhand_bt.run.session import Session
from scuhand_bt.run.simulation import DryRun, Rehearsal
from scuhand_bt.run.twins import WORLD, folder_of_run, have_their_process, say
from scuhand_bt.sim.fault_rules import FaultFile
from scuhand_bt.sim.world import masses_in

BROKEN = 70
"""Exit code of a child that ended by an exception."""
LOST_MG = 1e-6
WRONG_MG = 1.0
"""What the balance shows may be this far from what is in the container, and no more: noise, drift, rounding."""
TRIES = 5
"""So often a rehearsal that ended safe by itself is resumed."""
SOON_S = 0.05
REHEARSED_S = (1.0, 45.0)
TWINS_SHARE = 0.3
"""Share of a rehearsal's kills that the twins' process is killed with."""
RESUMING_SHARE = 0.3
"""Share of the kills that come soon after the child has begun."""


@dataclass
class Batch:
    """A plan to be killed, and the planner that all its children share."""

    plan: Plan
    lab: Lab
    motion: MotionPlanner
    folder: Path
    seed: int
    faults: FaultFile | None = None
    unattended: bool = False
    rehearses: bool = False
    """On twins, with the real drivers and in real time."""


@dataclass
class Tally:
    """What was seen."""

    kills: int = 0
    of_twins: int = 0
    """Those in which the twins' process was killed, too."""
    ended_safe: int = 0
    """Rehearsals that ended by themselves, as a cell does on a computer that cannot keep time, and were resumed."""
    while_resuming: int = 0
    """Kills before the resumed run had begun an action."""
    while_dosing: int = 0
    """Kills within a `dispense`."""
    batches: int = 0
    doses: int = 0
    worst_imbalance_mg: float = 0.0
    worst_error_mg: float = 0.0
    """Largest difference of a recorded mass from the true one."""
    problems: list[str] = field(default_factory=list)


class Deadly(BatchObserver):
    """Shows nothing, and ends its own process at a tick; of those at which a skill is at work, where one is named, and
    of those that count."""

    def __init__(self, last_tick: int | None, within: str = "", counts: Callable[[], bool] = lambda: True) -> None:
        self._left, self._within, self._counts = last_tick, within, counts

    def ticked(self, root: Any) -> None:
        if self._within and not any(
            node.name == self._within and node.status is Status.RUNNING for node in root.iterate()
        ):
            return
        if not self._counts():
            return
        if self._left is not None:
            self._left -= 1
            if self._left <= 0:
                os.kill(os.getpid(), signal.SIGKILL)


def make_batch(recipe: Path, folder: Path, seed: int, motion: MotionPlanner | None = None) -> Batch:
    """Read a recipe, and plan its motions unless that is done: those of a whole run, which every child would plan."""
    lab = load_lab(find_lab(recipe))
    plan = make_plan(load_recipe(recipe, lab), lab)
    if motion is None:
        motion = prepared_motion(plan, lab)
        with tempfile.TemporaryDirectory() as apart:
            session = Session(plan, lab, Options(DryRun(seed), folder=Path(apart)), motion)
            with closing(session):
                session.run(BatchObserver())
    return Batch(plan, lab, motion, folder, seed)


@dataclass(frozen=True)
class Kill:
    """When a child is ended: after some time, or at a tick of its tree."""

    after_s: float = math.inf
    at_tick: int | None = None
    within: str = ""
    """The skill that is at work then."""
    is_open: bool = False
    """Only ticks at which the valve is open count."""
    at_event: str = ""
    """Or as soon as an entry of this kind is in the journal."""
    takes_twins: bool = False
    """The twins' process, too."""


def at_any_time(rng: random.Random, whole_s: float, kills: int) -> Iterator[Kill]:
    """Kills spread over a batch that takes `whole_s`; a share of them soon, while the child resumes."""
    for _ in range(kills):
        soon = rng.random() < RESUMING_SHARE
        yield Kill(after_s=rng.uniform(0.0, SOON_S if soon else 2.0 * whole_s / kills))


def in_rehearsals(rng: random.Random, kills: int) -> Iterator[Kill]:
    """Kills after some time each, in seconds of which a resumed rehearsal needs the first few to begin."""
    for _ in range(kills):
        yield Kill(after_s=rng.uniform(*REHEARSED_S), takes_twins=rng.random() < TWINS_SHARE)


def at_ticks(rng: random.Random, most: int, kills: int) -> Iterator[Kill]:
    """Kills at ticks, which are the same ones on every computer."""
    for _ in range(kills):
        yield Kill(at_tick=rng.randint(1, 4 if rng.random() < RESUMING_SHARE else most))


def kill_until_done(batch: Batch, kills: Iterable[Kill], tally: Tally) -> None:
    """Run a batch, killing it on its way, then let it end, and judge what came of it."""
    with closing(_Orphans(batch.folder)) as orphans:
        _kill_until_done(batch, kills, tally, orphans)


def _kill_until_done(batch: Batch, kills: Iterable[Kill], tally: Tally, orphans: "_Orphans") -> None:
    begun: Path | None = None
    for kill in kills:
        before = len(read(begun, "entry")) if begun is not None else 0
        code = _run_on(batch, begun, kill, tally)
        begun = begun or next(iter(journals(batch.folder)), None)
        if code is not None and code not in (0, 1):
            tally.problems.append(f"seed {batch.seed}: a child ended with {code} before it was killed")
            return
        if code is not None:
            break
        tally.kills += 1
        tally.of_twins += orphans.are_left(begun, are_killed=kill.takes_twins)
        if begun is not None:
            _look(begun, before, tally)
            if read_history(begun).is_complete:  # the kill came after its last word
                code = 0
                break
    else:
        code = _run_on(batch, begun, Kill(), tally)
    begun = begun or next(journals(batch.folder))
    tally.batches += 1
    if code not in (0, 1):
        tally.problems.append(f"seed {batch.seed}: ended with {code}")
    masses_mg = masses_in(folder_of_run(begun) / WORLD) if batch.rehearses else None
    judge(batch.plan, f"seed {batch.seed}", begun, tally, masses_mg)


def _run_on(batch: Batch, begun: Path | None, kill: Kill, tally: Tally) -> int | None:
    """As `run_child`; a rehearsal that ended safe is resumed."""
    code = run_child(batch, begun, kill)
    for _ in range(TRIES if batch.rehearses else 0):
        if code != ExitCode.CELL_FAULT:
            break
        tally.ended_safe += 1
        code = run_child(batch, begun or next(journals(batch.folder), None), kill)
    return code


class _Orphans:
    """The twins of killed runs, in the folder of their journals."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def are_left(self, of: Path | None, *, are_killed: bool) -> bool:
        """Only those of this run go on, if they are not killed as well; whether they were."""
        kept = folder_of_run(of) if of is not None else None
        for folder in self._running():
            if folder != kept:
                say(folder, ["end"])
        if not (are_killed and kept is not None and have_their_process(kept)):
            return False
        with suppress(SourceError):  # it has just begun, and hears nothing yet
            os.kill(int(str(say(kept, ["look"]).found["pid"])), signal.SIGKILL)
            return True
        return False

    def close(self) -> None:
        for folder in self._running():
            say(folder, ["end"])

    def _running(self) -> list[Path]:
        return [folder for folder in self._folder.glob("*.twins") if have_their_process(folder)]


def journals(folder: Path) -> Iterator[Path]:
    return (path for path in sorted(folder.glob("*.sqlite")) if _has_begun(path))


def _has_begun(path: Path) -> bool:
    """A run that was killed before its first word is none."""
    try:
        return bool(read(path, "run"))
    except SourceError:
        return False


def run_child(batch: Batch, begun: Path | None, kill: Kill) -> int | None:
    """Run, or resume, in a process of its own; its exit code, None if it was killed."""
    child = os.fork()
    if child == 0:
        code = BROKEN
        try:
            code = _run(batch, begun, kill)
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(code)
    deadline = time.monotonic() + kill.after_s
    while time.monotonic() < deadline:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            return None if os.WIFSIGNALED(status) else os.waitstatus_to_exitcode(status)
        time.sleep(0.001)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return None


def _run(batch: Batch, begun: Path | None, kill: Kill) -> int:
    kind = Rehearsal if batch.rehearses else DryRun
    options = Options(kind(batch.seed, faults=batch.faults), folder=batch.folder, unattended=batch.unattended)
    with Path(os.devnull).open() as nobody:  # who starts this at a terminal is not asked
        os.dup2(nobody.fileno(), 0)
    found = None
    if begun is not None:
        found = resumable(begun, checked_history(begun), batch.plan, batch.lab, accept_changes=False)
    session = Session(batch.plan, batch.lab, options, batch.motion, resumes=found)
    heard = session.journal.heard

    def deadly(event: Event | Note) -> None:
        heard(event)
        if event.entry()[0] == kill.at_event:
            os.kill(os.getpid(), signal.SIGKILL)

    session.journal.heard = deadly
    try:
        hand = session.cell.hand
        deadly = Deadly(kill.at_tick, kill.within, lambda: hand.opening_mm > 0.0 or not kill.is_open)
        return session.run(deadly).exit_code
    finally:
        session.close()


def _look(journal: Path, before: int, tally: Tally) -> None:
    """Where the kill came, of a program that had found `before` entries."""
    kinds = [row["kind"] for row in read(journal, "entry")]
    if before and "action_started" not in kinds[before:]:
        tally.while_resuming += 1
    actions = read(journal, "action")
    if actions and actions[-1]["skill"] == "dispense" and actions[-1]["outcome"] == "started":
        tally.while_dosing += 1


def judge(plan: Plan, name: str, journal: Path, tally: Tally, masses_mg: Mapping[str, float] | None = None) -> None:
    """Nothing lost, nothing twice, every verdict right, every entry in its place.

    By `masses_mg` of the world, or what the journal has of them.
    """

    def wrong(what: str) -> None:
        tally.problems.append(f"{name}: {what}")

    with closing(read_only(journal)) as database:
        if (problem := verify(database).problem) is not None:
            wrong(problem)
    events = read(journal, "event")
    matter = [event["payload"] for event in events if event["kind"] == "matter"]
    there_mg = sum(source.amount_mg for source in plan.recipe.sources.values())
    found_mg = masses_mg or (matter[-1] if matter else None)
    imbalance_mg = abs(math.fsum(found_mg.values()) - there_mg) if found_mg else 0.0
    tally.worst_imbalance_mg = max(tally.worst_imbalance_mg, imbalance_mg)
    if imbalance_mg > LOST_MG:
        wrong(f"{imbalance_mg} mg lost or made")
    results = {event["payload"]["id"]: event["payload"] for event in events if event["kind"] == "sample"}
    for sample in plan.recipe.samples:
        result = results[sample.id]
        true_mg, said_mg, target_mg = result["true_mg"], result["dispensed_mg"], result["target_mg"]
        if masses_mg is not None:
            container = result["doses"][-1]["container"] if result["doses"] else sample.id
            true_mg = masses_mg.get(f"container:{container}", 0.0)
        tally.doses += 1
        if said_mg is None or result["verdict"] in ("interrupted", "not run"):
            wrong(f"{sample.id}: {result['verdict']}, {result['code']}, true {true_mg}")
            continue
        tally.worst_error_mg = max(tally.worst_error_mg, abs(said_mg - true_mg))
        if abs(said_mg - true_mg) > WRONG_MG:
            wrong(f"{sample.id}: {said_mg:.2f} mg said, {true_mg:.2f} mg true")
        is_in = abs(true_mg - target_mg) <= result["tolerance_mg"]
        near = abs(abs(true_mg - target_mg) - result["tolerance_mg"]) <= WRONG_MG
        if (result["verdict"] == "in tolerance") != is_in and not near:
            wrong(f"{sample.id}: '{result['verdict']}' at {true_mg:.2f} mg of {target_mg:g} mg")
