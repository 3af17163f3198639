"""Where the powder of each source went: what was weighed, with its uncertainty, and what is only reckoned.

Only what came into containers was weighed. What a scoop brought, what went back and what was let out over the waste are
the run's own reckoning, which has no uncertainty that anyone has measured.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, cast

from scuhand_bt.events.cell import Discarded, Refilled, Returned, Scooped, SheetSwapped
from scuhand_bt.events.weighings import BracketClosed, DoseBegun, LotDosed
from scuhand_bt.journal.kinds import parsed
from scuhand_bt.journal.reader import Contents
from scuhand_bt.journal.run_events import Matter, RunBegun
from scuhand_bt.report.weighing_record import weighing_rows


@dataclass
class SourceBalance:
    """One source over the whole run. Masses in mg; None where the journal does not say."""

    name: str
    powder: str
    lot: str
    start_mg: float | None = None
    """What it was said to hold before the first action."""
    scoops: int = 0
    sheets: set[int] = field(default_factory=set)
    """The numbers of those that have touched it; both rollers and the passive clamp have with each, until wiped."""
    scooped_mg: float = 0.0
    returned_mg: float = 0.0
    discarded_mg: float = 0.0
    dosed_mg: float = 0.0
    dosed_variance_mg2: float = 0.0
    in_cone_mg: float = 0.0
    left_mg: float | None = None
    truly_left_mg: float | None = None
    """The simulation's."""

    @property
    def dosed_uncertainty_mg(self) -> float:
        """Standard uncertainty of what was dosed in sum, as if the weighings were independent."""
        return math.sqrt(self.dosed_variance_mg2)

    @property
    def unaccounted_mg(self) -> float | None:
        """At the start, less all that it is booked to have gone to, and to be left.

        None of that but the doses was weighed: 0 tells that the books close, not that the powder is where they say.
        """
        if self.start_mg is None or self.left_mg is None:
            return None
        return self.start_mg - self.dosed_mg - self.discarded_mg - self.in_cone_mg - self.left_mg


def powder_balance(contents: Contents) -> Sequence[SourceBalance]:
    """The balance of every source of a run, in the recipe's order."""
    found: dict[str, SourceBalance] = {}
    believed: Mapping[str, Any] = {}
    of_lots: dict[tuple[str, str], str] = {}
    """The source that was dosed from, by container and lot."""
    closed: dict[tuple[str, str], LotDosed] = {}
    sheet = 1
    for row in contents.each("entry"):
        match event := parsed(row["kind"], row["payload"]):
            case RunBegun():
                found = {name: SourceBalance(name, one.powder, one.lot) for name, one in event.sources.items()}
            case Scooped() if event.source in found:
                found[event.source].scoops += 1
                found[event.source].sheets.add(sheet)
                found[event.source].scooped_mg += event.expected_mg
            case Returned() if event.source in found:
                found[event.source].returned_mg += event.expected_mg
            case Discarded() if (name := event.source or believed.get("cone_source")) in found:
                found[name].discarded_mg += event.expected_mg
            case Refilled() if (one := found.get(event.source)) is not None and one.start_mg is not None:
                one.start_mg += event.mass_mg
            case SheetSwapped():
                sheet = event.sheets_used
            case DoseBegun() if (pan := believed.get("pan")) is not None:
                of_lots[pan["id"], event.lot] = believed["cone_source"]
            case BracketClosed():
                closed |= {(event.container, lot): dosed for lot, dosed in event.doses.items()}
            case Matter():
                for name, one in found.items():
                    one.truly_left_mg = event.model_extra.get(f"source:{name}") if event.model_extra else None
        if row["state"] is not None:
            believed = row["state"]["believed"]
            sheet = believed.get("sheets_used", sheet)
            for name, mass_mg in believed["sources_mg"].items():
                if name in found:
                    one = found[name]
                    one.left_mg = mass_mg
                    one.start_mg = mass_mg if one.start_mg is None else one.start_mg
    if (holding := found.get(believed.get("cone_source", ""))) is not None:
        holding.in_cone_mg = believed["cone_mg"]
    weighings = list(weighing_rows(contents))
    # An old journal has only what the skill said of a dose, and nothing that was adjusted to the bare pan.
    said = "result" if any(row["weighing"] == "result" for row in weighings) else "dose"
    told = set[tuple[object, ...]]()
    for row in weighings:
        if row["weighing"] == said and (source := found.get(str(row.get("source")))) is not None:
            source.dosed_mg += cast(float, row["net_mg"])
            source.dosed_variance_mg2 += cast(float, row["standard_uncertainty_mg"]) ** 2
            told.add((row["container"], source.powder, source.lot))
    for (container, lot), dosed in closed.items():  # of a dose that broke off no sample tells
        source = found.get(of_lots.get((container, lot), ""))
        if source is not None and (container, source.powder, source.lot) not in told:
            source.dosed_mg += dosed.net_mg
            source.dosed_variance_mg2 += dosed.uncertainty_mg**2
    return list(found.values())
