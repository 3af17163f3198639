"""A sample, and what it asks of the lab: room in the container, range of the balance, powder, reach."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from scuhand_bt.cell import places
from scuhand_bt.cell_spec import BalanceSpec, CellSpec
from scuhand_bt.motion import ApexPose, unreachable_reason
from scuhand_bt.problems import Mark, Problems
from scuhand_bt.quantity import format_mass
from scuhand_bt.specs import Container, Source
from scuhand_bt.yaml_source import Node


@dataclass(frozen=True)
class Sample:
    """One container to be filled: a workflow and its inputs."""

    mark: Mark
    id: str
    workflow: str
    inputs: Mapping[str, Any]

    @property
    def source(self) -> Source | None:
        return next((value for value in self.inputs.values() if isinstance(value, Source)), None)

    @property
    def container(self) -> Container | None:
        return next((value for value in self.inputs.values() if isinstance(value, Container)), None)

    @property
    def mass_mg(self) -> float | None:
        return self._mass("mass")

    @property
    def tolerance_mg(self) -> float | None:
        return self._mass("tolerance")

    def _mass(self, name: str) -> float | None:
        value = self.inputs.get(name)
        return value if isinstance(value, float) else None

    @property
    def scoops(self) -> int:
        """Loads of the cone that the mass needs, at the least."""
        if self.source is None or self.mass_mg is None:
            return 0
        return math.ceil(self.mass_mg / self.source.powder.load_limit_mg)


def demand_mg(samples: Iterable[Sample], source: Source) -> float:
    """The powder that samples take from a source: their masses, and what each scoop loses."""
    return sum(
        sample.mass_mg + sample.scoops * source.powder.scoop_loss_mg
        for sample in samples
        if sample.source is not None and sample.source.name == source.name and sample.mass_mg is not None
    )


def check_source(source: Source, mark: Mark, problems: Problems) -> None:
    """The source's powder must fit into its mortar."""
    powder, mortar = source.powder, source.mortar
    holds_mg = mortar.capacity_mm3 * powder.bulk_density_mg_per_mm3
    if source.amount_mg > holds_mg:
        what = f"{format_mass(source.amount_mg)} of {powder.name} does not fit into '{mortar.name}'"
        problems.add(mark, what, f"it holds {format_mass(holds_mg)}")


def check_sample(
    sample: Sample, own: Mapping[str, Node], shared: Mapping[str, Node], balance: BalanceSpec, problems: Problems
) -> None:
    """One sample against its container, its powder and the balance.

    `own` and `shared` are the places of its values: its own, and the recipe's defaults.
    """

    def at(*names: str) -> Mark:
        """Where a value stands; for one that disagrees with another, in the sample that puts them together."""
        places = [own[name] for name in names if name in own]
        if not places and len(names) == 1:
            places = [shared[name] for name in names if name in shared]
        return places[0].mark if places else sample.mark

    mass_mg, tolerance_mg = sample.mass_mg, sample.tolerance_mg
    container, source = sample.container, sample.source
    if mass_mg is not None and mass_mg <= 0:
        problems.add(at("mass"), f"the mass is {mass_mg:g} mg", "more than 0")
        return
    if tolerance_mg is not None and tolerance_mg < balance.least_tolerance_mg:
        what = f"the tolerance {tolerance_mg:g} mg cannot be told with a readability of {balance.readability_mg:g} mg"
        problems.add(at("tolerance"), what, f"at least {balance.least_tolerance_mg:g} mg")
    elif mass_mg is not None and tolerance_mg is not None and mass_mg <= tolerance_mg:
        problems.add(
            at("mass", "tolerance"), f"the mass {mass_mg:g} mg is not more than its tolerance, {tolerance_mg:g} mg"
        )
    if mass_mg is None or container is None:
        return
    if container.empty_mass_mg + mass_mg > balance.maximum_mg:
        together = f"'{container.name}' ({format_mass(container.empty_mass_mg)}) and {format_mass(mass_mg)}"
        problems.add(
            at("mass", "container"),
            f"{together} are too heavy for the balance",
            f"its maximum is {format_mass(balance.maximum_mg)}",
        )
    if source is None:
        return
    density = source.powder.bulk_density_mg_per_mm3
    if mass_mg / density > container.capacity_mm3:
        volume = f"{mass_mg / density / 1000:.2f} cm³"
        what = f"{format_mass(mass_mg)} of {source.powder.name} ({volume}) does not fit into '{container.name}'"
        holds = f"{container.capacity_mm3 / 1000:.2f} cm³, {format_mass(container.capacity_mm3 * density)}"
        problems.add(at("mass", "container"), what, f"it holds {holds}")


def check_demand(
    samples: Sequence[Sample], sources: Mapping[str, Source], marks: Mapping[str, Mark], problems: Problems
) -> None:
    """Each source must hold what its samples need, losses included."""
    for name, source in sources.items():
        needed_mg = demand_mg(samples, source)
        if needed_mg > source.amount_mg:
            users = sum(1 for sample in samples if sample.source is not None and sample.source.name == name)
            problems.add(
                marks[name],
                f"'{name}' holds {format_mass(source.amount_mg)} of {source.powder.name}, but its {users} samples "
                f"need {format_mass(needed_mg)} with losses",
            )


def check_reach(
    samples: Sequence[Sample],
    sources: Mapping[str, Source],
    cell: CellSpec,
    marks: Mapping[str, Mark],
    problems: Problems,
) -> None:
    """The arm must reach every place of the batch with the cone upright."""
    kinds = {sample.container.name: sample for sample in samples if sample.container is not None}
    containers = [sample.container for sample in kinds.values() if sample.container is not None]
    place_marks = {source.station: marks[name] for name, source in sources.items()}
    for sample in kinds.values():
        assert sample.container is not None
        place_marks.setdefault(places.over_balance(cell, sample.container)[0], sample.mark)
    anywhere = samples[0].mark if samples else next(iter(marks.values()), Mark("recipe"))
    for place, position_mm in places.all_places(cell, sources, containers).items():
        pose = ApexPose(np.array(position_mm) / 1000)
        reason = unreachable_reason(pose, cell.hand.apex_offset_mm / 1000)
        if reason is not None:
            what = f"the arm cannot reach '{place}' of robot/cell.yaml with the cone upright"
            problems.add(place_marks.get(place, anywhere), what, reason)
