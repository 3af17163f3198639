"""A lab, opened: recipes are checked, planned and run in it."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, TypedDict, Unpack, cast

from scuhand_bt.api.results import Result
from scuhand_bt.journal.results import SampleResult
from scuhand_bt.journal.telling import RunEvent, Telling
from scuhand_bt.lab import Lab, find_lab, read_lab, state_folder, with_cell
from scuhand_bt.problems import Problem
from scuhand_bt.recipe.plan import Plan, make_plan
from scuhand_bt.recipe.recipe import load_recipe
from scuhand_bt.run.checking import Checked, check, doubts, on_the_cell, ways_lacking

if TYPE_CHECKING:  # who only checks a recipe does not wait for the arm's kinematics
    from scuhand_bt.run.control import Control
    from scuhand_bt.run.operator import Person
    from scuhand_bt.run.session import Session
    from scuhand_bt.run.simulation import DryRun, Rehearsal, Simulation

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


class HowRun(How, total=False):
    """How a recipe is run to its end, and who is told."""

    on_sample: OnSample | None
    on_event: OnEvent | None


class HowSimulated(HowRun, total=False):
    """How a recipe is run on simulated or twin devices."""

    seed: int
    """Of all randomness; 0 without."""
    plant: str | None
    """Physics of your own, `module:Class`."""
    faults: str | Path | None
    """A fault file: what goes wrong (`docs/faults.md`)."""


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

    def require_cell(self) -> Lab:
        """The lab, where the cell's own file is sound. SourceError with all that is wrong where it is not."""
        return with_cell(self.lab)

    def check(self, recipe: Given | None = None, *, fast: bool = False) -> Checked:
        """All that `run` would refuse, and what is most likely not meant, each with its place; nothing moves.

        Without a recipe the lab itself. `fast` leaves out the planning of the arm's ways.
        """
        return check(self.lab, _given(recipe) if recipe is not None else None, fast=fast)

    def plan(self, recipe: Given) -> Plan:
        """The recipe's jobs in their order. SourceError with all that is wrong."""
        lab = self.require_cell()
        return make_plan(load_recipe(_given(recipe), lab), lab)

    def notes(self, plan: Plan, *, ways: bool = False) -> list[Problem]:
        """What a run of a plan on the real cell would be refused for, or ask, by what the lab knows of it now.

        With `ways` the arm's ways are planned, too, as `check` does: seconds, unless that was done before.
        """
        return [*on_the_cell(plan, self.lab), *(ways_lacking(plan, self.lab) if ways else ())]

    def doubts(self, plan: Plan) -> list[Problem]:
        """What `check` warns of the samples of a plan: that fewer than is asked for will be in tolerance."""
        return doubts(plan, self.lab)

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

    def dry_run(self, recipe: Given | Plan, **how: Unpack[HowSimulated]) -> Result:
        """Run a recipe on simulated devices, at once.

        SourceError for what is wrong, SkillFailed for places without a way between them, PlantError for physics that
        cannot be used.
        """
        from scuhand_bt.run.simulation import DryRun

        with TemporaryDirectory() as scratch:
            how.setdefault("journals", Path(scratch) / "runs")
            return self._simulated(recipe, DryRun, how)

    def rehearse(self, recipe: Given | Plan, **how: Unpack[HowSimulated]) -> Result:
        """The same in real time, by the real drivers, against twins of the devices. Also NoCompiler without one."""
        from scuhand_bt.run.simulation import Rehearsal

        return self._simulated(recipe, Rehearsal, how)

    def run(self, recipe: Given | Plan, *, operator: str, pin: str | None = None, **how: Unpack[HowRun]) -> Result:
        """Run a recipe on the devices of `robot/cell.yaml`: real ones, or twins that another program has put there.

        `operator` is who is at the cell. What this person is asked waits for an answer in this terminal, on the
        dashboard or by `scuhand-bt answer`. Ctrl-C ends the run safe; a skill that hangs is not ended here, as the
        command's supervisor does. Also raises ValueError for a name that is none, and without the PIN of who has one.
        """
        return self._ran(recipe, None, how, person_of(self.state, operator, pin))

    def _simulated(self, recipe: Given | Plan, kind: "type[DryRun] | type[Rehearsal]", how: HowSimulated) -> Result:
        from scuhand_bt.sim.fault_rules import read_faults

        seed, plant, file = how.pop("seed", 0), how.pop("plant", None), how.pop("faults", None)
        faults = read_faults(Path(file)) if file is not None else None
        return self._ran(recipe, kind(seed, plant, faults=faults), cast(HowRun, how))

    def _ran(
        self, recipe: Given | Plan, simulation: "Simulation | None", how: HowRun, person: "Person | None" = None
    ) -> Result:
        on_sample, on_event = how.pop("on_sample", None), how.pop("on_event", None)
        return ran(self.prepare(recipe, simulation, person=person, **cast(How, how)), on_sample, on_event)


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


def ran(session: "Session", on_sample: OnSample | None, on_event: OnEvent | None) -> Result:
    """What a session comes to, which is closed then."""
    from scuhand_bt.run.observers import BatchObserver

    class Samples(BatchObserver):
        def sample_ended(self, result: SampleResult) -> None:
            if on_sample is not None:
                on_sample(result)

    with closing(session, on_event):
        came = session.run(Samples())
    notices = tuple(session.notices)
    return Result(session.run_id, came.samples, int(came.exit_code), came.reason, came.duration_s, notices)


def person_of(state: Path, operator: str, pin: str | None) -> "Person":
    """Who that is at the cell. ValueError for a name that is none, and without the PIN of who has one there."""
    from scuhand_bt.lab_state.persons import Persons, person_name
    from scuhand_bt.run.operator import Person

    name, persons = person_name(operator), Persons(state)
    if name not in persons.names():
        return Person(name)
    if pin is None or not persons.is_pin(name, pin):
        raise ValueError(f"{name} signs with a PIN: " + ("give it" if pin is None else "this is not it"))
    return Person(name, lambda given: persons.is_pin(name, given))


def _given(recipe: Given) -> Path | Mapping[str, Any]:
    return recipe if isinstance(recipe, Mapping) else Path(recipe)
