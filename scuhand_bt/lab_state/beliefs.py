"""What is learnt is kept: beliefs about powders, their scoops and balances, and what was measured of these, in
`.scuhand/lab.db`.

Rows are only ever added; the last one of a name counts, the others are its history; one without a value says that
what was known is forgotten. What is known of a balance belongs to its `Cell.balance_name`, and what doses have taught
of it is believed for `BALANCE_BELIEVED_FOR`; what a lot's scoops bring belongs to that lot in one kind of mortar, and
is believed for `YIELD_BELIEVED_FOR`; how a lot flows is a first guess again after `FLOW_BELIEVED_FOR`. What was learnt
from simulated devices is kept apart, and never read by a run: a real run must not believe a simulation, and a dry run
of one seed must not depend on the runs before it.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Generic, TypeVar

from pydantic import ValidationError

from scuhand_bt.cell.cell import Cell
from scuhand_bt.clock import wall_time
from scuhand_bt.dosing.characteristic import least_repeatability_mg, usp_minimum_weight_mg
from scuhand_bt.lab_state.lab_db import reading_lab_db, user_name, writing_lab_db
from scuhand_bt.problems import SourceError
from scuhand_bt.specs import BalanceBelief, PowderBelief, Source

FORGOTTEN = "null"
"""In the place of a belief."""
BALANCE_BELIEVED_FOR = timedelta(days=7)
"""Nobody tells a program that a filter was set otherwise: what is older than this is learnt anew, by one small dose."""

YIELD_BELIEVED_FOR = timedelta(days=30)
"""Powder takes up water, and sheets wear: what is older than this is learnt anew, by a run's first load."""

FLOW_BELIEVED_FOR = timedelta(days=180)
"""What is older may have caked or dried: the next dose goes by it as by a first guess."""

B = TypeVar("B", PowderBelief, BalanceBelief)


@dataclass(frozen=True)
class Taught:
    """Which run has taught something, and when (ISO 8601)."""

    version: int
    simulated: bool
    run: str
    at: str

    @property
    def origin(self) -> str:
        """Where it comes from, in a word."""
        return f"version {self.version}, {self.run}{', SIMULATED' if self.simulated else ''}"

    def is_older_than(self, age: timedelta, now: datetime) -> bool:
        """Whether it was learnt longer ago than that, or nobody can tell when: by a wrong clock, or a damaged row."""
        try:
            at = datetime.fromisoformat(self.at).astimezone()
        except (ValueError, OverflowError):
            return True
        return abs(now - at) > age


@dataclass(frozen=True)
class Learnt(Taught, Generic[B]):
    """One belief as it was written: of a powder lot (`Source.sheet_key`), or of a balance (`Cell.balance_name`)."""

    belief: B


@dataclass(frozen=True)
class LearntYield(Taught):
    """The share of what was expected that scoops were seen to bring."""

    share: float


YieldOf = tuple[str, str]
"""A powder lot (`Source.sheet_key`), and the mortar's name."""


@dataclass(frozen=True)
class Measured:
    """One figure of a balance as it was written: who says so, and since when (ISO 8601)."""

    value: float
    says: str
    at: str


Figures = Mapping[str, Measured]
"""What was measured of a balance, by `BalanceFigure`."""


class LabState:
    """What the lab's database says of powders and balances; see `lab_db.py` for the errors of all of this."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def powders(self, *, simulated: bool) -> dict[str, Learnt[PowderBelief]]:
        """The last belief about each powder lot; empty where nothing was ever learnt."""
        return self._latest("powder", PowderBelief, simulated)

    def balances(self, *, simulated: bool) -> dict[str, Learnt[BalanceBelief]]:
        """The last belief about each balance."""
        return self._latest("balance", BalanceBelief, simulated)

    def yields(self, *, simulated: bool) -> dict[YieldOf, LearntYield]:
        """What the scoops of each powder lot bring in each kind of mortar."""
        return {
            of: LearntYield(version, simulated, run, at, share)
            for of, (version, run, at, share) in self._yielded(simulated).items()
            if share is not None and 0.0 < share < math.inf  # what a damaged row says is learnt anew
        }

    def unreadable(self) -> list[str]:
        """The real powder lots and balances of which another version has learnt what this one cannot read."""
        names = []
        for kind, known in (("powder", self.powders(simulated=False)), ("balance", self.balances(simulated=False))):
            names += [name for name in self._last(kind, simulated=False) if name not in known]
        return names

    def figures(self, *, simulated: bool) -> dict[str, Figures]:
        """What was measured of each balance, and holds; the one that was measured last is the last."""
        with reading_lab_db(self._folder) as database:
            if database is None:
                return {}
            rows = database.execute(
                "SELECT balance, figure, value, says, at FROM measured WHERE simulated = ? ORDER BY id", (simulated,)
            )
            found: dict[str, dict[str, Measured]] = {}
            for balance, figure, value, says, at in rows:
                known = found.pop(balance, {})
                known.pop(figure, None)
                found[balance] = known if value is None else {**known, figure: Measured(value, says, at)}
            return {balance: known for balance, known in found.items() if known}

    def balance_figures(
        self, readability_mg: float, *, simulated: bool
    ) -> list[tuple[str, str, float | str, str, str]]:
        """What was measured of balances, what follows from it, and what doses have taught.

        Each as the balance's name, the figure's, its value, what or which run says so, and when.
        """
        rows: list[tuple[str, str, float | str, str, str]] = []
        for name, figures in self.figures(simulated=simulated).items():
            rows += [(name, figure, one.value, one.says, one.at) for figure, one in figures.items()]
            if (repeatability := figures.get("repeatability_mg")) is not None:
                least_mg = usp_minimum_weight_mg(least_repeatability_mg(repeatability.value, readability_mg))
                rows.append((name, "minimum_weight_mg", least_mg, repeatability.says, repeatability.at))
        for name, learnt in self.balances(simulated=simulated).items():
            belief = learnt.belief
            kind = f"{belief.shape}, adapts" if belief.adapts else belief.shape
            taught: dict[str, float | str] = {
                "lag_s": belief.lag_s,
                "lag_doubt": belief.doubt,
                "filter": kind,
                "filter_misfit": belief.misfit,
                "noise_in_doses_mg": belief.noise_mg,
                "shaken_noise_in_doses_mg": belief.shaken_noise_mg,
            }
            rows += [(name, figure, value, learnt.run, learnt.at) for figure, value in taught.items()]
        return rows

    def recall(self, cell: Cell, now: datetime, since: str = "") -> None:
        """Give a real cell what was learnt on real devices, and let it believe nothing else of powders and balance.

        Of powders and of what scoops bring, what the run has seen itself counts more, also where it was killed before
        it could keep that; but for what was forgotten, and of powders learnt, `since` it broke off (ISO 8601).
        """
        by_now = {
            name: learnt.belief.model_copy(update={"doses": 0} if learnt.is_older_than(FLOW_BELIEVED_FOR, now) else {})
            for name, learnt in self.powders(simulated=False).items()
        }
        if since:
            is_later = _later_than(since)
            anew = {name for name, (_, _, at, _) in self._written("powder", simulated=False).items() if is_later(at)}
            by_now |= {name: belief for name, belief in cell.powder_beliefs.items() if name not in anew}
        cell.powder_beliefs = by_now
        balance = self.balances(simulated=False).get(cell.balance_name)
        is_known = balance is not None and not balance.is_older_than(BALANCE_BELIEVED_FOR, now)
        cell.balance_belief = balance.belief if balance is not None and is_known else BalanceBelief()
        delay = self.figures(simulated=False).get(cell.balance_name, {}).get("delay_s")
        cell.known_delay_s = delay.value if delay is not None else None
        yields = self.yields(simulated=False)
        forgotten = self._forgotten_yields(since) if since else frozenset()
        for name, source in cell.sources.items():
            learnt = yields.get(_yield_of(source))
            if learnt is not None and not learnt.is_older_than(YIELD_BELIEVED_FOR, now):
                cell.believed.scoops_bring(name, learnt.share)
            elif _yield_of(source) in forgotten:
                cell.believed.scoops_forgotten(name)

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
        name, belief = cell.balance_name, cell.balance_belief
        if belief.fits and (name not in balances or balances[name].belief != belief):
            news.append(("balance", name, belief))
        figures = [(name, figure, value) for figure, value in cell.balance_figures.items()]
        written = [(kind, name, belief.model_dump_json()) for kind, name, belief in news]
        if not belief.fits and name in balances and not cell.simulated:  # it was given up, or was too old
            written.append(("balance", name, FORGOTTEN))
        known, seen = self.yields(simulated=cell.simulated), cell.believed.seen_yields
        shares = {_yield_of(cell.sources[name]): share for name, share in seen.items() if name in cell.sources}
        brought = [(of, share) for of, share in shares.items() if of not in known or known[of].share != share]
        self._write(written, figures, brought, simulated=cell.simulated, says=run)

    def forget_balances(self) -> list[str]:
        """Believe nothing of any real balance any more; their names."""
        learnt, figures = self.balances(simulated=False), self.figures(simulated=False)
        self._write(
            [("balance", name, FORGOTTEN) for name in learnt],
            [(name, figure, None) for name, known in figures.items() for figure in known],
            [],
            simulated=False,
            says=f"operator {user_name()}",
        )
        return sorted({*learnt, *figures})

    def forget_powders(self, name: str) -> list[str]:
        """Believe nothing any more of a powder lot and its scoops, or of all lots of a powder; their names."""

        def is_meant(lot: str) -> bool:
            return name in (lot, lot.partition("/")[0])  # a lot may have slashes in its name, too

        lots = [lot for lot in self.powders(simulated=False) if is_meant(lot)]
        yields = [of for of in self.yields(simulated=False) if is_meant(of[0])]
        self._write(
            [("powder", lot, FORGOTTEN) for lot in lots],
            [],
            [(of, None) for of in yields],
            simulated=False,
            says=f"operator {user_name()}",
        )
        return list(dict.fromkeys([*lots, *(lot for lot, _ in yields)]))

    def _write(
        self,
        beliefs: Sequence[tuple[str, str, str]],
        figures: Sequence[tuple[str, str, float | None]],
        yields: Sequence[tuple[YieldOf, float | None]],
        *,
        simulated: bool,
        says: str,
    ) -> None:
        if not beliefs and not figures and not yields:
            return
        at = wall_time()
        with writing_lab_db(self._folder, durable=not simulated) as database:
            database.executemany(
                "INSERT INTO learnt (kind, name, simulated, run, at, belief) VALUES (?, ?, ?, ?, ?, ?)",
                [(kind, name, simulated, says, at, belief) for kind, name, belief in beliefs],
            )
            database.executemany(
                "INSERT INTO measured (balance, figure, simulated, value, says, at) VALUES (?, ?, ?, ?, ?, ?)",
                [(name, figure, simulated, value, says, at) for name, figure, value in figures],
            )
            database.executemany(
                "INSERT INTO yielded (lot, mortar, simulated, share, run, at) VALUES (?, ?, ?, ?, ?, ?)",
                [(*of, simulated, share, says, at) for of, share in yields],
            )

    def _yielded(self, simulated: bool) -> dict[YieldOf, tuple[int, str, str, float | None]]:
        """By lot and mortar what was written last: version, run, time and share; None where that was forgotten."""
        with reading_lab_db(self._folder) as database:
            if database is None:
                return {}
            rows = database.execute(
                "SELECT version, lot, mortar, run, at, share FROM yielded WHERE simulated = ? ORDER BY version",
                (simulated,),
            )
            return {(lot, mortar): (version, run, at, share) for version, lot, mortar, run, at, share in rows}

    def _forgotten_yields(self, since: str) -> frozenset[YieldOf]:
        """Those that a person has forgotten since then."""
        is_later = _later_than(since)
        yielded = self._yielded(simulated=False).items()
        return frozenset(of for of, (*_, at, share) in yielded if share is None and is_later(at))

    def _latest(self, kind: str, model: type[B], simulated: bool) -> dict[str, Learnt[B]]:
        found = {}
        for name, (version, run, at, belief) in self._last(kind, simulated).items():
            with suppress(ValidationError):  # `unreadable` tells of it
                found[name] = Learnt(version, simulated, run, at, model.model_validate_json(belief))
        return found

    def _last(self, kind: str, simulated: bool) -> dict[str, tuple[int, str, str, str]]:
        """By name what was written last, where it is not that it was forgotten."""
        written = self._written(kind, simulated)
        return {name: last for name, last in written.items() if last[-1] != FORGOTTEN}

    def _written(self, kind: str, simulated: bool) -> dict[str, tuple[int, str, str, str]]:
        """By name what was written last: version, run, time and belief."""
        with reading_lab_db(self._folder) as database:
            if database is None:
                return {}
            rows = database.execute(
                "SELECT version, name, run, at, belief FROM learnt WHERE kind = ? AND simulated = ? ORDER BY version",
                (kind, simulated),
            )
            return {name: (version, run, at, belief) for version, name, run, at, belief in rows}


def _later_than(since: str) -> Callable[[str], bool]:
    """Whether something was written here since then; of a damaged row that is not known."""
    moment = datetime.fromisoformat(since).replace(microsecond=0)  # as what is written here is dated

    def is_later(at: str) -> bool:
        try:
            return datetime.fromisoformat(at) >= moment
        except ValueError:
            return False

    return is_later


def _yield_of(source: Source) -> YieldOf:
    return source.sheet_key, source.mortar.name
