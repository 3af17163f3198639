"""Figures that a study proposes: looked for on some seeds, judged on others, and shown as a diff.

What is made least is the share of samples that are not in tolerance, and a little the time:

    1 - good + TIME_WORTH (duration / good) / (duration / good as written)

by a tree-structured Parzen estimator (Bergstra et al., Advances in Neural Information Processing Systems 24, 2011;
Optuna). All candidates have the same seeds.
"""

import difflib
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path

from scuhand_bt.problems import Mark, Problem, SourceError
from scuhand_bt.study.change import Changes, file_of, with_value
from scuhand_bt.study.pool import all_trials
from scuhand_bt.study.store import Store
from scuhand_bt.study.trial import Setup, Trial
from scuhand_bt.study.vary import Between, Vary, check_setups

TIME_WORTH = 0.1
"""Half the time is worth one sample of twenty."""


@dataclass(frozen=True)
class Found:
    """What came of some trials of one setup."""

    good: float
    """Share of the samples that are truly in tolerance, and said to be."""
    duration_s: float

    def cost(self, as_written: "Found") -> float:
        """Runs that stop at a failure take little time: it counts by what they bring, and not where that is nothing."""
        if self.good == 0.0 or as_written.good == 0.0:
            return 1.0 - self.good + TIME_WORTH
        share = self.duration_s / self.good / (as_written.duration_s / as_written.good)
        return 1.0 - self.good + TIME_WORTH * share


@dataclass(frozen=True)
class Proposal:
    """The best that was found, and what it is worth on seeds that it was not looked for on."""

    changes: Changes
    as_written: Found
    proposed: Found
    refused: int = 0
    """Candidates that no recipe or lab may have, each figure of which by itself one may."""

    @property
    def is_better(self) -> bool:
        return self.proposed.cost(self.as_written) < self.as_written.cost(self.as_written)


def optimised(
    setup: Setup,
    vary: Vary,
    candidates: int,
    seeds: Sequence[int],
    held_out: Sequence[int],
    executor: Executor,
    store: Store,
) -> Proposal:
    """The best of so many candidates on `seeds`, judged on `held_out`.

    SourceError where Optuna is missing, or no recipe or lab may have any of them.
    """
    try:
        import optuna
    except ImportError:
        problem = "the search needs Optuna; `pip install 'scuhand-bt[study]'`"
        raise SourceError([Problem(Mark("--optimise", 0), problem)]) from None

    def of(changes: Changes, seeds: Sequence[int]) -> Found:
        tasks = [(replace(setup, changes=changes), seed) for seed in seeds]
        return _found([trial for _, trial in all_trials(tasks, executor, store)])

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    search = optuna.create_study(sampler=optuna.samplers.TPESampler(seed=0))
    as_written = of((), seeds)
    refused: list[SourceError] = []
    for _ in range(candidates):
        asked = search.ask()
        changes = tuple(
            (place, given.at(asked.suggest_float(place, 0.0, 1.0)))
            if isinstance(given, Between)
            else (place, asked.suggest_categorical(place, given))
            for place, given in vary.vary.items()
        )
        asked.set_user_attr("changes", changes)
        try:
            check_setups([replace(setup, changes=changes)])
        except SourceError as error:  # the same search comes to it each time: it would never end
            refused.append(error)
            search.tell(asked, state=optuna.trial.TrialState.FAIL)
        else:
            search.tell(asked, of(changes, seeds).cost(as_written))
    if len(refused) == candidates:
        raise refused[0]
    best = tuple((place, value) for place, value in search.best_trial.user_attrs["changes"])
    return Proposal(best, of((), held_out), of(best, held_out), len(refused))


def diff(setup: Setup, changes: Changes) -> Iterator[str]:
    """The changes as a unified diff of the files; nothing is written."""
    texts: dict[Path, tuple[str, str]] = {}
    for place, value in changes:
        path = file_of(place, setup.recipe, setup.lab)
        before, after = texts.get(path, (path.read_text(encoding="utf-8"),) * 2)
        texts[path] = before, with_value(after, place, value)
    for path, (before, after) in texts.items():
        name = str(path.relative_to(setup.lab)) if path.is_relative_to(setup.lab) else str(path)
        yield from difflib.unified_diff(before.splitlines(), after.splitlines(), name, name, n=1, lineterm="")


def _found(trials: Sequence[Trial]) -> Found:
    samples = [sample for trial in trials for sample in trial.samples]
    good = sum(sample.good and sample.truly_good for sample in samples) / max(len(samples), 1)
    return Found(good, sum(trial.duration_s for trial in trials) / len(trials))
