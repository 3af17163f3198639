"""The leaf of a job's tree, which runs a skill's generator; and what it shares with the other nodes of the tree."""

import traceback
from collections.abc import Callable, Generator, Sequence
from pathlib import Path
from typing import Any, Protocol, TypeVar

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from pydantic import ValidationError

from scuhand_bt.cell.cell import Cell
from scuhand_bt.cell.leased import leased
from scuhand_bt.cell.right_of_way import LOOK_S
from scuhand_bt.clock import Signal, Steps, Wake
from scuhand_bt.failures import CATALOGUE, Code
from scuhand_bt.record import RecordLost
from scuhand_bt.skill import Skill, SkillFailed
from scuhand_bt.tree.leases import Leases
from scuhand_bt.tree.replay import ENDED, Decision, Recorded, Replay
from scuhand_bt.tree.substitutes import Substitutes
from scuhand_bt.tree.wires import in_words

REST_S = 1.0
"""Time for the devices to come to rest after the skill's end [s]. A wide open valve takes 0.7 s."""
REJOINING = ("arm", "balance")
"""The devices that `Rejoin` uses."""

S = TypeVar("S", bound=Skill[Any])
Values = dict[str, Any]
Arguments = Callable[[], Values]
"""Evaluates a call's parameters when it begins."""


class SkillBug(Exception):  # noqa: N818 - it names what it is, for the user
    """A skill broke the rules of skills, or of Python. This is no failure of the cell."""


class Listener(Protocol):
    """Receives every action before it starts and after it has ended; in a run it is the journal."""

    def started(self, leaf: "SkillLeaf", inputs: Values) -> None: ...

    def waits(self, leaf: "SkillLeaf") -> Wake | None:
        """What to wait for until the start of the action is on disk; None if it is."""
        ...

    def acting(self, leaf: "SkillLeaf") -> None:
        """The leaf is about to make its next step; what is recorded from now on belongs to it."""
        ...

    def ended(self, leaf: "SkillLeaf", outcome: str, result: Any) -> None: ...

    def in_words(self, inputs: Values) -> str:
        """The inputs of an action in the form in which they are recorded."""
        ...

    def decided(self, path: str, visit: int, decision: Decision) -> None:
        """A node other than a leaf has failed for a reason of its own."""
        ...

    def gave_up(self, path: str) -> None:
        """A `retry` has failed, and does not begin its child again."""
        ...

    def rounds_done(self, path: str) -> None:
        """A `repeat` or `for_each` has succeeded, and does not begin its child again."""
        ...


class Rejoin(Protocol):
    """What a resumed run does before the first live action, and before an action that had begun.

    See docs/run-behaviour.md, "Resuming". `recorded` is what is recorded for the action's place and visit; `is_same`:
    it was the same skill with the same inputs. Returns False if the operator says that the action is done and must not
    begin again.
    """

    def __call__(
        self, cell: Cell, replay: Replay, skill: Skill[Any], name: str, recorded: Recorded | None, *, is_same: bool
    ) -> Steps[bool]: ...


class Consent(Protocol):
    """Asks for permission before each action, in single step."""

    def waits(self, leaf: "SkillLeaf", inputs: Values, shared: "Ticking") -> Wake | None:
        """What to wait for until the leaf may begin; None, only once, when it may."""
        ...

    def withdraw(self, leaf: "SkillLeaf", shared: "Ticking") -> None:
        """The leaf was halted, so its question is void."""
        ...


class Ticking:
    """What the nodes of one job's tree share: cell, leases, listener, replay, and what each node waits for."""

    def __init__(
        self,
        cell: Cell,
        leases: Leases,
        listener: Listener,
        replay: Replay,
        rejoin: Rejoin,
        substitutes: Substitutes | None = None,
        consent: Consent | None = None,
    ) -> None:
        self.cell = cell
        self.leases = leases
        self.listener = listener
        self.replay = replay
        self.rejoin = rejoin
        self.substitutes = substitutes
        """Stand-ins for skills, in a test of a workflow."""
        self.consent = consent
        """Lets each action begin, in single step."""
        self.acting: set[SkillLeaf] = set()
        """The leaves whose skill is at work."""
        self.rejoining: SkillLeaf | None = None
        """The leaf that settles what an interruption has left. No other action begins meanwhile."""
        self.is_pausing = False
        """No action may begin."""
        self.going_on = Signal()
        """Fires when actions may begin again."""
        self.is_interrupted = False
        """The run, not the tree, halts the job."""
        self.bugs: list[SkillBug] = []
        """Exceptions of skills while they were halted. They are kept, so that the rest of the tree is halted too."""
        self._waiting: dict[Behaviour, Sequence[Wake]] = {}
        self.held_up_by: set[object] = set()
        """What keeps an action from beginning: an answer in single step, or settling what an interruption left."""
        self._held_up_s = self._changed_s = 0.0

    @property
    def held_up_s(self) -> float:
        """The total time for which actions were held up [s]. Timeouts do not count it."""
        return self._held_up_s + (self.cell.clock.now_s - self._changed_s if self.held_up_by else 0.0)

    def holds_up(self, who: object, is_so: bool) -> None:
        self._held_up_s, self._changed_s = self.held_up_s, self.cell.clock.now_s
        (self.held_up_by.add if is_so else self.held_up_by.discard)(who)

    def wait(self, node: Behaviour, *wakes: Wake) -> None:
        """Set what `node` wants to be ticked for next; replaces what it had set before."""
        self._waiting[node] = wakes

    def done(self, node: Behaviour) -> None:
        self._waiting.pop(node, None)

    def wakes(self) -> list[Wake]:
        """Everything that the tree waits for now."""
        return [wake for wakes in self._waiting.values() for wake in wakes]


class SkillLeaf(Behaviour):
    """Runs one skill: makes it from its arguments, leases its devices, and drives its generator."""

    def __init__(
        self,
        name: str,
        path: str,
        skill: type[Skill[Any]],
        arguments: Arguments,
        keep: Callable[[Any], None],
        shared: Ticking,
    ) -> None:
        super().__init__(name)
        self.path = path
        self.skill = skill
        self.visits = 0
        self.failure: SkillFailed | None = None
        self._arguments = arguments
        self._keep = keep
        self._shared = shared
        self._steps: Steps[Any] | None = None
        self._wake: Wake | None = None
        self._began_waiting_s = self._rest_deadline_s = 0.0
        self._ended: tuple[str, Any] | None = None
        self._is_recorded = self._may_begin = False
        self._recorded: Recorded | None = None

    def initialise(self) -> None:
        self.visits += 1
        self.failure = None
        self._steps = self._wake = self._ended = None
        self._is_recorded = self._may_begin = False
        self._recorded = self._shared.replay.recorded(self.path, self.visits)
        self._began_waiting_s = self._shared.cell.clock.now_s

    @property
    def is_stuck(self) -> bool:
        """Whether it is being replayed, and waits to be halted as it was then."""
        replay = self._shared.replay
        return replay.is_replaying and self._recorded is not None and self._recorded.outcome == "halted"

    def update(self) -> Status:
        try:
            if self.is_stuck:
                return Status.RUNNING
            if self._steps is None and self._is_replayed():
                return Status.SUCCESS
            if self._steps is None and not self._begin():
                return Status.RUNNING
            if self._ended is not None:
                return self._come_to_rest(*self._ended)
            if self._wake is None and (writing := self._shared.listener.waits(self)) is not None:
                self._shared.wait(self, writing)
                return Status.RUNNING
            if self._wake is not None and not self._is_due(self._wake):
                return Status.RUNNING
            assert self._steps is not None
            self._shared.listener.acting(self)
            self._wake = next(self._steps)
            if not isinstance(self._wake, Wake):
                raise TypeError(f"it yields {self._wake!r}; a skill yields `Wake`s")
        except StopIteration as stop:
            return self._has_ended("done", stop.value)
        except SkillFailed as failure:
            if not is_explained(self.skill, failure):
                self._end("broken", None)
                raise unexplained(self.name, failure) from failure
            return self._has_ended("failed", failure)
        except (RecordLost, SkillBug):
            raise
        except BaseException as error:  # sys.exit() too: the engine decides how a run ends
            self._end("broken", None)
            raise bug_of(self.name, error) from error
        self._shared.wait(self, self._wake)
        return Status.RUNNING

    def _has_ended(self, outcome: str, result: Any) -> Status:
        self._ended = outcome, result
        self._rest_deadline_s = self._shared.cell.clock.now_s + REST_S
        return self._come_to_rest(outcome, result)

    def _come_to_rest(self, outcome: str, result: Any) -> Status:
        """The skill has ended; its action is over once all devices that it commanded stand still.

        Raises SkillBug if a sound device runs on longer than `REST_S`. A faulty device is left to the guards.
        """
        shared, cell = self._shared, self._shared.cell
        devices = {name: cell.device(name) for name in (self.skill.devices if self._is_recorded else ())}
        at_work = [name for name, device in devices.items() if not device.is_stopped and device.fault is None]
        if at_work and cell.clock.now_s < self._rest_deadline_s:
            shared.wait(self, *shared.leases.wakes(at_work, self._rest_deadline_s))
            return Status.RUNNING
        if at_work:
            for name in at_work:
                devices[name].stop()
            self._end("broken", None)
            raise SkillBug(f"the skill {self.name} broke: it has ended and left at work: {', '.join(at_work)}")
        if outcome == "failed":
            self.failure = result
        else:
            self._keep(result)
        self._end(outcome, result)
        return Status.FAILURE if outcome == "failed" else Status.SUCCESS

    def terminate(self, new_status: Status) -> None:
        """Halted while running: close the generator, whose `finally` sends the safe commands."""
        if new_status is not Status.INVALID or self.status is not Status.RUNNING:
            return
        outcome = "interrupted" if self._shared.is_interrupted else "halted"
        if self._shared.consent is not None:
            self._shared.consent.withdraw(self, self._shared)
        try:
            if self._steps is not None:
                self._shared.listener.acting(self)
                self._steps.close()
        except BaseException as error:
            outcome = "broken"
            self._shared.bugs.append(bug_of(self.name, error))
        self._end(outcome, None)

    def _is_replayed(self) -> bool:
        """End as recorded, if this action had ended before the interruption. Raises the recorded failure."""
        recorded, shared = self._recorded, self._shared
        if recorded is None or recorded.outcome not in ENDED:
            return False
        inputs = shared.listener.in_words(self._arguments())
        if not shared.replay.can_replay(recorded, self.name, self.skill, inputs):
            return False
        self._keep(shared.replay.replay(recorded, self.skill))
        shared.done(self)
        return True

    def _begin(self) -> bool:
        """Take the leases and make the skill; False if it must wait for another action, a person or a pause."""
        shared, replay = self._shared, self._shared.replay
        if replay.is_replaying:
            return False
        now_s = shared.cell.clock.now_s
        if shared.is_pausing or shared.rejoining is not None:
            self._began_waiting_s = now_s
            shared.wait(self, Wake.on(shared.going_on))
            return False
        inputs = self._arguments()
        if shared.consent is not None and not self._may_begin:
            self._began_waiting_s = now_s
            if (asked := shared.consent.waits(self, inputs, shared)) is not None:
                shared.wait(self, asked)
                return False
            self._may_begin = True
        is_open = self._recorded is not None
        also: tuple[str, ...] = REJOINING if replay.is_to_rejoin else ()
        if is_open and not also and self.skill.settle is not Skill.settle:
            also, self._began_waiting_s = ("arm",), now_s  # for `settle`; waits for whatever action has it
        if wakes := self._lacks((*dict.fromkeys((*self.skill.devices, *also)),)):
            shared.wait(self, *wakes)
            return False
        skill = made(self.name, self.skill, inputs)
        shared.rejoining = self if replay.is_to_rejoin or is_open else None
        shared.listener.started(self, inputs)
        self._is_recorded = True
        shared.acting.add(self)
        self._steps = skill.run(leased(shared.cell, self.skill.sees()))
        if not isinstance(self._steps, Generator):
            raise TypeError("its run is no generator; it must `yield` somewhere")
        if shared.substitutes is not None:
            self._steps = shared.substitutes.steps(self.path, shared.cell.clock, self._steps)
        if shared.rejoining is self:
            self._steps = self._resume(skill, self._steps, shared.listener.in_words(inputs))
        return True

    def _lacks(self, devices: Sequence[str]) -> list[Wake]:
        """Lease these and the skill's zones; returns what to wait for, if anything. SkillFailed after too long."""
        leases = self._shared.leases
        if leases.take(devices, self, self.skill.zones):
            return []
        timeout_s, failure = leases.waited_for(devices, self, self.skill.zones)
        until_s = self._began_waiting_s + timeout_s
        if self._shared.cell.clock.now_s >= until_s:
            raise failure
        return leases.wakes(devices, until_s)

    def _resume(self, skill: Skill[Any], steps: Steps[Any], inputs: str) -> Steps[Any]:
        """The skill's steps, preceded by settling what an interruption has left."""
        shared, recorded = self._shared, self._recorded
        is_same = recorded is not None and recorded.skill == self.name and recorded.inputs == inputs
        rejoined = shared.rejoin(shared.cell, shared.replay, skill, self.name, recorded, is_same=is_same)
        shared.holds_up(self, True)
        try:
            if not (yield from rejoined):
                return None
        finally:
            shared.holds_up(self, False)
            if shared.rejoining is self:
                shared.rejoining = None
                shared.going_on.fire()
        # Only what the skill itself needs: without the arm, it has to wait for zones in which that stands.
        shared.leases.give_back(self)
        self._began_waiting_s = shared.cell.clock.now_s
        while self._lacks(self.skill.devices):
            yield Wake.on(shared.cell.right_of_way.news, shared.cell.clock.now_s + LOOK_S)
        return (yield from steps)

    def _is_due(self, wake: Wake) -> bool:
        return wake.has_fired or self._shared.cell.clock.now_s >= wake.until_s

    def _end(self, outcome: str, result: Any) -> None:
        self._steps = None
        self._shared.done(self)
        self._shared.acting.discard(self)
        self._shared.leases.give_back(self)
        if self._is_recorded:
            self._is_recorded = False
            self._shared.listener.ended(self, outcome, result)


def bug_of(name: str, error: BaseException) -> SkillBug:
    """The bug behind an exception in a skill's code, with the line of its file."""
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if Path(frame.filename).stem == name]
    where = f" ({name}.py, line {lines[-1]})" if lines else ""
    return SkillBug(f"the skill {name} broke: {type(error).__name__}: {error}{where}")


def is_explained(skill: type[Skill[Any]], failure: SkillFailed) -> bool:
    """Whether recipes and workflows can name this failure: by the catalogue, or the skill itself."""
    return failure.code in CATALOGUE or failure.code in skill.failures


def unexplained(name: str, failure: SkillFailed) -> SkillBug:
    """The bug of a skill that fails with an undeclared code."""
    return SkillBug(f"the skill {name} broke: it fails with a code that nobody has explained: {failure}")


def made(name: str, skill: type[S], inputs: Values) -> S:
    """The skill with its parameters. Raises SkillFailed workflow.bad_value for values that it does not accept."""
    try:
        return skill.model_validate(inputs, by_alias=True, by_name=False)
    except ValidationError as error:
        raise SkillFailed(Code.WORKFLOW_BAD_VALUE, f"{name}: {in_words(error)}") from None


def is_stuck(node: Behaviour) -> bool:
    """Whether a part of a replayed tree waits to be halted as it was then."""
    return any(
        isinstance(leaf, SkillLeaf) and leaf.status is Status.RUNNING and leaf.is_stuck for leaf in node.iterate()
    )
