"""The changer's slots: what a plan wants in them, and what a run has taken from which."""

import json
from collections.abc import Iterator
from itertools import groupby

from scuhand_bt.cell_spec import CellSpec
from scuhand_bt.events.weighings import ContainerPlaced
from scuhand_bt.journal.reader import Contents
from scuhand_bt.quantity import listed
from scuhand_bt.recipe.plan import Plan


def changer_lines(plan: Plan, cell: CellSpec) -> Iterator[str]:
    """How the changer is to be filled before the start; nothing where a person puts containers on the pan."""
    changer = cell.changer
    kinds = [one.name for job in plan.jobs if job.sample is not None for one in job.sample.all_containers]
    if changer.driver == "operator" or not kinds:
        return
    if changer.kinds:
        of_kinds = [
            _at_first(kinds.count(kind), kind, changer.slots_for(kind)) for kind in changer.kinds if kind in kinds
        ]
        order, taken, behind = "each kind in its slots", "the next container of its kind", "each kind"
    else:
        slots = changer.slots_for("")
        of_kinds = [f"{len(list(group))} {kind}" for kind, group in groupby(kinds[:slots])]
        order = "in the order of the jobs" + (f", at first {slots} of {len(kinds)}" if len(kinds) > slots else "")
        taken, behind = "the next container, and each sample behind it the one after its own", "the last"
    yield f"In the changer, {order}: {listed(of_kinds, 'group')}."
    if plan.recipe.redone:
        yield f"A sample that is done once more takes {taken}: put spare ones behind {behind}."


def _at_first(wanted: int, kind: str, slots: int) -> str:
    return f"{slots} of {wanted} {kind}" if wanted > slots else f"{wanted} {kind}"


def slots_taken(contents: Contents) -> list[tuple[str, str, str]]:
    """Slot, container and kind of all that came from the changer, in the order in which they came."""
    query = "SELECT payload FROM entry WHERE kind = ? ORDER BY seq"
    rows = contents.database.execute(query, (ContainerPlaced.KIND,))
    placed = [ContainerPlaced.model_validate(json.loads(payload)) for (payload,) in rows]
    found = [(str(one.slot), one.container, one.kind) for one in placed if one.slot is not None]
    return list(dict.fromkeys(found))
