"""The audit trail: who did what to a run or to the lab, when, and why; what a program does by itself is in `show`."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime

from scuhand_bt.journal.events import Answered
from scuhand_bt.journal.kinds import parsed
from scuhand_bt.journal.reader import Contents
from scuhand_bt.journal.results import Chosen
from scuhand_bt.journal.run_events import Continued, Ended, Paused, Resumed, RunBegun, Trouble
from scuhand_bt.lab_state.inventory import StockEntry

UNKNOWN = "not told"
NO_REASON = "no reason given"


@dataclass(frozen=True)
class Deed:
    """One line of the trail."""

    at: str
    """ISO 8601 with its offset from UTC."""
    who: str
    what: str
    why: str = ""
    entry: int | None = None
    """Of the run's journal."""


def deeds_of_run(contents: Contents) -> Iterator[Deed]:
    """What persons did in a run, and what of it they should know, in order."""
    operator = UNKNOWN
    for row in contents.each("entry"):
        event = parsed(row["kind"], row["payload"])
        if isinstance(event, RunBegun | Resumed):
            operator = _name(event.operator, event.signed)
        match event:
            case RunBegun():
                who, what, why = operator, f"began '{event.recipe}' on the cell '{event.cell}', {event.mode}", ""
            case Resumed():
                changes = "; ".join(f"accepted: {change}" for change in event.changes)
                who, what, why = operator, f"resumed it with scuhand_bt {event.version}", changes
            case Answered():
                by = _name(event.by, event.signed) if event.by is not None else UNKNOWN
                who, what, why = by, f"answered '{event.answer}'", event.question
            case Chosen():
                who, what, why = operator, f"chose '{event.action}' for '{event.sample}'", f"attempt {event.attempt}"
            case Paused():
                who, what, why = _name(event.by, event.signed), "paused it", ""
            case Continued():
                who, what, why = _name(event.by, event.signed), "let it go on", ""
            case Ended() if event.by is not None:
                who, what, why = _name(event.by, event.signed), "stopped it", event.reason
            case Trouble():
                who, what, why = "the program", "noted", event.what
            case Ended():
                who, what, why = "the program", f"ended it with exit code {event.exit_code}", event.reason
            case _:
                continue
        yield Deed(row["at"], who, what, why, row["seq"])


def deeds_in_lab(corrections: Iterable[StockEntry], enrolled: Iterable[tuple[str, str]]) -> Sequence[Deed]:
    """What persons did to the lab's own records, in order; `enrolled` are the names that got a PIN, and when."""
    deeds = [
        Deed(one.at, one.operator or UNKNOWN, f"corrected '{one.place}' to {_told(one)}", one.reason or NO_REASON)
        for one in corrections
    ]
    deeds += [Deed(at, name, "got a PIN") for at, name in enrolled]
    return sorted(deeds, key=lambda deed: datetime.fromisoformat(deed.at))


def _told(one: StockEntry) -> str:
    return one.in_words + (f" of {one.lot_key}" if one.lot_key else "")


def _name(name: str | None, signed: bool) -> str:
    return UNKNOWN if name is None else f"{name} (PIN)" if signed else name
