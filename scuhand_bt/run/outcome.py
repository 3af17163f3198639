"""How a job, and a whole run, came out."""

from dataclasses import dataclass
from typing import Literal

from scuhand_bt.journal.events import SampleResult
from scuhand_bt.skill import SkillFailed

Interruption = Literal["stopped", "paused", "tripped"]


@dataclass(frozen=True)
class Outcome:
    """How a job's tree ended: `failure` is None if it succeeded.

    `interrupted` says what halted the job before its end: a person's stop or pause, or a guard, whose reason
    `failure` then is.
    """

    failure: SkillFailed | None = None
    interrupted: Interruption | None = None


@dataclass(frozen=True)
class BatchResult:
    """How a run ended."""

    samples: tuple[SampleResult, ...]
    exit_code: int
    reason: str
    duration_s: float
    is_complete: bool
    """Nothing is left that could be resumed."""
