"""A trial: one seeded dry run of a recipe, reduced to the few figures that a plan or a study needs.

It runs in its own process (`study/dry_run.py`), so nothing here imports the robot's libraries.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, as_completed
from dataclasses import KW_ONLY, dataclass, field
from pathlib import Path
from typing import TypeAlias

from scuhand_bt.study.change import Changes

LEFTOVERS = ("kept", "returned", "discarded")
"""What may become of powder left in the cone, by the kinds of journal entries."""


def into(station: str) -> str:
    """The same for a vessel that a recipe has named for leftovers."""
    return f"into {station}"


@dataclass(frozen=True)
class Setup:
    """What is tried: a recipe in a lab with changed figures, a controller and simulated physics."""

    recipe: Path
    lab: Path
    _: KW_ONLY
    controller: str | None = None
    order: str | None = None
    """Another order of the samples than the recipe's."""
    plant: str | None = None
    """Physics by `module:Class`; None: `some_cell`'s, which differ for each seed."""
    changes: Changes = ()
    files: str = ""
    """The hash (`files_hash`) that recipe and lab must have whenever they are read; "" for any."""
    modules: str = ""
    """Likewise the hash of the user's own modules behind plant and lab (`modules_hash`)."""


@dataclass(frozen=True)
class SampleTrial:
    """A sample's result in one trial. Masses are None if nothing was dosed."""

    id: str
    good: bool
    """In tolerance and confirmed, by its weighings."""
    truly_good: bool
    """By the simulated masses in all of its containers."""
    verdict: str
    code: str | None
    target_mg: float | None
    dispensed_mg: float | None
    true_mg: float | None
    duration_s: float


@dataclass(frozen=True)
class Trial:
    """One dry run."""

    seed: int
    exit_code: int
    duration_s: float
    began_s: Mapping[str, float]
    """When each job of the plan began, by its name [s]."""
    samples: tuple[SampleTrial, ...]
    scoops: Mapping[str, int]
    """By source."""
    used_mg: Mapping[str, float]
    """What each source has lost, by its name [mg]."""
    leftovers_mg: Mapping[str, Mapping[str, float]]
    """Powder left in the cone after doses, by source: totals returned, discarded or put away; the most kept."""
    asked_s: Mapping[str, Sequence[Sequence[float]]] = field(default_factory=dict)
    """By job: the first and last time at which each action asked a person for something [s]."""
    stopped: str = ""
    """Why it stopped before its end; "" if it did not."""


Task: TypeAlias = tuple[Setup, int]
"""What is tried, and the seed."""


def trial(setup: Setup, seed: int) -> Trial:
    """One dry run. Raises SourceError for a wrong recipe, lab or change."""
    from scuhand_bt.study.dry_run import dry_run

    return dry_run(setup, seed)


def trials(tasks: Iterable[Task], executor: Executor) -> Iterator[tuple[Task, Trial]]:
    """Every task's trial as it ends, run by a pool of processes or by Dask."""
    waiting = {executor.submit(trial, setup, seed): (setup, seed) for setup, seed in tasks}
    for done in as_completed(waiting):
        yield waiting[done], done.result()
