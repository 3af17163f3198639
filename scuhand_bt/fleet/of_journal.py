"""What a run's journal says for the job that it was begun for."""

import sqlite3
from collections import Counter
from contextlib import closing, suppress
from pathlib import Path

from scuhand_bt.journal.history import History
from scuhand_bt.journal.reader import open_journal
from scuhand_bt.journal.results import SampleResult
from scuhand_bt.journal.run_events import RunBegun
from scuhand_bt.journal.store import read_only
from scuhand_bt.problems import Problem, SourceError


def key_of(journal: Path) -> str | None:
    """The key of the order that a run was begun for: its recipe is in the folder of that name. None: it has not begun.

    SourceError for a journal that cannot be read: whose it is nobody knows, and no run is to be begun twice.
    """
    query = f"SELECT json_extract(payload, '$.recipe_path') FROM entry WHERE kind = '{RunBegun.KIND}'"
    with suppress(OSError, sqlite3.Error), closing(read_only(journal)) as file:
        if file.execute("PRAGMA user_version").fetchone()[0] == 0:
            return None
    try:
        with open_journal(journal) as (database, _):
            row = database.execute(query).fetchone()
            return Path(row[0]).parent.name if row is not None else None
    except SourceError as error:
        what = "no job begins here meanwhile, as this may be a job's: bring it back, or move it away if it is no job's"
        raise SourceError([Problem(problem.mark, f"{problem.message}; {what}") for problem in error.problems]) from None


def came_to(history: History) -> str:
    """Why it ended, and how many samples with each verdict."""
    last = {sample: result for (sample, _), result in history.samples.items()}
    counts = ", ".join(f"{many} {words}" for words, many in Counter(map(_in_words, last.values())).items())
    why = (history.ended.reason or "done") if history.ended is not None else "it was killed"
    return f"{why} ({counts or 'no sample done'})"


def _in_words(result: SampleResult) -> str:
    is_doubtful = result.verdict == "in tolerance" and not result.is_good
    return f"{result.verdict} but not good" if is_doubtful else result.verdict
