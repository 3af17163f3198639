"""What samples need of a source: doses, losses of scoops, discarded powder, and what other samples of its lot take."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from scuhand_bt.dosing.strokes import LOAD_AIM, scooped_for_mg
from scuhand_bt.problems import Mark, Problems
from scuhand_bt.quantity import counted, format_mass
from scuhand_bt.recipe.sample import Sample
from scuhand_bt.specs import Source


@dataclass(frozen=True)
class Demand:
    """What a source holds, and what samples take from it, including the loss of each scoop."""

    source: Source
    doses_mg: tuple[float, ...]
    """For each sample that takes from it, in the order of the samples, losses included."""
    samples: int
    discarded_mg: float
    """What scoops bring beyond the doses and is discarded, except after the last of these samples."""
    refilled_mg: float | None
    """The most that it holds after a refill; None if the plan has no refill."""

    @property
    def needed_mg(self) -> float:
        return sum(self.doses_mg)

    def doubt_of(self, mass_mg: float) -> str:
        """Why `mass_mg` may run out although the doses need no more; "" if it is enough."""
        if self.discarded_mg == 0.0 or self.needed_mg + self.discarded_mg <= mass_mg:
            return ""
        needs = f"its samples need {format_mass(self.needed_mg)} with losses"
        gone = f"about {self.discarded_mg / 1000:.1f} g are discarded before the last one"
        return f"{needs}, and because scoops bring more than a dose, {gone}: it may run out"


def demand_of(samples: Sequence[Sample], source: Source, refilled_mg: float | None = None) -> Demand:
    """What these samples need of a source; `refilled_mg` is the most that it holds after a refill."""
    users = sum(any(one.name == source.name for one in sample.sources) for sample in samples)
    discarded = [mg for mg in (discarded_mg(sample, source) for sample in samples) if mg > 0.0]
    doses = tuple(mg for mg in (needed_mg(sample, source) for sample in samples) if mg > 0.0)
    return Demand(source, doses, users, sum(discarded[:-1]), refilled_mg)


def needed_mg(sample: Sample, source: Source) -> float:
    """What one sample needs of a source, losses included."""
    return sum(take.needed_mg for take in sample.takes if take.source.name == source.name)


def discarded_mg(sample: Sample, source: Source) -> float:
    """What a sample's last scoop brings beyond the dose and is discarded, for planning.

    An estimate: from a mortar that holds little a scoop brings less.
    """
    takes_mg = sum(take.mass_mg or 0.0 for take in sample.takes if take.source.name == source.name)
    if not source.is_discarded or takes_mg == 0.0:
        return 0.0
    most_mg = LOAD_AIM * source.powder.load_limit_mg
    last_mg = takes_mg - most_mg * (math.ceil(takes_mg / most_mg) - 1)
    return min(scooped_for_mg(last_mg, source.powder, is_discarded=True), most_mg) - last_mg


def lent_mg(samples: Sequence[Sample], source: Source) -> float:
    """What samples of other sources, but of this source's lot, may take of it while its powder is kept in the cone.

    In the recipe's order. What is taken after this source's last sample is not counted, as no sample lacks it.
    """
    lent_mg = since_mg = 0.0
    is_kept = False
    for sample in samples:
        if needed_mg(sample, source) > 0.0:
            lent_mg += min(since_mg, LOAD_AIM * source.powder.load_limit_mg)
            since_mg, is_kept = 0.0, sample.may_keep(source)
        elif is_kept:
            of_lot = [take for take in sample.takes if take.source.sheet_key == source.sheet_key]
            since_mg += sum(take.needed_mg for take in of_lot)
            is_kept = not of_lot or sample.may_keep(source)
    return lent_mg


def check_demand(
    samples: Sequence[Sample],
    sources: Mapping[str, Source],
    marks: Mapping[str, Mark],
    problems: Problems,
    *,
    may_refill: bool,
) -> None:
    """Report every source that holds less than its samples need, or, if it is refilled, less than one sample needs.

    Losses are included. `may_refill`: the lab has the workflow `refill`.
    """
    for name, source in sources.items():
        demand, most_mg = demand_of(samples, source), max((needed_mg(one, source) for one in samples), default=0.0)
        if source.refill_mg is not None and most_mg > source.refill_mg:
            alone = next(sample for sample in samples if needed_mg(sample, source) == most_mg)
            what = f"'{name}' is refilled with {format_mass(source.refill_mg)} of {source.powder.name}"
            needs = f"'{alone.id}' alone needs {format_mass(most_mg)} with losses"
            allowed = f"refill with at least {_rounded(most_mg, math.ceil)}" if most_mg <= source.amount_mg else ""
            problems.add(marks[name], f"{what}, but {needs}", allowed, code="source-short")
        elif source.refill_mg is None and demand.needed_mg > source.amount_mg:
            holds = f"'{name}' holds {format_mass(source.amount_mg)} of {source.powder.name}"
            its = f"its {counted(demand.samples, 'sample')} {'needs' if demand.samples == 1 else 'need'}"
            needs = f"{its} {format_mass(demand.needed_mg)} with losses"
            ways = []
            if demand.needed_mg <= source.capacity_mg:
                ways.append(f"begin with at least {_rounded(demand.needed_mg, math.ceil)}")
            if may_refill and most_mg <= source.amount_mg:
                ways.append(f"let a person refill it on the way: refill: {_rounded(source.amount_mg, math.floor)}")
            problems.add(marks[name], f"{holds}, but {needs}", ", or ".join(ways), code="source-short")
        elif source.refill_mg is None and (doubt := demand.doubt_of(source.amount_mg)):
            what = f"'{name}' holds {format_mass(source.amount_mg)} of {source.powder.name}, {doubt}"
            remedy = "use more powder, or `leftover: keep` or `return`; `plan` shows by dry runs how much is discarded"
            problems.warn(marks[name], what, remedy, code="source-discarded")
        elif source.refill_mg is None and (lent := lent_mg(samples, source)) > source.amount_mg - demand.needed_mg:
            what = f"'{name}' holds {format_mass(source.amount_mg)} of {source.powder.name} and its samples need "
            what += f"{format_mass(demand.needed_mg)} with losses, but what the cone keeps of it may go to samples of "
            what += f"another source of this lot, up to {format_mass(lent)}: it may run out"
            remedy = "use more powder, group the samples by source, or write `leftover: return`"
            problems.warn(marks[name], what, remedy, code="source-lent")


def _rounded(mass_mg: float, towards: Callable[[float], int]) -> str:
    """A mass rounded to 0.1 mg by `towards` (ceil or floor), as a recipe may have it."""
    return format_mass(towards(10.0 * mass_mg) / 10.0)
