"""The doses of a workflow as `recipe/flow.py` finds them: into which container, of which source, and how much."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from scuhand_bt.problems import Mark
from scuhand_bt.specs import Keeping, Source


@dataclass(frozen=True)
class Pour:
    """One dose: target, container, source, and where they are written.

    None means known only when it runs. A container or source "" was never named.
    """

    container: str | None
    source: str | None
    lot: str | None
    mass_mg: float | None
    most_mg: float | None
    """Upper bound of the target; None if it has none."""
    tolerance_mg: float | None
    mass_mark: Mark
    tolerance_mark: Mark
    mass_input: str | None = None
    """The sample's input that the mass is, if it is one."""
    tolerance_input: str | None = None
    """The sample's input that the tolerance is, if it is one."""
    beside_mg: float = 0.0
    """How much above `most_mg` is still in tolerance, at most; 0 if that has no bound."""
    scoop: int | None = None
    """The number of the scoop that it must come from; None if it may come from several, or is tried again."""

    @property
    def place(self) -> tuple[str | None, str | None]:
        """Container and lot. As in a run, a dose of the same lot into the same container replaces earlier ones."""
        return self.container, self.lot

    def adds_nothing_to(self, before: "Pour") -> bool:
        """Whether an earlier dose of the same place already brings as much, with as narrow a tolerance."""
        if self.place != before.place or self.mass_mg is None or before.mass_mg is None:
            return False
        tolerance_mg, before_mg = self.tolerance_mg, before.tolerance_mg
        is_finer = tolerance_mg is not None and before_mg is not None and tolerance_mg < before_mg
        return self.mass_mg <= before.mass_mg and not is_finer

    @property
    def accepted_mg(self) -> float:
        """The most that may be dispensed in tolerance, for which there must be room; 0 if it has no bound."""
        return 0.0 if self.most_mg is None else self.most_mg + self.beside_mg


@dataclass(frozen=True)
class Unfit:
    """A value that a skill or node does not accept, and where it is written."""

    what: str
    mark: Mark
    input: str | None
    """The sample's input that the value is, if it is one."""


@dataclass(frozen=True)
class Weight:
    """A mass that is put on the pan as it is, and where it is written."""

    mass_mg: float
    mark: Mark
    input: str | None
    """The sample's input that the mass is, if it is one."""


@dataclass(frozen=True)
class Flow:
    """All doses of a workflow in order, and those that may be the last of their place."""

    pours: tuple[Pour, ...] = ()
    last: frozenset[Pour] = frozenset()
    leaves: frozenset[Keeping | None] = frozenset({None})
    """How the powder left in the cone may be dealt with at the end; None if nothing empties the cone."""
    unfit: tuple[Unfit, ...] = ()
    weights: tuple[Weight, ...] = ()


def sources_of(inputs: Mapping[str, Any]) -> list[Source]:
    """The sources among a workflow's inputs, each once."""
    return list({value.name: value for _, value in each_of(inputs) if isinstance(value, Source)}.values())


def each_of(inputs: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """The name and value of each input; a list gives one pair for each of its items."""
    for name, value in inputs.items():
        for one in value if isinstance(value, tuple) else (value,):
            yield name, one
