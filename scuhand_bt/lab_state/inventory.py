"""The inventory: what is believed to be in a cell from one run to the next, in the lab's database.

What a run believes (`Cell.believed`, corrected by all that the balance saw) is kept after every job; a person
corrects it with `scuhand-bt inventory set`. Rows are only ever added: the last one of a thing counts, the others are
its history. What was simulated is kept apart, and never read by a run.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

from scuhand_bt.cell.cell import Cell
from scuhand_bt.clock import wall_time
from scuhand_bt.lab_state.lab_db import reading_lab_db, user_name, writing_lab_db
from scuhand_bt.problems import SourceError
from scuhand_bt.quantity import format_mass

StockKind = Literal["station", "cone", "sheet", "changer", "container"]
_COLUMNS = "kind, name, powder, lot, mass_mg, used, run, operator, at, reason"
STOCK_KINDS: tuple[StockKind, ...] = ("station", "cone", "sheet", "changer", "container")


@dataclass(frozen=True)
class StockEntry:
    """One thing: the powder at a station or in the cone, the sheet, the changer's slots, a kind of container."""

    kind: StockKind
    name: str = ""
    """The station of a mortar or a vessel, or the kind of container; of the changer, one that has slots of its own."""
    powder: str = ""
    """At a station or in the cone; what the sheet has touched. "" for a fresh one, and what is empty."""
    lot: str = ""
    mass_mg: float | None = None
    used: int | None = None
    """Sheets (this one counts), slots of the changer since it was filled, or containers of this kind."""
    run: str | None = field(default=None, compare=False)
    operator: str | None = field(default=None, compare=False)
    at: str = field(default="", compare=False)
    reason: str | None = field(default=None, compare=False)
    """Why an operator has corrected it, if that was said."""

    @property
    def lot_key(self) -> str:
        """As `Source.sheet_key`: one powder of one lot."""
        return f"{self.powder}/{self.lot}" if self.lot else self.powder

    @property
    def origin(self) -> str:
        """Who says so, and since when."""
        who = f"operator {self.operator}" if self.operator is not None else f"run {self.run}"
        return f"{who}, {self.at}"

    @property
    def place(self) -> str:
        """What `inventory set` calls it."""
        return f"changer/{self.name}" if self.kind == "changer" and self.name else self.name or self.kind

    @property
    def in_words(self) -> str:
        """How much, or how many; `about` so much powder where a run says so, which has weighed what it dosed only."""
        match self.kind:
            case "station" | "cone":
                is_reckoned = self.run is not None and self.powder
                return ("about " if is_reckoned else "") + format_mass(self.mass_mg or 0.0)
            case "sheet":
                return f"number {self.used}, {'touched' if self.powder else 'fresh'}"
            case _:
                return f"{self.used} used"


Stock = Mapping[tuple[StockKind, str], StockEntry]
"""The last entry of each thing, by its kind and name."""


class Inventory:
    """The inventory of one cell; `folder` holds the lab's database. See `lab_db.py` for the errors of reading."""

    def __init__(self, folder: Path, cell: str) -> None:
        self._folder = folder
        self._cell = cell
        self._kept: dict[bool, dict[tuple[StockKind, str], StockEntry]] = {}

    def stock(self, *, simulated: bool) -> Stock:
        """What is known now."""
        with reading_lab_db(self._folder) as database:
            if database is None:
                return {}
            rows = database.execute(
                f"SELECT {_COLUMNS} FROM inventory WHERE id IN "
                "(SELECT max(id) FROM inventory WHERE cell = ? AND simulated = ? GROUP BY kind, name)",
                (self._cell, simulated),
            )
            entries = (StockEntry(*row) for row in rows)
            return {
                (entry.kind, entry.name): entry for entry in sorted(entries, key=lambda e: STOCK_KINDS.index(e.kind))
            }

    def keep(self, cell: Cell, run: str) -> str | None:
        """Write what has changed of a run's belief since it was last written; what went wrong, or None."""
        return self.keeping(cell, run)()

    def keeping(self, cell: Cell, run: str) -> Callable[[], str | None]:
        """As `keep`, of what is believed now, to be called where nobody waits for a disk."""
        believed, simulated = list(_believed(cell)), cell.simulated

        def keep() -> str | None:
            try:
                kept = self._kept.setdefault(simulated, self._to_go_on_from(cell, simulated=simulated))
                news = [entry for entry in believed if kept.get((entry.kind, entry.name)) != entry]
                if news:
                    self._write(news, simulated, run, None)
                kept |= {(entry.kind, entry.name): entry for entry in news}
            except SourceError as error:
                return str(error)
            return None

        return keep

    def _to_go_on_from(self, cell: Cell, *, simulated: bool) -> dict[tuple[StockKind, str], StockEntry]:
        """What need not be written again: counts of slots that were divided otherwise are followed by new ones."""
        stock = dict(self.stock(simulated=simulated))
        if counted_otherwise(cell.spec.changer.kinds, stock) is None:
            return stock
        return {key: entry for key, entry in stock.items() if entry.kind != "changer"}

    def enter(self, entry: StockEntry, operator: str | None = None) -> None:
        """A correction of the real cell, by this operator, or the user of the computer."""
        self._write([entry], False, None, operator or user_name())

    def corrections(self) -> list[StockEntry]:
        """All that operators have corrected, in order."""
        with reading_lab_db(self._folder) as database:
            query = f"SELECT {_COLUMNS} FROM inventory WHERE cell = ? AND operator IS NOT NULL ORDER BY id"
            return [StockEntry(*row) for row in database.execute(query, (self._cell,))] if database is not None else []

    def _write(self, entries: Iterable[StockEntry], simulated: bool, run: str | None, operator: str | None) -> None:
        at = wall_time()
        rows = [
            (self._cell, simulated, e.kind, e.name, e.powder, e.lot, e.mass_mg, e.used, run, operator, at, e.reason)
            for e in entries
        ]
        with writing_lab_db(self._folder, durable=not simulated) as database:
            database.executemany(
                f"INSERT INTO inventory (cell, simulated, {_COLUMNS}) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
                rows,
            )


def counted_otherwise(kinds: Sequence[str], stock: Stock) -> StockEntry | None:
    """The last count of the changer's slots, where that is of slots that were divided otherwise than they are now.

    `kinds` are those that now have slots of their own, none where the changer is filled in the plan's order.
    """
    counts = [entry for entry in stock.values() if entry.kind == "changer"]
    if not counts:
        return None
    last = max(counts, key=_entered)
    is_of_now = any(entry.name in (kinds or ("",)) and _entered(entry) == _entered(last) for entry in counts)
    return None if is_of_now else last


def _entered(entry: StockEntry) -> datetime:
    return datetime.fromisoformat(entry.at) if entry.at else datetime.min.replace(tzinfo=UTC)


def _believed(cell: Cell) -> Iterator[StockEntry]:
    """What a cell believes now, as entries."""
    believed = cell.believed
    for name, source in cell.sources.items():
        yield StockEntry("station", source.station, source.powder.name, source.lot, mass_mg=believed.sources_mg[name])
    source_of_cone = cell.sources.get(believed.cone_source or "")
    if source_of_cone is None:
        yield StockEntry("cone", mass_mg=0.0)
    else:
        yield StockEntry("cone", "", source_of_cone.powder.name, source_of_cone.lot, mass_mg=believed.cone_mg)
    for station, held in believed.vessels.items():
        powder, _, lot = (held.lot or "").partition("/")
        yield StockEntry("station", station, powder, lot, mass_mg=held.mass_mg)
    powder, _, lot = (believed.sheet or "").partition("/")
    yield StockEntry("sheet", "", powder, lot, used=believed.sheets_used)
    if not cell.changer.needs_person:
        if not (kinds := cell.spec.changer.kinds):
            yield StockEntry("changer", used=believed.slots_used)
        for kind in kinds:
            yield StockEntry("changer", kind, used=believed.slots_of_kinds.get(kind, 0))
    for kind, used in believed.containers_used.items():
        yield StockEntry("container", kind, used=used)
