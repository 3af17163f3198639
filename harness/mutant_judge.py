"""The judge of mutants: a changed recipe, table, workflow or lab is a clean error or a correct run, nothing else.

Every mutant (`harness.mutants`, `harness.structures`) is read and planned as `check` does it. What is accepted
is run dry, and the record is judged: every sample has a verdict that the world's true mass bears out, no powder is
lost, the cell ends safe, no exception, and an exit code with a reason. What lasts too long is stopped as Ctrl-C does
it, and judged, too.
"""

import math
import shutil
import signal
import traceback
from collections import OrderedDict
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any, get_args

from harness.mutants import Mutant, originals
from harness.verdicts import is_untrue
from scuhand_bt.journal.export import canonical
from scuhand_bt.journal.reader import open_contents
from scuhand_bt.journal.results import SampleResult, SampleVerdict
from scuhand_bt.lab import Lab, load_lab, starter_lab, without_driver
from scuhand_bt.motion import MotionPlanner
from scuhand_bt.problems import SourceError
from scuhand_bt.recipe.plan import Plan, make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.run.inventory_conflicts import conflicts
from scuhand_bt.run.observers import BatchObserver
from scuhand_bt.run.options import Options
from scuhand_bt.run.prepared_motion import places_of, prepared_motion
from scuhand_bt.run.session import Session
from scuhand_bt.run.simulation import DryRun
from scuhand_bt.sim.fault_rules import FaultFile, read_faults
from scuhand_bt.skill import SkillFailed

TICKS = 1500
RUN_CPU_S = 3.0
"""An accepted mutant is run for so many ticks, or so long, and then stopped."""
HANG_CPU_S = 5.0
"""Nothing may keep the processor for so long without an end: not reading, and not a run that is to stop."""
PLANNERS = 12
LOST_SHARE = 1e-9
RAW = (
    "Input should",
    "Field required",
    "Extra inputs",
    "Value error",
    "validation error",
    "Traceback",
    " object at 0x",
)
"""What is not said in a user's words."""


class Hang(BaseException):
    """No end in sight."""


@dataclass(frozen=True)
class Outcome:
    """What came of a mutant; `wrong` is empty if it was as it should be."""

    kind: str
    how: str
    end: str
    wrong: tuple[str, ...] = ()
    files: Mapping[str, str] | None = None
    """What was wrong with, if something was."""


class Judge:
    """A lab of its own, in which one mutant after the other is judged."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        for part in ("robot", "skills", "trees"):
            ignored = shutil.ignore_patterns("__pycache__", "firmware")
            shutil.copytree(starter_lab() / part, folder / part, ignore=ignored)
        (folder / "recipes").mkdir()
        self.originals = originals()
        for name, text in self.originals.items():
            (folder / name).write_text(text, encoding="utf-8")
        self._lab = load_lab(folder)
        self._planners: OrderedDict[str, MotionPlanner] = OrderedDict()

    def judge(self, mutant: Mutant) -> Outcome:
        """Put the mutant in its place, see what comes of it, and put all back."""
        try:
            for name, data in mutant.changes.items():
                (self._folder / name).write_bytes(data)
            with _limit(HANG_CPU_S, _raise_hang):
                end, wrong = self._judge(mutant)
        except (Exception, Hang) as error:
            last = traceback.extract_tb(error.__traceback__)[-1]
            where = f"{Path(last.filename).name}:{last.lineno}"
            end, wrong = "broken", [f"{type(error).__name__} at {where}: {str(error)[:200]}"]
        finally:
            for name in mutant.changes:
                if name in self.originals:
                    (self._folder / name).write_text(self.originals[name], encoding="utf-8")
                else:
                    (self._folder / name).unlink(missing_ok=True)
            shutil.rmtree(self._folder / ".scuhand", ignore_errors=True)
        files = {name: data.decode(errors="backslashreplace") for name, data in mutant.changes.items()}
        return Outcome(mutant.kind, mutant.how, end, tuple(wrong), files if wrong else None)

    def _judge(self, mutant: Mutant) -> tuple[str, list[str]]:
        try:
            is_of_lab = any(name.startswith(("trees", "robot")) for name in mutant.changes)
            lab = load_lab(self._folder) if is_of_lab else self._lab
            recipe = load_recipe(self._folder / mutant.recipe, lab)
            plan = make_plan(recipe, lab)
            without_driver(lab)
            conflicts(plan, lab.cell, {})
            faults = read_faults(self._folder / mutant.faults) if mutant.faults is not None else None
            return self._run(plan, lab, faults)
        except SourceError as error:
            return "refused", [*_unclear(error)]
        except SkillFailed as error:
            return f"refused: {error.code}", [] if error.code.startswith("arm.") else [str(error)]

    def _run(self, plan: Plan, lab: Lab, faults: FaultFile | None) -> tuple[str, list[str]]:
        with _limit(4 * HANG_CPU_S, _raise_hang):  # the ways are planned first
            simulation = DryRun(faults=faults)
            options = Options(simulation, folder=self._folder / ".scuhand" / "runs")
            session = Session(plan, lab, options, self._planner(plan, lab))
        try:
            watch = _Watch(session)
            with _limit(RUN_CPU_S, watch.stop):
                result = session.run(watch)
        finally:
            session.close()
        wrong = [*_unsafe(session, faults), *_unjust(session, result.samples, lab, plan)]
        if watch.is_stopped:
            end = "stopped"
        elif result.exit_code in (0, 1, 3):
            end = {0: "in tolerance", 1: "flagged", 3: "cell fault"}[result.exit_code]
        else:
            end, wrong = "?", [*wrong, f"exit code {result.exit_code}"]
        if not watch.is_stopped and (result.exit_code == 0) != all(sample.is_good for sample in result.samples):
            wrong.append(f"exit code {result.exit_code} does not go with the samples")
        if result.exit_code == 3 and not any(f"{code}" in result.reason for code in lab.library.failures()):
            wrong.append(f"no known code: {result.reason}")
        return end, wrong

    def _planner(self, plan: Plan, lab: Lab) -> MotionPlanner:
        mortars = [source.mortar for source in plan.recipe.sources.values()]
        key = f"{lab.cell} {sorted(places_of(plan, lab).items())} {mortars}"
        if key not in self._planners:
            self._planners[key] = prepared_motion(plan, lab)
        self._planners.move_to_end(key)
        if len(self._planners) > PLANNERS:
            self._planners.popitem(last=False)
        return self._planners[key]


class _Watch(BatchObserver):
    """Ends a run that goes on too long."""

    def __init__(self, session: Session) -> None:
        self._session, self._ticks, self.is_stopped = session, 0, False

    def stop(self) -> None:
        self.is_stopped = True
        self._session.control.wish("stop_now")
        _set_alarm(HANG_CPU_S, _raise_hang)

    def ticked(self, root: object) -> None:
        self._ticks += 1
        if self._ticks == TICKS:
            self.stop()


def _raise_hang() -> None:
    raise Hang("it goes on and on")


@contextmanager
def _limit(cpu_s: float, then: Any) -> Iterator[None]:
    """Do something if this much time of the processor has gone; not nested, the last one counts."""
    _set_alarm(cpu_s, then)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)


def _set_alarm(cpu_s: float, then: Any) -> None:
    def ring(number: int, frame: FrameType | None) -> None:
        then()

    signal.signal(signal.SIGPROF, ring)
    signal.setitimer(signal.ITIMER_PROF, cpu_s)


def _unclear(error: SourceError) -> Iterator[str]:
    """Problems that are not told as they should be."""
    if not error.problems:
        yield "refused without a word"
    for problem in error.problems:
        line = str(problem)
        if any(raw in line for raw in RAW) or not line.isprintable() or len(problem.message) > 1000:
            yield f"said: {line[:300]}"
            return


def _unsafe(session: Session, faults: FaultFile | None) -> Iterator[str]:
    """What is open, vibrates or moves after the end, and powder that is nowhere."""
    hand, arm, world = session.cell.hand, session.cell.arm, session.world
    assert world is not None
    if world.is_open and not any(rule.fault.startswith("valve") for rule in (faults.rules if faults else ())):
        yield "the valve is open"
    if hand.vibration:  # type: ignore[attr-defined]
        yield "the motor vibrates"
    if not arm.is_stopped:
        yield "the arm moves"
    was_mg = sum(source.amount_mg for source in session.plan.recipe.sources.values())
    with open_contents(session.journal.path) as contents:
        events = contents.rows("event")
    for event in events:
        if event["kind"] == "broken":
            yield f"broken: {event['payload']['traceback'][-600:]}"
        if event["kind"] == "matter":
            masses_mg = event["payload"]
            if not abs(math.fsum(masses_mg.values()) - was_mg) <= max(1e-6, LOST_SHARE * was_mg):
                yield f"of {was_mg:.3f} mg there are {math.fsum(masses_mg.values()):.3f} mg left"
            if not min(masses_mg.values()) >= 0.0:
                yield f"a negative mass: {min(masses_mg.values())}"
    if sum(event["kind"] == "matter" for event in events) != 1:
        yield "the record does not say where the powder is"
    canonical(session.journal.path)


def _unjust(session: Session, samples: tuple[SampleResult, ...], lab: Lab, plan: Plan) -> Iterator[str]:
    """Samples without a verdict, or with one that the world's true mass contradicts."""
    if [sample.id for sample in samples] != [sample.id for sample in plan.recipe.samples]:
        yield f"the samples are {[sample.id for sample in samples]}"
    codes = lab.library.failures()
    for sample in samples:
        if sample.verdict not in get_args(SampleVerdict):
            yield f"'{sample.id}' has the verdict {sample.verdict}"
        if sample.code is not None and sample.code not in codes:
            yield f"'{sample.id}' failed with {sample.code}"
        # Of a container that was weighed twice, what its last dose says is not what it holds.
        if is_untrue(sample) and _is_weighed_once(session.journal.path, sample.id):
            held = f"{sample.true_mg:.2f} mg of {sample.target_mg:g} ± {sample.tolerance_mg:g} mg"
            yield f"'{sample.id}' is called {sample.verdict} with {sample.dispensed_mg} mg, and holds {held}"


def _is_weighed_once(journal: Path, sample: str) -> bool:
    """Whether the sample's own container was put on the pan once, tared once, and dosed last of all."""
    with open_contents(journal) as contents:
        jobs = {row["id"]: row for row in contents.rows("job")}
        rows = [row for row in contents.rows("action") if jobs[row["job"]]["sample"] == sample]
    last = max((jobs[row["job"]]["attempt"] for row in rows), default=1)
    done = [row["skill"] for row in rows if jobs[row["job"]]["attempt"] == last]
    known = [skill for skill in done if skill in ("place_container", "remove_container", "tare", "dispense")]
    return known[:2] == ["place_container", "tare"] and len(known) > 2 and set(known[2:]) == {"dispense"}
