"""What an interleaving may have come to: a small model, and the true masses of the simulated world.

- A command ends with a documented code, without a traceback; a run's code is the one that its journal tells.
- Each sample is begun at most once per attempt, in the recipe's order, and each container is dosed at most once.
- What is called good is truly within its tolerance; what was poured, arrived or fell somewhere that the world names.
- `verify` accepts what nobody touched, and refuses what somebody wrote anew, as far as the ledger reaches.
- A run is complete, or can be resumed, or says why not.
"""

import math
import random
import shutil
import sqlite3
from collections import Counter
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from harness.gated import BROKEN, Command, start
from harness.interleavings import SOURCE_MG, TARGETS_MG, TOLERANCE_MG, Done, entries_of, read_is_complete
from scuhand_bt.journal.hash_chain import COLUMNS, GENESIS, Entry, digest
from scuhand_bt.journal.reader import read
from scuhand_bt.lab_state.ledger import Ledger
from scuhand_bt.problems import SourceError

LOST_MG = 1e-6
WRONG_MG = 0.1
"""A good dose may be farther from its target than its tolerance by this much: what a balance of 0.1 mg can tell."""
SPILLED_MG = 1.0
"""Nothing is spilled without a power cut, or a skill that opens the valve beside the container."""
CODES = {0, 1, 2, 3, 130}


@dataclass
class Tally:
    """What was seen."""

    interleavings: int = 0
    with_power_cuts: int = 0
    """Of these, those in which a process was killed and the devices changed by it."""
    processes: int = 0
    killed: int = 0
    runs: int = 0
    complete: int = 0
    doses: int = 0
    good: int = 0
    forgeries: int = 0
    steps: Counter[str] = field(default_factory=Counter)
    stuck: Counter[str] = field(default_factory=Counter)
    """Runs that are not complete, by why."""
    worst_error_mg: float = 0.0
    """Largest difference of a good dose's recorded mass from the true one."""
    worst_imbalance_mg: float = 0.0
    problems: list[str] = field(default_factory=list)


def judge(done: Done, tally: Tally) -> list[str]:
    """Hold all that has happened against the model; its problems, which the tally has then, too."""
    tally.interleavings += 1
    tally.with_power_cuts += done.power_cuts > 0
    tally.steps += done.count
    for command in done.ended:
        tally.processes += 1
        tally.killed += command.code == -9
        _judge_command(done, command)
    for journal in done.journals:
        _judge_run(done, journal, tally)
    if done.journals:
        _judge_evidence(done, tally)
    tally.problems += done.problems
    return done.problems


def _judge_command(done: Done, command: Command) -> None:
    name = command.args[0]
    if command.code == -9:
        return
    if command.code not in CODES or command.code == BROKEN:
        done.wrong(f"'{name}' ends with {command.code}: {command.text[-300:]}")
    if "Traceback" in command.text:
        done.wrong(f"'{name}' shows a traceback: {command.text[-300:]}")
    if name not in ("run", "resume"):
        return
    if command.came_to is None:
        if command.code in (0, 1, 130) and not command.text.strip().endswith("continues."):
            done.wrong(f"'{name}' ends with {command.code}, and the engine said nothing")
        return
    if command.came_to != command.code:
        done.wrong(f"'{name}' ends with {command.code}, and the engine said {command.came_to}")
    if not command.is_mute:
        if command.code in (3, 130) and "Ended early: " not in command.text and "did not stop" not in command.text:
            done.wrong(f"'{name}' ends with {command.code} and does not say why: {command.text[-300:]}")
        if command.code == 0 and "2 of 2 samples good" not in command.text:
            done.wrong(f"'{name}' ends with 0, and not all is good: {command.text[-300:]}")
    _judge_end(done, command)


def _judge_end(done: Done, command: Command) -> None:
    """How a run ended is in its journal; a process that lost that has a cell fault, and may have kept it elsewhere."""
    path = done.runs / f"{command.run}.sqlite"
    try:
        codes = [event["payload"]["exit_code"] for event in read(path, "event") if event["kind"] == "ended"]
    except SourceError:
        codes = []
    if command.code != 3 and command.code not in codes:
        done.wrong(f"'{command.args[0]}' ends with {command.code}, which its journal does not have: {codes}")


def _judge_run(done: Done, journal: Path, tally: Tally) -> None:
    def wrong(what: str) -> None:
        done.wrong(f"{journal.stem[-4:]}: {what}")

    tally.runs += 1
    run = journal.stem
    try:
        jobs, events, doses = read(journal, "job"), read(journal, "event"), read(journal, "dose")
    except SourceError as error:
        if run not in done.given_up:
            wrong(f"it cannot be read, and nobody said so: {error}")
        return
    is_complete = read_is_complete(journal)
    tally.complete += is_complete
    if is_complete and done.made.careless:
        wrong(f"it is complete, though its skill {done.made.careless}")
    if not is_complete:
        if not (why := done.given_up.get(run, "")):
            wrong("it is neither complete nor does it say why not")
        tally.stuck[_kind(why)] += 1
    began = Counter((job["sample"], job["attempt"]) for job in jobs if job["sample"])
    if twice := [each for each, count in began.items() if count > 1]:
        wrong(f"begun twice: {twice}")
    order = list(dict.fromkeys(job["sample"] for job in jobs if job["sample"]))
    if order != [name for name in TARGETS_MG if name in order] or (order and order[0] != "a"):
        wrong(f"in another order: {order}")
    dosed = Counter(dose["payload"]["container"] for dose in doses)
    if twice := [container for container, count in dosed.items() if count > 1]:
        wrong(f"dosed twice: {twice}")
    matter = _true(done, run)
    if matter is None:
        return
    imbalance_mg = abs(math.fsum(matter.values()) - SOURCE_MG)
    tally.worst_imbalance_mg = max(tally.worst_imbalance_mg, imbalance_mg)
    if imbalance_mg > LOST_MG:
        wrong(f"{imbalance_mg} mg lost or made")
    is_still = not done.made.has_outages and done.made.careless != "leaves the valve open"
    if is_still and matter.get("spilled", 0.0) > SPILLED_MG:
        wrong(f"{matter['spilled']:.1f} mg spilled, and nothing has fallen")
    results = {event["payload"]["id"]: event["payload"] for event in events if event["kind"] == "sample"}
    if is_complete and set(results) != set(TARGETS_MG):
        wrong(f"it is complete, and has results of {sorted(results)} only")
    for name, result in results.items():
        _judge_sample(name, result, matter, done, tally, wrong, is_complete=is_complete)


def _judge_sample(
    name: str,
    result: dict[str, Any],
    matter: dict[str, float],
    done: Done,
    tally: Tally,
    wrong: Any,
    *,
    is_complete: bool,
) -> None:
    tally.doses += 1
    containers = {dose["container"] for dose in result["doses"]}
    true_mg = math.fsum(matter.get(f"container:{container}", 0.0) for container in containers)
    if is_complete and result["verdict"] in ("interrupted", "not run") and result.get("code") is None:
        wrong(f"{name}: '{result['verdict']}' in a run that is complete")
    if result.get("code") is not None or result["verdict"] != "in tolerance":
        said_mg = result["dispensed_mg"]
        if said_mg is not None and not done.made.has_outages and abs(said_mg - true_mg) > 10 * WRONG_MG:
            wrong(f"{name}: {said_mg:.2f} mg said, {true_mg:.2f} mg true")
        return
    tally.good += 1
    tally.worst_error_mg = max(tally.worst_error_mg, abs(true_mg - result["dispensed_mg"]))
    if abs(true_mg - TARGETS_MG[name]) > TOLERANCE_MG + WRONG_MG:
        wrong(f"{name}: good at {result['dispensed_mg']:.2f} mg, {true_mg:.2f} mg true of {TARGETS_MG[name]:g} mg")


def _true(done: Done, run: str) -> dict[str, float] | None:
    """The true masses at the end of a run, as the last process told them that had it."""
    for command in reversed(done.ended):
        if command.run == run and command.came_to is not None and not command.is_overtaken:
            return dict(command.seen["matter"])
    return None


def _kind(why: str) -> str:
    """A reason without its names and figures."""
    for known in (
        "simulated world", "careless", "nothing had moved", "journal is empty", "no run", "arm.", "container.",
        "operator.", "overshoot", "interrupted", "stopped", "device.",
    ):  # fmt: skip
        if known in why:
            return known
    return why[-80:]


# --- evidence


def _judge_evidence(done: Done, tally: Tally) -> None:
    """`verify` accepts every journal as it is, and no forgery of one of them."""
    rng = random.Random(done.made.seed)
    for journal in done.journals:
        told = _verify(done, journal)
        if told.code != 0 and entries_of(journal):
            done.wrong(f"`verify` refuses what nobody touched: {told.text.strip()}")
    journal = rng.choice(done.journals)
    last = max((one.line.entries for one in Ledger(done.runs.parent).verified().of(journal.stem)), default=0)
    if not entries_of(journal) or last < 2:
        return
    state = done.made.folder / "forged"
    (state / "runs").mkdir(parents=True)
    shutil.copy(done.runs.parent / "lab.db", state)
    forged = state / "runs" / journal.name
    how = rng.choice(["altered", "written anew", "cut off", "taken out"])
    _forge(journal, forged, how, rng.randint(1, last), last)
    tally.forgeries += 1
    if (told := _verify(done, forged)).code != 3:
        done.wrong(f"`verify` ends with {told.code} for a journal that was {how}: {told.text.strip()}")


def _verify(done: Done, journal: Path) -> Command:
    output = done.made.folder / f"verified-{journal.stem[-4:]}-{journal.parent.parent.name.strip('.')}"
    command = start(["verify", str(journal)], output, done.made.motion, done.made.plant)
    command.wait()
    return command


def _forge(journal: Path, forged: Path, how: str, seq: int, last: int) -> None:
    """A copy of a journal in which an entry is not what it was."""
    with closing(sqlite3.connect(journal)) as database, closing(sqlite3.connect(forged)) as copy:
        database.backup(copy)
    with closing(sqlite3.connect(forged, isolation_level=None)) as copy:
        copy.execute("DROP TRIGGER entries_stay")
        copy.execute("DROP TRIGGER entries_last")
        if how == "cut off":
            copy.execute("DELETE FROM entry WHERE seq >= ?", (last,))
        elif how == "taken out":
            copy.execute("DELETE FROM entry WHERE seq = ?", (seq,))
        else:
            copy.execute("UPDATE entry SET at = '2020' || substr(at, 5) WHERE seq = ?", (seq,))
        if how == "written anew":
            before = GENESIS
            for row in copy.execute(f"SELECT {COLUMNS} FROM entry ORDER BY seq").fetchall():
                before = digest(before, Entry(*row))
                copy.execute("UPDATE entry SET hash = ? WHERE seq = ?", (before, row[0]))
