"""What the cell is believed to hold, as the journal keeps it, and a resumed run takes it up."""

from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from pydantic import TypeAdapter, ValidationError

from scuhand_bt.cell.believed import Believed
from scuhand_bt.cell.cell import Cell
from scuhand_bt.specs import BalanceBelief, PowderBelief

_BELIEVED = TypeAdapter(Believed)


def state_of(cell: Cell) -> dict[str, Any]:
    """All that a program which takes over this cell needs to be told, as plain JSON values."""
    return {
        "believed": _BELIEVED.dump_python(cell.believed, mode="json", by_alias=False),
        "joints_rad": [round(angle, 9) for angle in cell.arm.positions.tolist()],
        "powders": {
            name: belief.model_dump(mode="json", by_alias=False) for name, belief in cell.powder_beliefs.items()
        },
        "balance": cell.balance_belief.model_dump(mode="json", by_alias=False),
        "balance_figures": dict(cell.balance_figures),
    }


def take_up(cell: Cell, state: Mapping[str, Any]) -> None:
    """Believe what another program believed of this cell. Raises pydantic.ValidationError for what it never was."""
    if not state:
        return
    cell.believed = _BELIEVED.validate_python(state["believed"], by_name=True, by_alias=False)
    source = cell.sources.get(cell.believed.cone_source or "")
    if source is not None and cell.believed.sheet is None:  # as it could be in journals of earlier versions
        cell.believed.cone_holds(source, cell.believed.cone_mg)
    for name, belief in state["powders"].items():
        with suppress(ValidationError):  # of another version: it is learnt anew
            cell.powder_beliefs[name] = PowderBelief.model_validate(belief, by_name=True, by_alias=False)
    with suppress(ValidationError):
        cell.balance_belief = BalanceBelief.model_validate(state["balance"], by_name=True, by_alias=False)
    cell.balance_figures = dict(state.get("balance_figures", {}))
    cell.known_delay_s = cell.balance_figures.get("delay_s", cell.known_delay_s)
