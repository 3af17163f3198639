"""What is learnt is kept: beliefs about powders and the balance, in the lab's `.scuhand/lab.db`.

Rows are only ever added; the last one of a name counts, the others are its history. What was learnt from
simulated devices is kept apart, and never read by a run: a real run must not believe a simulation, and a
dry run of one seed must not depend on the runs before it.
"""

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Generic, TypeVar

from scuhand_bt.cell.cell import Cell
from scuhand_bt.lab_state.lab_db import lab_db
from scuhand_bt.problems import SourceError
from scuhand_bt.specs import BalanceBelief, PowderBelief

B = TypeVar("B", PowderBelief, BalanceBelief)


@dataclass(frozen=True)
class Learnt(Generic[B]):
    """One belief as it was written: of a powder lot (`Source.sheet_key`), or of the cell's balance."""

    version: int
    name: str
    simulated: bool
    run: str
    at: str
    belief: B

    @property
    def origin(self) -> str:
        """Where it comes from, in a word."""
        return f"version {self.version}, {self.run}{', SIMULATED' if self.simulated else ''}"


class LabState:
    """What the lab's database says of powders and balances; see `lab_db` for the errors of all of this."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def powders(self, *, simulated: bool) -> dict[str, Learnt[PowderBelief]]:
        """The last belief about each powder lot; empty where nothing was ever learnt."""
        return self._latest("powder", PowderBelief, simulated)

    def balances(self, *, simulated: bool) -> dict[str, Learnt[BalanceBelief]]:
        """The last belief about each cell's balance."""
        return self._latest("balance", BalanceBelief, simulated)

    def recall(self, cell: Cell) -> None:
        """Give a real cell what was learnt on real devices."""
        cell.powder_beliefs |= {name: learnt.belief for name, learnt in self.powders(simulated=False).items()}
        balance = self.balances(simulated=False).get(cell.spec.cell)
        if balance is not None:
            cell.balance_belief = balance.belief

    def keep(self, cell: Cell, run: str) -> str | None:
        """Write what doses have taught a cell, where it is news; what went wrong, or None."""
        try:
            self._keep(cell, run)
        except SourceError as error:
            return str(error)
        return None

    def _keep(self, cell: Cell, run: str) -> None:
        powders, balances = self.powders(simulated=cell.simulated), self.balances(simulated=cell.simulated)
        news: list[tuple[str, str, PowderBelief | BalanceBelief]] = [
            ("powder", name, belief)
            for name, belief in cell.powder_beliefs.items()
            if belief.doses and (name not in powders or powders[name].belief != belief)
        ]
        name, belief = cell.spec.cell, cell.balance_belief
        if belief.fits and (name not in balances or balances[name].belief != belief):
            news.append(("balance", name, belief))
        if not news:
            return
        at = datetime.now().astimezone().isoformat(timespec="seconds")
        with lab_db(self._folder, write=True) as database:
            assert database is not None
            database.executemany(
                "INSERT INTO learnt (kind, name, simulated, run, at, belief) VALUES (?, ?, ?, ?, ?, ?)",
                [(kind, name, cell.simulated, run, at, belief.model_dump_json()) for kind, name, belief in news],
            )

    def _latest(self, kind: str, model: type[B], simulated: bool) -> dict[str, Learnt[B]]:
        with lab_db(self._folder, write=False) as database:
            if database is None:
                return {}
            rows = database.execute(
                "SELECT version, name, run, at, belief FROM learnt WHERE kind = ? AND simulated = ? ORDER BY version",
                (kind, simulated),
            )
            return {
                name: Learnt(version, name, simulated, run, at, model.model_validate_json(belief))
                for version, name, run, at, belief in rows
            }
