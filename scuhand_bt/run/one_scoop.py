"""Checks, before a run, whether one scoop can bring all the doses that a workflow takes from it."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import accumulate

from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.dosing.strokes import LAST_SHARE, LOAD_AIM
from scuhand_bt.problems import Problems
from scuhand_bt.quantity import counted, format_mass
from scuhand_bt.recipe.demand import needed_mg
from scuhand_bt.recipe.plan import Plan
from scuhand_bt.recipe.sample import Sample
from scuhand_bt.run.stroke_ways import one_load_mg
from scuhand_bt.specs import Source

OTHER_FILLS = (0.75, 0.5, 0.25, 1.5, 2.0, 3.0)
"""Multiples of a source's `amount` that the remedy tries; the first with which a scoop brings enough is named."""


@dataclass(frozen=True)
class _OfOneScoop:
    """What a sample takes from a source by one scoop, and how much the mortar holds then."""

    sample: Sample
    source: Source
    doses_mg: tuple[float, ...]
    bed_mg: float


def warn_of_one_scoop(plan: Plan, cell: CellSpec, problems: Problems) -> None:
    """Warn of samples whose doses are more than one scoop should bring; once for samples that are alike.

    That is the lesser of what the first stroke brings and what a stroke brings from what is left by then, if that were
    level. In a nearly full bowl the first is less, and strokes do not improve it.
    """
    told = set[tuple[str, tuple[float, ...]]]()
    for one in _of_one_scoop(plan):
        source = one.source
        brings_mg, bed_mg = _brings_mg(cell, source, (source.amount_mg, one.bed_mg))
        if brings_mg >= sum(one.doses_mg) or (source.name, one.doses_mg) in told:
            continue
        told.add((source.name, one.doses_mg))
        doses = f"{counted(len(one.doses_mg), 'dose')} ({format_mass(sum(one.doses_mg))})"
        what = f"'{one.sample.id}' takes {doses} from one scoop of '{source.name}', but of {format_mass(bed_mg)} of "
        what += (
            f"{source.powder.name} in this mortar a scoop should bring {format_mass(brings_mg)}: the cone may run empty"
        )
        problems.warn(one.sample.mark, what, _remedy(one, cell, brings_mg), code="one-scoop")


def _of_one_scoop(plan: Plan) -> Iterator[_OfOneScoop]:
    """In the plan's order. A mortar that holds too little for a sample is refilled before it."""
    left_mg = {demand.source.name: demand.source.amount_mg for demand in plan.demands}
    for sample in (job.sample for job in plan.jobs if job.sample is not None):
        for source in sample.sources:
            needs_mg = needed_mg(sample, source)
            if left_mg[source.name] < needs_mg:
                left_mg[source.name] = source.amount_mg
            by_scoop: dict[int, list[float]] = {}
            for take in sample.takes:
                if take.source.name == source.name and take.scoop is not None and take.mass_mg:
                    by_scoop.setdefault(take.scoop, []).append(take.mass_mg)
            for doses_mg in by_scoop.values():
                yield _OfOneScoop(sample, source, tuple(doses_mg), left_mg[source.name])
            left_mg[source.name] -= needs_mg


def _brings_mg(
    cell: CellSpec, source: Source, beds_mg: tuple[float, ...], of_none_mg: float = math.inf
) -> tuple[float, float]:
    """The least that one scoop should bring from any of these beds, and from which.

    `of_none_mg` counts where no stroke is possible.
    """
    loads_mg = [one_load_mg(cell, source, bed_mg) for bed_mg in beds_mg]
    return min((of_none_mg if mg is None else mg, bed_mg) for mg, bed_mg in zip(loads_mg, beds_mg, strict=True))


def _remedy(one: _OfOneScoop, cell: CellSpec, brings_mg: float) -> str:
    """What would suffice without the last part of a load, with which `cone_holds` begins no dose either."""
    source, sure = one.source, 1.0 - LAST_SHARE
    sum_mg, fit = sum(one.doses_mg), sum(mg <= sure * brings_mg for mg in accumulate(one.doses_mg))
    ways = [f"doses of {format_mass(math.floor(sure * brings_mg / len(one.doses_mg)))} at most"]
    ways += [f"several samples, of {counted(fit, 'dose')} each"] if fit > 0 else []
    ways += ["a workflow that scoops again where the cone runs empty, as `fill` does"]
    limit_mg = source.powder.load_limit_mg
    if sum_mg > sure * LOAD_AIM * limit_mg:
        return (
            f"{', or '.join(ways)}; the powder's load limit ({format_mass(limit_mg)}) is too small for so much at once"
        )
    taken_mg, needs_mg = source.amount_mg - one.bed_mg, needed_mg(one.sample, source)
    fills_mg = (share * source.amount_mg for share in OTHER_FILLS)
    fitting_mg = (mg for mg in fills_mg if taken_mg + needs_mg <= mg <= source.capacity_mg)
    enough_mg = (mg for mg in fitting_mg if _brings_mg(cell, source, (mg, mg - taken_mg), 0.0)[0] * sure >= sum_mg)
    if (fill_mg := next(enough_mg, None)) is not None:
        ways.append(f"{format_mass(math.floor(fill_mg))} in it")
    return f"{', or '.join(ways)}, or another mortar"
