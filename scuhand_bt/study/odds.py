"""What to expect of a run, estimated from trials: duration, results of samples, scoops and powder.

Each trial has its own cell (`some_cell`). The method, and how well it predicts, are in docs/study.md, "How the figures
are formed" and "Evidence". A duration's interval is that of one more run: normal in its logarithm, widened by
`MODEL_SHARE`. As the cells of successive seeds are evenly spread, few trials estimate the spread nearly as well as
many, and Student's t would be too wide. A mass's interval is Student's t for the mass itself, widened by
`MODEL_MASS_SHARE`. `benchmarks.forecasts` compares the predictions with runs on plants that no trial has had.
"""

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import betaincinv, betaln, stdtrit  # not `stats`, which takes half a second

from scuhand_bt.dosing.verdict import LIKELY
from scuhand_bt.exit_codes import ExitCode
from scuhand_bt.quantity import format_below
from scuhand_bt.recipe.plan import PersonNeeded, Plan
from scuhand_bt.recipe.sample import Sample
from scuhand_bt.study.trial import LEFTOVERS, Trial

RECKONED = (
    "Leftovers are what each run estimates, by what its scoops should bring: no interval says how far that is off. "
    "The powder used is the simulation's own figure."
)
"""How `Odds.leftovers_mg` and `Odds.used_mg` are obtained, for people who read them side by side."""
CELLS = (
    "Each dry run has a cell of its own: its powders flow at half to twice what the lab's files say, its scoops bring "
    "three quarters to five quarters of what they should, and its balance is a third to four times as slow."
)
"""Why the intervals are so wide, for people who read them."""
COVERED = 0.9
"""Coverage of the intervals."""
MODEL_SHARE = 0.05
"""Additional relative standard deviation of a time, for what persons, carousels and arms differ by."""
MODEL_MASS_SHARE = 0.005
"""The same for a mass. Evidence: 48 sources in 24 recipes, on plants that share no physics with the trials'. With
eight trials, 16 lay some milligrams outside the plain Student's t interval, and 4 outside this one."""
FEWEST = 3
"""Fewer trials give no interval."""
WIDE = 1.645
"""Half-width of an interval that contains `COVERED` of a normal distribution [standard deviations]."""
BATCH_COUNTS = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0)
"""How many trials of a sample's own kind the whole batch may count as; equally likely a priori."""
RATES = 64
"""Number of grid points for the batch's success rate."""


@dataclass(frozen=True)
class Range:
    """A median and an interval; of fewer than `FEWEST` dry runs, the least and the greatest value."""

    low: float
    middle: float
    high: float

    def no_earlier_than(self, other: "Range") -> "Range":
        """All three values raised to at least the other's."""
        return Range(max(self.low, other.low), max(self.middle, other.middle), max(self.high, other.high))


@dataclass(frozen=True)
class Chance:
    """The probability that a sample is in tolerance, with an interval, estimated from all trials."""

    probability: float
    low: float
    high: float
    tried: int
    """Number of trials of samples like it."""
    good: int
    """How many of these were good."""

    @property
    def is_unlikely(self) -> bool:
        """Whether to warn of it. Having few trials is no reason to warn."""
        return self.probability < LIKELY and self.good < self.tried

    @property
    def told(self) -> str:
        """The probability and its interval, as text."""
        middle = format_below(self.probability, LIKELY) if self.is_unlikely else f"{self.probability:.0%}"
        return f"{middle} ({self.low:.0%} to {self.high:.0%})"


@dataclass(frozen=True)
class Odds:
    """The estimates from a plan's trials."""

    trials: int
    duration_s: Range
    began_s: Mapping[str, Range]
    """When each job begins, by its name, if any trial has begun it. Never earlier than the job before it, however few
    trials have come so far."""
    asked_s: Mapping[str, Range]
    """When a person is first asked for something in a job, by its name, if any trial has asked."""
    moments_s: Mapping[str, Sequence[Range]]
    """When each moment of the plan that needs a person is, by the job's name, likewise: from the first to the last
    request that belongs to it, such as taking a container off the pan and putting another one there."""
    ended: Mapping[str, int]
    """How many trials have come to the end of each job."""
    alone: Mapping[str, int]
    """In how many of these nobody was asked for anything until then."""
    stopped: Sequence[str]
    """For each trial that stopped before its end: why."""
    samples: Mapping[str, Chance]
    """For every sample that any trial had."""
    asked: float
    """Mean number of samples of a run; trials may differ in it by what is varied."""
    good: float
    """Expected number of samples in tolerance."""
    scoops: Mapping[str, Range]
    """By source."""
    used_mg: Mapping[str, Range]
    leftovers_mg: Mapping[str, Mapping[str, Range]]
    """Powder left in the cone after doses, by source and by what became of it (the same keys for each source). This is
    the range that the trials had, as such figures have no symmetric distribution."""
    codes: Mapping[str, float]
    """Mean number of samples of a run that fail with a code, the most frequent first."""
    verdicts: Mapping[str, float]
    """Mean number of samples that are not good without a failure, by verdict; `in tolerance` means unconfirmed."""

    def persons_s(self, plan: Plan) -> Iterator[tuple[PersonNeeded, Range | None]]:
        """Every moment of the plan that needs a person, and when it is; None if no trial knows.

        If no trial has asked in that job, it is when the job begins. No moment is earlier than the one before it.
        """
        before = Counter[str]()
        last = Range(0.0, 0.0, 0.0)
        for person in plan.persons:
            job = person.job or ""
            moments = self.moments_s.get(job)
            found = moments[before[job]] if moments is not None else self.began_s.get(job)
            before[job] += 1
            if found is not None:
                last = found = found.no_earlier_than(last)
            yield person, found

    @property
    def tells_intervals(self) -> bool:
        """Whether ranges are intervals with coverage `COVERED`, and not just the extremes of very few trials."""
        return self.trials >= FEWEST

    @property
    def left(self) -> list[str]:
        """What became of powder left in the cone: the kinds that occur."""
        by_source = self.leftovers_mg.values()
        return [kind for kind in next(iter(by_source), {}) if any(mg[kind].high > 0.0 for mg in by_source)]

    @property
    def not_good(self) -> dict[str, float]:
        """Mean number of samples of a run that are not good, by a text for people: first `codes`, then `verdicts`."""
        words = {"in tolerance": "verdict 'in tolerance', not confirmed"}
        told = {words.get(one, f"verdict '{one}', no failure"): many for one, many in self.verdicts.items()}
        return {**self.codes, **told}

    @property
    def unlikely(self) -> list[str]:
        """The samples to warn of."""
        return [name for name, chance in self.samples.items() if chance.is_unlikely]


def odds_of(plan: Plan, found: Sequence[Trial], *, as_written: bool = True) -> Odds:
    """Estimate from at least one trial of a plan. `as_written`: every sample asks for the same in all trials."""
    vessels = sorted({kind for trial in found for mg in trial.leftovers_mg.values() for kind in mg} - {*LEFTOVERS})
    first_asked_s = [min((one[0][0] for one in trial.asked_s.values()), default=math.inf) for trial in found]
    moments = Counter(person.job for person in plan.persons if person.job is not None)
    asked_s = {job: [trial.asked_s[job] for trial in found if job in trial.asked_s] for job in moments}
    bad = [one for trial in found for one in trial.samples if not one.good]
    codes = Counter(one.code for one in bad if one.code is not None)
    verdicts = Counter(one.verdict for one in bad if one.code is None)
    ends_s = [_ends_s(trial) for trial in found]
    samples = _chances(plan, found, as_written=as_written)
    asked = [one.id for trial in found for one in trial.samples]
    return Odds(
        trials=len(found),
        duration_s=_of_times([trial.duration_s for trial in found]),
        began_s=_in_turn(_of_jobs(plan, [trial.began_s for trial in found])),
        asked_s=_of_jobs(plan, [{job: of[0][0] for job, of in trial.asked_s.items()} for trial in found]),
        moments_s={job: _moments(moments[job], of_trials) for job, of_trials in asked_s.items() if of_trials},
        ended={job.name: sum(job.name in of_s for of_s in ends_s) for job in plan.jobs},
        alone={
            job.name: sum(
                of_s.get(job.name, math.inf) <= min(first_s, trial.duration_s)
                for trial, of_s, first_s in zip(found, ends_s, first_asked_s, strict=True)
            )
            for job in plan.jobs
        },
        stopped=[trial.stopped for trial in found if trial.stopped],
        samples=samples,
        asked=len(asked) / len(found),
        good=sum(samples[name].probability for name in asked) / len(found),
        scoops={name: _seen([trial.scoops[name] for trial in found]) for name in plan.recipe.sources},
        used_mg={name: _of_masses([trial.used_mg[name] for trial in found]) for name in plan.recipe.sources},
        leftovers_mg={
            name: {
                kind: _seen([trial.leftovers_mg[name].get(kind, 0.0) for trial in found])
                for kind in (*LEFTOVERS, *vessels)
            }
            for name in plan.recipe.sources
        },
        codes={code: count / len(found) for code, count in codes.most_common()},
        verdicts={verdict: count / len(found) for verdict, count in verdicts.most_common()},
    )


def _ends_s(trial: Trial) -> dict[str, float]:
    """When each job ended, by its name: as the next one began. Without the job that stopped the run."""
    ends_s = dict(zip(trial.began_s, [*trial.began_s.values()][1:], strict=False))
    is_whole = all(one.id in trial.began_s for one in trial.samples)
    if is_whole and trial.exit_code in (ExitCode.OK, ExitCode.FLAGGED):
        ends_s |= dict.fromkeys([*trial.began_s][-1:], trial.duration_s)
    return ends_s


def _of_jobs(plan: Plan, times_s: Sequence[Mapping[str, float]]) -> dict[str, Range]:
    """A time of each job over all trials, for jobs that any trial has."""
    by_job = {job.name: [of[job.name] for of in times_s if job.name in of] for job in plan.jobs}
    return {job: _of_times(found) for job, found in by_job.items() if found}


def _in_turn(times_s: Mapping[str, Range]) -> dict[str, Range]:
    """Make each at least as late as the one before it."""
    last = Range(0.0, 0.0, 0.0)
    return {job: (last := found.no_earlier_than(last)) for job, found in times_s.items()}


def _moments(many: int, asked_s: Sequence[Sequence[Sequence[float]]]) -> list[Range]:
    """When each of a job's `many` moments is, from the requests of each trial.

    Only trials in which exactly so many actions asked are used. If too few are like that, because somebody was asked
    about a failure or a skill's forecast is wrong, requests cannot be assigned to moments. Then every moment gets the
    whole span.
    """
    alike = [one for one in asked_s if len(one) == many]
    if len(alike) >= min(FEWEST, len(asked_s)):
        return [_from_to(spans) for spans in zip(*alike, strict=True)]
    return [_from_to([(one[0][0], max(last for _, last in one)) for one in asked_s])] * many


def _from_to(spans_s: Sequence[Sequence[float]]) -> Range:
    """The span from the earliest begin to the latest end."""
    begins, ends = (_of_times(times) for times in zip(*spans_s, strict=True))
    return Range(begins.low, begins.middle, ends.high)


def _of_times(times_s: Sequence[float]) -> Range:
    """The interval of one more run. Durations vary by factors, so their logarithms are used."""
    if len(times_s) < FEWEST or min(times_s) <= 0.0:
        return _seen(times_s)
    logs, many = np.log(times_s), len(times_s)
    half = WIDE * math.hypot(float(np.std(logs, ddof=1)) * math.sqrt(1.0 + 1.0 / many), MODEL_SHARE)
    middle = float(np.mean(logs))
    return Range(*(math.exp(at) for at in (middle - half, middle, middle + half)))


def _of_masses(masses_mg: Sequence[float]) -> Range:
    """The interval of one more run. With four trials, it lies outside their extremes two times in five."""
    if len(masses_mg) < FEWEST:
        return _seen(masses_mg)
    mean, many = float(np.mean(masses_mg)), len(masses_mg)
    half = float(stdtrit(many - 1, 0.5 + COVERED / 2.0) * np.std(masses_mg, ddof=1)) * math.sqrt(1.0 + 1.0 / many)
    half = math.hypot(half, WIDE * MODEL_MASS_SHARE * mean)
    return Range(max(0.0, mean - half), float(np.median(masses_mg)), mean + half)


def _seen(values: Sequence[float]) -> Range:
    covered = COVERED if len(values) >= FEWEST else 1.0
    low, middle, high = np.quantile(values, ((1.0 - covered) / 2.0, 0.5, (1.0 + covered) / 2.0))
    return Range(float(low), float(middle), float(high))


def _chances(plan: Plan, found: Sequence[Trial], *, as_written: bool) -> dict[str, Chance]:
    """The probability of each sample. Samples that ask for the same are one kind, and kinds are pooled (`_pooled`).

    A sample that differs between trials, or is only in some of them, is a kind of its own.
    """
    kinds: dict[str, object] = {}
    if as_written:
        kinds = {sample.id: _alike(sample) for sample in plan.recipe.samples}
    came: dict[object, list[bool]] = {}
    for trial in found:
        for one in trial.samples:
            came.setdefault(kinds.setdefault(one.id, one.id), []).append(one.good)
    chances = dict(zip(came, _pooled([(sum(kind), len(kind)) for kind in came.values()]), strict=True))
    return {name: chances[kind] for name, kind in kinds.items() if kind in chances}


def _pooled(kinds: Sequence[tuple[int, int]]) -> list[Chance]:
    """The probability that one more sample of each kind is good, given (good, tried) of each kind.

    Each kind's rate has a beta distribution about the batch's rate (Jeffreys prior), with an unknown concentration:
    the number of trials that the batch counts as. Rate and concentration are summed over a grid (Gelman et al.,
    Bayesian Data Analysis, 5.3). So kinds that come out alike support each other.
    """
    if not kinds:
        return []
    # Kinds with the same counts are computed once.
    came, which, many = np.unique(np.array(kinds), axis=0, return_inverse=True, return_counts=True)
    good, tried = came.T
    batch = betaincinv(0.5, 0.5, (np.arange(RATES) + 0.5) / RATES)[:, np.newaxis]
    counts = np.array(BATCH_COUNTS)[:, np.newaxis, np.newaxis]
    a, b = counts * batch, counts * (1.0 - batch)
    logs = np.sum(many * (betaln(a + good, b + tried - good) - betaln(a, b)), axis=-1, keepdims=True)
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    means = (a + good) / (counts + tried)
    squares = means * (a + good + 1.0) / (counts + tried + 1.0)
    mean = np.sum(weights * means, axis=(0, 1))
    variance = np.sum(weights * squares, axis=(0, 1)) - mean * mean
    # The interval is that of a beta distribution with the same mean and variance.
    size = mean * (1.0 - mean) / variance - 1.0
    low, high = (
        betaincinv(size * mean, size * (1.0 - mean), share) for share in ((1.0 - COVERED) / 2.0, (1.0 + COVERED) / 2.0)
    )
    figures = zip(mean.tolist(), low.tolist(), high.tolist(), tried.tolist(), good.tolist(), strict=True)
    chances = [Chance(*one) for one in figures]
    return [chances[index] for index in which.reshape(-1)]


def _alike(sample: Sample) -> object:
    container = sample.container.name if sample.container is not None else None
    powders = tuple(source.sheet_key for source in sample.sources)
    return sample.workflow, powders, container, sample.asks, sample.tolerance_mg
