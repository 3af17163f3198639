"""Finds an interrupted run, and decides whether it may be resumed: nothing altered, and no unnoticed changes."""

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import scuhand_bt
from scuhand_bt.journal.hash_chain import NO_ENTRY
from scuhand_bt.journal.history import History, history_of
from scuhand_bt.journal.presence import Presence
from scuhand_bt.journal.reader import open_verified
from scuhand_bt.journal.run_events import RunBegun
from scuhand_bt.journal.store import SCHEMA_VERSION
from scuhand_bt.lab import Lab, is_lab
from scuhand_bt.problems import Mark, Problem, SourceError
from scuhand_bt.quantity import listed
from scuhand_bt.recipe.plan import Job, Plan, recoveries, sheet_changes
from scuhand_bt.recipe.sample import Sample
from scuhand_bt.run.own_modules import digests, lab_modules


@dataclass(frozen=True)
class Resumable:
    """An interrupted run that may go on, and what has changed since (accepted by whoever resumes it)."""

    path: Path
    history: History
    changes: tuple[str, ...]
    presence: Presence | None = None
    """The lock that whoever resumes it has held since before the history was read; None if yet to be taken."""


def world_path(journal: Path) -> Path:
    """The file of a dry run's simulated world, beside its journal."""
    return journal.with_suffix(".world")


def find_run(folder: Path, name: str) -> Path:
    """The journal of a run by its id, a unique beginning of it, or `last`. Raises SourceError if there is none."""
    runs = sorted(folder.glob("*.sqlite"))
    if name == "last" and runs:
        return max(runs, key=_written_s)
    found = [path for path in runs if path.stem.startswith(name)] if name else []
    exact = [path for path in found if path.stem == name]
    if len(found) == 1 or exact:
        return (exact or found)[0]
    if found:
        what = f"'{name}' may be any of {len(found)} runs: {', '.join(path.stem for path in found[:5])}"
    else:
        what = f"there is no run '{name}'; `scuhand-bt runs` lists them"
    raise SourceError([Problem(Mark(str(folder)), what)])


def _written_s(path: Path) -> float:
    """When a journal was last written to; while its run goes on, that shows only in SQLite's log beside it."""
    written_s = path.stat().st_mtime
    with suppress(FileNotFoundError):
        written_s = max(written_s, path.with_name(f"{path.name}-wal").stat().st_mtime)
    return written_s


def checked_history(path: Path) -> History:
    """The history of a run whose hash chain is whole and that has something left to do. Raises SourceError if not."""
    with open_verified(path) as (database, version, verified):
        if version < SCHEMA_VERSION:
            what = "an older scuhand-bt wrote it, and recorded less than resuming needs"
            raise _refused(path, f"{what}: start a new run with the samples that are left")
        if verified.problem == NO_ENTRY:
            raise _refused(path, "the journal is empty: nothing had moved when the run ended; start a new run")
        if verified.problem is not None:
            raise _refused(path, f"the journal is not as it was written: {verified.problem}")
        history = history_of(database)
    if history.begun is None:
        raise _refused(path, "nothing had moved when the run ended; start a new run")
    if history.is_complete:
        raise _refused(path, f"the run is complete: {_left_of_complete(history)}")
    if history.lost_world:
        raise _refused(path, f"its simulated world could not be kept: {history.lost_world}; start a new run")
    return history


def _left_of_complete(history: History) -> str:
    """What a complete run left undone, and how to do that."""
    bad = [one for one in history.told.values() if not one.is_good]
    if not bad:
        return "nothing is left to do"
    named = listed([f"'{one.id}' ({', '.join(filter(None, (one.verdict, one.code)))})" for one in bad], "sample")
    return f"nothing is done again. Not good: {named}. For these, begin a new run, with a recipe of them alone"


def its_places(path: Path, run: RunBegun) -> tuple[Path, Path]:
    """Where a run's recipe and lab are now: a lab may have been moved as a whole."""
    recipe, lab, here = Path(run.recipe_path), Path(run.lab), path.absolute().parent.parent.parent
    if not is_lab(here):  # its journal is kept outside the lab
        return recipe, lab
    return (here / recipe.relative_to(lab) if recipe.is_relative_to(lab) else recipe), here


def resumable(
    path: Path,
    history: History,
    plan: Plan,
    lab: Lab,
    *,
    accept_changes: bool,
    presence: Presence | None = None,
) -> Resumable:
    """The run, if recipe, lab and program are unchanged or the changes are accepted; else raises SourceError.

    Some changes cannot be accepted (docs/run-behaviour.md, "What is refused"):

    * a job before one that has begun, which would change what is on the pan and in the cone;
    * other slots of the changer, by which used containers are known;
    * another powder in a source, by whose name the cone's content and what was learnt are known.
    """
    if overtaken := (*_overtaken(history, plan, lab), *_other_slots(history, lab), *_other_sources(history, plan)):
        raise SourceError([Problem(Mark(str(path)), what) for what in overtaken])
    changes = tuple(_changes(history, plan, lab))
    if changes and not accept_changes:
        hint = "--accept-changes resumes with what is there now, and notes it"
        raise SourceError([Problem(Mark(str(path)), f"since this run began, {change}; {hint}") for change in changes])
    return Resumable(path, history, changes, presence)


def _overtaken(history: History, plan: Plan, lab: Lab) -> Iterator[str]:
    """What had begun, and is no longer the next thing to do in this plan."""
    begun, names = {name for name, _ in history.jobs}, [job.name for job in plan.jobs]
    if (unfinished := history.unfinished()) is not None:
        samples = [job.sample for job in plan.jobs if job.sample is not None]
        unplanned = {job.name: sample.id for sample in samples for job in _unplanned(sample, plan, lab)}
        name = unplanned.get(unfinished[1], unfinished[1])
        if name not in names:
            yield f"'{name}' was under way, but this plan no longer has it. Put it back; to skip it, use `on_failure`"
    new = next((number for number, name in enumerate(names) if name not in begun), len(names))
    if (later := next((name for name in names[new:] if name in begun), None)) is not None:
        yield f"'{later}' had begun, but in this plan '{names[new]}' comes before it. Put new samples after it"


def _unplanned(sample: Sample, plan: Plan, lab: Lab) -> list[Job]:
    """Jobs that may precede or follow a sample without being in the plan, because one has failed."""
    return [*recoveries(sample), *sheet_changes(sample, plan.recipe, lab.library, lab.cell)]


def _other_slots(history: History, lab: Lab) -> Iterator[str]:
    changer = lab.cell.changer
    slots = history.run.devices.get("changer", {}).get("slots", changer.slots)
    if slots != changer.slots and changer.driver != "operator":
        was, now = _in_words(slots), _in_words(changer.slots)
        put_back = "put them back in robot/cell.yaml, or begin the rest as a new run"
        yield f"the changer's slots were {was} when this run began, and are {now} now; {put_back}"


def _other_sources(history: History, plan: Plan) -> Iterator[str]:
    for name, was in history.run.sources.items():
        now = plan.recipe.sources.get(name)
        if now is None:
            continue
        before = f"{was.powder}/{was.lot}" if was.lot else was.powder
        mortar = was.mortar or now.mortar.name  # older journals do not name it
        if (before, mortar) != (now.sheet_key, now.mortar.name):
            there = f"{before} in '{mortar}' when this run began, and is {now.sheet_key} in '{now.mortar.name}' now"
            yield f"source '{name}' was {there}; put it back in the recipe, or begin the rest as a new run"


def _in_words(slots: object) -> str:
    return ", ".join(f"{count} {kind}" for kind, count in slots.items()) if isinstance(slots, dict) else f"{slots}"


def _changes(history: History, plan: Plan, lab: Lab) -> Iterator[str]:
    if history.run.recipe_hash != plan.recipe.hash:
        yield f"the recipe {plan.recipe.path} or one of its tables has changed"
    yield from (f"the lab's {what}" for what in _differing(history.run.lab_files, lab.files))
    if history.run.modules is not None:
        now = digests(lab_modules(lab.folder))
        yield from (f"your own module {what}" for what in _differing(history.run.modules, now))
    if history.run.version != scuhand_bt.__version__:
        yield f"scuhand_bt {history.run.version} became {scuhand_bt.__version__}"


def _differing(before: Mapping[str, str], now: Mapping[str, str]) -> Iterator[str]:
    for name in sorted(before.keys() | now.keys()):
        if before.get(name) != now.get(name):
            what = "was added" if name not in before else "is gone" if name not in now else "has changed"
            yield f"{name} {what}"


def _refused(path: Path, what: str) -> SourceError:
    return SourceError([Problem(Mark(str(path)), what)])
