"""What a workflow's doses are: each into what, of what and how much, as `recipe/flow.py` finds them."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from scuhand_bt.problems import Mark
from scuhand_bt.specs import Keeping, Source


@dataclass(frozen=True)
class Pour:
    """A dose: what is dispensed towards, into what, of what, and where that is written.

    None is what is known only when it runs; a container or source "" is one that was never named.
    """

    container: str | None
    source: str | None
    lot: str | None
    mass_mg: float | None
    most_mg: float | None
    """What it is at most; None where nothing bounds it."""
    tolerance_mg: float | None
    mass_mark: Mark
    tolerance_mark: Mark
    mass_input: str | None = None
    """The sample's input that its mass is, if it is one."""
    tolerance_input: str | None = None
    """Likewise of its tolerance."""
    beside_mg: float = 0.0
    """How much more than `most_mg` is still in tolerance, at most; 0 where nothing bounds that."""
    scoop: int | None = None
    """The number of the scoop that it must come of; None where it may be of others, or there is another try."""

    @property
    def place(self) -> tuple[str | None, str | None]:
        """As in a run, the last dose of a lot into a container counts for both."""
        return self.container, self.lot

    def adds_nothing_to(self, before: "Pour") -> bool:
        """Whether an earlier one of its place has brought as much already, as exactly."""
        if self.place != before.place or self.mass_mg is None or before.mass_mg is None:
            return False
        tolerance_mg, before_mg = self.tolerance_mg, before.tolerance_mg
        is_finer = tolerance_mg is not None and before_mg is not None and tolerance_mg < before_mg
        return self.mass_mg <= before.mass_mg and not is_finer

    @property
    def accepted_mg(self) -> float:
        """The most that it may end with in tolerance, as far as it has a bound: there must be room for that."""
        return 0.0 if self.most_mg is None else self.most_mg + self.beside_mg


@dataclass(frozen=True)
class Unfit:
    """A value that a skill or node is given and does not accept, and where it is given that."""

    what: str
    mark: Mark
    input: str | None
    """The sample's input that it is, if it is one."""


@dataclass(frozen=True)
class Weight:
    """A mass that comes on the pan as it is, and where it is given."""

    mass_mg: float
    mark: Mark
    input: str | None
    """The sample's input that it is, if it is one."""


@dataclass(frozen=True)
class Flow:
    """All doses of a workflow in their order, and those that may be the last of their place."""

    pours: tuple[Pour, ...] = ()
    last: frozenset[Pour] = frozenset()
    leaves: frozenset[Keeping | None] = frozenset({None})
    """How what is left in the cone may be dealt with in the end; None where nothing empties that."""
    unfit: tuple[Unfit, ...] = ()
    weights: tuple[Weight, ...] = ()


def sources_of(inputs: Mapping[str, Any]) -> list[Source]:
    """The sources among the inputs of a workflow, each once."""
    return list({value.name: value for _, value in each_of(inputs) if isinstance(value, Source)}.values())


def each_of(inputs: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """The values of inputs, each of those in a list by itself, with the input's name."""
    for name, value in inputs.items():
        for one in value if isinstance(value, tuple) else (value,):
            yield name, one
