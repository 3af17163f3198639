"""The sources of a recipe: mortars with powder at stations, read and held against the lab."""

import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Annotated

from scuhand_bt.lab import Lab
from scuhand_bt.problems import Mark, Problems, shorten
from scuhand_bt.quantity import Milligrams, format_mass
from scuhand_bt.recipe.sample import check_source
from scuhand_bt.specs import Assay, Positive, Source
from scuhand_bt.validation import validate
from scuhand_bt.yaml_source import Entries, Node, Scalar, describe

REFILL = "refill"
"""The lab's workflow in which a person puts more powder into a mortar; input `source`."""


class SourceText(Assay):
    """A source as a recipe writes it."""

    station: str
    container: str
    powder: str
    amount_mg: Annotated[Milligrams, Positive]
    refill_mg: Annotated[Milligrams, Positive] | None = None
    lot: str = ""


@dataclass
class SourcesReader:
    """Reads `sources`; `source_marks` and `marks` are filled with the places of their names and values."""

    lab: Lab
    problems: Problems
    source_marks: dict[str, Mark]
    marks: dict[str, Mark]

    def read(self, node: Node | None) -> dict[str, Source]:
        """The sources of this mapping that are right; all that is wrong is noted."""
        if node is None:
            return {}  # as a check of the cell needs none
        if not isinstance(node, Entries) or not node.values:
            self.problems.add(node.mark, f"'sources': {describe(node)} names no source", code="wrong-shape")
            return {}
        sources: dict[str, Source] = {}
        for name, value in node.values.items():
            self.source_marks[name] = node.keys[name]
            source = self._read_source(name, value)
            if source is not None:
                sources[name] = source
        by_station: dict[str, str] = {}
        for name, source in sources.items():
            if source.station in by_station:
                self.problems.add(
                    self.source_marks[name],
                    f"'{by_station[source.station]}' stands at {source.station} already",
                    code="station-taken",
                )
            by_station[source.station] = name
        self._check_apart([source for name, source in sources.items() if by_station[source.station] == name])
        self._check_assays(sources.values())
        return sources

    def _check_apart(self, sources: Sequence[Source]) -> None:
        """Mortars side by side must have room."""
        for one, other in combinations(sources, 2):
            places_mm = [self.lab.cell.stations[source.station].position_mm[:2] for source in (one, other)]
            room_mm = (one.mortar.outer_diameter_mm + other.mortar.outer_diameter_mm) / 2
            if (apart_mm := math.dist(*places_mm)) < room_mm:
                what = f"the mortars of '{one.name}' and '{other.name}' stand {apart_mm:.0f} mm apart"
                allowed = f"they need {room_mm:.0f} mm; move a station in robot/cell.yaml"
                self.problems.add(self.source_marks[other.name], what, allowed, code="mortars-overlap")

    def _check_assays(self, sources: Iterable[Source]) -> None:
        """One lot has one assay: what is in the cone of it is dosed for a sample that names another mortar of it."""
        assayed: dict[str, Source] = {}
        for source in sources:
            if source.purity_ratio is None:
                continue
            other = assayed.setdefault(source.sheet_key, source)
            if any(getattr(source, name) != getattr(other, name) for name in Assay.model_fields):
                what = f"'{other.name}' and '{source.name}' are one lot, {source.sheet_key}, and their assays differ"
                remedy = "the same `purity` and `water`, or a `lot` of its own for each"
                self.problems.add(self.source_marks[source.name], what, remedy, code="lot-assays")

    def _read_source(self, name: str, node: Node) -> Source | None:
        lab = self.lab
        if isinstance(node, Entries):
            known = [info.alias or "" for info in SourceText.model_fields.values()]
            unknown = [key for key in node.keys if key not in known]
            for key in unknown:
                self.problems.add(
                    node.keys[key], f"unknown key '{shorten(key)}'", unknown=key, known=known, code="unknown-key"
                )
            node = node.without(*unknown)
        before = len(self.problems.found)
        text = validate(SourceText, node, self.problems)
        if not isinstance(node, Entries):
            return None
        mortar_stations = [s.name for s in lab.cell.stations.values() if s.kind == "mortar"]
        self._require_known(node, "station", mortar_stations, "mortar station", "station")
        self._require_known(node, "container", lab.library.mortars, "mortar", "mortar")
        self._require_known(node, "powder", lab.library.powders, "powder", "powder")
        if text is None or len(self.problems.found) > before:
            return None
        source = Source(
            name=name,
            station=text.station,
            mortar=lab.library.mortars[text.container],
            powder=lab.library.powders[text.powder],
            amount_mg=text.amount_mg,
            refill_mg=text.refill_mg,
            lot=text.lot,
            **{name: getattr(text, name) for name in Assay.model_fields},
        )
        self.marks |= {f"sources.{name}": self.source_marks[name]}
        self.marks |= {f"sources.{name}.{key}": value.mark for key, value in node.values.items()}
        check_source(source, lab.cell, node.values, self.problems)
        if source.refill_mg is not None and source.refill_mg > source.amount_mg:
            what = f"a refill of {format_mass(source.refill_mg)} is more than the mortar holds at the start"
            allowed = f"at most its amount, {format_mass(source.amount_mg)}"
            self.problems.add(node.values["refill"].mark, what, allowed, code="source-overfull")
        return source

    def _require_known(self, node: Entries, key: str, known: Collection[str], what: str, kind: str) -> None:
        value = node.get(key)
        if not isinstance(value, Scalar) or value.text is None or value.text in known:
            return
        if not self.lab.library.broken.tell(kind, value.text, self.problems):
            self.problems.add(
                value.mark, f"unknown {what} {describe(value)}", unknown=value.text, known=known, code="unknown-name"
            )
