"""A trial: one seeded dry run of a recipe, as the few figures that a plan or a study asks for.

It is made in a process of its own (`study/dry_run.py`), so that nothing here needs the robot's libraries.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, as_completed
from dataclasses import KW_ONLY, dataclass, field
from pathlib import Path
from typing import TypeAlias

from scuhand_bt.study.change import Changes

LEFTOVERS = ("kept", "returned", "discarded")
"""What becomes of powder that is left in the cone, as the journal calls it."""


def into(station: str) -> str:
    """What is beside these, where a recipe has named a vessel that is not the waste bin."""
    return f"into {station}"


@dataclass(frozen=True)
class Setup:
    """What is tried: a recipe in a lab, with changes of its figures, under a controller, on simulated physics."""

    recipe: Path
    lab: Path
    _: KW_ONLY
    controller: str | None = None
    order: str | None = None
    """Another order of the samples than the recipe's."""
    plant: str | None = None
    """Physics by `module:Class`; None: `some_cell`'s, another one for each seed."""
    changes: Changes = ()
    files: str = ""
    """What recipe and lab are to be (`files_hash`), wherever and whenever they are read; empty: whatever they are."""
    modules: str = ""
    """What one's own modules are to be that plant and lab are made of (`modules_hash`), likewise."""


@dataclass(frozen=True)
class SampleTrial:
    """How a sample came out in one trial. Masses are None where nothing was dosed."""

    id: str
    good: bool
    """In tolerance and confirmed, by its weighings."""
    truly_good: bool
    """By the simulated masses, of all of its containers."""
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
    """When each job of the plan began, by its name."""
    samples: tuple[SampleTrial, ...]
    scoops: Mapping[str, int]
    """By source."""
    used_mg: Mapping[str, float]
    """What each source has lost, by its name."""
    leftovers_mg: Mapping[str, Mapping[str, float]]
    """By source, what was left in the cone after doses: returned, discarded, put away; of what was kept the most."""
    asked_s: Mapping[str, Sequence[Sequence[float]]] = field(default_factory=dict)
    """When a person was first and last asked for something by each action that did so, by its job's name."""
    stopped: str = ""
    """Why it stopped before its end; empty where it came to that."""


Task: TypeAlias = tuple[Setup, int]
"""What is tried, and its seed."""


def trial(setup: Setup, seed: int) -> Trial:
    """One dry run. SourceError for a recipe, a lab or changes that are wrong."""
    from scuhand_bt.study.dry_run import dry_run

    return dry_run(setup, seed)


def trials(tasks: Iterable[Task], executor: Executor) -> Iterator[tuple[Task, Trial]]:
    """Every task's trial, as they end, by whatever runs them: a pool of processes, or Dask's."""
    waiting = {executor.submit(trial, setup, seed): (setup, seed) for setup, seed in tasks}
    for done in as_completed(waiting):
        yield waiting[done], done.result()
