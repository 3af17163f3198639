"""Who is told how a batch goes on: the live view, plain lines, and whoever else asks for it."""

from py_trees.behaviour import Behaviour

from scuhand_bt.journal.events import PersonSoon
from scuhand_bt.journal.results import SampleResult
from scuhand_bt.recipe.plan import Job
from scuhand_bt.tree.build import Tree


class BatchObserver:
    """Is told how the batch goes on, and shows nothing of it; the live view and plain lines do."""

    def tree_made(self, tree: Tree) -> None:
        """The tree of an attempt at a job, before its first tick."""

    def ticked(self, root: Behaviour) -> None:
        """The tree after a tick; must be quick."""

    def job_started(self, job: Job, number: int) -> None:
        """A job of the plan begins, or a sample's is taken up; its number is counted from 0."""

    def attempt_started(self, job: Job, attempt: int) -> None:
        """An attempt at a job, or at a recovery, begins or is taken up."""

    def person_called(self, soon: PersonSoon) -> None:
        """A person is going to be asked for something at the next job, and may come meanwhile."""

    def sample_ended(self, result: SampleResult) -> None:
        """A sample has its result, or another one than it had."""

    def sample_known(self, result: SampleResult) -> None:
        """A sample has had its result since before the run was resumed: as if it came now, unless told otherwise."""
        self.sample_ended(result)

    def paused(self) -> None:
        """The run stands still, as a person wished it."""

    def continued(self) -> None:
        """A person let it go on."""


class Observers(BatchObserver):
    """Several, each told in its turn."""

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
