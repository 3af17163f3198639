"""When persons come to a run: moments soon after each other are one stay (docs/unattended.md, "Who is needed")."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

from scuhand_bt.quantity import counted, format_duration, listed
from scuhand_bt.recipe.plan import Plan
from scuhand_bt.study.night import Night
from scuhand_bt.study.odds import Odds, Range

APART_S = 1800.0
"""Two moments closer than this belong to one stay [s]."""
START = Range(0.0, 0.0, 0.0)
"""The start of a run, which needs somebody, too."""


@dataclass(frozen=True)
class Stay:
    """Moments that need a person: their number, the earliest time of the first and the latest of the last."""

    moments: int
    from_s: float
    until_s: float


def stays(plan: Plan, odds: Odds) -> Iterator[Stay]:
    """The stays in order, the start's first. Moments that no trial has reached are left out."""
    moments, first, last = 0, START, START
    for _, when in odds.persons_s(plan):
        if when is None:
            continue
        if when.middle - last.middle > APART_S:
            yield Stay(moments, first.low, last.high)
            moments, first = 0, when
        moments += 1
        last = when
    yield Stay(moments, first.low, last.high)


def stopped_in_words(odds: Odds) -> Iterator[str]:
    """How many dry runs stopped before their end, and why the first did, as a sentence."""
    if odds.stopped:
        yield (
            f"Of {counted(odds.trials, 'dry run')} {len(odds.stopped)} stopped before the end, so the time above is "
            f"too short: a person then has to look at the cell, and to resume the run. The first: {odds.stopped[0]}"
        )


def unforeseen(plan: Plan, odds: Odds) -> list[str]:
    """The jobs that need no person by the plan, but in which dry runs asked for one."""
    needed = {person.job for person in plan.persons}
    return [job for job in odds.asked_s if job not in needed]


def unforeseen_in_words(plan: Plan, odds: Odds) -> Iterator[str]:
    """The same as a sentence; none if there are no such jobs."""
    if jobs := unforeseen(plan, odds):
        yield (
            f"In dry runs a person was also asked for something at {listed(jobs, 'job')}, which may not happen: for "
            "example what to do with a failed sample, or to fill the changer for one that is done once more."
        )


def _by(after_s: float) -> str:
    """A time by which something happens; rounded up to a minute if it is given without seconds."""
    return format_duration(after_s if after_s < 3600.0 else 60.0 * math.ceil(after_s / 60.0))


def stays_in_words(plan: Plan, odds: Odds, night: Night | None) -> Iterator[str]:
    """How often somebody comes, and when: after the start, or by the clock of a night. Nothing if nobody has to."""
    found = list(stays(plan, odds))
    if not any(stay.moments for stay in found):
        return
    told, by = (format_duration, _by) if night is None else (night.clock, night.by)
    times = list[str]()
    for stay in found:
        first, last = told(stay.from_s), by(stay.until_s)
        if not times:
            span = f"from the start until {last}"
        elif first != last:
            span = f"from {first} to {last}"
        else:
            span = first if night is None else f"at {first}"
        span += " after it" if night is None else ""
        times.append(f"{span} ({counted(stay.moments, 'moment')})" if stay.moments else "for the start")
    *before, end = times
    yield f"So a person comes {counted(len(times), 'time')}: {', '.join(before)}{', and ' if before else ''}{end}."
