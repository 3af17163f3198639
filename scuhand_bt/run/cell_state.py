"""The state of a cell as the journal keeps it for a resumed run, and a record of its motions for those who watch."""

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any

from pydantic import TypeAdapter, ValidationError

from scuhand_bt.cell.believed import Believed
from scuhand_bt.cell.cell import Cell
from scuhand_bt.devices.interfaces import Forming, Joints, Trajectory
from scuhand_bt.journal.events import ArmMoves
from scuhand_bt.specs import BalanceBelief, PowderBelief

_BELIEVED = TypeAdapter(Believed)
ROW_S, MOST_ROWS = 0.1, 40
"""Motions are recorded for display only: one row every 0.1 s, and at most 40 rows."""


def state_of(cell: Cell) -> dict[str, Any]:
    """Everything that another program needs to take over this cell, as plain JSON values."""
    return {
        "believed": _BELIEVED.dump_python(cell.believed, mode="json", by_alias=False),
        "joints_rad": [round(angle, 9) for angle in cell.arm.positions.tolist()],
        "powders": {
            name: belief.model_dump(mode="json", by_alias=False) for name, belief in cell.powder_beliefs.items()
        },
        "balance": cell.balance_belief.model_dump(mode="json", by_alias=False),
        "balance_figures": dict(cell.balance_figures),
    }


class MotionRecord:
    """Reports every motion of a cell's arm and sheet as it begins."""

    def __init__(self, cell: Cell, tell: Callable[[ArmMoves], None]) -> None:
        self._cell = cell
        self._tell = tell
        self._formed_s, self._forming = 0.0, Forming(0.0, lambda time_s: 0.0, with_arm=False)
        cell.arm.on_start = self._moves
        cell.hand.on_start = self._forms

    def _forms(self, forming: Forming) -> None:
        self._formed_s, self._forming = self._cell.clock.now_s, forming
        if forming.with_arm:
            return
        steps, step_s = _rows(forming.duration_s)
        self._say(step_s, [self._cell.arm.positions], self._rims_mm(steps, step_s))

    def _moves(self, trajectory: Trajectory) -> None:
        steps, step_s = _rows(trajectory.duration_s)
        self._say(step_s, [trajectory.sample(step_s * k) for k in range(steps + 1)], self._rims_mm(steps, step_s))

    def _rims_mm(self, steps: int, step_s: float) -> list[float]:
        """The rim's diameter at each row while the sheet is being rolled; empty if it rests."""
        since_s = self._cell.clock.now_s - self._formed_s
        if since_s >= self._forming.duration_s:
            return []
        return [self._forming.rim_mm(since_s + step_s * k) for k in range(steps + 1)]

    def _say(self, step_s: float, rows: Sequence[Joints], rims_mm: Sequence[float]) -> None:
        self._tell(
            ArmMoves(
                step_s=round(step_s, 6),
                joints_rad=tuple(tuple(round(angle, 4) for angle in row.tolist()) for row in rows),
                cone_mm=round(self._cell.hand.cone_diameter_mm, 2),
                rims_mm=tuple(round(rim_mm, 2) for rim_mm in rims_mm),
            )
        )


def _rows(duration_s: float) -> tuple[int, float]:
    """The number of steps of a motion's record, and the time between them [s]."""
    steps = min(MOST_ROWS, max(1, math.ceil(duration_s / ROW_S)))
    return steps, duration_s / steps


def take_up(cell: Cell, state: Mapping[str, Any]) -> None:
    """Restore the beliefs that another program had of this cell.

    Raises pydantic.ValidationError if the state is malformed.
    """
    if not state:
        return
    cell.believed = _BELIEVED.validate_python(state["believed"], by_name=True, by_alias=False)
    source = cell.sources.get(cell.believed.cone_source or "")
    if source is not None and cell.believed.sheet is None:  # journals of earlier versions
        cell.believed.cone_holds(source, cell.believed.cone_mg)
    for name, belief in state["powders"].items():
        with suppress(ValidationError):  # a belief of another version is learnt again
            cell.powder_beliefs[name] = PowderBelief.model_validate(belief, by_name=True, by_alias=False)
    with suppress(ValidationError):
        cell.balance_belief = BalanceBelief.model_validate(state["balance"], by_name=True, by_alias=False)
    cell.balance_figures = dict(state.get("balance_figures", {}))
    cell.known_delay_s = cell.balance_figures.get("delay_s", cell.known_delay_s)
