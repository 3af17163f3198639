"""The node `while`: conditions that are checked on every tick of the child that they guard."""

from collections.abc import Iterator, Sequence

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.composites import Sequence as SequenceNode

from scuhand_bt.cell.leased import leased
from scuhand_bt.clock import Wake
from scuhand_bt.skill import Condition, SkillFailed
from scuhand_bt.tree.leaf import Arguments, Ticking, bug_of, is_explained, is_stuck, made, unexplained
from scuhand_bt.tree.nodes import failure_of
from scuhand_bt.tree.replay import Decision


class Guard(Behaviour):
    """A condition in front of a `while`'s child."""

    def __init__(self, name: str, condition: type[Condition], arguments: Arguments, shared: Ticking) -> None:
        super().__init__(name)
        self.condition = condition
        self.failure: SkillFailed | None = None
        self._arguments = arguments
        self._cell = shared.cell

    def update(self) -> Status:
        self.failure = None
        try:
            made(self.name, self.condition, self._arguments()).check(leased(self._cell, self.condition.sees()))
        except SkillFailed as failure:
            if not is_explained(self.condition, failure):
                raise unexplained(self.name, failure) from failure
            self.failure = failure
            return Status.FAILURE
        except BaseException as error:
            raise bug_of(self.name, error) from error
        return Status.SUCCESS


class While(SequenceNode):
    """Guards, then the child; every tick checks the guards again. If a guard fails, the child is halted."""

    def __init__(self, path: str, guards: Sequence[Guard], child: Behaviour, shared: Ticking) -> None:
        super().__init__("while", memory=False, children=[*guards, child])
        self.failure: SkillFailed | None = None
        self.path = path
        self._visits = 0
        self._child = child
        self._devices = sorted({device for guard in guards for device in guard.condition.watches})
        self._shared = shared

    def initialise(self) -> None:
        self.failure = None
        self._visits += 1

    def tick(self) -> Iterator[Behaviour]:
        if self._shared.replay.is_replaying:
            yield from self._replay()
            return
        had_begun = self.status is Status.RUNNING and self._child.status is Status.RUNNING
        for node in super().tick():
            if node is self and self.status is Status.RUNNING:  # before `yield`, after which a parent may stop the tick
                self._shared.wait(self, *(Wake.on(self._shared.cell.device(name).news) for name in self._devices))
            if node is self and self.status is Status.FAILURE and self._child.status is not Status.FAILURE:
                decision = Decision(failure_of(self), had_begun)
                self._shared.listener.decided(self.path, self._visits, decision)
            yield node

    def _replay(self) -> Iterator[Behaviour]:
        """Replay: the guards held until the one that is recorded to have failed."""
        if self.status is not Status.RUNNING:
            self.initialise()
        decision = self._shared.replay.decision(self.path, self._visits)
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
