"""What is written down while a run goes on: the Protocol; the journal (`journal/writer.py`) implements it.

Everything that happens goes through the record before it goes anywhere else.
"""

from collections.abc import Mapping
from typing import Any, Protocol

from scuhand_bt.specs import Dose


class RecordLost(Exception):  # noqa: N818 - it says what happened
    """What happens cannot be written down any more; the run must end, safely."""


class Record(Protocol):
    """Where devices and skills write what they did and saw; times are the run's, in seconds."""

    def pulse(self, values: Mapping[str, Any]) -> None:
        """One opening of the valve, or one streamed segment: what was commanded and what was weighed."""
        ...

    def dose(self, dose: Dose) -> None:
        """The result for one container, in tolerance or not; the last one written for a job is its dose."""
        ...

    def event(self, kind: str, values: Mapping[str, Any]) -> None:
        """Anything else worth keeping: a scoop, a prompt and its answer, a fault."""
        ...


class NoRecord:
    """A record for benchmarks and tests, which keeps nothing."""

    def pulse(self, values: Mapping[str, Any]) -> None:
        pass

    def dose(self, dose: Dose) -> None:
        pass

    def event(self, kind: str, values: Mapping[str, Any]) -> None:
        pass
