"""What a recipe needs of a cell, and what a cell has: by it a job goes to a station that can do it.

Both are names and a few figures, and no rule of a recipe is written anew here: the run at the station checks all, with
the station's own lab, before anything moves.
"""

from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Literal

from pydantic import BaseModel, ConfigDict

from scuhand_bt.lab import Lab, state_folder
from scuhand_bt.lab_state.inventory import Inventory
from scuhand_bt.problems import Problems
from scuhand_bt.quantity import format_mass
from scuhand_bt.recipe.plan import Plan
from scuhand_bt.run.inventory_conflicts import EMPTY_MG
from scuhand_bt.tree.check import check_workflows
from scuhand_bt.tree.library import Library

Kind = Literal["powder", "container", "mortar", "workflow", "mortar station", "vessel"]


class Needs(BaseModel):
    """What a plan names, and what its balance must be able to do."""

    model_config = ConfigDict(frozen=True)

    simulated: bool
    names: Mapping[Kind, tuple[str, ...]]
    lots: Mapping[str, str]
    """The powder lot (`Source.sheet_key`) at each station of a mortar, and that comes into a vessel for leftovers."""
    containers: Mapping[str, int]
    """How many it fills, by kind."""
    heaviest_mg: float
    """What stands on the balance at the most."""
    tolerance_mg: float | None
    """The narrowest one."""
    person: str
    """The first moment that needs one, "" for none."""


class Offer(BaseModel):
    """What a station's cell has."""

    model_config = ConfigDict(frozen=True)

    cell: str
    simulated: bool
    unattended: bool
    names: Mapping[Kind, tuple[str, ...]]
    lots: Mapping[str, str]
    """What stands at its stations by the inventory; empty where nothing is known."""
    slots: Mapping[str, int]
    """Those of its changer, by kind of container, or "" for whichever; none where a person changes containers."""
    maximum_mg: float
    least_tolerance_mg: float


def needs_of(plan: Plan, *, simulated: bool) -> Needs:
    """What this plan needs."""
    samples, sources = plan.recipe.samples, plan.recipe.sources.values()
    taken = [demand.source for demand in plan.demands if demand.samples]
    into = {source.leftover_to: source.sheet_key for source in taken if source.leftover_to}
    containers = [one for sample in samples for one in sample.all_containers]
    filled = [
        one.empty_mass_mg + sum(pour.mass_mg or 0.0 for pour in sample.filled.get(one.id, ()))
        for sample in samples
        for one in sample.all_containers
    ]
    weights = [weight.mass_mg for sample in samples for weight in sample.flow.weights]
    return Needs(
        simulated=simulated,
        names={
            "powder": _sorted(source.powder.name for source in sources),
            "container": _sorted(one.name for one in containers),
            "mortar": _sorted(source.mortar.name for source in sources),
            "workflow": _sorted(job.workflow for job in plan.jobs),
            "mortar station": _sorted(source.station for source in sources),
            "vessel": _sorted(into),
        },
        lots={source.station: source.sheet_key for source in sources} | into,
        containers=Counter(one.name for one in containers),
        heaviest_mg=max((*filled, *weights), default=0.0),
        tolerance_mg=min((one for sample in samples if (one := sample.least_tolerance_mg)), default=None),
        person=next((str(person) for person in plan.persons), ""),
    )


def offer_of(lab: Lab, *, simulated: bool, unattended: bool) -> Offer:
    """What this lab's cell has now. SourceError where its database cannot be read."""
    stock = {} if simulated else Inventory(state_folder(lab), lab.cell.cell).stock(simulated=False)
    holds = {name: one.lot_key for (kind, name), one in stock.items() if kind == "station" and _is_there(one.mass_mg)}
    library, changer = lab.library, lab.cell.changer
    by_kind = {kind: changer.slots_for(kind) for kind in changer.kinds or ("",)}
    return Offer(
        cell=lab.cell.cell,
        simulated=simulated,
        unattended=unattended,
        names={
            "powder": _sorted(library.powders),
            "container": _sorted(library.containers),
            "mortar": _sorted(library.mortars),
            "workflow": _sorted(name for name in library.workflows if _is_sound(name, library)),
            "mortar station": _sorted(one.name for one in lab.cell.stations.values() if one.kind == "mortar"),
            "vessel": _sorted(one.name for one in lab.cell.stations.values() if one.kind == "waste"),
        },
        lots=holds,
        slots={} if changer.driver == "operator" else by_kind,
        maximum_mg=lab.cell.balance.maximum_mg,
        least_tolerance_mg=lab.cell.balance.least_tolerance_mg,
    )


def missing(needs: Needs, offer: Offer) -> list[str]:
    """What a station lacks for it, in words; nothing for one that can do it."""
    return list(_missing(needs, offer))


def _missing(needs: Needs, offer: Offer) -> Iterator[str]:
    if needs.simulated != offer.simulated:
        yield (
            "it has only simulated devices"
            if offer.simulated
            else "it has real devices, but simulated ones are asked for"
        )
    for kind, names in needs.names.items():
        for name in names:
            if name not in offer.names.get(kind, ()):
                yield f"it has no {kind} '{name}'"
    for station, lot in needs.lots.items():
        if (holds := offer.lots.get(station, lot)) != lot:
            yield f"its {station} holds {holds}, not {lot}"
    if needs.heaviest_mg > offer.maximum_mg:
        what = f"{format_mass(offer.maximum_mg)}, and {format_mass(needs.heaviest_mg)} would stand on it"
        yield f"its balance's maximum is {what}"
    if needs.tolerance_mg is not None and needs.tolerance_mg < offer.least_tolerance_mg:
        told = f"{offer.least_tolerance_mg:g} mg, and the recipe's is {needs.tolerance_mg:g} mg"
        yield f"the finest tolerance of its balance is {told}"
    if needs.person and offer.unattended:
        yield f"it is unattended, and a person is {needs.person}"
    yield from _changer_lacks(needs, offer)


def _changer_lacks(needs: Needs, offer: Offer) -> Iterator[str]:
    """Whoever submits may have another changer, by which the plan needs nobody."""
    if not offer.slots:
        if needs.containers and offer.unattended:
            yield "it is unattended, and a person changes its containers"
        return
    for kind, count in ({"": sum(needs.containers.values())} if "" in offer.slots else needs.containers).items():
        slots, of_kind = offer.slots.get(kind, 0), f" for '{kind}'" if kind else ""
        if not slots:
            yield f"its changer has no slot{of_kind}"
        elif offer.unattended and count > slots:
            yield f"it is unattended, and its changer has slots{of_kind} for {slots} of the {count} containers"


def _sorted(names: "Iterator[str] | Mapping[str, object]") -> tuple[str, ...]:
    return tuple(sorted(set(names)))


def _is_sound(workflow: str, library: Library) -> bool:
    """Whether it can be run with what the lab has: a broken skill breaks all workflows that lead to it."""
    problems = Problems()
    check_workflows(library, [workflow], problems)
    return not problems.found


def _is_there(mass_mg: float | None) -> bool:
    return (mass_mg or 0.0) >= EMPTY_MG
