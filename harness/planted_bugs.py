"""Bugs that the program once had, planted again in the processes of an interleaving: the checker has to find each.

A bug is a change of the program in memory, and what has to happen for it to show. `script` may name the seed's own
moment (`{ticks}` within the first dose, `{later}` after it), so that another seed is another moment of the same story.
"""

import sqlite3
from collections.abc import Callable, Iterator
from contextlib import nullcontext, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from scuhand_bt.api import interrupted, past
from scuhand_bt.cell import pan_cleared
from scuhand_bt.cell.believed import Believed
from scuhand_bt.cli import run as cli_run
from scuhand_bt.exit_codes import ExitCode
from scuhand_bt.journal import store
from scuhand_bt.lab import find_lab, load_lab
from scuhand_bt.problems import SourceError
from scuhand_bt.record import Record, RecordLost
from scuhand_bt.report import proof
from scuhand_bt.run import batch, outcome, sample_results, session
from scuhand_bt.sim.world import World
from scuhand_bt.specs import Container
from scuhand_bt.tree import leaf

SEEDS = 12
"""So many seeds are tried before a bug counts as not found."""


@dataclass(frozen=True)
class Bug:
    """One bug: what it is, how it is planted, and where it shows."""

    what: str
    plant: Callable[[], None]
    script: tuple[str, ...] = ()
    only: str = ""
    """What every power cut does."""
    careless: str = ""

    def at(self, seed: int) -> tuple[str, ...]:
        """The script of this seed."""
        return tuple(step.format(ticks=155 + 6 * seed, later=340 + 6 * seed) for step in self.script)


def _reads_before_locking() -> None:
    interrupted.take_run = lambda journal: nullcontext(None)  # type: ignore[assignment,return-value]
    made = session.Session.__init__

    def make(one: Any, *given: Any, resumes: Any = None, **options: Any) -> None:
        if resumes is not None:
            with sqlite3.connect(resumes.path) as database:
                (head,) = database.execute("SELECT hash FROM entry ORDER BY seq DESC LIMIT 1").fetchone()
            resumes = replace(resumes, history=replace(resumes.history, head=head.hex()))
        made(one, *given, resumes=resumes, **options)

    session.Session.__init__ = make  # type: ignore[method-assign]


def _does_not_look(says: str) -> None:
    """The journal's file is looked at as before, but this is not seen."""
    look = store.Store.look

    def looks(one: store.Store) -> None:
        try:
            look(one)
        except RecordLost as lost:
            if says not in str(lost):
                raise

    store.Store.look = looks  # type: ignore[method-assign]


def _appends_behind_anything() -> None:
    _does_not_look(store.OVERTAKEN)
    store._INSERT = store._INSERT.replace("INSERT", "INSERT OR REPLACE")


def _misses_no_file() -> None:
    _does_not_look("taken away")


def _believes_what_arrived() -> None:
    def settles(*given: Any) -> Iterator[Any]:
        return
        yield

    def anything(*given: Any) -> tuple[float, float]:
        return -1e9, 1e9

    sample_results.confirmed = sample_results.doubted = lambda result, *told: result  # type: ignore[assignment]
    sample_results.SampleResults.note_open_brackets = lambda one: None  # type: ignore[method-assign]
    session.settle_outage = settles  # type: ignore[assignment]
    pan_cleared.possible_mg = anything


def _redo_collides() -> None:
    def inputs_for(sample: Any, attempt: int) -> dict[str, Any]:
        return {
            name: value.model_copy(update={"id": f"{value.id}.{attempt}"})
            if attempt > 1 and isinstance(value, Container)
            else value
            for name, value in sample.inputs.items()
        }

    batch.inputs_for = sample_results.inputs_for = outcome.inputs_for = inputs_for
    Believed.had_gone = lambda self, container: None  # type: ignore[method-assign]  # else it would be told what it got


def _says_all_is_well() -> None:
    watched = cli_run._watched
    cli_run._watched = lambda *given, **more: replace(watched(*given, **more), exit_code=ExitCode.OK)


def _ends_with_the_valve_open() -> None:
    def come_to_rest(one: Any, ended: str, result: Any) -> Any:
        if ended == "failed":
            one.failure = result
        else:
            one._keep(result)
        one._end(ended, result)
        return leaf.Status.FAILURE if ended == "failed" else leaf.Status.SUCCESS

    leaf.SkillLeaf._come_to_rest = come_to_rest  # type: ignore[method-assign]


def _lets_skills_write_anything() -> None:
    Record.event = lambda record, event, *more: record._keep(event)  # type: ignore[method-assign]


def _lets_skills_exit() -> None:
    bug_of = leaf.bug_of

    def of(name: str, error: BaseException) -> leaf.SkillBug:
        if isinstance(error, SystemExit):
            raise error
        return bug_of(name, error)

    leaf.bug_of = of


def _knows_no_ledger() -> None:
    proof._against = lambda *given: None


def _needs_the_lab() -> None:
    find = past.find_state

    def find_state(lab: Path | None = None) -> Path:
        if problems := load_lab(find_lab(chosen=lab)).problems:
            raise SourceError(problems)
        return find(lab)

    past.find_state = find_state


def _saves_the_world_no_more() -> None:
    save, left = World.save, [5]

    def saves(world: World) -> None:
        if left[0]:
            left[0] -= 1
            save(world)

    World.save = saves  # type: ignore[method-assign]


def _sees_no_full_disk() -> None:
    add = store.Store.add

    def adds(one: store.Store, rows: Any) -> None:
        try:
            add(one, rows)
        except sqlite3.Error:
            with suppress(sqlite3.Error):
                one.db.execute("ROLLBACK")

    store.Store.add = adds  # type: ignore[method-assign]
    _does_not_look("")


BUGS = {
    "resume.unlocked": Bug(
        "`resume` reads the history, waits, and only then takes the lock, without reading again",
        _reads_before_locking,
        ("begin:{ticks}", "kill@0", "resume", "resume", "go:1@1", "go:300@1", "kill@1", "finish@0"),
    ),
    "append.anywhere": Bug(
        "an entry is added whatever another process has added since",
        _appends_behind_anything,
        ("begin:{ticks}", "elsewhere", "go:30@1", "finish@0", "finish@0"),
    ),
    "outage.believed": Bug(
        "after an outage whatever seems to have arrived is believed",
        _believes_what_arrived,
        ("begin:{ticks}", "kill@0"),
        "outage.zero_moved",
    ),
    "redo.collides": Bug(
        "`redo` calls its container `<id>.2`, which is another sample's id, and what it got there is forgotten",
        _redo_collides,
        ("begin:{ticks}", "kill@0"),
        "outage.container_exchanged",
    ),
    "exit.zero": Bug(
        "an unfinished run ends with exit code 0", _says_all_is_well, ("begin:{ticks}", "stop --now", "finish@0")
    ),
    "exit.by_skill": Bug(
        "`sys.exit(0)` in a skill is the exit code of the run",
        _lets_skills_exit,
        ("begin:1", "finish@0"),
        careless="ends the program",
    ),
    "journal.removed": Bug(
        "a journal that is removed in mid-run goes unnoticed", _misses_no_file, ("begin:{ticks}", "lose@0", "finish@0")
    ),
    "journal.full": Bug("a full disk goes unnoticed", _sees_no_full_disk, ("begin:{ticks}", "full:1@0", "finish@0")),
    "skill.valve": Bug(
        "a skill may end with the valve open",
        _ends_with_the_valve_open,
        ("begin:1", "finish@0"),
        careless="leaves the valve open",
    ),
    "skill.ended": Bug(
        "a skill may write that the run has ended",
        _lets_skills_write_anything,
        ("begin:1", "finish@0"),
        careless="says that the run has ended",
    ),
    "verify.chain_only": Bug("`verify` accepts a journal that was written anew with a whole chain", _knows_no_ledger),
    "stop.needs_lab": Bug(
        "`stop` reads the lab, which somebody has half saved", _needs_the_lab, ("begin:{ticks}", "half_save", "stop")
    ),
    "world.lost": Bug(
        "a kill loses what had happened in the cell", _saves_the_world_no_more, ("begin:{later}", "kill@0")
    ),
}
