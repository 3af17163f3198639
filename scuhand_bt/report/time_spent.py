"""Where a run's time went: what every moment of each job was spent on, by its journal.

A moment counts once. Where several things go on at once, the one that stands last in `Activity` is what it was spent
on: who waits for a person waits, whatever skill asked; an open valve doses, whatever else the skill does.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, get_args

from scuhand_bt.events.cell import Discarded, Returned, Scooped, SheetSwapped, ValveChecked
from scuhand_bt.events.doses import DoseCurve
from scuhand_bt.events.entry import SkillEvent
from scuhand_bt.events.weighings import (
    BalanceWatched,
    BracketClosed,
    ContainerAgain,
    ContainerLifted,
    ContainerPlaced,
    DoseBegun,
    DoseWeighed,
    Reweighed,
    Tared,
    WeightChecked,
)
from scuhand_bt.journal.events import Answered, ArmMoves, Asked
from scuhand_bt.journal.reader import Contents
from scuhand_bt.journal.run_events import Continued, Ended, Paused, Resumed

Activity = Literal[
    "other",
    "moving",
    "emptying the cone",
    "scooping",
    "changing containers",
    "changing the sheet",
    "settling and weighing",
    "dosing",
    "waiting for persons",
    "paused",
]
ACTIVITIES: tuple[Activity, ...] = get_args(Activity)
_TOLD_BY: Mapping[Activity, tuple[type[SkillEvent], ...]] = {
    "emptying the cone": (Returned, Discarded),
    "scooping": (Scooped,),
    "changing containers": (ContainerPlaced, ContainerAgain, ContainerLifted, BracketClosed),
    "changing the sheet": (SheetSwapped, ValveChecked),
    "settling and weighing": (Tared, DoseBegun, DoseWeighed, Reweighed, WeightChecked, BalanceWatched),
}
"""What an action was, by what it wrote, whichever skill of whichever lab; of several, the last here. A dose settles
wherever its valve is shut. What has written none of these, and moved the arm, moved; all else is `other`."""
_OF_KINDS = {event.KIND: activity for activity, events in _TOLD_BY.items() for event in events}


@dataclass(frozen=True)
class Span:
    """Something went on from here to there, in run time."""

    began_s: float
    ended_s: float
    activity: Activity


@dataclass(frozen=True)
class JobTime:
    """One attempt at a job, and how long each activity took of it."""

    name: str
    sample: str | None
    attempt: int
    began_s: float
    ended_s: float
    spent_s: Mapping[Activity, float]

    @property
    def duration_s(self) -> float:
        return self.ended_s - self.began_s


@dataclass(frozen=True)
class TimeSpent:
    """The jobs in their order, and the whole run: `total_s` adds up to the time of its last entry."""

    jobs: Sequence[JobTime]
    total_s: Mapping[Activity, float]


def time_spent(contents: Contents) -> TimeSpent:
    """What each job of a run, and all of it, was spent on. A job or action without an end lasts to the last entry."""
    last_s = max((row["time_s"] for row in contents.each("entry")), default=0.0)
    spans = sorted(_spans(contents, last_s), key=lambda span: span.began_s)
    jobs = []
    next_span = 0
    for row in contents.rows("job"):
        began_s, ended_s = row["started_s"], last_s if row["ended_s"] is None else row["ended_s"]
        while next_span < len(spans) and spans[next_span].ended_s <= began_s:
            next_span += 1
        within = []
        for span in spans[next_span:]:
            if span.began_s >= ended_s:
                break
            within.append(span)
        jobs.append(
            JobTime(row["name"], row["sample"], row["attempt"], began_s, ended_s, _split(began_s, ended_s, within))
        )
    return TimeSpent(jobs, _split(0.0, last_s, spans))


def _spans(contents: Contents, last_s: float) -> Iterator[Span]:
    was: dict[int, Activity] = {}
    for row in contents.each("event"):
        if (activity := _OF_KINDS.get(row["kind"])) is not None and row["action"] is not None:
            was[row["action"]] = max(activity, was.get(row["action"], activity), key=ACTIVITIES.index)
        elif row["kind"] == ArmMoves.KIND:
            move = ArmMoves.model_validate(row["payload"])
            yield Span(row["time_s"], row["time_s"] + move.duration_s, "moving")
    for row in contents.each("action"):
        ended_s = last_s if row["ended_s"] is None else row["ended_s"]
        yield Span(row["started_s"], ended_s, was.get(row["id"], "other"))
    asked_s: float | None = None
    paused_s: float | None = None
    courses: dict[int | None, list[Sequence[float]]] = {}
    for row in contents.each("event"):
        kind, now_s = row["kind"], row["time_s"]
        if kind == DoseCurve.KIND:
            courses.setdefault(row["action"], []).extend(row["payload"]["points"])
        if asked_s is not None and kind in (Answered.KIND, Asked.KIND, Resumed.KIND, Ended.KIND):
            yield Span(asked_s, now_s, "waiting for persons")
            asked_s = None
        if paused_s is not None and kind in (Continued.KIND, Resumed.KIND, Ended.KIND):
            yield Span(paused_s, now_s, "paused")
            paused_s = None
        if kind == Asked.KIND:
            asked_s = now_s
        elif kind == Paused.KIND:
            paused_s = now_s
    for points in courses.values():
        yield from _open_valve(points)
    if asked_s is not None:
        yield Span(asked_s, last_s, "waiting for persons")
    if paused_s is not None:
        yield Span(paused_s, last_s, "paused")


def _open_valve(points: Sequence[Sequence[float]]) -> Iterator[Span]:
    """While the valve was open or vibrated, by the course of a dose."""
    for (began_s, _, opening_mm, vibration, *_), (ended_s, *_) in pairwise(points):
        if opening_mm > 0.0 or vibration > 0.0:
            yield Span(began_s, ended_s, "dosing")


def _split(began_s: float, ended_s: float, spans: Iterable[Span]) -> dict[Activity, float]:
    """How long each activity took of a time, each moment counted for the last in order of those that go on in it."""
    edges: list[tuple[float, int, Activity]] = []
    for span in spans:
        first_s, last_s = max(span.began_s, began_s), min(span.ended_s, ended_s)
        if first_s < last_s:
            edges += [(first_s, 1, span.activity), (last_s, -1, span.activity)]
    spent_s = dict.fromkeys(ACTIVITIES, 0.0)
    going_on = dict.fromkeys(ACTIVITIES, 0)
    now_s = began_s
    for at_s, change, activity in [*sorted(edges), (ended_s, 0, "other")]:
        at_work: Activity = next((one for one in reversed(ACTIVITIES) if going_on[one]), "other")
        spent_s[at_work] += at_s - now_s
        going_on[activity] += change
        now_s = at_s
    return spent_s
