"""Several cells on one queue: what a job is, what stations can do, and a station's work (`scuhand-bt station`)."""

from typing import TYPE_CHECKING

from scuhand_bt.fronts import front

if TYPE_CHECKING:
    from scuhand_bt.fleet.order import submission_of
    from scuhand_bt.fleet.queue import ABSENT_S, HELD_BACK, KnownStation, QueuedJob, choose, open_queue
    from scuhand_bt.fleet.station import Manner, Station
else:
    __getattr__, __dir__ = front(
        __name__,
        {
            "fleet.order": "submission_of",
            "fleet.queue": "ABSENT_S HELD_BACK KnownStation QueuedJob choose open_queue",
            "fleet.station": "Manner Station",
        },
    )

__all__ = [
    "ABSENT_S",
    "HELD_BACK",
    "KnownStation",
    "Manner",
    "QueuedJob",
    "Station",
    "choose",
    "open_queue",
    "submission_of",
]
