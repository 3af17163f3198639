"""When persons come to a run: moments that need them soon after each other are one stay."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from scuhand_bt.quantity import counted, format_duration
from scuhand_bt.recipe.plan import Plan
from scuhand_bt.study.night import Night
from scuhand_bt.study.odds import Odds, Range

APART_S = 1800.0
"""Between two moments, from the beginning of the first: who is needed again so soon stays."""


@dataclass(frozen=True)
class Stay:
    """Jobs that need a person, and when the first of them does at the earliest and the last one at the latest."""

    jobs: tuple[str, ...]
    from_s: float
    until_s: float


def stays(plan: Plan, odds: Odds) -> Iterator[Stay]:
    """The stays of persons after the start, in their order; of moments that any trial has come to."""
    needed = {person.job for person in plan.persons}
    now: list[tuple[str, Range]] = []
    for job in plan.jobs:
        when = odds.person_s(job.name) if job.name in needed else None
        if when is None:
            continue
        if now and when.middle - now[-1][1].middle > APART_S:
            yield _stay(now)
            now = []
        now.append((job.name, when))
    if now:
        yield _stay(now)


def _stay(moments: Sequence[tuple[str, Range]]) -> Stay:
    return Stay(tuple(job for job, _ in moments), moments[0][1].low, moments[-1][1].high)


def stays_in_words(plan: Plan, odds: Odds, night: Night | None) -> Iterator[str]:
    """How often somebody comes, and when: after the start, or by the clock of a night. Nothing for who never does."""
    found = list(stays(plan, odds))
    if not found:
        return
    goes_between = found[0].from_s > APART_S
    times = ["for the start"] if goes_between else []
    for stay in found:
        told = format_duration if night is None else night.clock
        first, last = "the start" if not times else told(stay.from_s), told(stay.until_s)
        at = "at " if night is not None else ""
        span = f"from {first} {'to' if times else 'until'} {last}" if first != last else f"{at}{first}"
        span += " after it" if night is None else ""
        times.append(f"{span} ({counted(len(stay.jobs), 'moment')})")
    *before, end = times
    yield f"So a person comes {counted(len(times), 'time')}: {', '.join(before)}{', and ' if before else ''}{end}."
