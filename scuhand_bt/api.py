"""scuhand_bt from Python: a lab is opened, recipes are checked, planned and run, and results come as records.

    from scuhand_bt import api

    lab = api.open_lab("my-lab")
    result = lab.dry_run("my-lab/recipes/xrd_holders.yaml", seed=1)
    for dose in result.doses:
        print(dose.sample, dose.dispensed_mg, dose.verdict)

A recipe is the path of a file, or a dict of what would stand in one ("50 mg" as there). Masses are in mg, times in s.
The command line is made of this (`docs/python.md`).

Everything is done in the thread that calls, and what is made in one thread may be used in another. Threads may each
run their own recipe of one `OpenLab`; a session is run once.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, TypedDict, Unpack

from scuhand_bt.journal.results import DoseResult, SampleResult
from scuhand_bt.journal.telling import RunEvent, Telling
from scuhand_bt.lab import Lab, find_lab, read_lab, state_folder, with_cell
from scuhand_bt.problems import Problem, SourceError
from scuhand_bt.recipe.composition import Composition
from scuhand_bt.recipe.plan import Plan, make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.recipe.sample import Sample
from scuhand_bt.run.checking import Checked, check, on_the_cell
from scuhand_bt.skill import SkillFailed

if TYPE_CHECKING:
    from scuhand_bt.journal.export import canonical
    from scuhand_bt.run.batch import BatchObserver, Observers
    from scuhand_bt.run.control import Control
    from scuhand_bt.run.make_cell import DryRun, Rehearsal, Simulation
    from scuhand_bt.run.operator import Person
    from scuhand_bt.run.outcome import BatchResult
    from scuhand_bt.run.questions import UNKNOWN
    from scuhand_bt.run.session import Session
    from scuhand_bt.sim.fault_rules import read_faults
    from scuhand_bt.sim.plant import PlantError
    from scuhand_bt.sim.wire.hand import NoCompiler

__all__ = [
    "UNKNOWN",
    "BatchObserver",
    "BatchResult",
    "Checked",
    "Control",
    "DoseRecord",
    "DryRun",
    "How",
    "Lab",
    "NoCompiler",
    "Observers",
    "OnEvent",
    "OpenLab",
    "Person",
    "Plan",
    "PlantError",
    "Problem",
    "Rehearsal",
    "Result",
    "RunEvent",
    "Sample",
    "SampleResult",
    "Session",
    "SkillFailed",
    "SourceError",
    "canonical",
    "closing",
    "open_lab",
    "read_faults",
]

_WITH_A_RUN = {
    "journal.export": ("canonical",),
    "run.batch": ("BatchObserver", "Observers"),
    "run.control": ("Control",),
    "run.make_cell": ("DryRun", "Rehearsal"),
    "run.operator": ("Person",),
    "run.outcome": ("BatchResult",),
    "run.questions": ("UNKNOWN",),
    "run.session": ("Session",),
    "sim.fault_rules": ("read_faults",),
    "sim.plant": ("PlantError",),
    "sim.wire.hand": ("NoCompiler",),
}
"""Imported when they are asked for: who only checks a recipe does not wait for the arm's kinematics."""


def __getattr__(name: str) -> Any:
    for module, names in _WITH_A_RUN.items():
        if name in names:
            return getattr(import_module(f"scuhand_bt.{module}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


Given = str | Path | Mapping[str, Any]
"""A recipe: its file, or a dict of what would stand there."""
OnSample = Callable[[SampleResult], object]
"""Is told of each sample as it gets its result, and again when the bare pan has confirmed it; in the run's own thread,
which it is not to hold up."""
OnEvent = Callable[[RunEvent], object]
"""Is told of everything that happens, in order, on one thread beside the run; `Result.notices` says if it broke."""


class How(TypedDict, total=False):
    """How a recipe is run, on whatever."""

    controller: str | None
    """The dosing controller, in place of the recipe's and the lab's."""
    journals: str | Path
    """The folder for the journal; without it the lab's, and of a `dry_run` none is kept."""
    unattended: bool
    """Nobody is there: a plan that needs a person is refused, and nobody is waited for."""
    control: "Control"
    """Pauses and stops it, from any thread."""
    single_step: bool
    """The person at the cell is asked before each action (in a simulation: where it `asks`)."""
    slow_ratio: float
    """Arm, roller and changer go at this share of their speeds."""


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

    run: str
    """Its id."""
    samples: tuple[SampleResult, ...]
    exit_code: int
    """As the command's: 0 every dose in tolerance, 1 with flagged doses, 3 a fault of the cell, 130 interrupted."""
    reason: str
    """Why it ended early; empty where it did not."""
    duration_s: float
    """Time of the run."""
    notices: tuple[str, ...]
    """What went wrong beside the batch: a notification that failed, a callback that broke."""

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

    @property
    def state(self) -> Path:
        """The folder of its journals, its inventory, and what it has learnt."""
        return state_folder(self.lab)

    def check(self, recipe: Given | None = None, *, fast: bool = False) -> Checked:
        """All that `run` would refuse, and what is most likely not meant, each with its place; nothing moves.

        Without a recipe the lab itself. `fast` leaves out the planning of the arm's ways.
        """
        return check(self.lab, _given(recipe) if recipe is not None else None, fast=fast)

    def plan(self, recipe: Given) -> Plan:
        """The recipe's jobs in their order. SourceError with all that is wrong."""
        lab = with_cell(self.lab)
        return make_plan(load_recipe(_given(recipe), lab), lab)

    def notes(self, plan: Plan) -> list[Problem]:
        """What a run of a plan on the real cell would be refused for, or ask, by what the lab knows of it now."""
        return on_the_cell(plan, self.lab)

    def prepare(
        self,
        recipe: Given | Plan,
        simulation: "Simulation | None" = None,
        *,
        person: "Person | None" = None,
        **how: Unpack[How],
    ) -> "Session":
        """A run made ready, to be `run` once in a `with closing(session)`; what `dry_run`, `rehearse` and `run` do.

        Without a `simulation` (`DryRun`, `Rehearsal`) it is on the devices of `robot/cell.yaml`. Raises as `Session`.
        """
        from scuhand_bt.run.options import Options
        from scuhand_bt.run.session import Session

        plan = recipe if isinstance(recipe, Plan) else self.plan(recipe)
        folder = Path(how["journals"]) if "journals" in how else None
        unattended = how.get("unattended", False)
        options = Options(
            simulation,
            how.get("controller"),
            folder,
            unattended=unattended,
            person=person,
            single_step=how.get("single_step", False),
            slow_ratio=how.get("slow_ratio", 1.0),
        )
        return Session(plan, self.lab, options, control=how.get("control"))

    def dry_run(
        self,
        recipe: Given | Plan,
        *,
        seed: int = 0,
        plant: str | None = None,
        faults: str | Path | None = None,
        on_sample: OnSample | None = None,
        on_event: OnEvent | None = None,
        **how: Unpack[How],
    ) -> Result:
        """Run a recipe on simulated devices, at once. `faults` is a fault file, `plant` physics of your own.

        SourceError for what is wrong, SkillFailed for places without a way between them.
        """
        from scuhand_bt.run.make_cell import DryRun
        from scuhand_bt.sim.fault_rules import read_faults

        wrong = read_faults(Path(faults)) if faults is not None else None
        with TemporaryDirectory() as scratch:
            how.setdefault("journals", Path(scratch) / "runs")
            return _ran(self.prepare(recipe, DryRun(seed, plant, faults=wrong), **how), on_sample, on_event)

    def rehearse(
        self,
        recipe: Given | Plan,
        *,
        seed: int = 0,
        plant: str | None = None,
        faults: str | Path | None = None,
        on_sample: OnSample | None = None,
        on_event: OnEvent | None = None,
        **how: Unpack[How],
    ) -> Result:
        """The same in real time, by the real drivers, against twins of the devices."""
        from scuhand_bt.run.make_cell import Rehearsal
        from scuhand_bt.sim.fault_rules import read_faults

        wrong = read_faults(Path(faults)) if faults is not None else None
        return _ran(self.prepare(recipe, Rehearsal(seed, plant, wrong), **how), on_sample, on_event)

    def run(
        self,
        recipe: Given | Plan,
        *,
        operator: str,
        pin: str | None = None,
        on_sample: OnSample | None = None,
        on_event: OnEvent | None = None,
        **how: Unpack[How],
    ) -> Result:
        """Run a recipe on the devices of `robot/cell.yaml`: real ones, or twins that another program has put there.

        `operator` is who is at the cell. What this person is asked waits for an answer in this terminal, on the
        dashboard or by `scuhand-bt answer`. Ctrl-C ends the run safe; a skill that hangs is not ended here, as the
        command's supervisor does. Also raises ValueError for a name that is none, and without the PIN of who has one.
        """
        return _ran(self.prepare(recipe, person=self._person(operator, pin), **how), on_sample, on_event)

    def _person(self, operator: str, pin: str | None) -> "Person":
        from scuhand_bt.lab_state.persons import Persons, person_name
        from scuhand_bt.run.operator import Person

        name, persons = person_name(operator), Persons(self.state)
        if name not in persons.names():
            return Person(name)
        if pin is None or not persons.is_pin(name, pin):
            raise ValueError(f"{name} signs with a PIN: " + ("give it" if pin is None else "this is not it"))
        return Person(name, lambda given: persons.is_pin(name, given))


def open_lab(folder: str | Path | None = None, *, recipe: str | Path | None = None) -> OpenLab:
    """A lab's folder; without one the nearest upward from the recipe's file, or from here, else the starter lab.

    What is wrong in its files are its `problems`. SourceError for a folder that is no lab.
    """
    of = Path(recipe) if recipe is not None else None
    return OpenLab(read_lab(find_lab(of, Path(folder) if folder is not None else None)))


@contextmanager
def closing(session: "Session", on_event: OnEvent | None = None) -> Iterator["Session"]:
    """Tell `on_event` of all that happens in a session, from its first entry to its last, and close it."""
    if on_event is None:
        try:
            yield session
        finally:
            session.close()
        return
    telling = Telling(lambda: session.journal.kept_in or session.journal.path, on_event)
    try:
        yield session
    finally:
        with telling.paused():
            session.close()
        telling.end()
        if telling.problem is not None:
            session.notices.append(telling.problem)


def _given(recipe: Given) -> Path | Mapping[str, Any]:
    return recipe if isinstance(recipe, Mapping) else Path(recipe)


def _ran(session: "Session", on_sample: OnSample | None, on_event: OnEvent | None) -> Result:
    from scuhand_bt.run.batch import BatchObserver

    class Samples(BatchObserver):
        def sample_ended(self, result: SampleResult) -> None:
            if on_sample is not None:
                on_sample(result)

    with closing(session, on_event):
        ran = session.run(Samples())
    return Result(session.run_id, ran.samples, int(ran.exit_code), ran.reason, ran.duration_s, tuple(session.notices))


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
