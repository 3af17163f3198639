"""Searches better figures on some seeds, judges them on others, and shows them as a diff (docs/study.md).

The cost to minimise is the share of samples not in tolerance, plus a small share for time:

    1 - good + TIME_WORTH (duration / good) / (duration / good as written)

The search is a tree-structured Parzen estimator (Bergstra et al., Advances in Neural Information Processing Systems
24, 2011; Optuna). All candidates run on the same seeds.
"""

import difflib
import math
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.stats import t

from scuhand_bt.problems import Mark, Problem, SourceError
from scuhand_bt.study.change import Changes, file_of, with_value
from scuhand_bt.study.pool import all_trials
from scuhand_bt.study.store import Store
from scuhand_bt.study.trial import Setup, Trial
from scuhand_bt.study.vary import Between, Vary, check_setups

TIME_WORTH = 0.1
"""Weight of time in the cost: halving it is worth one sample of twenty."""
SURE = 0.95
"""Confidence with which a proposal must be better: of twenty that change nothing, one is shown."""


@dataclass(frozen=True)
class Found:
    """The result of some trials of one setup."""

    good: float
    """Share of samples that are in tolerance both truly and by their weighings."""
    duration_s: float

    def cost(self, as_written: "Found") -> float:
        """The cost. Time counts per good sample, as runs that stop early are short; as unchanged if there is none."""
        if self.good == 0.0 or as_written.good == 0.0:
            return 1.0 - self.good + TIME_WORTH
        share = self.duration_s / self.good / (as_written.duration_s / as_written.good)
        return 1.0 - self.good + TIME_WORTH * share


@dataclass(frozen=True)
class Proposal:
    """The best candidate, and its worth on seeds that the search did not use."""

    changes: Changes
    as_written: Found
    proposed: Found
    is_better: bool
    """By more than chance explains."""
    refused: int = 0
    """Candidates that no recipe or lab may have, although each of their figures alone may be valid."""


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

    Raises SourceError if Optuna is missing, or if no candidate is valid.
    """
    try:
        import optuna
    except ImportError:
        problem = "the search needs Optuna; `pip install 'scuhand-bt[study]'`"
        raise SourceError([Problem(Mark("--optimise", 0), problem)]) from None

    def of(changes: Changes, seeds: Sequence[int]) -> list[Trial]:
        tasks = [(replace(setup, changes=changes), seed) for seed in seeds]
        return sorted((trial for _, trial in all_trials(tasks, executor, store)), key=lambda trial: trial.seed)

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    search = optuna.create_study(sampler=optuna.samplers.TPESampler(seed=0))
    as_written = _found(of((), seeds))
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
        except SourceError as error:  # must not end the search: it is deterministic, and would never get past this
            refused.append(error)
            search.tell(asked, state=optuna.trial.TrialState.FAIL)
        else:
            search.tell(asked, _found(of(changes, seeds)).cost(as_written))
    if len(refused) == candidates:
        raise refused[0]
    best = tuple((place, value) for place, value in search.best_trial.user_attrs["changes"])
    before, after = of((), held_out), of(best, held_out)
    return Proposal(best, _found(before), _found(after), is_better(before, after), len(refused))


def is_better(before: Sequence[Trial], after: Sequence[Trial]) -> bool:
    """Whether the cost has fallen by more than chance explains; both have the same seeds, paired.

    The uncertainty is estimated by leaving out one seed at a time (the jackknife; Tukey, Annals of Mathematical
    Statistics 29, 614, 1958), and compared by Student's t. A single seed shows nothing.
    """
    many = len(before)
    if many < 2:
        return False
    without = [_saved([*before[:one], *before[one + 1 :]], [*after[:one], *after[one + 1 :]]) for one in range(many)]
    uncertainty = math.sqrt(many - 1) * float(np.std(without))
    return _saved(before, after) > float(t.ppf(SURE, many - 1)) * uncertainty


def _saved(before: Sequence[Trial], after: Sequence[Trial]) -> float:
    """The reduction of the cost."""
    as_written = _found(before)
    return as_written.cost(as_written) - _found(after).cost(as_written)


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
