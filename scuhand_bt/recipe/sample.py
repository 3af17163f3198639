"""A sample, and its checks against the lab: room in containers, range of the balance, powder, reach of the arm.

What it takes from sources and puts into containers is known from its workflow's flow (`recipe/flow.py`).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from scuhand_bt.cell import places
from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.device_specs.balance import BalanceSpec
from scuhand_bt.motion import ApexPose, Mount, unreachable_reason
from scuhand_bt.problems import Mark, Problems
from scuhand_bt.quantity import format_mass
from scuhand_bt.recipe.composition import Composition
from scuhand_bt.recipe.pour import Flow, Pour, each_of, sources_of
from scuhand_bt.specs import Container, Powder, Source
from scuhand_bt.yaml_source import Node


@dataclass(frozen=True)
class Take:
    """A mass of powder taken from a source, as an upper bound; None if it has none."""

    source: Source
    mass_mg: float | None
    scoop: int | None = None
    """The number of the scoop that it must come from, if it must be one."""

    @property
    def needed_mg(self) -> float:
        """The mass, and the loss of each scoop that it takes."""
        if self.mass_mg is None:
            return 0.0
        powder = self.source.powder
        return self.mass_mg + math.ceil(self.mass_mg / powder.load_limit_mg) * powder.scoop_loss_mg


@dataclass(frozen=True)
class Ask:
    """A mass that a sample asks for. With a `lot` of None, the workflow decides on the lot."""

    mass_mg: float
    tolerance_mg: float | None
    lot: str | None = None

    def is_for(self, target_mg: float, lot: str | None) -> bool:
        """Whether a dose with this target fulfils it. A lot of None is one that only the run knows."""
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
    """What its workflow doses, in order."""
    composition: Composition | None = None
    """What it is to be composed of, if the recipe has `compose`."""

    @cached_property
    def asks(self) -> tuple[Ask, ...]:
        """What its container is to hold: its mass, or that of each powder of its composition."""
        if self.composition is not None:
            return tuple(Ask(one.target_mg, one.tolerance_mg, one.lot) for one in self.composition.powders)
        return (Ask(self.mass_mg, self.tolerance_mg),) if self.mass_mg is not None else ()

    @cached_property
    def takes(self) -> tuple[Take, ...]:
        """What it takes from its sources, in order. A dose brings only what its container does not hold yet."""
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
        """By container: the largest bounded dose of each lot."""
        largest: dict[str, dict[str, Pour]] = {}
        for pour in self.flow.pours:
            if pour.container and pour.lot and pour.most_mg is not None:
                of_container = largest.setdefault(pour.container, {})
                if pour.lot not in of_container or pour.accepted_mg > of_container[pour.lot].accepted_mg:
                    of_container[pour.lot] = pour
        return {container: tuple(pours.values()) for container, pours in largest.items()}

    @cached_property
    def sources(self) -> tuple[Source, ...]:
        """All its sources: first those that its workflow takes from, in that order, then the others."""
        in_order = [take.source for take in self.takes] + sources_of(self.inputs)
        return tuple({source.name: source for source in in_order}.values())

    def may_keep(self, source: Source) -> bool:
        """Whether powder of this source may still be in the cone when the workflow has ended."""
        return any(keeping is None or source.is_kept(keeping) for keeping in self.flow.leaves)

    @property
    def last_source(self) -> Source | None:
        """The source whose powder was on the sheet last when the workflow has ended."""
        return self.takes[-1].source if self.takes else next(iter(self.sources), None)

    @cached_property
    def all_containers(self) -> Sequence[Container]:
        return [value for _, value in each_of(self.inputs) if isinstance(value, Container)]

    @cached_property
    def containers(self) -> Sequence[Container]:
        """Those that its mass may be for: the input `container` if it is one, else all."""
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
        """Its powders and the tolerance of each [mg], as far as the recipe has one."""
        of_lot = {ask.lot: ask.tolerance_mg for ask in self.asks}
        found = [(source.powder, of_lot.get(source.sheet_key, self.tolerance_mg)) for source in self.sources]
        return [(powder, tolerance_mg) for powder, tolerance_mg in found if tolerance_mg is not None]

    @property
    def least_tolerance_mg(self) -> float | None:
        """The narrowest tolerance that it asks for; None if it asks for none."""
        found = (self.tolerance_mg, *(ask.tolerance_mg for ask in self.asks))
        return min((one for one in found if one is not None), default=None)

    def is_dosed_into(self, container_id: str) -> bool:
        """Whether its mass may be for this container; true for any if it has none of its own."""
        return not self.containers or any(one.id == container_id for one in self.containers)

    def ask_for(self, target_mg: float, lot: str | None) -> Ask | None:
        """What it asks for that a dose with this target fulfils, if anything."""
        return next((ask for ask in self.asks if ask.is_for(target_mg, lot)), None)

    def _mass(self, name: str) -> float | None:
        value = self.inputs.get(name)
        return value if isinstance(value, float) else None


def check_sample(
    sample: Sample, own: Mapping[str, Node], shared: Mapping[str, Node], cell: CellSpec, problems: Problems
) -> None:
    """Check one sample against its containers, its powders, the balance and the changer.

    `own` are its own values, `shared` the recipe's defaults; both tell where to report a mistake.
    """

    def at(*names: str) -> Mark:
        """Where a value stands; for one that disagrees with another, in the sample that puts them together."""
        places = [own[name] for name in names if name in own]
        if not places and len(names) == 1:
            places = [shared[name] for name in names if name in shared]
        return places[0].mark if places else sample.mark

    def where_told(name: str | None, mark: Mark) -> Mark:
        """Where an input's value stands in the recipe; `mark`, where that does not tell it."""
        return at(name) if name is not None and (name in own or name in shared) else mark

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
        _add_too_fine(tolerance_mg, at("tolerance"), balance, problems)
        if tolerance_mg <= 0:
            return
    elif mass_mg is not None and tolerance_mg is not None and mass_mg <= tolerance_mg:
        what = f"the mass {mass_mg:g} mg is not more than its tolerance, {tolerance_mg:g} mg"
        problems.add(at("mass", "tolerance"), what, code="wide-tolerance")
    for pour in sample.flow.pours:
        if pour.most_mg is not None and pour.most_mg <= 0:
            what = f"the mass taken from '{pour.source}' is {pour.most_mg:g} mg"
            problems.add(at(pour.mass_input or "mass"), what, "more than 0", code="bad-mass")
            return
    fine = {
        (pour.tolerance_mg, where_told(pour.tolerance_input, pour.tolerance_mark)): None
        for pour in sample.flow.pours
        if pour.tolerance_mg is not None
        and pour.tolerance_mg < balance.least_tolerance_mg
        and pour.tolerance_input != "tolerance"
    }
    for fine_mg, mark in fine:
        _add_too_fine(fine_mg, mark, balance, problems)
    for one in sample.flow.unfit:
        problems.add(where_told(one.input, one.mark), one.what, code="bad-value")
    for weight in sample.flow.weights:
        if weight.mass_mg > balance.maximum_mg:
            mark = where_told(weight.input, weight.mark)
            _add_too_heavy(f"a weight of {format_mass(weight.mass_mg)} is", balance, mark, problems)
    for key, container in each_of(sample.inputs):
        if isinstance(container, Container):
            pours = sample.filled.get(container.id, ())
            marked = at(*(pour.mass_input for pour in pours[:1] if pour.mass_input), key)
            _check_room(container, pours, sources_of(sample.inputs), balance, marked, problems)


def _add_too_fine(tolerance_mg: float, mark: Mark, balance: BalanceSpec, problems: Problems) -> None:
    what = f"the tolerance {tolerance_mg:g} mg is too fine for a readability of {balance.readability_mg:g} mg"
    problems.add(mark, what, f"at least {balance.least_tolerance_mg:g} mg", code="fine-tolerance")


def _add_too_heavy(what: str, balance: BalanceSpec, mark: Mark, problems: Problems) -> None:
    maximum = f"its maximum is {format_mass(balance.maximum_mg)}"
    problems.add(mark, f"{what} too heavy for the balance", maximum, code="too-heavy")


def _check_room(
    container: Container,
    pours: Sequence[Pour],
    sources: Sequence[Source],
    balance: BalanceSpec,
    mark: Mark,
    problems: Problems,
) -> None:
    """What goes into a container must fit into it and be within the balance's range, up to the top of its tolerance."""
    filled_mg = sum(pour.accepted_mg for pour in pours)
    if container.empty_mass_mg + filled_mg > balance.maximum_mg:
        what = f"'{container.name}' ({format_mass(container.empty_mass_mg)})"
        what += f" and {format_mass(filled_mg)} are" if pours else " is"
        _add_too_heavy(what, balance, mark, problems)
    powders = {source.name: source.powder for source in sources}
    parts = [(pour, powders[pour.source]) for pour in pours if pour.source]
    if sum(pour.accepted_mg / powder.bulk_density_mg_per_mm3 for pour, powder in parts) > container.capacity_mm3:
        said = " and ".join(f"{format_mass(pour.most_mg or 0.0)} of {powder.name}" for pour, powder in parts)
        volume_mm3 = sum((pour.most_mg or 0.0) / powder.bulk_density_mg_per_mm3 for pour, powder in parts)
        fits = "does not fit" if len(parts) == 1 else "do not fit"
        what = f"{said} ({volume_mm3 / 1000:.2f} cm³) {fits} into '{container.name}'"
        if (beside_mg := sum(pour.beside_mg for pour, _ in parts)) > 0.0:
            what += f" with the {format_mass(beside_mg)} more that the tolerance allows"
        holds = f"it holds {container.capacity_mm3 / 1000:.2f} cm³"
        if len(parts) == 1:
            holds = f"{holds}, {format_mass(container.capacity_mm3 * parts[0][1].bulk_density_mg_per_mm3)}"
        problems.add(mark, what, holds, code="container-overfull")


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
