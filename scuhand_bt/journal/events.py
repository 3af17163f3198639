"""The engine's own kinds of entries: of jobs, their actions and what is asked.

Those of the whole run are in `run_events.py`, those of samples in `results.py`, those that skills write in
`scuhand_bt/events`, all of them in `kinds.py`.

Fields with a default are absent in journals of before they were written.
"""

from typing import ClassVar

from pydantic import Field, JsonValue

from scuhand_bt.events.entry import Event, Text, Values
from scuhand_bt.events.weighings import Weighing
from scuhand_bt.failures import SkillFailed
from scuhand_bt.journal.results import Chosen, SampleResult
from scuhand_bt.journal.run_events import (
    Broken,
    Continued,
    Ended,
    FaultRules,
    Matter,
    NotResumable,
    Paused,
    Resumed,
    RunBegun,
    Trouble,
)

# --- jobs


class JobStarted(Event):
    """A job of the plan begins."""

    KIND: ClassVar = "job_started"

    name: Text
    sample: Text | None
    attempt: int
    workflow: str


class JobResumed(Event):
    """A job that was interrupted is taken up again."""

    KIND: ClassVar = "job_resumed"


class JobEnded(Event):
    """A job has ended, or was interrupted."""

    KIND: ClassVar = "job_ended"

    outcome: str
    """done, failed, stopped (failed, and ended the run), interrupted or broken."""
    code: str | None = None
    """The failure's."""
    detail: Text | None = None

    @property
    def failure(self) -> SkillFailed | None:
        return SkillFailed(self.code, self.detail or "") if self.code else None


class TreeNode(Values):
    """A node of a workflow's tree."""

    depth: int
    """How far below the root it stands."""
    name: Text
    path: str = ""
    """Its place in the tree, as `action_started`, `decided`, `gave_up` and `rounds_done` have it; empty for what writes
    none."""


class WorkflowTree(Event):
    """What the tree of a workflow looks like, before the first job with it: for whoever shows the jobs."""

    KIND: ClassVar = "workflow_tree"

    workflow: str
    nodes: tuple[TreeNode, ...]
    """From the root down, each before what is below it."""


# --- actions


class ArmMoves(Event):
    """The arm begins a motion, or the sheet does while the arm stands: for whoever shows it."""

    KIND: ClassVar = "arm_moves"

    step_s: float
    """Time between two of the rows."""
    joints_rad: tuple[tuple[float, ...], ...]
    """Where the seven joints are, from the motion's beginning to its end; one row for an arm that stands."""
    cone_mm: float
    """The diameter of the cone's rim at its beginning."""
    rims_mm: tuple[float, ...] = ()
    """And in such rows, where it changes."""

    @property
    def duration_s(self) -> float:
        """How long the arm moves."""
        return self.step_s * (len(self.joints_rad) - 1)


class ActionStarted(Event):
    """A skill is about to act."""

    KIND: ClassVar = "action_started"

    path: str
    """Its place in the job's tree."""
    visit: int
    """How often the tree has come to this place, this time included."""
    skill: str
    inputs: dict[str, JsonValue]
    """Its parameters; things of the lab by their names."""
    units: dict[str, str] = Field(default_factory=dict)
    """Of those that are quantities."""


class ActionEnded(Event):
    """A skill has ended, or was halted."""

    KIND: ClassVar = "action_ended"

    outcome: str
    """done, failed, halted (by its tree), interrupted (by the run) or broken."""
    code: str | None
    """The failure's."""
    result: JsonValue
    """What it gave; of a failure its `detail`."""

    @property
    def failure(self) -> SkillFailed | None:
        """None for any other outcome than `failed`."""
        if self.outcome != "failed":
            return None
        return SkillFailed(self.code or "", str(self.result["detail"]) if isinstance(self.result, dict) else "")


class Frames(Event):
    """Lines of the balance, as they came while a skill with hand and balance was at work.

    They are in the entry's own column, compressed: zlib of a JSON list of [time_s, raw, value_mg, unit, stable].
    At most the last half second is lost with the power.
    """

    KIND: ClassVar = "frames"

    readings: int
    """How many lines."""


class GaveUp(Event):
    """A `retry` has failed with what is below it, and does not begin that again: for whoever shows the tree."""

    KIND: ClassVar = "gave_up"

    path: str


class RoundsDone(Event):
    """A `repeat` or `for_each` has done all its rounds, and begins none any more: for whoever shows the tree."""

    KIND: ClassVar = "rounds_done"

    path: str


class Decided(Event):
    """A node of the tree that is no skill has failed on its own account: a timeout, a `while`."""

    KIND: ClassVar = "decided"

    path: str
    visit: int
    code: str
    detail: Text
    had_begun: bool
    """Whether its child had begun."""

    @property
    def failure(self) -> SkillFailed:
        return SkillFailed(self.code, self.detail)


# --- taking up what was interrupted


class ArmMoved(Event):
    """The arm does not stand where it stood before the interruption, and is moved back."""

    KIND: ClassVar = "arm_moved"

    moved_rad: float
    """The farthest any joint has moved."""


class PanCompared(Event, Weighing):
    """The pan was weighed after an interruption in which nothing can have been dosed."""

    KIND: ClassVar = "pan_compared"

    before_mg: float
    """Its gross before."""


class ContainerReweighed(Event):
    """A resumed run has weighed the container that was on the pan about the bare pan, whatever the zero is by now."""

    KIND: ClassVar = "container_reweighed"

    container: Text
    before: Weighing
    """The pan as it was found."""
    bare: Weighing
    loaded: Weighing
    """The container put back."""
    held_mg: float
    """What it holds, by what it weighed empty."""
    uncertainty_mg: float
    least_mg: float
    most_mg: float
    """What it can hold: what it held, and what the cone can have lost."""
    counts: bool
    """False: it was given up, and its sample fails."""


class Settled(Event):
    """An action that had begun and not ended begins again, as its skill declares."""

    KIND: ClassVar = "settled"

    skill: str
    by: str
    """repeat or reweigh."""


# --- the person at the cell


class PersonSoon(Event):
    """A person is going to be asked for something at the next job, and may come meanwhile."""

    KIND: ClassVar = "person_soon"

    job: Text
    """That job's name."""
    what: Text

    def __str__(self) -> str:
        return f"a person is needed soon, at '{self.job}': {self.what}"


class Asked(Event):
    """A person is asked."""

    KIND: ClassVar = "asked"

    question: Text
    choices: list[str]


class Answered(Event):
    """A person has answered."""

    KIND: ClassVar = "answered"

    question: Text
    answer: str
    by: Text | None = None
    """Who; None for a simulated person."""
    signed: bool = False
    """With this person's PIN."""


ENGINE_EVENTS: tuple[type[Event], ...] = (
    RunBegun,
    Resumed,
    Paused,
    Continued,
    Ended,
    NotResumable,
    Matter,
    FaultRules,
    Trouble,
    Broken,
    JobStarted,
    JobResumed,
    JobEnded,
    SampleResult,
    Chosen,
    WorkflowTree,
    ArmMoves,
    ActionStarted,
    ActionEnded,
    Frames,
    Decided,
    GaveUp,
    RoundsDone,
    ArmMoved,
    PanCompared,
    ContainerReweighed,
    Settled,
    PersonSoon,
    Asked,
    Answered,
)
"""All that the engine writes."""
