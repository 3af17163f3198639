"""Kill a run on the real drivers again and again while it scoops, and resume it, over twins that outlive it.

The twins have a process of their own, with the powder and the roller's shaft in it; the run is a child that is ended
with SIGKILL after some time of scooping. Whoever does what the run asks for answers at once. The shaft, and not what
any program believes of it, tells how wide the rim was.
"""

import math
import multiprocessing
import os
import random
import shutil
import signal
import threading
import time
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Client, Connection, Listener
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from py_trees.common import Status

from harness.kill import BROKEN, journals
from scuhand_bt.clock import Clock, Steps, Wake
from scuhand_bt.devices.interfaces import Operator
from scuhand_bt.dosing.cone import Cone
from scuhand_bt.exit_codes import ExitCode
from scuhand_bt.failures import SkillFailed
from scuhand_bt.journal.history import read_history
from scuhand_bt.lab import Lab, load_lab, starter_lab
from scuhand_bt.motion import MotionPlanner
from scuhand_bt.recipe.plan import Plan, make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.run.clock import WallClock
from scuhand_bt.run.observers import BatchObserver
from scuhand_bt.run.operator import OperatorChanger
from scuhand_bt.run.options import Options
from scuhand_bt.run.prepared_motion import prepared_motion
from scuhand_bt.run.resume import checked_history, resumable
from scuhand_bt.run.session import Session
from scuhand_bt.sim.wire.bench import WireBench

WORKFLOW = """
workflow: scoop_first
summary: Scoop before a container stands on the pan, so that a run that is killed scooping is soon scooping again.
inputs: {source: Source, container: Container, mass: Mass, tolerance: {type: Mass, default: 2 mg}}
result: $dose
tree:
  sequence:
    - fallback:
        - cone_holds: {powder: $source.powder, wanted: $mass}
        - scoop: {source: $source, wanted: $mass}
    - place_container: {container: $container}
    - tare:
    - fill: {source: $source, container: $container, mass: $mass, tolerance: $tolerance, as: dose}
    - return_leftover: {source: $source, keep: never}
    - park:
"""
RECIPE = """
recipe: scoops
workflow: scoop_first
sources: {lot: {station: %s, container: %s, powder: glass_beads, amount: %s}}
defaults: {source: lot, container: alumina_crucible, tolerance: 10 mg}
samples: [{id: a, mass: 300 mg}]
"""
MORTARS = (
    ("mortar_bay", "agate_mortar", "20 g"),
    ("mortar_bay_2", "small_agate_mortar", "8 g"),
    ("mortar_bay", "jar_95", "12 g"),
)
"""Batches take turns with them."""
JAR = "  jar_95: {bore: 95 mm, depth: 40 mm, height: 55 mm, outer_diameter: 103 mm, corner: 5 mm}\n"
MOUNTED_MM, MOUNTED_COUNT, ROLLER = 90.0, 2048, 9
SCOOPING_S = {"agate_mortar": 4.3, "small_agate_mortar": 7.0, "jar_95": 4.5}
"""So long, at least, arm or roller are seen to move in a scoop: a run is killed within it, and does not get through."""
LOOK_S = 0.005
MOVED = 1e-3
"""From tick to tick: a joint [rad], or the rim [mm], that has moved."""
PLANS_S = 0.2
"""A tick that takes longer plans, while nothing moves: of that, no more than this counts."""
DEAD_MEN_S = 0.4
"""Until arm and valve have noticed that nobody speaks to them."""
TRIES = 8
"""So often a run that ended safe by itself, one time after the other, is resumed."""


@dataclass
class Seen:
    """What the twins have seen."""

    narrowest_mm: float = math.inf
    widest_mm: float = 0.0
    worst_belief_mm: float = 0.0
    """Of what a program that had just connected believed of the rim."""
    masses_mg: dict[str, float] = field(default_factory=dict)
    dosed_mg: dict[str, float] = field(default_factory=dict)
    track: list[list[float]] = field(default_factory=list)
    """The time [s], and the shafts of arm and roller, from the flat sheet [rad], when the roller had turned."""
    stands_rad: list[float] = field(default_factory=list)
    """The arm's joints, when it was last asked for."""


@dataclass
class Tally(Seen):
    """What was seen of all batches."""

    kills: int = 0
    at_kills_mm: list[float] = field(default_factory=list)
    """The rim at each kill."""
    batches: int = 0
    ended_safe: list[str] = field(default_factory=list)
    """Why runs ended safe by themselves, which were resumed then, and how the arm stood."""
    doses_ended: int = 0
    """Of the samples, so many came to their dose once nobody killed any more."""
    problems: list[str] = field(default_factory=list)

    def add(self, other: "Tally") -> None:
        """What was seen of other batches, too."""
        self.narrowest_mm = min(self.narrowest_mm, other.narrowest_mm)
        self.widest_mm = max(self.widest_mm, other.widest_mm)
        self.worst_belief_mm = max(self.worst_belief_mm, other.worst_belief_mm)
        self.dosed_mg |= other.dosed_mg
        self.kills += other.kills
        self.at_kills_mm += other.at_kills_mm
        self.batches += other.batches
        self.ended_safe += other.ended_safe
        self.doses_ended += other.doses_ended
        self.problems += other.problems


def mortar_of(seed: int) -> tuple[str, str, str]:
    """Station, mortar and amount of a batch."""
    return MORTARS[seed % len(MORTARS)]


def make_lab_of_twins(folder: Path, seed: int) -> Path:
    """A copy of the starter lab whose devices are twins in `folder`/ports, and whose changer is a person."""
    lab = folder / "lab"
    for part in ("robot", "skills", "trees"):
        shutil.copytree(starter_lab() / part, lab / part, ignore=shutil.ignore_patterns("__pycache__"))
    path, ports = lab / "robot" / "cell.yaml", folder / "ports"
    ports.mkdir()
    cell = yaml.safe_load(path.read_text(encoding="utf-8"))
    cell["arm"] |= {"port": str(ports / "arm"), "options": {"latency": "40 ms"}}
    cell["hand"] |= {"port": str(ports / "hand")}
    cell["balance"] |= {"port": str(ports / "balance"), "options": {"bits": "8N1"}, "limits": {}}
    cell["changer"] = {"driver": "operator"}
    path.write_text(yaml.safe_dump(cell, sort_keys=False), encoding="utf-8")
    with (lab / "robot" / "containers.yaml").open("a", encoding="utf-8") as kinds:
        kinds.write(JAR)
    (lab / "trees" / "scoop_first.yaml").write_text(WORKFLOW, encoding="utf-8")
    (folder / "recipe.yaml").write_text(RECIPE % mortar_of(seed), encoding="utf-8")
    return lab


def plan_in(folder: Path) -> tuple[Plan, Lab]:
    """The plan and the lab in a folder that `make_lab_of_twins` has filled."""
    lab = load_lab(folder / "lab")
    return make_plan(load_recipe(folder / "recipe.yaml", lab), lab), lab


def keep_twins(folder: Path, joints: Any, seed: int) -> None:
    """The twins' process: they go on until it is told to end."""
    plan, lab = plan_in(folder)
    firmware = lab.folder / "robot" / "firmware"
    bench = WireBench(lab.cell, plan.recipe.sources, firmware, joints, WallClock(), seed, ports=folder / "ports")
    world, seen, ended, track = bench.world, Seen(), threading.Event(), list[list[float]]()
    roller = bench.bus.twin.servos[ROLLER]

    def rim_mm() -> float:
        hand = lab.cell.hand
        turned_deg = (roller.shaft - MOUNTED_COUNT) * 360 / 4096
        return Cone.from_roller(Cone(MOUNTED_MM).roller_deg(hand) + turned_deg, hand).diameter_mm

    def look() -> None:
        before_mm = rim_mm()
        while not ended.wait(LOOK_S):
            now_mm = rim_mm()
            if now_mm != before_mm:
                track.append(
                    [time.monotonic(), *bench.arm.joints, math.radians(Cone(now_mm).roller_deg(lab.cell.hand))]
                )
            before_mm = now_mm
            seen.narrowest_mm, seen.widest_mm = min(seen.narrowest_mm, now_mm), max(seen.widest_mm, now_mm)

    def serve(caller: Connection) -> None:
        with suppress(EOFError, OSError):
            while True:
                what, said = caller.recv()
                if what == "place":
                    world.place(said)
                elif what == "remove":
                    world.remove()
                elif what == "believes":
                    seen.worst_belief_mm = max(seen.worst_belief_mm, abs(said - rim_mm()))
                elif what == "stands":
                    seen.stands_rad = [round(angle, 5) for angle in bench.arm.joints.tolist()]
                elif what == "track":
                    seen.track = list(track)
                elif what == "end":
                    ended.set()
                elif what == "seen":
                    seen.masses_mg = dict(world.masses_mg)
                    seen.dosed_mg = {sample.id: world.true_mass(sample.id) for sample in plan.recipe.samples}
                caller.send((rim_mm(), seen))

    def listen() -> None:
        with Listener(str(folder / "ask")) as door:
            while True:
                threading.Thread(target=serve, args=(door.accept(),), daemon=True).start()

    with bench:
        for task in (look, listen):
            threading.Thread(target=task, daemon=True).start()
        ended.wait()


class Twins:
    """What one process asks of the twins'."""

    def __init__(self, folder: Path) -> None:
        deadline_s = time.monotonic() + 60.0
        while True:
            try:
                self._line = Client(str(folder / "ask"))
                return
            except (FileNotFoundError, ConnectionRefusedError):  # it is not there yet, or does not listen yet
                if time.monotonic() > deadline_s:
                    raise
            time.sleep(0.05)

    def ask(self, what: str, said: object = None) -> tuple[float, Seen]:
        self._line.send((what, said))
        answer: tuple[float, Seen] = self._line.recv()
        return answer


class Hands(Operator):
    """The person at the cell, who does what is asked."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock

    def ask(self, question: str, choices: Sequence[str] = ("done", "stop")) -> Steps[str]:
        if "rim" in question and "sheet" not in question:
            raise RuntimeError("the roller's turns were not lost, and it asks for them")
        ready_s = self._clock.now_s + 0.3
        while self._clock.now_s < ready_s:
            yield Wake(ready_s)
        return choices[0]

    def ask_until(
        self, question: str, choices: Sequence[str], is_seen: Callable[[], bool], does: Callable[[], None]
    ) -> Steps[str]:
        answer = yield from self.ask(question, choices)
        does()
        return answer


class OfSession(BatchObserver):
    """An observer that is told which session it observes."""

    session: Session


class KilledScooping(OfSession):
    """Ends its own process after so much time in which arm or roller moved for a scoop.

    Not counted is what moves nothing: planning, and the emptying of a cone whose load a kill before has made doubtful.
    """

    def __init__(self, after_s: float) -> None:
        self._left_s, self._since_s = after_s, math.inf
        self._was: Any = None

    def ticked(self, root: Any) -> None:
        now_s, cell = time.monotonic(), self.session.cell
        stands = np.append(cell.arm.positions, cell.hand.cone_diameter_mm)
        moved = self._was is not None and bool(np.abs(stands - self._was).max() > MOVED)
        self._was = stands
        if moved:
            self._left_s -= min(max(0.0, now_s - self._since_s), PLANS_S)
        scoops = any(node.name == "scoop" and node.status is Status.RUNNING for node in root.iterate())
        self._since_s = now_s if scoops else math.inf
        if self._left_s <= 0.0:
            os.kill(os.getpid(), signal.SIGKILL)


def run_over(folder: Path, plan: Plan, lab: Lab, motion: MotionPlanner, observer: BatchObserver) -> int:
    """Begin the run over the twins of a folder, or resume it; its exit code."""
    twins, runs = Twins(folder), folder / "state" / "runs"
    begun, found = next(journals(runs), None), None
    if begun is not None:
        found = resumable(begun, checked_history(begun), plan, lab, accept_changes=False)
    try:
        session = Session(plan, lab, Options(None, folder=runs), motion, resumes=found)
    except SkillFailed:  # no device answers, on a computer that is busy: `run` says so, and ends
        return ExitCode.CELL_FAULT
    if isinstance(observer, OfSession):
        observer.session = session
    try:
        cell = session.cell
        if begun is None:
            cell.hand.rim_is(MOUNTED_MM)
        twins.ask("believes", cell.hand.cone_diameter_mm)
        cell.operator = Hands(cell.clock)
        cell.changer = OperatorChanger(
            cell.operator,
            lambda container: void(twins.ask("place", container)),
            lambda: void(twins.ask("remove")),
            may_be_loaded=begun is not None,
        )
        return session.run(observer).exit_code
    finally:
        session.close()


def void(answer: object) -> None:
    """What is answered does not matter."""


def kill_while_scooping(folder: Path, kills: int, seed: int) -> Tally:
    """One batch, killed so often, then let end, and judged."""
    folder.mkdir(parents=True)
    make_lab_of_twins(folder, seed)
    plan, lab = plan_in(folder)
    motion, rng, tally = prepared_motion(plan, lab, for_real=True), random.Random(seed), Tally(batches=1)
    spawn = multiprocessing.get_context("spawn")
    keeper = spawn.Process(target=keep_twins, args=(folder, motion.home(), seed), daemon=True)
    keeper.start()
    twins, runs, tries = Twins(folder), folder / "state" / "runs", TRIES
    (most_s,) = (SCOOPING_S[source.mortar.name] for source in plan.recipe.sources.values())
    try:
        while tries and not any(read_history(path).is_complete for path in journals(runs)):
            after_s = rng.uniform(0.0, most_s) if tally.kills < kills else math.inf
            code = _child(folder, plan, lab, motion, after_s)
            if code is None:
                tally.kills += 1
                tally.at_kills_mm.append(round(twins.ask("rim")[0], 1))
                tries = TRIES
                time.sleep(DEAD_MEN_S)
            elif code == BROKEN:
                tally.problems.append(f"seed {seed}: a child broke")
                break
            elif code not in (0, 1):
                ends = [read_history(path).ended for path in journals(runs)]
                reason = "".join(end.reason for end in ends if end) or "it did not begin"
                rim_mm, seen = twins.ask("stands")
                tally.ended_safe.append(f"seed {seed}: {reason}; joints {seen.stands_rad}, rim {rim_mm:.2f} mm")
                tries -= 1
                time.sleep(DEAD_MEN_S)
        _judge(plan, lab, seed, twins.ask("seen")[1], tally)
    finally:
        with suppress(EOFError, OSError):
            twins.ask("end")
        keeper.join(10.0)
    return tally


def _child(folder: Path, plan: Plan, lab: Lab, motion: MotionPlanner, after_s: float) -> int | None:
    """Run or resume in a process of its own; its exit code, None if it was killed."""
    child = os.fork()
    if child == 0:
        code = BROKEN
        try:
            code = run_over(folder, plan, lab, motion, KilledScooping(after_s))
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(code)
    _, status = os.waitpid(child, 0)
    return None if os.WIFSIGNALED(status) else os.waitstatus_to_exitcode(status)


def _judge(plan: Plan, lab: Lab, seed: int, seen: Seen, tally: Tally) -> None:
    narrowest_mm, widest_mm = lab.cell.hand.rim_limits_mm
    tally.narrowest_mm, tally.widest_mm = seen.narrowest_mm, seen.widest_mm
    tally.worst_belief_mm = seen.worst_belief_mm
    if not narrowest_mm <= seen.narrowest_mm <= seen.widest_mm <= widest_mm:
        tally.problems.append(f"seed {seed}: rims of {seen.narrowest_mm:.1f} to {seen.widest_mm:.1f} mm")
    for sample in plan.recipe.samples:
        dosed_mg, mass_mg = seen.dosed_mg[sample.id], sample.mass_mg or 0.0
        tally.dosed_mg[f"{seed}/{sample.id}"] = round(dosed_mg, 1)
        tally.doses_ended += abs(dosed_mg - mass_mg) <= 2.0 * (sample.tolerance_mg or 0.0)
        if dosed_mg > mass_mg + 2.0 * (sample.tolerance_mg or 0.0):
            tally.problems.append(
                f"seed {seed}: '{sample.id}' holds {dosed_mg:.1f} mg, and {mass_mg:g} mg were asked for"
            )
    there_mg = sum(source.amount_mg for source in plan.recipe.sources.values())
    if abs(math.fsum(seen.masses_mg.values()) - there_mg) > 1e-6:
        tally.problems.append(f"seed {seed}: powder was lost or made")
