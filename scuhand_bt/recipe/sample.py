"""A sample, and what it asks of the lab: room in its containers, range of the balance, powder, reach.

What it takes of its sources and puts into its containers is told by what its workflow does (`recipe/flow.py`).
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from scuhand_bt.cell import places
from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.device_specs.balance import BalanceSpec
from scuhand_bt.dosing.strokes import LOAD_AIM, scooped_for_mg
from scuhand_bt.motion import ApexPose, Mount, unreachable_reason
from scuhand_bt.problems import Mark, Problems
from scuhand_bt.quantity import counted, format_mass
from scuhand_bt.recipe.composition import Composition
from scuhand_bt.recipe.flow import Flow, Pour, each_of, sources_of
from scuhand_bt.specs import Container, Powder, Source
from scuhand_bt.yaml_source import Node

LEAST_LIMIT_MG = 300.0
"""A load limit that scoops keep, but for some first loads. In dry runs of beads and MSG first loads under limits of 20
and 40 mg were 2 to 4.5 times as much, under 80 and 160 mg 1.6 to 2.3 times, under 320 mg 1.2 to 1.7 times."""


@dataclass(frozen=True)
class Take:
    """So much powder, at most, out of a source; None where nothing bounds it."""

    source: Source
    mass_mg: float | None
    scoop: int | None = None
    """The number of the scoop that it must come of, if it is one."""

    @property
    def needed_mg(self) -> float:
        """The mass, and what each scoop for it loses."""
        if self.mass_mg is None:
            return 0.0
        powder = self.source.powder
        return self.mass_mg + math.ceil(self.mass_mg / powder.load_limit_mg) * powder.scoop_loss_mg


@dataclass(frozen=True)
class Ask:
    """A mass that a sample asks for, of a lot; None for whichever its workflow takes."""

    mass_mg: float
    tolerance_mg: float | None
    lot: str | None = None

    def is_for(self, target_mg: float, lot: str | None) -> bool:
        """Whether it is dispensed towards; a lot of None is one that only the run can tell."""
        is_lot = self.lot is None or lot in (None, self.lot)
        return is_lot and math.isclose(target_mg, self.mass_mg, rel_tol=1e-9)


@dataclass(frozen=True)
class Sample:
    """One container to be filled: a workflow and its inputs."""

    mark: Mark
    id: str
    workflow: str
    inputs: Mapping[str, Any]
    flow: Flow
    """What its workflow doses, in the order in which it does."""
    composition: Composition | None = None
    """What it is to be composed of, if its recipe says that."""

    @cached_property
    def asks(self) -> tuple[Ask, ...]:
        """What its container is to hold: its mass, or that of each powder of its composition."""
        if self.composition is not None:
            return tuple(Ask(one.target_mg, one.tolerance_mg, one.lot) for one in self.composition.powders)
        return (Ask(self.mass_mg, self.tolerance_mg),) if self.mass_mg is not None else ()

    @cached_property
    def takes(self) -> tuple[Take, ...]:
        """What it takes from its sources in that order: a dose counts what its container holds already."""
        takes, held_mg = [], dict[tuple[str | None, str], float]()
        by_name = {source.name: source for source in sources_of(self.inputs)}
        for pour in self.flow.pours:
            if pour.source and pour.most_mg is None:
                takes.append(Take(by_name[pour.source], None))
            elif pour.source and pour.most_mg is not None:
                before_mg = held_mg.get((pour.container, pour.source), 0.0)
                takes.append(Take(by_name[pour.source], max(0.0, pour.most_mg - before_mg), pour.scoop))
                held_mg[pour.container, pour.source] = max(before_mg, pour.most_mg)
        return tuple(takes)

    @property
    def filled(self) -> Mapping[str, tuple[Pour, ...]]:
        """By container, the largest dose of each lot into it, as far as that has a bound."""
        largest: dict[str, dict[str, Pour]] = {}
        for pour in self.flow.pours:
            if pour.container and pour.lot and pour.most_mg is not None:
                of_container = largest.setdefault(pour.container, {})
                if pour.lot not in of_container or pour.accepted_mg > of_container[pour.lot].accepted_mg:
                    of_container[pour.lot] = pour
        return {container: tuple(pours.values()) for container, pours in largest.items()}

    @cached_property
    def sources(self) -> tuple[Source, ...]:
        """All of its sources, in the order in which its workflow takes from them; then those it takes nothing from."""
        in_order = [take.source for take in self.takes] + sources_of(self.inputs)
        return tuple({source.name: source for source in in_order}.values())

    def may_keep(self, source: Source) -> bool:
        """Whether what is left of a source in the cone may be there still when its workflow has ended."""
        return any(keeping is None or source.is_kept(keeping) for keeping in self.flow.leaves)

    @property
    def last_source(self) -> Source | None:
        """Whose powder the sheet has touched when its workflow has ended."""
        return self.takes[-1].source if self.takes else next(iter(self.sources), None)

    @cached_property
    def all_containers(self) -> Sequence[Container]:
        return [value for _, value in each_of(self.inputs) if isinstance(value, Container)]

    @cached_property
    def containers(self) -> Sequence[Container]:
        """Those that its mass may be for: its own called `container`, else all of its own."""
        own = self.all_containers
        return [value for value in own if value is self.inputs.get("container")] or own

    @property
    def container(self) -> Container | None:
        return next(iter(self.containers), None)

    @property
    def mass_mg(self) -> float | None:
        return self._mass("mass")

    @property
    def tolerance_mg(self) -> float | None:
        return self._mass("tolerance")

    @property
    def powder_tolerances(self) -> list[tuple[Powder, float]]:
        """Within what each of its powders is to be dosed, as far as its recipe says."""
        of_lot = {ask.lot: ask.tolerance_mg for ask in self.asks}
        found = [(source.powder, of_lot.get(source.sheet_key, self.tolerance_mg)) for source in self.sources]
        return [(powder, tolerance_mg) for powder, tolerance_mg in found if tolerance_mg is not None]

    @property
    def least_tolerance_mg(self) -> float | None:
        """The narrowest that it asks for."""
        found = (self.tolerance_mg, *(ask.tolerance_mg for ask in self.asks))
        return min((one for one in found if one is not None), default=None)

    def is_dosed_into(self, container_id: str) -> bool:
        """Whether its mass may be for this container; any may be where it has none of its own."""
        return not self.containers or any(one.id == container_id for one in self.containers)

    def ask_for(self, target_mg: float, lot: str | None) -> Ask | None:
        """What it asks for that is dispensed towards, if it is."""
        return next((ask for ask in self.asks if ask.is_for(target_mg, lot)), None)

    def _mass(self, name: str) -> float | None:
        value = self.inputs.get(name)
        return value if isinstance(value, float) else None


@dataclass(frozen=True)
class Demand:
    """What a source has, and what samples take from it: their masses, and what each scoop loses."""

    source: Source
    doses_mg: tuple[float, ...]
    """Of each sample that takes of it, in their order, losses included."""
    samples: int
    discarded_mg: float
    """What their scoops are to bring more, and is discarded before the last one: after that nothing lacks it."""
    refilled_mg: float | None
    """What it holds after the refill that fills it most; None where the plan has none."""

    @property
    def needed_mg(self) -> float:
        return sum(self.doses_mg)

    def doubt_of(self, mass_mg: float) -> str:
        """Why so much may be too little, though samples need no more; "" where it is enough."""
        if self.discarded_mg == 0.0 or self.needed_mg + self.discarded_mg <= mass_mg:
            return ""
        needs = f"its samples need {format_mass(self.needed_mg)} with losses"
        gone = f"some {self.discarded_mg / 1000:.1f} g are discarded before the last one"
        return f"{needs}, and as scoops bring more than a dose {gone}: it may run out"


def demand_of(samples: Sequence[Sample], source: Source, refilled_mg: float | None = None) -> Demand:
    """What these samples need of a source, which refills bring to so much at the most."""
    users = sum(any(one.name == source.name for one in sample.sources) for sample in samples)
    discarded = [mg for mg in (discarded_mg(sample, source) for sample in samples) if mg > 0.0]
    doses = tuple(mg for mg in (needed_mg(sample, source) for sample in samples) if mg > 0.0)
    return Demand(source, doses, users, sum(discarded[:-1]), refilled_mg)


def needed_mg(sample: Sample, source: Source) -> float:
    """What a sample needs of a source, with losses."""
    return sum(take.needed_mg for take in sample.takes if take.source.name == source.name)


def discarded_mg(sample: Sample, source: Source) -> float:
    """What a sample's last scoop from a source is to bring more than it needs, where that is discarded.

    Of a mortar that holds little a scoop brings less. It is for planning: what a run discards, only it knows.
    """
    takes_mg = sum(take.mass_mg or 0.0 for take in sample.takes if take.source.name == source.name)
    if not source.is_discarded or takes_mg == 0.0:
        return 0.0
    most_mg = LOAD_AIM * source.powder.load_limit_mg
    last_mg = takes_mg - most_mg * (math.ceil(takes_mg / most_mg) - 1)
    return min(scooped_for_mg(last_mg), most_mg) - last_mg


def lent_mg(samples: Sequence[Sample], source: Source) -> float:
    """What samples of other sources may take of this one, whose powder is kept in the cone for its lot.

    In their order in the recipe: what comes after the last sample of this source takes nothing that that lacks.
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


def check_source(source: Source, cell: CellSpec, marks: Mapping[str, Node], problems: Problems) -> None:
    """The source's powder must fit into its mortar, and come where the hand opens as wide as it can.

    `marks` are the places of its values.
    """
    powder, mortar, widest_mm = source.powder, source.mortar, cell.hand.max_opening_mm
    if powder.belief.least_mm >= widest_mm:
        least = f"of {powder.name} {powder.belief.little_comes}"
        if powder.belief.threshold_mm >= widest_mm:
            least = f"nothing of {powder.name} comes up to its belief's 'threshold', {powder.belief.threshold_mm:g} mm"
        remedy = "correct it in robot/powders.yaml, or the hand's 'max_opening' in robot/cell.yaml"
        problems.add(
            marks["powder"].mark, f"the hand opens to {widest_mm:g} mm, and {least}", remedy, code="never-opened"
        )
    if powder.load_limit_mg < LEAST_LIMIT_MG:
        limit, least = format_mass(powder.load_limit_mg), format_mass(LEAST_LIMIT_MG)
        what = f"the 'load_limit' of {powder.name}, {limit}, is not kept: a scoop may bring several times as much"
        remedy = f"{least} or more in robot/powders.yaml, if the cone may hold that"
        problems.warn(marks["powder"].mark, what, remedy, code="small-load")
    holds_mg = source.capacity_mg
    if source.amount_mg > holds_mg:
        what = f"{format_mass(source.amount_mg)} of {powder.name} does not fit into '{mortar.name}'"
        problems.add(marks["amount"].mark, what, f"it holds {format_mass(holds_mg)}", code="source-overfull")


def check_sample(
    sample: Sample, own: Mapping[str, Node], shared: Mapping[str, Node], cell: CellSpec, problems: Problems
) -> None:
    """One sample against its container, its powder, the balance and the changer.

    `own` and `shared` are the places of its values: its own, and the recipe's defaults.
    """

    def at(*names: str) -> Mark:
        """Where a value stands; for one that disagrees with another, in the sample that puts them together."""
        places = [own[name] for name in names if name in own]
        if not places and len(names) == 1:
            places = [shared[name] for name in names if name in shared]
        return places[0].mark if places else sample.mark

    balance, changer = cell.balance, cell.changer
    for key, container in each_of(sample.inputs):
        if isinstance(container, Container) and changer.driver != "operator" and not changer.takes(container.name):
            what = f"the changer has no slot for a container of the kind {container.name}"
            problems.add(at(key), what, f"it has slots for: {', '.join(changer.kinds)}", code="no-slot")
    mass_mg, tolerance_mg = sample.mass_mg, sample.tolerance_mg
    if mass_mg is not None and mass_mg <= 0:
        problems.add(at("mass"), f"the mass is {mass_mg:g} mg", "more than 0", code="bad-mass")
        return
    if tolerance_mg is not None and tolerance_mg < balance.least_tolerance_mg:
        what = f"the tolerance {tolerance_mg:g} mg cannot be told with a readability of {balance.readability_mg:g} mg"
        problems.add(at("tolerance"), what, f"at least {balance.least_tolerance_mg:g} mg", code="fine-tolerance")
    elif mass_mg is not None and tolerance_mg is not None and mass_mg <= tolerance_mg:
        what = f"the mass {mass_mg:g} mg is not more than its tolerance, {tolerance_mg:g} mg"
        problems.add(at("mass", "tolerance"), what, code="wide-tolerance")
    for pour in sample.flow.pours:
        if pour.most_mg is not None and pour.most_mg <= 0:
            what = f"the mass taken from '{pour.source}' is {pour.most_mg:g} mg"
            problems.add(at(pour.mass_input or "mass"), what, "more than 0", code="bad-mass")
            return
    for key, container in each_of(sample.inputs):
        if isinstance(container, Container):
            pours = sample.filled.get(container.id, ())
            marked = at(*(pour.mass_input for pour in pours[:1] if pour.mass_input), key)
            _check_room(container, pours, sources_of(sample.inputs), balance, marked, problems)


def _check_room(
    container: Container,
    pours: Sequence[Pour],
    sources: Sequence[Source],
    balance: BalanceSpec,
    mark: Mark,
    problems: Problems,
) -> None:
    """What goes into one container must fit into it, and on the balance: the most that is accepted as in tolerance."""
    filled_mg = sum(pour.accepted_mg for pour in pours)
    if pours and container.empty_mass_mg + filled_mg > balance.maximum_mg:
        together = f"'{container.name}' ({format_mass(container.empty_mass_mg)}) and {format_mass(filled_mg)}"
        maximum = f"its maximum is {format_mass(balance.maximum_mg)}"
        problems.add(mark, f"{together} are too heavy for the balance", maximum, code="too-heavy")
    powders = {source.name: source.powder for source in sources}
    parts = [(pour, powders[pour.source]) for pour in pours if pour.source]
    if sum(pour.accepted_mg / powder.bulk_density_mg_per_mm3 for pour, powder in parts) > container.capacity_mm3:
        said = " and ".join(f"{format_mass(pour.most_mg or 0.0)} of {powder.name}" for pour, powder in parts)
        volume_mm3 = sum((pour.most_mg or 0.0) / powder.bulk_density_mg_per_mm3 for pour, powder in parts)
        fits = "does not fit" if len(parts) == 1 else "do not fit"
        what = f"{said} ({volume_mm3 / 1000:.2f} cm³) {fits} into '{container.name}'"
        if (beside_mg := sum(pour.beside_mg for pour, _ in parts)) > 0.0:
            what += f" with the {format_mass(beside_mg)} more that are in tolerance"
        holds = f"it holds {container.capacity_mm3 / 1000:.2f} cm³"
        if len(parts) == 1:
            holds = f"{holds}, {format_mass(container.capacity_mm3 * parts[0][1].bulk_density_mg_per_mm3)}"
        problems.add(mark, what, holds, code="container-overfull")


def check_demand(
    samples: Sequence[Sample],
    sources: Mapping[str, Source],
    marks: Mapping[str, Mark],
    problems: Problems,
    *,
    may_refill: bool,
) -> None:
    """Each source must hold what its samples need, losses included; one that is refilled, what any of them needs.

    `may_refill`: the lab has the workflow by which a person refills one on the way.
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
            remedy = "more powder, `leftover: keep` or `return`, or see by `plan` what dry runs discard"
            problems.warn(marks[name], what, remedy, code="source-discarded")
        elif source.refill_mg is None and (lent := lent_mg(samples, source)) > source.amount_mg - demand.needed_mg:
            what = f"'{name}' holds {format_mass(source.amount_mg)} of {source.powder.name}, its samples need "
            what += f"{format_mass(demand.needed_mg)} with losses, and what is kept in the cone of it may go to others "
            what += f"of its lot in between, up to {format_mass(lent)}: it may run out"
            remedy = "more powder, the samples of each source one after the other, or `leftover: return`"
            problems.warn(marks[name], what, remedy, code="source-lent")


def _rounded(mass_mg: float, towards: Callable[[float], int]) -> str:
    """A mass to 0.1 mg as a recipe may have it, on this side of what it is."""
    return format_mass(towards(10.0 * mass_mg) / 10.0)


def check_reach(
    samples: Sequence[Sample],
    sources: Mapping[str, Source],
    cell: CellSpec,
    mount: Mount,
    marks: Mapping[str, Mark],
    problems: Problems,
) -> None:
    """The arm must reach every place of the batch with the cone upright."""
    kinds = {kind.name: (kind, sample.mark) for sample in reversed(samples) for kind in sample.all_containers}
    containers = [kind for kind, _ in kinds.values()]
    place_marks = {source.station: marks[name] for name, source in sources.items()}
    for kind, mark in kinds.values():
        place_marks.setdefault(places.over_balance(cell, kind)[0], mark)
    anywhere = samples[0].mark if samples else next(iter(marks.values()), Mark("recipe"))
    for place, position_mm in places.all_places(cell, sources, containers).items():
        pose = ApexPose(np.array(position_mm) / 1000)
        reason = unreachable_reason(pose, mount)
        if reason is not None:
            what = f"the arm cannot reach '{place}' of robot/cell.yaml with the cone upright"
            problems.add(place_marks.get(place, anywhere), what, reason, code="out-of-reach")
