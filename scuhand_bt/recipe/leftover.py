"""`leftover`: what a recipe wants done with the powder left in the cone (docs/recipes.md, "What is left in the cone").

Leftover powder has been in the cone, over the pan and in the air; the chemist decides whether it may go back to stock.
"""

from collections.abc import Iterable, Mapping
from typing import get_args

from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.problems import Mark, Problems, shorten
from scuhand_bt.specs import Leftover, Source
from scuhand_bt.yaml_source import Entries, Node, Scalar, describe

POLICIES: Mapping[Leftover, str] = {
    "keep": "it stays in the cone for the next sample of its lot, and goes back when there is none",
    "return": "it goes back to its source after each sample",
    "discard": "it goes to waste, or with `{to: STATION}` into another vessel",
}
assert set(POLICIES) == set(get_args(Leftover))
TO = "to"


def with_leftover(
    sources: Mapping[str, Source], node: Node | None, cell: CellSpec, problems: Problems
) -> dict[str, Source]:
    """The sources, each with the recipe's policy for its leftover powder. Mistakes are reported."""
    if node is None:
        return dict(sources)
    name = (node.text or "") if isinstance(node, Scalar) else ""
    if name in POLICIES:
        return _told(sources, {"leftover": name})
    if not isinstance(node, Entries):
        known = [*POLICIES, f"{{{TO}: STATION}}"]
        problems.add(
            node.mark, f"'leftover' cannot be {describe(node)}", unknown=name, known=known, code="unknown-name"
        )
        return dict(sources)
    for key, mark in node.keys.items():
        if key != TO:
            problems.add(mark, f"unknown key '{shorten(key)}'", unknown=key, known=[TO], code="unknown-key")
    vessel = node.get(TO)
    if vessel is None:
        problems.add(node.mark, f"'{TO}' is missing", "write the vessel's station", code="missing-key")
        return dict(sources)
    vessels = [station.name for station in cell.stations.values() if station.kind == "waste"]
    name = (vessel.text or "") if isinstance(vessel, Scalar) else ""
    if name not in vessels:
        what = f"unknown vessel {describe(vessel)}: it must be a station of the kind 'waste'"
        problems.add(vessel.mark, what, unknown=name, known=vessels, code="unknown-name")
        return dict(sources)
    return _told(sources, {"leftover": "discard", "leftover_to": name})


def check_unmixed(sources: Iterable[Source], mark: Mark, problems: Problems) -> None:
    """Report it if leftovers of several lots would go into one vessel; `mark` is where the recipe names that."""
    lots = {source.sheet_key: source.leftover_to for source in sources if source.leftover_to}
    if len(lots) > 1:
        what = f"leftovers of {' and of '.join(sorted(lots))} would mix in '{next(iter(lots.values()))}'"
        problems.add(mark, what, "write a recipe for each lot, or `leftover: discard`", code="leftover-mixed")


def _told(sources: Mapping[str, Source], leftover: Mapping[str, str]) -> dict[str, Source]:
    return {name: source.model_copy(update=leftover) for name, source in sources.items()}
