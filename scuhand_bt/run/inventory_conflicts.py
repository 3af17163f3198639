"""Where the inventory and a recipe disagree, and how a real run settles that before anything moves.

See docs/unattended.md, "What the cell holds between runs". `check` reports the conflicts. Runs on simulated devices
have none, as they do not depend on the real cell.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime

from scuhand_bt.cell.cell import Cell
from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.clock import Steps
from scuhand_bt.failures import Code
from scuhand_bt.lab_state.inventory import Stock, StockEntry, counted_otherwise
from scuhand_bt.problems import Mark, Problem, SourceError
from scuhand_bt.quantity import format_mass
from scuhand_bt.recipe.plan import Plan
from scuhand_bt.skill import SkillFailed
from scuhand_bt.specs import Source

PLAUSIBLE_SHARE = 0.05
"""Amounts of recipe and inventory count as equal up to a difference of this share of the larger one, or of what two
scoops lose if that is more."""
EMPTY_MG = 1.0
"""A cone or mortar with less than this is empty."""
MOUNTED_MM = 0.5
"""A rim within this distance of its size when mounted counts as just mounted."""

Resolution = Callable[[Cell], None]


@dataclass(frozen=True)
class Conflict:
    """One disagreement, where the recipe says otherwise, and the answers that settle it.

    Without answers, only an operator's entry or a change of the recipe settles it.
    """

    mark: Mark
    what: str
    question: str = ""
    answers: tuple[tuple[str, Resolution], ...] = ()

    @property
    def problem(self) -> Problem:
        return Problem(self.mark, self.what)


def conflicts(plan: Plan, cell: CellSpec, stock: Stock) -> list[Conflict]:
    """All conflicts between the inventory and this plan."""
    return [
        *_about_sources(plan, stock),
        *about_vessels(plan, stock),
        *_about_hand(plan, cell, stock),
        *_about_changer(plan, cell, stock),
    ]


def require_resolvable(found: Sequence[Conflict], *, unattended: bool) -> None:
    """Raises SourceError for conflicts that no answer settles; if unattended for all, as nobody can be asked."""
    problems = [conflict.problem for conflict in found if unattended or not conflict.answers]
    if problems:
        raise SourceError(problems)


def recall(cell: Cell, stock: Stock) -> None:
    """Set a real cell's beliefs from the inventory, as far as the recipe names the same powders."""
    believed = cell.believed
    for name, source in cell.sources.items():
        known = stock.get(("station", source.station))
        if known is not None and known.lot_key == source.sheet_key:
            believed.source_holds(name, known.mass_mg or 0.0)
    for vessel in cell.spec.vessels:
        if (held := stock.get(("station", vessel.name))) is not None:
            believed.vessel_holds(vessel.name, held.lot_key or None, held.mass_mg or 0.0)
    if (sheet := stock.get(("sheet", ""))) is not None:
        believed.sheet_is(sheet.lot_key or None, sheet.used or 1)
    if (cone := stock.get(("cone", ""))) is not None and cone.powder:  # even with 0 mg: it was not seen to be empty
        same = [source for source in cell.sources.values() if source.sheet_key == cone.lot_key]
        if same:
            believed.cone_holds(same[0], cone.mass_mg or 0.0)
    containers = {name: entry.used or 0 for (kind, name), entry in stock.items() if kind == "container"}
    kinds = cell.spec.changer.kinds
    is_counted = counted_otherwise(kinds, stock) is None  # else a person confirms that it was refilled
    counts = {kind: stock.get(("changer", kind)) for kind in kinds or ("",)} if is_counted else {}
    slots = {kind: entry.used or 0 for kind, entry in counts.items() if entry is not None}
    believed.containers_taken(slots.get("", believed.slots_used), {**believed.containers_used, **containers})
    if kinds:
        believed.slots_taken({**believed.slots_of_kinds, **slots})


def corrections(stock: Stock, since: str) -> Stock:
    """What an operator has entered after a moment (ISO 8601)."""
    moment = datetime.fromisoformat(since)
    return {
        key: entry
        for key, entry in stock.items()
        if entry.operator is not None and datetime.fromisoformat(entry.at) > moment
    }


def resolve(cell: Cell, found: Sequence[Conflict]) -> Steps[None]:
    """Ask the operator about each conflict, and believe the answer.

    Raises SkillFailed operator.refused if the answer is to stop, operator.absent if nobody is there.
    """
    for conflict in found:
        answers = dict(conflict.answers)
        answer = yield from cell.operator.ask(conflict.question, (*answers, "stop"))
        if answer not in answers:
            raise SkillFailed(Code.OPERATOR_REFUSED, conflict.what)
        answers[answer](cell)


def _about_sources(plan: Plan, stock: Stock) -> Iterator[Conflict]:
    marks = plan.recipe.marks
    for demand in plan.demands:
        source, name = demand.source, demand.source.name
        known = stock.get(("station", source.station))
        if known is None or known.mass_mg is None:
            continue
        if known.lot_key != source.sheet_key:
            if known.mass_mg >= EMPTY_MG:
                yield Conflict(marks[f"sources.{name}"], _another_powder(source, known))
            continue
        mark = marks[f"sources.{name}.amount"]
        amount, left = format_mass(source.amount_mg), known.in_words
        what = f"'{name}' holds {left} of {source.sheet_key} by the inventory ({known.origin})"
        # The plan's refills are scheduled for its own `amount`, so a refilled source needs that at the start.
        enough_mg = demand.needed_mg if source.refill_mg is None else min(demand.needed_mg, source.amount_mg)
        needs = f"its samples need {format_mass(demand.needed_mg)} with losses"
        plausible_mg = max(PLAUSIBLE_SHARE * max(source.amount_mg, known.mass_mg), 2 * source.powder.scoop_loss_mg)
        if abs(source.amount_mg - known.mass_mg) > plausible_mg:
            answers: tuple[tuple[str, Resolution], ...] = (("recipe", _believe_source(name, source.amount_mg)),)
            question = f"How much powder is at {source.station}: {amount} (recipe) or {left} (inventory)?"
            if known.mass_mg >= enough_mg:
                answers += (("inventory", _believe_source(name, known.mass_mg)),)
                if source.refill_mg is None and (doubt := demand.doubt_of(known.mass_mg)):
                    what, question = f"{what}, {doubt}", f"{question} Of {left} {doubt}."
            else:
                what = f"{what}, too little: {needs}"
            yield Conflict(mark, f"{what}; the recipe says {amount}", question, answers)
        elif known.mass_mg < demand.needed_mg and source.refill_mg is None:
            yield Conflict(mark, f"{what}, too little: {needs}; refill it, and {_set(source)}")


def _another_powder(source: Source, known: StockEntry) -> str:
    what = f"by the inventory '{source.station}' holds {known.in_words} of {known.lot_key} ({known.origin}), not"
    return f"{what} {source.sheet_key}. If the mortar was changed, {_set(source)}"


def _set(source: Source) -> str:
    lot = f" --lot {source.lot}" if source.lot else ""
    amount = f"{source.amount_mg:g} mg"
    return f"enter that: scuhand-bt inventory set {source.station} '{amount}' --powder {source.powder.name}{lot}"


def _believe_source(name: str, mass_mg: float) -> Resolution:
    def believe(cell: Cell) -> None:
        cell.believed.source_holds(name, mass_mg)

    return believe


def about_vessels(plan: Plan, stock: Stock) -> Iterator[Conflict]:
    """A conflict if a leftover would go into a vessel with powder of another lot, also when a run is resumed."""
    for source in (demand.source for demand in plan.demands if demand.samples):
        station = source.leftover_to
        held = stock.get(("station", station))
        if held is None or not held.powder or held.lot_key == source.sheet_key:
            continue
        what = f"by the inventory the vessel '{station}' holds {held.in_words} of {held.lot_key} ({held.origin})"
        what = f"{what}; the leftover of {source.sheet_key} is to go there"
        question = f"The vessel '{station}' holds {held.lot_key}. Has it been emptied and cleaned, or changed?"
        yield Conflict(plan.recipe.marks["leftover"], what, question, (("emptied", _vessel_emptied(station)),))
        return  # a recipe has only one such vessel, for one lot


def _vessel_emptied(station: str) -> Resolution:
    def emptied(cell: Cell) -> None:
        cell.believed.vessel_holds(station, None, 0.0)

    return emptied


def about_rim(cell: Cell, stock: Stock) -> list[Conflict]:
    """A conflict if an operator has entered a fresh sheet, but the roller's turns say that the rim was rolled since."""
    sheet, rim_mm = stock.get(("sheet", "")), cell.hand.cone_diameter_mm
    if sheet is None or sheet.operator is None or sheet.powder or abs(rim_mm - _mounted_mm(cell.spec)) <= MOUNTED_MM:
        return []
    what = f"a fresh sheet was entered ({sheet.origin}), and by the roller its rim is {rim_mm:.0f} mm wide"
    choices = f"{_mounted_mm(cell.spec):g} mm as mounted, or {rim_mm:.0f} mm as the roller says"
    question = f"A fresh sheet was entered. How wide is its rim: {choices}?"
    return [Conflict(Mark("robot/cell.yaml"), what, question, (("mounted", _as_mounted), ("rolled", lambda _: None)))]


def _mounted_mm(cell: CellSpec) -> float:
    return cell.hand.options.start_diameter_mm


def _as_mounted(cell: Cell) -> None:
    """Whatever the roller did to the sheet before."""
    cell.hand.rim_is(_mounted_mm(cell.spec))


def _fresh_sheet(cell: Cell) -> None:
    _as_mounted(cell)
    cell.believed.sheet_swapped()


def _slots_refilled(cell: Cell) -> None:
    cell.believed.slots_refilled()


def _about_hand(plan: Plan, cell: CellSpec, stock: Stock) -> Iterator[Conflict]:
    """The cone must be empty or hold the first sample's lot; the sheet must be fresh or have touched only that."""
    first = next((job.sample.sources[0] for job in plan.jobs if job.sample is not None and job.sample.sources), None)
    mark = plan.recipe.marks[f"sources.{first.name}"] if first is not None else Mark(str(plan.recipe.path))
    needs = f"the first sample needs {first.sheet_key}" if first is not None else "this recipe needs it empty"
    cone, sheet = stock.get(("cone", "")), stock.get(("sheet", ""))
    is_loaded = cone is not None and (cone.mass_mg or 0.0) >= EMPTY_MG
    if cone is not None and is_loaded and (first is None or cone.lot_key != first.sheet_key):
        what = f"by the inventory the cone holds {cone.in_words} of {cone.lot_key} ({cone.origin})"
        yield Conflict(mark, f"{what}; {needs}. Empty it, and enter that: scuhand-bt inventory set cone '0 mg'")
    if sheet is not None and sheet.powder and first is not None and sheet.lot_key != first.sheet_key:
        what = f"by the inventory the sheet has touched {sheet.lot_key} ({sheet.origin})"
        rim = f"with a rim of {_mounted_mm(cell):g} mm"
        question = f"The sheet has touched {sheet.lot_key}. Is a fresh sheet in the hand now, {rim}?"
        yield Conflict(mark, f"{what}; {needs}", question, (("fresh", _fresh_sheet),))


def _about_changer(plan: Plan, cell: CellSpec, stock: Stock) -> Iterator[Conflict]:
    if cell.changer.driver == "operator":
        return
    if (last := counted_otherwise(cell.changer.kinds, stock)) is not None:
        counts = [one for one in stock.values() if one.kind == "changer" and bool(one.name) == bool(last.name)]
        used = sum(one.used or 0 for one in counts)
        how = "by kind" if cell.changer.kinds else "in the plan's order"
        what = f"by the inventory {used} slots of the changer were used ({last.origin}) when it was filled otherwise"
        question = f"The changer is to be filled {how} now. Has that been done?"
        what = f"{what} than robot/cell.yaml says now ({how})"
        yield Conflict(Mark(str(plan.recipe.path)), what, question, (("filled", _slots_refilled),))
        return
    batch = Counter(one.name for sample in plan.recipe.samples for one in sample.all_containers)
    for kind in cell.changer.kinds or ("",):
        if (known := stock.get(("changer", kind))) is None:
            continue
        containers = batch[kind] if kind else batch.total()
        used, slots, for_kind = known.used or 0, cell.changer.slots_for(kind), f" for {kind}" if kind else ""
        if not used or used + containers <= slots:
            continue
        what = f"by the inventory {used} of the changer's {slots} slots{for_kind} are used ({known.origin})"
        question = f"{used} of the changer's {slots} slots{for_kind} are used. Has it been filled again?"
        what = f"{what}; the batch has {containers} containers" + (f" of the kind {kind}" if kind else "")
        yield Conflict(Mark(str(plan.recipe.path)), what, question, (("filled", _slots_refilled),))
