"""The py_trees nodes of a workflow, except leaves (`tree/leaf.py`) and `while` (`tree/guarded.py`).

`sequence`, `parallel`, `invert`, `optional` and a plain `fallback` are py_trees' own. Those here need the run's clock,
a failure's code or a value: `retry`, `timeout`, `repeat`, `for_each`, `if`, `switch`, a `fallback` with `on`, and the
call of a workflow. If a value cannot be computed, the node that needs it fails.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, ClassVar

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.composites import Composite, Selector
from py_trees.decorators import Decorator

from scuhand_bt.clock import Wake
from scuhand_bt.failures import Code
from scuhand_bt.skill import SkillFailed
from scuhand_bt.tree.leaf import Arguments, Ticking, is_stuck
from scuhand_bt.tree.record import Round
from scuhand_bt.tree.replay import Decision


class _Begun(Decorator):
    """A decorator that evaluates its arguments when it begins, and fails if it cannot."""

    def __init__(self, name: str, child: Behaviour) -> None:
        super().__init__(name, child)
        self.failure: SkillFailed | None = None

    def begin(self) -> None:
        """Evaluate what it needs. Raises SkillFailed."""
        raise NotImplementedError

    def tick(self) -> Iterator[Behaviour]:
        if self.status is not Status.RUNNING and not self._begins():
            yield self
            return
        self.decorated.tick_once()
        _is_now(self, self.update())
        yield self

    def _begins(self) -> bool:
        """False if it cannot begin; it has then failed."""
        self.failure = None
        try:
            self.begin()
        except SkillFailed as failure:
            self.failure = failure
            self.stop(Status.FAILURE)
            return False
        return True


class _OnClock(_Begun):
    """A decorator that may ask for a tick, and may fail for a reason of its own."""

    def __init__(self, name: str, child: Behaviour, arguments: Arguments, shared: Ticking) -> None:
        super().__init__(name, child)
        self._arguments = arguments
        self._shared = shared

    def terminate(self, new_status: Status) -> None:
        self._shared.done(self)

    def _again(self) -> Status:
        """Tick the child again at this same time."""
        self._shared.wait(self, Wake(self._shared.cell.clock.now_s))
        return Status.RUNNING


class _Counted(_OnClock):
    """A decorator that begins its child again, up to a number of times that must be at least 1."""

    count: ClassVar[str]

    def __init__(self, child: Behaviour, arguments: Arguments, shared: Ticking) -> None:
        super().__init__(type(self).__name__.lower(), child, arguments, shared)
        self._left = 0

    def begin(self) -> None:
        self._left = self._arguments()[self.count]
        if self._left < 1:
            raise SkillFailed(Code.WORKFLOW_BAD_VALUE, f"{self.name}: '{self.count}' is {self._left}")


class Retry(_Counted):
    """Begin the child again when it fails with one of `codes` (any, if empty), up to `attempts` times in all.

    It reports to the listener when it gives up. Otherwise the journal would look the same as before another attempt.
    """

    count = "attempts"

    def __init__(
        self, path: str, child: Behaviour, arguments: Arguments, codes: frozenset[str], shared: Ticking
    ) -> None:
        super().__init__(child, arguments, shared)
        self.path = path
        self._codes = codes

    def update(self) -> Status:
        self._shared.done(self)
        if self.decorated.status is not Status.FAILURE:
            return self.decorated.status
        failure = failure_of(self.decorated)
        self._left -= 1
        if self._left <= 0 or (self._codes and failure.code not in self._codes):
            if not self._shared.replay.is_replaying:
                self._shared.listener.gave_up(self.path)
            return Status.FAILURE
        return self._again()


class Repeat(_Counted):
    """Run the child `times` times; fails when the child fails. Reports its end to the listener."""

    count = "times"

    def __init__(self, path: str, child: Behaviour, arguments: Arguments, around: Round, shared: Ticking) -> None:
        super().__init__(child, arguments, shared)
        self.path = path
        self._round = around

    def begin(self) -> None:
        super().begin()
        self._round.number = 1

    def update(self) -> Status:
        self._shared.done(self)
        if self.decorated.status is not Status.SUCCESS:
            return self.decorated.status
        self._left -= 1
        if self._left <= 0:
            _tell_rounds_done(self.path, self._shared)
            return Status.SUCCESS
        self._round.number += 1
        return self._again()


class ForEach(_Begun):
    """Run the child for each item of its parallel lists; fails when the child fails.

    Reports its end to the listener. `items` are the values that the child reads, by the items' names. The next round
    begins in the tick in which the last one ended: lists are finite.
    """

    def __init__(
        self,
        path: str,
        child: Behaviour,
        arguments: Arguments,
        around: Round,
        items: dict[str, Any],
        shared: Ticking,
    ) -> None:
        super().__init__("for_each", child)
        self.path = path
        self._shared = shared
        self._arguments = arguments
        self._round = around
        self._items = items
        self._rounds: list[dict[str, Any]] = []

    def begin(self) -> None:
        lists = self._arguments()
        counts = {name: len(listed) for name, listed in lists.items()}
        if len(set(counts.values())) > 1:
            said = ", ".join(f"'{name}' has {count}" for name, count in counts.items())
            raise SkillFailed(Code.WORKFLOW_BAD_VALUE, f"for_each: the lists differ in length: {said}")
        self._rounds = [dict(zip(lists, items, strict=True)) for items in zip(*lists.values(), strict=True)]
        self._round.number = 1

    def tick(self) -> Iterator[Behaviour]:
        if self.status is not Status.RUNNING and not self._begins():
            yield self
            return
        while self._round.number <= len(self._rounds):
            self._items.update(self._rounds[self._round.number - 1])
            self.decorated.tick_once()
            if self.decorated.status is not Status.SUCCESS:
                break
            self._round.number += 1
        _is_now(self, self.update())
        yield self

    def update(self) -> Status:
        if self._round.number <= len(self._rounds):
            return self.decorated.status
        _tell_rounds_done(self.path, self._shared)
        return Status.SUCCESS


def _tell_rounds_done(path: str, shared: Ticking) -> None:
    if not shared.replay.is_replaying:
        shared.listener.rounds_done(path)


class Chosen(Composite):
    """`if` or `switch`: when it begins it chooses one child, which it then ticks. If it chooses none, it succeeds."""

    def __init__(self, name: str, children: Sequence[Behaviour], choose: Callable[[], int | None]) -> None:
        super().__init__(name, list(children))
        self.failure: SkillFailed | None = None
        self._choose = choose

    def tick(self) -> Iterator[Behaviour]:
        if self.status is not Status.RUNNING:
            _reset(self.children)
            self.failure = self.current_child = None
            try:
                number = self._choose()
                self.current_child = None if number is None else self.children[number]
            except SkillFailed as failure:
                self.failure = failure
        status = Status.SUCCESS if self.failure is None else Status.FAILURE
        if self.current_child is not None:
            self.current_child.tick_once()
            status = self.current_child.status
        _is_now(self, status)
        yield self


class Fallback(Selector):
    """A fallback that goes on to its next child only after a failure with one of `codes`, and fails with any other."""

    def __init__(self, children: Sequence[Behaviour], codes: frozenset[str]) -> None:
        super().__init__("fallback", memory=True, children=list(children))
        self._codes = codes

    def tick(self) -> Iterator[Behaviour]:
        if self.status is not Status.RUNNING:
            _reset(self.children)
            self.current_child = self.children[0]
        begin = self.children.index(self.current_child) if self.current_child is not None else 0
        for child in self.children[begin:]:
            self.current_child = child
            child.tick_once()
            if child.status is not Status.FAILURE or failure_of(child).code not in self._codes:
                break
        _is_now(self, child.status)
        yield self


def _is_now(node: Behaviour, status: Status) -> None:
    """Set the status after a tick. A node that has ended halts the children that it left running."""
    if status is Status.RUNNING:
        node.status = status
    else:
        node.stop(status)


def _reset(children: Sequence[Behaviour]) -> None:
    """Forget how the children ended the last time."""
    for child in children:
        if child.status is not Status.INVALID:
            child.stop(Status.INVALID)


class Timeout(_OnClock):
    """Halt the child and fail if it has not ended within `duration` of run time.

    Two times are not counted: while actions are held up (`Ticking.held_up_by`), and while a pause keeps the child from
    going on. The latter begins when nothing of the child is at work any more, even if something beside it is.
    """

    def __init__(self, path: str, child: Behaviour, arguments: Arguments, shared: Ticking) -> None:
        super().__init__("timeout", child, arguments, shared)
        self.path = path
        self._visits = 0
        self._duration_s = 0.0
        self._began_s = self._looked_s = 0.0
        """On a clock that stands still while actions are held up."""
        self._is_kept = False

    def begin(self) -> None:
        self._visits += 1
        self._duration_s = self._arguments()["duration"]
        self._began_s = self._looked_s = self._counted_s

    @property
    def _counted_s(self) -> float:
        return self._shared.cell.clock.now_s - self._shared.held_up_s

    def update(self) -> Status:
        if self.decorated.status is not Status.RUNNING:
            return self.decorated.status
        shared = self._shared
        decision = shared.replay.decision(self.path, self._visits)
        if decision is not None and is_stuck(self.decorated):
            return self._fail(decision.failure)
        self._leave_out_the_pause()
        deadline_s = self._began_s + shared.held_up_s + self._duration_s
        if shared.cell.clock.now_s >= deadline_s:
            failure = SkillFailed(Code.WORKFLOW_TIMEOUT, f"not done after {self._duration_s:g} s")
            status = self._fail(failure)
            shared.listener.decided(self.path, self._visits, Decision(failure))
            return status
        if self._is_kept or shared.held_up_by:
            shared.done(self)  # no wake: the deadline moves with the clock
        else:
            shared.wait(self, Wake(deadline_s))
        return Status.RUNNING

    def _leave_out_the_pause(self) -> None:
        now_s = self._counted_s
        if self._is_kept:
            self._began_s += now_s - self._looked_s
        self._looked_s = now_s
        self._is_kept = self._shared.is_pausing and self._shared.acting.isdisjoint(self.decorated.iterate())

    def _fail(self, failure: SkillFailed) -> Status:
        self.decorated.stop(Status.INVALID)
        self.failure = failure
        return Status.FAILURE


class WorkflowCall(_Begun):
    """A call of a workflow: its inputs are bound when it begins, its result is kept when it succeeds."""

    def __init__(self, name: str, child: Behaviour, bind: Callable[[], None], keep_result: Callable[[], None]) -> None:
        super().__init__(name, child)
        self._bind = bind
        self._keep_result = keep_result

    def begin(self) -> None:
        self._bind()

    def update(self) -> Status:
        if self.decorated.status is Status.SUCCESS:
            try:
                self._keep_result()
            except SkillFailed as failure:
                self.failure = failure
                return Status.FAILURE
        return self.decorated.status


def failure_of(node: Behaviour) -> SkillFailed:
    """Why a node failed: the failure of the leaf or node that decided it."""
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
        return SkillFailed(Code.WORKFLOW_INVERTED, f"{node.decorated.name} succeeded under 'invert'")
    return SkillFailed(Code.WORKFLOW_INVERTED, f"{node.name} failed")
