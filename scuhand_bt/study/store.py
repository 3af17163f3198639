"""Stores trials on disk by what was tried and the seed, so that a study can be continued and enlarged."""

import hashlib
import json
import sqlite3
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import asdict, replace
from pathlib import Path

from platformdirs import user_cache_path

from scuhand_bt.problems import Mark, Problem, SourceError
from scuhand_bt.program import source_digest
from scuhand_bt.study.change import files_hash, modules_hash
from scuhand_bt.study.trial import SampleTrial, Setup, Task, Trial

RECIPES_KEPT = 64
"""How many recipes' trials the user's cache keeps, the last used ones. Files of deleted recipes thus disappear."""
_SCHEMA = "CREATE TABLE IF NOT EXISTS trial (tried TEXT, seed INTEGER, figures TEXT, PRIMARY KEY (tried, seed))"
_TABLES = "SELECT name FROM sqlite_master WHERE type = 'table'"


class Store:
    """Trials in one SQLite file."""

    def __init__(self, database: sqlite3.Connection, setup: Setup) -> None:
        self._database = database
        self._files = _read_as(setup)

    def found(self, tasks: Iterable[Task]) -> Iterator[tuple[Task, Trial]]:
        """Those of the tasks that were tried before, with exactly today's files and program."""
        for setup, seed in tasks:
            row = self._database.execute(
                "SELECT figures FROM trial WHERE tried = ? AND seed = ?", (self._key(setup), seed)
            ).fetchone()
            if row is not None and (kept := _read(row[0])) is not None:
                yield (setup, seed), kept

    def keep(self, setup: Setup, trial: Trial) -> None:
        """Store a trial at once."""
        row = self._key(setup), trial.seed, json.dumps(asdict(trial))
        self._database.execute("INSERT OR REPLACE INTO trial VALUES (?, ?, ?)", row)
        self._database.commit()

    def _key(self, setup: Setup) -> str:
        ordered = [setup.order] if setup.order is not None else []
        tried = json.dumps([self._files, setup.controller, setup.plant, setup.changes, *ordered])
        return hashlib.sha256(tried.encode()).hexdigest()


class _Cache(Store):
    """A store whose loss costs only time: trials that cannot be read are made again, errors in writing are ignored."""

    def found(self, tasks: Iterable[Task]) -> Iterator[tuple[Task, Trial]]:
        with suppress(sqlite3.Error):
            yield from super().found(tasks)

    def keep(self, setup: Setup, trial: Trial) -> None:
        with suppress(sqlite3.Error):
            super().keep(setup, trial)


def _read(figures: str) -> Trial | None:
    """A stored trial; None if it is damaged, so that it is made again."""
    with suppress(ValueError, TypeError, KeyError):
        found = json.loads(figures)
        return replace(Trial(**found), samples=tuple(SampleTrial(**one) for one in found["samples"]))
    return None


def _read_as(setup: Setup) -> str:
    """Everything on disk that a trial depends on: files, program, the user's own modules."""
    files = setup.files or files_hash(setup.recipe, setup.lab)
    modules = setup.modules or modules_hash(setup.plant, setup.lab)
    return json.dumps([files, source_digest(), *([modules] if modules else [])])


@contextmanager
def open_store(path: Path, setup: Setup, kind: type[Store] = Store) -> Iterator[Store]:
    """The store in a file, which is made if there is none. Raises SourceError if it cannot be used."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _unusable(path, error) from None
    try:
        with closing(sqlite3.connect(path)) as database:
            if {name for (name,) in database.execute(_TABLES)} - {"trial"}:
                raise _unusable(path, "it is a database of something else")
            database.execute(_SCHEMA)
            yield kind(database, setup)
    except sqlite3.Error as error:
        raise _unusable(path, error) from None


@contextmanager
def last_tried(setup: Setup) -> Iterator[Store | None]:
    """The trials of this recipe, with today's files, in the user's cache. Those with earlier files are deleted.

    None if the file cannot be made.
    """
    folder = user_cache_path("scuhand_bt") / "trials"
    which = f"{setup.recipe.resolve()}\0{setup.lab.resolve()}"
    of, now = (hashlib.sha256(text.encode()).hexdigest()[:16] for text in (which, _read_as(setup)))
    path = folder / f"{of}-{now}.sqlite"
    with ExitStack() as opened:
        store = None
        with suppress(SourceError, OSError):
            store = opened.enter_context(open_store(path, setup, _Cache))
            path.touch()  # reading counts as use, too
            by_age = sorted(folder.glob("*.sqlite"), key=lambda one: one.stat().st_mtime, reverse=True)
            for gone in {*folder.glob(f"{of}-*.sqlite"), *by_age[RECIPES_KEPT:]} - {path}:
                gone.unlink()
        yield store


def _unusable(path: Path, why: Exception | str) -> SourceError:
    return SourceError([Problem(Mark(str(path)), f"the study cannot be kept there: {why}")])
