"""Reads the sources of a recipe (vessels with powder at stations) and checks them against the lab."""

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Annotated

from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.lab import Lab
from scuhand_bt.problems import Mark, Problems, shorten
from scuhand_bt.quantity import Milligrams, format_mass
from scuhand_bt.specs import Assay, Positive, Source
from scuhand_bt.validation import validate
from scuhand_bt.yaml_source import Entries, Node, Scalar, describe

REFILL = "refill"
"""The lab's workflow in which a person adds powder to a mortar; its input is `source`."""
LEAST_LIMIT_MG = 300.0
"""The least load limit [mg] that scoops keep, except for some first loads. In dry runs with beads and MSG, first loads
were 2 to 4.5 times limits of 20 and 40 mg. They were 1.6 to 2.3 times 80 and 160 mg, and 1.2 to 1.7 times 320 mg."""


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
    """Reads `sources`. Fills `source_marks` with the places of their names, `marks` with those of names and values."""

    lab: Lab
    problems: Problems
    source_marks: dict[str, Mark]
    marks: dict[str, Mark]

    def read(self, node: Node | None) -> dict[str, Source]:
        """The sources that are right. Mistakes are reported."""
        if node is None:
            return {}  # a recipe that only checks the cell needs none
        if not isinstance(node, Entries) or not node.values:
            self.problems.add(node.mark, f"'sources' must name sources, not be {describe(node)}", code="wrong-shape")
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
        """Mortars side by side must not overlap."""
        for one, other in combinations(sources, 2):
            places_mm = [self.lab.cell.stations[source.station].position_mm[:2] for source in (one, other)]
            room_mm = (one.mortar.outer_diameter_mm + other.mortar.outer_diameter_mm) / 2
            if (apart_mm := math.dist(*places_mm)) < room_mm:
                what = f"the mortars of '{one.name}' and '{other.name}' are only {apart_mm:.0f} mm apart"
                allowed = f"they need {room_mm:.0f} mm; move a station in robot/cell.yaml"
                self.problems.add(self.source_marks[other.name], what, allowed, code="mortars-overlap")

    def _check_assays(self, sources: Iterable[Source]) -> None:
        """All sources of a lot must have the same assay: powder of one may be dosed for a sample of another."""
        assayed: dict[str, Source] = {}
        for source in sources:
            if source.purity_ratio is None:
                continue
            other = assayed.setdefault(source.sheet_key, source)
            if any(getattr(source, name) != getattr(other, name) for name in Assay.model_fields):
                what = (
                    f"'{other.name}' and '{source.name}' are the same lot, {source.sheet_key}, but their assays differ"
                )
                remedy = "write the same `purity` and `water`, or a `lot` of its own for each"
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
        _check_source(source, lab.cell, node.values, self.problems)
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


def _check_source(source: Source, cell: CellSpec, marks: Mapping[str, Node], problems: Problems) -> None:
    """The powder must fit into the mortar, and must flow at the widest opening of the hand's valve.

    `marks` tells where to report a mistake.
    """
    powder, mortar, widest_mm = source.powder, source.mortar, cell.hand.max_opening_mm
    if powder.belief.least_mm >= widest_mm:
        least = f"of {powder.name} {powder.belief.little_comes}"
        if powder.belief.threshold_mm >= widest_mm:
            least = f"no {powder.name} flows up to its belief's 'threshold', {powder.belief.threshold_mm:g} mm"
        remedy = "correct it in robot/powders.yaml, or the hand's 'max_opening' in robot/cell.yaml"
        problems.add(
            marks["powder"].mark, f"the hand opens only to {widest_mm:g} mm, and {least}", remedy, code="never-opened"
        )
    if powder.load_limit_mg < LEAST_LIMIT_MG:
        limit, least = format_mass(powder.load_limit_mg), format_mass(LEAST_LIMIT_MG)
        what = (
            f"the 'load_limit' of {powder.name}, {limit}, is too small for scoops: one may bring several times as much"
        )
        remedy = f"write {least} or more in robot/powders.yaml, if the cone may hold that"
        problems.warn(marks["powder"].mark, what, remedy, code="small-load")
    holds_mg = source.capacity_mg
    if source.amount_mg > holds_mg:
        what = f"{format_mass(source.amount_mg)} of {powder.name} does not fit into '{mortar.name}'"
        problems.add(marks["amount"].mark, what, f"it holds {format_mass(holds_mg)}", code="source-overfull")
