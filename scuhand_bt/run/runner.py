"""The runner: ticks one job's tree, and moves the clock to the earliest thing the tree waits for."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from py_trees.behaviour import Behaviour
from py_trees.common import Status

from scuhand_bt.clock import Signal, Wake
from scuhand_bt.devices.cell import Cell
from scuhand_bt.plan import Job
from scuhand_bt.run.journal import Journal
from scuhand_bt.skill import SkillFailed
from scuhand_bt.tree.build import Tree
from scuhand_bt.tree.check import Library
from scuhand_bt.tree.leases import Leases
from scuhand_bt.tree.nodes import SkillBug, SkillLeaf, Ticking, failure_of

DEVICES = ("hand", "arm", "changer", "balance")
SAFE_TIMEOUT_S = 20.0
"""How long the cell may take to stand still after it was told to stop."""
FALL_S = 0.5
"""After everything stands still, what was falling has landed."""
MAX_SILENCE_S = 3600.0
"""If nothing at all happens for this long, a skill waits for what never comes."""
MAX_TICKS_AT_ONE_TIME = 10_000


@dataclass(frozen=True)
class Outcome:
    """How a job's tree ended: `failure` is None if it succeeded; `halted` if the run was stopped."""

    failure: SkillFailed | None = None
    halted: bool = False


class TickObserver(Protocol):
    """Is shown the tree after every tick; must be quick."""

    def ticked(self, root: Behaviour) -> None: ...


class Runner:
    """Runs jobs on a cell, one tree alive at a time. `stop` fires to halt the run (Ctrl-C does)."""

    def __init__(self, cell: Cell, library: Library, journal: Journal, stop: Signal, observer: TickObserver) -> None:
        self._cell = cell
        self._library = library
        self._journal = journal
        self._stop = stop
        self._observer = observer
        self._leases = Leases(cell)

    def run(self, job: Job, inputs: Mapping[str, Any]) -> Outcome:
        """Run one job to its end. Any exception leaves the tree halted; `make_safe` is the caller's to call."""
        shared = Ticking(self._cell, self._leases, _Recorder(self._journal))
        tree = Tree(self._library.workflows[job.workflow], inputs, self._library, shared)
        halted = True
        try:
            halted = self._tick_to_end(tree.root, shared)
        finally:
            if halted:
                tree.root.stop(Status.INVALID)
        if shared.bugs:
            raise shared.bugs[0]
        if halted:
            return Outcome(halted=True)
        if moving := self._still_moving():
            self.make_safe()
            return Outcome(SkillFailed("device.busy", f"{moving} moved on for {SAFE_TIMEOUT_S:g} s after the job"))
        return Outcome(None if tree.root.status is Status.SUCCESS else failure_of(tree.root))

    def make_safe(self) -> bool:
        """Valve closed, vibration off, arm stopped: tell every device, then wait. False if one did not stop."""
        for name in DEVICES:
            self._cell.device(name).stop()
        is_still = not self._still_moving()
        self._cell.clock.wait([Wake(self._cell.clock.now_s + FALL_S)])
        return is_still

    def _tick_to_end(self, root: Behaviour, shared: Ticking) -> bool:
        """Tick until the root has ended (False), or the run is to stop (True)."""
        clock, ticks_now, last_s = self._cell.clock, 0, -1.0
        while not self._stop.count:
            root.tick_once()
            self._observer.ticked(root)
            if root.status is not Status.RUNNING:
                return False
            now_s = clock.now_s
            ticks_now = ticks_now + 1 if now_s == last_s else 0
            last_s = now_s
            if ticks_now > MAX_TICKS_AT_ONE_TIME:
                raise SkillBug(f"{_running(root)} is ticked again and again without letting time pass")
            silence = Wake(now_s + MAX_SILENCE_S, self._stop, self._stop.count)
            wakes = shared.wakes()
            clock.wait([*wakes, silence])
            nothing_timed = all(math.isinf(wake.until_s) for wake in wakes)
            if nothing_timed and clock.now_s >= silence.until_s and not any(wake.has_fired for wake in wakes):
                raise SkillBug(f"{_running(root)} waits for something that never comes")
        return True

    def _still_moving(self) -> str:
        """Wait for all devices to stop; the names of those that have not in time, "" if all have."""
        clock, devices = self._cell.clock, {name: self._cell.device(name) for name in DEVICES}
        deadline_s = clock.now_s + SAFE_TIMEOUT_S
        while moving := [name for name, device in devices.items() if not device.is_stopped]:
            if clock.now_s >= deadline_s:
                return ", ".join(moving)
            clock.wait([Wake.on(devices[name].news, min(deadline_s, clock.now_s + 0.1)) for name in moving])
        return ""


class _Recorder:
    """Tells the journal of every action."""

    def __init__(self, journal: Journal) -> None:
        self._journal = journal
        self._actions: dict[SkillLeaf, int] = {}

    def started(self, leaf: SkillLeaf, inputs: Mapping[str, Any]) -> None:
        self._actions[leaf] = self._journal.action_started(leaf.path, leaf.visits, leaf.name, inputs)

    def acting(self, leaf: SkillLeaf) -> None:
        self._journal.action = self._actions[leaf]

    def ended(self, leaf: SkillLeaf, outcome: str, result: Any) -> None:
        code = result.code if isinstance(result, SkillFailed) else None
        value = {"detail": result.detail} if isinstance(result, SkillFailed) else result
        self._journal.action_ended(self._actions.pop(leaf), outcome, code, value)


def _running(root: Behaviour) -> str:
    """The leaves that are running, by name."""
    names = [node.name for node in root.iterate() if isinstance(node, SkillLeaf) and node.status is Status.RUNNING]
    return "the skill " + (" and ".join(names) or "at work")
