"""Runs that were begun before, here or in another process: what each has left, and what is said to one that goes on."""

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scuhand_bt.api.results import Result
from scuhand_bt.journal.archive import (
    ABOUT_TO_BEGIN,
    Summary,
    frames,
    is_about_to_begin,
    story,
    summaries,
    summary,
    told_story,
)
from scuhand_bt.journal.copies import make_one_file
from scuhand_bt.journal.export import canonical_of
from scuhand_bt.journal.follow import Follower
from scuhand_bt.journal.hash_chain import NO_ENTRY, Verified
from scuhand_bt.journal.kinds import parsed
from scuhand_bt.journal.presence import Held, is_held
from scuhand_bt.journal.reader import Contents, open_contents, open_verified
from scuhand_bt.journal.results import SampleResult
from scuhand_bt.journal.run_events import Ended, Resumed, RunBegun
from scuhand_bt.journal.telling import EVENTS, RunEvent, event_of
from scuhand_bt.lab import find_state
from scuhand_bt.lab_state.ledger import Ledger
from scuhand_bt.problems import Mark, Problem, SourceError
from scuhand_bt.run.resume import find_run as journal_named

if TYPE_CHECKING:
    from scuhand_bt.run.control import Wish
    from scuhand_bt.run.questions import Question


SILENT = "it does not answer"
NEVER_WAS = "the run was ended before anything was written down, and nothing had moved: start it anew"
_KINDS = tuple(event.KIND for event in (RunBegun, SampleResult, Ended, Resumed))
_TOLD = f"SELECT kind, payload FROM entry WHERE kind IN ({', '.join('?' * len(_KINDS))}) ORDER BY seq"


class NotHeard(Exception):  # noqa: N818 - it says what is so
    """What was said to a run has changed nothing: it does not go on, does not answer, or does not accept it."""


@dataclass(frozen=True)
class PastRun:
    """A run by its journal's file, whatever state it is in; nothing is read before it is asked for.

    What is read of it raises SourceError for a file that is no journal, of a newer version, or damaged; `result`,
    `events` and `export` also for a journal that is not as it was written. What is told to it raises NotHeard.
    """

    path: Path

    @property
    def id(self) -> str:
        return self.path.stem

    @property
    def state(self) -> Path:
        """The folder of its lab's journals, inventory and ledger."""
        return self.path.absolute().parent.parent

    @property
    def is_going_on(self) -> bool:
        """Whether a process has it now, though its lock may have been deleted."""
        from scuhand_bt.run.control import listens

        return is_held(self.path) or listens(self.path)

    @property
    def is_about_to_begin(self) -> bool:
        """Whether a process has it that has written nothing of it yet."""
        return is_about_to_begin(self.path)

    def summary(self) -> Summary:
        """The run in a line: its state, how many samples are good. Not verified; a file that is none says why."""
        return summary(self.path)

    def problem(self) -> str | None:
        """Where its journal is no longer as it was written; None for one that is."""
        self._require_begun()
        with open_verified(self.path) as (_, _, verified):
            return None if self._never_was(verified) else verified.problem

    @contextmanager
    def opened(self, head: str | None = None) -> Iterator[Contents]:
        """All that its journal holds, verified: what reports and proofs are made of. `head`: what its chain ends in.

        Also SourceError for a run that was ended before anything was written down.
        """
        self._require_begun()
        with open_contents(self.path, head) as contents:
            if self._never_was(contents.verified):
                raise SourceError([Problem(Mark(str(self.path)), NEVER_WAS)])
            yield contents

    def result(self) -> Result:
        """What it came to, or has come to until now: as `dry_run` and `run` give it, without their notices."""
        found: dict[str, SampleResult] = {}
        planned: list[str] = []
        ended: Ended | None = None
        with self._whole() as contents:
            for kind, payload in contents.database.execute(_TOLD, _KINDS):
                match parsed(kind, json.loads(payload)):
                    case RunBegun() as begun:
                        planned = [sample.id for sample in begun.samples or ()]
                    case SampleResult() as sample:
                        found[sample.id] = sample
                    case Ended() | Resumed() as last:
                        ended = last if isinstance(last, Ended) else None
            (duration_s,) = contents.database.execute("SELECT MAX(time_s) FROM entry").fetchone()
        place = {name: number for number, name in enumerate(planned)}
        samples = tuple(sorted(found.values(), key=lambda sample: place.get(sample.id, len(place))))
        code, reason = (ended.exit_code, ended.reason) if ended is not None else (None, "")
        return Result(self.id, samples, code, reason, duration_s or 0.0, ())

    def events(self) -> Iterator[RunEvent]:
        """All that happened in it, in order: what `on_event` was told."""
        with self._whole() as contents:
            yield from map(event_of, contents.database.execute(EVENTS))

    def story(self) -> dict[str, Any]:
        """What happened in it, as nested plain values: samples, jobs with their actions, whether its chain is whole."""
        with self.opened() as contents:
            return story(contents)

    @contextmanager
    def told(self) -> Iterator[dict[str, Any]]:
        """The same, but `samples` and `run` are iterators, for once: of a long run not all is in memory."""
        with self.opened() as contents:
            yield told_story(contents)

    def frames(self, sample: str) -> list[dict[str, Any]]:
        """Every line that the balance sent while it weighed for a sample. Also SourceError for one without any."""
        with self.opened() as contents:
            return frames(contents, sample)

    def export(self) -> str:
        """The canonical export, as JSON text: equal for equal runs."""
        with self._whole() as contents:
            return canonical_of(contents)

    def follow(self) -> Follower:
        """What becomes of it, by one `look` after the other; nothing is verified."""
        return Follower(self.path)

    def make_one_file(self) -> bool:
        """Take the log that a killed run has left into its journal; whether there was one. NotHeard while it goes on.

        SourceError where the files cannot be written.
        """
        try:
            return make_one_file(self.path)
        except Held:
            raise NotHeard("it goes on") from None

    def wish(self, wish: "Wish", by: str | None = None, pin: str | None = None) -> None:
        """Pause it, let it continue, or stop it, in whatever process of this computer it goes on.

        `by` is who wishes it, `pin` what proves that; without them it is the system's user.
        """
        from scuhand_bt.run.control import say_wish

        self._heard(lambda: say_wish(self.path, wish, by, pin))

    def question(self) -> "Question | None":
        """What it waits for a person with; None for nothing, or where it does not go on. NotHeard if it is silent."""
        from scuhand_bt.run.control import waiting_question

        try:
            return waiting_question(self.path)
        except TimeoutError:
            raise NotHeard(SILENT) from None

    def answer(self, question: "Question", choice: str, by: str | None = None, pin: str | None = None) -> None:
        """Give one of a question's choices; the first answer counts. `by` and `pin` as of `wish`."""
        from scuhand_bt.run.control import say_answer

        self._heard(lambda: say_answer(self.path, question, choice, by, pin))

    def balance(self) -> tuple[float, float, bool] | None:
        """What its balance shows now: run time [s], gross [mg], whether it is stable; None where nobody says it."""
        from scuhand_bt.run.control import balance_now

        try:
            return balance_now(self.path)
        except TimeoutError:  # too busy, or stopped
            return None

    @contextmanager
    def _whole(self) -> Iterator[Contents]:
        with self.opened() as contents:
            if (problem := contents.verified.problem) is not None:
                what = f"the journal is not as it was written: {problem}"
                raise SourceError([Problem(Mark(str(self.path)), what)])
            yield contents

    def _never_was(self, verified: Verified) -> bool:
        """Whether nothing was ever written down: the ledger has a line of every run that has a first entry."""
        return verified.problem == NO_ENTRY and not Ledger(self.state).verified().of(self.id)

    def _require_begun(self) -> None:
        if self.is_about_to_begin:
            what = f"{ABOUT_TO_BEGIN}: nothing can be read yet; try again in some seconds"
            raise SourceError([Problem(Mark(str(self.path)), what)])

    def _heard(self, say: Callable[[], str | None]) -> None:
        from scuhand_bt.run.control import HEARD

        try:
            said = say()
        except TimeoutError:
            raise NotHeard(SILENT) from None
        if said is None:
            being_begun = "another process is about to begin or to resume it"
            raise NotHeard(being_begun if is_held(self.path) else "it is not running")
        if said != HEARD:
            raise NotHeard(said)


def find_run(run: str | Path, lab: str | Path | None = None) -> PastRun:
    """A run by its id, a unique beginning of it, `last`, or its journal's file.

    Looked for in this lab, else the one around this folder; nothing of the lab is read. SourceError if there is none.
    """
    path = Path(run)
    if path.suffix == ".sqlite":
        return PastRun(path)
    try:
        return PastRun(journal_named(runs_folder(lab), str(run)))
    except SourceError:
        if path.is_file():
            return PastRun(path)
        raise


def runs(lab: str | Path | None = None) -> list[Summary]:
    """All runs of a lab, the newest first; nothing is verified, and one that cannot be read says why."""
    return summaries(runs_folder(lab))


def runs_folder(lab: str | Path | None = None) -> Path:
    """Where the journals of a lab are, else of the one around this folder. SourceError if that was never a lab."""
    return find_state(Path(lab) if lab is not None else None) / "runs"
