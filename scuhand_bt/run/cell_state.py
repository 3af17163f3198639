"""What the cell is believed to hold, as the journal keeps it, and a resumed run takes it up; and how its arm moves."""

import math
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from pydantic import TypeAdapter, ValidationError

from scuhand_bt.cell.believed import Believed
from scuhand_bt.cell.cell import Cell
from scuhand_bt.devices.interfaces import Trajectory
from scuhand_bt.journal.events import ArmMoves
from scuhand_bt.specs import BalanceBelief, PowderBelief

_BELIEVED = TypeAdapter(Believed)
ROW_S, MOST_ROWS = 0.1, 40
"""A motion is written down for who watches it, not to be moved along: in rows so far apart, and not more of them."""


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


def arm_moves(trajectory: Trajectory, cone_mm: float) -> ArmMoves:
    """A motion of the arm that is about to begin, with a cone of this rim."""
    steps = min(MOST_ROWS, max(1, math.ceil(trajectory.duration_s / ROW_S)))
    step_s = trajectory.duration_s / steps
    rows = (trajectory.sample(step_s * k) for k in range(steps + 1))
    joints_rad = tuple(tuple(round(angle, 4) for angle in row.tolist()) for row in rows)
    return ArmMoves(step_s=round(step_s, 6), joints_rad=joints_rad, cone_mm=round(cone_mm, 2))


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
