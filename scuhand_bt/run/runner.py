"""The runner: ticks one job's tree, and advances the clock to the earliest thing that the tree waits for."""

import math
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from functools import partial
from typing import Any, Protocol, TypeVar, cast

from py_trees.behaviour import Behaviour
from py_trees.common import Status

from scuhand_bt.cell.cell import Cell
from scuhand_bt.clock import Wake
from scuhand_bt.failures import Code
from scuhand_bt.journal.events import ActionEnded, ActionStarted, Decided, GaveUp, RoundsDone, TreeNode, WorkflowTree
from scuhand_bt.journal.plain import plain, plain_values, to_json
from scuhand_bt.journal.run_events import Continued, Paused
from scuhand_bt.journal.writer import Journal
from scuhand_bt.recipe.plan import Job
from scuhand_bt.run.control import Control
from scuhand_bt.run.guards import Guards
from scuhand_bt.run.outcome import Outcome
from scuhand_bt.run.rejoin import rejoin
from scuhand_bt.skill import SkillFailed, Steps
from scuhand_bt.tree.build import Tree
from scuhand_bt.tree.guarded import While
from scuhand_bt.tree.leaf import Consent, SkillBug, SkillLeaf, Ticking
from scuhand_bt.tree.leases import Leases
from scuhand_bt.tree.library import Library, units_of
from scuhand_bt.tree.nodes import ForEach, Repeat, Retry, Timeout, failure_of
from scuhand_bt.tree.replay import Decision, Replay
from scuhand_bt.tree.substitutes import Substitutes

SAFE_TIMEOUT_S = 20.0
"""How long the cell may take to stand still after the command [s]: a carousel's swing takes 2 s, an arm's stop 1 s."""
UNREACHED_S = 2.0
"""The same for a device that cannot be reached: its own watchdog has stopped it long before."""
UNREACHED = frozenset({Code.DEVICE_LOST, Code.ARM_LIMP, Code.HAND_VALVE_LOST})
FALL_S = 0.5
"""When everything stands still, wait this long for falling powder to land [s]."""
MAX_SILENCE_S = 3600.0
"""If nothing at all happens for this long [s], a skill waits for something that never comes."""
MAX_TICKS_AT_ONE_TIME = 10_000

T = TypeVar("T")


class TickObserver(Protocol):
    """Receives each job's tree, its root after every tick, and pauses. Must be quick."""

    def tree_made(self, tree: Tree) -> None: ...

    def ticked(self, root: Behaviour) -> None: ...

    def paused(self) -> None: ...

    def continued(self) -> None: ...


class Runner:
    """Runs jobs on a cell, one tree at a time, as long as `control` and the guards permit."""

    def __init__(
        self,
        cell: Cell,
        library: Library,
        journal: Journal,
        control: Control,
        guards: Guards,
        observer: TickObserver,
        substitutes: Substitutes | None = None,
        consent: Consent | None = None,
    ) -> None:
        self._cell = cell
        self._library = library
        self._journal = journal
        self._control = control
        self._observer = observer
        self._leases = Leases(cell)
        self._guards = guards
        self._substitutes, self._consent = substitutes, consent
        self._drawn: set[str] = set()
        """The workflows whose tree is in the journal."""

    def run(self, job: Job, inputs: Mapping[str, Any], replay: Replay) -> Outcome:
        """Run one job to its end, from where `replay` leaves it. After any exception the tree is halted.

        After an interruption the caller must call `make_safe`.
        """
        recorder, rejoins = _Recorder(self._journal), partial(rejoin, self._journal)
        shared = Ticking(self._cell, self._leases, recorder, replay, rejoins, self._substitutes, self._consent)
        skills = self._library.skills
        had = (skills[name].devices for name in replay.open_skills if name in skills)
        replay.at_work = frozenset(device for devices in had for device in devices)
        tree = Tree(self._library.workflows[job.workflow], inputs, self._library, shared)
        if job.workflow not in self._drawn:
            self._drawn.add(job.workflow)
            self._journal.event(WorkflowTree(workflow=job.workflow, nodes=tuple(_drawn(tree.root))))
        self._observer.tree_made(tree)
        interrupted: Outcome | None = Outcome(interrupted="stopped")
        try:
            interrupted = self._tick_to_end(tree.root, shared)
        finally:
            if interrupted is not None:
                shared.is_interrupted = True
                tree.root.stop(Status.INVALID)
        if shared.bugs:
            raise shared.bugs[0]
        if interrupted is not None:
            return interrupted
        if moving := self._still_moving():
            self.make_safe()
            # Not subject to `on_failure`: nothing may go on beside a device that does not stop.
            busy = SkillFailed(Code.DEVICE_BUSY, f"{moving} still moved {SAFE_TIMEOUT_S:g} s after the job")
            return Outcome(self._guards.look() or busy, "tripped")
        return Outcome(None if tree.root.status is Status.SUCCESS else failure_of(tree.root))

    def make_safe(self) -> bool:
        """Close the valve, end vibration, stop the arm: tell every device, then wait. False if one did not stop."""
        with ExitStack() as stopping:  # if stopping one fails, the others are still stopped
            for device in self._cell.every_device.values():
                stopping.callback(device.stop)
        is_still = not self._still_moving()
        self._cell.clock.wait([Wake(self._cell.clock.now_s + FALL_S)])
        return is_still

    def ask(self, steps: Steps[T]) -> T | None:
        """Ask the person at the cell something between jobs; None if the run is to end before the answer.

        The guards keep watching; a fault is raised.
        """
        try:
            while True:
                wish = self._wish()
                if self._control.stops_now:
                    break
                self._cell.clock.wait([next(steps), wish, *self._watched()])
                if (fault := self._look()) is not None:
                    raise fault
        except StopIteration as answer:
            return cast(T, answer.value)
        steps.close()
        return None

    def hold(self) -> SkillFailed | None:
        """Stand still until a person continues or stops the run; returns a guard's fault if one trips meanwhile."""
        by = self._control.paused_by
        self._journal.event(Paused(by=by.name, signed=by.signed))
        self._observer.paused()
        while True:
            wish = self._wish()
            if not self._control.is_pausing or self._control.is_stopping:
                break
            self._cell.clock.hold([wish, *self._watched()])
            if (fault := self._look()) is not None:
                return fault
        by = self._control.continued_by
        self._journal.event(Continued(by=by.name, signed=by.signed))
        self._observer.continued()
        return None

    def settle(self) -> None:
        """Let time pass until everything that has happened is on disk. Raises RecordLost if it cannot be."""
        self._journal.commit()
        while (writing := self._journal.waits()) is not None:
            self._cell.clock.wait([writing])
            self._journal.keep_up()

    def _wish(self) -> Wake:
        """A wake for the next wish. Made before the current wish is read, so that none is missed."""
        return Wake.on(self._control.news)

    def _tick_to_end(self, root: Behaviour, shared: Ticking) -> Outcome | None:
        """Tick until the root has ended (None), or the job is interrupted."""
        clock, control, guards = self._cell.clock, self._control, self._guards
        ticks_now, last_s = 0, -1.0
        while True:
            wish = self._wish()
            if control.halts:
                return Outcome(interrupted="stopped" if control.stops_now else "paused")
            if (fault := guards.look()) is not None:
                return Outcome(fault, "tripped")
            shared.is_pausing = control.is_pausing
            root.tick_once()
            self._journal.commit()  # observers may read it
            self._observer.ticked(root)
            if root.status is not Status.RUNNING:
                return None
            if shared.replay.is_replaying:
                shared.replay.tick_ended()
                continue
            now_s = clock.now_s
            ticks_now = ticks_now + 1 if now_s == last_s else 0
            last_s = now_s
            if ticks_now > MAX_TICKS_AT_ONE_TIME:
                raise SkillBug(f"{_running(root)} is ticked again and again without letting time pass")
            if shared.is_pausing and not shared.acting:
                if (fault := self.hold()) is not None:
                    return Outcome(fault, "tripped")
                if control.is_stopping:  # a paused job is not continued only to be stopped
                    return Outcome(interrupted="stopped")
                shared.going_on.fire()
                continue
            if (fault := self._wait(root, shared, wish)) is not None:
                return Outcome(fault, "tripped")

    def _wait(self, root: Behaviour, shared: Ticking, wish: Wake) -> SkillFailed | None:
        """Wait for the next tick; returns a guard's fault if one trips meanwhile."""
        clock, control = self._cell.clock, self._control
        wakes = [*shared.wakes(), wish]
        silence = Wake(clock.now_s + MAX_SILENCE_S)
        while True:
            clock.wait([*wakes, silence, *self._watched()])
            if (fault := self._look()) is not None:
                return fault
            now_s = clock.now_s
            for wake in wakes:
                if now_s >= wake.until_s or wake.has_fired:
                    return None
            nothing_timed = now_s >= silence.until_s and all(math.isinf(wake.until_s) for wake in wakes)
            if nothing_timed and not control.halts:
                raise SkillBug(f"{_running(root)} waits for something that never comes")

    def _watched(self) -> list[Wake]:
        """What is watched, whatever the tree waits for."""
        return [*self._guards.wakes(), Wake.on(self._journal.news)]

    def _look(self) -> SkillFailed | None:
        """A guard's fault, if any. Raises RecordLost if the journal can no longer be written."""
        self._journal.keep_up()
        return self._guards.look()

    def _still_moving(self) -> str:
        """Wait for all devices to stop; returns the names of those that have not in time, "" if all have."""
        clock, devices = self._cell.clock, self._cell.every_device
        began_s = clock.now_s
        while moving := {name: device for name, device in devices.items() if not device.is_stopped}:
            is_reached = any(device.fault is None or device.fault.code not in UNREACHED for device in moving.values())
            deadline_s = began_s + (SAFE_TIMEOUT_S if is_reached else UNREACHED_S)
            if clock.now_s >= deadline_s:
                return ", ".join(moving)
            clock.wait([Wake.on(device.news, min(deadline_s, clock.now_s + 0.1)) for device in moving.values()])
        return ""


def _drawn(root: Behaviour, depth: int = 0) -> Iterator[TreeNode]:
    """A tree's nodes, depth-first."""
    path = root.path if isinstance(root, SkillLeaf | Timeout | While | Retry | Repeat | ForEach) else ""
    yield TreeNode(depth=depth, name=root.name, path=path)
    for child in root.children:
        yield from _drawn(child, depth + 1)


class _Recorder:
    """Tells the journal of every action."""

    def __init__(self, journal: Journal) -> None:
        self._journal = journal
        self._actions: dict[SkillLeaf, int] = {}

    def started(self, leaf: SkillLeaf, inputs: Mapping[str, Any]) -> None:
        weighs = {"hand", "balance"} <= set(leaf.skill.devices)
        given, units = plain_values(inputs), units_of(leaf.skill)
        units = {name: units[name] for name in given if name in units}
        event = ActionStarted(path=leaf.path, visit=leaf.visits, skill=leaf.name, inputs=given, units=units)
        self._actions[leaf] = self._journal.action_started(event, weighs=weighs)

    def waits(self, leaf: SkillLeaf) -> Wake | None:
        return self._journal.waits(self._actions[leaf])

    def acting(self, leaf: SkillLeaf) -> None:
        self._journal.action = self._actions[leaf]

    def ended(self, leaf: SkillLeaf, outcome: str, result: Any) -> None:
        code = result.code if isinstance(result, SkillFailed) else None
        value = {"detail": result.detail} if isinstance(result, SkillFailed) else result
        event = ActionEnded(outcome=outcome, code=code, result=plain(value))
        self._journal.action_ended(self._actions.pop(leaf), event)

    def in_words(self, inputs: Mapping[str, Any]) -> str:
        return to_json(plain_values(inputs))

    def decided(self, path: str, visit: int, decision: Decision) -> None:
        failure = decision.failure
        self._journal.event(
            Decided(path=path, visit=visit, code=failure.code, detail=failure.detail, had_begun=decision.had_begun)
        )

    def gave_up(self, path: str) -> None:
        self._journal.event(GaveUp(path=path))

    def rounds_done(self, path: str) -> None:
        self._journal.event(RoundsDone(path=path))


def _running(root: Behaviour) -> str:
    """The names of the running leaves."""
    names = [node.name for node in root.iterate() if isinstance(node, SkillLeaf) and node.status is Status.RUNNING]
    return "the skill " + (" and ".join(names) or "at work")
