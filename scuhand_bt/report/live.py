"""What a person sees while a batch runs in this terminal: plain lines, or a picture that stays; and its last words."""

from collections.abc import Callable, Iterator
from types import TracebackType

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.composites import Selector
from rich.console import Console
from rich.live import Live

from scuhand_bt.cell.cell import Cell
from scuhand_bt.journal.events import PersonSoon
from scuhand_bt.journal.follow import Follower
from scuhand_bt.journal.pace import pace
from scuhand_bt.journal.plain import plain_values
from scuhand_bt.journal.results import SampleResult
from scuhand_bt.journal.standing import Standing
from scuhand_bt.quantity import format_duration, format_mass
from scuhand_bt.recipe.plan import Job, Plan
from scuhand_bt.report.live_terminal import LiveTerminal
from scuhand_bt.report.picture import Asked, Node, Picture, Shown, in_grams, in_words
from scuhand_bt.report.watching import asked_of
from scuhand_bt.run.control import Control
from scuhand_bt.run.observers import BatchObserver
from scuhand_bt.run.outcome import BatchResult
from scuhand_bt.run.questions import Question
from scuhand_bt.tree.leaf import SkillLeaf
from scuhand_bt.tree.nodes import failure_of

REFRESHES_PER_S = 8
KEYS = "Ctrl-Z pauses, Ctrl-\\ stops after this sample, Ctrl-C stops now"
_STATES = {
    Status.SUCCESS: "done",
    Status.FAILURE: "failed",
    Status.RUNNING: "running",
    Status.INVALID: "to come",
}


class PlainLines(BatchObserver):
    """The batch as plain lines, for a log: one for every sample that ends, with `each_action` for every action too."""

    def __init__(self, write: Callable[[str], None], total: int | None = None, *, each_action: bool = False) -> None:
        self._write = write
        self._total = total
        self._each_action = each_action
        self._ended: dict[str, SampleResult] = {}
        """Samples that have ended, and what each was told to have come to."""
        self._before: dict[SkillLeaf, Status] = {}

    def ticked(self, root: Behaviour) -> None:
        if not self._each_action:
            return
        now = {node: node.status for node in root.iterate() if isinstance(node, SkillLeaf)}
        for leaf, status in now.items():
            if status is not self._before.get(leaf, Status.INVALID) and status is not Status.INVALID:
                why = f": {failure_of(leaf)}" if status is Status.FAILURE else ""
                self._write(f"  {leaf.name} {_STATES[status]}{why}")
        self._before = now

    def job_started(self, job: Job, number: int) -> None:
        if job.sample is None or self._each_action:
            self._write(f"{job.name}")

    def person_called(self, soon: PersonSoon) -> None:
        self._write(str(soon))

    def sample_ended(self, result: SampleResult) -> None:
        words, before = in_words(result), self._ended.get(result.id)
        if result.verdict == "not run":
            return
        if before is not None and before.attempt == result.attempt:
            is_as_good = before.is_good and result.is_good
            if is_as_good or words == in_words(before):
                return
        self._ended[result.id] = result
        of = f"/{self._total}" if self._total is not None else ""
        self._write(f"[{len(self._ended)}{of}] {result.id}: {words}")

    def sample_known(self, result: SampleResult) -> None:
        self._ended[result.id] = result


class LiveView(BatchObserver):
    """A picture that stays: the current job's tree, progress and time left, the balance, questions, the newest doses.

    It is drawn on a thread of its own, so that it also tells of a run that is paused. Of one that is resumed `before`
    has what it had come to: when its samples were judged, and how long it had stood still.
    """

    def __init__(
        self, console: Console, cell: Cell, plan: Plan, control: Control, mode: str, before: Follower | None = None
    ) -> None:
        self._cell = cell
        self._control = control
        self._plan = plan
        self._mode = mode
        self._results: dict[str, SampleResult] = {}
        self._told_s: dict[str, tuple[float, float]] = {}
        """Run time at which each was judged first, and how much of that the run had stood still."""
        self._standing = Standing()
        if before is not None:
            self._results = {name: one for name, one in before.samples.items() if one.was_tried}
            self._told_s = {name: before.told_s[name] for name in self._results}
            self._standing = before.standing
            self._standing.continued(cell.clock.now_s)
            self._standing.answered(cell.clock.now_s)
        self._asked: Question | None = None
        self._job: tuple[Job, int] | None = None
        self._root: Behaviour | None = None
        self._live = Live(
            console=console,
            get_renderable=lambda: Picture(self.shown()),
            refresh_per_second=REFRESHES_PER_S,
            screen=True,
        )

    def __enter__(self) -> "LiveView":
        self._live.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._live.__exit__(kind, error, traceback)

    def ticked(self, root: Behaviour) -> None:
        self._root = root

    def attempt_started(self, job: Job, attempt: int) -> None:
        self._job = job, attempt

    def sample_ended(self, result: SampleResult) -> None:
        before = self._results.pop(result.id, None)  # the newest last
        self._results[result.id] = result
        if result.was_tried and (before is None or before.attempt != result.attempt):
            now_s = self._cell.clock.now_s
            self._told_s[result.id] = now_s, self._standing.until(now_s)

    def paused(self) -> None:
        self._standing.paused(self._cell.clock.now_s)

    def continued(self) -> None:
        self._standing.continued(self._cell.clock.now_s)

    def shown(self) -> Shown:
        """What there is to see now."""
        asked, terminal = self._control.questions.waiting, self._control.terminal
        self._note(asked)
        here = terminal if isinstance(terminal, LiveTerminal) else None
        results = list(self._results.values())
        return Shown(
            recipe=self._plan.recipe.name,
            mode=self._mode,
            total=len(self._plan.recipe.samples),
            results=results,
            run_time_s=self._cell.clock.now_s,
            left_s=self._time_left_s(),
            job=_about(*self._job) if self._job is not None else "",
            tree=list(nodes_of(self._root)) if self._root is not None else [],
            readings=self._readings(),
            soon=self._soon(),
            state=self._state(),
            keys=KEYS,
            question=Asked(asked.text, asked.choices, asked.at) if asked is not None else None,
            typed=here.typed if here is not None else None,
            note=here.note if here is not None else "",
        )

    def _note(self, asked: Question | None) -> None:
        """A question is seen to wait, or none is."""
        if asked is not self._asked:
            self._standing.answered(self._cell.clock.now_s)
            self._asked = asked
        if asked is not None:
            self._standing.asked(self._cell.clock.now_s)

    def _readings(self) -> str:
        reading, empty_mg = self._cell.balance.latest, self._cell.believed.pan_empty_mg
        said = "balance: no reading"
        if reading is not None:
            said = in_grams(reading.value_mg, is_stable=reading.stable)
            said += f", net {format_mass(reading.value_mg - empty_mg)}" if empty_mg is not None else ""
        return f"{said}; valve {self._cell.hand.opening_mm:.2f} mm"

    def _soon(self) -> str:
        """What a person is going to be asked for at the next job."""
        person = self._plan.soon(self._job[0]) if self._job is not None else None
        return str(PersonSoon(job=person.job or "", what=person.what)) if person is not None else ""

    def _state(self) -> str:
        """What was asked of the run."""
        control = self._control
        if control.is_stopping:
            return "Stopping now" if control.halts else "Stopping after this sample; Ctrl-C stops now"
        return "Paused: no further action begins; Ctrl-Z continues" if control.is_pausing else ""

    def _time_left_s(self) -> float:
        """Of the whole plan; while the run stands still none of it goes by."""
        now_s = self._cell.clock.now_s
        under_way = self._job[0].name if self._job is not None else None
        told_s = dict(self._told_s)  # a copy: the run goes on
        all_s = self._plan.duration_s
        keeps = pace(self._plan.done_s, told_s, self._standing.until(now_s), under_way, now_s, all_s)
        return max(0.0, keeps.ends_s(all_s) - now_s)


def nodes_of(root: Behaviour, depth: int = 0, passed: str = "to come") -> Iterator[Node]:
    """A tree's nodes, each below the one that it belongs to; `passed`: the state of one that has none of its own."""
    state = passed if root.status is Status.INVALID else _STATES[root.status]
    why = str(failure_of(root)) if state == "failed" and not root.children else ""
    yield Node(depth, root.name, state, why)
    passed = "to come" if state in ("running", "to come") else "skipped"
    # A fallback comes to a child when those before it have failed; py_trees then clears their states.
    tried = root.children.index(root.current_child) if isinstance(root, Selector) and root.current_child else 0
    for number, child in enumerate(root.children):
        yield from nodes_of(child, depth + 1, "failed" if number < tried and state != "to come" else passed)


def _about(job: Job, attempt: int) -> str:
    """What is under way: a sample with what it asks for, or a job between samples."""
    again = f", attempt {attempt}" if attempt > 1 else ""
    sample = job.sample
    if sample is not None and sample.composition is not None:
        parts = " and ".join(f"{format_mass(one.target_mg)} of {one.formula}" for one in sample.composition.powders)
        return f"{job.name}{again}: {sample.composition.product} of {parts}"
    asked = list(asked_of(plain_values(sample.inputs))) if sample is not None else []
    if sample is None or not any(mass for mass, _ in asked):
        return f"{job.name}{again}"
    powders = {source.name: f" of {source.powder.name}" for source in sample.sources}
    # Of several powders a mass alone may be that of one: which one is its workflow's to say.
    whole = next(iter(powders.values())) if len(powders) == 1 else ""
    doses = " + ".join(f"{mass}{powders.get(source, '') if len(asked) > 1 else whole}" for mass, source in asked)
    into = f" into {sample.container.name}" if sample.container is not None else ""
    return f"{job.name}{again}: {doses}{into}"


def end_line(result: BatchResult, seconds: float) -> str:
    """One sentence about the whole run."""
    good = sum(1 for sample in result.samples if sample.is_good)
    line = f"{good} of {len(result.samples)} samples good; {format_duration(result.duration_s)} of run time"
    line += f", computed in {seconds:.1f} s"
    return f"{line}. Ended early: {result.reason}" if result.reason else f"{line}."
