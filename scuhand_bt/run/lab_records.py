"""What a run records in its lab besides its journal: ledger, inventory, what was learnt, and notifications.

None of it ends a run that has begun. What goes wrong is a journal entry, and a notice at the end.
"""

import time
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from datetime import datetime
from pathlib import Path

from scuhand_bt.cell.cell import Cell
from scuhand_bt.events.entry import Event, Note
from scuhand_bt.journal.events import Asked, PersonSoon
from scuhand_bt.journal.run_events import Paused, Trouble
from scuhand_bt.journal.writer import Journal
from scuhand_bt.lab import Lab
from scuhand_bt.lab_state.beliefs import LabState
from scuhand_bt.lab_state.inventory import Inventory, Stock
from scuhand_bt.lab_state.ledger import Ledger, Occasion
from scuhand_bt.problems import SourceError
from scuhand_bt.record import RecordLost
from scuhand_bt.run.notify import Notice, NoticeState, Notifier
from scuhand_bt.run.outcome import BatchResult
from scuhand_bt.run.simulation import DryRun, Simulation
from scuhand_bt.run.wall_clock import ClockWatch, disagreement


class LabRecords:
    """The lab's side of one run; `folder` keeps the lab's state. A run on the real cell starts from its `stock`.

    A run that is not `is_kept` records nothing. Raises SourceError for an unreadable lab database or an unusable key.
    """

    def __init__(
        self, folder: Path, lab: Lab, run: str, recipe: str, simulation: Simulation | None, *, is_kept: bool
    ) -> None:
        self.notices: list[str] = []
        """What went wrong besides the batch, such as a failed notification or an inventory that could not be written.
        """
        self.learnt = LabState(folder)
        self.ledger = Ledger(folder)
        self._inventory = Inventory(folder, lab.cell.cell)
        self.stock: Stock = self._inventory.stock(simulated=False) if simulation is None else {}
        self._run, self._recipe, self._simulation = run, recipe, simulation
        self._beside = ThreadPoolExecutor(max_workers=1, thread_name_prefix="inventory")
        self._notifier = Notifier(lab.cell.notify if is_kept else None)
        self._clock_watch = ClockWatch()
        self._is_kept = is_kept

    def begin(self, journal: Journal, cell: Cell) -> None:
        """From now on, receive every entry of the journal."""
        self._journal, self._cell = journal, cell
        if self._is_kept:
            journal.heard = self._heard

    def odd_clock(self, since: str | None) -> str | None:
        """What is odd about the clock, compared with this lab's last entry and the run's own last one (`since`)."""
        with suppress(SourceError):  # an unreadable ledger, which is reported when it is written
            last_at = max(filter(None, [self.ledger.last()[1], since]), key=datetime.fromisoformat, default=None)
            return disagreement(last_at)
        return None

    def after_job(self) -> None:
        """Write a real cell's inventory and the journal's head, on another thread than the tick."""
        if not self._cell.simulated:
            self._keep_inventory()
            self._beside.submit(self._anchor_job, *self._journal.last)

    def batch_ended(self) -> None:
        """Keep what was learnt and what is left. Raises RecordLost if the journal can no longer be written."""
        if self._is_kept:
            if (problem := self.learnt.keep(self._cell, self._run)) is not None:
                self._trouble(problem)
            self._keep_inventory()
        self._beside.shutdown()

    def came_to(self, result: BatchResult) -> None:
        """Notify how the run ended."""
        self._tell("ended" if result.is_complete else "stopped", result.reason, result)

    def finish_telling(self) -> None:
        """Wait for notifications under way."""
        for what in self._notifier.finish():
            self._trouble(what)

    def anchor_end(self) -> None:
        """Write the closed journal's head into the ledger."""
        if (problem := self.anchor("ended", *self._journal.last)) is not None:
            self.notices.append(problem)

    def anchor(self, occasion: Occasion, entries: int, head: str) -> str | None:
        """Write the journal's head into the lab's ledger; returns what went wrong, or None.

        Not that of a rescue copy elsewhere: whoever resumes the journal itself has another entry with this number.
        """
        if self._journal.kept_in != self._journal.path:
            return None
        try:
            self.ledger.add(self._run, occasion, entries, head, durable=not self._cell.simulated)
        except SourceError as error:
            return f"the run is not in the lab's ledger: {error}"
        return None

    def _heard(self, event: Event | Note) -> None:
        """Notify of journal entries that a person elsewhere should know of."""
        if (jump := self._clock_watch.jump()) is not None:
            self._trouble(jump)
        if isinstance(event, Paused):
            self._tell("paused")
        elif isinstance(event, Asked) and self._is_waited_for:
            self._tell("needs person", event.question, choices=event.choices)
        elif isinstance(event, PersonSoon) and self._is_waited_for:
            self._tell("person soon", str(event))

    @property
    def _is_waited_for(self) -> bool:
        """Whether questions go to a real person, who may be elsewhere."""
        return not isinstance(self._simulation, DryRun) or self._simulation.asks

    def _anchor_job(self, entries: int, head: str) -> None:
        """Write the ledger once the entries are on disk, so that it never has what a power cut took from the
        journal.
        """
        while self._journal.waits(entries) is not None:
            time.sleep(0.05)
        if (problem := self.anchor("job", entries, head)) is not None:
            with suppress(RecordLost):
                self._trouble(problem)

    def _keep_inventory(self) -> None:
        """Written on another thread than the tick, as the journal is."""
        keeping = self._beside.submit(self._inventory.keeping(self._cell, self._run))
        keeping.add_done_callback(self._kept_inventory)

    def _kept_inventory(self, keeping: Future[str | None]) -> None:
        if (problem := keeping.result()) is not None:
            with suppress(RecordLost):
                self._trouble(problem)

    def _tell(
        self, state: NoticeState, reason: str = "", result: BatchResult | None = None, choices: Sequence[str] = ()
    ) -> None:
        notice = Notice(
            self._run,
            self._recipe,
            self._cell.simulated,
            state,
            reason,
            result.exit_code if result is not None else None,
            Counter(sample.verdict for sample in result.samples) if result is not None else {},
            self._journal.head,
            choices=tuple(choices),
        )
        self._notifier.tell(notice)

    def _trouble(self, what: str) -> None:
        self.notices.append(what)
        self._journal.event(Trouble(what=what))
