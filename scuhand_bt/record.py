"""What skills write down while a run goes on; everything that happens goes through the journal before anywhere else."""

from collections.abc import Callable, Mapping

from pydantic import JsonValue

from scuhand_bt.clock import Steps, Wake
from scuhand_bt.events.catalogue import SKILL_EVENTS
from scuhand_bt.events.doses import CurveRow
from scuhand_bt.events.entry import NOTE_PREFIX, Note, SkillEvent


class RecordLost(Exception):  # noqa: N818 - it says what happened
    """What happens cannot be written down any more; the run must end, safely."""


class Record:
    """The part of the journal that skills may write, `cell.record`: what they did and weighed, and a lab's own notes.

    The run's course and its verdicts are the engine's to write. `keep`, `waits` and `course` are the journal's; without
    them nothing is kept.
    """

    def __init__(
        self,
        keep: Callable[[SkillEvent | Note], None] = lambda event: None,
        waits: Callable[[], Wake | None] = lambda: None,
        course: Callable[[CurveRow], None] | None = None,
    ) -> None:
        self._keep = keep
        self._waits = waits
        self.course = course
        """Takes the points of a dose's course, one at each reading; None where nobody wants them."""

    def kept(self) -> Steps[None]:
        """Wait until all that was written is on disk: before what must not happen unless that is known."""
        while (writing := self._waits()) is not None:
            yield writing

    def event(self, event: SkillEvent, *more: object) -> None:
        """Write an entry of a shipped kind: `cell.record.event(Tared(...))`. Raises TypeError for anything else."""
        if more or type(event) not in SKILL_EVENTS:
            what = repr(event) if isinstance(event, str) else type(event).__name__
            kinds = ", ".join(one.__name__ for one in SKILL_EVENTS)
            raise TypeError(
                f"{what} is not an entry that a skill may write: write one of {kinds} (from scuhand_bt.skill), "
                f'or a kind of your own as `cell.record.note("{NOTE_PREFIX}…", {{…}})`'
            )
        self._keep(event)

    def note(self, kind: str, values: Mapping[str, JsonValue]) -> None:
        """Write an entry of a kind of the lab's own: `cell.record.note("lab.sieved", {"mesh_mm": 0.5})`.

        Raises ValueError for a kind without the prefix `lab.`, and for values that are no JSON.
        """
        self._keep(Note(kind, values))
