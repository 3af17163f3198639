"""A run as it is now, by its journal, for whoever watches from another process: each look reads only what is new."""

import json
from dataclasses import dataclass, field
from pathlib import Path

from scuhand_bt.failures import SkillFailed
from scuhand_bt.journal.events import (
    ActionEnded,
    ActionStarted,
    Answered,
    Asked,
    Continued,
    Ended,
    JobEnded,
    JobResumed,
    JobStarted,
    Paused,
    Resumed,
    RunBegun,
)
from scuhand_bt.journal.kinds import parsed
from scuhand_bt.journal.reader import open_journal
from scuhand_bt.journal.results import SampleResult

_TOLD_BY = (
    *(RunBegun, Resumed, JobStarted, JobResumed, JobEnded, ActionStarted, ActionEnded, SampleResult),
    *(Asked, Answered, Paused, Continued, Ended),
)
_KINDS = tuple(event.KIND for event in _TOLD_BY)


@dataclass
class ActionNow:
    """An action of the job that is under way."""

    skill: str
    outcome: str | None = None
    """None while it goes on."""
    failure: SkillFailed | None = None


@dataclass
class Follower:
    """Follows the journal at `path`; `look` brings it up to date. Nothing is verified."""

    path: Path
    begun: RunBegun | None = None
    samples: dict[str, SampleResult] = field(default_factory=dict)
    """What was said of each last, the newest last."""
    job: JobStarted | None = None
    actions: dict[int, ActionNow] = field(default_factory=dict)
    """Of that job, by the entries that they began with."""
    asked: Asked | None = None
    """The question that waits, and since when (ISO 8601)."""
    asked_at: str = ""
    is_paused: bool = False
    ended: Ended | None = None
    time_s: float = 0.0
    """Run time of the last entry."""
    _seq: int = 0
    _asked_in: int | None = None

    def look(self) -> list[SampleResult]:
        """Read what is new, and return the results among it. Raises SourceError as `open_journal`."""
        results = []
        marks = ", ".join("?" * len(_KINDS))
        query = (
            f"SELECT seq, action, at, time_s, kind, payload FROM entry WHERE seq > ? AND kind IN ({marks}) ORDER BY seq"
        )
        with open_journal(self.path) as (database, _):
            for seq, action, at, time_s, kind, payload in database.execute(query, (self._seq, *_KINDS)):
                self._seq, self.time_s = seq, time_s
                event = parsed(kind, json.loads(payload))
                self._take(seq, action, at, event)
                if isinstance(event, SampleResult):
                    results.append(event)
        return results

    def _take(self, seq: int, action: int | None, at: str, event: object) -> None:
        match event:
            case RunBegun():
                self.begun = event
            case JobStarted():
                self.job, self.actions = event, {}
            case ActionStarted():
                self.actions[seq] = ActionNow(event.skill)
            case ActionEnded() if action is not None:
                if action in self.actions:
                    self.actions[action] = ActionNow(self.actions[action].skill, event.outcome, event.failure)
                if action == self._asked_in:
                    self.asked = None
            case SampleResult():
                self.samples.pop(event.id, None)
                self.samples[event.id] = event
            case Asked():
                self.asked, self.asked_at, self._asked_in = event, at, action
            case Answered():
                self.asked = None
            case Paused() | Continued():
                self.is_paused = isinstance(event, Paused)
            case Ended() | Resumed():
                self.ended = event if isinstance(event, Ended) else None
                self.asked, self.is_paused = None, False
