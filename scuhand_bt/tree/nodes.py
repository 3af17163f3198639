"""The py_trees nodes that a workflow is built into: the skill's leaf, and decorators on the run's clock.

`sequence`, `fallback`, `parallel`, `invert` and `optional` are py_trees' own. Ours are the leaf, which
drives a skill's generator, and what needs the run's clock or a failure's code: `retry`, `timeout`,
`repeat`, `while`, and the call of a workflow.
"""

from collections.abc import Callable, Generator, Iterator, Sequence
from typing import Any, ClassVar, Protocol, TypeVar

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.composites import Composite, Selector
from py_trees.composites import Sequence as SequenceNode
from py_trees.decorators import Decorator
from pydantic import ValidationError

from scuhand_bt.clock import Signal, Steps, Wake
from scuhand_bt.devices.cell import Cell
from scuhand_bt.failures import CATALOGUE
from scuhand_bt.record import RecordLost
from scuhand_bt.skill import Condition, Skill, SkillFailed
from scuhand_bt.tree.leases import Leases
from scuhand_bt.tree.past import ENDED, REJOINING, Decision, Past, Recorded, rejoin, settle
from scuhand_bt.tree.wires import in_words

LEASE_TIMEOUT_S = 10.0

S = TypeVar("S", bound=Skill[Any])
Values = dict[str, Any]
Arguments = Callable[[], Values]
"""Evaluates a call's parameters when it begins."""


class SkillBug(Exception):  # noqa: N818 - it names what it is, for the user
    """A skill broke the rules of skills (or Python's); not a failure of the cell."""


class Listener(Protocol):
    """Who is told of every action before it starts and after it has ended: the journal."""

    def started(self, leaf: "SkillLeaf", inputs: Values) -> None: ...

    def acting(self, leaf: "SkillLeaf") -> None:
        """The leaf is about to do its next step; what is recorded now is its doing."""
        ...

    def ended(self, leaf: "SkillLeaf", outcome: str, result: Any) -> None: ...

    def in_words(self, inputs: Values) -> str:
        """The inputs of an action as the record keeps them."""
        ...

    def decided(self, path: str, visit: int, decision: Decision) -> None:
        """A node that is no action has failed on its own account."""
        ...


class Ticking:
    """What the nodes of one job's tree share: the cell, its leases, the listener, and who waits for what."""

    def __init__(self, cell: Cell, leases: Leases, listener: Listener, past: Past) -> None:
        self.cell = cell
        self.leases = leases
        self.listener = listener
        self.past = past
        self.acting: set[SkillLeaf] = set()
        """The leaves whose skill is at work."""
        self.is_pausing = False
        """No action may begin."""
        self.going_on = Signal()
        """Fires when actions may begin again."""
        self.paused_s = 0.0
        """How long the job has been paused in all: timeouts do not count it."""
        self.is_interrupted = False
        """The run, not the tree, halts the job."""
        self.bugs: list[SkillBug] = []
        """What broke while it was halted: it must not keep the rest of the tree from being halted too."""
        self._waiting: dict[Behaviour, Sequence[Wake]] = {}

    def wait(self, node: Behaviour, *wakes: Wake) -> None:
        """Note when `node` wants the next tick; replaces what it asked for before."""
        self._waiting[node] = wakes

    def done(self, node: Behaviour) -> None:
        self._waiting.pop(node, None)

    def wakes(self) -> list[Wake]:
        """All that the tree waits for now."""
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
        self._lease_deadline_s = 0.0
        self._is_recorded = False
        self._recorded: Recorded | None = None

    def initialise(self) -> None:
        self.visits += 1
        self.failure = None
        self._steps = self._wake = None
        self._is_recorded = False
        self._recorded = self._shared.past.recorded(self.path, self.visits)
        self._lease_deadline_s = self._shared.cell.clock.now_s + LEASE_TIMEOUT_S

    @property
    def is_stuck(self) -> bool:
        """It is being replayed, and waits to be halted as it was then."""
        past = self._shared.past
        return past.is_replaying and self._recorded is not None and self._recorded.outcome == "halted"

    def update(self) -> Status:
        try:
            if self.is_stuck:
                return Status.RUNNING
            if self._steps is None and self._is_replayed():
                return Status.SUCCESS
            if self._steps is None and not self._begin():
                return Status.RUNNING
            if self._wake is not None and not self._is_due(self._wake):
                return Status.RUNNING
            assert self._steps is not None
            self._shared.listener.acting(self)
            self._wake = next(self._steps)
            if not isinstance(self._wake, Wake):
                raise TypeError(f"it yields {self._wake!r}; a skill yields `Wake`s")
        except StopIteration as stop:
            self._keep(stop.value)
            self._end("done", stop.value)
            return Status.SUCCESS
        except SkillFailed as failure:
            if not _is_explained(self.skill, failure):
                self._end("broken", None)
                raise _unexplained(self.name, failure) from failure
            self.failure = failure
            self._end("failed", failure)
            return Status.FAILURE
        except RecordLost:
            raise
        except Exception as error:
            self._end("broken", None)
            raise _bug(self.name, error) from error
        self._shared.wait(self, self._wake)
        return Status.RUNNING

    def terminate(self, new_status: Status) -> None:
        """Halted while running: close the generator, whose `finally` sends the safe commands."""
        if new_status is not Status.INVALID or self.status is not Status.RUNNING:
            return
        outcome = "interrupted" if self._shared.is_interrupted else "halted"
        try:
            if self._steps is not None:
                self._steps.close()
        except Exception as error:
            outcome = "broken"
            self._shared.bugs.append(_bug(self.name, error))
        self._end(outcome, None)

    def _is_replayed(self) -> bool:
        """End as recorded, if this action ended before the run was interrupted; raises a recorded failure."""
        recorded, shared = self._recorded, self._shared
        if recorded is None or recorded.outcome not in ENDED:
            return False
        inputs = shared.listener.in_words(self._arguments())
        if not shared.past.can_replay(recorded, self.name, self.skill, inputs):
            return False
        self._keep(shared.past.replay(recorded, self.skill))
        shared.done(self)
        return True

    def _begin(self) -> bool:
        """Take the leases and make the skill; False while it must wait for others, or the run pauses."""
        shared, past = self._shared, self._shared.past
        if past.is_replaying:
            return False
        now_s = shared.cell.clock.now_s
        if shared.is_pausing:
            self._lease_deadline_s = now_s + LEASE_TIMEOUT_S
            shared.wait(self, Wake.on(shared.going_on))
            return False
        own = self.skill.devices
        devices = sorted({*own, *REJOINING}) if past.is_to_rejoin else own
        if not shared.leases.take(devices, self):
            if now_s >= self._lease_deadline_s:
                names = ", ".join(devices)
                raise SkillFailed("device.busy", f"{names} not free after {LEASE_TIMEOUT_S:g} s")
            shared.wait(self, *shared.leases.wakes(devices, self._lease_deadline_s))
            return False
        inputs = self._arguments()
        skill = _made(self.name, self.skill, inputs)
        shared.listener.started(self, inputs)
        self._is_recorded = True
        shared.acting.add(self)
        self._steps = skill.run(shared.cell)
        if not isinstance(self._steps, Generator):
            raise TypeError("its run is no generator; it must `yield` somewhere")
        if past.is_to_rejoin or self._recorded is not None:
            self._steps = self._resume(skill, self._steps, shared.listener.in_words(inputs))
        return True

    def _resume(self, skill: Skill[Any], steps: Steps[Any], inputs: str) -> Steps[Any]:
        """The skill's steps, after what an interruption has left to settle."""
        shared, recorded = self._shared, self._recorded
        if shared.past.is_to_rejoin:
            shared.past.is_to_rejoin = False
            yield from rejoin(shared.cell, shared.past, skill, was_interrupted=recorded is not None)
        if recorded is not None:
            same = recorded.skill == self.name and recorded.inputs == inputs
            answer = yield from settle(shared.cell, skill, self.name, None if same else recorded)
            if answer == "done":
                return None
        shared.leases.give_back(self, keep=self.skill.devices)
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


def _bug(name: str, error: Exception) -> SkillBug:
    return SkillBug(f"the skill {name} broke: {type(error).__name__}: {error}")


def _is_explained(skill: type[Skill[Any]], failure: SkillFailed) -> bool:
    """Whether recipes and workflows can name this failure: the catalogue has it, or the skill itself."""
    return failure.code in CATALOGUE or failure.code in skill.failures


def _unexplained(name: str, failure: SkillFailed) -> SkillBug:
    return SkillBug(f"the skill {name} broke: it fails with a code that nobody has explained: {failure}")


def _made(name: str, skill: type[S], inputs: Values) -> S:
    """The skill with its parameters; SkillFailed workflow.bad_value for values that it does not accept."""
    try:
        return skill.model_validate(inputs, by_alias=True, by_name=False)
    except ValidationError as error:
        raise SkillFailed("workflow.bad_value", f"{name}: {in_words(error)}") from None


class Guard(Behaviour):
    """A condition in front of a `while`'s child; looked at on every tick of the `while`."""

    def __init__(self, name: str, condition: type[Condition], arguments: Arguments, shared: Ticking) -> None:
        super().__init__(name)
        self.condition = condition
        self.failure: SkillFailed | None = None
        self._arguments = arguments
        self._cell = shared.cell

    def update(self) -> Status:
        self.failure = None
        try:
            _made(self.name, self.condition, self._arguments()).check(self._cell)
        except SkillFailed as failure:
            if not _is_explained(self.condition, failure):
                raise _unexplained(self.name, failure) from failure
            self.failure = failure
            return Status.FAILURE
        except Exception as error:
            raise _bug(self.name, error) from error
        return Status.SUCCESS


class While(SequenceNode):
    """Guards, then the child, all looked at anew on every tick; a guard that fails halts the child."""

    def __init__(self, path: str, guards: Sequence[Guard], child: Behaviour, shared: Ticking) -> None:
        super().__init__("while", memory=False, children=[*guards, child])
        self.failure: SkillFailed | None = None
        self._path = path
        self._visits = 0
        self._child = child
        self._devices = sorted({device for guard in guards for device in guard.condition.watches})
        self._shared = shared

    def initialise(self) -> None:
        self.failure = None
        self._visits += 1

    def tick(self) -> Iterator[Behaviour]:
        if self._shared.past.is_replaying:
            yield from self._replay()
            return
        had_begun = self.status is Status.RUNNING and self._child.status is Status.RUNNING
        for node in super().tick():
            if node is self and self.status is Status.RUNNING:  # before a parent takes this for the tick's end
                self._shared.wait(self, *(Wake.on(self._shared.cell.device(name).news) for name in self._devices))
            if node is self and self.status is Status.FAILURE and self._child.status is not Status.FAILURE:
                decision = Decision(failure_of(self), had_begun)
                self._shared.listener.decided(self._path, self._visits, decision)
            yield node

    def _replay(self) -> Iterator[Behaviour]:
        """The guards held, then, until the one that is recorded to have failed."""
        if self.status is not Status.RUNNING:
            self.initialise()
        decision = self._shared.past.decision(self._path, self._visits)
        if decision is None or decision.had_begun:
            yield from self._child.tick()
        self.status = self._child.status
        if decision is not None and (not decision.had_begun or is_stuck(self._child)):
            self._child.stop(Status.INVALID)
            self.failure = decision.failure
            self.status = Status.FAILURE
        yield self

    def terminate(self, new_status: Status) -> None:
        self._shared.done(self)


class _OnClock(Decorator):
    """A decorator that may ask for a tick of its own, and may fail for a reason of its own."""

    def __init__(self, name: str, child: Behaviour, arguments: Arguments, shared: Ticking) -> None:
        super().__init__(name, child)
        self.failure: SkillFailed | None = None
        self._arguments = arguments
        self._shared = shared

    def terminate(self, new_status: Status) -> None:
        self._shared.done(self)

    def _again(self) -> Status:
        """Tick the child anew, at this same time."""
        self._shared.wait(self, Wake(self._shared.cell.clock.now_s))
        return Status.RUNNING


class _Counted(_OnClock):
    """A decorator that begins its child again, up to a number of times that must be at least 1."""

    count: ClassVar[str]

    def __init__(self, child: Behaviour, arguments: Arguments, shared: Ticking) -> None:
        super().__init__(type(self).__name__.lower(), child, arguments, shared)
        self._left = 0

    def tick(self) -> Iterator[Behaviour]:
        if self.status is not Status.RUNNING:
            self._left = self._arguments()[self.count]
            self.failure = None
            if self._left < 1:
                self.failure = SkillFailed("workflow.bad_value", f"{self.name}: '{self.count}' is {self._left}")
                self.stop(Status.FAILURE)
                yield self
                return
        yield from super().tick()


class Retry(_Counted):
    """Begin the child again when it fails with one of `codes` (none given: any), up to `attempts` times in all."""

    count = "attempts"

    def __init__(self, child: Behaviour, arguments: Arguments, codes: frozenset[str], shared: Ticking) -> None:
        super().__init__(child, arguments, shared)
        self._codes = codes

    def update(self) -> Status:
        self._shared.done(self)
        if self.decorated.status is not Status.FAILURE:
            return self.decorated.status
        failure = failure_of(self.decorated)
        self._left -= 1
        if self._left <= 0 or (self._codes and failure.code not in self._codes):
            return Status.FAILURE
        return self._again()


class Repeat(_Counted):
    """Run the child `times` times; fails when the child fails."""

    count = "times"

    def update(self) -> Status:
        self._shared.done(self)
        if self.decorated.status is not Status.SUCCESS:
            return self.decorated.status
        self._left -= 1
        return Status.SUCCESS if self._left <= 0 else self._again()


class Timeout(_OnClock):
    """Halt the child and fail if it has not ended within `duration` of run time, pauses not counted."""

    def __init__(self, path: str, child: Behaviour, arguments: Arguments, shared: Ticking) -> None:
        super().__init__("timeout", child, arguments, shared)
        self._path = path
        self._visits = 0
        self._duration_s = 0.0
        self._began_s = 0.0

    @property
    def _deadline_s(self) -> float:
        return self._began_s + self._shared.paused_s + self._duration_s

    def initialise(self) -> None:
        self.failure = None
        self._visits += 1
        self._duration_s = self._arguments()["duration"]
        self._began_s = self._shared.cell.clock.now_s - self._shared.paused_s

    def update(self) -> Status:
        if self.decorated.status is not Status.RUNNING:
            return self.decorated.status
        shared = self._shared
        decision = shared.past.decision(self._path, self._visits)
        if decision is not None and is_stuck(self.decorated):
            return self._fail(decision.failure)
        if shared.cell.clock.now_s >= self._deadline_s:
            failure = SkillFailed("workflow.timeout", f"not done after {self._duration_s:g} s")
            status = self._fail(failure)
            shared.listener.decided(self._path, self._visits, Decision(failure))
            return status
        shared.wait(self, Wake(self._deadline_s))
        return Status.RUNNING

    def _fail(self, failure: SkillFailed) -> Status:
        self.decorated.stop(Status.INVALID)
        self.failure = failure
        return Status.FAILURE


class WorkflowCall(Decorator):
    """A workflow called by another: its inputs are bound when it begins, its result kept when it succeeds."""

    def __init__(self, name: str, child: Behaviour, bind: Callable[[], None], keep_result: Callable[[], None]) -> None:
        super().__init__(name, child)
        self._bind = bind
        self._keep_result = keep_result

    def initialise(self) -> None:
        self._bind()

    def update(self) -> Status:
        if self.decorated.status is Status.SUCCESS:
            self._keep_result()
        return self.decorated.status


def is_stuck(node: Behaviour) -> bool:
    """Whether a part of a tree that is being replayed waits to be halted as it was then."""
    return any(
        isinstance(leaf, SkillLeaf) and leaf.status is Status.RUNNING and leaf.is_stuck for leaf in node.iterate()
    )


def failure_of(node: Behaviour) -> SkillFailed:
    """Why a node failed: the failure of the leaf that decided it."""
    own = getattr(node, "failure", None)
    if isinstance(own, SkillFailed):
        return own
    if isinstance(node, Composite):
        failed = [child for child in node.children if child.status is Status.FAILURE]
        if failed:
            return failure_of(failed[-1] if isinstance(node, Selector) else failed[0])
    elif isinstance(node, Decorator):
        if node.decorated.status is Status.FAILURE:
            return failure_of(node.decorated)
        return SkillFailed("workflow.inverted", f"{node.decorated.name} succeeded under 'invert'")
    return SkillFailed("workflow.inverted", f"{node.name} failed")
