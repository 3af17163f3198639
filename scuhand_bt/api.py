"""scuhand_bt from Python: a lab is opened, recipes are checked, planned and run dry, and results come as records.

    from scuhand_bt import api

    lab = api.open_lab("my-lab")
    result = lab.dry_run("my-lab/recipes/xrd_holders.yaml", seed=1)
    for dose in result.doses:
        print(dose.sample, dose.dispensed_mg, dose.verdict)

A recipe is the path of a file, or a dict of what would stand in one ("50 mg" as there). Masses are in mg, times in s.
Everything is done in the thread that calls; two threads may each run their own recipe of one `OpenLab`.
"""

import json
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from scuhand_bt.journal.results import DoseResult, SampleResult
from scuhand_bt.lab import Lab, find_lab, load_lab
from scuhand_bt.problems import Problem, Problems, SourceError
from scuhand_bt.recipe.composition import Composition
from scuhand_bt.recipe.plan import Plan, make_plan
from scuhand_bt.recipe.recipe import Recipe, load_recipe, recipe_of
from scuhand_bt.run.batch import BatchObserver
from scuhand_bt.run.make_cell import DryRun
from scuhand_bt.run.options import Options
from scuhand_bt.run.session import Session
from scuhand_bt.sim.fault_rules import read_faults
from scuhand_bt.yaml_source import from_plain

__all__ = ["DoseRecord", "OpenLab", "Plan", "Problem", "Result", "SourceError", "open_lab"]

RecipeGiven = str | Path | Mapping[str, Any]


@dataclass(frozen=True)
class DoseRecord:
    """One dose: a powder lot in a container; of a sample that was not dosed, its verdict alone."""

    sample: str
    container: str | None
    lot: str | None
    target_mg: float | None
    dispensed_mg: float | None
    error_mg: float | None
    uncertainty_mg: float | None
    tolerance_mg: float | None
    verdict: str
    sample_duration_s: float
    code: str | None
    """Of the sample's failure, if there was one."""
    detail: str | None
    true_mg: float | None
    """The simulation's, of all that the container holds, whichever lot; None on a real cell."""
    recorded: Mapping[str, bool | int | float | str]
    """What the workflow has recorded of the sample, by name, in mg, mm, s or degrees."""
    composition: Mapping[str, float | str | None]
    """Of a composed sample: by element the atoms reached per formula of the product, and their `u(ELEMENT)`; `verdict`.
    """


@dataclass(frozen=True)
class Result:
    """What a run came to."""

    samples: tuple[SampleResult, ...]
    exit_code: int
    """As the command's: 0 every dose in tolerance, 1 with flagged doses, 3 a fault of the cell."""
    reason: str
    duration_s: float
    """Time of the run."""

    @property
    def doses(self) -> list[DoseRecord]:
        """All doses, in the order of the recipe."""
        return [record for sample in self.samples for record in _records(sample)]

    def rows(self) -> list[dict[str, Any]]:
        """The doses as dicts: `pandas.DataFrame(result.rows())`; recorded values stand there as `recorded.NAME`, and
        what a sample is composed of as `composition.ELEMENT`.
        """
        rows = [asdict(dose) for dose in self.doses]
        nested = ("recorded", "composition")
        return [row | {f"{of}.{key}": value for of in nested for key, value in row.pop(of).items()} for row in rows]


@dataclass(frozen=True)
class OpenLab:
    """A lab, loaded once."""

    lab: Lab

    @property
    def problems(self) -> tuple[Problem, ...]:
        """What is wrong in its files, and breaks only what uses them."""
        return self.lab.problems

    def check(self, recipe: RecipeGiven) -> list[Problem]:
        """The errors of a recipe, each with its place; none for one that can be run."""
        try:
            self.plan(recipe)
        except SourceError as error:
            return error.problems
        return []

    def plan(self, recipe: RecipeGiven) -> Plan:
        """The recipe's jobs in their order. SourceError with all that is wrong."""
        return make_plan(self._recipe(recipe), self.lab)

    def dry_run(
        self,
        recipe: RecipeGiven,
        *,
        seed: int = 0,
        faults: str | Path | None = None,
        controller: str | None = None,
        journals: str | Path | None = None,
        on_sample: Callable[[SampleResult], None] = lambda result: None,
    ) -> Result:
        """Run a recipe on simulated devices, and tell `on_sample` of each sample as it ends.

        `faults` is a fault file; the journal is kept below `journals`, if that is given.
        SourceError for what is wrong, SkillFailed for places without a way between them.
        """
        wrong = read_faults(Path(faults)) if faults is not None else None
        plan = self.plan(recipe)
        with tempfile.TemporaryDirectory() as scratch:
            folder = Path(journals) if journals is not None else Path(scratch) / "runs"
            session = Session(plan, self.lab, Options(DryRun(seed, faults=wrong), controller, folder))
            try:
                ran = session.run(_Telling(on_sample))
            finally:
                session.close()
        return Result(ran.samples, int(ran.exit_code), ran.reason, ran.duration_s)

    def _recipe(self, given: RecipeGiven) -> Recipe:
        if not isinstance(given, Mapping):
            return load_recipe(Path(given), self.lab)
        problems = Problems()
        path = self.lab.folder / "recipes" / "given.yaml"
        text = json.dumps(given, default=str)
        recipe = recipe_of(from_plain(given, "recipe"), path, text, self.lab, problems)
        problems.raise_any()
        assert recipe is not None
        return recipe


def open_lab(folder: str | Path | None = None) -> OpenLab:
    """A lab's folder; without one the nearest upward from here, else the starter lab. SourceError for what is none."""
    return OpenLab(load_lab(find_lab(None, Path(folder) if folder is not None else None)))


class _Telling(BatchObserver):
    def __init__(self, on_sample: Callable[[SampleResult], None]) -> None:
        self._on_sample = on_sample

    def sample_ended(self, result: SampleResult) -> None:
        self._on_sample(result)


def _records(sample: SampleResult) -> list[DoseRecord]:
    """A record for each dose; of a sample without one, of the sample itself."""
    if not sample.doses:
        return [_record(sample, sample, None, sample.true_mg)]
    return [_record(sample, dose, dose.lot, dose.true_mg) for dose in sample.doses]


def _record(sample: SampleResult, of: SampleResult | DoseResult, lot: str | None, true_mg: float | None) -> DoseRecord:
    return DoseRecord(
        sample=sample.id,
        container=of.container,
        lot=lot,
        target_mg=of.target_mg,
        dispensed_mg=of.dispensed_mg,
        error_mg=of.error_mg,
        uncertainty_mg=of.uncertainty_mg,
        tolerance_mg=of.tolerance_mg,
        verdict=of.verdict,
        sample_duration_s=sample.duration_s,
        code=sample.code,
        detail=sample.detail,
        true_mg=true_mg,
        recorded={one.name: one.value for one in sample.recorded},
        composition=_composition(sample.composition) if sample.composition is not None else {},
    )


def _composition(composition: Composition) -> dict[str, float | str | None]:
    found: dict[str, float | str | None] = {}
    for one in composition.elements:
        found |= {one.element: one.reached, f"u({one.element})": one.uncertainty}
    return found | {"verdict": composition.verdict}
