"""Which samples of a plan are done during hours in which nobody comes."""

import math
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from datetime import datetime, timedelta

from scuhand_bt.lab import Lab
from scuhand_bt.problems import Mark, Problem, SourceError
from scuhand_bt.quantity import format_duration, listed
from scuhand_bt.recipe.order import ORDERS
from scuhand_bt.recipe.plan import Plan, make_plan
from scuhand_bt.study.odds import Odds

ONE_OF = 20
"""A sample counts as done if at most one run in so many would not have done it."""


@dataclass(frozen=True)
class Night:
    """From one time of day to another, on the same day or the next."""

    begins: datetime
    ends: datetime

    @property
    def lasts_s(self) -> float:
        return (self.ends - self.begins).total_seconds()

    def clock(self, after_s: float) -> str:
        """The time of day after so many seconds; with "(+N d)" if that is a day or more after the beginning."""
        at = self.begins + timedelta(seconds=after_s)
        days = (at.date() - self.begins.date()).days
        return f"{at:%H:%M}" + (f" (+{days} d)" if at >= self.begins + timedelta(days=1) else "")

    def by(self, done_s: float) -> str:
        """As `clock`, rounded up to a minute: for times by which something is done."""
        return self.clock(60.0 * math.ceil(done_s / 60.0))


@dataclass(frozen=True)
class Fate:
    """What becomes of a sample in the night."""

    sample: str
    done_s: float | None
    """By when it is done in 19 of 20 nights [s]; None if it is not counted."""
    why: str | None
    """Why it is not done within the night; None if it is."""


@dataclass(frozen=True)
class BetterOrder:
    """An order with which more samples are done in the night."""

    order: str
    samples: int
    """So many, by dry runs of this order."""


def read_night(text: str) -> Night:
    """Parse `20:00-08:00`. Raises SourceError for anything else, and if both times are equal."""
    found = re.fullmatch(r"\s*(\d{1,2}:\d\d)\s*[-–]\s*(\d{1,2}:\d\d)\s*", text)
    try:
        begins, ends = (datetime.strptime(part, "%H:%M") for part in found.groups()) if found else (None, None)
    except ValueError:
        begins = ends = None
    if begins is None or ends is None:
        raise SourceError([Problem(Mark("--night", 0), f"'{text}' is not a night; write hours such as 20:00-08:00")])
    if begins == ends:
        raise SourceError(
            [Problem(Mark("--night", 0), f"'{text}' ends when it begins; write hours such as 20:00-08:00")]
        )
    return Night(begins, ends if ends > begins else ends + timedelta(days=1))


def fates(plan: Plan, odds: Odds, night: Night) -> Iterator[Fate]:
    """Each sample in order: done in time, or why not. A moment that needs a person stops everything after it.

    No sample is done before an earlier one, however few trials there are.
    """
    needed: dict[str, list[str]] = {}
    for person in plan.persons:
        if person.job is not None:
            needed.setdefault(person.job, []).append(person.what)
    waits: str | None = None
    done_s = 0.0
    names = [job.name for job in plan.jobs]
    for job, following in zip(plan.jobs, [*names[1:], None], strict=True):
        if waits is None and job.name in needed:
            waits = f"a person is needed before, at '{job.name}': {'; '.join(needed[job.name])}"
        if job.sample is None:
            continue
        stopped, asked = odds.trials - odds.ended[job.name], odds.ended[job.name] - odds.alone[job.name]
        if waits is not None:
            yield Fate(job.name, None, waits)
        elif ONE_OF * stopped > odds.trials:
            of = "every dry run has" if stopped == odds.trials else f"{stopped} of {odds.trials} dry runs have"
            yield Fate(job.name, None, f"{of} stopped before its end")
        elif ONE_OF * (stopped + asked) > odds.trials:
            of = "every dry run" if asked == odds.trials else f"{asked} of {odds.trials} dry runs"
            yield Fate(job.name, None, f"in {of} a person was asked for something before its end")
        else:
            ended = odds.duration_s if following is None else odds.began_s[following]
            done_s = max(done_s, ended.high)
            yield Fate(job.name, done_s, "it may take longer" if done_s > night.lasts_s else None)


def likely_better(plan: Plan, lab: Lab, odds: Odds, night: Night) -> Plan | None:
    """The plan in the order with which most samples are done, by each plan's own forecast; None if that is this one."""
    slower = odds.duration_s.high / plan.duration_s if plan.duration_s > 0.0 else 1.0

    def done(made: Plan) -> int:
        needed, many = {person.job for person in made.persons}, 0
        for job in made.jobs:
            if job.name in needed or made.done_s[job.name] * slower > night.lasts_s:
                break
            many += job.sample is not None
        return many

    best = max((make_plan(replace(plan.recipe, order=order), lab) for order in ORDERS), key=done)
    return best if done(best) > done(plan) else None


def better_order(plan: Plan, lab: Lab, odds: Odds, night: Night, tried: Callable[[Plan], Odds]) -> BetterOrder | None:
    """The likely better order, if dry runs of it (`tried`) confirm that more samples are done."""
    done = [fate.why is None for fate in fates(plan, odds, night)]
    likely = None if all(done) else likely_better(plan, lab, odds, night)
    if likely is None:
        return None
    more = sum(fate.why is None for fate in fates(likely, tried(likely), night))
    return BetterOrder(likely.recipe.order, more) if more > sum(done) else None


def in_words(plan: Plan, lab: Lab, odds: Odds, night: Night, tried: Callable[[Plan], Odds]) -> Iterator[str]:
    """The night in sentences. `tried` makes as many dry runs of another order, if one may do more samples."""
    found = list(fates(plan, odds, night))
    fit = [fate for fate in found if fate.why is None]
    hours = f"from {night.clock(0.0)} to {night.clock(night.lasts_s)} ({format_duration(night.lasts_s)})"
    last = f", the last by {night.by(fit[-1].done_s or 0.0)}" if fit else ""
    rare = ""
    if fit and odds.trials < ONE_OF:
        rare = f" {odds.trials} dry runs may not show what stops one run in {ONE_OF}: use more `--trials`."
    yield f"In a night {hours} with nobody there: {len(fit)} of {len(found)} samples{last}.{rare}"
    reasons: dict[str, list[str]] = {}
    for fate in found:
        if fate.why is not None:
            reasons.setdefault(fate.why, []).append(fate.sample)
    for why, samples in reasons.items():
        yield f"Not {listed(samples, 'sample')}: {why}."
    if (better := better_order(plan, lab, odds, night, tried)) is not None:
        yield f"With `order: {better.order}` it would be {better.samples}, by the same number of dry runs."
