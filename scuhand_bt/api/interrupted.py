"""A run that was stopped or killed, and goes on: nothing is done twice."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from scuhand_bt.api.labs import OnEvent, OnSample, OpenLab, open_lab, person_of, ran
from scuhand_bt.api.past import PastRun, find_run
from scuhand_bt.api.results import Result
from scuhand_bt.journal.history import History
from scuhand_bt.quantity import format_duration, format_mass
from scuhand_bt.recipe.plan import Plan
from scuhand_bt.recipe.recipe import given_again
from scuhand_bt.run.holds import take_run
from scuhand_bt.run.options import Options, options_of
from scuhand_bt.run.resume import Resumable, checked_history, its_places, resumable
from scuhand_bt.run.session import Session

if TYPE_CHECKING:
    from scuhand_bt.run.control import Control
    from scuhand_bt.run.operator import Person


@dataclass(frozen=True)
class Interrupted:
    """An interrupted run that may go on; no other process can take it up meanwhile."""

    lab: OpenLab
    """Its lab, as it is now."""
    plan: Plan
    """Its recipe's, as it is now."""
    known: tuple[str, ...]
    """What is known of where it stands, and what is not, in lines for whoever lets it go on."""
    _options: Options
    _found: Resumable

    @property
    def changes(self) -> tuple[str, ...]:
        """What has changed in recipe, lab or program since it began, and was accepted."""
        return self._found.changes

    @property
    def is_on_the_cell(self) -> bool:
        """It goes on with the devices of `robot/cell.yaml`, and is no simulation."""
        return self._options.simulation is None

    def prepare(
        self,
        *,
        person: "Person | None" = None,
        may_torque: bool = False,
        attended: bool | None = None,
        control: "Control | None" = None,
    ) -> Session:
        """The run made ready to go on, once, in a `with closing(session)`. Raises as `Session`.

        `may_torque`: who resumes it has seen the arm, which may be held where it is if it has no torque. `attended`:
        whether somebody is there now and can be asked; None where it is as when the run was begun.
        """
        unattended = self._options.unattended if attended is None else not attended
        options = replace(self._options, person=person, may_torque=may_torque, unattended=unattended)
        return Session(self.plan, self.lab.lab, options, control=control, resumes=self._found)


@contextmanager
def take_up(run: PastRun, *, accept_changes: bool = False) -> Iterator[Interrupted]:
    """Have an interrupted run, from before its history is read: no other process resumes it beside this one.

    SourceError for a run that goes on, is complete, or whose journal is not as it was written; for what is wrong with
    its recipe or lab by now; and, unless `accept_changes`, for every change of recipe, lab or program since it began.
    """
    with take_run(run.path) as presence:
        history = checked_history(run.path)
        options = options_of(history, run.path.parent)
        recipe, folder = its_places(run.path, history.run)
        lab = open_lab(folder, recipe=recipe)
        plan = lab.plan(given_again(recipe, history.run.recipe_text))
        found = resumable(run.path, history, plan, lab.lab, accept_changes=accept_changes, presence=presence)
        known = what_is_known(history, len(plan.recipe.samples))
        yield Interrupted(lab, plan, tuple(known), options, found)


def resume(
    run: str | Path | PastRun = "last",
    *,
    lab: str | Path | None = None,
    operator: str | None = None,
    pin: str | None = None,
    accept_changes: bool = False,
    may_torque: bool = False,
    attended: bool | None = None,
    control: "Control | None" = None,
    on_sample: OnSample | None = None,
    on_event: OnEvent | None = None,
) -> Result:
    """Go on with a run that was stopped or killed, as it was begun, without doing anything twice.

    `run` and `lab` as `find_run` has them; `operator` and `pin` as of `OpenLab.run`, needed on the cell alone;
    `accept_changes`, `may_torque` and `attended` as of `take_up` and `Interrupted.prepare`. `on_event` is told from the
    first new entry. Raises as `find_run`, `take_up` and `Session` do, and ValueError for who is not named, or has not
    proven it.
    """
    its = run if isinstance(run, PastRun) else find_run(run, lab)
    with take_up(its, accept_changes=accept_changes) as found:
        if operator is None and found.is_on_the_cell:
            raise ValueError("a run on the cell needs a person's name: give it as `operator`")
        person = person_of(its.state, operator, pin) if operator is not None else None
        session = found.prepare(person=person, may_torque=may_torque, attended=attended, control=control)
        return ran(session, on_sample, on_event)


def what_is_known(history: "History", samples: int) -> list[str]:
    """What is known of an interrupted run, and what is not, for whoever lets it go on."""
    believed = history.state.get("believed", {})
    run, done = history.run, {sample for sample, attempt in history.samples if history.jobs[sample, attempt].is_over}
    lines = [
        f"{run.recipe} ({run.mode}): interrupted at {format_duration(history.time_s)} of run time; "
        f"the last entry is of {history.at}.",
        f"{len(done)} of {samples} samples are finished.",
    ]
    the_cone = "The cone"
    if (unfinished := history.unfinished()) is not None:
        job, name = unfinished
        open_ones = [recorded.skill for recorded in job.actions.values() if recorded.outcome not in ("done", "failed")]
        at_work = f" '{open_ones[-1]}' had begun and not ended: how far it came is not known yet." if open_ones else ""
        the_cone = "Before that action the cone" if open_ones else the_cone
        why = f", and had failed: {job.failure}; it is taken up where it failed" if job.failure is not None else ""
        lines.append(f"'{name}' was under way{why}.{at_work}")
    if believed:
        source, pan = believed["cone_source"], believed["pan"]
        cone = f"about {format_mass(believed['cone_mg'])} from '{source}'" if source else "no powder"
        on_pan = f"'{pan['id']}' ({pan['name']})" if pan else "nothing that is known"
        lines.append(f"{the_cone} held {cone}, and on the pan stood {on_pan}.")
    return lines
