"""A cell of wire twins in a process of their own, and runs on it, each in a process of its own.

A run is one on the cell, whose devices say that they are twins: so who may be asked, and who gives torque, is as on a
real cell. A scripted person answers, who sees the twins' world.
"""

import json
import math
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scuhand_bt.cell import believed
from scuhand_bt.cell_spec import DEVICES
from scuhand_bt.failures import Code, SkillFailed
from scuhand_bt.lab import CELL_FILE, Lab, load_lab, starter_lab
from scuhand_bt.motion import MotionPlanner
from scuhand_bt.problems import SourceError
from scuhand_bt.recipe.plan import Plan, make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.run import make_cell
from scuhand_bt.run.observers import BatchObserver
from scuhand_bt.run.operator import Person
from scuhand_bt.run.options import Options
from scuhand_bt.run.outage import rim_in_words
from scuhand_bt.run.prepared_motion import prepared_motion
from scuhand_bt.run.questions import Who
from scuhand_bt.run.resume import checked_history, resumable
from scuhand_bt.run.session import Session
from scuhand_bt.run.twins import FOLDER, say
from scuhand_bt.specs import Container
from scuhand_bt.yaml_edit import Path as Keys
from scuhand_bt.yaml_edit import Value, edited

RECIPE = """
recipe: wire-cuts
sources:
  beads: {station: mortar_bay, container: agate_mortar, powder: glass_beads, amount: 20 g}
workflow: fill_xrd_holder
defaults: {source: beads, container: xrd_holder, tolerance: 2 mg}
samples:
  - {id: small, mass: 20 mg}
  - {id: middle, mass: 60 mg}
  - {id: large, mass: 120 mg, tolerance: 4 mg}
on_failure: {dose.overshoot: flag, dose.not_reached: flag, container.changed: flag, otherwise: stop}
"""
ON_BUSY_S = 0.1
"""Latency of the servos' lines on a computer that does much else: what answers late there is not without power."""
BEGIN_S = 60.0
"""A run has begun within this, and twins have."""
LIMP = "limp"
"""What a refused resume says of an arm without torque, in the place of an exit code."""


@dataclass
class WireCell:
    """A lab on twins, its plan, and the motions that all its runs share."""

    lab: Lab
    plan: Plan
    motion: MotionPlanner
    seed: int
    twins: Path

    def say(self, *words: str) -> dict[str, Any]:
        return dict(say(self.twins, words).found)

    @property
    def runs(self) -> Path:
        return self.lab.folder / ".scuhand" / "runs"


def make_lab(folder: Path, latency_s: float = ON_BUSY_S) -> tuple[Lab, Plan, MotionPlanner]:
    """A copy of the starter lab whose devices are at the ports of its twins, and the ways of its recipe.

    `latency_s` of the servos' lines: a computer that is busy with other things too needs more than one that is not.
    """
    for part in ("robot", "skills", "trees"):
        shutil.copytree(starter_lab() / part, folder / part, ignore=shutil.ignore_patterns("__pycache__"))
    cell = folder / CELL_FILE
    ports: dict[Keys, Value] = {(name, "port"): str(folder / ".scuhand" / FOLDER / name) for name in DEVICES}
    ports["arm", "options"] = ports["changer", "options"] = {"latency": f"{1000 * latency_s:g} ms"}
    cell.write_text(edited(cell.read_text(encoding="utf-8"), ports), encoding="utf-8")
    recipe = folder / "recipe.yaml"
    recipe.write_text(RECIPE, encoding="utf-8")
    lab = load_lab(folder)
    plan = make_plan(load_recipe(recipe, lab), lab)
    return lab, plan, prepared_motion(plan, lab)


@contextmanager
def twins_of(lab: Lab, plan: Plan, motion: MotionPlanner, seed: int) -> Iterator[WireCell]:
    """New twins, in a process of their own."""
    folder = lab.folder / ".scuhand" / FOLDER
    shutil.rmtree(lab.folder / ".scuhand" / "runs", ignore_errors=True)
    command = [sys.executable, "-m", "scuhand_bt", "twins", str(plan.recipe.path), "--lab", str(lab.folder), "--new"]
    with subprocess.Popen(
        [*command, "--seed", str(seed)], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL
    ) as process:
        try:
            until_s = time.monotonic() + BEGIN_S
            while not _is_heard(folder):
                if process.poll() is not None or time.monotonic() > until_s:
                    raise RuntimeError("the twins have not begun")
                time.sleep(0.05)
            yield WireCell(lab, plan, motion, seed, folder)
        finally:
            process.terminate()


def _is_heard(folder: Path) -> bool:
    try:
        return say(folder, ["look"]).is_done
    except SourceError:
        return False


# --- the run, in a process of its own


class Begun(BatchObserver):
    """Tells that the batch goes on."""

    def __init__(self, tell: Callable[[dict[str, Any]], None]) -> None:
        self._tell, self._is_told = tell, False

    def ticked(self, root: Any) -> None:
        if not self._is_told:
            self._is_told = True
            self._tell({"begun": True})


class Run:
    """A child that runs the batch, or resumes it; what it knows comes through a pipe."""

    def __init__(self, cell: WireCell, begun: Path | None, *, consent: bool) -> None:
        reading, writing = os.pipe()
        self.pid = os.fork()
        if self.pid == 0:
            os.close(reading)
            code = 70
            try:
                code = _run(cell, begun, consent, writing)
            except BaseException:
                traceback.print_exc()
            finally:
                os._exit(code)
        os.close(writing)
        self._heard = b""
        self._pipe = reading
        os.set_blocking(reading, False)
        self.told: list[dict[str, Any]] = []
        self.code: int | str | None = None
        self.ended_s = math.inf
        """When it was seen to have ended, by the computer's steady clock."""

    def look(self) -> bool:
        """Hear what it has told; whether it still goes on."""
        if self.code is not None:
            return False
        ended, status = os.waitpid(self.pid, os.WNOHANG)
        while True:
            try:
                data = os.read(self._pipe, 65536)
            except BlockingIOError:
                break
            if not data:
                break
            self._heard += data
        *lines, self._heard = self._heard.split(b"\n")
        self.told += [json.loads(line) for line in lines]
        if ended:
            self.ended_s = time.monotonic()
            os.close(self._pipe)
            self.code = "killed" if os.WIFSIGNALED(status) else os.waitstatus_to_exitcode(status)
            if any(LIMP in one for one in self.told):
                self.code = LIMP
        return self.code is None

    def has_begun(self) -> bool:
        return any("begun" in one for one in self.told)

    def wait(self, until_s: float, condition: Callable[[], bool] = lambda: False) -> bool:
        """Until then, or the condition holds, or it has ended; whether it goes on."""
        while self.look() and time.monotonic() < until_s and not condition():
            time.sleep(0.02)
        return self.code is None

    def kill(self) -> None:
        if self.look():
            os.kill(self.pid, signal.SIGKILL)
            while self.look():
                time.sleep(0.005)


def _run(cell: WireCell, begun: Path | None, consent: bool, pipe: int) -> int:
    def tell(what: dict[str, Any]) -> None:
        os.write(pipe, json.dumps(what).encode() + b"\n")

    with Path(os.devnull).open() as nobody:
        os.dup2(nobody.fileno(), 0)
    _fills_slots(cell)
    found = None
    if begun is not None:
        found = resumable(begun, checked_history(begun), cell.plan, cell.lab, accept_changes=False)
    options = Options(None, folder=cell.runs, may_torque=consent, person=Person("Ada"))
    try:
        session = Session(cell.plan, cell.lab, options, cell.motion, resumes=found)
    except SkillFailed as failed:
        tell({LIMP: str(failed)} if failed.code == Code.ARM_LIMP else {"refused": str(failed)})
        return 3
    for look in (_answer, _watch):
        threading.Thread(target=look, args=(cell, session, tell), daemon=True).start()
    try:
        return session.run(Begun(tell)).exit_code
    finally:
        session.close()


def _fills_slots(cell: WireCell) -> None:
    """A person fills the changer in the order in which it is emptied."""
    slot_of = believed.slot_of

    def filled(what: believed.Believed, container: Container) -> int:
        slot = slot_of(what, container)
        cell.say("fill", str(slot + 1), container.name, container.id)
        return slot

    vars(make_cell)["believed_slot"] = filled


def _answer(cell: WireCell, session: Session, tell: Callable[[dict[str, Any]], None]) -> None:
    """A person who does what is asked, and says what can be seen."""
    questions = session.control.questions
    while True:
        time.sleep(0.1)
        if (asked := questions.waiting) is None:
            continue
        time.sleep(0.3)
        sees = ("same", rim_in_words(cell.say("look")["rim_mm"]))
        answer = next((one for one in asked.choices if one in sees), asked.choices[0])
        if "none" in asked.choices and answer not in sees:
            answer = "none"
        if "mount the sheet again" in asked.text:
            cell.say("sheet")
        tell({"asked": asked.text, "answer": answer})
        questions.give(asked.number, answer, Who("Ada"))


def _watch(cell: WireCell, session: Session, tell: Callable[[dict[str, Any]], None]) -> None:
    """When a device is first known to be in fault."""
    known: dict[str, str] = {}
    while True:
        for name, device in session.cell.every_device.items():
            fault = device.fault
            if (code := "" if fault is None else str(fault.code)) != known.get(name, ""):
                known[name] = code
                tell({"at_s": time.monotonic(), "device": name, "code": code})
        time.sleep(0.002)
