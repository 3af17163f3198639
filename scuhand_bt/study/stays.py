"""When persons come to a run: moments that need them soon after each other are one stay."""

from collections.abc import Iterator
from dataclasses import dataclass

from scuhand_bt.quantity import counted, format_duration, listed
from scuhand_bt.recipe.plan import Plan
from scuhand_bt.study.night import Night
from scuhand_bt.study.odds import Odds, Range

APART_S = 1800.0
"""Between two moments, from the beginning of the first: who is needed again so soon stays."""
START = Range(0.0, 0.0, 0.0)
"""It needs somebody, too."""


@dataclass(frozen=True)
class Stay:
    """Jobs that need a person, and when the first of them does at the earliest and the last one at the latest."""

    jobs: tuple[str, ...]
    from_s: float
    until_s: float


def stays(plan: Plan, odds: Odds) -> Iterator[Stay]:
    """The stays of persons in their order, the start's first; of moments that any trial has come to."""
    needed = {person.job for person in plan.persons}
    jobs, first, last = list[str](), START, START
    for job in plan.jobs:
        when = odds.person_s(job.name) if job.name in needed else None
        if when is None:
            continue
        if when.middle - last.middle > APART_S:
            yield Stay(tuple(jobs), first.low, last.high)
            jobs, first = [], when
        jobs.append(job.name)
        last = when
    yield Stay(tuple(jobs), first.low, last.high)


def unforeseen(plan: Plan, odds: Odds) -> list[str]:
    """The jobs that need no person by the plan, and in which dry runs asked one for something."""
    needed = {person.job for person in plan.persons}
    return [job for job in odds.asked_s if job not in needed]


def unforeseen_in_words(plan: Plan, odds: Odds) -> Iterator[str]:
    """Nothing where there is none."""
    if jobs := unforeseen(plan, odds):
        yield (
            f"In dry runs a person was also asked for something at {listed(jobs, 'job')}, which need not come: what "
            "to do with a sample that failed, say, or to fill the changer for one that is done once more."
        )


def stays_in_words(plan: Plan, odds: Odds, night: Night | None) -> Iterator[str]:
    """How often somebody comes, and when: after the start, or by the clock of a night. Nothing for who never does."""
    found = list(stays(plan, odds))
    if not any(stay.jobs for stay in found):
        return
    told = format_duration if night is None else night.clock
    times = list[str]()
    for stay in found:
        first, last = told(stay.from_s), told(stay.until_s)
        if not times:
            span = f"from the start until {last}"
        elif first != last:
            span = f"from {first} to {last}"
        else:
            span = first if night is None else f"at {first}"
        span += " after it" if night is None else ""
        times.append(f"{span} ({counted(len(stay.jobs), 'moment')})" if stay.jobs else "for the start")
    *before, end = times
    yield f"So a person comes {counted(len(times), 'time')}: {', '.join(before)}{', and ' if before else ''}{end}."
