"""Observers of a batch: the live view, plain lines, and others."""

from py_trees.behaviour import Behaviour

from scuhand_bt.journal.events import PersonSoon
from scuhand_bt.journal.results import SampleResult
from scuhand_bt.recipe.plan import Job
from scuhand_bt.tree.build import Tree


class BatchObserver:
    """Receives the progress of the batch, and ignores it; subclasses show it."""

    def tree_made(self, tree: Tree) -> None:
        """The tree of an attempt at a job was made, before its first tick."""

    def ticked(self, root: Behaviour) -> None:
        """The tree was ticked; must be quick."""

    def job_started(self, job: Job, number: int) -> None:
        """A job of the plan begins, or a sample's job is resumed; `number` counts from 0."""

    def attempt_started(self, job: Job, attempt: int) -> None:
        """An attempt at a job or a recovery begins or is resumed."""

    def person_called(self, soon: PersonSoon) -> None:
        """A person will be asked for something at the next job, and may come meanwhile."""

    def sample_ended(self, result: SampleResult) -> None:
        """A sample has a result, or a changed one."""

    def sample_known(self, result: SampleResult) -> None:
        """A sample already had its result before the run was resumed. By default treated as if it came now."""
        self.sample_ended(result)

    def paused(self) -> None:
        """The run is paused by a person."""

    def continued(self) -> None:
        """A person has continued it."""


class Observers(BatchObserver):
    """Passes everything on to several observers in turn."""

    def __init__(self, *observers: BatchObserver) -> None:
        self._each = observers

    def tree_made(self, tree: Tree) -> None:
        for one in self._each:
            one.tree_made(tree)

    def ticked(self, root: Behaviour) -> None:
        for one in self._each:
            one.ticked(root)

    def job_started(self, job: Job, number: int) -> None:
        for one in self._each:
            one.job_started(job, number)

    def attempt_started(self, job: Job, attempt: int) -> None:
        for one in self._each:
            one.attempt_started(job, attempt)

    def person_called(self, soon: PersonSoon) -> None:
        for one in self._each:
            one.person_called(soon)

    def sample_ended(self, result: SampleResult) -> None:
        for one in self._each:
            one.sample_ended(result)

    def sample_known(self, result: SampleResult) -> None:
        for one in self._each:
            one.sample_known(result)

    def paused(self) -> None:
        for one in self._each:
            one.paused()

    def continued(self) -> None:
        for one in self._each:
            one.continued()
