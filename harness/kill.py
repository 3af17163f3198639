"""Kill a dry run again and again, resume it until it is done, and hold the end against the world's true masses.

A child process runs the batch and is ended with SIGKILL at a random moment, also while it resumes; its simulated
world lives on in its file, as the powder would (the valve stays open until its dead-man closes it).
"""

import math
import os
import random
import signal
import time
import traceback
from collections.abc import Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from py_trees.common import Status

from scuhand_bt.events import Event, Note
from scuhand_bt.journal.hash_chain import verify
from scuhand_bt.journal.history import read_history
from scuhand_bt.journal.reader import read
from scuhand_bt.journal.store import read_only
from scuhand_bt.lab import Lab, find_lab, load_lab
from scuhand_bt.motion import MotionPlanner
from scuhand_bt.problems import SourceError
from scuhand_bt.recipe.plan import Plan, make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.run.batch import BatchObserver
from scuhand_bt.run.make_cell import DryRun, prepared_motion
from scuhand_bt.run.options import Options
from scuhand_bt.run.resume import checked_history, resumable
from scuhand_bt.run.session import Session
from scuhand_bt.sim.fault_rules import FaultFile

BROKEN = 70
"""Exit code of a child that ended by an exception."""
LOST_MG = 1e-6
WRONG_MG = 1.0
"""What the balance shows may be this far from what is in the container, and no more: noise, drift, rounding."""
SOON_S = 0.05
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


@dataclass
class Tally:
    """What was seen."""

    kills: int = 0
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
    """Shows nothing, and ends its own process at a tick; of those at which a skill is at work, where one is named."""

    def __init__(self, last_tick: int | None, within: str = "") -> None:
        self._left, self._within = last_tick, within

    def ticked(self, root: Any) -> None:
        if self._within and not any(
            node.name == self._within and node.status is Status.RUNNING for node in root.iterate()
        ):
            return
        if self._left is not None:
            self._left -= 1
            if self._left <= 0:
                os.kill(os.getpid(), signal.SIGKILL)


def make_batch(recipe: Path, folder: Path, seed: int, motion: MotionPlanner | None = None) -> Batch:
    """Read a recipe, and plan its motions unless that is done."""
    lab = load_lab(find_lab(recipe))
    plan = make_plan(load_recipe(recipe, lab), lab)
    return Batch(plan, lab, motion or prepared_motion(plan, lab), folder, seed)


@dataclass(frozen=True)
class Kill:
    """When a child is ended: after some time, or at a tick of its tree."""

    after_s: float = math.inf
    at_tick: int | None = None
    within: str = ""
    """The skill that is at work then."""
    at_event: str = ""
    """Or as soon as an entry of this kind is in the journal."""


def at_any_time(rng: random.Random, whole_s: float, kills: int) -> Iterator[Kill]:
    """Kills spread over a batch that takes `whole_s`; a share of them soon, while the child resumes."""
    for _ in range(kills):
        soon = rng.random() < RESUMING_SHARE
        yield Kill(after_s=rng.uniform(0.0, SOON_S if soon else 2.0 * whole_s / kills))


def at_ticks(rng: random.Random, most: int, kills: int) -> Iterator[Kill]:
    """Kills at ticks, which are the same ones on every computer."""
    for _ in range(kills):
        yield Kill(at_tick=rng.randint(1, 4 if rng.random() < RESUMING_SHARE else most))


def kill_until_done(batch: Batch, kills: Iterable[Kill], tally: Tally) -> None:
    """Run a batch, killing it on its way, then let it end, and judge what came of it."""
    begun: Path | None = None
    for kill in kills:
        before = len(read(begun, "entry")) if begun is not None else 0
        code = run_child(batch, begun, kill)
        if code is not None and code not in (0, 1):
            tally.problems.append(f"seed {batch.seed}: a child ended with {code} before it was killed")
            return
        begun = begun or next(iter(journals(batch.folder)), None)
        if code is not None:
            break
        tally.kills += 1
        if begun is not None:
            _look(begun, before, tally)
            if read_history(begun).is_complete:  # the kill came after its last word
                code = 0
                break
    else:
        code = run_child(batch, begun, Kill())
    begun = begun or next(journals(batch.folder))
    tally.batches += 1
    if code not in (0, 1):
        tally.problems.append(f"seed {batch.seed}: ended with {code}")
    judge(batch.plan, f"seed {batch.seed}", begun, tally)


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
    options = Options(DryRun(batch.seed, faults=batch.faults), folder=batch.folder, unattended=batch.unattended)
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
        return session.run(Deadly(kill.at_tick, kill.within)).exit_code
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


def judge(plan: Plan, name: str, journal: Path, tally: Tally) -> None:
    """Nothing lost, nothing twice, every verdict right, every entry in its place."""

    def wrong(what: str) -> None:
        tally.problems.append(f"{name}: {what}")

    with closing(read_only(journal)) as database:
        if (problem := verify(database).problem) is not None:
            wrong(problem)
    events = read(journal, "event")
    matter = [event["payload"] for event in events if event["kind"] == "matter"]
    there_mg = sum(source.amount_mg for source in plan.recipe.sources.values())
    imbalance_mg = abs(math.fsum(matter[-1].values()) - there_mg) if matter else 0.0
    tally.worst_imbalance_mg = max(tally.worst_imbalance_mg, imbalance_mg)
    if imbalance_mg > LOST_MG:
        wrong(f"{imbalance_mg} mg lost or made")
    results = {event["payload"]["id"]: event["payload"] for event in events if event["kind"] == "sample"}
    for sample in plan.recipe.samples:
        result = results[sample.id]
        true_mg, said_mg, target_mg = result["true_mg"], result["dispensed_mg"], result["target_mg"]
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
