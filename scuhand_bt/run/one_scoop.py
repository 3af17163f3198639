"""Doses that a workflow takes of one scoop: whether one can bring them all, before a run finds the cone empty."""

from collections.abc import Iterator
from dataclasses import dataclass

from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.dosing.strokes import LAST_SHARE, LOAD_AIM
from scuhand_bt.problems import Problems
from scuhand_bt.quantity import counted, format_mass
from scuhand_bt.recipe.plan import Plan
from scuhand_bt.recipe.sample import Sample, needed_mg
from scuhand_bt.run.stroke_ways import one_load_mg
from scuhand_bt.specs import Source

OTHER_FILLS = (0.75, 0.5, 0.25, 1.5, 2.0, 3.0)
"""Times what is in a mortar, of which a scoop may bring enough: the first that does is told."""


@dataclass(frozen=True)
class _OfOneScoop:
    """What a sample takes of a source by one scoop, from a bed of so much."""

    sample: Sample
    source: Source
    doses_mg: tuple[float, ...]
    bed_mg: float


def warn_of_one_scoop(plan: Plan, cell: CellSpec, problems: Problems) -> None:
    """Warn of samples whose doses are more than one scoop lets out; of those alike, once.

    The bed is taken to be level. Strokes leave it less so, and bring less: what is not warned of may be lost, too.
    """
    told = set[tuple[str, tuple[float, ...]]]()
    for one in _of_one_scoop(plan):
        if (one.source.name, one.doses_mg) in told:
            continue
        brings_mg = one_load_mg(cell, one.source, one.bed_mg)
        if brings_mg is None or (sure_mg := _sure_mg(brings_mg)) >= sum(one.doses_mg):
            continue
        told.add((one.source.name, one.doses_mg))
        doses, powder = counted(len(one.doses_mg), "dose"), one.source.powder.name
        what = f"'{one.sample.id}' takes {doses} ({format_mass(sum(one.doses_mg))}) of one scoop from "
        what += f"'{one.source.name}', and of {format_mass(one.bed_mg)} of {powder} one brings {format_mass(brings_mg)}"
        what += f", of which some {format_mass(sure_mg)} come well: the cone may run empty"
        problems.warn(one.sample.mark, what, _remedy(one, cell, sure_mg), code="one-scoop")


def _of_one_scoop(plan: Plan) -> Iterator[_OfOneScoop]:
    """In the order of the plan; before a sample for which too little is left a mortar is refilled."""
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


def _sure_mg(load_mg: float) -> float:
    """What doses may count on of a load: as `cone_holds` has it, none is begun with the last of it."""
    return (1.0 - LAST_SHARE) * load_mg


def _remedy(one: _OfOneScoop, cell: CellSpec, sure_mg: float) -> str:
    source, sum_mg = one.source, sum(one.doses_mg)
    fit = sum(sum(one.doses_mg[: number + 1]) <= sure_mg for number in range(len(one.doses_mg)))
    ways = [f"doses of {format_mass(sure_mg / len(one.doses_mg))} at most"]
    ways += [f"several samples, of {counted(fit, 'dose')} each"] if fit > 0 else []
    ways += ["a workflow that scoops again where the cone runs empty, as `fill` does"]
    limit_mg = source.powder.load_limit_mg
    if sum_mg > _sure_mg(LOAD_AIM * limit_mg):
        return f"{', or '.join(ways)}; the powder's load limit ({format_mass(limit_mg)}) allows no scoop of so much"
    fills_mg = (share * one.bed_mg for share in OTHER_FILLS)
    fitting_mg = (mg for mg in fills_mg if needed_mg(one.sample, source) <= mg <= source.capacity_mg)
    enough_mg = (mg for mg in fitting_mg if _sure_mg(one_load_mg(cell, source, mg) or 0.0) >= sum_mg)
    if (fill_mg := next(enough_mg, None)) is not None:
        ways.append(f"{format_mass(fill_mg)} in it")
    return f"{', or '.join(ways)}, or another mortar"
